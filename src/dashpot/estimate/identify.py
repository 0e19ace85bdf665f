"""One verb: identify(model, spectrum, method) → Estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.spectrum import Moments, Spectrum
from dashpot.errors import DataError, IdentifiabilityError, ModelError, UsageError
from dashpot.estimate.inference.diagnostics import (
    dead_channels,
    duplicated_lines,
    prior_conflict,
    reversed_phase,
)
from dashpot.estimate.inference.uncertainty import ROUNDING, Judged, Worth, judge, worth
from dashpot.estimate.likelihood.boundary_loads import carries_loads
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.record_noise import noise_from_residuals, noise_is_sought
from dashpot.estimate.linear.instrumental_variables import OptimalIV, likeliest
from dashpot.estimate.method import Limits, Method, Prepared, Solution
from dashpot.estimate.preparation.noise_quality import channels_correlate, without_correlation
from dashpot.estimate.preparation.state_reconstruction import (
    channels_present,
    noise_is_known,
    states_if_seen,
    unseen,
    working_covariance,
)
from dashpot.estimate.result import Estimate, Fit, ModeValues
from dashpot.model.dynamics import matrices
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.model.observation import is_direct
from dashpot.model.unstructured import free_entries, free_names
from dashpot.notices import Notice

ZERO = 1.96  # standard deviations within which a negative part may be none
BIASED = 3.0  # standard deviations
LOST = 1e-13  # of the terms of a variance: below it the sum is rounding
FALSE_ALARMS = 0.05  # of short records of white noise, at most, fail the test of whiteness
CHUNK = 2_000_000  # complex numbers of amplitudes at once: keeps the working set of a batch near 1 GB
MODES_TO = 400  # coordinates: the modes of larger rigs would take longer than all else


def identify(
    model: Model,
    spectrum: Spectrum,
    method: Method | str | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Estimate the unknowns of `model` from `spectrum`.

    `method` may be a name ("oiv"); without one, `automatic` chooses.  Leading batch axes of the spectrum are repeats of
    the same test and come back as leading axes of the Estimate; `progress(done, all)` is called between chunks of them.

    Raises UsageError or DataError where the data lack what the method needs, IdentifiabilityError where they do not
    determine the unknowns.
    """
    _check(model, spectrum)
    if isinstance(method, str):
        from dashpot.estimate.registry import method as named  # it imports the estimators, one by one

        method = named(method)
    chosen = automatic(model, spectrum) if method is None else method
    _check_records(spectrum, chosen)
    _check_laws(model, chosen)
    batch = spectrum.batch
    flat = _flatten(with_record_noise(model, spectrum, chosen))
    repeats = flat.amplitudes.shape[0]
    size = max(1, CHUNK // (flat.lines * (model.n + 1) * (len(model.elements) + len(flat.channels))))
    parts = []
    for first in range(0, repeats, size):
        parts.append(_identify(model, _repeats(flat, slice(first, first + size)), chosen))
        if progress is not None:
            progress(min(first + size, repeats), repeats)
    return _assemble(model, chosen, parts, batch, flat)


def automatic(model: Model, spectrum: Spectrum) -> Method:
    """OptimalIV where calibrated channels see every coordinate and input, else MaximumLikelihood.

    Bounds of unknowns, whole records and nonlinear elements are MaximumLikelihood's as well: it alone holds the first,
    knows the loads of the second and is efficient for the third.
    """
    if carries_loads(spectrum) or len(model.nonlinear):
        return MaximumLikelihood()
    direct = all(is_direct(model, channel) for channel in spectrum.channels)
    bounded = np.any(np.isfinite(model.bounds))
    return OptimalIV() if direct and not bounded and not unseen(model, spectrum) else MaximumLikelihood()


def _check(model: Model, spectrum: Spectrum) -> None:
    model.require_unknowns()
    if spectrum.lines == 0:
        raise DataError("there are no lines in the data", cure="give at least one frequency")


def _check_records(spectrum: Spectrum, method: Method) -> None:
    """Raises UsageError where a method would take the transients of whole records for steady vibration."""
    if carries_loads(spectrum) and not method.by_output:
        raise UsageError(
            f"the method {method.name} works on settled lines; whole records carry transients",
            cure="use the method ml, or give settled dwells with their frequencies",
        )


def _check_laws(model: Model, method: Method) -> None:
    """Raises UsageError where a method knows linear elements only."""
    if len(model.nonlinear) and not method.nonlinear:
        raise UsageError(
            f"the method {method.name} does not know nonlinear elements", cure="use the method ml, or hls"
        )


def with_record_noise(model: Model, spectrum: Spectrum, method: Method | None = None) -> Spectrum:
    """The spectrum with the noise of its whole records as the residuals of a fit show it; itself where that is known.

    What `identify` does first; the spectrum it works with, for those who judge the fit.
    """
    if not noise_is_sought(spectrum):
        return spectrum
    chosen = method if isinstance(method, MaximumLikelihood) else MaximumLikelihood()
    flat = _flatten(spectrum)
    repeats = [
        noise_from_residuals(model, _repeats(flat, slice(k, k + 1)), chosen)
        for k in range(len(flat.amplitudes))
    ]
    V = np.concatenate([repeat.covariance for repeat in repeats])
    dof = np.min([repeat.dof for repeat in repeats], axis=0)
    covariance = V.reshape(*spectrum.batch, *V.shape[1:])
    return replace(spectrum, covariance=covariance, noise=repeats[0].noise, dof=dof)


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


@dataclass(frozen=True)
class _Part:
    """What one chunk of repeats gave."""

    solution: Solution
    judged: Judged
    worth: Worth


def _noise_free(V: Complex) -> bool:
    return not np.any(V)


def _identify(model: Model, spectrum: Spectrum, method: Method) -> _Part:
    known = noise_is_known(spectrum) and not _noise_free(spectrum.covariance)
    if not known:
        nothing = np.full_like(spectrum.covariance, np.nan)
        spectrum = replace(spectrum, covariance=nothing, noise=("unknown",) * spectrum.lines)
    V = working_covariance(model, spectrum)
    V = V if V.ndim == 4 else V[None]
    correlate = channels_correlate(spectrum) if known else np.ones(len(V), dtype=bool)
    V = np.where(correlate[:, None, None, None], V, without_correlation(V))
    if not known and np.any(model.prior_precision):
        V = _sized_by_residuals(model, spectrum, method, V)
    data = _prepared(model, spectrum, V)
    solution = method.solve(data)
    best = _most_likely(data, solution, method)
    judged = judge(data, best, method.by_output or bool(len(model.nonlinear)))
    value = worth(data, best, judged, known, correlate, method.weighted)
    if len(solution.theta) == 1 and known and best is not solution:
        solution = replace(
            solution, warnings=(*solution.warnings, *_bias(judged.names, solution, best, value, method))
        )
    return _Part(solution, judged, value)


def _prepared(model: Model, spectrum: Spectrum, V: Complex) -> Prepared:
    return Prepared(model, spectrum, V, states_if_seen(model, spectrum, V))


def _sized_by_residuals(model: Model, spectrum: Spectrum, method: Method, V: Complex) -> Complex:
    """V scaled until χ² is its degrees of freedom: priors weigh against noise of the right size only."""
    exact = replace(model, elements=tuple(replace(element, sd=None) for element in model.elements))
    for trial in (exact, model, model):
        if not trial.unknowns:
            continue
        data = _prepared(trial, spectrum, V)
        solution = method.solve(data)
        best = _most_likely(data, solution, method)
        judged = judge(data, best, method.by_output)
        penalty = np.sum(judged.precision * (best.theta - judged.mean) ** 2, axis=-1)
        chi2 = np.sum(judged.cost, axis=-1) + penalty
        V = V * (np.maximum(chi2, ROUNDING) / max(judged.dof, 1))[:, None, None, None]
    return V


def _most_likely(data: Prepared, solution: Solution, method: Method) -> Solution:
    """The solution with the most likely parameters near it."""
    if method.efficient or method.by_output:
        return solution
    if len(data.model.nonlinear):
        return replace(solution, theta=MaximumLikelihood().solve(data).theta)
    return replace(solution, theta=likeliest(data, solution.theta))


def _bias(
    names: tuple[str, ...], solution: Solution, best: Solution, value: Worth, method: Method
) -> tuple[Notice, ...]:
    """A warning where an estimate lies further from the most likely one than its spread explains (Hausman 1978)."""
    sd = np.sqrt(np.maximum(np.diagonal(value.covariance[0]), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.where(sd > 0, np.abs(solution.theta[0] - best.theta[0]) / sd, 0.0)
    worst = int(np.argmax(np.nan_to_num(away)))
    if not away[worst] > BIASED:
        return ()
    text = (
        f"{method.name} is biased by the noise of these data: {names[worst]} lies {away[worst]:.3g} standard "
        "deviations from the maximum-likelihood value, which oiv gives"
    )
    return (Notice("biased", text, (names[worst],)),)


def _assemble(
    model: Model, method: Method, parts: list[_Part], batch: tuple[int, ...], spectrum: Spectrum
) -> Estimate:
    def join(pieces: list[Real]) -> Real:
        whole = np.concatenate(pieces)
        return whole.reshape((*batch, *whole.shape[1:]))

    theta = join([part.solution.theta for part in parts])
    covariance = join([part.worth.covariance for part in parts])
    noise = join([part.worth.noise for part in parts])
    single = not batch
    judged = parts[0].judged
    known_noise = noise_is_known(spectrum) and not _noise_free(spectrum.covariance)
    chi2, p = join([part.worth.chi2 for part in parts]), join([part.worth.p for part in parts])
    fit = Fit(chi2, judged.dof, p, known_noise)
    if single:
        require_determined(judged.names, theta, noise, dead_channels(model, spectrum))
    misfit = bool(np.any(fit.rejected))
    warnings = list(dict.fromkeys(w for part in parts for w in part.solution.warnings))
    if single:
        warnings += _warnings(model, theta, covariance, fit, known_noise) + reversed_phase(
            model, theta, noise
        )
        warnings += prior_conflict(model, theta, noise) if method.efficient or method.by_output else []
    limits = parts[0].solution.limits
    warnings += held(judged.names, theta, limits) if single and limits is not None else []
    warnings += _colour(spectrum) + _left_out(model, spectrum) + duplicated_lines(spectrum)
    m = len(model.unknowns)
    return Estimate(
        model=model.name,
        method=method.name,
        names=judged.names,
        units=judged.units,
        values=theta,
        covariance=covariance,
        noise_covariance=noise,
        bound_sd=join([_sd(part.worth.bound) for part in parts]),
        dof=join([part.worth.dof for part in parts]),
        lower=np.full(len(judged.names), -np.inf) if limits is None else limits.lower,
        upper=np.full(len(judged.names), np.inf) if limits is None else limits.upper,
        free_values=join([_free_values(part.solution) for part in parts]),
        basis="model misfit" if misfit else "sensor noise" if known_noise else "residuals",
        converged=np.concatenate([part.solution.converged for part in parts]).reshape(batch),
        iterations=np.concatenate([part.solution.iterations for part in parts]).reshape(batch),
        history=parts[0].solution.history,
        fit=fit,
        known=known_values(model),
        tied=tied_values(model),
        modes=_modes(model, theta[:m], covariance[:m, :m]) if single and model.n <= MODES_TO else None,
        signs={name: join([part.solution.signs[name] for part in parts]) for name in parts[0].solution.signs},
        warnings=tuple(warnings),
        notes=spectrum.notes,
    )


def _sd(covariance: Real) -> Real:
    """NaN where rounding has made a variance negative: the data do not determine that unknown."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def _free_values(solution: Solution) -> Real:
    return solution.theta if solution.limits is None else solution.limits.free


def require_determined(
    names: tuple[str, ...], theta: Real, covariance: Real, dead: Sequence[str] = ()
) -> None:
    """Raises IdentifiabilityError, which names `dead` channels, where an unknown has no finite interval."""
    variance = np.diagonal(covariance)
    if np.all(np.isfinite(theta)) and np.all(np.isfinite(variance)) and np.all(variance >= 0):
        return
    lost = [name for name, v in zip(names, variance, strict=True) if not np.isfinite(v)]
    if dead:
        raise IdentifiabilityError(
            f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}, for {', '.join(dead)} "
            f"show{'s' if len(dead) == 1 else ''} no motion at any line",
            cure="see whether the sensor is connected, or leave the channel out of the rig file",
        )
    raise IdentifiabilityError(
        f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}",
        cure="give one of them a value, add frequencies, or ask `dashpot check` which combinations can be found",
    )


def _warnings(model: Model, theta: Real, covariance: Real, fit: Fit, known_noise: bool) -> list[Notice]:
    notices = []
    if not known_noise:
        text = (
            "the noise of the amplitudes is not given: equal relative noise is assumed and its size taken from the "
            "residuals"
        )
        notices.append(Notice("unknown_noise", text))
    elif bool(fit.rejected):
        text = (
            f"the model does not fit: residuals are {float(fit.misfit):.3g} times the sensors' noise "
            f"(χ² {float(fit.chi2):.4g} with {fit.dof} degrees of freedom); intervals are widened by that factor"
        )
        notices.append(Notice("model_misfit", text))
    notices += wrong_signs(model, theta, covariance)
    lower, upper = model.bounds
    own = theta[: len(lower)]
    for j in np.flatnonzero((own < lower) | (own > upper)):
        name = model.unknowns[j].name
        text = f"{name} lies beyond its bounds; of all methods only ml keeps to them"
        notices.append(Notice("beyond_bound", text, (name,)))
    return notices


def nonlinear_names(model: Model) -> frozenset[str]:
    """Unknowns of nonlinear elements, whose parameters and constants may have any sign."""
    names = {e.name for e in model.elements if e.force_law is not None}
    return frozenset(names | {f"{e.name}.{c.name}" for e, c in model.constants})


def wrong_signs(model: Model, theta: Real, covariance: Real) -> list[Notice]:
    """Warnings of negative parts, and of free matrices that are not definite."""
    free = free_names(model)
    any_sign = nonlinear_names(model)
    sd = _sd(covariance)
    notices = []
    for j, (unknown, value) in enumerate(zip(model.unknowns, theta, strict=False)):
        if value < 0 and unknown.name not in free and unknown.name not in any_sign:
            within = value > -ZERO * sd[j]
            why = "0 is within its interval" if within else "the model or the data are wrong somewhere"
            text = f"{unknown.name} is negative ({value:.4g} {unknown.unit}): {why}"
            notices.append(Notice("negative_but_zero" if within else "negative", text, (unknown.name,)))
    if not free:
        return notices
    parts = matrices(model, model.parameters(theta[: len(model.unknowns)]))
    for letter in free_entries(model):
        values = np.linalg.eigvalsh(getattr(parts, letter))
        if values[0] < -1e-9 * values[-1]:
            text = (
                f"{letter} is not positive definite (eigenvalues from {values[0]:.3g} to {values[-1]:.3g}); "
                "the method oiv+ finds the most likely matrices that are"
            )
            notices.append(Notice("not_definite", text, (letter,)))
    return notices


def held(names: tuple[str, ...], theta: Real, limits: Limits) -> list[Notice]:
    """Warnings of unknowns that lie at a bound; one repeat."""
    at = (theta <= limits.lower) | (theta >= limits.upper)
    return [
        Notice(
            "at_bound", f"{name} is at its bound; without the bound {float(free):.4g} would fit best", (name,)
        )
        for name, bound, free in zip(names, at, limits.free[0], strict=True)
        if bound
    ]


def _colour(spectrum: Spectrum) -> list[Notice]:
    """What the tests of whiteness led to, where they failed at more lines than white noise explains."""
    coloured = sum(kind == "blocks" for kind in spectrum.noise)
    if not coloured or bdtrc(coloured - 1, spectrum.lines, FALSE_ALARMS) > FALSE_ALARMS * (1 + 1e-9):
        return []
    text = f"coloured noise at {coloured} of {spectrum.lines} frequencies; the intervals include it"
    return [Notice("coloured_noise", text)]


def _left_out(model: Model, spectrum: Spectrum) -> list[Notice]:
    """Inputs that some lines measure and others leave empty: there they are unknown, which costs precision."""
    measured = channels_present(spectrum)
    notices = []
    for name in (*model.displacement_inputs, *model.force_inputs):
        direct = [set(channel.of) == {name} and is_direct(model, channel) for channel in spectrum.channels]
        at = np.any(measured[:, direct], axis=-1)
        if np.any(at) and not np.all(at):
            text = (
                f"the input {name} is not measured at {np.sum(~at)} of {len(at)} lines and is unknown there, which "
                "widens the intervals; if it was at rest, write 0"
            )
            notices.append(Notice("input_not_measured", text, (name,)))
    return notices


def known_values(model: Model) -> tuple[tuple[str, float, str], ...]:
    unknown = {u.name for u in model.unknowns}
    inner = tuple(
        (f"{e.name}.{c.name}", float(c.value), model.constant_unit(e, c))
        for e, c in model.constants
        if not c.unknown and c.value is not None
    )
    return inner + tuple(
        (element.name, float(model.p0[i]), model.unit(element))
        for i, element in enumerate(model.elements)
        if element.name not in unknown and not np.any(model.T[i])
    )


def tied_values(model: Model) -> tuple[tuple[str, str, float, str], ...]:
    return tuple(
        (element.name, model.elements[tie.root].name, tie.times, model.unit(element))
        for element, tie, row in zip(model.elements, model.ties, model.T, strict=True)
        if element.same_as is not None and np.any(row)
    )


def _modes(model: Model, theta: Real, covariance: Real) -> ModeValues | None:
    """Modes of the linear elements; None where nonlinear ones hold the rig together."""
    if not len(model.nonlinear):
        return mode_values(model, theta, covariance)
    try:
        return mode_values(model, theta, covariance)
    except ModelError:
        return None


def mode_values(model: Model, theta: Real, covariance: Real) -> ModeValues:
    """Modes at θ with standard deviations of frequency and damping propagated from its covariance.

    NaN where a standard deviation is lost in the rounding of terms that are far larger.
    """
    found = modes(model, model.parameters(theta))
    slope = found.sensitivity @ model.T
    values = found.eigenvalues
    size = np.where(np.abs(values) > 0, np.abs(values), 1.0)
    grow = (np.conj(values)[:, None] * slope).real / size[:, None]
    frequency = grow / (2 * np.pi)
    damping = -slope.real / size[:, None] + values.real[:, None] * grow / size[:, None] ** 2

    def sd(jacobian: Real) -> Real:
        variance: Real = np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian)
        terms = np.einsum("ki,ij,kj->k", np.abs(jacobian), np.abs(covariance), np.abs(jacobian))
        lost = (variance <= LOST * terms) & (terms > 0)
        return np.sqrt(np.where(lost, np.nan, np.maximum(variance, 0.0)))

    return ModeValues(
        values, found.frequency_hz, found.damping_ratio, sd(frequency), sd(damping), found.shapes
    )
