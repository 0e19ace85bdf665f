"""A dwell cut into blocks of whole periods: what each channel does in each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Ints, Real, freeze
from dashpot.data.conditioning.regression import basis, duration, window
from dashpot.data.record import Record

MOST = 32  # blocks, of more periods each where there are many
FEWEST = 8
SAMPLES = 8  # that a block has on average, at least


@dataclass(frozen=True)
class PeriodBlocks:
    """Blocks of whole periods, counted from the end of a dwell.

    starts, ends (blocks,): the first sample of each and the one after its last
    amplitudes, rms (blocks, batch · channels): of the sine at the drive frequency, and of what it leaves, SI units
    """

    starts: Ints
    ends: Ints
    amplitudes: Complex
    rms: Real

    def __post_init__(self) -> None:
        freeze(self)


def period_blocks(record: Record, f: float) -> PeriodBlocks | None:
    """The blocks at f Hz, kept with the record; None where its periods are too few, or have gaps."""
    key = (period_blocks, f)
    if key not in record.kept:
        edges = _edges(record.time, f)
        record.kept[key] = None if edges is None else PeriodBlocks(*edges, *_fitted(record, f, *edges))
    blocks = record.kept[key]
    assert blocks is None or isinstance(blocks, PeriodBlocks)
    return blocks


def _edges(time: Real, f: float) -> tuple[Ints, Ints] | None:
    """Where the blocks start and end."""
    periods = int(f * duration(time) + 1e-6)
    each = max(1, periods // MOST, int(np.ceil(SAMPLES * periods / len(time))))
    blocks = periods // each
    if blocks < FEWEST:
        return None
    step = (time[-1] - time[0]) / (len(time) - 1)
    starts = np.searchsorted(time, time[-1] + step - (each / f) * np.arange(blocks, 0, -1) - step / 4)
    ends = np.append(starts[1:], len(time))
    return None if np.min(ends - starts) < 4 else (starts, ends)


def _fitted(record: Record, f: float, starts: Ints, ends: Ints) -> tuple[Complex, Real]:
    """Amplitude and residual rms of each block, both (blocks, batch · channels)."""
    samples, channels = record.values.shape[-2:]
    values = record.values.reshape(-1, samples, channels)
    amplitudes, rms = [], []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        t = record.time[start:end]
        A = basis(t, f, (1,), 0, *window(t))
        y = np.moveaxis(values[:, start:end], 1, 0).reshape(len(t), -1)
        c = np.linalg.lstsq(A, y, rcond=None)[0]
        amplitudes.append(c[1] - 1j * c[2])
        rms.append(np.sqrt(np.mean((y - A @ c) ** 2, axis=0)))
    return np.array(amplitudes), np.array(rms)
