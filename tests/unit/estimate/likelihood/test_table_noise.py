"""Noise of tables that give none: found with the parameters, and paid for by the intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from dashpot.arrays import Complex, Real
from dashpot.check.verdict import assess
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.table_noise import doubts_of_weights, with_residual_noise
from dashpot.estimate.preparation import prepare
from dashpot.estimate.registry import method
from tests.two_masses import PUSHED
from tests.unit.data.test_local_noise import RIG, functions

LINES = 20
TRUTH = RIG.theta(PUSHED)
CLEAN = functions(LINES, 0.0)
SIZE = np.abs(CLEAN.amplitudes) * np.array([1.0, 1.0, 0.0])
CONSTANT = 0.02 * np.array([1.0, 0.1, 1.0]) * np.median(SIZE, axis=0)
KINDS = {"share": 0.02 * SIZE, "constant": CONSTANT * np.ones((LINES, 1))}


def table(sd: Real, seed: int, noise: bool = False) -> Spectrum:
    """The table with noise of this standard deviation of both parts of each amplitude, which it gives if so wanted."""
    rng = np.random.default_rng(seed)
    wobble = rng.standard_normal(sd.shape) + 1j * rng.standard_normal(sd.shape)
    given: Complex = 2 * sd[:, :, None] ** 2 * np.eye(3) + 0j
    amplitudes = CLEAN.amplitudes + sd * wobble
    if not noise:
        return replace(CLEAN, amplitudes=amplitudes)
    return replace(CLEAN, amplitudes=amplitudes, covariance=given, noise=("given",) * LINES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_estimates_are_as_good_as_with_the_noise_given(kind: str) -> None:
    """50 draws of six parameters: coverage to 1.3 % if they were independent, 3 % as they are; the ratio to 5 %.

    With even weights the ratio is 2.0 and the coverage 78 % where the noise is a share of the motion.
    """
    draws = 50
    errors, known, hits = np.empty((draws, 6)), np.empty((draws, 6)), np.empty((draws, 6), dtype=bool)
    for k in range(draws):
        estimate = identify(RIG, table(KINDS[kind], k))
        assert (estimate.basis, np.isnan(estimate.fit.p)) == ("residuals", True)
        assert [note.code for note in estimate.notes] == ["noise_fitted"]
        errors[k] = estimate.values - TRUTH
        half = t.ppf(0.975, estimate.dof) * estimate.sd
        hits[k] = np.abs(errors[k]) < half
        known[k] = identify(RIG, table(KINDS[kind], k, noise=True)).values - TRUTH
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(known**2, axis=0))
    assert np.median(ratio) < 1.15, ratio
    assert 0.88 < np.mean(hits) < 0.997, np.mean(hits, axis=0)


def test_the_noise_is_what_it_is() -> None:
    """A share of 2 % in 40 tables of 40 real numbers a channel and table: its size to 1.8 %."""
    shares = []
    for k in range(40):
        lines, _ = with_residual_noise(RIG, table(KINDS["share"], k), method("oiv"))
        assert set(lines.noise) == {"fitted"}
        assert not lines.noise_known
        shares.append(np.sqrt(np.diagonal(lines.covariance, axis1=1, axis2=2).real / 2)[:, :2] / SIZE[:, :2])
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(0.02, rel=0.08)


def test_noise_in_equal_proportion_costs_nothing() -> None:
    """Then one factor is all there is to find: intervals are Student's with what is left of the degrees of freedom."""
    even = 0.02 * np.sqrt(np.mean(SIZE**2, axis=0)) * np.ones((LINES, 1))
    plain = 0
    for k in range(10):
        spectrum = table(even, k)
        lines, _ = with_residual_noise(RIG, spectrum, method("oiv"))
        data = prepare(RIG, lines)
        solution = method("oiv").solve(data)
        grown, dof = doubts_of_weights(data, solution)
        relative = np.diagonal(lines.covariance, axis1=1, axis2=2).real[:, :2] / np.mean(
            np.abs(spectrum.amplitudes[:, :2]) ** 2, axis=0
        )
        if np.ptp(relative) < 1e-9 * np.max(relative):
            plain += 1
            assert dof == pytest.approx(2 * 2 * LINES - 6, rel=1e-6)
            assert np.all(np.abs(grown[0]) < 1e-6 * np.abs(np.diag(solution.covariance[0])))
    assert plain >= 6


def test_repeats_of_a_batch_are_what_each_is_alone() -> None:
    alone = [identify(RIG, table(KINDS["share"], k)) for k in range(3)]
    batch = replace(CLEAN, amplitudes=np.stack([table(KINDS["share"], k).amplitudes for k in range(3)]))
    together = identify(RIG, batch)
    for k, one in enumerate(alone):
        assert together.values[k] == pytest.approx(one.values, rel=1e-9)
        assert together.sd[k] == pytest.approx(one.sd, rel=1e-9)


def test_a_missing_damper_shows_whatever_the_phase_of_the_drive() -> None:
    """What it leaves over turns with the drive: from line to line it runs smoothly only against the motion."""
    wrong = replace(RIG, elements=tuple(element for element in RIG.elements if element.name != "c2"))
    dense = functions(200, 0.01)
    assert assess(wrong, dense, identify(wrong, dense)).verdict == "does not fit"
    turned = dense.amplitudes * np.exp(2j * np.pi * np.random.default_rng(1).random((200, 1)))
    stepped = replace(dense, amplitudes=turned)
    judged = assess(wrong, stepped, identify(wrong, stepped))
    assert judged.verdict == "does not fit"
    assert "smooth_residuals" in [reason.code for reason in judged.reasons]
    assert assess(RIG, stepped, identify(RIG, stepped)).verdict == "cannot tell"


def test_too_small_and_exact_tables_keep_even_weights() -> None:
    small = table(KINDS["share"], 0).select(range(2))
    assert with_residual_noise(RIG, small, method("oiv"))[0] is small
    exact, _ = with_residual_noise(RIG, table(0 * SIZE, 0), method("oiv"))
    variance = np.diagonal(exact.covariance, axis1=1, axis2=2).real
    assert np.all(np.ptp(variance, axis=0) == 0)


def test_a_table_of_anything_but_motion_finds_no_noise_and_does_not_break_off() -> None:
    """As decibels read as metres: where the rig explains nothing, sizes of the noise have no ends."""
    random = np.random.default_rng(4).standard_normal(CLEAN.amplitudes.shape) * (1 + 1j)
    assert "noise_fitted" not in {
        note.code
        for note in with_residual_noise(RIG, replace(CLEAN, amplitudes=random), method("oiv"))[0].notes
    }
