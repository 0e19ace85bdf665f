"""JSON as dashpot writes and reads it: UTF-8, indented by one, and null for what is not a finite number."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from dashpot.errors import UsageError

# Libraries that only some uses need: imported when they are asked for, with an error that names the extra.


def optional_library(module: str, extra: str, purpose: str) -> Any:
    """An optional module.  Raises UsageError that names the extra where it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        raise UsageError(
            f"{purpose} needs {module.partition('.')[0]}, which is not installed",
            cure=f'install it: pip install ".[{extra}]" from the copy of dashpot',
        ) from None


def data_frame(columns: Mapping[str, Any], index: str) -> Any:
    """A pandas DataFrame of columns, one of which is its index.  Raises UsageError without pandas."""
    pandas = optional_library("pandas", "analysis", "to_dataframe")
    return pandas.DataFrame(dict(columns)).set_index(index)


# Columns of Arrow as arrays of NumPy, and back.
#
# Arrow's own conversions load pandas, which takes a fourth of a second in every process that has no other
# use for it.


def array_of(column: Any) -> np.ndarray:
    """An Arrow column of numbers as an array of their kind, read-only where it is shared; gaps are NaN."""
    import pyarrow as pa

    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    plain = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
    if not plain or column.null_count or not chunks:
        return pa.chunked_array(chunks, column.type).to_numpy()
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
        encoded = [value.encode() for value in words]
        ends = np.cumsum([0, *map(len, encoded)])
        if ends[-1] > np.iinfo(np.int32).max:
            return pa.array(words)
        data = pa.py_buffer(b"".join(encoded))
        return pa.Array.from_buffers(pa.string(), len(words), [None, _buffer(ends.astype(np.int32)), data])
    return pa.array(values)


def _buffer(values: np.ndarray) -> Any:
    import pyarrow as pa

    return pa.py_buffer(np.ascontiguousarray(values))


def to_json(content: object) -> str:
    """The text of a JSON file.  Takes NumPy's numbers and arrays; NaN and infinities, which JSON has not, are null."""
    return json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def from_json(text: str | bytes) -> Any:
    """The content of a JSON text.  Raises ValueError if it is none.

    NaN and infinities, which other programs write, are read as such: whoever wants a number says where one is missing.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists or tables are nested too deep") from None


def nullable(value: float | None, missing: float = math.nan) -> float:
    """A number that may be null, which stands for `missing`."""
    return missing if value is None else float(value)


def numbers_of(values: Sequence[float | None], missing: float = math.nan) -> np.ndarray:
    """Numbers some of which may be null, (values,)."""
    return np.array([nullable(value, missing) for value in values])


def _plain(content: object) -> object:
    match content:
        case np.generic() | np.ndarray():
            return _plain(content.tolist())
        case float() if not math.isfinite(content):
            return None
        case Mapping():
            return {key: _plain(value) for key, value in content.items()}
        case list() | tuple():
            return [_plain(value) for value in content]
    return content
