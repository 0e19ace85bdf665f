"""Whether the drive's amplitude drifts while dwells last: then they are no steady sines.

A drive that fades scales the motion of all channels by one factor that changes slowly.  A sine of one amplitude counts
the change as noise, and the rig, whose response lags behind its drive, is not the one that ratios of the channels show.
What changes in one channel alone, by its sensor or by hum, is no drive: there channels contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import fdtrc

from dashpot.arrays import Real
from dashpot.data.conditioning.period_blocks import PeriodBlocks, period_blocks
from dashpot.data.conditioning.ramps import common_ramp, contradiction
from dashpot.data.conditioning.steady_state import periods_of
from dashpot.data.conditioning.transients import BESIDE, MANY_SAMPLES
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.numerics.combined_tests import fishers_product

LEVEL = 1e-3  # of the test for an amplitude that drifts
FEWEST_PERIODS = 2.0  # below which drift of a sensor and a growing sine look alike
BENT = 2  # degree of the polynomial that the amplitude of many periods may follow
START = 8  # th part of a dwell in which transients decay
SLIGHT = 5e-4  # of an amplitude: a drift by less spoils no more than gains are known to
USABLE = 0.45  # of the sampling rate


def drive_fades(records: Sequence[Record], weaker: Sequence[Real]) -> float:
    """p-value of every dwell having one amplitude: Fisher's product of the F tests of all dwells.

    1 where no dwell has periods enough to tell.  Channels with replaced samples, whose amplitudes are `weaker`
    (channels,) than those of all samples, have no say: what stands in for them has one amplitude or follows the noise.
    """
    each = (_steady(_sound(record, times)) for record, times in zip(records, weaker, strict=True))
    return float(fishers_product([p for p in each if p is not None]))


def _sound(record: Record, weaker: Real) -> Record:
    """The record with those channels alone of which no sample was replaced."""
    sound = np.flatnonzero(weaker <= 1)
    if len(sound) == len(record.channels):
        return record
    channels = tuple(record.channels[c] for c in sound)
    return replace(record, channels=channels, values=record.values[..., sound])


def _steady(record: Record) -> float | None:
    """p-value of one dwell having one amplitude; None where it has too few periods, or repeats."""
    f = record.frequency_hz
    if f is None or record.values.ndim != 2 or periods_of(record) < FEWEST_PERIODS or not record.channels:
        return None
    blocks = period_blocks(record, f)
    return _of_few_periods(record, f) if blocks is None else _of_blocks(blocks)


def _of_few_periods(record: Record, f: float) -> float | None:
    """F of a drift of the common amplitude over the residual, taken as white."""
    rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
    many = len(record.time) >= MANY_SAMPLES and BESIDE[-1] * f < USABLE * rate
    try:
        ramp = common_ramp(record, f, 1, "amplitude", BESIDE if many else (1,))
    except DataError:
        return None
    if ramp.free < 1 or ramp.information <= 0:
        return None
    variance = max(ramp.variance, ramp.widening / ramp.information) + SLIGHT**2
    return float(fdtrc(1, ramp.free, ramp.kappa**2 / variance))


def _of_blocks(blocks: PeriodBlocks) -> float | None:
    """F of a slow change of the common amplitude over its scatter from block to block, which knows the noise.

    The first blocks have no say: what decays there is a transient, which has a test of its own.
    """
    size = np.abs(blocks.amplitudes[len(blocks.amplitudes) // START :])
    mean, noise = np.mean(size, axis=0), np.median(blocks.rms, axis=0)
    moves = mean > 0
    if not np.any(moves):
        return None
    relative = size[:, moves] / mean[moves]
    weight = 1 / ((noise[moves] / mean[moves]) ** 2 + SLIGHT**2)
    both = np.column_stack([relative, relative @ weight / np.sum(weight)])
    slow = np.linalg.qr(legvander(np.linspace(-1, 1, len(both)), BENT))[0][:, 1:]
    along = slow.T @ (both - np.mean(both, axis=0))
    free = len(both) - 1 - BENT
    left = np.sum((both - np.mean(both, axis=0)) ** 2, axis=0) - np.sum(along**2, axis=0)
    variance = np.maximum(left, 0.0) / free + SLIGHT**2
    apart = float(np.sum(np.sum((along[:, :-1] - along[:, -1:]) ** 2, axis=0) / variance[:-1]))
    widening = contradiction(apart, BENT * (relative.shape[1] - 1))
    F = float(np.sum(along[:, -1] ** 2)) / BENT / (variance[-1] * widening)
    return float(fdtrc(BENT, free, F))
