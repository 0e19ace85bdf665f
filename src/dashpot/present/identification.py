"""The report of an identification: answer, evidence, and what to do next; and of one that gave nothing."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import astuple

import numpy as np
from matplotlib.figure import Figure

from dashpot.channel import Channel
from dashpot.check.evidence import Collinearity, Evidence, doubtful, evidence_of, undetermined
from dashpot.check.residuals import DwellHistory, correlation
from dashpot.check.validation import RecordPrediction
from dashpot.data.conditioning.lines import UsedDwell
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.assessment import Residuals
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined, listed
from dashpot.model.network import Model
from dashpot.present.check import shares_section
from dashpot.present.document import Document, Items, Picture, Provenance, Section, section
from dashpot.present.estimate import (
    CYCLES,
    CYCLES_TEXT,
    STATED,
    STATED_TEXT,
    basis_in_words,
    convergence_in_words,
    cycle_columns,
    diagnosis_in_words,
    has_modes,
    headline,
    mode_columns,
    motion_in_words,
    page_verdict,
    parameter_columns,
    profiles_in_words,
    reasons_in_words,
    remaining_in_words,
    remarks,
    residuals_in_words,
    signs_in_words,
    spread_columns,
    stated_columns,
    warnings_in_words,
    worst_in_words,
)
from dashpot.present.figures import spectra as figures
from dashpot.present.figures.comparison import change_figure, cost_figure, cycle_figure, estimate_figure
from dashpot.present.figures.spectra import rows_of_pictures
from dashpot.present.page import figure_picture, page_html
from dashpot.present.schematic.drawing import mode_drawing, numbered_mode, rig_picture
from dashpot.present.validation import fits_in_words, prediction_section
from dashpot.present.words import capitalised, names_of, percent, sentence, short

MOST_PANELS = 16  # channels drawn with amplitude and phase
MOST_NAMED = 4  # unknowns named one by one
TERMS = ("±", "interval", "bound", "χ²", "residual", "difference of the motion", "correlation")


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
    found = evidence_of(model, spectrum, estimate, level, dwells, channels)
    unsure = doubtful(estimate, level)
    names = names_of(model, shown)
    # What the headline has not said: other reasons of the verdict, and the motion by channel
    assessment = estimate.assessment
    statements = []
    if assessment is not None:
        statements = [*reasons_in_words(estimate, assessment), motion_in_words(assessment)]
        if found.residuals is None:
            statements += [residuals_in_words(estimate.fit), worst_in_words(assessment)]
    statements += [f"Held out and predicted: {text}" for text in fits_in_words(held_out)]
    curved = [model.elements[i].name for i in model.nonlinear]
    if curved:
        statements.append(
            f"The rig is nonlinear ({joined(curved)}): its modes are those of its linear part, and the values "
            "are valid for motions as large as in this test."
        )
    shown_terms = {
        ("band", "share"): found.residuals is not None,
        ("damping ratio",): has_modes(estimate),
        ("FIT",): bool(held_out or histories),
    }
    treatments = [sentence(capitalised(note.text, names)) for note in estimate.notes]
    method = f"Method {convergence_in_words(estimate)}"
    if found.residuals is not None:
        lines = found.residuals.frequency_hz
        low, high = (short(float(end), 4) for end in (lines.min(), lines.max()))
        method = f"Fitted: {len(lines)} lines from {low} to {high} Hz. {method}"
    treatments.append(method)
    steps = next_steps(estimate, unsure, found.collinearity, plannable=not len(model.nonlinear))
    return page_html(
        Document(
            estimate.model or "Identification",
            (
                *([prediction_section("Measured and model", histories)] if histories else []),
                *_evidence(model, spectrum, estimate, found, held_out, len(dwells)),
            ),
            page_verdict(estimate),
            headline=headline(estimate, unsure),
            statements=tuple(filter(None, statements)),
            cautions=tuple(
                capitalised(text, names) for text in warnings_in_words(estimate, untried=untried, coded=True)
            ),
            answer=section(
                "Parameters",
                basis_in_words(estimate, noise_only=False),
                profiles_in_words(estimate),
                signs_in_words(estimate),
                parameter_columns(estimate, level, bound=False, noise=False),
                assumptions_in_words(model, estimate, shown),
            ),
            beside=_modes(model, estimate) if has_modes(estimate) else None,
            drawing=rig_picture(model, shown, estimate, unsure, level),
            appendix=(
                section("What next", Items(tuple(steps))),
                section("How the data were processed", *treatments),
            ),
            terms=(*TERMS, *(term for terms, there in shown_terms.items() if there for term in terms)),
            provenance=provenance,
        )
    )


def assumptions_in_words(model: Model, estimate: Estimate, channels: Sequence[Channel]) -> str:
    """What the values rest on: exact and stated values, the laws of the elements, the calibration of the channels."""
    exact = [name for name, _, _ in estimate.known]
    parts = [f"{listed(exact, 6)} exactly as stated"] if exact else []
    if estimate.stated:
        parts.append(
            f"{listed([name for name, _, _ in estimate.stated], 6)} as stated, with the stated uncertainty"
        )
    laws = [model.elements[i].name for i in model.nonlinear]
    if not laws:
        parts.append("linear elements")
    open_gains = {name.partition(".")[0] for name in estimate.names if "." in name}
    if [channel for channel in channels if channel.name not in open_gains]:
        others = (
            " of the other channels"
            if open_gains & {channel.name for channel in channels}
            else " of all channels"
        )
        parts.append(f"the calibration{others} as the rig file states it")
    return f"Assumed: {'; '.join(parts)}." if parts else ""


def failure_report(
    model: Model, channels: Sequence[Channel], error: DashpotError, provenance: Provenance | None = None
) -> str:
    """HTML page of an identification that gave nothing: why, what would help, and the rig."""
    names = names_of(model, channels)
    problems = [sentence(capitalised(problem.what, names)) for problem in error.problems]
    cures = [sentence(capitalised(problem.cure, names)) for problem in error.problems if problem.cure]
    undecided = isinstance(error, IdentifiabilityError)
    why = (
        "the channels and data do not determine the unknowns" if undecided else "the search did not converge"
    )
    return page_html(
        Document(
            model.name or "Identification",
            verdict="bad",
            subtitle="No parameters were estimated.",
            headline=f"No answer: {why}.",
            statements=tuple(problems),
            drawing=rig_picture(model, channels, unsure=undetermined(model, channels)),
            steps=tuple(dict.fromkeys(cures)),
            provenance=provenance,
        )
    )


def fit_figure(model: Model, estimate: Estimate, channels: Sequence[Channel]) -> Figure:
    """Measured and fitted, of what the estimate keeps of its lines, which are of some of the `channels`.

    The first six responses, or the first six channels where no response can be formed.  No batch axes.  Raises
    UsageError if the data drive no output.
    """
    found = evidence_of(model, None, estimate, channels=channels)
    if found.responses:
        return figures.response_figure(found.responses[:6])
    driven = [] if found.residuals is None else found.residuals.compared()
    if found.residuals is None or not driven:
        raise UsageError("none of the channels depends on the estimate", "a figure of the fit")
    return figures.residual_channels_figure(found.residuals, driven[:6])


def moved_figure(model: Model, estimate: Estimate, level: float = 0.95) -> Figure:
    """By how much each unknown has moved from what was stated or guessed of it, with its interval.

    The first 40 unknowns; no batch axes.  Raises UsageError where nothing is stated or guessed.
    """
    rows = []
    low, high = estimate.interval(level)
    for k, unknown in enumerate(model.unknowns):
        nominal = unknown.guess if unknown.prior is None else unknown.prior
        if nominal:
            ends = sorted((float(low[k] / nominal), float(high[k] / nominal)))
            rows.append((unknown.name, float(estimate.values[k] / nominal), *ends))
    if not rows:
        what = "nothing is stated or guessed of the unknowns, so no change can be drawn"
        raise UsageError(what, cure="give guesses, such as guess = 1")
    names, *numbers = zip(*rows[:40], strict=True)
    value, lower, upper = 100 * (np.array(numbers) - 1)
    return change_figure([str(name) for name in names], value, lower, upper)


# The evidence.


def _evidence(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    found: Evidence,
    held_out: Sequence[RecordPrediction],
    dwells: int,
) -> list[Section]:
    """Causes of a misfit, modes, responses, histories, residuals, intervals, correlations, what each line tells."""
    sections = []
    if estimate.assessment is not None and estimate.assessment.findings:
        causes = Items(tuple(diagnosis_in_words(estimate.assessment.findings)))
        sections.append(section("Why it does not fit", causes, whole=True))
    if estimate.cycles:
        pictures = []
        for elements in dict.fromkeys(cycle.elements for cycle in estimate.cycles):
            figure = cycle_figure([cycle for cycle in estimate.cycles if cycle.elements == elements])
            said = f"Equivalent stiffness and damping of {joined(elements)} over the amplitude"
            pictures.append(figure_picture(figure, said))
        sections.append(section(CYCLES, CYCLES_TEXT, *pictures, cycle_columns(estimate.cycles), whole=True))
    if found.residuals is not None:
        sections += _responses(found, found.residuals)
        if found.records:
            text = (
                "The inputs are taken as measured; the fit also estimates their noise, so its residuals are "
                "smaller."
            )
            sections.append(prediction_section("In time, as used", found.records[:1], text))
        if found.dwells:
            sections.append(_dwells(found.dwells, dwells))
        sections += _residuals(found.residuals, estimate)
    if len(estimate.names) <= 40:  # more unknowns do not fit in one picture
        text = "Each unknown with its 95 % interval; shaded, the interval at the Cramér-Rao bound."
        if estimate.stated:
            text += " 'stated' is the value in the rig file."
        picture = figure_picture(estimate_figure(estimate), "Parameters with their intervals")
        about = " ".join(remarks(estimate))
        sections.append(section("Intervals", text, about, picture, spread_columns(estimate)))
        if any(element.block == element.name and element.value is None for element in model.elements):
            text = "Change of each unknown from the model as assembled, with its 95 % interval."
            picture = figure_picture(moved_figure(model, estimate), "Changes from the model as assembled")
            sections.append(section("What has changed", text, picture))
        if estimate.costs:
            figure = cost_figure(estimate.costs)
            picture = figure_picture(
                figure, "Share of each variance that is due to the stated values", wide=False
            )
            sections.append(section(STATED, STATED_TEXT, stated_columns(estimate), picture))
        if len(estimate.names) > 1:
            text = (
                "Near ±1, two unknowns are strongly correlated: their sum or difference is known better "
                "than either."
            )
            figure = figures.correlation_plot(estimate.names, correlation(estimate.covariance))
            picture = figure_picture(figure, "Correlation matrix of the estimates", wide=False)
            sections.append(section("Correlation", text, picture))
    if found.collinearity is not None and spectrum is not None:
        sections += shares_section(found.collinearity, spectrum)
    if found.profiles:
        names = joined([each.name for each in found.profiles])
        figure = figures.profile_figure(found.profiles)
        text = (
            f"χ² is not a parabola along {names}; the intervals above end where its profile meets the line."
        )
        picture = figure_picture(figure, f"Rise of χ² along {names}, with the parabola of ± sd")
        sections.append(section("Profiles that are not parabolic", text, picture))
    return [*sections, *([prediction_section("Predicted, not used", held_out)] if held_out else [])]


def _modes(model: Model, estimate: Estimate) -> Section:
    """Natural frequencies and damping ratios, and the first shapes, moving."""
    assert estimate.modes is not None
    pictures = []
    for number in range(1, min(len(estimate.modes.eigenvalues), 4) + 1):
        title, shape = numbered_mode(model, estimate, number)
        try:
            pictures.append(Picture(mode_drawing(model, shape, title).svg(), title, wide=False))
        except UsageError:
            break
    return section("Modes", mode_columns(estimate.modes), *pictures)


def _responses(found: Evidence, left: Residuals) -> list[Section]:
    """Responses, or channels where none can be formed, as measured and as predicted."""
    every = found.responses
    responses = every[:MOST_PANELS]
    if responses:
        text = "Output over input, measured and predicted by the estimated rig."
        if left.transients:
            text += " The estimated start and end transients are subtracted from the measured motion."
        panels = [
            figure_picture(
                figures.response_figure(part),
                f"Amplitude and phase of {joined([shown.channel for shown in part])}, measured and model",
            )
            for part in (responses[rows.start : rows.stop] for rows in rows_of_pictures(len(responses)))
        ]
        in_plane = joined([r.channel for r in responses[: figures.MOST_PLANES]])
        plane = figure_picture(
            figures.nyquist_figure(responses), f"{in_plane} in the complex plane", wide=len(responses) > 2
        )
        text, circles = (
            said + _first(most, len(every))
            for said, most in ((text, MOST_PANELS), ("Each resonance is a circle.", figures.MOST_PLANES))
        )
        return [
            section("Measured and model", text, *panels, whole=True),
            section("In the complex plane", circles, plane, whole=True),
        ]
    driven = left.compared()
    pictures = []
    for rows in rows_of_pictures(len(driven[:MOST_PANELS])):
        places = [driven[k] for k in rows]
        shown = joined([left.channels[i] for i in places])
        figure = figures.residual_channels_figure(left, places)
        pictures.append(figure_picture(figure, f"Amplitude and phase of {shown}, measured and predicted"))
    text = "Amplitude and phase of each channel, as measured and as predicted from the inputs."
    text += _first(MOST_PANELS, len(driven))
    return [section("Measured and model", text, *pictures, whole=True)] if pictures else []


def _first(most: int, channels: int) -> str:
    """That not all channels are drawn."""
    return f" Drawn are the first {most} of {channels} channels." if channels > most else ""


def _dwells(histories: Sequence[DwellHistory], dwells: int) -> Section:
    """Some dwells in time, the part used shaded."""
    cut = [
        f"at {short(one.frequency_hz, 4)} Hz {short(one.begin, 3)} to {short(one.end, 3)} s of "
        f"{short(float(one.time[-1]), 3)} s"
        for one in histories
        if one.begin > 0 or one.end < one.time[-1]
    ]
    shaded = (
        f"Shaded: the part that was used, {joined(cut)}." if cut else "Each of these dwells was used whole."
    )
    channels = joined(histories[0].channels)
    return section(
        "Dwells in time",
        shaded,
        f"{len(histories)} of {dwells} dwells are shown, among them the one with the largest residual and the "
        "one with the shortest part used. Offsets are removed; predicted is the steady state.",
        figure_picture(figures.whole_dwells(histories), f"Dwells of {channels} in time. {shaded}"),
        figure_picture(
            figures.beginnings(histories), f"{channels} where the part used begins, measured and predicted"
        ),
        whole=True,
    )


def _residuals(found: Residuals, estimate: Estimate) -> list[Section]:
    size = np.abs(found.normalised) / np.sqrt(2)
    if not np.any(np.isfinite(size)):
        return []
    unit = "their rms (the noise is unknown)" if found.scaled else "the standard deviation of the noise"
    texts = [f"Measured minus predicted amplitude over {unit}; where the model fits, 95 % lie in the band."]
    rms = [
        f"{name} {short(value, 2)}"
        for name, value in zip(found.channels, found.rms().tolist(), strict=True)
        if np.isfinite(value)
    ]
    texts.append(f"Rms of each channel: {joined(rms)}.")
    worst = next((astuple(each) for each in found.largest(1)), None)
    largest = ""
    if worst is not None:
        name, f, value = worst
        largest = f"The largest is {short(value, 2)}: {name} at {short(f, 4)} Hz."
    if estimate.assessment is not None:
        texts += [residuals_in_words(estimate.fit), worst_in_words(estimate.assessment)]
    else:
        texts.append(largest)
    figure = figures.residual_plot(found.channels, found.frequency_hz, size, worst)
    picture = figure_picture(figure, f"Residuals by frequency and channel. {largest}")
    return [section("Residuals", *texts, picture)]


# What to do next; commands are named with the files they would take.


def next_steps(
    estimate: Estimate, doubtful: Sequence[str], weak: Collinearity | None, *, plannable: bool = True
) -> list[str]:
    """The most useful things to do, the first first; `plannable`: whether `dashpot design` knows the rig."""
    if not bool(estimate.converged):
        return [
            "Do not use these values.",
            'Check the signs and units of the channels: gain = "unknown" for all but one reveals a wrong one.',
            "Give initial guesses of the unknowns, or try another method (dashpot compare shows several).",
        ]
    steps = _on_fit(estimate)
    parameters = [name for name in doubtful if "." not in name]
    rig = estimate.rig or "rig.toml"
    if parameters:
        shown = joined(parameters[:MOST_NAMED]) + (" and others" if len(parameters) > MOST_NAMED else "")
        are, pronoun = ("is", "it") if len(parameters) == 1 else ("are", "them")
        hint = f" Design the next test for {pronoun}: {_design(rig, parameters[:MOST_NAMED])}."
        steps.append(
            f"{shown} {are} poorly determined: the interval extends more than half the value to either "
            f"side.{hint if plannable else ''}"
        )
    elif plannable and (least := _least_known(estimate)) is not None:
        steps.append(
            f"The least certain is {least[0]} (± {least[1]} %). To plan a test for it: "
            f"{_design(rig, [least[0]])}."
        )
    if weak is not None and weak.combinations:
        worst = weak.combinations[0]
        steps.append(
            f"{joined(worst.names[:MOST_NAMED])} are strongly correlated: if {worst.best} were known, their "
            f"intervals would shrink to {percent(worst.narrowing, 1.0)} % of their present width."
        )
    if estimate.assessment is not None and estimate.assessment.verdict == "fits":
        steps.append(
            "Before relying on the result, predict a test that was not used: dashpot validate estimate.json "
            "OTHER.csv."
        )
    return steps


def _design(rig: str, names: Sequence[str]) -> str:
    """The command that plans a test for some unknowns."""
    return f"dashpot design {rig} --after estimate.json --for {','.join(names)} --samples N"


def _on_fit(estimate: Estimate) -> list[str]:
    """What the verdict asks for."""
    assessment = estimate.assessment
    if assessment is None or assessment.verdict == "fits":
        return []
    if assessment.verdict == "cannot tell" and not estimate.fit.known_noise:
        return [
            (
                "Make the fit testable: give the noise of the sensors (columns NAME_sd), longer dwells, "
                "repeated tests, or an at-rest record (--noise-record)."
            )
        ]
    if assessment.verdict == "cannot tell":
        return ["Measure where the rig moves more, or longer: these data cannot confirm the model."]
    if assessment.cause is not None:
        best = assessment.cause
        outlook = remaining_in_words(best)
        step = f"Try the most likely cause: {best.change}."
        if outlook:
            step += f" {outlook.capitalize()}."
        if best.channels or best.elements:
            step += " dashpot identify --apply NEW.toml writes that rig file."
        return [step]
    return [
        (
            "Look where the residuals are largest: an element or a motion is missing there or a value is "
            "wrong, and none of the usual mistakes explains it."
        ),
        (
            "Until the model fits, use the values only within the frequencies of this test: they are the best "
            "for this model, and their intervals are widened for the misfit."
        ),
    ]


def _least_known(estimate: Estimate) -> tuple[str, str] | None:
    """The parameter with the largest relative standard deviation, with it in per cent; None if there is none."""
    pairs = [
        (float(sd / abs(value)), name, percent(float(sd), float(value)))
        for name, sd, value in zip(estimate.names, estimate.sd, estimate.values, strict=True)
        if value != 0 and "." not in name
    ]
    return max(pairs)[1:] if pairs else None
