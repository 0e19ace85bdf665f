"""A delimited text file as named columns of numbers, with the place of everything that is wrong in it."""

from __future__ import annotations

import codecs
import csv
import itertools
import mmap
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot.arrays import Bools, Real
from dashpot.data.readers.columns import LARGEST, MOST_COLUMNS, Columns, bare, columns_of_block, is_unit
from dashpot.data.readers.datafile import PIECE, SUBSTITUTED, DataFile, open_file, whole_lines
from dashpot.data.readers.delimited.timestamps import is_date, is_timestamp
from dashpot.data.readers.delimited.writing import name_in
from dashpot.errors import DataError
from dashpot.io.ledger import noted
from dashpot.io.words import counted, listed, shown
from dashpot.notices import Notice

# Text of any encoding as UTF-8 with line feeds, without what editors and broken writes leave at its end.


Text = bytes | mmap.mmap
LOOKED_AT = 1 << 20  # bytes by which an encoding is told
_MARKS = (b"\xff\xfe", b"\xfe\xff")  # that begin a text in UTF-16
_END = b"\0\x1a"  # of a file that was laid out before it was written, or that DOS ended
_NO_WINDOWS_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
_FEWEST = 8  # bytes of text in UTF-16 that need no mark


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


def as_utf8(data: bytes, source: str) -> bytes:
    """The text of a file as UTF-8 without a mark, with line feeds.  Raises DataError where it is not text."""
    encoding = _encoding(data, source)
    if encoding is not None:
        try:
            data = data.decode(encoding).encode()
        except UnicodeError:
            raise _damaged(source) from None
    data = data.removeprefix(codecs.BOM_UTF8).rstrip(_END)
    if not data.strip():
        raise DataError("the file is empty", source, "give a file with a header row and data")
    if b"\0" in data[:LOOKED_AT]:
        raise DataError("the file is not text", source, "give a CSV file")
    return data.replace(b"\r", b"\n") if b"\n" not in data and b"\r" in data else data


def rewritten_as_utf8(file: DataFile, data: Text) -> DataFile:
    """The same of a file that is too large to be held; itself where it is so already.

    Raises DataError where it is said to be UTF-16 and is not.
    """
    pieces = (data[at : at + PIECE] for at in range(0, len(data), PIECE))
    encoding = _encoding(data[:LOOKED_AT], file.name)
    if encoding is not None:
        try:
            return file.rewritten(text.encode() for text in codecs.iterdecode(pieces, encoding))
        except UnicodeError:
            raise _damaged(file.name) from None
    if b"\n" not in data[:LOOKED_AT] and b"\r" in data[:LOOKED_AT]:
        return file.rewritten(piece.replace(b"\r", b"\n") for piece in pieces)
    if data[-1] in _END:
        return file.rewritten(piece.translate(None, _END) for piece in pieces)
    return file


def _encoding(data: bytes, source: str) -> str | None:
    """What the text is written in, None where that is UTF-8; Windows-1252 is what a µ or ² alone in it may be."""
    wide = _wide(data)
    if wide is not None:
        return wide
    head = data[:LOOKED_AT]
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
    """UTF-16, with a mark or where every other byte of the beginning is zero."""
    if data[:2] in _MARKS:
        return "utf-16"
    begin = data[:64]
    if len(begin) >= _FEWEST and len(begin) % 2 == 0:
        for encoding, low, high in (
            ("utf-16-le", begin[::2], begin[1::2]),
            ("utf-16-be", begin[1::2], begin[::2]),
        ):
            if not any(high) and all(low):
                return encoding
    return None


def _damaged(source: str) -> DataError:
    return DataError("the file is damaged UTF-16", source, "save it as UTF-8")


# Rows between those of numbers that are none: a header on each page, comments. They are blanked, and told.
#
# Rows keep their places, for blank ones are passed over.


_MINUS, _HYPHEN = "\u2212".encode(), b"-"
_COMMENTS = b"#", b"%"
_LETTER = rb"[A-Za-z_\x80-\xff]"


