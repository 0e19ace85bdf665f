"""Samples that are not measured: clipped at the limit of a channel's range, held, 0 or a spike where it missed them.

In a dwell they are marked (`Record.status`): of clipped samples a regression then knows that the signal is beyond them,
of missing ones nothing.  Which they are is told by the motion around them.  In dwells with transients they are
unknowns in the lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Ints, Real
from dashpot.data.conditioning.drive_frequency import at_frequencies, drive_frequencies
from dashpot.data.conditioning.harmonic_fit import rounding_steps
from dashpot.data.conditioning.regression import Terms, in_between, solve_harmonics, window
from dashpot.data.record import ABOVE, BELOW, MISSING, Record, limits, runs_of_one_value
from dashpot.errors import DataError
from dashpot.io.words import counted
from dashpot.notices import Notice

DEPTH = 1e-3  # of a channel's range, by which the motion goes beyond a limit in the mean: less is no matter
MOST = 0.6  # of a channel's samples: of one that clips more the rest says too little
BEYOND = 4.0  # times the scatter of the motion around a run of one value by which that departs from it
SPIKE = 10.0  # times that scatter by which a single sample does
MOST_MISSING = 0.1  # of a channel's samples: a channel that misses more is at fault throughout
PER_PERIOD = 0.5  # runs at the most: a mass that sticks rests twice in each period
FREEDOM = 8  # samples that there must be around beside the parameters of the motion
MOST_BENDS = 6  # degree of the polynomials that amplitude and phase of a sine that is not steady may follow
LEVEL = 1e-3  # of the tests for it


def marked(dwells: Sequence[Record]) -> tuple[list[Record], list[Notice]]:
    """The dwells with their samples marked that channels clip or miss, and a notice of each such channel.

    Repeats (leading axes) are taken as measured.
    """
    notices: list[Notice] = []
    with_missing = [_with_missing(record, notices) for record in dwells]
    if not any(np.any(limits(column)) for r in dwells if r.values.ndim == 2 for column in r.values.T):
        return with_missing, notices
    # The motion around clipped samples is that of the drive's own frequency, which they hide but little.
    perhaps = [_perhaps_clipped(record) for record in with_missing]
    at_their_own = at_frequencies(perhaps, drive_frequencies(perhaps))
    return [
        _with_clipped(own, record, notices) for own, record in zip(at_their_own, with_missing, strict=True)
    ], notices


def _with_missing(record: Record, notices: list[Notice]) -> Record:
    """The dwell with those runs of one value, and single samples, marked that depart from the motion around them.

    What a coarse converter repeats near a turning point departs by no more than a step, and what rests at the greatest
    or least value is clipped.
    """
    if record.values.ndim != 2 or record.frequency_hz is None:
        return record
    still = record.values[1:] == record.values[:-1]
    # Two equal neighbours in a row anywhere: nearly no record has any, which spares it the rest.
    held = np.any(still[1:] & still[:-1], axis=0)
    most = max(1.0, PER_PERIOD * _periods(record))
    status = np.zeros(record.values.shape, dtype=np.int64)
    for c, column in enumerate(record.values.T):
        runs = list(runs_of_one_value(column, 3)) if held[c] else []
        spikes = [at for at in _spikes(column) if not any(begin <= at < end for begin, end in runs)]
        runs += [(at, at + 1) for at in spikes] if len(spikes) <= most else []
        if not runs:
            continue
        trial = np.zeros(len(column), dtype=np.int64)
        for begin, end in runs:
            trial[begin:end] = MISSING
        if np.count_nonzero(trial) > MOST_MISSING * len(column):
            continue
        motion, scatter = _motion_there(record, c, trial)
        step, missed = rounding_steps([record])[c], []
        for begin, end in runs:
            away = np.abs(column[begin:end] - motion[begin:end])
            value, expected = column[begin], float(np.mean(motion[begin:end]))
            limit = (value == column.max() and expected > value) or (
                value == column.min() and expected < value
            )
            times = BEYOND if end > begin + 1 else SPIKE
            far = np.sqrt(np.mean(away**2)) > times * np.mean(scatter[begin:end]) and np.max(away) > step
            if far and not limit:
                missed.append((begin, end))
        if 0 < len(missed) <= most:
            for begin, end in missed:
                status[begin:end, c] = MISSING
            name, count = record.channels[c].name, sum(end - begin for begin, end in missed)
            text = f"{name} misses {counted(count, 'sample')} of the dwell at {record.frequency_hz:g} Hz"
            notices.append(
                Notice("dropouts", f"{text} (held, 0 or a spike): the other samples are used", (name,))
            )
    return replace(record, status=status) if np.any(status) else record


def _spikes(column: Real) -> list[int]:
    """Samples that depart from the line between their neighbours far more than samples usually do."""
    away = np.abs(column[1:-1] - (column[:-2] + column[2:]) / 2)
    usual = float(np.median(away)) if len(away) else 0.0
    around = np.pad(away, 1)
    far = (away > 2 * SPIKE * usual) & (away >= np.maximum(around[:-2], around[2:])) & (usual > 0)
    spikes: list[int] = (np.flatnonzero(far) + 1).tolist()
    return spikes


def _periods(record: Record) -> float:
    step = (record.time[-1] - record.time[0]) / (len(record.time) - 1)
    return float(len(record.time) * step * (record.frequency_hz or 0.0))


def _perhaps_clipped(record: Record) -> Record:
    """The dwell with all samples marked that stand at what may be limits."""
    if record.values.ndim != 2 or record.frequency_hz is None:
        return record
    status = record.marks()
    for c, column in enumerate(record.values.T):
        highest, lowest = limits(column)
        if np.mean(highest | lowest) <= MOST:
            status[highest, c], status[lowest, c] = ABOVE, BELOW
    return replace(record, status=status) if np.any(status) else record


def _with_clipped(perhaps: Record, record: Record, notices: list[Notice]) -> Record:
    """The dwell with the clipped samples of those channels marked whose motion lies beyond their limits."""
    if perhaps.status is None:
        return record
    status = np.array(perhaps.status)
    for c, channel in enumerate(record.channels):
        clipped = np.abs(status[:, c]) == 1
        if not np.any(clipped):
            continue
        column = record.values[:, c]
        motion, _ = _motion_there(perhaps, c, np.where(clipped, MISSING, status[:, c]))
        beyond = status[clipped, c] * (motion - column)[clipped]
        if np.nansum(beyond) > DEPTH * np.ptp(column) * len(beyond):  # others rest at it
            text = f"{channel.name} clips in the dwell at {record.frequency_hz:g} Hz"
            told = f"{text} ({counted(int(np.sum(clipped)), 'sample')}): the other samples are used"
            notices.append(Notice("unclipped", told, (channel.name,)))
        else:
            status[clipped, c] = 0
    return replace(record, status=status) if np.any(status) else record


def _surroundings(record: Record, c: int, status: Ints) -> Iterator[tuple[slice, slice, Terms, Real]]:
    """Pieces of a channel with samples not measured: samples around, those of it, terms and columns (around, terms).

    Three periods with one more on either side.  The columns are an offset, a slope and two multiples of a steady sine,
    or where that leaves more than noise would, of one whose amplitude and phase run.  Pieces with too few samples
    measured are left out.
    """
    assert record.frequency_hz is not None
    period = max(round(len(status) / _periods(record)), 1)
    edges = np.linspace(0, len(status), max(len(status) // (3 * period), 1) + 1).round().astype(int).tolist()
    for begin, end in pairwise(edges):
        around = slice(max(begin - period, 0), min(end + period, len(status)))
        measured = status[around] == 0
        time, y = record.time[around], record.values[around, c]
        if not np.any(status[begin:end]) or np.count_nonzero(measured) < 6 + FREEDOM:
            continue
        terms, inside = Terms(1, (1, 2)), window(time)
        A = terms.columns(time, record.frequency_hz, *inside)
        for degree in range(1, MOST_BENDS + 1):
            more = Terms(degree + 1, (1, 2), degree)
            free = int(np.count_nonzero(measured)) - more.count
            if free < FREEDOM:
                break
            bent = more.columns(time, record.frequency_hz, *inside)
            before, after = (_left(of[measured], y[measured]) for of in (A, bent))
            F = max(before - after, 0.0) / (more.count - terms.count) / max(after / free, 1e-300)
            if fdtrc(more.count - terms.count, free, F) < LEVEL:
                terms, A = more, bent
        yield around, slice(begin, end), terms, A


def _left(A: Real, y: Real) -> float:
    return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))


def _motion_there(record: Record, c: int, status: Ints) -> tuple[Real, Real]:
    """The motion of a channel as the samples measured show it, and their scatter, (samples,); NaN where they do not."""
    motion, scatter = np.full((2, len(status)), np.nan)
    for around, inside, _, A in _surroundings(record, c, status):
        measured = status[around] == 0
        y = record.values[around, c][measured]
        fitted = A @ np.linalg.lstsq(A[measured], y, rcond=None)[0]
        motion[inside] = fitted[inside.start - around.start :][: inside.stop - inside.start]
        scatter[inside] = np.sqrt(np.sum((y - fitted[measured]) ** 2) / (len(y) - A.shape[1]))
    return motion, scatter


def expected(record: Record) -> Record:
    """A dwell with what the motion around says of samples that are not measured, and how well (`Record.sd`).

    A missing sample is as little known as if nothing stood there.  Of a clipped one the likelihood of being beyond its
    limit is a parabola about that motion: a sample of another value, with more noise.
    """
    if record.status is None:
        return record
    values, f = np.array(record.values), record.frequency_hz or 0.0
    sd = np.where(record.status != 0, np.inf, 0.0)
    for c in np.flatnonzero(~record.whole_channels).tolist():
        status = record.status[:, c]
        for around, inside, terms, A in _surroundings(record, c, status):
            here = record.part(around)
            here = replace(here, channels=here.channels[c : c + 1], values=here.values[:, c : c + 1])
            here = replace(here, status=status[around, None])
            try:
                found = solve_harmonics(here, f, terms)
            except DataError:
                continue
            motion = A @ found.coefficients[0, :, 0]
            noise = max(float(np.sqrt(found.covariance[0, 0, 0])), 1e-13 * float(found.largest[0, 0]))
            side = np.where(np.abs(status[around]) == 1, status[around], 0)
            beyond = side * (record.values[around, c] - motion) / noise
            _, slope, _, curvature, _, _ = in_between(beyond, np.full(len(beyond), np.inf))
            weight = np.where(side, np.clip(-curvature, 1e-12, 1 - 1e-9), 1e-12)
            at = np.flatnonzero(status[inside]) + inside.start
            its = at - around.start
            values[at, c] = (motion + np.where(side, side * slope / weight * noise, 0.0))[its]
            sd[at, c] = np.where(side, noise * np.sqrt(1 / weight - 1), np.inf)[its]
    return replace(record, values=values, sd=sd)


FEW = 2.0  # periods, in which a transient under a clipped sine is not to be told from it


def notices_of_doubt(dwells: Sequence[Record]) -> list[Notice]:
    """Of dwells that are no steady sines: channels that clip in so few periods that nothing tells of what."""
    brief = {
        record.channels[c].name: None
        for record in dwells
        if record.status is not None and _periods(record) < FEW
        for c in np.flatnonzero(np.any(np.abs(record.status) == 1, axis=0))
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
