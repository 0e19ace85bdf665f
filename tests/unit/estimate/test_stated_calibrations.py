"""Gains and delays known with a standard deviation: the joint posterior, its limits, coverage, pulls and impacts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import dashpot
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.model.rigfile import Rig, parse_rig
from dashpot.study.montecarlo import Task, repeats_of, summarise
from dashpot.study.scenario import Scenario
from dashpot.study.simulate import Dwells, dwells, simulate_spectrum
from tests import rigs
from tests.two_masses import OPEN, one_mass

RIG = one_mass("f", "value = 2", of={"x": "noise = 2e-4, GAIN", "f": ""})
HZ = np.linspace(1.0, 6.0, 12)
TRUE = {"k": 800.0, "c": 6.0}


def rig(gain: str) -> Rig:
    return parse_rig(RIG.replace("GAIN", gain))


def seen(of: Rig, gain: float = 1.0, delay: float = 0.0, seed: int = 0) -> Spectrum:
    """Amplitudes that a sensor of this true gain and delay shows."""
    loose = [replace(c, gain_prior=None, delay_prior=None) for c in of.channels]
    model = of.model
    drawn = simulate_spectrum(
        model,
        model.parameters(np.array([TRUE["k"], TRUE["c"]])),
        loose,
        test_of(of),
        np.random.default_rng(seed),
    )
    kappa = np.array([gain * np.exp(-1j * drawn.omega * delay), np.ones(len(drawn.omega))]).T
    return replace(drawn, amplitudes=drawn.amplitudes * kappa, channels=of.channels)


def test_of(of: Rig) -> Dwells:
    return dwells(of.model, HZ, 50)


test_of.__test__ = False  # type: ignore[attr-defined]


def posterior(
    y: np.ndarray, V: np.ndarray, mean: Sequence[float], sd: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Mode and covariance of (k, c, gain, delay): Gauss-Newton on the rows of data and priors, y = κ / (k − ω²m + jωc).

    y (lines,) amplitudes, V (lines,) variances E|e|²; mean, sd of gain and delay.
    """
    w = 2 * np.pi * HZ
    psi = np.array([TRUE["k"], TRUE["c"], *mean])
    for _ in range(50):
        k, c, gain, delay = psi
        H = gain * np.exp(-1j * w * delay) / (k - 2 * w**2 + 1j * w * c)
        by_k = -H / (k - 2 * w**2 + 1j * w * c)
        J = np.stack([by_k, 1j * w * by_k, H / gain, -1j * w * H], axis=1)
        rows, left = [], []
        for line in range(len(w)):
            for part in (np.real, np.imag):  # each of variance V / 2
                rows.append(part(J[line]) / np.sqrt(V[line] / 2))
                left.append(part(y[line] - H[line]) / np.sqrt(V[line] / 2))
        for j in range(2):
            row = np.zeros(4)
            row[2 + j] = 1 / sd[j]
            rows.append(row)
            left.append((mean[j] - psi[2 + j]) / sd[j])
        A, b = np.array(rows), np.array(left)
        psi = psi + np.linalg.solve(A.T @ A, A.T @ b)
    return psi, np.linalg.inv(A.T @ A)


def test_estimate_is_the_joint_gaussian_posterior() -> None:
    of = rig('gain = { value = 1.02, sd = "1 %" }, delay = { value = "2 ms", sd = "0.5 ms" }')
    data = seen(of, 1.03, 2.2e-3)
    found = identify(of.model, data)
    y, V = data.amplitudes[:, 0], data.covariance[:, 0, 0].real
    mode, covariance = posterior(y, V, (1.02, 2e-3), (0.0102, 5e-4))
    assert found.names == ("k", "c", "x.gain", "x.delay")
    assert found.units == ("N/m", "N·s/m", "1", "s")
    np.testing.assert_allclose(found.values, mode, rtol=1e-7)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-5)
    assert found.fit.dof == 2 * len(HZ) - 4 + 2
    # Pulls and impacts by their definitions
    sd = np.sqrt(np.diagonal(covariance))
    by_hand = (mode[2:] - [1.02, 2e-3]) / np.sqrt(np.square([0.0102, 5e-4]) - sd[2:] ** 2)
    np.testing.assert_allclose(found.pulls[2:], by_hand, rtol=1e-4)
    assert np.isnan(found.pulls[:2]).all()
    np.testing.assert_allclose(found.impacts[0, 2], covariance[0, 2] / sd[2], rtol=1e-5)


