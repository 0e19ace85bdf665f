"""Moderated variances: Smyth's estimators against their definition, and what they are good for."""

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.noise import moderated
from dashpot.estimate.identify import identify
from tests import rigs

RIG = rigs.paper_rig()
CHANNELS = rigs.channels(RIG, (Quantity.DISPLACEMENT,))


@pytest.mark.parametrize("constant", [False, True])
def test_alike_variances_are_pooled(constant: bool) -> None:
    """Noise that is proportional to the amplitude, or constant: the prior finds it within a fifth from 8 samples."""
    rng = np.random.default_rng(8)
    records = rigs.records(RIG, CHANNELS, rng, samples=8, relative=0.0 if constant else 0.1)
    if constant:
        records = [
            type(r)(r.channels, r.time, r.values + 0.02 * rng.normal(size=r.values.shape), r.frequency_hz)
            for r in records
        ]
    lines = spectrum(records, drift=0)
    variance = np.diagonal(lines.covariance, axis1=1, axis2=2).real[:, :2]
    size = 0.02 if constant else 0.1 * np.abs(rigs.amplitudes(RIG, CHANNELS)[:, :2])
    ratio = variance / (4 * size**2 / 8)
    assert np.all(np.abs(np.log(ratio)) < 0.7)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.25)
    assert np.all(lines.dof > 12)  # 5 of its own
    assert lines.notes[-1].code == "noise_moderated"


def test_dwells_with_many_samples_keep_their_own_noise() -> None:
    lines = spectrum(rigs.records(RIG, CHANNELS, np.random.default_rng(9), samples=64))
    assert moderated(lines) is lines


def test_one_short_dwell_among_long_ones_leaves_the_rig_determined() -> None:
    """Eight samples at one of 25 frequencies, whose own noise has too few degrees of freedom for any weight."""
    rng = np.random.default_rng(10)
    records = rigs.records(RIG, CHANNELS, rng, samples=100, periods=6.0)
    records[4] = rigs.records(RIG, CHANNELS, rng, samples=8)[4]
    estimate = identify(RIG.model, spectrum(records))
    assert bool(estimate.converged)
    assert np.all(np.abs(estimate.values - RIG.theta) < 5 * estimate.sd)


@pytest.mark.long
def test_few_samples_cost_no_more_than_a_tenth() -> None:
    """rms over the bound of known noise with 10 and 24 samples a dwell, 60 tests: 1.08 and 1.05, ± 6 %."""
    for samples, most in ((10, 1.2), (24, 1.12)):
        errors, inside = [], []
        V = np.zeros((RIG.lines, 3, 3), dtype=complex)
        Y = rigs.amplitudes(RIG, CHANNELS)
        V[:, [0, 1], [0, 1]] = (0.1 * np.abs(Y[:, :2])) ** 2 * 4 / samples
        bound = identify(RIG.model, rigs.perfect(RIG, CHANNELS, V)).noise_sd
        for seed in range(60):
            records = rigs.records(
                RIG, CHANNELS, np.random.default_rng(1000 + seed), samples=samples, relative=0.1
            )
            estimate = identify(RIG.model, spectrum(records))
            errors.append(((estimate.values - RIG.theta) / bound) ** 2)
            low, high = np.array([estimate[name].interval95 for name in RIG.names]).T
            inside.append((low < RIG.theta) & (high > RIG.theta))
        assert np.sqrt(np.mean(errors)) < most
        assert np.mean(inside) == pytest.approx(0.95, abs=0.035)
