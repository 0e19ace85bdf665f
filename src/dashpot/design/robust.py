"""Tests that are good although the parameters are in doubt: on average, or in the worst case.

A box θ (1 ± doubt), or the cloud of an Estimate.  The average is over drawn scenarios.  The worst case over a box is
found by exchange: the best test for a few scenarios, then the scenario that is worst for that test, until none is
worse (Shimizu and Aiyoshi 1980; Pronzato and Walter 1988 for designs).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dashpot.arrays import Real, frozen
from dashpot.design.allocation import Grid, optimise, value
from dashpot.design.criteria import Goal
from dashpot.design.plan import Budget, Lines, Plan, plan, shortest
from dashpot.design.test_setup import Bench
from dashpot.errors import UsageError
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

CLOSE = 2e-3  # a scenario worse by less than this part of the variance ends the search
SLOW = 64  # scenarios drawn to find the slowest transient

NOTHING = Lines(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0))  # the test of no dwell


@dataclass(frozen=True)
class UniformBox:
    """Every unknown lies within value · (1 ± doubt); doubt (unknowns,) or one for all."""

    doubt: Real | float
    kind: ClassVar[str] = "box"

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns): a third of them corners."""
        width = self.width(nominal)
        unit = rng.uniform(-1, 1, (count, len(nominal)))
        corners = count // 3
        unit[:corners] = rng.choice([-1.0, 1.0], (corners, len(nominal)))
        return nominal + width * unit

    def width(self, nominal: Real) -> Real:
        """Half the side of the box, (unknowns,), SI units."""
        doubt = np.broadcast_to(np.asarray(self.doubt, dtype=float), nominal.shape)
        if np.any(~np.isfinite(doubt) | (doubt < 0) | (doubt >= 1)):
            raise UsageError("a doubt that is not between 0 and 100 %", cure="write it as --doubt 30%")
        wide: Real = doubt * np.abs(nominal)
        return wide


@dataclass(frozen=True)
class GaussianPrior:
    """The unknowns are normal about their values with this covariance (unknowns, unknowns), SI units."""

    covariance: Real

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen(self.covariance, np.float64))

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns), cut at 2.5 standard deviations and at a tenth of the value."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        theta = nominal + np.clip(rng.standard_normal((count, len(nominal))), -2.5, 2.5) @ root.T
        small = theta * np.sign(nominal) < 0.1 * np.abs(nominal)
        return np.where(small, 0.1 * nominal, theta)


def uniform_box_of(model: Model, nominal: Real, doubt: float) -> UniformBox:
    """The same doubt in every unknown; of one that the rig file knows with an sd, no more than 1.96 sd."""
    size = np.where(nominal == 0, 1.0, np.abs(nominal))
    known = np.array([np.inf if u.sd is None else 1.96 * u.sd for u in model.unknowns])
    return UniformBox(np.minimum(doubt, known / size))


def gaussian_prior_of(model: Model, estimate: Estimate) -> GaussianPrior:
    """The doubt that an estimate leaves in the unknowns of the rig, by their names.

    Raises UsageError where it is of other unknowns, or has no finite covariance.
    """
    names = [unknown.name for unknown in model.unknowns]
    missing = [name for name in names if name not in estimate.names]
    if missing:
        raise UsageError(
            f"the estimate says nothing of {', '.join(missing)}", cure="give an estimate of this rig"
        )
    i = [estimate.names.index(name) for name in names]
    covariance = estimate.covariance[np.ix_(i, i)]
    if not np.all(np.isfinite(covariance)):
        raise UsageError("the estimate's covariance is not finite", cure="say the doubt with --doubt 30%")
    return GaussianPrior(covariance)


def slowest_settling(bench: Bench, prior: UniformBox | GaussianPrior, seed: int = 0) -> float:
    """Settling time of the slowest of several scenarios, s.  Raises UsageError where one never settles."""
    nominal = bench.theta[0]
    drawn = prior.draw(nominal, SLOW, np.random.default_rng(seed))
    return bench.with_scenarios(np.concatenate([nominal[None], drawn])).settling()


@dataclass(frozen=True)
class Robust:
    """A plan with the bench of its scenarios, and how bad it may get.

    plan     None where what is known suffices already
    worst    the goal's figure in the worst scenario that was found
    search   the figures of the worst scenarios on the way
    """

    plan: Plan | None
    bench: Bench
    worst: float
    search: tuple[float, ...]


def on_average(
    bench: Bench,
    goal: Goal,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[Bench], Grid],
    *,
    target: float | None = None,
    count: int = 32,
    known: Real | None = None,
    seed: int = 0,
) -> Robust:
    """The test with the best mean of the goal over `count` scenarios; with a target, the shortest that has it.

    `known` is information in SI units (q, q).
    """
    nominal = bench.theta[0]
    theta = np.concatenate([nominal[None], prior.draw(nominal, count, np.random.default_rng(seed))])
    wide = bench.with_scenarios(theta)
    already = _prior(wide, known)
    grid = grid_of(wide)
    found = (
        plan(wide, goal, budget, grid, known=already, doubt="average")
        if target is None
        else shortest(wide, goal, target, budget, grid, known=already, doubt="average")
    )
    M = _prior(wide, known)
    at = value(goal.terms(wide, "worst"), M if found is None else M + found.lines.information(wide))
    return Robust(found, wide, goal.figure(at.F), ())


