"""Which noise of a record is trusted: that of a record at rest before that of its periods before that of residuals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from dashpot.arrays import Real
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.noise import noise_at_rest
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.table_noise import with_residual_noise
from dashpot.model.dynamics import response
from tests.whole_rigs import WholeTest, chain, record_of

MEMORY, SIZE = 0.8, 0.02
PERIODS, SAMPLES = 8, 400


def coloured(count: int, seed: int, sd: Real) -> Real:
    """First-order noise of the outputs, and none to speak of on the input, (count, channels)."""
    white = np.random.default_rng(seed).normal(size=(count + 200, len(sd)))
    noise: Real = lfilter([(1 - MEMORY**2) ** 0.5], [1, -MEMORY], white, axis=0)[200:] * sd
    return np.asarray(noise, dtype=np.float64)


def true_variance(lines: Spectrum, step: float, samples: int, sd: Real) -> Real:
    """E|Δ|² of the amplitudes of outputs over so many samples, (lines, outputs)."""
    z = np.exp(-1j * lines.omega * step)
    return (1 - MEMORY**2) / np.abs(1 - MEMORY * z[:, None]) ** 2 * sd[:-1] ** 2 * 4 / samples


@cache
def parts() -> tuple[WholeTest, Record, Record, Record, Real, Real]:
    """A rig; a record that repeats and one that does not, with coloured noise, and one at rest; the noise's sd
    in the first and the last, and in the second."""
    model, theta = chain(2, 0.05, force=True, base=False, seed=3)
    random = record_of(model, theta, "random", decay_times=20, seed=2)
    step = float(random.record.time[1])
    order = np.arange(1, 60)
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, len(order))
    F = np.exp(1j * phase)
    omega = 2 * np.pi * order / (SAMPLES * step)
    X = response(model, model.parameters(theta), omega, np.zeros((len(omega), 0), dtype=complex), F[:, None])
    waves = np.exp(1j * omega * step * np.arange(PERIODS * SAMPLES)[:, None])
    periodic = (waves @ np.concatenate([X, F[:, None]], axis=1)).real
    sd = np.array([SIZE, SIZE, 1e-9]) * np.std(periodic, axis=0)
    of_random = np.array([SIZE, SIZE, 1e-9]) * random.size
    channels = random.record.channels

    def noisy(values: Real, seed: int, size: Real) -> Record:
        return Record(channels, step * np.arange(len(values)), values + coloured(len(values), seed, size))

    still = noisy(np.zeros((6000, 3)), 7, sd)
    return random, noisy(periodic, 5, sd), noisy(random.record.values, 6, of_random), still, sd, of_random


@pytest.mark.parametrize("source", ["rest", "periods", "residual"])
def test_the_best_noise_there_is_counts_and_is_said(source: str) -> None:
    random, periodic, aperiodic, still, sd, of_random = parts()
    step = float(periodic.time[1])
    if source == "rest":  # the same record repeats: the record at rest goes before
        lines, samples = spectrum([periodic], still=noise_at_rest([still])), PERIODS * SAMPLES
    elif source == "periods":
        lines, samples = spectrum([periodic]), PERIODS * SAMPLES
    else:
        lines, samples, sd = spectrum([aperiodic]), len(aperiodic.time), of_random
        assert set(lines.noise) == {"floor"}
        lines, _ = with_residual_noise(random.model, lines, MaximumLikelihood())
    assert set(lines.noise) == {source}
    told = {"rest": "noise_at_rest", "periods": "periods_averaged", "residual": "input_noise"}
    assert told[source] in [notice.code for notice in lines.notes]
    # The mean over at least 40 lines with 14 degrees of freedom each, or over hundreds: 0.06 is one sd at most.
    shown = np.diagonal(lines.covariance, axis1=-2, axis2=-1).real[:, :2]
    assert np.mean(shown / true_variance(lines, step, samples, sd)) == pytest.approx(1, abs=0.25)
    # Intervals rest on it: twice the noise, twice the bound.
    estimate = identify(random.model, lines)
    doubled = identify(random.model, replace(lines, covariance=4 * lines.covariance))
    np.testing.assert_allclose(doubled.bound_sd, 2 * estimate.bound_sd, rtol=0.02)
    assert np.all(np.abs(estimate.values - random.theta) < 4.5 * estimate.sd)
