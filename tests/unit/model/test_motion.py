"""Motion in time against closed forms, and against the steady response at one frequency."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.errors import ModelError
from dashpot.model.dynamics import response
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from tests.networks import network

M, C, K = 2.0, 3.0, 800.0


def single(c: float = C) -> Model:
    return network("x", "u f@x", f"m@x={M} k:x-u={K} c:x-u={c} b:x-u=0.5")


def test_free_decay() -> None:
    model = single()
    steps = integrator(model, model.p0, 0.01)
    motion = steps.motion(np.zeros((300, 2)), np.array([0.01, 0.2]))
    t, total = 0.01 * np.arange(300), M + 0.5
    decay = C / (2 * total)
    omega = np.sqrt(K / total - decay**2)
    expected = np.exp(-decay * t) * (
        0.01 * np.cos(omega * t) + (0.2 + decay * 0.01) / omega * np.sin(omega * t)
    )
    np.testing.assert_allclose(motion.x[:, 0], expected, atol=1e-14)
    np.testing.assert_allclose(motion.a[:, 0], -(C * motion.v[:, 0] + K * motion.x[:, 0]) / total, atol=1e-12)


@pytest.mark.parametrize("driven", [0, 1])
def test_the_steady_state_is_the_response(driven: int) -> None:
    model = single(30.0)
    f, step = 4.0, 1 / 4000
    t = step * np.arange(20000)
    inputs = np.zeros((len(t), 2))
    inputs[:, driven] = np.cos(2 * np.pi * f * t)
    motion = integrator(model, model.p0, step).motion(inputs)
    omega = np.array([2 * np.pi * f])
    unit = np.eye(2, dtype=complex)[driven]
    X = response(model, model.p0, omega, unit[None, :1], unit[None, 1:])[0, 0]
    expected = (X * np.exp(1j * omega * t)).real
    late = t > 3
    np.testing.assert_allclose(motion.x[late, 0], expected[late], atol=1e-8 * abs(X))


def test_critical_damping_has_no_modes_to_split() -> None:
    critical = single(2 * np.sqrt(K * (M + 0.5)))
    near = single(2 * np.sqrt(K * (M + 0.5)) * (1 + 1e-9))
    inputs = np.random.default_rng(1).normal(size=(200, 2)) * 1e-3
    both = [integrator(model, model.p0, 0.01).motion(inputs).x for model in (critical, near)]
    np.testing.assert_allclose(both[0], both[1], atol=1e-9)


def test_channels_of_a_motion() -> None:
    model = single()
    steps = integrator(model, model.p0, 0.002)
    t = 0.002 * np.arange(2000)
    inputs = np.stack([1e-3 * np.sin(20 * t), np.cos(33 * t)], axis=-1)
    motion = steps.motion(inputs)
    channels = [
        Channel("acc", {"x": 1.0}, Quantity.ACCELERATION),
        Channel("rel", {"x": 1.0, "u": -1.0}, Quantity.VELOCITY),
        Channel("f", {"f": 1.0}, Quantity.FORCE),
        Channel("reaction", {"u": 1.0}, Quantity.FORCE),
    ]
    Y = channel_samples(observation_model(model, channels, np.ones(1)), model.p0, motion)
    base = [1e-3 * np.sin(20 * t), 20e-3 * np.cos(20 * t), -0.4 * np.sin(20 * t)]
    inside = slice(20, -20)  # the spline's ends are not the sine's
    rel = motion.v[:, 0] - base[1]
    np.testing.assert_allclose(Y[:, 0], motion.a[:, 0])
    np.testing.assert_allclose(Y[inside, 1], rel[inside], atol=1e-8)
    np.testing.assert_allclose(Y[:, 2], np.cos(33 * t))
    # Newton: what moves the base is what accelerates the mass, less the applied force.
    np.testing.assert_allclose(Y[:, 3], M * motion.a[:, 0] - inputs[:, 1], atol=1e-9)


def test_refusals() -> None:
    hysteretic = Model(
        ("x",), (), (mass("m", "x", value=1.0), Element("h", Kind.HYSTERETIC, {"x": 1.0}, value=1.0))
    )
    with pytest.raises(ModelError, match="hysteretic damper"):
        integrator(hysteretic, hysteretic.p0, 0.1)
    light = Model(("x",), (), (between("k", Kind.SPRING, "x", "ground", value=1.0),))
    with pytest.raises(ModelError, match="a coordinate without mass"):
        integrator(light, light.p0, 0.1)
