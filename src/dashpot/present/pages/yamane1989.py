"""The reproduction of Yamane (1989) to look at: tables for a terminal, PNG figures, one self-contained HTML page."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arrays import Real
from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes
from dashpot.present.figures import study as draw
from dashpot.present.text.numbers import short
from dashpot.reproduce.yamane1989.findings import (
    FIGURE2_PARAMETERS,
    FIGURE3_PARAMETERS,
    Column,
    Curve,
    EigenvalueEntry,
    Entry,
    Picture,
    Reproduction,
)

TEMPLATES = Path(__file__).parents[1] / "templates"
ERROR = "relative error, %"
KINDS = {"relative": "noise in proportion to the amplitude", "constant": "noise of constant size"}
NARROW = 10  # headings up to this width stand beside the first row of their group


@dataclass(frozen=True)
class TextTable:
    """A table as text: rows belong to groups, each with a heading ("" for none)."""

    title: str
    note: str
    header: tuple[str, ...]
    groups: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]


# Tables


def tables(found: Reproduction) -> tuple[TextTable, ...]:
    """All tables of the reproduction."""
    return (
        _table1(found.eigenvalues),
        _printed_table(
            found.table2,
            "Table 2. Noise level: least squares and instrumental variables",
            "CASE-3, 1,400 samples; relative errors in %.",
            ("ls", "iv"),
        ),
        _printed_table(
            found.table3,
            "Table 3. Six unknowns and four",
            "CASE-3, 10 %, 1,400 samples; relative errors in %. In the second half c1 and c2 are known as well.",
            ("iv",),
        ),
        _printed_table(
            found.table4,
            "Table 4. Input frequencies",
            "10 %, 56 samples a frequency; relative errors in %.",
            ("iv",),
        ),
        _eigenvalue_table(found.identified_eigenvalues),
        _ranking_table(found),
    )


LEGEND = (
    "mean and ± (standard deviation) are those of the draws; at: share of the draws below the printed value, %; "
    "z: distance of the printed value from the mean in standard deviations; rms: root mean square error over the "
    "parameters, and the share of draws where it is smaller than that of the printed values."
)


def _printed_table(columns: Sequence[Column], title: str, note: str, methods: Sequence[str]) -> TextTable:
    header = ["", ""]
    for name in methods:
        header += [f"{name} printed", "mean", "±", "at", "z"]
    groups = []
    for heading in dict.fromkeys(column.title for column in columns):
        own = {column.method: column for column in columns if column.title == heading}
        rows = []
        for j, entry in enumerate(own["oiv"].entries):
            cells = ["", entry.parameter]
            for name in methods:
                cells += _cells(own[name].entries[j])
            rows.append((*cells, f"{entry.spread:.2f}", f"{entry.bound:.2f}"))
        cells = ["", "rms"]
        for name in methods:
            column = own[name]
            cells += [_signless(column.printed_rms), "", f"{column.rms_error:.2f}", _share(column.luck), ""]
        rows.append((*cells, f"{own['oiv'].rms:.2f}", f"{own['oiv'].bound:.2f}"))
        groups.append((heading, tuple(rows)))
    return TextTable(title, note, (*header, "oiv ±", "bound"), tuple(groups))


def _cells(entry: Entry) -> list[str]:
    return [
        "–" if entry.printed is None else signed(entry.printed),
        signed(entry.mean),
        f"{entry.spread:.2f}",
        _share(entry.percentile),
        "" if entry.z is None else signed(entry.z, 1),
    ]


def signed(value: float, digits: int = 2) -> str:
    """A number with a minus that is one, as wide as a plus would make it."""
    text = f"{abs(value):.{digits}f}"
    return text if value >= 0 or not text.strip("0.") else f"−{text}"


def _signless(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}" if 1 <= value <= 99 else f"{value:.1f}"


def _pair(value: complex, digits: int = 3) -> str:
    return f"{signed(value.real, digits)} ± {abs(value.imag):.{digits}f}j"


def _table1(rows: Sequence[EigenvalueEntry]) -> TextTable:
    body = tuple(("", _pair(row.printed, 4), _pair(row.mean, 4)) for row in rows)
    return TextTable(
        "Table 1. Eigenvalues of the model, 1/s",
        "",
        ("", "printed", "of the rig as modelled here"),
        (("", body),),
    )


def _eigenvalue_table(rows: Sequence[EigenvalueEntry]) -> TextTable:
    groups = []
    for heading in dict.fromkeys((row.table, row.title, row.method) for row in rows):
        body = tuple(
            (
                "", _pair(row.printed), _pair(row.mean), f"{row.sd.real:.3f}", f"{row.sd.imag:.3f}",
                signed(_distance(row.printed.real - row.mean.real, row.sd.real), 1),
                signed(_distance(abs(row.printed.imag) - row.mean.imag, row.sd.imag), 1),
            )
            for row in rows
            if (row.table, row.title, row.method) == heading
        )  # fmt: skip
        groups.append((" ".join(heading[1:]), body))
    return TextTable(
        "Eigenvalues of the identified rigs, 1/s",
        "As Tables 2 and 4 print them; sd and z of the real and the imaginary part.",
        ("", "printed", "mean of the draws", "sd re", "sd im", "z re", "z im"),
        tuple(groups),
    )


def _distance(away: float, sd: float) -> float:
    return away / sd if sd > 0 else math.nan


def _ranking_table(found: Reproduction) -> TextTable:
    groups = []
    for kind, words in KINDS.items():
        rows = tuple(
            (
                "", rank.case, f"{rank.samples:,}", f"{rank.iv:.2f} ± {rank.iv_se:.2f}", f"{rank.place_iv}",
                f"{rank.oiv:.2f} ± {rank.oiv_se:.2f}", f"{rank.place_oiv}", f"{rank.bound:.2f}", f"{rank.ls:.1f}",
            )
            for rank in found.ranking
            if rank.kind == kind
        )  # fmt: skip
        groups.append((words, rows))
    return TextTable(
        "The true ranking of the cases",
        "rms over the six parameters of the relative spread, %, ± its standard error; of ls the rms error, bias "
        "included. Noise of constant size: 10 % of each channel's rms amplitude over the frequencies of CASE-3. "
        "CASE-4 has fewer samples.",
        ("", "case", "samples", "iv", "place", "oiv", "place", "bound", "ls"),
        tuple(groups),
    )


def show(found: Reproduction, console: Console) -> None:
    """Tables and findings to a terminal."""
    console.print(
        f"[bold]Yamane (1989)[/bold], {found.draws:,} draws a point, seed {found.seed}", markup=True
    )
    console.print(LEGEND, markup=False, style="dim")
    for table in tables(found):
        console.print()
        for part in _parts(table):
            console.print(rich_table(part))
        if table.note:
            console.print(table.note, markup=False, style="dim")
    console.print()
    console.print("What it shows", style="bold")
    for finding in found.findings:
        console.print()
        console.print(f"{finding.title}.", style="bold", markup=False)
        console.print(finding.text, markup=False)
    console.print()
    console.print(
        "Corrections of the print: " + "; ".join(_corrections(found)) + ".", markup=False, style="dim"
    )


def _corrections(found: Reproduction) -> Iterable[str]:
    return (f"{row['where']}: {row['printed']} is read as {row['read']}" for row in found.corrections)


def _parts(table: TextTable) -> Iterable[TextTable]:
    """The table itself, or a table for each group where their headings are long."""
    if all(len(heading) <= NARROW for heading, _ in table.groups):
        return [table]
    return [
        replace(table, title=f"{table.title}: {heading}", groups=(("", rows),))
        for heading, rows in table.groups
    ]


def rich_table(table: TextTable) -> Table:
    """A TextTable for a terminal."""
    made = Table(
        title=escape(table.title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False,
        padding=(0, 1, 0, 0),
    )  # fmt: skip
    shown = [
        k
        for k, name in enumerate(table.header)
        if name != "z" and (k or any(heading for heading, _ in table.groups))
    ]
    for k in shown:
        made.add_column(escape(table.header[k]), justify="left" if k <= 1 else "right")
    for heading, rows in table.groups:
        for k, row in enumerate(rows):
            cells = [heading if k == 0 else "", *row[1:]]
            made.add_row(*(escape(cells[column]) for column in shown))
        made.add_section()
    return made


# Figures


def pictures(found: Reproduction) -> dict[str, tuple[str, bytes]]:
    """Captions and PNG files by name."""
    return {
        "figure2": (
            "Figure 2. Relative error against noise level (CASE-3, 1,400 samples): mean and middle 95 % of the draws.",
            draw.png(_curves(found.figure2, FIGURE2_PARAMETERS, logarithmic=False)),
        ),
        "figure3": (
            "Figure 3. Relative error against the number of samples (CASE-3, 10 %): mean and middle 95 % of the draws.",
            draw.png(_curves(found.figure3, FIGURE3_PARAMETERS, logarithmic=True)),
        ),
        "table2": (
            "Table 2 as a picture: where the paper's single draw falls among all draws.",
            draw.png(_spreads(found.table2, ("ls", "iv", "oiv"), prefix="noise level ")),
        ),
        "table4": (
            "Table 4 as a picture: where the paper's single draw falls among all draws.",
            draw.png(_spreads(found.table4, ("iv", "oiv"))),
        ),
        "ranking": (
            "The four cases under two kinds of noise; the error bars are 95 % intervals of the Monte Carlo.",
            draw.png(_ranking(found)),
        ),
    }


def _curves(picture: Picture, parameters: Sequence[str], *, logarithmic: bool) -> Figure:
    bands, marks, limits = [], [], []
    for parameter in parameters:
        own = [curve for curve in picture.curves if curve.parameter == parameter]
        bands.append([_band(curve) for curve in own])
        here = []
        for method in dict.fromkeys(curve.method for curve in own):
            points = [p for p in picture.points if p.parameter == parameter and p.method == method]
            if points:
                x, y = np.array([p.x for p in points]), np.array([p.error for p in points])
                here.append(draw.Mark(f"{method}, printed", draw.colour(method), x, y))
        marks.append(here)
        limits.append(_limits(own))
    return draw.band_panels(
        parameters, own[0].x, bands, marks, picture.x_label, ERROR, logarithmic=logarithmic, limits=limits
    )


def _band(curve: Curve) -> draw.Band:
    return draw.Band(
        curve.method, draw.colour(curve.method), curve.mean, curve.low, curve.high, curve.method == "oiv"
    )


def _limits(curves: Sequence[Curve]) -> tuple[float, float]:
    low = min(float(np.nanmin(curve.low)) for curve in curves)
    high = max(float(np.nanmax(curve.high)) for curve in curves)
    room = 0.05 * (high - low)
    return low - room, high + room


def _spreads(columns: Sequence[Column], methods: Sequence[str], prefix: str = "") -> Figure:
    titles = list(dict.fromkeys(column.title for column in columns))
    rows = [entry.parameter for entry in columns[0].entries]
    panels = [
        [
            _spread(column)
            for method in methods
            for column in columns
            if column.title == title and column.method == method
        ]
        for title in titles
    ]
    return draw.spread_panels([prefix + title for title in titles], rows, panels, ERROR)


def _spread(column: Column) -> draw.Spread:
    def over(name: str) -> Real:
        values = [getattr(entry, name) for entry in column.entries]
        return np.array([np.nan if value is None else value for value in values], dtype=float)

    return draw.Spread(
        column.method, draw.colour(column.method), over("mean"), over("low"), over("high"), over("printed")
    )


def _ranking(found: Reproduction) -> Figure:
    cases = list(dict.fromkeys(rank.case for rank in found.ranking))
    panels, bounds = [], []
    for kind in KINDS:
        own = [rank for rank in found.ranking if rank.kind == kind]
        panels.append(
            [
                draw.Series(
                    name,
                    draw.colour(name),
                    np.array([getattr(rank, name) for rank in own]),
                    np.array([getattr(rank, f"{name}_se") for rank in own]),
                )
                for name in ("iv", "oiv")
            ]
        )
        bounds.append(np.array([rank.bound for rank in own]))
    titles = [words[0].upper() + words[1:] for words in KINDS.values()]
    return draw.bar_panels(titles, cases, panels, bounds, "rms relative spread, %")


# Files


def write(
    found: Reproduction, report: str | Path | None = None, figures: str | Path | None = None
) -> list[str]:
    """Write the HTML report and the PNG figures (into the folder `figures`, made if missing); what was written.

    Raises DataError where a file cannot be written.
    """
    if report is None and figures is None:
        return []
    drawn = pictures(found)
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
        write_bytes(Path(report), page(found, drawn).encode("utf-8"))
        written.append(str(report))
    return written


def page(found: Reproduction, drawn: Mapping[str, tuple[str, bytes]]) -> str:
    """The HTML page with the figures in it."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # A PNG file states its width at byte 16.
    images = [
        (
            caption,
            int.from_bytes(content[16:20], "big") * 96 // draw.DPI,
            base64.b64encode(content).decode("ascii"),
        )
        for caption, content in drawn.values()
    ]
    return environment.get_template("yamane1989.html").render(
        found=found,
        tables=tables(found),
        images=images,
        legend=LEGEND,
        corrections=found.corrections,
        short=short,
    )
