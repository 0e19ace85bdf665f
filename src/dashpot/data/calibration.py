"""The known sign, gain and delay of channels as factors of their amplitudes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.errors import DataError


def calibration(channels: Sequence[Channel], frequency_hz: Real) -> Complex:
    """Factors that turn raw amplitudes into the quantity, (lines, channels): e^{jωτ} / (sign · gain).

    What is unknown stays in.  Raises DataError for a gain or sign of zero.
    """
    h = np.ones((len(frequency_hz), len(channels)), dtype=complex)
    for i, channel in enumerate(channels):
        h[:, i] /= real_factor(channel)
        if channel.delay is not None and channel.delay != 0:
            h[:, i] *= np.exp(2j * np.pi * frequency_hz * channel.delay)
    return h


def calibrated(
    channels: Sequence[Channel], frequency_hz: Real, X: Complex, V: Complex
) -> tuple[Complex, Complex]:
    """Amplitudes (lines, channels) and their covariance (lines, channels, channels) with what is known taken out."""
    h = calibration(channels, frequency_hz)
    return X * h, V * h[:, :, None] * np.conj(h)[:, None, :]


def real_factor(channel: Channel) -> float:
    """Known sign · gain.  Raises DataError where it is 0 or not finite."""
    factor = channel.factor
    if factor == 0 or not np.isfinite(factor):
        raise DataError(
            f"channel {channel.name} has gain · sign = {factor:g}", cure="give a factor other than zero"
        )
    return factor
