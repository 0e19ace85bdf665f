"""Whether parts of the band agree on the parameters, and how far they move when one part is left out (THEORY §11).

What χ² rejects moves parameters by more than χ²/dof tells: over 60 random rigs with eight kinds of misfit, intervals
widened by χ²/dof hold the truth in 74 %, widened to the scatter of the parts, too, in 92 %.

A record whose noise is read from its own residuals has no χ² that could fail: what the model lacks counts as noise.  A
wrong model still asks each part of the band for parameters of its own, which noise does not.  Both figures come from
the information and the scores of the lines at the estimate, so that nothing is fitted again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Real
from dashpot.io.words import joined
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse

PARTS = 6
LEVEL = 1e-3  # of the test whether they agree
DISAGREE = "bands_disagree"
TELLING = 0.02  # of what the whole band knows of a direction: parts that know less do not judge it


@dataclass(frozen=True)
class BandStability:
    """What parts of the band know at an estimate, for K repeats.

    information (K, parts, M, M) and scores (K, parts, M) of each part; total (K, M, M): their sum with the priors
    """

    information: Real
    scores: Real
    total: Real

    @property
    def dof(self) -> Real:
        """Degrees of freedom behind `covariance`, (K, 1); a line that knows more than a share leaves parts empty."""
        filled = np.any(_variances(self.information) > 0, axis=-1)
        degrees: Real = np.maximum(np.sum(filled, axis=-1, keepdims=True) - 1.0, 1.0)
        return degrees

    @cached_property
    def p(self) -> Real:
        """Tail probability that noise alone makes the parts differ as much, (K,)."""
        each = zip(self.information, self.scores, self.total, strict=True)
        return np.array([_agreement(*repeat) for repeat in each])

    @property
    def disagree(self) -> Bools:
        """Where the parts differ by more than noise makes them, (K,)."""
        return self.p < LEVEL

    @cached_property
    def moved(self) -> Real:
        """How far the unknowns move when each of the parts is left out, (K, parts, M)."""
        without = np.nan_to_num(scaled_inverse(self.total[:, None] - self.information))
        moved: Real = -np.einsum("kgij,kgj->kgi", without, self.scores)
        return moved

    @property
    def covariance(self) -> Real:
        """Of the estimate by leaving out one part at a time, (K, M, M)."""
        away = self.moved - np.mean(self.moved, axis=1, keepdims=True)
        parts = away.shape[1]
        jackknife: Real = (parts - 1) / parts * np.einsum("kgi,kgj->kij", away, away)
        return jackknife

    @property
    def apart(self) -> Real:
        """By how many of its standard deviations from noise each unknown moves, at most, (K, M)."""
        noise = np.sqrt(np.abs(_variances(scaled_inverse(self.total))))
        apart: Real = np.max(np.abs(self.moved), axis=1) / noise
        return apart

    def widened(self, covariance: Real, degrees: Real, where: Bools) -> tuple[Real, Real]:
        """Covariances (K, M, M) with their degrees of freedom (K, M), by the scatter of the parts where it is larger.

        where (K,): the repeats for which the parts count
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = _variances(self.covariance) / _variances(covariance)
        larger = where[:, None] & (np.nan_to_num(ratio) > 1.0)
        factor = np.sqrt(np.where(larger, ratio, 1.0))
        return (
            covariance * factor[:, :, None] * factor[:, None, :],
            np.where(larger, np.minimum(degrees, self.dof), degrees),
        )

    def notices(self, names: tuple[str, ...]) -> list[Notice]:
        """What the first repeat shows."""
        if not self.disagree[0]:
            return []
        most = np.argsort(-self.apart[0])[:2]
        moves = joined(f"{names[int(j)]} by {self.apart[0, j]:.2g}" for j in most)
        text = (
            "parts of the band disagree (leaving out a sixth of it moves "
            f"{moves} standard deviations of the noise)"
        )
        return [Notice(DISAGREE, text, tuple(names[int(j)] for j in most))]


def band_stability(frequency_hz: Real, information: Real, scores: Real, prior: Real) -> BandStability:
    """Six parts of the band that know equally much of the unknowns; as many as there are lines where these are fewer.

    frequency_hz (lines,); information (K, lines, M, M) and scores (K, lines, M), minus half the slope of the cost, at
    the estimate; prior (M, M) precision.
    """
    total = np.sum(information, axis=1) + prior
    belongs = _parts(frequency_hz, information, total)
    return BandStability(
        np.einsum("klg,klij->kgij", belongs, information), np.einsum("klg,kli->kgi", belongs, scores), total
    )


def _variances(covariance: Real) -> Real:
    variances: Real = np.diagonal(covariance, axis1=-2, axis2=-1)
    return variances


def _parts(frequency_hz: Real, information: Real, total: Real) -> Real:
    """1 where a line belongs to a part, (K, lines, parts): ascending in frequency, with equal shares of information."""
    share = np.einsum("klij,kji->kl", information, scaled_inverse(total))
    order = np.argsort(frequency_hz, kind="stable")
    run = np.cumsum(np.maximum(np.nan_to_num(share[:, order]), 0.0), axis=1)
    parts = min(PARTS, len(order))
    part = np.empty(share.shape, dtype=np.int64)
    part[:, order] = np.minimum((parts * run / np.maximum(run[:, -1:], 1e-300)).astype(int), parts - 1)
    belongs: Real = (part[..., None] == np.arange(parts)).astype(float)
    return belongs


def _agreement(information: Real, scores: Real, total: Real) -> float:
    """Tail probability of Σ Sᵀ I⁻¹ S over the parts, χ² where only noise makes their scores S."""
    size = np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(total / (size[:, None] * size))
    usable = values > 1e-12 * values[-1]
    root = vectors[:, usable] / np.sqrt(values[usable]) / size[:, None]
    statistic, dof = 0.0, -int(np.sum(usable))
    for part, score in zip(information, scores, strict=True):
        known, axes = np.linalg.eigh(root.T @ part @ root)
        seen = known > TELLING
        along = (axes.T @ (root.T @ score))[seen]
        statistic += float(np.sum(along**2 / known[seen]))
        dof += int(np.sum(seen))
    return 1.0 if dof < 1 else float(chdtrc(dof, statistic))
