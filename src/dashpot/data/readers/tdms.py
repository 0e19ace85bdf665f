"""TDMS files of LabVIEW and DIAdem: groups are parts, properties say units and sampling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dashpot.data.readers.arrays import PIECE, ArrayColumns, Streamed, parts_of_variables
from dashpot.data.readers.columns import FREQUENCY
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError
from dashpot.io.ledger import noted

# Where the numbers of a TDMS channel stand in the file, so that long ones are read in pieces.
#
# nptdms reads at once what a segment holds of a channel, which may be all of it; where channels alternate,
# of each.


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
    """The blocks of a channel of an open TdmsFile; None if its samples are no plain numbers (DAQmx, dates)."""
    blocks: list[SampleBlock] = []
    for segment in getattr(content._reader, "_segments", None) or ():
        objects = [stored for stored in segment.ordered_objects if stored.has_data]
        if all(stored.path != path for stored in objects):
            continue
        kind = next(stored.data_type.nptype for stored in objects if stored.path == path)
        plain = (not hasattr(one, "daqmx_metadata") and one.data_type.size is not None for one in objects)
        if kind is None or not all(plain):
            return None
        # Places follow from the lengths of the channels, each once, which are the same where samples alternate.
        whole = {stored.path: stored.number_values for stored in objects}
        if len(whole) < len(objects) or (segment.toc_mask & INTERLEAVED and len(set(whole.values())) > 1):
            return None
        # The whole chunks, and the last one where it is shorter
        dtype = np.dtype(kind).newbyteorder(">" if segment.toc_mask & BIG_ENDIAN else "<")
        alternating = bool(segment.toc_mask & INTERLEAVED)
        last = segment.final_chunk_lengths_override
        sizes = {stored.path: stored.data_type.size for stored in objects}
        apart = sum(size * whole[name] for name, size in sizes.items())
        step = sum(sizes.values()) if alternating else dtype.itemsize
        in_front = list(sizes)[: list(sizes).index(path)]
        chunks = segment.num_chunks - (last is not None)
        for first, count, lengths in ((0, chunks, whole), (chunks, 1, last)):
            if count and lengths is not None:
                before = sum(sizes[name] * (1 if alternating else lengths.get(name, 0)) for name in in_front)
                start = segment.data_position + first * apart + before
                blocks.append(SampleBlock(dtype, start, count, lengths.get(path, 0), apart, step))
    return blocks or None


def mapped(file: DataFile) -> np.memmap[Any, Any]:
    """All bytes of a file, which the system reads as they are asked for."""
    return np.memmap(noted(file.path), np.uint8, "r")


LEAD = 28  # bytes that begin a segment: tag, contents, version, its length, the length of its description
UNFINISHED = 2**64 - 1


def read_tdms(file: DataFile, nptdms: Any) -> Iterator[ArrayColumns]:
    """The groups, split by the lengths of their channels, which are read when they are asked for."""
    with file.reading() as stream:
        # Each segment says where the next one begins; nptdms leaves out one whose description is cut off
        start = 0
        while True:
            stream.seek(start)
            lead = stream.read(LEAD)
            big = int.from_bytes(lead[4:8], "little") & BIG_ENDIAN
            length = int.from_bytes(lead[12:20], "big" if big else "little")
            if not lead or length == UNFINISHED:
                break
            start += LEAD + length
            stream.seek(start - 1)
            if len(lead) < LEAD or not stream.read(1):
                raise DataError("the file is cut off", file.name, "copy it again")
        stream.seek(0)
        content = nptdms.TdmsFile(stream, read_metadata_only=True, keep_open=True)
        if getattr(content, "_incomplete_channel_properties", None):
            raise DataError("the file is cut off", file.name, "copy it again")
        groups = list(content.groups())
        for group in groups:
            lengths: dict[int, list[Any]] = {}
            for channel in group.channels():
                if np.dtype(channel.dtype).kind in "fiubM" and len(channel):
                    lengths.setdefault(len(channel), []).append(channel)
            for rows, channels in lengths.items():
                variables = {**content.properties, **group.properties}
                units: dict[str, str | None] = {}
                for channel in channels:
                    variables = {**channel.properties, **variables}
                    said = (channel.properties.get(key) for key in ("unit_string", "NI_UnitDescription"))
                    units[channel.name] = next(filter(None, said), None)
                if FREQUENCY in variables:  # which may be a text
                    variables[FREQUENCY] = float(variables[FREQUENCY])
                for channel in channels:
                    variables[channel.name] = Streamed(rows, partial(_samples, file, content, channel))
                place = f"{file.name} ({group.name})" if len(groups) > 1 else file.name
                yield from parts_of_variables(place, variables, units)


def _samples(file: DataFile, content: Any, channel: Any) -> Iterator[Any]:
    """The samples in the unit of the channel, in pieces, whatever stands between them in the file.

    Those that are no plain numbers come as nptdms reads them, which is all of a segment at a time.
    """
    from nptdms.base_segment import RawChannelDataChunk
    from nptdms.tdms import ChannelDataChunk

    blocks = sample_blocks(content, channel.path)
    if blocks is None:
        yield from (chunk[:] for chunk in channel.data_chunks())
        return
    at, raw = 0, mapped(file)
    for block in blocks:
        for piece in block.pieces(raw):
            yield ChannelDataChunk(channel, RawChannelDataChunk.channel_data(piece), at)[:]
            at += len(piece)
