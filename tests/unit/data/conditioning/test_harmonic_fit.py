"""Harmonic regression: against textbook least squares, and its intervals against repeats.

Statistical tests state their own error: `tolerance` is four standard errors of what they measure, of a fixed seed,
and small enough to notice a variance that is wrong by ten per cent.
"""

import numpy as np
import pytest
from scipy.special import stdtrit

from dashpot.data.conditioning.harmonic_fit import fit_harmonics, second_moments
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, X2, U, wave


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


@pytest.mark.slow
def test_many_samples_with_offset_drift_and_second_harmonic():
    rng = np.random.default_rng(2)
    t, f, X = 17.3 + np.arange(400_000) / 400, 7.7713, np.array([2 - 1j, 0.5 + 0.2j])
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
    np.testing.assert_allclose(sd, 0.5 * np.sqrt(2 / 4e5), rtol=0.01)
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


def test_large_offsets_and_high_drift_cost_no_digits():
    """The refinement by the residual: without it the error of this record is 1e-5."""
    t = np.linspace(0, 1.02, 4000)
    fit = fit_harmonics(Record((X1,), t, 1e6 + wave(t, 1.0, [1]), 1.0), harmonics=(), drift=5)
    assert abs(fit.amplitudes[0, 0] - 1) < 1e-8


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
    monkeypatch.setattr("dashpot.data.conditioning.regression.CHUNK", 77)
    monkeypatch.setattr("dashpot.data.conditioning.regression.TILE", 300)
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


@pytest.mark.parametrize(
    ("samples", "rate", "f", "match"),
    [
        (100, 100, 0.6, "0.6 of a period"),
        (4, 1, 0.9, "too few"),
        (100, 10, 5.0, "cannot separate"),
        (100, 10, 10.0, "cannot separate"),
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


def test_a_harmonic_beyond_half_the_sampling_rate_is_refused():
    time = np.arange(200) / 40
    record = Record((X1,), time, np.cos(4 * np.pi * time)[:, None], 2.0)
    with pytest.raises(DataError, match="order 25"):
        fit_harmonics(record, orders=(1, 25))
