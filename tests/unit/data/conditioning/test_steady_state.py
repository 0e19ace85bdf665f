"""Transients are cut where there are some, and nothing else is."""

import numpy as np
import pytest

from dashpot.data.conditioning.clock import within_times
from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.steadiness import settled
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, X2, wave


def test_transient_is_cut_and_reported():
    rng = np.random.default_rng(14)
    t, f = np.arange(6000) / 100, 2.0
    decay = np.exp(-t / 3)[:, None] * np.cos(2 * np.pi * 2.3 * t)[:, None]
    y = wave(t, f, [1, 2]) + decay + 0.01 * rng.normal(size=(6000, 2))
    found = settled(Record((X1, X2), t, y, f))
    assert 6 < found.dropped_s < 30
    assert found.dropped_samples == np.searchsorted(t, t[0] + found.dropped_s - 1e-9)
    assert found.note.code == "transient_discarded"
    assert found.record.time[0] == t[found.dropped_samples]
    assert found.record.time[-1] == t[-1]
    after = fit_harmonics(found.record)
    assert np.all(np.abs(after.amplitudes[0] - [1, 2]) < 6 * np.sqrt(np.diagonal(after.covariance[0]).real))


def test_silence_before_and_ring_down_after_the_dwell_are_cut():
    """The drive runs from 20 s to 50 s of 80 s, 0.4 % off its nominal frequency."""
    rng = np.random.default_rng(22)
    t, f = np.arange(8000) / 100, 2.008
    decay = np.where(t > 50, np.exp(-(t - 50) / 8), 0)[:, None] * np.cos(2 * np.pi * 2.7 * t)[:, None]
    y = (
        wave(t, f, [1, 2]) * ((t > 20) & (t < 50))[:, None]
        + decay * [0.5, 1]
        + 0.01 * rng.normal(size=(8000, 2))
    )
    found = settled(Record((X1, X2), t, y, 2.0))
    assert 20 < found.record.time[0] < 26
    assert 44 < found.record.time[-1] < 50
    assert found.dropped_samples == 8000 - len(found.record.time)
    assert "the first" in str(found.note)
    assert "the last" in str(found.note)
    assert refine_frequency(found.record).frequency_hz == pytest.approx(f, abs=1e-4)


def test_settled_record_is_left_alone():
    """At 1 %: 3 of 100 records at most would be cut by chance in 98 % of seeds, 8 in all but 1e-5 of them."""
    rng = np.random.default_rng(15)
    t = np.arange(1000) / 50
    cut = [
        settled(Record((X1,), t, wave(t, 2, [1]) + 0.1 * rng.normal(size=(1000, 1)), 2.0)).dropped_samples > 0
        for _ in range(100)
    ]
    assert sum(cut) < 8
    assert settled(Record((X1,), t, wave(t, 2, [1]), 2.0)).dropped_samples == 0
    assert "too few" in str(settled(Record((X1,), t, wave(t, 0.2, [1]), 0.2)).note)


def test_a_stated_time_is_dropped():
    t = 5 + np.arange(1000) / 100
    record = Record((X1,), t, wave(t, 2.0, [1.0]), 2.0)
    assert within_times(record, 7.5, np.inf).time[0] == pytest.approx(7.5)
    lines, whole = spectrum([record], settle=2.5), spectrum([record])
    assert lines.samples[0] == 750
    assert whole.samples[0] == 1000
    with pytest.raises(DataError, match="fewer than two samples"):
        spectrum([record], settle=10)
