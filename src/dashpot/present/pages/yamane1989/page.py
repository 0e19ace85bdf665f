"""The reproduction of Yamane (1989) to look at: on a terminal, as PNG figures, as one self-contained HTML page."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from dashpot.io.atomic import write_bytes, write_text
from dashpot.io.words import joined
from dashpot.present.figures import study as draw
from dashpot.present.figures.style import DPI, method_colour, png
from dashpot.present.pages.page import Page, Provenance, inline, with_code
from dashpot.present.pages.report import true_rig_picture
from dashpot.present.text.numbers import short
from dashpot.reproduce.yamane1989.reproduction import (
    FIGURE2_PARAMETERS,
    FIGURE3_PARAMETERS,
    Efficiency,
    EigenvalueEntry,
    ErrorCurve,
    FewerUnknowns,
    FigureData,
    IntervalCoverage,
    LeastSquaresBias,
    Luck,
    OneDraw,
    PaperOrder,
    PrintedAmongDraws,
    PrintedColumn,
    Rank,
    Reproduction,
    SamplesForOnePerCent,
    TableEntry,
)
from dashpot.reproduce.yamane1989.rig import true_rig

# The reproduction of Yamane (1989) as tables of text, for a terminal and for a page.


KINDS = {"relative": "noise in proportion to the amplitude", "constant": "noise of constant size"}


@dataclass(frozen=True)
class TextTable:
    """A table as text: rows belong to groups, each with a heading ("" for none)."""

    title: str
    note: str
    header: tuple[str, ...]
    groups: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]


def text_tables(reproduction: Reproduction) -> tuple[TextTable, ...]:
    """All tables of the reproduction."""
    return (
        _table1(reproduction.eigenvalues),
        _printed_table(
            reproduction.table2,
            "Table 2. Noise level: least squares and instrumental variables",
            "CASE-3, 1,400 samples; relative errors in %.",
            ("ls", "iv"),
        ),
        _printed_table(
            reproduction.table3,
            "Table 3. Six unknowns and four",
            "CASE-3, 10 %, 1,400 samples; relative errors in %. In the second half c1 and c2 are known as well.",
            ("iv",),
        ),
        _printed_table(
            reproduction.table4,
            "Table 4. Input frequencies",
            "10 %, 56 samples a frequency; relative errors in %.",
            ("iv",),
        ),
        _eigenvalue_table(reproduction.identified_eigenvalues),
        _ranking_table(reproduction),
    )


LEGEND = (
    "mean and ± (standard deviation) are those of the draws; at: share of the draws below the printed value, %; "
    "z: distance of the printed value from the mean in standard deviations; rms: root mean square error over the "
    "parameters, and the share of draws where it is smaller than that of the printed values."
)


def _printed_table(
    columns: Sequence[PrintedColumn], title: str, note: str, methods: Sequence[str]
) -> TextTable:
    header = ["", ""]
    for name in methods:
        header += [f"{name} printed", "mean", "±", "at", "z"]
    groups = []
    for heading in dict.fromkeys(column.title for column in columns):
        by_method = {column.method: column for column in columns if column.title == heading}
        rows = []
        for j, entry in enumerate(by_method["oiv"].entries):
            cells = ["", entry.parameter]
            for name in methods:
                cells += _cells(by_method[name].entries[j])
            rows.append((*cells, f"{entry.spread:.2f}", f"{entry.bound:.2f}"))
        cells = ["", "rms"]
        for name in methods:
            column = by_method[name]
            cells += [_signless(column.printed_rms), "", f"{column.rms_error:.2f}", _share(column.luck), ""]
        rows.append((*cells, f"{by_method['oiv'].rms:.2f}", f"{by_method['oiv'].bound:.2f}"))
        groups.append((heading, tuple(rows)))
    return TextTable(title, note, (*header, "oiv ±", "bound"), tuple(groups))


def _cells(entry: TableEntry) -> list[str]:
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


def _ranking_table(reproduction: Reproduction) -> TextTable:
    groups = []
    for kind, words in KINDS.items():
        rows = tuple(
            (
                "", rank.case, f"{rank.samples:,}", f"{rank.iv:.2f} ± {rank.iv_se:.2f}", f"{rank.place_iv}",
                f"{rank.oiv:.2f} ± {rank.oiv_se:.2f}", f"{rank.place_oiv}", f"{rank.bound:.2f}", f"{rank.ls:.1f}",
            )
            for rank in reproduction.ranking
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


def parts(table: TextTable) -> Iterable[TextTable]:
    """The table itself, or a table for each group where their headings are long."""
    # headings up to this width stand beside the first row of their group
    if all(len(heading) <= 10 for heading, _ in table.groups):
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


# The reproduction of Yamane (1989) as figures: PNG files with their captions.


ERROR = "relative error, %"
X_LABELS = {"noise": "noise level ρ, %", "samples": "samples in all"}


def images(reproduction: Reproduction) -> dict[str, tuple[str, bytes]]:
    """Captions and PNG files by name."""
    return {
        "figure2": (
            "Figure 2. Relative error against noise level (CASE-3, 1,400 samples): mean and middle 95 % of the draws.",
            png(_curves(reproduction.figure2, FIGURE2_PARAMETERS, logarithmic=False)),
        ),
        "figure3": (
            "Figure 3. Relative error against the number of samples (CASE-3, 10 %): mean and middle 95 % of the draws.",
            png(_curves(reproduction.figure3, FIGURE3_PARAMETERS, logarithmic=True)),
        ),
        "table2": (
            "Table 2 as a picture: where the paper's single draw falls among all draws.",
            png(_spreads(reproduction.table2, ("ls", "iv", "oiv"), prefix="noise level ")),
        ),
        "table4": (
            "Table 4 as a picture: where the paper's single draw falls among all draws.",
            png(_spreads(reproduction.table4, ("iv", "oiv"))),
        ),
        "ranking": (
            "The four cases under two kinds of noise; the error bars are 95 % intervals of the Monte Carlo.",
            png(_ranking(reproduction)),
        ),
    }


def _curves(data: FigureData, parameters: Sequence[str], *, logarithmic: bool) -> Figure:
    bands, marks, limits = [], [], []
    for parameter in parameters:
        curves = [curve for curve in data.curves if curve.parameter == parameter]
        bands.append([_band(curve) for curve in curves])
        printed = []
        for method in dict.fromkeys(curve.method for curve in curves):
            points = [p for p in data.points if p.parameter == parameter and p.method == method]
            if points:
                x, y = np.array([p.x for p in points]), np.array([p.error for p in points])
                printed.append(draw.Mark(f"{method}, printed", method_colour(method), x, y))
        marks.append(printed)
        low = min(float(np.nanmin(curve.low)) for curve in curves)
        high = max(float(np.nanmax(curve.high)) for curve in curves)
        room = 0.05 * (high - low)
        limits.append((low - room, high + room))
    return draw.band_panels(
        parameters,
        curves[0].x,
        bands,
        marks,
        X_LABELS[data.over],
        ERROR,
        logarithmic=logarithmic,
        limits=limits,
    )


def _band(curve: ErrorCurve) -> draw.Band:
    return draw.Band(
        curve.method, method_colour(curve.method), curve.mean, curve.low, curve.high, curve.method == "oiv"
    )


def _spreads(columns: Sequence[PrintedColumn], methods: Sequence[str], prefix: str = "") -> Figure:
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


def _spread(column: PrintedColumn) -> draw.Spread:
    def over(name: str) -> Real:
        values = [getattr(entry, name) for entry in column.entries]
        return np.array([np.nan if value is None else value for value in values], dtype=float)

    return draw.Spread(
        column.method, method_colour(column.method), over("mean"), over("low"), over("high"), over("printed")
    )


def _ranking(reproduction: Reproduction) -> Figure:
    cases = list(dict.fromkeys(rank.case for rank in reproduction.ranking))
    panels, bounds = [], []
    for kind in KINDS:
        ranks = [rank for rank in reproduction.ranking if rank.kind == kind]
        panels.append(
            [
                draw.Series(
                    name,
                    method_colour(name),
                    np.array([getattr(rank, name) for rank in ranks]),
                    np.array([getattr(rank, f"{name}_se") for rank in ranks]),
                )
                for name in ("iv", "oiv")
            ]
        )
        bounds.append(np.array([rank.bound for rank in ranks]))
    titles = [words[0].upper() + words[1:] for words in KINDS.values()]
    return draw.bar_panels(titles, cases, panels, bounds, "rms relative spread, %")


# What the reproduction of Yamane (1989) shows, in words, from the numbers of
# `reproduce.yamane1989.findings`.


WELL_KNOWN = 1.0  # standard error of a share, in points, with which nobody needs more draws


@dataclass(frozen=True)
class Statement:
    """A finding in words."""

    title: str
    text: str


def sentences(reproduction: Reproduction) -> tuple[Statement, ...]:
    """All findings, in the order of the paper."""
    findings = reproduction.findings
    return (
        _printed_among_draws(findings.printed_among_draws),
        _bias(findings.bias),
        _efficiency(findings.efficiency),
        _one_draw(findings.one_draw),
        _luck(findings.luck),
        _coverage(findings.coverage),
        _fewer_unknowns(findings.fewer_unknowns),
        _order(findings.order, reproduction.ranking),
        _samples(findings.samples),
    )


def paper_headline(reproduction: Reproduction) -> str:
    """Whether the paper is found again, in one sentence."""
    among = reproduction.findings.printed_among_draws
    return (
        f"{among.inside} of the paper's {among.total} printed errors are such as its methods give on its rig."
    )


def statements(reproduction: Reproduction) -> tuple[str, ...]:
    """How accurate the paper's methods are, and what its intervals are worth."""
    found = reproduction.findings
    worst = max(found.bias.worst, key=lambda each: abs(each.mean))
    ranges = [
        f"{low:.0f} to {high:.0f} % with {name}" for name, (low, high) in found.coverage.by_method.items()
    ]
    return (
        (
            f"Spread of the parameters at 10 % noise, CASE-3 (rms): {found.efficiency.iv:.1f} % with the paper's "
            f"instrumental variables, {found.efficiency.oiv:.1f} % optimally weighted; no unbiased method can do "
            f"better than {found.efficiency.bound:.1f} %. Least squares is off by up to {abs(worst.mean):.0f} % "
            f"({worst.parameter} at {worst.level:g} %)."
        ),
        f"95 % intervals hold the true value in {joined(ranges)} of the draws.",
    )


