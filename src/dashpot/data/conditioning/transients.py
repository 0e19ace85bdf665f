"""Dwells whose transients are still in them: found by one test of all dwells, and used as records with their own loads.

Dwells too short for that test are given both ways, for a fit to decide (`Spectrum.unsettled`).

A dwell of any number of periods, whole or not, is a whole record too (THEORY §8), and dwells that follow each other
without a gap are one.  Long settled dwells lose nothing by harmonic regression and are cheaper by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import chdtrc, chdtri, fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real, freeze
from dashpot.data.conditioning.clock import FEWEST_OF_A_DWELL, even_step
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.regression import (
    CHUNK,
    basis,
    duration,
    exact_channels,
    holds_a_period,
    solve_harmonics,
    window,
)
from dashpot.data.conditioning.still import Still
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, WholeRecord, concatenate
from dashpot.errors import DataError
from dashpot.notices import Notice

# A dwell cut into blocks of whole periods: what each channel does in each of them.


MOST = 32  # blocks, of more periods each where there are many
FEWEST = 8
SAMPLES = 8  # that a block has on average, at least


@dataclass(frozen=True)
class PeriodBlocks:
    """Blocks of whole periods, counted from the end of a dwell.

    starts, ends (blocks,): the first sample of each and the one after its last
    amplitudes, rms (blocks, batch · channels): of the sine at the drive frequency, and of what it leaves, SI units
    """

    starts: Ints
    ends: Ints
    amplitudes: Complex
    rms: Real

    def __post_init__(self) -> None:
        freeze(self)


def period_blocks(record: Record, f: float) -> PeriodBlocks | None:
    """The blocks at f Hz, kept with the record; None where its periods are too few, or have gaps."""
    key = (period_blocks, f)
    if key not in record.kept:
        edges = _edges(record.time, f)
        record.kept[key] = None if edges is None else _blocks(Sines.of(record, f, *edges), *edges)
    blocks = record.kept[key]
    assert blocks is None or isinstance(blocks, PeriodBlocks)
    return blocks


def _blocks(sines: Sines, starts: Ints, ends: Ints) -> PeriodBlocks:
    return PeriodBlocks(starts, ends, sines.amplitudes, np.sqrt(sines.squares / (sines.free + 3)))


def _edges(time: Real, f: float) -> tuple[Ints, Ints] | None:
    """Where the blocks start and end."""
    periods = int(f * duration(time) + 1e-6)
    each = max(1, periods // MOST, int(np.ceil(SAMPLES * periods / len(time))))
    blocks = periods // each
    if blocks < FEWEST:
        return None
    step = (time[-1] - time[0]) / (len(time) - 1)
    starts = np.searchsorted(time, time[-1] + step - (each / f) * np.arange(blocks, 0, -1) - step / 4)
    ends = np.append(starts[1:], len(time))
    return None if np.min(ends - starts) < 4 else (starts, ends)


@dataclass(frozen=True)
class Sines:
    """An offset and a sine at f Hz in each of some pieces of a dwell, by the samples measured.

    amplitudes; squares that are left over; spread of an amplitude per unit variance of a sample; free degrees of
    freedom: (pieces, batch · channels)
    """

    amplitudes: Complex
    squares: Real
    spread: Real
    free: Real

    @staticmethod
    def of(record: Record, f: float, starts: Ints, ends: Ints) -> Sines:
        """Pieces from one sample to the one before another.  Raises LinAlgError where the terms are not to be told."""
        longest = int(np.max(ends - starts))
        each = max(1, CHUNK // longest)
        parts = [
            _sines(record, f, starts[k : k + each], ends[k : k + each], longest)
            for k in range(0, len(starts), each)
        ]
        return Sines(*(np.concatenate(of) for of in zip(*parts, strict=True)))


def _sines(
    record: Record, f: float, starts: Ints, ends: Ints, longest: int
) -> tuple[Complex, Real, Real, Real]:
    rows = starts[:, None] + np.arange(longest)
    inside = rows < ends[:, None]
    rows = np.where(inside, rows, 0)
    cycles = f * record.time[rows]
    turn = 2 * np.pi * (cycles - np.floor(cycles))
    A = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=-1) * inside[..., None]
    y = np.moveaxis(record.values[..., rows, :], -1, -3).reshape(-1, *rows.shape).swapaxes(0, 1)
    y = y - np.mean(y, axis=-1, keepdims=True)
    counts, B = inside[:, None], A[:, None]  # (pieces, channels or 1, samples, terms)
    if record.status is not None:
        counts = np.moveaxis(record.status[rows] == 0, -1, 1) & counts
        B = B * counts[..., None]
    P = np.linalg.pinv(np.swapaxes(B, -1, -2) @ B, rcond=1e-12, hermitian=True)
    c = (P @ (np.swapaxes(B, -1, -2) @ y[..., None]))[..., 0]
    left = (y - (A[:, None] @ c[..., None])[..., 0]) * counts
    free = np.broadcast_to(np.sum(counts, axis=-1) - 3.0, c.shape[:2])
    spread = np.broadcast_to(P[..., 1, 1] + P[..., 2, 2], c.shape[:2])
    return c[..., 1] - 1j * c[..., 2], np.sum(left**2, axis=-1), spread, free


# The part of a dwell that is driven and where the transient has decayed.


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
    kept = record.part(slice(first, last))
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
    return record.part(slice(first, None))


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
    return np.max(np.min(np.lib.stride_tricks.sliding_window_view(size, 4, axis=0), axis=-1), axis=0)


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
    return (values - np.mean(values[tail:], axis=0)) / scatter


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


# Whether dwells drift: one test of the slopes of all dwells and channels together (THEORY §11).
#
# A slope that is taken out of a dwell of one period costs up to a half of its standard deviation, of five
# periods 1 %; one that is left in spoils the amplitude. So it is taken out of short dwells where they show
# it, and of long ones always.


LEVEL = 0.05  # of the test: a slope too many costs less than one too few
CHEAP = 5.0  # periods from which on a slope costs nothing


def slope_costs(records: Sequence[Record]) -> bool:
    """Whether some dwell is so short that solving for a slope widens its amplitudes."""
    return any(periods_of(record) < CHEAP for record in records)


def slopes_show(records: Sequence[Record], orders: Sequence[int]) -> float:
    """p-value of no drift in any dwell or channel: F of each slope, as normal squares, pooled; 1 without evidence.

    Each F has the degrees of freedom of its own residual, so that few samples do not make it too large.
    """
    total, count = 0.0, 0
    for record in records:
        if record.frequency_hz is None:
            continue
        try:
            solution = solve_harmonics(record, record.frequency_hz, tuple(orders), 1)
        except DataError:
            continue
        if np.min(solution.free) < 1:
            continue
        exact = exact_channels(solution.covariance, solution.amplitudes(1), solution.largest)
        tail = fdtrc(1, solution.free, solution.wald((1,)))[~exact]
        total += float(np.sum(chdtri(1, np.maximum(tail, 1e-250))))
        count += int(np.sum(~exact))
        far = np.abs(solution.coefficients[:, 1][exact]) > 1e-9 * solution.largest[exact]
        if np.any(far):
            return 0.0
    return float(chdtrc(count, total)) if count else 1.0


LEVEL_TRANSIENTS = 1e-3  # of the test for transients
EXACT = 1e-9  # of a channel's size: what scatters less is rounding, and says nothing of transients
MANY_PERIODS = 8  # from which on the scatter of the later ones is a better measure of the noise
MOST_A_PERIOD = 1e9  # samples, beyond which the stamps of the record are damaged
CLEAR = 6.0  # standard deviations of a change that no drift of a sensor makes: one of them is enough
SEEN = 3.0  # and of changes that are transients where there are many
MANY = 0.1  # of all dwells and channels
SLIGHT = 3e-3  # of an amplitude: what a transient may leave in it of a long dwell
SLIGHT_IN_FEW = 5e-4  # and in a short one, whose noise does not contain it
FEWEST_A_BLOCK = 6  # samples, for amplitudes of single periods with a residual
SHORT = 200  # lines: below it two polynomial columns serve
COMPARED = 2.0  # periods from which on a dwell's first can be set against its last
MOST_BENDS = 8  # degree of the polynomials that amplitude and phase of a sine may follow
BENT = 3  # degree of the polynomials that a dwell shorter than that may be bent by
BESIDE, MANY_SAMPLES = (1, 2, 3), 24  # multiples solved for beside them, from so many samples on
WITHIN = 0.5  # of a step: a block that follows after one step belongs to the same record


def continuous(records: Sequence[Record]) -> list[Record]:
    """Blocks that follow each other by one step of time put together, as records without a frequency."""
    groups: list[list[Record]] = []
    for record in records:
        if groups and _follows(groups[-1][-1], record):
            groups[-1].append(record)
        else:
            groups.append([record])
    return [group[0] if len(group) == 1 else _joined(group) for group in groups]


def _follows(first: Record, second: Record) -> bool:
    """Whether the second record goes on one step after the first, as the same experiment."""
    if first.channels != second.channels or first.experiment != second.experiment:
        return False
    if first.values.shape[:-2] != second.values.shape[:-2] or min(len(first.time), len(second.time)) < 2:
        return False
    step = float(np.median(np.diff(first.time)))
    after = float(second.time[0] - first.time[-1])
    alike = abs(float(np.median(np.diff(second.time))) - step) <= 0.01 * step
    return alike and abs(after - step) <= WITHIN * step


def _joined(group: list[Record]) -> Record:
    return replace(
        group[0],
        time=np.concatenate([record.time for record in group]),
        values=np.concatenate([record.values for record in group], axis=-2),
        frequency_hz=None,
    )


def transients_matter(records: Sequence[Record]) -> bool:
    """Whether dwells have transients that spoil amplitudes: significant together, and large in some dwells' channels.

    What a long dwell shows in its first period hardly reaches its amplitude, and the noise beside its line contains it.
    """
    changes = first_to_last(records)
    pairs = sum(len(change.variance) for change in changes)
    clear = any(np.any(change.spoiled(CLEAR)) for change in changes)
    many = sum(int(np.sum(change.spoiled(SEEN))) for change in changes) > MANY * pairs
    return (clear or many) and transients_show(changes) < LEVEL_TRANSIENTS


def short_dwells_bend(records: Sequence[Record]) -> bool:
    """Whether dwells of less than two periods are no steady sines: together, and more than a few of all dwells.

    Their first period cannot be set against their last.  A transient, or a frequency that is off, bends the offset and
    lets amplitude and phase run: two more polynomials and the sine times time, beside harmonics where there are samples
    enough, explain more of the residual than noise would (F of each channel, pooled).
    """
    tails = [tail for tail in map(_bent, records) if tail is not None]
    if not tails:
        return False
    normal = chdtri(1, np.maximum(np.concatenate(tails), 1e-250))
    bent = sum(bool(np.any(tail < LEVEL_TRANSIENTS / len(tail))) for tail in tails)
    return bent > MANY * len(records) and float(chdtrc(len(normal), float(np.sum(normal)))) < LEVEL_TRANSIENTS


def _bent(record: Record) -> Real | None:
    """p-values (channels,) of a short dwell's noisy channels being steady sines; None where it cannot be told."""
    f = record.frequency_hz
    if f is None or record.values.ndim != 2 or not f * duration(record.time) < COMPARED:
        return None
    orders = BESIDE if len(record.time) >= MANY_SAMPLES else (1,)
    terms = BENT + 3 + 2 * len(orders)
    if len(record.time) - terms < 2:
        return None
    try:
        solution = solve_harmonics(record, f, orders, BENT, ramps=True)
    except DataError:
        return None
    noisy = solution.squares[0].diagonal() > len(record.time) * (EXACT * solution.largest[0]) ** 2
    tail = fdtrc(BENT + 1, solution.free, solution.wald((*range(2, BENT + 1), -2, -1))[0])
    return np.asarray(tail[noisy]) if np.any(noisy) else None


