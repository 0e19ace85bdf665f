"""WAV files: samples of whole numbers as shares of full scale, channels by their number."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Literal

import numpy as np

from dashpot.data.readers.arrays import PIECE, ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.columns import TIME
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import damaged
from dashpot.errors import DataError
from dashpot.units import SHARE

WHOLE, FLOATING, EXTENSIBLE = 1, 3, 0xFFFE  # formats of samples; the last one is told further on
BYTES = {WHOLE: (1, 2, 3, 4, 8), FLOATING: (4, 8)}  # of a sample


def is_wav(file: DataFile) -> bool:
    """The first bytes say so."""
    return file.head[:4] in (b"RIFF", b"RIFX", b"RF64") and file.head[8:12] == b"WAVE"


def read_wav(file: DataFile) -> Iterator[ArrayColumns]:
    """All channels, channel_1, channel_2, …; a manifest gives them their names and units.

    Raises DataError if the file ends before its last sample.
    """
    with damaged(file.name, "WAV"):
        rate, samples = _samples(file)
    if rate <= 0:
        raise DataError(f"the sampling rate is {rate} Hz", file.name, "the file is damaged")
    rows, channels = samples.shape[:2]
    columns: dict[str, Any] = {
        f"channel_{i + 1}": Streamed(rows, partial(_pieces, samples, i)) for i in range(channels)
    }
    units = {} if samples.dtype.kind == "f" else dict.fromkeys(columns, SHARE)
    yield array_columns(file.name, {TIME: steps(0.0, 1 / rate, rows), **columns}, units)


def _samples(file: DataFile) -> tuple[int, Any]:
    """Rate in Hz and samples, (samples, channels), those of 24 bits as their bytes, (samples, channels, 3).

    Raises ValueError if there are none, or the file ends before the last.
    """
    data = file.contents
    order: Literal["little", "big"] = "big" if data[:4] == b"RIFX" else "little"

    def number(at: int, size: int) -> int:
        return int.from_bytes(data[at : at + size], order)

    at, kind, channels, rate, width, long_size = 12, 0, 0, 0, 0, 0
    for _ in range(10_000):  # chunks that are looked through
        if at + 8 > len(data):
            break
        name, size, at = data[at : at + 4], number(at + 4, 4), at + 8
        if name == b"ds64":  # where 32 bits do not hold the size
            long_size = number(at + 8, 8)
        elif name == b"fmt ":
            kind, channels, rate, block = (
                number(at, 2),
                number(at + 2, 2),
                number(at + 4, 4),
                number(at + 12, 2),
            )
            kind = number(at + 24, 2) if kind == EXTENSIBLE else kind
            width = block // max(channels, 1)
            if width not in BYTES.get(kind, ()) or block != channels * width:
                raise ValueError("its samples are of an unknown kind")
        elif name == b"data" and channels:
            size = long_size if size == 2**32 - 1 else size
            if at + size > len(data):
                raise ValueError("it ends before its last sample")
            rows, mark = size // (width * channels), "<" if order == "little" else ">"
            if width == 3:
                raw = np.frombuffer(data, np.uint8, 3 * rows * channels, at).reshape(rows, channels, 3)
                return rate, raw if order == "little" else raw[..., ::-1]
            letter = "f" if kind == FLOATING else "u" if width == 1 else "i"
            return rate, np.frombuffer(data, f"{mark}{letter}{width}", rows * channels, at).reshape(
                rows, channels
            )
        at += size + size % 2
    raise ValueError("it has no samples")


def _pieces(samples: Any, channel: int) -> Iterator[Any]:
    """One channel, between −1 and 1 where the samples are whole numbers."""
    for at in range(0, len(samples), PIECE):
        x = samples[at : at + PIECE, channel]
        if x.ndim == 2:  # bytes of numbers of 24 bits, the least first
            yield (x[:, 0] + 256.0 * x[:, 1] + 65536.0 * x[:, 2].astype(np.int8)) / 2**23
        elif x.dtype == np.uint8:
            yield (x.astype(float) - 128) / 128
        else:
            yield x.astype(float) / -float(np.iinfo(x.dtype).min) if x.dtype.kind == "i" else x
