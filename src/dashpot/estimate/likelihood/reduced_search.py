"""The search of large rigs: on the span of few motions, which are computed anew where each search ends (THEORY §10).

Responses and adjoints at some lines span a reduced rig that is exact at those lines and parameters, with its slopes.
All of the search that a small rig gets runs there; its end gives new motions, until it stays where they were computed.
What has been left out of the basis, lines between those of the basis, the full rig checks at the end.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.likelihood.descent import Likelihood
from dashpot.estimate.likelihood.global_search import from_minima, global_minima
from dashpot.estimate.likelihood.objective import per_line
from dashpot.estimate.likelihood.starting_values import candidates
from dashpot.model.observation import ObservationModel
from dashpot.model.reduced import extended_basis, line_motions, reduced
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult
from dashpot.numerics.small_systems import solve_scaled

FROM = 400  # coordinates from which the search is on a basis
MOST_UNKNOWNS = 100  # each has a projected matrix of its own
LINES = 20  # at which motions are computed
WIDEST = 260  # columns of the basis; beyond it only the last motions are kept
REFRESHES = 25  # at most
STILL = 1e-4  # standard deviations within which the end of a search is where its motions were computed
ROUNDING = 1e-9  # of a value
NEAR = 0.05  # standard deviations that lines outside the basis may move the end by


def is_reducible(likelihood: Likelihood) -> bool:
    """Whether a rig is large enough for a basis to pay, and nothing stands in its way."""
    model, exact = likelihood.view.model, likelihood.exact
    plain = exact.ends is None and exact.nonlinear is None and likelihood.repeats == 1
    return model.n >= FROM and plain and likelihood.view.m <= MOST_UNKNOWNS


def reduced_search(
    likelihood: Likelihood,
) -> tuple[Likelihood, OptimizeResult, Real, tuple[Notice, ...]]:
    """The minimum of one repeat of a large rig, with the likelihood on the basis there.

    Returns that likelihood, the minimum, the signs of its channels (1, channels), and a notice where it is not unique.

    Raises ConvergenceError where no start leads to a minimum.
    """
    view = likelihood.view
    psi, sign = candidates(likelihood.data, 1, np.random.default_rng(likelihood.effort.seed))
    lines = _spread(view.omega)
    V = np.zeros((view.model.n, 0))
    minima, notices, history, settled = None, tuple[Notice, ...](), [psi[0]], False
    iterations = np.zeros(1, dtype=np.int64)
    for _ in range(REFRESHES):
        V = _basis(V, view, psi[0], lines)
        on_basis = likelihood.on_basis(reduced(view, V))
        if minima is None:
            minima, sign, notices = from_minima(on_basis, global_minima(on_basis, 0))
        else:
            minima = on_basis.descend(psi, sign)
        iterations += minima.iterations
        history.append(minima.x[0])
        still = _steps(minima.x - psi, on_basis, minima.x, sign) < STILL
        psi = minima.x
        if still:
            more = _left_out(likelihood, on_basis, lines, psi, sign)
            settled = not len(more)
            if settled:
                break
            lines = np.union1d(lines, more)
    assert minima is not None
    converged = minima.converged & settled
    whole = OptimizeResult(psi, minima.cost, converged, iterations, np.array(history))
    return on_basis, whole, sign, notices


def _spread(omega: Real) -> Ints:
    """Lines for the basis: all of few, else LINES of them, spread evenly over the sorted frequencies."""
    order = np.argsort(omega, kind="stable")
    if len(order) <= LINES:
        return np.sort(order)
    return np.sort(order[np.unique(np.linspace(0, len(order) - 1, LINES).astype(int))])


def _basis(V: Real, view: ObservationModel, psi: Real, lines: Ints) -> Real:
    """The basis with the motions at ψ; where it would grow too wide, they take its place."""
    p = view.model.parameters(psi[: view.m])
    motions = np.concatenate([line_motions(view, p, int(line)) for line in lines], axis=1)
    wider = extended_basis(V, motions)
    return wider if wider.shape[1] <= WIDEST or not V.shape[1] else extended_basis(V[:, :0], motions)


def _steps(step: Real, likelihood: Likelihood, psi: Real, sign: Real) -> float:
    """A step (1, M) in standard deviations, the largest; steps within rounding of the value count as none."""
    around = likelihood.model_at(psi, sign)
    rounding = np.abs(step[0]) <= ROUNDING * np.abs(psi[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.where(rounding, 0.0, np.abs(step[0]) / around.sd[0])
    return float(np.max(np.nan_to_num(sizes, nan=np.inf)))


def _left_out(likelihood: Likelihood, on_basis: Likelihood, lines: Ints, psi: Real, sign: Real) -> Ints:
    """Lines that belong into the basis: those at which the full rig differs most, where it would move the end."""
    if len(lines) == len(likelihood.view.omega):
        return np.zeros(0, dtype=np.int64)
    information, scores, cost = per_line(likelihood.view, likelihood.exact, psi, sign)
    _, near, near_cost = per_line(on_basis.view, on_basis.exact, psi, sign)
    change = np.sum(scores - near, axis=-2)
    step = solve_scaled(np.sum(information, axis=-3), change)
    if _steps(step, on_basis, psi, sign) < NEAR:
        return np.zeros(0, dtype=np.int64)
    worst = np.argsort(-np.abs(cost - near_cost)[0])
    fresh = worst[~np.isin(worst, lines)]
    return np.asarray(fresh[: LINES // 2], dtype=np.int64)
