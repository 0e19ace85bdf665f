"""Blocks and tables on disk: Parquet files that are there whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes

WIDE = ("values", "sd", "half")  # one column an unknown


def write_block(path: Path, block: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """A block's repeats, method after method, one row a repeat.  Raises DataError where it cannot be written."""
    columns: dict[str, Any] = {
        "method": np.concatenate([np.full(len(own["p"]), name) for name, own in block.items()])
    }
    for name in ("converged", "p"):
        columns[name] = np.concatenate([own[name] for own in block.values()])
    for name in WIDE:
        wide = np.concatenate([own[name] for own in block.values()])
        columns |= {f"{name}_{i}": np.ascontiguousarray(wide[:, i]) for i in range(wide.shape[1])}
    write_table(path, columns)


def read_block(path: Path, unknowns: int) -> dict[str, dict[str, np.ndarray]]:
    """What `write_block` wrote, by method.  Raises DataError where the file is not whole."""
    import pyarrow.parquet as parquet

    try:
        table = parquet.read_table(path, use_threads=False)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        names = columns["method"]
        found = {}
        for name in dict.fromkeys(names.tolist()):
            rows = names == name
            found[str(name)] = {
                **{key: columns[key][rows] for key in ("converged", "p")},
                **{
                    key: np.stack([columns[f"{key}_{i}"][rows] for i in range(unknowns)], axis=-1)
                    for key in WIDE
                },
            }
        return found
    except (OSError, KeyError, ValueError) as error:  # pyarrow's own errors are kinds of these
        raise DataError(
            "this block of a study cannot be read", str(path), "delete it and run the study again"
        ) from error


def sound(path: Path, rows: int) -> bool:
    """Whether a block of so many rows is there and whole."""
    import pyarrow.parquet as parquet

    if not path.is_file():
        return False
    try:
        found: int = parquet.read_metadata(path).num_rows
    except (OSError, ValueError):
        return False
    return found == rows


def write_table(path: Path, columns: Mapping[str, Sequence[Any] | np.ndarray]) -> None:
    """A Parquet file of named columns; it takes its place when it is whole.  Raises DataError."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    sink = pa.BufferOutputStream()
    parquet.write_table(pa.table(dict(columns)), sink, compression="zstd", write_statistics=False)
    write_bytes(path, sink.getvalue().to_pybytes())
