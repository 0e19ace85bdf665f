"""Tables of many rigs, a column of which names the rig of each row; never held whole.

The process that shares work out reads the names alone.  Rows of Parquet tables are read by the workers, who are told
which; those of CSV, which have no places in the file, are read in passing and sent.
"""

from __future__ import annotations

import csv
import hashlib
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from dashpot.data.readers import Reading, read
from dashpot.data.readers.amplitudes import amplitude_columns
from dashpot.data.readers.arrays import array_columns
from dashpot.data.readers.interpretation import interpret
from dashpot.data.readers.records import Circumstances
from dashpot.data.spectrum import Moments, Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.fleet.data_sets import BlockPart, DataSet, Source, Treatment, digest_of
from dashpot.io.json_document import array_of, arrow_table
from dashpot.io.ledger import noted
from dashpot.io.words import counted, listed, shown
from dashpot.model.rigfile import Rig

# Rows of CSV tables of many rigs, read as they come, and the line of what is wrong with them.


_DELIMITERS = ";", "\t", ","  # in the order in which a header that has several is taken apart


@dataclass(frozen=True)
class CsvLayout:
    """How a table is written: delimiter, decimal mark, and the columns that are to be read as texts.

    texts  beside the one that names rigs, which always is: 007 is a name
    """

    path: str
    column: str
    delimiter: str
    decimal: str
    header: tuple[str, ...]
    texts: frozenset[str] = field(default=frozenset())

    def batches(self) -> Iterator[Any]:
        """The rows, some at a time.  Raises DataError where they cannot be taken apart, with the line."""
        import pyarrow as pa
        import pyarrow.csv as text

        numbers = dict.fromkeys(set(self.header) - self.texts - {self.column}, pa.float64())
        kinds = {**numbers, **dict.fromkeys(self.texts | {self.column}, pa.string())}
        # Kinds are stated, for pyarrow would hold a column for whole numbers that begins with some.
        converted = text.ConvertOptions(column_types=kinds, decimal_point=self.decimal)
        parsed = text.ParseOptions(delimiter=self.delimiter)
        try:
            with text.open_csv(noted(self.path), convert_options=converted, parse_options=parsed) as reader:
                yield from reader
        except pa.ArrowInvalid as error:
            raise self._fault(str(error)) from None

    def _fault(self, said: str) -> Exception:
        """What is wrong first, found row by row; a column that holds more than numbers is told as such."""
        column = re.match(r"In CSV column #(\d+):.*CSV conversion error", said)
        if column is not None and self.header[int(column[1])] not in self.texts:
            return NotNumbersError(self.header[int(column[1])])
        line, cells = 1, len(self.header)
        try:
            with open(noted(self.path), encoding="utf-8", errors="replace", newline="") as file:
                reader = csv.reader(file, delimiter=self.delimiter)
                for row in reader:
                    if row and len(row) != cells:
                        what = f"the row has {counted(len(row), 'cell')}, the header {cells}"
                        cure = "fill the row or take it out"
                        if reader.line_num > line:
                            what, cure = "a quote is not closed on its line", "close it, or take it out"
                        return DataError(what, f"{self.path}:{line}", cure)
                    line = reader.line_num + 1
        except csv.Error:
            return DataError("the row cannot be taken apart", f"{self.path}:{line}", "look for a stray quote")
        return DataError(f"the table cannot be read ({shown(said, 150)})", self.path, "check the file")


class NotNumbersError(Exception):
    """A column holds more than numbers: its name."""


