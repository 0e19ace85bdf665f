"""Which files one run reads and writes, so that no output ever replaces an input or another output.

Files are told apart by identity, not by name: links, hard links and different spellings of a path are the same file.
Without an open ledger nothing is noted and nothing refused: a program that calls dashpot minds its own files.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar

from dashpot.errors import DataError, UsageError

AnyPath = str | os.PathLike[str]
Path = TypeVar("Path", str, os.PathLike[str], str | os.PathLike[str])
Key = str | tuple[int, int]


@dataclass
class Ledger:
    """Inputs and outputs of a run, by the places and the inodes that their paths lead to.

    allows  whether a file may be read, by its real path; None: any
    beside  a folder in which files are found that are not where a relative path leads; None: nowhere
    """

    read: set[Key] = field(default_factory=set)
    inputs: dict[str, None] = field(default_factory=dict)  # names of the files read, in order
    claimed: dict[Key, object] = field(default_factory=dict)
    written: set[Key] = field(default_factory=set)
    allows: Callable[[str], bool] | None = None
    beside: str | None = None

    def found(self, path: Path) -> Path:
        """The path of an input, or that of its namesake in `beside` where it alone is there."""
        if self.beside is None or os.path.isabs(path) or os.path.exists(path):
            return path
        other: Path = type(path)(os.path.join(self.beside, path))  # type: ignore[call-arg]
        return other if os.path.exists(other) else path

    def note_read(self, path: AnyPath) -> None:
        """An input.  Raises UsageError if it is an output of this run, DataError if it may not be read."""
        keys = keys_of(path)
        if self.allows is not None and not self.allows(os.path.realpath(path)):
            raise DataError("is outside the folder that is served", os.fspath(path), "copy it there")
        if any(key in self.claimed or key in self.written for key in keys):
            raise _overwrites(path)
        self.read.update(keys)
        self.inputs[os.fspath(path)] = None

    def claim(self, path: AnyPath, by: object) -> None:
        """An output to come, of the option `by`.  Raises UsageError if it is an input or another's output."""
        keys = keys_of(path)
        if any(key in self.read for key in keys):
            raise _overwrites(path)
        if any(self.claimed.get(key, by) != by for key in keys):
            raise _taken(path)
        self.claimed.update(dict.fromkeys(keys, by))

    def note_written(self, path: AnyPath) -> None:
        """An output about to be written.  Raises UsageError if it is an input, or written already."""
        keys = keys_of(path)
        if any(key in self.read for key in keys):
            raise _overwrites(path)
        if any(key in self.written for key in keys):
            raise _taken(path)
        self.written.update(keys)

    def write_anew(self) -> None:
        """All outputs may be written again, by the options that claimed them: what they hold has grown."""
        self.written.clear()


_current: ContextVar[Ledger | None] = ContextVar("ledger", default=None)


@contextmanager
def opened(allows: Callable[[str], bool] | None = None, beside: str | None = None) -> Iterator[Ledger]:
    """A ledger for all that is read and written inside; one opened in another allows and finds what that does."""
    outer = _current.get()
    if allows is None and outer is not None:
        allows, beside = outer.allows, outer.beside
    ledger = Ledger(allows=allows, beside=beside)
    before = _current.set(ledger)
    try:
        yield ledger
    finally:
        _current.reset(before)


def current() -> Ledger | None:
    """The ledger of this run; None if there is none."""
    return _current.get()


def noted(path: Path) -> Path:
    """The path of an input, once it is in the ledger: every file is opened for reading through this.

    Raises UsageError if the file is an output of this run, DataError if it is a device, which may never end.
    """
    try:
        device = stat.S_ISCHR(os.stat(path).st_mode) and os.path.realpath(path) != os.devnull
    except (OSError, ValueError):
        device = False
    if device:
        raise DataError("is a device, not a file", os.fspath(path), "give a file")
    ledger = current()
    if ledger is not None:
        path = ledger.found(path)
        ledger.note_read(path)
    return path


def keys_of(path: AnyPath) -> tuple[Key, ...]:
    """What a path leads to: a place and, where a file lies there, its device and inode.

    Nothing for devices and pipes, which may be read and written at once, nor for what is no path at all.
    """
    try:
        place = os.path.realpath(path)  # fails where the current folder is gone
    except (OSError, ValueError):
        return ()
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return (place,)
    except (OSError, ValueError):
        return ()
    if not stat.S_ISREG(status.st_mode):
        return ()
    return place, (status.st_dev, status.st_ino)


def _overwrites(path: AnyPath) -> UsageError:
    return UsageError("this would overwrite an input file", os.fspath(path), "name another file")


def _taken(path: AnyPath) -> UsageError:
    return UsageError("two outputs have this name", os.fspath(path), "name another file")