def taken_as_settled(records: Sequence[Record]) -> list[Notice]:
    """What is to be said where dwells count as settled, of those that have not and those too short to show it."""
    dwells = [record for record in records if record.frequency_hz is not None and record.values.ndim == 2]
    if transients_matter(dwells) or short_dwells_bend(dwells):
        return [Notice("transients_ignored", "the dwells have not settled, but are treated as settled")]
    brief = tuple(record.source for record in dwells if not shows_settling(record))
    if not brief:
        return []
    which, them = ("one dwell is", "it") if len(brief) == 1 else (f"{len(brief)} dwells are", "them")
    text = f"{which} too short to show whether a transient is in {them}: taken as settled"
    return [Notice("transient_undetectable", text, brief)]


@dataclass(frozen=True)
class DwellChange:
    """How the amplitudes of a dwell's channels change from its first period to its last.

    difference, variance E|Δ|² and amplitude (channels,) of those with noise, residual degrees of freedom of a channel
    """

    difference: Complex
    variance: Real
    amplitude: Real
    dof: int
    periods: int

    def spoiled(self, beyond: float) -> Bools:
        """(channels,): changes `beyond` so many sd that, spread over all periods, are more than gains are known to."""
        change = np.abs(self.difference)
        share = change / (np.maximum(self.amplitude, 1e-300) * self.periods)
        slight = SLIGHT if self.periods >= MANY_PERIODS else SLIGHT_IN_FEW
        return (share > slight) & (change > beyond * np.sqrt(self.variance))


