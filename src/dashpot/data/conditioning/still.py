"""The noise of all channels as records at rest show it: the best there is, and cheap in the laboratory (THEORY §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.clock import even_step
from dashpot.data.record import Record
from dashpot.errors import DataError

HALF_WINDOW = 30  # lines on either side over which noise is smoothed


@dataclass(frozen=True, eq=False)
class Still:
    """The noise of all channels as a record at rest shows it: periodogram of its samples.

    frequency_hz (lines,); power (lines, channels, channels): 2/N of Σ Y Yᴴ smoothed over neighbouring lines, which is
    E[Δ Δᴴ] of peak amplitudes times the number of samples; dof: real degrees of freedom behind each line.
    """

    frequency_hz: Real
    power: Complex
    dof: float

    def covariance(self, frequency_hz: Real, samples: int) -> Complex:
        """V of peak amplitudes of a record of so many samples, (lines, channels, channels)."""
        at = np.searchsorted((self.frequency_hz[1:] + self.frequency_hz[:-1]) / 2, frequency_hz)
        V: Complex = self.power[at] / samples
        return V


def noise_at_rest(records: Sequence[Record], half_window: int = HALF_WINDOW) -> Still:
    """The noise that records with nothing driven show, smoothed over 2·half_window + 1 lines and over the records.

    The longest record gives the lines; raises DataError for uneven samples and records too short.
    """
    longest = max(records, key=lambda record: len(record.time))
    parts = [_periodogram(record, half_window) for record in records]
    grid = parts[[record is longest for record in records].index(True)].frequency_hz
    total = np.zeros((len(grid), len(longest.channels), len(longest.channels)), dtype=np.complex128)
    dof = 0.0
    for part in parts:
        if part.power.shape[1:] != total.shape[1:]:
            raise DataError("the records at rest have different channels", longest.source)
        total += part.dof * part.covariance(grid, 1)
        dof += part.dof
    return Still(grid, total / dof, dof)


def _periodogram(record: Record, half_window: int) -> Still:
    step = even_step(record)
    samples = len(record.time)
    lines = (samples - 1) // 2
    if lines < 2 * half_window + 1:
        raise DataError(
            f"the record at rest has {samples} samples", record.source, f"{4 * half_window + 4} are the least"
        )
    centred = record.values - record.values.mean(axis=0)
    Y = fft.rfft(centred, axis=0)[1 : lines + 1] * (2 / samples)
    frequency = np.arange(1, lines + 1) / (samples * step)
    power = smoothed(np.einsum("lc,ld->lcd", Y, np.conj(Y)), half_window) * samples
    return Still(frequency, power, 2.0 * (2 * half_window + 1))


def smoothed(values: Complex, half_window: int) -> Complex:
    """Mean over the nearest 2·half_window + 1 lines (axis 0), fewer lines on one side taken from the other."""
    lines = len(values)
    width = min(2 * half_window + 1, lines)
    sums = np.concatenate([np.zeros((1, *values.shape[1:]), dtype=values.dtype), np.cumsum(values, axis=0)])
    first = np.clip(np.arange(lines) - width // 2, 0, lines - width)
    mean: Complex = (sums[first + width] - sums[first]) / width
    return mean