def _telling(sign: bytes) -> bytes:
    """A byte of a text, if possible one that numbers do not have."""
    match = re.search(rb"[^\s\d.,;:|+\-eE]", sign)
    return match[0] if match else sign[:1]


class StrayRows:
    """What is to be left out of the text behind a header, and how much of it there was.

    heading  the text from its beginning to the row of units, or the header where there is none
    """

    def __init__(self, heading: bytes) -> None:
        self._start = len(heading)
        self._headings = [row for row in map(bytes.strip, heading.splitlines()) if re.search(_LETTER, row)]
        repeated = b"|".join(re.escape(row) for row in self._headings)
        self._stray = re.compile(rb"(?m)^[ \t\f]*(?:(" + repeated + rb")|[#%][^\r\n]*)[ \t\f]*(?=\r?$)")
        self.repeated = self.comments = 0

    def among(self, data: Text) -> bool:
        """Whether there may be such rows: a quick look."""
        signs = (*self._headings[-2:], b"\f", _MINUS, *_COMMENTS)
        # A byte is found ten times as fast as several, and one that numbers do not have is seldom there.
        present = {byte for byte in map(_telling, signs) if data.find(byte, self._start) >= 0}
        return any(_telling(sign) in present and data.find(sign, self._start) >= 0 for sign in signs)

    def blanked(self, data: bytes) -> bytes:
        """The text without them."""
        return data[: self._start] + self._blanked(data[self._start :])

    def _blanked(self, lines: bytes) -> bytes:
        """Whole lines without them, and with hyphens for signs that typesetting has put there."""

        def counting(match: re.Match[bytes]) -> bytes:
            self.repeated += match[1] is not None
            self.comments += match[1] is None
            return b""

        return self._stray.sub(counting, lines).replace(_MINUS, _HYPHEN).replace(b"\f", b"")

    def rewritten(self, file: DataFile, data: Text) -> DataFile:
        """A file that is too large to be held without them."""
        return file.rewritten(
            chain([data[: self._start]], map(self._blanked, whole_lines(data, self._start)))
        )

    def note(self, source: str) -> tuple[Notice, ...]:
        """What was left out, where anything was."""
        words = []
        if self.repeated:
            words.append(f"{counted(self.repeated, 'row')} repeating the header")
        if self.comments:
            words.append(counted(self.comments, "comment"))
        return (Notice("stray_rows", f"{source}: left out {listed(words)}", (source,)),) if words else ()


HELD, STREAMED = (
    1 << 23,
    1 << 21,
)  # bytes that are parsed at a time; of a file, some such blocks are read ahead
COUNTED = 1 << 24  # bytes whose line ends are counted at a time


