"""Errors of known parameters, as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console

from dashpot.check.sensitivity import KnownErrors
from dashpot.present.tables.layout import TableColumn, show_paragraph, show_table


def known_columns(errors: KnownErrors) -> list[TableColumn]:
    """Per cent by which each unknown moves for an error of 1 % of each known parameter."""
    rows = errors.relative.tolist()
    columns = [TableColumn("1 % of", tuple(errors.known))]
    for j, name in enumerate(errors.unknowns):
        cells = (f"{row[j]:+.2f} %" if math.isfinite(row[j]) else "–" for row in rows)
        columns.append(TableColumn(name, tuple(cells), "right"))
    return columns


def show_known(out: Console, errors: KnownErrors) -> None:
    """Print the table of known errors."""
    show_paragraph(out, "How far an error of 1 % of each known parameter moves the estimates:")
    show_table(out, known_columns(errors))


def show_paragraphs(out: Console, paragraphs: Sequence[str]) -> None:
    """Print text, one paragraph below the other."""
    for paragraph in paragraphs:
        show_paragraph(out, paragraph)
