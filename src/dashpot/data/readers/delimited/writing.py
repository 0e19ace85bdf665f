"""Comma-separated files, written whole or not at all."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot.arrays import Real
from dashpot.io.atomic import write_bytes


def write_rows(
    path: str | os.PathLike[str], header: Sequence[str], columns: Sequence[Sequence[object] | Real]
) -> None:
    """Write a comma-separated file, numbers with all their digits, packed where the name ends in .gz.

    The file appears whole or not at all.  Raises DataError where it cannot be written.  columns (rows,) each.
    """
    arrays = [
        pa.array(np.asarray(c)) if isinstance(c, np.ndarray) else pa.array(c, pa.string()) for c in columns
    ]
    names = [f"c{i}" for i in range(len(arrays))]
    sink = pa.BufferOutputStream()
    pacsv.write_csv(
        pa.table(arrays, names=names), sink, pacsv.WriteOptions(include_header=False, quoting_style="none")
    )
    head = (",".join(_quoted(name) for name in header) + "\n").encode()
    parts = (head, memoryview(sink.getvalue()))
    write_bytes(path, _packed(parts) if Path(path).suffix == ".gz" else parts)


def _packed(parts: Iterable[bytes | memoryview]) -> Iterator[bytes]:
    """Packed as gzip, without name and time, so that the same data give the same bytes."""
    packer = zlib.compressobj(9, wbits=31)
    for part in parts:
        yield packer.compress(part)
    yield packer.flush()


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n\r') else name
