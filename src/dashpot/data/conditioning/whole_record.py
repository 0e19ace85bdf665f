"""Whole records: all samples of any excitation become lines k/T that share the record's boundary loads (THEORY §8).

Nothing has to settle, to repeat or to end where it began: what the ends of the record leave in its lines is smooth in
frequency, a load a + jωb at every coordinate and a few real polynomial columns in each channel, and the likelihood
solves for it.  Here the samples are checked, put through one FFT, and limited to the band in which something moves.

A dwell of any number of periods, whole or not, is a whole record too, and dwells that follow each other without a gap
are one.  Long settled dwells lose nothing by harmonic regression and are cheaper by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy import fft

from dashpot.arrays import Bools, Complex, Ints, Real, diagonal_matrices
from dashpot.channel import Channel
from dashpot.data.conditioning.clock import (
    GAP,
    even_step,
    fewest_samples,
    with_even_stamps,
)
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.regression import Terms, solve_harmonics
from dashpot.data.conditioning.unmeasured import (
    MOST_MISSING,
    MOST_UNKNOWN,
    SHORTEST,
    marked_whole,
    told_by_lines,
    with_likely,
)
from dashpot.data.noise import (
    BIN,
    FAR_BELOW,
    LEVEL,
    STANDS_OUT,
    Still,
    variance_at_rest,
    white_floor,
    without_leakage,
)
from dashpot.data.periods import ROUNDING, driven_lines, driven_note
from dashpot.data.record import MISSING, Record, calibrated, real_factor
from dashpot.data.spectrum import Spectrum, Unmeasured, WholeRecord, concatenate
from dashpot.errors import DataError
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

SLIP = 0.1  # of a step: where the next sample is early or late by more, the clock has slipped
UNEVEN = 0.02  # share of gaps from which on they are the clock's
HIGHEST = 0.9  # of half the sampling rate: above it the input between the samples is not known well enough
POLYNOMIAL = 4  # columns 1, jω, (jω)², … of each output channel: the fourth takes the error down by twenty
AT_REST = "rest"  # kind of noise: as a record with nothing driven shows it
FLOOR = "floor"  # kind of noise: white, as the top of the spectrum shows it, until residuals show more
HIGHEST_LINES = 0.96  # of half the sampling rate: a recorder's filter leaves nothing above
MANY_LINES = 300_000  # from which on a narrower band is worth stating


def without_gaps(record: Record, *, split: bool = False) -> tuple[list[Record], tuple[Notice, ...]]:
    """The record with rows of unknown samples where some are missing, or cut there, and where its clock slips; a note.

    It is cut where too many are missing, or not a whole number of steps, or to `split`.  Pieces too short to use are
    left out.

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
    whole = None if slipped or split else _with_unknown_rows(record, np.rint(steps / usual).astype(np.int64))
    if whole is not None:
        count = len(whole.time) - len(record.time)
        text = f"{counted(count, 'sample')} missing before {at}: treated as unknown"
        return [whole], (record.notice("gaps", text),)
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
            f"the record has {counted(len(cuts), 'gap')}, and no segment between them has {SHORTEST} samples",
            record.source,
            "give the record without gaps",
        )
    dropped = f", {lost} samples of short segments dropped" if lost else ""
    what = "the clock slips" if slipped else "samples are missing"
    text = f"{what} before {at}: split into {len(pieces)} segments{dropped}"
    return pieces, (record.notice("gaps", text),)


