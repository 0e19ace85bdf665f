"""Parquet and Feather (Arrow IPC) files."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from dashpot.data.readers.arrays import LONG, PIECE, ArrayColumns, Streamed
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import guarded
from dashpot.data.readers.optional import damaged
from dashpot.io.json_document import array_of
from dashpot.io.ledger import noted

SMALL = 1 << 16  # numbers of a file up to which it is read whole: column by column takes ten times as long


@dataclass(frozen=True)
class ParquetReader:
    """Columns by their names; each is read when it is asked for.  The unit is metadata `unit` of its field."""

    format: str = "Parquet"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head.startswith(b"PAR1")

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The table."""
        return guarded(file, lambda: self._parts(file))

    def _parts(self, file: DataFile) -> Generator[ArrayColumns]:
        import pyarrow.parquet as pq

        with damaged(file.name, self.format):
            content = pq.ParquetFile(noted(file.path), pre_buffer=False)  # else whole columns are held
            schema, rows = content.schema_arrow, content.metadata.num_rows
            _check_unpacked(file, schema, rows)
            source = file.name
            loads = tuple(partial(_parquet_column, content, field, source) for field in schema)
            if rows * len(schema.names) <= SMALL:
                with suppress(OSError, pa.ArrowException):  # of a column that may not be asked for
                    table = content.read(use_threads=False)
                    loads = tuple(partial(_numpy, table.column(i)) for i in range(table.num_columns))
            yield _columns(file, schema, rows, loads)


@dataclass(frozen=True)
class FeatherReader:
    """Columns by their names.  The unit is metadata `unit` of its field."""

    format: str = "Feather"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head.startswith((b"ARROW1", b"FEA1"))

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The table."""
        return guarded(file, lambda: self._parts(file))

    def _parts(self, file: DataFile) -> Generator[ArrayColumns]:
        with damaged(file.name, self.format):
            if file.head.startswith(b"FEA1"):  # of before 2020
                import pyarrow.feather as feather

                table = feather.read_table(noted(file.path))
                loads = tuple(partial(_numpy, table.column(i)) for i in range(table.num_columns))
                yield _columns(file, table.schema, table.num_rows, loads)
                return
            batches = _batch_reader(file)
            rows = sum(len(batch) for batch in _feather_batches(file, 0)) if batches.schema.names else 0
            _check_unpacked(file, batches.schema, rows)
            loads = tuple(partial(_feather_column, file, i, rows) for i in range(len(batches.schema)))
            yield _columns(file, batches.schema, rows, loads)


def _batch_reader(file: DataFile, *columns: int) -> Any:
    """Of all columns, or of the numbered ones alone: the others are neither read nor unpacked."""
    options = pa.ipc.IpcReadOptions(included_fields=list(columns))
    return pa.ipc.open_file(pa.memory_map(str(noted(file.path))), options=options)


def _feather_batches(file: DataFile, index: int) -> Iterator[Any]:
    with damaged(file.name, "Feather"):
        batches = _batch_reader(file, index)
        for k in range(batches.num_record_batches):
            yield batches.get_batch(k).column(0)


def _feather_column(file: DataFile, index: int, rows: int) -> Any:
    with damaged(file.name, "Feather"):
        kind = _batch_reader(file).schema.field(index).type
        if rows >= LONG and (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            return Streamed(
                rows, lambda: (_numpy(pa.chunked_array([x])) for x in _feather_batches(file, index))
            )
        return _numpy(pa.chunked_array(list(_feather_batches(file, index)), type=kind))


def _check_unpacked(file: DataFile, schema: Any, rows: int) -> None:
    """Raises DataError where the numbers are more than the file may unpack to; texts have the limit of the process."""
    file.check_unpacked(rows * sum(pa.types.is_primitive(kind) for kind in schema.types) * 8)


def _columns(file: DataFile, schema: Any, rows: int, loads: tuple[Any, ...]) -> ArrayColumns:
    units = []
    for field in schema:
        unit = (field.metadata or {}).get(b"unit")
        units.append(None if unit is None else unit.decode("utf-8", errors="replace"))
    return ArrayColumns(file.name, tuple(schema.names), tuple(units), (), rows, loads)


def _parquet_column(content: Any, field: Any, source: str) -> Any:
    name, kind = field.name, field.type
    with damaged(source, "Parquet"):
        if content.metadata.num_rows >= LONG and (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            return Streamed(content.metadata.num_rows, partial(_batches, content, name, source))
        return _numpy(content.read([name]).column(0))


def _batches(content: Any, name: str, source: str) -> Iterator[Any]:
    with damaged(source, "Parquet"):
        for batch in content.iter_batches(batch_size=PIECE, columns=[name]):
            yield _numpy(pa.chunked_array([batch.column(0)]))


def _numpy(column: Any) -> Any:
    """A column as an array; gaps are NaN."""
    if pa.types.is_floating(column.type) or (pa.types.is_integer(column.type) and not column.null_count):
        return array_of(column)
    if pa.types.is_integer(column.type) or pa.types.is_decimal(column.type):
        return column.cast(pa.float64()).to_numpy()
    if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
        return column.to_numpy()
    return np.array(column.to_pylist(), dtype=object)
