"""One estimate from experiments in which the rig differs, against stacked least squares written out slowly."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import butter, lfilter

import dashpot
from dashpot import api
from dashpot.arrays import Complex, Real
from dashpot.channel import RUNS
from dashpot.check.identifiability import structure
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError, IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.model.observation import observation_model, transfer
from dashpot.model.rigfile import Rig, parse_rig
from tests.rigs import stated
from tests.two_masses import OPEN as SHAKEN
from tests.two_masses import one_mass

ADDED = 'masses.extra = { at = "x1", value = 0.5 }'
TRUTH = {"m1": 2.0, "m2": 3.0, "k1": 4000.0, "k2": 9000.0, "c1": 12.0, "c2": 20.0, "c1@added": 30.0}
HZ = np.linspace(2, 16, 15)
SD = 0.03  # of real and imaginary parts, per unit of the base


def table(rig: Rig, experiment: str | None, rng: np.random.Generator, repeats: int = 0) -> Spectrum:
    """Amplitudes of the rig in an experiment, the base exact; `repeats` of the noise as a leading axis."""
    here = rig.in_experiment(experiment)
    values = {name: TRUTH[name] for name in here.model.unknown_names}
    view = observation_model(here.model, here.channels, 2 * np.pi * HZ)
    clean = transfer(view, here.model.parameters(here.model.theta(values))).G[..., 0]
    sd = np.array([SD, SD, 0.0])
    shape = (repeats, *clean.shape) if repeats else clean.shape
    noisy = clean + sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    gains = [1.1 if channel.gain is None else 1.0 for channel in here.channels]
    kind = 0 if experiment is None else 1 + rig.model.experiments.index(experiment)
    own = {
        channel.column: channel for channel in rig.all_channels if channel.only == experiment and experiment
    }
    channels = [own.get(channel.name, channel) for channel in rig.channels]
    V = np.broadcast_to(np.diag(2 * np.square(sd * gains)), (len(HZ), 3, 3)).astype(complex)
    return stated(channels, HZ, noisy * gains, V, kind * RUNS)


def by_hand(p: Mapping[str, float], extra: float, c1: float, gain: float) -> Complex:
    """Two masses above a shaken base, frequency by frequency: amplitudes (lines, 2)."""
    rows = []
    for omega in 2 * np.pi * HZ:
        z1, z2 = p["k1"] + 1j * omega * c1, p["k2"] + 1j * omega * p["c2"]
        D = np.array([[z1 - omega**2 * (p["m1"] + extra), -z1], [-z1, z1 + z2 - omega**2 * p["m2"]]])
        rows.append(np.linalg.solve(D, [0, z2]))
    return np.array(rows) * [gain, 1.0]


@pytest.mark.parametrize("method", [None, "ml"])
def test_the_joint_estimate_is_that_of_stacked_least_squares(method: str | None) -> None:
    text = f'{SHAKEN}[experiments.added]\n{ADDED}\nc1 = "own"\nx1.gain = "own"\n'
    rig, rng = parse_rig(text), np.random.default_rng(3)
    bare, added = table(rig, None, rng), table(rig, "added", rng)
    estimate = identify(rig.model, concatenate([bare, added]), method)

    def residual(psi: Real) -> Real:
        p = dict(zip(estimate.names, psi, strict=True))
        first = bare.amplitudes[:, :2] - by_hand(p, 0.0, p["c1"], 1.0)
        second = added.amplitudes[:, :2] - by_hand(p, 0.5, p["c1@added"], p["x1@added.gain"])
        second = second / [1.1, 1.0]
        both = np.concatenate([first.ravel(), second.ravel()]) / SD
        return np.concatenate([both.real, both.imag])

    start = np.array([TRUTH.get(name, 1.1) for name in estimate.names])
    found = least_squares(residual, start, x_scale=np.abs(start), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert set(estimate.names) == {*TRUTH, "x1@added.gain"}
    np.testing.assert_allclose(estimate.values, found.x, rtol=1e-5)
    np.testing.assert_allclose(estimate.fit.chi2, 2 * found.cost, rtol=1e-6)
    np.testing.assert_allclose(
        estimate.covariance, np.linalg.inv(found.jac.T @ found.jac), rtol=2e-3, atol=1e-9
    )


@pytest.mark.parametrize("method", ["wls", "tls", "cls", "oiv", "oiv+", "ml"])
def test_an_experiment_that_differs_in_nothing_changes_nothing(method: str) -> None:
    known = SHAKEN.replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 2 }')
    plain, same = parse_rig(known), parse_rig(f"{known}[experiments.same]\nm1 = 2\n")
    rng = np.random.default_rng(9)
    first, second = table(plain, None, rng), table(plain, None, rng)
    usual = identify(plain.model, concatenate([first, second]), method)
    labelled = concatenate([first, replace(second, experiment=np.full(len(HZ), RUNS))])
    estimate = identify(same.model, labelled, method)
    assert estimate.names == usual.names
    np.testing.assert_allclose(
        estimate.values, usual.values, atol=1e-4 * np.min(usual.sd / usual.values), rtol=1e-6
    )
    np.testing.assert_allclose(estimate.sd, usual.sd, rtol=1e-4)


def test_an_added_mass_sets_the_scale_of_a_shaken_rig() -> None:
    alone, rig = parse_rig(SHAKEN), parse_rig(f"{SHAKEN}[experiments.added]\n{ADDED}\n")
    with pytest.raises(IdentifiabilityError):
        dashpot.identify(alone, table(alone, None, np.random.default_rng(1)))
    assert not structure(alone.model, alone.channels).identifiable
    assert structure(rig.model, rig.all_channels).identifiable
    both = concatenate([table(rig, kind, np.random.default_rng(1)) for kind in (None, "added")])
    assert structure(rig.model, rig.all_channels, both).identifiable
    estimate = dashpot.identify(rig, both)
    assert np.all(np.abs(estimate.values - [TRUTH[name] for name in estimate.names]) < 4 * estimate.sd)
    assert estimate.assessment is not None
    assert estimate.assessment.verdict == "fits"


@pytest.mark.parametrize("ask", [api.identify, api.check, api.compare])
def test_an_experiment_without_data_is_told(ask: Callable[[Rig, Spectrum], object]) -> None:
    rig = parse_rig(f'{SHAKEN}[experiments.added]\ndata = "run2*.csv"\n{ADDED}\n')
    with pytest.raises(DataError, match=r"added.*run2"):
        ask(rig, table(rig, None, np.random.default_rng(1)))


def test_an_own_unknown_that_nothing_shows_is_told() -> None:
    rig = parse_rig(f'{SHAKEN}[experiments.added]\nmasses.extra = {{ at = "x1" }}\nm1 = "own"\n')
    both = concatenate([table(rig, None, np.random.default_rng(1))] * 2)
    half = np.arange(both.lines) >= len(HZ)
    with pytest.raises(IdentifiabilityError, match="extra"):
        dashpot.identify(rig, replace(both, experiment=np.where(half, RUNS, 0)))


def test_that_the_rig_as_it_stands_is_missing_is_told() -> None:
    rig = parse_rig(f"{SHAKEN}[experiments.added]\n{ADDED}\n")
    with pytest.raises(IdentifiabilityError, match="without the changes"):
        dashpot.identify(rig, table(rig, "added", np.random.default_rng(1)))


def test_dwells_of_a_nonlinear_rig_whose_channel_differs() -> None:
    text = one_mass("f", "value = 1", "guess = 900", "guess = 3", {}, k3='law = "d**3", guess = 1e5')
    rig = parse_rig(text + '[experiments.late]\nx.gain = "own"\n')
    truth, rng, records = {"k": 1000.0, "k3": 2e5, "c": 4.0}, np.random.default_rng(1), []
    for experiment, gain in ((None, 1.0), ("late", 1.1)):
        hz = [3.0, 4.0, 5.0, 6.0, 7.0]
        for clean in dashpot.simulate(rig, truth, hz, amplitudes={"f": 5.0}, experiment=experiment):
            x = gain * (clean.values[:, 0] + 1e-5 * rng.standard_normal(len(clean.time)))
            columns = {"time_s": clean.time, "x": x, "f": clean.values[:, 1]}
            driven = clean.frequency_hz
            records.append(dashpot.record(columns, rig, frequency_hz=driven, experiment=experiment or 0))
    estimate = dashpot.identify(rig, records)
    assert estimate.names == (*truth, "x@late.gain")
    assert np.all(np.abs(estimate.values - [*truth.values(), 1.1]) < 4 * estimate.sd)


def test_lines_of_a_large_rig_are_each_of_their_experiment() -> None:
    count = 60  # of coordinates: sparse dynamics, and no reduced rig
    points = [f"x{i}" for i in range(count)]
    tied = [f'm{i} = {{ at = "x{i}", same_as = "m0" }}' for i in range(1, count)]
    ends = zip(points, [*points[1:], "u"], strict=True)
    springs = [f'k{i} = {{ between = ["{a}", "{b}"], value = 1000 }}' for i, (a, b) in enumerate(ends)]
    ends = zip(points, [*points[1:], "u"], strict=True)
    dampers = [f'c{i} = {{ between = ["{a}", "{b}"], value = 2 }}' for i, (a, b) in enumerate(ends)]
    rig = parse_rig(
        f"coordinates = {points}\n[inputs]\nu = {{}}\n".replace("'", '"')
        + '[masses]\nm0 = { at = "x0", guess = 1 }\n'
        + "\n".join([*tied, "[springs]", *springs, "[dampers]", *dampers])
        + '\n[channels]\nx0 = { of = "x0" }\nu = { of = "u" }\n[experiments.added]\n'
        + 'masses.extra = { at = "x3", value = 5 }\n'
    )
    hz, kinds = np.linspace(0.2, 2, 12), (None, "added")
    whole = observation_model(
        rig.model, rig.channels, 2 * np.pi * np.tile(hz, 2), np.repeat([0, RUNS], len(hz))
    )
    both = transfer(whole, rig.model.parameters(np.ones(1))).G
    for kind, part in zip(kinds, np.split(both, 2), strict=True):
        here = rig.in_experiment(kind)
        view = observation_model(here.model, here.channels, 2 * np.pi * hz)
        np.testing.assert_allclose(part, transfer(view, here.model.parameters(np.ones(1))).G, rtol=1e-9)


@pytest.mark.slow
def test_whole_records_of_two_experiments_give_one_estimate() -> None:
    text = f'{SHAKEN}[experiments.added]\n{ADDED}\nc1 = "own"\nx1.gain = "own"\n'
    rig, rng = parse_rig(text), np.random.default_rng(5)
    time = np.arange(800) * 0.01
    records = []
    for experiment, gain in ((None, 1.0), ("added", 1.1)):
        here = rig.in_experiment(experiment)
        drive = lfilter(*butter(4, 0.4), rng.standard_normal(len(time)))
        values = {name: TRUTH[name] for name in here.model.unknown_names}
        (clean,) = dashpot.simulate(rig, values, {"time_s": time, "u": drive}, experiment=experiment)
        noise = np.array([0.01, 0.01, 0.0]) * rng.standard_normal(clean.values.shape)
        shown = (clean.values + noise) * [gain, 1.0, 1.0]
        columns = {name: shown[:, i] for i, name in enumerate(("x1", "x2", "u"))}
        records.append(dashpot.record({"time_s": time, **columns}, rig, experiment=experiment or 0))
    estimate = dashpot.identify(rig, records)
    truth = np.array([TRUTH.get(name, 1.1) for name in estimate.names])
    assert np.all(np.abs(estimate.values - truth) < 4 * estimate.sd)
    assert np.all(estimate.sd < 0.01 * truth)
    assert estimate.assessment is not None
    assert estimate.assessment.verdict == "fits"
