"""From records to the lines of a Spectrum, conditioned as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np

from dashpot.arrays import Real
from dashpot.data.calibration import calibration
from dashpot.data.conditioning.account import account_of_dwells, other_motion, summed_up
from dashpot.data.conditioning.brief_dwells import long_enough
from dashpot.data.conditioning.clipped_samples import notices_of_doubt, reaches_limits, without_clipping
from dashpot.data.conditioning.clock import with_even_stamps
from dashpot.data.conditioning.drift import LEVEL as DRIFT_LEVEL
from dashpot.data.conditioning.drift import slope_costs, slopes_show
from dashpot.data.conditioning.drive_fading import LEVEL as FADING_LEVEL
from dashpot.data.conditioning.drive_fading import drive_fades
from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.conditioning.drive_wander import LEVEL as WANDER_LEVEL
from dashpot.data.conditioning.drive_wander import drive_wanders
from dashpot.data.conditioning.driven_harmonics import DrivenOrders, driven_orders, orders_used
from dashpot.data.conditioning.dropouts import without_dropouts
from dashpot.data.conditioning.harmonic_fit import HarmonicFit, fit_harmonics
from dashpot.data.conditioning.moderated import moderated
from dashpot.data.conditioning.quantisation import rounding_floor, rounding_steps
from dashpot.data.conditioning.repetition import averaged_periods
from dashpot.data.conditioning.sample_moments import second_moments
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.conditioning.stated_frequency import (
    at_frequencies,
    beyond_half_rate,
    drive_frequencies,
    require_stated,
)
from dashpot.data.conditioning.steady_state import (
    driven_throughout,
    periods_of,
    settled,
    without_start,
)
from dashpot.data.conditioning.transients import (
    continuous,
    dwells_with_transients,
    short_dwells_bend,
    shows_settling,
    taken_as_settled,
    transients_matter,
)
from dashpot.data.conditioning.whole_record import AT_REST, whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.data.stretch import SettledDwell
from dashpot.errors import DashpotError, DataError
from dashpot.notices import Notice

WANDERS = "the drive frequency wanders within a dwell, which is nevertheless treated as steady"
FADES = "the drive's amplitude drifts within a dwell, which is nevertheless treated as steady"
TELLING = 16  # samples of a dwell that shows by itself whether it is a steady sine
LONG_ENOUGH = 8  # periods that must be left of a dwell that rests for a part


def spectrum(
    records: Sequence[Record], conditioning: Conditioning | None = None, **treatments: Unpack[Treatments]
) -> Spectrum:
    """The lines of all records, with the known sign, gain and delay of every channel taken out.

    A settled dwell gives a line for each order; records without a frequency, dwells that follow each other in time, and
    dwells that have not settled give all their lines, with boundary loads for their transients; dwells too short to
    show it give both (`unsettled`).  `conditioning`, or its fields as keywords, says how.  Settled dwells add,
    spectrum(a + b) == spectrum(a) + spectrum(b), where nothing is "auto": what is, all dwells decide together.
    Raises DataError as Conditioning, `fit_harmonics` and `whole_record`.
    """
    settings = conditioning_of(conditioning, treatments)
    if not records:
        raise DataError("there are no records", cure="give at least one record")
    joined = continuous(records) if settings.dwells_may_be_whole else list(records)
    parts, rest = [], []
    for record in joined:
        mean = averaged_periods(record) if _may_repeat(settings) else None
        if mean is None:
            rest.append(record)
        else:
            parts.append(mean)
    whole = [record for record in rest if record.frequency_hz is None]
    dwells = [record for record in rest if record.frequency_hz is not None]
    if dwells:
        parts.append(_of_dwells(dwells, settings))
    if whole:
        parts.append(
            whole_records(whole, band_hz=settings.band, still=settings.still, ramp=settings.degree > 0)
        )
    lines = concatenate(parts)
    if settings.still is None or AT_REST not in lines.noise:
        return lines
    text = f"noise: that of the record at rest, its spectrum from {settings.still.dof:.0f} values around each line"
    return replace(lines, notes=(*lines.notes, Notice("noise_at_rest", text)))


def _may_repeat(settings: Conditioning) -> bool:
    """Whether periods may be averaged: nothing is asked for that needs the whole record or its fundamental."""
    chosen = settings.orders != "auto" or settings.transients != "auto" or settings.band is not None
    return not chosen and settings.still is None and settings.dwells_may_be_whole


def _of_dwells(dwells: Sequence[Record], settings: Conditioning) -> Spectrum:
    """The lines of dwells, treated as all of them together ask for: what was driven, frequency, settling, drift."""
    dwells, left_out = long_enough(dwells)
    dwells, weaker, notes = _evened(dwells, settings)
    notes = [*left_out, *notes]
    uncut, of_stamps = dwells, list(notes)
    if settings.transients == "settle" and settings.settle == "none" and _unsettled(dwells):
        settings = settings.changed(settle="auto")
    if settings.refine == "auto":
        require_stated([record for record in dwells if beyond_half_rate(record)], settings.wanted)
    dwells, cut = driven_parts(dwells, settings)
    notes += cut
    wanders = False
    if settings.refine == "auto":
        dwells, wanders, refined = _at_drive_frequencies(dwells, settings)
        notes += refined
    why_whole = _why_whole(dwells, settings, weaker, wanders)
    if wanders and why_whole is None:
        notes.append(Notice("drive_wanders", WANDERS))
    if why_whole is not None:
        if settings.settle == "none":  # what was cut off to see a steady sine is data like the rest
            dwells, notes = uncut, of_stamps
        notes = [*notes, *notices_of_doubt(dwells, weaker)]
        slopes = settings.degree > 0
        lines = dwells_with_transients(
            dwells, settings.band, settings.still, why=why_whole, slopes=slopes, weaker=weaker
        )
        return replace(lines, notes=(*notes, *lines.notes))
    if settings.drift == "auto" and slope_costs(dwells):
        settings, evidence = _with_drift(dwells, settings)
        notes.append(evidence)
    lines = _of_settled(dwells, uncut, settings, weaker)
    if (
        settings.settle == "none"
        and settings.refine != "always"
        and settings.transients in ("auto", "settle")
    ):
        notes += taken_as_settled(dwells)
    notes += _taken_as_steady(dwells, settings, weaker, notes)
    return replace(lines, notes=(*notes, *lines.notes), unsettled=_as_unsettled(dwells, settings, weaker))


def _evened(
    dwells: Sequence[Record], settings: Conditioning
) -> tuple[Sequence[Record], Sequence[Real], list[Notice]]:
    """The dwells on even stamps where those are even but for rounding, with what a channel missed or clipped put right.

    With what that makes of the variance of each channel's amplitudes, (channels,) of each dwell, and notes.  As they
    are with "none".
    """
    if settings.refine == "none":
        return dwells, [np.ones(len(record.channels)) for record in dwells], []
    whole, notes = [], []
    for record in dwells:
        even, note = with_even_stamps(record)
        complete, dropouts = without_dropouts(even)
        whole.append(complete)
        notes += [*([] if note is None else [note]), *dropouts]
    # The sine that stands in for clipped samples is that of the drive's own frequency, which they hide but little.
    limited = any(reaches_limits(record) for record in whole)
    at_their_own = at_frequencies(whole, drive_frequencies(whole)) if limited else whole
    unclipped = [
        without_clipping(record, stated.frequency_hz)
        for record, stated in zip(at_their_own, dwells, strict=True)
    ]
    notes += [notice for each in unclipped for notice in each.notices]
    evened = [
        replace(each.record, frequency_hz=record.frequency_hz)
        for each, record in zip(unclipped, dwells, strict=True)
    ]
    return evened, [each.weaker for each in unclipped], notes


def _as_unsettled(
    dwells: Sequence[Record], settings: Conditioning, weaker: Sequence[Real]
) -> Spectrum | None:
    """The lines with the dwells that are too short to show whether they have settled as whole records.

    None where no dwell is, or where one cannot be used so.
    """
    brief = [(record, of) for record, of in zip(dwells, weaker, strict=True) if not shows_settling(record)]
    if not brief or not settings.dwells_may_be_whole or any(record.values.ndim != 2 for record in dwells):
        return None
    try:
        whole = dwells_with_transients(
            [record for record, _ in brief], settings.band, settings.still,
            why="too short to show settling", slopes=settings.degree > 0, weaker=[of for _, of in brief],
        )  # fmt: skip
    except DashpotError:
        return None
    rest = [(record, of) for record, of in zip(dwells, weaker, strict=True) if shows_settling(record)]
    if not rest:
        return whole
    kept = [record for record, _ in rest]
    return concatenate([_of_settled(kept, kept, settings, [of for _, of in rest]), whole])


def _at_drive_frequencies(
    dwells: Sequence[Record], settings: Conditioning
) -> tuple[Sequence[Record], bool, list[Notice]]:
    """The dwells at the frequencies that they show, or as they are if those wander within a dwell; whether they do."""
    require_stated(dwells, settings.wanted)
    drive = drive_frequencies(dwells)
    refined = at_frequencies(dwells, drive)
    if drive_wanders(refined) < WANDER_LEVEL:
        return dwells, True, []
    return refined, False, drive.note(dwells)


def _with_drift(dwells: Sequence[Record], settings: Conditioning) -> tuple[Conditioning, Notice]:
    """The settings with the drift that all dwells together call for."""
    p = slopes_show(dwells, settings.wanted)
    what = "only an offset is" if p > DRIFT_LEVEL else "an offset and a slope are"
    chance = f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
    text = f"{what} removed from each dwell (drift over all dwells: {chance})"
    return settings.changed(drift=0 if p > DRIFT_LEVEL else 1), Notice("drift_by_evidence", text)


def _of_settled(
    dwells: Sequence[Record], given: Sequence[Record], settings: Conditioning, weaker: Sequence[Real]
) -> Spectrum:
    """The lines of settled dwells, which were `given` as recorded, of the multiples that were driven.

    weaker: times the variance that the channels of each dwell would have with all samples.
    """
    notes: list[Notice] = []
    driven = [DrivenOrders(settings.wanted)] * len(dwells)
    if settings.orders == "auto" and not settings.moments:
        driven = driven_orders(dwells, settings)
        notes = orders_used(driven)
    steps = rounding_steps(dwells)
    each = [
        _lines(record, settings, of, steps, times)
        for record, of, times in zip(dwells, driven, weaker, strict=True)
    ]
    notes.insert(0, account_of_dwells(given, each, settings))
    lines = concatenate(each)
    if settings.wanted == (1,) and settings.noise == "auto":
        lines = moderated(lines)
    return replace(lines, notes=(*notes, *summed_up(lines.notes)))


def _why_whole(
    dwells: Sequence[Record], settings: Conditioning, weaker: Sequence[Real], wanders: bool
) -> str | None:
    """Why dwells are used as whole records: asked for, no steady sines, or unsettled; None where they are not.

    Whether they have settled is one test of all of them together.
    """
    if not settings.dwells_may_be_whole:
        return None
    if settings.transients == "estimate":
        return "taken whole"
    if not all(record.values.ndim == 2 and len(record.time) >= TELLING for record in dwells):
        return None
    if wanders:
        return "not steady (the drive frequency wanders)"
    unsettled, fades = _unsettled(dwells), drive_fades(dwells, weaker) < FADING_LEVEL
    if fades:
        return f"not steady (the drive's amplitude drifts{', or they have not settled' if unsettled else ''})"
    if unsettled:
        return "not settled"
    return "not steady sines" if short_dwells_bend(dwells) else None


def _taken_as_steady(
    dwells: Sequence[Record], settings: Conditioning, weaker: Sequence[Real], notes: Sequence[Notice]
) -> list[Notice]:
    """That the drive's amplitude drifts, where dwells may not be whole records and no transient explains as much."""
    asked = settings.dwells_may_be_whole or settings.refine == "none"
    if asked or any(note.code in ("transients_ignored", "drive_wanders") for note in notes):
        return []
    return [Notice("drive_fades", FADES)] if drive_fades(dwells, weaker) < FADING_LEVEL else []


