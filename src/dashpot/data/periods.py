"""Periodic tests: the mean of the periods of one record, and their scatter as the covariance of its noise.

A multisine is repeated P times.  With X_p the amplitudes of period p, the mean over p has the covariance
Σ (X_p − X̄)(X_p − X̄)ᴴ / (P (P − 1)) with P − 1 complex degrees of freedom (Pintelon and Schoukens, System
Identification, 2nd ed. 2012, §2.5).  What repeats with every period, distortion too, is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Ints
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.record import Record, calibrated
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.notices import Notice

UNEVEN = 1e-3  # of a sampling step
UNAVERAGED = "leave out lines and frequency_hz, and it is used whole"
NEIGHBOURS = 10  # lines beside an excited one that show the noise there


def samples_of_period(record: Record, period_s: float) -> int:
    """Samples in one period.  Raises DataError where the sampling is uneven, or the period no whole number of them."""
    time = record.time
    step = float(time[-1] - time[0]) / (len(time) - 1)
    if np.max(np.abs(time - time[0] - step * np.arange(len(time)))) > UNEVEN * step * len(time) ** 0.5:
        raise DataError(
            "the samples are not evenly spaced",
            record.source,
            f"periods cannot be averaged then: {UNAVERAGED}",
        )
    each = round(period_s / step) if np.isfinite(period_s) and period_s > 0 else 0
    if each < 2 or abs(each * step - period_s) * len(time) / each > UNEVEN * step * len(time) ** 0.5:
        cure = f"correct the period; if the record does not repeat, {UNAVERAGED}"
        raise DataError(f"{period_s:g} s is not a whole number of samples of {step:g} s", record.source, cure)
    return each


def one_period(record: Record, period_s: float, orders: Sequence[int]) -> Spectrum:
    """A line for each of `orders` from the last period of a record; noise from the lines beside that are not excited.

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
    silent = np.setdiff1d(
        np.arange(max(1, int(wanted[0]) - 2 * NEIGHBOURS), min(each // 2, int(wanted[-1]) + 1)), wanted
    )
    if len(silent) < NEIGHBOURS:
        cure = f"record at least two periods, or leave {NEIGHBOURS} lines unexcited"
        raise DataError("nothing shows the noise of a single period", record.source, cure)
    start = np.clip(np.searchsorted(silent, wanted) - NEIGHBOURS // 2, 0, len(silent) - NEIGHBOURS)
    J = F[silent[start[:, None] + np.arange(NEIGHBOURS)]]
    V = np.einsum("lnc,lnd->lcd", J, np.conj(J)) / NEIGHBOURS
    return _lines(record, period_s, wanted, F[wanted], V, each, 2.0 * NEIGHBOURS)


def average_periods(
    record: Record, period_s: float, orders: Sequence[int], *, skip: int = 0, drift: int = 0
) -> Spectrum:
    """A line for each of `orders`, multiples of 1/period_s, from the periods after the first `skip`.

    `drift` is the degree of the polynomial taken out of each period.  Raises DataError where the sampling is uneven,
    a period is not a whole number of samples, or fewer than two periods are left.
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
    wanted = sorted({int(order) for order in orders})
    fit = fit_harmonics(periods, 1 / period_s, orders=wanted, harmonics=(), drift=drift, noise="white")
    X = np.mean(fit.amplitudes, axis=0)
    away = fit.amplitudes - X
    V = np.einsum("plc,pld->lcd", away, np.conj(away)) / (count * (count - 1))
    notes = _notes(record.source, period_s, skip, X, away)
    return _lines(record, period_s, np.array(wanted), X, V, count * each, 2.0 * (count - 1), notes)


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


def _notes(source: str, period_s: float, skip: int, mean: Complex, away: Complex) -> tuple[Notice, ...]:
    """What is left out, and whether periods agree: mean (lines, channels), away (periods, lines, channels) from it."""
    notes = []
    if skip:
        left_out = "period is" if skip == 1 else f"{skip} periods are"
        notes.append(Notice("periods_skipped", f"{source}: the first {left_out} left out", (source,)))
    count = len(away)
    variance = np.sum(np.abs(away) ** 2, axis=0) / (count * (count - 1))
    if np.median(np.abs(mean) ** 2 / np.maximum(variance, 1e-300)) < 4:  # chance alone makes it 1
        text = f"{source}: its periods of {period_s:g} s hardly agree with one another: is it periodic?"
        notes.append(Notice("periods_differ", text, (source,)))
    return tuple(notes)
