"""Dwells of rigs far from linear, whose motion Newton's method misses where nobody has measured it."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.errors import ConvergenceError
from dashpot.model.network import Model
from dashpot.model.nonlinear.continuation import grown_from_rest
from dashpot.model.nonlinear.harmonics import Drive

MOST = 6  # dwells that are followed
POINTS = 400  # on the way of each


def regained(model: Model, theta: Real, drive: Drive, last: Real, converged: Bools) -> Real | None:
    """The `last` elongations (N, e, W) with those of dwells that have not converged (N,) found from rest.

    Their drive is raised slowly.  theta (K, unknowns) of K repeats, one after another in the dwells.  None where none
    of them is found.
    """
    delta, gained = last.copy(), False
    dwells = len(delta) // len(theta)
    for row in np.flatnonzero(~converged)[:MOST]:
        try:
            alone = drive.rows(np.arange(len(delta)) == row)
            delta[row] = grown_from_rest(model, theta[row // dwells], alone, points=POINTS)
        except ConvergenceError:
            continue
        gained = True
    return delta if gained else None
