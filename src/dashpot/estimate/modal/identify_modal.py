"""Physical parameters from measured eigenvalues and mode shapes with their uncertainty (Kuratani; THEORY §4).

Weighted nonlinear least squares on natural frequencies, damping ratios and shapes; the complex scale of each shape is
eliminated exactly (variable projection: Golub and Pereyra 1973, Kaufman 1975), so shapes of any scale will do.  Modes
are paired with those of the model by the modal assurance criterion and by frequency.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Ints, Real
from dashpot.data.modal_data import ModalData
from dashpot.errors import ConvergenceError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.inference.derived import known_values, mode_values, tied_values
from dashpot.estimate.inference.diagnostics import held, require_determined, wrong_signs
from dashpot.estimate.inference.uncertainty import MISFIT_LEVEL
from dashpot.estimate.likelihood.global_search import DOUBT, TIE
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.modal.mode_residuals import modal_misfit
from dashpot.estimate.modal.pairing import MeasuredModes, measured_modes, with_one_axis
from dashpot.estimate.modal.starting_values import guessed, like_parts, linear_start, random_rigs, usual_parts
from dashpot.estimate.result import MISFIT, SENSOR_NOISE, Estimate, Fit
from dashpot.io.words import with_values
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, minimise, without_bounds
from dashpot.numerics.small_systems import scaled_inverse

NAME = "modal"
ASTRAY = 1e-4  # χ² so unlikely may mean a local minimum: other starts are tried
STARTS = 32
LARGE = (
    8  # coordinates above which a rig of like parts that leads to a fit is taken, without a look for others
)
FAR = 1e5  # times the values of like parts and usual ones, beyond which an end is none
FOLLOWED = 10  # of the starts that have not settled after a few steps

Search = Callable[[Real, Ints, int], OptimizeResult]  # starts, the repeats they belong to, most steps


def identify_modal(model: Model, data: ModalData, *, starts: int = STARTS, seed: int = 0) -> Estimate:
    """Estimate the unknowns of `model` from measured modes; leading axes of the data are repeats.

    Where only some points are seen, several rigs may have the same modes: one of them is returned, and a warning
    names another.
    Large rigs start from like parts whose first frequency is that of the data; an end far outside their scale is none.
    The first start is linear least squares on (λ²M + λC + K) φ = 0 where every coordinate is seen, and the model's
    guesses where it has them all; where these are missing or end with an unlikely χ², `starts` random rigs whose
    frequencies are those of the data are tried.  Displacement inputs stand still: the modes are those with them held.
    Covariance and bound are the inverse of the information, widened by χ²/dof where χ² rejects the model.

    Raises DataError or UsageError where the data do not suit the rig, IdentifiabilityError where they do not determine
    the unknowns, ConvergenceError where no search ends near the scale of what is known, ModelError where all values
    that it ends in are 0.
    """
    _check(model, data)
    batch = data.frequency_hz.shape[:-1]
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    minima, ends = _deepest_minima(model, flat, view, starts, seed)
    return _estimate(model, flat, view, minima, ends, batch)


def _estimate(
    model: Model,
    data: ModalData,
    view: MeasuredModes,
    minima: OptimizeResult,
    ends: OptimizeResult | None,
    batch: tuple[int, ...],
) -> Estimate:
    """The deepest minima with their covariance and χ²; `ends` are those of all starts, where rivals are looked for."""
    m = len(model.unknowns)
    theta = minima.x
    at = modal_misfit(model, data, view, theta, np.arange(len(theta)))
    lower, upper = model.bounds
    free = without_bounds(theta, at, lower, upper)
    covariance = scaled_inverse(at.symmetric)
    chi2, dof = at.cost, view.dof(model)
    p: Real = np.asarray(chdtrc(float(dof), chi2)) if dof > 0 else np.full(len(chi2), np.nan)
    misfit = (p < MISFIT_LEVEL) & (chi2 > dof)
    widened = covariance * np.where(misfit, chi2 / max(dof, 1), 1.0)[:, None, None]
    fit = Fit(chi2.reshape(batch), dof, p.reshape(batch))
    warnings: tuple[Notice, ...] = ()
    if not batch:
        _require_regular(at.symmetric[0], model)
        require_determined(model.unknown_names, theta[0], covariance[0])
        warnings = _warnings(model, theta[0], widened[0], HeldBounds(lower, upper, free))
        warnings += () if ends is None else _rivals(model, minima, ends, np.sqrt(np.diagonal(covariance[0])))
    return Estimate(
        model=model.name,
        method=NAME,
        names=model.unknown_names,
        units=model.unknown_units,
        values=theta.reshape((*batch, m)),
        covariance=widened.reshape((*batch, m, m)),
        noise_covariance=covariance.reshape((*batch, m, m)),
        bound_sd=np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)).reshape((*batch, m)),
        dof=np.where(misfit[:, None], float(max(dof, 1)), np.inf).repeat(m, axis=1).reshape((*batch, m)),
        lower=lower,
        upper=upper,
        free_values=free.reshape((*batch, m)),
        basis=MISFIT if np.any(misfit) else SENSOR_NOISE,
        converged=minima.converged.reshape(batch),
        iterations=minima.iterations.reshape(batch),
        history=minima.history,
        fit=fit,
        known=known_values(model),
        tied=tied_values(model),
        modes=None if batch else mode_values(model, theta[0], widened[0]),
        signs={},
        warnings=warnings,
    )


def _check(model: Model, data: ModalData) -> None:
    model.require_unknowns()
    for name in data.points:
        if name not in model.coordinates:
            raise DataError(
                f"the shapes have a point {name}, which is not a coordinate of the rig",
                cure=f"there are {', '.join(model.coordinates)}",
            )
    if not np.any(model.p0) and not np.any(model.prior_precision):
        raise IdentifiabilityError(
            "modes alone do not fix the size of masses and stiffnesses: all of them times any factor have the same",
            cure="give one mass or stiffness a value",
        )
    if data.modes > model.n:
        raise DataError(
            f"{data.modes} modes are measured, and the rig has no more than {model.n} that oscillate",
            cure="leave modes out, or give the rig more coordinates",
        )


def _warnings(model: Model, theta: Real, covariance: Real, limits: HeldBounds) -> tuple[Notice, ...]:
    return (*wrong_signs(model, theta, covariance), *held(model.unknown_names, theta, limits))


def _require_regular(symmetric: Real, model: Model) -> None:
    scale = np.sqrt(np.diagonal(symmetric))
    blind = [u.name for u, s in zip(model.unknowns, scale, strict=True) if not s > 0]
    if not blind:
        values, vectors = np.linalg.eigh(symmetric / np.outer(scale, scale))
        if values[0] > 1e-12:
            return
        weak = np.abs(vectors[:, 0])
        blind = [u.name for u, w in zip(model.unknowns, weak, strict=True) if w > 0.1 * np.max(weak)]
    raise IdentifiabilityError(
        f"the modes do not determine {', '.join(blind)}",
        cure=f"{with_values(blind)}, measure more modes, or more points of their shapes",
    )


# The search


def _search_near(model: Model, data: ModalData, view: MeasuredModes) -> Search:
    """Minimises χ².

    An end far outside the scale of everything known is none: nothing that is measured depends on it there.
    """
    lower, upper = model.bounds
    largest = FAR * np.maximum(np.abs(like_parts(model, data)), np.abs(usual_parts(model, data)))

    def search(start: Real, rows: Ints, limit: int) -> OptimizeResult:
        ends = minimise(
            lambda theta, some: modal_misfit(model, data, view, theta, rows[some]),
            start, limit=limit, tolerance=1e-6, lower=lower, upper=upper,
        )  # fmt: skip
        lost = np.any(np.abs(ends.x) > largest, axis=-1)
        return replace(ends, cost=np.where(lost, np.inf, ends.cost), converged=ends.converged & ~lost)

    return search


def _deepest_minima(
    model: Model, data: ModalData, view: MeasuredModes, starts: int, seed: int
) -> tuple[OptimizeResult, OptimizeResult | None]:
    """The deepest minima, and for one repeat without a start of its own where all of its starts ended."""
    repeats = len(data.frequency_hz)
    everyone = np.arange(repeats)
    search = _search_near(model, data, view)
    minima, ends = None, None
    firsts = [linear_start(model, data, view), guessed(model, repeats)]
    if model.n > LARGE:
        firsts.append(np.tile(like_parts(model, data), (repeats, 1)))
    for first in firsts:
        if first is None:
            continue
        reached = search(first, everyone, 100)
        minima = reached if minima is None else minima.improved(everyone, reached)
    lonely = minima is None and repeats == 1
    for attempt in range(2):
        astray = everyone if minima is None else _astray(minima, view.rows - len(model.unknowns))
        if not len(astray) or not starts:
            break
        drawn = random_rigs(model, data, starts, np.random.default_rng([seed, attempt]))
        if not attempt:
            drawn = np.concatenate([like_parts(model, data)[None], drawn])
        if lonely:
            ends = _ends(search, drawn)
            reached = _one_of(model, ends)
        else:
            reached = _deepest(search, drawn, astray)
        minima = reached if minima is None else minima.improved(astray, reached)
    if minima is None:
        raise UsageError(
            "there is no start for the search", cure="give the unknowns a guess, or allow starts"
        )
    if not np.any(np.isfinite(minima.cost)):
        raise ConvergenceError(
            "no start leads to a rig with these modes: the searches end far outside the scale of what is known",
            cure="give the unknowns a guess, measure more modes, or more points of their shapes",
        )
    return minima, ends


def searched_from(model: Model, data: ModalData, starts: Real) -> OptimizeResult:
    """The deepest end, the one row of it, of searches from the linear start and from `starts` (K, unknowns).

    `data` has no batch axes.  Raises as `identify_modal` where the data do not suit the rig.
    """
    _check(model, data)
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    linear = linear_start(model, flat, view)
    firsts = starts if linear is None else np.concatenate([starts, linear])
    return _deepest(_search_near(model, flat, view), firsts, np.zeros(1, dtype=np.int64))


def _astray(minima: OptimizeResult, dof: int) -> Ints:
    """The repeats that have not settled, or settled where χ² is unlikely."""
    cost = np.where(np.isfinite(minima.cost), minima.cost, np.inf)
    tail = np.asarray(chdtrc(float(max(dof, 1)), cost))
    return np.flatnonzero(~minima.converged | ~np.isfinite(minima.cost) | (tail < ASTRAY))


def _ends(search: Search, drawn: Real) -> OptimizeResult:
    """Where all starts of the one repeat end; the deepest of those that are still on their way are followed."""
    ends = search(drawn, np.zeros(len(drawn), dtype=np.int64), 25)
    on_the_way = np.flatnonzero(~ends.converged & np.isfinite(ends.cost))
    deepest = on_the_way[np.argsort(ends.cost[on_the_way])[:FOLLOWED]]
    if not len(deepest):
        return ends
    return ends.improved(deepest, search(ends.x[deepest], np.zeros_like(deepest), 100))


def _deepest(search: Search, drawn: Real, rows: Ints) -> OptimizeResult:
    """For each of the rows, all starts for a few steps, which tell the valleys apart; the deepest to its end."""
    starts = len(drawn)
    short = search(np.tile(drawn, (len(rows), 1)), np.repeat(rows, starts), 25)
    cost = np.where(np.isfinite(short.cost), short.cost, np.inf).reshape(len(rows), starts)
    best = np.argmin(cost, axis=1)
    return search(short.x.reshape(len(rows), starts, -1)[np.arange(len(rows)), best], rows, 100)


def _one_of(model: Model, ends: OptimizeResult) -> OptimizeResult:
    """The deepest of the ends; of those that fit alike to TIE, one without negative parts, and of like parts."""
    cost = np.where(np.isfinite(ends.cost), ends.cost, np.inf)
    if np.any(ends.converged & np.isfinite(cost)):
        cost = np.where(ends.converged, cost, np.inf)
    alike = cost <= np.min(cost) + TIE
    sound = alike & np.all(ends.x > 0, axis=-1)
    if np.any(sound):
        logs = np.log(np.where(sound[:, None], ends.x, 1.0))
        units = np.array(model.unknown_units)
        spread = np.sum([np.ptp(logs[:, units == unit], axis=-1) for unit in dict.fromkeys(units)], axis=0)
        at = [int(np.argmin(np.where(sound, spread, np.inf)))]
    else:
        at = [int(np.argmin(cost))]
    return OptimizeResult(ends.x[at], ends.cost[at], ends.converged[at], ends.iterations[at], ends.x[at])


def _rivals(model: Model, minima: OptimizeResult, ends: OptimizeResult, sd: Real) -> tuple[Notice, ...]:
    """A warning where other ends fit nearly as well: frequencies alone have several rigs."""
    best = minima.x[0]
    near = ends.converged & (ends.cost <= minima.cost[0] + DOUBT)
    if np.all(best >= 0):
        near &= np.all(ends.x >= 0, axis=-1)
    others: list[Real] = []
    above: list[float] = []
    for k in np.argsort(ends.cost):
        if near[k] and all(np.any(np.abs(ends.x[k] - other) > 3 * sd) for other in (best, *others)):
            others.append(ends.x[k])
            above.append(float(ends.cost[k] - minima.cost[0]))
    if not others:
        return ()
    away = np.abs(others[0] - best)
    largest = np.argsort(-away / np.maximum(np.abs(best), np.abs(others[0])))[:4]
    values = ", ".join(
        f"{model.unknowns[j].name} = {others[0][j]:.4g} {model.unknowns[j].unit}" for j in largest
    )
    more = len(others) - 1
    many = f" ({more} more set{'' if more == 1 else 's'} of values likewise)" if more else ""
    worse = f"almost as well (χ² is {above[0]:.3g} larger)" if above[0] > TIE else "equally well"
    text = (
        f"not unique: {values} fits {worse}{many}; measure shapes at more points, fix a parameter or give a guess "
        "of every unknown"
    )
    return (Notice("not_unique", text, tuple(model.unknowns[j].name for j in largest)),)