def paper_steps(reproduction: Reproduction) -> tuple[str, ...]:
    """What to do with it."""
    error = reproduction.findings.coverage.standard_error
    steps = (
        "On data of your own, take the optimally weighted form: dashpot identify RIG DATA --method oiv.",
    )
    more = f"{reproduction.draws:,} draws tell a share of 95 % to ± {error:.1f} points: take --draws 1000 to judge it."
    return steps if error <= WELL_KNOWN else (*steps, more)


def _printed_among_draws(among: PrintedAmongDraws) -> Statement:
    return Statement(
        "The paper's rig is found again",
        f"{among.inside} of the {among.total} printed errors lie within the middle 95 % of the draws (independent "
        f"values would give {0.95 * among.total:.0f}; these are not independent). Column by column, all parameters "
        f"together, a draw is farther from the mean than the paper's with a probability of {among.least_p:.2g} to "
        f"{among.largest_p:.2g}: nothing speaks against the rig and the noise assumed here.",
    )


def _bias(bias: LeastSquaresBias) -> Statement:
    parts = [
        f"at {worst.level:g} % it puts {worst.parameter} off by {signed(worst.mean, 1)} % on average, "
        f"{abs(worst.mean) / worst.spread:.0f} times its spread"
        for worst in bias.worst
    ]
    text = "; ".join(parts)
    return Statement(
        "Least squares is biased, and more samples do not help",
        f"{text[0].upper()}{text[1:]}. From 5 to 10 % the bias grows by a factor of {bias.growth:.1f}: nearly with the "
        f"square of the noise, whose power enters the normal matrix. Its 95 % intervals at 10 % hold the truth in "
        f"{bias.coverage[0]:.0f} to {bias.coverage[1]:.0f} % of the draws, depending on the parameter.",
    )


