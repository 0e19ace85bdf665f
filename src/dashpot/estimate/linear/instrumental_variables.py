"""Instrumental variables: the paper's bootstrap (eq. 17-20) and the optimally weighted, refined form (THEORY §4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real
from dashpot.errors import ModelError
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.gram import (
    auxiliary,
    compiled_equation,
    compiled_result,
    equation_sums,
    normal_equations,
    regressors,
)
from dashpot.estimate.linear.least_squares import (
    Sampled,
    least_squares_sums,
    sampled,
    sandwich,
    solve_sums,
    starts,
    sums_with_harmonics,
    where_finite,
)
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.nonlinear.regression import harmonic_equations, require_direct
from dashpot.estimate.preparation import Prepared, States
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import amplitudes, unit_forces
from dashpot.model.matrix_elements import LETTERS, Letter
from dashpot.model.network import Model
from dashpot.model.observation import small
from dashpot.numerics.kernel import threads
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult, QuadraticModel, minimise
from dashpot.numerics.small_systems import solve_scaled

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
        Raises DataError or UsageError if the channels do not show what this needs.
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
    X = amplitudes(
        model, model.parameters(theta), observed.omega, observed.U, observed.f, observed.experiment
    )
    return unit_forces(model, observed.omega, X, observed.U, observed.experiment)


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
        UsageError if the channels do not show every coordinate and input.
        """
        model, states = data.model, data.seen_states
        if len(model.nonlinear):
            require_direct(data)
            return MaximumLikelihood(max_iterations=self.max_iterations, tolerance=self.tolerance).solve(data)
        first, *others = starts(model, states) if small(model) else likelier_first(model, states)
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


def likelier_first(model: Model, states: States) -> list[Real]:
    """The `starts` and the guesses, each (K, unknowns), the likeliest of each repeat first.

    In long chains least squares may begin far off.
    """
    tries = list(starts(model, states))
    guess = [unknown.nominal for unknown in model.unknowns]
    if None not in guess:
        tries.append(np.broadcast_to(np.array(guess, dtype=float), tries[0].shape))
    with np.errstate(all="ignore"):
        costs = np.stack([auxiliary(model, model.parameters(theta), states).cost() for theta in tries])
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), axis=0, kind="stable")
    return list(np.take_along_axis(np.stack(tries), order[..., None], axis=0))


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
    Phi = regressors(model, unit_forces(model, mine.omega, mine.X, mine.U, mine.experiment))

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


BARRIER = 1e-6  # of χ², for each row of the matrices: what keeping off the edge of the cone may cost


@dataclass(frozen=True)
class FreeMatrices(Frozen):
    """M, C, K, and the joint covariance of their entries, SI units.

    coordinates  of rows and columns, in order
    M, C, K      (..., n, n)
    entries      (letter, i, j), i ≤ j, of every entry that some unknown moves
    covariance   (..., entries, entries)
    """

    coordinates: tuple[str, ...]
    M: Real
    C: Real
    K: Real
    entries: tuple[tuple[Letter, int, int], ...]
    covariance: Real

    def sd(self, letter: Letter) -> Real:
        """Standard deviations of a matrix's entries, (..., n, n); 0 where known."""
        n = len(self.coordinates)
        variance = np.diagonal(self.covariance, axis1=-2, axis2=-1)
        out = np.zeros((*variance.shape[:-1], n, n))
        for position, (which, i, j) in enumerate(self.entries):
            if which == letter:
                out[..., i, j] = out[..., j, i] = np.sqrt(variance[..., position])
        return out


def matrices_of(model: Model, estimate: Estimate) -> FreeMatrices:
    """The matrices of an estimate of any model without hysteretic dampers, with their covariance.

    Raises ModelError if the estimate is of another model.
    """
    names = model.unknown_names
    m = len(names)
    if estimate.names[:m] != names:
        raise ModelError("the estimate belongs to another model", cure="give the model that was identified")
    if len(model.by_matrix["H"]):
        raise ModelError(
            "hysteretic dampers do not fit into M, C or K", cure="remove them, or use viscous dampers"
        )
    p = model.parameters(estimate.values[..., :m])
    B = model.B
    upper = [(i, j) for i in range(model.n) for j in range(i, model.n)]
    matrices: dict[Letter, Real] = {}
    rows, entries = [], []
    for letter in LETTERS:
        index = model.by_matrix[letter]
        matrices[letter] = np.einsum("...e,ei,ej->...ij", p[..., index], B[index], B[index])
        for i, j in upper:
            row = (B[index, i] * B[index, j]) @ model.T[index]
            if np.any(row):
                rows.append(row)
                entries.append((letter, i, j))
    L = np.array(rows).reshape(len(rows), m)
    covariance = L @ estimate.covariance[..., :m, :m] @ L.T
    return FreeMatrices(
        model.coordinates, matrices["M"], matrices["C"], matrices["K"], tuple(entries), covariance
    )


