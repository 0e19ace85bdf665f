"""Whole records: all samples of any excitation become lines k/T that share the record's boundary loads (THEORY §8).

Nothing has to settle, to repeat or to end where it began: what the ends of the record leave in its lines is smooth in
frequency, a load a + jωb at every coordinate and a few real polynomial columns in each channel, and the likelihood
solves for it.  Here the samples are checked, put through one FFT, and limited to the band in which something moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import fft
from scipy.special import chdtrc

from dashpot.arrays import Complex, Ints, Real, diagonal_matrices
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.clock import even_step, fewest_samples
from dashpot.data.conditioning.regression import in_between
from dashpot.data.conditioning.still import HALF_WINDOW, Still, smoothed, variance_at_rest
from dashpot.data.record import ABOVE, BELOW, MISSING, Record, calibration, limits, runs_of_one_value
from dashpot.data.spectrum import Spectrum, Unmeasured, WholeRecord, concatenate
from dashpot.errors import DataError
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

GAP = 1.5  # sampling steps: where the next sample is later than this, another record begins
SHORTEST = 64  # samples of a piece between gaps
MOST_UNKNOWN = 500  # samples of all channels that stay unknown in a record: with more it is cut
DEPTH = 1e-3  # of a channel's range, by which the motion goes beyond a limit in the mean: less is no matter
MOST_MISSING = 0.1  # of a record's samples, or of a channel's: what misses or holds more does so for a reason
SLIP = 0.1  # of a step: where the next sample is early or late by more, the clock has slipped
UNEVEN = 0.02  # share of gaps from which on they are the clock's
HIGHEST = 0.9  # of half the sampling rate: above it the input between the samples is not known well enough
BIN = 30  # lines, at least, whose mean power says whether something moves there
BINS = 200  # at most
STANDS_OUT = 4.0  # standard deviations of a bin's mean power above the floor: a signal
POLYNOMIAL = 4  # columns 1, jω, (jω)², … of each output channel: the fourth takes the error down by twenty
AT_REST = "rest"  # kind of noise: as a record with nothing driven shows it
ALIKE = 1.4  # by which the mean power of second differences scatters more: neighbours share lines
FLOOR = "floor"  # kind of noise: white, as the top of the spectrum shows it, until residuals show more
LOWEST = 10  # line up to which a linear drift is felt
MANY = 200  # lines from which on a column for it costs nothing to speak of
TOP = (0.6, 0.98)  # of half the sampling rate: where that floor is read
HIGHEST_LINES = 0.96  # of half the sampling rate: a recorder's filter leaves nothing above
FOLDED = 0.01  # of a channel's largest lines: what moves there that is said
MANY_LINES = 300_000  # from which on a narrower band is worth stating
BYTES = 650  # of memory that an identification takes for each line of a channel
CHANCE = 1e-3  # that the loudest line of noise counts as motion
FAR_BELOW = 0.1  # of the mean power of the lines: a floor is noise, not motion


def without_gaps(record: Record) -> tuple[list[Record], tuple[Notice, ...]]:
    """The record with rows of unknown samples where some are missing, or cut there, and where its clock slips; a note.

    It is cut where too many are missing, or not a whole number of steps.  Pieces too short to use are left out.

    Raises DataError where no piece is long enough.
    """
    steps = np.diff(record.time)
    if not len(steps):
        return [record], ()
    usual = float(np.median(steps))
    cuts = np.flatnonzero(steps > GAP * usual) + 1
    away = np.abs(steps - usual)
    slips = np.flatnonzero(away > max(SLIP * usual, 2 * float(np.quantile(away, 1 - UNEVEN)))) + 1
    slipped = len(cuts) < len(slips) <= UNEVEN * len(steps)
    cuts = slips if slipped else cuts
    if not len(cuts):
        return [record], ()
    at = ", ".join(f"{record.time[cut]:.6g} s" for cut in cuts[:3]) + (", …" if len(cuts) > 3 else "")
    whole = None if slipped else _with_unknown_rows(record, np.rint(steps / usual).astype(np.int64))
    if whole is not None:
        count = len(whole.time) - len(record.time)
        text = f"{record.source}: {counted(count, 'sample')} missing before {at}: unknown there, the others are used"
        return [whole], (Notice("gaps", text, (record.source,)),)
    edges = [0, *cuts.tolist(), len(record.time)]
    pieces = [record.part(slice(a, b)) for a, b in pairwise(edges) if b - a >= SHORTEST]
    lost = len(record.time) - sum(len(piece.time) for piece in pieces)
    if len(cuts) > UNEVEN * len(steps):
        raise DataError(
            f"the samples are not evenly spaced: {len(cuts)} of {len(steps)} steps are longer than {GAP:g} × "
            "the usual one",
            record.source,
            "record with a steady clock; resampling adds errors that look like motion",
        )
    if not pieces:
        raise DataError(
            f"the time has {len(cuts)} gaps, and no piece between them has {SHORTEST} samples",
            record.source,
            "give the record without gaps",
        )
    dropped = f", {lost} samples of short pieces left out" if lost else ""
    what = "the clock slips" if slipped else "samples are missing"
    text = f"{record.source}: {what} before {at}: used as {len(pieces)} records{dropped}"
    return pieces, (Notice("gaps", text, (record.source,)),)


def _with_unknown_rows(record: Record, steps: Ints) -> Record | None:
    """The record with a row for each sampling step, of which there are so many from row to row (rows − 1,).

    None where too many are put in, or the stamps are no even ones then.
    """
    number = np.concatenate([[0], np.cumsum(steps)])
    rows, channels = int(number[-1]) + 1, len(record.channels)
    missing = rows - len(number)
    if missing * channels > MOST_UNKNOWN or missing > MOST_MISSING * rows or record.values.ndim != 2:
        return None
    at = np.arange(rows)
    values = np.stack([np.interp(at, number, column) for column in record.values.T], axis=1)
    status = np.full(values.shape, MISSING)
    status[number] = record.marks()
    whole = replace(record, time=np.interp(at, number, record.time), values=values, sd=None, status=status)
    try:
        even_step(whole)
    except DataError:
        return None
    return whole


# Samples of a whole record in which a channel holds one value, or reads 0, while the motion goes on.
#
# They are unknown, or where they are too many the record is cut there: what is on either side is used as a
# record of its own.


SHORTEST_HELD_SAMPLES = 4  # samples of a run
LONG_HELD = 10  # samples, in which no motion of many steps a sample turns about
CHANCE_HELD = 1e-6  # that a motion through a short run is as far from its value
AROUND_HELD_SAMPLES = 20  # samples on either side that show how the channel moves
# Steps of the converter, or standard deviations, by which a motion does not stand still by chance
RESOLVED = 4.0
MOST_RUNS = 5  # in one channel: what rests more often does so for a reason
SIDES = 64  # samples of a part that is used


def without_held_samples(record: Record) -> tuple[list[Record], tuple[Notice, ...]]:
    """The record with the runs unknown in which channels hold a value, or its parts before, between and behind them,
    and a note of them.

    Channels of forces are left alone: a drive may hold its value.  Repeats (leading axes) stay as they are.
    """
    if record.values.ndim != 2:
        return [record], ()
    status = record.marks()
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
            status[begin:end, c] = MISSING
    edges = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
    parts = [record.part(slice(a, b)) for a, b in pairwise(edges) if not held[a] and b - a >= SIDES]
    if not names or not parts:
        return [record], ()
    at = record.time[int(np.argmax(held))]
    used = f"used as {counted(len(parts), 'record')}"
    if np.count_nonzero(status) <= MOST_UNKNOWN:
        parts, used = [replace(record, status=status)], "unknown there, the others are used"
    text = (
        f"{record.source}: {joined(names)} hold{'s' if len(names) == 1 else ''} a value in {int(np.sum(held))} "
        f"samples, first at {at:.6g} s, while the motion goes on: {used}"
    )
    return parts, (Notice("held_samples", text, tuple(names)),)


def _runs_held(column: Real) -> list[tuple[int, int]]:
    """Begin and end of each run of one value (samples,) that the motion around it does not explain."""
    runs = list(runs_of_one_value(column, SHORTEST_HELD_SAMPLES))
    values, counts = np.unique(column, return_counts=True)
    resting = values[counts > MOST_MISSING * len(column)]
    if not 0 < len(runs) <= MOST_RUNS or sum(end - begin for begin, end in runs) > MOST_MISSING * len(column):
        return []
    if len(resting) or len(values) < 2:
        return []
    step = float(np.min(np.diff(values)))
    runs = [
        (a, b) for a, b in runs if a > 0 and b < len(column) and _moves_around(column, a, b, RESOLVED * step)
    ]
    lost = [(a, b) for a, b in runs if b - a >= LONG_HELD]
    short = [(a, b) for a, b in runs if b - a < LONG_HELD]
    if not short:
        return lost
    # Short ones may be turning points: a motion as loud at each frequency as the channel is would leave the value
    every, at = (np.concatenate([np.arange(*run) for run in some]) for some in (runs, short))
    motion = np.array(column)
    motion[every] = np.interp(every, np.delete(np.arange(len(column)), every), np.delete(column, every))
    expected, precision = _told_by_lines(motion, at, 0, (np.zeros(len(at)), np.zeros(len(at))))
    away, covariance = motion[at] + expected - column[at], np.linalg.inv(precision)
    for begin, end in short:
        own = (at >= begin) & (at < end)
        square = away[own] @ np.linalg.solve(covariance[np.ix_(own, own)], away[own])
        if np.max(np.abs(away[own])) > RESOLVED * step and chdtrc(end - begin, square) < CHANCE_HELD:
            lost.append((begin, end))
    return lost


def _moves_around(column: Real, begin: int, end: int, least: float) -> bool:
    """Whether a channel moves by more than `least` from sample to sample around a run that is not at a limit."""
    sides = (
        np.diff(column[max(begin - AROUND_HELD_SAMPLES, 0) : begin]),
        np.diff(column[end : end + AROUND_HELD_SAMPLES]),
    )
    usual = min(float(np.sqrt(np.mean(part**2))) if len(part) else 0.0 for part in sides)
    return column[begin] not in (column.min(), column.max()) and usual > least


def whole_record(
    record: Record,
    *,
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
    polynomial: int = POLYNOMIAL,
    loads: bool = True,
    ramp: bool = False,
) -> Spectrum:
    """Lines k/T, k ≥ 1, of one evenly sampled record, peak amplitudes (2/N) Σ x e^{−jωt}, SI units.

    Without `band_hz` the lines reach from the first to where nothing stands out of the noise any more, and to 0.9 of
    half the sampling rate at most.  The covariance is that of a record at `still`, else the white floor of each channel
    (0 where it has none), which the residuals of a fit replace.  The offset is in the DC line alone, which is left out;
    with `ramp` each output has a column for a linear drift where there are lines enough to pay for it.  What stands for
    samples that are not measured (`Record.status`) is unknown in the lines.
    Raises DataError for uneven samples, a band without lines or without signal, and channels that do not move.
    """
    if record.values.ndim != 2:
        raise DataError("repeats of a record cannot be combined", record.source, "give one at a time")
    step = even_step(record)
    record, remaining = _aligned(record, step)
    samples = len(record.time)
    duration = samples * step
    _require_motion(record)
    first, last = _lines_of(record.source, band_hz, samples, step)
    record, known = with_likely(record)
    X, floor, folded = _amplitudes(record, first, last, stated=band_hz is not None)
    if band_hz is None:
        X = X[: _moving(X, record.source, last / duration)]
        last = first + len(X) - 1
    frequency = np.arange(first, last + 1) / duration
    lines, channels = X.shape
    h = calibration(remaining, frequency)
    if still is None:
        V = np.broadcast_to(diagonal_matrices(floor), (lines, channels, channels))
        kind, dof = FLOOR, 2.0 * lines
    else:
        V, kind, dof = still.covariance(frequency, samples), AT_REST, still.dof
    if np.any(h != 1):
        X, V = X * h, V * h[:, :, None] * np.conj(h)[:, None, :]
    return Spectrum(
        record.channels,
        frequency,
        X,
        V,
        np.full(lines, samples),
        np.full(lines, dof),
        (kind,) * lines,
        np.full(lines, record.experiment),
        stretch=np.zeros(lines, dtype=np.int64),
        notes=_notices(record, folded),
        stretches=(
            WholeRecord(
                duration,
                samples,
                loads,
                polynomial,
                ramp and _drift_shows(first, lines),
                unmeasured=_unmeasured(record, known, remaining, last),
            ),
        ),
    )


def with_clipped_samples(record: Record) -> tuple[Record, tuple[Notice, ...]]:
    """The record with the samples marked at which channels end while their motion is likely to go on, and notes.

    As it is where they are too many.
    """
    if record.values.ndim != 2:
        return record, ()
    status = record.marks()
    notes = []
    for c, channel in enumerate(record.channels):
        highest, lowest = limits(record.values[:, c]) & (status[:, c] == 0)
        clipped = highest | lowest
        if not np.any(clipped) or np.count_nonzero(status) + np.sum(clipped) > MOST_UNKNOWN:
            continue
        trial = np.where(clipped, MISSING, status[:, c])
        alone = replace(record, status=np.where(np.arange(status.shape[1]) == c, trial[:, None], 0), sd=None)
        beyond = (np.where(highest, 1, -1) * (with_likely(alone)[0].values - record.values)[:, c])[clipped]
        if np.mean(beyond) > DEPTH * np.ptp(record.values[:, c]):  # others rest at it
            status[highest, c], status[lowest, c] = ABOVE, BELOW
            text = f"{channel.name} clips ({counted(int(np.sum(clipped)), 'sample')}): the other samples are used"
            notes.append(Notice("unclipped", f"{record.source}: {text}", (channel.name,)))
    return (replace(record, status=status), tuple(notes)) if notes else (record, ())


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
        mean, precision = _told_by_lines(values[:, c], at, 0, nothing)
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


def _unmeasured(
    likely: Record, known: Known, remaining: Sequence[Channel], last: int
) -> tuple[Unmeasured, ...]:
    """What is known of samples that are not measured: of each by itself, and by lines above the `last` of the band,
    which hold noise alone.  remaining: channels with what is left of their known delays."""
    found = []
    for c, own in known.items():
        assert likely.status is not None
        at = np.flatnonzero(likely.status[:, c])
        found.append(Unmeasured(remaining[c], at, *_told_by_lines(likely.values[:, c], at, last, own)))
    return tuple(found)


def _told_by_lines(column: Real, at: Ints, last: int, known: tuple[Real, Real]) -> tuple[Real, Real]:
    """Mean (k,) and inverse covariance (k, k) of what is to be added to the samples `at` (k,) of a channel.

    By lines above the `last`, of which each is as loud as those beside it; by what is known of each, inverse variance
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
        loudness = smoothed(power.astype(np.complex128), HALF_WINDOW).real
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


