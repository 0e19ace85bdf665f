"""Long vectors of MATLAB files of version 5 as columns that are not held: read, and unpacked, in pieces."""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any, BinaryIO

import numpy as np

from dashpot.data.readers.array_columns import LONG, PIECE, Streamed
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.matlab_layout import COMPLEX, COMPRESSED, HEAD, MATRIX, NUMERIC, Tag, elements_of
from dashpot.errors import DataError

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
