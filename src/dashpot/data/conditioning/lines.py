"""From records to the lines of a Spectrum, conditioned as told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Bools, Ints, Real
from dashpot.data.conditioning.clock import with_even_stamps, within_times
from dashpot.data.conditioning.drive_frequency import (
    at_drive_frequencies,
    driven_at,
    refine_frequency,
    require_stated,
)
from dashpot.data.conditioning.harmonic_fit import (
    SIGNIFICANT,
    HarmonicFit,
    fit_harmonics,
    rounding_steps,
    second_moments,
)
from dashpot.data.conditioning.regression import highest_multiple, holds_a_period
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.conditioning.steadiness import (
    CHEAP,
    FADES,
    MANY_PERIODS,
    SLOPE_LEVEL,
    UNSETTLED,
    UNSTEADY,
    WANDERS,
    Unsteady,
    driven_throughout,
    settled,
    shows_settling,
    slopes_show,
)
from dashpot.data.conditioning.unmeasured import expected, marked, notices_of_doubt
from dashpot.data.conditioning.whole_record import AT_REST, continuous, dwells_with_transients, whole_records
from dashpot.data.noise import LEVEL, moderated
from dashpot.data.periods import averaged_periods
from dashpot.data.record import Record, calibrated
from dashpot.data.spectrum import SettledDwell, Spectrum, concatenate
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import counted
from dashpot.notices import Notice

# What was done to settled dwells, in one line for the whole test.


LITTLE = 0.3  # part of a channel's power that the multiples of the drive explain
DRIFTS = {-1: "nothing", 0: "mean", 1: "linear trend"}


def account_of_dwells(given: Sequence[Record], lines: Sequence[Spectrum], settings: Conditioning) -> Notice:
    """How many dwells, how much of them, at which frequency and without which drift; `given` as they were recorded.

    lines: those of each dwell, in the same order.
    """
    samples = sum(len(record.time) for record in given)
    used = sum(int(each.samples[0]) for each in lines)
    moved = sum(
        settings.wanted[0] * record.frequency_hz != each.frequency_hz[0]
        for record, each in zip(given, lines, strict=True)
        if record.frequency_hz is not None
    )
    share = "all" if used == samples else f"{100 * used / samples:.3g} % of"
    frequency = "kept" if not moved else f"refined in {moved}" if moved < len(given) else "refined"
    drift = DRIFTS.get(settings.degree, f"polynomial of degree {settings.degree}")
    dwells = f"{len(given)} stepped-sine dwell{'' if len(given) == 1 else 's'}"
    text = f"{dwells}: {share} {samples:,} samples used, stated frequencies {frequency}, {drift} removed"
    return Notice("settled_dwells", text)


def other_motion(record: Record, fit: HarmonicFit, wanted: Sequence[int]) -> Notice | None:
    """That most channels of a dwell hardly move with its drive, but otherwise, and not as white noise does.

    wanted: which of the fit's orders are used.  An earthquake given as a dwell does; so does one of hum or drift alone.
    """
    p = fit.whiteness[np.isfinite(fit.whiteness)]
    if fit.noise == "white" and np.min(p, initial=1.0) > LEVEL:
        return None
    power = np.abs(fit.amplitudes) ** 2 / 2
    driven, of_all = np.sum(power[..., wanted, :], axis=-2), np.sum(power, axis=-2)
    rest = np.diagonal(fit.residual_covariance, axis1=-2, axis2=-1).real
    share = np.median(driven / np.maximum(of_all + rest, 1e-300))
    if share > LITTLE:
        return None
    text = (
        f"only {100 * share:.2g} % of the signal power is at {fit.frequency_hz:g} Hz and the harmonics used, "
        "and the rest is not white noise, so this is not a steady sine; remove the frequency to use the whole "
        "record"
    )
    return record.notice("other_motion", text)


Treated = tuple[Sequence[Record], list[Notice]]  # what dwells become, and notices


# Dwells too brief to hold an amplitude: left out where most dwells are longer.


def long_enough(dwells: Sequence[Record]) -> Treated:
    """The dwells without those that end before their first period, where most are longer.

    A recording that was stopped within a dwell, or one dwell that failed, is no reason to refuse the others.
    """
    brief = dict[int, str]()
    for k, record in enumerate(dwells):
        f = record.stated_hz
        if len(record.time) < 5:  # samples of a dwell: more than its offset, slope and fundamental have terms
            brief[k] = f"{counted(len(record.time), 'sample')} at {f:g} Hz"
        elif not holds_a_period(record.time, f):
            brief[k] = f"{record.periods:.2g} of a period at {f:g} Hz"
    if 2 * len(brief) >= len(dwells):
        return dwells, []
    kept = [record for k, record in enumerate(dwells) if k not in brief]
    notes = [dwells[k].notice("dwell_left_out", f"left out: {text}") for k, text in brief.items()]
    return kept, notes


# Harmonics of the drive that every channel shows beyond doubt, which are data as good as the fundamental.
#
# A stepper motor or a crank moves its base at many multiples of its frequency, and these may be all that
# reaches the higher modes. Where only the response shows a multiple, it is distortion and stays out of the
# data.


STRONG = 0.01  # of the fundamental, in the channel that shows a multiple most


def driven_orders(
    records: Sequence[Record], conditioning: Conditioning
) -> tuple[list[tuple[int, ...]], list[Notice]]:
    """For each dwell the multiples of its frequency that are driven: 1 alone, unless half of the long dwells have more,
    which a note says.

    A multiple counts where each channel's F test rejects noise at 1 % over all, and where it has a hundredth of some
    channel's fundamental.  Short dwells and repeats have their fundamental alone.
    """
    able = [record.values.ndim == 2 and record.periods >= MANY_PERIODS for record in records]
    driven = [
        _orders_of(record, conditioning) if long else (1,) for record, long in zip(records, able, strict=True)
    ]
    several = [len(orders) for orders in driven if len(orders) > 1]
    if not several or 2 * len(several) < sum(able):
        return [(1,)] * len(driven), []
    dwells = f"{len(several)} dwell{'s' if len(several) > 1 else ''}"
    text = f"{sum(several)} lines of {dwells}: harmonics of the drive that appear in every channel are used"
    return driven, [Notice("harmonics_driven", text)]


def _orders_of(record: Record, conditioning: Conditioning) -> tuple[int, ...]:
    """The multiples that drive every channel of a long dwell."""
    fundamental = conditioning.changed(orders=(1,))
    try:
        if np.sum(_driven(fit_harmonics(record, None, fundamental))) < 2:
            return (1,)
        most = min(100, highest_multiple(record, record.stated_hz), (len(record.time) - 4) // 6)
        every = fit_harmonics(record, None, fundamental.changed(orders=range(1, most + 1), harmonics="none"))
    except DataError:
        return (1,)  # the samples do not tell so many apart
    there = _driven(every)
    return tuple(np.array(every.orders)[there].tolist()) if there[0] else (1,)


def _driven(fit: HarmonicFit) -> Bools:
    """(orders,): which multiples every channel shows."""
    size = np.abs(fit.amplitudes)
    variance = np.diagonal(fit.covariance, axis1=-2, axis2=-1).real
    with np.errstate(divide="ignore", invalid="ignore"):
        F = np.where(variance > 0, size**2 / variance, np.where(size > 1e-9 * size[0], np.inf, 0.0))
    p = fdtrc(2, fit.dof[:, None], F)
    strong = np.any(size >= STRONG * size[0], axis=-1)
    return strong & np.all(p < SIGNIFICANT / size.size, axis=-1)


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
        # Periods may be averaged where nothing is asked for that needs the whole record or its fundamental
        chosen = settings.orders != "auto" or settings.transients != "auto" or settings.band is not None
        may_repeat = not chosen and settings.still is None and settings.dwells_may_be_whole
        mean = averaged_periods(record) if may_repeat else None
        if mean is None:
            rest.append(record)
        else:
            parts.append(moderated(mean[0], kind="periods") if settings.noise == "auto" else mean[0])
    whole = [record for record in rest if record.frequency_hz is None]
    dwells = [record for record in rest if record.frequency_hz is not None]
    if dwells:
        parts.append(_of_dwells(dwells, settings))
    if whole:
        parts.append(
            whole_records(
                whole,
                band_hz=settings.band,
                still=settings.still,
                ramp=settings.degree > 0,
                marks=settings.refine != "none",
            )
        )
    lines = concatenate(parts)
    if settings.still is None or AT_REST not in lines.noise:
        return lines
    text = (
        f"noise taken from the at-rest record (spectrum averaged over {settings.still.dof:.0f} values around "
        "each line)"
    )
    return replace(lines, notes=(*lines.notes, Notice("noise_at_rest", text)))


def _of_dwells(dwells: Sequence[Record], settings: Conditioning) -> Spectrum:
    """The lines of dwells, treated as all of them together ask for."""
    dwells, left_out = long_enough(dwells)
    uncut, marks = evened_and_marked(dwells, settings)
    of_samples = [*left_out, *marks]
    # Without transients where those are not to be estimated and matter
    wanted = settings.transients == "settle" and settings.settle == "none"
    if wanted and (UNSETTLED.shows(uncut) or not all(map(driven_throughout, uncut))):
        settings = settings.changed(settle="auto")
    dwells, cuts = driven_parts(uncut, settings)
    dwells, moved = _at_drive_frequencies(dwells, settings)
    notes = [*of_samples, *cuts, *moved]
    found = [row for row in UNSTEADY if row.asked(settings) and row.shows(dwells)]
    why = _why_whole(dwells, settings, found)
    if why is not None:
        at_hz = [record.frequency_hz for record in dwells]
        if settings.settle == "none":  # what was cut off to see a steady sine is data like the rest
            dwells, notes = uncut, of_samples
        lines = _as_whole(dwells, at_hz, settings, why)
        return replace(lines, notes=(*notes, *notices_of_doubt(dwells), *lines.notes))
    if settings.drift == "auto" and any(record.periods < CHEAP for record in dwells):
        # The drift that all dwells together call for
        p = slopes_show(dwells, settings.wanted)
        what = "only the mean is" if p > SLOPE_LEVEL else "a linear trend is"
        chance = f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
        text = f"{what} removed from each dwell (test for a slope over all dwells: {chance})"
        settings = settings.changed(drift=0 if p > SLOPE_LEVEL else 1)
        notes.append(Notice("drift_by_evidence", text))
    lines = _of_settled(dwells, uncut, settings)
    # Dwells that count as settled sines, and are none or too short to show it. A drive whose amplitude drifts
    # explains nothing where something else does
    others = [row for row in found if row is not FADES]
    said = {row.code: Notice(row.code, row.ignored) for row in others or found}
    brief = tuple(
        record.source for record in dwells if not shows_settling(record) and record.values.ndim == 2
    )
    if brief and UNSETTLED.asked(settings) and UNSETTLED.code not in said:
        which = "one dwell is" if len(brief) == 1 else f"{len(brief)} dwells are"
        text = f"{which} too short to show a transient: treated as settled"
        said["transient_undetectable"] = Notice("transient_undetectable", text, brief)
    notes += list(said.values())
    return replace(lines, notes=(*notes, *lines.notes), unsettled=_as_unsettled(dwells, settings))


def evened_and_marked(dwells: Sequence[Record], settings: Conditioning) -> Treated:
    """On even stamps where those are even but for rounding, with the samples marked that channels clip or miss; as they
    are with "none"."""
    if settings.refine == "none":
        return dwells, []
    evened = [with_even_stamps(record) for record in dwells]
    with_marks, notes = marked([record for record, _ in evened])
    return with_marks, [*(note for _, note in evened if note is not None), *notes]


def driven_parts(dwells: Sequence[Record], settings: Conditioning) -> Treated:
    """The dwells without their starts as `settle` says; with "none", those that rest for a part cut to what is driven.

    A dwell that is driven for too few periods to see its transient decay is left whole.
    """
    if settings.refine == "auto":
        beyond_half_rate = [record for record in dwells if 2 * record.step_s * record.stated_hz > 1]
        require_stated(beyond_half_rate, settings.wanted)
    if settings.settle not in ("auto", "none"):
        late = float(settings.settle)
        return [within_times(record, record.time[0] + late, np.inf) for record in dwells], []
    if settings.settle == "none" and settings.transients != "auto":
        return dwells, []
    kept, notes = [], []
    for record in dwells:
        if settings.settle == "none" and driven_throughout(record):
            kept.append(record)
            continue
        part = settled(record)
        enough = settings.settle == "auto" or part.record.periods >= MANY_PERIODS
        kept.append(part.record if enough else record)
        notes += [part.note] if enough and part.note is not None else []
    return kept, notes


def _at_drive_frequencies(dwells: Sequence[Record], settings: Conditioning) -> Treated:
    """At the frequencies that they show: all together, unless these wander within a dwell; each by itself "always"."""
    if settings.refine == "none":
        return dwells, []
    if settings.refine == "auto":
        require_stated(dwells, settings.wanted)
        refined, notes = at_drive_frequencies(dwells)
        return (dwells, []) if WANDERS.shows(refined) else (refined, notes)
    refined, notes = [], []
    for record in dwells:
        found = refine_frequency(record, drift=settings.drift)
        refined.append(replace(record, frequency_hz=found.frequency_hz))
        if abs(found.frequency_hz - found.nominal_hz) > 3 * found.sd:
            notes.append(driven_at(record, found.frequency_hz))
        if WANDERS.shows(refined[-1:]):
            notes.append(record.notice(WANDERS.code, WANDERS.ignored))
    return refined, notes


def _as_whole(
    dwells: Sequence[Record], at_hz: Sequence[float | None], settings: Conditioning, why: str
) -> Spectrum:
    """Dwells as whole records; the motion around, at `at_hz`, begins the samples that are not measured."""
    begun = [expected(replace(record, frequency_hz=f)) for record, f in zip(dwells, at_hz, strict=True)]
    return dwells_with_transients(
        [replace(full, frequency_hz=of.frequency_hz) for full, of in zip(begun, dwells, strict=True)],
        settings.band,
        settings.still,
        why=why,
        slopes=settings.degree > 0,
    )


def _as_unsettled(dwells: Sequence[Record], settings: Conditioning) -> Spectrum | None:
    """The lines with the dwells that are too short to show whether they have settled as whole records.

    None where no dwell is, or where one cannot be used so.
    """
    brief = [record for record in dwells if not shows_settling(record)]
    if not brief or not settings.dwells_may_be_whole or any(record.values.ndim != 2 for record in dwells):
        return None
    try:
        at_hz = [record.frequency_hz for record in brief]
        whole = _as_whole(brief, at_hz, settings, "too short to detect a transient")
    except DashpotError:
        return None
    rest = [record for record in dwells if shows_settling(record)]
    return concatenate([_of_settled(rest, rest, settings), whole]) if rest else whole


def _of_settled(dwells: Sequence[Record], given: Sequence[Record], settings: Conditioning) -> Spectrum:
    """The lines of settled dwells, which were `given` as recorded, of the multiples that were driven."""
    notes: list[Notice] = []
    steps = zip(dwells, rounding_steps(dwells), strict=True)
    dwells = [replace(of, cell=cell) if np.any(cell) and of.values.ndim == 2 else of for of, cell in steps]
    driven = [settings.wanted] * len(dwells)
    if settings.orders == "auto" and not settings.moments:
        driven, notes = driven_orders(dwells, settings)
    each, told, other = zip(
        *(settled_lines(record, settings, of) for record, of in zip(dwells, driven, strict=True)), strict=True
    )
    notes.insert(0, account_of_dwells(given, each, settings))
    lines = concatenate(each)
    if settings.wanted == (1,) and settings.noise == "auto":
        lines = moderated(lines, np.concatenate(told))
    first, *more = [note for note in other if note is not None] or [None]
    if first is not None and more:
        text = f"{first.text}; {len(more)} more dwell{'' if len(more) == 1 else 's'} likewise"
        first = replace(
            first, text=text, of=tuple(name for note in (first, *more) if note for name in note.of)
        )
    return replace(lines, notes=(*notes, *lines.notes, *([] if first is None else [first])))


def _why_whole(dwells: Sequence[Record], settings: Conditioning, found: Sequence[Unsteady]) -> str | None:
    """Why dwells are used as whole records: asked for, no steady sines, or unsettled; None where they are not."""
    if not settings.dwells_may_be_whole:
        return None
    if settings.transients == "estimate":
        return "used whole"
    # samples of a dwell that shows by itself whether it is a steady sine
    if not all(record.values.ndim == 2 and len(record.time) >= 16 for record in dwells):
        return None
    if WANDERS in found:
        return WANDERS.why
    reasons = [row.why for row in found]
    if not all(map(driven_throughout, dwells)):
        reasons.append(UNSETTLED.why)
    return " or ".join(dict.fromkeys(reasons)) or None


def settled_lines(
    record: Record, settings: Conditioning, orders: tuple[int, ...]
) -> tuple[Spectrum, Real, Notice | None]:
    """The lines of one record, the share of each amplitude's information that what is measured has, (lines, channels),
    and a note where it moves otherwise than with its drive."""
    settings = settings.changed(orders=orders)
    fit = fit_harmonics(record, None, settings)
    wanted = [fit.orders.index(order) for order in settings.wanted]
    frequencies = fit.frequency_hz * np.array([fit.orders[i] for i in wanted], dtype=float)
    covariance = fit.covariance[..., wanted, :, :]
    # Whether second moments are asked for, and with "auto" whether they can be had
    if settings.moments != "auto":
        with_moments = settings.moments
    else:
        with_moments = settings.wanted == (1,) and not any(channel.delay for channel in record.channels)
    lines = Spectrum(
        record.channels,
        frequencies,
        *calibrated(record.channels, frequencies, fit.amplitudes[..., wanted, :], covariance),
        np.full(len(wanted), fit.samples),
        fit.dof[wanted],
        (fit.noise,) * len(wanted),
        np.full(len(wanted), record.experiment),
        second_moments(expected(record), settings.drift) if with_moments else None,
        fit.notes,
        stretches=(SettledDwell(fit.frequency_hz if len(wanted) > 1 else None),),
    )
    return lines, fit.told[wanted], other_motion(record, fit, wanted)


# Which part of each dwell stands behind its lines, for pictures of it.


@dataclass(frozen=True)
class UsedDwell:
    """A dwell as recorded, the stamps of the first and the last sample that were used, s, and its lines (k,)."""

    record: Record
    begin: float
    end: float
    lines: Ints

    @property
    def discarded(self) -> float:
        """The share of its length that was not used."""
        time = self.record.time
        return 1.0 - (self.end - self.begin) / float(time[-1] - time[0])


def used_dwells(
    records: Sequence[Record], spectrum: Spectrum, settings: Conditioning
) -> tuple[UsedDwell, ...]:
    """Each dwell with its lines in the spectrum that `settings` made of the records.

    Nothing where lines do not stand for one settled dwell each: whole records, averaged periods, tables among them.
    """
    if any(record.frequency_hz is None for record in records):
        return ()
    records, _ = long_enough(records)
    # The lines of one dwell after another: of a stretch with a fundamental all, else each line alone
    fundamental = [getattr(stretch, "fundamental_hz", None) for stretch in spectrum.stretches]
    alone = np.array([hz is None for hz in fundamental])[spectrum.stretch]
    lines = np.split(
        np.arange(spectrum.lines), np.flatnonzero((np.diff(spectrum.stretch) != 0) | alone[1:]) + 1
    )
    if len(lines) != len(records) or not all(
        _fits(record, spectrum, numbers) for record, numbers in zip(records, lines, strict=True)
    ):
        return ()
    if settings.refine != "none":
        records = [with_even_stamps(record)[0] for record in records]
    parts, _ = driven_parts(records, settings)
    return tuple(
        UsedDwell(record, float(part.time[0]), float(part.time[-1]), numbers)
        for record, part, numbers in zip(records, parts, lines, strict=True)
    )


def _fits(record: Record, spectrum: Spectrum, lines: Ints) -> bool:
    """Whether the lines are multiples of the record's frequency, of its experiment."""
    if record.values.ndim != 2:
        return False
    order = spectrum.frequency_hz[lines] / record.stated_hz
    # 0.02 of the drive frequency: as far as a line may lie from a multiple of it
    near = np.all(np.abs(order - np.rint(order)) <= 0.02 * np.maximum(order, 1.0)) and np.all(order > 0.5)
    settled = spectrum.noise[int(lines[0])] in ("white", "blocks")
    return bool(near and settled and np.all(spectrum.experiment[lines] == record.experiment))
