"""The data sets of a fleet, which workers read: a file each here, rows of tables in `tables`."""

from __future__ import annotations

import hashlib
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.readers import Reading
from dashpot.data.readers.manifest import files_fitting, is_pattern
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.estimate.identify import amplitudes_for
from dashpot.estimate.registry import method_class
from dashpot.io.ledger import noted
from dashpot.model.rigfile import Rig

# How every data set of a fleet is treated.


@dataclass(frozen=True)
class Treatment:
    """How every data set of a fleet is treated: its method, conditioning of time records.

    method  None is what `identify` does by itself: the method that suits, and a search from many starts where that may
            have ended in another minimum.  One that is named takes all data sets that are alike as one batch.
    """

    method: str | None = None
    conditioning: Conditioning = field(default_factory=Conditioning)
    frequency_hz: float | None = None
    positive: bool = False
    seed: int = 0

    def spectrum(self, rig: Rig, reading: Reading) -> Spectrum:
        """The amplitudes of a data set; what its manifest says of conditioning counts first.

        Raises DataError where its samples cannot be used, UsageError where there is no such method.
        """
        methods = [] if self.method is None else [method_class(self.method).traits]
        return amplitudes_for(rig.model, reading, self.conditioning.changed(**reading.conditioning), methods)


PIECE = 1 << 20  # bytes of a file that are read at once

Order = Literal["name", "time", "given"]


@dataclass(frozen=True)
class DataSet:
    """What was measured on one rig of a fleet.

    name      of the data set, in results
    source    the file
    columns, units  rows of a table by column, and the units that the file gives them; none where the file is the set
    """

    name: str
    source: str
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    units: Mapping[str, str | None] = field(default_factory=dict)


class BlockPart(ABC):
    """Neighbouring data sets of a fleet: what a worker is sent, who reads them if they are not held."""

    names: tuple[str, ...]

    @property
    @abstractmethod
    def sources(self) -> tuple[str, ...]:
        """The file of each."""

    @abstractmethod
    def checksum(self) -> str:
        """Of names, places and content: parts with equal ones give the same rows."""

    @abstractmethod
    def loaded(self) -> BlockPart:
        """The same with its numbers, read where they have not been.

        Raises DataError where a table cannot be read or has changed since its checksum.
        """

    @abstractmethod
    def data_sets(self) -> Iterator[DataSet]:
        """One after the other, of a part that is loaded."""


@dataclass(frozen=True)
class Source:
    """Where data sets come from: how many there are, and a function that yields blocks of so many, each of parts."""

    count: int
    blocks: Callable[[int], Iterator[tuple[BlockPart, ...]]]


def expanded(patterns: Iterable[str], order: Order = "name") -> list[str]:
    """Files that names and patterns (data/*.parquet, ** for folders within) lead to, each once.

    In the order of their names, numbers in them counted as such (run2 before run10), of the time when they were last
    changed, or as given.  Raises UsageError where a name leads to nothing, DataError as `files_fitting`.
    """
    files: dict[str, None] = {}
    for pattern in patterns:
        if not is_pattern(pattern) and not os.path.exists(pattern):
            raise UsageError("there is no such file", pattern, "correct the name or the folder")
        found = sorted(files_fitting(pattern), key=natural) if is_pattern(pattern) else [pattern]
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


def digest_of(*values: object) -> str:
    """SHA-256 of texts and whole numbers, in tuples or alone."""
    return hashlib.sha256(repr(values).encode("utf-8", "surrogatepass")).hexdigest()


# A file each


@dataclass(frozen=True)
class Files(BlockPart):
    """Files that are a data set each, with the checksums of their contents, or the reason why there is none."""

    names: tuple[str, ...]
    contents: tuple[str, ...]

    @property
    def sources(self) -> tuple[str, ...]:
        """The files, which are the names."""
        return self.names

    def checksum(self) -> str:
        """Of all files."""
        return digest_of(self.names, self.contents)

    def loaded(self) -> Files:
        """As it is: each file is read when it is identified."""
        return self

    def data_sets(self) -> Iterator[DataSet]:
        """One for each file."""
        for path in self.names:
            yield DataSet(path, path)


def of_files(paths: Sequence[str]) -> Source:
    """Every file a data set of its own; one that cannot be read is one too."""

    def blocks(size: int) -> Iterator[tuple[BlockPart, ...]]:
        for first in range(0, len(paths), size):
            some = tuple(paths[first : first + size])
            yield (Files(some, tuple(_checksum(path) for path in some)),)

    return Source(len(paths), blocks)


def _checksum(path: str) -> str:
    digest = hashlib.sha256()
    try:
        with open(noted(path), "rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
    except (OSError, ValueError) as error:
        return f"unreadable: {error}"
    return digest.hexdigest()
