"""Where the numbers of a TDMS channel stand in the file, so that long ones are read in pieces.

nptdms reads at once what a segment holds of a channel, which may be all of it; where channels alternate, of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.data.readers.array_columns import PIECE
from dashpot.data.readers.datafile import DataFile
from dashpot.io.ledger import noted

BIG_ENDIAN, INTERLEAVED = 1 << 6, 1 << 5  # among the contents of a segment


@dataclass(frozen=True)
class SampleBlock:
    """Chunks of one length, evenly placed: the number k of chunk i is at `start + i * apart + k * step` bytes."""

    dtype: np.dtype[Any]
    start: int
    chunks: int
    length: int
    apart: int
    step: int

    def pieces(self, raw: np.memmap[Any, Any]) -> Iterator[Any]:
        """The numbers in order; raw (bytes of the file,)."""
        shape, strides = (self.chunks, self.length), (self.apart, self.step)
        numbers: Any = np.ndarray(shape, self.dtype, raw, self.start, strides)
        together = max(PIECE // max(self.length, 1), 1)
        for chunk in range(0, self.chunks, together):
            for at in range(0, self.length, PIECE):
                yield numbers[chunk : chunk + together, at : at + PIECE].ravel()


def sample_blocks(content: Any, path: str) -> list[SampleBlock] | None:
    """The blocks of a channel of an open TdmsFile; None where its samples are no plain numbers (DAQmx, dates)."""
    blocks: list[SampleBlock] = []
    for segment in getattr(content._reader, "_segments", None) or ():
        objects = [stored for stored in segment.ordered_objects if stored.has_data]
        if all(stored.path != path for stored in objects):
            continue
        kind = next(stored.data_type.nptype for stored in objects if stored.path == path)
        if kind is None or not _evenly_placed(segment, objects):
            return None
        blocks += _blocks_of_segment(segment, objects, path, np.dtype(kind))
    return blocks or None


def _evenly_placed(segment: Any, objects: list[Any]) -> bool:
    """Whether places follow from the lengths of the channels: each once, no texts, no raw samples of DAQmx."""
    if any(hasattr(stored, "daqmx_metadata") or stored.data_type.size is None for stored in objects):
        return False
    lengths = {stored.path: stored.number_values for stored in objects}
    alternating = bool(segment.toc_mask & INTERLEAVED)
    return len(lengths) == len(objects) and not (alternating and len(set(lengths.values())) > 1)


def _blocks_of_segment(
    segment: Any, objects: list[Any], path: str, kind: np.dtype[Any]
) -> Iterator[SampleBlock]:
    """The whole chunks, and the last one where it is shorter."""
    dtype = kind.newbyteorder(">" if segment.toc_mask & BIG_ENDIAN else "<")
    alternating = bool(segment.toc_mask & INTERLEAVED)
    whole = {stored.path: stored.number_values for stored in objects}
    last = segment.final_chunk_lengths_override
    sizes = {stored.path: stored.data_type.size for stored in objects}
    apart = sum(size * whole[name] for name, size in sizes.items())
    step = sum(sizes.values()) if alternating else kind.itemsize
    in_front = list(sizes)[: list(sizes).index(path)]
    chunks = segment.num_chunks - (last is not None)
    for first, count, lengths in ((0, chunks, whole), (chunks, 1, last)):
        if count and lengths is not None:
            before = sum(sizes[name] * (1 if alternating else lengths.get(name, 0)) for name in in_front)
            start = segment.data_position + first * apart + before
            yield SampleBlock(dtype, start, count, lengths.get(path, 0), apart, step)


def mapped(file: DataFile) -> np.memmap[Any, Any]:
    """All bytes of a file, which the system reads as they are asked for."""
    return np.memmap(noted(file.path), np.uint8, "r")