def _with_unknown_rows(record: Record, steps: Ints) -> Record | None:
    """The record with a row for each sampling step; `steps` (rows − 1,): how many from row to row.

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


def whole_record(
    record: Record,
    *,
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
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
    refuse_rest(record)
    first, last = _lines_of(record.source, band_hz, samples, step)
    record, known = with_likely(record)
    X, floor, folded = _amplitudes(record, first, last, stated=band_hz is not None)
    if band_hz is None:
        X = X[: _moving(X, record.source, last / duration)]
        last = first + len(X) - 1
    frequency = np.arange(first, last + 1) / duration
    lines, channels = X.shape
    if still is None:
        V = np.broadcast_to(diagonal_matrices(floor), (lines, channels, channels))
        kind, dof = FLOOR, 2.0 * lines
    else:
        V, kind, dof = still.covariance(frequency, samples), AT_REST, still.dof
    if any(channel.factor != 1 or channel.delay for channel in remaining):
        X, V = calibrated(remaining, frequency, X, V)
    names = [channel.name for channel, share in zip(record.channels, folded, strict=True) if share > 0.01]
    text = (
        f"{record.source}: aliasing: {joined(names)} still {'move' if len(names) > 1 else 'moves'} at half the "
        f"sampling rate ({100 * np.max(folded):.2g} % of the largest lines), and values may be off by as much; "
        "sample faster, or use an anti-aliasing filter"
    )
    aliased = [Notice("folded", text, tuple(names))] if names else []
    # What is known of samples that are not measured: of each by itself, and by lines above the last, of noise alone
    at = {c: np.flatnonzero(record.marks()[:, c]) for c in known}
    unmeasured = tuple(
        Unmeasured(remaining[c], at[c], *told_by_lines(record.values[:, c], at[c], last, own))
        for c, own in known.items()
    )
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
        notes=(*aliased, *driven_note(record.source, lines, first + np.flatnonzero(driven_lines(X)))),
        stretches=(
            WholeRecord(
                duration,
                samples,
                polynomial=POLYNOMIAL,
                # A drift is felt in the ten lowest lines, and 200 can spare a column for it
                ramp=ramp and first <= 10 and lines >= 200,
                unmeasured=unmeasured,
            ),
        ),
    )


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
            f"the motion is between {low / duration:.3g} and {high / duration:.3g} Hz: " if high > low else ""
        )
        raise DataError(
            f"no motion above the noise between {first / duration:.4g} and {last / duration:.4g} Hz, the band "
            "asked for",
            record.source,
            f"{where}set --band there, or leave it out",
        )
    return X, floor, folded


def _stands_out(mean: Real | float, floor: Real | float, lines: int) -> Bools:
    """Whether mean powers of so many lines are beyond those of noise of mean power `floor`."""
    return np.asarray(mean > (1 + STANDS_OUT / lines**0.5) * floor)


def _bins(power: Real, lines: int = BIN) -> Real:
    """Mean power (bins, ...) of so many neighbouring lines (lines, ...) each."""
    count = len(power) // lines
    return np.asarray(np.mean(power[: count * lines].reshape(count, lines, *power.shape[1:]), axis=1))


def _motion_in(Y: Complex, floor: float, first: int, last: int) -> tuple[bool, float, float]:
    """Whether a channel moves in some of its lines, and the first and last line of its motion (inf and 0 of none).

    Y (N/2 + 1,) lines.  Without a floor, a mean power `floor` of noise, lines move that are not far below the largest.
    """
    power = np.abs(Y) ** 2
    power[0] = 0.0
    inside = power[first : last + 1]
    if floor == 0:
        moves = power > (FAR_BELOW**2) * np.max(power)
        at = np.flatnonzero(moves)
        return bool(np.any(moves[first : last + 1])), float(at[0]), float(at[-1])
    out = np.flatnonzero(_stands_out(_bins(power[1:]), floor, BIN))
    low, high = (1.0 + BIN * out[0], 1.0 + BIN * (out[-1] + 1)) if len(out) else (np.inf, 0.0)
    # Few lines, or few loud ones among many, may be a resonance.
    loudest = float(np.max(inside)) > floor * np.log(len(inside) / LEVEL)
    return loudest or bool(_stands_out(np.mean(inside), floor, len(inside))), float(low), float(high)


def at_the_top(Y: Complex, floor: float) -> float:
    """Motion of one channel at half the sampling rate, of its largest lines; 0 where it is noise of mean power `floor`.

    Y (N/2 + 1,) lines.  What moves there moves above, too, and that is folded back into all lines.
    """
    power = np.abs(Y) ** 2
    top = power[int(HIGHEST_LINES * len(Y)) :]
    if len(top) < 2 * BIN:
        return 0.0
    level, largest = float(np.mean(top)), float(np.max(_bins(power)))
    return (level / largest) ** 0.5 if _stands_out(level, floor, len(top)) and largest > 0 else 0.0


def whole_records(
    records: Sequence[Record],
    *,
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
    ramp: bool = False,
    marks: bool = True,
) -> Spectrum:
    """Lines of several records, each with boundary loads of its own; records are cut where too many samples miss.

    marks: samples that channels hold, miss or clip are found and count as not measured.  Raises as `whole_record`.
    """
    notes: list[Notice] = []
    pieces: list[Record] = []
    for given in records:
        record, rounded = with_even_stamps(given)
        parts, told = without_gaps(record)
        notes += (*([] if rounded is None else [rounded]), *told)
        for part in parts:
            each, told = marked_whole(part) if marks else ([part], ())
            pieces += each
            notes += told
    spectra = [whole_record(piece, band_hz=band_hz, still=still, ramp=ramp) for piece in pieces]
    every = concatenate(spectra)
    used = sum(len(piece.time) for piece in pieces)
    low, high = float(np.min(every.frequency_hz)), float(np.max(every.frequency_hz))
    text = (
        f"{len(pieces)} continuous record{'s' if len(pieces) > 1 else ''} ({used:,} samples in total): "
        f"{every.lines:,} frequency line{'s' if every.lines > 1 else ''}, {low:.4g} to {high:.4g} Hz; start and "
        "end transients estimated with the parameters"
    )
    notes.append(Notice("whole_records", text))
    if band_hz is None and every.lines > MANY_LINES:
        gib = every.lines * len(every.channels) * 650 / 2**30  # 650 bytes for each line of a channel
        text = (
            f"the signal is above the noise up to {high:.4g} Hz: its {every.lines:,} lines take about {gib:.2g} "
            "GiB to identify; a --band that ends just above the rig's highest mode gives the same result for "
            "less"
        )
        notes.append(Notice("many_lines", text))
    return replace(every, notes=(*every.notes, *notes))


def _aligned(record: Record, step: float) -> tuple[Record, tuple[Channel, ...]]:
    """The record with late channels shifted by whole samples, so that their ends belong together.

    The other channels have what is left of their delays, less than one sample.
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
        raise DataError(
            "the delay of a channel is longer than the record", record.source, "correct its delay"
        )

    def shifted(of: np.ndarray) -> np.ndarray:
        return np.stack([of[s : s + count, c] for c, s in enumerate(first)], axis=-1)

    sd, status = (None if of is None else shifted(of) for of in (record.sd, record.status))
    return replace(
        record, time=record.time[:count], values=shifted(record.values), sd=sd, status=status
    ), remaining


