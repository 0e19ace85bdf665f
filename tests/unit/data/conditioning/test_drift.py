"""Drift by evidence: slopes of all dwells together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from dashpot.channel import Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.steadiness import slopes_show
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from tests import rigs

RIG = rigs.paper_rig()
CHANNELS = rigs.channels(RIG, (Quantity.DISPLACEMENT,))


def dwells(seed: int, *, slope: float = 0.0, samples: int = 10, periods: float = 1.0) -> list[Record]:
    rng = np.random.default_rng(seed)
    records = rigs.records(RIG, CHANNELS, rng, samples=samples, periods=periods, relative=0.1)
    drifting = slope * np.linspace(-1, 1, samples)[:, None] * [1, 1, 0]
    return [replace(r, values=r.values + drifting * np.max(np.abs(r.values), axis=0)) for r in records]


@pytest.mark.slow
def test_the_test_keeps_its_level_with_ten_samples_a_dwell() -> None:
    """p is uniform: Kolmogorov and Smirnov's test over 50 seeds at 1 %."""
    p = [slopes_show(dwells(seed), (1,)) for seed in range(50)]
    assert kstest(p, "uniform").pvalue > 0.01


def test_a_slope_of_a_tenth_of_the_amplitude_shows() -> None:
    assert slopes_show(dwells(1, slope=0.1, samples=56), (1,)) < 1e-6


@pytest.mark.parametrize(("slope", "degree"), [(0.0, 0), (0.2, 1)])
def test_short_dwells_lose_a_slope_only_where_there_is_one(slope: float, degree: int) -> None:
    records = dwells(2, slope=slope, samples=56)
    lines = spectrum(records)
    np.testing.assert_array_equal(lines.amplitudes, spectrum(records, drift=degree).amplitudes)
    assert "drift_by_evidence" in [note.code for note in lines.notes]


def test_long_dwells_lose_a_slope_always() -> None:
    records = dwells(3, samples=100, periods=6.0)
    np.testing.assert_array_equal(spectrum(records).amplitudes, spectrum(records, drift=1).amplitudes)


@pytest.mark.long
@pytest.mark.parametrize(("slope", "most"), [(0.0, 1.2), (0.05, 1.55), (0.2, 1.55)])
def test_slopes_cost_what_the_theory_says(slope: float, most: float) -> None:
    """Rms error over the bound of no drift, one-period dwells at 5 % noise; THEORY §11 has 1.09, 1.42 and 1.35.

    60 tests of six unknowns that move together in threes: ± 6 %.  Coverage 93-95 % there, here ± 3.5 %.
    """
    samples = 20
    Y = rigs.amplitudes(RIG, CHANNELS)
    V = np.zeros((RIG.lines, 3, 3), dtype=complex)
    V[:, [0, 1], [0, 1]] = (0.05 * np.abs(Y[:, :2])) ** 2 * 4 / samples
    bound = identify(RIG.model, rigs.perfect(RIG, CHANNELS, V)).noise_sd
    errors, held = [], []
    for seed in range(60):
        rng = np.random.default_rng([seed, 7])
        records = rigs.records(RIG, CHANNELS, rng, samples=samples, relative=0.05)
        slopes = slope * rng.choice([-1, 1], (len(records), 3)) * np.abs(Y) * [1, 1, 0]
        ramp = np.linspace(-0.5, 0.5, samples)[:, None]
        estimate = identify(
            RIG.model,
            spectrum([replace(r, values=r.values + ramp * s) for r, s in zip(records, slopes, strict=True)]),
        )
        errors.append(((estimate.values - RIG.theta) / bound) ** 2)
        low, high = np.array([estimate[name].interval95 for name in RIG.names]).T
        held.append((low < RIG.theta) & (high > RIG.theta))
    assert np.sqrt(np.mean(errors)) < most
    assert np.mean(held) == pytest.approx(0.945, abs=0.04)
