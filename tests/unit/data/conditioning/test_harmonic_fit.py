"""Harmonic regression: against textbook least squares, and its intervals against repeats.

Statistical tests state their own error: `tolerance` is four standard errors of what they measure, of a fixed seed,
and small enough to notice a variance that is wrong by ten per cent.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import stdtrit

from dashpot.channel import Channel
from dashpot.data.conditioning.harmonic_fit import (
    fit_harmonics,
    refine_frequency,
    second_moments,
    settled,
    spectrum,
)
from dashpot.data.record import Record
from dashpot.data.spectrum import merge_repeats
from dashpot.errors import DataError

X1, X2, U = Channel("x1", {"x1": 1}), Channel("x2", {"x2": 1}), Channel("u", {"u": 1})


def wave(t, f, amplitudes):
    """Re(X e^{jωt}), (samples, channels)."""
    return np.real(np.exp(2j * np.pi * f * t)[:, None] * np.asarray(amplitudes))


def coloured(rng, a, *shape):
    """AR(1) noise e_t = a e_{t−1} + white, stationary, along the axis before the last."""
    e = rng.normal(size=shape)
    e[..., 0, :] /= np.sqrt(1 - a**2)
    for i in range(1, shape[-2]):
        e[..., i, :] += a * e[..., i - 1, :]
    return e


def textbook(t, y, f, orders, degree):
    """lstsq on the whole design matrix: amplitudes (orders, channels), covariance of (Re, Im) per order and channel."""
    columns = [(t - t.mean()) ** i for i in range(degree + 1)]
    for k in orders:
        columns += [np.cos(2 * np.pi * k * f * t), -np.sin(2 * np.pi * k * f * t)]
    A = np.stack(columns, axis=1)
    c, squares, _, _ = np.linalg.lstsq(A, y, rcond=None)
    P = np.linalg.inv(A.T @ A)
    X = c[degree + 1 :: 2] + 1j * c[degree + 2 :: 2]
    sigma2 = squares / (len(t) - A.shape[1])
    first = degree + 1 + 2 * np.arange(len(orders))
    blocks = np.array([P[i : i + 2, i : i + 2] for i in first])
    return X, blocks[:, None] * sigma2[None, :, None, None]


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("samples", [37, 800])
def test_equals_textbook_least_squares_on_non_uniform_times(degree, samples):
    rng = np.random.default_rng(1)
    t = 3 + np.sort(rng.uniform(0, 2.7, samples))
    y = (
        5
        + wave(t, 1.3, [1 - 2j, 0.3])
        + wave(t, 3.9, [0.1, 0.2j])
        + 0.1 * rng.normal(size=(samples, 2))
        + t[:, None]
    )
    fit = fit_harmonics(
        Record((X1, X2), t, y, 1.3), orders=(1, 3), harmonics=(2,), drift=degree, noise="white"
    )
    X, covariance = textbook(t, y, 1.3, (1, 2, 3), degree)
    np.testing.assert_allclose(fit.amplitudes, X, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(fit.real_covariance, covariance, rtol=1e-9, atol=1e-12)
    circular = np.trace(covariance, axis1=-2, axis2=-1)
    np.testing.assert_allclose(np.diagonal(fit.covariance, axis1=-2, axis2=-1).real, circular, rtol=1e-9)
    residual = y - fit(t)
    np.testing.assert_allclose(
        fit.residual_covariance, residual.T @ residual / (samples - degree - 7), rtol=1e-9
    )


def test_two_million_samples_with_offset_drift_and_second_harmonic():
    rng = np.random.default_rng(2)
    t, f, X = 17.3 + np.arange(2_000_000) / 2000, 7.7713, np.array([2 - 1j, 0.5 + 0.2j])
    y = (
        wave(t, f, X)
        + wave(t, 2 * f, [0.05, 0.01j])
        + np.array([30, -4])
        + 1e-3 * np.array([1, 4]) * t[:, None]
    )
    y += 0.5 * rng.normal(size=y.shape)
    fit = fit_harmonics(Record((X1, X2), t, y, f))
    assert fit.orders == (1, 2)
    assert fit.noise == "white"
    sd = np.sqrt(np.diagonal(fit.real_covariance[0], axis1=-2, axis2=-1))
    np.testing.assert_allclose(sd, 0.5 * np.sqrt(2 / 2e6), rtol=0.01)
    error = np.stack([(fit.amplitudes[0] - X).real, (fit.amplitudes[0] - X).imag], axis=-1)
    assert np.all(np.abs(error) < 3.5 * sd)  # misses once in 500 seeds


def test_interval_of_an_amplitude_holds_the_truth_as_often_as_stated():
    """8000 repeats, 5.4 periods in 60 samples: the sd of the mean square of 2 parts of 2 channels is 0.8 %."""
    rng = np.random.default_rng(3)
    repeats, t, X = 8000, np.arange(60) / 10, np.array([1 + 1j, -2])
    common = rng.normal(size=(repeats, 60, 1))
    e = np.concatenate([common, 0.6 * common + 0.8 * rng.normal(size=common.shape)], axis=-1)
    fit = fit_harmonics(Record((X1, X2), t, wave(t, 0.9, X) + e, 0.9), noise="white")
    error = fit.amplitudes[:, fit.orders.index(1)] - X
    V = fit.covariance[:, fit.orders.index(1)]
    assert np.mean(np.abs(error) ** 2) / np.mean(np.diagonal(V, axis1=-2, axis2=-1).real) == pytest.approx(
        1, abs=0.032
    )
    cross = np.mean(error[:, 0] * np.conj(error[:, 1]))
    assert abs(cross - np.mean(V[:, 0, 1])) < 0.05 * np.mean(V[:, 0, 0].real)
    real = fit.real_covariance[:, fit.orders.index(1)]
    parts = np.stack([error.real, error.imag], axis=-1)
    inside = np.abs(parts) < stdtrit(fit.dof[0], 0.975) * np.sqrt(np.diagonal(real, axis1=-2, axis2=-1))
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / (2 * repeats)))
    # a variance 10 % too small would hold 93.7 %, four standard errors are 0.7 %
    whitened = np.einsum("...i,...ij,...j->...", parts, np.linalg.inv(real), parts)
    assert np.mean(whitened) == pytest.approx(2 * fit.dof[0] / (fit.dof[0] - 2), rel=0.04)


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


def test_large_offsets_and_high_drift_cost_no_digits():
    """The refinement by the residual: without it the error of this record is 1e-5."""
    t = np.linspace(0, 1.02, 4000)
    fit = fit_harmonics(Record((X1,), t, 1e6 + wave(t, 1.0, [1]), 1.0), harmonics=(), drift=5)
    assert abs(fit.amplitudes[0, 0] - 1) < 1e-8


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
    assert "not white" in fit.notes[0]
    with pytest.raises(DataError, match="too few"):
        fit_harmonics(record, noise="blocks")


def test_batch_equals_loop():
    rng = np.random.default_rng(9)
    t = np.sort(rng.uniform(0, 5, 200))
    y = wave(t, 1.2, [1, 2j]) + 0.1 * rng.normal(size=(3, 4, 200, 2))
    options = {"harmonics": (2,), "noise": "blocks"}
    whole = fit_harmonics(
        Record((X1, X2), t, np.concatenate([y, y], axis=-2)[..., :200, :], 1.2), harmonics=(2,)
    )
    assert whole.amplitudes.shape == (3, 4, 2, 2)
    t = np.arange(200) / 10
    whole = fit_harmonics(Record((X1, X2), t, y, 0.7), **options)
    for i in range(3):
        for j in range(4):
            one = fit_harmonics(Record((X1, X2), t, y[i, j], 0.7), **options)
            for name in (
                "amplitudes",
                "covariance",
                "real_covariance",
                "trend",
                "residual_covariance",
                "whiteness",
            ):
                np.testing.assert_allclose(
                    getattr(whole, name)[i, j], getattr(one, name), rtol=1e-9, atol=1e-13
                )


def test_chunks_and_tiles_do_not_show(monkeypatch):
    rng = np.random.default_rng(10)
    t = np.arange(1000) / 20
    record = Record((X1, X2), t, wave(t, 0.7, [1, 2j]) + rng.normal(size=(5, 1000, 2)) + t[:, None], 0.7)
    whole, moments = fit_harmonics(record, noise="blocks"), second_moments(record)
    monkeypatch.setattr("dashpot.data.conditioning.harmonic_fit.CHUNK", 77)
    monkeypatch.setattr("dashpot.data.conditioning.harmonic_fit.TILE", 300)
    pieces = fit_harmonics(record, noise="blocks")
    for name in ("amplitudes", "covariance", "whiteness", "residual_covariance"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(second_moments(record).products, moments.products, rtol=1e-11, atol=1e-10)


def test_exact_channel_has_no_covariance():
    rng = np.random.default_rng(11)
    t = np.arange(5000) / 50
    y = wave(t, 1.7, [1 + 1j, 2e-3]) + np.array([0, 5]) + np.array([1, 0]) * rng.normal(size=(5000, 2))
    fit = fit_harmonics(Record((X1, U), t, y, 1.7))
    assert np.all(fit.covariance[0, 1] == 0)
    assert np.all(fit.covariance[0, :, 1] == 0)
    assert fit.covariance[0, 0, 0] > 0
    assert abs(fit.amplitudes[0, 1] - 2e-3) < 1e-15 * 5
    idle = fit_harmonics(Record((X1, U), t, y * [1, 0], 1.7))
    assert np.all(idle.covariance[:, 1] == 0)


def test_harmonics_of_the_drive_are_found():
    rng = np.random.default_rng(12)
    t = np.arange(4000) / 100
    y = wave(t, 2.03, [1]) + wave(t, 6.09, [0.05]) + 0.1 * rng.normal(size=(4000, 1))
    assert fit_harmonics(Record((X1,), t, y, 2.03)).orders == (1, 3)
    assert fit_harmonics(Record((X1,), t, y, 2.03), harmonics=()).orders == (1,)
    clean = y - wave(t, 6.09, [0.05])
    assert fit_harmonics(Record((X1,), t, clean, 2.03)).orders == (1,)


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
    with pytest.raises(DataError, match="no frequency"):
        refine_frequency(record)


def test_transient_is_cut_and_reported():
    rng = np.random.default_rng(14)
    t, f = np.arange(6000) / 100, 2.0
    decay = np.exp(-t / 3)[:, None] * np.cos(2 * np.pi * 2.3 * t)[:, None]
    y = wave(t, f, [1, 2]) + decay + 0.01 * rng.normal(size=(6000, 2))
    found = settled(Record((X1, X2), t, y, f))
    assert 6 < found.dropped_s < 30
    assert found.dropped_samples == np.searchsorted(t, t[0] + found.dropped_s - 1e-9)
    assert "thrown away" in found.note
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
    assert "the first" in found.note
    assert "the last" in found.note
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
    assert "too few" in settled(Record((X1,), t, wave(t, 0.2, [1]), 0.2)).note


@pytest.mark.parametrize(
    ("samples", "rate", "f", "match"),
    [
        (100, 100, 0.6, "0.6 of a period"),
        (4, 1, 0.9, "too few"),
        (100, 10, 5.0, "apart"),
        (100, 10, 10.0, "apart"),
        (100, 10, np.nan, "nan"),
        (100, 10, -1.0, "-1"),
        (100, 10, None, "not known"),
    ],
)
def test_what_cannot_be_solved_is_said(samples, rate, f, match):
    t = np.arange(samples) / rate
    with pytest.raises(DataError, match=match) as caught:
        fit_harmonics(Record((X1,), t, np.ones((samples, 1)), f, source="sweep.csv"))
    assert caught.value.problems[0].where == "sweep.csv"
    assert caught.value.problems[0].cure


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


@pytest.mark.parametrize("drift", [None, 0, 1])
def test_second_moments_are_those_of_the_projected_samples(drift):
    rng = np.random.default_rng(17)
    t = np.arange(150) / 20
    y = 3 + rng.normal(size=(2, 150, 2))
    channels = (replace(X1, gain=2.0, sign=-1.0), X2)
    lines = spectrum([Record(channels, t, y, 1.1)], moments=True, drift=drift)
    waves = np.stack([np.cos(2 * np.pi * 1.1 * t), np.sin(2 * np.pi * 1.1 * t)], axis=-1)
    for i in range(2):
        q = np.concatenate([y[i] * [-0.5, 1], waves], axis=1)
        if drift is not None:
            A = np.vander(t - t.mean(), drift + 1)
            q = q - A @ np.linalg.lstsq(A, q, rcond=None)[0]
        np.testing.assert_allclose(lines.moments.products[i, 0], q.T @ q, rtol=1e-10, atol=1e-9)


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


def test_options_reach_the_fit():
    t = np.arange(4000) / 100
    decay = np.exp(-t / 2)[:, None] * np.cos(2 * np.pi * 2.4 * t)[:, None]
    record = Record((X1,), t, wave(t, 2.0, [1]) + decay, 2.004)
    lines = spectrum([record], settle=True, refine=True)
    assert lines.samples[0] < 4000
    assert lines.frequency_hz[0] == pytest.approx(2.0, abs=1e-4)
    assert "thrown away" in lines.notes[0]
    assert "not at 2.004 Hz" in lines.notes[1]


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
