"""Blocks and tables on disk: Parquet files that are there whole or not at all.

A block says what it is of (its Label) and carries a digest of its numbers beside the page checksums of Parquet, so that
flipped bits, blocks of another place and blocks of another study or version are seen when it is read.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes
from dashpot.io.json_document import array_of, arrow_table

# Fingerprints: digests of values of which every bit counts and no order that means nothing.


def fingerprint_of(value: object) -> str:
    """SHA-256 of the canonical form of a value: equal values have equal ones, whoever computes them.

    Raises TypeError for a value that has no canonical form.
    """
    return hashlib.sha256(json.dumps(_canonical(value)).encode()).hexdigest()


def fields_of(value: object) -> list[tuple[str, object]]:
    """Names and values of a dataclass's fields."""
    assert is_dataclass(value)
    return [(field.name, getattr(value, field.name)) for field in fields(value)]


def _canonical(value: object) -> object:
    """A value as JSON of which every bit counts and no order that means nothing: equal values give equal texts."""
    if isinstance(value, Enum):
        return _canonical(value.value)
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [str(array.dtype), list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]
    if is_dataclass(value):
        return {name: _canonical(content) for name, content in fields_of(value)}
    if isinstance(value, Mapping):
        return {str(key): _canonical(value[key]) for key in sorted(value)}
    if isinstance(value, frozenset | set):
        return [_canonical(entry) for entry in sorted(value)]
    if isinstance(value, tuple | list):
        return [_canonical(entry) for entry in value]
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(f"{type(value).__name__} has no canonical form")


WIDE = ("values", "sd", "half")  # one column an unknown
METADATA = b"dashpot"  # the key in the file's metadata
State = Literal["absent", "whole", "damaged", "outdated", "other"]
Block = dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True)
class Label:
    """What a block is of.

    fingerprint  all that the numbers follow from but seed, place and methods
    seed, index  of the study, and of the (first) block in its scenario
    size         draws
    methods      in their order
    unknowns     how many
    version      of dashpot that computed it, and of its kernel
    """

    fingerprint: str
    seed: int
    index: int
    size: int
    methods: tuple[str, ...]
    unknowns: int
    version: str


def write_block(path: Path, block: Mapping[str, Mapping[str, np.ndarray]], label: Label) -> None:
    """A block's repeats, method after method, one row a repeat.  Raises DataError where it cannot be written."""
    columns: dict[str, Any] = {
        "method": np.concatenate([np.full(len(repeats["p"]), name) for name, repeats in block.items()])
    }
    for name in ("converged", "p"):
        columns[name] = np.concatenate([repeats[name] for repeats in block.values()])
    for name in WIDE:
        wide = np.concatenate([repeats[name] for repeats in block.values()])
        columns |= {f"{name}_{i}": np.ascontiguousarray(wide[:, i]) for i in range(wide.shape[1])}
    write_table(
        path, columns, json.dumps({"label": asdict(label), "sha256": digest_of_columns(columns)}).encode()
    )


def read_block(path: Path, label: Label) -> Block:
    """What `write_block` wrote under this label, by method.

    Raises DataError where the file is not whole, or is of something else.
    """
    content, state = _read(path, label)
    if content is None:
        raise DataError(
            f"this block of a study is {state}", str(path), "run the study again, which computes it again"
        )
    return content


def state_of(path: Path, label: Label) -> State:
    """Whether a block is there and whole, and of what the label says.

    "damaged" has lost its numbers or lies in another's place; "outdated" was computed by another version; "other" has
    other draws or methods.
    """
    return _read(path, label)[1]


def _read(path: Path, label: Label) -> tuple[Block | None, State]:
    try:
        columns, metadata = read_table(path)
        meta = json.loads(metadata[METADATA])
        own = Label(**{**meta["label"], "methods": tuple(meta["label"]["methods"])})
        if meta["sha256"] != digest_of_columns(columns) or len(columns["method"]) != own.size * len(
            own.methods
        ):
            return None, "damaged"
        if replace(own, size=label.size, methods=label.methods, version=label.version) != label:
            return None, "damaged"
        if own.version != label.version:
            return None, "outdated"
        if own != label:
            return None, "other"
        return _by_method(columns, label), "whole"
    except FileNotFoundError:
        return None, "absent"
    except Exception:  # damage may show anywhere between the file's first byte and the last key
        return None, "damaged"


def _by_method(columns: Mapping[str, np.ndarray], label: Label) -> Block:
    blocks = {}
    for k, name in enumerate(label.methods):
        rows = slice(k * label.size, (k + 1) * label.size)
        if set(columns["method"][rows]) != {name}:
            raise ValueError(name)
        blocks[name] = {
            **{key: columns[key][rows] for key in ("converged", "p")},
            **{
                key: np.stack([columns[f"{key}_{i}"][rows] for i in range(label.unknowns)], axis=-1)
                for key in WIDE
            },
        }
    return blocks


def digest_of_columns(columns: Mapping[str, np.ndarray]) -> str:
    """Of the names and numbers of all columns, to the bit."""
    digest = hashlib.sha256()
    for name, column in columns.items():
        numbers = column.dtype.kind in "fb"
        data = column.tobytes() if numbers else json.dumps([str(text) for text in column]).encode()
        digest.update(f"{name}:{_name_of(column.dtype) if numbers else 'text'}:{len(data)}:".encode() + data)
    return digest.hexdigest()


_name_of = cache(str)  # of a dtype, which NumPy puts together anew each time


def write_table(
    path: Path, columns: Mapping[str, Sequence[Any] | np.ndarray], meta: bytes | None = None
) -> None:
    """A Parquet file of named columns, with page checksums; it takes its place when it is whole.  Raises DataError."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    table = arrow_table(columns)
    if meta is not None:
        table = table.replace_schema_metadata({METADATA: meta})
    sink = pa.BufferOutputStream()
    # A dictionary of numbers that hardly repeat costs twice the time, and space; packing them halves the speed for a
    # tenth of the space.
    words = [field.name for field in table.schema if pa.types.is_string(field.type)]
    packed = {name: "zstd" if name in words else "none" for name in table.column_names}
    parquet.write_table(
        table,
        sink,
        compression=packed,
        use_dictionary=words,
        write_statistics=False,
        write_page_checksum=True,
    )
    write_bytes(path, sink.getvalue().to_pybytes())


def _column(column: Any) -> np.ndarray:
    import pyarrow as pa

    if pa.types.is_string(column.type) and not column.null_count:
        return np.array(column.to_pylist(), dtype=object)
    return array_of(column)


def read_table(path: Path) -> tuple[dict[str, np.ndarray], Mapping[bytes, bytes]]:
    """Columns and metadata of such a file, page checksums verified.

    Raises whatever Python and pyarrow raise where it is damaged, FileNotFoundError where there is none.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet

    # read_table would make a data set of the one file, which takes as long as reading it.
    source = pa.BufferReader(path.read_bytes())
    table = parquet.ParquetFile(source, page_checksum_verification=True).read(use_threads=False)
    return {name: _column(table[name]) for name in table.column_names}, table.schema.metadata or {}
