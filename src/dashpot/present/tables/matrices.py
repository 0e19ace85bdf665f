"""M, C and K with their standard deviations, for a terminal."""

from __future__ import annotations

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dashpot.estimate.linear.definite import FreeMatrices
from dashpot.model.unstructured import Letter
from dashpot.present.text.numbers import aligned, rounded

UNITS = {False: {"M": "kg", "C": "N·s/m", "K": "N/m"}, True: {"M": "kg·m²", "C": "N·m·s/rad", "K": "N·m/rad"}}
GAP = 2  # between columns; the box has one of it


def show_matrices(console: Console, matrices: FreeMatrices, angular: bool = False) -> None:
    """Every matrix that was found, its upper triangle, value ± standard deviation; as many columns as fit."""
    letters = list(dict.fromkeys(letter for letter, _, _ in matrices.entries))
    for letter in letters:
        columns = _columns(matrices, letter)
        room = console.width - max(map(cell_len, matrices.coordinates)) - GAP
        blocks: list[list[int]] = [[]]
        used = 0
        for j, column in enumerate(columns):
            need = max(map(cell_len, [matrices.coordinates[j], *column])) + GAP
            if blocks[-1] and used + need > room:
                blocks.append([])
                used = 0
            blocks[-1].append(j)
            used += need
        for block in blocks:
            console.print()
            console.print(_table(matrices, columns, block, f"{letter}, {UNITS[angular][letter]}"))


def _columns(matrices: FreeMatrices, letter: Letter) -> list[list[str]]:
    values, sd = getattr(matrices, letter), matrices.sd(letter)
    found = {(i, j) for which, i, j in matrices.entries if which == letter}
    columns = []
    for j in range(len(matrices.coordinates)):
        pairs = [rounded(values[i, j], sd[i, j]) if (i, j) in found else ("0", "") for i in range(j + 1)]
        left = aligned([value for value, _ in pairs])
        widest = max(map(cell_len, left))
        column = [
            f"{value.rjust(widest)} ± {spread}" if spread else value.rjust(widest)
            for value, (_, spread) in zip(left, pairs, strict=True)
        ]
        columns.append(column + [""] * (len(matrices.coordinates) - j - 1))
    return columns


def _table(matrices: FreeMatrices, columns: list[list[str]], block: list[int], title: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
    table.add_column(Text(title), no_wrap=True)
    for j in block:
        table.add_column(Text(matrices.coordinates[j]), no_wrap=True)
    for i in range(max(block) + 1):
        table.add_row(matrices.coordinates[i], *(columns[j][i] for j in block))
    return table
