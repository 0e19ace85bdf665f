"""Weights of the channels where nothing is known of their noise."""

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.preparation import working_covariance
from dashpot.model.observation import observation_model
from tests.networks import network

MODEL = network("x", "u", "m@x k:x-u")


def test_without_known_noise_only_the_inputs_own_channels_are_exact() -> None:
    """Relative noise of each channel's rms over the lines; a reaction force is not an input."""
    channels = (
        Channel("x", {"x": 1.0}), Channel("F", {"u": 1.0}, Quantity.FORCE), Channel("u", {"u": 1.0}),
        Channel("au", {"u": 1.0}, Quantity.ACCELERATION),
    )  # fmt: skip
    rng = np.random.default_rng(5)
    Y = rng.normal(size=(6, 4)) + 1j * rng.normal(size=(6, 4))
    lines = np.arange(1.0, 7.0)
    spectrum = Spectrum(
        channels, lines, Y, np.full((6, 4, 4), np.nan), np.full(6, 50), np.full(6, np.inf), ("given",) * 6,
        np.zeros(6, dtype=np.int64),
    )  # fmt: skip
    view = observation_model(MODEL, spectrum.channels, spectrum.omega)
    variance = np.diagonal(working_covariance(view, spectrum), axis1=-2, axis2=-1).real
    expected = np.mean(np.abs(Y) ** 2, axis=0) * [1, 1, 0, 0]
    np.testing.assert_allclose(variance, np.tile(expected, (6, 1)))
