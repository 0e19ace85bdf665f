"""Dwells in time: what was measured, what the estimated rig predicts of the steady motion, which part was used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.check.residuals import Residuals
from dashpot.data.calibration import calibration, real_factor
from dashpot.data.conditioning.used_dwells import UsedDwell

MOST_DWELLS, MOST_CHANNELS = 3, 4


@dataclass(frozen=True)
class DwellHistory:
    """Some channels of one dwell.

    time (samples,) s from its first sample, measured (samples, channels) SI without offset; begin, end: of the part
    used, s; lines_hz (lines,), amplitudes (lines, channels) of the predicted motion, x(t) = Re(X e^{jωt}).
    """

    source: str
    frequency_hz: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    time: Real
    measured: Real
    begin: float
    end: float
    lines_hz: Real
    amplitudes: Complex

    def __post_init__(self) -> None:
        freeze(self)

    def predicted(self, time: Real) -> Real:
        """The predicted steady motion at times in s, (times, channels)."""
        turning = np.exp(2j * np.pi * np.asarray(time)[:, None] * self.lines_hz)
        motion: Real = (turning @ self.amplitudes).real
        return motion


def dwell_histories(dwells: Sequence[UsedDwell], found: Residuals) -> tuple[DwellHistory, ...]:
    """The dwell of the largest residual, the one of which least was used, and the first or another, by frequency.

    `found` are the residuals of the spectrum that the dwells' lines are in; channels with the largest are taken.
    """
    if not dwells:
        return ()
    size = np.nan_to_num(np.abs(found.normalised))
    worst = [float(np.max(size[dwell.lines])) for dwell in dwells]
    wanted = [int(np.argmax(worst)), int(np.argmax([dwell.discarded for dwell in dwells]))]
    wanted = list(dict.fromkeys([*wanted, 0, len(dwells) - 1, len(dwells) // 2]))[:MOST_DWELLS]
    measured = np.flatnonzero(np.any(np.isfinite(found.measured), axis=0))
    order = np.argsort(-np.nan_to_num(found.rms()[measured]), kind="stable")
    channels = sorted(measured[order[:MOST_CHANNELS]].tolist())
    shown = sorted((dwells[k] for k in wanted), key=lambda dwell: float(found.frequency_hz[dwell.lines[0]]))
    return tuple(_history(dwell, found, channels) for dwell in shown)


def _history(dwell: UsedDwell, found: Residuals, channels: Sequence[int]) -> DwellHistory:
    record, lines = dwell.record, dwell.lines
    start = float(record.time[0])
    factor = np.array([real_factor(channel) for channel in record.channels])
    values = record.values / factor
    inside = (record.time >= dwell.begin) & (record.time <= dwell.end)
    values = values - np.mean(values[inside], axis=0)
    f = found.frequency_hz[lines]
    # As the sensor shows it: late by its known delay, and with phases counted from the first sample on.
    shown = found.predicted[lines] / (calibration(record.channels, f) * factor)
    shown = shown * np.exp(2j * np.pi * f * start)[:, None]
    return DwellHistory(
        record.source,
        float(f[0]),
        tuple(found.channels[c] for c in channels),
        tuple(found.units[c] for c in channels),
        record.time - start,
        values[:, channels],
        dwell.begin - start,
        dwell.end - start,
        f,
        np.nan_to_num(shown[:, channels]),
    )