def at_rest(values: Real) -> Bools:
    """(channels,): which of (samples, channels) move by no more than rounding."""
    return np.asarray(np.ptp(values, axis=0) <= ROUNDING * np.max(np.abs(values), axis=0))


def refuse_rest(record: Record, inputs: int = 0) -> None:
    """Raises DataError where a channel stays at one value; the first `inputs` may."""
    for c in np.flatnonzero(at_rest(record.values[:, inputs:])).tolist():
        raise DataError(
            f"{record.channels[inputs + c].name} stays at {record.values[0, inputs + c]:g} throughout",
            record.source,
            "check that the sensor is connected, or leave the channel out; an input that stays at "
            "rest during a free decay is ground, not an input",
        )


def leaked_by_a_step(column: Real) -> Complex:
    """What the step from the last sample (N,) back to the first puts into the lines, (N/2 + 1,)."""
    samples = len(column)
    turn = np.exp(-2j * np.pi * np.arange(1, samples // 2 + 1) / samples)
    leaked = np.zeros(samples // 2 + 1, dtype=np.complex128)
    leaked[1:] = 2 * (column[-1] - column[0]) / (samples - 1) / (turn - 1)
    return leaked


def _moving(X: Complex, source: str, highest_hz: float) -> int:
    """How many of the lines are kept: up to the last bin in which some channel stands out of its floor.

    Raises DataError where none does in any part of the band up to `highest_hz`.
    """
    lines = len(X)
    each = max(BIN, -(-lines // 200))  # 200 bins at most
    if lines < 3 * each:
        return lines
    mean = _bins(np.abs(X) ** 2, each)
    floor = np.quantile(mean[-max(3, len(mean) // 4) :], 0.25, axis=0)
    out = np.flatnonzero(np.any(_stands_out(mean, floor, each), axis=-1))
    if not len(out):
        raise DataError(
            f"no signal above the noise up to {highest_hz:.4g} Hz",
            source,
            "check that the rig was driven during this record; if the whole band is driven evenly, state it "
            "with --band",
        )
    return min(lines, int((out[-1] + 2) * each))


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
        lines = whole_record(record, band_hz=band_hz, still=still)
        (whole,) = (value for value in lines.stretches if isinstance(value, WholeRecord))
        columns = 2 if lines.lines < SHORT else POLYNOMIAL
        dwell = replace(whole, drive_hz=record.frequency_hz, ramp=slopes, polynomial=columns)
        lines = replace(lines, stretches=(dwell,))
        spectra.append(_with_sine_floor(lines, record) if still is None else lines)
    dwells = "one dwell is" if len(spectra) == 1 else f"{len(spectra)} dwells are"
    text = f"{dwells} {why}: all samples are used, and start and end transients are estimated"
    joined = concatenate(spectra)
    return replace(joined, notes=(Notice("dwells_with_transients", text),))


def _with_sine_floor(lines: Spectrum, record: Record) -> Spectrum:
    """The noise of each channel from what a sine leaves over, where that is less than its floor or there is none.

    With a slope and harmonics, amplitude and phase of the sine follow a polynomial of fewer degrees than it has
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
        bends = min(8, int(record.periods), (samples - 2 - 2 * len(orders)) // 6)
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
