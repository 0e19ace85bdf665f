"""Whether a MATLAB file of version 5 can hold what its headers claim: a lie there would cost memory and time.

An array of n elements needs n bytes at least, and every element of the file lies inside the one around it.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from math import prod

from dashpot.errors import DataError

HEADER = 128
MATRIX, COMPRESSED, INT32 = 14, 15, 5
KINDS = {*range(1, 8), 9, *range(12, 19)}  # of data elements
CELL, STRUCTURE, OBJECT, SPARSE, OPAQUE = 1, 2, 3, 5, 17
MOST_COMPRESSED = 1100  # times, by deflate
DEEPEST = 20
HEAD = 1 << 16  # bytes of a compressed element that are looked at


def check_layout(data: bytes | mmap.mmap, source: str) -> None:
    """Raises DataError where an element reaches beyond its end or claims more than it can hold."""
    if len(data) < HEADER:
        raise _lie(source)
    order = ">" if data[126:128] == b"MI" else "<"
    position = HEADER
    while position + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        end = position + 8 + size
        if end > len(data):
            raise DataError("the MATLAB file is cut off", source, "copy it again")
        if kind == COMPRESSED:
            _check_compressed(data[position + 8 : end], order, source)
        elif kind == MATRIX:
            _check_matrix(data, position + 8, end, order, source, 0)
        position = end


def _check_compressed(packed: bytes, order: str, source: str) -> None:
    """The header of a compressed element."""
    try:
        head = zlib.decompressobj().decompress(packed, HEAD)
    except zlib.error:
        raise DataError("the MATLAB file is damaged", source, "copy it again") from None
    if len(head) < 8:
        raise _lie(source)
    kind, size = struct.unpack_from(f"{order}II", head, 0)
    if kind == MATRIX:
        if size > MOST_COMPRESSED * len(packed):
            raise _lie(source)
        _check_matrix(head, 8, 8 + size, order, source, 0)


def _check_matrix(data: bytes | mmap.mmap, start: int, end: int, order: str, source: str, depth: int) -> None:
    """An array: what it claims to hold, and the arrays inside it as far as the bytes go."""
    if start == end:
        return
    position, number = start, 0
    kind_of_array, elements = 0, 0
    while position + 8 <= min(end, len(data)):
        kind, size, content, following = _tag(data, position, order)
        if (
            content + size > end or kind not in KINDS
        ):  # SciPy looks kinds up without asking whether they exist
            raise _lie(source)
        if number == 0 and size >= 4 and content < len(data):
            kind_of_array = struct.unpack_from(f"{order}I", data, content)[0] & 0xFF
            if kind_of_array == OPAQUE:
                return
        elif number == 1 and kind == INT32 and content + size <= len(data):
            elements = prod(struct.unpack_from(f"{order}{size // 4}i", data, content))
            if kind_of_array != SPARSE and not 0 <= elements <= end - start:
                raise _lie(source)
        elif kind == MATRIX and depth < DEEPEST:
            _check_matrix(data, content, content + size, order, source, depth + 1)
        position, number = following, number + 1


def _tag(data: bytes | mmap.mmap, position: int, order: str) -> tuple[int, int, int, int]:
    """Kind, size, place of the content and of the next element."""
    kind, size = struct.unpack_from(f"{order}II", data, position)
    if kind >> 16:  # small: size and kind in one word, the content in the other
        return kind & 0xFFFF, min(kind >> 16, 4), position + 4, position + 8
    padded = size if kind == COMPRESSED else size + (-size) % 8
    return kind, size, position + 8, position + 8 + padded


def _lie(source: str) -> DataError:
    return DataError("the MATLAB file claims more than it holds", source, "it is damaged; copy it again")
