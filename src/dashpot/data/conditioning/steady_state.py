"""The part of a dwell that is driven and where the transient has decayed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.period_blocks import period_blocks
from dashpot.data.conditioning.regression import duration
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.notices import Notice

SIGNIFICANT = 0.01
HEARD = 6.0  # sd of a block's amplitude that a channel must have to say whether it is driven


@dataclass(frozen=True)
class Settled:
    """The part of a dwell that is driven and where the transient has decayed, and what was thrown away around it.

    `note` says so in words; it is None where nothing was thrown away and a transient would have been seen.
    """

    record: Record
    dropped_samples: int
    dropped_s: float
    note: Notice | None


def settled(record: Record, frequency_hz: float | None = None) -> Settled:
    """The part of a dwell that is driven, after its transient.

    Blocks of whole periods, counted from the end, give amplitudes and residuals.  The longest run of blocks with more
    than half of the greatest lasting amplitude is what was driven.  Within it the cut is where the mean of what
    remains is known best (White's marginal standard error rule, Simulation 69, 1997), at most half way, and only if
    what comes before it differs significantly (p < 0.01) from what comes after.  A small error of the frequency does
    not matter.  Raises DataError where the frequency is not known.
    """
    f = record.frequency_hz if frequency_hz is None else frequency_hz
    if f is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    time = record.time
    blocks = period_blocks(record, f)
    if blocks is None:
        periods = int(f * duration(time) + 1e-6)
        text = (
            f"{record.source}: {periods} periods at {f:g} Hz are too few to detect a transient, or have gaps"
        )
        return Settled(record, 0, 0.0, Notice("transient_undetectable", text, (record.source,)))
    starts, Z, rms = blocks.starts, blocks.amplitudes, blocks.rms
    begin, end = _driven(Z)
    if end - begin >= 8:
        begin += _truncation(_features(Z[begin:end], rms[begin:end], float(np.max(np.abs(record.values)))))
    first = 0 if begin == 0 else int(starts[begin])
    last = len(time) if end == len(starts) else int(starts[end])
    dropped = len(time) - (last - first)
    if not dropped:
        return Settled(record, 0, 0.0, None)
    kept = replace(record, time=time[first:last], values=record.values[..., first:last, :])
    what = [f"the first {time[first] - time[0]:.4g} s"] * (first > 0) + [
        f"the last {time[-1] - time[last - 1]:.4g} s"
    ] * (last < len(time))
    whole = float(time[-1] - time[0])
    text = f"{record.source}: discarded {' and '.join(what)} of {whole:.4g} s at {f:g} Hz (transient)"
    note = Notice("transient_discarded", text, (record.source,))
    return Settled(kept, dropped, float(time[-1] - time[0] - (kept.time[-1] - kept.time[0])), note)


def without_start(record: Record, seconds: float) -> Record:
    """The record without its first seconds.  Raises DataError where less than two samples are left."""
    first = int(np.searchsorted(record.time, record.time[0] + seconds))
    if len(record.time) - first < 2:
        length = float(record.time[-1] - record.time[0])
        raise DataError(
            f"the record is {length:.4g} s long and its first {seconds:g} s are to be dropped",
            record.source,
            "drop less, or record longer",
        )
    return replace(record, time=record.time[first:], values=record.values[..., first:, :])


def periods_of(record: Record) -> float:
    """Periods of the drive that a record lasts; 0 without a frequency."""
    return 0.0 if record.frequency_hz is None else record.frequency_hz * duration(record.time)


def driven_throughout(record: Record) -> bool:
    """Whether a dwell moves from its first period to its last; True where it has too few periods to tell."""
    f = record.frequency_hz
    if f is None or record.values.ndim != 2:
        return True
    blocks = period_blocks(record, f)
    if blocks is None:
        return True
    Z = blocks.amplitudes
    noise = np.median(blocks.rms, axis=0) * np.sqrt(4 / np.min(blocks.ends - blocks.starts))
    heard = _level(np.abs(Z)) > HEARD * noise
    return not np.any(heard) or _driven(Z[:, heard]) == (0, len(Z))


def _driven(Z: Complex) -> tuple[int, int]:
    """Longest run of driven blocks, [begin, end); those in which the drive comes or goes are left out.

    A channel's level is the greatest that it keeps for four blocks.
    """
    size = np.abs(Z)
    level = _level(size)
    on = np.ones(len(Z), dtype=bool)
    if np.any(level > 0):
        on = np.median(size[:, level > 0] / level[level > 0], axis=1) > 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    runs = edges.reshape(-1, 2)
    begin, end = (int(k) for k in runs[np.argmax(runs[:, 1] - runs[:, 0])])
    if end - begin < 4:
        return 0, len(Z)
    return begin + (begin > 0), end - (end < len(Z))


def _level(size: Real) -> Real:
    """The greatest amplitude that each channel keeps for four blocks, (channels,), of (blocks, channels)."""
    level: Real = np.max(np.min(np.lib.stride_tricks.sliding_window_view(size, 4, axis=0), axis=-1), axis=0)
    return level


def _features(Z: Complex, rms: Real, largest: float) -> Real:
    """(blocks, features) in units of their scatter over the last half: amplitudes turned by the phase of the steadiest
    channel, which makes them blind to a small error of the frequency, and residual rms."""
    tail = len(Z) // 2
    size = np.median(np.abs(Z), axis=0)
    floor = np.maximum(1e-9 * size, 1e-13 * largest) + np.finfo(float).tiny
    steady = int(np.argmax(size / np.maximum(np.std(np.abs(Z[tail:]), axis=0), floor)))
    turned = Z * np.exp(-1j * np.angle(Z[:, steady]))[:, None]
    values = np.concatenate([turned.real, turned.imag, rms], axis=1)
    scatter = np.maximum(np.std(values[tail:], axis=0, ddof=1), np.tile(floor, 3))
    normal: Real = (values - np.mean(values[tail:], axis=0)) / scatter
    return normal


def _truncation(features: Real) -> int:
    """Number of blocks to drop."""
    blocks, width = features.shape
    score = []
    for cut in range(blocks // 2 + 1):
        rest = features[cut:]
        spread = np.sum((rest - np.mean(rest, axis=0)) ** 2) + len(rest) * 1e-3 * width
        score.append(spread / len(rest) ** 2)
    cut = int(np.argmin(score))
    if cut == 0:
        return 0
    before, rest = features[:cut], features[cut:]
    free = len(rest) - 1
    spread = np.sum((rest - np.mean(rest, axis=0)) ** 2, axis=0) + free * 1e-3
    F = np.sum((before - np.mean(rest, axis=0)) ** 2, axis=0) / cut / (spread / free)
    p = fdtrc(cut, free, F / (1 + 1 / len(rest)))
    return cut if float(np.min(p)) * width < SIGNIFICANT else 0
