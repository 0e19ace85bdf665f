"""Samples that are not measured: clipped at the limit of a channel's range, held, 0 or a spike where it missed them.

They are marked (`Record.status`): of clipped samples a regression then knows that the signal is beyond them, of missing
ones nothing; in the lines of whole records they are unknowns.  Which they are is told by the motion around them: in a
dwell by that of a sine nearby, in a whole record by one that is as loud at each frequency as the channel is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import fft
from scipy.special import chdtrc, fdtrc

from dashpot.arrays import Ints, Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.drive_frequency import at_drive_frequencies
from dashpot.data.conditioning.harmonic_fit import rounding_steps
from dashpot.data.conditioning.regression import Terms, in_between, partly_measured, triangle, window
from dashpot.data.conditioning.steadiness import FEW_PERIODS
from dashpot.data.noise import LEVEL, smoothed
from dashpot.data.record import ABOVE, BELOW, MISSING, Record, limits, runs_of_one_value
from dashpot.errors import DataError
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

Motion = Callable[[int, Ints], Real]  # of a channel, with samples marked: what is expected there, (samples,)
DEPTH = 1e-3  # of a channel's range, by which the motion goes beyond a limit in the mean: less is no matter
MOST = 0.6  # of a channel's samples: of one that clips more the rest says too little
# Times the scatter of the motion around a run of one value, or steps of the converter, by which it departs from that
BEYOND = 4.0
SPIKE = 10.0  # times that scatter by which a single sample does
MOST_MISSING = 0.1  # of a channel's samples: a channel that misses more is at fault throughout
PER_PERIOD = 0.5  # runs at the most: a mass that sticks rests twice in each period
FREEDOM = 8  # samples that there must be around, beyond the parameters of the motion


def marked(dwells: Sequence[Record]) -> tuple[list[Record], list[Notice]]:
    """The dwells with their samples marked that channels clip or miss, and a notice of each such channel.

    Repeats (leading axes) are taken as measured.
    """
    notices: list[Notice] = []
    with_missing = [_with_missing(record, notices) for record in dwells]
    if not any(np.any(limits(column)) for r in dwells if r.values.ndim == 2 for column in r.values.T):
        return with_missing, notices
    # The motion around clipped samples is that of the drive's own frequency, which they hide but little.
    perhaps = [_perhaps_clipped(record, MOST * len(record.time)) for record in with_missing]
    at_their_own = at_drive_frequencies(perhaps)[0]
    return [
        record
        if own.status is None
        else _with_clipped(
            record,
            own.status,
            lambda c, status, own=own: _motion_there(own, c, status)[0],  # type: ignore[misc]
            f"{{}} clips in the dwell at {record.frequency_hz:g} Hz ({{}}): the other samples are used",
            notices,
        )
        for own, record in zip(at_their_own, with_missing, strict=True)
    ], notices


def _with_missing(record: Record, notices: list[Notice]) -> Record:
    """The dwell with those runs of one value, and single samples, marked that depart from the motion around them.

    What a coarse converter repeats near a turning point departs by no more than a step, and what rests at the greatest
    or least value is clipped.
    """
    if record.values.ndim != 2 or record.frequency_hz is None:
        return record
    most = max(1.0, PER_PERIOD * record.periods)
    status = np.zeros(record.values.shape, dtype=np.int64)
    for c, column in enumerate(record.values.T):
        runs = list(runs_of_one_value(column, 3))
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
        step, missed = rounding_steps([record])[0, c], []
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
            text = f"{name} has {counted(count, 'missing sample')} in the dwell at {record.frequency_hz:g} Hz"
            notices.append(
                Notice("dropouts", f"{text} (held, 0 or a spike): the other samples are used", (name,))
            )
    return replace(record, status=status) if np.any(status) else record


def _departures(values: Real) -> Real:
    """Samples (samples, ...) less the line between their neighbours; of the first and the last 0."""
    away = np.zeros(values.shape)
    away[1:-1] = values[1:-1] - (values[:-2] + values[2:]) / 2
    return away


def _spikes(column: Real) -> list[int]:
    """Samples that depart from the line between their neighbours far more than samples usually do."""
    away = np.abs(_departures(column))
    usual = float(np.median(away[1:-1])) if len(away) > 2 else 0.0
    far = (away[1:-1] > 2 * SPIKE * usual) & (away[1:-1] >= np.maximum(away[:-2], away[2:])) & (usual > 0)
    spikes: list[int] = (np.flatnonzero(far) + 1).tolist()
    return spikes


def _perhaps_clipped(record: Record, most: float, *, of_all: bool = False) -> Record:
    """The record with all samples marked that stand at what may be limits, as long as no more than `most` of a channel
    are marked, or of all channels."""
    if record.values.ndim != 2:
        return record
    status = record.marks()
    for c, column in enumerate(record.values.T):
        highest, lowest = limits(column) & (status[:, c] == 0)
        if np.count_nonzero(status if of_all else status[:, c]) + np.sum(highest | lowest) <= most:
            status[highest, c], status[lowest, c] = ABOVE, BELOW
    return replace(record, status=status) if np.any(status) else record


def _with_clipped(record: Record, perhaps: Ints, motion: Motion, text: str, notices: list[Notice]) -> Record:
    """The record with those of the clipped samples marked, of what may be, beyond which its channel moves.

    What a coarse converter rounds to the code on which it turns is beyond that by half a step at the most.
    """
    status = np.array(perhaps)
    for c in np.flatnonzero(np.any(np.abs(perhaps) == 1, axis=0)).tolist():
        clipped, column, name = np.abs(perhaps[:, c]) == 1, record.values[:, c], record.channels[c].name
        expected = motion(c, np.where(clipped, MISSING, perhaps[:, c]))
        beyond = perhaps[clipped, c] * (expected - column)[clipped]
        least = max(DEPTH * float(np.ptp(column)), float(rounding_steps([record])[0, c]) / 2)
        if np.nansum(beyond) > least * len(beyond):  # others rest at it
            count = counted(int(np.sum(clipped)), "sample")
            notices.append(Notice("unclipped", text.format(name, count), (name,)))
        else:
            status[clipped, c] = 0
    return replace(record, status=status) if np.any(status) else record


def _motions(record: Record, c: int, status: Ints) -> Iterator[tuple[slice, slice, Real, float]]:
    """Pieces of a channel with samples not measured: samples around, those of it, motion (around,), sd of a sample.

    Three periods with one more on either side.  The motion is an offset, a slope and two multiples of a steady sine,
    or where that leaves more than noise would, of one whose amplitude and phase run; an offset and a sine where few
    samples are measured.  It is the likeliest by `status`; pieces whose samples do not tell it are left out.
    """
    assert record.frequency_hz is not None
    f, period = record.frequency_hz, max(round(len(status) / record.periods), 1)
    one = record.channels[c : c + 1], record.values[:, c : c + 1], status[:, None]
    alone = replace(record, channels=one[0], values=one[1], status=one[2], sd=None, cell=None)
    edges = np.linspace(0, len(status), max(len(status) // (3 * period), 1) + 1).round().astype(int).tolist()
    for begin, end in pairwise(edges):
        around = slice(max(begin - period, 0), min(end + period, len(status)))
        measured = status[around] == 0
        here, count = alone.part(around), int(np.count_nonzero(measured))
        terms = Terms(1, (1, 2)) if count >= 6 + FREEDOM else Terms(0)
        if not np.any(status[begin:end]) or count < terms.count + 2:
            continue
        bends = min(6, (count - FREEDOM - 6) // 3)  # degree of what amplitude and phase that run may follow
        if bends > 0:
            # By the columns in this order, three more for each bend, one QR has what each is left with
            every = Terms(bends + 1, (1, 2), bends)
            more = [
                [k + 2, every.count - 2 * (bends - k), every.count - 2 * (bends - k) + 1]
                for k in range(bends)
            ]
            order = [0, 1, *every.wave(1), *every.wave(2), *(column for three in more for column in three)]
            A = every.columns(here.time, f, *window(here.time))[:, order]
            R = triangle([np.column_stack([A, here.values])[measured]])
            left, at = np.cumsum(R[::-1, -1] ** 2)[::-1], 0
            for degree in range(1, bends + 1):
                fewer, many = 6 + 3 * at, 6 + 3 * degree
                F = (left[fewer] - left[many]) / (many - fewer) / max(left[many] / (count - many), 1e-300)
                if fdtrc(many - fewer, count - many, F) < LEVEL:
                    terms, at = Terms(degree + 1, (1, 2), degree), degree
        A, y = terms.columns(here.time, f, *window(here.time)), here.values[:, 0]
        if np.any(np.abs(status[around]) == 1):
            try:
                found = partly_measured(here, 0, f, terms)
            except DataError:
                continue
            motion, noise = A @ found.coefficients, found.variance**0.5
        else:
            motion = A @ np.linalg.lstsq(A[measured], y[measured], rcond=None)[0]
            noise = float(np.sqrt(np.sum((y - motion)[measured] ** 2) / (count - terms.count)))
        yield around, slice(begin, end), motion, max(noise, 1e-13 * float(np.max(np.abs(y))))


def _motion_there(record: Record, c: int, status: Ints) -> tuple[Real, Real]:
    """The motion of a channel as the samples measured show it, and their scatter, (samples,); NaN where they do not."""
    motion, scatter = np.full((2, len(status)), np.nan)
    for around, inside, fitted, noise in _motions(record, c, np.where(status != 0, MISSING, 0)):
        motion[inside] = fitted[inside.start - around.start :][: inside.stop - inside.start]
        scatter[inside] = noise
    return motion, scatter


def expected(record: Record) -> Record:
    """A dwell with what the motion around says of samples that are not measured, and how well (`Record.sd`).

    A missing sample is as little known as if nothing stood there.  Of a clipped one the likelihood of being beyond its
    limit is a parabola about that motion: a sample of another value, with more noise.
    """
    if record.status is None:
        return record
    values, sd = np.array(record.values), np.where(record.status != 0, np.inf, 0.0)
    for c in np.flatnonzero(~record.whole_channels).tolist():
        status = record.status[:, c]
        for around, inside, motion, noise in _motions(record, c, status):
            side = np.where(np.abs(status[around]) == 1, status[around], 0)
            beyond = side * (record.values[around, c] - motion) / noise
            _, slope, _, curvature, _, _ = in_between(beyond, np.full(len(beyond), np.inf))
            weight = np.where(side, np.clip(-curvature, 1e-12, 1 - 1e-9), 1e-12)
            at = np.flatnonzero(status[inside]) + inside.start
            its = at - around.start
            values[at, c] = (motion + np.where(side, side * slope / weight * noise, 0.0))[its]
            sd[at, c] = np.where(side, noise * np.sqrt(1 / weight - 1), np.inf)[its]
    return replace(record, values=values, sd=sd)


def notices_of_doubt(dwells: Sequence[Record]) -> list[Notice]:
    """Of dwells that are no steady sines: channels that clip in so few periods that nothing tells of what."""
    brief = {
        record.channels[c].name: None
        for record in dwells
        if record.status is not None and record.periods < FEW_PERIODS
        for c in np.flatnonzero(np.any(np.abs(record.status) == 1, axis=0))
    }
    return [
        Notice(
            "clipped_in_doubt",
            f"{name} clips in dwells of less than two periods that are not steady sines: the motion there is "
            "unknown, and errors may exceed the intervals",
            (name,),
        )
        for name in brief
    ]


# Whole records. Samples in which a channel holds one value, or reads 0, while the motion goes on, spikes, and clipped
# ones are unknown; where they are too many the record is cut there, and what is on either side is used by itself.


MOST_UNKNOWN = 500  # samples of all channels that stay unknown in a record: with more it is cut
SHORTEST_HELD_SAMPLES = 4  # samples of a run
LONG_HELD = 10  # samples, in which no motion of many steps a sample turns about
CHANCE_HELD = 1e-6  # that a motion through a short run is as far from its value
AROUND = 20  # samples on either side that show how a channel moves
MOST_RUNS = 5  # in one channel: what rests more often does so for a reason
SHORTEST = 64  # samples of a piece that is used, between gaps or runs of one value
ALONE = 4.0  # times the largest departure around a spike by which it departs: the motion before and behind is alike
AT_ONCE = 2.0  # and that by which no other channel does: a blow moves several
MOST_SPIKES = 20  # in one channel: more are part of its motion, as where parts of a rig meet


def marked_whole(record: Record) -> tuple[list[Record], tuple[Notice, ...]]:
    """The record with the samples marked that channels hold, miss or clip, or its parts between those held; notices.

    Channels of forces hold their values and have peaks: of them clipped samples alone are marked.  Repeats (leading
    axes) stay as they are.
    """
    if record.values.ndim != 2:
        return [record], ()
    status, notes = record.marks(), list[Notice]()
    held, holding = np.zeros(len(record.time), dtype=bool), []
    away = _departures(record.values)
    for c, channel in enumerate(record.channels):
        if channel.quantity is Quantity.FORCE:
            continue
        runs = _runs_held(record.values[:, c])
        if runs:
            holding.append(channel.name)
        for begin, end in runs:
            held[begin:end] = True
            status[begin:end, c] = MISSING
        spikes = [at for at in _spikes(record.values[:, c]) if status[at, c] == 0 and _alone(away, at, c)]
        if 0 < len(spikes) <= MOST_SPIKES:
            status[spikes, c] = MISSING
            which = (
                f"{channel.name} has {counted(len(spikes), 'spike')}, first at {record.time[spikes[0]]:.6g} s"
            )
            notes.append(Notice("dropouts", f"{record.source}: {which}: treated as missing", (channel.name,)))
    edges = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
    spiky = replace(record, status=status) if np.any(status) else record
    parts = [spiky.part(slice(a, b)) for a, b in pairwise(edges) if not held[a] and b - a >= SHORTEST]
    if np.count_nonzero(status) <= MOST_UNKNOWN or not parts:
        parts, used = [spiky], "treated as missing"
    else:
        used = f"split into {counted(len(parts), 'segment')}"
    if holding:
        text = (
            f"{record.source}: {joined(holding)} hold{'s' if len(holding) == 1 else ''} one value for "
            f"{np.sum(held)} samples, first at {record.time[np.argmax(held)]:.6g} s, although the motion "
            f"continues: {used}"
        )
        notes.append(Notice("held_samples", text, tuple(holding)))
    return [_with_clipped_of_whole(part, notes) for part in parts], tuple(notes)


def _with_clipped_of_whole(record: Record, notes: list[Notice]) -> Record:
    """The record with the samples marked that are clipped; as it is where they are too many."""
    status = _perhaps_clipped(record, MOST_UNKNOWN, of_all=True).marks()

    def motion(c: int, trial: Ints) -> Real:
        alone = np.where(np.arange(status.shape[1]) == c, trial[:, None], 0)
        return with_likely(replace(record, status=alone, sd=None))[0].values[:, c]

    text = f"{record.source}: {{}} clips ({{}}): the other samples are used"
    return _with_clipped(record, status, motion, text, notes) if np.any(np.abs(status) == 1) else record


def _alone(away: Real, at: int, c: int) -> bool:
    """Whether one sample of a channel departs far more than those around, where no other channel does; departures
    (samples, channels).

    Without it its neighbours would lie where they should: next to a step, one of them would not.
    """
    spike = away[at, c]
    beside = away[[at - 1, at + 1], c] + spike / 2
    away = np.abs(away)
    first, near = max(at - AROUND, 0), slice(max(at - 2, 0), at + 3)
    around = np.concatenate([away[first : near.start], away[near.stop : at + AROUND + 1]])
    if not len(around):
        return False
    usual = np.max(around, axis=0)
    others = np.arange(away.shape[1]) != c
    quiet = np.all(away[near][:, others] <= AT_ONCE * usual[others]) and np.all(
        np.abs(beside) < abs(spike) / 4
    )
    return bool(away[at, c] > ALONE * usual[c] and quiet)


def _runs_held(column: Real) -> list[tuple[int, int]]:
    """Begin and end of each run of one value (samples,) that the motion around it does not explain."""
    runs, most = list(runs_of_one_value(column, SHORTEST_HELD_SAMPLES)), MOST_MISSING * len(column)
    if not 0 < len(runs) <= MOST_RUNS or sum(end - begin for begin, end in runs) > most:
        return []
    values, counts = np.unique(column, return_counts=True)
    if np.any(counts > most) or len(values) < 2:  # a value at which the channel rests
        return []
    step = float(np.min(np.diff(values)))
    runs = [
        (a, b) for a, b in runs if a > 0 and b < len(column) and _moves_around(column, a, b, BEYOND * step)
    ]
    lost = [(a, b) for a, b in runs if b - a >= LONG_HELD]
    short = [(a, b) for a, b in runs if b - a < LONG_HELD]
    if not short:
        return lost
    # Short ones may be turning points: a motion as loud at each frequency as the channel is would leave the value
    every, at = (np.concatenate([np.arange(*run) for run in some]) for some in (runs, short))
    motion = np.array(column)
    motion[every] = np.interp(every, np.delete(np.arange(len(column)), every), np.delete(column, every))
    expected, precision = told_by_lines(motion, at, 0, (np.zeros(len(at)), np.zeros(len(at))))
    away, covariance = motion[at] + expected - column[at], np.linalg.inv(precision)
    for begin, end in short:
        own = (at >= begin) & (at < end)
        square = away[own] @ np.linalg.solve(covariance[np.ix_(own, own)], away[own])
        if np.max(np.abs(away[own])) > BEYOND * step and chdtrc(end - begin, square) < CHANCE_HELD:
            lost.append((begin, end))
    return lost


def _moves_around(column: Real, begin: int, end: int, least: float) -> bool:
    """Whether a channel moves by more than `least` from sample to sample around a run that is not at a limit."""
    sides = (np.diff(column[max(begin - AROUND, 0) : begin]), np.diff(column[end : end + AROUND]))
    usual = min(float(np.sqrt(np.mean(part**2))) if len(part) else 0.0 for part in sides)
    return column[begin] not in (column.min(), column.max()) and usual > least


# Of each channel: inverse variance and mean of what is to be added, (k,) each
Known = dict[int, tuple[Real, Real]]


def with_likely(record: Record) -> tuple[Record, Known]:
    """The record with values that are likely for samples not measured, and what is known of each by itself.

    They are as `Record.sd` has them, else of a motion that is as loud at each frequency as the channel is, and beyond
    its limit where it is clipped.
    """
    values, known = np.array(record.values), Known()
    for c in np.flatnonzero(~record.whole_channels).tolist():
        assert record.status is not None
        at, there = np.flatnonzero(record.status[:, c]), np.flatnonzero(record.status[:, c] == 0)
        if record.sd is not None:
            known[c] = 1 / record.sd[at, c] ** 2, np.zeros(len(at))
            continue
        limit, side = values[at, c].copy(), record.status[at, c]
        values[at, c] = np.interp(at, there, values[there, c])
        nothing = np.zeros(len(at)), np.zeros(len(at))
        mean, precision = told_by_lines(values[:, c], at, 0, nothing)
        side = np.where(side == MISSING, 0, side)
        likely, inverse, at_mean = _beyond(limit - values[at, c], side, mean, precision)
        values[at, c] += likely
        known[c] = inverse, at_mean - likely
    return replace(record, values=values), known


def _beyond(limit: Real, side: Ints, mean: Real, precision: Real) -> tuple[Real, Real, Real]:
    """Mean of Gaussian numbers (k,) that are above (side 1) or below (−1) limits, and for each of these the number with
    noise that tells as much: inverse variance and mean.

    By expectation propagation (Minka 2001): each limit in turn, against what all others leave of its number.
    """
    tau, nu = np.zeros(len(side)), np.zeros(len(side))
    some = side != 0
    for _ in range(20 if np.any(some) else 0):
        covariance = np.linalg.inv(precision + np.diag(tau))
        every = covariance @ (precision @ mean + nu)
        variance = np.diagonal(covariance)[some]
        cavity = 1 / np.maximum(1 / variance - tau[some], 1e-6 / variance)
        middle = cavity * (every[some] / variance - nu[some])
        z = side[some] * (limit[some] - middle) / np.sqrt(cavity)
        _, slope, _, curvature, _, _ = in_between(z, np.full(len(z), np.inf))
        narrower = cavity * np.clip(1 + curvature, 1e-6, 1.0)
        moved = middle + side[some] * slope * np.sqrt(cavity)
        before = tau[some]
        tau[some] = (before + 1 / narrower - 1 / cavity) / 2  # half a step, for all at once
        nu[some] = (nu[some] + moved / narrower - middle / cavity) / 2
        if np.max(np.abs(tau[some] - before) * variance) < 1e-3:
            break
    likely = np.linalg.solve(precision + np.diag(tau), precision @ mean + nu).astype(np.float64)
    return likely, tau, np.where(tau > 0, nu / np.where(tau > 0, tau, 1.0), 0.0)


def told_by_lines(column: Real, at: Ints, last: int, known: tuple[Real, Real]) -> tuple[Real, Real]:
    """Mean (k,) and inverse covariance (k, k) of what is to be added to the samples `at` (k,) of a channel.

    By lines above the `last`, each as loud as its neighbours; by what is known of each, inverse variance
    and mean (k,); and by the channel's size, which it does not exceed.
    """
    samples, lines = len(column), len(column) // 2 - last
    own = precision = np.diag(known[0] + 1 / np.ptp(np.delete(column, at)) ** 2)
    pull = known[0] * known[1]
    filled = np.array(column)
    if len(at) > lines:  # as loud as they are for the unknowns' sake
        return pull / np.diagonal(own), own
    # What the ends leak by jumps of the motion, its slope and its bend is smooth in jω, and none of the noise
    s = 1j * np.arange(last + 1, len(column) // 2 + 1)[:, None] / (len(column) // 2)
    ends = (s ** np.arange(-3, 3) / np.linalg.norm(s ** np.arange(-3, 3), axis=0)).astype(np.complex128)
    leaked: Real = np.zeros(ends.shape[1])
    padded = np.zeros((samples // 2 + 1, 2 + ends.shape[1]), dtype=np.complex128)
    for _ in range(3):
        Y = fft.rfft(filled - filled.mean())[last + 1 :]
        power = np.abs(Y - ends @ leaked) ** 2 / (1 - len(at) / (2 * lines))
        loudness = smoothed(power)
        weight = 1 / np.maximum(loudness, 1e-20 * np.max(np.abs(Y)) ** 2)
        # Products of errors of single samples with lines whose real and imaginary parts have half of the power each
        padded[last + 1 :] = weight[:, None] * np.column_stack([Y, np.ones(lines), ends])
        in_time = samples * fft.irfft(padded, samples, axis=0)
        weighted = 2 * np.conj(ends.T) * weight
        by_ends = np.linalg.pinv((weighted @ ends).real, hermitian=True).astype(np.float64)
        of_ends = (weighted @ Y).real
        leaked = by_ends @ of_ends
        beside = in_time[at, 2:] @ by_ends
        precision = own + in_time[np.abs(at[:, None] - at), 1] - beside @ in_time[at, 2:].T
        away = in_time[at, 0] - beside @ of_ends + own @ (filled - column)[at] - pull
        filled[at] -= np.linalg.solve(precision, away)
    return filled[at] - column[at], precision
