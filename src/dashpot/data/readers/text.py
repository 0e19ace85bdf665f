"""Delimited text, read and written: named columns of numbers, with the place of everything that is wrong in them.

Workbooks of Excel and OpenDocument spreadsheets are read as the text that each sheet shows would be.
"""

from __future__ import annotations

import codecs
import csv
import mmap
import os
import re
import zlib
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot.arrays import Real
from dashpot.data.readers.columns import (
    LARGEST,
    MOST_COLUMNS,
    UNNAMED,
    Columns,
    are_units,
    bare,
    columns_of_block,
    is_date,
    is_timestamp,
    is_unit,
)
from dashpot.data.readers.datafile import PIECE, SUBSTITUTED, DataFile, open_file, whole_lines
from dashpot.data.readers.guarded import damaged, guarded
from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes
from dashpot.io.ledger import noted
from dashpot.io.words import counted, listed, shown
from dashpot.notices import Notice

# Text of any encoding as UTF-8 with line feeds, without what editors and broken writes leave at its end.


Text = bytes | mmap.mmap
LOOKED_AT = (
    1 << 20
)  # bytes from which the encoding and the line ends are told, and in which the header must end
_END = b"\0\x1a"  # of a file that was laid out before it was written, or that DOS ended
_NO_WINDOWS_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")


def is_text(head: bytes) -> bool:
    """Whether bytes that begin a file are text: none but the last is zero, or they are in UTF-16."""
    written = head.rstrip(_END)
    plain = b"\0" not in written and (len(written) == len(head) or b"\n" in written or b"\r" in written)
    return plain or _wide(head) is not None


def text_of(head: bytes) -> str:
    """The text of a header, in UTF-8 or Windows-1252."""
    try:
        return head.decode("utf-8")
    except UnicodeDecodeError:
        return head.decode("cp1252", errors="replace")


def _as_utf8(file: DataFile) -> DataFile:
    """The same in UTF-8 without a mark, with line feeds.  Raises DataError if it is no text."""
    encoding = _encoding(file.contents[:LOOKED_AT], file.name)
    if encoding is not None:
        try:
            file = file.rewritten(
                text.encode() for text in codecs.iterdecode(_pieces(file.contents, 0), encoding)
            )
        except UnicodeError:
            raise DataError("the file is damaged UTF-16", file.name, "save it as UTF-8") from None
    data, end = file.contents, len(file.contents)
    start = 3 if data[:3] == codecs.BOM_UTF8 else 0
    while end > start and data[end - 1] in _END:
        block = data[max(start, end - PIECE) : end]
        end -= len(block) - len(block.rstrip(_END))
    head = data[start : min(end, LOOKED_AT)]
    if not head or re.compile(rb"\S").search(data, start, end) is None:
        raise DataError("the file is empty", file.name, "give a file with a header row and data")
    if b"\0" in head:
        raise DataError("the file is not text", file.name, "give a CSV file")
    if b"\n" not in head and b"\r" in head:
        return file.rewritten(piece.replace(b"\r", b"\n") for piece in _pieces(data, start, end))
    return file if (start, end) == (0, len(data)) else file.rewritten(_pieces(data, start, end))


def _pieces(data: Text, start: int, end: int | None = None) -> Iterator[bytes]:
    end = len(data) if end is None else end
    return (data[at : min(at + PIECE, end)] for at in range(start, end, PIECE))


def _encoding(head: bytes, source: str) -> str | None:
    """What the text is written in, None where that is UTF-8; Windows-1252 is what a µ or ² alone in it may be."""
    wide = _wide(head)
    if wide is not None:
        return wide
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError as error:
        if not _NO_WINDOWS_TEXT.search(head.rstrip(_END)):
            return "cp1252"
        row = head.count(b"\n", 0, error.start) + 1
        within = error.start - head.rfind(b"\n", 0, error.start)
        what = f"byte {within} of the row is not UTF-8"
        raise DataError(what, f"{source}:{row}", "save the file as UTF-8") from None
    return None