def _lines_of(source: str, band_hz: tuple[float, float] | None, samples: int, step: float) -> tuple[int, int]:
    """Numbers of the first and the last line in a band.  Raises DataError where there is none."""
    if band_hz is None:
        return 1, int(np.floor(HIGHEST * samples / 2))
    duration = samples * step
    first, last = int(np.ceil(band_hz[0] * duration - 1e-9)), int(np.floor(band_hz[1] * duration + 1e-9))
    first, last = max(first, 1), min(last, samples // 2 - 1)
    if last < first:
        raise DataError(
            f"no line of the record lies between {band_hz[0]:g} and {band_hz[1]:g} Hz",
            source,
            f"its lines are multiples of {1 / duration:.4g} Hz up to {0.5 / step:.4g} Hz",
        )
    return first, last


def _amplitudes(record: Record, first: int, last: int, *, stated: bool) -> tuple[Complex, Real, Real]:
    """Peak amplitudes of the lines, (lines, channels), the white floor of each channel, and how it moves at the top.

    Raises DataError where nothing moves in a `stated` band.
    """
    moving: list[tuple[bool, float, float]] = []
    duration = len(record.time) * even_step(record)
    samples = len(record.time)
    X = np.empty((last - first + 1, len(record.channels)), dtype=np.complex128)
    floor, folded = np.zeros(len(record.channels)), np.zeros(len(record.channels))
    for c in range(len(record.channels)):
        column = record.values[:, c]
        Y = fft.rfft(column - column.mean())
        Y *= 2 / samples
        X[:, c] = Y[first : last + 1]
        rest = variance_at_rest(column) * 4 / samples
        floor[c] = rest or white_floor(without_leakage(Y))
        folded[c] = at_the_top(Y - leaked_by_a_step(column), floor[c])
        if stated:
            # What the ends leak is no motion in the band either.
            moving.append(_motion_in(Y, rest or white_floor(np.abs(Y) ** 2), first, last))
    if moving and not any(inside for inside, _, _ in moving):
        low, high = min(low for _, low, _ in moving), max(high for _, _, high in moving)
        where = (
            f"the record moves from {low / duration:.3g} to {high / duration:.3g} Hz: " if high > low else ""
        )
        raise DataError(
            f"no channel moves more than its noise from {first / duration:.4g} to {last / duration:.4g} Hz, the band "
            "that is asked for",
            record.source,
            f"{where}set the band there, or none, which takes it from where something moves",
        )
    return X, floor, folded


def _motion_in(Y: Complex, floor: float, first: int, last: int) -> tuple[bool, float, float]:
    """Whether a channel moves in some of its lines, and the first and last line of its motion (inf and 0 of none).

    Y (N/2 + 1,) lines.  Without a floor, a mean power `floor` of noise, lines move that are not far below the largest.
    """
    power = np.abs(Y) ** 2
    power[0] = 0.0
    if floor == 0:
        moves = power > (FAR_BELOW**2) * np.max(power)
        at = np.flatnonzero(moves)
        return bool(np.any(moves[first : last + 1])), float(at[0]), float(at[-1])
    starts: Ints = np.arange(1, len(power) - BIN, BIN)
    out = np.flatnonzero(np.add.reduceat(power, starts)[:-1] > (1 + STANDS_OUT / BIN**0.5) * floor * BIN)
    low, high = (float(starts[out[0]]), float(starts[out[-1]] + BIN)) if len(out) else (np.inf, 0.0)
    inside = power[first : last + 1]
    # Few lines, or few loud ones among many, may be a resonance.
    loudest = float(np.max(inside)) > floor * np.log(len(inside) / CHANCE)
    return loudest or float(np.mean(inside)) > (1 + STANDS_OUT / len(inside) ** 0.5) * floor, low, high


def at_the_top(Y: Complex, floor: float) -> float:
    """Motion of one channel at half the sampling rate, of its largest lines; 0 where it is noise of mean power `floor`.

    Y (N/2 + 1,) lines.  What moves there moves above, too, and that is folded back into all lines.
    """
    power = np.abs(Y) ** 2
    top = power[int(HIGHEST_LINES * len(Y)) :]
    if len(top) < 2 * BIN:
        return 0.0
    starts: Ints = np.arange(0, len(power) - BIN, BIN)
    largest = float(np.max(np.add.reduceat(power, starts)[:-1])) / BIN
    level, alike = float(np.mean(top)), STANDS_OUT / len(top) ** 0.5
    return (level / largest) ** 0.5 if level > floor * (1 + alike) and largest > 0 else 0.0


def _notices(record: Record, folded: Real) -> tuple[Notice, ...]:
    """That channels move above half the sampling rate, of which they show `folded` (channels,)."""
    names = [channel.name for channel, share in zip(record.channels, folded, strict=True) if share > FOLDED]
    if not names:
        return ()
    text = (
        f"{record.source}: {joined(names)} still {'move' if len(names) > 1 else 'moves'} at half the sampling rate "
        f"({100 * np.max(folded):.2g} % of the largest lines): what lies above is folded back, and values may be off "
        "by up to as much; sample faster, or through a filter against it"
    )
    return (Notice("folded", text, tuple(names)),)


def whole_records(
    records: Sequence[Record],
    *,
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
    polynomial: int = POLYNOMIAL,
    ramp: bool = False,
) -> Spectrum:
    """Lines of several records, each with boundary loads of its own; records are cut where samples are missing or held.

    Raises as `whole_record`.
    """
    notes: list[Notice] = []
    pieces: list[Record] = []
    for record in records:
        parts, told = without_gaps(record)
        notes += told
        for part in parts:
            moving, told = without_held_samples(part)
            notes += told
            for each in moving:
                piece, told = with_clipped_samples(each)
                pieces.append(piece)
                notes += told
    spectra = [
        whole_record(piece, band_hz=band_hz, still=still, polynomial=polynomial, ramp=ramp)
        for piece in pieces
    ]
    every = concatenate(spectra)
    used = sum(len(piece.time) for piece in pieces)
    low, high = float(np.min(every.frequency_hz)), float(np.max(every.frequency_hz))
    text = (
        f"{len(pieces)} whole record{'s' if len(pieces) > 1 else ''} of {used} samples: {every.lines} "
        f"line{'s' if every.lines > 1 else ''} from {low:.4g} to {high:.4g} Hz, transients at both "
        "ends estimated with the rest"
    )
    notes.append(Notice("whole_records", text))
    if band_hz is None and every.lines > MANY_LINES:
        gib = every.lines * len(every.channels) * BYTES / 2**30
        text = (
            f"the record rises above its noise up to {high:.4g} Hz: its {every.lines} lines take some {gib:.2g} GiB "
            "to identify; a band that ends just above the rig's highest mode gives the same result for less"
        )
        notes.append(Notice("many_lines", text))
    return replace(every, notes=(*every.notes, *notes))


def _aligned(record: Record, step: float) -> tuple[Record, tuple[Channel, ...]]:
    """The record with late channels shifted by whole samples, so that their ends belong together.

    The channels beside it have what is left of their delays, less than one sample.
    """
    shifts = np.array([round((channel.delay or 0.0) / step) for channel in record.channels])
    remaining = tuple(
        channel if not shift else replace(channel, delay=(channel.delay or 0.0) - shift * step)
        for channel, shift in zip(record.channels, shifts.tolist(), strict=True)
    )
    if not np.any(shifts):
        return record, remaining
    first = shifts - shifts.min()
    count = len(record.time) - int(first.max())
    if count < fewest_samples(record):
        raise DataError("a channel is later than the record is long", record.source, "correct its delay")

    def shifted(of: np.ndarray) -> np.ndarray:
        return np.stack([of[s : s + count, c] for c, s in enumerate(first)], axis=-1)

    sd, status = (None if of is None else shifted(of) for of in (record.sd, record.status))
    return replace(
        record, time=record.time[:count], values=shifted(record.values), sd=sd, status=status
    ), remaining


def _drift_shows(first: int, lines: int) -> bool:
    """Whether a linear drift is to be reckoned with: it is in the lowest lines, and few lines cannot spare one."""
    return first <= LOWEST and lines >= MANY


def _require_motion(record: Record) -> None:
    """Raises DataError where a channel stays at one value."""
    for c, channel in enumerate(record.channels):
        column = record.values[:, c]
        if np.ptp(column) == 0:
            raise DataError(
                f"{channel.name} stays at {column[0]:g} throughout",
                record.source,
                "check that the sensor is connected, or leave the channel out of the rig file; an input that stays "
                "at rest during a free decay is ground, not an input",
            )


def leaked_by_a_step(column: Real) -> Complex:
    """What the step from the last sample (N,) back to the first puts into the lines, (N/2 + 1,)."""
    samples = len(column)
    turn = np.exp(-2j * np.pi * np.arange(1, samples // 2 + 1) / samples)
    leaked = np.zeros(samples // 2 + 1, dtype=np.complex128)
    leaked[1:] = 2 * (column[-1] - column[0]) / (samples - 1) / (turn - 1)
    return leaked


def without_leakage(Y: Complex) -> Real:
    """Power of neighbouring lines (k,) of a record without what its ends leak into them, (k − 2,).

    A record that ends elsewhere than it began leaks into all lines, smoothly from one to the next: second differences
    have none of it, and six times the power of what is independent from line to line.
    """
    return np.abs(np.diff(Y, 2)) ** 2 / 6


def white_floor(power: Real) -> float:
    """E[Δ Δ*] of white noise, from the power (N/2 + 1,) of the lines of one channel near half the sampling rate.

    0 where they are not flat, or not far below the others: then they show motion, and tell nothing of the noise.
    """
    top = power[int(TOP[0] * len(power)) : int(TOP[1] * len(power))]
    halves = np.array_split(top, 2)
    if len(top) < 2 * BIN:
        return 0.0
    low, high = (float(np.mean(half)) for half in halves)
    level = (low + high) / 2
    even = abs(low - high) <= STANDS_OUT * ALIKE * level * 2 / len(top) ** 0.5
    return level if even and level < FAR_BELOW * float(np.mean(power[1:])) else 0.0


def _moving(X: Complex, source: str, highest_hz: float) -> int:
    """How many of the lines are kept: up to the last bin in which some channel stands out of its floor.

    Raises DataError where none does in any part of the band up to `highest_hz`.
    """
    lines = len(X)
    each = max(BIN, -(-lines // BINS))
    if lines < 3 * each:
        return lines
    power = np.abs(X) ** 2
    edges: Ints = np.arange(0, lines - each + 1, each)
    mean = np.add.reduceat(power[: edges[-1] + each], edges, axis=0) / each
    floor = np.quantile(mean[-max(3, len(mean) // 4) :], 0.25, axis=0)
    out = np.flatnonzero(np.any(mean > (1 + STANDS_OUT / each**0.5) * floor, axis=-1))
    if not len(out):
        raise DataError(
            f"no channel moves more in one part of the band up to {highest_hz:.4g} Hz than in another: there is no "
            "signal in it",
            source,
            "check that the rig was driven while this was recorded; where all of the band is driven alike, state it",
        )
    return min(lines, int((out[-1] + 2) * each))