@dataclass(frozen=True)
class Table(Columns):
    """The text of a file behind its header row.

    body       bytes after the header row
    first_row  file row on which the body begins, counted from 1
    clock      start and step of the first column, where that is left empty for the header says its numbers
    """

    body: memoryview
    first_row: int
    delimiter: str
    decimal: str
    file: DataFile | None = None  # of which the body is the end, where it is too large to be held
    clock: tuple[float, float] | None = None

    @property
    def whole(self) -> tuple[bytes | mmap.mmap, int]:
        """The bytes that the body is the end of, and where it begins there."""
        held: Any = self.body.obj
        return held, len(held) - len(self.body)

    @property
    def heading(self) -> str:
        """The file and its header row."""
        return f"{self.source}:{self.first_row - 1}"

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
        """The columns as float64.  Empty cells of `optional` ones give NaN; those of `infinite` may be inf.

        Of a file that is not held, those of `together` are the columns of one new array.
        Raises DataError at the first row with too few or too many cells, a gap, text, NaN or infinity.
        """
        if not columns:
            return {}
        pieces = self._pieces(columns, optional, infinite)
        if self.file is not None:
            return _filled(columns_of_block(columns, together, self._row_count()), pieces)
        parts: dict[int, list[Real]] = {column: [] for column in columns}
        for piece in pieces:
            for column, numbers in piece.items():
                parts[column].append(numbers)
        pa.default_memory_pool().release_unused()
        return {column: np.concatenate([*parts.pop(column), np.zeros(0)]) for column in list(parts)}

    def _pieces(
        self, columns: Sequence[int], optional: Sequence[int], infinite: Sequence[int]
    ) -> Iterator[dict[int, Real]]:
        """The columns some rows at a time, checked."""
        optional = optional if self.clock is None else [*optional, 0]
        rows = 0
        for batch in self._batches(columns, pa.float64(), optional, infinite):
            piece: dict[int, Real] = {}
            for column, array in zip(columns, batch.columns, strict=True):
                numbers, empty = _numbers_of(array)
                wrong = ~(np.abs(numbers) <= LARGEST) & ~empty
                if column in infinite:
                    wrong &= numbers != np.inf
                if column not in optional:
                    wrong |= empty
                if np.any(wrong):
                    raise self._diagnosis(columns, optional, infinite)
                piece[column] = numbers
            if self.clock is not None and 0 in piece:
                start, step = self.clock
                piece[0] = start + step * np.arange(rows, rows + batch.num_rows)
            rows += batch.num_rows
            yield piece

    def _row_count(self) -> int:
        """How many rows there are if none is blank, but for a guess that `_filled` puts right."""
        count = 0
        held, start = self.whole
        for at in range(start, len(held), COUNTED):
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
        """The columns by pyarrow, in pieces.

        Raises DataError: what pyarrow finds wrong is looked for again, as it does not say where in a way to rely on.
        """
        names = [f"c{i}" for i in range(len(self.header))]
        wanted = [names[i] for i in columns]
        options = {
            "read_options": pacsv.ReadOptions(
                column_names=names, block_size=HELD if self.file is None else STREAMED
            ),
            "parse_options": pacsv.ParseOptions(delimiter=self.delimiter),
            "convert_options": pacsv.ConvertOptions(
                column_types=dict.fromkeys(wanted, kind),
                include_columns=wanted,
                null_values=[""],
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
                decimal_point=self.decimal,
            ),
        }
        try:
            if self.file is None:
                yield from pacsv.read_csv(pa.BufferReader(pa.py_buffer(self.body)), **options).to_batches()
                return
            # A file of pyarrow's own: its threads may still read ahead when it is closed.
            with pa.OSFile(str(noted(self.file.path))) as stream:
                stream.seek(self.whole[1])
                with pacsv.open_csv(stream, **options) as reader:
                    yield from reader
        except (pa.ArrowException, UnicodeDecodeError):
            raise self._diagnosis(columns if kind == pa.float64() else [], optional, infinite) from None

    def rows(self) -> Iterator[tuple[int, str]]:
        """(file row, text) of the rows that are not blank."""
        row = self.first_row
        body, start = self.whole
        while start < len(body):
            end = body.find(b"\n", start)
            end = len(body) if end < 0 else end
            text = body[start:end].decode("utf-8", errors="replace").rstrip("\r")
            if text:
                yield row, text
            start, row = end + 1, row + 1

    def _diagnosis(
        self, columns: Sequence[int], optional: Sequence[int], infinite: Sequence[int]
    ) -> DataError:
        """What is wrong first, found row by row."""
        row = self.first_row
        for row, text in self.rows():
            place = f"{self.source}:{row}"
            try:
                cells = next(csv.reader([text], delimiter=self.delimiter))
            except (csv.Error, StopIteration):
                return DataError("the row cannot be taken apart", place, "look for a stray quote")
            if len(cells) != len(self.header):
                cure = "fill the row or take it out; a short last row means that the file was cut off"
                if self.delimiter == "," and len(cells) > len(self.header):
                    cure = "numbers with decimal commas need a semicolon between columns"
                return DataError(
                    f"the row has {len(cells)} cells, the header {len(self.header)}", place, cure
                )
            for column in columns:
                cause = self._wrong(cells[column].strip(), column in optional, column in infinite)
                if cause is not None:
                    name = shown(bare(self.header[column])[0])
                    return DataError(f"column {name}: {cause[0]}", place, cause[1])
        stray = next((row for row, text in self.rows() if text.count('"') % 2), None)
        if stray is not None:
            return DataError("a quote is not closed", f"{self.source}:{stray}", "close it, or take it out")
        return DataError(
            "the file cannot be read as a table of numbers", self.source, "save it as plain CSV in UTF-8"
        )

    def _wrong(self, cell: str, optional: bool, infinite: bool) -> tuple[str, str] | None:
        """Cause and cure of a cell that is not a number."""
        if not cell:
            return None if optional else ("the cell is empty", "fill the gap, or cut the rows out")
        try:
            value = float(cell.replace(",", ".") if self.decimal == "," else cell)
        except ValueError:
            return f'"{shown(cell)}" is not a number', _cure_of(cell)
        if "_" in cell:
            return f'"{shown(cell)}" is not a number', "correct it, or cut the rows out"
        if np.isnan(value) or (np.isinf(value) and not (infinite and value > 0)):
            return f'"{shown(cell)}" is not a finite number', "fill the gap, or cut the rows out"
        if np.isfinite(value) and abs(value) > LARGEST:
            return f'"{shown(cell)}" is too large', "correct it, or cut the rows out"
        return None


