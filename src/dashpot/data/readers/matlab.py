"""MATLAB files: version 5 to 7.2 by SciPy, 7.3 as the HDF5 that it is."""

from __future__ import annotations

import mmap
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any, BinaryIO, cast

import numpy as np

from dashpot.data.readers.arrays import LONG, PIECE, ArrayColumns, Streamed, parts_of_variables
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import damaged
from dashpot.errors import DataError

# Whether a MATLAB file of version 5 can hold what its headers claim: a lie there would cost memory and
# time.
#
# An array of n elements needs n bytes at least, and every element of the file lies inside the one around
# it.


HEADER = 128
MATRIX, COMPRESSED, INT32 = 14, 15, 5
KINDS = {*range(1, 8), 9, *range(12, 19)}  # of data elements
CELL, STRUCTURE, OBJECT, SPARSE, OPAQUE = 1, 2, 3, 5, 17
NUMERIC = range(6, 16)  # classes of arrays, from double to uint64
PARTS = {SPARSE: 6, **dict.fromkeys(NUMERIC, 4)}  # of an array that is not complex, by class
COMPLEX = 0x0800
MOST_COMPRESSED = 1100  # times, by deflate
DEEPEST = 20
HEAD = 1 << 16  # bytes of a compressed element that are looked at


@dataclass(frozen=True)
class Tag:
    """What begins an element: its kind and size, where its content starts and where the next one begins."""

    kind: int
    size: int
    start: int
    following: int

    @property
    def end(self) -> int:
        """Where the content ends."""
        return self.start + self.size

    @staticmethod
    def at(data: bytes | mmap.mmap, position: int, order: str) -> Tag:
        """The tag at a place."""
        kind, size = struct.unpack_from(f"{order}II", data, position)
        if kind >> 16:  # small: size and kind in one word, the content in the other
            return Tag(kind & 0xFFFF, min(kind >> 16, 4), position + 4, position + 8)
        padded = size if kind == COMPRESSED else size + (-size) % 8
        return Tag(kind, size, position + 8, position + 8 + padded)


def elements_of(data: bytes | mmap.mmap, source: str) -> Iterator[tuple[str, Tag]]:
    """Byte order and tag of each variable.  Raises DataError where one reaches beyond the end of the file."""
    if len(data) < HEADER:
        raise _lie(source)
    order = ">" if data[126:128] == b"MI" else "<"
    position = HEADER
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        element = Tag(kind, size, position + 8, position + 8 + size)
        if element.end > len(data):
            raise DataError("the MATLAB file is cut off", source, "copy it again")
        yield order, element
        position = element.end


def check_layout(file: DataFile, data: bytes | mmap.mmap) -> None:
    """Raises DataError where an element reaches beyond its end, claims more than it holds or unpacks to too much."""
    source, unpacked = file.name, 0
    for order, element in elements_of(data, source):
        if element.kind == COMPRESSED:
            unpacked += _unpacked_size(data, element, order, source)
            file.check_unpacked(unpacked)
            _check_compressed(data, element, order, source)
        elif element.kind == MATRIX:
            _check_matrix(data, element.start, element.end, order, source, 0)


def _unpacked_head(data: bytes | mmap.mmap, element: Tag, source: str) -> bytes:
    """What a compressed element begins with: a tag at least."""
    packed = data[element.start : min(element.end, element.start + HEAD)]
    try:
        head = zlib.decompressobj().decompress(packed, HEAD)
    except zlib.error:
        raise DataError("the MATLAB file is damaged", source, "copy it again") from None
    if len(head) < 8:
        raise _lie(source)
    return head


def _unpacked_size(data: bytes | mmap.mmap, element: Tag, order: str, source: str) -> int:
    """Bytes to which a compressed element unpacks, of which SciPy reads no more."""
    size: int = struct.unpack_from(f"{order}II", _unpacked_head(data, element, source), 0)[1]
    return size


