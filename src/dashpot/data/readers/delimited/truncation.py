"""Whether the last number of a text file was cut off."""

from __future__ import annotations

import re
from dataclasses import replace

from dashpot.data.readers.delimited.table import Table
from dashpot.errors import DataError
from dashpot.io.words import shown
from dashpot.notices import Notice


def with_checked_end(table: Table) -> Table:
    """The table, whose last row, where it has no line end, may have been cut off within its last number.

    Raises DataError where that shows.
    """
    if bytes(table.body[-1:]) == b"\n":
        return table
    tail = bytes(table.body[-(1 << 16) :]).decode("utf-8", errors="replace").splitlines()
    rows = [line for line in tail if line.strip()]
    rows = rows[1:] if len(table.body) > 1 << 16 else rows
    if len(rows) < 2:
        return table
    *before, last = (line.rpartition(table.delimiter)[2].strip() for line in rows[-50:])
    if rows[-1].count(table.delimiter) == len(table.header) - 1 and _looks_cut(last, before):
        raise DataError(
            f'the last number, "{shown(last)}", is shorter than those above and has no line end: the file was cut off',
            f"{table.source}:{table.row(sum(1 for _ in table.rows()) - 1)}",
            "copy it again, or take the last row out",
        )
    text = f"{table.source}: the last row has no line end; if the file was cut off, its last number is wrong"
    return replace(table, notes=(*table.notes, Notice("no_line_end", text, (table.source,))))


def _looks_cut(last: str, before: list[str]) -> bool:
    """Shorter than numbers of one width, or by four digits than any; or without the exponent of the others."""
    shortest = min(len(cell) for cell in before)
    alike = len(before) >= 3 and all(len(cell) == shortest for cell in before)
    if len(last) < shortest - (0 if alike else 3):
        return True
    powers = [re.search(r"[eE][+-]?(\d*)$", cell) for cell in before]
    power = re.search(r"[eE][+-]?(\d*)$", last)
    digits = [len(match[1]) for match in powers if match]
    if digits and power and len(power[1]) < min(digits):
        return True
    if len(digits) == len(before) >= 3 and not power:
        return True
    return last.endswith((".", ",")) and not any(cell.endswith((".", ",")) for cell in before)
