"""Libraries that only some formats need, each in a process of its own, and what damaged files do to them."""

from __future__ import annotations

import gc
import io
import logging
import re
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import count
from typing import Any, TypeVar

import numpy as np

from dashpot.data.readers.arrays import ArrayColumns, Streamed, pieces_of
from dashpot.data.readers.datafile import DataFile, most_unpacked
from dashpot.errors import DashpotError, DataError
from dashpot.io.guarded import GUARDED, Child
from dashpot.io.words import shown

Part = TypeVar("Part")
SMALL = 1 << 16  # numbers of a part up to which its columns come with it


def library(module: str, extra: str, source: str, what: str) -> Any:
    """An optional module, which writes nothing to stderr: what is wrong with a file is raised, in one line.

    Raises DataError that names the extra where it is not installed.
    """
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError:
        cure = f'install it: pip install ".[{extra}]" from the copy of dashpot'
        raise DataError(f"to read {what}, {package} is needed", source, cure) from None
    finally:
        for name, logger in logging.root.manager.loggerDict.items():
            if name.partition(".")[0] == package and isinstance(logger, logging.Logger):
                logger.setLevel(logging.CRITICAL + 1)


@contextmanager
def damaged(source: str, what: str) -> Iterator[None]:
    """Whatever a library raises, in one line: files are not to be trusted."""
    try:
        yield
    except DashpotError:
        raise
    except MemoryError:
        raise DataError(
            f"the {what} file asks for more memory than there is", source, "it may be damaged"
        ) from None
    except BaseException as error:  # a panic of Rust is no Exception
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = re.sub(r"\s+", " ", str(error)).strip() or type(error).__name__
        raise DataError(
            f"the {what} file is damaged or cut off ({shown(reason, 100)})", source, "copy it again"
        ) from None


def guarded(file: DataFile, what: str, parts: Callable[[], Iterator[Part]]) -> Iterator[Part]:
    """The parts of a file of the format `what`, which a process of its own reads, as it does their columns later.

    Raises DataError, one line, where the library raises anything, aborts, hangs, or asks for more memory than the file
    can need.
    """
    answers = _Parts(parts(), file.name, what)
    most = 4 * most_unpacked(file.size)  # arrays, and the copies and texts made of them
    child = Child(answers, file.name, most, file.size) if GUARDED else None
    ask = answers if child is None else child.ask
    streams = count()

    def pieces(number: int, column: int) -> Iterator[Any]:
        stream = next(streams)
        try:
            while (piece := ask((stream, number, column))) is not None:
                yield piece
        finally:
            if child is None or child.end.alive:
                ask(("close", stream))

    for number in count():
        part, held = ask("part")
        if part is None:
            return
        if isinstance(part, ArrayColumns):
            columns = range(len(part.header))
            streamed = (Streamed(part.rows, partial(pieces, number, i)) for i in columns)
            part = replace(part, columns=tuple(held.get(i, each) for i, each in enumerate(streamed)))
        yield part


class _Parts:
    """What answers in the other process: the part that was asked for last, and the first, may be asked for columns."""

    def __init__(self, parts: Iterator[Any], source: str, what: str) -> None:
        self.parts, self.source, self.what = parts, source, what
        self.numbers = count()
        self.held: dict[int, ArrayColumns] = {}
        self.streams: dict[int, Iterator[Any]] = {}

    def close(self) -> None:
        """Let go of the parts, and so of the file."""
        self.held.clear()
        self.streams.clear()
        if isinstance(self.parts, Generator):
            self.parts.close()
        gc.collect()  # objects of asammdf hold each other, and a scratch file

    def __call__(self, request: Any, /) -> Any:
        """The next part and, of a small one, its columns; the next piece of a column; None where there is none."""
        # asammdf prints where it is slow
        with damaged(self.source, self.what), redirect_stdout(io.StringIO()):
            match request:
                case "part":
                    part, number = next(self.parts, None), next(self.numbers)
                    if not isinstance(part, ArrayColumns):
                        return part, {}
                    self.held = {k: held for k, held in self.held.items() if k == 0} | {number: part}
                    # Columns of a small part come with it, but those that cannot be read: nobody may ask for them
                    columns: dict[int, Any] = {}
                    small = part.rows * len(part.columns) <= SMALL
                    for i, column in enumerate(part.columns if small else ()):
                        with suppress(Exception):
                            values = np.concatenate(list(pieces_of(column)))
                            if values.shape == (part.rows,):
                                columns[i] = values
                    return replace(part, columns=()), columns
                case "close", stream:
                    self.streams.pop(stream, None)
                case stream, number, column:
                    if stream not in self.streams:
                        self.streams[stream] = pieces_of(self.held[number].columns[column])
                    return next(self.streams[stream], None)
        return None
