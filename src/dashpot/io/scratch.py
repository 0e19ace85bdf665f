"""Files that other programs need for a moment: in a folder of their own, gone when the work is done."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Scratch:
    """A folder that lasts as long as the work in it."""

    folder: Path

    def write(self, name: str, content: bytes) -> Path:
        """Where the content now stands."""
        path = self.folder / name
        path.write_bytes(content)
        return path

    def read(self, name: str) -> bytes:
        """What another program has written there.  Raises OSError where it has not."""
        return (self.folder / name).read_bytes()


@contextmanager
def scratch() -> Iterator[Scratch]:
    """A folder for files in between, removed at the end whatever happens."""
    with tempfile.TemporaryDirectory(prefix="dashpot-") as folder:
        yield Scratch(Path(folder))
