"""A report page: what it says, as plain content, and its HTML, one file that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from dashpot.errors import printable
from dashpot.io.ledger import current, noted
from dashpot.io.words import counted, joined
from dashpot.present.figures.interactive import interactive_svg
from dashpot.present.figures.style import DPI
from dashpot.present.tables.layout import TableColumn
from dashpot.present.text.glossary import EXPLANATIONS

TEMPLATES = Path(__file__).parents[1] / "templates"
_COMMAND = r"\bdashpot [a-z]+ [^()]*?(?=\.(?:\s|$)| writes |$)"
_CODE = re.compile(rf"{_COMMAND}|\[\w+\] [\w-]+ = \{{.*\}}")  # commands, and lines of a rig file
LIBRARIES = ("numpy", "scipy")  # whose versions a report states
MOST_SOURCES = 4  # files that the first lines of a page name
Verdict = Literal["good", "bad", "open"]


@dataclass(frozen=True)
class Picture:
    """A picture with what it shows in words, for who cannot see it; `wide` takes the whole width."""

    svg: str
    alternative: str
    wide: bool = True


@dataclass(frozen=True)
class Block:
    """A heading with paragraphs, tables and pictures; `whole` takes the whole width of a wide screen."""

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[tuple[TableColumn, ...], ...] = ()
    pictures: tuple[Picture, ...] = ()
    items: tuple[str, ...] = ()
    whole: bool = False


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

    @property
    def sources(self) -> str:
        """The files that were read, in a few words: their names without folders."""
        names = [Path(file.name).name for file in self.files]
        rest = len(names) - MOST_SOURCES
        return joined(names if rest <= 0 else [*names[:MOST_SOURCES], counted(rest, "other file")])


def provenance_of(
    command: str, settings: tuple[tuple[str, str, bool], ...] = (), labels: tuple[str, ...] = ()
) -> Provenance:
    """How a result is computed by `command` now and here, from the files that the open ledger knows as read."""
    versions = [("dashpot", version("dashpot")), ("Python", platform.python_version())]
    versions += [(name, version(name)) for name in LIBRARIES]
    ledger = current()
    files = []
    for name in () if ledger is None else tuple(ledger.inputs):
        path = Path(name)
        if path.is_file():
            with open(noted(name), "rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            files.append(SourceFile(name, path.stat().st_size, digest))
    date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")
    return Provenance(date, tuple(versions), command, os.getcwd(), settings, tuple(files), labels)


@dataclass(frozen=True)
class Page:
    """A report: the answer, what to do next, the evidence, and how it was computed.

    headline says in one sentence whether to trust the answer; `terms` are keys of EXPLANATIONS.
    """

    title: str
    subtitle: str
    verdict: Verdict
    headline: str
    statements: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    answer: Block | None = None
    drawing: Picture | None = None
    steps: tuple[str, ...] = ()
    evidence: tuple[Block, ...] = ()
    terms: tuple[str, ...] = ()
    provenance: Provenance | None = None


def figure_picture(figure: Figure, alternative: str, *, wide: bool = True) -> Picture:
    """A figure as a picture of a page, whose values can be told."""
    return Picture(interactive_svg(figure), alternative, wide)


def image_picture(png: bytes, alternative: str) -> Picture:
    """A PNG file as a picture of a page, as wide as it is meant to be printed."""
    width = int.from_bytes(png[16:20], "big") * 96 // DPI  # a PNG file states its width at byte 16
    content = base64.b64encode(png).decode("ascii")
    image = f'<img alt="{escape(alternative)}" width="{width}" src="data:image/png;base64,{content}">'
    return Picture(image, alternative)


def page_html(page: Page) -> str:
    """The page as one HTML file."""
    loader = FileSystemLoader(TEMPLATES)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    explanations = [(term, EXPLANATIONS[term]) for term in page.terms]
    blocks = (*page.evidence, *(() if page.answer is None else (page.answer,)))
    pictures = [picture.svg for block in blocks for picture in block.pictures]
    scripted = any("data-panels=" in svg or "<animate " in svg for svg in pictures)
    script = loader.get_source(environment, "figures.js")[0] if scripted else ""
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    text = environment.get_template("report.html").render(
        page=page, explanations=explanations, inline=inline, rows=_rows, with_code=with_code, allowed=allowed,
        script=Markup(script),
    )  # fmt: skip
    return printable(text, kept="\n")


def inline(picture: Picture) -> Markup:
    """The SVG element with its alternative text."""
    label = Markup.escape(picture.alternative)
    text = picture.svg
    if text.startswith("<svg") and "role=" not in text[: text.index(">")]:
        at_left = 'preserveAspectRatio="xMinYMin"'  # where a page holds less of its height
        text = text.replace("<svg ", f'<svg role="img" aria-label="{label}" {at_left} ', 1)
    return Markup(text)


def with_code(text: str) -> Markup:
    """The text with commands and lines of rig files set as code, in which no option is broken at its hyphens."""
    marked = re.sub(r"(?<![\w-])--[\w-]+", r'<span class="option">\g<0></span>', str(escape(text)))
    return Markup(_CODE.sub(r"<code>\g<0></code>", marked))


def _rows(columns: Sequence[TableColumn]) -> list[list[tuple[str, str]]]:
    """Rows of a table: (text, alignment) of each cell."""
    texts = zip(*(column.cells for column in columns), strict=True)
    return [
        [
            (cell.replace("± ", "±\N{NO-BREAK SPACE}"), column.justify)
            for cell, column in zip(row, columns, strict=True)
        ]
        for row in texts
    ]
