"""The file formats: a new one is a line here.  They are asked in this order; text takes what nothing else knows."""

from __future__ import annotations

from dashpot.data.readers.arrow_files import FeatherReader, ParquetReader
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.delimited.lvm import LabViewReader
from dashpot.data.readers.delimited.reader import TextReader
from dashpot.data.readers.delimited.xsens import XsensReader
from dashpot.data.readers.excel import ExcelReader
from dashpot.data.readers.famos import FamosReader
from dashpot.data.readers.hdf5 import Hdf5Reader
from dashpot.data.readers.matlab import MatlabReader
from dashpot.data.readers.mdf import MdfReader
from dashpot.data.readers.numpy_files import NumpyReader
from dashpot.data.readers.protocol import Reader
from dashpot.data.readers.tdms import TdmsReader
from dashpot.data.readers.uff.reader import UffReader
from dashpot.data.readers.wav import WavReader
from dashpot.errors import DataError

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
