"""Nonlinear rigs on a base that is known by its acceleration or velocity, against SciPy's integrator.

The base starts anywhere and at any velocity, and its sensor adds a constant.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.check.validation import validate_records
from dashpot.data.record import Record
from dashpot.estimate.nonlinear.record_problem import record_constants
from dashpot.estimate.nonlinear.records import arranged
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.integration import bases_of, moving_rig
from dashpot.study.simulate import driven_record
from tests.networks import network

M2, TRUTH = 2.7, {"m1": 3.0, "k1": 4600.0, "k2": 4600.0, "c1": 20.0, "c2": 20.0}
LAWS = {
    "cubic": (1e9, (), lambda d, v: d**3),
    "coulomb": (5.0, (Constant("v0", 0.03),), lambda d, v: np.tanh(v / 0.03)),
    "v*abs(v)": (400.0, (), lambda d, v: v * abs(v)),
}
RATE, GROUND = 200.0, 1500.0
CHANNELS = {
    "x1": Channel("x1", {"x1": 1.0}),
    "x2": Channel("x2", {"x2": 1.0}),
    "r1": Channel("r1", {"x1": 1.0, "u": -1.0}),
    "r2": Channel("r2", {"x2": 1.0, "u": -1.0}),
    "a1": Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION),
    "a2": Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
}


def rig(
    law: str = "cubic", *, grounded: bool = False, guessed: float | None = None
) -> tuple[Model, dict[str, float]]:
    """Two masses on a base, the lower one on a law too, the upper one perhaps on a spring to the ground."""
    q, constants, _ = LAWS[law]
    truth = TRUTH | {"q": q} | ({"kg": GROUND} if grounded else {})
    guess = (
        dict.fromkeys(truth) if guessed is None else {name: guessed * value for name, value in truth.items()}
    )
    elements = [
        mass("m1", "x1", guess=guess["m1"]), mass("m2", "x2", value=M2),
        between("k1", Kind.SPRING, "x1", "x2", guess=guess["k1"]),
        between("k2", Kind.SPRING, "x2", "u", guess=guess["k2"]),
        between("c1", Kind.DAMPER, "x1", "x2", guess=guess["c1"]),
        between("c2", Kind.DAMPER, "x2", "u", guess=guess["c2"]),
        replace(between("q", Kind.SPRING, "x2", "u", guess=guess["q"]), force_law=force_law(law, constants)),
    ]  # fmt: skip
    if grounded:
        elements.append(between("kg", Kind.SPRING, "x1", "ground", guess=guess["kg"]))
    return Model(("x1", "x2"), (Input("u"),), tuple(elements)), truth


@cache
def moved(
    law: str, samples: int, seed: int, grounded: bool, start: tuple[float, float] | None, velocity: bool
) -> tuple[Real, dict[str, Real], Real]:
    """Instants, columns of the motion by SciPy, and what the base's sensor ought to show."""
    rng, time = np.random.default_rng(seed), np.arange(samples) / RATE
    omega, phase = 2 * np.pi * rng.uniform(1, 15, 30), rng.uniform(0, 6.3, 30)
    angle = omega * time[:, None] + phase
    if velocity:
        rate = CubicSpline(time, -3e-4 * np.sum(omega * np.sin(angle), axis=1))
        bend, place = rate.derivative(), rate.antiderivative()
    else:
        bend = CubicSpline(time, -3e-4 * np.sum(omega**2 * np.cos(angle), axis=1))
        rate, place = bend.antiderivative(1), bend.antiderivative(2)
    u0, v0 = start or (3e-4 * np.sum(np.cos(phase)), -3e-4 * np.sum(omega * np.sin(phase)))
    q, _, force = LAWS[law]
    ground = GROUND if grounded else 0.0

    def rates(t: float, s: Real) -> list[float]:
        x1, x2, v1, v2 = s
        d, v = x2 - u0 - v0 * t - place(t), v2 - v0 - rate(t)
        upper = TRUTH["k1"] * (x1 - x2) + TRUTH["c1"] * (v1 - v2)
        lower = TRUTH["k2"] * d + TRUTH["c2"] * v + q * force(d, v)
        return [v1, v2, (-upper - ground * x1) / TRUTH["m1"], (upper - lower) / M2]

    begun = [u0, u0, v0 + velocity * rate(0), v0 + velocity * rate(0)]
    s = solve_ivp(rates, (0, time[-1]), begun, "DOP853", time, rtol=1e-10, atol=1e-13, max_step=1 / RATE).y
    u = u0 + v0 * time + place(time)
    a = np.array([rates(t, state)[2:] for t, state in zip(time, s.T, strict=True)]).T
    columns = {"x1": s[0], "x2": s[1], "r1": s[0] - u, "r2": s[1] - u, "a1": a[0], "a2": a[1]}
    return time, columns, rate(time) if velocity else bend(time)


