"""Predictions of records that an estimate was not made from."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot import Channel, dwells, identify, simulate_spectrum
from dashpot.check.validation import validate
from dashpot.present.validation import prediction_in_words
from tests.nonlinear_rigs import motions, settled, two_masses
from tests.two_masses import SHAKEN, SHAKEN_TRUTH

LINES = np.linspace(1, 12, 400)


@pytest.mark.parametrize("noise_of_input", [0.0, 2e-2])
def test_chi2_counts_the_noise_of_the_inputs_that_the_rig_passes_on(noise_of_input: float) -> None:
    """800 squares of each channel, predicted by the true rig: 1 ± 0.05; the seed is fixed."""
    channels = (
        Channel("x1", {"x1": 1.0}, noise=5e-2),
        Channel("x2", {"x2": 1.0}, noise=5e-2),
        Channel("u", {"u": 1.0}, noise=noise_of_input),
    )
    p = SHAKEN.parameters(SHAKEN.theta(SHAKEN_TRUTH))
    test = dwells(SHAKEN, LINES, 50)
    first, second = (
        simulate_spectrum(SHAKEN, p, channels, test, np.random.default_rng(seed)) for seed in (1, 2)
    )
    (predicted,) = validate(SHAKEN, identify(SHAKEN, first), second)
    assert predicted.channels == ("x1", "x2")
    np.testing.assert_allclose(predicted.chi2 / predicted.dof, 1.0, atol=0.2)
    rms = np.sqrt(np.mean(np.abs(predicted.measured - predicted.predicted) ** 2, axis=0))
    alone = np.mean(np.abs(predicted.measured) ** 2, axis=0)
    np.testing.assert_allclose(predicted.fit, 1 - rms / np.sqrt(alone))


def test_a_record_in_another_unit_is_the_prediction_but_for_a_factor() -> None:
    channels = (
        Channel("x1", {"x1": 1.0}, noise=5e-2),
        Channel("x2", {"x2": 1.0}, noise=5e-2),
        Channel("u", {"u": 1.0}),
    )
    p = SHAKEN.parameters(SHAKEN.theta(SHAKEN_TRUTH))
    first = simulate_spectrum(SHAKEN, p, channels, dwells(SHAKEN, LINES, 50), np.random.default_rng(3))
    amplitudes = np.array(first.amplitudes)
    amplitudes[..., 0] *= 1000
    predictions = validate(SHAKEN, identify(SHAKEN, first), replace(first, amplitudes=amplitudes))
    factor, fit = predictions[0].rescaled()
    assert factor == pytest.approx([1000, 1], rel=0.1)
    assert np.all(fit > 0.8)
    assert "x1 is 1000 times its prediction: another unit" in prediction_in_words(predictions)


@pytest.mark.slow
@pytest.mark.parametrize("noise_of_input", [0.0, 5e-3])
def test_harmonics_of_a_rig_that_strikes_are_predicted_to_within_their_noise(noise_of_input: float) -> None:
    """144 squares of each channel: 1 ± 0.12; the seed is fixed.  All dwells are one row, as of linear rigs."""
    model, theta = two_masses("gap")
    channels = motions("x1", "x2", "u")
    first, second = (
        settled(
            model,
            theta,
            channels,
            np.linspace(3, 12, 24),
            orders=(1, 2, 3),
            noise=2e-3,
            input_noise=noise_of_input,
            rng=np.random.default_rng(seed),
        )
        for seed in (1, 2)
    )
    (predicted,) = validate(model, identify(model, first), second)
    assert predicted.channels == ("x1", "x2")
    np.testing.assert_array_equal(predicted.dof, 144)
    np.testing.assert_allclose(predicted.chi2 / predicted.dof, 1.0, atol=0.36)
