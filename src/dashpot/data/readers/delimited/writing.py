"""Comma-separated files, written whole or not at all."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot.arrays import Real
from dashpot.io.atomic import write_bytes

# How a formula begins in spreadsheets, and apostrophes before it, of which reading takes one away
_FORMULA = re.compile(r"'*[=+\-@\t\r].", re.DOTALL)
_QUOTED = set(',"\n\r')
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)")


def write_rows(
    path: str | os.PathLike[str], header: Sequence[str], columns: Sequence[Sequence[object] | Real]
) -> None:
    """Write a comma-separated file, numbers with all their digits, packed where the name ends in .gz.

    The file appears whole or not at all.  Raises DataError where it cannot be written.  columns (rows,) each.
    """
    arrays = [
        pa.array(np.asarray(c))
        if isinstance(c, np.ndarray)
        else pa.array([_safe(str(x)) for x in c], pa.string())
        for c in columns
    ]
    names = [f"c{i}" for i in range(len(arrays))]
    sink = pa.BufferOutputStream()
    # Arrow quotes every text of a table or none.
    quoted = any(_QUOTED & set(text) for c in arrays if pa.types.is_string(c.type) for text in c.to_pylist())
    options = pacsv.WriteOptions(include_header=False, quoting_style="needed" if quoted else "none")
    pacsv.write_csv(pa.table(arrays, names=names), sink, options)
    head = (",".join(_cell(name) for name in header) + "\n").encode()
    parts = (head, memoryview(sink.getvalue()))
    write_bytes(path, _packed(parts) if Path(path).suffix == ".gz" else parts)


def _packed(parts: Iterable[bytes | memoryview]) -> Iterator[bytes]:
    """Packed as gzip, without name and time, so that the same data give the same bytes."""
    packer = zlib.compressobj(9, wbits=31)
    for part in parts:
        yield packer.compress(part)
    yield packer.flush()


def _cell(text: str) -> str:
    """The text as one cell, in quotes where it must be."""
    text = _safe(text)
    return '"' + text.replace('"', '""') + '"' if _QUOTED & set(text) else text


def _safe(text: str) -> str:
    """The text with an apostrophe before what a spreadsheet takes for a formula; numbers stay as they are."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def name_in(text: str) -> str:
    """The name that was written, without the apostrophe before a formula."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text
