"""Dwells of rigs far from linear, whose motion Newton's method misses where nobody has measured it."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ConvergenceError
from dashpot.model.network import Model
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.harmonic_balance import Periodic
from dashpot.model.nonlinear.harmonics import Drive

MOST = 6  # dwells that are followed
POINTS = 400  # on the way of each


def regained(model: Model, theta: Real, drive: Drive, at: Periodic) -> Real | None:
    """Elongations (N, e, W) with those of lost dwells found by raising their drive slowly from rest.

    theta (K, unknowns) of K repeats, one after another in the dwells.  None where none of them is found.
    """
    delta, gained = at.delta.copy(), False
    dwells = len(delta) // len(theta)
    for row in np.flatnonzero(~at.converged)[:MOST]:
        try:
            alone = drive.rows(np.arange(len(delta)) == row)
            delta[row] = grown_from_rest(model, theta[row // dwells], alone, points=POINTS)
        except ConvergenceError:
            continue
        gained = True
    return delta if gained else None
