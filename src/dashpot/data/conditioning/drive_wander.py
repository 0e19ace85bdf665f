"""Whether the drive frequency of dwells wanders while they last: then they are no steady sines.

A frequency that wanders turns the phase of all channels together and leaves their amplitudes nearly as they are.
Noise, whatever its colour and however alike in the channels, and transients do as much to the one as to the other: so
the scatter of the common phase over blocks of whole periods is tested against that of the common amplitude.  Stamps
that jitter turn the phase, too, but from sample to sample: what that explains of the scatter is no wandering.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.period_blocks import period_blocks
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
    windows = [
        _Window.of(record, f, *edges) for edges in zip(blocks.starts[:-1], blocks.ends[1:], strict=True)
    ]
    Z = np.array([each.amplitude for each in windows])
    noise = np.median(blocks.rms, axis=0)
    size = np.mean(np.abs(Z), axis=0)
    weight = np.where(size > 0, 1 / np.where(size > 0, noise**2 + (ROUNDED * size) ** 2, 1.0), 0.0)
    turns = np.angle(np.sum(weight * Z[1:] * np.conj(Z[:-1]), axis=1))
    phase = np.concatenate([[0.0], np.cumsum(turns)])
    mean = np.mean(Z * np.exp(-1j * phase)[:, None], axis=0)
    look = weight * np.conj(mean) / float(np.abs(mean) ** 2 @ weight)
    common = np.exp(-1j * phase) * (Z @ look)
    phase = phase + np.angle(common)
    looks = look * np.exp(-1j * phase)[:, None]
    jitter = max(float(np.mean([each.jitter(way) for each, way in zip(windows, looks, strict=True)])), 0.0)
    freedom = len(Z) - 2
    of_phase, of_amplitude = (_about_a_line(x) / freedom + ROUNDED**2 for x in (phase, np.abs(common)))
    return float(fdtrc(freedom, freedom, of_phase / (of_amplitude + jitter)))


@dataclass(frozen=True)
class _Window:
    """Two neighbouring blocks under Hann's window.

    It keeps noise at low frequencies, and a slope, from doing more to one phase than to the other.

    amplitude (channels,): at the drive's frequency; left (samples, channels): what each sample adds to it beyond a
    steady sine
    """

    amplitude: Complex
    left: Complex

    @staticmethod
    def of(record: Record, f: float, first: int, last: int) -> _Window:
        t = record.time[first:last]
        values = record.values[first:last] - np.mean(record.values, axis=0)
        share = (np.arange(len(t)) + 0.5) / len(t)
        hann = np.sin(np.pi * share) ** 2
        turned = np.exp(-2j * np.pi * f * t)
        carrier = (2 * hann * turned / np.sum(hann))[:, None]
        even = values - np.mean(values, axis=0)
        steady = np.outer(np.conj(turned), 2 * np.mean(turned[:, None] * even, axis=0)).real
        return _Window(np.sum(carrier * values, axis=0), carrier * (even - steady))

    def jitter(self, look: Complex) -> float:
        """Variance of the common phase that samples out of time with each other explain, look (channels,).

        Stamps that jitter turn the phase from sample to sample, in all channels alike; noise beside them is as large
        in phase as in amplitude.
        """
        each = self.left @ look
        return float(np.sum(each.imag**2) - np.sum(each.real**2))


def _about_a_line(x: Real) -> float:
    """Sum of squares about the line through x, (blocks,)."""
    index = np.arange(len(x)) - (len(x) - 1) / 2
    away = x - np.mean(x)
    away = away - index * (index @ away) / (index @ index)
    return float(away @ away)
