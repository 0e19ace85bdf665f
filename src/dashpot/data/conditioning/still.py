"""The noise of all channels as records at rest show it: the best there is, and cheap in the laboratory (THEORY §8).

A record may bring its own: before an earthquake, between the blows of a hammer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.conditioning.clock import even_step
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.numerics.variance_tests import equal_variances

HALF_WINDOW = 30  # lines on either side over which noise is smoothed
BLOCK = 32  # samples, at least, of the parts of a record that may be at rest
BLOCKS = 256  # parts, at most
IN_A_ROW = 8  # parts, at least: what moves at random is quiet for a part or two as well
QUIETEST = 0.05  # share of the parts that are at rest, if any are
QUIET = 0.1  # of the mean power of all parts: what those at rest have at most
BEYOND = 4.0  # standard deviations of a part's variance, from which on it moves
BY_CHANCE = 1e-3  # p-value below which parts at rest are not alike


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
        return self.power[at] / samples


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


def variance_at_rest(values: Real) -> float:
    """Variance of white noise in the samples of one channel, (samples,), while it is at rest; 0 where it never is.

    At rest are parts of the record in a row that vary alike, without colour, and far less than the others.
    """
    count = min(BLOCKS, len(values) // BLOCK)
    if count < 2 * IN_A_ROW:
        return 0.0
    size = len(values) // count
    parts = values[: count * size].reshape(count, size)
    along = np.linspace(-1.0, 1.0, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    parts = parts - (parts @ along / (along @ along))[:, None] * along
    dof = size - 2
    variance = np.sum(parts**2, axis=1) / dof
    quietest = max(IN_A_ROW, int(QUIETEST * count))
    level, still = float(np.median(np.sort(variance)[:quietest])), np.zeros(count, dtype=bool)
    for _ in range(count):
        before, still = still, _in_rows(variance < level * (1 + BEYOND * (2 / dof) ** 0.5))
        if not np.any(still) or np.array_equal(before, still):
            break
        level = float(np.mean(variance[still]))
    if not np.any(still) or not 0 < level < QUIET * float(np.mean(variance)):
        return 0.0
    steps = float(np.sum(np.diff(parts[still], axis=1) ** 2) / np.sum(parts[still] ** 2))
    white = abs(steps / 2 - 1) < BEYOND / (np.sum(still) * dof) ** 0.5 + 2 / size
    return level if white and equal_variances(variance[still], float(dof)) > BY_CHANCE else 0.0


def _in_rows(still: Bools) -> Bools:
    """Those of the parts (parts,) that are among IN_A_ROW neighbours, the first and last of which may still move."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    inner = np.zeros(len(still), dtype=bool)
    for first, end in edges.reshape(-1, 2).tolist():
        if end - first >= IN_A_ROW:
            inner[first + 1 : end - 1] = True
    return inner


def smoothed(values: Complex, half_window: int) -> Complex:
    """Mean over the nearest 2·half_window + 1 lines (axis 0), fewer lines on one side taken from the other."""
    lines = len(values)
    width = min(2 * half_window + 1, lines)
    sums = np.concatenate([np.zeros((1, *values.shape[1:]), dtype=values.dtype), np.cumsum(values, axis=0)])
    first = np.clip(np.arange(lines) - width // 2, 0, lines - width)
    return (sums[first + width] - sums[first]) / width
