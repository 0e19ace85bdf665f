"""What an estimate is worth: information of each line, residuals, and how the noise was known (THEORY §5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real, hermitian
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.estimate.likelihood.maximum_likelihood import prior_mean, prior_precision
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.linear.auxiliary_model import auxiliary
from dashpot.estimate.linear.gram import regressors
from dashpot.estimate.method import Prepared, Solution
from dashpot.estimate.preparation.noise_quality import NoiseQuality, interval_dof, noise_quality
from dashpot.model.observation import observation_model
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled, solve_small

ROUNDING = 1e-30  # χ² of exact data against noise of the data's own size
MISFIT_LEVEL = 1e-3  # p-value of χ² below which intervals count the misfit of the model


@dataclass(frozen=True)
class Judged:
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
class Worth:
    """Covariances and fit of K repeats; see Estimate for the names."""

    covariance: Real
    noise: Real
    bound: Real
    dof: Real
    chi2: Real
    p: Real


def judge(data: Prepared, solution: Solution, by_output: bool) -> Judged:
    """Residuals and information in the channels (by_output) or in the equation of motion, where all is seen.

    Both say the same where all channels are direct; only the channels know of calibrations and of force channels.
    """
    model = data.model
    if by_output:
        view = observation_model(model, data.spectrum.channels, data.spectrum.omega)
        exact = measured(data, view)
        sign = np.ones((len(exact.y), len(view.channels)))
        for name, found in solution.signs.items():
            sign[:, data.spectrum.index(name)] = found
        at = predict(view, exact, solution.theta, sign)
        scores = 2 * (hermitian(at.J) @ at.weighted[..., None]).real[..., 0]
        return Judged(
            view.names, view.units, at.information(), scores, at.cost_per_line, exact.rows - at.columns,
            prior_precision(view), prior_mean(view),
        )  # fmt: skip
    if data.states is None:
        raise UsageError("some coordinate is not seen", cure="use the method ml")
    here = auxiliary(model, model.parameters(solution.theta), data.states)
    Psi = regressors(model, here.w)
    weighted: Complex = solve_small(here.Se, np.concatenate([Psi, here.e[..., None]], axis=-1))
    products = 2 * (hermitian(Psi) @ weighted).real
    cost = 2 * np.sum((np.conj(here.e) * weighted[..., -1]).real, axis=-1)
    return Judged(
        tuple(u.name for u in model.unknowns), tuple(u.unit for u in model.unknowns),
        products[..., :-1], -products[..., -1], cost, 2 * model.n * data.spectrum.lines,
        model.prior_precision, model.prior_mean,
    )  # fmt: skip


def worth(
    data: Prepared, solution: Solution, judged: Judged, known: bool, correlate: Bools, weighted: bool
) -> Worth:
    """Covariance, bound and χ².

    χ² and bound are the model's, not the method's: `solution` and `judged` are to be those of the most likely
    parameters, to which one Gauss-Newton step leads, with the covariance of the method.  Where the noise is unknown,
    χ² supplies its size; where it was estimated, weights and intervals pay for that; where the model does not fit,
    the covariance grows by χ²/dof.  Where bounds hold unknowns, χ² is that of the values held: bounds that the data
    contradict are no fit.
    """
    prior = np.diag(judged.precision)
    away = solution.theta - judged.mean
    total = np.sum(judged.information, axis=-3) + prior
    gradient = np.sum(judged.scores, axis=-2) - judged.precision * away
    excess = _excess(total, gradient, solution)
    penalty = np.sum(judged.precision * away**2, axis=-1)
    dof = judged.dof
    usable = float(max(dof, 1))
    if not known:
        chi2 = np.maximum(np.sum(judged.cost, axis=-1) + penalty - excess, 0.0)
        scale = np.maximum(chi2, ROUNDING) / usable
        covariance = solution.covariance * scale[:, None, None]
        bound = scaled_inverse(np.sum(judged.information, axis=-3) / scale[:, None, None] + prior)
        nothing = np.full(len(chi2), np.nan)
        return Worth(
            covariance, covariance, bound, np.full(away.shape, usable), np.full(len(chi2), usable), nothing
        )
    quality = noise_quality(data.spectrum, np.atleast_1d(correlate))
    shrink = np.mean(quality.shrink, axis=-1)
    chi2 = np.maximum(np.sum(judged.cost * quality.shrink, axis=-1) + penalty - excess * shrink, 0.0)
    p = _p_value(chi2, dof, judged.rows, data.spectrum)
    bound = scaled_inverse(np.sum(judged.information * quality.shrink[..., None, None], axis=-3) + prior)
    bread = scaled_inverse(total)
    noise, degrees = _noise(judged, quality, bread, prior)
    if not weighted:
        noise = solution.covariance
    misfit = (p < MISFIT_LEVEL) & (chi2 > dof)
    factor = np.where(misfit, chi2 / usable, 1.0)
    degrees = np.where(misfit[:, None], np.minimum(degrees, usable), degrees)
    return Worth(noise * factor[:, None, None], noise, bound, degrees, chi2, p)


def _excess(total: Real, gradient: Real, solution: Solution) -> Real:
    """What χ² at θ lies above its minimum, (K,), unknowns held at a bound staying there."""
    if solution.limits is not None:
        held = (solution.theta <= solution.limits.lower) | (solution.theta >= solution.limits.upper)
        gradient = np.where(held, 0.0, gradient)
        apart = (held[:, :, None] | held[:, None, :]) & ~np.eye(held.shape[-1], dtype=bool)
        total = np.where(apart, 0.0, total)
    excess: Real = np.sum(gradient * solve_scaled(total, gradient), axis=-1)
    return excess


def _noise(judged: Judged, quality: NoiseQuality, bread: Real, prior: Real) -> tuple[Real, Real]:
    """Covariance of a weighted estimate, the noise having been estimated, and the degrees of freedom behind it."""
    around = bread[:, None]
    shares = around @ (judged.information * quality.inflation[..., None, None]) @ around
    stated = bread @ prior @ bread
    own = np.diagonal(stated, axis1=-2, axis2=-1)
    degrees = interval_dof(np.diagonal(shares, axis1=-2, axis2=-1), quality.dof, own)
    return np.sum(shares, axis=-3) + stated, degrees


def _p_value(chi2: Real, dof: int, rows: int, spectrum: Spectrum) -> Real:
    """Tail probability of χ², widened where the noise was estimated.

    With an estimated covariance a line's quadratic form is a Lawley-Hotelling trace; mean and variance of their sum
    are matched by a scaled χ².
    """
    from scipy.special import chdtrc

    if dof <= 0 or "residual" in spectrum.noise:  # noise sized by these very residuals tests nothing
        return np.full(len(chi2), np.nan)
    nu, n = spectrum.dof, rows / (2 * spectrum.lines)
    with np.errstate(invalid="ignore"):
        wide = (nu - 1) * (nu - n + 1) / ((nu - n) * (nu - n - 3))
    wide = np.where(np.isfinite(nu), np.where(nu - n - 3 > 0, wide, np.nan), 1.0)
    ratio = float(np.nanmean(wide)) if np.any(np.isfinite(wide)) else 1.0
    return np.asarray(chdtrc(dof / ratio, chi2 / ratio), dtype=float)
