"""The data sets of a fleet: a file each, or the rows of a table that name the same rig; read as a stream."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from glob import glob, has_magic
from typing import Any, Literal

import numpy as np

from dashpot.errors import DataError, UsageError
from dashpot.io.ledger import noted
from dashpot.io.words import listed, shown

PIECE = 1 << 20  # bytes of a file that are read at once
ROWS = 1 << 16  # of a table

Order = Literal["name", "time", "given"]


@dataclass(frozen=True)
class DataSet:
    """What was measured on one rig of a fleet.

    name      of the data set, in results
    source    the file
    checksum  of all that is read from it
    columns, units  rows of a table by column, and the units that the file gives them; none where the file is the set
    """

    name: str
    source: str
    checksum: str
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    units: Mapping[str, str | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """Where data sets come from: how many there are, and a function that reads them one after the other."""

    count: int
    read: Callable[[], Iterator[DataSet]]


def expanded(patterns: Iterable[str], order: Order = "name") -> list[str]:
    """Files that names and patterns (data/*.parquet, ** for folders within) lead to, each once.

    In the order of their names, numbers in them counted as such (run2 before run10), of the time when they were last
    changed, or as given.  Raises UsageError where a name or a pattern leads to nothing.
    """
    files: dict[str, None] = {}
    for pattern in patterns:
        found = [pattern]
        if has_magic(pattern) and not os.path.exists(pattern):
            found = sorted(
                (path for path in glob(pattern, recursive=True) if os.path.isfile(path)), key=natural
            )
            if not found:
                raise UsageError("no file matches this pattern", pattern, "correct the pattern or the folder")
        elif not os.path.exists(pattern):
            raise UsageError("there is no such file", pattern, "correct the name or the folder")
        files.update(dict.fromkeys(found))
    if order == "name":
        return sorted(files, key=natural)
    if order == "time":
        return sorted(files, key=lambda path: (_time_of(path), natural(path)))
    return list(files)


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts texts with the numbers in them as numbers."""
    parts = re.split(r"(\d+)", text)
    return tuple((1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts)


def _time_of(path: str) -> float:
    try:
        return os.stat(path).st_mtime
    except OSError:
        return 0.0  # its reader will say what is wrong with it


# A file each


def of_files(paths: Sequence[str]) -> Source:
    """Every file a data set of its own; one that cannot be read is one too, with the reason for its checksum."""

    def read() -> Iterator[DataSet]:
        for path in paths:
            yield DataSet(path, path, _checksum(path))

    return Source(len(paths), read)


def _checksum(path: str) -> str:
    digest = hashlib.sha256()
    try:
        with open(noted(path), "rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
    except (OSError, ValueError) as error:
        return f"unreadable: {error}"
    return digest.hexdigest()


# Rows of tables


def of_tables(paths: Sequence[str], column: str) -> Source:
    """The rows of tables (Parquet, CSV) of which a column names the rig, those of one rig together.

    A table is read twice and never held whole: once for the names, once for the rows.  Raises DataError where a table
    has no such column or is damaged, and where rows of one rig are not together in the file.
    """
    seen: dict[str, str] = {}
    for path in paths:
        last: str | None = None
        for _, _, part in _parts(path, column, names_only=True):
            for name in _runs(part[column])[0]:
                if name == last:
                    continue
                if name in seen:
                    place = "" if seen[name] == path else f" and in {shown(seen[name])}"
                    raise DataError(
                        f"the rows of {shown(name)} are not together in the file{place}", path,
                        f"sort the table by {column}, or give rigs names of their own",
                    )  # fmt: skip
                seen[name] = path
                last = name

    def read() -> Iterator[DataSet]:
        for path in paths:
            yield from _rigs_of(path, column)

    return Source(len(seen), read)


def _rigs_of(path: str, column: str) -> Iterator[DataSet]:
    held: list[dict[str, np.ndarray]] = []
    current, units = "", dict[str, str | None]()
    for _, units, part in _parts(path, column):
        names, starts = _runs(part[column])
        ends = [*starts[1:], len(part[column])]
        for name, start, end in zip(names, starts, ends, strict=True):
            if held and name != current:
                yield _data_set(path, current, held, units)
                held = []
            current = name
            held.append({key: values[start:end] for key, values in part.items() if key != column})
    if held:
        yield _data_set(path, current, held, units)


def _runs(values: np.ndarray) -> tuple[list[str], list[int]]:
    """Names that follow each other, and the row at which each begins."""
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return [str(values[start]) for start in starts], starts.tolist()


def _data_set(
    path: str, name: str, parts: Sequence[Mapping[str, np.ndarray]], units: Mapping[str, str | None]
) -> DataSet:
    columns = dict(parts[0])
    if len(parts) > 1:
        columns = {key: np.concatenate([part[key] for part in parts]) for key in columns}
    digest = hashlib.sha256(repr(sorted((key, unit) for key, unit in units.items() if unit)).encode())
    numbers = [key for key, values in columns.items() if values.dtype == np.float64]
    digest.update(repr((list(columns), numbers)).encode())
    digest.update(np.array([columns[key] for key in numbers]).tobytes())
    for key, values in columns.items():
        if values.dtype != np.float64:
            data = values.tobytes() if values.dtype.kind in "ib" else repr(values.tolist()).encode()
            digest.update(f"{key}:{values.dtype.kind}:{len(data)}:".encode() + data)
    return DataSet(name, path, digest.hexdigest(), columns, units)


@dataclass(frozen=True)
class PackedRows:
    """Rows of many data sets as one table: thousands of small arrays would cost more to send than to identify."""

    heads: tuple[tuple[str, str, str], ...]
    ends: tuple[int, ...]
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str | None]

    def unpacked(self) -> tuple[DataSet, ...]:
        """The data sets again; their columns are views."""
        starts = (0, *self.ends[:-1])
        return tuple(
            DataSet(*head, {key: values[a:b] for key, values in self.columns.items()}, self.units)
            for head, a, b in zip(self.heads, starts, self.ends, strict=True)
        )


def packed(data_sets: Sequence[DataSet]) -> PackedRows | tuple[DataSet, ...]:
    """Data sets for sending: as one table where they are rows with the same columns and units."""
    first = data_sets[0]
    alike = all(list(one.columns) == list(first.columns) and one.units == first.units for one in data_sets)
    if not first.columns or not alike:
        return tuple(data_sets)
    counts = [len(next(iter(one.columns.values()))) for one in data_sets]
    return PackedRows(
        tuple((one.name, one.source, one.checksum) for one in data_sets),
        tuple(int(end) for end in np.cumsum(counts)),
        {key: np.concatenate([one.columns[key] for one in data_sets]) for key in first.columns},
        dict(first.units),
    )


def _parts(
    path: str, column: str, names_only: bool = False
) -> Iterator[tuple[int, dict[str, str | None], dict[str, np.ndarray]]]:
    """Number of a part, units and columns of a table, some ten thousand rows at a time."""
    import pyarrow as pa

    try:
        for number, batch in enumerate(_batches(noted(path), column, names_only)):
            if not batch.num_rows:
                continue
            units = {
                entry.name: (entry.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") or None
                for entry in batch.schema
            }
            yield number, units, {name: _array(batch.column(name)) for name in batch.schema.names}
    except (OSError, ValueError, pa.ArrowException) as error:
        if isinstance(error, FileNotFoundError):
            raise DataError("there is no such file", path, "correct the path") from None
        raise DataError(
            f"the table cannot be read ({shown(str(error), 150)})", path, "check the file"
        ) from None


def _batches(path: str, column: str, names_only: bool) -> Iterator[Any]:
    import pyarrow.csv as text
    import pyarrow.parquet as parquet

    with open(noted(path), "rb") as file:
        is_parquet = file.read(4) == b"PAR1"
    if is_parquet:
        content = parquet.ParquetFile(path)
        _require_column(path, column, content.schema_arrow.names)
        yield from content.iter_batches(ROWS, columns=[column] if names_only else None, use_threads=False)
        return
    # A name such as 007 is a text.
    converted = text.ConvertOptions(column_types={column: "string"})
    reader = text.open_csv(path, convert_options=converted)
    _require_column(path, column, reader.schema.names)
    for batch in reader:
        yield batch.select([column]) if names_only else batch


def _require_column(path: str, column: str, names: Sequence[str]) -> None:
    if column not in names:
        raise DataError(
            f"column {shown(column)}: missing (it is to name the rig)", path, f"there are {listed(names)}"
        )


def _array(column: Any) -> np.ndarray:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_floating(kind) or (pa.types.is_integer(kind) and not column.null_count):
        values: np.ndarray = column.to_numpy(zero_copy_only=False)
    elif pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind):
        values = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    else:
        values = np.array([str(value) for value in column.to_pylist()], dtype=object)
    return values
