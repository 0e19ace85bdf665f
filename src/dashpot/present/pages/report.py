"""The report of an identification."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.check.data_findings import Collinearity, collinearity, doubtful, shares_by_band, undetermined
from dashpot.check.profile import Profile, chi2_surface, profile
from dashpot.check.residuals import (
    Residuals,
    calibrations_of,
    correlation,
    dwell_histories,
    residuals,
    responses_of_channels,
)
from dashpot.check.validation import RecordPrediction, validate
from dashpot.data.conditioning.used_dwells import UsedDwell
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.present.figures import spectra as figures
from dashpot.present.figures.comparison import estimate_figure
from dashpot.present.figures.response import MOST_PLANES, nyquist_figure, response_figure
from dashpot.present.figures.spectra import (
    beginnings,
    profile_figure,
    rows_of_pictures,
    shares_figure,
    whole_dwells,
)
from dashpot.present.figures.validation import drawn_of, prediction_figure
from dashpot.present.pages.page import Block, Page, Picture, Provenance, Verdict, figure_picture, page_html
from dashpot.present.schematic.drawing import mode_drawing, numbered_mode, schematic
from dashpot.present.tables.estimate import (
    fit_paragraphs,
    has_modes,
    mode_columns,
    parameter_columns,
    remarks,
    signs_in_words,
)
from dashpot.present.text.assessment import VERDICTS, diagnosis_in_words
from dashpot.present.text.check import profile_in_words
from dashpot.present.text.estimate import (
    convergence_in_words,
    fit_in_words,
    sentence,
    warnings_in_words,
)
from dashpot.present.text.next_steps import next_steps
from dashpot.present.text.numbers import short

# The evidence of an identification: from model, data and estimate to arrays to figures with what they show.


MOST_PANELS = 16  # channels drawn with amplitude and phase
MOST_IN_FILE = 6  # channels of a figure that stands alone
MOST_NAMES = 40  # unknowns in one picture
MOST_AMPLITUDES = 3000  # with more, profiles take longer than the report is worth


def evidence_blocks(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    found: Residuals | None,
    weak: Collinearity | None,
    dwells: Sequence[UsedDwell] = (),
) -> list[Block]:
    """Measured and estimated responses, histories, residuals, intervals, correlations, what each line tells.

    No batch axes; `dwells` are those that the spectrum's lines come from.
    """
    blocks = []
    if spectrum is not None and found is not None:
        blocks += _responses(model, spectrum, estimate, found)
        blocks += _histories(model, spectrum, estimate)
        blocks += _dwells(dwells, found)
        blocks += _residuals(found)
    if len(estimate.names) <= MOST_NAMES:
        text = "Each unknown with its 95 % interval; shaded, the interval at the Cramér-Rao bound."
        if any(unknown.sd is not None for unknown in model.unknowns):
            text += " 'stated' is what the rig file says of it."
        picture = figure_picture(estimate_figure(estimate, model=model), "Parameters with their intervals")
        blocks.append(Block("Intervals", (text,), pictures=(picture,)))
        if len(estimate.names) > 1:
            blocks.append(_correlations(estimate))
    if weak is not None and spectrum is not None and len(weak.names) <= MOST_NAMES:
        blocks.append(shares_block(weak, spectrum))
    return blocks


def prediction_block(title: str, predictions: Sequence[RecordPrediction]) -> Block:
    """FIT of each record and channel, and histories of the first record."""
    texts = [text[:1].upper() + text[1:] for text in fits_in_words(predictions)]
    records = [part for part in predictions if part.samples]
    shown = "Histories and spectra" if records else "Amplitudes and phases"
    drawn = drawn_of(predictions)
    pictures = tuple(
        figure_picture(
            prediction_figure(drawn, rows),
            f"{shown} of {joined([drawn.channels[k] for k in rows])}, measured and predicted",
        )
        for rows in rows_of_pictures(len(drawn.channels))
    )
    if records:
        texts.append(_part_shown(records[0]))
    return Block(title, tuple(texts), pictures=pictures, whole=True)


def fits_in_words(predictions: Sequence[RecordPrediction]) -> list[str]:
    """FIT of every channel, a sentence for each record."""
    texts = []
    for k, part in enumerate(predictions):
        fits = [
            f"{name} {short(100 * float(fit), 3)} %"
            for name, fit in zip(part.channels, part.fit, strict=True)
        ]
        record = f"record {k + 1}: " if len(predictions) > 1 else ""
        texts.append(f"{record}FIT {joined(fits)}.")
    return texts


def _part_shown(record: RecordPrediction) -> str:
    """Which part of a record its histories hold."""
    low, high = (short(float(end), 4) for end in (np.min(record.frequency_hz), np.max(record.frequency_hz)))
    return (
        f"The histories last {short(record.duration_s, 4)} s and hold the {len(record.frequency_hz)} lines from {low} "
        f"to {high} Hz that were used; motion at other frequencies is left out of all curves."
    )


def fit_figure(model: Model, spectrum: Spectrum, estimate: Estimate) -> Figure:
    """Measured and fitted: the first responses, or the first channels where no response can be formed.

    No batch axes.  Raises UsageError where the data drive no output.
    """
    found = residuals(
        model, estimate.values[: len(model.unknowns)], spectrum, calibrations_of(model, estimate)
    )
    responses = responses_of_channels(model, estimate, spectrum, found)
    if responses:
        return response_figure(responses[:MOST_IN_FILE])
    driven = _driven(found)
    if not driven:
        raise UsageError("no channel of these data depends on the estimate", "a figure of the fit")
    return _channels_figure(found, driven[:MOST_IN_FILE])


def _driven(found: Residuals) -> list[int]:
    """Places of the channels that can be compared with a prediction."""
    return [i for i in range(len(found.channels)) if np.any(np.isfinite(found.normalised[:, i]))]


def _channels_figure(found: Residuals, places: Sequence[int]) -> Figure:
    """Channels as measured and as predicted."""
    # Of another experiment's channel there is nothing to compare a prediction with.
    predicted = np.where(np.isfinite(found.measured), found.predicted, np.nan)
    return figures.amplitude_and_phase(
        [found.channels[i] for i in places], [found.units[i] for i in places], found.frequency_hz,
        found.measured[:, places], found.sd[:, places], None, None, predicted[:, places],
    )  # fmt: skip


def _responses(model: Model, spectrum: Spectrum, estimate: Estimate, found: Residuals) -> list[Block]:
    every = responses_of_channels(model, estimate, spectrum, found)
    responses = every[:MOST_PANELS]
    if responses:
        text = "Output over input, measured and predicted by the estimated rig."
        if spectrum.carries_loads:
            text += " The transients at both ends of the record, as estimated, are taken out of the measured motion."
        text += _first(MOST_PANELS, len(every))
        panels = tuple(
            figure_picture(
                response_figure(part),
                f"Amplitude and phase of {joined([shown.channel for shown in part])}, measured and model",
            )
            for part in (responses[rows.start : rows.stop] for rows in rows_of_pictures(len(responses)))
        )
        plane = figure_picture(
            nyquist_figure(responses),
            f"{joined([r.channel for r in responses[:MOST_PLANES]])} in the complex plane",
            wide=len(responses) > 2,
        )
        return [
            Block("Measured and model", (text,), pictures=panels, whole=True),
            Block(
                "In the complex plane",
                (f"Each resonance is a circle.{_first(MOST_PLANES, len(every))}",),
                pictures=(plane,),
                whole=True,
            ),
        ]
    driven = _driven(found)
    chosen = driven[:MOST_PANELS]
    if not chosen:
        return []
    pictures = []
    for rows in rows_of_pictures(len(chosen)):
        places = [chosen[k] for k in rows]
        shown = joined([found.channels[i] for i in places])
        pictures.append(
            figure_picture(
                _channels_figure(found, places), f"Amplitude and phase of {shown}, measured and predicted"
            )
        )
    text = "Amplitude and phase of each channel, as measured and as predicted from the inputs."
    texts = (text + _first(MOST_PANELS, len(driven)),)
    return [Block("Measured and model", texts, pictures=tuple(pictures), whole=True)]


def _first(most: int, channels: int) -> str:
    """That not all channels are drawn."""
    return f" Drawn are the first {most} of {channels} channels." if channels > most else ""


def _histories(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Block]:
    """The first whole record in time, where there is one."""
    if len(model.nonlinear) or not any(getattr(stretch, "samples", 0) for stretch in spectrum.stretches):
        return []
    try:
        predictions = validate(model, estimate, spectrum)
    except DataError:
        return []
    records = [part for part in predictions if part.samples]
    if not records:
        return []
    block = prediction_block("In time, as used", records[:1])
    text = "The inputs are taken as measured; the fit also estimates their noise and so leaves less."
    return [replace(block, paragraphs=(*block.paragraphs, text))]


def _dwells(dwells: Sequence[UsedDwell], found: Residuals) -> list[Block]:
    """Some dwells in time, the part used shaded."""
    histories = dwell_histories(dwells, found)
    if not histories:
        return []
    cut = [one for one in histories if one.begin > 0 or one.end < one.time[-1]]
    shaded = "Each of these dwells was used whole."
    if cut:
        places = [
            f"at {short(one.frequency_hz, 4)} Hz {short(one.begin, 3)} to {short(one.end, 3)} s of "
            f"{short(float(one.time[-1]), 3)} s"
            for one in cut
        ]
        shaded = f"Shaded is the part that was used: {joined(places)}."
    choice = (
        f"Shown are {len(histories)} of {len(dwells)} dwells, with them the one with the largest residual and the one "
        "of which least was used. Offsets are taken out; predicted is the steady motion."
    )
    channels = joined(histories[0].channels)
    pictures = (
        figure_picture(whole_dwells(histories), f"Dwells of {channels} in time. {shaded}"),
        figure_picture(
            beginnings(histories), f"{channels} where the part used begins, measured and predicted"
        ),
    )
    return [Block("Dwells in time", (shaded, choice), pictures=pictures, whole=True)]


def _residuals(found: Residuals) -> list[Block]:
    size = np.abs(found.normalised) / np.sqrt(2)
    if not np.any(np.isfinite(size)):
        return []
    unit = "their rms (the noise is unknown)" if found.scaled else "the standard deviation of the noise"
    texts = [
        f"Size of measured minus predicted amplitude over {unit}; where the model fits, 95 % lie in the band."
    ]
    rms = [
        f"{name} {short(value, 2)}"
        for name, value in zip(found.channels, found.rms().tolist(), strict=True)
        if np.isfinite(value)
    ]
    texts.append(f"Rms of each channel: {joined(rms)}.")
    worst = found.worst()
    if worst is not None:
        name, f, value = worst
        texts.append(f"The largest is {short(value, 2)}: {name} at {short(f, 4)} Hz.")
    figure = figures.residual_plot(found.channels, found.frequency_hz, size, worst)
    picture = figure_picture(figure, f"Residuals by frequency and channel. {texts[-1]}")
    return [Block("Residuals", tuple(texts), pictures=(picture,))]


def _correlations(estimate: Estimate) -> Block:
    figure = figures.correlation_plot(estimate.names, correlation(estimate.covariance))
    text = "Near ±1, two unknowns are hard to separate: their sum or difference is known better than either."
    return Block(
        "Correlation",
        (text,),
        pictures=(figure_picture(figure, "Correlation matrix of the estimates", wide=False),),
    )


def profiles_block(model: Model, spectrum: Spectrum, estimate: Estimate, level: float) -> Block | None:
    """Profiles of the unknowns whose normal interval misleads; None where there are none, or where they cost much."""
    records = any(getattr(stretch, "samples", 0) for stretch in spectrum.stretches)
    # unknowns whose profile is computed
    many = len(estimate.names) > 12 or spectrum.amplitudes.size > MOST_AMPLITUDES
    if records or many or len(model.nonlinear) or estimate.method not in AUTOMATIC:
        return None
    differing = []
    for name in estimate.names:
        try:
            profiled = profile(model, spectrum, name, level, estimate)
        except DashpotError:
            return None  # nothing is said of the surface of such a rig
        if bool(profiled.misleads):
            differing.append(profiled)
    return _drawn(differing) if differing else None


def _drawn(profiles: Sequence[Profile]) -> Block:
    names = joined([each.name for each in profiles])
    picture = figure_picture(
        profile_figure(profiles), f"Rise of χ² along {names}, beside the parabola of ± sd"
    )
    texts = ("Where the curve is not the parabola, use the interval from the profile.",)
    return Block(
        "Profiles that differ",
        texts,
        items=tuple(profile_in_words(each) for each in profiles),
        pictures=(picture,),
    )


def shares_block(weak: Collinearity, spectrum: Spectrum) -> Block:
    """What each line tells of each unknown."""
    middles, shares = shares_by_band(weak, spectrum.frequency_hz)
    figure = shares_figure(weak.names, middles, shares)
    text = "Which frequencies determine each unknown: per cent of the information on it."
    if weak.idle:
        text += f" {len(weak.idle)} of {spectrum.lines} lines contribute to no unknown."
    picture = figure_picture(figure, "Share of the information on each unknown by frequency")
    return Block("Information by frequency", (text,), pictures=(picture,))


HALF = 640.0  # px of a drawing that still has room beside the parameters
NO_ANSWER = {
    "identifiable": "No answer: the channels and data do not determine the unknowns.",
    "converged": "No answer: the iteration did not converge.",
}
TERMS = ("±", "interval", "bound", "χ²", "residual", "difference of the motion", "correlation")
OF_LINES = ("band", "share")  # of reports with a spectrum


@dataclass(frozen=True)
class EvidenceFound:
    """What the data say of an estimate beside its values; None where it cannot be said."""

    residuals: Residuals | None
    collinearity: Collinearity | None


def identification_report(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    level: float = 0.95,
    provenance: Provenance | None = None,
    *,
    channels: Sequence[Channel] = (),
    held_out: Sequence[RecordPrediction] = (),
    untried: Collection[str] = (),
    dwells: Sequence[UsedDwell] = (),
    histories: Sequence[RecordPrediction] = (),
) -> str:
    """HTML page of an estimate and the spectrum it came from, if it came from one (no batch axes).

    `channels` are drawn where there is no spectrum; `held_out` are predictions of what was not used; `untried`:
    treatments of time records that were not chosen; `dwells`: those behind the spectrum's lines, some are drawn;
    `histories`: the motion that the fit predicts for records without a spectrum.
    """
    shown = channels if spectrum is None else spectrum.channels
    found = _findings(model, spectrum, estimate)
    unsure = doubtful(estimate, level)
    names = names_of(model, shown)
    texts = tuple(sentence(capitalised(note.text, names)) for note in estimate.notes)
    text = convergence_in_words(estimate)
    if spectrum is None:
        subtitle = text
    else:
        low, high = float(spectrum.frequency_hz.min()), float(spectrum.frequency_hz.max())
        subtitle = f"{text} {spectrum.lines} lines from {short(low, 4)} to {short(high, 4)} Hz."
    on_held_out = [f"Held out and predicted: {text}" for text in fits_in_words(held_out)] if held_out else []
    page = Page(
        estimate.model or "Identification",
        subtitle,
        _verdict(estimate),
        headline(estimate, unsure),
        (*_statements(estimate, names), *on_held_out, *_on_law(model)),
        tuple(capitalised(text, names) for text in warnings_in_words(estimate, untried=untried)),
        Block("Parameters", tuple(_below_parameters(estimate)), (tuple(parameter_columns(estimate, level)),)),
        rig_picture(model, shown, estimate, unsure, level),
        tuple(next_steps(estimate, unsure, found.collinearity, plannable=not len(model.nonlinear))),
        (
            *((prediction_block("Measured and model", histories),) if histories else ()),
            *_evidence(model, spectrum, estimate, found, held_out, level, dwells),
            *([Block("What was done with the data", texts)] if texts else []),
        ),
        _terms(estimate, spectrum, (*held_out, *histories)),
        provenance,
    )
    return page_html(page)


def failure_report(
    model: Model,
    channels: Sequence[Channel],
    error: DashpotError,
    provenance: Provenance | None = None,
) -> str:
    """HTML page of an identification that gave nothing: why, what would help, and the rig."""
    names = names_of(model, channels)
    problems = [sentence(capitalised(problem.what, names)) for problem in error.problems]
    cures = [sentence(capitalised(problem.cure, names)) for problem in error.problems if problem.cure]
    page = Page(
        model.name or "Identification",
        "No parameters were estimated.",
        "bad",
        NO_ANSWER["identifiable" if isinstance(error, IdentifiabilityError) else "converged"],
        tuple(problems),
        drawing=rig_picture(model, channels, None, undetermined(model, channels), 0.95),
        steps=tuple(dict.fromkeys(cures)),
        provenance=provenance,
    )
    return page_html(page)


def rig_picture(
    model: Model, channels: Sequence[Channel], estimate: Estimate | None, unsure: Sequence[str], level: float
) -> Picture | None:
    """The drawing of the rig; None where it is too large for one."""
    try:
        drawing = schematic(model, channels, estimate, unsure, level)
    except UsageError:
        return None
    return Picture(drawing.svg(), drawing.title, wide=drawing.width > HALF)


def true_rig_picture(model: Model, theta: Real, channels: Sequence[Channel]) -> Picture | None:
    """The drawing of a rig with its true values θ (unknowns,), of which there is no estimate."""
    true = {unknown.name: float(value) for unknown, value in zip(model.unknowns, theta, strict=True)}
    elements = tuple(replace(each, value=true.get(each.name, each.value), sd=None) for each in model.elements)
    return rig_picture(replace(model, elements=elements), channels, None, (), 0.95)


def headline(estimate: Estimate, unsure: Sequence[str]) -> str:
    """Whether to trust the answer, in one sentence."""
    if not bool(estimate.converged):
        return "No answer: the iteration did not converge. The values below are those of the last step."
    poor = [name for name in unsure if "." not in name]
    names = joined(poor[:4]) + (" and others" if len(poor) > 4 else "")
    rest = f" {names} {'is' if len(poor) == 1 else 'are'} poorly determined." if poor else ""
    if estimate.assessment is None:
        return fit_in_words(estimate.fit) + rest
    verdict = estimate.assessment.verdict
    if verdict == "does not fit":
        cause = estimate.assessment.findings[0].text if estimate.assessment.findings else ""
        why = f" Likely cause: {sentence(cause)}" if cause else ""
        return f"The model does not fit the data: do not sign these values as they are.{why}{rest}"
    return sentence(VERDICTS[verdict]) + rest


def capitalised(text: str, names: Collection[str]) -> str:
    """The text with a capital letter first, unless it begins with one of the names: x1 is not X1."""
    word = re.split(r"[^\w$]", text, maxsplit=1)[0]
    return text if word in names else text[:1].upper() + text[1:]


def names_of(model: Model, channels: Sequence[Channel]) -> frozenset[str]:
    """Every name of a rig that a sentence may begin with."""
    elements = (element.name for element in model.elements)
    inputs = (drive.name for drive in model.inputs)
    return frozenset((*model.coordinates, *inputs, *elements, *(channel.name for channel in channels)))


def _terms(
    estimate: Estimate, spectrum: Spectrum | None, predicted: Sequence[RecordPrediction]
) -> tuple[str, ...]:
    """What is explained: whatever the page shows."""
    shown = {
        OF_LINES: spectrum is not None,
        ("damping ratio",): has_modes(estimate),
        ("FIT",): bool(predicted),
    }
    return (*TERMS, *(term for terms, there in shown.items() if there for term in terms))


def _verdict(estimate: Estimate) -> Verdict:
    if not bool(estimate.converged):
        return "bad"
    if estimate.assessment is not None:
        verdicts: dict[str, Verdict] = {"fits": "good", "does not fit": "bad", "cannot tell": "open"}
        return verdicts[estimate.assessment.verdict]
    if not estimate.fit.known_noise or estimate.fit.dof <= 0:
        return "open"
    return "bad" if bool(estimate.fit.rejected) else "good"


def _statements(estimate: Estimate, names: Collection[str]) -> list[str]:
    """The verdict with its numbers and the motion that is left over."""
    assessment = estimate.assessment
    if assessment is None:
        return [text for text, _ in fit_paragraphs(estimate)[1:]]
    causes = set(diagnosis_in_words(assessment.findings))
    texts = [text for text, _ in fit_paragraphs(estimate) if text not in causes]
    # The headline has said the verdict.
    return [capitalised(text.removeprefix(f"{VERDICTS[assessment.verdict]}: "), names) for text in texts]


def _on_law(model: Model) -> list[str]:
    """What holds of a nonlinear rig."""
    names = [model.elements[i].name for i in model.nonlinear]
    if not names:
        return []
    return [
        (
            f"The rig is nonlinear ({joined(names)}): its modes are those of its linear part, and the values hold for "
            "motions as large as those of this test."
        )
    ]


def _below_parameters(estimate: Estimate) -> list[str]:
    texts = list(remarks(estimate))
    if estimate.signs:
        texts.append(signs_in_words(estimate))
    return texts


def _findings(model: Model, spectrum: Spectrum | None, estimate: Estimate) -> EvidenceFound:
    if spectrum is None:
        return EvidenceFound(None, None)
    left = residuals(
        model, estimate.values[: len(model.unknowns)], spectrum, calibrations_of(model, estimate)
    )
    try:
        weak = collinearity(chi2_surface(model, spectrum, estimate), estimate.covariance)
    except DashpotError:
        weak = None  # of such a rig nothing is said of single lines
    return EvidenceFound(left, weak)


def _evidence(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    found: EvidenceFound,
    held_out: Sequence[RecordPrediction],
    level: float,
    dwells: Sequence[UsedDwell],
) -> list[Block]:
    blocks = []
    if estimate.assessment is not None and estimate.assessment.findings:
        causes = tuple(diagnosis_in_words(estimate.assessment.findings))
        blocks.append(Block("Why it does not fit", items=causes, whole=True))
    blocks += evidence_blocks(model, spectrum, estimate, found.residuals, found.collinearity, dwells)
    if spectrum is not None and (differing := profiles_block(model, spectrum, estimate, level)) is not None:
        blocks.append(differing)
    if held_out:
        blocks.append(prediction_block("Predicted, not used", held_out))
    if has_modes(estimate):
        blocks.insert(1 if blocks and blocks[0].title.startswith("Why") else 0, _modes(model, estimate))
    return blocks


def _modes(model: Model, estimate: Estimate) -> Block:
    """Natural frequencies and damping ratios, and the first shapes, moving."""
    assert estimate.modes is not None
    pictures = []
    for number in range(1, min(len(estimate.modes.eigenvalues), 4) + 1):
        title, shape = numbered_mode(model, estimate, number)
        try:
            pictures.append(Picture(mode_drawing(model, shape, title).svg(), title, wide=False))
        except UsageError:
            break
    return Block("Modes", (), (tuple(mode_columns(estimate.modes)),), tuple(pictures), whole=True)
