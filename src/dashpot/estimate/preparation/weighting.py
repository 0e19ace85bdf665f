"""How the channels weigh: their covariance as it is known, or equal relative noise where nothing is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex
from dashpot.data.spectrum import Spectrum
from dashpot.model.observation import ObservationModel


def with_unknown_noise(spectrum: Spectrum) -> Spectrum:
    """The same amplitudes with unknown noise."""
    nothing = np.full_like(spectrum.covariance, np.nan)
    return replace(spectrum, covariance=nothing, noise=("unknown",) * spectrum.lines)


def working_covariance(view: ObservationModel, spectrum: Spectrum) -> Complex:
    """Covariance of the channels to weigh with, (..., lines, channels, channels).

    As known; unknown noise leaves the inputs exact and gives each other channel the same relative noise: what that
    lacks is one common factor, which the residuals supply.
    """
    if not np.isnan(spectrum.covariance).any():
        return spectrum.covariance
    present = spectrum.present
    X = np.where(present, spectrum.amplitudes, 0.0)
    size = np.sqrt(np.sum(np.abs(X) ** 2, axis=-2) / np.maximum(np.sum(present, axis=0), 1))
    variance = np.where(view.inputs_alone, 0.0, size**2)[..., None, :] * np.ones((spectrum.lines, 1))
    return (variance[..., :, None] * np.eye(len(spectrum.channels))).astype(np.complex128)
