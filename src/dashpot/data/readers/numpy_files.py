"""Arrays that NumPy has saved: .npz, and .npy of a structured array.  Nothing in them is executed."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from typing import Any, cast

import numpy as np

from dashpot.data.readers.arrays import LONG, PIECE, ArrayColumns, Streamed, parts_of_variables
from dashpot.data.readers.columns import MOST_COLUMNS
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import damaged
from dashpot.errors import DataError
from dashpot.io.ledger import noted


def is_numpy(file: DataFile) -> bool:
    """A saved array, or a zip archive that begins with one."""
    packed = file.head.startswith(b"PK\x03\x04") and b".npy" in file.head[30:300]
    return packed or file.head.startswith(b"\x93NUMPY")


def read_numpy(file: DataFile) -> Iterator[ArrayColumns]:
    """The arrays of one length each; their units are text arrays NAME_unit.

    Raises DataError if the file cannot be read.
    """
    variables: dict[str, Any] = {}
    units: dict[str, str | None] = {}
    with damaged(file.name, "NumPy"):
        if file.head.startswith(b"\x93NUMPY"):
            variables = _fields(np.load(noted(file.path), mmap_mode="r", allow_pickle=False))
        else:
            with file.reading() as stream, np.load(cast(Any, stream), allow_pickle=False) as archive:
                file.check_unpacked(sum(item.file_size for item in archive.zip.infolist()))
                if len(archive.files) > 2 * MOST_COLUMNS:  # units among them
                    what = f"there are {len(archive.files)} arrays"
                    raise DataError(what, file.name, "give a file with fewer")
                for name in archive.files:
                    array = _streamed_member(file, archive.zip, name)
                    array = archive[name] if array is None else array
                    if isinstance(array, Streamed):
                        variables[name] = array
                    elif array.dtype.kind == "U" and array.ndim == 0 and name.endswith("_unit"):
                        units[name.removesuffix("_unit")] = str(array)
                    elif array.dtype.names:
                        variables |= _fields(array)
                    else:
                        variables[name] = array
    yield from parts_of_variables(file.name, variables, units)


def _fields(array: Any) -> dict[str, Any]:
    return {name: array[name] for name in array.dtype.names or ()}


def _streamed_member(file: DataFile, archive: zipfile.ZipFile, name: str) -> Streamed | None:
    """A long column of numbers in an archive; None for everything else."""
    member = f"{name}.npy"
    if member not in archive.NameToInfo or archive.getinfo(member).file_size < 8 * LONG:
        return None
    with archive.open(member) as raw:
        shape, kind = _header(raw)
    if len(shape) != 1 or shape[0] < LONG or kind.kind not in "fiub":
        return None

    def pieces() -> Iterator[Any]:
        with (
            damaged(file.name, "NumPy"),
            file.reading() as stream,
            zipfile.ZipFile(stream) as whole,
            whole.open(member) as raw,
        ):
            _header(raw)
            for at in range(0, shape[0], PIECE):
                count = min(PIECE, shape[0] - at)
                yield np.frombuffer(raw.read(count * kind.itemsize), dtype=kind, count=count)

    return Streamed(shape[0], pieces)


def _header(raw: Any) -> tuple[tuple[int, ...], Any]:
    """Shape and kind of a saved array; what follows are its numbers."""
    version = np.lib.format.read_magic(raw)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = read(raw)
    return shape, kind