@dataclass(frozen=True)
class DefiniteOptimalIV(Method):
    """oiv with M, C and K (or those of `letters`) positive semidefinite.

    If the free estimate is definite, it is the answer.  Otherwise the likelihood is maximised over the cone:
    Gauss-Newton, each step a quadratic programme over the cone (convex, hence with one answer) by an interior-point
    method (Boyd and Vandenberghe 2004, ch. 11), shortened where the likelihood would not grow.  The answer is
    positive definite; its smallest eigenvalues are what the barrier leaves.
    The covariance stated is the free one: in the metric of the information the nearest point of a convex set that
    holds the truth is never farther from it than the free estimate.
    A matrix that its elements cannot make definite (a coordinate without mass, a chain without ground) is required to
    be so on the subspace that they span.

    Iterations end where no unknown moves by more than `tolerance` of its standard deviation, after `max_iterations` at
    the latest.
    """

    letters: str = "MCK"
    max_iterations: int = 100
    tolerance: float = 1e-5
    name: ClassVar[str] = "oiv+"
    traits: ClassVar[Traits] = Traits(maximum_likelihood=True, weighted=True, definite=True)

    def solve(self, data: Prepared) -> Solution:
        """The free estimate, refined on the cone for the repeats that leave it."""
        free = OptimalIV().solve(data)
        theta, converged, iterations = free.theta.copy(), free.converged.copy(), free.iterations.copy()
        # What the data leave undetermined has no nearest point: the cone has no end in its direction.
        known = np.all(np.isfinite(free.covariance), axis=(-1, -2)) & np.all(np.isfinite(theta), axis=-1)
        there = np.flatnonzero(known & free.converged)
        if not len(there):
            return free
        # One cone for each matrix that the unknowns move, on the subspace that its elements span
        cones = []
        size = np.median(np.abs(data.model.parameters(theta[there])), axis=0)
        for letter in self.letters:
            index = data.model.by_matrix[letter]
            if not np.any(data.model.T[index]):
                continue
            B = data.model.B[index]
            _, s, Vh = np.linalg.svd(B, full_matrices=False)
            F = B @ Vh[s > 1e-10 * s[0]].T
            scale = np.sqrt(size[index] @ F**2)
            F = F / np.where(scale > 0, scale, 1.0)
            products = F[:, :, None] * F[:, None, :]
            cones.append(
                _Cone(
                    np.tensordot(data.model.p0[index], products, axes=1),
                    np.einsum("eu,eij->uij", data.model.T[index], products),
                )
            )
        if not cones:
            return free
        rows = there[_smallest(cones, theta[there]) < 0]
        history = free.history
        if len(rows):
            start, there_is = _inside(data.model, cones, theta[rows])
            converged[rows[~there_is]] = False
            rows, start = rows[there_is], start[there_is]
        if len(rows):
            ends = self._on_the_cone(data.model, data.seen_states, cones, theta[rows], start, rows)
            theta[rows], converged[rows] = where_finite(ends.x, theta[rows]), ends.converged
            iterations[rows] += ends.iterations
            if rows[0] == 0:
                history = np.concatenate([history, ends.history])
        return Solution(theta, free.covariance, converged, iterations, history, free.signs, free.warnings)

    def _on_the_cone(
        self, model: Model, states: States, cones: list[_Cone], free: Real, start: Real, rows: Ints
    ) -> OptimizeResult:
        """The constrained maxima of the likelihood near the free ones; `start` are any points inside."""
        likelihood = objective(model, states, rows)
        everyone = np.arange(len(rows))
        x = _nearest(free, likelihood(free, everyone).symmetric, cones, start)
        converged = np.zeros(len(rows), dtype=bool)
        iterations = np.zeros(len(rows), dtype=np.int64)
        history = [x[0].copy()]
        around, active = likelihood(x, everyone), everyone
        cost = around.cost.copy()
        for _ in range(self.max_iterations):
            target = x[active] + solve_scaled(around.symmetric, around.gradient)
            step = _nearest(target, around.symmetric, cones, start[active]) - x[active]
            length = np.sqrt(np.maximum(np.einsum("ku,kuv,kv->k", step, around.symmetric, step), 0.0))
            for _halving in range(12):
                there = likelihood(x[active] + step, active)
                # In χ², more than the barrier costs and less than matters
                worse = ~(there.cost <= cost[active] + 1e-4)
                if not np.any(worse):
                    break
                step = np.where(worse[:, None], step / 2, step)
            better = ~worse
            x[active] += np.where(better[:, None], step, 0.0)
            cost[active] = np.where(better, there.cost, cost[active])
            iterations[active] += 1
            if active[0] == 0:
                history.append(x[0].copy())
            done = (length < self.tolerance) & np.all(np.isfinite(target), axis=-1)
            converged[active[done]] = True
            keep = ~done & better
            if not np.any(keep):
                break
            active, around = active[keep], there.rows(keep)
        return OptimizeResult(x, cost, converged, iterations, np.array(history))


