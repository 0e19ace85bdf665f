"""Nonlinear rigs from whole records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dashpot.channel import Channel, Quantity
from dashpot.data.record import ABOVE, MISSING, Record
from dashpot.errors import ConvergenceError, DataError
from dashpot.estimate.nonlinear.record_problem import enough_substeps
from dashpot.estimate.nonlinear.record_regression import first_record_values
from dashpot.estimate.nonlinear.records import arranged
from dashpot.estimate.nonlinear.whole_record import fit_records, followed_record
from dashpot.model.elements import Element, Kind, between
from dashpot.model.nonlinear.force_law import force_law
from dashpot.model.nonlinear.integration import Integrator, forcing
from dashpot.model.nonlinear.shooting import integrate
from tests.networks import network
from tests.nonlinear_rigs import IN_ROWS, chain, guessed, motions, two_masses

STEP = 1 / 200


def record(law, channels, *, noise=0.0, samples=800, seed=0, start=None):
    model, theta = two_masses(law)
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(samples)
    tones = rng.uniform(1, 15, 30)
    u = 3e-4 * np.sum(
        np.cos(2 * np.pi * tones * time[:, None] + rng.uniform(0, 6.3, 30)), axis=1, keepdims=True
    )
    machine = Integrator(model, theta, forcing(STEP, u), 4)
    motion = integrate(machine, np.zeros(machine.states) if start is None else start)
    columns = {"x1": motion.state[:, 0], "x2": motion.state[:, 1], "u": u[:, 0]}
    columns["a1"] = machine.acceleration(motion)[0][:, 0]
    values = np.column_stack([columns[channel.name] for channel in channels])
    sd = np.array([0.0 if channel.name == "u" else noise for channel in channels]) * np.std(values, axis=0)
    return model, theta, Record(channels, time, values + sd * rng.standard_normal(values.shape))


ALL = motions("x1", "x2", "u")


def test_an_exact_record_from_a_moving_start_gives_all_parameters_back_without_guesses():
    model, theta, data = record("cubic", ALL, start=np.array([1e-3, 0.0, 0.0, 0.02]))
    estimate = fit_records(model, [data]).estimate()
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < 1e-6


@pytest.mark.parametrize(("law", "seed"), [("gap", 1), ("coulomb", 2)])
def test_constants_inside_laws_are_near_the_truth_before_the_search(law, seed):
    """A tiny gap in parallel with a spring of negative stiffness once seemed likelier: its terms are larger."""
    model, theta, data = record(law, ALL, noise=0.005, seed=seed)
    first = first_record_values(model, (arranged(model, data),))
    constants = theta[len(model.elements) - 1 :]
    assert len(constants)
    assert np.all(np.abs(first[-len(constants) :] / constants - 1) < 0.1)


def test_first_values_are_exact_with_a_dozen_samples_a_period():
    """Window functions were differentiated by splines: springs came out 2 % too stiff, half a period off after 50."""
    rate, decay = 20.0, 0.2
    time = np.arange(600) * 2 * np.pi / rate / 12
    x = np.exp(-decay * time) * np.cos(rate * time)
    along = between("q", Kind.SPRING, "x", "ground").along
    cubic = Element("q", Kind.SPRING, along, force_law=force_law("d**3"))
    model = network("x", "", "m@x=1 k:x-ground c:x-ground", cubic)
    first = first_record_values(model, (arranged(model, Record(motions("x"), time, x[:, None])),))
    assert first[:2] == pytest.approx([rate**2 + decay**2, 2 * decay], rel=2e-3)


@pytest.mark.slow
def test_a_decay_on_a_bilinear_spring_starts_near_the_truth():
    """What constants of the grid leave had been laid to noise of the motion, and a negative mass was the result."""
    m, k, c = np.array([1.485, 1.42, 1.209]), (799.0, 979.0, 635.0), (1.81, 1.09, 1.08)

    def rates(_, y):
        d, v = (part - np.append(part[1:], 0.0) for part in np.split(y, 2))
        d[1] = max(d[1], 0.0) + 0.43 * min(d[1], 0.0)
        forces = np.array(k) * d + np.array(c) * v
        return np.concatenate([y[3:], -np.diff(forces, prepend=0.0) / m])

    time = np.arange(600) * 0.01133
    x = (
        solve_ivp(rates, (0, time[-1]), [0.01, 0.0081, 0.0056, 0, 0, 0], t_eval=time, rtol=1e-9, atol=1e-12)
        .y[:3]
        .T
    )
    x += 0.003 * np.sqrt(np.mean(x**2, axis=0)) * np.random.default_rng(0).standard_normal(x.shape)
    along = between("q", Kind.SPRING, "x2", "x3").along
    bilinear = Element("q", Kind.SPRING, along, force_law=force_law("bilinear"))
    rig = "m1@x1=1.485 m2@x2 m3@x3 k1:x1-x2 k3:x3-ground c1:x1-x2 c2:x2-x3 c3:x3-ground"
    model = network("x1 x2 x3", "", rig, bilinear)
    first = first_record_values(model, (arranged(model, Record(motions("x1", "x2", "x3"), time, x)),))
    truth = {"m2": m[1], "m3": m[2], "k1": k[0], "k3": k[2], "q": k[1], "q.ratio": 0.43}
    for name, value in truth.items():
        assert first[model.unknown_names.index(name)] == pytest.approx(value, rel=0.03)


@pytest.fixture(scope="module")
def noisy_cubic():
    """Model, true values, a record with 2 % noise, and its estimate."""
    model, theta, data = record("cubic", ALL, noise=0.02, seed=3)
    return model, theta, data, fit_records(model, [data]).estimate()


def test_intervals_hold_and_unused_records_are_predicted_to_the_noise(noisy_cubic):
    model, theta, _, estimate = noisy_cubic
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)
    _, _, fresh = record("cubic", ALL, noise=0.02, seed=5)
    prediction = followed_record(model, estimate, fresh).compared()
    assert prediction.names == ("x1", "x2")
    assert np.all(prediction.relative < 0.03)


def chaotic(samples):
    """A mass on a light damper and a spring that stiffens tenfold, under a force of many tones: chaotic motion."""
    rng = np.random.default_rng(2)
    along = between("q", Kind.SPRING, "x", "ground").along
    model = network(
        "x",
        "f@x",
        "m@x k:x-ground c:x-ground",
        Element("q", Kind.SPRING, along, force_law=force_law("cubic")),
    )
    theta = np.array([1.0, 50.0, 0.2, 5e6])
    time = np.arange(samples) / 40
    tones, phases = rng.uniform(0.2, 3, 40), rng.uniform(0, 6.3, 40)
    force = 0.15 * np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1)
    drive = CubicSpline(time, force)

    def rates(t, s):
        return [s[1], drive(t) - 50.0 * s[0] - 0.2 * s[1] - 5e6 * s[0] ** 3]

    x = solve_ivp(rates, (0, time[-1]), [0, 0], "DOP853", time, rtol=1e-8, atol=1e-12).y[0]
    noisy = x + 0.01 * np.std(x) * rng.standard_normal(samples)
    channels = (Channel("f", {"f": 1.0}, Quantity.FORCE), *motions("x"))
    return model, theta, Record(channels, time, np.column_stack([force, noisy]))


@pytest.mark.parametrize("samples", [250, pytest.param(1000, marks=pytest.mark.long)])
def test_motions_that_no_free_motion_follows_from_afar_are_held_near_the_measured_one(samples):
    model, theta, data = chaotic(samples)
    estimate = fit_records(model, [data]).estimate()
    assert bool(estimate.converged)
    for value, sd, true in zip(estimate.values, estimate.sd, theta, strict=False):
        assert abs(value - true) < 4 * sd
        assert sd < 0.03 * true
    if samples == 1000:
        assert "cut_record" in [notice.code for notice in estimate.warnings]


@pytest.mark.long
def test_a_gap_is_given_back_from_an_independent_integrator():
    """Kinks within steps cost the integration its order: steps are halved until that moves nothing."""
    k, c, m, q, gap = 1200.0, 3.0, 2.0, 2500.0, 1.5e-3
    element = replace(between("q", Kind.SPRING, "x", "ground"), force_law=force_law("gap"))
    model = network("x", "f@x", "m@x k:x-ground c:x-ground", element)
    rng = np.random.default_rng(6)
    time = np.arange(300) / 90
    tones, phases = rng.uniform(1, 7, 30), rng.uniform(0, 6.3, 30)
    force = CubicSpline(time, 0.6 * np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1))

    def rates(t, s):
        pull = k * s[0] + q * (max(s[0] - gap, 0) + min(s[0] + gap, 0))
        return [s[1], (force(t) - pull - c * s[1]) / m]

    x = solve_ivp(rates, (0, time[-1]), [0, 0], "DOP853", time, rtol=1e-11, atol=1e-15, max_step=time[1]).y[0]
    assert np.max(np.abs(x)) > 1.5 * gap
    channels = (Channel("f", {"f": 1.0}, Quantity.FORCE), *motions("x"))
    estimate = fit_records(model, [Record(channels, time, np.column_stack([force(time), x]))]).estimate()
    truth = {"m": m, "k": k, "c": c, "q": q, "q.gap": gap}
    assert max(abs(estimate[name].value / value - 1) for name, value in truth.items()) < 1e-5


KINKS = dict.fromkeys(("gap", "one-sided", "bilinear", "jenkins", "backlash"), 1e-5)


def exact_record(law, count):
    """A row of masses for a second, integrated in 64 steps between samples: far finer than a fit begins with."""
    model, theta = chain(law, count)
    rng = np.random.default_rng(0)
    time = STEP * np.arange(300 if law == "stribeck" else 200)
    tones, phases = rng.uniform(1, 15, 30), rng.uniform(0, 6.3, 30)
    u = 3e-4 * np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1, keepdims=True)
    machine = Integrator(model, theta, forcing(STEP, u), 64)
    motion = integrate(machine, np.zeros(machine.states))
    channels = motions(*model.coordinates, "u")
    return model, theta, Record(channels, time, np.hstack([motion.state[:, :count], u]))


FEW_MASSES = [("cubic", 3), ("one-sided", 1)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "count"),
    [
        *FEW_MASSES,
        *(
            pytest.param(law, count, marks=pytest.mark.long)
            for law, count in IN_ROWS
            if law != "bouc-wen" and (law, count) not in FEW_MASSES
        ),
    ],
)
def test_exact_records_of_one_to_five_masses_give_every_law_back_without_guesses(law, count):
    """Stribeck's friction had begun at a ratio of 2,000, where one constant after the other leads; gaps left 6e-5.

    A play that the base carries along before the first sample leaves no trace of where it was: 1e-3 was left.
    """
    model, theta, data = exact_record(law, count)
    estimate = fit_records(model, [data]).estimate()
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < KINKS.get(law, 1e-6)


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 3, 5])
def test_exact_records_give_hysteresis_back_from_guesses(count):
    model, theta, data = exact_record("bouc-wen", count)
    estimate = fit_records(guessed(model, theta, 1.03), [data]).estimate()
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < 1e-3


@pytest.mark.long
def test_a_search_that_does_not_end_is_not_repeated_with_finer_steps():
    """Each took twice the time of the one before: a channel at another point was followed for a quarter of an hour."""
    model, theta, data = record(
        "coulomb", (*motions("x2"), Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION), *motions("u"))
    )
    moved = replace(
        data, values=np.column_stack([record("coulomb", ALL)[2].values[:, 0], *data.values.T[1:]])
    )
    fitted = fit_records(guessed(model, theta, 1.05), [moved])
    assert not fitted.converged
    assert fitted.problem.substeps[0] <= 8


@pytest.mark.long
def test_steps_are_halved_where_kinks_of_a_law_would_move_the_estimate():
    model, theta, data = record("gap", ALL, noise=1e-4, samples=400)
    fitted = fit_records(guessed(model, theta, 1.01), [data])
    coarse = enough_substeps(model, theta, STEP)
    assert fitted.problem.substeps[0] > coarse
    estimate = fitted.estimate()
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)


def test_acceleration_of_one_point_is_enough_with_guesses():
    channels = (Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION), Channel("u", {"u": 1.0}))
    model, theta, data = record("cubic", channels, noise=0.01)
    with pytest.raises(DataError, match="guess"):
        fit_records(model, [data]).estimate()
    estimate = fit_records(guessed(model, theta, 1.05), [data]).estimate()
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)


def test_an_input_that_is_not_measured_is_named():
    model, _, data = record("cubic", ALL)
    blind = Record(data.channels[:2], data.time, data.values[:, :2])
    with pytest.raises(DataError, match="input"):
        fit_records(model, [blind]).estimate()


def test_a_sensor_that_stands_still_is_named():
    """It had been fitted by a rig of springs of 1e-15 N/m."""
    model, theta, data = record("cubic", ALL, samples=60)
    dead = Record(data.channels, data.time, data.values * np.array([0.0, 1.0, 1.0]))
    with pytest.raises(DataError, match="x1 shows no motion"):
        fit_records(guessed(model, theta), [dead]).estimate()


def test_values_too_stiff_for_the_samples_are_refused():
    """Steps enough for them would not fit into any memory."""
    model, theta, data = record("cubic", ALL, samples=50)
    stiff = [replace(e, guess=1e30) if e.name == "k1" else e for e in guessed(model, theta, 1.0).elements]
    with pytest.raises(ConvergenceError, match="too fast for 200"):
        fit_records(replace(model, elements=tuple(stiff)), [data]).estimate()


def test_samples_that_are_missed_or_clipped_do_not_count(noisy_cubic):
    """20 spikes and 8 % of clipped samples of x1, 2 % noise, seed 3: no unknown moves by more than a standard
    deviation, and no more than a quarter of an interval is lost."""
    model, _, data, whole = noisy_cubic
    values, status = data.values.copy(), np.zeros(data.values.shape, dtype=np.int64)
    spikes = np.arange(7, 800, 40)
    values[spikes, 0] += 30 * np.max(np.abs(values[:, 0]))
    status[spikes, 0] = MISSING
    clipped = data.values[:, 0] > np.quantile(data.values[:, 0], 0.92)
    values[clipped, 0] = np.quantile(data.values[:, 0], 0.92)
    status[clipped, 0] = np.where(status[clipped, 0] == 0, ABOVE, MISSING)
    some = fit_records(model, (replace(data, values=values, status=status),)).estimate()
    assert np.all(np.abs(some.values - whole.values) < whole.sd)
    assert np.all(some.sd < 1.25 * whole.sd)
