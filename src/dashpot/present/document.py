"""A result as a document: paragraphs, tables and pictures, for a terminal, a notebook or a page.

A topic (an estimate, a planned test, a study …) says once which blocks it has; `show` prints them, `html_of` is for a
notebook, and `page.page_html` makes a report of them.  Columns are never cut off, but stacked where they do not fit
side by side.
"""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from typing import IO, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, ConsoleRenderable, JustifyMethod, RenderHook, RenderResult
from rich.segment import Segment
from rich.table import Table as TerminalTable
from rich.text import Text

from dashpot.errors import printable

WIDTH = 80  # columns of text where nothing says how wide it may be
GAP = 2  # between columns
Verdict = Literal["good", "bad", "open"]


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


def columns_of(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[TableColumn]:
    """A table by its rows.  A head that ends with > is that of a column flush right, one with ^ of a centred one."""
    cells = list(zip(*rows, strict=True)) or [()] * len(heads)
    sides: dict[str, JustifyMethod] = {">": "right", "^": "center"}
    return [
        TableColumn(head[:-1], texts, sides[head[-1]]) if head[-1:] in sides else TableColumn(head, texts)
        for head, texts in zip(heads, cells, strict=True)
    ]


@dataclass(frozen=True)
class Paragraph:
    """Text, and its style on a terminal."""

    text: str
    style: str = ""


@dataclass(frozen=True)
class Items:
    """A list of texts."""

    texts: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Columns; on a terminal each block of them begins with the first `keys`, which name the rows.

    styles  of the rows, where they have one
    heads   so many rows stand in the head, as units do
    marked  cells that end with it are red
    """

    columns: Sequence[TableColumn]
    styles: Sequence[str] = ()
    keys: int = 1
    heads: int = 0
    marked: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture (SVG or an image element) with what it shows in words, for who cannot see it; `wide`: all the width."""

    svg: str
    alternative: str
    wide: bool = True


Block = Paragraph | Items | Table | Picture


@dataclass(frozen=True)
class Section:
    """Blocks that belong together; pages show the title, and `whole` takes the whole width of a wide screen."""

    title: str
    blocks: tuple[Block, ...]
    whole: bool = False


def section(title: str, *parts: Block | str | Sequence[TableColumn] | None, whole: bool = False) -> Section:
    """A section of blocks, of texts, which are paragraphs, and of columns, which are tables; None are left out."""
    blocks: list[Block] = []
    for part in parts:
        if isinstance(part, str):
            blocks += [Paragraph(part)] if part else []
        elif isinstance(part, Block):
            blocks.append(part)
        elif part is not None:
            blocks.append(Table(part))
    return Section(title, tuple(blocks), whole)


@dataclass(frozen=True)
class SourceFile:
    """A file that went into a result."""

    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """How a result was computed: when, with what, from what, and the command that repeats it.

    settings: (name, value, whether it was given); labels: lines that the report is to bear, such as who made it.
    """

    date: str
    versions: tuple[tuple[str, str], ...]
    command: str
    folder: str
    settings: tuple[tuple[str, str, bool], ...]
    files: tuple[SourceFile, ...]
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Document:
    """A result in words, tables and pictures.  Terminals and notebooks show title and sections, pages all of it.

    headline    says in one sentence whether to trust the answer, statements say more, cautions what to mind
    answer      the section beside the drawing, `beside` the one below that; the others are the evidence
    steps       what to do next
    appendix    what only those need who go on working with the result
    terms       keys of `page.EXPLANATIONS`
    """

    title: str
    sections: tuple[Section, ...] = ()
    verdict: Verdict = "open"
    subtitle: str = ""
    headline: str = ""
    statements: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    answer: Section | None = None
    drawing: Picture | None = None
    steps: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    provenance: Provenance | None = None
    beside: Section | None = None
    appendix: tuple[Section, ...] = ()


# On a terminal.


def console() -> Console:
    """Where documents go: as wide as the terminal or COLUMNS says, else 80 columns; without colour into a file."""
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


def printed(document: Document, width: int = WIDTH) -> str:
    """What `show` prints, as text without empty lines around it."""
    text = StringIO()
    show(_console(width, text), document)
    return text.getvalue().strip("\n")


def show(out: Console, document: Document) -> None:
    """Print the title, and the sections with an empty line between them; no pictures."""
    if document.title:
        show_paragraph(out, document.title, "bold")
    for number, each in enumerate(document.sections):
        if number:
            out.print()
        for block in each.blocks:
            if isinstance(block, Table):
                show_table(out, block)
            elif isinstance(block, Paragraph):
                show_paragraph(out, block.text, block.style)


def say(document: Document, *, apart: bool = False) -> None:
    """Print a document to standard output, `apart` from what stands there already by an empty line."""
    out = console()
    if apart:
        out.print()
    show(out, document)


def column_blocks(columns: Sequence[TableColumn], width: int, keys: int = 1) -> list[list[TableColumn]]:
    """The columns in blocks no wider than `width`, each beginning with the first `keys` columns, which name the rows.

    A column that does not fit next to those has a block to itself; there its texts are folded.
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


def show_table(out: Console, table: Table) -> None:
    """Print a table in as many blocks as the width needs."""
    for number, block in enumerate(column_blocks(table.columns, out.width, table.keys)):
        if number:
            out.print()
        made = TerminalTable(box=box.SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), pad_edge=False, show_edge=False)
        for column in block:
            head = Text("\n".join([column.title, *column.cells[: table.heads]]))
            if table.heads:
                head.stylize("not bold")
                head.stylize("bold", 0, len(column.title))
            made.add_column(head, justify=column.justify, overflow="fold")
        for row, cells in enumerate(zip(*(column.cells[table.heads :] for column in block), strict=True)):
            red = (table.marked and cell.endswith(table.marked) for cell in cells)
            texts = (Text(cell, style="red" if bad else "") for cell, bad in zip(cells, red, strict=True))
            made.add_row(*texts, style=table.styles[row] if row < len(table.styles) else "")
        out.print(made)


def show_paragraph(out: Console, text: str, style: str = "") -> None:
    """Text, wrapped at words; what is longer than a line stands whole."""
    for line in textwrap.wrap(text, max(out.width, 1), break_long_words=False, break_on_hyphens=False):
        out.print(Text(line, style=style), soft_wrap=True)


# In a notebook.


def html_of(document: Document) -> str:
    """Paragraphs and tables as HTML elements, the title as caption of the first table; all texts are escaped."""
    parts, caption = [], f"<caption>{_html(document.title)}</caption>" if document.title else ""
    for block in (block for each in document.sections for block in each.blocks):
        if isinstance(block, Table):
            columns = block.columns
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
            parts.append(f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>")
            caption = ""
        elif isinstance(block, Paragraph):
            parts.append(f"<p>{_html(block.text)}</p>")
    return "".join(parts)


def _html(text: str) -> str:
    return printable(escape(text), kept="\n").replace("\n", "<br>")
