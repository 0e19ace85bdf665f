"""Comparisons as documents: estimates of several methods below each other, and nonlinear elements by evidence."""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.channel import Channel
from dashpot.check.element_evidence import ElementComparison, ElementEvidence
from dashpot.estimate.comparison import Comparison
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.rigfile import element_line, element_section
from dashpot.present.document import Document, Provenance, Table, TableColumn, columns_of, section
from dashpot.present.estimate import fit_in_words
from dashpot.present.figures.comparison import comparison_figure
from dashpot.present.page import figure_picture, page_html
from dashpot.present.schematic.drawing import rig_picture
from dashpot.present.words import flush, percent, plain, sentence, short, value_and_sd

MISSES = "*"


def comparison_document(comparison: Comparison, level: float = 0.95) -> Document:
    """A row for each method, a column for each unknown, and remarks; units, truth and bound stand in the head."""
    columns = comparison_columns(comparison, level)
    heads = len(columns[0].cells) - len(comparison.estimates)
    table = Table(columns, heads=heads, marked=MISSES)
    sections = section("", table), section("", *comparison_remarks(comparison, level))
    return Document(comparison.model, sections)


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
    methods: dict[str, list[str]] = {}  # χ² is taken at the most likely values: most say the same of the fit
    for name, each in comparison.estimates.items():
        methods.setdefault(fit_in_words(each.fit), []).append(name)
    intervals = section(
        "Intervals",
        "Where intervals of different methods do not overlap, the noise or the model is not as assumed.",
        figure_picture(comparison_figure(comparison, level), "Intervals of every method"),
        whole=True,
    )
    if estimate is None or not bool(estimate.converged):
        advice = "None of these methods uses all the information in the data: compare the intervals."
    elif bool(estimate.fit.rejected):
        advice = (
            f"The model does not fit the data: do not rely on these values as they are, even those of {best}."
        )
    else:
        advice = f"Use the values of {best}: of these methods it uses the data best."
    return page_html(
        Document(
            model.name or "Comparison",
            (intervals,),
            "bad" if wrong and best in (None, *wrong) else "open",
            f"{len(comparison.estimates)} methods on the same data.",
            advice,
            tuple(f"{joined(names)}: {text}" for text, names in methods.items()),
            (f"{joined(wrong)} did not converge: do not use those values.",) if wrong else (),
            section(
                "Values by method",
                *comparison_remarks(comparison, level),
                comparison_columns(comparison, level),
            ),
            rig_picture(model, channels, estimate, level=level),
            (f"Judge the fit: dashpot identify RIG DATA --method {best} --report report.html.",)
            if best
            else (),
            ("±", "interval", "bound"),
            provenance,
        )
    )


def comparison_columns(comparison: Comparison, level: float = 0.95) -> list[TableColumn]:
    """What the rows are, then each unknown; the last rows are the methods, those above them name, unit, truth, bound.

    With a known truth there is a column of the worst errors as well, and an interval that misses it ends in MISSES.
    """
    heads = ["", ""]  # names and units speak for themselves
    if comparison.truth:
        heads.append("truth")
    if _has_bound(comparison):
        heads.append("bound")
    heads = [*heads, *comparison.estimates]
    columns = []
    for name in comparison.names:
        truth, bound = comparison.truth.get(name), comparison.bound_sd(name)
        pairs = []
        for estimate in comparison.estimates.values():
            v = estimate[name]
            value, sd = value_and_sd(v.value, v.sd)
            pairs.append((value, sd + (MISSES if _missed(estimate, name, truth, level) else "")))
        values = flush(["" if truth is None else plain(truth), *(value for value, _ in pairs)])
        unit = comparison.units[comparison.names.index(name)]
        cells = [name, "" if unit == "1" else unit]
        if comparison.truth:
            cells.append(values[0].rstrip())
        if _has_bound(comparison):
            cells.append("" if bound is None else f"{' ' * len(values[0])} ± {short(bound, 2)}")
        columns.append(
            [*cells, *(f"{value} ± {sd}" for value, (_, sd) in zip(values[1:], pairs, strict=True))]
        )
    texts = [heads, *columns]
    if comparison.truth:
        worst = []
        for estimate in comparison.estimates.values():
            errors = [(estimate[name].value - true, true) for name, true in comparison.truth.items()]
            error, true = max(errors, key=lambda pair: abs(pair[0] / pair[1]) if pair[1] else 0.0)
            worst.append(percent(error, true))
        texts.append(["worst", "error %", *[""] * (len(heads) - 2 - len(worst)), *flush(worst)])
    return [TableColumn(cells[0], tuple(cells[1:])) for cells in texts]