def _check_compressed(data: bytes | mmap.mmap, element: Tag, order: str, source: str) -> None:
    """The header of a compressed element."""
    head = _unpacked_head(data, element, source)
    try:
        kind, size = struct.unpack_from(f"{order}II", head, 0)
        if kind != MATRIX:
            return
        if size > MOST_COMPRESSED * element.size:
            raise _lie(source)
        kind_of_array = struct.unpack_from(f"{order}I", head, 16)[0] & 0xFF if len(head) == HEAD else 0
        if kind_of_array in (CELL, STRUCTURE, OBJECT):  # arrays inside are looked at as well
            head = zlib.decompressobj().decompress(data[element.start : element.end], 8 + size)
    except zlib.error:
        raise DataError("the MATLAB file is damaged", source, "copy it again") from None
    _check_matrix(head, 8, 8 + size, order, source, 0)


def _check_matrix(data: bytes | mmap.mmap, start: int, end: int, order: str, source: str, depth: int) -> None:
    """An array: what it claims to hold, and the arrays inside it as far as the bytes go."""
    if start == end:
        return
    number, flags = 0, 0
    for tag in _parts(data, start, end, order, source):
        size, content = tag.size, tag.start
        if number == 0 and size >= 4 and content < len(data):
            flags = struct.unpack_from(f"{order}I", data, content)[0]
            if flags & 0xFF == OPAQUE:
                return
        elif number == 1 and tag.kind == INT32 and content + size <= len(data):
            elements = prod(struct.unpack_from(f"{order}{size // 4}i", data, content))
            if flags & 0xFF != SPARSE and not 0 <= elements <= end - start:
                raise _lie(source)
        elif tag.kind == MATRIX and depth < DEEPEST:
            _check_matrix(data, content, content + size, order, source, depth + 1)
        number += 1
    parts = PARTS.get(flags & 0xFF)
    if parts is not None and end <= len(data) and number != parts + bool(flags & COMPLEX):
        raise _lie(source)  # SciPy reads on where it should find an imaginary part


def _parts(data: bytes | mmap.mmap, start: int, end: int, order: str, source: str) -> Iterator[Tag]:
    """The elements of an array, as far as the bytes go."""
    position = start
    while position + 8 <= min(end, len(data)):
        tag = Tag.at(data, position, order)
        if tag.end > end or tag.kind not in KINDS:  # SciPy looks kinds up without asking whether they exist
            raise _lie(source)
        yield tag
        position = tag.following


def _lie(source: str) -> DataError:
    return DataError("the MATLAB file claims more than it holds", source, "it is damaged; copy it again")


# Long vectors of MATLAB files of version 5 as columns that are not held: read, and unpacked, in pieces.


TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
READ = 1 << 20  # bytes


@dataclass(frozen=True)
class LongVectors:
    """The long real vectors of a file by name, and the names of its other variables (None: all, as there is none)."""

    vectors: Mapping[str, Streamed]
    others: list[str] | None


def long_vectors(file: DataFile, data: bytes | mmap.mmap) -> LongVectors:
    """What need not be held; `data` is the file, whose layout has been checked."""
    vectors: dict[str, Streamed] = {}
    others = []
    for order, element in elements_of(data, file.name):
        if element.kind not in (MATRIX, COMPRESSED) or not element.size:
            continue
        head, start, packed = (
            bytes(data[element.start : min(element.end, element.start + HEAD)]),
            element.start,
            None,
        )
        if element.kind == COMPRESSED:
            head, start, packed = zlib.decompressobj().decompress(head, HEAD)[8:], 8, element
        name, numbers = _variable(file, head, order, start, packed)
        if numbers is None:
            others.append(name)
        else:
            vectors[name] = numbers
    return LongVectors(vectors, others if vectors else None)


def _variable(
    file: DataFile, head: bytes, order: str, start: int, packed: Tag | None
) -> tuple[str, Streamed | None]:
    """From the first bytes of an array's content, which `start`s there in the file or in the unpacked element."""
    flags = Tag.at(head, 0, order)
    dimensions = Tag.at(head, flags.following, order)
    name = Tag.at(head, dimensions.following, order)
    text = head[name.start : name.end].decode("latin-1")
    word = struct.unpack_from(f"{order}I", head, flags.start)[0]
    shape = struct.unpack_from(f"{order}{dimensions.size // 4}i", head, dimensions.start)
    rows = prod(shape)
    if word & 0xFF not in NUMERIC or word & COMPLEX or rows < LONG or rows != max(shape):
        return text, None
    numbers = Tag.at(head, name.following, order)
    dtype = np.dtype(order + TYPES[numbers.kind])
    if numbers.size != rows * dtype.itemsize:
        raise DataError(
            "the MATLAB file claims more than it holds", file.name, "it is damaged; copy it again"
        )
    return text, Streamed(rows, partial(_pieces, file, start + numbers.start, rows, dtype, packed))


