"""The noise that channels are declared to have, for simulation and design."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.model.network import Model
from dashpot.model.observation import measures_input


def noise_sd(channels: Sequence[Channel], Y: Complex) -> Real:
    """Standard deviation of one sample's noise, SI units of the quantity; `Y` (..., lines, channels) amplitudes.

    Absolute and relative part are independent: √((noise · scale / |sign · gain|)² + (relative_noise |Y|)²).
    """
    floor = np.array([channel.noise * channel.scale / abs(channel.factor) for channel in channels])
    relative = np.array([channel.relative_noise for channel in channels])
    sd: Real = np.hypot(floor, relative * np.abs(Y))
    return sd


def with_relative_noise(
    model: Model, channels: Iterable[Channel], level: float, *, drives: bool = False
) -> tuple[Channel, ...]:
    """Channels with noise of sd = level × amplitude of that channel at that frequency and no other (paper eq. 21).

    Channels of the inputs stay as they are unless `drives`.
    """
    return tuple(
        channel
        if measures_input(model, channel) and not drives
        else replace(channel, noise=0.0, relative_noise=level)
        for channel in channels
    )
