"""One verb: identify(model, spectrum, method) → Estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from dashpot.arrays import Real, frozen
from dashpot.data.repeats import flattened, in_chunks
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.estimate.inference.derived import known_values, linear_modes, tied_values
from dashpot.estimate.inference.free_motion import modes_unseen
from dashpot.estimate.inference.notices import notices
from dashpot.estimate.inference.time_course import time_change_notices
from dashpot.estimate.inference.uncertainty import Inference, inference, with_noise_of_residuals
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.residual_noise import with_residual_noise
from dashpot.estimate.likelihood.settling import with_settling_decided
from dashpot.estimate.method import Method, Solution, require_suited
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.preparation.state_reconstruction import unseen
from dashpot.estimate.registry import AUTOMATIC, method_class
from dashpot.estimate.registry import method as method_named
from dashpot.estimate.result import MISFIT, RESIDUALS, SENSOR_NOISE, Estimate, Fit
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.numerics.small_systems import standard_deviations

CHUNK = 2_000_000  # complex numbers of amplitudes at once: keeps the working set of a batch near 1 GB


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
    model.require_unknowns()
    if spectrum.lines == 0:
        raise DataError("there are no lines in the data", cure="give at least one frequency")
    if isinstance(method, str):
        method = method_named(method)
    spectrum = with_settling_decided(model, spectrum, method)
    chosen = automatic(model, spectrum) if method is None else method
    _require_able(model, spectrum, chosen)
    spectrum, chosen = with_residual_noise(model, spectrum, chosen)
    flat = flattened(spectrum)
    repeats = len(flat.amplitudes)
    size = max(1, CHUNK // (flat.lines * (model.n + 1) * (len(model.elements) + len(flat.channels))))
    parts: list[Inference] = []
    for part in in_chunks(flat, size):
        parts.append(_identified(model, part, chosen))
        if progress is not None:
            progress(min(len(parts) * size, repeats), repeats)
    return _estimate(model, chosen, parts, spectrum.batch, flat)


def automatic(model: Model, spectrum: Spectrum, *, bounded: bool = False) -> Method:
    """The first method of AUTOMATIC that suits: oiv where calibrated channels see every coordinate and input, else ml.

    Where unknowns have bounds, or are to have some (`bounded`), it must be one that holds them; where there are whole
    records, one that knows their transients; where there are nonlinear elements, one that is efficient for them.
    """
    view = observation_model(model, spectrum.channels, spectrum.omega)
    bounded = bounded or bool(np.any(np.isfinite(model.bounds)))
    by_output = not view.is_direct.all() or bool(unseen(view, spectrum))
    transients = spectrum.carries_loads
    for name in AUTOMATIC:
        traits = method_class(name).traits
        asked = (
            (by_output, traits.by_output), (bounded, traits.bounds), (transients, traits.transients),
            (bool(len(model.nonlinear)), traits.nonlinear and traits.maximum_likelihood and traits.by_output),
        )  # fmt: skip
        if all(able or not wanted for wanted, able in asked):
            break
    return method_named(name)


def _require_able(model: Model, spectrum: Spectrum, method: Method) -> None:
    """Raises UsageError where the method does not know the rig's elements or the data's transients."""
    if len(model.nonlinear) and not method.traits.nonlinear:
        raise UsageError(
            f"the method {method.name} cannot handle nonlinear elements",
            cure="use the method ml, oiv, iv, wls, ls or hls",
        )
    if spectrum.carries_loads and len(model.nonlinear):
        raise UsageError(
            "transients of whole records can be estimated for linear rigs only",
            cure="give settled dwells with their frequencies, or leave the nonlinear elements out",
        )
    if spectrum.carries_loads and not method.traits.transients:
        raise UsageError(
            f"the method {method.name} works on settled lines; whole records carry transients",
            cure="use the method ml, or give settled dwells with their frequencies",
        )


def _identified(model: Model, spectrum: Spectrum, method: Method) -> Inference:
    """Prepare, solve, infer: one chunk of repeats."""
    # A search that has its start needs no look at all coordinates together, which costs more than the search.
    begun = isinstance(method, MaximumLikelihood) and bool(method.start)
    data = prepare(model, spectrum, moments=bool(method.traits.moments), states=not begun)
    require_suited(method, data)
    if not data.noise_known and np.any(model.prior_precision):
        data = with_noise_of_residuals(data, method)
    part = inference(data, method.solve(data), method)
    if not spectrum.records:
        return part
    solution = part.solution
    warnings = (*solution.warnings, *time_change_notices(data, solution), *modes_unseen(data, solution))
    return replace(part, solution=replace(solution, warnings=warnings))


def _estimate(
    model: Model, method: Method, parts: list[Inference], batch: tuple[int, ...], spectrum: Spectrum
) -> Estimate:
    """The Estimate of all chunks together."""

    def join(piece: Callable[[Inference], Any]) -> Any:
        whole = piece(parts[0]) if len(parts) == 1 else np.concatenate([piece(part) for part in parts])
        return whole.reshape((*batch, *whole.shape[1:]))

    some = parts[0]
    first = some.solution
    theta, covariance = join(lambda part: part.solution.theta), join(lambda part: part.uncertainty.covariance)
    chi2, p = join(lambda part: part.uncertainty.chi2), join(lambda part: part.uncertainty.p)
    fit = Fit(chi2, some.dof, p, spectrum.noise_known)
    m = len(model.unknowns)
    lower, upper = _bounds(first, len(some.names))
    warnings = dict.fromkeys(notice for part in parts for notice in part.solution.warnings)
    bands = [part.uncertainty.bands for part in parts if part.uncertainty.bands is not None]
    shown = notices(model, spectrum, None if batch else parts[0], fit)
    return Estimate(
        model=model.name,
        method=method.name,
        names=some.names,
        units=some.units,
        values=theta,
        covariance=covariance,
        noise_covariance=join(lambda part: part.uncertainty.noise),
        bound_sd=standard_deviations(join(lambda part: part.uncertainty.bound)),
        dof=join(lambda part: part.uncertainty.dof),
        lower=lower,
        upper=upper,
        free_values=join(lambda part: _free_values(part.solution)),
        basis=_basis(fit, any(np.any(each.disagree) for each in bands)),
        converged=join(lambda part: part.solution.converged),
        iterations=join(lambda part: part.solution.iterations),
        history=first.history,
        fit=fit,
        known=known_values(model),
        tied=tied_values(model),
        modes=None if batch else linear_modes(model, theta[:m], covariance[:m, :m]),
        signs={name: join(_sign_of(name)) for name in first.signs},
        warnings=(*warnings, *shown),
        notes=spectrum.notes,
    )


def _bounds(solution: Solution, unknowns: int) -> tuple[Real, Real]:
    """What the estimates were held to, (unknowns,) each."""
    if solution.bounds is None:
        return _no_bounds(unknowns)
    return np.full(unknowns, solution.bounds.lower), np.full(unknowns, solution.bounds.upper)


@cache
def _no_bounds(unknowns: int) -> tuple[Real, Real]:
    endless = np.full(unknowns, np.inf)
    return frozen(-endless, np.float64), frozen(endless, np.float64)


def _sign_of(channel: str) -> Callable[[Inference], Real]:
    """The sign that a chunk has for the channel."""
    return lambda part: part.solution.signs[channel]


def _free_values(solution: Solution) -> Real:
    """The estimates as they would be without bounds."""
    return solution.theta if solution.bounds is None else solution.bounds.free


def _basis(fit: Fit, bands_disagree: bool) -> str:
    """What the intervals rest on."""
    if fit.rejected.any() or bands_disagree:
        return MISFIT
    return SENSOR_NOISE if fit.known_noise else RESIDUALS
