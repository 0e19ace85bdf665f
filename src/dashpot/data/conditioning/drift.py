"""Whether dwells drift: one test of the slopes of all dwells and channels together (THEORY §11).

A slope that is taken out of a dwell of one period costs up to a half of its standard deviation, of five periods 1 %;
one that is left in spoils the amplitude.  So it is taken out of short dwells where they show it, and of long ones
always.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, chdtri, fdtrc

from dashpot.data.conditioning.regression import exact_channels, solve_harmonics
from dashpot.data.conditioning.steady_state import periods_of
from dashpot.data.record import Record
from dashpot.errors import DataError

LEVEL = 0.05  # of the test: a slope too many costs less than one too few
CHEAP = 5.0  # periods from which on a slope costs nothing


def slope_costs(records: Sequence[Record]) -> bool:
    """Whether some dwell is so short that solving for a slope widens its amplitudes."""
    return any(periods_of(record) < CHEAP for record in records)


def slopes_show(records: Sequence[Record], orders: Sequence[int]) -> float:
    """p-value of no drift in any dwell or channel: F of each slope, as normal squares, pooled; 1 without evidence.

    Each F has the degrees of freedom of its own residual, so that few samples do not make it too large.
    """
    total, count = 0.0, 0
    for record in records:
        if record.frequency_hz is None:
            continue
        try:
            solution = solve_harmonics(record, record.frequency_hz, tuple(orders), 1)
        except DataError:
            continue
        free = len(record.time) - 2 - 2 * len(orders)
        if free < 1:
            continue
        sigma = solution.squares / free
        exact = exact_channels(sigma, solution.amplitudes(1), solution.largest)
        variance = np.diagonal(sigma, axis1=1, axis2=2)[~exact]
        slope = solution.coefficients[:, 1][~exact]
        F = slope**2 / (solution.P[1, 1] * variance)
        total += float(np.sum(chdtri(1, np.maximum(fdtrc(1, free, F), 1e-250))))
        count += int(np.sum(~exact))
        far = np.abs(solution.coefficients[:, 1][exact]) > 1e-9 * solution.largest[exact]
        if np.any(far):
            return 0.0
    return float(chdtrc(count, total)) if count else 1.0
