"""Harmonics of the drive that every channel shows beyond doubt, which are data as good as the fundamental.

A stepper motor or a crank moves its base at many multiples of its frequency, and these may be all that reaches the
higher modes.  Where only the response shows a multiple, it is distortion and stays out of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Bools
from dashpot.data.conditioning.harmonic_fit import HarmonicFit, fit_harmonics
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.conditioning.steady_state import periods_of
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.notices import Notice

SIGNIFICANT = 0.01  # over all channels and multiples of a dwell together
STRONG = 0.01  # of the fundamental, in the channel that shows a multiple most
LONG = 8.0  # periods from which on the noise beside each multiple is seen
HIGHEST = 0.95  # of half the sampling rate
MOST = 100  # multiples


@dataclass(frozen=True)
class DrivenOrders:
    """The multiples of its frequency that drive a dwell; fit: that of the fundamental alone, where it was made."""

    orders: tuple[int, ...]
    fit: HarmonicFit | None = None


def driven_orders(records: Sequence[Record], conditioning: Conditioning) -> list[DrivenOrders]:
    """For each dwell the multiples of its frequency that are driven: 1 alone, unless half of the long dwells have more.

    A multiple counts where each channel's F test rejects noise at 1 % over all, and where it has a hundredth of some
    channel's fundamental.  Short dwells and repeats have their fundamental alone.
    """
    able = [record.values.ndim == 2 and periods_of(record) >= LONG for record in records]
    driven = [
        _orders_of(record, conditioning) if long else DrivenOrders((1,))
        for record, long in zip(records, able, strict=True)
    ]
    several = sum(len(dwell.orders) > 1 for dwell in driven)
    if 2 * several >= max(sum(able), 1):
        return driven
    return [DrivenOrders((1,), dwell.fit) for dwell in driven]


def orders_used(driven: Sequence[DrivenOrders]) -> list[Notice]:
    """A note where dwells have more lines than their fundamentals."""
    several = [len(dwell.orders) for dwell in driven if len(dwell.orders) > 1]
    if not several:
        return []
    dwells = f"{len(several)} dwell{'s' if len(several) > 1 else ''}"
    text = f"{sum(several)} lines of {dwells}: harmonics of the drive that every channel shows are used"
    return [Notice("harmonics_driven", text)]


def _orders_of(record: Record, conditioning: Conditioning) -> DrivenOrders:
    """The multiples that drive every channel of a long dwell."""
    fundamental = conditioning.changed(orders=(1,))
    alone = None
    try:
        alone = fit_harmonics(record, None, fundamental)
        if np.sum(_driven(alone)) < 2:
            return DrivenOrders((1,), alone)
        rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
        most = min(MOST, int(HIGHEST * rate / 2 / (record.frequency_hz or rate)), (len(record.time) - 4) // 6)
        every = fit_harmonics(record, None, fundamental.changed(orders=range(1, most + 1), harmonics="none"))
    except DataError:
        return DrivenOrders((1,), alone)  # the samples do not tell so many apart
    there = _driven(every)
    return DrivenOrders(tuple(np.array(every.orders)[there].tolist()) if there[0] else (1,), alone)


def _driven(fit: HarmonicFit) -> Bools:
    """(orders,): which multiples every channel shows."""
    size = np.abs(fit.amplitudes)
    variance = np.diagonal(fit.covariance, axis1=-2, axis2=-1).real
    with np.errstate(divide="ignore", invalid="ignore"):
        F = np.where(variance > 0, size**2 / variance, np.where(size > 1e-9 * size[0], np.inf, 0.0))
    p = fdtrc(2, fit.dof[:, None], F)
    strong = np.any(size >= STRONG * size[0], axis=-1)
    there: Bools = strong & np.all(p < SIGNIFICANT / size.size, axis=-1)
    return there
