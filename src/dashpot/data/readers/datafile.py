"""A file as readers see it: its first bytes, its contents, packed or not."""

from __future__ import annotations

import gzip
import io
import mmap
import os
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, cast

from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes
from dashpot.io.ledger import noted
from dashpot.io.words import shown

HEAD = 1 << 16  # bytes by which formats are told apart
PIECE = 1 << 24
LARGE = 1 << 28  # bytes from which a file is not held in memory


@dataclass(frozen=True)
class DataFile:
    """A file that can be read; `head` is its first bytes, unpacked where it is packed by gzip."""

    path: Path
    head: bytes
    packed: bool

    @property
    def name(self) -> str:
        """The path, for messages."""
        return shown(str(self.path), 200)

    @property
    def suffix(self) -> str:
        """The ending of the name in small letters, such as .csv, without .gz."""
        name = self.path.name.lower().removesuffix(".gz")
        return Path(name).suffix

    @cached_property
    def contents(self) -> bytes:
        """All bytes, unpacked.  Raises DataError where they cannot be read or are damaged."""
        with self.reading() as stream:
            return stream.read()

    @cached_property
    def mapped(self) -> mmap.mmap | None:
        """The bytes of a file that is too large to be held; None for every other."""
        if self.packed or not self.path.is_file() or self.path.stat().st_size < LARGE:
            return None
        with _said(self.name), Path(noted(self.path)).open("rb") as raw:
            return mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ)

    @contextmanager
    def reading(self) -> Iterator[BinaryIO]:
        """The unpacked bytes as a stream.  Raises DataError where they cannot be read or are damaged."""
        with _said(self.name), _stream(self.path, self.packed, self.head) as stream:
            yield stream

    @contextmanager
    def unpacked(self) -> Iterator[Path]:
        """A path to the unpacked file, for libraries that want one; temporary where the file is packed."""
        if not self.packed and self.path.is_file():
            yield self.path
            return
        with tempfile.TemporaryDirectory(prefix="dashpot-") as folder, self.reading() as source:
            target = Path(folder) / f"data{self.suffix}"
            write_bytes(target, iter(lambda: source.read(PIECE), b""))
            yield target


def open_file(path: str | os.PathLike[str]) -> DataFile:
    """The file and its first bytes.

    Raises DataError where there is none, it is a folder or a device, may not be read, is empty, or is damaged.
    """
    name = shown(os.fspath(path), 200)
    with _said(name):
        try:
            kind = os.stat(path).st_mode
        except ValueError as error:
            raise DataError(f"the file cannot be read ({error})", name, "check the path") from None
        if stat.S_ISDIR(kind):
            raise DataError("is a directory", name, "give the files in it")
        if stat.S_ISREG(kind):
            with Path(noted(path)).open("rb") as raw:
                packed = raw.read(2) == b"\x1f\x8b"
            with _stream(Path(path), packed, b"") as stream:
                head = stream.read(HEAD)
        elif stat.S_ISFIFO(kind):
            return _from_pipe(Path(path))
        else:
            # Of the devices only this one ends.
            head, packed = b"", False
            if os.path.realpath(path) != os.devnull:
                raise DataError("is a device, not a file", name, "give a file")
    if not head.strip():
        raise DataError("the file is empty", name, "give a file with a header row and data")
    return DataFile(Path(path), head, packed)


def _from_pipe(path: Path) -> DataFile:
    """All that comes out of a pipe, held in memory."""
    data = Path(noted(path)).read_bytes()
    data = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    if not data.strip():
        raise DataError("the file is empty", shown(str(path), 200), "give a file with a header row and data")
    file = DataFile(path, data[:HEAD], packed=False)
    file.__dict__["contents"] = data  # the cached property: a pipe is read once
    return file


def _stream(path: Path, packed: bool, held: bytes) -> BinaryIO:
    if not path.is_file() and held:
        return io.BytesIO(held)
    return cast(BinaryIO, gzip.open(noted(path), "rb") if packed else Path(noted(path)).open("rb"))


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
