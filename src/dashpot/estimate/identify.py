"""One verb: identify(model, spectrum, method) → Estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.data.spectrum import Moments, Spectrum
from dashpot.errors import DataError, IdentifiabilityError, UsageError
from dashpot.estimate.auxiliary import auxiliary, information, normal_equations
from dashpot.estimate.covariance import channels_correlate, interval_dof, noise_quality, without_correlation
from dashpot.estimate.estimate import Estimate, Fit, ModeValues
from dashpot.estimate.instruments import OptimalIV
from dashpot.estimate.method import Method, Prepared, Solution
from dashpot.estimate.regression import inverse, solve_scaled
from dashpot.estimate.states import noise_is_known, states, unseen, working_covariance
from dashpot.model.dynamics import modes, unit_forces
from dashpot.model.network import Model

CHUNK = 2_000_000  # complex numbers of amplitudes at once: keeps the working set of a batch near 1 GB


def identify(
    model: Model,
    spectrum: Spectrum,
    method: Method | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Estimate the unknowns of `model` from `spectrum`.

    The default method is OptimalIV where every coordinate and input is seen.  Leading batch axes of the spectrum are
    repeats of the same test and come back as leading axes of the Estimate; `progress(done, all)` is called between
    chunks of them.

    Raises UsageError or DataError where the data lack what the method needs, IdentifiabilityError where they do not
    determine the unknowns.
    """
    _check(model, spectrum)
    chosen = OptimalIV() if method is None else method
    batch = spectrum.batch
    flat = _flatten(spectrum)
    repeats = flat.amplitudes.shape[0]
    size = max(1, CHUNK // (flat.lines * (model.n + 1) * (len(model.elements) + len(flat.channels))))
    parts = []
    for first in range(0, repeats, size):
        parts.append(_identify(model, _repeats(flat, slice(first, first + size)), chosen))
        if progress is not None:
            progress(min(first + size, repeats), repeats)
    return _assemble(model, chosen, parts, batch, flat)


def _check(model: Model, spectrum: Spectrum) -> None:
    if not model.unknowns:
        raise UsageError(
            "every parameter of the rig is known", cure="leave out the value of what is to be found"
        )
    if spectrum.lines == 0:
        raise DataError("there are no lines in the data", cure="give at least one frequency")


def _flatten(spectrum: Spectrum) -> Spectrum:
    """The same spectrum with exactly one leading axis of repeats on amplitudes, covariance (or 1) and moments."""
    repeats = int(np.prod(spectrum.batch, dtype=int))
    V = spectrum.covariance
    V = (
        V[None]
        if V.ndim == 3
        else np.broadcast_to(V, (*spectrum.batch, *V.shape[-3:])).reshape(repeats, *V.shape[-3:])
    )
    moments = None
    if spectrum.moments is not None:
        M = spectrum.moments.products
        moments = Moments(
            np.broadcast_to(M, (*spectrum.batch, *M.shape[-3:])).reshape(repeats, *M.shape[-3:])
        )
    amplitudes = spectrum.amplitudes.reshape(repeats, *spectrum.amplitudes.shape[-2:])
    return replace(spectrum, amplitudes=amplitudes, covariance=V, moments=moments)


def _repeats(flat: Spectrum, rows: slice) -> Spectrum:
    if len(flat.amplitudes) == 1:
        return flat
    V = flat.covariance if len(flat.covariance) == 1 else flat.covariance[rows]
    moments = None if flat.moments is None else Moments(flat.moments.products[rows])
    return replace(flat, amplitudes=flat.amplitudes[rows], covariance=V, moments=moments)


class _Part:
    """What one chunk of repeats gave."""

    def __init__(
        self, solution: Solution, cov: Real, noise: Real, bound: Real, dof: Real, chi2: Real, p: Real
    ) -> None:
        self.solution, self.covariance, self.noise, self.bound, self.dof = solution, cov, noise, bound, dof
        self.chi2, self.p = chi2, p


def _noise_free(V: Complex) -> bool:
    return not np.any(V)


def _identify(model: Model, spectrum: Spectrum, method: Method) -> _Part:
    known = noise_is_known(spectrum) and not _noise_free(spectrum.covariance)
    if not known:
        spectrum = replace(
            spectrum,
            covariance=np.full_like(spectrum.covariance, np.nan),
            noise=("unknown",) * spectrum.lines,
        )
    V = working_covariance(model, spectrum)
    V = V if V.ndim == 4 else V[None]
    correlate = channels_correlate(spectrum) if known else np.ones(len(V), dtype=bool)
    V = np.where(correlate[:, None, None, None], V, without_correlation(V))
    data = Prepared(model, spectrum, V, None if unseen(model, spectrum) else states(model, spectrum, V))
    solution = method.solve(data)
    if data.states is None:
        raise UsageError("some coordinate is not seen", cure="use the method ml")
    at = auxiliary(model, model.parameters(solution.theta), data.states)
    lines = information(model, at)
    prior = np.diag(model.prior_precision)
    m = len(model.unknowns)
    rows = 2 * model.n * spectrum.lines
    dof = rows - m + int(np.count_nonzero(model.prior_precision))
    # χ² is the model's, not the method's: one Gauss-Newton step leads from the estimate to the minimum nearby.
    a = unit_forces(model, data.states.omega, data.states.X, data.states.U)
    _, symmetric, gradient = normal_equations(model, at, a)
    gradient = gradient - model.prior_precision * (solution.theta - model.prior_mean)
    excess = np.sum(gradient * solve_scaled(symmetric + np.diag(model.prior_precision), gradient), axis=-1)
    per_line = at.cost_per_line()
    away = np.sum(model.prior_precision * (solution.theta - model.prior_mean) ** 2, axis=-1)
    if not known:
        chi2 = np.maximum(np.sum(per_line, axis=-1) + away - excess, 0.0)
        scale = chi2 / max(dof, 1)
        covariance = solution.covariance * scale[:, None, None]
        bound = inverse(np.sum(lines, axis=-3) / scale[:, None, None] + prior)
        degrees = np.full(solution.theta.shape, float(max(dof, 1)))
        return _Part(
            solution, covariance, covariance, bound, degrees, chi2 / scale, np.full(len(chi2), np.nan)
        )
    quality = noise_quality(spectrum, np.atleast_1d(correlate))
    chi2 = np.maximum(
        np.sum(per_line * quality.shrink, axis=-1) + away - excess * np.mean(quality.shrink, axis=-1), 0.0
    )
    p = _p_value(chi2, dof, model.n, spectrum)
    bound = inverse(np.sum(lines * quality.shrink[..., None, None], axis=-3) + prior)
    bread = inverse(np.sum(lines, axis=-3) + prior)
    shares = bread[:, None] @ (lines * quality.inflation[..., None, None]) @ bread[:, None]
    if method.weighted:
        noise = np.sum(shares, axis=-3) + bread @ prior @ bread
    else:
        noise = solution.covariance
    degrees = interval_dof(np.diagonal(shares, axis1=-2, axis2=-1), quality.dof)
    misfit = (p < 1e-3) & (chi2 > dof)
    factor = np.where(misfit, chi2 / max(dof, 1), 1.0)
    covariance = noise * factor[:, None, None]
    degrees = np.where(misfit[:, None], np.minimum(degrees, float(max(dof, 1))), degrees)
    return _Part(solution, covariance, noise, bound, degrees, chi2, p)


def _p_value(chi2: Real, dof: int, n: int, spectrum: Spectrum) -> Real:
    """Tail probability of χ², widened where the noise was estimated.

    With an estimated covariance a line's quadratic form is a Lawley-Hotelling trace; mean and variance of their sum
    are matched by a scaled χ².
    """
    from scipy.stats import chi2 as distribution

    if dof <= 0:
        return np.full(len(chi2), np.nan)
    nu = spectrum.dof
    with np.errstate(invalid="ignore"):
        wide = (nu - 1) * (nu - n + 1) / ((nu - n) * (nu - n - 3))
    wide = np.where(np.isfinite(nu), np.where(nu - n - 3 > 0, wide, np.nan), 1.0)
    ratio = float(np.nanmean(wide)) if np.any(np.isfinite(wide)) else 1.0
    p: Real = distribution.sf(chi2 / ratio, dof / ratio)
    return p


def _assemble(
    model: Model, method: Method, parts: list[_Part], batch: tuple[int, ...], spectrum: Spectrum
) -> Estimate:
    def join(pieces: list[Real]) -> Real:
        whole = np.concatenate(pieces)
        return whole.reshape((*batch, *whole.shape[1:]))

    theta = join([part.solution.theta for part in parts])
    covariance = join([part.covariance for part in parts])
    noise = join([part.noise for part in parts])
    converged = np.concatenate([part.solution.converged for part in parts]).reshape(batch)
    single = not batch
    dof = 2 * model.n * spectrum.lines - len(model.unknowns) + int(np.count_nonzero(model.prior_precision))
    known_noise = noise_is_known(spectrum) and not _noise_free(spectrum.covariance)
    fit = Fit(join([part.chi2 for part in parts]), dof, join([part.p for part in parts]), known_noise)
    if single:
        _require_determined(model, theta, noise)
    misfit = bool(np.any(fit.rejected))
    basis = "model misfit" if misfit else "sensor noise" if known_noise else "residuals"
    names = tuple(unknown.name for unknown in model.unknowns)
    warnings = list(dict.fromkeys(w for part in parts for w in part.solution.warnings))
    warnings += _warnings(model, theta, fit, known_noise) if single else []
    return Estimate(
        model=model.name,
        method=method.name,
        names=names,
        units=tuple(unknown.unit for unknown in model.unknowns),
        values=theta,
        covariance=covariance,
        noise_covariance=noise,
        bound_sd=join([np.sqrt(np.diagonal(part.bound, axis1=-2, axis2=-1)) for part in parts]),
        dof=join([part.dof for part in parts]),
        basis=basis,
        converged=converged,
        iterations=np.concatenate([part.solution.iterations for part in parts]).reshape(batch),
        history=parts[0].solution.history,
        fit=fit,
        known=_known(model),
        tied=_tied(model),
        modes=mode_values(model, theta, covariance) if single else None,
        calibrations={},
        warnings=tuple(warnings),
    )


def _require_determined(model: Model, theta: Real, covariance: Real) -> None:
    variance = np.diagonal(covariance)
    if np.all(np.isfinite(theta)) and np.all(np.isfinite(variance)) and np.all(variance >= 0):
        return
    lost = [u.name for u, v in zip(model.unknowns, variance, strict=True) if not np.isfinite(v)]
    raise IdentifiabilityError(
        f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}",
        cure="give one of them a value, add frequencies, or ask `dashpot check` which combinations can be found",
    )


