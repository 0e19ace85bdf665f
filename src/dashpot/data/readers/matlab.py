"""MATLAB files: version 5 to 7.2 by SciPy; 7.3 as the HDF5 that it is."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator
from functools import partial
from math import prod
from typing import Any, cast

import numpy as np

from dashpot.data.readers.arrays import LONG, ArrayColumns, Streamed, parts_of_variables
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError
from dashpot.io.ledger import noted


def read_matlab(file: DataFile, scipy_io: Any) -> Iterator[ArrayColumns]:
    """The variables; fields of structures are STRUCT.FIELD, or FIELD where one structure is all there is.

    Elements of an array of structures are parts of their own.
    """
    every = list(variables_of(file))
    variables: dict[str, Any] = {name: value for name, value in every if value is not None}
    others = [name for name, value in every if value is None] if variables else None
    with warnings.catch_warnings(), file.reading() as stream:
        warnings.simplefilter("ignore")  # of objects that only MATLAB can read
        content: dict[str, Any] = scipy_io.loadmat(
            cast(Any, stream),
            variable_names=others,
            squeeze_me=False,
            struct_as_record=False,
            verify_compressed_data_integrity=True,
        )
    series: list[tuple[str, dict[str, Any]]] = []
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    filled = [value for value in named.values() if np.size(value) > 1 or len(_structures(value)) == 1]
    for name, value in named.items():
        if not variables and len(filled) == len(_structures(value)) == 1:  # as an array of one
            series.append((name, _fields(_structures(value)[0], 0)))
        else:
            _flatten(name, value, variables, series)
    for name, fields in series:
        yield from parts_of_variables(f"{file.name} ({name})", {**variables, **fields})
    if series and not any(np.size(value) > 1 for value in variables.values()):
        return
    yield from parts_of_variables(file.name, variables)


# The variables of a file of version 5. Long vectors are not held: mapped, or unpacked in pieces.


MATRIX, COMPRESSED = 14, 15  # kinds of data elements
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
NUMERIC = range(6, 16)  # classes of arrays, from double to uint64
HEAD = 1 << 16  # bytes of an element that are looked at


def variables_of(file: DataFile) -> Iterator[tuple[str, Any]]:
    """The name of each variable and, of a long real vector, its numbers; None of another one.

    Raises DataError if one reaches beyond the end of the file, or unpacks to too much.
    """
    data, position, unpacked = file.contents, 128, 0
    order = ">" if data[126:128] == b"MI" else "<"
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        start, position = position + 8, position + 8 + size
        if position > len(data):
            raise DataError("the MATLAB file is cut off", file.name, "copy it again")
        if kind not in (MATRIX, COMPRESSED) or not size:
            continue
        head = bytes(data[start : min(position, start + HEAD)])
        if kind == COMPRESSED:
            head = zlib.decompressobj().decompress(head, HEAD)
            size = struct.unpack_from(f"{order}I", head, 4)[0]
            unpacked += size
            file.check_unpacked(unpacked)
            head = head[8:]
        name, rows, dtype, at = _header(head, order, size)
        if dtype is None:
            yield name, None
        elif kind == COMPRESSED:
            yield name, Streamed(rows, partial(_unpacked, file, start, 8 + at, rows, dtype))
        else:
            yield name, np.memmap(noted(file.path), dtype, "r", start + at, (rows,))


def _header(head: bytes, order: str, room: int) -> tuple[str, int, np.dtype[Any] | None, int]:
    """The name of an array, how many numbers it holds and, of a long real vector, their kind and where they begin.

    room: bytes of it all.  Raises ValueError if its numbers take another number of bytes, or its cells or
    structures, each of which is an element with a head of eight bytes, more than there are.
    """
    flags_at, _, _, following = _element(head, 0, order)
    dimensions_at, size, _, following = _element(head, following, order)
    name_at, length, _, following = _element(head, following, order)
    name = head[name_at : name_at + length].decode("latin-1")
    flags = struct.unpack_from(f"{order}I", head, flags_at)[0]
    shape = struct.unpack_from(f"{order}{size // 4}i", head, dimensions_at)
    rows = prod(shape)
    # Flags hold the class of an array (cells, structures and objects hold arrays), and whether it is complex.
    if flags & 0xFF in (1, 2, 3) and 8 * rows > room:
        raise ValueError("its header states more data than it contains")
    if flags & 0xFF not in NUMERIC or flags & 0x0800 or rows < LONG or rows != max(shape):
        return name, rows, None, 0
    numbers_at, size, kind, _ = _element(head, following, order)
    dtype = np.dtype(order + TYPES[kind])
    if size != rows * dtype.itemsize:
        raise ValueError("its header states more data than it contains")
    return name, rows, dtype, numbers_at


def _element(head: bytes, position: int, order: str) -> tuple[int, int, int, int]:
    """Where the content of an element begins, its size and kind, and where the next one begins."""
    kind, size = struct.unpack_from(f"{order}II", head, position)
    if kind >> 16:  # small: size and kind in one word, the content in the other
        return position + 4, min(kind >> 16, 4), kind & 0xFFFF, position + 8
    return position + 8, size, kind, position + 8 + size + (-size) % 8


def _unpacked(file: DataFile, start: int, before: int, rows: int, dtype: np.dtype[Any]) -> Iterator[Any]:
    """The numbers of a compressed element that begins at byte `start`, `before` of whose bytes stand before them."""
    unpack, held = zlib.decompressobj(), bytearray()
    with file.reading() as raw:
        raw.seek(start)
        while rows:
            packed = raw.read(1 << 17)  # which unpacks to 140 MB at most
            if not packed:
                raise DataError("the MATLAB file is cut off", file.name, "copy it again")
            held += unpack.decompress(packed)
            left_out = min(before, len(held))
            count = min((len(held) - left_out) // dtype.itemsize, rows)
            end = left_out + count * dtype.itemsize
            if count:
                yield np.frombuffer(bytes(held[left_out:end]), dtype)
            del held[:end]
            before, rows = before - left_out, rows - count


def _structures(value: Any) -> list[Any]:
    """The structures of an array of them; none of another value."""
    items = np.asarray(value).ravel().tolist() if np.asarray(value).dtype.kind == "O" else []
    return items if all(hasattr(item, "_fieldnames") for item in items) else []


def _fields(structure: Any, depth: int) -> dict[str, Any]:
    """The fields of a structure under their names."""
    fields: dict[str, Any] = {}
    for field in structure._fieldnames:
        _flatten(field, getattr(structure, field), fields, [], depth + 1)
    return fields


def _flatten(
    name: str, value: Any, variables: dict[str, Any], series: list[tuple[str, dict[str, Any]]], depth: int = 0
) -> None:
    """Put a variable under its name, and the fields of structures under theirs."""
    array = np.asarray(value)
    if array.dtype.kind in "fiubc":
        variables[name] = array
        return
    structures = _structures(value) if depth <= 8 else []  # structures inside structures
    if len(structures) == 1:
        for field in structures[0]._fieldnames:
            inner = getattr(structures[0], field)
            _flatten(f"{name}.{field}", inner, variables, series, depth + 1)
        return
    for k, item in enumerate(structures):
        series.append((f"{name}({k + 1})", _fields(item, depth)))
