"""Columns of Arrow as arrays of NumPy, and back.

Arrow's own conversions load pandas, which takes a fourth of a second in every process that has no other use for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def array_of(column: Any) -> np.ndarray:
    """An Arrow column of numbers as an array of their kind, read-only where it is shared; gaps are NaN."""
    import pyarrow as pa

    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    plain = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
    if not plain or column.null_count or not chunks:
        array: np.ndarray = pa.chunked_array(chunks, column.type).to_numpy()
        return array
    arrays = [np.from_dlpack(chunk) for chunk in chunks]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def arrow_table(columns: Mapping[str, Sequence[Any] | np.ndarray]) -> Any:
    """An Arrow table of named columns, in which NaN stays a number."""
    import pyarrow as pa

    return pa.Table.from_arrays([_column_of(values) for values in columns.values()], names=list(columns))


def _column_of(values: Sequence[Any] | np.ndarray) -> Any:
    import pyarrow as pa

    if isinstance(values, np.ndarray) and values.ndim == 1:
        if values.dtype in (np.float64, np.int64):
            kind = pa.float64() if values.dtype == np.float64 else pa.int64()
            return pa.Array.from_buffers(kind, len(values), [None, _buffer(values)])
        if values.dtype == np.bool_:
            bits = np.packbits(values, bitorder="little")
            return pa.Array.from_buffers(pa.bool_(), len(values), [None, _buffer(bits)])
    words = values.tolist() if isinstance(values, np.ndarray) else values
    if len(words) and all(type(word) is str for word in words):
        return _texts(words)
    return pa.array(values)


def _texts(values: Sequence[str]) -> Any:
    import pyarrow as pa

    encoded = [value.encode() for value in values]
    ends = np.cumsum([0, *map(len, encoded)])
    if ends[-1] > np.iinfo(np.int32).max:
        return pa.array(values)
    data = pa.py_buffer(b"".join(encoded))
    return pa.Array.from_buffers(pa.string(), len(values), [None, _buffer(ends.astype(np.int32)), data])


def _buffer(values: np.ndarray) -> Any:
    import pyarrow as pa

    return pa.py_buffer(np.ascontiguousarray(values))
