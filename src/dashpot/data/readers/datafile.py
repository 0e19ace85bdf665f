"""A file as readers see it: its first bytes, its contents, packed or not."""

from __future__ import annotations

import gzip
import itertools
import mmap
import os
import stat
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, cast

from dashpot.errors import DataError, UsageError
from dashpot.io.atomic import Scratch, lasting_scratch
from dashpot.io.ledger import noted
from dashpot.io.words import shown

HEAD = 1 << 16  # bytes by which formats are told apart
PIECE = 1 << 24
SUBSTITUTED = 1 << 20  # bytes in which patterns are replaced at a time, which takes some ten times as many
LARGE = 1 << 26  # bytes from which a file is not held in memory
UNPACKED = "DASHPOT_UNPACKED_GIB"  # environment variable: how much larger than a file its contents may be


@dataclass(frozen=True)
class DataFile:
    """A file that can be read.

    given    the path that the user gave
    path     where its bytes are: there, or in a scratch file of what came packed by gzip or out of a pipe
    head     the first of them
    scratch  keeps the scratch file for as long as the file may be read
    held     all bytes, where they stand in no file
    """

    given: Path
    path: Path
    head: bytes
    scratch: Scratch | None = None
    held: bytes | None = None

    @property
    def name(self) -> str:
        """The path that was given, for messages."""
        return shown(str(self.given), 200)

    @property
    def suffix(self) -> str:
        """The ending of the name in small letters, such as .csv, without .gz."""
        return Path(self.given.name.lower().removesuffix(".gz")).suffix

    @property
    def size(self) -> int:
        """Bytes, of what is not packed by gzip."""
        with _said(self.name):
            return os.stat(self.path).st_size

    def check_unpacked(self, size: int) -> None:
        """Raises DataError if contents of so many bytes are more than the file may unpack to."""
        _check_unpacked(size, self.size, self.name)

    @cached_property
    def contents(self) -> bytes | mmap.mmap:
        """All bytes; those of a large file are mapped, not held.  Raises DataError if they cannot be read."""
        if self.held is not None:
            return self.held
        with self.reading() as stream:
            if os.fstat(stream.fileno()).st_size < LARGE:
                return stream.read()
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)

    @contextmanager
    def reading(self) -> Iterator[BinaryIO]:
        """The bytes as a stream.  Raises DataError if they cannot be read."""
        with _said(self.name), Path(noted(self.path)).open("rb") as stream:
            yield stream

    def rewritten(self, pieces: Iterable[bytes]) -> DataFile:
        """The file as it is read once it is written otherwise: held, or in a scratch file where this one is mapped."""
        if isinstance(self.contents, bytes):
            return replace(self, held=b"".join(pieces))
        scratch = lasting_scratch()
        return DataFile(self.given, scratch.write("data", pieces), self.head, scratch)


def most_unpacked(packed: int) -> int:
    """Bytes to which a file of so many may unpack.  Raises UsageError if the environment says no number of GiB."""
    text = os.environ.get(UNPACKED, "") or "1"
    try:
        return packed + int(float(text) * 2**30)
    except (ValueError, OverflowError):
        what = f'{UNPACKED} is "{shown(text)}"'
        raise UsageError(what, cure="give the room for unpacked data in GiB, such as 4") from None


def _check_unpacked(size: int, packed: int, source: str) -> None:
    if size > most_unpacked(packed):
        what = f"its contents are more than {(most_unpacked(packed) - packed) / 2**30:g} GiB larger than the file"
        raise DataError(what, source, f"if you trust the file, set {UNPACKED} to more")


def whole_lines(
    data: bytes | mmap.mmap, start: int, end: int | None = None, most: int = PIECE
) -> Iterator[bytes]:
    """The bytes between two places, some lines at a time: `most` bytes, or one line that is longer."""
    end = len(data) if end is None else end
    while start < end:
        stop = data.rfind(b"\n", start, min(start + most, end)) + 1
        if stop == 0:  # a line that is longer
            stop = data.find(b"\n", start, end) + 1 or end
        yield data[start:stop]
        start = stop


def open_file(path: str | os.PathLike[str]) -> DataFile:
    """The file and its first bytes.

    Raises DataError if there is none, it is a folder or a device, may not be read, is empty, or is damaged.
    """
    name = shown(os.fspath(path), 200)
    with _said(name):
        try:
            kind = os.stat(path).st_mode
        except ValueError as error:
            raise DataError(f"the file cannot be read ({error})", name, "check the path") from None
        if stat.S_ISDIR(kind):
            raise DataError("is a directory", name, "give the files in it")
        if not (stat.S_ISREG(kind) or stat.S_ISFIFO(kind) or os.path.realpath(path) == os.devnull):
            raise DataError("is a device, not a file", name, "give a file")
        with Path(noted(path)).open("rb") as raw:
            path = Path(path)
            packed = raw.peek(2)[:2] == b"\x1f\x8b"
            if not packed and not stat.S_ISFIFO(kind):
                file = DataFile(path, path, raw.read(HEAD))
            else:
                source: BinaryIO = cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw
                head = source.read(HEAD)
                scratch = lasting_scratch()
                pieces: Iterator[bytes] = itertools.chain([head], iter(lambda: source.read(PIECE), b""))
                if packed:
                    pieces = _counted(pieces, path)
                file = DataFile(path, scratch.write("data", pieces), head, scratch)
    if not file.head.strip():
        raise DataError("the file is empty", name, "give a file with a header row and data")
    return file


def _counted(pieces: Iterable[bytes], path: Path) -> Iterator[bytes]:
    """The same.  Raises DataError as soon as they are more than the packed file may unpack to."""
    size, packed = 0, os.stat(path).st_size
    for piece in pieces:
        size += len(piece)
        _check_unpacked(size, packed, shown(str(path), 200))
        yield piece


@contextmanager
def _said(name: str) -> Iterator[None]:
    """Errors of reading in one line."""
    try:
        yield
    except FileNotFoundError:
        raise DataError("there is no such file", name, "correct the path") from None
    except PermissionError:
        raise DataError("the file may not be read", name, "change its permissions") from None
    except (EOFError, gzip.BadGzipFile, zlib.error):
        raise DataError("the packed file is damaged or cut off", name, "pack or copy it again") from None
    except OSError as error:
        reason = shown(error.strerror or str(error), 100)
        raise DataError(f"the file cannot be read ({reason})", name, "check the path") from None
