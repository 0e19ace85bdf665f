"""How many equations a line holds: inputs that none of its channels can see take none away."""

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.estimate.likelihood.objective import inputs_seen
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model


def seen(model, channels, present):
    omega = np.linspace(1.0, 2.0, len(present))
    return inputs_seen(observation_model(model, channels, omega), np.array(present, dtype=bool)).tolist()


def test_rigs_side_by_side_in_one_model():
    model = Model(
        ("x1", "x2"),
        (Input("f1", "force", {"x1": 1.0}), Input("f2", "force", {"x2": 1.0})),
        tuple(
            Element(f"{kind}{i}", kind, {f"x{i}": 1.0}) for i in (1, 2) for kind in (Kind.MASS, Kind.SPRING)
        ),
    )
    channels = [
        Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION),
        Channel("F1", {"f1": 1.0}, Quantity.FORCE),
        Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
        Channel("F2", {"f2": 1.0}, Quantity.FORCE),
    ]
    lines = [[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1], [1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 1, 0]]
    assert seen(model, channels, lines) == [1, 1, 2, 1, 0, 2]


def test_a_chain_passes_every_input_on_and_moved_inputs_pass_nothing():
    springs = [
        {"u": 1.0, "x1": -1.0},
        {"x1": 1.0, "x2": -1.0},
        {"v": 1.0, "x2": -1.0},
        {"v": 1.0, "x3": -1.0},
    ]
    model = Model(
        ("x1", "x2", "x3"),
        (Input("u", "displacement"), Input("v", "displacement")),
        tuple(Element(f"k{i}", Kind.SPRING, along) for i, along in enumerate(springs)),
    )
    channels = [
        Channel("x1", {"x1": 1.0}),
        Channel("x2", {"x2": 1.0}),
        Channel("x3", {"x3": 1.0}),
        Channel("R", {"u": 1.0}, Quantity.FORCE),
        Channel("K", {"k3": 1.0}, Quantity.FORCE),
    ]
    lines = [[1, 1, 0, 0, 0], [1, 0, 0, 0, 0], [0, 0, 1, 0, 1], [0, 0, 1, 1, 0]]
    assert seen(model, channels, lines) == [2, 1, 1, 2]