def _pieces(file: DataFile, start: int, rows: int, dtype: np.dtype[Any], packed: Tag | None) -> Iterator[Any]:
    with file.reading() as raw:
        blocks = _plain(raw, start) if packed is None else _unpacked(raw, packed, start)
        held, missing = bytearray(), rows
        while missing:
            count = min(missing, PIECE)
            while len(held) < count * dtype.itemsize:
                block = next(blocks, None)
                if block is None:
                    raise DataError("the MATLAB file is cut off", file.name, "copy it again")
                held += block
            yield np.frombuffer(bytes(held[: count * dtype.itemsize]), dtype)
            del held[: count * dtype.itemsize]
            missing -= count


def _plain(raw: BinaryIO, start: int) -> Iterator[bytes]:
    raw.seek(start)
    while block := raw.read(READ):
        yield block


def _unpacked(raw: BinaryIO, packed: Tag, start: int) -> Iterator[bytes]:
    """What is in a compressed element, from `start` on."""
    raw.seek(packed.start)
    missing, before, unpack = packed.size, start, zlib.decompressobj()
    while missing and not unpack.eof:
        piece = raw.read(min(missing, READ))
        missing -= len(piece)
        while piece:
            block = unpack.decompress(piece, READ)
            piece = unpack.unconsumed_tail
            yield block[before:]
            before = max(before - len(block), 0)


DEEPEST_MATLAB = 8  # structures inside structures


@dataclass(frozen=True)
class MatlabReader:
    """MATLAB files before 7.3; fields of structures are STRUCT.FIELD, or FIELD where one structure is all there is."""

    format: str = "MATLAB"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head.startswith(b"MATLAB 5.0 MAT-file")

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The variables; elements of an array of structures are parts of their own.

        Raises DataError where the file cannot be read.
        """
        from scipy.io import loadmat

        data = file.contents
        check_layout(file, data)
        with damaged(file.name, self.format):
            long = long_vectors(file, data)
        with damaged(file.name, self.format), warnings.catch_warnings(), file.reading() as stream:
            warnings.simplefilter("ignore")  # of objects that only MATLAB can read
            content: dict[str, Any] = loadmat(
                cast(Any, stream),
                variable_names=long.others,
                squeeze_me=False,
                struct_as_record=False,
                verify_compressed_data_integrity=True,
            )
        variables: dict[str, Any] = {**long.vectors}
        series: list[tuple[str, dict[str, Any]]] = []
        named = {name: value for name, value in content.items() if not name.startswith("__")}
        alone = (
            not variables and sum(np.size(value) > 1 or _is_structure(value) for value in named.values()) == 1
        )
        for name, value in named.items():
            if alone and _is_structure(value):  # as an array of one
                series.append((name, _fields(value.item(), 0)))
            else:
                _flatten(name, value, variables, series)
        for name, fields in series:
            yield from parts_of_variables(f"{file.name} ({name})", {**variables, **fields})
        if series and not any(np.size(value) > 1 for value in variables.values()):
            return
        if not variables:
            raise DataError("there are no variables of numbers", file.name, "save the channels as arrays")
        yield from parts_of_variables(file.name, variables)


def _is_structure(value: Any) -> bool:
    """Whether this is one structure."""
    return (
        np.size(value) == 1 and np.asarray(value).dtype.kind == "O" and hasattr(value.item(), "_fieldnames")
    )


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
    if array.dtype.kind != "O" or depth > DEEPEST_MATLAB:
        return
    structures = [item for item in array.ravel().tolist() if hasattr(item, "_fieldnames")]
    if len(structures) == 1 and array.size == 1:
        for field in structures[0]._fieldnames:
            inner = getattr(structures[0], field)
            _flatten(f"{name}.{field}", inner, variables, series, depth + 1)
    elif structures and len(structures) == array.size:
        for k, item in enumerate(structures):
            series.append((f"{name}({k + 1})", _fields(item, depth)))
