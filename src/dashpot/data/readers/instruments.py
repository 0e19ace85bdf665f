"""Text files of instruments: LabVIEW measurements (.lvm, often saved as .txt) and Xsens DOT inertial sensors.

LabVIEW: a header, then a column of time and one for each channel.

    LabVIEW Measurement … ***End_of_Header*** … Channels 2 … ***End_of_Header***
    X_Value    Acceleration (Trigger)    Force (Trigger)    Comment

A file may hold several segments, each with a header of its own.  The column X_Value comes under the name time_s; where
the file leaves it empty (X_Columns No), the header says its start and step (X0, Delta_X).

Xsens: one CSV file for each sensor.  Some rows about the device, then the columns PacketCounter, SampleTimeFine (µs,
32 bits), Euler_X …, Acc_X … (m/s²), Gyr_X … (°/s).  The first row may hold zeros instead of a measurement.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.data.readers.arrays import ArrayColumns, Streamed
from dashpot.data.readers.columns import LONGEST, TIME
from dashpot.data.readers.datafile import SUBSTITUTED, DataFile, whole_lines
from dashpot.data.readers.text import LOOKED_AT, Text, TextTable, open_table, text_of
from dashpot.errors import DataError
from dashpot.notices import Notice

FIRST, COMMENT = "X_Value", "Comment"
_END = re.compile(rb"^\*\*\*End_of_Header\*\*\*[^\n]*\n", re.MULTILINE)
_NO_TIMES = re.compile(rb"^X_Columns[^\w\n]+No\b", re.MULTILINE)
_HEAD = re.compile(rb"^(LabVIEW Measurement|Channels)\b", re.MULTILINE)  # of the file, of a segment


def is_labview(file: DataFile) -> bool:
    """The first row says so."""
    return file.head.lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"LabVIEW Measurement")


def read_labview(file: DataFile) -> Iterator[TextTable]:
    """The segments.  Times are those written where they are, not multiples of the rounded Delta_X of the header.

    Raises DataError if there is no column of time, or another one for each channel, or another step.
    """
    data = file.contents
    ends = [match.end() for match in _END.finditer(data)]
    no_times = bool(ends) and _NO_TIMES.search(data, 0, ends[0]) is not None
    heads = [i for i, end in enumerate(ends) if data[end : end + len(FIRST)] == FIRST.encode()]
    if not heads:  # what is missing is said
        yield open_table(file.rewritten([data[:LOOKED_AT]]), FIRST)
    counted = above = 0
    for number, i in enumerate(heads, start=1):
        end = ends[i]
        next_head = _HEAD.search(data, end)
        source = file.name if len(heads) == 1 else f"{file.name} (segment {number})"
        above += sum(lines.count(b"\n") for lines in whole_lines(data, counted, end))
        counted = end
        rows = _without_comments(data, end, next_head.start() if next_head else len(data))
        table = open_table(file.rewritten(rows), FIRST, source)
        if table.header.count(FIRST) > 1:
            cure = "save it with one column of time (X_Columns One)"
            raise DataError("there is a column of time for each channel", source, cure)
        header = text_of(data[ends[i - 1] if i else 0 : end])
        units = [unit or None for unit in _listed(header, "Y_Unit_Label")]
        channels = len(table.header) - 1
        clock = _clock(header, source) if no_times else None
        yield replace(
            table,
            header=("" if no_times and clock is None else TIME, *table.header[1:]),
            units=(None, *(units + [None] * channels)[:channels]),
            first_row=table.first_row + above,
            clock=clock,
        )


def _listed(header: str, label: str) -> list[str]:
    """What the header of a segment lists for its channels under a label; nothing where it has none."""
    for row in header.splitlines():
        name, *cells = row.split("\t")
        if name == label:
            return [cell.strip() for cell in cells]
    return []


def _clock(header: str, source: str) -> tuple[float, float] | None:
    """Start and step of the times of a segment, s; None if it does not say them.

    Raises DataError if they are no numbers or cannot be those of times, or others for each channel.
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
    if not (math.isfinite(first) and 1e-15 < between < LONGEST):
        what = f"X0 is {first:g} and Delta_X {between:g}, from which no times follow (X_Columns No)"
        raise DataError(what, source, "set Delta_X in the header to the time between two samples, s")
    return first, between