def _wide(data: bytes) -> str | None:
    """UTF-16, with a mark, or where every other byte of the first 8 to 64 is zero."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    begin = data[:64]
    if len(begin) >= 8 and len(begin) % 2 == 0:
        for encoding, low, high in (
            ("utf-16-le", begin[::2], begin[1::2]),
            ("utf-16-be", begin[1::2], begin[::2]),
        ):
            if not any(high) and all(low):
                return encoding
    return None


# Rows between those of numbers that are none: a header on each page, comments.  They are blanked, so that the others
# keep their places, and counted.


_MINUS = "\u2212".encode()
_COMMENT = re.compile(rb"(?m)^[ \t\f]*[#%][^\r\n]*(?=\r?$)")


def _without_stray_rows(file: DataFile, start: int, source: str) -> tuple[DataFile, tuple[Notice, ...]]:
    """The file without such rows behind byte `start`, form feeds and minus signs of typesetting; what was left out.

    Rows repeat the header where they are one of those in front of `start` in which there is a letter.
    """
    data = file.contents
    lines = map(bytes.strip, data[:start].splitlines())
    heading = [line for line in lines if re.search(rb"[A-Za-z_\x80-\xff]", line)]
    signs = (*heading[-2:], b"\f", _MINUS, b"#", b"%")
    # A byte is found ten times as fast as several, and one that numbers do not have is seldom there.
    present = {byte for byte in map(_telling, signs) if data.find(byte, start) >= 0}
    if not any(_telling(sign) in present and data.find(sign, start) >= 0 for sign in signs):
        return file, ()
    again = b"|".join(map(re.escape, heading)) or rb"(?!)"
    repeated = re.compile(rb"(?m)^[ \t\f]*(?:" + again + rb")[ \t\f]*(?=\r?$)")
    left_out: Counter[str] = Counter()
    file = file.rewritten(chain([data[:start]], _blanked(data, start, repeated, left_out)))
    words = [f"{counted(left_out['row'], 'row')} repeating the header"] if left_out["row"] else []
    words += [counted(left_out["comment"], "comment")] if left_out["comment"] else []
    return file, (Notice("stray_rows", f"{source}: left out {listed(words)}", (source,)),) if words else ()


def _telling(sign: bytes) -> bytes:
    """A byte of a text, if possible one that numbers do not have."""
    match = re.search(rb"[^\s\d.,;:|+\-eE]", sign)
    return match[0] if match else sign[:1]


def _blanked(data: Text, start: int, repeated: re.Pattern[bytes], left_out: Counter[str]) -> Iterator[bytes]:
    """The text behind `start` without stray rows, which are counted."""
    for lines in whole_lines(data, start):
        lines, rows = repeated.subn(b"", lines)
        lines, comments = _COMMENT.subn(b"", lines)
        left_out.update(row=rows, comment=comments)
        yield lines.replace(_MINUS, b"-").replace(b"\f", b"")


BLOCK = 1 << 21  # bytes that are parsed at a time; some such blocks are read ahead
COUNTED = 1 << 24  # bytes whose line ends are counted at a time


@dataclass(frozen=True)
class TextTable(Columns):
    """The text of a file behind its header row.

    start      byte at which the rows begin
    first_row  file row that begins there, counted from 1
    clock      start and step of the first column, where that is left empty for the header says its numbers
    """

    file: DataFile
    start: int
    first_row: int
    delimiter: str
    decimal: str
    clock: tuple[float, float] | None = None

    @property
    def heading(self) -> str:
        """The file and its header row."""
        return f"{self.source}:{max(self.first_row - 1, 1)}"

    def place(self, index: int) -> str:
        """The file and the row."""
        return f"{self.source}:{self.row(index)}"

    def part_from(self, index: int) -> str:
        """The file and about the row: blank rows are not counted."""
        return f"{self.source}:{self.first_row + index}"

    def first(self, column: int) -> str:
        """As of Columns."""
        for _, text in self.rows():
            cells = text.split(self.delimiter)
            return cells[column].strip().strip('"') if column < len(cells) else ""
        return ""

    def numbers(
        self,
        columns: Sequence[int],
        optional: Sequence[int] = (),
        infinite: Sequence[int] = (),
        together: Sequence[int] = (),
    ) -> dict[int, Real]:
        """As of Columns.  Raises DataError at the first row with too few or too many cells as well."""
        if not columns:
            return {}
        optional = optional if self.clock is None else [*optional, 0]
        arrays = columns_of_block(columns, together, self._row_count())
        rows, room = 0, len(arrays[columns[0]])
        for batch in self._batches(columns, pa.float64(), optional, infinite):
            more = rows + batch.num_rows
            if more > room:  # the count was too low: what stands in quotes may have line ends
                room = max(more, 2 * room)
                arrays = {column: np.resize(array[:rows], room) for column, array in arrays.items()}
            for column, array in zip(columns, batch.columns, strict=True):
                # Arrow's own conversion to NumPy would load pandas.
                empty = np.zeros(len(array), dtype=bool)
                if array.null_count:
                    empty = np.from_dlpack(array.is_null().cast(pa.uint8())).astype(bool)
                    array = array.fill_null(np.nan)
                numbers = np.array(np.from_dlpack(array))
                wrong = ~(np.abs(numbers) <= LARGEST) & ~empty
                if column in infinite:
                    wrong &= numbers != np.inf
                if column not in optional:
                    wrong |= empty
                if np.any(wrong):
                    raise self.diagnosis(columns, optional, infinite)
                if column == 0 and self.clock is not None:
                    numbers = self.clock[0] + self.clock[1] * np.arange(rows, more)
                arrays[column][rows:more] = numbers
            rows = more
        pa.default_memory_pool().release_unused()
        return arrays if rows == room else {column: array[:rows] for column, array in arrays.items()}

    def _row_count(self) -> int:
        """How many rows there are if none is blank."""
        held, count = self.file.contents, 0
        for at in range(self.start, len(held), COUNTED):
            ends = np.frombuffer(held[at : at + COUNTED], dtype=np.uint8) == ord("\n")
            count += int(np.count_nonzero(ends))
        return count + int(held[-1:] != b"\n")

    def texts(self, column: int) -> list[str]:
        """A column as text."""
        return [
            text or ""
            for batch in self._batches([column], pa.string(), [], [])
            for text in batch.column(0).to_pylist()
        ]

    def row(self, index: int) -> int:
        """File row of a data row, both for messages: blank rows are skipped when data rows are counted."""
        for i, (row, _) in enumerate(self.rows()):
            if i == index:
                return row
        return self.first_row + index

    def _batches(
        self, columns: Sequence[int], kind: pa.DataType, optional: Sequence[int], infinite: Sequence[int]
    ) -> Iterator[pa.RecordBatch]:
        """The columns as one kind, in pieces.  Raises DataError."""
        try:
            yield from self.batches(dict.fromkeys(columns, kind))
        except (pa.ArrowException, UnicodeDecodeError):
            raise self.diagnosis(columns if kind == pa.float64() else [], optional, infinite) from None

    def batches(
        self, kinds: Mapping[int, pa.DataType], gaps: Sequence[str] = ("",)
    ) -> Iterator[pa.RecordBatch]:
        """Columns by their places as pyarrow reads them, in pieces; `gaps` are how cells without numbers are written.

        Raises what pyarrow raises, which does not say where in a way to rely on: `diagnosis` looks for it again.
        """
        names, held = [f"c{i}" for i in range(len(self.header))], self.file.contents
        wanted = {names[i]: kind for i, kind in kinds.items()}
        # A mapped file as one of pyarrow's own: its threads may still read ahead when it is closed.
        with (
            pa.BufferReader(held) if isinstance(held, bytes) else pa.OSFile(str(noted(self.file.path)))
        ) as stream:
            stream.seek(self.start)
            with pacsv.open_csv(
                stream,
                pacsv.ReadOptions(column_names=names, block_size=BLOCK),
                pacsv.ParseOptions(delimiter=self.delimiter),
                pacsv.ConvertOptions(
                    column_types=wanted,
                    include_columns=list(wanted),
                    null_values=list(gaps),
                    strings_can_be_null=True,
                    quoted_strings_can_be_null=True,
                    decimal_point=self.decimal,
                ),
            ) as reader:
                yield from reader

    def rows(self) -> Iterator[tuple[int, str]]:
        """(file row, text) of the rows that are not blank."""
        row, body, start = self.first_row, self.file.contents, self.start
        while start < len(body):
            end = body.find(b"\n", start)
            end = len(body) if end < 0 else end
            text = body[start:end].decode("utf-8", errors="replace").rstrip("\r")
            if text:
                yield row, text
            start, row = end + 1, row + 1

    def diagnosis(
        self, columns: Sequence[int] = (), optional: Sequence[int] = (), infinite: Sequence[int] = ()
    ) -> DataError:
        """What is wrong first, with cells in these columns or with a row as such, found row by row."""
        row = self.first_row
        for row, text in self.rows():
            place = f"{self.source}:{row}"
            if text.count('"') % 2:
                return DataError("a quote is not closed on its line", place, "close it, or remove it")
            cells = _cells(text, self.delimiter)
            if not cells:
                return DataError("the row cannot be parsed", place, "look for a stray quote")
            if len(cells) != len(self.header):
                cure = "complete the row or remove it; a short last row means that the file was cut off"
                if self.delimiter == "," and len(cells) > len(self.header):
                    cure = "numbers with decimal commas need a semicolon between columns"
                return DataError(
                    f"the row has {len(cells)} cells, the header {len(self.header)}", place, cure
                )
            for column in columns:
                cause = self._wrong(cells[column], column in optional, column in infinite)
                if cause is not None:
                    name = shown(bare(self.header[column])[0])
                    return DataError(f"column {name}: {cause[0]}", place, cause[1])
        return DataError(
            "the file cannot be read as a table of numbers", self.source, "save it as plain CSV in UTF-8"
        )

    def _wrong(self, cell: str, optional: bool, infinite: bool) -> tuple[str, str] | None:
        """Cause and cure of a cell that is not a number."""
        if not cell:
            return None if optional else ("the cell is empty", "fill the gap, or remove the rows")
        try:
            value = float(cell.replace(",", ".") if self.decimal == "," else cell)
        except ValueError:
            if re.fullmatch(r"[-+]?\d{1,3}([,.'\u2019\s]\d{3})+([.,]\d*)?", cell):
                cure = "write numbers without thousands separators"
            elif re.fullmatch(r"[-+]?[\d.,]+[dD][-+]?\d+", cell):
                cure = "write powers of ten with E"
            else:
                cure = "correct it, or remove the rows"
            return f'"{shown(cell)}" is not a number', cure
        if "_" in cell:
            return f'"{shown(cell)}" is not a number', "correct it, or remove the rows"
        if np.isnan(value) or (np.isinf(value) and not (infinite and value > 0)):
            return f'"{shown(cell)}" is not a finite number', "fill the gap, or remove the rows"
        if np.isfinite(value) and abs(value) > LARGEST:
            return f'"{shown(cell)}" is too large', "correct it, or remove the rows"
        return None


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


# Where the columns of a text file begin: delimiter, header row, row of units.


_DELIMITERS = (",", ";", "\t", "|")
_BLANKS = " "  # as a delimiter: any number of blanks and tabs


@dataclass(frozen=True)
class _Row:
    """A row that is not blank: its number in the file, where the next one begins, its text, where it begins."""

    number: int
    end: int
    text: str
    begin: int


def open_table(
    path: str | os.PathLike[str] | DataFile, first_column: str | None = None, source: str | None = None
) -> TextTable:
    """Read a file, plain or .gz, and its header row: after blank rows, rows that begin with #, `sep=`, and others.

    The header row is the one in front of the numbers, or in front of a row of units.  With `first_column` it is the
    first row that begins with it, the first of all where that is "".  `source` names the file, or the part of it, in
    messages.
    Raises DataError if the file cannot be read, is not text, is empty, or has a header and no rows.
    """
    file = _as_utf8(path if isinstance(path, DataFile) else open_file(path))
    source = file.name if source is None else source
    # The header row, and what parts its cells
    header, commented, delimiter = _leading_rows(file.contents, source, first_column)
    if first_column is None:
        if commented is not None and _is_heading(commented, header, delimiter):
            header = commented
        else:
            header = _in_front_of_numbers(file.contents, header, delimiter)
    if delimiter is None:
        delimiter = _delimiter(header.text)
    place, text = f"{source}:{header.number}", header.text
    if delimiter == _BLANKS:
        text = "\t".join(text.split())
    names = _names(text, "\t" if delimiter == _BLANKS else delimiter, place)
    units: tuple[str | None, ...] = ()
    notes: tuple[Notice, ...] = ()
    unnamed: tuple[Notice, ...] = ()
    start, first_row = header.end, header.number + 1
    if all(_is_number(name) for name in names):
        names, unnamed = _without_header(file.contents, header, delimiter, source)
        start, first_row = header.begin, header.number
        file, notes = _without_stray_rows(file, start, source)
    elif not first_column:
        below = _next_row(file.contents, start, header.number)
        cells = [] if below is None else _cells(below.text, delimiter)
        if below is not None and len(cells) == len(names) and _is_unit_row(cells):
            start, first_row, units = below.end, below.number + 1, tuple(map(_unit, cells))
        if first_column is None:
            file, notes = _without_stray_rows(file, start, source)
    if delimiter == _BLANKS:
        # Cells are apart by one tab instead of blanks
        rows = whole_lines(file.contents, start, most=SUBSTITUTED)
        tabbed = (re.sub(rb"(?m)^\t|\t(?=\r?$)", b"", re.sub(rb"[ \t]+", b"\t", lines)) for lines in rows)
        file = file.rewritten(chain([file.contents[:start]], tabbed))
        delimiter = "\t"
    data = file.contents
    first = _next_row(data, start, first_row - 1)
    if first is None:
        raise DataError("the file has a header and no rows", place, "give a file with data")
    # A delimiter may end the header alone, or the rows alone
    cells = _cells(first.text, delimiter)
    if len(cells) == len(names) - 1 and not names[-1]:
        names, units = names[:-1], units[: len(cells)]
    elif len(cells) == len(names) + 1 and not cells[-1]:
        names, units = (*names, ""), (*units, None) if units else ()
    sample = data[start : start + 4096].decode("utf-8", errors="replace")
    decimal, thousands = _decimal(sample, delimiter, source)
    notes = (*unnamed, *thousands, *notes)
    return _ended(TextTable(source, names, units, notes, file, start, first_row, delimiter, decimal))


def _ended(table: TextTable) -> TextTable:
    """The table, with a note where its last row has no line end.

    Raises DataError where that looks cut off within its last number.
    """
    data = table.file.contents
    if data[-1:] == b"\n":
        return table
    begin = max(table.start, len(data) - (1 << 16))
    tail = data[begin:].decode("utf-8", errors="replace").splitlines()[begin > table.start :]
    rows = [line for line in tail if line.strip()][-50:]
    if len(rows) < 2:
        return table
    *before, last = (line.rpartition(table.delimiter)[2].strip() for line in rows)
    if rows[-1].count(table.delimiter) == len(table.header) - 1 and _looks_cut(last, before):
        raise DataError(
            f'the last number, "{shown(last)}", is shorter than those above and has no line end: the file was cut off',
            f"{table.source}:{table.row(sum(1 for _ in table.rows()) - 1)}",
            "copy it again, or remove the last row",
        )
    text = f"{table.source}: the last row has no line end; if the file was cut off, its last number is wrong"
    return replace(table, notes=(*table.notes, Notice("no_line_end", text, (table.source,))))


def _without_header(
    data: Text, first: _Row, delimiter: str, source: str
) -> tuple[tuple[str, ...], tuple[Notice, ...]]:
    """Names of columns of a file without a header row, blank but that of the time, and a note that says so.

    The first column is the time where it increases evenly.
    """
    rows = islice(_rows(data, first.begin, first.number - 1), 50)
    cells = [_cells(row.text, delimiter) for row in rows]
    column = [float(row[0].replace(",", ".")) for row in cells if row and _is_number(row[0])]
    steps = np.diff(column)
    # 1.5: stamps are rounded, and now and then one is late
    timed = (
        len(cells[0]) > 1 and len(steps) > 1 and np.min(steps) > 0 and np.max(steps) <= 1.5 * np.min(steps)
    )
    names = ("time" if timed else "", *[""] * (len(cells[0]) - 1))
    shown_names = listed([name or f"{UNNAMED}{i + 1}" for i, name in enumerate(names)])
    text = f"{source}: no header row; its columns are called {shown_names}"
    return names, (Notice("no_header", text, (source,)),)


def _is_heading(commented: _Row, below: _Row, delimiter: str | None) -> bool:
    """Whether a row that begins with # names the columns of the row of numbers below it."""
    mark = _delimiter(below.text) if delimiter is None else delimiter
    names, cells = _cells(commented.text, mark), _cells(below.text, mark)
    return (
        len(names) == len(cells) and _is_data(cells) and all(name and not _is_number(name) for name in names)
    )


