"""From records to the lines of a Spectrum, conditioned as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np

from dashpot.data.calibration import calibration
from dashpot.data.conditioning.clock import FEWEST
from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.sample_moments import second_moments
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.conditioning.steady_state import settled, without_start
from dashpot.data.conditioning.transients import LEVEL, continuous, dwells_with_transients, transients_show
from dashpot.data.conditioning.whole_record import whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.data.stretch import SettledDwell
from dashpot.errors import DataError
from dashpot.notices import Notice


def spectrum(
    records: Sequence[Record], conditioning: Conditioning | None = None, **treatments: Unpack[Treatments]
) -> Spectrum:
    """The lines of all records, with the known sign, gain and delay of every channel taken out.

    A settled dwell gives a line for each order; records without a frequency, dwells that follow each other in time, and
    dwells that have not settled give all their lines, with boundary loads for their transients.  `conditioning`, or its
    fields as keywords, says how.  Settled dwells add: spectrum(a + b) == spectrum(a) + spectrum(b).
    Raises DataError as Conditioning, `fit_harmonics` and `whole_record`.
    """
    settings = conditioning_of(conditioning, treatments)
    if not records:
        raise DataError("there are no records", cure="give one record at least")
    joined = continuous(records) if settings.dwells_may_be_whole else list(records)
    whole = [record for record in joined if record.frequency_hz is None]
    dwells = [record for record in joined if record.frequency_hz is not None]
    parts = []
    if dwells and settings.dwells_may_be_whole and _unsettled(dwells, settings):
        parts.append(dwells_with_transients(dwells, settings.band, settings.still))
    else:
        parts += [_lines(record, settings) for record in dwells]
    if whole:
        parts.append(
            whole_records(whole, band_hz=settings.band, still=settings.still, ramp=settings.degree > 0)
        )
    return concatenate(parts)


def _unsettled(dwells: Sequence[Record], settings: Conditioning) -> bool:
    """Whether dwells are to be used with their transients: asked for, or seen in a test of all of them together."""
    if settings.transients == "estimate":
        return True
    usable = all(record.values.ndim == 2 and len(record.time) >= FEWEST for record in dwells)
    return usable and transients_show(dwells) < LEVEL


def _lines(record: Record, settings: Conditioning) -> Spectrum:
    """The lines of one record."""
    record, notes = _treated(record, settings)
    fit = fit_harmonics(record, None, settings)
    wanted = [fit.orders.index(order) for order in settings.orders]
    frequencies = fit.frequency_hz * np.array([fit.orders[i] for i in wanted], dtype=float)
    h = calibration(record.channels, frequencies)
    return Spectrum(
        record.channels,
        frequencies,
        fit.amplitudes[..., wanted, :] * h,
        fit.covariance[..., wanted, :, :] * h[:, :, None] * np.conj(h)[:, None, :],
        np.full(len(wanted), fit.samples),
        fit.dof[wanted],
        (fit.noise,) * len(wanted),
        np.full(len(wanted), record.experiment),
        second_moments(record, settings.drift) if _with_moments(record, settings) else None,
        (*notes, *fit.notes),
        stretches=(SettledDwell(fit.frequency_hz if len(wanted) > 1 else None),),
    )


def _with_moments(record: Record, settings: Conditioning) -> bool:
    """Whether second moments are asked for, and with "auto" whether they can be had."""
    if settings.moments != "auto":
        return settings.moments
    return settings.orders == (1,) and not any(channel.delay for channel in record.channels)


def _treated(record: Record, settings: Conditioning) -> tuple[Record, list[Notice]]:
    """The record settled and with its frequency refined, as far as that is wanted, and notes."""
    notes: list[Notice] = []
    if settings.settle == "auto":
        part = settled(record)
        record = part.record
        notes += [] if part.note is None else [part.note]
    elif settings.settle != "none":
        record = without_start(record, float(settings.settle))
    if settings.nominal_frequency:
        return record, notes
    refined = refine_frequency(record, drift=settings.drift)
    if abs(refined.frequency_hz - refined.nominal_hz) > 3 * refined.sd:
        text = f"{record.source}: driven at {refined.frequency_hz:.7g} Hz, not at {refined.nominal_hz:.7g} Hz"
        notes.append(Notice("frequency_refined", text, (record.source,)))
    return replace(record, frequency_hz=refined.frequency_hz), notes