def _cure_of(cell: str) -> str:
    """What to do about a cell that is not a number."""
    if re.fullmatch(r"[-+]?\d{1,3}([,.'\u2019\s]\d{3})+([.,]\d*)?", cell):
        return "write numbers without thousands separators"
    if re.fullmatch(r"[-+]?[\d.,]+[dD][-+]?\d+", cell):
        return "write powers of ten with E"
    return "correct it, or cut the rows out"


def _numbers_of(array: Any) -> tuple[Real, Bools]:
    """A column of float64 and where it is empty.  Arrow's own conversion to NumPy would load pandas."""
    empty = np.zeros(len(array), dtype=bool)
    if array.null_count:
        empty = np.from_dlpack(array.is_null().cast(pa.uint8())).astype(bool)
        array = array.fill_null(np.nan)
    return np.array(np.from_dlpack(array)), empty


def _filled(arrays: dict[int, Real], pieces: Iterator[dict[int, Real]]) -> dict[int, Real]:
    """The arrays with the numbers of the pieces; shorter, or new ones, where blank rows or quotes misled the count."""
    rows, room = 0, min((len(array) for array in arrays.values()), default=0)
    for piece in pieces:
        more = len(next(iter(piece.values()), ()))
        if rows + more > room:
            room = max(rows + more, 2 * room)
            arrays = {column: np.resize(array[:rows], room) for column, array in arrays.items()}
        for column, numbers in piece.items():
            arrays[column][rows : rows + more] = numbers
        rows += more
    pa.default_memory_pool().release_unused()
    return arrays if rows == room else {column: array[:rows] for column, array in arrays.items()}


# Whether the last number of a text file was cut off.


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


# Where the columns of a text file begin: encoding, delimiter, header row, row of units.


HEAD = 1 << 20  # bytes in which the header row must end
MOST_LEADING = 400  # rows in front of the data that are looked through
_DELIMITERS = (",", ";", "\t", "|")
_BLANKS = " "  # as a delimiter: any number of blanks and tabs


@dataclass(frozen=True)
class _Row:
    """A row that is not blank: its number in the file, where the next one begins, its text."""

    number: int
    end: int
    text: str


