"""WAV files: samples of whole numbers as shares of full scale, channels by their number."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.data.readers.array_columns import LONG, PIECE, ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.optional import damaged
from dashpot.data.readers.sampling import TIME
from dashpot.errors import DataError
from dashpot.io.ledger import noted


@dataclass(frozen=True)
class WavReader:
    """Channels are channel_1, channel_2, …; a manifest gives them their names and units."""

    format: str = "WAV"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head[:4] in (b"RIFF", b"RIFX", b"RF64") and file.head[8:12] == b"WAVE"

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """All channels.  Raises DataError where the file ends before its last sample."""
        from scipy.io.wavfile import WavFileWarning

        with damaged(file.name, self.format), warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*(EOF|end of file|incomplete).*")
            warnings.filterwarnings("ignore", category=WavFileWarning)
            rate, samples = _read(file)
        if rate <= 0:
            raise DataError(f"the sampling rate is {rate} Hz", file.name, "the file is damaged")
        values = samples[:, None] if samples.ndim == 1 else samples
        loads: dict[str, Any] = {f"channel_{i + 1}": _Channel(values, i) for i in range(values.shape[1])}
        columns = array_columns(file.name, {TIME: steps(0.0, 1 / rate, len(values)), **loads})
        yield ArrayColumns(columns.source, columns.header, columns.units, (), len(values), columns.loads)


def _read(file: DataFile) -> tuple[int, Any]:
    """Rate and samples; those of a large file are mapped, but for whole numbers of 24 bits."""
    from scipy.io import wavfile

    if file.mapped is not None:
        with suppress(ValueError):
            return wavfile.read(noted(file.path), mmap=True)
    if file.packed:  # of a stream that unpacks, NumPy would read the packed bytes
        return wavfile.read(io.BytesIO(file.contents))
    with file.reading() as stream:
        return wavfile.read(stream)


@dataclass(frozen=True)
class _Channel:
    """One channel, between −1 and 1 where the samples are whole numbers."""

    values: Any
    index: int

    def __call__(self) -> Any:
        rows = len(self.values)
        if rows < LONG:
            return self._between(0, rows)
        return Streamed(rows, lambda: (self._between(at, at + PIECE) for at in range(0, rows, PIECE)))

    def _between(self, start: int, stop: int) -> Any:
        x = self.values[start:stop, self.index]
        if x.dtype == np.uint8:
            return (x.astype(float) - 128) / 128
        if x.dtype.kind == "i":
            return x.astype(float) / -float(np.iinfo(x.dtype).min)
        return x
