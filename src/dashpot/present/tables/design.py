"""A planned test as tables: its dwells, and the expected intervals."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console

from dashpot.design.advise import Answer
from dashpot.design.allocation import ExpectedPrecision
from dashpot.design.plan import Plan
from dashpot.design.plan_files import phase_deg
from dashpot.design.test_setup import drive_units
from dashpot.present.tables.layout import TableColumn, show_paragraph, show_table
from dashpot.present.text.design import plan_in_words, sensors_in_words, stopping_in_words
from dashpot.present.text.estimate import sentence
from dashpot.present.text.numbers import alike, percent, rounded, short

NOTHING = "–"
NORMAL_95 = 1.96


def show_answer(answer: Answer, out: Console) -> None:
    """Print the dwells, the expected intervals, and what they are worth."""
    out.print()
    if answer.setup.model.name:
        show_paragraph(out, answer.setup.model.name, "bold")
    if answer.verdict is not None:
        show_paragraph(out, stopping_in_words(answer), "green" if answer.verdict.reached else "")
    if answer.choice is not None:
        for k, line in enumerate(sensors_in_words(answer)):
            show_paragraph(out, line, "dim" if k else "")
    if answer.plan is None:
        show_paragraph(out, "No test is needed: what is already known reaches the target.", "green")
        return
    out.print()
    columns = dwell_columns(answer.plan, drive_units(answer.setup.model))
    show_table(out, columns, [""] * len(answer.plan.dwells) + ["dim"])
    out.print()
    show_table(out, expected_columns(answer))
    out.print()
    for line in plan_in_words(answer, answer.plan):
        show_paragraph(out, line)
    for note in answer.notes:
        show_paragraph(out, sentence(f"Note: {note}"), "yellow")


def dwell_columns(plan: Plan, units: Mapping[str, str]) -> list[TableColumn]:
    """A row for each dwell, and the sums below."""
    dwells = plan.dwells
    places = (*(str(k + 1) for k in range(len(dwells))), "total")
    columns = [
        TableColumn("dwell", places, "right"),
        TableColumn("frequency, Hz", (*(f"{dwell.frequency_hz:.6g}" for dwell in dwells), ""), "right"),
    ]
    for name in dwells[0].amplitudes:
        cells = (_amplitude(dwell.amplitudes[name]) for dwell in dwells)
        columns.append(TableColumn(f"drive {name}, {units[name]}", (*cells, ""), "right"))
    if plan.time_s is not None:
        settling = sum(dwell.settle_s for dwell in dwells)
        timed = {
            "settle, s": (*(short(dwell.settle_s) for dwell in dwells), short(settling)),
            "periods": (*(str(dwell.periods) for dwell in dwells), ""),
            "measure, s": (
                *(short(dwell.time_s or 0.0, 4) for dwell in dwells),
                short(plan.time_s - settling, 4),
            ),
        }
        columns += [TableColumn(title, cells, "right") for title, cells in timed.items()]
    samples = (*(str(dwell.samples) for dwell in dwells), str(plan.samples))
    return [*columns, TableColumn("samples", samples, "right")]


def _amplitude(z: complex) -> str:
    if abs(z.imag) > 1e-12 * abs(z):
        return f"{abs(z):.4g} ∠{phase_deg(z):.0f}°"
    return f"{z.real:.4g}"


def expected_columns(answer: Answer) -> list[TableColumn]:
    """Values, the expected ± with its interval, and what is known now and what another test would give."""
    assert answer.plan is not None
    expected = answer.plan.predicted
    values, spreads, intervals = [], [], []
    for value, sd in zip(expected.values.tolist(), expected.sd.tolist(), strict=True):
        shown, spread = rounded(value, sd)
        values.append(shown)
        spreads.append(spread)
        intervals.append(" … ".join(alike([value - NORMAL_95 * sd, value + NORMAL_95 * sd], sd)))
    columns = [
        TableColumn("parameter", tuple(expected.names)),
        TableColumn("value", tuple(values), "right"),
        TableColumn("expected ±", tuple(spreads), "right"),
        TableColumn("unit", tuple("" if unit == "1" else unit for unit in expected.units)),
        TableColumn("± %", _relative(expected, expected), "right"),
        TableColumn("95 % interval", tuple(intervals), "right"),
    ]
    if answer.estimate is not None:
        e = answer.estimate
        now = {n: percent(float(sd), float(v)) for n, sd, v in zip(e.names, e.sd, e.values, strict=True)}
        cells = tuple(now.get(name, NOTHING) for name in expected.names)
        columns.append(TableColumn("now\n± %", cells, "right"))
    if answer.unsettled is not None:
        columns.append(TableColumn("whole\n± %", _relative(answer.unsettled.predicted, expected), "right"))
    if answer.comparison is not None:
        other = answer.comparison
        columns.append(TableColumn("other\n± %", _relative(other.predicted, expected), "right"))
        if other.iv is not None:
            columns.append(TableColumn("other,\niv ± %", _relative(other.iv, expected), "right"))
    return columns


def _relative(precision: ExpectedPrecision, rows: ExpectedPrecision) -> tuple[str, ...]:
    """Relative standard deviations in per cent, for the parameters of `rows`."""
    relative = {
        name: short(100 * share, 2)
        for name, value, share in zip(
            precision.names, precision.values.tolist(), precision.relative.tolist(), strict=True
        )
        if value != 0
    }
    return tuple(relative.get(name, NOTHING) for name in rows.names)
