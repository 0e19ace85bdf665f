"""The clock of a record: whether its samples are evenly spaced, and where some are missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record, kept
from dashpot.errors import DataError
from dashpot.notices import Notice

GAP = 1.5  # sampling steps between samples from which on there is a gap
UNEVEN = 0.02  # of a sampling step: stamps may be rounded by that much
ROUNDED = 1e-6  # of a sampling step: stamps that are less off are even
FIGURES = range(4, 10)  # that stamps may be written with; files of more are not coarse
FEWEST, FEWEST_OF_A_DWELL = 16, 8  # samples of a record: of one whose frequency is known fewer tell something


def fewest_samples(record: Record) -> int:
    """How many samples a record must have to be used whole."""
    return FEWEST if record.frequency_hz is None else FEWEST_OF_A_DWELL


@kept
def even_step(record: Record) -> float:
    """The sampling step, s.  Raises DataError where the samples are not evenly spaced."""
    time = record.time
    if len(time) < fewest_samples(record):
        raise DataError(
            f"a record of {len(time)} samples",
            record.source,
            f"at least {fewest_samples(record)} samples are needed",
        )
    time = with_even_stamps(record)[0].time
    index, step, away = _line(time)
    if np.max(away) > UNEVEN * step:
        row = int(np.argmax(away)) + 1
        raise DataError(
            f"the samples are not evenly spaced: row {row} is {np.max(away) / step:.3g} steps of {step:.4g} s off",
            record.source,
            "record with a steady clock; resampling adds errors that look like motion",
        )
    rounding = max(float(np.max(away)), 2 * float(np.spacing(np.max(np.abs(time)))))
    return _simplest(time, index, step, 2 * rounding) if rounding <= ROUNDED * step else step


def _line(time: Real) -> tuple[Real, float, Real]:
    """The straight line through the stamps: indices from the middle, its step and how far each stamp is off, s.

    NumPy's sums have the same bits on every processor, those of BLAS do not.
    """
    index: Real = np.arange(len(time), dtype=np.float64) - (len(time) - 1) / 2
    step = float(np.sum(index * (time - time[0])) / np.sum(index * index))
    return index, step, np.abs(time - np.mean(time) - step * index)


def with_even_stamps(record: Record) -> tuple[Record, Notice | None]:
    """The record on an even clock where its stamps are even times rounded to some digit, else as it is.

    Steps of 10 and 20 ms are what 64 samples a second look like in stamps of 10 ms: taken at their word, they are
    noise of the time.  So are stamps of six significant figures, once they are long.  Where steps are 10 ms but for one
    of 20, a sample is missing.  A note says so where the digit is coarse.
    """
    time = record.time
    if len(time) < FEWEST_OF_A_DWELL:
        return record, None
    index, step, off = _line(time)
    away = float(np.max(off))
    if not ROUNDED * step < away < step:
        return record, None
    coarse = away > UNEVEN * step
    fits = [digit for digit in _digits(time) if 0 < away <= (1.02 if coarse else 0.75) * digit]
    if not fits:
        return record, None
    digit = fits[0]
    middle = float(np.mean(time))
    step = _simplest(time - middle, index, step, (1 + 1e-6) * digit)
    steps = np.diff(time)
    if np.min(steps) > (1 - ROUNDED) * step and np.max(steps) > GAP * step:  # rounding shortens steps as well
        return record, None
    even: Real = np.asarray(middle + step * index, dtype=np.float64)
    text = f"time stamps are rounded to {digit:.3g} s; evenly spaced samples, {step:.6g} s apart, are used"
    return replace(record, time=even), record.notice("stamps_rounded", text) if coarse else None


def _digits(time: Real) -> Iterator[float]:
    """The digits that all stamps may be rounded to, s: a fixed one, or that of the largest where figures are fixed."""
    steps = np.diff(time)
    digit = float(np.min(steps[steps > 1e-9 * np.mean(steps)], initial=np.inf))
    digit = float(np.min(np.abs(np.diff(np.unique(np.round(steps, 12)))), initial=digit))
    if digit > 0 and _multiples(steps, digit):
        yield digit
    size = np.abs(time[time != 0])
    decade = np.floor(np.log10(size))
    for figures in FIGURES:
        digits = 10 ** (decade + 1 - figures)
        if np.max(digits) <= np.mean(steps) and _multiples(size, digits):
            yield float(np.max(digits))
            return


def _multiples(values: Real, digit: Real | float) -> bool:
    return bool(np.max(np.abs(values / digit - np.round(values / digit)), initial=0.0) < 1e-3)


def _simplest(time: Real, index: Real, step: float, rounding: float) -> float:
    """The shortest number, as a rate or as a step, whose even times differ from the stamps by their rounding only.

    Loggers run at 64 Hz, not at 64.0008; the line through few stamps is no more accurate.
    """
    for digits in range(1, 16):
        for simple in (1 / float(f"{1 / step:.{digits}g}"), float(f"{step:.{digits}g}")):
            if np.ptp(time - simple * index) <= rounding:
                return simple
    return step


def _rows(record: Record, first: int, last: int) -> Record:
    """The samples from one to before another.  Raises DataError where fewer than two are left."""
    if last - first < 2:
        text = (
            f"fewer than two samples are left: the record is from {record.time[0]:g} to {record.time[-1]:g} s"
        )
        raise DataError(text, record.source, "use more of it, or record longer")
    return record.part(slice(first, last))


def cut(record: Record, start: float, end: float) -> Record:
    """The samples of a record between two shares of its length.  Raises DataError where fewer than two are left."""
    return _rows(record, round(start * len(record.time)), round(end * len(record.time)))


def within_times(record: Record, start: float, end: float) -> Record:
    """The samples of a record from one time to another, s.  Raises DataError where fewer than two are left."""
    first, last = np.searchsorted(record.time, start), np.searchsorted(record.time, end, side="right")
    return _rows(record, int(first), int(last))
