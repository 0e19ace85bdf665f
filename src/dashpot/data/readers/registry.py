"""The file formats: a new one is a line here.  They are asked in this order; text takes what nothing else knows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from dashpot.data.readers.arrow_files import FeatherReader, ParquetReader
from dashpot.data.readers.columns import Columns
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.excel import ExcelReader
from dashpot.data.readers.famos import FamosReader
from dashpot.data.readers.hdf5 import Hdf5Reader
from dashpot.data.readers.instruments import LabViewReader, XsensReader
from dashpot.data.readers.matlab import MatlabReader
from dashpot.data.readers.mdf import MdfReader
from dashpot.data.readers.numpy_files import NumpyReader
from dashpot.data.readers.tdms import TdmsReader
from dashpot.data.readers.text import TextReader
from dashpot.data.readers.uff.reader import UffReader
from dashpot.data.readers.wav import WavReader
from dashpot.errors import DataError

# What a reader of a file format is.


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


READERS: tuple[Reader, ...] = (
    MatlabReader(),
    Hdf5Reader(),
    NumpyReader(),
    ParquetReader(),
    FeatherReader(),
    ExcelReader(),
    WavReader(),
    TdmsReader(),
    MdfReader(),
    FamosReader(),
    UffReader(),
    LabViewReader(),
    XsensReader(),
    TextReader(),
)


def reader_of(file: DataFile) -> Reader:
    """The first reader whose file it is.  Raises DataError where there is none."""
    for reader in READERS:
        if reader.sniff(file):
            return reader
    known = ", ".join(reader.format for reader in READERS)
    raise DataError("the file is not text, and its format is not known", file.name, f"there are {known}")
