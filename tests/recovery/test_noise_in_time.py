"""Whole records whose noise grows with time: error, stated error and coverage against the bound of all samples."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.data.conditioning.lines import spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from tests.record_draws import CASES, bound
from tests.whole_rigs import WholeTest

STEPPED = CASES[5]


def growing_noise(test: WholeTest) -> Real:
    """Standard deviations (samples, channels): 20 times as much at the end as at the start, the input exact."""
    outputs = np.array([set(channel.of) <= set(test.model.coordinates) for channel in test.record.channels])
    growth = np.linspace(0.1, 2.0, len(test.record.time))[:, None]
    return STEPPED.noise * growth * test.size * outputs


def identified(test: WholeTest, sd: Real, seed: int) -> Estimate:
    """From one noisy copy of the record."""
    noise = sd * np.random.default_rng((3, seed)).normal(size=test.record.values.shape)
    return identify(test.model, spectrum([replace(test.record, values=test.record.values + noise)]))


def test_noise_that_grows_is_weighted_by_its_size_in_time() -> None:
    """One draw; the powers of 48 blocks cost 3 % of the standard deviations (25 draws: 1.033, each to 0.015)."""
    test = STEPPED.test()
    sd = growing_noise(test)
    least, found = bound(test, sd), identified(test, sd, 0)
    assert np.mean(found.sd / least) == pytest.approx(1.033, abs=0.04)
    assert np.mean(found.bound_sd / least) == pytest.approx(1.01, abs=0.04)
    assert [notice.code for notice in found.warnings] == ["noise_in_time"]
    even = identified(test, np.sqrt(np.mean(sd**2, axis=0)), 0)
    assert not even.warnings


@pytest.mark.long
def test_noise_that_grows_reaches_its_bound() -> None:
    """200 draws; five unknowns of one count as two independent ones: 1.03 ± 3 / √800, coverage 95 % ± 3 · 1.1 %."""
    test = STEPPED.test()
    sd = growing_noise(test)
    errors, held = [], []
    for seed in range(200):
        found = identified(test, sd, seed)
        low, high = found.interval()
        errors.append(found.values - test.theta)
        held.append((low < test.theta) & (test.theta < high))
    assert np.sqrt(np.mean((np.array(errors) / bound(test, sd)) ** 2)) == pytest.approx(1.03, abs=0.11)
    assert np.mean(held) == pytest.approx(0.95, abs=0.033)
