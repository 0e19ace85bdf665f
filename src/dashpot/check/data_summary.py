"""What a spectrum or a record holds, channel by channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum


@dataclass(frozen=True)
class ChannelSummary:
    """Amplitudes of one channel in `unit`: smallest, largest, and the median of the noise; NaN where not measured."""

    name: str
    low: float
    high: float
    noise: float
    typical: float
    unit: str

    @property
    def measured(self) -> bool:
        """Whether there is any amplitude of it."""
        return bool(np.isfinite(self.high))


def channel_summaries(spectrum: Spectrum, units: Sequence[str]) -> tuple[ChannelSummary, ...]:
    """Range of |X| over lines and repeats, median amplitude and median sd of each channel; SI units by channel."""
    magnitude, sd = np.abs(spectrum.amplitudes), np.broadcast_to(spectrum.sd(), spectrum.amplitudes.shape)
    summaries = []
    for i, channel in enumerate(spectrum.channels):
        size, noise = magnitude[..., i], sd[..., i]
        finite = np.isfinite(size)
        if not np.any(finite):
            numbers = (np.nan,) * 4
        else:
            shown = size[finite]
            numbers = (np.min(shown), np.max(shown), np.median(noise[finite]), np.median(shown))
        low, high, typical_noise, typical = map(float, numbers)
        summaries.append(ChannelSummary(channel.name, low, high, typical_noise, typical, units[i]))
    return tuple(summaries)


def span_of(record: Record) -> tuple[float, float]:
    """Duration, s, and mean sampling rate, Hz (NaN of a single sample)."""
    duration = float(record.time[-1] - record.time[0])
    return duration, (len(record.time) - 1) / duration if duration > 0 else np.nan