def open_table(path: str | os.PathLike[str] | DataFile, first_column: str | None = None) -> Table:
    """Read a file, plain or .gz, and its header row: after blank rows, rows that begin with #, `sep=`, and others.

    The header row is the one in front of the numbers, or in front of a row of units.  With `first_column` it is the
    first row that begins with it.
    Raises DataError where the file cannot be read, is not text, is empty, or has a header and no rows.
    """
    file = path if isinstance(path, DataFile) else open_file(path)
    if isinstance(file.contents, bytes):
        return table_of(file.contents, file.name, first_column)
    file = rewritten_as_utf8(file, file.contents)
    header = _header(file.contents, file.name, first_column)
    stray = _stray_rows(file.contents, header, first_column)
    if stray is not None and stray.among(file.contents):
        file = stray.rewritten(file, file.contents)
    if header.delimiter == _BLANKS:
        above = (b"\n" * (header.row.number - 1), _tabbed_row(header.row))
        file = file.rewritten(itertools.chain(above, _tabbed(file.contents, header.row.end)))
    table = table_of(file.contents, file.name, first_column)
    left_out = () if stray is None else stray.note(file.name)
    return replace(table, file=file, notes=(*table.notes, *left_out))


@dataclass(frozen=True)
class _Header:
    """The header row of a table, and what parts its cells."""

    row: _Row
    delimiter: str


def _header(data: Text, source: str, first_column: str | None) -> _Header:
    rows, commented, delimiter = _leading_rows(data, source, first_column)
    header_at = len(rows) - 1
    if first_column is None:
        if commented is not None and _is_heading(commented, rows[0], delimiter):
            rows, header_at = [commented], 0
        else:
            rows, header_at = _with_header(data, rows, delimiter)
    row = rows[header_at]
    return _Header(row, _delimiter(row.text) if delimiter is None else delimiter)


def table_of(data: Text, source: str, first_column: str | None = None) -> Table:
    """The table in the bytes of a file; as `open_table`.  Raises DataError where there is no table."""
    data = as_utf8(data, source) if isinstance(data, bytes) else data
    header = _header(data, source, first_column)
    row, delimiter = header.row, header.delimiter
    place = f"{source}:{row.number}"
    stray = _stray_rows(data, header, first_column)
    if stray is not None and isinstance(data, bytes) and stray.among(data):
        data = stray.blanked(data)
    if delimiter == _BLANKS:
        data = b"".join((data[: row.end], *_tabbed(data, row.end)))
        row = _Row(row.number, row.end, _tabbed_row(row).decode().rstrip("\n"))
        delimiter = "\t"
    names = _names(row.text, delimiter, place)
    units: tuple[str | None, ...] = ()
    start, first_row = row.end, row.number + 1
    if first_column is None:
        start, first_row, units = _behind_units(data, row, delimiter, len(names))
    first_data = _next_row(data, start, first_row - 1)
    if first_data is None:
        raise DataError("the file has a header and no rows", place, "give a file with data")
    names, units = _of_width(names, units, _cells(first_data.text, delimiter))
    decimal, notes = _decimal(data[start : start + 4096].decode("utf-8", errors="replace"), delimiter, source)
    notes = notes if stray is None else (*notes, *stray.note(source))
    body = memoryview(data)[start:]
    return with_checked_end(Table(source, names, units, notes, body, first_row, delimiter, decimal))


def _stray_rows(data: Text, header: _Header, first_column: str | None) -> StrayRows | None:
    """What may stand between the rows, where nothing fixed says how the file looks."""
    if first_column is not None:
        return None
    row = header.row
    start, _, _ = _behind_units(data, row, header.delimiter, len(_cells(row.text, header.delimiter)))
    return StrayRows(data[:start])


def _of_width(
    names: tuple[str, ...], units: tuple[str | None, ...], cells: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str | None, ...]]:
    """Names and units where a delimiter ends the header alone, or the rows alone."""
    if len(cells) == len(names) - 1 and not names[-1]:
        return names[:-1], units[: len(cells)]
    if len(cells) == len(names) + 1 and not cells[-1]:
        return (*names, ""), (*units, None) if units else ()
    return names, units


def _is_heading(commented: _Row, below: _Row, delimiter: str | None) -> bool:
    """Whether a row that begins with # names the columns of the row of numbers below it."""
    mark = _delimiter(below.text) if delimiter is None else delimiter
    names, cells = _cells(commented.text, mark), _cells(below.text, mark)
    return (
        len(names) == len(cells) and _is_data(cells) and all(name and not _is_number(name) for name in names)
    )


