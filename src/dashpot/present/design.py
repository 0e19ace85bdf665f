"""A planned test as a document: its dwells, the expected intervals, how close to optimal it is."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dashpot.design.advise import Answer, phase_deg
from dashpot.design.allocation import Criterion, ExpectedPrecision
from dashpot.design.plan import Plan
from dashpot.design.releases import ReleasePlan
from dashpot.design.test_setup import drive_units
from dashpot.io.words import counted, joined
from dashpot.present.document import (
    Document,
    Paragraph,
    Provenance,
    Section,
    Table,
    TableColumn,
    columns_of,
    section,
)
from dashpot.present.figures.design import planned_test_figure
from dashpot.present.page import figure_picture, page_html
from dashpot.present.schematic.drawing import rig_picture
from dashpot.present.words import alike, capitalised, names_of, percent, sentence, short, value_and_sd

WASTE = 0.05  # of the information: what waiting for the steady state may cost
NOTHING = "–"
NO_TEST = "Target reached without a test: what is already known is enough."
_SCENARIOS = {"worst": "worst of", "average": "average over"}


def answer_document(answer: Answer) -> Document:
    """What is printed of an answer: the dwells, the expected intervals, and what they are worth."""
    first: list[Paragraph] = []
    if answer.verdict is not None:
        first.append(Paragraph(stopping_in_words(answer), "green" if answer.verdict.reached else ""))
    if answer.choice is not None:
        chosen, *others = sensors_in_words(answer)
        first += [Paragraph(chosen), *(Paragraph(line, "dim") for line in others)]
    plan = answer.plan
    if plan is None:
        return Document(answer.setup.model.name, (section("", *first, Paragraph(NO_TEST, "green")),))
    columns = dwell_columns(plan, drive_units(answer.setup.model))
    notes = (Paragraph(sentence(f"Note: {note}"), "yellow") for note in answer.notes)
    return Document(
        answer.setup.model.name,
        (
            section("", *first),
            section("Dwells", Table(columns, [""] * len(plan.dwells) + ["dim"])),
            section("Expected intervals", expected_columns(answer)),
            section("", *plan_in_words(answer, plan), *notes),
        ),
    )


def release_document(plan: ReleasePlan) -> Document:
    """What is printed of planned releases: which to make, what they will tell, and each coordinate by itself."""
    unit, scale = ("rad", 1.0) if set(plan.model.coordinates) <= plan.model.angles else ("mm", 1e3)
    rows = [
        (each.hold, short(scale * each.deflection), short(each.record_s), percent(each.figure, 1.0))
        for each in plan.releases
    ]
    first = plan.together[0]
    if len(plan.together) == 1:
        said = f"Hold {first.hold} {short(scale * first.deflection)} {unit} out, let go"
    else:
        holds = [f"{each.hold} ({short(scale * each.deflection)} {unit})" for each in plan.together]
        said = f"Make {len(holds)} releases, from {joined(holds)}"
    said += f", and record {short(first.record_s)} s at {short(plan.rate_hz, 4)} Hz"
    said += " each." if len(plan.together) > 1 else "."
    texts = [
        (name, *value_and_sd(value, sd), "" if u == "1" else u, percent(sd, value))
        for name, u, value, sd in zip(
            plan.names, plan.units, plan.values.tolist(), plan.sd.tolist(), strict=True
        )
    ]
    notes = (Paragraph(sentence(f"Note: {note}"), "yellow") for note in plan.notes)
    return Document(
        plan.model.name,
        (
            section("", said, f"Expected relative standard deviation: {percent(plan.figure, 1.0)} %."),
            section("Expected", columns_of(["parameter", "value>", "±>", "unit", "± %>"], texts)),
            section(
                "Single releases", columns_of(["held at", f"deflection, {unit}>", "record, s>", "± %>"], rows)
            ),
            section("", *notes),
        ),
    )


def design_report(answer: Answer, provenance: Provenance | None = None) -> str:
    """HTML page of a planned test."""
    model, plan = answer.setup.model, answer.plan
    names = names_of(model, answer.setup.channels)
    statements = [] if answer.verdict is None else [stopping_in_words(answer)]
    statements += sensors_in_words(answer) if answer.choice is not None else []
    dwells: Section | None = None
    evidence: tuple[Section, ...] = ()
    headline = NO_TEST
    if plan is not None:
        said, *more = plan_in_words(answer, plan)
        statements += more
        headline = f"{counted(len(plan.dwells), 'dwell')}, {plan.samples} samples. {said}"
        dwells = section("Dwells", dwell_columns(plan, drive_units(model)))
        figure = planned_test_figure(answer)
        shown = "Dwells, information by frequency, and the expected intervals"
        evidence = (
            section("Expected intervals", expected_columns(answer)),
            section("Why these frequencies", figure_picture(figure, shown)),
        )
    return page_html(
        Document(
            model.name or "The next test",
            evidence,
            "good" if answer.verdict is not None and answer.verdict.reached else "open",
            "The next test.",
            headline,
            tuple(statements),
            tuple(sentence(capitalised(note, names)) for note in answer.notes),
            dwells,
            rig_picture(model, answer.setup.channels, answer.estimate),
            (
                "Write the dwells as a table for the shaker's controller: option --csv FILE.",
                "After the test: dashpot identify RIG DATA.",
            ),
            ("±", "bound", "duality gap"),
            provenance,
        )
    )


# Sentences.


def plan_in_words(answer: Answer, plan: Plan) -> list[str]:
    """What the test gives by its criterion, how close to optimal it is, and how it compares."""
    predicted = plan.predicted
    name = plan.criterion.name
    names = plan.criterion.names
    of = f" of {joined(names)}" if names else ""
    if len(names) == 1:
        name = "relative standard deviation"  # a mean of one
    over = ""
    if answer.worst is not None:
        over = f", {_SCENARIOS[answer.setup.over]} {len(answer.setup.theta)} scenarios"
    figure = figure_in_words(plan.criterion, plan.predicted.figure)
    cost, gap = 100 * max(plan.loss, 0.0), f"duality gap {short(plan.gap, 2)}"
    if cost < 0.01:  # per cent that rounding may cost for a test to be called optimal
        best = "better by more than 0.01 %"
        optimality = f"Optimal: no test of {plan.samples:,.0f} samples in this band is {best} ({gap})."
    else:
        optimality = (
            f"The best test with as many samples in this band gives {figure_in_words(plan.criterion, plan.ideal)} "
            f"({gap}); whole periods and limits cost {short(cost, 2)} %."
        )
    lines = [f"{name[0].upper()}{name[1:]}{of}{over}: {figure}.", optimality]
    if len(predicted.names) > 1:
        rms = short(100 * predicted.rms())
        known = [unknown.name for unknown in answer.setup.model.unknowns if unknown.sd is not None]
        including = f", {joined(known)} with its stated sd included" if known else ""
        lines.append(
            f"Rms relative standard deviation of the {len(predicted.names)} parameters{including}: {rms} %."
        )
    if answer.worst is not None:
        where = "found by search" if answer.setup.over == "worst" else "of these scenarios"
        lines.append(f"Worst case ({where}): {figure_in_words(plan.criterion, answer.worst)}.")
    if answer.comparison is not None:
        other = answer.comparison
        line = (
            f"The other test ({len(other.schedule.frequency_hz)} frequencies) gives "
            f"{figure_in_words(plan.criterion, other.predicted.figure)} from as many samples: it needs "
            f"{_times(other.factor)} the samples for the same precision"
        )
        if other.factor_iv is not None:
            line += f", {_times(other.factor_iv)} with the paper's instrumental variables"
        lines.append(f"{line}.")
    if answer.unsettled is not None:
        gives = figure_in_words(plan.criterion, answer.unsettled.predicted.figure)
        if not any(dwell.settle_s for dwell in plan.dwells):
            advice = (
                f"No dwell waits for the steady state: with transients included the test gives {gives}; the figures "
                "above assume steady state."
            )
        elif answer.unsettled.thrown_away > WASTE:
            advice = (
                "Do not wait for steady state: record from the start and keep the transients. The same test then "
                f"gives {gives}; discarding them loses {100 * answer.unsettled.thrown_away:.0f} % of the information."
            )
        elif answer.unsettled.thrown_away < -WASTE:
            advice = (
                "Waiting for steady state pays: transients are noisier here (noise in per cent of the motion); "
                f"with them the same test gives {gives}."
            )
        else:
            advice = (
                f"Waiting for steady state costs little: with the transients, the same test gives {gives}."
            )
        lines.append(advice)
    return lines


def figure_in_words(criterion: Criterion, value: float) -> str:
    """A criterion's figure: a relative standard deviation; of targets, in multiples of them."""
    return f"{short(value)} × target" if criterion.targets is not None else f"{short(100 * value)} %"


