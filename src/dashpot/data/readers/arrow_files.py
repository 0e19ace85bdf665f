"""Parquet and Feather (Arrow IPC) files: columns by their names; the unit is metadata `unit` of its field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from dashpot.data.readers.arrays import PIECE, ArrayColumns, Streamed
from dashpot.data.readers.datafile import DataFile
from dashpot.io.json_document import array_of
from dashpot.io.ledger import noted


def read_parquet(file: DataFile, parquet: Any) -> Iterator[ArrayColumns]:
    """The table; its columns are read when they are asked for."""
    content = parquet.ParquetFile(noted(file.path), pre_buffer=False)  # else whole columns are held
    schema, rows = content.schema_arrow, content.metadata.num_rows
    _check_unpacked(file, schema, rows)
    # 1 << 16: numbers of a file up to which it is read whole: column by column takes ten times as long
    if rows * len(schema.names) <= (1 << 16):
        with suppress(OSError, pa.ArrowException):  # of a column that may not be asked for
            yield _held(file, content.read(use_threads=False))
            return

    def batches(column: int) -> Iterator[Any]:
        for batch in content.iter_batches(batch_size=PIECE, columns=[schema.names[column]]):
            yield pa.chunked_array([batch.column(0)])

    yield _columns(file, schema, rows, batches)


def parquet_pieces(file: DataFile) -> Iterator[ArrayColumns]:
    """The table, some rows at a time, which are held."""
    import pyarrow.parquet as parquet

    content = parquet.ParquetFile(noted(file.path), pre_buffer=False)
    for batch in content.iter_batches(batch_size=PIECE):
        yield _held(file, pa.Table.from_batches([batch], content.schema_arrow))


def read_feather(file: DataFile, feather: Any) -> Iterator[ArrayColumns]:
    """The table; its columns are read when they are asked for, and the others neither read nor unpacked then."""
    if file.head.startswith(b"FEA1"):  # of before 2020
        yield _held(file, feather.read_table(noted(file.path)))
        return
    source = pa.memory_map(str(noted(file.path)))

    def batches(column: int) -> Iterator[Any]:
        content = pa.ipc.open_file(source, options=pa.ipc.IpcReadOptions(included_fields=[column]))
        for k in range(content.num_record_batches):
            yield pa.chunked_array([content.get_batch(k).column(0)])

    schema = pa.ipc.open_file(source).schema
    rows = sum(len(batch) for batch in batches(0)) if schema.names else 0
    _check_unpacked(file, schema, rows)
    yield _columns(file, schema, rows, batches)


def _check_unpacked(file: DataFile, schema: Any, rows: int) -> None:
    """Raises DataError if the numbers are more than the file may unpack to; texts have the limit of the process."""
    file.check_unpacked(rows * sum(pa.types.is_primitive(kind) for kind in schema.types) * 8)


def _held(file: DataFile, table: pa.Table) -> ArrayColumns:
    """All columns of a table that is held."""
    return _columns(file, table.schema, table.num_rows, lambda i: iter([table.column(i)]))


def _columns(file: DataFile, schema: Any, rows: int, pieces: Callable[[int], Iterator[Any]]) -> ArrayColumns:
    """All columns, each of which comes in pieces when it is asked for."""
    units = tuple(units_of(schema).values())
    columns = tuple(Streamed(rows, partial(_numbers, pieces, i)) for i in range(len(units)))
    return ArrayColumns(file.name, tuple(schema.names), units, (), rows, columns)


def units_of(schema: Any) -> dict[str, str | None]:
    """The unit of each column by name, None where its metadata say none."""
    said = {field.name: (field.metadata or {}).get(b"unit") for field in schema}
    return {name: unit and unit.decode("utf-8", errors="replace") for name, unit in said.items()}


def _numbers(pieces: Callable[[int], Iterator[Any]], column: int) -> Iterator[Any]:
    return map(array_of_column, pieces(column))


def array_of_column(column: Any) -> Any:
    """A column of numbers, moments or texts as an array; gaps of numbers are NaN."""
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        return array_of(column)
    if pa.types.is_decimal(column.type):
        return column.cast(pa.float64()).to_numpy()
    if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
        return column.to_numpy()
    return np.array(column.to_pylist(), dtype=object)
