"""A document as a report page: one HTML file that needs nothing else, with how it was computed."""

from __future__ import annotations

import base64
import hashlib
import os
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from types import MappingProxyType

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from dashpot.errors import printable
from dashpot.io.ledger import current, noted
from dashpot.io.words import counted, joined
from dashpot.present.document import Document, Picture, Provenance, SourceFile, TableColumn
from dashpot.present.figures.interactive import interactive_svg
from dashpot.present.figures.style import DPI

TEMPLATES = Path(__file__).with_name("templates")
_COMMAND = r"\bdashpot [a-z]+ [^()]*?(?=\.(?:\s|$)| writes |$)"
_CODE = re.compile(rf"{_COMMAND}|\[\w+\] [\w-]+ = \{{.*\}}")  # commands, and lines of a rig file
LIBRARIES = ("numpy", "scipy")  # whose versions a report states

# Short explanations of the figures of merit.
EXPLANATIONS: Mapping[str, str] = MappingProxyType(
    {
        "±": "One standard deviation of the value: if the test is repeated, values scatter by about that much.",
        "interval": (
            "Contains the true value in 95 of 100 tests (or the level named), as long as the model fits."
        ),
        "bound": (
            "The smallest ± that any unbiased method could reach with these data (Cramér-Rao). If ± is "
            "near it, a better method would not help, only more or other data."
        ),
        "χ²": (
            "Sum of the squared residuals over the variance of the noise. Where the model fits, it is "
            "about the number of degrees of freedom (measured numbers minus unknowns); p is the "
            "probability of a larger one by chance."
        ),
        "residual": (
            "Measured minus predicted amplitude, over the standard deviation of this difference due to "
            "noise. Where the model fits, its rms is 1 and 95 % lie below 1.73."
        ),
        "difference of the motion": (
            "Rms of measured minus predicted amplitudes over the rms of the measured ones, in per "
            "cent, for each channel: the share of the motion that the model leaves unexplained, "
            "noise included."
        ),
        "band": "95 % band of the model's response: from the covariance of the estimate, to first order.",
        "correlation": (
            "Near ±1, two unknowns are strongly correlated: their sum or difference is known better "
            "than either."
        ),
        "share": (
            "Share of the information on an unknown that comes from a line or band. A line that "
            "contributes to no unknown can be left out of the next test."
        ),
        "damping ratio": "Damping over critical damping; 0.01 halves a free motion in 11 cycles.",
        "FIT": "1 minus the rms of the difference over the rms of the measured motion, in per cent: 100 % is a perfect "
        "prediction, 0 % is no better than predicting rest.",
        "profile": (
            "χ² with one unknown fixed at a value and all others at their best; where it is not a "
            "parabola, use the interval from the profile instead of the normal one."
        ),
        "duality gap": "How far the designed test is from the best one possible; 0 proves it optimal.",
        "spread": "Standard deviation of the values over the draws of a simulation; bias is the mean error.",
        "coverage": (
            "Share of the draws whose interval contains the true value; for 95 % intervals it should be 95 %."
        ),
    }
)


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


def figure_picture(figure: Figure, alternative: str, *, wide: bool = True) -> Picture:
    """A figure as a picture of a page, whose values can be told."""
    return Picture(interactive_svg(figure), alternative, wide)


def image_picture(png: bytes, alternative: str) -> Picture:
    """A PNG file as a picture of a page, as wide as it is meant to be printed."""
    width = int.from_bytes(png[16:20], "big") * 96 // DPI  # a PNG file states its width at byte 16
    content = base64.b64encode(png).decode("ascii")
    image = f'<img alt="{escape(alternative)}" width="{width}" src="data:image/png;base64,{content}">'
    return Picture(image, alternative)


def page_html(page: Document) -> str:
    """The document as one HTML file."""
    loader = FileSystemLoader(TEMPLATES)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    sections = [*page.sections, *filter(None, (page.answer, page.beside))]
    pictures = [block.svg for part in sections for block in part.blocks if isinstance(block, Picture)]
    scripted = any("data-panels=" in svg or "<animate " in svg for svg in pictures)
    script = loader.get_source(environment, "figures.js")[0] if scripted else ""
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    # The files that were read, in a few words: their names without folders, those of the first four
    names = [] if page.provenance is None else [Path(file.name).name for file in page.provenance.files]
    rest = len(names) - 4
    sources = joined(names if rest <= 0 else [*names[:4], counted(rest, "other file")]) if names else ""
    text = environment.get_template("report.html").render(
        page=page,
        explanations=[(term, EXPLANATIONS[term]) for term in page.terms],
        sources=sources,
        # neighbouring blocks of one kind: pictures stand side by side
        grouped=lambda blocks: groupby(blocks, key=lambda block: type(block).__name__),
        inline=inline,
        rows=_rows,
        with_code=with_code,
        allowed=allowed,
        script=Markup(script),
    )
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
    return [
        [
            (cell.replace("± ", "±\N{NO-BREAK SPACE}"), column.justify)
            for cell, column in zip(row, columns, strict=True)
        ]
        for row in zip(*(column.cells for column in columns), strict=True)
    ]
