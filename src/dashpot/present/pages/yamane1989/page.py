"""The reproduction of Yamane (1989) to look at: on a terminal, as PNG figures, as one self-contained HTML page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from rich.console import Console

from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes, write_text
from dashpot.present.figures.style import DPI
from dashpot.present.pages.page import Page, Provenance, inline, with_code
from dashpot.present.pages.report import true_rig_picture
from dashpot.present.pages.yamane1989.figures import images
from dashpot.present.pages.yamane1989.findings import headline, next_steps, sentences, statements
from dashpot.present.pages.yamane1989.tables import LEGEND, parts, rich_table, text_tables
from dashpot.present.text.numbers import short
from dashpot.reproduce.yamane1989.reproduction import Reproduction
from dashpot.reproduce.yamane1989.rig import true_rig

TEMPLATES = Path(__file__).parents[2] / "templates"


def show_reproduction(reproduction: Reproduction, console: Console) -> None:
    """Tables and findings to a terminal."""
    console.print(
        f"[bold]Yamane (1989)[/bold], {reproduction.draws:,} draws a point, seed {reproduction.seed}",
        markup=True,
    )
    console.print(LEGEND, markup=False, style="dim")
    for table in text_tables(reproduction):
        console.print()
        for part in parts(table):
            console.print(rich_table(part))
        if table.note:
            console.print(table.note, markup=False, style="dim")
    console.print()
    console.print("What it shows", style="bold")
    for finding in sentences(reproduction):
        console.print()
        console.print(f"{finding.title}.", style="bold", markup=False)
        console.print(finding.text, markup=False)
    console.print()
    console.print(
        "Corrections of the print: " + "; ".join(_corrections(reproduction)) + ".", markup=False, style="dim"
    )


def _corrections(reproduction: Reproduction) -> Iterable[str]:
    return (f"{row['where']}: {row['printed']} is read as {row['read']}" for row in reproduction.corrections)


def write_reproduction(
    reproduction: Reproduction,
    report: str | Path | None = None,
    figures: str | Path | None = None,
    *,
    provenance: Provenance | None = None,
    write: Callable[[str, str], None] = write_text,
) -> list[str]:
    """Write the HTML report and the PNG figures (into the folder `figures`, made if missing); what was written.

    `write` takes the name and the HTML of the report.

    Raises DataError where a file cannot be written.
    """
    if report is None and figures is None:
        return []
    drawn = images(reproduction)
    written = []
    if figures is not None:
        folder = Path(figures)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(
                f"the folder cannot be made ({error.strerror or error})", str(folder), "name another one"
            ) from None
        for name, (_, content) in drawn.items():
            write_bytes(folder / f"{name}.png", content)
            written.append(str(folder / f"{name}.png"))
    if report is not None:
        write(str(report), page(reproduction, drawn, provenance))
        written.append(str(report))
    return written


def page(
    reproduction: Reproduction, drawn: Mapping[str, tuple[str, bytes]], provenance: Provenance | None = None
) -> str:
    """The HTML page with the figures in it."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # A PNG file states its width at byte 16.
    embedded = [
        (
            caption,
            int.from_bytes(content[16:20], "big") * 96 // DPI,
            base64.b64encode(content).decode("ascii"),
        )
        for caption, content in drawn.values()
    ]
    rig = true_rig()
    theta = np.array([rig.values[unknown.name] for unknown in rig.model.unknowns])
    drawing = true_rig_picture(rig.model, theta, rig.channels)
    assert drawing is not None  # two masses
    content = Page(
        "Yamane (1989), reproduced", "", "open", headline(reproduction), statements(reproduction),
        drawing=drawing, steps=next_steps(reproduction), provenance=provenance,
    )  # fmt: skip
    return environment.get_template("yamane1989.html").render(
        page=content,
        inline=inline,
        with_code=with_code,
        reproduction=reproduction,
        findings=sentences(reproduction),
        tables=text_tables(reproduction),
        images=embedded,
        legend=LEGEND,
        corrections=reproduction.corrections,
        short=short,
    )
