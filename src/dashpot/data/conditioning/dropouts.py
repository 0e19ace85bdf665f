"""Samples of a dwell that a channel missed: it holds a value, or reads 0, while the motion goes on.

Such a run has the very same number in every sample, and departs from the sine that the samples around it follow.  What
a coarse converter repeats near a turning point departs by no more than a step, and what rests at the greatest or least
value is clipped: both stay as they are.  A run is replaced by the sine around it with the noise of the samples before
it, so that the dwell stays even and its amplitudes are those of the other samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.io.words import counted
from dashpot.notices import Notice

SHORTEST = 3  # samples of a run
AROUND = 1.0  # periods on either side that show the motion
FREEDOM = 8  # samples that there must be around a run beside the parameters of the sine
BEYOND = 4.0  # times the scatter around a run that it departs from the sine
MOST = 0.1  # of a channel's samples: a channel that misses more is at fault throughout
PER_PERIOD = 0.5  # runs at the most: a mass that sticks rests twice in each period
ORDERS = 2  # multiples of the drive in the motion around a run


def without_dropouts(record: Record) -> tuple[Record, list[Notice]]:
    """The dwell with the samples that a channel missed put right, and a notice of each such channel.

    Repeats (leading axes) and records without a frequency stay as they are.
    """
    if record.values.ndim != 2 or record.frequency_hz is None:
        return record, []
    still = record.values[1:] == record.values[:-1]
    # Two equal neighbours in a row anywhere: nearly no record has any, which spares it the rest.
    suspect = np.flatnonzero(np.any(still[1:] & still[:-1], axis=0))
    values, notices = None, []
    for c in suspect.tolist():
        mended = _mended(record, c)
        if mended is None:
            continue
        column, samples = mended
        values = np.array(record.values) if values is None else values
        values[:, c] = column
        name = record.channels[c].name
        text = f"{name} misses {counted(samples, 'sample')} of the dwell at {record.frequency_hz:g} Hz"
        notices.append(Notice("dropouts", f"{text} (held or 0): the other samples are used", (name,)))
    return (record if values is None else replace(record, values=values)), notices


def _mended(record: Record, c: int) -> tuple[Real, int] | None:
    """A channel (samples,) with its missed samples put right, and how many; None where it misses none."""
    column = record.values[:, c]
    runs = list(runs_of_one_value(column, SHORTEST))
    step = (record.time[-1] - record.time[0]) / (len(column) - 1)
    assert record.frequency_hz is not None
    periods = len(column) * step * record.frequency_hz
    reach = int(np.ceil(AROUND / (record.frequency_hz * step)))
    if sum(end - begin for begin, end in runs) > MOST * len(column):
        return None
    mended, count, samples = np.array(column), 0, 0
    for begin, end in runs:
        around = _motion_around(record, mended, begin, end, reach)
        if around is None:
            continue
        expected, noise, scatter = around
        if _clipped(column, begin, float(np.mean(expected))):
            continue
        if np.sqrt(np.mean((column[begin:end] - expected) ** 2)) > BEYOND * scatter:
            mended[begin:end] = expected + noise
            count, samples = count + 1, samples + end - begin
    return (mended, samples) if 0 < count <= max(1.0, PER_PERIOD * periods) else None


def runs_of_one_value(column: Real, shortest: int) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of one number in a channel (samples,), of so many samples at the least."""
    edges = np.flatnonzero(np.diff(column) != 0) + 1
    begin, end = np.append(0, edges), np.append(edges, len(column))
    long = end - begin >= shortest
    yield from zip(begin[long].tolist(), end[long].tolist(), strict=True)


def _clipped(column: Real, begin: int, expected: float) -> bool:
    """Whether a run rests at the greatest or least value of its channel where the motion goes beyond it."""
    value = column[begin]
    return bool((value == column.max() and expected > value) or (value == column.min() and expected < value))


def _motion_around(
    record: Record, column: Real, begin: int, end: int, reach: int
) -> tuple[Real, Real, float] | None:
    """What the samples around a run say of it: motion and noise (end − begin,), and their scatter; None if too few."""
    first = max(begin - reach, 0)
    rows = np.arange(first, min(end + reach, len(column)))
    outside = (rows < begin) | (rows >= end)
    assert record.frequency_hz is not None
    turn = 2 * np.pi * record.frequency_hz * (record.time[rows] - record.time[begin])
    sines = [wave(order * turn) for order in range(1, ORDERS + 1) for wave in (np.cos, np.sin)]
    basis = np.stack([np.ones(len(rows)), *sines], axis=1)
    freedom = int(np.count_nonzero(outside)) - basis.shape[1]
    if freedom < FREEDOM:
        return None
    fitted = basis @ np.linalg.lstsq(basis[outside], column[rows[outside]], rcond=None)[0]
    left = column[rows[outside]] - fitted[outside]
    noise = np.resize(left, end - begin)
    return fitted[~outside], noise, float(np.sqrt(np.sum(left**2) / freedom))
