"""WAV files: samples of whole numbers as shares of full scale, channels by their number."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any, Literal

import numpy as np

from dashpot.data.readers.arrays import PIECE, ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import damaged
from dashpot.data.readers.time_columns import TIME
from dashpot.errors import DataError
from dashpot.io.ledger import noted
from dashpot.units import SHARE

UNKNOWN = 2**32 - 1  # a size that stands elsewhere


def is_wav(file: DataFile) -> bool:
    """The first bytes say so."""
    return file.head[:4] in (b"RIFF", b"RIFX", b"RF64") and file.head[8:12] == b"WAVE"


def read_wav(file: DataFile) -> Iterator[ArrayColumns]:
    """All channels, channel_1, channel_2, …; a manifest gives them their names and units.

    Raises DataError where the file ends before its last sample.
    """
    from scipy.io.wavfile import WavFileWarning

    with damaged(file.name, "WAV"), warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=WavFileWarning)  # of chunks that it does not know
        warnings.filterwarnings("error", message=".*(EOF|end of file|incomplete).*")
        rate, samples = _read(file)
    if rate <= 0:
        raise DataError(f"the sampling rate is {rate} Hz", file.name, "the file is damaged")
    values = samples[:, None] if samples.ndim == 1 else samples
    columns: dict[str, Any] = {
        f"channel_{i + 1}": Streamed(len(values), partial(_pieces, values, i)) for i in range(values.shape[1])
    }
    units = {} if values.dtype.kind == "f" else dict.fromkeys(columns, SHARE)
    return iter([array_columns(file.name, {TIME: steps(0.0, 1 / rate, len(values)), **columns}, units)])


def _read(file: DataFile) -> tuple[int, Any]:
    """Rate and samples; those of a large file are mapped."""
    from scipy.io import wavfile

    if not isinstance(file.contents, bytes):
        with suppress(ValueError):  # of whole numbers of 24 bits
            return wavfile.read(noted(file.path), mmap=True)
        return _of_24_bits(file)
    with file.reading() as stream:
        return wavfile.read(stream)


def _of_24_bits(file: DataFile) -> tuple[int, Any]:
    """Rate and samples of 24 bits, (samples, channels, 3 bytes), mapped.  Raises ValueError where there are none."""
    order: Literal["little", "big"] = "big" if file.head[:4] == b"RIFX" else "little"

    def number(at: int, size: int) -> int:
        return int.from_bytes(file.contents[at : at + size], order)

    at, rate, channels, long_size, end = 12, 0, 0, 0, len(file.contents)
    while at + 8 <= end:
        name, size, at = file.contents[at : at + 4], number(at + 4, 4), at + 8
        if name == b"ds64":  # where 32 bits do not hold the size
            long_size = number(at + 8, 8)
        elif name == b"fmt ":
            channels, rate = number(at + 2, 2), number(at + 4, 4)
            if number(at + 12, 2) != 3 * channels or number(at + 14, 2) != 24:
                raise ValueError("its samples are of no known kind")
        elif name == b"data" and channels:
            size = long_size if size == UNKNOWN else size
            if at + size > end:
                raise ValueError("it ends before its last sample")
            rows = size // (3 * channels)
            shape = (rows, channels, 3)
            samples: Any = np.memmap(noted(file.path), np.uint8, "r", offset=at, shape=shape)
            return rate, samples if order == "little" else samples[..., ::-1]
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
