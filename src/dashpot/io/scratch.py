"""Files that other programs need for a moment: in a folder of their own, gone when the work is done."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from dashpot.errors import DataError

_lasting: dict[str, int] = {}  # folders that are there until they are let go, and the process that made each


@dataclass(frozen=True)
class Scratch:
    """A folder that lasts as long as the work in it."""

    folder: Path

    def write(self, name: str, content: bytes | Iterable[bytes]) -> Path:
        """Where the content, whole or in pieces, now stands.  Raises DataError where there is no room for it."""
        path = self.folder / name
        with path.open("wb", buffering=0) as file:
            for piece in (content,) if isinstance(content, bytes) else content:
                left = memoryview(piece)
                try:
                    while left:
                        left = left[file.write(left) :]
                except OSError as error:
                    what = f"there is no room for a file in between ({error.strerror})"
                    cure = "make room there, or set TMPDIR to a folder on a larger disk"
                    raise DataError(what, str(self.folder), cure) from None
        return path

    def read(self, name: str) -> bytes:
        """What another program has written there.  Raises OSError where it has not."""
        return (self.folder / name).read_bytes()


@contextmanager
def scratch() -> Iterator[Scratch]:
    """A folder for files in between, removed at the end whatever happens."""
    with tempfile.TemporaryDirectory(prefix="dashpot-") as folder:
        yield Scratch(Path(folder))


def lasting_scratch() -> Scratch:
    """A folder for files that are read until their reader is let go: removed with it, or when the process ends."""
    folder = tempfile.mkdtemp(prefix="dashpot-")
    lasting = Scratch(Path(folder))
    _lasting[folder] = os.getpid()
    weakref.finalize(lasting, _remove, folder)
    return lasting


def clear_scratch() -> None:
    """Remove the folders that last: for a signal handler that ends the process at once."""
    for folder in tuple(_lasting):
        _remove(folder)


def _remove(folder: str) -> None:
    if _lasting.pop(folder, None) == os.getpid():  # not in processes that were forked from it
        shutil.rmtree(folder, ignore_errors=True)