def _decimal(sample: str, delimiter: str, source: str) -> tuple[str, tuple[Notice, ...]]:
    """The decimal mark, and a note where each comma could part thousands: three digits behind it, no 0 alone before."""
    cells = [cell for line in sample.splitlines() for cell in _cells(line, delimiter)]
    numbers = [cell for cell in cells if _is_number(cell)]
    if delimiter == "," or any("." in cell for cell in numbers) or not any("," in cell for cell in numbers):
        return ".", ()
    if not all(re.fullmatch(r"[-+]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in cells if "," in cell):
        return ",", ()
    text = (
        f"{source}: commas are read as decimal points (1,000 as 1.000); if they separate thousands, write "
        "numbers without them"
    )
    return ",", (Notice("decimal_comma", text, (source,)),)


def _leading_rows(data: Text, source: str, first_column: str | None) -> tuple[_Row, _Row | None, str | None]:
    """The first row that may be the header, the row before it that begins with #, the delimiter of `sep=`."""
    commented: _Row | None = None
    delimiter: str | None = None
    for row in _rows(data):
        if row.end - row.begin > LOOKED_AT:
            cure = "give a CSV file with one row per sample"
            raise DataError("the header row is over 1 MB long", f"{source}:{row.number}", cure)
        if row.text.lower().startswith("sep=") and len(row.text) == 5:
            delimiter = row.text[4]
        elif row.text.startswith(first_column) if first_column else not row.text.startswith("#"):
            return row, commented, delimiter
        elif row.text.startswith("#"):
            commented = replace(row, text=row.text.lstrip("# \t"))
    begins = "" if first_column is None else f" that begins with {first_column}"
    cure = f"give a file with a header row{begins} and data"
    raise DataError("the file has no header row", source, cure)


def _next_row(data: Text, position: int, number: int) -> _Row | None:
    """The next row that is not blank, behind row `number` that ends at `position`."""
    return next(_rows(data, position, number), None)


def _rows(data: Text, position: int = 0, number: int = 0) -> Iterator[_Row]:
    """The rows that are not blank, behind row `number` that ends at `position`; of very long ones what is looked at."""
    while position < len(data):
        end = data.find(b"\n", position, position + LOOKED_AT)
        end = min(len(data), position + LOOKED_AT) if end < 0 else end
        text = data[position:end].decode("utf-8", errors="replace").strip("\r\n ")
        begin, position, number = position, min(end + 1, len(data)), number + 1
        if text:
            yield _Row(number, position, text, begin)


def _in_front_of_numbers(data: Text, candidate: _Row, delimiter: str | None) -> _Row:
    """The header row: the first candidate, where numbers or units follow it.

    Otherwise the last row of text in front of two rows of numbers of the same width, or in front of a row of units
    there; where there is none, the first candidate.
    """
    rows = [candidate]
    for following in islice(_rows(data, candidate.end, candidate.number), 400):  # that are looked through
        rows.append(following)
        shows = rows[0] if len(rows) == 2 else rows[-1]
        mark = _delimiter(shows.text) if delimiter is None else delimiter
        *above, first, second = (list[str](), *(_cells(row.text, mark) for row in rows[-4:]))
        if len(rows) == 2:  # whether numbers follow at once, one for each name
            if abs(len(first) - len(second)) <= 1 and _is_data(second) and not any(map(_is_number, first)):
                break
            continue
        if len(first) != len(second):
            continue
        if _is_data(first) and _is_data(second):
            for row, names in zip(rows[-3::-1], above[:0:-1], strict=False):
                if abs(len(names) - len(first)) > 1 or any(map(_is_number, names)):
                    break
                if not _is_unit_row(names):
                    return row
        # Whether these are the first rows of numbers, and the row above has too few cells to name them
        alone = len(first) > 1 and all(map(_is_number, (*first, *second)))
        if alone and 2 * len(above[-1]) <= len(first) and not any(map(_is_number, above[-1])):
            return rows[-2]
    return candidate


def _delimiter(text: str) -> str:
    """The delimiter of a row."""
    most = max(_DELIMITERS, key=text.count)
    if text.count(most) == 0 and len(text.split()) > 1:
        name, unit = bare(text)
        alone = unit is not None and len(name.split()) == 1 and is_unit(unit)  # "laser (mm)"
        return most if alone else _BLANKS
    if most == "," and text.count(";") > 0:  # decimal commas
        return ";"
    return most


def _cells(text: str, delimiter: str) -> list[str]:
    if delimiter == _BLANKS:
        return text.split()
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter))]
    except (csv.Error, StopIteration, TypeError):
        return []


