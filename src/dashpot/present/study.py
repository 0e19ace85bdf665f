"""A Monte Carlo study as a document: one row for each scenario and method, and how accurate each method is."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from dashpot.io.words import counted, joined
from dashpot.present.document import Document, Paragraph, Provenance, Table, TableColumn, columns_of, section
from dashpot.present.figures import study as draw
from dashpot.present.figures.style import method_colour, png
from dashpot.present.page import image_picture, page_html
from dashpot.present.schematic.drawing import true_rig_picture
from dashpot.study.montecarlo import LEVELS, StudyOutcome, Summary, SummaryRow

NOTHING = "–"
COUNTED_FACTORS = {"noise": "noise level", "samples": "samples per frequency", "in_all": "samples in total"}
RESULTS = ("bias>", "spread>", "bound>", "ratio>", "coverage>", "failed>")
LEGEND = (
    "bias, spread and bound: rms over the parameters, % of their true values (bound: Cramér-Rao at the truth).",
    "ratio: spread / bound.",
    "coverage: smallest and largest share of 95 % intervals that contain the truth, %.",
)


def study_document(outcome: StudyOutcome) -> Document:
    """What is printed: what varies, and how each method did."""
    fixed, columns = _fixed_factors(outcome), study_columns(outcome.rows)
    return Document(
        f"{outcome.name}, seed {outcome.seed}",
        (
            section("", Paragraph(fixed, "dim") if fixed else None),
            section("", Table(columns, keys=len(columns) - len(RESULTS))),
            section("", *(Paragraph(line, "dim") for line in LEGEND)),
        ),
    )


def study_report(
    outcome: StudyOutcome, pictures: Mapping[str, bytes], provenance: Provenance | None = None
) -> str:
    """HTML page of a Monte Carlo study with its PNG pictures by name, as many as a page holds."""
    rows, truth = outcome.rows, outcome.rows[0].scenario
    fixed = _fixed_factors(outcome)
    failed = sum(row.summary.failed for row in rows)
    scenarios = counted(len({id(row.scenario) for row in rows}), "scenario")
    methods = joined(dict.fromkeys(row.method for row in rows))
    shown, used = [], 0
    for name, content in list(pictures.items())[:12]:
        used += len(content)
        if used > 1_300_000:  # bytes of pictures in one page; base64 adds a third
            break
        shown.append(image_picture(content, name.replace("_", " ")))
    rest = len(pictures) - len(shown)
    more = f"{rest} more figures are in the folder of the study." if rest else ""
    first, *others = accuracy_in_words(rows)
    return page_html(
        Document(
            outcome.name,
            (
                section("Errors of the methods", *LEGEND, study_columns(rows), whole=True),
                section("Figures", more, *shown, whole=True),
            ),
            "open",
            f"Monte Carlo study of {methods} in {scenarios}, seed {outcome.seed}.",
            f"Most accurate: {first}" if others else first,
            (*others, *((f"{fixed}.",) if fixed else ())),
            (f"{failed} identifications failed; they are left out of bias and spread.",) if failed else (),
            drawing=true_rig_picture(truth.model, truth.theta, truth.channels),
            steps=next_study_steps(rows),
            terms=("spread", "bound", "coverage"),
            provenance=provenance,
        )
    )


def study_columns(rows: Sequence[SummaryRow]) -> list[TableColumn]:
    """The method with the factors that vary, then bias, spread, bound, their ratio, coverage and failures.

    Factors stand where the scenario changes.  The method comes first: it names the rows where columns are stacked.
    """
    varied = varied_factors(rows)
    # More columns of factors are put into one of 21 characters: 80 columns hold the rest as well
    together, width = len(varied) > 3, 21
    heads = [
        f"{name.replace('_', ' ')}{'>' if name in COUNTED_FACTORS and not together else ''}"
        for name in varied
    ]
    if together:
        heads = [fill(", ".join(varied), width)]
    cells = []
    for k, row in enumerate(rows):
        factors = [factor_text(row.scenario.factors.get(name)) for name in varied]
        if together:
            factors = [fill(", ".join(text for text in factors if text != NOTHING), width)]
        if k and rows[k - 1].scenario is row.scenario:
            factors = [""] * len(factors)
        summary = row.summary
        cells.append(
            (
                *factors,
                row.method,
                f"{summary.rms_bias:.2f}",
                f"{summary.rms_spread:.2f}",
                f"{summary.rms_bound:.2f}",
                f"{summary.rms_spread / summary.rms_bound:.2f}" if summary.rms_bound > 0 else NOTHING,
                f"{min(summary.coverage):.1f}–{max(summary.coverage):.1f}",
                f"{summary.failed}/{summary.draws}" if summary.failed else NOTHING,
            )
        )
    return columns_of([*heads, "method", *RESULTS], cells)


# Factors and accuracies in words.


def factor_text(value: object) -> str:
    """The value of a factor as it is shown."""
    return NOTHING if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def varied_factors(rows: Sequence[SummaryRow]) -> list[str]:
    """Factors that are not the same in all scenarios."""
    names = dict.fromkeys(key for row in rows for key in row.scenario.factors)
    return [name for name in names if len({row.scenario.factors.get(name) for row in rows}) > 1]


def _fixed_factors(outcome: StudyOutcome) -> str:
    """Those that are, in words; empty where there are none."""
    varied, factors = varied_factors(outcome.rows), outcome.rows[0].scenario.factors
    fixed = [f"{key} {factor_text(value)}" for key, value in factors.items() if key not in varied]
    return f"In all scenarios: {', '.join(fixed)}" if fixed else ""


def accuracy_in_words(rows: Iterable[SummaryRow]) -> list[str]:
    """How far each method is from the bound and how often its intervals hold the truth, the most accurate first."""
    texts = []
    for name, summaries in _most_accurate_first(rows).items():
        errors = [each.error_over_bound for each in summaries]
        sizes = [each.rms_error for each in summaries]
        shares = [float(share) for each in summaries for share in each.coverage]
        texts.append(
            f"{name}: rms error {_span(sizes, 1)} % of the true values, {_span(errors, 2)} × the Cramér-Rao "
            f"bound; 95 % intervals contain the truth in {_span(shares, 0)} % of the draws."
        )
    return texts


def next_study_steps(rows: Sequence[SummaryRow]) -> tuple[str, ...]:
    """What to do after a study: whose values to take, and how far its shares are known."""
    method = next(iter(_most_accurate_first(rows)))
    draws = min(row.summary.draws - row.summary.failed for row in rows)
    steps = [f"Use it for tests like these: dashpot identify RIG DATA --method {method}."]
    if draws < 400:  # by which a share of 95 % is known to a point
        spread = 100 * math.sqrt(0.95 * 0.05 / max(draws, 1))
        steps.append(
            f"{draws} draws give a share of 95 % to ± {spread:.1f} points only: use --draws 1000 before judging "
            "intervals."
        )
    return tuple(steps)


def _most_accurate_first(rows: Iterable[SummaryRow]) -> dict[str, list[Summary]]:
    """Summaries of each method, by its largest error over the bound."""
    by_method: dict[str, list[Summary]] = {}
    for row in rows:
        by_method.setdefault(row.method, []).append(row.summary)
    worst = {name: max(each.error_over_bound for each in parts) for name, parts in by_method.items()}
    order = sorted(worst, key=lambda name: (math.isnan(worst[name]), worst[name]))
    return {name: by_method[name] for name in order}


def _span(values: Sequence[float], decimals: int) -> str:
    low, high = f"{min(values):.{decimals}f}", f"{max(values):.{decimals}f}"
    return low if low == high else f"{low} to {high}"


# Pictures: scenarios that differ in one factor alone, as curves over a number or as bars.


Rest = tuple[tuple[str, str | float | int], ...]


@dataclass(frozen=True)
class FactorGroup:
    """Scenarios that differ in one factor alone: its values, and the summaries by method (a list over the values)."""

    factor: str
    rest: Rest
    values: tuple[object, ...]
    parameters: tuple[str, ...]
    summaries: dict[str, list[Summary]]


def study_pictures(outcome: StudyOutcome) -> dict[str, bytes]:
    """PNG files by name: for each numeric factor errors and accuracy over it, for each other factor bars.

    Of many groups of one factor some are drawn.
    """
    made: dict[str, bytes] = {}
    varied = varied_factors(outcome.rows)
    for group in evenly_spread(groups(outcome)):
        rest = {key: factor_text(value) for key, value in group.rest if key in varied}
        title = ", ".join(f"{key.replace('_', ' ')} {text}" for key, text in rest.items())
        slug = re.sub(r"[^A-Za-z0-9._]+", "-", "_".join(rest.values())).strip("-")[:80]
        if group.factor in COUNTED_FACTORS:
            drawn = _curves(group)
        else:  # the first eight values, side by side
            places = [factor_text(value) for value in group.values[:8]]
            series = []
            for k, (method, summaries) in enumerate(group.summaries.items()):
                spread = np.array([s.rms_spread for s in summaries[:8]])
                kept = np.array([max(s.draws - s.failed, 1) for s in summaries[:8]])
                series.append(
                    draw.Series(method, method_colour(method, k), spread, spread / np.sqrt(2 * kept))
                )
            bound = np.array([s.rms_bound for s in next(iter(group.summaries.values()))[:8]])
            drawn = {"": draw.bar_panels([title or outcome.name], places, [series], [bound])}
        for kind, figure in drawn.items():
            stem = "_".join(filter(None, [group.factor, kind, slug]))
            name, k = stem, 1
            while name in made:
                k += 1
                name = f"{stem}_{k}"
            made[name] = png(figure)
    return made


def groups(outcome: StudyOutcome) -> list[FactorGroup]:
    """All sets of scenarios that differ in one factor alone and are worth a picture."""
    made = []
    for factor in varied_factors(outcome.rows):
        least = 3 if factor in COUNTED_FACTORS else 2  # points that make a curve
        sets: dict[tuple[Rest, tuple[str, ...]], list[SummaryRow]] = {}
        for row in outcome.rows:
            factors = row.scenario.factors
            if factor in factors:
                rest = tuple((key, value) for key, value in factors.items() if key != factor)
                sets.setdefault((rest, row.scenario.model.unknown_names), []).append(row)
        for (rest, names), rows in sets.items():
            by_method: dict[str, dict[object, Summary]] = {}
            for row in rows:
                by_method.setdefault(row.method, {})[row.scenario.factors[factor]] = row.summary
            values = list(dict.fromkeys(row.scenario.factors[factor] for row in rows))
            if factor in COUNTED_FACTORS:
                values.sort(key=float)
            complete = {
                name: [summaries[value] for value in values]
                for name, summaries in by_method.items()
                if len(summaries) == len(values)
            }
            group = FactorGroup(factor, rest, tuple(values) if complete else (), names, complete)
            if len(group.values) >= least:
                made.append(group)
    return made


def evenly_spread(every: Sequence[FactorGroup]) -> Iterable[FactorGroup]:
    """Groups of each factor, the first and the last among them, no more than MOST_ALIKE."""
    for _, alike in groupby(every, key=lambda group: group.factor):
        several = list(alike)
        # Of one factor 12 groups are drawn: bars at each of 200 noise levels are 200 figures.
        places = np.linspace(0, len(several) - 1, min(len(several), 12))
        yield from (several[int(place)] for place in places)


def _curves(group: FactorGroup) -> dict[str, Figure]:
    """Errors of the first parameters, and the accuracy of all, over a number."""
    x, label = np.array(group.values, dtype=float), COUNTED_FACTORS[group.factor]
    if group.factor == "noise" and ("kind", "relative") in group.rest:
        x, label = 100 * x, "noise level ρ, %"
    logarithmic = group.factor != "noise" and float(np.max(x)) > 4 * float(np.min(x))
    shown = range(min(len(group.parameters), 6))  # parameters drawn in one figure
    bands = []
    ends = [LEVELS.index(level) for level in (0.025, 0.975)]
    for j in shown:
        panel = []
        for k, (method, summaries) in enumerate(group.summaries.items()):
            mean = np.array([s.mean[j] for s in summaries], dtype=float)
            low, high = np.array([s.quantiles[ends, j] for s in summaries], dtype=float).T
            dashed = k == len(group.summaries) - 1 > 0
            panel.append(draw.Band(method, method_colour(method, k), mean, low, high, dashed))
        bands.append(panel)
    methods = [
        draw.Accuracy(
            method,
            method_colour(method, k),
            np.array([s.rms_spread for s in summaries]),
            np.array([s.rms_bias for s in summaries]),
            np.array([s.coverage for s in summaries], dtype=float),
        )
        for k, (method, summaries) in enumerate(group.summaries.items())
    ]
    bound = np.array([summary.rms_bound for summary in next(iter(group.summaries.values()))])
    limits = []  # room for all bands; one far wider than the others is cut off at thrice the second widest
    for panel in bands:
        edges = [(float(np.nanmin(band.low)), float(np.nanmax(band.high))) for band in panel]
        widths = sorted((high - low for low, high in edges), reverse=True)
        kept = [
            (low, high)
            for low, high in edges
            if len(widths) < 2 or high - low <= 3 * widths[1] or widths[1] == 0
        ] or edges
        low, high = min(pair[0] for pair in kept), max(pair[1] for pair in kept)
        room = 0.05 * (high - low) if high > low else 1.0
        limits.append((low - room, high + room))
    return {
        "errors": draw.band_panels(
            [group.parameters[j] for j in shown],
            x,
            bands,
            x_label=label,
            logarithmic=logarithmic,
            limits=limits,
        ),
        "accuracy": draw.accuracy_panels(
            x, methods, bound, label, logarithmic=logarithmic or group.factor == "noise"
        ),
    }
