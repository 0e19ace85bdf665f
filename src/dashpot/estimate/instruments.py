"""Instrumental variables: the paper's bootstrap (eq. 17-20) and the optimally weighted, refined form (THEORY §4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.errors import UsageError
from dashpot.estimate.auxiliary import Auxiliary, auxiliary, information, normal_equations
from dashpot.estimate.least_squares import compensated, sandwich, solve_sums
from dashpot.estimate.method import Method, Prepared, Solution
from dashpot.estimate.regression import inverse, solve_scaled
from dashpot.estimate.samples import Sampled, least_squares_sums, sampled, sums_with_harmonics
from dashpot.estimate.states import States
from dashpot.model.dynamics import response, unit_forces
from dashpot.model.network import Model


@dataclass(frozen=True)
class InstrumentalVariables(Method):
    """The paper's bootstrap: instruments from the auxiliary model, unweighted, from least squares (eq. 17-20).

    Stops when no unknown moves by more than `tolerance` of its size.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    name: ClassVar[str] = "iv"

    def solve(self, data: Prepared) -> Solution:
        """θ from (G) with instruments from the response of the auxiliary model."""
        looks = sampled(data)
        N, r = least_squares_sums(looks)
        theta = solve_sums(looks, N, r)

        def step(theta: Real, rows: Ints) -> Real:
            part = looks.rows(rows)
            N, r = sums_with_harmonics(part, instruments(part, theta))
            return solve_sums(part, N, r, theta)

        theta, converged, iterations, history = fixed_point(step, theta, self.tolerance, self.max_iterations)
        w = instruments(looks, theta)
        N, _ = sums_with_harmonics(looks, w)
        return Solution(theta, sandwich(looks, N, w, theta), converged, iterations, history)


def instruments(looks: Sampled, theta: Real) -> Complex:
    """w_i of eq. 18-19, amplitudes (K, lines, elements): unit forces of the auxiliary model's response."""
    model = looks.model
    X = response(model, model.parameters(theta), looks.omega, looks.U, looks.f)
    return unit_forces(model, looks.omega, X, looks.U)


def fixed_point(
    step: Callable[[Real, Ints], Real], theta: Real, tolerance: float, limit: int
) -> tuple[Real, Bools, Ints, Real]:
    """Repeat θ ← step(θ) for all repeats until each stands still; (θ, converged, iterations, history of the first)."""
    theta = theta.copy()
    converged = np.zeros(len(theta), dtype=bool)
    iterations = np.zeros(len(theta), dtype=np.int64)
    history = [theta[0].copy()]
    active = np.flatnonzero(np.all(np.isfinite(theta), axis=-1))
    for _ in range(limit):
        if not len(active):
            break
        new = step(theta[active], active)
        moved = np.max(np.abs(new - theta[active]) / np.maximum(np.abs(new), 1e-300), axis=-1)
        theta[active] = new
        iterations[active] += 1
        if active[0] == 0:
            history.append(new[0].copy())
        converged[active[moved <= tolerance]] = True
        active = active[(moved > tolerance) & np.all(np.isfinite(new), axis=-1)]
    return theta, converged, iterations, np.array(history)


@dataclass(frozen=True)
class OptimalIV(Method):
    """Optimally weighted, refined instrumental variables: Ω = (H Σ Hᴴ)⁻¹ and instruments follow θ̂.

    Its fixed point is the maximum of the likelihood where all coordinates are seen, so it sits on the Cramér-Rao
    bound.  A step that does not lower Σ eᴴ Ω e is replaced by damped Gauss-Newton steps, which do.
    """

    max_iterations: int = 200
    tolerance: float = 1e-9
    name: ClassVar[str] = "oiv"
    weighted: ClassVar[bool] = True

    def solve(self, data: Prepared) -> Solution:
        """θ at the minimum of Σ eᴴ Ω(θ) e with the priors' rows."""
        if data.states is None:
            raise UsageError("oiv needs every coordinate and input", cure="use the method ml")
        model, states = data.model, data.states
        start = compensated(model, states)
        search = _Search(model, states, start)
        search.run(self.max_iterations, self.tolerance)
        at = auxiliary(model, model.parameters(search.theta), states)
        lines = information(model, at)
        bread = inverse(np.sum(lines, axis=-3) + np.diag(model.prior_precision))
        return Solution(search.theta, bread, search.converged, search.iterations, np.array(search.history))


