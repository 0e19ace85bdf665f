"""Long records in pieces: a file is read some rows at a time, also while it grows, and cut into windows of time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.channel import Channel
from dashpot.data.conditioning.clock import FEWEST, GAP
from dashpot.data.readers.arrow_files import parquet_pieces
from dashpot.data.readers.columns import Columns, is_timestamp, time_column
from dashpot.data.readers.datafile import HEAD, DataFile, open_file
from dashpot.data.readers.interpretation import interpret_parts
from dashpot.data.readers.records import Circumstances
from dashpot.data.readers.registry import reader_of
from dashpot.data.readers.text import TextTable, open_table
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.ledger import noted

PIECE = 1 << 23  # bytes of text that are read at a time
LOOK = 1.0  # s between looks at a file that grows


def records_in_pieces(
    path: str | os.PathLike[str],
    channels: Sequence[Channel],
    *,
    follow: float | None = None,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[Record]:
    """The continuous record of a file, some rows at a time where it is text or Parquet, else whole.

    follow  s: text is read on as it grows, until it has not for so long

    Raises DataError as `read`; for a table of amplitudes and for stepped sine, which are no continuous record; and
    for a file that cannot be followed.
    """
    file = open_file(path)
    reader = reader_of(file)
    parts: Iterator[Iterable[Columns]]
    table = None
    if reader.format == "text" and file.path == file.given:
        held = file.head[: file.head.rfind(b"\n") + 1]
        table = open_table(replace(file, held=held)) if held.strip() else None
        if table is not None and bytes(table.file.contents) != held:  # read otherwise than it stands
            table = None
    if table is not None and _in_rows(table, channels):
        parts = ([part] for part in _text_pieces(file, table, follow, wait))
    elif follow is not None:
        cure = "follow a text file (CSV) with times in seconds, not packed"
        raise DataError("this file cannot be followed as it grows", file.name, cure)
    elif reader.format == "Parquet":
        parts = ([part] for part in parquet_pieces(file))
    else:
        parts = iter([reader.parts(file)])
    for some in parts:
        found = interpret_parts(some, channels, Circumstances())
        if found.spectra or found.responses or not found.records:
            raise DataError("this is not a record of samples in time", file.name, "give one")
        for record in found.records:
            if record.frequency_hz is not None:
                raise DataError("this is stepped sine, not a continuous record", file.name, "give one")
            yield replace(record, source=file.name)


def _in_rows(table: TextTable, channels: Sequence[Channel]) -> bool:
    """Whether rows can be read without those before them: times are numbers of seconds in them."""
    at = time_column(table, channels, may_lack=True)
    if at is None or table.clock is not None or ":" in table.first(at) or is_timestamp(table.first(at)):
        return False
    return table.names[at] == "time_s" or table.unit(at) is not None


def _text_pieces(
    file: DataFile, table: TextTable, follow: float | None, wait: Callable[[float], None]
) -> Iterator[TextTable]:
    """Tables of some rows each, with the header of the file; row numbers are those of the file."""
    heading = bytes(table.file.contents[: table.start])
    row = table.first_row
    for lines in _lines(file, len(heading), follow, wait):
        held = heading + lines
        part = open_table(DataFile(file.given, file.path, held[:HEAD], held=held))
        yield replace(part, first_row=row)
        row += lines.count(b"\n")


def _lines(
    file: DataFile, start: int, follow: float | None, wait: Callable[[float], None]
) -> Iterator[bytes]:
    """Whole lines behind a byte, some at a time, and what comes before the file has rested for `follow` s."""
    with Path(noted(file.path)).open("rb") as stream:
        stream.seek(start)
        rest, idle = b"", 0.0
        while True:
            more = stream.read(PIECE)
            if more:
                idle, whole = 0.0, (rest + more).rpartition(b"\n")
                rest = whole[2]
                if whole[1] and whole[0].strip():
                    yield whole[0] + whole[1]
                continue
            if follow is None or idle >= follow:
                break
            wait(LOOK)
            idle += LOOK
            if os.fstat(stream.fileno()).st_size < stream.tell():
                raise DataError("the file became shorter while it was followed", file.name, "begin again")
        if rest.strip() and follow is None:  # a last line without an end
            yield rest


def windows_of(records: Iterable[Record], seconds: float) -> Iterator[Record]:
    """Windows of that length, one after the other; none reaches over a gap, what is left at its ends is dropped.

    A rest of half a window or more is a window.  Raises DataError if a window would have too few samples.
    """
    held: Record | None = None
    latest = -np.inf
    for record in records:
        if record.time[0] <= latest:
            raise DataError(
                "the time does not increase from piece to piece", record.source, "give one record"
            )
        latest = float(record.time[-1])
        if held is None:
            held = record
        else:
            time = np.concatenate([held.time, record.time])
            held = replace(held, time=time, values=np.concatenate([held.values, record.values]))
        while held is not None:
            step = _step(held, seconds)
            gap = np.flatnonzero(np.diff(held.time) > GAP * step)
            end = int(gap[0]) + 1 if len(gap) else len(held.time)
            count = round(seconds / step)
            if end >= count:
                yield held.part(slice(0, count))
                held = _behind(held, count)
            elif len(gap):
                if 2 * end >= count:
                    yield held.part(slice(0, end))
                held = _behind(held, end)
            else:
                break
    if held is not None and 2 * len(held.time) >= round(seconds / _step(held, seconds)):
        yield held


def _step(record: Record, seconds: float) -> float:
    """The usual step of a record.  Raises DataError if windows of so many seconds hold too few samples."""
    step = float(np.median(np.diff(record.time[:1001]))) if len(record.time) > 1 else seconds
    if len(record.time) > 1 and seconds < FEWEST * step:
        cure = (
            f"windows of {FEWEST * step:.3g} s have the {FEWEST} samples that are the fewest; take many more"
        )
        raise DataError(f"windows of {seconds:g} s at {1 / step:.4g} Hz are too short", record.source, cure)
    return step


def _behind(record: Record, count: int) -> Record | None:
    """What is left of a record, None where nothing is; a copy, that the rest may be forgotten."""
    if count >= len(record.time):
        return None
    rest = record.part(slice(count, None))
    return replace(rest, time=rest.time.copy(), values=rest.values.copy())
