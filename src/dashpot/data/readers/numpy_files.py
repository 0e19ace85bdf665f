"""Arrays that NumPy has saved: .npz, and .npy of a structured array.  Nothing in them is executed."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.data.readers.columns import ArrayColumns
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.optional import damaged
from dashpot.data.readers.variables import parts_of_variables
from dashpot.errors import DataError

LARGEST_RATIO = 1100  # of unpacked to packed size: more than deflate can do honestly


@dataclass(frozen=True)
class NumpyReader:
    """Arrays by their names; units as a text array NAME_unit."""

    format: str = "NumPy"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """A saved array, or a zip archive that begins with one."""
        if file.head.startswith(b"\x93NUMPY"):
            return True
        return file.head.startswith(b"PK\x03\x04") and b".npy" in file.head[30:300]

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The arrays of one length each."""
        variables: dict[str, Any] = {}
        units: dict[str, str | None] = {}
        with damaged(file.name, self.format):
            if file.head.startswith(b"\x93NUMPY"):
                variables = _fields(np.load(io.BytesIO(file.contents), allow_pickle=False))
            else:
                _check_sizes(file)
                with np.load(io.BytesIO(file.contents), allow_pickle=False) as archive:
                    for name in archive.files:
                        array = archive[name]
                        if array.dtype.kind == "U" and array.ndim == 0 and name.endswith("_unit"):
                            units[name.removesuffix("_unit")] = str(array)
                        elif array.dtype.names:
                            variables |= _fields(array)
                        else:
                            variables[name] = array
        if not any(np.size(value) > 1 for value in variables.values()):
            raise DataError("there are no named arrays of numbers", file.name, "save them by np.savez(x1=…)")
        yield from parts_of_variables(file.name, variables, units)


def _fields(array: Any) -> dict[str, Any]:
    return {name: array[name] for name in array.dtype.names or ()}


def _check_sizes(file: DataFile) -> None:
    """Raises DataError for an archive that unpacks to more than its bytes can hold."""
    with zipfile.ZipFile(io.BytesIO(file.contents)) as archive:
        size = sum(item.file_size for item in archive.infolist())
    if size > LARGEST_RATIO * len(file.contents):
        raise DataError("the archive claims to be far larger than it is", file.name, "it may be damaged")
