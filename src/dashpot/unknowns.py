"""What is to be found, parameters and calibrations alike: names, units, and what is known of values beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real, frozen


@dataclass(frozen=True)
class Unknown:
    """One unknown: a parameter of the rig, or a gain or delay of its channels.

    name, unit    in results, SI
    prior, sd     stated value and its standard deviation, if both are stated
    guess         start of the iterations
    lower, upper  bounds, None if there are none
    """

    name: str
    unit: str
    prior: float | None = None
    sd: float | None = None
    guess: float | None = None
    lower: float | None = None
    upper: float | None = None

    @property
    def nominal(self) -> float | None:
        """The stated value, else the guess."""
        return self.guess if self.prior is None else self.prior


def prior_precision(unknowns: Sequence[Unknown]) -> Real:
    """1/sd² of the unknowns that are known with an sd, else 0; (unknowns,)."""
    return frozen([0.0 if u.sd is None else u.sd**-2.0 for u in unknowns], np.float64)


def prior_mean(unknowns: Sequence[Unknown]) -> Real:
    """Values of the unknowns that are known with an sd, else 0; (unknowns,)."""
    return frozen([0.0 if u.sd is None or u.prior is None else u.prior for u in unknowns], np.float64)


def bounds_of(unknowns: Sequence[Unknown]) -> tuple[Real, Real]:
    """Least and largest values allowed to the unknowns, (unknowns,) each, SI units; ∓inf where none is."""
    low = [-np.inf if u.lower is None else u.lower for u in unknowns]
    high = [np.inf if u.upper is None else u.upper for u in unknowns]
    return frozen(low, np.float64), frozen(high, np.float64)


# The least part of a prior's variance that data count as taking from it: where the noise is known, beyond rounding;
# where residuals tell it, covariances are right to some per cent only.
LEAST_TOLD = {True: 1e-8, False: 0.05}


def pull(value: Real, variance: Real, stated: Real | float, sd: Real | float, known_noise: bool) -> Real:
    """(estimate − stated) / √(sd² − variance) of estimates that have used the statement stated ± sd, all of one shape.

    An efficient estimate and a statement that it has used differ by sd² − variance in variance where both are right:
    the pull is then a draw of the standard normal.  Demortier and Lyons, CDF note 5776 (2002).
    """
    spread = np.sqrt(np.maximum(sd**2 - variance, LEAST_TOLD[known_noise] * sd**2))
    return np.asarray((value - stated) / spread)
