"""The report of an identification."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.check.chi2_surface import chi2_surface
from dashpot.check.collinearity import Collinearity, collinearity
from dashpot.check.doubt import doubtful, undetermined
from dashpot.check.residuals import Residuals, calibrations_of, residuals
from dashpot.check.validation import RecordPrediction
from dashpot.data.conditioning.used_dwells import UsedDwell
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.present.pages.evidence import evidence_blocks, fits_in_words, prediction_block, profiles_block
from dashpot.present.pages.page import Block, Page, Picture, Provenance, Verdict, page_html
from dashpot.present.schematic.drawing import schematic
from dashpot.present.schematic.moving import mode_drawing, numbered_mode
from dashpot.present.tables.estimate import (
    fit_paragraphs,
    has_modes,
    mode_columns,
    parameter_columns,
    remarks,
    signs_in_words,
)
from dashpot.present.text.assessment import VERDICTS, diagnosis_in_words
from dashpot.present.text.estimate import (
    convergence_in_words,
    fit_in_words,
    sentence,
    warnings_in_words,
)
from dashpot.present.text.next_steps import next_steps
from dashpot.present.text.numbers import short

MOST_MODES = 4
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
    page = Page(
        estimate.model or "Identification",
        _subtitle(estimate, spectrum),
        _verdict(estimate),
        headline(estimate, unsure),
        (*_statements(estimate, names), *_on_held_out(held_out), *_on_law(model)),
        tuple(capitalised(text, names) for text in warnings_in_words(estimate, untried=untried)),
        Block("Parameters", tuple(_below_parameters(estimate)), (tuple(parameter_columns(estimate, level)),)),
        rig_picture(model, shown, estimate, unsure, level),
        tuple(next_steps(estimate, unsure, found.collinearity, plannable=not len(model.nonlinear))),
        (
            *((prediction_block("Measured and model", histories),) if histories else ()),
            *_evidence(model, spectrum, estimate, found, held_out, level, dwells),
            *_treatment(estimate, names),
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


def _subtitle(estimate: Estimate, spectrum: Spectrum | None) -> str:
    text = convergence_in_words(estimate)
    if spectrum is None:
        return text
    low, high = float(spectrum.frequency_hz.min()), float(spectrum.frequency_hz.max())
    return f"{text} {spectrum.lines} lines from {short(low, 4)} to {short(high, 4)} Hz."


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


def _on_held_out(held_out: Sequence[RecordPrediction]) -> list[str]:
    """How well what was held out is predicted."""
    return [f"Held out and predicted: {text}" for text in fits_in_words(held_out)] if held_out else []


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


def _treatment(estimate: Estimate, names: Collection[str]) -> list[Block]:
    """What was done with the data, and what is to be known of them."""
    texts = tuple(sentence(capitalised(note.text, names)) for note in estimate.notes)
    return [Block("What was done with the data", texts)] if texts else []


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
    for number in range(1, min(len(estimate.modes.eigenvalues), MOST_MODES) + 1):
        title, shape = numbered_mode(model, estimate, number)
        try:
            pictures.append(Picture(mode_drawing(model, shape, title).svg(), title, wide=False))
        except UsageError:
            break
    return Block("Modes", (), (tuple(mode_columns(estimate.modes)),), tuple(pictures), whole=True)
