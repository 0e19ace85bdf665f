"""Estimates of one rig from data apart, merged: as if all data had been identified at once.

For small noise −2 ln(likelihood) of each part is a parabola around its own estimate, known by that and its information,
so that the parabolas add up without their data: what this loses goes with the share of noise in a part squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real
from dashpot.errors import DataError
from dashpot.estimate.inference.derived import linear_modes
from dashpot.estimate.result import MISFIT, Estimate, Fit
from dashpot.model.network import Model
from dashpot.notices import Notice

DISAGREE = 1e-3  # p-value below which the scatter of the parts' estimates is more than their noise


@dataclass(frozen=True)
class Merged:
    """One estimate of all parts, and how the parts scatter about it.

    estimate  without assessment
    chi2      χ² of the parts' estimates about the merged one, by their full covariances
    dof       its degrees of freedom, (parts − 1) × unknowns
    p         probability of a larger one if one rig is behind all parts
    away      (parts, unknowns)  how far each lies from the merged one, in standard deviations of the difference
    """

    estimate: Estimate
    chi2: float
    dof: int
    p: float
    away: Real

    @property
    def disagree(self) -> bool:
        """Whether the parts differ by more than their noise."""
        return self.p < DISAGREE


def merge_estimates(model: Model, parts: Sequence[Estimate]) -> Merged:
    """Merge estimates of the same unknowns of `model` from data that share no noise; none has batch axes.

    Each counts by its information from the sensors' noise; priors count once.  Intervals are widened where those of the
    parts are, and where the parts scatter more than they promise.  Raises DataError where their unknowns or the signs
    of channels differ, or one does not determine the unknowns.
    """
    _require_alike(parts)
    scale = parts[0].noise_sd
    free = np.array([part.free_values for part in parts]) / scale
    prior = np.concatenate([model.prior_precision, np.zeros(len(scale) - len(model.unknowns))]) * scale**2
    mean = np.concatenate([model.prior_mean, np.zeros(len(scale) - len(model.unknowns))]) / scale
    precision = np.array([_inverse(part.noise_covariance / np.outer(scale, scale)) for part in parts])
    told = precision - np.diag(prior)  # by the data alone
    total = np.sum(told, axis=0) + np.diag(prior)
    weighted = np.einsum("pij,pj->pi", precision, free) - prior * mean
    theta = np.linalg.solve(total, np.sum(weighted, axis=0) + prior * mean)
    noise = _inverse(total)
    spread = np.array([part.covariance / np.outer(scale, scale) for part in parts])
    covariance = noise @ (np.einsum("pij,pjk,pkl->il", told, spread, told) + np.diag(prior)) @ noise
    off = free - theta
    scatter = float(np.einsum("pi,pij,pj->", off, np.array([_inverse(each) for each in spread]), off))
    dof = (len(parts) - 1) * len(scale)
    p = float(chdtrc(dof, scatter)) if dof else 1.0
    dof_of_intervals = np.sum([part.dof for part in parts], axis=0)
    if p < DISAGREE:
        covariance = covariance * (scatter / dof)
        dof_of_intervals = np.minimum(dof_of_intervals, dof)
    widened = p < DISAGREE or any(part.basis == MISFIT for part in parts)
    alone = np.maximum(np.diagonal(spread, axis1=-2, axis2=-1) - np.diagonal(noise), np.finfo(float).tiny)
    units = np.outer(scale, scale)
    estimate = _estimate(
        model, parts, theta * scale, (covariance if widened else noise) * units, noise * units
    )
    basis = MISFIT if widened else parts[0].basis
    return Merged(replace(estimate, basis=basis, dof=dof_of_intervals), scatter, dof, p, off / np.sqrt(alone))


def _inverse(matrix: Real) -> Real:
    """Of a covariance whose diagonal is near 1.  Raises DataError where it is singular."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise DataError("a part of the data does not determine the unknowns", cure="leave it out")
    symmetric: Real = (inverse + inverse.T) / 2
    return symmetric


def _require_alike(parts: Sequence[Estimate]) -> None:
    """Raises DataError where estimates cannot be merged."""
    first = parts[0]
    for part in parts:
        if part.names != first.names:
            names = sorted(set(part.names) ^ set(first.names))
            raise DataError(
                f"parts of the data estimate different unknowns ({', '.join(names)})", cure="identify apart"
            )
        for channel, sign in first.signs.items():
            if float(part.signs[channel]) != float(sign):
                raise DataError(
                    f"the sign of {channel} comes out differently in different parts of the data",
                    cure="was a sensor turned? identify the parts before and after apart",
                )


def _estimate(
    model: Model, parts: Sequence[Estimate], theta: Real, covariance: Real, noise: Real
) -> Estimate:
    """The merged estimate with intervals from `covariance`, whatever they rest on."""
    first, m = parts[0], len(model.unknowns)
    chi2, dof = sum(float(part.fit.chi2) for part in parts), sum(part.fit.dof for part in parts)
    tested = all(np.isfinite(part.fit.p) for part in parts)
    p = float(chdtrc(dof, chi2)) if tested else np.nan
    over_bound = np.mean([(part.bound_sd / part.noise_sd) ** 2 for part in parts], axis=0)
    return replace(
        first,
        values=np.clip(theta, first.lower, first.upper),
        free_values=theta,
        covariance=covariance,
        noise_covariance=noise,
        bound_sd=np.sqrt(np.diagonal(noise) * over_bound),
        converged=np.asarray(np.all([part.converged for part in parts])),
        iterations=np.sum([part.iterations for part in parts]),
        history=np.array([theta]),
        fit=Fit(np.array(chi2), dof, np.array(p), all(part.fit.known_noise for part in parts)),
        modes=linear_modes(model, theta[:m], covariance[:m, :m]),
        warnings=_together([part.warnings for part in parts]),
        notes=_together([part.notes for part in parts]),
        assessment=None,
        profiles={},
    )


def _together(each: Sequence[Sequence[Notice]]) -> tuple[Notice, ...]:
    """What is noticed in any part, once, and in how many it is where that is not all."""
    first: dict[tuple[str, tuple[str, ...]], Notice] = {}
    count: dict[tuple[str, tuple[str, ...]], int] = {}
    for notices in each:
        for key, notice in {(notice.code, notice.of): notice for notice in notices}.items():
            first.setdefault(key, notice)
            count[key] = count.get(key, 0) + 1
    return tuple(
        notice
        if count[key] == len(each)
        else replace(notice, text=f"{notice.text} ({count[key]} of {len(each)} parts)")
        for key, notice in first.items()
    )