def transients_show(changes: Sequence[DwellChange]) -> float:
    """p-value of all changes being noise (pooled F); 1 where no dwell has two periods to compare."""
    apart = sum(2 * float(np.sum(np.abs(change.difference) ** 2 / change.variance)) for change in changes)
    spread = sum(2 * len(change.variance) for change in changes)
    freedom = sum(change.dof * len(change.variance) for change in changes)
    if not spread or freedom < 4:
        return 1.0
    return float(fdtrc(spread, freedom, apart / spread))


def first_to_last(records: Sequence[Record]) -> list[DwellChange]:
    """The changes of the amplitudes of those dwells that have two periods to compare."""
    return [change for change in map(_first_to_last, records) if change is not None]


def shows_settling(record: Record) -> bool:
    """Whether a dwell has a first and a last block of whole periods, whose comparison tells if it has settled."""
    return _block(record) is not None


def _block(record: Record) -> tuple[int, int] | None:
    """Samples and periods of the shortest block that gives an amplitude; None where no two fit into the dwell."""
    if record.frequency_hz is None or record.values.ndim != 2:
        return None
    period = 1 / record.frequency_hz
    step = float(record.time[-1] - record.time[0]) / (len(record.time) - 1)
    if not 2 * step < period < step * MOST_A_PERIOD:
        return None
    periods = max(1, int(np.ceil((FEWEST_A_BLOCK - 0.5) * step / period)))
    each = round(periods * period / step)
    return (each, periods) if len(record.time) >= 2 * each else None