def _is_data(cells: Sequence[str]) -> bool:
    """Numbers, moments and gaps alone, and a number among them."""
    numbers = [_is_number(cell) for cell in cells]
    return any(numbers) and all(
        number or not cell or is_timestamp(cell) or is_date(cell)
        for cell, number in zip(cells, numbers, strict=True)
    )


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Units, or the ratios of two that responses have, and gaps alone; one of them at least is a unit."""
    named = [_unit(cell) or "" for cell in cells if cell not in ("", "-", "[-]", "[]")]
    single = [is_unit(text) for text in named]
    return any(single) and all(alone or are_units(text) for alone, text in zip(single, named, strict=True))


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units."""
    text = re.sub(r"^[\[(](.*)[\])]$", r"\1", cell).strip()
    return None if text in ("", "-") else text


def _names(text: str, delimiter: str, place: str) -> tuple[str, ...]:
    """Names of the columns."""
    if text.count(delimiter) >= MOST_COLUMNS:
        what = f"the header has {text.count(delimiter) + 1} columns"
        raise DataError(what, place, "give a CSV file with one row per sample")
    names = _cells(text, delimiter)
    if not names:
        raise DataError("the header row cannot be parsed", place, "look for a stray quote")
    names[0] = names[0].lstrip("%").strip()
    return tuple(map(name_in, names))


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


