"""The data sets of a fleet: files, or the rows of tables in which a column names the rig; never held whole.

The process that shares work out reads names alone.  Files, and rows of Parquet tables, are read by the workers, who are
told which; rows of CSV tables, which have no places in the file, are read in passing and sent.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.readers import Reading
from dashpot.data.readers.arrow_files import array_of_column, units_of
from dashpot.data.readers.datafile import PIECE
from dashpot.data.readers.manifest import files_fitting, is_pattern
from dashpot.data.readers.text import TextTable, open_table
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.estimate.identify import amplitudes_for
from dashpot.estimate.registry import method_class
from dashpot.io.json_document import array_of, arrow_table
from dashpot.io.ledger import noted
from dashpot.io.words import choose_from, shown
from dashpot.model.rigfile import Rig
from dashpot.study.blocks import digest_of_columns, fingerprint_of

ROWS = 1 << 16  # of a Parquet table that are decoded at a time
CHANGED = "the table has changed while it was read"
Order = Literal["name", "time", "given"]


@dataclass(frozen=True)
class Treatment:
    """How every data set of a fleet is treated: its method, conditioning of time records.

    method  None is what `identify` does by itself: the method that suits, and a search from many starts where that may
            have ended in another minimum.  One that is named takes all data sets that are alike as one batch.
    """

    method: str | None = None
    conditioning: Conditioning = field(default_factory=Conditioning)
    frequency_hz: float | None = None
    positive: bool = False
    seed: int = 0

    def spectrum(self, rig: Rig, reading: Reading) -> Spectrum:
        """The amplitudes of a data set; what its manifest says of conditioning counts first.

        Raises DataError if its samples cannot be used, UsageError if there is no such method.
        """
        methods = [] if self.method is None else [method_class(self.method).traits]
        return amplitudes_for(rig.model, reading, self.conditioning.changed(**reading.conditioning), methods)


@dataclass(frozen=True)
class DataSet:
    """What was measured on one rig of a fleet.

    name      of the data set, in results
    source    the file
    columns, units  rows of a table by column, and the units that the file gives them; none where the file is the set
    """

    name: str
    source: str
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    units: Mapping[str, str | None] = field(default_factory=dict)


def expanded(patterns: Iterable[str], order: Order = "name") -> list[str]:
    """Files that names and patterns (data/*.parquet, ** for folders within) lead to, each once.

    In the order of their names, numbers in them counted as such (run2 before run10), of the time when they were last
    changed, or as given.  Raises UsageError if a name leads to nothing, DataError as `files_fitting`.
    """
    files: dict[str, None] = {}
    for pattern in patterns:
        if not is_pattern(pattern) and not os.path.exists(pattern):
            raise UsageError("there is no such file", pattern, "correct the name or the folder")
        found = sorted(files_fitting(pattern), key=natural) if is_pattern(pattern) else [pattern]
        files.update(dict.fromkeys(found))
    if order == "name":
        return sorted(files, key=natural)
    if order == "time":
        return sorted(files, key=lambda path: (_time_of(path), natural(path)))
    return list(files)


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts texts with the numbers in them as numbers."""
    parts = re.split(r"(\d+)", text)
    return tuple((1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts)


def _time_of(path: str) -> float:
    try:
        return os.stat(path).st_mtime
    except OSError:
        return 0.0  # its reader will say what is wrong with it


# A file each.


@dataclass(frozen=True)
class Files:
    """Files that are a data set each, with the checksums of their contents, or the reason why there is none."""

    names: tuple[str, ...]
    contents: tuple[str, ...]

    def checksum(self) -> str:
        """Of all files."""
        return fingerprint_of((self.names, self.contents))

    def data_sets(self) -> Iterator[DataSet]:
        """One for each file, which its reader reads."""
        return (DataSet(path, path) for path in self.names)


# Rows of a table.


@dataclass(frozen=True)
class HeldRows:
    """Rows of one table: where those of each rig end, the columns but the one that names rigs, and their units."""

    names: tuple[str, ...]
    source: str
    ends: tuple[int, ...]
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str | None]

    def checksum(self) -> str:
        """Of all numbers and texts as well, their kinds and units."""
        contents = digest_of_columns(self.columns)
        return fingerprint_of((self.names, self.source, self.ends, self.units, contents))

    def some(self, first: int, end: int) -> HeldRows:
        """Some of the rigs; columns are views."""
        skipped = self.ends[first - 1] if first else 0
        rows = slice(skipped, self.ends[end - 1])
        ends = tuple(row - skipped for row in self.ends[first:end])
        return replace(self, names=self.names[first:end], ends=ends, columns=_of_rows(self.columns, rows))

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
                cells = ["nan" if cell in (None, "") else cell for cell in values.tolist()]
                chosen[name] = np.array(cells, dtype=float)
    return chosen


@dataclass(frozen=True)
class ParquetRows:
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

    def checksum(self) -> str:
        """Of the row groups, and which rows of them these are."""
        return fingerprint_of((self.names, self.source, self.column, self.first, self.ends, self.groups))

    def loaded(self) -> HeldRows:
        """The rows read.  Raises DataError if the table cannot be read, or is not as its checksums say."""
        with readable(self.source):
            stamp = stamp_of(self.source)
            if stamp != self.stamp and any(
                group_checksum(self.source, k, stamp) != text for k, text in self.groups
            ):
                raise DataError(CHANGED, self.source, "run again")
            table = _row_groups(self.source, stamp).between(self.first, self.first + self.ends[-1])
            return held_rows(self.names, self.source, self.ends, table, self.column)


BlockPart = Files | HeldRows | ParquetRows  # neighbouring data sets: what a worker is sent


@dataclass(frozen=True)
class Source:
    """Where data sets come from: how many there are, and a function that yields blocks of so many, each of parts."""

    count: int
    blocks: Callable[[int], Iterator[tuple[BlockPart, ...]]]


def of_files(paths: Sequence[str]) -> Source:
    """Every file a data set of its own; one that cannot be read is one too."""

    def blocks(size: int) -> Iterator[tuple[BlockPart, ...]]:
        for first in range(0, len(paths), size):
            some = tuple(paths[first : first + size])
            yield (Files(some, tuple(_checksum(path) for path in some)),)

    return Source(len(paths), blocks)


def _checksum(path: str) -> str:
    try:
        with open(noted(path), "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError) as error:
        return f"unreadable: {error}"


# Tables: their rigs in order, and the row at which each begins.


def of_tables(paths: Sequence[str], column: str) -> Source:
    """The rows of tables (Parquet, CSV) in which a column names the rig, those of one rig together.

    Raises DataError if a table has no such column or is damaged, and where rows of one rig are not together.
    """
    seen: dict[str, tuple[str, int]] = {}
    tables: list[RigTable] = []
    for path in paths:
        with readable(path):
            table = _opened(path, column)
        for name, start in zip(table.names, table.starts, strict=False):
            if name in seen:
                other, row = seen[name]
                again = (
                    f"begins in row {row + 1} and again in row {start + 1}"
                    if other == path
                    else f"begins in row {start + 1} and is in {shown(other)} as well"
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
                count = len(table.names)
                starts = [0, *range(room, count, size)]  # the first `room` rigs, then `size` each
                for part in table.parts(zip(starts, [*starts[1:], count], strict=True)):
                    held.append(part)
                    room -= len(part.names)
                    if not room:
                        yield tuple(held)
                        held, room = [], size
        if held:
            yield tuple(held)

    return Source(len(seen), blocks)


@contextmanager
def readable(path: str) -> Iterator[None]:
    """Raises DataError for whatever a reader of tables raises."""
    try:
        yield
    except FileNotFoundError:
        raise DataError("there is no such file", path, "correct the path") from None
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(
            f"the table cannot be read ({shown(str(error), 150)})", path, "check the file"
        ) from None


@dataclass(frozen=True)
class RigTable:
    """A table: its rigs in order, and the row at which each begins, with the number of rows at the end.

    text    the rows of a CSV table, None for a Parquet table
    stamp   of the file when the names were read
    """

    path: str
    column: str
    names: tuple[str, ...]
    starts: tuple[int, ...]
    text: TextRows | None
    stamp: tuple[int, int]

    def parts(self, cuts: Iterable[tuple[int, int]]) -> Iterator[BlockPart]:
        """The rigs from one number to another, cut after cut; of a Parquet table where they stand, of CSV their rows.

        Raises DataError if the table is not what it was.
        """
        stamp = stamp_of(self.path)
        if stamp != self.stamp:
            raise DataError(CHANGED, self.path, "run again")
        rows = None if self.text is None else _Rows(self.path, self.text.batches(), 0)
        begins = _row_groups(self.path, stamp).begins if rows is None else ()
        for first, end in cuts:
            names, start, stop = self.names[first:end], self.starts[first], self.starts[end]
            ends = tuple(row - start for row in self.starts[first + 1 : end + 1])
            if rows is None:
                of = np.searchsorted(begins, [start, stop - 1], side="right").tolist()
                groups = tuple((k, group_checksum(self.path, k, stamp)) for k in range(of[0] - 1, of[1]))
                yield ParquetRows(names, self.path, self.column, start, ends, groups, stamp)
                continue
            held = rows.between(start, stop)
            if _runs(held.column(self.column)) != (list(names), [0, *ends[:-1]]):
                raise DataError(CHANGED, self.path, "run again")
            yield held_rows(names, self.path, ends, held, self.column)


def _opened(path: str, column: str) -> RigTable:
    """The table with its names read.  Raises DataError if it has no such column, or a row without a name."""
    stamp = stamp_of(path)
    with open(noted(path), "rb") as file:
        start = file.read(4)
    if start == b"PAR1":
        content = _row_groups(path, stamp).file
        require_columns(path, column, tuple(content.schema_arrow.names))
        coming = batches(content, columns=[column])
        return RigTable(path, column, *_named_rows(path, column, coming), None, stamp)
    table = open_table(path, "")
    require_columns(path, column, table.header)
    rows = TextRows(table, frozenset([table.header.index(column)]))
    while True:
        try:
            return RigTable(path, column, *_named_rows(path, column, rows.batches()), rows, stamp)
        except NotNumbersError as error:
            rows = replace(rows, texts=rows.texts | set(error.args))


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
                f"column {shown(column)}: row {row} names no rig", path, "name the rig of every row"
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


def held_rows(names: tuple[str, ...], path: str, ends: tuple[int, ...], table: Any, column: str) -> HeldRows:
    """The rows of an Arrow table, in which a column names the rigs."""
    others = [name for name in table.schema.names if name != column]
    columns = {name: array_of_column(table.column(name)) for name in others}
    return HeldRows(names, path, ends, columns, units_of(table.schema))


# Row groups of a Parquet table: their checksums, and rows read from them one block after the other.


def stamp_of(path: str) -> tuple[int, int]:
    """Size of a file, and when it was changed."""
    state = os.stat(path)
    return state.st_size, state.st_mtime_ns


@lru_cache(maxsize=16)
def group_checksum(path: str, number: int, stamp: tuple[int, int]) -> str:
    """Of the bytes of a row group's columns, with what they are decoded by; read once while the file is the same."""
    file = _row_groups(path, stamp).file
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
    """Rows of a ParquetFile from a row group on, some at a time; one iterator over all would hold what it decodes."""
    for number in range(first_group, file.num_row_groups):
        yield from file.iter_batches(ROWS, row_groups=[number], columns=columns, use_threads=False)


class _Rows:
    """Rows of a table, read batch by batch from some row on; the batches that the last rows lay in are held."""

    def __init__(self, path: str, coming: Iterator[Any], row: int) -> None:
        self.path, self.coming = path, coming
        self.held: list[Any] = []
        self.from_row = self.to_row = row

    def between(self, first: int, end: int) -> Any:
        """An Arrow table of the rows from `first` on, before `end`.  Raises DataError if there are no more."""
        while self.to_row < end:
            batch = next(self.coming, None)
            if batch is None:
                raise DataError(CHANGED, self.path, "run again")
            self.to_row += batch.num_rows
            self.held.append(batch)
            while self.held and self.from_row + self.held[0].num_rows <= first:
                self.from_row += self.held.pop(0).num_rows
        return pa.Table.from_batches(self.held, self.held[0].schema).slice(first - self.from_row, end - first)


class _RowGroups:
    """A Parquet table that is read by places.

    Blocks of one process follow each other, so that it goes on where it was: of a row group, however long, little is
    held and every row is decoded once.
    """

    def __init__(self, path: str) -> None:
        import pyarrow.parquet as parquet

        self.path, self.file = path, parquet.ParquetFile(path)
        groups = self.file.metadata
        self.begins = np.cumsum([0, *(groups.row_group(k).num_rows for k in range(groups.num_row_groups))])
        self.rows = _Rows(path, batches(self.file), 0)

    def between(self, first: int, end: int) -> Any:
        """An Arrow table of the rows from `first` on, before `end`."""
        group = int(np.searchsorted(self.begins, first, side="right")) - 1
        if first < self.rows.from_row or self.rows.to_row < self.begins[group]:
            self.rows = _Rows(self.path, batches(self.file, group), int(self.begins[group]))
        return self.rows.between(first, end)


@lru_cache(maxsize=1)
def _row_groups(path: str, stamp: tuple[int, int]) -> _RowGroups:
    del stamp  # of the file that it has opened
    return _RowGroups(path)


# Rows of CSV tables of many rigs, read as they come.


@dataclass(frozen=True)
class TextRows:
    """A table in text, and the places of those columns that are to be read as texts: 007 is the name of a rig."""

    table: TextTable
    texts: frozenset[int]

    def batches(self) -> Iterator[Any]:
        """The rows, some at a time.  Raises DataError, with the line, if they cannot be taken apart."""
        import pyarrow.csv as text

        names, units = self.table.header, self.table.units or [None] * len(self.table.header)
        # Kinds are stated, for pyarrow would hold a column for whole numbers that begins with some.
        kinds = {i: pa.string() if i in self.texts else pa.float64() for i in range(len(names))}
        said = [None if unit is None else {"unit": unit} for unit in units]
        schema = pa.schema(map(pa.field, names, kinds.values(), [True] * len(names), said))
        try:
            for batch in self.table.batches(kinds, text.ConvertOptions().null_values):
                yield pa.RecordBatch.from_arrays(batch.columns, schema=schema)
        except (pa.ArrowException, UnicodeDecodeError) as error:
            told = re.match(r"In CSV column #(\d+):.*CSV conversion error", str(error))
            if told is not None and int(told[1]) not in self.texts:
                raise NotNumbersError(int(told[1])) from None
            raise self.table.diagnosis() from None


class NotNumbersError(Exception):
    """A column holds more than numbers: its place."""


def require_columns(path: str, column: str, names: tuple[str, ...]) -> None:
    """Raises DataError if the column that names rigs is missing, or one is named twice."""
    if column not in names:
        what = f"column {shown(column)}: missing (it should name the rig)"
        raise DataError(what, path, choose_from(names))
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise DataError(f"column {shown(twice)}: named twice", path, "rename one of them")
