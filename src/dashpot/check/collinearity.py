"""What the data at hand tell badly: combinations of unknowns that widen the intervals, and lines that carry nothing.

The correlation-scaled information has eigenvalues; a small one belongs to a combination that is hardly seen, and adds
1/eigenvalue to the variance of what takes part in it (Belsley, Kuh and Welsch 1980, chapter 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real, frozen
from dashpot.check.chi2_surface import Surface
from dashpot.estimate.likelihood.maximum_likelihood import prior_precision

WEAK = 10.0  # times the interval is wider, from which a combination is told
PART = 0.5  # of a variance that a combination must make up for an unknown to be named with it
IDLE = 0.01  # of an even share of the information below which a line carries nothing


@dataclass(frozen=True)
class Combination:
    """A combination of unknowns that the data hardly see.

    names: those that have at least half of their variance from it; direction (names,): relative changes (δθ/θ, s for
    delays), the largest 1; spread: relative standard deviation along it; widening (names,): factor by which the
    interval is wider than were all other unknowns known; best: the unknown whose value would help most, and
    narrowing: what remains of the intervals of `names` then (mean of the factors).
    """

    names: tuple[str, ...]
    direction: Real
    spread: float
    widening: Real
    best: str
    narrowing: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", frozen(self.direction, np.float64))
        object.__setattr__(self, "widening", frozen(self.widening, np.float64))


@dataclass(frozen=True)
class Weakness:
    """Weak combinations, the weakest first, and what each line contributes.

    shares (lines, M): part of the information on each unknown (tr C I_l, unknown by unknown; a column sums to 1, less
    what priors tell); idle: lines that carry nothing for any unknown.
    """

    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    shares: Real
    idle: tuple[int, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "shares", frozen(self.shares, np.float64))


def weakness(base: Surface, covariance: Real) -> Weakness:
    """What the first repeat of a surface tells badly; `covariance` (M, M) is the estimate's.

    Intervals that are widened tenfold or more by the doubt about others are told.
    """
    names = base.view.names
    information = base.information[0]
    total = np.sum(information, axis=0) + np.diag(prior_precision(base.view))
    sd = np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(total / np.outer(sd, sd))
    values = np.maximum(values, 1e-15)
    parts = vectors**2 / values  # of the variance of each unknown, (unknowns, combinations)
    inflation = np.sum(parts, axis=1)
    portion = parts / inflation[:, None]
    spread = np.sqrt(np.diagonal(covariance) / (inflation / sd**2))  # what the noise basis multiplies
    late = np.array([name.endswith(".delay") for name in names])
    size = np.where(late | (base.psi[0] == 0), 1.0, np.abs(base.psi[0]))
    found = []
    for k in np.argsort(values):
        if values[k] * WEAK**2 > 1:
            break
        own = np.flatnonzero((portion[:, k] > PART) & (inflation > WEAK**2))
        if not len(own):
            continue
        relative = vectors[:, k] / sd / size * np.where(base.psi[0] < 0, -1, 1)
        peak = relative[own][np.argmax(np.abs(relative[own]))]
        best, narrowing = _best(covariance, own)
        along = float(abs(peak) / np.sqrt(values[k]) * np.mean(spread[own]))
        found.append(
            Combination(
                tuple(names[i] for i in own),
                relative[own] / peak,
                along,
                np.sqrt(inflation[own]),
                names[best],
                narrowing,
            )
        )
    C = (
        np.linalg.inv(total / np.outer(sd, sd)) / np.outer(sd, sd)
        if values[0] > 1e-14
        else np.diag(1 / sd**2)
    )
    shares = np.einsum("jk,lki,ij->lj", C, information, C) / np.diagonal(C)
    lines = len(information)
    idle = tuple(int(line) for line in np.flatnonzero(np.all(shares < IDLE / lines, axis=1)))
    return Weakness(names, tuple(found), shares, idle)


def _best(covariance: Real, own: np.ndarray) -> tuple[int, float]:
    """(the unknown whose value would narrow the intervals of `own` most, mean remaining factor of the others)."""
    variance = np.diagonal(covariance)
    best, least = int(own[0]), np.inf
    for i in own:
        left = variance[own] - covariance[own, i] ** 2 / variance[i]
        factor = np.sqrt(np.maximum(left, 0.0) / variance[own])
        others = factor[own != i]
        mean = float(np.mean(others)) if len(others) else 0.0
        if mean < least:
            best, least = int(i), mean
    return best, least
