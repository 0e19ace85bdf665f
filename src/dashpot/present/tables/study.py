"""A Monte Carlo study as a table: one row for each scenario and method."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from rich.console import Console

from dashpot.present.tables.layout import TableColumn, show_paragraph, show_table
from dashpot.present.text.study import COUNTED_FACTORS, LEGEND, NOTHING, factor_text, varied_factors
from dashpot.study.montecarlo import StudyOutcome, Summary, SummaryRow

RESULTS = ("bias", "spread", "bound", "ratio", "coverage", "failed")
LABEL = 21  # characters of several factors in one column on a line: 80 columns hold the rest beside it


def show_study(outcome: StudyOutcome, console: Console) -> None:
    """Print what varies, and how each method did."""
    varied = varied_factors(outcome.rows)
    factors = outcome.rows[0].scenario.factors
    fixed = [f"{key} {factor_text(value)}" for key, value in factors.items() if key not in varied]
    show_paragraph(console, f"{outcome.name}, seed {outcome.seed}", "bold")
    if fixed:
        show_paragraph(console, "In all scenarios: " + ", ".join(fixed), "dim")
    console.print()
    columns = study_columns(outcome.rows)
    show_table(console, columns, keys=len(columns) - len(RESULTS))
    console.print()
    for line in LEGEND:
        show_paragraph(console, line, "dim")


def study_columns(rows: Sequence[SummaryRow]) -> list[TableColumn]:
    """The method with the factors that vary, then bias, spread, bound, their ratio, coverage and failures.

    Factors stand where the scenario changes.  The method comes first: it names the rows where columns are stacked.
    """
    varied = varied_factors(rows)
    changes = [k == 0 or rows[k - 1].scenario is not row.scenario for k, row in enumerate(rows)]
    if len(varied) <= 3:  # columns of factors; more are put into one
        columns = [_factor_column(rows, name, changes) for name in varied]
    else:
        labels = [[factor_text(row.scenario.factors.get(name)) for name in varied] for row in rows]
        cells = tuple(
            fill(", ".join(text for text in scenario if text != NOTHING), LABEL) if changed else ""
            for scenario, changed in zip(labels, changes, strict=True)
        )
        columns = [TableColumn(fill(", ".join(varied), LABEL), cells)]
    columns.append(TableColumn("method", tuple(row.method for row in rows)))
    results = [_results(row.summary) for row in rows]
    for place, title in enumerate(RESULTS):
        columns.append(TableColumn(title, tuple(texts[place] for texts in results), "right"))
    return columns


def _factor_column(rows: Sequence[SummaryRow], name: str, changes: Sequence[bool]) -> TableColumn:
    texts = (factor_text(row.scenario.factors.get(name)) for row in rows)
    cells = tuple(text if changed else "" for text, changed in zip(texts, changes, strict=True))
    return TableColumn(name.replace("_", " "), cells, "right" if name in COUNTED_FACTORS else "left")


def _results(summary: Summary) -> tuple[str, ...]:
    return (
        f"{summary.rms_bias:.2f}",
        f"{summary.rms_spread:.2f}",
        f"{summary.rms_bound:.2f}",
        f"{summary.rms_spread / summary.rms_bound:.2f}" if summary.rms_bound > 0 else NOTHING,
        f"{min(summary.coverage):.1f}–{max(summary.coverage):.1f}",
        f"{summary.failed}/{summary.draws}" if summary.failed else NOTHING,
    )
