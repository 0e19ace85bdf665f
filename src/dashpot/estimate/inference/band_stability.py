"""Whether parts of the band agree on the parameters, and how far they move when one part is left out (THEORY §11).

A record whose noise is read from its own residuals has no χ² that could fail: what the model lacks counts as noise.  A
wrong model still asks each part of the band for parameters of its own, which noise does not.  Both figures come from
the information and the scores of the lines at the estimate, so that nothing is fitted again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Ints, Real
from dashpot.io.words import joined
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse

PARTS = 6
LEVEL = 1e-3  # of the test whether they agree
DISAGREE = "bands_disagree"
TELLING = 0.02  # of what the whole band knows of a direction: parts that know less do not judge it


@dataclass(frozen=True)
class BandStability:
    """Agreement of the parts of the band, for K repeats.

    p (K,): tail probability that noise alone makes them differ as much
    covariance (K, M, M) of the estimate by leaving out one part at a time, with `dof` degrees of freedom
    apart (K, M): by how many of its standard deviations from noise each unknown moves, at most
    """

    p: Real
    covariance: Real
    apart: Real
    dof: int = PARTS - 1

    @property
    def disagree(self) -> Bools:
        """Where the parts differ by more than noise makes them, (K,)."""
        return self.p < LEVEL

    def widened(self, noise: Real) -> Real:
        """Covariances from noise (K, M, M), with the scatter of the parts where they disagree and it is larger."""
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.diagonal(self.covariance, axis1=1, axis2=2) / np.diagonal(noise, axis1=1, axis2=2)
        factor = np.sqrt(np.where(self.disagree[:, None], np.maximum(np.nan_to_num(ratio), 1.0), 1.0))
        return noise * factor[:, :, None] * factor[:, None, :]

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
    """Agreement of six parts of the band that know equally much of the unknowns.

    frequency_hz (lines,); information (K, lines, M, M) and scores (K, lines, M), minus half the slope of the cost, at
    the estimate; prior (M, M) precision.
    """
    K, _, M = scores.shape
    p, covariance, apart = np.ones(K), np.zeros((K, M, M)), np.zeros((K, M))
    for k in range(K):
        total = np.sum(information[k], axis=0) + prior
        part = _parts(frequency_hz, information[k], total)
        by_part = np.stack([np.sum(information[k][part == g], axis=0) for g in range(PARTS)])
        score = np.stack([np.sum(scores[k][part == g], axis=0) for g in range(PARTS)])
        p[k] = _agreement(by_part, score, total)
        without = scaled_inverse(total - by_part)
        moved = -np.einsum("gij,gj->gi", np.nan_to_num(without), score)
        away = moved - np.mean(moved, axis=0)
        covariance[k] = (PARTS - 1) / PARTS * away.T @ away
        noise = np.sqrt(np.abs(np.diagonal(scaled_inverse(total))))
        apart[k] = np.max(np.abs(moved), axis=0) / noise
    return BandStability(p, covariance, apart)


def _parts(frequency_hz: Real, information: Real, total: Real) -> Ints:
    """Which of the parts each line belongs to, (lines,): ascending in frequency, with equal shares of information."""
    share = np.einsum("lij,ji->l", information, scaled_inverse(total))
    order = np.argsort(frequency_hz, kind="stable")
    run = np.cumsum(np.maximum(np.nan_to_num(share[order]), 0.0))
    part = np.zeros(len(order), dtype=np.int64)
    part[order] = np.minimum((PARTS * run / max(float(run[-1]), 1e-300)).astype(int), PARTS - 1)
    return part


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
