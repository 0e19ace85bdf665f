"""The search among rigs for those that have measured modes: from the equation of motion, guesses, or drawn rigs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Ints, Real
from dashpot.data.modal_data import ModalData
from dashpot.errors import ConvergenceError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.likelihood.global_search import TIE
from dashpot.estimate.likelihood.local_minima import COMPETING
from dashpot.estimate.modal.mode_residuals import modal_misfit
from dashpot.estimate.modal.pairing import MeasuredModes, measured_modes, with_one_axis
from dashpot.estimate.modal.starting_values import guessed, like_parts, linear_start, random_rigs, usual_parts
from dashpot.model.network import Model
from dashpot.numerics.levenberg_marquardt import OptimizeResult, minimise

ASTRAY = 1e-4  # χ² so unlikely may mean a local minimum: other starts are tried
STARTS = 32
LARGE = (
    8  # coordinates above which a rig of like parts that leads to a fit is taken without a look for others
)
FAR = 1e5  # times the values of like parts and usual ones, beyond which an end is none
FOLLOWED = 10  # of the starts that have not settled after a few steps

Search = Callable[[Real, Ints, int], OptimizeResult]  # starts, the repeats they belong to, most steps


def check_suited(model: Model, data: ModalData) -> None:
    """Raises DataError where modes do not suit the rig, IdentifiabilityError where nothing fixes its size."""
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


def deepest_minima(
    model: Model, data: ModalData, view: MeasuredModes, starts: int, seed: int
) -> tuple[OptimizeResult, OptimizeResult | None]:
    """The deepest minima, and for one repeat without a start of its own where all of its starts ended.

    Raises UsageError without any start, ConvergenceError where none ends near the scale of what is known.
    """
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
    check_suited(model, data)
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    linear = linear_start(model, flat, view)
    firsts = starts if linear is None else np.concatenate([starts, linear])
    return _deepest(_search_near(model, flat, view), firsts, np.zeros(1, dtype=np.int64))


def rigs_with(model: Model, data: ModalData, *, seed: int = 0) -> Real:
    """Rigs that have these modes, (rigs, unknowns), the nearest first: several where not every point is seen.

    `data` has no batch axes.  Raises as `identify_modal`.
    """
    check_suited(model, data)
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    starts = STARTS if linear_start(model, flat, view) is None else 0
    minima, ends = deepest_minima(model, flat, view, starts, seed)
    if ends is None:
        return minima.x
    near = np.flatnonzero(ends.cost <= minima.cost[0] + COMPETING)
    nearest: Real = np.concatenate([minima.x, ends.x[near[np.argsort(ends.cost[near])]]])
    return nearest


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
