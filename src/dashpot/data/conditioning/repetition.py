"""Continuous records of a periodic drive: their period is found, and their periods are averaged.

A multisine or a periodic random drive that repeats puts all its power on the multiples of one frequency.  What the rest
of the lines hold is noise, and its size at each multiple is the scatter of the periods.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.periods import average_periods
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.notices import Notice

REPEATS = 0.5  # correlation of every channel's steps with those a period later: the rest is noise
LASTING = 0.97  # of it, between periods that are further apart
FEWEST_PERIODS = 6
FEWEST_LINES = 12  # in every channel: fewer are a sine, a decay or their harmonics
FUNDAMENTAL = 0.3  # of the strongest line: what a dwell has in every channel
SHORTEST = 32  # samples of a period
SIGNIFICANT = 1e-3
APART = 16.0  # times the scatter of the last half by which the mean square of a period that has not settled is off


def averaged_periods(record: Record) -> Spectrum | None:
    """The mean of the settled periods of a record that repeats, on the lines that every channel shows; else None.

    A record of a stated frequency that moves at that frequency is a dwell, and no such record.
    """
    samples = _period(record)
    if samples is None:
        return None
    step = float(record.time[-1] - record.time[0]) / (len(record.time) - 1)
    count = len(record.time) // samples
    periods = record.values[: count * samples].reshape(count, samples, -1)
    X = fft.rfft(periods, axis=1)[:, 1 : samples // 2]
    skip = _unsettled(X)
    lines = _driven(X[skip:])
    if len(lines) < FEWEST_LINES or (record.frequency_hz is not None and _is_dwell(X[skip:], lines)):
        return None
    try:
        mean = average_periods(record, samples * step, lines, skip=skip)
    except DataError:
        return None  # its stamps are uneven
    start = f", the first {skip} left out" if skip else ""
    text = (
        f"{record.source}: the record repeats every {samples * step:.6g} s: {len(lines)} lines are means of "
        f"{count - skip} periods{start}"
    )
    return replace(mean, notes=(Notice("periods_averaged", text, (record.source,)),))


def _is_dwell(X: Complex, lines: list[int]) -> bool:
    """Whether all channels move at the fundamental, of (periods, lines, channels)."""
    size = np.abs(np.mean(X, axis=0))
    return lines[0] == 1 and bool(np.all(size[0] > FUNDAMENTAL * np.max(size, axis=0)))


def _period(record: Record) -> int | None:
    """Samples of the period that all channels repeat with to the record's end; None where there is none."""
    n = len(record.time)
    if record.values.ndim != 2 or n < FEWEST_PERIODS * SHORTEST:
        return None
    steps = np.diff(record.values, axis=0)
    steps = steps - np.mean(steps, axis=0)
    power = np.abs(fft.rfft(steps, fft.next_fast_len(2 * n), axis=0)) ** 2
    alike = fft.irfft(power, axis=0)[: n // 2]
    if np.any(alike[0] <= 0):
        return None
    alike = np.min(alike / alike[0], axis=1) * (n / (n - np.arange(len(alike))))
    lags = alike[SHORTEST : n // FEWEST_PERIODS]
    highest = float(np.max(lags, initial=0.0))
    if highest < REPEATS:
        return None
    first = SHORTEST + int(np.flatnonzero(lags > LASTING * highest)[0])
    peak = first + int(np.argmax(alike[first : first + max(2, first // 100)]))
    return peak if bool(np.all(alike[peak::peak] > LASTING * alike[peak])) else None


def _unsettled(X: Complex) -> int:
    """Periods to leave out, of at most the first half, of (periods, lines, channels)."""
    half = len(X) // 2
    last = X[half:]
    variance = np.var(last, axis=0, ddof=1)
    away = np.abs(X[:half] - np.mean(last, axis=0)) ** 2
    varies = variance > 0  # records without noise may repeat exactly
    if not np.any(varies):
        return 0
    off: Real = np.mean(away[:, varies] / variance[varies], axis=1)
    late = np.flatnonzero(off > APART)
    return int(late[-1]) + 1 if len(late) else 0


def _driven(X: Complex) -> list[int]:
    """Multiples of the frequency that all channels show, of (periods, lines, channels)."""
    count = len(X)
    mean = np.mean(X, axis=0)
    variance = np.var(X, axis=0, ddof=1) / count
    with np.errstate(divide="ignore", invalid="ignore"):
        p = fdtrc(2, 2 * (count - 1), np.abs(mean) ** 2 / variance)
    there = np.all(p < SIGNIFICANT / p.size, axis=1)
    return [int(line) + 1 for line in np.flatnonzero(there)]
