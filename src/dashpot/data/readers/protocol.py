"""What a reader of a file format is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from dashpot.data.readers.columns import Columns
from dashpot.data.readers.datafile import DataFile


class Reader(Protocol):
    """One file format.  A new one is a module with such a value and a line in the registry.

    The parts of a file are its groups, blocks or sheets: columns of one length each.  Readers know nothing of rigs:
    `time_s` is a part's time where the format has its own sampling, `frequency_hz` and `experiment` what it says of
    the drive; `OUT/IN_re`, `OUT/IN_im` are frequency response functions.
    """

    @property
    def format(self) -> str:
        """The name of the format, for messages."""

    @property
    def extra(self) -> str | None:
        """The extra of dashpot that installs what the reader needs; None: nothing."""

    def sniff(self, file: DataFile) -> bool:
        """Whether a file is of this format, by its first bytes or its name."""

    def parts(self, file: DataFile) -> Iterable[Columns]:
        """The parts of a file.  Raises DataError, one line, for what is damaged or cut off."""
