"""Instrumental variables: the paper's bootstrap (eq. 17-20) and the optimally weighted, refined form (THEORY §4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.auxiliary_model import auxiliary, equation_sums, normal_equations
from dashpot.estimate.linear.gram import compiled_equation, compiled_result, regressors
from dashpot.estimate.linear.least_squares import (
    Sampled,
    least_squares_sums,
    sampled,
    sandwich,
    solve_sums,
    starts,
    sums_with_harmonics,
)
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.nonlinear.regression import harmonic_equations, require_direct
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.dynamics import amplitudes, unit_forces
from dashpot.model.network import Model
from dashpot.numerics.kernel import threads
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult, QuadraticModel, minimise

FAR = 1e9  # times the start


@dataclass(frozen=True)
class InstrumentalVariables(Method):
    """The paper's bootstrap: instruments from the auxiliary model, unweighted, from least squares (eq. 17-20).

    Stops when no unknown moves by more than `tolerance` of its size, after `max_iterations` at the latest.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    name: ClassVar[str] = "iv"
    traits: ClassVar[Traits] = Traits(moments="auto", nonlinear=True)

    def solve(self, data: Prepared) -> Solution:
        """θ from (G) with instruments from the response of the auxiliary model, of nonlinear rigs by harmonic balance.

        Nonlinear laws of the noisy motion are biased themselves, so that instruments take out a part only (THEORY §9).
        Raises DataError or UsageError where the channels do not show what this needs.
        """
        if len(data.model.nonlinear):
            equations = harmonic_equations(data)
            theta, converged, iterations, history = fixed_point(
                lambda theta, rows: equations.rows(rows).with_instruments(theta),
                equations.least_squares(),
                self.tolerance,
                self.max_iterations,
            )
            spread = equations.spread(theta, instruments=True)
            return Solution(theta, spread, converged, iterations, history)
        observed = sampled(data)
        N, r = least_squares_sums(observed)
        theta = solve_sums(observed, N, r)

        def step(theta: Real, rows: Ints) -> Real:
            part = observed.rows(rows)
            N, r = sums_with_harmonics(part, instruments(part, theta))
            return solve_sums(part, N, r, theta)

        theta, converged, iterations, history = fixed_point(step, theta, self.tolerance, self.max_iterations)
        w = instruments(observed, theta)
        N, _ = sums_with_harmonics(observed, w)
        return Solution(theta, sandwich(observed, N, w, theta), converged, iterations, history)


def instruments(observed: Sampled, theta: Real) -> Complex:
    """w_i of eq. 18-19, amplitudes (K, lines, elements): unit forces of the auxiliary model's response."""
    model = observed.model
    X = amplitudes(model, model.parameters(theta), observed.omega, observed.U, observed.f)
    return unit_forces(model, observed.omega, X, observed.U)


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

    Stops when no unknown moves by more than `tolerance` of its size, after `max_iterations` at the latest.
    """

    max_iterations: int = 200
    tolerance: float = 1e-9
    name: ClassVar[str] = "oiv"
    traits: ClassVar[Traits] = Traits(maximum_likelihood=True, weighted=True, nonlinear=True)

    def solve(self, data: Prepared) -> Solution:
        """θ at the minimum of Σ eᴴ Ω(θ) e with the priors' rows.

        Of nonlinear rigs a is that of the model's own motion, and the best instruments are the slopes of the equation's
        error through that motion: what they make zero is the slope of the likelihood (THEORY §9).  Raises DataError or
        UsageError where the channels do not show every coordinate and input.
        """
        model, states = data.model, data.seen_states
        if len(model.nonlinear):
            require_direct(data)
            return MaximumLikelihood(max_iterations=self.max_iterations, tolerance=self.tolerance).solve(data)
        first, *others = starts(model, states)
        from_start = partial(search, model, states, limit=self.max_iterations, tolerance=self.tolerance)
        ends = from_start(first, np.arange(len(first)))
        dof = (
            2 * model.n * len(states.omega)
            - len(model.unknowns)
            + int(np.count_nonzero(model.prior_precision))
        )
        for start in others:
            # So unlikely a χ², were the noise as stated, may mean a local minimum: other starts are tried.
            tail = chdtrc(float(max(dof, 1)), np.where(np.isfinite(ends.cost), ends.cost, np.inf))
            (astray,) = (~ends.converged | (tail < 1e-4)).nonzero()
            if not len(astray):
                break
            ends = ends.improved(astray, from_start(start, astray))
        covariance = equation_sums(model, states, ends.x).inverse
        return Solution(ends.x, covariance, ends.converged, ends.iterations, ends.history)


def search(
    model: Model, states: States, start: Real, repeats: Ints, *, limit: int, tolerance: float
) -> OptimizeResult:
    """Minimise Σ eᴴ Ω(θ) e with the priors' rows, for some of the repeats; `start` is (K, unknowns) of all."""
    equation = compiled_equation(model, states)
    if equation is not None:
        ends, sums = equation.search(start, repeats, FAR, limit, tolerance, PATIENCE, threads())
        result = compiled_result(ends)
        if len(repeats) == len(start):  # the sums at the ends are kept
            states.compiled["sums"] = model, result.x, QuadraticModel(*sums)
        return result
    # With noise as large as the signal the likelihood may rise towards infinity: such a repeat has no answer.
    reach = FAR * np.where(np.isnan(start), 0.0, np.abs(start)).max(axis=0, initial=0.0)
    reach = np.where(reach > 0, reach, np.inf)
    evaluate = objective(model, states, repeats)
    minimum = minimise(evaluate, start[repeats], limit=limit, tolerance=tolerance, lower=-reach, upper=reach)
    return replace(minimum, converged=minimum.converged & np.all(np.abs(minimum.x) < reach, axis=-1))


def objective(model: Model, states: States, repeats: Ints) -> Callable[[Real, Ints], QuadraticModel]:
    """Σ eᴴ Ω(θ) e with the priors' rows, as `minimise` takes it, for some of the repeats."""
    precision = model.prior_precision
    mine = states.rows(repeats)
    Phi = regressors(model, unit_forces(model, mine.omega, mine.X, mine.U))

    def evaluate(theta: Real, rows: Ints) -> QuadraticModel:
        at = auxiliary(model, model.parameters(theta), mine.rows(rows))
        mixed, symmetric, gradient = normal_equations(model, at, Phi[rows])
        away = theta - model.prior_mean
        return QuadraticModel(
            at.cost() + np.sum(precision * away**2, axis=-1),
            gradient - precision * away,
            symmetric + np.diag(precision),
            mixed + np.diag(precision),
        )

    return evaluate


def likeliest(data: Prepared, theta: Real) -> Real:
    """The most likely parameters near θ, (K, unknowns), to a thousandth of a standard deviation.

    χ² of the data and the bound belong to them, whatever method found θ.
    """
    if data.states is None:
        return theta
    everyone = np.arange(len(theta))
    return search(data.model, data.states, theta, everyone, limit=50, tolerance=1e-3).x
