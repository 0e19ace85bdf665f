"""Tables of many rigs, a column of which names the rig of each row; never held whole.

The process that shares work out reads the names alone.  Rows of Parquet tables are read by the workers, who are told
which; those of CSV, which have no places in the file, are read in passing and sent.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dashpot.errors import DataError
from dashpot.fleet.csv_rows import CsvLayout, NotNumbersError, csv_layout, require_columns
from dashpot.fleet.data_sets import BlockPart, DataSet, Source, digest_of
from dashpot.fleet.parquet_groups import batches, group_checksum, rows_between, stamp_of, with_units
from dashpot.io.arrow_arrays import array_of, arrow_table
from dashpot.io.ledger import noted
from dashpot.io.words import shown

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
                    f"{shown(name)} {again}: the rows of a rig are not together", path,
                    f"sort the table by {column}, or give rigs names of their own",
                )  # fmt: skip
            seen[name] = path, start
        tables.append(table)

    def blocks(size: int) -> Iterator[tuple[BlockPart, ...]]:
        held: list[BlockPart] = []
        room = size
        for table in tables:
            with readable(table.path):
                for part in table.parts(_cuts(len(table.names), room, size)):
                    held.append(part)
                    room -= len(part.names)
                    if not room:
                        yield tuple(held)
                        held, room = [], size
        if held:
            yield tuple(held)

    return Source(len(seen), blocks)


def _cuts(count: int, room: int, size: int) -> list[tuple[int, int]]:
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