def _has_bound(comparison: Comparison) -> bool:
    return any(comparison.bound_sd(name) is not None for name in comparison.names)


def _missed(estimate: Estimate, name: str, truth: float | None, level: float) -> bool:
    if truth is None:
        return False
    low, high = estimate.interval(level)
    j = estimate.names.index(name)
    return truth < float(low[j]) or truth > float(high[j])


def comparison_remarks(comparison: Comparison, level: float = 0.95) -> list[str]:
    """What ± and marks mean, and what was noticed, by the methods it concerns."""
    lines = ["± is one standard deviation."]
    if _has_bound(comparison):
        lines.append("The bound is the smallest ± that any unbiased method can reach (Cramér-Rao).")
    if any(
        _missed(estimate, name, truth, level)
        for estimate in comparison.estimates.values()
        for name, truth in comparison.truth.items()
    ):
        lines.append(f"{MISSES}: the {100 * level:g} % interval misses the truth.")
    lines += [
        f"{name} did not converge." for name, e in comparison.estimates.items() if not bool(e.converged)
    ]
    reasons = [(str(error), name) for name, error in comparison.refused.items()]
    warnings = [(w.text, name) for name, e in comparison.estimates.items() for w in e.warnings]
    everyone = tuple(comparison.estimates)
    return [*lines, *_by_name(reasons, ()), *_by_name(warnings, everyone)]


def _by_name(said: list[tuple[str, str]], everyone: tuple[str, ...]) -> list[str]:
    """What is said of several methods in the same words, once."""
    names: dict[str, list[str]] = {}
    for text, name in said:
        of_it = text.removeprefix("the method ").removeprefix(f"{name} ").removeprefix("is ")
        names.setdefault(of_it, []).append(name)
    return [
        f"{'all' if len(group) > 1 and tuple(group) == everyone else ', '.join(group)}: {sentence(text)}"
        for text, group in names.items()
    ]


# Nonlinear elements that the rig may lack, ranked by evidence.


def elements_document(comparison: ElementComparison) -> Document:
    """A row for each candidate, and the entries of the rig file of those that the data call for."""
    rows = (
        (", ".join(_named(row)), f"{100 * row.remaining:.3g} %", f"{row.evidence:+.4g}")
        for row in comparison.ranked
    )
    texts = ["Residuals and ln evidence are relative to the rig as it is."]
    chosen = comparison.chosen
    if chosen is None:
        texts.append("The data call for none of these elements.")
    else:
        named = " and ".join(_named(chosen))
        texts.append(f"The data call for {named}. Nothing has been added to the rig file; to add it, write")
        texts += [f"  {element_section(element)} {element_line(element)}" for element in chosen.elements]
        texts += [
            f"{name} comes out negative, which no passive damper is: it compensates for other dampers that are "
            "too large."
            for name in _negative_dampers(chosen)
        ]
    return Document("", (section("", columns_of(["added", "residuals>", "ln evidence>"], rows), *texts),))


def _named(one: ElementEvidence) -> list[str]:
    """name (law, points) of each element."""
    words = []
    negative = _negative_dampers(one)
    for element in one.elements:
        law = "" if element.force_law is None else element.force_law.text
        points = tuple(element.along) if len(element.along) > 1 else (*element.along, "ground")
        sign = ", negative" if element.name in negative else ""
        words.append(f"{element.name} ({law}, {'-'.join(points)}{sign})")
    return words


def _negative_dampers(one: ElementEvidence) -> list[str]:
    """Names of its dampers that would feed energy in."""
    pairs = zip(one.elements, one.values, strict=True)
    return [element.name for element, value in pairs if element.kind is Kind.DAMPER and value < 0]