# Delimited text of any shape.


_JSON = re.compile(rb'\s*\{\s*["}]')


def read_text(file: DataFile) -> Iterator[TextTable]:
    """The table.  Raises DataError if the text is none, but JSON."""
    if _JSON.match(file.head):
        cure = "name a data file; an estimate is what validate and export take first"
        raise DataError("this is JSON, not a recording", file.name, cure)
    yield open_table(file)


# Comma-separated files, written whole or not at all.


# How a formula begins in spreadsheets, and apostrophes before it; reading takes one away
_FORMULA = re.compile(r"'*[=+\-@\t\r].", re.DOTALL)
_QUOTED = set(',"\n\r')
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)")


def write_rows(
    path: str | os.PathLike[str], header: Sequence[str], columns: Sequence[Sequence[object] | Real]
) -> None:
    """Write a comma-separated file, numbers with all their digits, packed where the name ends in .gz.

    The file appears whole or not at all.  Raises DataError if it cannot be written.  columns (rows,) each.
    """
    arrays = [
        pa.array(np.asarray(c))
        if isinstance(c, np.ndarray)
        else pa.array([_safe(str(x)) for x in c], pa.string())
        for c in columns
    ]
    names = [f"c{i}" for i in range(len(arrays))]
    sink = pa.BufferOutputStream()
    # Arrow quotes every text of a table or none.
    quoted = any(_QUOTED & set(text) for c in arrays if pa.types.is_string(c.type) for text in c.to_pylist())
    options = pacsv.WriteOptions(include_header=False, quoting_style="needed" if quoted else "none")
    pacsv.write_csv(pa.table(arrays, names=names), sink, options)
    # Names in quotes where they must be
    marked = ('"' + x.replace('"', '""') + '"' if _QUOTED & set(x) else x for x in map(_safe, header))
    parts = ((",".join(marked) + "\n").encode(), memoryview(sink.getvalue()))
    write_bytes(path, _packed(parts) if Path(path).suffix == ".gz" else parts)


