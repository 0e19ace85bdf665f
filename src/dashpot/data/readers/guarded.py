"""Parts of a file whose library is native code, as a process of its own reads them."""

from __future__ import annotations

import gc
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import count
from typing import Any, TypeVar

import numpy as np

from dashpot.data.readers.arrays import ArrayColumns, Load, Streamed
from dashpot.data.readers.datafile import DataFile, most_unpacked
from dashpot.errors import DataError
from dashpot.io.guarded import GUARDED, Child

Part = TypeVar("Part")
SMALL = 1 << 16  # numbers of a part up to which its columns come with it
SHARE = 4  # times what the file may unpack to: arrays, and the copies and texts made of them


def guarded(file: DataFile, parts: Callable[[], Generator[Part]]) -> Iterator[Part]:
    """The parts, which a process of its own reads, as it does their columns when they are asked for.

    Raises DataError, one line, where the library aborts, hangs, or asks for more memory than the file can need.
    """
    if not GUARDED:
        yield from parts()
        return
    size = file.size
    child = Child(_Parts(parts()), file.name, SHARE * most_unpacked(size), size)
    for number in count():
        part, columns = child.ask("part")
        if part is None:
            return
        if isinstance(part, ArrayColumns):
            loads = tuple(_column(child, number, i, columns.get(i)) for i in range(len(part.header)))
            part = replace(part, loads=loads)
        yield part


def _column(child: Child, part: int, column: int, held: Any) -> Load:
    """How a column is asked for, unless it is here."""

    def load() -> Any:
        if held is not None:
            return held
        values = child.ask((part, column))
        return Streamed(values, pieces) if isinstance(values, int) else values

    def pieces() -> Iterator[Any]:
        stream = child.ask(("pieces", part, column))
        try:
            while (piece := child.ask(("next", stream))) is not None:
                yield piece
        finally:
            if child.end.alive:
                child.ask(("close", stream))

    return load


class _Parts:
    """What answers in the other process: the part that was asked for last, and the first, may be asked for columns."""

    def __init__(self, parts: Generator[Any]) -> None:
        self.parts = parts
        self.numbers, self.keys = count(), count()
        self.held: dict[int, ArrayColumns] = {}
        self.streams: dict[int, Iterator[Any]] = {}

    def close(self) -> None:
        """Let go of the parts, and so of the file."""
        self.held.clear()
        self.streams.clear()
        self.parts.close()
        gc.collect()  # objects of asammdf hold each other, and a scratch file

    def __call__(self, request: Any, /) -> Any:
        match request:
            case "part":
                part, number = next(self.parts, None), next(self.numbers)
                if not isinstance(part, ArrayColumns):
                    return part, {}
                self.held = {k: held for k, held in self.held.items() if k == 0} | {number: part}
                return replace(part, loads=()), _small(part)
            case "pieces", number, column:
                key = next(self.keys)
                self.streams[key] = self.held[number].loads[column]().pieces()
                return key
            case "next", key:
                return next(self.streams[key], None)
            case "close", key:
                del self.streams[key]
            case number, column:
                values = self.held[number].loads[column]()
                return values.rows if isinstance(values, Streamed) else values
        return None


def _small(part: ArrayColumns) -> dict[int, Any]:
    """The columns of a small part; those that cannot be read are left out, for nobody may ask for them."""
    columns: dict[int, Any] = {}
    for i, load in enumerate(part.loads if part.rows * len(part.loads) <= SMALL else ()):
        with suppress(DataError):
            values = load()
            columns[i] = np.concatenate([*values.pieces()]) if isinstance(values, Streamed) else values
    return columns
