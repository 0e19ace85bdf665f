"""From records to the lines of a Spectrum, conditioned as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np

from dashpot.data.calibration import calibration
from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.sample_moments import second_moments
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.conditioning.steady_state import settled, without_start
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.notices import Notice


def spectrum(
    records: Sequence[Record], conditioning: Conditioning | None = None, **treatments: Unpack[Treatments]
) -> Spectrum:
    """One line for each record and order, with the known sign, gain and delay of every channel taken out.

    `conditioning`, or its fields as keywords, says how.  spectrum(a + b) == spectrum(a) + spectrum(b).
    Raises DataError as Conditioning and `fit_harmonics`.
    """
    settings = conditioning_of(conditioning, treatments)
    if not records:
        raise DataError("there are no records", cure="give one record at least")
    return concatenate([_lines(record, settings) for record in records])


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