def recorded(
    shown: str, law: str = "cubic", *, samples: int = 600, seed: int = 0, grounded: bool = False,
    start: tuple[float, float] | None = (0.01, 0.03), bias: float = 0.2, velocity: bool = False,
    noise: float = 0.0, base_noise: float = 0.0, draw: int = 0,
) -> Record:  # fmt: skip
    """Channels "x1 x2 …" and the base's sensor; start: base and rig move so; None: as tones."""
    time, columns, base_shown = moved(law, samples, seed, grounded, start, velocity)
    names = shown.split()
    values = np.column_stack([*(columns[name] for name in names), base_shown])
    sd = np.array([*[noise] * len(names), base_noise]) * np.std(values, axis=0)
    values[:, -1] += bias
    base = Channel("u", {"u": 1.0}, Quantity.VELOCITY if velocity else Quantity.ACCELERATION)
    noisy = values + sd * np.random.default_rng(draw).standard_normal(values.shape)
    return Record((*(CHANNELS[name] for name in names), base), time, noisy)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shown", "law", "options", "guessed"),
    [
        ("r1 r2", "cubic", {}, None),
        pytest.param("x1 x2", "cubic", {}, None, marks=pytest.mark.long),
        ("a1 a2", "coulomb", {}, 1.05),
        ("r1 r2", "cubic", {"velocity": True}, None),
        ("x1 x2", "cubic", {"grounded": True, "start": None}, None),
        pytest.param("a1 r2", "cubic", {}, 1.05, marks=pytest.mark.long),
        pytest.param("a1 a2", "v*abs(v)", {}, 1.05, marks=pytest.mark.long),
        pytest.param("x1 x2", "cubic", {"velocity": True}, None, marks=pytest.mark.long),
        pytest.param("a1 a2", "cubic", {"grounded": True, "start": None}, 1.05, marks=pytest.mark.long),
        pytest.param("x1", "cubic", {"grounded": True, "start": None}, 1.05, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_exact_records_give_all_parameters_back(shown, law, options, guessed):
    model, truth = rig(law, grounded="grounded" in options, guessed=guessed)
    fitted = fit_records(model, [recorded(shown, law, **options)], exact_inputs=True)
    estimate = fitted.estimate()
    assert estimate.names == tuple(model.unknown_names)
    assert bool(estimate.converged)
    assert max(abs(estimate[name].value / value - 1) for name, value in truth.items()) < 1e-6


@pytest.mark.parametrize(
    ("shown", "law", "grounded", "starts", "biases"),
    [
        ("r1 r2", "cubic", False, [0, 1, 3, 4], [0]),  # where the base is, nobody sees
        ("x1 x2", "cubic", False, [0, 1, 3, 4, 5], [0]),  # nor the zeros of sensors, but velocities
        ("a1 a2", "coulomb", False, [0, 1, 3, 4], []),  # friction has no position
        ("x1 x2", "coulomb", False, [0, 1, 3, 4, 5], [0]),
        ("a1 a2", "cubic", True, [0, 1, 2, 3, 4, 5], [0]),
    ],
)
def test_constants_that_leave_no_trace_are_no_unknowns(shown, law, grounded, starts, biases):
    model, _ = rig(law, grounded=grounded)
    data = arranged(model, recorded(shown, law, grounded=grounded, samples=80))
    free = record_constants(moving_rig(model, data.bases), data)
    assert free.starts.tolist() == starts
    assert free.biases.tolist() == biases


def test_the_rig_counts_from_where_the_base_carries_it():
    """A lever on the base: at its tip it moves twice as far."""
    model = network(
        "x tip",
        "u",
        "m@x M@tip k:x-u",
        replace(between("l", Kind.SPRING, "tip", "u"), along={"tip": 1.0, "x": -1.0, "u": -1.0}),
    )
    bases = bases_of(model, {"u": 2})
    assert dict(bases.carried[0]) == {"x": 1.0, "tip": 2.0}
    moving = moving_rig(model, bases)
    assert [dict(e.along) for e in moving.elements[:4]] == [
        {"x": 1.0, "u, moving": 1.0}, {"tip": 1.0, "u, moving": 2.0}, {"x": 1.0}, {"tip": 1.0, "x": -1.0}
    ]  # fmt: skip


@pytest.mark.long
def test_noise_of_an_acceleration_is_found_where_it_carries_absolute_channels_away():
    """At 2 % the base seems to wander by 3 cm; the rig moves by 1 mm."""
    model, truth = rig()
    record = recorded("x1 x2", start=None, noise=0.01, base_noise=0.02)
    fitted = fit_records(model, [record])
    estimate = fitted.estimate()
    assert bool(estimate.converged)
    sd = 0.02 * np.std(record.values[:, 2])
    assert np.sqrt(fitted.noise.variance[0]) == pytest.approx(sd, rel=0.15)
    assert all(abs(estimate[name].value - value) < 4 * estimate[name].sd for name, value in truth.items())
    assert all(estimate[name].sd < 0.03 * value for name, value in truth.items())


@pytest.mark.slow
def test_a_record_that_was_not_used_is_predicted_and_simulated_ones_are_the_integrators():
    model, truth = rig()
    estimate = fit_records(model, [recorded("r1 r2", noise=0.01)], exact_inputs=True).estimate()
    other = recorded("r1 r2", seed=3, noise=0.01, bias=-0.1)
    (prediction,) = validate_records(model, estimate, [other])
    assert np.all(np.asarray(prediction.fit) > 0.97)
    exact = recorded("a1 r2", samples=300, start=(0.0, 0.0), bias=0.0)
    level = exact.values - np.mean(exact.values[:, -1]) * np.array([0, 0, 1])
    shown = driven_record(
        model, model.theta(truth), exact.channels, Record(exact.channels[-1:], exact.time, level[:, -1:]),
        np.random.default_rng(0),
    )  # fmt: skip
    again = fit_records(rig(guessed=1.02)[0], [shown], exact_inputs=True).estimate()
    assert max(abs(again[name].value / value - 1) for name, value in truth.items()) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(("law", "shown", "noise"), [("cubic", "r1 r2", 0.03), ("coulomb", "a1 a2", 0.02)])
def test_intervals_hold(law, shown, noise):
    """40 draws of six unknowns, seeds 0-39: coverage of 240 intervals, which draws share, within 4 % of 95 %."""
    model, truth = rig(law, guessed=1.02)
    z = []
    for draw in range(40):
        record = recorded(shown, law, samples=400, noise=noise, draw=draw)
        estimate = fit_records(model, [record], exact_inputs=True).estimate()
        z.append([(estimate[name].value - value) / estimate[name].sd for name, value in truth.items()])
    inside = np.mean(np.abs(z) < 1.96)
    assert 0.91 <= inside <= 0.985
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15
