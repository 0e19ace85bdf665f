"""The file formats: a new one is a line here.  They are asked in this order; text takes what nothing else knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from dashpot.data.readers.arrow_files import read_feather, read_parquet
from dashpot.data.readers.columns import Columns
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.famos import read_famos
from dashpot.data.readers.guarded import guarded, library
from dashpot.data.readers.hdf5 import is_hdf5, read_hdf5
from dashpot.data.readers.instruments import is_labview, is_xsens, read_labview, read_xsens
from dashpot.data.readers.matlab import read_matlab
from dashpot.data.readers.mdf import read_mdf
from dashpot.data.readers.numpy_files import is_numpy, read_numpy
from dashpot.data.readers.tdms import read_tdms
from dashpot.data.readers.text import is_excel, is_text, read_excel, read_text
from dashpot.data.readers.uff import is_universal, read_universal
from dashpot.data.readers.wav import is_wav, read_wav
from dashpot.errors import DataError


@dataclass(frozen=True)
class Reader:
    """One file format.

    The parts of a file are its groups, blocks or sheets: columns of one length each.  Readers know nothing of rigs:
    `time_s` is a part's time where the format has its own sampling, `frequency_hz` and `experiment` what it says of
    the drive; `OUT/IN_re`, `OUT/IN_im` are frequency response functions.

    format   its name, for messages
    read     gives the parts of a file; takes the library, where one is needed.  Raises DataError, one line, for what
             is damaged or cut off; where native code reads, anything
    starts   what its files begin with, or
    sniff    whether a file is of this format, by its first bytes or its name
    module   the library, and the extra of dashpot that installs it
    native   whether it is native code, which then works in a process of its own
    """

    format: str
    read: Callable[..., Iterator[Columns]]
    starts: tuple[bytes, ...] = ()
    sniff: Callable[[DataFile], bool] = lambda file: False
    module: tuple[str, str] | None = None
    native: bool = False

    def parts(self, file: DataFile) -> Iterator[Columns]:
        """The parts of a file, one at least.

        Raises DataError, one line, for what is damaged, cut off or without numbers, and what is not installed.
        """
        needed = [] if self.module is None else [library(*self.module, file.name, self.format)]
        read = partial(self.read, file, *needed)
        part = None
        for part in guarded(file, self.format, read) if self.native else read():
            yield part
        if part is None:
            what, cure = "there are no channels with samples", "save some in it, or name another file"
            raise DataError(what, file.name, cure)


_FORMATS = "formats"
READERS = (
    Reader("MATLAB", read_matlab, (b"MATLAB 5.0 MAT-file",), module=("scipy.io", ""), native=True),
    Reader("HDF5", read_hdf5, sniff=is_hdf5, module=("h5py", _FORMATS), native=True),
    Reader("NumPy", read_numpy, sniff=is_numpy),
    Reader("Parquet", read_parquet, (b"PAR1",), module=("pyarrow.parquet", ""), native=True),
    Reader("Feather", read_feather, (b"ARROW1", b"FEA1"), module=("pyarrow.feather", ""), native=True),
    Reader("Excel", read_excel, sniff=is_excel, module=("fastexcel", _FORMATS)),
    Reader("WAV", read_wav, sniff=is_wav),
    Reader("TDMS", read_tdms, (b"TDSm", b"TDSh"), module=("nptdms", _FORMATS), native=True),
    Reader("MDF", read_mdf, (b"MDF     ", b"UnFinMF "), module=("asammdf", "mdf"), native=True),
    Reader("FAMOS", read_famos, (b"|CF,2,",)),
    Reader("UFF", read_universal, sniff=is_universal),
    Reader("LabVIEW measurement", read_labview, sniff=is_labview),
    Reader("Xsens DOT", read_xsens, sniff=is_xsens),
    Reader("text", read_text, sniff=lambda file: is_text(file.head)),
)


_NO_DATA = {  # what is given in the place of a recording, by what such files begin with
    "a PDF document": (b"%PDF",),
    "a picture": (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"II*\0", b"MM\0*"),
    "an archive": (b"PK\x03\x04", b"7z\xbc\xaf", b"Rar!", b"\xfd7zXZ"),
    "a film": (b"\x1aE\xdf\xa3", b"\0\0\0\x18ftyp", b"\0\0\0\x1cftyp", b"\0\0\0 ftyp"),
    "a program": (b"\x7fELF",),
}


def reader_of(file: DataFile) -> Reader:
    """The first reader whose file it is.  Raises DataError if there is none."""
    *formats, text = READERS
    for reader in formats:
        if file.head.startswith(reader.starts) or reader.sniff(file):
            return reader
    for what, begins in _NO_DATA.items():
        if file.head.startswith(begins):
            raise DataError(f"this is {what}, not a recording", file.name, "name the file with the numbers")
    if text.sniff(file):
        return text
    known = ", ".join(reader.format for reader in READERS)
    raise DataError("the file is not text, and its format is unknown", file.name, f"formats are {known}")
