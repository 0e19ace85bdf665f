"""Predicted amplitudes and normalised residuals."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot import Channel, Input, Quantity, Spectrum, dwells, identify, method, simulate_spectrum
from dashpot.arrays import Real
from dashpot.check.residuals import calibrations_of, channel_response, residuals
from tests import rigs
from tests.networks import network

MODEL = network("x1 x2", "u", "m1@x1 m2@x2=2.7 k1:x1-x2 k2:x2-u=4600 c1:x1-x2 c2:x2-u")
THETA = MODEL.theta({"m1": 3.0, "k1": 4600.0, "c1": 20.0, "c2": 30.0})
F = np.geomspace(1, 15, 12)


def channels(noise_u: float = 0.0) -> tuple[Channel, ...]:
    return (
        Channel("x1", {"x1": 1.0}, noise=0.02),
        Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION, noise=3.0),
        Channel("rel", {"x1": 1.0, "x2": -1.0}, noise=0.02),
        Channel("u", {"u": 1.0}, noise=noise_u),
    )


def simulated(
    seed: int, noise_u: float = 0.0, draws: int | None = None, extra: tuple[Channel, ...] = ()
) -> Spectrum:
    rng = np.random.default_rng(seed)
    test = dwells(MODEL, F, 100)
    return simulate_spectrum(
        MODEL, MODEL.parameters(THETA), (*channels(noise_u), *extra), test, rng, draws=draws
    )


@pytest.mark.parametrize("noise_u", [0.0, 0.02])
def test_residuals_at_the_truth_have_variance_1(noise_u: float) -> None:
    # 40 repeats × 12 lines × 2 parts: 960 normal numbers a channel, whose rms has a standard error of 2.3 %.
    repeats = simulated(5, noise_u, draws=40)
    power = []
    for k in range(40):
        one = replace(repeats, amplitudes=repeats.amplitudes[k])
        found = residuals(MODEL, THETA, one)
        power.append(found.rms() ** 2)
        if noise_u == 0:
            np.testing.assert_allclose(found.inputs[:, 0], one.amplitudes[:, 3], rtol=1e-12)
            assert np.all(np.isnan(found.normalised[:, 3]))
    rms = np.sqrt(np.mean(power, axis=0))
    np.testing.assert_allclose(rms[: 4 if noise_u else 3], 1, atol=4 * 0.023)


@pytest.mark.parametrize("noise_u", [0.0, 0.02])
def test_prediction_is_the_projection_of_maximum_likelihood(noise_u: float) -> None:
    """Σ over the whitened residual is the χ² of the fit (all coordinates are seen, so oiv is ml)."""
    spectrum = simulated(6, noise_u)
    estimate = identify(MODEL, spectrum)
    found = residuals(MODEL, estimate.values, spectrum)
    difference = spectrum.amplitudes - found.predicted
    V = spectrum.covariance
    noisy = np.diagonal(V[0]).real > 0
    np.testing.assert_allclose(difference[:, ~noisy], 0, atol=1e-12)
    r, own = difference[:, noisy], V[:, noisy][:, :, noisy]
    chi2 = 2 * np.sum((np.conj(r) * np.linalg.solve(own, r[..., None])[..., 0]).real)
    assert chi2 == pytest.approx(_chi2_by_hand(found.inputs, estimate.values, spectrum), rel=1e-9)
    # v̂ is a minimum: any other input is worse.
    for step in (1e-3, -1e-3, 1e-3j):
        if noise_u:
            assert _chi2_by_hand(found.inputs + step, estimate.values, spectrum) > chi2


def _chi2_by_hand(v: np.ndarray, theta: Real, spectrum: Spectrum) -> float:
    G = channel_response(MODEL, MODEL.parameters(theta), spectrum.channels, spectrum.omega)
    r = spectrum.amplitudes - (G @ v[..., None])[..., 0]
    sd2 = np.diagonal(spectrum.covariance, axis1=1, axis2=2).real
    exact = sd2 == 0
    return float(2 * np.sum(np.where(exact, 0, np.abs(r) ** 2 / np.where(exact, 1, sd2))))


def test_an_exact_and_a_noisy_input_together() -> None:
    """What the exact input explains must not count for the noisy one."""
    model = replace(MODEL, inputs=(Input("u"), Input("f", "force", {"x1": 1.0})))
    sensors = (*channels(), Channel("f", {"f": 1.0}, Quantity.FORCE, noise=0.5))
    test = dwells(model, F, 100, amplitudes={"f": 3000.0})
    clean = tuple(replace(channel, noise=0.0) for channel in sensors)
    rng = np.random.default_rng(12)
    p = model.parameters(THETA)
    noisy = simulate_spectrum(model, p, sensors, test, rng)
    exact = simulate_spectrum(model, p, clean, test, rng)
    found = residuals(model, THETA, replace(noisy, amplitudes=exact.amplitudes))
    assert found.input_units == ("m", "N")
    assert found.units == ("m", "m/s²", "m", "m", "N")
    np.testing.assert_allclose(found.inputs, np.tile([1, 3000], (len(F), 1)), rtol=1e-9)
    np.testing.assert_allclose(found.predicted, exact.amplitudes, rtol=1e-9)


def test_a_misplaced_line_is_the_worst() -> None:
    spectrum = simulated(7)
    X = spectrum.amplitudes.copy()
    X[4, 1] += 50
    found = residuals(MODEL, THETA, replace(spectrum, amplitudes=X))
    (worst,) = found.largest(1)
    assert worst.channel == "a2"
    assert worst.frequency_hz == pytest.approx(F[4])
    assert worst.sd > 10


def test_what_was_not_measured_has_no_residual_but_a_prediction() -> None:
    spectrum = simulated(8)
    X = spectrum.amplitudes.copy()
    X[3, 0] = np.nan
    found = residuals(MODEL, THETA, replace(spectrum, amplitudes=X))
    assert np.isnan(found.normalised[3, 0])
    assert np.isfinite(found.predicted[3, 0])
    assert np.isfinite(found.normalised[3, 1])


def test_unknown_noise_is_scaled_to_1() -> None:
    spectrum = simulated(9)
    unknown = rigs.of_unknown_noise(spectrum)
    estimate = identify(MODEL, unknown)
    found = residuals(MODEL, estimate.values, unknown)
    assert found.scaled
    usable = np.isfinite(found.normalised)
    power = np.sum(np.abs(found.normalised[usable]) ** 2)
    assert power == pytest.approx(2 * np.sum(usable) - 4, rel=1e-9)


def test_calibrations_of_an_estimate_bring_the_residuals_down() -> None:
    extra = (Channel("late", {"x1": 1.0}, noise=0.02, delay=None, gain=None),)
    spectrum = simulated(10, extra=extra)
    X = spectrum.amplitudes.copy()
    X[:, 4] *= 1.5 * np.exp(-0.004j * spectrum.omega)
    spectrum = replace(spectrum, amplitudes=X)
    estimate = identify(MODEL, spectrum, method("ml"))
    found = calibrations_of(MODEL, estimate)
    assert found["late.gain"] == pytest.approx(1.5, rel=0.01)
    assert found["late.delay"] == pytest.approx(0.004, rel=0.05)
    theta = estimate.values[: len(MODEL.unknowns)]
    # 24 numbers: their rms is within 1 ± 0.5 but for one case in a thousand.
    assert residuals(MODEL, theta, spectrum, found).rms()[4] < 1.5
    assert residuals(MODEL, theta, spectrum).rms()[4] > 10
