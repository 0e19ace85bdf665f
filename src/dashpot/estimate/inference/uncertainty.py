"""Covariance, bound and χ² of an estimate, from the information of each line and the residuals (THEORY §5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.inference.band_stability import BandStability, band_stability
from dashpot.estimate.inference.diagnostics import bias
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.objective import (
    measured,
    nuisance_columns,
    per_line,
    prior_mean,
    prior_precision,
)
from dashpot.estimate.linear.auxiliary_model import equation_by_line
from dashpot.estimate.linear.instrumental_variables import likeliest
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.preparation.noise_quality import NoiseQuality, interval_dof, noise_quality
from dashpot.estimate.preparation.prepared import Prepared, without_priors
from dashpot.model.observation import observation_model
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled

ROUNDING = 1e-30  # χ² of exact data against noise of the data's own size
MISFIT_LEVEL = 1e-3  # p-value of χ² below which intervals count the misfit of the model


@dataclass(frozen=True)
class Linearised:
    """Information and residuals at an estimate, line by line, for K repeats and M unknowns.

    information (K, lines, M, M); scores (K, lines, M), their sum is minus half the slope of the cost;
    cost (K, lines); rows: how many real equations the lines hold; precision, mean (M,) of the priors.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    information: Real
    scores: Real
    cost: Real
    rows: int
    precision: Real
    mean: Real

    @property
    def dof(self) -> int:
        """Degrees of freedom of χ²."""
        return self.rows - len(self.names) + int(np.count_nonzero(self.precision))


@dataclass(frozen=True)
class Uncertainty:
    """Covariances and fit of K repeats; see Estimate for the names.

    bands: how parts of the band agree, where the noise is that of the residuals of whole records, else None
    """

    covariance: Real
    noise: Real
    bound: Real
    dof: Real
    chi2: Real
    p: Real
    bands: BandStability | None = None


@dataclass(frozen=True)
class Inference:
    """A method's solution, what the data say around it and how uncertain it is."""

    solution: Solution
    linearised: Linearised
    uncertainty: Uncertainty


def inference(data: Prepared, solution: Solution, method: Method) -> Inference:
    """Uncertainty of what `method` found, with a warning where the noise has biased it.

    χ² and bound are the model's, not the method's: they belong to the most likely parameters near θ.
    """
    best = most_likely(data, solution, method.traits)
    linearised = linearise(data, best, method.traits)
    found = uncertainty(data, best, linearised, method.traits.weighted)
    if len(solution.theta) == 1 and data.noise_known and best is not solution:
        warnings = (*solution.warnings, *bias(linearised.names, solution, best, found.covariance, method))
        solution = replace(solution, warnings=warnings)
    return Inference(solution, linearised, found)


def with_noise_of_residuals(data: Prepared, method: Method) -> Prepared:
    """The noise scaled until χ² is its degrees of freedom: priors weigh against noise of the right size only."""
    exact = without_priors(data.model)
    for model in (exact, data.model, data.model):
        if not model.unknowns:
            continue
        trial = replace(data, model=model)
        best = most_likely(trial, method.solve(trial), method.traits)
        around = linearise(trial, best, method.traits)
        penalty = np.sum(around.precision * (best.theta - around.mean) ** 2, axis=-1)
        chi2 = np.sum(around.cost, axis=-1) + penalty
        data = data.scaled(np.maximum(chi2, ROUNDING) / max(around.dof, 1))
    return data


def most_likely(data: Prepared, solution: Solution, traits: Traits) -> Solution:
    """The solution with the most likely parameters near it."""
    if traits.maximum_likelihood:
        return solution
    if len(data.model.nonlinear):
        return replace(solution, theta=MaximumLikelihood().solve(data).theta)
    return replace(solution, theta=likeliest(data, solution.theta))


def linearise(data: Prepared, solution: Solution, traits: Traits) -> Linearised:
    """Residuals and information in the channels (by output) or in the equation of motion, where all is seen.

    Both say the same where all channels are direct; only the channels know of calibrations, of force channels and of
    nonlinear elements.
    """
    by_output = traits.by_output or len(data.model.nonlinear)
    return _of_channels(data, solution) if by_output else _of_equation(data, solution)


def _of_channels(data: Prepared, solution: Solution) -> Linearised:
    view = observation_model(data.model, data.spectrum.channels, data.spectrum.omega)
    exact = measured(data, view)
    sign = np.ones((len(exact.y), len(view.channels)))
    for name, signs in solution.signs.items():
        sign[:, data.spectrum.index(name)] = signs
    information, scores, cost = per_line(view, exact, solution.theta, sign)
    rows = exact.rows - nuisance_columns(view, exact, solution.theta, sign)
    return Linearised(
        view.names, view.units, information, scores, cost, rows, prior_precision(view), prior_mean(view)
    )


def _of_equation(data: Prepared, solution: Solution) -> Linearised:
    model = data.model
    information, scores, cost = equation_by_line(model, data.seen_states, solution.theta)
    return Linearised(
        tuple(u.name for u in model.unknowns), tuple(u.unit for u in model.unknowns), information, scores, cost,
        2 * model.n * data.spectrum.lines, model.prior_precision, model.prior_mean,
    )  # fmt: skip


