"""The noise that rounding to the steps of a converter makes, which the residual of a fit may not show.

A channel that stays on one code has no residual at all, and where sampling and drive are commensurate every period is
rounded alike, so that the error is a harmonic of the drive.  Neither is an exact channel: rounding has the variance
step²/12, and only distinct phases of the motion average it (THEORY §11).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record

FINEST = 1e-7  # of the largest value: finer steps are digits of a text, not of a converter
DITHERED = 0.7  # residual in steps above which noise makes rounding errors independent
LOOKED_AT = 4096  # samples of each record
SMALLEST = 200  # distances of codes that are looked at


def rounding_steps(records: Sequence[Record]) -> Real:
    """The step of each channel in the units of its values, (channels,); 0 where it is finer than FINEST.

    All values of a quantised channel are a whole number of steps apart.
    """
    if not records:
        return np.zeros(0)
    channels = records[0].values.shape[-1]
    steps = np.zeros(channels)
    for c in range(channels):
        values = np.concatenate([r.values.reshape(-1, channels)[:LOOKED_AT, c] for r in records])
        steps[c] = _common_step(np.unique(values), float(np.max(np.abs(values), initial=0.0)))
    return steps


def _common_step(codes: Real, largest: float) -> float:
    """The greatest step of which all distances of ascending codes are multiples; 0 where there is none to speak of.

    Euclid's algorithm on the smallest distances, with the rounding of floating point as its zero.
    """
    apart = np.diff(codes)
    apart = apart[apart > 1e-12 * largest]
    if len(apart) < 2 or np.min(apart) < FINEST * largest:
        return 0.0
    step = float(np.min(apart))
    for distance in np.sort(apart)[:SMALLEST].tolist():
        rest = float(distance)
        while abs(rest) > 1e-3 * step and step > FINEST * largest:
            rest -= round(rest / step) * step
            if abs(rest) > 1e-3 * step:
                step, rest = abs(rest), step
    if step <= FINEST * largest:
        return 0.0
    multiples = np.round(apart / step)
    if np.max(np.abs(apart / step - multiples)) > 0.01:
        return 0.0
    return float(np.sum(apart) / np.sum(multiples))


def distinct_phases(record: Record, f: float, size: Real, step: Real) -> Real:
    """Samples at different phases of a motion of amplitude `size` (channels,), as far as steps (channels,) tell them.

    Two phases are one where the motion between them is less than a quarter of a step, and where they are half a period
    apart: about a zero on a code or between two, both are rounded alike.
    """
    cycles = 2 * f * record.time
    phase = np.sort(cycles - np.floor(cycles)) / 2
    gaps = np.diff(np.concatenate([phase, phase[:1] + 0.5]))
    counts = np.ones(len(step))
    for c, (amplitude, each) in enumerate(zip(size, step, strict=True)):
        if each > 0 and amplitude > 0:
            counts[c] = max(1, int(np.sum(2 * np.pi * amplitude * gaps > each / 4)))
    return counts


def rounding_floor(record: Record, f: float, size: Real, residual_sd: Real, step: Real) -> Real:
    """Least variance E|Δ|² of each channel's amplitude by rounding, (channels,); 0 where the residual shows it all."""
    floor = 4 * step**2 / 12 / distinct_phases(record, f, size, step)
    least: Real = np.where((step > 0) & (residual_sd < DITHERED * step), floor, 0.0)
    return least
