"""The sine of a dwell times time: how far all channels together turn or grow while the dwell lasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc

from dashpot.data.conditioning.regression import solve_harmonics
from dashpot.data.record import Record

CONTRADICTED = 1e-3  # level of the test whether the channels agree


@dataclass(frozen=True)
class CommonRamp:
    """κ of channels X (1 + κ s), or X (1 − jκ s) for the phase, s running from −1 to 1 in the dwell.

    information  1 over the variance of κ if the noise is white and each channel has its own; 0 where nothing moves
    variance     of κ with noise that channels have in common
    apart        χ² of the channels' own κ about the common one, `others` degrees of freedom
    free         degrees of freedom of a channel's residual
    """

    kappa: float
    information: float
    variance: float
    apart: float
    others: int
    free: int

    @property
    def widening(self) -> float:
        """By which the variance of κ grows where the channels contradict each other: what they share is one drive."""
        return contradiction(self.apart, self.others)


def contradiction(apart: float, others: int) -> float:
    """χ² over its degrees of freedom where that is significant, else 1."""
    contradicted = others > 0 and float(chdtrc(others, apart)) < CONTRADICTED
    return apart / others if contradicted else 1.0


def common_ramp(
    record: Record, f: float, degree: int, of: Literal["phase", "amplitude"], orders: Sequence[int] = (1,)
) -> CommonRamp:
    """The ramp of phase or of amplitude at f Hz beside a polynomial of `degree` and multiples of f, over all repeats.

    The columns s cos and s sin (s = (t − centre)/half) of a signal a cos + b sin have the coefficients κ (b, −a) where
    its phase runs, and κ (a, b) where its amplitude grows.  Raises DataError as `solve_harmonics`.
    """
    free = len(record.time) - degree - 3 - 2 * len(orders)
    solution = solve_harmonics(record, f, orders, degree, ramps=True)
    a, b = solution.coefficients[:, degree + 1], solution.coefficients[:, degree + 2]
    ramp = solution.coefficients[:, -2:]
    noise = solution.squares / max(free, 1)
    variance = np.diagonal(noise, axis1=1, axis2=2)
    size = a**2 + b**2
    floor = np.maximum(1e-24 * size, (np.finfo(float).eps * solution.largest) ** 2)
    weight = np.where(size > 0, 1 / np.maximum(variance, np.where(floor > 0, floor, 1.0)), 0.0)
    P = solution.P[-2:, -2:]
    inside = np.asarray(
        np.linalg.solve(P, np.stack([b, -a] if of == "phase" else [a, b], axis=1)), dtype=float
    )
    each = weight * np.sum((P @ inside) * inside, axis=1)
    information = float(np.sum(each))
    if information <= 0:
        return CommonRamp(0.0, 0.0, np.inf, 0.0, 0, free)
    by_channel = weight * np.sum(ramp * inside, axis=1)
    kappa = float(np.sum(by_channel)) / information
    telling = each > 0
    apart = float(np.sum((by_channel[telling] - each[telling] * kappa) ** 2 / each[telling]))
    look = weight[:, None] * inside
    shared = float(np.einsum("bic,bcd,bjd,ij->", look, noise, look, P)) / information**2
    return CommonRamp(kappa, information, shared, apart, int(np.sum(telling)) - 1, free)
