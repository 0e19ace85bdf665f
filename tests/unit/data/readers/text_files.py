"""The stepped-sine recording of `written` as text in the shapes that laboratories give it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dashpot.data.record import Record
from tests.unit.data.readers.written import NAMES, long_table


def _rows(records: list[Record], mark: str, comma: bool = False) -> list[str]:
    columns = (column.tolist() for column in long_table(records).values())
    rows = [mark.join(map(repr, row)) for row in zip(*columns, strict=True)]
    return [row.replace(".", ",") for row in rows] if comma else rows


def _header(mark: str) -> str:
    return mark.join(["frequency_hz", "time_s", *NAMES])


def tabs(path: Path, records: list[Record]) -> None:
    path.write_text("\n".join([_header("\t"), *_rows(records, "\t")]) + "\n")


def bars(path: Path, records: list[Record]) -> None:
    path.write_text("\n".join([_header("|"), *_rows(records, "|")]) + "\n")


def blanks(path: Path, records: list[Record]) -> None:
    """Columns under each other, as Fortran writes them."""
    path.write_text("\n".join(["  " + _header("   "), *(f"  {row}" for row in _rows(records, "   "))]) + "\n")


def semicolons(path: Path, records: list[Record]) -> None:
    path.write_text("\n".join(["sep=;", _header(";"), *_rows(records, ";")]) + "\n")


def decimal_commas(path: Path, records: list[Record]) -> None:
    """As a German Excel saves it, lines ended as on Windows."""
    path.write_bytes(
        ("\r\n".join([_header(";"), *_rows(records, ";", comma=True)]) + "\r\n").encode("cp1252")
    )


def utf_16(path: Path, records: list[Record]) -> None:
    """As Excel saves text in Unicode: tabs, decimal commas, two bytes a letter."""
    path.write_text("\n".join([_header("\t"), *_rows(records, "\t", comma=True)]) + "\n", encoding="utf-16")


def units_in_the_header(path: Path, records: list[Record]) -> None:
    head = [
        "recorded by,somebody",
        "on,2025-03-06",
        "",
        ",".join(["frequency_hz [Hz]", "t [s]", *(f"{n} [mm]" for n in NAMES)]),
    ]
    path.write_text("\n".join([*head, *_rows(records, ",")]) + "\n")


def units_below_the_header(path: Path, records: list[Record]) -> None:
    path.write_text("\n".join([_header(","), "Hz,s,mm,mm,mm", *_rows(records, ",")]) + "\n")


def milliseconds(path: Path, records: list[Record]) -> None:
    """Times whose steps are powers of two lose nothing."""
    table = long_table(records)
    table = {
        "frequency_hz": table["frequency_hz"],
        "time [ms]": 1e3 * table["time_s"],
        **{n: table[n] for n in NAMES},
    }
    rows = zip(*(column.tolist() for column in table.values()), strict=True)
    path.write_text("\n".join([",".join(table), *(",".join(map(repr, row)) for row in rows)]) + "\n")


def lvm_segments(path: Path, records: list[Record]) -> None:
    """LabVIEW text with a segment for each dwell."""
    lines = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "X_Columns\tOne",
        "Time_Pref\tRelative",
    ]
    lines += ["***End_of_Header***\t", ""]
    for record in records:
        millimetres = np.round(record.values * 1e3 * 1024) / 1024
        lines += [
            "Channels\t4",
            "***End_of_Header***\t",
            "\t".join(["X_Value", "frequency_hz", *NAMES, "Comment"]),
        ]
        for t, row in zip(record.time.tolist(), millimetres.tolist(), strict=True):
            lines.append("\t".join(map(repr, [t, record.frequency_hz, *row])))
        lines.append("")
    path.write_text("\n".join(lines) + "\n")


TEXTS: dict[str, tuple[str, Callable[[Path, list[Record]], None]]] = {
    "tabs": (".tsv", tabs),
    "bars": (".txt", bars),
    "blanks": (".dat", blanks),
    "semicolons": (".csv", semicolons),
    "decimal commas": (".csv", decimal_commas),
    "UTF-16": (".txt", utf_16),
    "units in the header": (".csv", units_in_the_header),
    "units below the header": (".csv", units_below_the_header),
    "milliseconds": (".csv", milliseconds),
    "LVM, segments": (".lvm", lvm_segments),
}
