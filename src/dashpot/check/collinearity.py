"""Collinearity in the data at hand: combinations of unknowns that widen the intervals, and lines that carry nothing.

The correlation-scaled information has eigenvalues; a small one belongs to a combination that is hardly seen, and adds
1/eigenvalue to the variance of what takes part in it (Belsley, Kuh and Welsch 1980, chapter 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.check.chi2_surface import Surface
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.likelihood.objective import prior_precision
from dashpot.io.words import listed

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
        freeze(self)


@dataclass(frozen=True)
class Collinearity:
    """Weak combinations, the weakest first, and what each line contributes.

    shares (lines, M): part of the information on each unknown (tr C I_l, unknown by unknown; a column sums to 1, less
    what priors tell); idle: lines that carry nothing for any unknown.
    """

    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    shares: Real
    idle: tuple[int, ...]

    def __post_init__(self) -> None:
        freeze(self)


def collinearity(base: Surface, covariance: Real) -> Collinearity:
    """What the first repeat of a surface determines badly; `covariance` (M, M) is the estimate's.

    Combinations count that inflate an interval tenfold or more over what it were with all other unknowns known.
    Raises IdentifiabilityError where nothing is known of an unknown, or the information is not a finite number.
    """
    total = np.sum(base.information[0], axis=0) + np.diag(prior_precision(base.view))
    known = np.all(np.isfinite(total), axis=-1) & (np.diagonal(total) > 0)
    if not np.all(known):
        lost = [name for name, fine in zip(base.view.names, known, strict=True) if not fine]
        raise IdentifiabilityError(
            f"at the estimated values the data say nothing about {listed(lost)}",
            cure="check units and signs of the channels, or give values",
        )
    sd = np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(total / np.outer(sd, sd))
    values = np.maximum(values, 1e-15)
    combinations = _combinations(base, covariance, sd, values, vectors)
    shares = _shares(base.information[0], total, sd, singular=values[0] <= 1e-14)
    lines = len(shares)
    idle = tuple(int(line) for line in np.flatnonzero(np.all(shares < IDLE / lines, axis=1)))
    return Collinearity(base.view.names, combinations, shares, idle)


def _combinations(
    base: Surface, covariance: Real, sd: Real, values: Real, vectors: Real
) -> tuple[Combination, ...]:
    """From eigenvalues (M,) and vectors (M, M) of the information scaled by `sd` (M,)."""
    names = base.view.names
    parts = vectors**2 / values  # of the variance of each unknown, (unknowns, combinations)
    inflation = np.sum(parts, axis=1)
    portion = parts / inflation[:, None]
    spread = np.sqrt(np.diagonal(covariance) / (inflation / sd**2))  # what the noise basis multiplies
    delays = np.array([name.endswith(".delay") for name in names])
    size = np.where(delays | (base.psi[0] == 0), 1.0, np.abs(base.psi[0]))
    combinations = []
    for k in np.argsort(values):
        if values[k] * WEAK**2 > 1:
            break
        members = np.flatnonzero((portion[:, k] > PART) & (inflation > WEAK**2))
        if not len(members):
            continue
        relative = (vectors[:, k] / sd / size * np.where(base.psi[0] < 0, -1, 1))[members]
        peak = relative[np.argmax(np.abs(relative))]
        best, narrowing = _best(covariance, members)
        along = float(abs(peak) / np.sqrt(values[k]) * np.mean(spread[members]))
        combinations.append(
            Combination(
                tuple(names[i] for i in members), relative / peak, along, np.sqrt(inflation[members]), names[best],
                narrowing,
            )
        )  # fmt: skip
    return tuple(combinations)


def _shares(information: Real, total: Real, sd: Real, singular: bool) -> Real:
    """Part of each line (lines, M, M) in the information on each unknown, (lines, M)."""
    scale = np.outer(sd, sd)
    C = np.diag(1 / sd**2) if singular else np.linalg.inv(total / scale) / scale
    shares: Real = np.einsum("jk,lki,ij->lj", C, information, C) / np.diagonal(C)
    return shares


def _best(covariance: Real, members: Ints) -> tuple[int, float]:
    """(the unknown whose value would narrow the intervals of `members` most, mean remaining factor of the others)."""
    variance = np.diagonal(covariance)
    best, least = int(members[0]), np.inf
    for i in members:
        left = variance[members] - covariance[members, i] ** 2 / variance[i]
        factor = np.sqrt(np.maximum(left, 0.0) / variance[members])
        others = factor[members != i]
        mean = float(np.mean(others)) if len(others) else 0.0
        if mean < least:
            best, least = int(i), mean
    return best, least


def shares_by_band(found: Collinearity, frequency_hz: Real, most: int = 120) -> tuple[Real, Real]:
    """Middles (bands,), Hz, and shares (bands, M) in the order of frequency; lines of one frequency are one band.

    Neighbouring frequencies are added up where there are more than `most`.
    """
    unique, place = np.unique(frequency_hz, return_inverse=True)
    each = max(1, -(-len(unique) // most))
    bands = np.zeros((-(-len(unique) // each), len(found.names)))
    np.add.at(bands, place // each, found.shares)
    middles = np.array([float(np.median(unique[k * each : (k + 1) * each])) for k in range(len(bands))])
    return middles, bands