def _packed(parts: Iterable[bytes | memoryview]) -> Iterator[bytes]:
    """Packed as gzip, without name and time, so that the same data give the same bytes."""
    packer = zlib.compressobj(9, wbits=31)
    for part in parts:
        yield packer.compress(part)
    yield packer.flush()


def _safe(text: str) -> str:
    """The text with an apostrophe before what a spreadsheet takes for a formula; numbers stay as they are."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def name_in(text: str) -> str:
    """The name that was written, without the apostrophe before a formula."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


ZIP = b"PK\x03\x04"
TRUTHS = ("true", "false")  # as text; as numbers 1 and 0


def is_excel(file: DataFile) -> bool:
    """A zip archive or compound file of that name, or with the parts of a workbook in front."""
    head = file.head
    if head.startswith(b"\xd0\xcf\x11\xe0"):
        return True
    names = (b"[Content_Types].xml", b"xl/", b"_rels/", b"docProps/", b"opendocument.spreadsheet")
    return head.startswith(ZIP) and (
        file.suffix in (".xlsx", ".xlsm", ".xlsb", ".ods") or any(name in head[:200] for name in names)
    )


def read_excel(file: DataFile, fastexcel: Any) -> Iterator[TextTable]:
    """The sheets with a header row; empty ones are left out.  Raises DataError if the file cannot be read."""
    if file.head.startswith(ZIP):
        with damaged(file.name, "Excel"), file.reading() as stream, ZipFile(stream) as archive:
            file.check_unpacked(sum(item.file_size for item in archive.infolist()))
    for place, text in guarded(file, "Excel", lambda: _sheets(file, fastexcel)):
        yield open_table(file.rewritten([text]), source=place)


