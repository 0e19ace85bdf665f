"""Whether the drive frequency of dwells wanders while they last: then they are no steady sines.

A frequency that wanders turns the phase of all channels together and leaves their amplitudes nearly as they are.
Noise, whatever its colour and however alike in the channels, and transients do as much to the one as to the other: so
the scatter of the common phase over blocks of whole periods is tested against that of the common amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.period_blocks import PeriodBlocks, period_blocks
from dashpot.data.record import Record
from dashpot.numerics.combined_tests import fishers_product

LEVEL = 1e-4  # of the test for a frequency that wanders
ROUNDED = 1e-6  # of an amplitude, and rad: what scatters less is exact


def drive_wanders(records: Sequence[Record]) -> float:
    """p-value of every dwell having one frequency: Fisher's product of the F tests of all dwells.

    1 where no dwell has blocks enough to tell.
    """
    return float(fishers_product([p for p in map(_steady, records) if p is not None]))


def _steady(record: Record) -> float | None:
    """p-value of one dwell having one frequency; None where it has too few periods, or repeats."""
    f = record.frequency_hz
    blocks = None if f is None or record.values.ndim != 2 else period_blocks(record, f)
    if f is None or blocks is None or not np.any(np.ptp(record.values, axis=0)):
        return None
    Z = _windowed(record, f, blocks)
    noise = np.median(blocks.rms, axis=0)
    size = np.mean(np.abs(Z), axis=0)
    moving = size > 0
    Z, weight = Z[:, moving], 1 / (noise**2 + (ROUNDED * size) ** 2)[moving]
    turns = np.angle(np.sum(weight * Z[1:] * np.conj(Z[:-1]), axis=1))
    phase = np.concatenate([[0.0], np.cumsum(turns)])
    still = Z * np.exp(-1j * phase)[:, None]
    mean = np.mean(still, axis=0)
    common = (still * np.conj(mean)) @ weight / float(np.abs(mean) ** 2 @ weight)
    phase = phase + np.angle(common)
    freedom = len(Z) - 2
    of_phase, of_amplitude = (_about_a_line(x) / freedom + ROUNDED**2 for x in (phase, np.abs(common)))
    return float(fdtrc(freedom, freedom, of_phase / of_amplitude))


def _windowed(record: Record, f: float, blocks: PeriodBlocks) -> Complex:
    """Amplitudes of two neighbouring blocks at a time under Hann's window, (blocks − 1, channels).

    The window keeps noise at low frequencies, and a slope, from doing more to one phase than to the other.
    """
    values = record.values - np.mean(record.values, axis=0)
    amplitudes = []
    for first, last in zip(blocks.starts[:-1].tolist(), blocks.ends[1:].tolist(), strict=True):
        t = record.time[first:last]
        share = (np.arange(len(t)) + 0.5) / len(t)
        window = np.sin(np.pi * share) ** 2
        carrier = window * np.exp(-2j * np.pi * f * t)
        amplitudes.append(2 * carrier @ values[first:last] / np.sum(window))
    return np.array(amplitudes)


def _about_a_line(x: Real) -> float:
    """Sum of squares about the line through x, (blocks,)."""
    index = np.arange(len(x)) - (len(x) - 1) / 2
    away = x - np.mean(x)
    away = away - index * (index @ away) / (index @ index)
    return float(away @ away)
