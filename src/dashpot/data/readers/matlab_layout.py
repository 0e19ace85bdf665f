"""Whether a MATLAB file of version 5 can hold what its headers claim: a lie there would cost memory and time.

An array of n elements needs n bytes at least, and every element of the file lies inside the one around it.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod

from dashpot.errors import DataError

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


def check_layout(data: bytes | mmap.mmap, source: str) -> None:
    """Raises DataError where an element reaches beyond its end or claims more than it can hold."""
    for order, element in elements_of(data, source):
        if element.kind == COMPRESSED:
            _check_compressed(data, element, order, source)
        elif element.kind == MATRIX:
            _check_matrix(data, element.start, element.end, order, source, 0)


def _check_compressed(data: bytes | mmap.mmap, element: Tag, order: str, source: str) -> None:
    """The header of a compressed element."""
    packed = data[element.start : min(element.end, element.start + HEAD)]
    try:
        head = zlib.decompressobj().decompress(packed, HEAD)
        if len(head) < 8:
            raise _lie(source)
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
