"""Estimates of several methods below each other, for a terminal."""

from __future__ import annotations

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dashpot.estimate.comparison import Comparison
from dashpot.estimate.result import Estimate
from dashpot.present.text.notices import with_remedy
from dashpot.present.text.numbers import aligned, percent, plain, rounded, short

MISSES = "*"
GAP = 2  # between columns; the box has one of it


def show_comparison(console: Console, comparison: Comparison, level: float = 0.95) -> None:
    """A row for each method, a column for each unknown, in as many blocks as the width needs, and remarks."""
    heads = _heads(comparison)
    columns = [_column(comparison, name, level) for name in comparison.names]
    if comparison.truth:
        columns.append(_errors_column(comparison, len(heads)))
    if comparison.model:
        console.print(Text(comparison.model, style="bold"))
    for k, block in enumerate(_blocks(heads, columns, console.width)):
        if k:
            console.print()
        console.print(_table(heads, block, len(comparison.estimates)))
    console.print()
    for line in _remarks(comparison, level):
        console.print(Text(line))


def _heads(comparison: Comparison) -> list[str]:
    """The first column: what the rows are."""
    heads = ["", ""]  # names and units speak for themselves
    if comparison.truth:
        heads.append("truth")
    if any(comparison.bound_sd(name) is not None for name in comparison.names):
        heads.append("bound")
    return [*heads, *comparison.estimates]


def _column(comparison: Comparison, name: str, level: float) -> list[str]:
    """Name, unit, truth, bound, then value ± sd of every method, marked where the interval misses the truth."""
    truth, bound = comparison.truth.get(name), comparison.bound_sd(name)
    pairs = []
    for estimate in comparison.estimates.values():
        v = estimate[name]
        value, sd = rounded(v.value, v.sd)
        pairs.append((value, sd + (MISSES if _missed(estimate, name, truth, level) else "")))
    told = "" if truth is None else plain(truth)
    values = aligned([told, *(value for value, _ in pairs)])
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


def _errors_column(comparison: Comparison, rows: int) -> list[str]:
    """The worst error of each method, % of the truth."""
    errors = aligned([_worst(comparison, estimate) for estimate in comparison.estimates.values()])
    widest = max(map(cell_len, errors))
    cells = [error.rjust(widest) for error in errors]
    return ["worst", "error %", *[""] * (rows - 2 - len(cells)), *cells]


def _worst(comparison: Comparison, estimate: Estimate) -> str:
    pairs = [(estimate[name].value - true, true) for name, true in comparison.truth.items()]
    error, true = max(pairs, key=lambda pair: abs(pair[0] / pair[1]) if pair[1] else 0.0)
    return percent(error, true)


def _blocks(heads: list[str], columns: list[list[str]], width: int) -> list[list[list[str]]]:
    """Which columns stand beside each other."""
    fixed = max(map(cell_len, heads)) + GAP
    blocks: list[list[list[str]]] = [[]]
    used = fixed
    for column in columns:
        need = max(map(cell_len, column)) + GAP
        if blocks[-1] and used + need > width:
            blocks.append([])
            used = fixed
        blocks[-1].append(column)
        used += need
    return blocks


def _table(heads: list[str], columns: list[list[str]], methods: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    first = len(heads) - methods
    for own in (heads, *columns):
        head = Text("\n".join(own[:first]))
        head.stylize("not bold")
        head.stylize("bold", 0, len(own[0]))
        table.add_column(head, no_wrap=True)
    for row in range(first, len(heads)):
        cells = [Text(own[row], style="red" if own[row].endswith(MISSES) else "") for own in columns]
        table.add_row(heads[row], *cells)
    return table


def _remarks(comparison: Comparison, level: float) -> list[str]:
    lines = ["± is one standard deviation."]
    if any(comparison.bound_sd(name) is not None for name in comparison.names):
        lines[0] = "± is one standard deviation; bound: the least that any can have without bias."
    if any(
        _missed(estimate, name, truth, level)
        for estimate in comparison.estimates.values()
        for name, truth in comparison.truth.items()
    ):
        lines.append(f"{MISSES} the {100 * level:g} % interval does not hold the truth.")
    lines += [
        f"{name} did not converge." for name, e in comparison.estimates.items() if not bool(e.converged)
    ]
    reasons = [(str(error), name) for name, error in comparison.refused.items()]
    told = [
        (with_remedy(warning), name) for name, e in comparison.estimates.items() for warning in e.warnings
    ]
    return [*lines, *_by_name(reasons, ()), *_by_name(told, tuple(comparison.estimates))]


def _by_name(said: list[tuple[str, str]], everyone: tuple[str, ...]) -> list[str]:
    """What is said of several methods in the same words, once."""
    names: dict[str, list[str]] = {}
    for text, name in said:
        names.setdefault(text.removeprefix("the method ").removeprefix(f"{name} "), []).append(name)
    return [
        f"{'all' if len(own) > 1 and tuple(own) == everyone else ', '.join(own)}: {text}"
        for text, own in names.items()
    ]
