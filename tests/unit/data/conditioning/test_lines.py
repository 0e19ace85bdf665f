"""Records as lines of a spectrum: calibrations, orders, options, merged repeats."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.data.spectrum import merge_repeats
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, X2, U, wave


def test_known_calibrations_are_taken_out_and_unknown_ones_stay():
    t = np.arange(400) / 50
    rng = np.random.default_rng(16)
    channels = (replace(X1, gain=2.0, sign=-1.0, delay=0.01), replace(X2, gain=None, delay=None, sign=None))
    y = wave(t - 0.01, 3.1, [1 + 1j, 0]) * -2 + wave(t, 3.1, [0, 1j]) + 0.01 * rng.normal(size=(400, 2))
    lines = spectrum([Record(channels, t, y, 3.1)], harmonics=(), noise="white")
    fit = fit_harmonics(Record((X1, X2), t, y, 3.1), harmonics=(), noise="white")
    np.testing.assert_allclose(lines.amplitudes[0], [1 + 1j, 1j], atol=0.01)
    h = np.array([-0.5 * np.exp(2j * np.pi * 3.1 * 0.01), 1])
    np.testing.assert_allclose(lines.amplitudes[0], h * fit.amplitudes[0])
    np.testing.assert_allclose(lines.covariance[0], np.outer(h, np.conj(h)) * fit.covariance[0])
    with pytest.raises(DataError, match="delay"):
        spectrum([Record(channels, t, y, 3.1)], moments=True)
    with pytest.raises(DataError, match="gain"):
        spectrum([Record((replace(X1, gain=0.0), X2), t, y, 3.1)])


def test_one_line_for_each_record_and_order():
    rng = np.random.default_rng(18)
    t = np.arange(500) / 50
    records = [
        Record((X1, U), t, wave(t, f, [1, 1]) + rng.normal(size=(500, 2)), f, i)
        for i, f in enumerate((2.0, 3.0))
    ]
    lines = spectrum(records, orders=(1, 3))
    np.testing.assert_allclose(lines.frequency_hz, [2, 6, 3, 9])
    np.testing.assert_array_equal(lines.experiment, [0, 0, 1, 1])
    np.testing.assert_array_equal(lines.samples, 500)
    with pytest.raises(DataError, match="moments"):
        spectrum(records, orders=(1, 3), moments=True)
    with pytest.raises(DataError, match="no records"):
        spectrum([])


def test_merged_repeats_are_as_good_as_one_long_record():
    """Four records of 500 samples against their amplitudes' weighted mean; exact channels stay exact."""
    rng = np.random.default_rng(19)
    t = np.arange(500) / 50
    y = wave(t, 2, [1, 1]) + np.array([1, 0]) * rng.normal(size=(1000, 4, 500, 2))
    records = [Record((X1, U), t, y[:, i], 2.0) for i in range(4)]
    merged = merge_repeats(spectrum(records, noise="white"))
    assert merged.lines == 1
    assert merged.samples[0] == 2000
    assert np.all(merged.covariance[..., 1] == 0)
    error = np.abs(merged.amplitudes[:, 0, 0] - 1) ** 2
    assert np.mean(error) == pytest.approx(4 / 2000, rel=0.13)
    assert np.mean(merged.covariance[:, 0, 0, 0].real) == pytest.approx(4 / 2000, rel=0.02)
