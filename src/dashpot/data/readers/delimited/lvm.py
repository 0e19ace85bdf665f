"""LabVIEW measurement files (.lvm, often saved as .txt): a header, then a column of time and one for each channel.

    LabVIEW Measurement … ***End_of_Header*** … Channels 2 … ***End_of_Header***
    X_Value    Acceleration (Trigger)    Force (Trigger)    Comment

`open_lvm` gives the table that stepped-sine readers take, the column X_Value under the name time_s.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace

from dashpot.data.readers.delimited.stepped_sine import TIME
from dashpot.data.readers.delimited.table import Table, open_table
from dashpot.errors import DataError

FIRST, COMMENT = "X_Value", "Comment"
_END = b"***End_of_Header***"


def is_lvm(table: Table) -> bool:
    """The first row says so."""
    return table.header[0] == "LabVIEW Measurement"


def open_lvm(path: str | os.PathLike[str], names: Mapping[str, str] | None = None) -> Table:
    """The samples of a LabVIEW measurement file; `names` renames its columns.

    Times are those written, not multiples of the rounded Delta_X of the header.  Raises DataError where the file is
    none, holds several segments, has no column of time, or has another one for each channel.
    """
    table = open_table(path, FIRST)
    body = bytes(table.body)
    if _END in body:
        raise DataError(
            "the file holds several segments", table.source, "save each as a file of its own (one header)"
        )
    if table.header.count(FIRST) > 1:
        cure = "save it with one column of time (X_Columns One)"
        raise DataError("there is a column of time for each channel", table.source, cure)
    width = len(table.header)
    if table.header[-1] == COMMENT:  # filled in few rows, or none, and left away in the others
        width -= 1
        body = _without_comments(body, table.delimiter, width)
    renamed = {FIRST: TIME, **(names or {})}
    header = tuple(renamed.get(name, name) for name in table.header[:width])
    for old in names or {}:
        if old not in table.header:
            cure = f"there are {', '.join(table.header[1:width])}"
            raise DataError(f"column {old}: missing", f"{table.source}:{table.first_row - 1}", cure)
    return replace(table, header=header, body=memoryview(body))


def _without_comments(body: bytes, delimiter: str, width: int) -> bytes:
    """The first `width` cells of each row."""
    separator = re.escape(delimiter.encode())
    cell = rb"[^\r\n" + separator + rb"]*"
    row = re.compile(
        rb"^(" + cell + (separator + cell) * (width - 1) + rb")" + separator + rb"[^\r\n]*", re.MULTILINE
    )
    return row.sub(rb"\1", body)