def test_a_prior_without_width_is_a_stated_gain_and_a_wide_one_is_none() -> None:
    tight, stated = rig("gain = { value = 1.02, sd = 1e-9 }"), rig("gain = 1.02")
    data = seen(tight, 1.03)
    gain = np.array([1.02, 1.0])  # which is taken out of the amplitudes where it is known
    V = data.covariance / np.outer(gain, gain)
    taken_out = replace(data, channels=stated.channels, amplitudes=data.amplitudes / gain, covariance=V)
    a, b = identify(tight.model, data), identify(stated.model, taken_out)
    np.testing.assert_allclose(a.values[:2], b.values, rtol=1e-6)
    np.testing.assert_allclose(a.sd[:2], b.sd, rtol=1e-5)
    wide, unknown = rig("gain = { value = 1, sd = 1e6 }"), rig('gain = "unknown"')
    a, b = identify(wide.model, seen(wide, 3.0)), identify(unknown.model, seen(unknown, 3.0))
    np.testing.assert_allclose(a.values, b.values, rtol=1e-6)
    np.testing.assert_allclose(a.sd, b.sd, rtol=1e-4)


@pytest.mark.parametrize("noise", ["given", "unknown"])
def test_noise_that_is_not_given_is_found_before_the_prior_weighs(noise: str) -> None:
    of = rig('gain = { value = 1.02, sd = "1 %" }')
    data = seen(of, 1.03)
    if noise == "unknown":
        data = rigs.of_unknown_noise(data)
    found = identify(of.model, data)
    assert found["k"].value == pytest.approx(TRUE["k"], rel=0.02)
    assert 0 < found["x.gain"].sd < 0.0102


def test_limits_hold_a_gain() -> None:
    of = rig("gain = { guess = 1, min = 0.98, max = 1.01 }")
    assert identify(of.model, seen(of, 1.05))["x.gain"].value == pytest.approx(1.01)


def test_a_contradicted_gain_is_told_beyond_three_pulls() -> None:
    of = rig('gain = { value = 1, sd = "0.1 %" }')
    for true, told in ((1.0, False), (1.1, True)):
        found = identify(of.model, seen(of, true))
        codes = {notice.code: notice for notice in found.warnings}
        assert ("prior_conflict" in codes) is told
        assert bool(np.nanmax(np.abs(found.pulls)) > 3) is told
    assert codes["prior_conflict"].of == ("x.gain",)


def test_coverage_where_true_gains_and_delays_are_drawn_from_their_priors() -> None:
    """95 % intervals of 2,000 tests hold the truth; binomial error 0.5 %, three of which are allowed."""
    of = rig('gain = { value = 1, sd = "2 %" }, delay = { value = "1 ms", sd = "1 ms" }')
    p = of.model.parameters(np.array([TRUE["k"], TRUE["c"]]))
    draws = 2000
    data = simulate_spectrum(of.model, p, of.channels, test_of(of), np.random.default_rng(5), draws=draws)
    found = identify(of.model, data)
    low, high = found.interval()
    for j, name in enumerate(("k", "c")):
        share = np.mean((low[:, j] <= TRUE[name]) & (TRUE[name] <= high[:, j]))
        assert abs(share - 0.95) < 3 * np.sqrt(0.95 * 0.05 / draws)
    # Pulls are draws of the standard normal.
    pulls = found.pulls[:, 2:]
    assert np.all(np.abs(np.mean(pulls, axis=0)) < 4 / np.sqrt(draws))
    assert np.all(np.abs(np.std(pulls, axis=0) - 1) < 4 / np.sqrt(2 * draws))


def test_a_study_draws_true_gains_and_its_bound_knows_them() -> None:
    """Coverage in 1,000 repeats; where the gain is taken as exact, its error is missed."""
    of = rig('gain = { value = 1, sd = "2 %" }')
    theta, draws = np.array([TRUE["k"], TRUE["c"]]), 1000
    study = Scenario({"rig": "one"}, of.model, theta, of.channels, test_of(of), ("ml",), draws)
    found = repeats_of(Task(study, 0, draws, seed=3, block=draws))["ml"]
    told = summarise(found, theta, study.bound_sd())
    assert np.all(np.abs(told.coverage - 95) < 3 * 100 * np.sqrt(0.05 * 0.95 / draws))
    np.testing.assert_allclose(told.spread, told.bound, rtol=4 / np.sqrt(2 * draws))
    exact = replace(study, channels=[replace(of.channels[0], gain=1.0, gain_prior=None), of.channels[1]])
    assert study.bound_sd()[1] > 1.2 * exact.bound_sd()[1]