def _first_to_last(record: Record) -> DwellChange | None:
    """The change of a dwell's amplitudes, kept with the record; None where it has no two blocks to compare."""
    if _first_to_last not in record.kept:
        record.kept[_first_to_last] = _change(record)
    return cast("DwellChange | None", record.kept[_first_to_last])


def _change(record: Record) -> DwellChange | None:
    block = _block(record)
    if block is None:
        return None
    each, periods = block
    count = len(record.time) // each
    later = count - count // 2 if count >= MANY_PERIODS else 0
    starts = [0, *(len(record.time) - each * k for k in range(max(later, 1), 0, -1))]
    # The record without the slope that it has beside its sine: seen through a period at another phase, that
    # looks like a change of amplitude
    f = record.frequency_hz or 0.0
    try:
        slope = solve_harmonics(record, f, (1,), 1).coefficients[0, 1]
    except DataError:
        return None
    centre, half = window(record.time)
    record = replace(record, values=record.values - ((record.time - centre) / half)[:, None] * slope)
    first = np.array(starts)
    if not all(holds_a_period(record.time[start : start + each], f) for start in starts):
        return None
    sines = Sines.of(record, f, first, first + each)
    difference = sines.amplitudes[0] - sines.amplitudes[-1]
    if later:
        # The scatter of the later periods knows the colour of the noise.
        variance = 2 * np.var(sines.amplitudes[1:], axis=0, ddof=1)
        dof = 2 * (later - 1)
    else:
        # What a sine leaves of the first period is no noise: a transient that decays in it would hide itself.
        dof = each * (count - 1) - 3
        rest = Sines.of(record, f, np.array([len(record.time) - dof - 3]), np.array([len(record.time)]))
        free = rest.free[0]
        if dof < 1 or np.min(free) < 1:
            return None
        variance = 2 * rest.spread[0] * rest.squares[0] / free * (count - 1)
        # Of channels with fewer degrees of freedom the variance by which F has the same p-value with those of all
        few = np.flatnonzero((free < dof) & (variance > 0) & (difference != 0))
        F = np.abs(difference[few]) ** 2 / variance[few]
        variance[few] *= F / (dof / 2 * np.expm1(free[few] / dof * np.log1p(2 * F / free[few])))
    noisy = variance > (EXACT * np.max(np.abs(record.values), axis=0)) ** 2
    size = np.abs(sines.amplitudes[-1][noisy])
    return DwellChange(difference[noisy], variance[noisy], size, dof, count * periods)


