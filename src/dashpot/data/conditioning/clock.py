"""The clock of a record: whether its samples are evenly spaced, and where some are missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.errors import DataError

UNEVEN = 0.02  # of a sampling step: stamps may be rounded by that much
FEWEST = 16  # samples of a record


def even_step(record: Record) -> float:
    """The sampling step, s.  Raises DataError where the samples are not evenly spaced."""
    time = record.time
    if len(time) < FEWEST:
        raise DataError(
            f"a record of {len(time)} samples",
            record.source,
            f"{FEWEST} samples are the least that can be used",
        )
    index = np.arange(len(time)) - (len(time) - 1) / 2
    step = float(index @ (time - time[0]) / (index @ index))
    away = np.abs(time - np.mean(time) - step * index)
    # Rounded stamps stay within a digit of the line through all of them, however long the record is.
    if np.max(away) > max(UNEVEN * step, 1.01 * _digit(time)):
        row = int(np.argmax(away)) + 1
        raise DataError(
            f"the samples are not evenly spaced: row {row} is {np.max(away) / step:.3g} steps of {step:.4g} s off",
            record.source,
            "record with a steady clock; a resampled record would have errors that nobody can tell from motion",
        )
    return step


def _digit(time: Real) -> float:
    """The last digit that the stamps are written with, s; at most a quarter of the step."""
    steps = np.diff(time[: min(len(time), 1000)])
    usual = float(np.median(steps))
    for digits in range(13):
        if np.all(np.abs(steps - np.round(steps, digits)) < 1e-4 * usual):
            return min(10.0**-digits, usual / 4)
    return 0.0


def cut(record: Record, start: float, end: float) -> Record:
    """The samples of a record between two shares of its length.  Raises DataError where fewer than two are left."""
    first, last = round(start * len(record.time)), round(end * len(record.time))
    if last - first < 2:
        raise DataError(
            f"{100 * (end - start):.3g} % of {len(record.time)} samples is no record",
            record.source,
            "take more of it",
        )
    return replace(record, time=record.time[first:last], values=record.values[..., first:last, :])
