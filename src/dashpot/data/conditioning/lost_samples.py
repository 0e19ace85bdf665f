"""Samples of a dwell that stand at the limit of a channel's range, where the motion goes on beyond it.

What the motion was there is told by the sine that the other samples around follow: where it lies beyond the limit for
most of the clipped samples, these are replaced by it, with the noise of the others, so that the dwell stays even.  They
tell nothing, so that amplitudes scatter as those of the other samples alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import fdtrc

from dashpot.arrays import Bools, Ints, Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.regression import duration
from dashpot.data.record import Record, at_limits
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

REACH = 3.0  # periods on either side of one with clipped samples that show the motion
NEAR = 2.5  # deviations of the noise from a limit within which it decides whether a sample is clipped
MOSTLY = 0.7  # of the clipped samples at a limit, beyond which the motion has to lie there: others rest at it
DIFFERENT = 0.9  # of the other samples, all of different values: then two alike at a limit are no chance
ALIKE = 3  # samples at a limit of a channel of which no two others are alike
DEPTH = 1e-3  # of a channel's range, beyond its limit: less is no matter
FREEDOM = 8  # samples that there must be around a run beside the parameters of the sine
ORDERS = 2  # multiples of the drive in the motion around a run
FEW = 2.0  # periods, in which a transient under a clipped sine is not to be told from it
MOST_BENDS = 6  # degree of the polynomials that amplitude and phase of a sine that is not steady may follow
LEVEL = 1e-3  # of the tests for it
MOST = 0.6  # of a channel's samples: of one that clips more the rest says too little


@dataclass(frozen=True)
class Unclipped:
    """A dwell with its clipped samples put right.

    weaker  (channels,)  times what the variance of an amplitude would be were no sample clipped
    """

    record: Record
    weaker: Real
    notices: list[Notice]


def reaches_limits(record: Record) -> bool:
    """Whether any channel of a dwell stands at what may be the limit of its range."""
    return record.values.ndim == 2 and any(np.any(_limits(column)) for column in record.values.T)


def without_clipping(record: Record, stated_hz: float | None = None) -> Unclipped:
    """The dwell as its channels would be with a wider range, and a notice of each channel that clips.

    stated_hz: the frequency by which the dwell is called, where that is not the one at which it moves.  Repeats
    (leading axes) and records without a frequency stay as they are.
    """
    weaker = np.ones(len(record.channels))
    if record.values.ndim != 2 or record.frequency_hz is None:
        return Unclipped(record, weaker, [])
    values, notices = None, []
    for c, channel in enumerate(record.channels):
        limits = _limits(record.values[:, c])
        clipped = np.any(limits, axis=0)
        if not np.any(clipped) or np.mean(clipped) > MOST:
            continue
        mended = _mended(record, record.values[:, c], limits)
        if mended is None:
            continue
        column, replaced = mended
        values = np.array(record.values) if values is None else values
        values[:, c] = column
        # The greatest variance of the fundamental from the samples that are not replaced, over that from all.
        # With what the noise adds that is put in with those that are.
        basis = _basis(record)
        all_of_them, some = (np.linalg.inv(rows.T @ rows)[2:4, 2:4] for rows in (basis, basis[~replaced]))
        ratio = np.max(np.linalg.eigvalsh(some)) / np.max(np.linalg.eigvalsh(all_of_them))
        weaker[c] = float(ratio + np.mean(replaced))
        label = record.frequency_hz if stated_hz is None else stated_hz
        text = f"{channel.name} clips in the dwell at {label:g} Hz"
        told = f"{text} ({counted(int(np.sum(clipped)), 'sample')}): the other samples are used"
        notices.append(Notice("unclipped", told, (channel.name,)))
    return Unclipped(record if values is None else replace(record, values=values), weaker, notices)


def notices_of_doubt(dwells: Sequence[Record], weaker: Sequence[Real]) -> list[Notice]:
    """Of dwells that are no steady sines: notices of channels that clip in so few periods that nothing tells of what.

    weaker (channels,) of each dwell, beyond 1 where samples have been put in.
    """
    brief = {
        record.channels[c].name: None
        for record, times in zip(dwells, weaker, strict=True)
        if duration(record.time) * (record.frequency_hz or 0.0) < FEW
        for c in np.flatnonzero(times > 1)
    }
    return [
        Notice(
            "clipped_in_doubt",
            f"{name} clips in dwells of less than two periods that are no steady sines: nothing tells what the motion "
            "was there, and values may be off by more than their intervals say",
            (name,),
        )
        for name in brief
    ]


def _limits(column: Real) -> Bools:
    """Which samples are at the greatest value, and which at the least, where those are limits: (2, samples).

    Where values come again elsewhere, as those of a coarse converter and of a sine in step with the sampling do, three
    have to follow each other, and to be many more than those at the next value.  Where no two others are alike, three
    alike are a limit, and at the other end of a channel that has one two are.
    """
    ends = np.stack([column == np.max(column), column == np.min(column)])
    others = column[~np.any(ends, axis=0)]
    if not len(others) or np.ptp(column) == 0:
        return at_limits(column)
    different = len(np.unique(np.round(others / np.ptp(column), 9)))  # but for rounding
    if different <= DIFFERENT * len(others):
        return at_limits(column)
    counts = np.count_nonzero(ends, axis=1)
    limited: Bools = (counts >= ALIKE) | ((counts >= 2) & (np.max(counts) >= ALIKE))
    return np.asarray(ends & limited[:, None])


def _mended(record: Record, column: Real, limits: Bools) -> tuple[Real, Bools] | None:
    """A channel (samples,) with what may be clipped put right, and which samples that are; None where the motion does
    not go beyond the limits.

    limits (2, samples): which samples stand at the greatest value, and which at the least.  Of samples near a limit
    those are left whose noise keeps them from it: all of them are taken by what the motion is there, not by how they
    read.
    """
    clipped = np.any(limits, axis=0)
    basis = _basis(record)
    clear = DEPTH * float(
        np.ptp(column)
    )  # a sine in step with the sampling has its greatest value in each period
    span = tuple(
        float(column[np.argmax(at)]) if np.any(at) else end
        for at, end in zip(limits, (np.inf, -np.inf), strict=True)
    )
    mended, replaced, beyond = (
        np.array(column),
        np.zeros(len(column), dtype=bool),
        np.zeros(len(column), bool),
    )
    for around, begin, end in _windows(record, clipped):
        rows = basis[around]
        first = _fitted(rows, column[around], ~clipped[around])
        if first is None:
            return None
        motion, noise = first
        sigma = float(np.sqrt(np.mean(noise**2)))
        inside = (motion < span[0] - NEAR * sigma) & (motion > span[1] + NEAR * sigma)
        second = _fitted(rows, column[around], inside)
        if second is None:
            return None
        motion, noise = second
        near = around[(motion >= span[0] - NEAR * sigma) | (motion <= span[1] + NEAR * sigma)]
        near = np.union1d(near[(near >= begin) & (near < end)], np.flatnonzero(clipped[begin:end]) + begin)
        mended[near] = motion[near - around[0]] + np.resize(noise, len(near))
        replaced[near] = True
        there = motion[near - around[0]]
        beyond[near] = (there > span[0] + clear) | (there < span[1] - clear)
    return (mended, replaced) if np.mean(beyond[clipped]) > MOSTLY else None


def _windows(record: Record, clipped: Bools) -> Iterator[tuple[Ints, int, int]]:
    """Samples around each period with clipped ones, and its begin and end."""
    step = (record.time[-1] - record.time[0]) / (len(record.time) - 1)
    assert record.frequency_hz is not None
    period = max(round(1 / (record.frequency_hz * step)), 1)
    reach = int(np.ceil(REACH * period))
    for begin in range(0, len(clipped), period):
        end = min(begin + period, len(clipped))
        if np.any(clipped[begin:end]):
            yield np.arange(max(begin - reach, 0), min(end + reach, len(clipped))), begin, end


def _fitted(rows: Real, values: Real, used: Bools) -> tuple[Real, Real] | None:
    """The motion at all rows by those used, and what it leaves of these; None where they are too few.

    A steady sine, or where that explains less than noise would let it, one whose amplitude and phase may run.
    """
    free = int(np.count_nonzero(used)) - rows.shape[1]
    if free < FREEDOM:
        return None
    motion, rest = _least_squares(rows, values, used)
    for degree in range(1, MOST_BENDS + 1):
        # The basis with another polynomial, and the sine of the drive times one
        shape = legvander(np.linspace(-1.0, 1.0, len(rows)), degree + 1)
        bent = np.concatenate(
            [rows, shape[:, degree + 1 :], rows[:, 2:4] * shape[:, degree : degree + 1]], axis=1
        )
        more = bent.shape[1] - rows.shape[1]
        if free - more < FREEDOM:
            break
        other, less = _least_squares(bent, values, used)
        before, after = float(np.sum(rest**2)), float(np.sum(less**2))
        if (
            fdtrc(more, free - more, max(before - after, 0.0) / more / max(after / (free - more), 1e-300))
            < LEVEL
        ):
            motion, rest, rows, free = other, less, bent, free - more
    return motion, rest


def _least_squares(rows: Real, values: Real, used: Bools) -> tuple[Real, Real]:
    motion: Real = rows @ np.linalg.lstsq(rows[used], values[used], rcond=None)[0]
    return motion, values[used] - motion[used]


def _basis(record: Record) -> Real:
    """An offset, a slope and sines of the drive, (samples, parameters)."""
    assert record.frequency_hz is not None
    turn = 2 * np.pi * record.frequency_hz * (record.time - record.time[0])
    sines = [wave(order * turn) for order in range(1, ORDERS + 1) for wave in (np.cos, np.sin)]
    line = np.linspace(-1.0, 1.0, len(turn))
    return np.stack([np.ones(len(turn)), line, *sines], axis=1)


# Samples of a dwell that a channel missed: it holds a value, or reads 0, while the motion goes on.
#
# Such a run has the very same number in every sample, and departs from the sine that the samples around it
# follow. What a coarse converter repeats near a turning point departs by no more than a step, and what
# rests at the greatest or least value is clipped: both stay as they are. A run is replaced by the sine
# around it with the noise of the samples before it, so that the dwell stays even and its amplitudes are
# those of the other samples.


SHORTEST = 3  # samples of a run
AROUND = 1.0  # periods on either side that show the motion
BEYOND = 4.0  # times the scatter around a run that it departs from the sine
MOST_DROPOUTS = 0.1  # of a channel's samples: a channel that misses more is at fault throughout
PER_PERIOD = 0.5  # runs at the most: a mass that sticks rests twice in each period


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
        mended = _mended_dropouts(record, c)
        if mended is None:
            continue
        column, samples = mended
        values = np.array(record.values) if values is None else values
        values[:, c] = column
        name = record.channels[c].name
        text = f"{name} misses {counted(samples, 'sample')} of the dwell at {record.frequency_hz:g} Hz"
        notices.append(Notice("dropouts", f"{text} (held or 0): the other samples are used", (name,)))
    return (record if values is None else replace(record, values=values)), notices


def _mended_dropouts(record: Record, c: int) -> tuple[Real, int] | None:
    """A channel (samples,) with its missed samples put right, and how many; None where it misses none."""
    column = record.values[:, c]
    runs = list(runs_of_one_value(column, SHORTEST))
    step = (record.time[-1] - record.time[0]) / (len(column) - 1)
    assert record.frequency_hz is not None
    periods = len(column) * step * record.frequency_hz
    reach = int(np.ceil(AROUND / (record.frequency_hz * step)))
    if sum(end - begin for begin, end in runs) > MOST_DROPOUTS * len(column):
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


# Samples of a whole record in which a channel holds one value, or reads 0, while the motion goes on.
#
# The record is cut there, as it is where samples are missing: what is on either side is used as a record of
# its own.


SHORTEST_HELD_SAMPLES = 10  # samples of a run
AROUND_HELD_SAMPLES = 20  # samples on either side that show how the channel moves
RESOLVED = 4.0  # steps of the converter from sample to sample, in rms, of a motion that does not stand still by chance
MOST_RUNS = 5  # in one channel: what rests more often does so for a reason
MOST_HELD_SAMPLES = (
    0.1  # of a channel's samples, or those at one value: a channel that rests more is at rest there
)
SIDES = 64  # samples of a part that is used


def without_held_samples(record: Record) -> tuple[list[Record], tuple[Notice, ...]]:
    """The parts of a record before, between and behind the runs in which channels hold a value, and a note of them.

    Channels of forces are left alone: a drive may hold its value.  Repeats (leading axes) stay as they are.
    """
    if record.values.ndim != 2:
        return [record], ()
    held = np.zeros(len(record.time), dtype=bool)
    names = []
    still = record.values[1:] == record.values[:-1]
    suspect = np.any(still[1:] & still[:-1], axis=0)
    for c, channel in enumerate(record.channels):
        if channel.quantity is Quantity.FORCE or not suspect[c]:
            continue
        runs = _runs_held(record.values[:, c])
        if runs:
            names.append(channel.name)
        for begin, end in runs:
            held[begin:end] = True
    edges = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
    parts = [
        replace(record, time=record.time[a:b], values=record.values[a:b])
        for a, b in pairwise(edges)
        if not held[a] and b - a >= SIDES
    ]
    if not names or not parts:
        return [record], ()
    at = record.time[int(np.argmax(held))]
    text = (
        f"{record.source}: {joined(names)} hold{'s' if len(names) == 1 else ''} a value in {int(np.sum(held))} "
        f"samples, first at {at:.6g} s, while the motion goes on: used as {counted(len(parts), 'record')}"
    )
    return parts, (Notice("held_samples", text, tuple(names)),)


def _runs_held(column: Real) -> list[tuple[int, int]]:
    """Begin and end of each run of one value (samples,) that the motion around it does not explain."""
    runs = list(runs_of_one_value(column, SHORTEST_HELD_SAMPLES))
    values, counts = np.unique(column, return_counts=True)
    resting = values[counts > MOST_HELD_SAMPLES * len(column)]
    if not 0 < len(runs) <= MOST_RUNS or sum(end - begin for begin, end in runs) > MOST_HELD_SAMPLES * len(
        column
    ):
        return []
    if len(resting) or len(values) < 2:
        return []
    step = float(np.min(np.diff(values)))
    inside = (np.array([r[0] for r in runs]) > 0) & (np.array([r[1] for r in runs]) < len(column))
    return [run for run, within in zip(runs, inside, strict=True) if within and _lost(column, *run, step)]


def _lost(column: Real, begin: int, end: int, step: float) -> bool:
    """Whether the channel moves around a run, by more than the steps of its converter hide, as it does not in it."""
    sides = (
        np.diff(column[max(begin - AROUND_HELD_SAMPLES, 0) : begin]),
        np.diff(column[end : end + AROUND_HELD_SAMPLES]),
    )
    usual = min(float(np.sqrt(np.mean(part**2))) if len(part) else 0.0 for part in sides)
    limit = column[begin] in (column.min(), column.max())
    return not limit and usual > RESOLVED * step
