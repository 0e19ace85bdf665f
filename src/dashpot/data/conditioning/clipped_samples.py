"""Samples of a dwell that stand at the limit of a channel's range, where the motion goes on beyond it.

What the motion was there is told by the sine that the other samples around follow: where it lies beyond the limit for
most of the clipped samples, these are replaced by it, with the noise of the others, so that the dwell stays even.  They
tell nothing, so that amplitudes scatter as those of the other samples alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import fdtrc

from dashpot.arrays import Bools, Ints, Real
from dashpot.data.clipping import at_limits
from dashpot.data.conditioning.regression import duration
from dashpot.data.record import Record
from dashpot.io.words import counted
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
        weaker[c] = _weaker(record, replaced)
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
        bent = _with_bends(rows, degree)
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


def _with_bends(rows: Real, degree: int) -> Real:
    """The basis with another polynomial, and the sine of the drive times one."""
    shape = legvander(np.linspace(-1.0, 1.0, len(rows)), degree + 1)
    return np.concatenate(
        [rows, shape[:, degree + 1 :], rows[:, 2:4] * shape[:, degree : degree + 1]], axis=1
    )


def _basis(record: Record) -> Real:
    """An offset, a slope and sines of the drive, (samples, parameters)."""
    assert record.frequency_hz is not None
    turn = 2 * np.pi * record.frequency_hz * (record.time - record.time[0])
    sines = [wave(order * turn) for order in range(1, ORDERS + 1) for wave in (np.cos, np.sin)]
    line = np.linspace(-1.0, 1.0, len(turn))
    return np.stack([np.ones(len(turn)), line, *sines], axis=1)


def _weaker(record: Record, replaced: Bools) -> float:
    """The greatest variance of the fundamental from the samples that are not replaced, over that from all.

    With what the noise adds that is put in with those that are.
    """
    basis = _basis(record)
    all_of_them, some = (np.linalg.inv(rows.T @ rows)[2:4, 2:4] for rows in (basis, basis[~replaced]))
    ratio = np.max(np.linalg.eigvalsh(some)) / np.max(np.linalg.eigvalsh(all_of_them))
    return float(ratio + np.mean(replaced))
