"""MDF4 files of measuring systems (ASAM): channel groups with a time of their own are parts."""

from __future__ import annotations

import io
import mmap
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from dashpot.data.readers.arrays import LONG, ArrayColumns, Streamed, array_columns
from dashpot.data.readers.columns import TIME
from dashpot.data.readers.datafile import DataFile


def read_mdf(file: DataFile, asammdf: Any) -> Iterator[ArrayColumns]:
    """The groups that hold numbers; the master channel is the time."""
    content = file.contents
    _refuse_rings(content)
    with io.BytesIO(content) if isinstance(content, bytes) else file.reading() as stream:
        mdf = asammdf.MDF(stream)
        mdf.configure(read_fragment_size=1 << 24)  # bytes of records that are read at once
        groups = [group.channel_group for group in mdf.groups]
        file.check_unpacked(sum(group.cycles_nr * getattr(group, "samples_byte_nr", 0) for group in groups))
        for number, group in enumerate(mdf.groups):
            columns: dict[str, Any] = {}
            units: dict[str, str | None] = {}
            master = mdf.masters_db.get(number)
            for channel in group.channels:
                end = getattr(channel, "byte_offset", 0) + getattr(channel, "bit_count", 0) // 8
                if end > getattr(group.channel_group, "samples_byte_nr", end):
                    raise ValueError(
                        f"channel {channel.name} lies outside its record"
                    )  # where asammdf would read on
            rows = group.channel_group.cycles_nr
            # Samples that are marked as invalid are left out, channel by channel: how many remain, only reading tells.
            streamed = (
                rows >= LONG
                and master is not None
                and not getattr(group.channel_group, "invalidation_bytes_nr", 0)
            )
            for index, channel in enumerate(group.channels):
                if index == master:
                    continue
                signal = mdf.get(group=number, index=index, record_count=1 if streamed else None)
                samples: Any = np.asarray(signal.samples)
                if samples.ndim == 1 and samples.dtype.kind in "fiub" and len(samples):
                    times: Any = np.asarray(signal.timestamps)
                    if streamed:
                        times, samples = (
                            Streamed(rows, partial(_pieces, mdf, number, at)) for at in (master, index)
                        )
                    columns.setdefault(TIME, times)
                    columns[channel.name] = samples
                    units[channel.name] = signal.unit or None
            if columns:
                place = f"{file.name} (group {number + 1})" if len(groups) > 1 else file.name
                yield array_columns(place, columns, units)


def _refuse_rings(content: bytes | mmap.mmap) -> None:
    """Raises ValueError if the blocks of an MDF4 file lead back to themselves: asammdf would walk for ever.

    The header leads to data groups, these to channel groups, these to channels; each to the next of its kind first.
    """
    if content[8:9] != b"4":
        return
    seen: set[int] = set()
    ahead = [(position, 0) for position in _links(content, 64)[:1]]
    while ahead:
        position, depth = ahead.pop()
        if position in seen:
            raise ValueError("its blocks lead back to themselves")
        seen.add(position)
        links = _links(content, position)
        ahead += [(link, depth) for link in links[:1] if link]
        ahead += [(link, depth + 1) for link in links[1:2] if link and depth < 2]


def _links(content: bytes | mmap.mmap, position: int) -> tuple[int, ...]:
    """Where the first two links of the block at `position` lead; () beyond the end."""
    count = int.from_bytes(content[position + 16 : position + 24], "little")
    at = [position + 24 + 8 * k for k in range(min(count, 2))]
    return tuple(int.from_bytes(content[k : k + 8], "little") for k in at if k + 8 <= len(content))


def _pieces(content: Any, number: int, index: int) -> Iterator[Any]:
    """Samples of a channel."""
    for samples, _ in content.iter_get(group=number, index=index, samples_only=True):
        yield np.asarray(samples)
