"""Periodic tests: the mean of the periods of one record, and their scatter as the covariance of its noise.

Of the multiples that are stated those count that are driven; what moves between them is noise, or distortion where it
repeats.  A multisine is repeated P times.  With X_p the amplitudes of period p, the mean over p has the covariance
Σ (X_p − X̄)(X_p − X̄)ᴴ / (P (P − 1)) with P − 1 complex degrees of freedom (Pintelon and Schoukens, System
Identification, 2nd ed. 2012, §2.5).  What repeats with every period, distortion too, is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtrc, fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.noise import LEVEL
from dashpot.data.record import Record, calibrated
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.notices import Notice

UNEVEN = 1e-3  # of a sampling step
UNAVERAGED = "leave out lines and frequency_hz, and the record is used whole"
NEIGHBOURS = 10  # lines next to an excited one that show the noise there


NEAR = 16  # lines on either side; the largest shows how much a driven line moves
SPLIT = 5.0  # between the sizes of driven lines and of others, in the channel that tells them apart best
RUNS = 10
DISTORTED = 1e-3  # of a channel's motion, and p-value of its being noise
ROUNDING = 1e-9  # of a channel's largest line or mean: where it moves less, it rests


def moving(X: Complex, lines: Ints) -> Bools:
    """(channels,): which move at some of the lines by more than rounding; X (multiples from 0, channels)."""
    size = np.abs(X)
    return np.asarray(np.max(size[lines], axis=0) > ROUNDING * np.max(size, axis=0))


def driven_lines(X: Complex) -> Bools:
    """(lines,): which of neighbouring multiples are driven, X (lines, channels); all where that is not to be told.

    In the channel of the drive some lines are far below their neighbours, here and there in the band in which it
    moves.  Of the channels that tell them apart that with most driven lines decides, unless one moves at every line.
    """
    found, most = np.ones(len(X), dtype=bool), 0
    if len(X) < 2 * RUNS:
        return found
    for size in np.abs(np.nan_to_num(X)).T:
        around = np.max(sliding_window_view(np.pad(size, NEAR), 2 * NEAR + 1), axis=-1)
        # Where a channel moves less than 3 % of its largest lines, it tells nothing.
        in_band = around > 0.03 * np.max(around)
        share = np.maximum(size / np.where(in_band, around, np.inf), 1e-12)
        if np.min(share) > 1 / SPLIT:
            return np.ones(len(X), dtype=bool)
        ordered = np.sort(share[in_band])
        # A fifth of the lines at least is not driven, in RUNS runs: else a few are weak, or lie next to hum.
        first = int(np.ceil(0.2 * len(ordered)))
        gaps = ordered[first : len(ordered) - RUNS] / ordered[first - 1 : len(ordered) - RUNS - 1]
        if first == 0 or not np.max(gaps, initial=0.0) > SPLIT:
            continue
        driven = share >= ordered[first + int(np.argmax(gaps))]
        if np.count_nonzero(driven[:-1] > driven[1:]) >= RUNS and np.count_nonzero(driven) > most:
            found, most = driven, int(np.count_nonzero(driven))
    return found


def _driven_and_not(mean: Complex, wanted: Ints, inputs: int = 0) -> tuple[Ints, Ints]:
    """Of the multiples that are wanted those that are driven, and all between that are not; mean (multiples from 0,
    channels): the first `inputs` drive, or nothing states which."""
    every = np.arange(wanted[0], wanted[-1] + 1)
    driving = np.arange(mean.shape[1]) < inputs if inputs else moving(mean, every)
    driven = driven_lines(mean[every][:, driving])
    found = np.intersect1d(wanted, every[driven])
    if not len(found):
        found, driven = wanted, np.ones(len(every), dtype=bool)
    return found, np.setdiff1d(every, found) if inputs else every[~driven]


def driven_note(source: str, asked: int, driven: Ints) -> tuple[Notice, ...]:
    """That some of the lines `asked` for are driven alone; multiples (lines,)."""
    if len(driven) == asked:
        return ()
    steps = np.unique(np.diff(driven))
    each = "some" if len(steps) != 1 else "every second" if steps[0] == 2 else f"one in {steps[0]}"
    text = (
        f"{source}: {len(driven)} of {asked} lines are driven, {each} from {driven[0]} to {driven[-1]}; the "
        "others show only noise and distortion"
    )
    return (Notice("lines_driven", text, (source,)),)


def distortion(X: Complex, driven: Ints, classes: Sequence[Ints], inputs: int = 0) -> Real:
    """Of each channel, rms at some multiples that are not driven over that at those that are, (channels, classes).

    X (periods, multiples from 0, channels).  0 where the scatter of the periods may do as much, NaN for no multiple.
    What one input, the first channel, has there comes through H, between its driven lines, and is taken off (Pintelon
    and Schoukens, §4.3.1.3).
    """
    count, at_driven = len(X), np.mean(X[:, driven], axis=0)
    motion = np.mean(np.abs(at_driven) ** 2, axis=0)
    if inputs == 1:
        H = [np.interp(np.arange(X.shape[1]), driven, each) for each in (at_driven / at_driven[:, :1]).T]
        X = X - np.stack(H, axis=1) * X[..., :1]
    shares = np.full((X.shape[2], len(classes)), np.nan)
    for k, lines in enumerate(classes):
        if len(lines):
            power = np.sum(np.abs(np.mean(X[:, lines], axis=0)) ** 2, axis=0)
            noise = np.sum(np.var(X[:, lines], axis=0, ddof=1), axis=0) / count
            ratio = power / np.maximum(noise, 1e-300)
            p = fdtrc(2 * len(lines), 2 * len(lines) * (count - 1), np.minimum(ratio, 1e12))
            beyond = np.where(p < DISTORTED, np.maximum(power - noise, 0), 0) / len(lines)
            share = np.sqrt(beyond / np.maximum(motion, 1e-300))
            shares[:, k] = np.where(share > ROUNDING, share, 0)
    return shares


def _distortion_note(record: Record, X: Complex, driven: Ints, between: Ints) -> tuple[Notice, ...]:
    """Which channels are distorted, by odd and even laws where the driven multiples are odd; as for `distortion`."""
    odd = bool(np.all(driven % 2 == 1))
    parity = between % 2
    classes = {" odd": between[parity == 1], " even": between[parity == 0]} if odd else {"": between}
    shares = np.nan_to_num(distortion(X, driven, list(classes.values())))
    told = np.flatnonzero(moving(np.mean(X, axis=0), driven) & (np.max(shares, axis=1) > DISTORTED))
    if not len(told):
        return ()
    names = tuple(record.channels[c].name for c in told)
    texts = (
        " and ".join(f"{100 * size:.2g} %{kind}" for kind, size in zip(classes, shares[c], strict=True))
        for c in told
    )
    text = (
        f"{record.source}: distortion at lines that are not driven, relative to the motion at those that "
        "are: "
    )
    of = ", ".join(f"{name} {share}" for name, share in zip(names, texts, strict=True))
    return (Notice("distortion", text + of, names),)


def samples_of_period(record: Record, period_s: float) -> int:
    """Samples in one period.  Raises DataError if the sampling is uneven, or the period no whole number of them."""
    time, step = record.time, record.step_s
    if np.max(np.abs(time - time[0] - step * np.arange(len(time)))) > UNEVEN * step * len(time) ** 0.5:
        raise DataError(
            "the samples are not evenly spaced", record.source, f"periods cannot be averaged: {UNAVERAGED}"
        )
    each = round(period_s / step) if np.isfinite(period_s) and period_s > 0 else 0
    if each < 2 or abs(each * step - period_s) * len(time) / each > UNEVEN * step * len(time) ** 0.5:
        cure = f"correct the period; if the record does not repeat, {UNAVERAGED}"
        raise DataError(f"{period_s:g} s is not a whole number of samples of {step:g} s", record.source, cure)
    return each


def one_period(record: Record, period_s: float, orders: Sequence[int]) -> Spectrum:
    """A line for each of `orders` from the last period of a record; noise from neighbouring lines that are not excited.

    The nearest unexcited lines within the band of the excited ones have the noise and the distortion of even order
    (Pintelon and Schoukens, System Identification, 2nd ed. 2012, §4.3).  Raises DataError as `average_periods`, and
    where too few lines are unexcited.
    """
    each = samples_of_period(record, period_s)
    if len(record.time) < each or record.values.ndim != 2:
        what = f"the record is shorter than its period of {period_s:g} s"
        raise DataError(what, record.source, "record at least one period, after the transient")
    wanted = np.array(sorted({int(order) for order in orders}))
    if wanted[-1] >= each / 2:
        what = f"line {wanted[-1]} is beyond half the sampling rate"
        raise DataError(what, record.source, "leave it out, or sample faster")
    first = len(record.time) - each
    phase = np.exp(-2j * np.pi * np.arange(each // 2) * record.time[first] / period_s)
    F = np.fft.fft(record.values[first:], axis=0)[: each // 2] * (2 / each) * phase[:, None]
    asked, (wanted, between) = len(wanted), _driven_and_not(F, wanted)
    beside = np.arange(max(1, int(wanted[0]) - 2 * NEIGHBOURS), min(each // 2, int(wanted[-1]) + 1))
    silent = np.union1d(beside[beside < wanted[0]], between) if len(between) else np.setdiff1d(beside, wanted)
    if len(silent) < NEIGHBOURS:
        cure = f"record at least two periods, or leave {NEIGHBOURS} lines unexcited"
        raise DataError("the noise of a single period cannot be estimated", record.source, cure)
    start = np.clip(np.searchsorted(silent, wanted) - NEIGHBOURS // 2, 0, len(silent) - NEIGHBOURS)
    J = F[silent[start[:, None] + np.arange(NEIGHBOURS)]]
    V = np.einsum("lnc,lnd->lcd", J, np.conj(J)) / NEIGHBOURS
    notes = driven_note(record.source, asked, wanted)
    return _lines(record, period_s, wanted, F[wanted], V, each, 2.0 * NEIGHBOURS, notes)


def average_periods(
    record: Record, period_s: float, orders: Sequence[int], *, skip: int = 0, inputs: int = 0
) -> Spectrum:
    """A line for each of `orders`, multiples of 1/period_s, from the periods after the first `skip`.

    The first `inputs` channels drive (0: nobody says which do); the mean of each period is taken out.  Raises DataError
    where the sampling is uneven, a period is not a whole number of samples, or fewer than two periods are left.
    """
    if record.values.ndim != 2:
        raise DataError(
            "repeats of a periodic record cannot be averaged", record.source, "give one at a time"
        )
    time = record.time
    each = samples_of_period(record, period_s)
    count = len(time) // each - skip
    if skip < 0 or count < 2:
        raise DataError(
            f"the record holds {len(time) // each} periods of {period_s:g} s, {skip} of them skipped",
            record.source,
            "at least two periods must be left",
        )
    first = skip * each
    values = record.values[first : first + count * each].reshape(count, each, -1)
    periods = replace(record, time=time[first : first + each], values=values)
    wanted = np.array(sorted({int(order) for order in orders}))
    notes: tuple[Notice, ...] = ()
    if wanted[-1] < each / 2:
        every = np.fft.rfft(values, axis=1)
        asked, (wanted, between) = len(wanted), _driven_and_not(np.mean(every, axis=0), wanted, inputs)
        notes = (
            *driven_note(record.source, asked, wanted),
            *_distortion_note(record, every, wanted, between),
        )
    fit = fit_harmonics(periods, 1 / period_s, orders=wanted.tolist(), harmonics=(), drift=0, noise="white")
    X = np.mean(fit.amplitudes, axis=0)
    away = fit.amplitudes - X
    V = np.einsum("plc,pld->lcd", away, np.conj(away)) / (count * (count - 1))
    told = []
    if skip:
        left_out = "period is" if skip == 1 else f"{skip} periods are"
        told.append(
            Notice("periods_skipped", f"{record.source}: the first {left_out} left out", (record.source,))
        )
    variance = np.diagonal(V, axis1=-2, axis2=-1).real
    if np.median(np.abs(X) ** 2 / np.maximum(variance, 1e-300)) < 4:  # chance alone makes it 1
        text = (
            f"{record.source}: successive periods of {period_s:g} s differ strongly. Is the record periodic?"
        )
        told.append(Notice("periods_differ", text, (record.source,)))
    notes = (*told, *notes)
    return _lines(record, period_s, wanted, X, V, count * each, 2.0 * (count - 1), notes)


def _lines(
    record: Record,
    period_s: float,
    orders: Ints,
    X: Complex,
    V: Complex,
    samples: int,
    dof: float,
    notes: tuple[Notice, ...] = (),
) -> Spectrum:
    """A line for each multiple of 1/period_s, calibrations taken out."""
    frequency_hz, lines = orders / period_s, len(orders)
    return Spectrum(
        record.channels,
        frequency_hz,
        *calibrated(record.channels, frequency_hz, X, V),
        np.full(lines, samples),
        np.full(lines, dof),
        ("periods",) * lines,
        np.full(lines, record.experiment),
        notes=notes,
    )


# Continuous records of a periodic drive: their period is found, and their periods are averaged.
#
# A multisine or a periodic random drive that repeats puts all its power on the multiples of one frequency.
# What the rest of the lines hold is noise, and its size at each multiple is the scatter of the periods.


LASTING = 0.97  # of it, between periods that are further apart
FEWEST_PERIODS = 6
SHORTEST = 32  # samples of a period


def averaged_periods(record: Record, inputs: int = 0) -> tuple[Spectrum, Real] | None:
    """The mean of the settled periods of a record that repeats, and its distortion at even and at odd multiples.

    Where the first `inputs` channels drive, they repeat, and the lines are those that one of them shows; else all
    channels repeat, and all show a line.  Distortion (channels, 2) as in `distortion`; None for other records, and for
    one that goes on settling; one of a stated frequency that moves at that frequency is a dwell.
    """
    samples = period_of(record.values[..., : inputs or None])
    if samples is None:
        return None
    step, count = record.step_s, len(record.time) // samples
    X = fft.rfft(record.values[: count * samples].reshape(count, samples, -1), axis=1)[
        :, : (samples + 1) // 2
    ]
    skip = unsettled_periods(X[:, 1:])
    if still_settling(X[skip:, 1:]):
        return None
    # Which lines repeat. Their noise is their own scatter, or that of their neighbours where it is larger: of few
    # periods it may be small by chance.
    settled = X[skip:, 1:]
    periods, beside, size = len(settled), 2 * NEIGHBOURS + 1, np.abs(np.mean(settled, axis=0))
    scatter = np.var(settled, axis=0, ddof=1) / periods
    noise = np.maximum(scatter, uniform_filter1d(scatter, beside, axis=0, mode="nearest"))
    p = fdtrc(2, 2 * (periods - 1) * beside, np.minimum(size**2 / np.maximum(noise, 1e-300), 1e12))
    there = (p < LEVEL / p.size) & (size > (DISTORTED if inputs else ROUNDING) * np.max(size, axis=0))
    lines = np.flatnonzero(np.any(there[:, :inputs], axis=1) if inputs else np.all(there, axis=1)) + 1
    # A dwell has 0.3 of its strongest line at the fundamental in every channel.
    dwell = record.frequency_hz is not None and lines[:1].tolist() == [1]
    dwell = dwell and bool(np.all(size[0] > 0.3 * np.max(size, axis=0)))
    # Fewer than 12 lines in every channel are a sine, a decay or their harmonics.
    if len(lines) < (1 if inputs else 12) or (dwell and not inputs):
        return None
    try:
        averaged = average_periods(record, samples * step, lines.tolist(), skip=skip, inputs=inputs)
    except DataError:
        return None  # its stamps are uneven
    driven = np.rint(averaged.frequency_hz * samples * step).astype(np.int64)
    between = np.setdiff1d(np.arange(driven[0], driven[-1]), driven)
    shares = distortion(X[skip:], driven, [between[between % 2 == parity] for parity in (0, 1)], inputs)
    start = f", the first {skip} left out" if skip else ""
    text = (
        f"{record.source}: the {'inputs repeat' if inputs else 'record repeats'} every {samples * step:.6g} s: "
        f"{averaged.lines} lines are means of {periods} periods{start}"
    )
    notice = Notice("periods_averaged", text, (record.source,))
    return replace(averaged, notes=(notice, *averaged.notes)), shares


def period_of(values: Real) -> int | None:
    """Samples of the period that all channels of (samples, channels) repeat with to the end; None: there is none."""
    n = len(values)
    if values.ndim != 2 or n < FEWEST_PERIODS * SHORTEST:
        return None
    steps = np.diff(values, axis=0)
    steps = steps - np.mean(steps, axis=0)
    power = np.abs(fft.rfft(steps, fft.next_fast_len(2 * n), axis=0)) ** 2
    alike = fft.irfft(power, axis=0)[: n // 2]
    if np.any(alike[0] <= 0):
        return None
    alike = np.min(alike / alike[0], axis=1) * (n / (n - np.arange(len(alike))))
    lags = alike[SHORTEST : n // FEWEST_PERIODS]
    highest = float(np.max(lags, initial=0.0))
    if highest < 0.5:  # correlation of every channel's steps with those a period later: the rest is noise
        return None
    first = SHORTEST + int(np.flatnonzero(lags > LASTING * highest)[0])
    peak = first + int(np.argmax(alike[first : first + max(2, first // 100)]))
    return peak if bool(np.all(alike[peak::peak] > LASTING * alike[peak])) else None


def unsettled_periods(X: Complex) -> int:
    """Periods to leave out, of at most the first half, of (periods, lines, channels): up to the last that differs.

    In some channel the sum over its lines is further from the last half than its noise there allows (F-test, of as many
    lines as share that noise).
    """
    half, count = len(X) // 2, len(X) - len(X) // 2
    last = X[half:]
    noise = np.var(last, axis=0, ddof=1)  # records without noise may repeat exactly, to rounding
    noise = np.maximum(noise, (ROUNDING * np.max(np.abs(last), axis=(0, 1))) ** 2 + 1e-300)
    alike = np.sum(noise, axis=0) ** 2 / np.sum(noise**2, axis=0)
    away = np.sum(np.abs(X[:half] - np.mean(last, axis=0)) ** 2, axis=1) / np.sum(noise, axis=0)
    p = fdtrc(2 * alike, 2 * alike * (count - 1), away / (1 + 1 / count))
    late = np.flatnonzero(np.any(p < LEVEL / p.size, axis=1))
    return int(late[-1]) + 1 if len(late) else 0


def still_settling(X: Complex) -> bool:
    """Whether the periods of (periods, lines, channels) go on approaching a last one.

    A decaying mode turns and shrinks by one complex factor from period to period, alike at all lines: neighbouring
    deviations e_k from the mean correlate.  Of noise, e/|e| is uniform on the sphere of P − 1 complex dimensions, so
    that r = Σ ē_k e_k+1 / Σ |e_k|² has known moments; the sum of r over lines is normal.  A mode shows in half of the
    channels at the least; what drifts in fewer has no end to wait for.
    """
    count = len(X)
    if count < 3:
        return False
    e = X - np.mean(X, axis=0)
    size = np.sum(np.abs(e) ** 2, axis=0)
    usable = size > (ROUNDING * np.max(np.abs(X), axis=(0, 1))) ** 2
    weight = np.where(usable, np.sqrt(size), 0.0)
    r = np.sum(np.conj(e[:-1]) * e[1:], axis=0) / np.where(usable, size, 1.0)
    apart = np.eye(count) - 1 / count
    A, d = apart @ np.eye(count, k=1) @ apart, count - 1
    mean = np.trace(A) / d
    both = (np.trace(A) ** 2 + np.array([np.sum(A**2), np.trace(A @ A)])) / (d * (d + 1)) - mean**2
    away = np.sum(weight * (r - mean), axis=0)
    shared = np.sum(weight**2, axis=0)
    variance = (
        np.stack([both[0] + both[1], both[0] - both[1]])[:, None] / 2 * np.where(shared > 0, shared, 1.0)
    )
    chi2 = np.sum(np.stack([away.real, away.imag]) ** 2 / np.maximum(variance, 1e-300), axis=0)
    return 2 * int(np.count_nonzero(chdtrc(2, chi2) < LEVEL / X.shape[-1])) >= X.shape[-1]
