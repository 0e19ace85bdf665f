"""Dwells whose transients are still in them, without these or used as records with their own loads.

A dwell of any number of periods, whole or not, is a whole record too (THEORY §8), and dwells that follow each other
without a gap are one.  Long settled dwells lose nothing by harmonic regression and are cheaper by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.clock import FEWEST_OF_A_DWELL, even_step
from dashpot.data.conditioning.harmonic_fit import SIGNIFICANT, fit_harmonics
from dashpot.data.conditioning.regression import Terms, duration, solve_harmonics
from dashpot.data.conditioning.steadiness import period_blocks, periods_of
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.noise import Still
from dashpot.data.record import MISSING, Record, kept, real_factor
from dashpot.data.spectrum import Spectrum, WholeRecord, concatenate
from dashpot.errors import DataError
from dashpot.notices import Notice

# The part of a dwell that is driven and where the transient has decayed.


@dataclass(frozen=True)
class Settled:
    """The part of a dwell that is driven and where the transient has decayed, and what was thrown away around it.

    `note` says so in words; it is None where nothing was thrown away and a transient would have been seen.
    """

    record: Record
    dropped_samples: int
    dropped_s: float
    note: Notice | None


def settled(record: Record) -> Settled:
    """The part of a dwell that is driven, after its transient.

    Blocks of whole periods, counted from the end, give amplitudes and residuals.  The longest run of blocks with more
    than half of the greatest lasting amplitude is what was driven.  Within it the cut is where the mean of what
    remains is known best (White's marginal standard error rule, Simulation 69, 1997), at most half way, and only if
    what comes before it differs significantly (p < 0.01) from what comes after.  A small error of the frequency does
    not matter.  Raises DataError where the frequency is not known.
    """
    f, time = record.frequency_hz, record.time
    if f is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    blocks = period_blocks(record)
    if blocks is None:
        periods = int(f * duration(time) + 1e-6)
        text = (
            f"{record.source}: {periods} periods at {f:g} Hz are too few to detect a transient, or have gaps"
        )
        return Settled(record, 0, 0.0, Notice("transient_undetectable", text, (record.source,)))
    starts, Z, rms = blocks.starts, blocks.amplitudes, blocks.rms
    begin, end = _driven(Z)
    if end - begin >= 8:
        # Features of blocks, in units of their scatter over the last half: amplitudes turned by the phase of the
        # steadiest channel, which makes them blind to a small error of the frequency, and residual rms
        Z = Z[begin:end]
        tail = len(Z) // 2
        size = np.median(np.abs(Z), axis=0)
        floor = np.maximum(1e-9 * size, 1e-13 * float(np.max(np.abs(record.values)))) + np.finfo(float).tiny
        steady = int(np.argmax(size / np.maximum(np.std(np.abs(Z[tail:]), axis=0), floor)))
        turned = Z * np.exp(-1j * np.angle(Z[:, steady]))[:, None]
        values = np.concatenate([turned.real, turned.imag, rms[begin:end]], axis=1)
        scatter = np.maximum(np.std(values[tail:], axis=0, ddof=1), np.tile(floor, 3))
        begin += _truncation((values - np.mean(values[tail:], axis=0)) / scatter)
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


@kept
def driven_throughout(record: Record) -> bool:
    """Whether a dwell moves from its first period to its last; True where it has too few periods to tell."""
    blocks = period_blocks(record) if record.values.ndim == 2 else None
    if blocks is None:
        return True
    Z = blocks.amplitudes
    noise = np.median(blocks.rms, axis=0) * np.sqrt(4 / np.min(blocks.ends - blocks.starts))
    heard = (
        _level(np.abs(Z)) > 6 * noise
    )  # standard deviations of a block's amplitude: no other channel tells
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


SHORT = 200  # lines: below it two polynomial columns serve


def continuous(records: Sequence[Record]) -> list[Record]:
    """Blocks that follow each other by one step of time put together, as records without a frequency."""
    groups: list[list[Record]] = []
    for record in records:
        if groups and _follows(groups[-1][-1], record):
            groups[-1].append(record)
        else:
            groups.append([record])
    return [
        group[0]
        if len(group) == 1
        else replace(
            group[0],
            time=np.concatenate([record.time for record in group]),
            values=np.concatenate([record.values for record in group], axis=-2),
            frequency_hz=None,
        )
        for group in groups
    ]


def _follows(first: Record, second: Record) -> bool:
    """Whether the second record goes on one step after the first, as the same experiment."""
    if first.channels != second.channels or first.experiment != second.experiment:
        return False
    if first.values.shape[:-2] != second.values.shape[:-2] or min(len(first.time), len(second.time)) < 2:
        return False
    step = float(np.median(np.diff(first.time)))
    after = float(second.time[0] - first.time[-1])
    alike = abs(float(np.median(np.diff(second.time))) - step) <= 0.01 * step
    return alike and abs(after - step) <= step / 2


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
                f"record at least {FEWEST_OF_A_DWELL} samples, or wait until it has settled",
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
    text = f"{dwells} {why}: all samples are used, and start and end transients are estimated"
    joined = concatenate(spectra)
    return replace(joined, notes=(Notice("dwells_with_transients", text),))


def _with_sine_floor(lines: Spectrum, record: Record) -> Spectrum:
    """The noise of each channel from what a sine leaves over, where that is less than its floor or there is none.

    Beside a slope and harmonics amplitude and phase of the sine follow a polynomial of fewer degrees than it has
    periods, that neither harmonics nor slopes can look like.
    """
    f, samples = record.frequency_hz, len(record.time)
    if f is None:
        return lines
    if record.status is not None:  # what stands for samples that are clipped is no limit any more
        record = replace(record, status=np.where(record.status == 0, 0, MISSING))
    try:
        orders = fit_harmonics(record, orders=(1,), drift=1, noise="white").orders
        # 8: degree that is enough for any drive
        bends = min(8, int(periods_of(record)), (samples - 2 - 2 * len(orders)) // 6)
        found = solve_harmonics(record, f, Terms(1, orders, max(bends, 0)))
    except DataError:
        return lines
    residual = (
        np.diagonal(found.covariance[0])
        * 4
        / samples
        / np.array([real_factor(channel) for channel in record.channels]) ** 2
    )
    floor = np.diagonal(lines.covariance[0]).real
    variance = np.where(floor > 0, np.minimum(floor, residual), residual)
    V = np.broadcast_to(np.diag(variance).astype(np.complex128), lines.covariance.shape)
    return replace(lines, covariance=V)
