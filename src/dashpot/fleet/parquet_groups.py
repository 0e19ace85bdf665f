"""Row groups of a Parquet table: their checksums, and rows read from them one block after the other."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from dashpot.io.ledger import noted

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