def _warnings(model: Model, theta: Real, fit: Fit, known_noise: bool) -> list[str]:
    found = []
    if not known_noise:
        found.append(
            "the noise of the amplitudes is not given: equal relative noise is assumed and its size taken from the residuals"
        )
    elif bool(fit.rejected):
        found.append(
            f"the model does not fit: residuals are {float(fit.misfit):.3g} times the sensors' noise "
            f"(χ² {float(fit.chi2):.4g} with {fit.dof} degrees of freedom); intervals are widened by that factor, "
            "what counts only sensor noise is named so"
        )
    for unknown, value in zip(model.unknowns, theta, strict=True):
        if value < 0:
            found.append(
                f"{unknown.name} comes out negative ({value:.4g} {unknown.unit}): the model or the data lack something"
            )
    return found


def _known(model: Model) -> tuple[tuple[str, float, str], ...]:
    unknown = {u.name for u in model.unknowns}
    return tuple(
        (element.name, float(model.p0[i]), model.unit(element))
        for i, element in enumerate(model.elements)
        if element.name not in unknown and not np.any(model.T[i])
    )


def _tied(model: Model) -> tuple[tuple[str, str, float, str], ...]:
    return tuple(
        (element.name, model.elements[tie.root].name, tie.times, model.unit(element))
        for element, tie, row in zip(model.elements, model.ties, model.T, strict=True)
        if element.same_as is not None and np.any(row)
    )


def mode_values(model: Model, theta: Real, covariance: Real) -> ModeValues:
    """Modes at θ with standard deviations of frequency and damping propagated from its covariance."""
    found = modes(model, model.parameters(theta))
    slope = found.sensitivity @ model.T
    values = found.eigenvalues
    size = np.where(np.abs(values) > 0, np.abs(values), 1.0)
    grow = (np.conj(values)[:, None] * slope).real / size[:, None]
    frequency = grow / (2 * np.pi)
    damping = -slope.real / size[:, None] + values.real[:, None] * grow / size[:, None] ** 2

    def sd(jacobian: Real) -> Real:
        return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian), 0.0))

    return ModeValues(
        values, found.frequency_hz, found.damping_ratio, sd(frequency), sd(damping), found.shapes
    )
