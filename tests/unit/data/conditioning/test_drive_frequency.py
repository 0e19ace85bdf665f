"""Refined frequency: its standard deviation against repeats, exact where the record is clean."""

import numpy as np
import pytest

from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, X2, U, wave


@pytest.mark.slow
def test_refined_frequency_and_its_sd():
    """400 records: the mean of ((f̂ − f)/sd)² is 1 with a standard error of 7 %."""
    rng = np.random.default_rng(13)
    t, f = np.arange(300) / 20, 1.2345
    ratios = []
    for _ in range(400):
        y = 3 + wave(t, f, [1, 0.3j]) + np.array([0.3, 0.1]) * rng.normal(size=(300, 2))
        found = refine_frequency(Record((X1, X2), t, y, 1.25))
        ratios.append(((found.frequency_hz - f) / found.sd) ** 2)
    assert np.mean(ratios) == pytest.approx(1, abs=0.28)


@pytest.mark.parametrize("nominal", [4.95, 5.0, 5.09])
def test_refined_frequency_of_a_clean_record_is_exact(nominal):
    t = np.arange(30000) / 100
    record = Record((X1, U), t, 2 + 0.01 * t[:, None] + wave(t, 5.0123, [1, 2j]), nominal)
    assert refine_frequency(record).frequency_hz == pytest.approx(5.0123, rel=1e-10)


def test_no_frequency_to_find():
    t = np.arange(3000) / 100
    record = Record((X1,), t, wave(t, 5.9, [1.0]), 5.0)
    with pytest.raises(DataError, match="no drive frequency"):
        refine_frequency(record)
