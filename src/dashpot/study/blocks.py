"""Blocks: work in pieces, each kept as it is finished and never computed twice, the same bits whoever computes them.

A block is a table of columns in a Parquet file that is there whole or not at all.  It says what it is of (its Key) and
carries a digest of its numbers besides the page checksums of Parquet, so that flipped bits, blocks of another place and
blocks of another study or version are seen when it is read.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from dashpot.errors import DataError, UsageError
from dashpot.io.atomic import locked, remove_parts, write_bytes
from dashpot.io.json_document import array_of, arrow_table

Task = TypeVar("Task")
Columns = dict[str, np.ndarray]
Map = Callable[
    [Callable[[Any], Any], Iterable[Any]], Iterable[Any]
]  # the built-in one, or that of an executor
State = Literal["absent", "whole", "damaged", "outdated", "other"]
METADATA = b"dashpot"  # the key in the file's metadata
GROWING = {"size", "methods"}  # of a label: what may be otherwise in a study that has grown


@dataclass(frozen=True)
class Key:
    """Where a block is kept, and what it is of.

    name   of its file in the store, without the ending
    label  all that its numbers follow from: texts, whole numbers and lists of them; "version" is that of the program
    """

    name: str
    label: Mapping[str, Any]


@dataclass(frozen=True)
class FinishedTask(Generic[Task]):
    """A finished task, whether it was kept from an earlier run, and what reads its columns."""

    task: Task
    kept: bool
    columns: Callable[[], Columns]


class BlockStore:
    """Blocks in the files of a folder, or in memory where there is none.

    `states` counts the blocks asked for by what lay in their place: "damaged" has lost its numbers or lies in
    another's place; "outdated" was computed by another version; "other" has other draws or methods.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.states: Counter[State] = Counter()
        self._memory: dict[str, Columns] = {}

    def map(
        self,
        f: Callable[[Task], Columns],
        tasks: Iterable[Task],
        *,
        key: Callable[[Task], Key],
        mapper: Map = map,
    ) -> Iterator[FinishedTask[Task]]:
        """What `f` makes of each task, as it is finished: taken from the store, or computed by any `mapper` and kept.

        `f` is a function of a module, which any process can be sent.  Children of this process write their blocks, for
        they clear away what is half-written when this one is killed; others, of a cluster, send them to be written
        here.  Raises DataError if a block cannot be written.
        """
        kept: deque[FinishedTask[Task]] = deque()
        missing: dict[int, tuple[Key, Task]] = {}

        def work() -> Iterator[tuple[int, Key, Task]]:
            for number, task in enumerate(tasks):
                own = key(task)
                columns, state = self._find(own)
                self.states[state] += 1
                if columns is None:
                    missing[number] = own, task
                    yield number, own, task
                else:  # very many may wait here; none is held
                    kept.append(FinishedTask(task, True, partial(self.read, own)))

        computed = partial(_computed, f, self.folder, (platform.node(), os.getpid()))
        for number, columns, written in mapper(computed, work()):
            while kept:
                yield kept.popleft()
            own, task = missing.pop(number)
            if self.folder is None:
                self._memory[own.name] = columns
            elif not written:
                write_block(self.folder, own, columns)
            yield FinishedTask(task, False, partial(dict, columns))
        yield from kept

    def read(self, key: Key) -> Columns:
        """A block that is there.  Raises DataError if it is not whole, or is of something else."""
        columns, state = self._find(key)
        if columns is None:
            where = None if self.folder is None else str(_file_of(self.folder, key))
            what = f"this block is {state}, though it was intact a moment ago"
            raise DataError(what, where, "run again, which computes it again")
        return columns

    def _find(self, key: Key) -> tuple[Columns | None, State]:
        if self.folder is None:
            columns = self._memory.get(key.name)
            return columns, "absent" if columns is None else "whole"
        try:
            columns, metadata = read_table(_file_of(self.folder, key))
            meta = json.loads(metadata[METADATA])
            differing = {name for name, value in key.label.items() if meta["label"][name] != value}
            if differing - GROWING - {"version"} or meta["sha256"] != digest_of_columns(columns):
                return None, "damaged"
        except FileNotFoundError:
            return None, "absent"
        except Exception:  # damage may show anywhere between the file's first byte and the last key
            return None, "damaged"
        if differing:
            return None, "outdated" if "version" in differing else "other"
        return columns, "whole"