def test_pulls_of_tight_statements_are_standard_normal_where_the_noise_is_known() -> None:
    of = rig("gain = { value = 1, sd = 2e-5 }")
    p = of.model.parameters(np.array([TRUE["k"], TRUE["c"]]))
    draws = 1000
    data = simulate_spectrum(of.model, p, of.channels, test_of(of), np.random.default_rng(6), draws=draws)
    found = identify(of.model, data)
    assert np.all(found.noise_sd[:, 2] > 0.99 * 2e-5)  # which the data can hardly move
    assert abs(np.std(found.pulls[:, 2]) - 1) < 4 / np.sqrt(2 * draws)


SHARED = (
    OPEN
    + """[calibrations]
calibrator = { value = 1, sd = "1 %" }
[channels]
x1 = { of = "x1", noise = 1e-5, gain = { of = "calibrator" } }
x2 = { of = "x2", noise = 1e-5, gain = { of = "calibrator" } }
u = { of = "u" }
F = { of = "u", quantity = "force", noise = 0.01 }
"""
)


def test_a_shared_calibration_is_one_unknown_and_same_gain_as_is_the_same() -> None:
    one = parse_rig(SHARED)
    other = parse_rig(
        SHARED.replace(
            'noise = 1e-5, gain = { of = "calibrator" } }',
            'noise = 1e-5, gain = { value = 1, sd = "1 %" } }',
            1,
        )
        .replace('gain = { of = "calibrator" }', 'same_gain_as = "x1"')
        .replace('[calibrations]\ncalibrator = { value = 1, sd = "1 %" }\n', "")
    )
    theta = np.array([2.0, 3.0, 4000.0, 5000.0, 20.0, 30.0])
    test = dwells(one.model, np.linspace(2, 12, 10), 60, amplitudes={"u": 1e-3})
    data = simulate_spectrum(
        one.model, one.model.parameters(theta), one.channels, test, np.random.default_rng(3)
    )
    a, b = identify(one.model, data), identify(other.model, replace(data, channels=other.channels))
    assert a.names[-1] == "calibrator"
    assert b.names[-1] == "x1.gain"
    np.testing.assert_allclose(a.values, b.values, rtol=1e-6)
    np.testing.assert_allclose(a.sd, b.sd, rtol=1e-6)
    for read in (one, other):
        assert parse_rig(dashpot.write_rig(read)) == replace(read, path="rig.toml")


@pytest.mark.slow
def test_whole_records_and_dwells_of_samples_know_the_prior() -> None:
    of = rig('gain = { value = 1.02, sd = "1 %" }')
    time = np.arange(4000) / 200
    force = np.random.default_rng(2).standard_normal(len(time))
    whole = dashpot.simulate(of, TRUE, {"time_s": time, "f": force}, seed=4)
    settled = dashpot.simulate(of, TRUE, HZ, samples=100, seed=4)
    for records in (whole, settled):
        found = of.identify(records)
        assert found.names == ("k", "c", "x.gain")
        assert 0 < found["x.gain"].sd < 0.0102
        assert abs(found["k"].value - 800) < 4 * found["k"].sd
        assert found.stated == (("x.gain", 1.02, pytest.approx(0.0102)),)


def test_costs_are_what_exact_statements_would_save_and_go_to_json_and_back() -> None:
    of = rig('gain = { value = 1.02, sd = "1 %" }, delay = { value = "2 ms", sd = "0.5 ms" }')
    found = identify(of.model, seen(of, 1.03, 2e-3))
    assert [cost.share for cost in found.costs] == sorted((cost.share for cost in found.costs), reverse=True)
    for cost in found.costs:
        exact = np.linalg.inv(found.covariance)
        kept = [name != cost.of for name in found.names]  # rows of the information but that of the statement
        left = np.linalg.inv(exact[np.ix_(kept, kept)])
        j = [name for name in found.names if name != cost.of].index(cost.on)
        assert 1 - left[j, j] / found[cost.on].sd ** 2 == pytest.approx(cost.share, abs=1e-6)
        assert abs(cost.impact) == pytest.approx(np.sqrt(cost.share) * found[cost.on].sd)
    content = json.loads(found.to_json())
    assert set(content["pulls"]) == {"x.gain", "x.delay"}
    assert content["impacts"][0].keys() == {"of", "on", "impact", "share"}
    again = dashpot.Estimate.from_json(found.to_json())
    np.testing.assert_allclose(again.pulls, found.pulls)
    assert again.stated == found.stated
    sharper = found.with_values(**{"x.gain": 1.02})
    assert [name for name, _, _ in sharper.stated] == ["x.delay"]
    assert {cost.of for cost in sharper.costs} == {"x.delay"}
