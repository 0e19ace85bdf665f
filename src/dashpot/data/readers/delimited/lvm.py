"""LabVIEW measurement files (.lvm, often saved as .txt): a header, then a column of time and one for each channel.

    LabVIEW Measurement … ***End_of_Header*** … Channels 2 … ***End_of_Header***
    X_Value    Acceleration (Trigger)    Force (Trigger)    Comment

A file may hold several segments, each with a header of its own.  The column X_Value comes under the name time_s; where
the file leaves it empty (X_Columns No), the header says its start and step (X0, Delta_X).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from dashpot.data.readers.columns import LONGEST, TIME
from dashpot.data.readers.datafile import LARGE, SUBSTITUTED, DataFile, open_file, whole_lines
from dashpot.data.readers.delimited.table import Table, Text, table_of, text_of
from dashpot.errors import DataError
from dashpot.io.words import shown

SHORTEST = 1e-15  # s, between two samples
TITLE, FIRST, COMMENT = b"LabVIEW Measurement", "X_Value", "Comment"
_END = re.compile(rb"^\*\*\*End_of_Header\*\*\*[^\n]*\n", re.MULTILINE)
_NO_TIMES = re.compile(rb"^X_Columns[^\w\n]+No\b", re.MULTILINE)
_HEAD = re.compile(rb"^(LabVIEW Measurement|Channels)\b", re.MULTILINE)  # of the file, of a segment


@dataclass(frozen=True)
class LabViewReader:
    """LabVIEW measurement files."""

    format: str = "LabVIEW measurement"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first row says so."""
        return file.head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(TITLE)

    def parts(self, file: DataFile) -> Iterator[Table]:
        """The segments.  Times are those written where they are, not multiples of the rounded Delta_X of the header.

        Raises DataError where there is no column of time, or another one for each channel, or another step.
        """
        data = file.contents
        ends = [match.end() for match in _END.finditer(data)]
        no_times = bool(ends) and _NO_TIMES.search(data, 0, ends[0]) is not None
        heads = [i for i, end in enumerate(ends) if data[end : end + len(FIRST)] == FIRST.encode()]
        if not heads:  # what is missing is said
            yield _segment(bytes(data[:LARGE]), file.name, 0, ())
        counted = above = 0
        for number, i in enumerate(heads, start=1):
            end = ends[i]
            next_head = _HEAD.search(data, end)
            source = file.name if len(heads) == 1 else f"{file.name} (segment {number})"
            above += sum(lines.count(b"\n") for lines in whole_lines(data, counted, end))
            counted = end
            header = text_of(data[ends[i - 1] if i else 0 : end])
            units = tuple(unit or None for unit in _listed(header, "Y_Unit_Label"))
            clock = _clock(header, source) if no_times else None
            without = no_times and clock is None
            stop = next_head.start() if next_head else len(data)
            segment = _segment_between(file, end, stop, source, above, units)
            names = ("", *segment.header[1:]) if without else segment.header
            yield replace(segment, clock=clock, header=names)


def open_lvm(path: str | os.PathLike[str], names: Mapping[str, str] | None = None) -> Table:
    """The samples of a file of one segment; `names` renames its columns.

    Raises DataError as LabViewReader.parts, and where there are several segments or a column is missing.
    """
    file = open_file(path)
    tables = list(LabViewReader().parts(file))
    if len(tables) > 1:
        cure = "save each as a file of its own (one header)"
        raise DataError("the file holds several segments", file.name, cure)
    return tables[0].renamed(names or {})


def _listed(header: str, label: str) -> list[str]:
    """What the header of a segment lists for its channels under a label; nothing where it has none."""
    for row in header.splitlines():
        name, *cells = row.split("\t")
        if name == label:
            return [cell.strip() for cell in cells]
    return []


def _clock(header: str, source: str) -> tuple[float, float] | None:
    """Start and step of the times of a segment, s; None where it does not say them.

    Raises DataError where they are no numbers or cannot be those of times, or others for each channel.
    """
    start, step = (
        {cell.replace(",", ".") for cell in _listed(header, label) if cell} for label in ("X0", "Delta_X")
    )
    if not step:
        return None
    if len(start) > 1 or len(step) > 1:
        cure = "save those of one sampling rate (Delta_X) and one start (X0) as a file"
        raise DataError("its channels have clocks of their own", source, cure)
    try:
        first, between = float(next(iter(start), "0")), float(next(iter(step)))
    except ValueError:
        raise DataError("X0 or Delta_X is not a number", source, "correct the header") from None
    if not (math.isfinite(first) and SHORTEST < between < LONGEST):
        what = f"X0 is {first:g} and Delta_X {between:g}, from which no times follow (X_Columns No)"
        raise DataError(what, source, "set Delta_X in the header to the time between two samples, s")
    return first, between


def _rows_alone(data: Text, start: int, end: int) -> Iterator[bytes]:
    """A segment in pieces, without comments: its header row, which may still name them, and its rows."""
    head_end = data.find(b"\n", start, end) + 1 or end
    header = data[start:head_end]
    yield header
    names = header.decode("utf-8", errors="replace").rstrip("\r\n").split("\t")
    if names[-1] != COMMENT:
        yield from whole_lines(data, head_end, end)
    else:
        yield from _without_comments(data, head_end, end, "\t", len(names) - 1)


def _segment_between(
    file: DataFile, end: int, stop: int, source: str, above: int, units: tuple[str | None, ...]
) -> Table:
    """The segment whose header ends at byte `end`, up to byte `stop`; of a large file as a part of that file."""
    data = file.contents
    if isinstance(data, bytes):
        return _segment(data[end:stop], source, above, units)
    part = file.rewritten(_rows_alone(data, end, stop))
    return replace(_segment(part.contents, source, above, units), file=part)


def _segment(data: Text, source: str, above: int, units: tuple[str | None, ...]) -> Table:
    """One segment: `above` rows of the file stand above its bytes."""
    table = table_of(data, source, FIRST)
    table = replace(table, first_row=table.first_row + above)
    body = table.body
    if table.header.count(FIRST) > 1:
        cure = "save it with one column of time (X_Columns One)"
        raise DataError("there is a column of time for each channel", shown(source, 200), cure)
    width = len(table.header)
    if table.header[-1] == COMMENT:  # filled in few rows, or none, and left away in the others
        width -= 1
        if isinstance(data, bytes):
            held, start = table.whole
            body = memoryview(b"".join(_without_comments(held, start, len(held), table.delimiter, width)))
    header = (TIME, *table.header[1:width])
    of_columns = (None, *units[: width - 1], *[None] * (width - 1 - len(units)))
    return replace(table, header=header, units=of_columns, body=body)


def _without_comments(data: Text, start: int, end: int, delimiter: str, width: int) -> Iterator[bytes]:
    """The first `width` cells of each row, in pieces."""
    separator = re.escape(delimiter.encode())
    cell = rb"[^\r\n" + separator + rb"]*"
    row = re.compile(
        rb"^(" + cell + (separator + cell) * (width - 1) + rb")" + separator + rb"[^\r\n]*", re.MULTILINE
    )
    for lines in whole_lines(data, start, end, SUBSTITUTED):
        yield row.sub(rb"\1", lines)
