"""Dwells whose transients are still in them: found by one test of all dwells, and used as records with their own loads.

A dwell of any number of periods, whole or not, is a whole record too (THEORY §8), and dwells that follow each other
without a gap are one.  Long settled dwells lose nothing by harmonic regression and are cheaper by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Real
from dashpot.data.conditioning.clock import FEWEST, even_step
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.still import Still
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.notices import Notice

LEVEL = 1e-3  # of the test for transients
EXACT = 1e-9  # of a channel's size: what scatters less is rounding, and says nothing of transients
MANY_PERIODS = 8  # from which on the scatter of the later ones is a better measure of the noise
MOST_A_PERIOD = 1e9  # samples, beyond which the stamps of the record are damaged
FEWEST_A_PERIOD = 6  # samples, for amplitudes of single periods with a residual
SHORT = 200  # lines: below it two polynomial columns serve
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


def transients_show(records: Sequence[Record]) -> float:
    """p-value of all dwells being settled: amplitudes of each one's first period against those of its last (pooled F).

    1 where no dwell has two periods to compare.
    """
    apart, spread, freedom = 0.0, 0, 0
    for record in records:
        pair = _first_and_last(record)
        if pair is None:
            continue
        difference, variance, dof = pair
        size = np.max(np.abs(record.values), axis=0)
        noisy = variance > (EXACT * size) ** 2
        apart += 2 * float(np.sum(np.abs(difference[noisy]) ** 2 / variance[noisy]))
        spread += 2 * int(np.sum(noisy))
        freedom += dof * int(np.sum(noisy))
    if not spread or freedom < 4:
        return 1.0
    return float(fdtrc(spread, freedom, apart / spread))


def _first_and_last(record: Record) -> tuple[Real, Real, int] | None:
    """(difference of amplitudes, its variance E|Δ|², residual degrees of freedom of a channel) of the two periods."""
    if record.frequency_hz is None or record.values.ndim != 2:
        return None
    period = 1 / record.frequency_hz
    step = float(record.time[-1] - record.time[0]) / (len(record.time) - 1)
    if not period < step * MOST_A_PERIOD:
        return None
    each = round(period / step)
    if each < FEWEST_A_PERIOD or len(record.time) < 2 * each:
        return None
    count = len(record.time) // each
    later = count - count // 2 if count >= MANY_PERIODS else 0
    starts = [0, *(len(record.time) - each * k for k in range(max(later, 1), 0, -1))]
    fits = []
    for start in starts:
        rows = slice(start, start + each)
        part = replace(record, time=record.time[rows], values=record.values[rows])
        try:
            fits.append(fit_harmonics(part, orders=(1,), harmonics="none", drift=0, noise="white"))
        except DataError:
            return None
    difference = fits[0].amplitudes[0] - fits[-1].amplitudes[0]
    if later:
        # The scatter of the later periods knows the colour of the noise.
        later_amplitudes = np.stack([fit.amplitudes[0] for fit in fits[1:]])
        variance = 2 * np.var(later_amplitudes, axis=0, ddof=1)
        return difference, np.asarray(variance), 2 * (later - 1)
    variance = sum(np.diagonal(fit.covariance[0]).real for fit in fits)
    return difference, np.asarray(variance), 2 * (each - 3)


def dwells_with_transients(
    records: Sequence[Record],
    band_hz: tuple[float, float] | None = None,
    still: Still | None = None,
    *,
    why: str = "not settled",
) -> Spectrum:
    """Lines of each dwell with boundary loads of its own; a note says `why`.  Raises as `whole_record`."""
    spectra = []
    for record in records:
        if len(record.time) < FEWEST:
            raise DataError(
                f"a dwell of {len(record.time)} samples is too short to tell its transient from its motion",
                record.source,
                f"record {FEWEST} samples at least, or wait until it has settled",
            )
        even_step(record)
        lines = whole_record(record, band_hz=band_hz, still=still)
        if lines.lines < SHORT:
            lines = whole_record(record, band_hz=band_hz, still=still, polynomial=2)
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
        fit = fit_harmonics(record, orders=(1,), drift=1, noise="white")
    except DataError:
        return lines
    residual = np.diagonal(fit.residual_covariance).real * 4 / len(record.time)
    factor = np.abs(np.array([(c.gain or 1.0) * (c.sign or 1.0) for c in record.channels])) ** 2
    floor = np.diagonal(lines.covariance[0]).real
    variance = np.where(floor > 0, np.minimum(floor, residual / factor), residual / factor)
    V = np.broadcast_to(np.diag(variance).astype(np.complex128), lines.covariance.shape)
    return replace(lines, covariance=V)
