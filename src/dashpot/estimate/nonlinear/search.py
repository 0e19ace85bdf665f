"""The maximum of the likelihood of measured harmonics: starts, branches and the number of harmonics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ConvergenceError
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.nonlinear.dwells import WarmStart
from dashpot.estimate.nonlinear.objective import NonlinearPart, measured_part, predict_harmonics
from dashpot.estimate.nonlinear.starting_values import KEPT, starting_points
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.nonlinear.harmonic_balance import periodic_response, truncation
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.observation import ObservationModel
from dashpot.numerics.levenberg_marquardt import OptimizeResult

if TYPE_CHECKING:
    from dashpot.estimate.likelihood.chunks import Measured
    from dashpot.estimate.likelihood.descent import Likelihood

Descent = Callable[
    ["Measured", Real, Real, int | None], OptimizeResult
]  # data, ψ, signs and a limit of iterations

SOFTNESS = (0.3, 0.03)  # relative noise of the stages from afar
PIECE = 16  # points evaluated at once
FIRST = 30  # iterations from each of the starts
FINEST, COARSEST = 1e-6, 1e-3  # truncation errors of the elongations between which harmonics are enough
SHARE = 0.1  # of the relative noise
MOST = 63  # harmonics


def search_harmonics(likelihood: Likelihood) -> tuple[OptimizeResult, Measured]:
    """The best end of all repeats, and the data with as many harmonics as it needs.

    Raises ConvergenceError where no start leads to a response at all.
    """
    data, view, exact = likelihood.data, likelihood.view, likelihood.exact
    descend = likelihood.descend_in
    one = data.only(0)
    first = exact.pick(np.array([0]))
    signs = np.ones((1, len(view.channels)))
    ends = list[OptimizeResult]()
    acceptable = first.rows + 6 * np.sqrt(2.0 * first.rows)
    stages = [*(measured(one, softness) for softness in SOFTNESS), first]
    for psi in _ranked(one, stages, descend):
        end = descend(_fresh(first), psi[None], signs, FIRST)
        if np.isfinite(end.cost[0]):
            ends.append(end)
        if end.converged[0] and end.cost[0] <= acceptable:
            break
    if not ends:
        raise ConvergenceError(
            "harmonic balance finds no response near the start", cure="give guesses of the unknowns"
        )
    best = min(ends, key=lambda end: float(end.cost[0]))
    start = np.repeat(best.x, len(exact.y), axis=0)
    sign = np.repeat(signs, len(exact.y), axis=0)
    exact = _fresh(exact)
    found = descend(exact, start, sign, None)
    while True:
        part = measured_part(exact)
        if _missing(view, part, exact, found.x, sign) <= _allowed(data) or part.dwells.orders >= MOST:
            return found, exact
        exact = _with_orders(data, exact, min(2 * part.dwells.orders + 1, MOST))
        found = descend(exact, found.x, sign, None)


def _allowed(data: Prepared) -> float:
    """Truncation error that hides in the noise of the best line."""
    variance = np.diagonal(data.covariance, axis1=-2, axis2=-1).real
    power = np.abs(np.nan_to_num(data.spectrum.amplitudes)) ** 2
    noisy = (variance > 0) & (power > 0)
    if not np.any(noisy):
        return FINEST
    best = float(np.min(np.sqrt(np.broadcast_to(variance, power.shape)[noisy] / power[noisy])))
    return float(np.clip(SHARE * best, FINEST, COARSEST))


def _fresh(exact: Measured) -> Measured:
    """The same data without memory of earlier responses."""
    return replace(exact, nonlinear=replace(measured_part(exact), warm=WarmStart()))


def _with_orders(data: Prepared, exact: Measured, orders: int) -> Measured:
    part = measured_part(exact)
    start = part.start
    if start is not None:
        wider = np.zeros((*start.shape[:-1], 2 * orders + 1))
        wider[..., : start.shape[-1]] = start
        start = wider
    wide = replace(part, dwells=part.dwells.with_orders(orders), start=start, warm=WarmStart())
    return replace(exact, nonlinear=wide)


def _ranked(one: Prepared, stages: Sequence[Measured], descend: Descent) -> Iterator[Real]:
    """Starting points, the most promising first: where all is seen those of the regression, then those from afar.

    From afar they go through softened data, in which valleys are wide, before they are ranked.  A regression of laws
    without unknown constants leaves no other valley to look for, and laws with a state take minutes from afar.
    """
    view = one.view
    if one.states is not None:
        points = starting_points(one)
        yield from points[np.argsort(_costs(view, stages[-1], points))]
        laws = [element.force_law for element, constant in one.model.constants if constant.unknown]
        if not laws or any(law is not None and law.has_state for law in laws):
            return
    points = starting_points(one, afar=True)
    if len(points) > 1:
        signs = np.ones((1, len(view.channels)))
        for stage, kept in zip(stages[:-1], (KEPT, KEPT // 2), strict=True):
            points = points[np.argsort(_costs(view, stage, points))[:kept]]
            points = np.array([descend(_fresh(stage), psi[None], signs, FIRST).x[0] for psi in points])
    yield from points[np.argsort(_costs(view, stages[-1], points))]


def _costs(view: ObservationModel, data: Measured, points: Real) -> Real:
    """−2 ln(likelihood) at many points of one repeat, inf where there is no response."""
    pieces = []
    for first in range(0, len(points), PIECE):
        psi = points[first : first + PIECE]
        data = _fresh(data)
        with np.errstate(all="ignore"):
            cost = predict_harmonics(
                view, data, measured_part(data), psi, np.ones((len(psi), len(view.channels)))
            )[5]
        pieces.append(np.sum(cost, axis=-1))
    total = np.concatenate(pieces)
    return np.where(np.isfinite(total), total, np.inf)


def _missing(view: ObservationModel, part: NonlinearPart, exact: Measured, psi: Real, sign: Real) -> float:
    """Largest truncation error of the responses at ψ, of the first repeat."""
    q = part.q if exact.q is None else exact.q
    theta = psi[:1, : view.m]
    R = len(part.dwells.omega)
    p = np.repeat(view.model.parameters(theta), R, axis=0)
    constants = np.repeat(view.model.inner_constants(theta), R, axis=0)
    drive: Drive = part.dwells.drive(q[:1], view.model.D.shape[1])
    start = part.warm.delta.get(0)
    at = periodic_response(view.model, p, constants, drive, start)
    error = truncation(view.model, p, constants, drive, at)
    return float(np.max(np.where(at.converged, error, 0.0), initial=0.0))