def uncertainty(data: Prepared, solution: Solution, around: Linearised, weighted: bool) -> Uncertainty:
    """Covariance, bound and χ².

    `solution` and `around` are to be those of the most likely parameters, to which one Gauss-Newton step leads, with
    the covariance of the method.  Where the noise is unknown, χ² supplies its size; where it was estimated, weights and
    intervals pay for that; where the model does not fit, the covariance grows by χ²/dof.  Where the residuals of whole
    records are all that tells the noise, it counts by how much parts of the band disagree.  Where bounds hold unknowns,
    χ² is that of the values held: bounds that the data contradict are no fit.
    """
    prior = np.diag(around.precision)
    away = solution.theta - around.mean
    total = np.sum(around.information, axis=-3) + prior
    gradient = np.sum(around.scores, axis=-2) - around.precision * away
    excess = _excess(total, gradient, solution)
    penalty = np.sum(around.precision * away**2, axis=-1)
    dof = around.dof
    usable = float(max(dof, 1))
    if not data.noise_known:
        chi2 = np.maximum(np.sum(around.cost, axis=-1) + penalty - excess, 0.0)
        scale = np.maximum(chi2, ROUNDING) / usable
        covariance = solution.covariance * scale[:, None, None]
        bound = scaled_inverse(np.sum(around.information, axis=-3) / scale[:, None, None] + prior)
        nothing = np.full(len(chi2), np.nan)
        return Uncertainty(
            covariance, covariance, bound, np.full(away.shape, usable), np.full(len(chi2), usable), nothing
        )
    quality = noise_quality(data.spectrum, data.correlated)
    shrink = np.mean(quality.shrink, axis=-1)
    chi2 = np.maximum(np.sum(around.cost * quality.shrink, axis=-1) + penalty - excess * shrink, 0.0)
    p = _p_value(chi2, dof, around.rows, data.spectrum)
    bread = bound = scaled_inverse(total)
    if not np.all(quality.shrink == 1):
        bound = scaled_inverse(np.sum(around.information * quality.shrink[..., None, None], axis=-3) + prior)
    noise, degrees = _noise(around, quality, bread, prior, total - prior)
    if not weighted:
        noise = solution.covariance
    misfit = (p < MISFIT_LEVEL) & (chi2 > dof)
    factor = np.where(misfit, chi2 / usable, 1.0)
    degrees = np.where(misfit[:, None], np.minimum(degrees, usable), degrees)
    covariance = noise * factor[:, None, None]
    if "residual" not in data.spectrum.noise or not weighted:
        return Uncertainty(covariance, noise, bound, degrees, chi2, p)
    bands = band_stability(data.spectrum.frequency_hz, around.information, around.scores, prior)
    degrees = np.where(bands.disagree[:, None], np.minimum(degrees, bands.dof), degrees)
    return Uncertainty(bands.widened(covariance), noise, bound, degrees, chi2, p, bands)


def _excess(total: Real, gradient: Real, solution: Solution) -> Real:
    """What χ² at θ lies above its minimum, (K,), unknowns held at a bound staying there."""
    if solution.bounds is not None:
        held = (solution.theta <= solution.bounds.lower) | (solution.theta >= solution.bounds.upper)
        gradient = np.where(held, 0.0, gradient)
        apart = (held[:, :, None] | held[:, None, :]) & ~np.eye(held.shape[-1], dtype=bool)
        total = np.where(apart, 0.0, total)
    excess: Real = np.sum(gradient * solve_scaled(total, gradient), axis=-1)
    return excess


def _noise(
    around: Linearised, quality: NoiseQuality, bread: Real, prior: Real, information: Real
) -> tuple[Real, Real]:
    """Covariance of a weighted estimate, the noise having been estimated, and the degrees of freedom behind it."""
    stated = bread @ prior @ bread
    if np.all(np.isinf(quality.dof)):  # the noise is given
        return bread @ information @ bread + stated, np.full(bread.shape[:-1], np.inf)
    core = kernel()
    if core is not None:
        summed, shared = core.line_shares(
            np.ascontiguousarray(around.information),
            np.ascontiguousarray(np.atleast_2d(quality.inflation)), bread, threads(),
        )  # fmt: skip
        degrees = interval_dof(shared, quality.dof, np.diagonal(stated, axis1=-2, axis2=-1))
        return bread @ summed @ bread + stated, degrees
    each = bread[:, None]
    shares = each @ (around.information * quality.inflation[..., None, None]) @ each
    exact = np.diagonal(stated, axis1=-2, axis2=-1)
    degrees = interval_dof(np.diagonal(shares, axis1=-2, axis2=-1), quality.dof, exact)
    return np.sum(shares, axis=-3) + stated, degrees


def _p_value(chi2: Real, dof: int, rows: int, spectrum: Spectrum) -> Real:
    """Tail probability of χ², widened where the noise was estimated.

    With an estimated covariance a line's quadratic form is a Lawley-Hotelling trace; mean and variance of their sum
    are matched by a scaled χ².
    """
    from scipy.special import chdtrc

    if dof <= 0 or "residual" in spectrum.noise:  # noise sized by these very residuals tests nothing
        return np.full(len(chi2), np.nan)
    if np.all(np.isinf(spectrum.dof)):
        return np.asarray(chdtrc(float(dof), chi2), dtype=float)
    nu, n = spectrum.dof, rows / (2 * spectrum.lines)
    with np.errstate(invalid="ignore"):
        wide = (nu - 1) * (nu - n + 1) / ((nu - n) * (nu - n - 3))
    wide = np.where(np.isfinite(nu), np.where(nu - n - 3 > 0, wide, np.nan), 1.0)
    ratio = float(np.nanmean(wide)) if np.any(np.isfinite(wide)) else 1.0
    return np.asarray(chdtrc(dof / ratio, chi2 / ratio), dtype=float)
