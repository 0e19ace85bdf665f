"""HDF5, MATLAB 7.3 among it: datasets are variables, groups are parts, attributes say units and sampling."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.data.readers.array_columns import LONG, PIECE, ArrayColumns, Streamed
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.optional import damaged, library
from dashpot.data.readers.variables import parts_of_variables
from dashpot.errors import DataError
from dashpot.io.ledger import noted

SIGNATURE = b"\x89HDF\r\n\x1a\n"
UNITS = ("unit", "units", "Unit", "Units", "unit_string")
MOST_GROUPS = 10_000

HEAP = b"GCOL\x01\0\0\0"  # begins a heap of texts: signature, version, three zeros; then its size
SMALLEST_HEAP = 4096  # bytes
VLEN = 9  # libhdf5's class of sequences of any length, as which it takes some damaged texts and dies of them


@dataclass(frozen=True)
class Hdf5Reader:
    """Every group that holds datasets of numbers is a part; attributes of a group and its parents are scalars of it."""

    format: str = "HDF5"
    extra: str | None = "formats"

    def sniff(self, file: DataFile) -> bool:
        """The signature at one of the places where it may stand."""
        return any(file.head[at : at + 8] == SIGNATURE for at in (0, 512, 1024, 2048))

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The groups, the outermost first.  Raises DataError where the file cannot be read."""
        h5py = library("h5py", "formats", file.name, self.format)
        with _opened(h5py, file) as content:
            groups = [("", content)]
            anything = False
            for name, group in groups:
                with damaged(file.name, self.format):
                    variables, units = _scalars(group), {}
                    for key, item in _named(group):
                        if isinstance(item, h5py.Group) and not key.startswith("#"):
                            groups.append((f"{name}/{key}" if name else key, item))
                        elif isinstance(item, h5py.Dataset):
                            variables |= _variable(key, item)
                            units[key] = _unit(item)
                            variables |= {
                                k: v
                                for k, v in _scalars(item).items()
                                if k not in variables and np.ndim(v) == 0
                            }
                if len(groups) > MOST_GROUPS:
                    raise DataError(f"there are over {MOST_GROUPS} groups", file.name, "give a smaller file")
                if any(np.size(value) > 1 for value in variables.values()):
                    anything = True
                    place = f"{file.name} ({name})" if name else file.name
                    yield from parts_of_variables(place, variables, units)
            if not anything:
                raise DataError(
                    "there are no datasets of numbers", file.name, "save the channels as datasets"
                )


def _named(group: Any) -> Iterator[tuple[str, Any]]:
    """What a group holds by name; names that are no text, which h5py gives as bytes, as far as they are."""
    for key, item in group.items():
        yield key.decode("utf-8", errors="replace") if isinstance(key, bytes) else key, item


@contextmanager
def _opened(h5py: Any, file: DataFile) -> Iterator[Any]:
    with damaged(file.name, "HDF5"):
        _refuse_endless_heaps(file.contents)
        with h5py.File(noted(file.path), "r") as content:
            yield content


def _refuse_endless_heaps(content: bytes | mmap.mmap) -> None:
    """Raises ValueError where libhdf5 would walk for ever through a heap of texts whose objects have no size."""
    start = content.find(HEAP)
    while start >= 0:
        size = int.from_bytes(content[start + 8 : start + 16], "little")
        end, at = start + size, start + 16
        while size >= SMALLEST_HEAP and end <= len(content) and at + 16 <= end:
            index = int.from_bytes(content[at : at + 2], "little")
            length = int.from_bytes(content[at + 8 : at + 16], "little")
            step = 16 + -(-length // 8) * 8 if index else length
            if step == 0 or at + step > end:
                raise ValueError("an object of a heap has a wrong size")
            at += step
        start = content.find(HEAP, start + 8)


def _variable(name: str, item: Any) -> dict[str, Any]:
    """A dataset of numbers as a variable; complex numbers of MATLAB are pairs of fields."""
    if item.dtype.names:
        if set(item.dtype.names) == {"real", "imag"}:
            value = item[()]
            return {name: value["real"] + 1j * value["imag"]}
        if item.ndim == 1:  # a table
            return {field: item[field] for field in item.dtype.names if item.dtype[field].kind in "fiub"}
        return {}
    if item.dtype.kind not in "fiubc" or item.size == 0 or "MATLAB_empty" in item.attrs:
        return {}
    kind = "MATLAB_class"
    if kind in item.attrs and not _is_sequence(item, kind) and item.attrs[kind] in (b"char", b"cell"):
        return {}
    if item.dtype.kind in "fiub" and max(item.shape, default=0) == item.size >= LONG:
        return {name: _streamed_dataset(item)}
    return {name: item[()]}


def _streamed_dataset(item: Any) -> Streamed:
    """A dataset with one long axis."""
    axis = item.shape.index(item.size)

    def pieces() -> Iterator[Any]:
        for start in range(0, item.size, PIECE):
            at = [slice(None)] * item.ndim
            at[axis] = slice(start, start + PIECE)
            yield item[tuple(at)].ravel()

    return Streamed(item.size, pieces)


def _scalars(item: Any) -> dict[str, Any]:
    """Attributes that are single numbers, of an item and of the groups around it."""
    scalars: dict[str, Any] = {}
    while True:
        for name in item.attrs:
            if _is_sequence(item, name):
                continue
            value = item.attrs[name]
            if np.size(value) == 1 and np.asarray(value).dtype.kind in "fiu":
                scalars.setdefault(name, np.asarray(value).ravel()[0])
        if item.name in ("/", None):
            return scalars
        item = item.parent


def _is_sequence(item: Any, name: str) -> bool:
    """Whether an attribute is a sequence of any length: neither a number nor a text."""
    return bool(item.attrs.get_id(name).get_type().get_class() == VLEN)


def _unit(item: Any) -> str | None:
    for name in UNITS:
        if name not in item.attrs:
            continue
        if _is_sequence(item, name):
            raise ValueError("a unit is no text")
        value = item.attrs[name]
        if isinstance(value, bytes):
            return value.decode("utf-8", errors="replace")
        if isinstance(value, str):
            return value
    return None