def _efficiency(efficiency: Efficiency) -> Statement:
    ratio = efficiency.iv / efficiency.bound
    least, largest = efficiency.oiv_ratios
    return Statement(
        "The paper's instrumental variables do not use the data fully",
        f"CASE-3, 10 %: rms spread of the six parameters {efficiency.iv:.2f} % with iv, {efficiency.oiv:.2f} % with "
        f"oiv, Cramér-Rao bound {efficiency.bound:.2f} %. iv stands at {ratio:.2f} × the bound: it needs "
        f"{ratio**2:.1f} × the samples that the data need. The optimally weighted form is at {least:.3f} to "
        f"{largest:.3f} × the bound in the four cases.",
    )


def _one_draw(draw: OneDraw) -> Statement:
    return Statement(
        "Table 2 shows one noise draw four times",
        f"The printed iv errors at 5, 10 and 20 %, divided by the level, agree within {draw.disagreement:.0f} % "
        f"(correlation of any two columns at least {draw.correlation:.4f}), where a draw at 20 % has a spread of "
        f"{draw.spread:.1f} %. The same random numbers were scaled to each level: the table's four levels are one "
        "piece of evidence.",
    )


def _luck(luck: Luck) -> Statement:
    return Statement(
        "The paper's draw was a lucky one",
        f"Its iv errors at CASE-3, 10 % have an rms of {luck.rms:.2f} %; {luck.as_good:.1f} % of the draws are as "
        f"good, the typical one has {luck.spread:.1f} %. That all six parameters stay within about 2 % at a noise "
        f"level of 20 % (section 3.1; printed maximum {luck.largest:.2f} %) happens in {luck.within['iv']:.1f} % of "
        f"the draws with iv and in {luck.within['oiv']:.1f} % with oiv.",
    )