def _sheets(file: DataFile, fastexcel: Any) -> Generator[tuple[str, bytes]]:
    """Place and text of the sheets that hold anything."""
    book = fastexcel.read_excel(bytes(file.contents))
    names = list(book.sheet_names)
    for name in names:
        # Tab-separated, numbers with all their digits: as text they come rounded to nine decimals
        table, numbers = (
            book.load_sheet(name, header_row=None, dtypes=kind).to_arrow() for kind in ("string", "float")
        )
        if table.num_rows == 0 or table.num_columns == 0 or table.num_columns > MOST_COLUMNS:
            text = b""
        else:
            columns = [
                [_text_of_cell(*cell) for cell in zip(texts.to_pylist(), values.to_pylist(), strict=True)]
                for texts, values in zip(table.columns, numbers.columns, strict=True)
            ]
            rows = (
                "\t".join(row).rstrip("\t") if i == 0 else "\t".join(row)
                for i, row in enumerate(zip(*columns, strict=True))
            )
            text = ("\n".join(rows) + "\n").encode()
        if text.count(b"\n") > 1 or (text and len(names) == 1):
            yield f"{file.name} ({name})" if len(names) > 1 else file.name, text


def _text_of_cell(text: str | None, number: float | None) -> str:
    if text is None:
        return ""
    if number is not None and text not in TRUTHS:
        return repr(number)
    return text.replace("\t", " ").replace("\n", " ")