def dwells_with_transients(
    records: Sequence[Record],
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
    *,
    why: str = "not settled",
    slopes: bool = False,
) -> Spectrum:
    """Lines of each dwell with boundary loads of its own, and a column for a slope of each output where `slopes`.

    A note says `why`.  Raises as `whole_record`.
    """
    spectra = []
    for record in records:
        if len(record.time) < FEWEST_OF_A_DWELL:
            raise DataError(
                f"a dwell of {len(record.time)} samples is too short to separate its transient from its motion",
                record.source,
                f"record {FEWEST_OF_A_DWELL} samples at least, or wait until it has settled",
            )
        even_step(record)
        lines = whole_record(record, band_hz=band_hz, still=still)
        if lines.lines < SHORT:
            lines = whole_record(record, band_hz=band_hz, still=still, polynomial=2)
        (whole,) = (value for value in lines.stretches if isinstance(value, WholeRecord))
        dwell = replace(whole, drive_hz=record.frequency_hz, ramp=slopes)
        lines = replace(lines, stretches=(dwell,))
        spectra.append(_with_sine_floor(lines, record) if still is None else lines)
    dwells = "one dwell is" if len(spectra) == 1 else f"{len(spectra)} dwells are"
    text = f"{dwells} {why}: all samples are used, the transients at both ends being estimated"
    joined = concatenate(spectra)
    return replace(joined, notes=(Notice("dwells_with_transients", text),))


def _with_sine_floor(lines: Spectrum, record: Record) -> Spectrum:
    """The noise of each channel from what a sine leaves over, where that is less than its floor or there is none."""
    if record.frequency_hz is None:
        return lines
    try:
        residual = _beside_the_sine(record, record.frequency_hz) * 4 / len(record.time)
    except DataError:
        return lines
    factor = np.abs(np.array([(c.gain or 1.0) * (c.sign or 1.0) for c in record.channels])) ** 2
    floor = np.diagonal(lines.covariance[0]).real
    variance = np.where(floor > 0, np.minimum(floor, residual / factor), residual / factor)
    V = np.broadcast_to(np.diag(variance).astype(np.complex128), lines.covariance.shape)
    return replace(lines, covariance=V)


def _beside_the_sine(record: Record, f: float) -> Real:
    """Variance of a sample, (channels,), beside a slope, harmonics, and a sine whose amplitude and phase may drift.

    By a polynomial of fewer degrees than it has periods, that neither harmonics nor slopes can look like.
    """
    fit = fit_harmonics(record, orders=(1,), drift=1, noise="white")
    variance: Real = np.diagonal(fit.residual_covariance).real.copy()
    samples, terms = len(record.time), 2 + 2 * len(fit.orders)
    degree = min(MOST_BENDS, int(fit.periods), (samples - terms) // 6)
    if degree < 1 or samples > CHUNK:
        return variance
    steady = basis(record.time, f, fit.orders, 1, *window(record.time))
    bends = legvander(np.linspace(-1, 1, samples), degree)[:, 1:]
    A = np.concatenate([steady, steady[:, 2:3] * bends, steady[:, 3:4] * bends], axis=1)
    for c, y in enumerate(record.values.T):
        measured = slice(None) if record.status is None else record.status[:, c] == 0
        rows, some = A[measured], y[measured]
        if len(some) > A.shape[1]:
            rest = some - rows @ np.linalg.lstsq(rows, some, rcond=None)[0]
            variance[c] = rest @ rest / (len(some) - A.shape[1])
    return variance
