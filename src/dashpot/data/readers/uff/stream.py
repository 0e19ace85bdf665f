"""The datasets of a universal file, one after another, without holding the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError

MARK = b"-1"
LONGEST_LINE = 10_000  # bytes; lines have 80
PIECE = 1 << 24  # bytes that are read at once


class UffStream:
    """Lines and blocks of bytes of a universal file, with the number of the line for messages."""

    def __init__(self, stream: BinaryIO, file: DataFile, number: int = 0) -> None:
        self._stream = stream
        self.file = file
        self.number = number

    @property
    def place(self) -> str:
        """The file and the line."""
        return f"{self.file.name}:{self.number}"

    def line(self) -> bytes:
        """The next line without its end; empty lines count.  Raises DataError at the end of the file."""
        text = self._stream.readline(LONGEST_LINE)
        if not text:
            raise self.cut_off()
        self.number += 1
        return text.rstrip(b"\r\n")

    def line_or_end(self) -> bytes | None:
        """The next line, None at the end of the file."""
        text = self._stream.readline(LONGEST_LINE)
        self.number += bool(text)
        return text.rstrip(b"\r\n") if text else None

    def block(self, size: int) -> bytes:
        """So many bytes.  Raises DataError where there are fewer."""
        return b"".join(self._pieces(size))

    @property
    def position(self) -> int:
        """The byte of the file that comes next."""
        return self._stream.tell()

    def skip(self, size: int) -> None:
        """Pass over so many bytes.  Raises DataError where there are fewer."""
        for _ in self._pieces(size):
            pass

    def _pieces(self, missing: int) -> Iterator[bytes]:
        while missing:
            piece = self._stream.read(min(missing, PIECE))
            if not piece:
                raise self.cut_off()
            yield piece
            missing -= len(piece)

    def cut_off(self) -> DataError:
        """The file ends inside a dataset."""
        return DataError("the file ends within a dataset: it is cut off", self.place, "copy it again")

    def wrong(self, what: str) -> DataError:
        """What is wrong at the present line."""
        return DataError(what, self.place, "the file is damaged; export it again")


@dataclass(frozen=True)
class DatasetStart:
    """The first line of a dataset: its number, and what follows it (of 58b: how the bytes are written)."""

    number: int
    binary: bool
    rest: bytes


def dataset_starts(stream: UffStream) -> Iterator[DatasetStart]:
    """Starts of the datasets; who asks for the next one has read the present one to its end.

    Raises DataError where something else stands between datasets.
    """
    while (text := stream.line_or_end()) is not None:
        if not text.strip():
            continue
        if text.strip() != MARK:
            raise stream.wrong("a dataset should begin here, with -1")
        head = stream.line()
        number = head[:6].strip()
        if not number.isdigit():
            raise stream.wrong("the number of a dataset should stand here")
        yield DatasetStart(int(number), head[6:7].lower() == b"b", head[7:])


def skip_dataset(stream: UffStream) -> None:
    """Read on to the end of the dataset."""
    while stream.line().strip() != MARK:
        pass


def expect_end(stream: UffStream) -> None:
    """The end of the dataset.  Raises DataError where something else follows."""
    text = stream.line()
    if not text.strip():
        text = stream.line()
    if text.strip() != MARK:
        raise stream.wrong("the dataset should end here, with -1: it holds more than it says")
