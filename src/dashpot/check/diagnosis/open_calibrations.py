"""Channels whose gain and delay are to be found, and the unknowns at which they are as stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.model.network import Model
from dashpot.model.observation import measures_input


def with_open_calibrations(model: Model, spectrum: Spectrum) -> tuple[tuple[Channel, ...], tuple[str, ...]]:
    """The channels with gain and delay to be found where they have noise, and the names of inputs that have none."""
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    noisy = np.any(variance.reshape(-1, len(spectrum.channels)) > 0, axis=0).tolist()
    channels = tuple(
        replace(channel, gain=None, delay=None) if heard and channel.same_gain_as is None else channel
        for channel, heard in zip(spectrum.channels, noisy, strict=True)
    )
    exact = [
        c.name
        for c, heard in zip(spectrum.channels, noisy, strict=True)
        if not heard and measures_input(model, c)
    ]
    return channels, tuple(exact)


def as_stated(names: Sequence[str], known: Mapping[str, float]) -> Real:
    """ψ (M,) by `names`: what is `known`, the gain 1 and the delay 0 elsewhere, and 0 for what else was added."""
    return np.array([known.get(name, 1.0 if name.endswith(".gain") else 0.0) for name in names])