def _file_of(folder: Path, key: Key) -> Path:
    return folder / f"{key.name}.parquet"


def _computed(
    f: Callable[[Task], Columns],
    folder: Path | None,
    sharer: tuple[str, int],
    numbered: tuple[int, Key, Task],
) -> tuple[int, Columns, bool]:
    """What a process does with a task: its number, its columns, and whether they are written.

    sharer  machine and process of the one who shares out the work: this one itself, or its parent
    """
    number, key, task = numbered
    columns = f(task)
    machine, process = sharer
    near = platform.node() == machine and process in (os.getpid(), os.getppid())
    if folder is not None and near:
        write_block(folder, key, columns)
        return number, columns, True
    return number, columns, False


def write_block(folder: Path, key: Key, columns: Columns) -> None:
    """A block in its place in a folder.  Raises DataError."""
    path = _file_of(folder, key)
    path.parent.mkdir(parents=True, exist_ok=True)
    meta = {"label": dict(key.label), "sha256": digest_of_columns(columns)}
    write_table(path, columns, json.dumps(meta).encode())


@contextmanager
def opened_store(folder: Path, own: Callable[[Path], bool], cure: str) -> Iterator[BlockStore]:
    """The store in a folder, made where there is none, held by this process alone, and cleared of half-written files.

    Raises UsageError if the folder cannot be used, holds files that are not its `own`, or another process works in
    it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        foreign = sorted(path.name for path in folder.iterdir() if path.name[0] != "." and not own(path))
    except OSError as error:
        what = f"the folder cannot be used ({error.strerror or error})"
        raise UsageError(what, str(folder), cure) from None
    if foreign:
        raise UsageError(f"the folder holds other files ({foreign[0]})", str(folder), cure)
    with locked(folder):
        for place in folder.glob("**/"):
            remove_parts(place)
        yield BlockStore(folder)


# Fingerprints: digests of values in which every bit counts, and no order without meaning.


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
    """A value as JSON in which every bit counts, and no order without meaning: equal values give equal texts."""
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


def digest_of_columns(columns: Mapping[str, np.ndarray]) -> str:
    """Of the names and numbers of all columns, to the bit."""
    digest = hashlib.sha256()
    for name, column in columns.items():
        numbers = column.dtype.kind in "fbi"
        data = column.tobytes() if numbers else json.dumps([str(text) for text in column]).encode()
        digest.update(f"{name}:{_name_of(column.dtype) if numbers else 'text'}:{len(data)}:".encode() + data)
    return digest.hexdigest()


_name_of = cache(str)  # of a dtype, which NumPy puts together anew each time


# Tables as Parquet files.


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
    options = {"compression": packed, "use_dictionary": words, "write_statistics": False}
    parquet.write_table(table, sink, write_page_checksum=True, **options)
    write_bytes(path, sink.getvalue().to_pybytes())


def read_table(path: Path) -> tuple[Columns, Mapping[bytes, bytes]]:
    """Columns and metadata of such a file, page checksums verified.

    Raises whatever Python and pyarrow raise where it is damaged, FileNotFoundError if there is none.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet

    # read_table would make a data set of the one file, which takes as long as reading it.
    source = pa.BufferReader(path.read_bytes())
    table = parquet.ParquetFile(source, page_checksum_verification=True).read(use_threads=False)
    columns = {}
    for name in table.column_names:
        texts = pa.types.is_string(table[name].type) and not table[name].null_count
        columns[name] = np.array(table[name].to_pylist(), dtype=object) if texts else array_of(table[name])
    return columns, table.schema.metadata or {}
