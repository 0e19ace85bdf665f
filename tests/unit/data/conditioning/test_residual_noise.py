"""The colour of the noise: noticed, covered by the intervals, and too short records refused."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import stdtrit

from dashpot.channel import Channel
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, X2, coloured, wave


def test_coloured_noise_is_noticed_and_covered():
    """AR(1) noise, white intervals would be wrong by a factor; 2000 repeats: four sd of the ratio are 6 %."""
    rng = np.random.default_rng(4)
    repeats, t, X = 2000, np.arange(600) / 20, np.array([1 + 1j])
    e = coloured(rng, 0.8, repeats, 600, 1)
    record = Record((X1,), t, wave(t, 1.01, X) + e, 1.01)
    fit = fit_harmonics(record)
    assert fit.noise == "blocks"
    first = fit.orders.index(1)
    error = fit.amplitudes[:, first, 0] - X[0]
    variance = fit.covariance[:, first, 0, 0].real
    assert np.mean(np.abs(error) ** 2) / np.mean(variance) == pytest.approx(1, abs=0.09)
    bound = stdtrit(fit.dof[first], 0.975) * np.sqrt(variance / 2)
    inside = np.mean(np.abs(np.stack([error.real, error.imag])) < bound)
    assert inside == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / (2 * repeats)))
    white = fit_harmonics(record, noise="white").covariance[:, 0, 0, 0].real
    assert np.mean(np.abs(error) ** 2) / np.mean(white) > 1.8


@pytest.mark.slow
def test_variance_from_blocks():
    """Two channels, 3000 repeats, 60 periods: four standard errors are 5.2 %, the curvature of the spectrum 1 %."""
    rng = np.random.default_rng(20)
    t = np.arange(1200) / 20
    e = lfilter([1], [1, -0.6], rng.normal(size=(3000, 1200, 2)), axis=1)
    fit = fit_harmonics(Record((X1, X2), t, e, 1.01), harmonics=(), noise="blocks")
    variance = np.diagonal(fit.covariance[:, 0], axis1=-2, axis2=-1).real
    assert np.mean(np.abs(fit.amplitudes) ** 2) / np.mean(variance) == pytest.approx(1, abs=0.06)


def test_few_blocks_are_counted_in_the_interval():
    """Eight periods leave six lines, 12 degrees of freedom: normal intervals would hold 92.6 %, not 95 ± 0.8 %."""
    rng = np.random.default_rng(21)
    t = np.arange(160) / 20
    fit = fit_harmonics(Record((X1,), t, rng.normal(size=(6000, 160, 1)), 1.0), harmonics=(), noise="blocks")
    assert fit.dof[0] == 12
    error = np.stack([fit.amplitudes.real, fit.amplitudes.imag])[..., 0, 0]
    inside = np.abs(error) < stdtrit(12, 0.975) * np.sqrt(fit.covariance[:, 0, 0, 0].real / 2)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.008)


def test_white_noise_is_taken_as_white():
    """At 1 % two of 100 records fail by chance less often than eight do (p < 1e-5)."""
    rng = np.random.default_rng(5)
    t = np.arange(500) / 20
    kinds = [
        fit_harmonics(Record((X1, X2), t, wave(t, 1, [1, 2]) + rng.normal(size=(500, 2)), 1.0)).noise
        for _ in range(100)
    ]
    assert kinds.count("blocks") < 8


def test_cross_covariance_of_delayed_common_noise_is_complex():
    """Channel 2 sees the noise of channel 1 two samples later: V_12 = E[Δ_1 Δ_2*] turns by +2 ω Δt."""
    rng = np.random.default_rng(6)
    t, f = np.arange(400) / 10, 1.5
    common = coloured(rng, 0.5, 1500, 402, 1)
    e = np.concatenate([common[:, 2:], common[:, :-2]], axis=-1)
    fit = fit_harmonics(Record((X1, X2), t, wave(t, f, [1, 1]) + e, f), harmonics=(), noise="blocks")
    error = fit.amplitudes[:, 0] - 1
    measured = np.mean(error[:, 0] * np.conj(error[:, 1]))
    stated = np.mean(fit.covariance[:, 0, 0, 1])
    size = np.mean(fit.covariance[:, 0, 0, 0].real)
    assert abs(measured - stated) < 0.1 * size
    assert np.angle(measured) == pytest.approx(2 * np.pi * f * 0.2, abs=0.1)


def test_blocks_with_more_channels_than_lines_stays_definite():
    rng = np.random.default_rng(7)
    t = np.arange(400) / 20
    channels = tuple(Channel(f"x{i}", {f"x{i}": 1}) for i in range(30))
    y = wave(t, 1, np.ones(30)) + coloured(rng, 0.7, 400, 30)
    V = fit_harmonics(Record(channels, t, y, 1.0), noise="blocks").covariance[0]
    assert np.linalg.eigvalsh(V)[0] > 0


def test_too_few_periods_for_colour():
    rng = np.random.default_rng(8)
    t = np.arange(500) / 100
    record = Record((X1,), t, wave(t, 1, [1]) + coloured(rng, 0.9, 500, 1), 1.0)
    fit = fit_harmonics(record)
    assert fit.noise == "white"
    assert "not white" in fit.notes[0].text
    with pytest.raises(DataError, match="too few"):
        fit_harmonics(record, noise="blocks")