def _times(factor: float) -> str:
    return f"{factor:.3g} times" if math.isfinite(factor) else "infinitely many times"


def stopping_in_words(answer: Answer) -> str:
    """Whether the data there are reach the target, and what would."""
    verdict = answer.verdict
    assert verdict is not None
    if verdict.reached:
        return f"Target reached: {verdict.reason}."
    if not math.isfinite(verdict.more):
        return f"Target not reached: {verdict.reason}."
    best = ""
    if answer.plan is not None and answer.plan.predicted.figure <= 1.0001:
        best = f", or use the test below with {answer.plan.samples:,.0f}"
    return (
        f"Target not reached: {verdict.reason}; {verdict.more:,.0f} more samples of the same kind would be "
        f"enough{best}."
    )


def sensors_in_words(answer: Answer) -> list[str]:
    """The sensors chosen, then the next best sets."""
    choice = answer.choice
    assert choice is not None
    how = "all sets were tried" if choice.complete else "by exchange; possibly not the very best set"
    lines = [f"Sensors: {joined(choice.best)} ({how})."]
    lines += [
        f"  {joined(names)}: {figure_in_words(answer.criterion, figure)}"
        for names, figure in choice.ranking[1:4]
    ]
    return lines


# Tables.


def dwell_columns(plan: Plan, units: Mapping[str, str]) -> list[TableColumn]:
    """A row for each dwell, and the sums below."""
    dwells, drives = plan.dwells, list(plan.dwells[0].amplitudes)
    heads = ["dwell>", "frequency, Hz>", *(f"drive {name}, {units[name]}>" for name in drives)]
    rows = []
    for k, dwell in enumerate(dwells, start=1):
        rows.append([str(k), f"{dwell.frequency_hz:.6g}"])
        for z in (dwell.amplitudes[name] for name in drives):
            turned = abs(z.imag) > 1e-12 * abs(z)
            rows[-1].append(f"{abs(z):.4g} ∠{phase_deg(z):.0f}°" if turned else f"{z.real:.4g}")
    rows.append(["total", *[""] * (1 + len(drives))])
    if plan.time_s is not None:
        settling = sum(dwell.settle_s for dwell in dwells)
        heads += ["settle, s>", "periods>", "measure, s>"]
        for row, dwell in zip(rows, dwells, strict=False):
            row += [short(dwell.settle_s), str(dwell.periods), short(dwell.time_s or 0.0, 4)]
        rows[-1] += [short(settling), "", short(plan.time_s - settling, 4)]
    for row, samples in zip(rows, (*(dwell.samples for dwell in dwells), plan.samples), strict=True):
        row.append(str(samples))
    return columns_of([*heads, "samples>"], rows)