def _behind_units(
    data: Text, header: _Row, delimiter: str, columns: int
) -> tuple[int, int, tuple[str | None, ...]]:
    """Where the rows begin behind the header, and behind a row of units where there is one; the units."""
    following = _next_row(data, header.end, header.number)
    if following is not None:
        cells = _cells(following.text, delimiter)
        if len(cells) == columns and _is_unit_row(cells):
            return following.end, following.number + 1, tuple(_unit(cell) for cell in cells)
    return header.end, header.number + 1, ()


def _decimal(sample: str, delimiter: str, source: str) -> tuple[str, tuple[Notice, ...]]:
    """The decimal mark, and a note where a comma may be meant to part thousands."""
    if delimiter == "," or "," not in sample:
        return ".", ()
    cells = [cell for line in sample.splitlines() for cell in _cells(line, delimiter)]
    numbers = [cell for cell in cells if _is_number(cell)]
    if any("." in cell for cell in numbers) or not any("," in cell for cell in numbers):
        return ".", ()
    return ",", (_thousands_note(source),) if _may_be_thousands(sample, delimiter) else ()


def _may_be_thousands(sample: str, delimiter: str) -> bool:
    """Whether each comma could part thousands: three digits behind it, one to three and no zero alone before it."""
    cells = [cell.strip().strip('"') for line in sample.splitlines() for cell in line.split(delimiter)]
    return all(re.fullmatch(r"[-+]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in cells if "," in cell)


def _thousands_note(source: str) -> Notice:
    text = f"{source}: commas are read as decimal points, 1,000 as 1.000; write numbers without thousands separators"
    return Notice("decimal_comma", text, (source,))


def _leading_rows(
    data: Text, source: str, first_column: str | None
) -> tuple[list[_Row], _Row | None, str | None]:
    """The first row that may be the header, the row before it that begins with #, the delimiter of `sep=`."""
    position, number, delimiter = 0, 0, None
    commented: _Row | None = None
    while True:
        number += 1
        end = data.find(b"\n", position, position + HEAD)
        if end < 0 and len(data) - position > HEAD:
            cure = "give a CSV file with one row per sample"
            raise DataError("the header row is over 1 MB long", f"{source}:{number}", cure)
        end = len(data) if end < 0 else end
        try:
            text = data[position:end].decode("utf-8").removeprefix("\ufeff").strip("\r\n ")
        except UnicodeDecodeError as error:
            what = f"byte {error.start + 1} of the row is not UTF-8"
            raise DataError(what, f"{source}:{number}", "save the file as UTF-8") from None
        position = min(end + 1, len(data))
        if text.lower().startswith("sep=") and len(text) == 5:
            delimiter = text[4]
        elif text.startswith(first_column) if first_column else text and not text.startswith("#"):
            return [_Row(number, position, text)], commented, delimiter
        elif text.startswith("#"):
            commented = _Row(number, position, text.lstrip("# \t"))
        if position >= len(data):
            begins = "" if first_column is None else f" that begins with {first_column}"
            cure = f"give a file with a header row{begins} and data"
            raise DataError("the file has no header row", source, cure)


def _next_row(data: Text, position: int, number: int) -> _Row | None:
    """The next row that is not blank, behind row `number` that ends at `position`."""
    while position < len(data):
        end = data.find(b"\n", position, position + HEAD)
        end = min(len(data), position + HEAD) if end < 0 else end
        text = data[position:end].decode("utf-8", errors="replace").strip("\r\n ")
        position, number = min(end + 1, len(data)), number + 1
        if text:
            return _Row(number, position, text)
    return None


def _with_header(data: Text, rows: list[_Row], delimiter: str | None) -> tuple[list[_Row], int]:
    """Rows from the first candidate on, and which of them is the header row.

    The first candidate is, where numbers or units follow it.  Otherwise the last row of text in front of two rows of
    numbers of the same width, or in front of a row of units there; where there is none, the first candidate.
    """
    rows = list(rows)
    while len(rows) < MOST_LEADING:
        following = _next_row(data, rows[-1].end, rows[-1].number)
        if following is None:
            break
        rows.append(following)
        if len(rows) == 2 and _follow_at_once(rows, delimiter):
            break
        if len(rows) < 3:
            continue
        header = _header_in_front(rows, delimiter)
        if header is not None:
            return rows, header
    return rows, 0


def _follow_at_once(rows: Sequence[_Row], delimiter: str | None) -> bool:
    """Whether numbers follow the first candidate, one for each name."""
    mark = _delimiter(rows[0].text) if delimiter is None else delimiter
    names, cells = (_cells(row.text, mark) for row in rows)
    return (
        abs(len(names) - len(cells)) <= 1 and _is_data(cells) and not any(_is_number(name) for name in names)
    )


def _header_in_front(rows: Sequence[_Row], delimiter: str | None) -> int | None:
    """The header row, where the last two rows are the first ones of numbers; None where they are not."""
    mark = _delimiter(rows[-1].text) if delimiter is None else delimiter
    *_, first, second = (_cells(row.text, mark) for row in rows[-3:])
    if len(first) != len(second) or not (_is_data(first) and _is_data(second)):
        return None
    for at in (len(rows) - 3, len(rows) - 4):
        if at < 0:
            return None
        cells = _cells(rows[at].text, mark)
        if abs(len(cells) - len(first)) > 1 or any(_is_number(cell) for cell in cells):
            return None
        if not _is_unit_row(cells):
            return at
    return None


def _delimiter(text: str) -> str:
    """The delimiter of a row."""
    most = max(_DELIMITERS, key=text.count)
    if text.count(most) == 0 and len(text.split()) > 1:
        return _BLANKS
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
    """Units and gaps alone, two units at least or one where there is one column."""
    named = [cell for cell in cells if cell not in ("", "-", "[-]", "[]")]
    return bool(named) and all(is_unit(_unit(cell) or "") for cell in named)


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units."""
    text = re.sub(r"^[\[(](.*)[\])]$", r"\1", cell).strip()
    return None if text in ("", "-") else text


def _tabbed_row(row: _Row) -> bytes:
    return "\t".join(row.text.split()).encode() + b"\n"


def _tabbed(data: Text, start: int) -> Iterator[bytes]:
    """What follows, in pieces, with cells apart by one tab instead of blanks."""
    for lines in whole_lines(data, start, most=SUBSTITUTED):
        yield re.sub(rb"(?m)^\t|\t(?=\r?$)", b"", re.sub(rb"[ \t]+", b"\t", lines))


def _names(text: str, delimiter: str, place: str) -> tuple[str, ...]:
    """Names of the columns."""
    if text.count(delimiter) >= MOST_COLUMNS:
        what = f"the header has {text.count(delimiter) + 1} columns"
        raise DataError(what, place, "give a CSV file with one row per sample")
    try:
        names = next(csv.reader([text], delimiter=delimiter))
    except (csv.Error, StopIteration, TypeError):
        raise DataError("the header row cannot be taken apart", place, "look for a stray quote") from None
    if all(_is_number(name) for name in names):
        raise DataError("the file has no header row", place, "name the columns in the first row")
    names[0] = names[0].lstrip("%")
    return tuple(name_in(name.strip()) for name in names)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


# Delimited text of any shape.


_JSON = re.compile(rb'\s*\{\s*["}]')


@dataclass(frozen=True)
class TextReader:
    """A header row and columns of numbers, by comma, semicolon, tab, bar or blanks."""

    format: str = "text"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """No byte is zero but at the end, or the text is in UTF-16."""
        return is_text(file.head)

    def parts(self, file: DataFile) -> Iterator[Table]:
        """The table.  Raises DataError where the text is none, but JSON."""
        if _JSON.match(file.head):
            cure = "name a data file; an estimate is what validate and export take first"
            raise DataError("this is JSON, and no recording", file.name, cure)
        yield open_table(file)
