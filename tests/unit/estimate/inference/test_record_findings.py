"""Inputs that have nothing to do with the motion, and bands too narrow for the ends of a record, are named."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.whole_record import whole_record
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.record_findings import unrelated_inputs
from tests.whole_rigs import chain, record_of

MODEL, THETA = chain(1, 0.04)
TEST = record_of(MODEL, THETA, "random", decay_times=30)


def codes(values: np.ndarray, band: tuple[float, float] | None = None) -> list[str]:
    record = replace(TEST.record, values=values)
    return [notice.code for notice in identify(MODEL, whole_record(record, band_hz=band)).warnings]


def test_an_input_that_shows_noise_alone_is_named() -> None:
    rng = np.random.default_rng(1)
    noisy = TEST.noisy(rng, 0.02 * TEST.size).values
    assert "unrelated_inputs" not in codes(noisy)
    dead = np.array(noisy)
    dead[:, 1] = 1e-6 * rng.normal(size=len(dead))
    assert "unrelated_inputs" in codes(dead)
    assert "unrelated_inputs" in codes(noisy, (60.0, 95.0))  # nothing was driven there


def test_weak_motion_under_noise_is_related() -> None:
    """The output 6 dB below its noise; and of 100 unrelated inputs 1 passes on average, 6 with p = 1e-4."""
    rng = np.random.default_rng(2)
    weak = whole_record(TEST.noisy(rng, np.array([2.0, 0.02]) * TEST.size), band_hz=(0.5, 20))
    assert unrelated_inputs(MODEL, weak) == []
    named = 0
    for _ in range(100):
        values = rng.normal(size=TEST.record.values.shape)
        values[:, 0] = TEST.record.values[:, 0] / TEST.size[0]
        lines = whole_record(replace(TEST.record, values=values), band_hz=(0.5, 20))
        named += bool(unrelated_inputs(MODEL, lines))
    assert named >= 94


def test_narrow_bands_are_named() -> None:
    rng = np.random.default_rng(3)
    noisy = TEST.noisy(rng, 0.02 * TEST.size).values
    assert "few_lines" not in codes(noisy)
    T = len(noisy) * (TEST.record.time[1] - TEST.record.time[0])
    middle = round(6.0 * T) / T
    with pytest.raises(IdentifiabilityError, match="5 lines in the band carry 6 terms") as refused:
        codes(noisy, (middle - 2.2 / T, middle + 2.2 / T))
    assert "widen the band" in str(refused.value)