def csv_layout(path: str, column: str) -> CsvLayout:
    """How a table is written, from its header and the row below.  Raises DataError where there is none."""
    with open(noted(path), encoding="utf-8-sig", errors="replace", newline="") as file:
        header, below = file.readline(), file.readline()
    if not header.strip():
        raise DataError("the table begins with an empty line", path, "begin with the names of the columns")
    delimiter = next((mark for mark in _DELIMITERS if mark in header), ",")
    names = tuple(next(csv.reader([header], delimiter=delimiter)))
    require_columns(path, column, names)
    if not below.strip():
        raise DataError("the table has no rows", path, "give the data of at least one rig")
    cells = below.split(delimiter)
    comma = delimiter != "," and any(
        re.fullmatch(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*", cell) for cell in cells
    )
    return CsvLayout(path, column, delimiter, "," if comma else ".", names)


def require_columns(path: str, column: str, names: tuple[str, ...]) -> None:
    """Raises DataError where the column that names rigs is missing, or one is named twice."""
    if column not in names:
        what = f"column {shown(column)}: missing (it is to name the rig)"
        raise DataError(what, path, f"there are {listed(names)}")
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise DataError(f"column {shown(twice)}: named twice", path, "rename one of them")


# Row groups of a Parquet table: their checksums, and rows read from them one block after the other.


ROWS = 1 << 16  # that are decoded at a time
PIECE = 1 << 20  # bytes of a file that are read at once


def with_units(schema: Any) -> dict[str, str | None]:
    """The unit that a table gives to each of its columns."""
    return {
        entry.name: (entry.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") or None
        for entry in schema
    }


def stamp_of(path: str) -> tuple[int, int]:
    """Size of a file, and when it was changed."""
    state = os.stat(path)
    return state.st_size, state.st_mtime_ns


def group_checksum(path: str, number: int) -> str:
    """Of the bytes of a row group's columns, with what they are decoded by; read once while the file is the same."""
    return _group_checksum(path, number, stamp_of(path))


@lru_cache(maxsize=16)
def _group_checksum(path: str, number: int, stamp: tuple[int, int]) -> str:
    del stamp  # of the file that the checksum is kept for
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(path) as file:
        group, schema = file.metadata.row_group(number), file.schema_arrow
    columns = [group.column(k) for k in range(group.num_columns)]
    digest = hashlib.sha256(schema.serialize())
    with open(noted(path), "rb") as content:
        for column in columns:
            encoded = (column.path_in_schema, column.physical_type, column.compression, column.encodings)
            digest.update(repr((encoded, column.num_values, column.total_compressed_size)).encode())
            begins = [column.data_page_offset]
            if column.has_dictionary_page and column.dictionary_page_offset is not None:
                begins.append(column.dictionary_page_offset)
            content.seek(min(begins))
            left = column.total_compressed_size
            while left > 0 and (piece := content.read(min(left, PIECE))):
                digest.update(piece)
                left -= len(piece)
    return digest.hexdigest()


def batches(file: Any, first_group: int = 0, columns: list[str] | None = None) -> Iterator[Any]:
    """Rows of a ParquetFile from a row group on, some at a time.

    Row group by row group, for one iterator over several holds all that it has decoded.
    """
    for number in range(first_group, file.num_row_groups):
        yield from file.iter_batches(ROWS, row_groups=[number], columns=columns, use_threads=False)


def rows_between(path: str, first: int, end: int) -> Any:
    """An Arrow table of the rows from `first` on, before `end`.

    Blocks of one process follow each other, so that it goes on where it was: of a row group, however long, little is
    held and every row is decoded once.
    """
    return _reader(path, stamp_of(path)).rows(first, end)


class _Reader:
    """A table, read up to some row; the batches that the last rows lay in are held."""

    def __init__(self, path: str) -> None:
        import pyarrow.parquet as parquet

        self.file = parquet.ParquetFile(path)
        groups = self.file.metadata
        self.begins = np.cumsum([0, *(groups.row_group(k).num_rows for k in range(groups.num_row_groups))])
        self._begin(0)

    def _begin(self, group: int) -> None:
        """Read on from a row group."""
        self.held: list[Any] = []
        self.batches = batches(self.file, group)
        self.from_row = self.to_row = int(self.begins[group])

    def rows(self, first: int, end: int) -> Any:
        """An Arrow table of the rows from `first` on, before `end`."""
        import pyarrow as pa

        group = int(np.searchsorted(self.begins, first, side="right")) - 1
        if first < self.from_row or self.to_row < self.begins[group]:
            self._begin(group)
        while self.to_row < end:
            batch = next(self.batches)
            self.to_row += batch.num_rows
            self.held.append(batch)
            while self.held and self.from_row + self.held[0].num_rows <= first:
                self.from_row += self.held.pop(0).num_rows
        return pa.Table.from_batches(self.held, self.held[0].schema).slice(first - self.from_row, end - first)


@lru_cache(maxsize=1)
def _reader(path: str, stamp: tuple[int, int]) -> _Reader:
    del stamp  # of the file that it has opened
    return _Reader(path)


CHANGED = "the table has changed while it was read"


@dataclass(frozen=True)
class HeldRows(BlockPart):
    """Rows of one table: where those of each rig end, the columns but the one that names rigs, and their units."""

    names: tuple[str, ...]
    source: str
    ends: tuple[int, ...]
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str | None]

    @property
    def sources(self) -> tuple[str, ...]:
        """The table, once for each rig."""
        return (self.source,) * len(self.names)

    def checksum(self) -> str:
        """Of all numbers and texts as well, their kinds and units."""
        contents = tuple(
            (name, str(values.dtype), hashlib.sha256(_bytes_of(values)).hexdigest())
            for name, values in self.columns.items()
        )
        return digest_of(self.names, self.source, self.ends, tuple(sorted(self.units.items())), contents)

    def loaded(self) -> HeldRows:
        """As it is."""
        return self

    def some(self, first: int, end: int) -> HeldRows:
        """Some of the rigs; columns are views."""
        skipped = self.ends[first - 1] if first else 0
        rows = slice(skipped, self.ends[end - 1])
        return HeldRows(
            self.names[first:end],
            self.source,
            tuple(row - skipped for row in self.ends[first:end]),
            _of_rows(self.columns, rows),
            self.units,
        )

    def data_sets(self) -> Iterator[DataSet]:
        """One for each rig; their columns are views."""
        for name, start, end in zip(self.names, (0, *self.ends[:-1]), self.ends, strict=True):
            yield DataSet(name, self.source, _of_rows(self.columns, slice(start, end)), self.units)


def _of_rows(columns: Mapping[str, np.ndarray], rows: slice) -> dict[str, np.ndarray]:
    """Some rows; of a column that holds texts elsewhere as numbers, where all of them are."""
    chosen = {name: values[rows] for name, values in columns.items()}
    for name, values in chosen.items():
        if values.dtype.kind == "O":
            with suppress(ValueError):
                chosen[name] = np.array([text or "nan" for text in values.tolist()], dtype=float)
    return chosen


def _bytes_of(values: np.ndarray) -> bytes:
    return values.tobytes() if values.dtype.kind in "fib" else repr(values.tolist()).encode()


@dataclass(frozen=True)
class ParquetRows(BlockPart):
    """Rows of a Parquet table by their places: the first of all, and where those of each rig end, counted from it.

    groups  number and checksum of each row group that they lie in
    stamp   of the file when these were taken: where it is another one, they are compared again
    """

    names: tuple[str, ...]
    source: str
    column: str
    first: int
    ends: tuple[int, ...]
    groups: tuple[tuple[int, str], ...]
    stamp: tuple[int, int]

    @property
    def sources(self) -> tuple[str, ...]:
        """The table, once for each rig."""
        return (self.source,) * len(self.names)

    def checksum(self) -> str:
        """Of the row groups, and which rows of them these are."""
        return digest_of(self.names, self.source, self.column, self.first, self.ends, self.groups)

    def loaded(self) -> HeldRows:
        """The rows read.  Raises DataError where the table cannot be read, or is not as its checksums say."""
        with readable(self.source):
            changed = stamp_of(self.source) != self.stamp
            if changed and any(group_checksum(self.source, k) != text for k, text in self.groups):
                raise DataError(CHANGED, self.source, "run again")
            table = rows_between(self.source, self.first, self.first + self.ends[-1])
            return HeldRows(
                self.names, self.source, self.ends, _columns(table, self.column), with_units(table.schema)
            )

    def data_sets(self) -> Iterator[DataSet]:
        """One for each rig, read first."""
        return self.loaded().data_sets()


def of_tables(paths: Sequence[str], column: str) -> Source:
    """The rows of tables (Parquet, CSV) of which a column names the rig, those of one rig together.

    Raises DataError where a table has no such column or is damaged, and where rows of one rig are not together.
    """
    seen: dict[str, tuple[str, int]] = {}
    tables: list[_Table] = []
    for path in paths:
        with readable(path):
            table = _opened(path, column)
        for name, start in zip(table.names, table.starts, strict=False):
            if name in seen:
                other, row = seen[name]
                again = (
                    f"begins in row {row + 1} and again in row {start + 1}"
                    if other == path
                    else f"begins in row {start + 1} and stands in {shown(other)} as well"
                )
                raise DataError(
                    f"{shown(name)} {again}: the rows of a rig are not together",
                    path,
                    f"sort the table by {column}, or give rigs names of their own",
                )
            seen[name] = path, start
        tables.append(table)

    def blocks(size: int) -> Iterator[tuple[BlockPart, ...]]:
        held: list[BlockPart] = []
        room = size
        for table in tables:
            with readable(table.path):
                for part in table.parts(_cuts_tables(len(table.names), room, size)):
                    held.append(part)
                    room -= len(part.names)
                    if not room:
                        yield tuple(held)
                        held, room = [], size
        if held:
            yield tuple(held)

    return Source(len(seen), blocks)


def _cuts_tables(count: int, room: int, size: int) -> list[tuple[int, int]]:
    """First and last (exclusive) of each part of `count` rigs: the first `room` of them, then `size` each."""
    starts = [0, *range(room, count, size)] if count else []
    return list(zip(starts, [*starts[1:], count], strict=True))


@contextmanager
def readable(path: str) -> Iterator[None]:
    """Raises DataError for whatever a reader of tables raises."""
    import pyarrow as pa

    try:
        yield
    except FileNotFoundError:
        raise DataError("there is no such file", path, "correct the path") from None
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(
            f"the table cannot be read ({shown(str(error), 150)})", path, "check the file"
        ) from None


# Where the rows of each rig stand


@dataclass(frozen=True)
class _Table(ABC):
    """A table: its rigs in order, and the row at which each begins, with the number of rows at the end."""

    path: str
    column: str
    names: tuple[str, ...]
    starts: tuple[int, ...]

    @abstractmethod
    def parts(self, cuts: Iterable[tuple[int, int]]) -> Iterator[BlockPart]:
        """The rigs from one number to another, cut after cut."""

    def ends(self, first: int, end: int) -> tuple[int, ...]:
        """Where the rows of some rigs end, counted from the first of them."""
        return tuple(row - self.starts[first] for row in self.starts[first + 1 : end + 1])


class _Parquet(_Table):
    def parts(self, cuts: Iterable[tuple[int, int]]) -> Iterator[BlockPart]:
        """References; the bytes of a row group are read for its checksum."""
        import pyarrow.parquet as parquet

        stamp = stamp_of(self.path)
        with parquet.ParquetFile(self.path) as file:
            sizes = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
        behind = np.cumsum(sizes)
        for first, end in cuts:
            of = np.searchsorted(behind, [self.starts[first], self.starts[end] - 1], side="right").tolist()
            groups = range(of[0], of[1] + 1)
            yield ParquetRows(
                self.names[first:end], self.path, self.column, self.starts[first], self.ends(first, end),
                tuple((k, group_checksum(self.path, k)) for k in groups), stamp,
            )  # fmt: skip


@dataclass(frozen=True)
class _Csv(_Table):
    """layout  how its rows are to be read"""

    layout: CsvLayout

    def parts(self, cuts: Iterable[tuple[int, int]]) -> Iterator[BlockPart]:
        """Rows, as the file is read.  Raises DataError where it is not what it was."""
        import pyarrow as pa

        coming = self.layout.batches()
        held: list[Any] = []
        reached = 0  # the row up to which the table is held
        for first, end in cuts:
            start, stop = self.starts[first], self.starts[end]
            while reached < stop:
                batch = next(coming, None)
                if batch is None:
                    raise DataError(CHANGED, self.path, "run again")
                held.append(batch)
                reached += batch.num_rows
            table = pa.Table.from_batches(held)
            skipped = table.num_rows - (reached - start)
            rows = table.slice(skipped, stop - start)
            ends = self.ends(first, end)
            if _runs(rows.column(self.column)) != (list(self.names[first:end]), [0, *ends[:-1]]):
                raise DataError(CHANGED, self.path, "run again")
            yield HeldRows(
                self.names[first:end], self.path, ends, _columns(rows, self.column), with_units(rows.schema)
            )
            held = table.slice(skipped + stop - start).to_batches()


def _opened(path: str, column: str) -> _Table:
    """The table with its names read.  Raises DataError where it has no such column, or a row without a name."""
    with open(noted(path), "rb") as file:
        start = file.read(4)
    if start == b"PAR1":
        return _Parquet(path, column, *_named_rows(path, column, _parquet_names(path, column)))
    if not start:
        raise DataError("the file is empty", path, "give a table, CSV or Parquet")
    layout = csv_layout(path, column)
    while True:
        try:
            return _Csv(path, column, *_named_rows(path, column, layout.batches()), layout)
        except NotNumbersError as text:
            layout = replace(layout, texts=layout.texts | {str(text)})


def _named_rows(path: str, column: str, coming: Iterable[Any]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Names of the rigs, and the row at which each begins, with the number of rows at the end."""
    names: list[str] = []
    starts: list[int] = []
    rows = 0
    for batch in coming:
        of_batch, places = _runs(batch.column(column))
        if "" in of_batch:
            row = rows + places[of_batch.index("")] + 1
            raise DataError(
                f"column {shown(column)}: row {row} does not name its rig", path, "name the rig of every row"
            )
        if names and of_batch and of_batch[0] == names[-1]:
            del of_batch[0], places[0]
        names += of_batch
        starts += [rows + place for place in places]
        rows += batch.num_rows
    if not rows:
        raise DataError("the table has no rows", path, "give the data of at least one rig")
    return tuple(names), (*starts, rows)


def _runs(column: Any) -> tuple[list[str], list[int]]:
    """Names that follow each other, and the row at which each begins."""
    import pyarrow as pa
    import pyarrow.compute as compute

    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if pa.types.is_dictionary(column.type):
        column = column.dictionary_decode()
    if not len(column):
        return [], []
    before, after = column.slice(0, len(column) - 1), column.slice(1)
    changes = compute.not_equal(after, before)
    if changes.null_count:
        changes = changes.fill_null(True)
    starts = np.concatenate([[0], 1 + np.flatnonzero(array_of(changes.cast(pa.uint8())))])
    values = column.take(arrow_table({"row": starts}).column(0)).to_pylist()
    texts = ("" if value is None else str(value) for value in values)
    names: list[str] = []
    places: list[int] = []
    for name, start in zip(texts, starts.tolist(), strict=True):
        if not names or name != names[-1]:  # gaps are each unlike the last
            names.append(name)
            places.append(start)
    return names, places


def _parquet_names(path: str, column: str) -> Iterator[Any]:
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(path) as content:
        require_columns(path, column, tuple(content.schema_arrow.names))
        yield from batches(content, columns=[column])


def _columns(table: Any, column: str) -> dict[str, np.ndarray]:
    """All columns but the one that names rigs."""
    return {name: _array(table.column(name)) for name in table.schema.names if name != column}


def _array(column: Any) -> np.ndarray:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_floating(kind) or (pa.types.is_integer(kind) and not column.null_count):
        values = array_of(column)
    elif pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind):
        values = column.cast(pa.float64()).to_numpy()
    else:
        values = np.array(["" if value is None else str(value) for value in column.to_pylist()], dtype=object)
    return values


# The amplitudes of a block's data sets: tables of many rigs read at once, and those measured alike as one
# batch.


AT_ONCE = 100  # rigs of a table, whose numbers stay in the cache


@dataclass(frozen=True)
class Cut:
    """The lines of one data set: some of the `whole` that was read, which `signature` describes."""

    whole: Spectrum
    first: int
    end: int
    signature: tuple[object, ...]

    def spectrum(self) -> Spectrum:
        """By itself."""
        if self.end - self.first == self.whole.lines:
            return self.whole
        return self.whole.select(np.arange(self.first, self.end))


@dataclass(frozen=True)
class PartReader:
    """Reads the data sets of a rig; `failed` is told of those that cannot be used, by their place in the part."""

    rig: Rig
    treatment: Treatment
    failed: Callable[[int, Exception], None]

    def cuts(self, part: BlockPart) -> dict[int, Cut]:
        """The lines of each data set by its place; rows of tables are read many at once."""
        if not isinstance(part, HeldRows):
            return self._one_by_one(part, 0)
        cuts: dict[int, Cut] = {}
        for first in range(0, len(part.names), AT_ONCE):
            cuts |= self._at_once(part, first, min(first + AT_ONCE, len(part.names)))
        return cuts

    def _at_once(self, rows: HeldRows, first: int, end: int) -> dict[int, Cut]:
        """Of some rigs of a table; where they cannot be read together, of each half of them."""
        some = rows.some(first, end)
        if end - first > 1:
            try:
                whole = self._lines_of_all(some)
            except Exception:  # of one of them, which is found and says so itself
                middle = (first + end) // 2
                return self._at_once(rows, first, middle) | self._at_once(rows, middle, end)
            if whole is not None:
                return dict(
                    zip(range(first, end), _cuts(whole, (0, *some.ends[:-1]), some.ends), strict=True)
                )
        return self._one_by_one(some, first)

    def _lines_of_all(self, rows: HeldRows) -> Spectrum | None:
        """The lines of all rigs one after the other; None where a rig's lines are not what each of them is alone."""
        columns = array_columns(rows.source, dict(rows.columns), dict(rows.units))
        if any(
            pair.to_radian is not None for pair in amplitude_columns(columns).values()
        ):  # phases are looked at from line to line
            return None
        content = interpret(columns, self.rig.channels, self._circumstances)
        if content.records or len(content.spectra) != 1:
            return None
        lines = content.spectra[0]
        if lines.lines != rows.ends[-1] or len(lines.stretches) > 1 or lines.records or not lines.complete:
            return None
        if "unknown" in lines.noise:  # it is sought in neighbouring lines
            return None
        return (
            lines if self.treatment.spectrum(self.rig, Reading((), lines, content.notes)) is lines else None
        )

    def _one_by_one(self, part: BlockPart, first: int) -> dict[int, Cut]:
        """Of data sets each read by itself, counted from `first`."""
        cuts: dict[int, Cut] = {}
        for k, data_set in enumerate(part.data_sets(), first):
            try:
                spectrum = self.treatment.spectrum(self.rig, self._reading(data_set))
            except Exception as error:  # a reader that fails on one file of a million must not stop the rest
                self.failed(k, error)
            else:
                cuts[k] = _cuts(spectrum, (0,), (spectrum.lines,))[0]
        return cuts

    def _reading(self, data_set: DataSet) -> Reading:
        """What one data set holds.  Raises DataError."""
        if not data_set.columns:
            return read(data_set.source, self.rig.channels, frequency_hz=self.treatment.frequency_hz)
        columns = array_columns(data_set.source, dict(data_set.columns), dict(data_set.units))
        content = interpret(columns, self.rig.channels, self._circumstances)
        lines = concatenate(content.spectra) if content.spectra else None
        return Reading(content.records, lines, content.notes, content.joint)

    @property
    def _circumstances(self) -> Circumstances:
        return Circumstances(self.treatment.frequency_hz, 0)


# Repeats of one test


def _cuts(whole: Spectrum, starts: Sequence[int], ends: Sequence[int]) -> list[Cut]:
    """The lines between these places, with all that those of a batch have in common, bit by bit."""
    silent = np.diagonal(whole.covariance, axis1=-2, axis2=-1) == 0
    arrays = (
        whole.frequency_hz, whole.samples, whole.dof, whole.experiment, whole.stretch,
        np.isfinite(whole.amplitudes), np.isnan(whole.covariance), silent,
    )  # fmt: skip
    shared = repr((whole.channels, whole.stretches, whole.moments is None))
    return [
        Cut(
            whole,
            start,
            end,
            (shared, whole.noise[start:end], *(array[start:end].tobytes() for array in arrays)),
        )
        for start, end in zip(starts, ends, strict=True)
    ]


def alike_cuts(cuts: Mapping[int, Cut]) -> list[list[int]]:
    """Which data sets can be repeats of one test: the same lines, measured alike.  Whole records never are."""
    groups: dict[object, list[int]] = {}
    for k, cut in cuts.items():
        groups.setdefault(k if cut.whole.records else cut.signature, []).append(k)
    return list(groups.values())


def stacked_cuts(cuts: Sequence[Cut]) -> Spectrum:
    """Cuts of one signature as one spectrum with a leading axis."""
    first = cuts[0].spectrum()
    moments = None
    if first.moments is not None:
        products = [(cut, cut.whole.moments.products) for cut in cuts if cut.whole.moments is not None]
        moments = Moments(np.stack([product[cut.first : cut.end] for cut, product in products]))
    amplitudes = np.stack([cut.whole.amplitudes[cut.first : cut.end] for cut in cuts])
    covariance = np.stack([cut.whole.covariance[cut.first : cut.end] for cut in cuts])
    amplitudes.setflags(write=False)
    covariance.setflags(write=False)
    return first.derived(amplitudes=amplitudes, covariance=covariance, moments=moments)
