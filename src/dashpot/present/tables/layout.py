"""How tables are laid out: columns of text that are never cut off, but stacked where they do not fit side by side.

A table is a list of TableColumns, the first of which names the rows.  The same columns become a table of a terminal,
in as many blocks as its width needs, or one of a page.
"""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from typing import IO

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, ConsoleRenderable, JustifyMethod, RenderHook, RenderResult
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from dashpot.errors import printable

WIDTH = 80  # columns of text where nothing says how wide it may be
GAP = 2  # between columns


@dataclass(frozen=True)
class TableColumn:
    """A column of a table: its title, of one or more lines, and a text for each row."""

    title: str
    cells: tuple[str, ...]
    justify: JustifyMethod = "left"

    @property
    def width(self) -> int:
        """Columns of the terminal that the longest text takes."""
        return max(cell_len(line) for text in (self.title, *self.cells) for line in text.split("\n"))


def console() -> Console:
    """Where tables go: as wide as the terminal or COLUMNS says, else 80 columns; without colour into a file."""
    known = sys.stdout.isatty() or "COLUMNS" in os.environ
    return _console(None if known else WIDTH)


class _Printable(RenderHook):
    """Shows control characters, and what turns or hides text, escaped, whatever prints them."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        """Each with its text escaped once it is laid out."""
        return [_Escaped(each) for each in renderables]


@dataclass(frozen=True)
class _Escaped:
    of: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for text, style, control in console.render(self.of, options):
            yield Segment(text if control else printable(text, kept="\n"), style, control)


def _console(width: int | None, file: IO[str] | None = None) -> Console:
    made = Console(file=file, width=width, highlight=False, emoji=False, markup=False)
    made.push_render_hook(_Printable())
    return made


def printed(show: Callable[[Console], None], width: int = WIDTH) -> str:
    """What `show` prints, as text without empty lines around it."""
    text = StringIO()
    show(_console(width, text))
    return text.getvalue().strip("\n")


def blocks_of(columns: Sequence[TableColumn], width: int, keys: int = 1) -> list[list[TableColumn]]:
    """The columns in blocks no wider than `width`, each beginning with the first `keys` columns, which name the rows.

    A column that does not fit beside those has a block to itself; there its texts are folded.
    """
    names, others = list(columns[:keys]), columns[keys:]
    least = sum(column.width for column in names) + GAP * (keys - 1)
    blocks: list[list[TableColumn]] = []
    used = width
    for column in others:
        need = GAP + column.width
        if used + need > width:
            blocks.append([*names])
            used = least
        blocks[-1].append(column)
        used += need
    return blocks or [names]


def show_table(
    out: Console, columns: Sequence[TableColumn], styles: Sequence[str] = (), *, keys: int = 1
) -> None:
    """Print a table in as many blocks as the width needs, each with the first `keys` columns.

    `styles` are those of the rows, where they have one.
    """
    for number, block in enumerate(blocks_of(columns, out.width, keys)):
        if number:
            out.print()
        table = Table(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
        for column in block:
            table.add_column(Text(column.title), justify=column.justify, overflow="fold")
        for row, cells in enumerate(zip(*(column.cells for column in block), strict=True)):
            table.add_row(*map(Text, cells), style=styles[row] if row < len(styles) else "")
        out.print(table)


def html_table(columns: Sequence[TableColumn], caption: str = "") -> str:
    """The table as an HTML element; all texts are escaped."""
    head = "".join(f"<th>{_html(column.title)}</th>" for column in columns)
    rows = "".join(
        "<tr>"
        + "".join(
            f'<td style="text-align:{column.justify}">{_html(cell)}</td>'
            for column, cell in zip(columns, cells, strict=True)
        )
        + "</tr>"
        for cells in zip(*(column.cells for column in columns), strict=True)
    )
    title = f"<caption>{_html(caption)}</caption>" if caption else ""
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def html_paragraph(text: str) -> str:
    """A paragraph; the text is escaped."""
    return f"<p>{_html(text)}</p>"


def _html(text: str) -> str:
    return printable(escape(text), kept="\n").replace("\n", "<br>")


def show_paragraph(out: Console, text: str, style: str = "") -> None:
    """Text, wrapped at words; what is longer than a line stands whole."""
    for line in textwrap.wrap(text, out.width, break_long_words=False, break_on_hyphens=False):
        out.print(Text(line, style=style), soft_wrap=True)
