"""The paper's rig as a test setup, its CASE 3, and data of it: what the tests of design share."""

from dataclasses import replace

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.design.advise import Answer, Question, answer
from dashpot.design.allocation import Criterion
from dashpot.design.test_setup import TestSetup, nominal_setup
from dashpot.model.rigfile.rig import ShakerLimits
from dashpot.quantities import frequencies
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.rigs import paper_rig
from tests.whole_rigs import chain

CASE3 = "1,1.5,2:4:0.25,5,6,7,8:12:0.5,13,14"
BAND = (0.25, 25.0)
RATE = 120.0
AMPLITUDE = 1e-3


def paper_setup(
    limits: ShakerLimits | None = None, relative: float = 0.1, floor: float = 0.0, floor_v: float = 0.0
) -> TestSetup:
    """Noise as a part of each amplitude, m of the displacements and m/s of the velocities."""
    rig = paper_rig()
    sensors = [
        Channel(f"{name}{x}", {x: 1.0}, quantity, noise=noise, relative_noise=relative)
        for name, quantity, noise in (("", Quantity.DISPLACEMENT, floor), ("d", Quantity.VELOCITY, floor_v))
        for x in ("x1", "x2")
    ]
    return nominal_setup(rig.model, [*sensors, Channel("u", {"u": 1.0})], rig.theta, limits=limits)


def measured(setup: TestSetup, samples: int = 56, seed: int = 0, f: str = CASE3) -> Spectrum:
    rng = np.random.default_rng(seed)
    test = dwells(setup.model, frequencies(f), samples)
    return simulate_spectrum(setup.model, setup.p[0], setup.channels, test, rng)


def random_information(rng: np.random.Generator, lines: int, q: int = 3, scenarios: int = 2) -> np.ndarray:
    """Of some lines that measure nothing in particular, (scenarios, lines, q, q)."""
    F = rng.standard_normal((scenarios, lines, q, q))
    return np.swapaxes(F, -1, -2) @ F


def setup_in_scenarios(scenarios: int) -> TestSetup:
    """The paper's setup with values that grow from scenario to scenario."""
    setup = paper_setup()
    growth = np.linspace(1, 1.3, scenarios)[:, None]
    return replace(setup, theta=np.tile(setup.theta, (scenarios, 1)) * growth)


def light_setup(floor: float, relative: float, zeta: float = 0.01) -> TestSetup:
    """Two masses on a shaken base with little damping."""
    model, theta = chain(2, zeta, seed=2)
    channels = [Channel(x, {x: 1.0}, noise=floor, relative_noise=relative) for x in model.coordinates]
    return nominal_setup(model, [*channels, Channel("u", {"u": 1.0})], theta, amplitude=AMPLITUDE)


def advised(own: TestSetup, settle: float, time: float = 40.0) -> Answer:
    """The planner's answer for its dwells within `time` s, each after `settle` s."""
    return answer(
        Question(
            model=own.model,
            channels=own.channels,
            criterion=Criterion("A"),
            band=(3.0, 20.0),
            rate=RATE,
            time=time,
            values=dict(zip(own.model.unknown_names, own.theta[0].tolist(), strict=True)),
            settle=settle,
            amplitude=AMPLITUDE,
        )
    )