def _coverage(coverage: IntervalCoverage) -> Statement:
    ranges = [f"{low:.1f} to {high:.1f} % with {name}" for name, (low, high) in coverage.by_method.items()]
    return Statement(
        "The intervals hold" if coverage.holds else "Some intervals do not hold",
        f"95 % intervals hold the true value, over the four cases and six parameters, in {joined(ranges)} of "
        f"{coverage.draws:,} draws (standard error of each figure {coverage.standard_error:.1f} points).",
    )


def _fewer_unknowns(fewer: FewerUnknowns) -> Statement:
    def changes(numbers: Mapping[str, tuple[float, float]]) -> str:
        return ", ".join(f"{name} {six:.2f} → {four:.2f} %" for name, (six, four) in numbers.items())

    count, worse = len(fewer.spread), fewer.worse
    on_average = f", the draws on average are for {joined(worse)}" if worse else ""
    return Statement(
        f"With c1 and c2 known, iv gains on {count - len(worse)} of {count} parameters",
        f"Spread of iv, 6 unknowns → 4: {changes(fewer.spread)}. Bound: {changes(fewer.bound)}. Table 3 finds the "
        f"accuracy better on the whole; its single draw was worse for {joined(fewer.worse_printed) or 'none'}"
        f"{on_average}. Knowing more cannot raise the bound, but it can spoil an estimator that does not weigh its "
        "equations.",
    )


def _order(order: PaperOrder, ranking: Sequence[Rank]) -> Statement:
    parts = []
    for kind, words in KINDS.items():
        for name in ("iv", "oiv"):
            ranks = [rank for rank in ranking if rank.kind == kind]
            spread = {rank.case[-1]: rank.iv if name == "iv" else rank.oiv for rank in ranks}
            best_first = " < ".join(
                f"{case} ({spread[case]:.2f} %)" for case in sorted(spread, key=spread.__getitem__)
            )
            parts.append(f"{words[0].upper()}{words[1:]}, {name}: {best_first}")
    survives = order.kept["relative"]
    return Statement(
        f"The paper's order of its cases {'survives' if survives else 'does not survive'}",
        f"Rms spread by case, best first. {'. '.join(parts)}. The paper ranks CASE-3 before CASE-2 before CASE-1 from "
        f"one draw each; under its own noise the true order of iv is {'the same' if survives else 'another'}, and "
        f"single draws come in the paper's order {order.by_chance:.0f} % of the time (17 % were all three alike). With "
        f"noise of constant size the paper's order {'holds' if order.kept['constant'] else 'does not hold either'}.",
    )


def _samples(samples: SamplesForOnePerCent) -> Statement:
    return Statement(
        f"{samples.samples:,} samples are {'' if samples.enough else 'not '}enough for 1 %",
        f"That all six parameters are within about 1 % at {samples.samples:,} samples (section 3.3) happens in "
        f"{samples.within:.1f} % of the draws with iv. An rms spread of 1 % takes about {samples.needed['iv']:,.0f} "
        f"samples with iv and {samples.needed['oiv']:,.0f} with oiv.",
    )


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
    corrections = (
        f"{row['where']}: {row['printed']} is read as {row['read']}" for row in reproduction.corrections
    )
    console.print("Corrections of the print: " + "; ".join(corrections) + ".", markup=False, style="dim")


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
        "Yamane (1989), reproduced", "", "open", paper_headline(reproduction), statements(reproduction),
        drawing=drawing, steps=paper_steps(reproduction), provenance=provenance,
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