def _unsettled(dwells: Sequence[Record]) -> bool:
    """Whether dwells have transients that spoil their amplitudes, or rest for a part."""
    return transients_matter(dwells) or not all(driven_throughout(record) for record in dwells)


def driven_parts(dwells: Sequence[Record], settings: Conditioning) -> tuple[list[Record], list[Notice]]:
    """The dwells without their starts as `settle` says; with "none", those that rest for a part cut to what is driven.

    A dwell that is driven for too few periods to see its transient decay is left whole.
    """
    if settings.settle not in ("auto", "none"):
        return [without_start(record, float(settings.settle)) for record in dwells], []
    if settings.settle == "none" and settings.transients != "auto":
        return list(dwells), []
    kept, notes = [], []
    for record in dwells:
        if settings.settle == "none" and driven_throughout(record):
            kept.append(record)
            continue
        part = settled(record)
        enough = settings.settle == "auto" or periods_of(part.record) >= LONG_ENOUGH
        kept.append(part.record if enough else record)
        notes += [part.note] if enough and part.note is not None else []
    return kept, notes


def _lines(
    record: Record, settings: Conditioning, driven: DrivenOrders, steps: Real, weaker: Real
) -> Spectrum:
    """The lines of one record, whose channels are rounded to `steps` (channels,) and scatter `weaker` times as much."""
    settings = settings.changed(orders=driven.orders)
    known = driven.fit if driven.orders == (1,) and settings.refine != "always" else None
    record, notes = _at_its_frequency(record, settings)
    fit = fit_harmonics(record, None, settings) if known is None else known
    wanted = [fit.orders.index(order) for order in settings.wanted]
    frequencies = fit.frequency_hz * np.array([fit.orders[i] for i in wanted], dtype=float)
    h = calibration(record.channels, frequencies)
    covariance = fit.covariance[..., wanted, :, :] + _rounding(record, fit, wanted, steps)
    covariance = covariance * np.sqrt(weaker[:, None] * weaker)
    return Spectrum(
        record.channels,
        frequencies,
        fit.amplitudes[..., wanted, :] * h,
        covariance * h[:, :, None] * np.conj(h)[:, None, :],
        np.full(len(wanted), fit.samples),
        fit.dof[wanted],
        (fit.noise,) * len(wanted),
        np.full(len(wanted), record.experiment),
        second_moments(record, settings.drift) if _with_moments(record, settings) else None,
        (*notes, *fit.notes, *other_motion(record, fit, wanted)),
        stretches=(SettledDwell(fit.frequency_hz if len(wanted) > 1 else None),),
    )