def _without_comments(data: Text, start: int, end: int) -> Iterator[bytes]:
    """A segment from its header row on, in pieces, without the last column where it is one of comments.

    It is filled in few rows, or none, and left away in the others.
    """
    head_end = data.find(b"\n", start, end) + 1 or end
    names = re.fullmatch(rb"(.*?)([\t,])" + COMMENT.encode() + rb"([ \r\n]*)", data[start:head_end])
    if names is None:
        yield from whole_lines(data, start, end)
        return
    yield names[1] + names[3]
    cell = rb"[^\r\n" + names[2] + rb"]*"
    width = names[1].count(names[2])
    row = re.compile(rb"(?m)^(" + cell + (names[2] + cell) * width + rb")" + names[2] + rb"[^\r\n]*")
    for lines in whole_lines(data, head_end, end, SUBSTITUTED):
        yield row.sub(rb"\1", lines)


COUNTER, CLOCK = "PacketCounter", "SampleTimeFine"
AXES = ("Acc_X", "Acc_Y", "Acc_Z")
UNITS = {"Acc_": "m/s²", "FreeAcc_": "m/s²", "Gyr_": "deg/s", "Euler_": "deg"}  # by the beginning of the name
WRAP = 1 << 32  # µs, the clock starts again after 71.6 minutes


def is_xsens(file: DataFile) -> bool:
    """Its columns are there."""
    return COUNTER.encode() in file.head and CLOCK.encode() in file.head


def read_xsens(file: DataFile) -> Iterator[ArrayColumns]:
    """What the sensor measured: `time_s` is its own clock, which synchronised sensors share."""
    table = open_table(file, COUNTER)
    # Clock in µs of all rows, the first row that is a measurement, notes
    counter_at, clock_at = table.need(COUNTER), table.need(CLOCK)
    axes = [table.need(name) for name in AXES]
    numbers = table.numbers(list(dict.fromkeys([counter_at, clock_at, *axes])))
    clock = numbers[clock_at]
    wrong = (clock != np.round(clock)) | (clock < 0) | (clock >= WRAP)
    table.refuse(clock_at, wrong, "{:g} is not a time in whole µs", "export the file again", clock)
    again = np.concatenate([[0], np.cumsum(np.diff(clock) < -WRAP / 2)]).astype(np.int64)
    ticks = clock.astype(np.int64) + WRAP * again
    back = np.diff(ticks, prepend=-1) <= 0
    table.refuse(clock_at, back, "the time does not increase", "sort the rows or split the file")
    silent = np.all([numbers[at] == 0 for at in axes], axis=0)
    first = int(np.argmin(silent)) if not np.all(silent) else len(silent)
    if len(ticks) - first < 2:
        raise DataError("there are no measurements", table.source, "give a file with more samples")
    notes = list(table.notes)
    lost = int(np.sum(np.diff(numbers[counter_at][first:]) - 1))
    if lost > 0:
        text = f"{table.source}: {lost} packets are missing; the others keep their true times"
        notes.append(Notice("packets_lost", text, (table.source,)))
    rows = len(ticks) - first
    columns: list[Any] = [ticks[first:] * 1e-6]
    names, units = [TIME], ["s"]
    for i, name in enumerate(table.header):
        unit = next((unit for prefix, unit in UNITS.items() if name.startswith(prefix)), None)
        if unit is not None:
            names.append(name)
            units.append(unit)
            columns.append(Streamed(rows, partial(_from, table, i, first)))
    yield ArrayColumns(file.name, tuple(names), tuple(units), tuple(notes), rows, tuple(columns))


def _from(table: TextTable, column: int, first: int) -> Iterator[Real]:
    yield table.numbers([column])[column][first:]
