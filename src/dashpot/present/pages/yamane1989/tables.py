"""The reproduction of Yamane (1989) as tables of text, for a terminal and for a page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from rich import box
from rich.markup import escape
from rich.table import Table

from dashpot.reproduce.yamane1989.reproduction import Reproduction
from dashpot.reproduce.yamane1989.tables import EigenvalueEntry, PrintedColumn, TableEntry

KINDS = {"relative": "noise in proportion to the amplitude", "constant": "noise of constant size"}
NARROW = 10  # headings up to this width stand beside the first row of their group


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