def expected_columns(answer: Answer) -> list[TableColumn]:
    """Values, the expected ± with its interval, and what is known now and what another test would give."""
    assert answer.plan is not None
    expected = answer.plan.predicted
    relative = _relative(expected)
    rows = []
    for name, value, sd, unit in zip(
        expected.names, expected.values.tolist(), expected.sd.tolist(), expected.units, strict=True
    ):
        ends = alike([value - 1.96 * sd, value + 1.96 * sd], sd)
        share = relative.get(name, NOTHING)
        rows.append((name, *value_and_sd(value, sd), "" if unit == "1" else unit, share, " … ".join(ends)))
    columns = columns_of(["parameter", "value>", "expected ±>", "unit", "± %>", "95 % interval>"], rows)
    others = {}
    if answer.estimate is not None:
        e = answer.estimate
        pairs = zip(e.names, e.sd.tolist(), e.values.tolist(), strict=True)
        others["now\n± %"] = {name: percent(sd, value) for name, sd, value in pairs}
    if answer.unsettled is not None:
        others["whole\n± %"] = _relative(answer.unsettled.predicted)
    if answer.comparison is not None:
        others["other\n± %"] = _relative(answer.comparison.predicted)
        if answer.comparison.iv is not None:
            others["other,\niv ± %"] = _relative(answer.comparison.iv)
    return columns + [
        TableColumn(title, tuple(shares.get(name, NOTHING) for name in expected.names), "right")
        for title, shares in others.items()
    ]


def _relative(precision: ExpectedPrecision) -> dict[str, str]:
    """Relative standard deviations in per cent, of the parameters that have one."""
    numbers = zip(precision.names, precision.values.tolist(), precision.relative.tolist(), strict=True)
    return {name: short(100 * share, 2) for name, value, share in numbers if value != 0}
