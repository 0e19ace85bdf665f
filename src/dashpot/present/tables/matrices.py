"""M, C and K with their standard deviations, for a terminal."""

from __future__ import annotations

from rich.cells import cell_len
from rich.console import Console

from dashpot.estimate.linear.definite import FreeMatrices
from dashpot.model.unstructured import Letter
from dashpot.present.tables.layout import TableColumn, show_table
from dashpot.present.text.numbers import aligned, rounded

UNITS = {False: {"M": "kg", "C": "N·s/m", "K": "N/m"}, True: {"M": "kg·m²", "C": "N·m·s/rad", "K": "N·m/rad"}}


def show_matrices(console: Console, matrices: FreeMatrices, angular: bool = False) -> None:
    """Every matrix that was found, its upper triangle, value ± standard deviation; as many columns as fit."""
    for letter in dict.fromkeys(letter for letter, _, _ in matrices.entries):
        console.print()
        show_table(console, matrix_columns(matrices, letter, UNITS[angular][letter]))


def matrix_columns(matrices: FreeMatrices, letter: Letter, unit: str) -> list[TableColumn]:
    """Coordinates, then a column of the upper triangle for each."""
    values, sd = getattr(matrices, letter), matrices.sd(letter)
    free = {(i, j) for which, i, j in matrices.entries if which == letter}
    columns = [TableColumn(f"{letter}, {unit}", tuple(matrices.coordinates))]
    for j, name in enumerate(matrices.coordinates):
        pairs = [rounded(values[i, j], sd[i, j]) if (i, j) in free else ("0", "") for i in range(j + 1)]
        left = aligned([value for value, _ in pairs])
        widest = max(map(cell_len, left))
        texts = [
            f"{value.rjust(widest)} ± {spread}" if spread else value.rjust(widest)
            for value, (_, spread) in zip(left, pairs, strict=True)
        ]
        columns.append(TableColumn(name, (*texts, *[""] * (len(matrices.coordinates) - j - 1))))
    return columns
