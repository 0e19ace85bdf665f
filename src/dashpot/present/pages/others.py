"""Reports of comparisons, planned tests, predictions and studies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dashpot.channel import Channel
from dashpot.check.data_findings import DataFindings, doubtful
from dashpot.check.identifiability import Structure
from dashpot.check.validation import RecordPrediction, within_noise
from dashpot.data.spectrum import Spectrum
from dashpot.design.advise import Answer
from dashpot.design.test_setup import drive_units
from dashpot.estimate.assessment import Finding
from dashpot.estimate.comparison import Comparison
from dashpot.estimate.result import Estimate
from dashpot.io.words import counted, joined
from dashpot.model.network import Model
from dashpot.present.figures.comparison import comparison_figure
from dashpot.present.figures.design import planned_test_figure
from dashpot.present.figures.spectra import profile_figure
from dashpot.present.pages.page import (
    Block,
    Page,
    Provenance,
    Verdict,
    figure_picture,
    image_picture,
    page_html,
)
from dashpot.present.pages.report import (
    MOST_NAMES,
    capitalised,
    names_of,
    prediction_block,
    rig_picture,
    shares_block,
    true_rig_picture,
)
from dashpot.present.tables.check import known_columns
from dashpot.present.tables.comparison import comparison_columns, comparison_remarks
from dashpot.present.tables.design import dwell_columns, expected_columns
from dashpot.present.tables.estimate import parameter_columns
from dashpot.present.tables.study import study_columns
from dashpot.present.tables.validation import validation_columns
from dashpot.present.text.check import collinearity_in_words, profile_in_words, structure_in_words
from dashpot.present.text.design import plan_in_words, sensors_in_words, stopping_in_words
from dashpot.present.text.estimate import fit_in_words, sentence
from dashpot.present.text.study import (
    LEGEND,
    accuracy_in_words,
    factor_text,
    next_study_steps,
    varied_factors,
)
from dashpot.present.text.validation import (
    EXPLANATION,
    is_poor,
    mistakes_in_words,
    next_validation_steps,
    prediction_in_words,
)
from dashpot.study.montecarlo import StudyOutcome

# The report of a check: what the channels and the data can determine.


IDENTIFY = "Identify: dashpot identify RIG DATA --report report.html."


def check_report(
    model: Model,
    channels: Sequence[Channel],
    structure: Structure,
    spectrum: Spectrum | None = None,
    found: DataFindings | None = None,
    level: float = 0.95,
    provenance: Provenance | None = None,
) -> str:
    """HTML page of a rig whose unknowns can be found; with data, of what they determine only poorly."""
    said = structure_in_words(
        structure, [c.name for c in channels], None if spectrum is None else spectrum.lines
    )
    estimate = None if found is None else found.estimate
    unsure = () if estimate is None else doubtful(estimate, level)
    hardly_separated = (
        [] if found is None else [name for entry in found.collinearity.combinations for name in entry.names]
    )
    poor = dict.fromkeys([*hardly_separated, *unsure])
    page = Page(
        model.name or "Check",
        model.summary.removeprefix(f"{model.name}: "),
        "open" if poor or structure.permutation_ambiguities else "good",
        f"All unknowns can be found, but {joined(poor)} only poorly."
        if poor
        else "All unknowns can be found.",
        tuple(said),
        answer=None if estimate is None else _answer(estimate, level),
        drawing=rig_picture(model, channels, estimate, unsure, level),
        steps=tuple(_steps(found, spectrum)),
        evidence=() if found is None or spectrum is None else tuple(_evidence(found, spectrum)),
        terms=() if found is None else ("±", "interval", "bound", "share", "profile"),
        provenance=provenance,
    )
    return page_html(page)


def _answer(estimate: Estimate, level: float) -> Block:
    return Block("Parameters", (), (tuple(parameter_columns(estimate, level)),))


def _steps(found: DataFindings | None, spectrum: Spectrum | None) -> list[str]:
    if found is None or spectrum is None:
        return [
            "Design the test: dashpot design RIG --samples N.",
            "Then: dashpot identify RIG DATA --report report.html.",
        ]
    steps = [
        f"Know {entry.best} from elsewhere, or add a sensor that separates {joined(entry.names)}."
        for entry in found.collinearity.combinations[:3]
    ]
    if found.collinearity.idle:
        steps.append(
            "Leave out the frequencies that contribute nothing, and dwell longer where they contribute most."
        )
    return steps or [IDENTIFY]


def _evidence(found: DataFindings, spectrum: Spectrum) -> list[Block]:
    units = dict(zip(found.estimate.names, found.estimate.units, strict=True))
    said = tuple(collinearity_in_words(found.collinearity, spectrum, units))
    blocks = [Block("What the data hardly separate", said, whole=True)]
    if len(found.collinearity.names) <= MOST_NAMES:
        blocks.append(shares_block(found.collinearity, spectrum))
    if found.profiles:
        shown = found.profiles[:12]
        picture = figure_picture(
            profile_figure(shown), f"Profiles of {joined([entry.name for entry in shown])}"
        )
        blocks.append(
            Block("Profiles", tuple(profile_in_words(entry) for entry in found.profiles), pictures=(picture,))
        )
    if found.known_errors is not None:
        text = "Change of each estimate, per cent, for an error of one per cent of each known parameter."
        blocks.append(
            Block(
                "Errors of known parameters", (text,), (tuple(known_columns(found.known_errors)),), whole=True
            )
        )
    return blocks


MOST_BYTES = 1_300_000  # of pictures in one page; base64 adds a third


def comparison_report(
    model: Model,
    channels: Sequence[Channel],
    comparison: Comparison,
    level: float = 0.95,
    provenance: Provenance | None = None,
) -> str:
    """HTML page of several methods side by side."""
    best = comparison.most_likely[0] if comparison.most_likely else None
    estimate = None if best is None else comparison.estimates[best]
    wrong = [name for name, each in comparison.estimates.items() if not bool(each.converged)]
    cautions = [f"{joined(wrong)} did not converge: do not use those values."] if wrong else []
    page = Page(
        model.name or "Comparison",
        f"{len(comparison.estimates)} methods on the same data.",
        "bad" if wrong and best in (None, *wrong) else "open",
        _best_in_words(comparison),
        tuple(_fits_in_words(comparison)),
        tuple(cautions),
        answer=Block(
            "Values by method",
            tuple(comparison_remarks(comparison, level)),
            (tuple(comparison_columns(comparison, level)),),
        ),
        drawing=rig_picture(
            model, channels, estimate, () if estimate is None else doubtful(estimate, level), level
        ),
        steps=(f"Judge the fit: dashpot identify RIG DATA --method {best} --report report.html.",)
        if best
        else (),
        evidence=(
            Block(
                "Intervals",
                (
                    "Where intervals of different methods do not overlap, the noise or the model is not as assumed.",
                ),
                pictures=(figure_picture(comparison_figure(comparison, level), "Intervals of every method"),),
                whole=True,
            ),
        ),
        terms=("±", "interval", "bound"),
        provenance=provenance,
    )
    return page_html(page)


def _best_in_words(comparison: Comparison) -> str:
    """Which values to use, in one sentence."""
    best = comparison.most_likely[0] if comparison.most_likely else None
    if best is None or not bool(comparison.estimates[best].converged):
        return "None of these methods makes full use of the data: compare the intervals."
    if bool(comparison.estimates[best].fit.rejected):
        return f"The model does not fit the data: do not sign these values as they are, even those of {best}."
    return f"Use the values of {best}: of these methods it makes the fullest use of the data."


def _fits_in_words(comparison: Comparison) -> list[str]:
    """Whether the model fits by each method: χ² is taken at the most likely values, so most say the same."""
    methods: dict[str, list[str]] = {}
    for name, estimate in comparison.estimates.items():
        methods.setdefault(fit_in_words(estimate.fit), []).append(name)
    return [f"{joined(names)}: {text}" for text, names in methods.items()]


def design_report(answer: Answer, provenance: Provenance | None = None) -> str:
    """HTML page of a planned test."""
    model, plan, estimate = answer.setup.model, answer.plan, answer.estimate
    names = names_of(model, answer.setup.channels)
    statements = list(sensors_in_words(answer)) if answer.choice is not None else []
    verdict: Verdict = "open"
    if answer.verdict is not None:
        verdict = "good" if answer.verdict.reached else "open"
        statements.insert(0, stopping_in_words(answer))
    answers: Block | None = None
    evidence: tuple[Block, ...] = ()
    if plan is None:
        headline = "No test is needed: what is already known reaches the target."
    else:
        said = plan_in_words(answer, plan)
        headline = f"{counted(len(plan.dwells), 'dwell')}, {plan.samples} samples. {said[0]}"
        statements += said[1:]
        answers = Block("Dwells", (), (tuple(dwell_columns(plan, drive_units(model))),))
        figure = figure_picture(
            planned_test_figure(answer), "Dwells, what each frequency tells, and the expected intervals"
        )
        evidence = (
            Block("Expected intervals", (), (tuple(expected_columns(answer)),)),
            Block("Why these frequencies", pictures=(figure,)),
        )
    page = Page(
        model.name or "The next test",
        "The next test.",
        verdict,
        headline,
        tuple(statements),
        tuple(sentence(capitalised(note, names)) for note in answer.notes),
        answers,
        rig_picture(
            model, answer.setup.channels, estimate, () if estimate is None else doubtful(estimate), 0.95
        ),
        (
            "Write the dwells as a table for the shaker's controller: option --csv FILE.",
            "After the test: dashpot identify RIG DATA.",
        ),
        evidence,
        ("±", "bound", "duality gap"),
        provenance,
    )
    return page_html(page)


def validation_report(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate,
    predictions: Sequence[RecordPrediction],
    findings: tuple[Finding, ...] = (),
    provenance: Provenance | None = None,
) -> str:
    """HTML page of predictions of what was not used, with what may be wrong with it."""
    columns = tuple(validation_columns(predictions))
    page = Page(
        model.name or "Validation",
        "Records that the estimate was not made from, predicted from their inputs.",
        "good" if within_noise(predictions) else "bad" if is_poor(predictions) else "open",
        prediction_in_words(predictions, findings),
        (*mistakes_in_words(findings), EXPLANATION),
        answer=Block("FIT of every channel", (), (columns,)),
        drawing=rig_picture(model, channels, estimate, doubtful(estimate), 0.95),
        steps=next_validation_steps(predictions),
        evidence=(prediction_block("Measured and predicted", predictions),),
        terms=("FIT", "χ²"),
        provenance=provenance,
    )
    return page_html(page)


def study_report(
    outcome: StudyOutcome, pictures: Mapping[str, bytes], provenance: Provenance | None = None
) -> str:
    """HTML page of a Monte Carlo study with its PNG pictures by name, as many as a page holds."""
    varied = varied_factors(outcome.rows)
    fixed = [
        f"{key} {factor_text(value)}"
        for key, value in outcome.rows[0].scenario.factors.items()
        if key not in varied
    ]
    failed = sum(row.summary.failed for row in outcome.rows)
    scenarios = len({id(row.scenario) for row in outcome.rows})
    methods = joined(dict.fromkeys(row.method for row in outcome.rows))
    shown, used = [], 0
    for name, content in list(pictures.items())[:12]:
        used += len(content)
        if used > MOST_BYTES:
            break
        shown.append(image_picture(content, name.replace("_", " ")))
    rest = len(pictures) - len(shown)
    more = (f"{rest} more figures are in the folder of the study.",) if rest else ()
    first, *others = accuracy_in_words(outcome.rows)
    page = Page(
        outcome.name,
        f"Monte Carlo study of {methods} in {counted(scenarios, 'scenario')}, seed {outcome.seed}.",
        "open",
        f"Most accurate: {first}" if others else first,
        (*others, *((f"In all scenarios: {', '.join(fixed)}.",) if fixed else ())),
        (f"{failed} identifications failed; they are left out of bias and spread.",) if failed else (),
        drawing=true_rig_picture(
            outcome.rows[0].scenario.model, outcome.rows[0].scenario.theta, outcome.rows[0].scenario.channels
        ),
        steps=next_study_steps(outcome.rows),
        evidence=(
            Block("Errors of the methods", LEGEND, (tuple(study_columns(outcome.rows)),), whole=True),
            Block("Figures", more, pictures=tuple(shown), whole=True),
        ),
        terms=("spread", "bound", "coverage"),
        provenance=provenance,
    )
    return page_html(page)