def in_the_worst_case(
    bench: Bench,
    goal: Goal,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[Bench], Grid],
    *,
    known: Real | None = None,
    rounds: int = 14,
    seed: int = 0,
) -> Robust:
    """The test whose worst scenario is best.  `known` is information in SI units (q, q)."""
    nominal = bench.theta[0]
    theta = nominal[None]
    search: list[float] = []
    samples = max(budget.measured(len(nominal)), budget.measured(1) / 2)
    for turn in range(rounds):
        # Which scenarios matter is found on a grid of fixed frequencies: no need to place them finely yet.
        wide = bench.with_scenarios(theta)
        grid = replace(grid_of(wide), free=False)
        found = optimise(wide.information, goal.terms(wide, "worst"), _prior(wide, known), samples, grid)
        lines = Lines(found.frequency_hz, found.pattern, samples * found.share)
        worst, at = worst_scenario(wide, goal, lines, prior, known=known, seed=seed + turn)
        search.append(worst)
        if worst**2 <= goal.figure(found.F) ** 2 * (1 + CLOSE):
            break
        theta = np.concatenate([theta, at[None]])
    # The last scenario may be new: it counts too.
    wide = bench.with_scenarios(theta)
    already = _prior(wide, known)
    final = plan(wide, goal, budget, grid_of(wide), known=already, doubt="worst")
    worst, _ = worst_scenario(wide, goal, final.lines, prior, known=known, seed=seed + rounds)
    return Robust(final, wide, worst, tuple(search))


def shortest_in_the_worst_case(
    bench: Bench,
    goal: Goal,
    target: float,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[Bench], Grid],
    *,
    known: Real | None = None,
    rounds: int = 14,
    seed: int = 0,
) -> Robust:
    """The shortest test whose worst scenario reaches the target, as far as a search finds it.

    `budget` says what is short (samples or time) and is a first guess; `known` is information in SI units (q, q).
    Raises UsageError where the search for scenarios does not end.
    """
    theta, aim = bench.theta[:1], target
    search: list[float] = []
    for turn in range(rounds):
        wide = bench.with_scenarios(theta)
        already = _prior(wide, known)
        found = shortest(wide, goal, aim, budget, grid_of(wide), known=already)
        lines = NOTHING if found is None else found.lines
        worst, at = worst_scenario(wide, goal, lines, prior, known=known, seed=seed + turn)
        search.append(worst)
        if worst <= target:
            return Robust(found, wide, worst, tuple(search))
        if found is not None and worst <= target * (1 + CLOSE):
            aim *= 0.999 * target / worst  # a scenario hardly worse than those that count already
        else:
            theta = np.concatenate([theta, at[None]])
        if found is not None:
            amount = found.samples if budget.samples is not None else found.time_s
            assert amount is not None
            budget = budget.scaled(amount * (worst / target) ** 2 / (budget.samples or budget.time or 1.0))
    raise UsageError(
        "no test was found whose worst case reaches the target",
        cure="doubt less, or give --samples or --time",
    )


def _prior(bench: Bench, known: Real | None) -> Real:
    return bench.prior if known is None else bench.known(known)


def worst_scenario(
    bench: Bench,
    goal: Goal,
    lines: Lines,
    prior: UniformBox | GaussianPrior,
    *,
    known: Real | None = None,
    count: int = 192,
    seed: int = 0,
) -> tuple[float, Real]:
    """The worst figure of a test over the prior and the θ (unknowns,) at which it occurs.

    Corners and inner points, then ever smaller steps from the worst of them.  The drive is the bench's.
    """
    rng = np.random.default_rng(seed)
    nominal = bench.theta[0]
    measured = len(lines.samples) > 0
    drive = bench.drive(lines.frequency_hz, lines.pattern) if measured else None

    def badness(theta: Real) -> Real:
        alone = bench.with_scenarios(theta)
        M = _prior(alone, known)
        if drive is not None:
            each = bench.per_sample(alone.p, alone.sizes, lines.frequency_hz, drive)
            M = M + np.einsum("i,siab->sab", lines.samples, each)
        F = np.empty(len(theta))
        for s in range(len(theta)):
            one = alone.with_scenarios(theta[s : s + 1])
            F[s] = value(goal.terms(one, "worst"), M[s : s + 1]).F
        return F

    pool = np.concatenate([bench.theta, prior.draw(nominal, count, rng)])
    if isinstance(prior, UniformBox):
        width = prior.width(nominal)
        if len(nominal) <= 6:
            signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(nominal))).reshape(len(nominal), -1).T
            pool = np.concatenate([pool, nominal + width * signs])
        low, high = nominal - width, nominal + width
    else:
        low, high = np.full_like(nominal, -np.inf), np.full_like(nominal, np.inf)
    F = badness(pool)
    top = int(np.argmax(F))
    at, most = pool[top], float(F[top])
    if isinstance(prior, UniformBox):
        for radius in (1.0, 0.5, 0.25, 0.1, 0.04):
            steps = radius * width * rng.uniform(-1, 1, (32, len(nominal)))
            steps *= rng.random((32, len(nominal))) < 0.5
            near = np.clip(at + steps, low, high)
            F = badness(near)
            top = int(np.argmax(F))
            if F[top] > most:
                at, most = near[top], float(F[top])
    return goal.figure(most), at
