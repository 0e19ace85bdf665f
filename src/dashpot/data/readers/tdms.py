"""TDMS files of LabVIEW and DIAdem: groups are parts, properties say units and sampling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO

import numpy as np

from dashpot.data.readers.array_columns import (
    LONG,
    PIECE,
    ArrayColumns,
    Load,
    Streamed,
    array_columns,
    constant,
    steps,
)
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.optional import damaged, library
from dashpot.data.readers.sampling import TIME, TIME_NAMES
from dashpot.data.readers.tdms_blocks import BIG_ENDIAN, SampleBlock, mapped, sample_blocks
from dashpot.data.readers.variables import OF_ALL, step_of
from dashpot.errors import DataError

LEAD = 28  # bytes that begin a segment: tag, contents, version, its length, the length of its description
UNFINISHED = 2**64 - 1


@dataclass(frozen=True)
class TdmsReader:
    """Every group is a part; channels are read when they are asked for."""

    format: str = "TDMS"
    extra: str | None = "formats"

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head.startswith((b"TDSm", b"TDSh"))

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The groups, split by the lengths of their channels.  Raises DataError where the file cannot be read."""
        nptdms = library("nptdms", "formats", file.name, self.format)
        with file.reading() as stream, damaged(file.name, self.format):
            _refuse_cut_off(stream, file.name)
            content = nptdms.TdmsFile(stream, read_metadata_only=True, keep_open=True)
            if getattr(content, "_incomplete_channel_properties", None):
                raise DataError("the file is cut off", file.name, "copy it again")
            groups = list(content.groups())
            count = 0
            for group in groups:
                lengths: dict[int, list[Any]] = {}
                for channel in group.channels():
                    if np.dtype(channel.dtype).kind in "fiubM":
                        lengths.setdefault(len(channel), []).append(channel)
                scalars = {**content.properties, **group.properties}
                for rows, channels in lengths.items():
                    if rows:
                        count += 1
                        place = f"{file.name} ({group.name})" if len(groups) > 1 else file.name
                        samples: dict[str, Load] = {
                            channel.name: partial(_samples, file, content, channel) for channel in channels
                        }
                        yield _part(place, channels, samples, rows, scalars)
            if not count:
                raise DataError("there are no channels with samples", file.name, "record something")


def _refuse_cut_off(stream: BinaryIO, source: str) -> None:
    """Each segment says where the next one begins; nptdms leaves out one whose description is cut off.

    A segment without end (all bits set) was being written when the recorder stopped; what there is of it counts.
    """
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
            raise DataError("the file is cut off", source, "copy it again")
    stream.seek(0)


def _part(
    source: str, channels: list[Any], samples: dict[str, Load], rows: int, scalars: dict[str, Any]
) -> ArrayColumns:
    """Channels of one length."""
    loads: dict[str, Any] = {**samples}
    units: dict[str, str | None] = {}
    for channel in channels:
        units[channel.name] = channel.properties.get("unit_string") or channel.properties.get(
            "NI_UnitDescription"
        )
        scalars = {**channel.properties, **scalars}
    for name in OF_ALL:
        if name in scalars and name not in loads:
            loads[name] = constant(float(scalars[name]), rows)
    if not any(name.lower() in TIME_NAMES for name in loads):
        waveform = channels[0].properties
        step = float(waveform.get("wf_increment", 0)) or step_of(scalars)
        if step:
            loads[TIME] = steps(float(waveform.get("wf_start_offset", 0)), step, rows)
    columns = array_columns(source, loads, units)
    return ArrayColumns(source, columns.header, columns.units, (), rows, columns.loads)


def _samples(file: DataFile, content: Any, channel: Any) -> Any:
    with damaged(file.name, "TDMS"):
        blocks = sample_blocks(content, channel.path)
        if blocks is not None:
            return Streamed(len(channel), partial(_scaled_pieces, file, blocks, channel))
        if len(channel) >= LONG:
            return Streamed(len(channel), partial(_chunks, channel, file.name))
        samples = channel[:]
        if len(samples) != len(channel):
            raise DataError(f"channel {channel.name} is cut off", file.name, "copy the file again")
        return samples


def _scaled_pieces(file: DataFile, blocks: list[SampleBlock], channel: Any) -> Iterator[Any]:
    """The samples in the unit of the channel, whatever stands between them in the file."""
    from nptdms.base_segment import RawChannelDataChunk
    from nptdms.tdms import ChannelDataChunk

    with damaged(file.name, "TDMS"):
        raw = mapped(file)
        at = 0
        for block in blocks:
            for piece in block.pieces(raw):
                yield ChannelDataChunk(channel, RawChannelDataChunk.channel_data(piece), at)[:]
                at += len(piece)


def _chunks(channel: Any, source: str) -> Iterator[Any]:
    """The samples as nptdms reads them, which is all of a segment at a time."""
    with damaged(source, "TDMS"):
        for chunk in channel.data_chunks():
            samples = chunk[:]
            for at in range(0, len(samples), PIECE):
                yield samples[at : at + PIECE]