@dataclass(frozen=True)
class _Cone:
    """A matrix that must be positive semidefinite: A(θ) = A₀ + Σ θ_u A_u, scaled to entries near 1."""

    A0: Real
    A: Real

    def at(self, theta: Real) -> Real:
        """(..., rows, rows) for θ (..., unknowns)."""
        return self.A0 + np.tensordot(theta, self.A, axes=1)


def _smallest(cones: list[_Cone], theta: Real) -> Real:
    """The smallest eigenvalue of all the cones' matrices, (K,)."""
    return np.min([np.linalg.eigvalsh(cone.at(theta))[..., 0] for cone in cones], axis=0)


def _inside(model: Model, cones: list[_Cone], free: Real) -> tuple[Real, Bools]:
    """Points (K, unknowns) with all matrices definite, near the free ones, and whether there is one, (K,).

    Positive elements make matrices definite; a tenth of what is left of the way there from the edge of the cone.
    """
    size = np.abs(model.parameters(free))
    floor = np.zeros_like(free)
    for index in model.by_matrix.values():
        typical = (
            np.median(np.where(size[:, index] > 0, size[:, index], np.nan), axis=-1) if len(index) else 0.0
        )
        for e in index:
            floor = np.where(model.T[e] != 0, 0.1 * np.nan_to_num(typical, nan=1.0)[:, None], floor)
    deep = np.maximum(np.abs(free), floor)
    low, high = np.zeros(len(free)), np.ones(len(free))
    for _ in range(30):
        middle = (low + high) / 2
        good = _smallest(cones, free + middle[:, None] * (deep - free)) > 0
        low, high = np.where(good, low, middle), np.where(good, middle, high)
    part = high + 0.1 * (1 - high)
    inside = free + part[:, None] * (deep - free)
    return inside, (_smallest(cones, deep) > 1e-9) & (_smallest(cones, inside) > 0)


def _nearest(centre: Real, W: Real, cones: list[_Cone], start: Real) -> Real:
    """The points of all the cones nearest to `centre` (K, unknowns) in the metric W, from `start` inside.

    Minimises ½ |x − centre|²_W − μ Σ log det A(x), μ falling from the distance of the start to BARRIER.  That is
    self-concordant: a Newton step of length δ in its own metric, cut to 1 / (1 + δ), stays inside and goes down (Boyd
    and Vandenberghe 2004, 9.6).  Where `centre` or W is not finite, the start is returned.
    """
    x, before = start, start
    mu = np.maximum(np.einsum("ku,kuv,kv->k", x - centre, W, x - centre), 1.0)
    lost = ~np.isfinite(mu)
    mu = np.where(lost, 1.0, mu)
    while True:
        for _ in range(200):
            # Rounding may carry a point over the edge where W is all but singular: it stays where it was inside.
            lost |= ~(_smallest(cones, x) > 0)
            x = np.where(lost[:, None], before, x)
            b, B = np.zeros_like(x), np.zeros_like(W)
            for cone in cones:
                values, vectors = np.linalg.eigh(cone.at(x))
                root = vectors / np.sqrt(np.maximum(values, 1e-100))[:, None, :]
                G = np.swapaxes(root, -1, -2)[:, None] @ cone.A @ root[:, None]  # A^-½ A_u A^-½, turned
                b = b + np.trace(G, axis1=-2, axis2=-1)
                flat = G.reshape(*G.shape[:2], -1)
                B = B + flat @ np.swapaxes(flat, -1, -2)
            slope = ((centre - x)[:, None, :] @ W)[:, 0] + mu[:, None] * b
            step = np.where(lost[:, None], 0.0, np.nan_to_num(solve_scaled(W + mu[:, None, None] * B, slope)))
            away = np.sqrt(np.maximum(np.sum(step * np.nan_to_num(slope), axis=-1), 0.0) / mu)
            before, x = x, x + step / np.where(away > 0.25, 1 + away, 1.0)[:, None]
            if np.all(away < 1e-2):
                break
        if np.all(mu <= BARRIER):
            return np.where((_smallest(cones, x) > 0)[:, None], x, before)
        mu = np.maximum(mu / 10, BARRIER)