class _Search:
    """Refined instrumental variables for all repeats at once, guarded by Levenberg-Marquardt on the same cost."""

    def __init__(self, model: Model, states: States, theta: Real) -> None:
        self.model, self.states = model, states
        self.theta = theta.copy()
        self.converged = np.zeros(len(theta), dtype=bool)
        self.iterations = np.zeros(len(theta), dtype=np.int64)
        self.history = [theta[0].copy()]

    def _rows(self, rows: Ints) -> States:
        s = self.states
        covariance = s.covariance if len(s.covariance) == 1 else s.covariance[rows]
        looks = s.looks if len(s.looks) == 1 else s.looks[rows]
        return States(s.omega, s.z[rows], covariance, looks, s.n, s.r)

    def _evaluate(self, theta: Real, data: States) -> tuple[Auxiliary, Real]:
        at = auxiliary(self.model, self.model.parameters(theta), data)
        away = theta - self.model.prior_mean
        cost = at.cost() + np.sum(self.model.prior_precision * away**2, axis=-1)
        return at, np.where(np.isfinite(cost), cost, np.inf)

    def _steps(self, theta: Real, at: Auxiliary, data: States, damping: Real) -> tuple[Real, Real]:
        """The next step of each repeat and the standard deviations that it is measured in."""
        model = self.model
        a = unit_forces(model, data.omega, data.X, data.U)
        mixed, symmetric, gradient = normal_equations(model, at, a, data.f)
        prior = model.prior_precision
        gradient = gradient - prior * (theta - model.prior_mean)
        symmetric = symmetric + np.diag(prior)
        free = damping == 0
        diagonal = np.diagonal(symmetric, axis1=-2, axis2=-1)
        damped = symmetric + (damping[:, None] * diagonal)[..., None] * np.eye(theta.shape[-1])
        chosen = np.where(free[:, None, None], mixed + np.diag(prior), damped)
        spread = np.sqrt(np.maximum(np.diagonal(inverse(symmetric), axis1=-2, axis2=-1), 0.0))
        return solve_scaled(chosen, gradient), spread

    def run(self, limit: int, tolerance: float) -> None:
        """Iterate until no unknown moves by more than `tolerance` standard deviations (or 1e-13 of its size)."""
        active = np.flatnonzero(np.all(np.isfinite(self.theta), axis=-1))
        if not len(active):
            return
        data = self._rows(active)
        theta = self.theta[active]
        at, cost = self._evaluate(theta, data)
        damping = np.zeros(len(active))
        for _ in range(limit):
            step, spread = self._steps(theta, at, data, damping)
            trial = theta + np.nan_to_num(step)
            trial_at, trial_cost = self._evaluate(trial, data)
            better = (trial_cost <= cost * (1 + 1e-12) + 1e-12) & np.all(np.isfinite(step), axis=-1)
            small = np.all(np.abs(step) <= np.maximum(tolerance * spread, 1e-13 * np.abs(theta)), axis=-1)
            theta = np.where(better[:, None], trial, theta)
            cost = np.where(better, trial_cost, cost)
            at = Auxiliary(
                *(_pick(better, new, old) for new, old in zip(_fields(trial_at), _fields(at), strict=True))
            )
            self.iterations[active] += 1
            self.theta[active] = theta
            if active[0] == 0:
                self.history.append(theta[0].copy())
            # A full step that lands within the tolerance ends the search; a damped one only if it is tiny because
            # nothing lower is left (damping has grown past all sense).
            done = small & (better | (damping > 1e8))
            self.converged[active[done]] = True
            damping = np.where(
                better, np.where(damping > 1e-6, damping / 10, 0.0), np.maximum(damping * 10, 1e-4)
            )
            lost = damping > 1e12
            keep = ~(done | lost)
            if not np.any(keep):
                break
            if not np.all(keep):
                active, theta, cost, damping = active[keep], theta[keep], cost[keep], damping[keep]
                at = Auxiliary(*(part[keep] for part in _fields(at)))
                data = self._rows(active)


def _fields(at: Auxiliary) -> tuple[np.ndarray, ...]:
    return at.e, at.Se, at.w


def _pick(better: Bools, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    return np.where(better.reshape(-1, *([1] * (new.ndim - 1))), new, old)
