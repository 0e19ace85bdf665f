"""Responses as they are shown: in the input's own quantity, with a band that Monte Carlo confirms."""

import numpy as np
import pytest

from dashpot import Channel, Quantity, dwells, identify, simulate_spectrum
from dashpot.check.residuals import FrequencyResponse, residuals, responses_of_channels
from dashpot.data.conditioning.lines import spectrum as lines_of
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import response
from tests.networks import network
from tests.two_masses import SHAKEN, SHAKEN_TRUTH
from tests.whole_rigs import chain, record_of

CHANNELS = (
    Channel("a1", {"x1": 1.0}, Quantity.ACCELERATION, noise=6.0),
    Channel("v2", {"x2": 1.0}, Quantity.VELOCITY, noise=0.2),
    Channel("table", {"u": 1.0}, Quantity.ACCELERATION),
)


def shown(seed: int) -> tuple[Estimate, tuple[FrequencyResponse, ...]]:
    p = SHAKEN.parameters(SHAKEN.theta(SHAKEN_TRUTH))
    test = dwells(SHAKEN, np.linspace(1, 12, 14), 100)
    spectrum = simulate_spectrum(SHAKEN, p, CHANNELS, test, np.random.default_rng(seed))
    estimate = identify(SHAKEN, spectrum)
    found = residuals(SHAKEN, estimate.values, spectrum)
    return estimate, responses_of_channels(SHAKEN, estimate, spectrum.channels, found)


def test_acceleration_over_acceleration_is_the_transmissibility() -> None:
    estimate, (first, second) = shown(1)
    assert [first.channel, second.channel] == ["a1", "v2"]  # not the table over itself
    assert (first.reference, first.unit, second.unit) == ("table", "", "m/s per m/s²")
    omega = 2 * np.pi * first.frequency_hz
    x = response(
        SHAKEN, SHAKEN.parameters(estimate.values), omega, np.ones((len(omega), 1)), np.zeros((len(omega), 0))
    )
    np.testing.assert_allclose(first.response, x[:, 0], rtol=1e-9)
    np.testing.assert_allclose(second.response, x[:, 1] / (1j * omega), rtol=1e-9)
    np.testing.assert_allclose(
        np.exp(1j * np.radians(first.curve_deg)), np.exp(1j * np.angle(x[:, 0])), atol=1e-9
    )
    assert np.max(np.abs(np.diff(first.curve_deg))) < 45  # no jumps
    close = np.abs(first.phase_deg - np.interp(first.lines_hz, first.frequency_hz, first.curve_deg))
    assert np.max(close) < 60


def test_of_a_whole_record_the_moving_start_is_taken_out() -> None:
    """Without noise what was measured over the input is the true rig's response, though the rig moves at both ends."""
    model, theta = chain(2, 0.03)
    test = record_of(model, theta, "random", decay_times=3, seed=1)
    spectrum = lines_of([test.record])
    estimate = identify(model, spectrum)
    found = residuals(model, estimate.values, spectrum)
    measured = responses_of_channels(model, estimate, spectrum.channels, found)
    assert [shown.channel for shown in measured] == ["x1_dis", "x2_dis"]
    for c, shown in enumerate(measured):
        omega = 2 * np.pi * shown.lines_hz
        none = np.zeros((len(omega), 0))
        true = response(model, model.parameters(theta), omega, np.ones((len(omega), 1)), none)[:, c]
        off = np.abs(shown.measured - true) / np.max(np.abs(true))
        assert np.median(off) < 1e-3
        raw = found.measured[:, c] / found.inputs[:, 0]
        assert np.median(np.abs(raw - true) / np.max(np.abs(true))) > 0.02  # with the ends in it


@pytest.mark.long
def test_the_band_is_as_wide_as_estimates_scatter() -> None:
    """Standard deviations of ln|H| over 150 repeats: to 4 standard errors (23 %), mean over frequencies to 12 %."""
    at = np.array([2.0, 5.0, 7.0, 9.0, 11.0])
    gains, phases, widths, angles = [], [], [], []
    for seed in range(150):
        _, (first, _) = shown(seed)
        gains.append(np.interp(at, first.frequency_hz, np.log(np.abs(first.response))))
        phases.append(np.interp(at, first.frequency_hz, first.curve_deg))
        widths.append(np.interp(at, first.frequency_hz, first.log_sd))
        angles.append(np.interp(at, first.frequency_hz, first.phase_sd_deg))
    ratio = np.std(gains, axis=0) / np.mean(widths, axis=0)
    assert ratio == pytest.approx(np.ones(5), abs=0.23)
    assert np.mean(ratio) == pytest.approx(1, abs=0.12)
    assert np.std(phases, axis=0) / np.mean(angles, axis=0) == pytest.approx(np.ones(5), abs=0.23)


def test_several_inputs_at_once_have_no_response() -> None:
    model = network("x", "u f@x", "m@x k:x-u")
    channels = (
        Channel("x", {"x": 1.0}, noise=0.1),
        Channel("u", {"u": 1.0}),
        Channel("f", {"f": 1.0}, Quantity.FORCE),
    )
    p = model.parameters(model.theta({"m": 1.0, "k": 300.0}))
    test = dwells(model, [1.0, 2, 4, 5], 50)
    spectrum = simulate_spectrum(model, p, channels, test, np.random.default_rng(0))
    estimate = identify(model, spectrum)
    assert (
        responses_of_channels(model, estimate, spectrum.channels, residuals(model, estimate.values, spectrum))
        == ()
    )
