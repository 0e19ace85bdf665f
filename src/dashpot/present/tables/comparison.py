"""Estimates of several methods below each other."""

from __future__ import annotations

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dashpot.estimate.comparison import Comparison
from dashpot.estimate.result import Estimate
from dashpot.present.tables.layout import (
    GAP,
    TableColumn,
    blocks_of,
    html_paragraph,
    html_table,
    show_paragraph,
)
from dashpot.present.text.estimate import sentence
from dashpot.present.text.numbers import aligned, percent, plain, rounded, short

MISSES = "*"


def show_comparison(console: Console, comparison: Comparison, level: float = 0.95) -> None:
    """A row for each method, a column for each unknown, in as many blocks as the width needs, and remarks."""
    methods = len(comparison.estimates)
    columns = comparison_columns(comparison, level)
    if comparison.model:
        show_paragraph(console, comparison.model, "bold")
    for number, block in enumerate(blocks_of(columns, console.width)):
        if number:
            console.print()
        table = Table(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
        first = len(block[0].cells) - methods
        for column in block:
            head = Text("\n".join([column.title, *column.cells[:first]]))
            head.stylize("not bold")
            head.stylize("bold", 0, len(column.title))
            table.add_column(head, overflow="fold")
        for row in range(first, first + methods):
            texts = [column.cells[row] for column in block]
            table.add_row(*(Text(text, style="red" if text.endswith(MISSES) else "") for text in texts))
        console.print(table)
    console.print()
    for line in comparison_remarks(comparison, level):
        show_paragraph(console, line)


def comparison_html(comparison: Comparison, level: float = 0.95) -> str:
    """The table and the remarks as HTML, for a notebook."""
    table = html_table(comparison_columns(comparison, level), comparison.model)
    return "".join([table, *map(html_paragraph, comparison_remarks(comparison, level))])


def comparison_columns(comparison: Comparison, level: float = 0.95) -> list[TableColumn]:
    """What the rows are, then each unknown; the last rows are the methods, those above them name, unit, truth, bound.

    With a known truth there is a column of the worst errors as well, and an interval that misses it ends in MISSES.
    """
    heads = ["", ""]  # names and units speak for themselves
    if comparison.truth:
        heads.append("truth")
    if any(comparison.bound_sd(name) is not None for name in comparison.names):
        heads.append("bound")
    heads = [*heads, *comparison.estimates]
    texts = [heads, *(_column(comparison, name, level) for name in comparison.names)]
    if comparison.truth:
        errors = aligned([_worst(comparison, estimate) for estimate in comparison.estimates.values()])
        widest = max(map(cell_len, errors))
        cells = [error.rjust(widest) for error in errors]
        texts.append(["worst", "error %", *[""] * (len(heads) - 2 - len(cells)), *cells])
    return [TableColumn(cells[0], tuple(cells[1:])) for cells in texts]


def _column(comparison: Comparison, name: str, level: float) -> list[str]:
    """Name, unit, truth, bound, then value ± sd of every method, marked where the interval misses the truth."""
    truth, bound = comparison.truth.get(name), comparison.bound_sd(name)
    pairs = []
    for estimate in comparison.estimates.values():
        v = estimate[name]
        value, sd = rounded(v.value, v.sd)
        pairs.append((value, sd + (MISSES if _missed(estimate, name, truth, level) else "")))
    values = aligned(["" if truth is None else plain(truth), *(value for value, _ in pairs)])
    widest = max(map(cell_len, values))
    values = [value.rjust(widest) for value in values]
    unit = comparison.units[comparison.names.index(name)]
    cells = [name, "" if unit == "1" else unit]
    if comparison.truth:
        cells.append(values[0].rstrip())
    if any(comparison.bound_sd(other) is not None for other in comparison.names):
        cells.append("" if bound is None else f"{' ' * widest} ± {short(bound, 2)}")
    return [*cells, *(f"{value} ± {sd}" for value, (_, sd) in zip(values[1:], pairs, strict=True))]


def _missed(estimate: Estimate, name: str, truth: float | None, level: float) -> bool:
    if truth is None:
        return False
    low, high = estimate.interval(level)
    j = estimate.names.index(name)
    return truth < float(low[j]) or truth > float(high[j])


def _worst(comparison: Comparison, estimate: Estimate) -> str:
    pairs = [(estimate[name].value - true, true) for name, true in comparison.truth.items()]
    error, true = max(pairs, key=lambda pair: abs(pair[0] / pair[1]) if pair[1] else 0.0)
    return percent(error, true)


def comparison_remarks(comparison: Comparison, level: float = 0.95) -> list[str]:
    """What ± and marks mean, and what was noticed, by the methods it concerns."""
    lines = ["± is one standard deviation."]
    if any(comparison.bound_sd(name) is not None for name in comparison.names):
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
