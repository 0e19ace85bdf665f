"""Parquet and Feather (Arrow IPC) files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from dashpot.data.readers.array_columns import LONG, PIECE, ArrayColumns, Streamed
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.optional import damaged
from dashpot.io.ledger import noted


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
        import pyarrow.parquet as pq

        with damaged(file.name, self.format):
            content = pq.ParquetFile(_source(file))
            schema = content.schema_arrow
            loads = tuple(partial(_parquet_column, content, name, file.name) for name in schema.names)
            yield _columns(file, schema, content.metadata.num_rows, loads)


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
        import pyarrow.feather as feather

        with damaged(file.name, self.format):
            table = feather.read_table(_source(file), memory_map=not file.packed)
            loads = tuple(partial(_array, table, i, file.name) for i in range(table.num_columns))
            yield _columns(file, table.schema, table.num_rows, loads)


def _source(file: DataFile) -> Any:
    """What pyarrow reads from: the file itself, or the unpacked bytes."""
    return pa.BufferReader(file.contents) if file.packed else str(noted(file.path))


def _columns(file: DataFile, schema: Any, rows: int, loads: tuple[Any, ...]) -> ArrayColumns:
    units = []
    for field in schema:
        unit = (field.metadata or {}).get(b"unit")
        units.append(None if unit is None else unit.decode("utf-8", errors="replace"))
    return ArrayColumns(file.name, tuple(schema.names), tuple(units), (), rows, loads)


def _parquet_column(content: Any, name: str, source: str) -> Any:
    with damaged(source, "Parquet"):
        kind = content.schema_arrow.field(name).type
        if content.metadata.num_rows >= LONG and (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            return Streamed(content.metadata.num_rows, partial(_batches, content, name, source))
        return _numpy(content.read([name]).column(0))


def _batches(content: Any, name: str, source: str) -> Iterator[Any]:
    with damaged(source, "Parquet"):
        for batch in content.iter_batches(batch_size=PIECE, columns=[name]):
            yield _numpy(pa.chunked_array([batch.column(0)]))


def _array(table: Any, index: int, source: str) -> Any:
    with damaged(source, "Feather"):
        column = table.column(index)
        if len(column) >= LONG and (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            starts = range(0, len(column), PIECE)
            return Streamed(len(column), lambda: (_numpy(column.slice(at, PIECE)) for at in starts))
        return _numpy(column)


def _numpy(column: Any) -> Any:
    """A column as an array; gaps are NaN."""
    if pa.types.is_floating(column.type) or (pa.types.is_integer(column.type) and not column.null_count):
        return column.to_numpy()
    if pa.types.is_integer(column.type) or pa.types.is_decimal(column.type):
        return column.cast(pa.float64()).to_numpy()
    if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
        return column.to_numpy()
    return np.array(column.to_pylist(), dtype=object)
