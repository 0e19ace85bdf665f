"""Minimising a sum of squares for many repeats at once: full steps where they help, damped ones where they do not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dashpot.arrays import Bools, Ints, Real, zeros_for_nan
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled

ROUNDING = 1e-5  # standard deviations
PATIENCE = 12  # iterations after which Newton's own matrix is worth its evaluations


@dataclass(frozen=True)
class QuadraticModel:
    """The cost at k points and what a step needs.

    cost (k,); gradient (k, m), minus half the slope; symmetric (k, m, m), half the curvature of Gauss-Newton;
    free (k, m, m), the matrix of the full step (`symmetric` itself, or a refined instrumental one).
    """

    cost: Real
    gradient: Real
    symmetric: Real
    free: Real

    @cached_property
    def inverse(self) -> Real:
        """The inverse of `symmetric`, (k, m, m); NaN where that is singular to rounding."""
        return scaled_inverse(self.symmetric)

    @staticmethod
    def joined(parts: Sequence[QuadraticModel]) -> QuadraticModel:
        """The points of several, one behind another."""
        fields = [(at.cost, at.gradient, at.symmetric, at.free) for at in parts]
        return QuadraticModel(*(np.concatenate(each) for each in zip(*fields, strict=True)))

    @property
    def sd(self) -> Real:
        """Standard deviations by `inverse`, (k, m); of the size of a variance that rounding made negative."""
        return np.sqrt(np.abs(np.diagonal(self.inverse, axis1=-2, axis2=-1)))

    def where(self, chosen: Bools, other: QuadraticModel) -> QuadraticModel:
        """This where chosen (K,), else the other."""
        one, two = chosen[:, None], chosen[:, None, None]
        return QuadraticModel(
            np.where(chosen, self.cost, other.cost),
            np.where(one, self.gradient, other.gradient),
            np.where(two, self.symmetric, other.symmetric),
            np.where(two, self.free, other.free),
        )

    def rows(self, keep: Bools) -> QuadraticModel:
        """Some of the points, keep (K,)."""
        return QuadraticModel(self.cost[keep], self.gradient[keep], self.symmetric[keep], self.free[keep])


@dataclass(frozen=True)
class OptimizeResult:
    """Where the search ended, for K repeats; iterations from all starts together.

    history of the first repeat: the start and the steps of the descent that ended there, (points, m).
    """

    x: Real
    cost: Real
    converged: Bools
    iterations: Ints
    history: Real

    def worse(self, rows: Ints, other: OptimizeResult) -> Bools:
        """For which of `rows` (k,) another search over them ended lower, or settled where this one did not."""
        return (other.cost < self.cost[rows] * (1 - 1e-9)) | (other.converged & ~self.converged[rows])

    def improved(self, rows: Ints, other: OptimizeResult) -> OptimizeResult:
        """With what another search over some of the repeats, rows (k,), found where `worse` prefers it.

        Iterations add up.
        """
        better = self.worse(rows, other)
        x, cost, converged = self.x.copy(), self.cost.copy(), self.converged.copy()
        iterations = self.iterations.copy()
        x[rows[better]], cost[rows[better]] = other.x[better], other.cost[better]
        converged[rows[better]] = other.converged[better]
        iterations[rows] += other.iterations
        history = other.history if len(rows) and rows[0] == 0 and better[0] else self.history
        return OptimizeResult(x, cost, converged, iterations, history)


def without_bounds(x: Real, around: QuadraticModel, lower: Real, upper: Real) -> Real:
    """Where the minima x, (k, m), would lie without bounds: one full step on where a bound holds, else x itself."""
    held = np.any((x <= lower) | (x >= upper), axis=-1, keepdims=True)
    return np.where(held, x + solve_scaled(around.symmetric, around.gradient), x)


def minimise(
    evaluate: Callable[[Real, Ints], QuadraticModel],
    start: Real,
    *,
    limit: int,
    tolerance: float,
    lower: Real | None = None,
    upper: Real | None = None,
    longest: Real | float = np.inf,
    patience: int = PATIENCE,
) -> OptimizeResult:
    """Minimise the cost of each of K repeats from `start`, (K, m), within bounds.

    `evaluate(x, rows)` gives the cost at x for the repeats `rows`.  A step that does not lower the cost is repeated
    with Levenberg and Marquardt's damping on the diagonal of `symmetric`.  A repeat ends when its full step is below
    `tolerance` standard deviations (or 1e-13 of the value) in every unknown.  A bound whose far side is downhill
    holds its unknown there, and one whose bounds meet is none.  No unknown moves by more than `longest` in one step.
    What still runs after `patience` iterations goes on with Newton's own matrix, and with every such number of
    iterations more may stop ten times farther off, up to ROUNDING: unknowns that the data hardly tell apart come no
    nearer.
    """
    m = start.shape[-1]
    low = np.full(m, -np.inf) if lower is None else lower
    high = np.full(m, np.inf) if upper is None else upper
    if np.any(low >= high):
        evaluate = _with_known(evaluate, low, low >= high)
    search = _Search(evaluate, np.clip(start, low, high), low, high, longest, tolerance, patience)
    for turn in range(limit if len(search.active) else 0):
        search.step(turn)
        if not len(search.active):
            break
    return OptimizeResult(
        search.ends, search.costs, search.converged, search.iterations, np.array(search.history)
    )


def _with_known(
    evaluate: Callable[[Real, Ints], QuadraticModel], value: Real, known: Bools
) -> Callable[[Real, Ints], QuadraticModel]:
    """`evaluate` where unknowns (m,) are known: for the others they are at their `value`, by themselves a parabola."""
    others = ~(known[:, None] | known)

    def at(x: Real, rows: Ints) -> QuadraticModel:
        local = evaluate(np.where(known, value, x), rows)
        symmetric, free = (
            np.where(others, part, np.eye(len(value))) for part in (local.symmetric, local.free)
        )
        return QuadraticModel(local.cost, np.where(known, value - x, local.gradient), symmetric, free)

    return at


class _Search:
    """Where the repeats are, and which of them still move: `x`, `around`, `damping` are of the `active` ones."""

    def __init__(
        self,
        evaluate: Callable[[Real, Ints], QuadraticModel],
        start: Real,
        low: Real,
        high: Real,
        longest: Real | float,
        tolerance: float,
        patience: int,
    ) -> None:
        repeats = len(start)
        self.evaluate, self.low, self.high, self.longest = evaluate, low, high, longest
        self.tolerance, self.patience = tolerance, patience
        # Newton's matrix takes an evaluation for each unknown: of very many, further steps come cheaper for longer.
        self.newton_from = max(patience, start.shape[-1] // 4)
        self.ends, self.costs = start, np.full(repeats, np.inf)
        self.converged = np.zeros(repeats, dtype=bool)
        self.iterations = np.zeros(repeats, dtype=np.int64)
        self.history = [start[0].copy()]
        self.active: Ints = np.flatnonzero(np.all(np.isfinite(start), axis=-1))
        self.damping, self.length = np.zeros(len(self.active)), np.full(len(self.active), np.inf)
        if len(self.active):
            self.x = start[self.active]
            self.around = self._evaluated(self.x)
            self.costs[self.active] = self.around.cost

    def _evaluated(self, x: Real) -> QuadraticModel:
        with np.errstate(all="ignore"):
            local = self.evaluate(x, self.active)
            cost = np.where(np.isfinite(local.cost), local.cost, np.inf)
            return QuadraticModel(cost, local.gradient, local.symmetric, local.free)

    def step(self, turn: int) -> None:
        """One iteration of all that still move."""
        convex = np.zeros(len(self.active), dtype=bool)
        if turn >= self.newton_from:
            self.around, convex = _curved(self.evaluate, self.x, self.active, self.around)
            self.damping = np.where(convex & (turn == self.newton_from), 0.0, self.damping)
        x, around, damping = self.x, self.around, self.damping
        step, spread = _step(x, around, damping, convex, self.low, self.high)
        trial = np.clip(x + np.clip(zeros_for_nan(step), -self.longest, self.longest), self.low, self.high)
        there = self._evaluated(trial)
        usable = np.all(np.isfinite(step), axis=-1)
        with np.errstate(all="ignore"):  # steps from where there is no cost yet, or into the infinite
            # The cost is rounded by that much where the noise of stiff chains is ill-conditioned.
            # By how much a step would lower the cost were it the parabola that Gauss and Newton take it for
            step = trial - x
            bent = np.einsum("ki,kij,kj->k", step, around.symmetric, step)
            promised, blur = 2 * np.sum(around.gradient * step, axis=-1) - bent, 1e-10 * np.abs(around.cost)
            # A step that promises less than the rounding of the cost is not refused for that rounding.
            allowed = np.where(promised <= blur, blur, 1e-12 * around.cost + 1e-12)
            better = usable & (there.cost <= around.cost + allowed)
            # Damping after a step that lowered the cost: a third where it kept its promise, as before where
            # it hardly did
            with np.errstate(all="ignore"):
                kept = zeros_for_nan((around.cost - there.cost) / promised)
            factor = np.where(kept > 0.75, 1 / 3, np.where(kept > 0.25, 0.7, 1.0))
            calm = np.where(damping * factor > 1e-7, damping * factor, 0.0)
            length = np.max(np.abs(trial - x) / spread, axis=-1)
        near = max(self.tolerance, min(self.tolerance * 10.0 ** (turn // self.patience - 1), ROUNDING))
        small = np.all(np.abs(trial - x) <= np.maximum(near * spread, 1e-13 * np.abs(x)), axis=-1)
        self.x = np.where(better[:, None], trial, x)
        self.around = there.where(better, around)
        # A tiny full step ends the search.  So does a tiny rejected one: nothing lower is left within rounding; and one
        # that grows where the cost can tell nothing: only rounding of the slope makes it.
        grows = (length <= ROUNDING) & (length >= self.length) & (promised <= blur)
        done = (small | grows) & usable & ((damping == 0) | ~better)
        self.length = np.where(better & (damping == 0), length, np.inf)
        self.damping = np.where(better, np.where(small, 0.0, calm), np.maximum(damping * 3, 1e-5))
        self._record(done)

    def _record(self, done: Bools) -> None:
        """Write down where the repeats are, and go on with those that are not done or out of damping."""
        active = self.active
        self.iterations[active] += 1
        self.ends[active], self.costs[active] = self.x, self.around.cost
        if active[0] == 0:
            self.history.append(self.x[0].copy())
        self.converged[active[done]] = True
        keep = ~(done | (self.damping > 1e14))
        if not np.all(keep):
            self.active, self.x, self.damping = active[keep], self.x[keep], self.damping[keep]
            self.length = self.length[keep]
            self.around = self.around.rows(keep)


def _curved(
    evaluate: Callable[[Real, Ints], QuadraticModel], x: Real, rows: Ints, around: QuadraticModel
) -> tuple[QuadraticModel, Bools]:
    """Newton's matrix as `free`, by differences of the slope, where it is positive definite; and where it is.

    Gauss-Newton and instruments leave out the curvature that residuals bring in: where the model does not fit, they
    creep.
    """
    m = x.shape[-1]
    with np.errstate(all="ignore"):
        spread = 1 / np.sqrt(np.diagonal(around.symmetric, axis1=-2, axis2=-1))
        width = 1e-4 * np.where(np.isfinite(spread), spread, 1.0)
        # Several unknowns at once where they are few, for a call costs more than its numbers; of many, what one call
        # holds grows with the square of their number.
        # At most 800 unknowns × repeats × displaced copies in one call
        together = max(1, min(m, 800 // (m * len(x))))
        columns = []
        for first in range(0, m, together):
            moved = [x + width[:, j, None] * np.eye(m)[j] for j in range(first, min(first + together, m))]
            slopes = evaluate(np.concatenate(moved), np.tile(rows, len(moved))).gradient
            columns += np.split(slopes, len(moved))
        curvature = np.stack(
            [(around.gradient - there) / width[:, j, None] for j, there in enumerate(columns)], axis=-1
        )
        curvature = (curvature + np.swapaxes(curvature, -1, -2)) / 2
        scaled = zeros_for_nan(curvature * spread[:, :, None] * spread[:, None, :])
        convex = np.linalg.eigvalsh(scaled)[:, 0] > 1e-6
    free = np.where(convex[:, None, None], curvature, around.free)
    return QuadraticModel(around.cost, around.gradient, around.symmetric, free), convex


def _step(
    x: Real, around: QuadraticModel, damping: Real, newton: Bools, low: Real, high: Real
) -> tuple[Real, Real]:
    """The next step of each repeat, and the standard deviations that steps are measured in.

    `newton`: where `free` is Newton's matrix, which may be damped; an instrumental one gives full steps only.
    """
    m = x.shape[-1]
    diagonal = np.diagonal(around.symmetric, axis1=-2, axis2=-1)
    full = newton | (damping == 0)
    matrix = np.where(full[:, None, None], around.free, around.symmetric)
    matrix = matrix + (damping[:, None] * diagonal)[..., None] * np.eye(m)
    gradient = around.gradient
    held = ((x <= low) & (gradient < 0)) | ((x >= high) & (gradient > 0))
    if np.any(held):
        free = ~held
        both = free[:, :, None] & free[:, None, :]
        matrix = np.where(both, matrix, np.eye(m))
        gradient = np.where(held, 0.0, gradient)
    # A direction that is not seen makes these overflow: such a step is refused or damped, not reported.
    with np.errstate(all="ignore"):
        spread = np.sqrt(np.maximum(np.diagonal(scaled_inverse(around.symmetric), axis1=-2, axis2=-1), 0.0))
        return solve_scaled(matrix, gradient), zeros_for_nan(spread)