def _rounding(record: Record, fit: HarmonicFit, wanted: Sequence[int], steps: Real) -> Real:
    """What rounding adds to the covariance of the wanted orders, (..., orders, channels, channels)."""
    if not np.any(steps > 0):
        return np.zeros(1)
    channels = len(steps)
    size = np.max(np.abs(fit.amplitudes), axis=-2).reshape(-1, channels)
    sd = np.sqrt(np.diagonal(fit.residual_covariance, axis1=-2, axis2=-1)).reshape(-1, channels)
    floor = np.array(
        [rounding_floor(record, fit.frequency_hz, a, b, steps) for a, b in zip(size, sd, strict=True)]
    )
    variance = np.diagonal(fit.covariance, axis1=-2, axis2=-1).real[..., wanted, :]
    missing = np.maximum(floor.reshape(*variance.shape[:-2], 1, channels) - variance, 0.0)
    added: Real = missing[..., None] * np.eye(channels)
    return added


def _with_moments(record: Record, settings: Conditioning) -> bool:
    """Whether second moments are asked for, and with "auto" whether they can be had."""
    if settings.moments != "auto":
        return settings.moments
    return settings.wanted == (1,) and not any(channel.delay for channel in record.channels)


def _at_its_frequency(record: Record, settings: Conditioning) -> tuple[Record, list[Notice]]:
    """The record with its frequency refined where that is always wanted, and a note."""
    if settings.refine != "always":
        return record, []
    refined = refine_frequency(record, drift=settings.drift)
    notes = []
    if abs(refined.frequency_hz - refined.nominal_hz) > 3 * refined.sd:
        text = f"{record.source}: driven at {refined.frequency_hz:.7g} Hz, not at {refined.nominal_hz:.7g} Hz"
        notes.append(Notice("frequency_refined", text, (record.source,)))
    record = replace(record, frequency_hz=refined.frequency_hz)
    if drive_wanders([record]) < WANDER_LEVEL:
        notes.append(Notice("drive_wanders", f"{record.source}: {WANDERS}", (record.source,)))
    return record, notes
