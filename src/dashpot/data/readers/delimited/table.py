"""A delimited text file as named columns of numbers, with the place of everything that is wrong in it."""

from __future__ import annotations

import csv
import mmap
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot.arrays import Bools, Real
from dashpot.data.readers.columns import LARGEST, Columns, bare, columns_of_block
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError
from dashpot.io.ledger import noted
from dashpot.io.words import shown

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
