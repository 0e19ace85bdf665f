"""The best test, also where the parameters are uncertain: on average, or in the worst case.

A box θ (1 ± relative), or the normal distribution of an Estimate.  The average is over drawn scenarios.  The worst
case over a box is found by exchange: the best test for a few scenarios, then the scenario that is worst for that
test, until none is worse (Shimizu and Aiyoshi 1980; Pronzato and Walter 1988 for designs).  Any `mapper` judges
scenarios, in tasks of a fixed size, so that the result does not depend on who computes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Frozen, Real, random_generator
from dashpot.design.allocation import Criterion, optimise
from dashpot.design.plan import Budget, Plan, plan, shortest
from dashpot.design.test_setup import NO_TEST, FrequencyGrid, Schedule, TestSetup
from dashpot.errors import UsageError
from dashpot.model.network import Model

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True)
class UniformBox:
    """Every unknown lies within value · (1 ± relative); relative (unknowns,) or one for all."""

    relative: Real | float

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns): a third of them corners."""
        width = self.width(nominal)
        unit = rng.uniform(-1, 1, (count, len(nominal)))
        corners = count // 3
        unit[:corners] = rng.choice([-1.0, 1.0], (corners, len(nominal)))
        return nominal + width * unit

    def width(self, nominal: Real) -> Real:
        """Half the side of the box, (unknowns,), SI units.

        Raises UsageError if the uncertainty is not between 0 and 100 %.
        """
        relative = np.broadcast_to(np.asarray(self.relative, dtype=float), nominal.shape)
        if np.any(~np.isfinite(relative) | (relative < 0) | (relative >= 1)):
            raise UsageError(
                "the uncertainty of a value must lie between 0 and 100 %", cure="state it, for example 30 %"
            )
        return relative * np.abs(nominal)


@dataclass(frozen=True)
class GaussianPrior(Frozen):
    """The unknowns are normal about their values with this covariance (unknowns, unknowns), SI units."""

    covariance: Real

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns), cut at 2.5 standard deviations and at a tenth of the value."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        theta = nominal + np.clip(rng.standard_normal((count, len(nominal))), -2.5, 2.5) @ root.T
        small = theta * np.sign(nominal) < 0.1 * np.abs(nominal)
        return np.where(small, 0.1 * nominal, theta)


Uncertainty = UniformBox | GaussianPrior


def uniform_box_of(model: Model, nominal: Real, relative: float) -> UniformBox:
    """The same uncertainty for every unknown; at most 1.96 sd where the rig file states an sd.

    nominal (unknowns,).
    """
    size = np.where(nominal == 0, 1.0, np.abs(nominal))
    known = np.array([np.inf if u.sd is None else 1.96 * u.sd for u in model.unknowns])
    return UniformBox(np.minimum(relative, known / size))


def slowest_settling(setup: TestSetup, uncertainty: Uncertainty) -> float:
    """Settling time of the slowest of 65 scenarios, s.  Raises UsageError where one never settles."""
    return _drawn(setup, uncertainty, 64).settling()


def _drawn(setup: TestSetup, uncertainty: Uncertainty, count: int) -> TestSetup:
    nominal = setup.theta[0]
    drawn = uncertainty.draw(nominal, count, random_generator(0))
    return replace(setup, theta=np.concatenate([nominal[None], drawn]))


@dataclass(frozen=True)
class BestTest:
    """A plan (None where what is known suffices already) with the setup of its scenarios.

    `worst` is the criterion's figure in the worst scenario that was found; None if the values are certain.
    """

    plan: Plan | None
    setup: TestSetup
    worst: float | None


def best_test(
    setup: TestSetup,
    criterion: Criterion,
    budget: Budget,
    uncertainty: Uncertainty | None,
    grid_of: Callable[[TestSetup], FrequencyGrid],
    *,
    target: float | None = None,
    mapper: Map = map,
) -> BestTest:
    """The best test within a budget or, with a target, the shortest that reaches it; of uncertain values a safe one.

    With a target, `budget` says what is short (samples or time) and is a first guess.  Of uncertain values the average
    over 33 scenarios counts, or the worst that a search finds, as the setup says.  Raises UsageError as `plan` and
    `shortest`, and where the search for scenarios does not end.
    """
    if uncertainty is None or setup.over == "average":
        wide = setup if uncertainty is None else _drawn(setup, uncertainty, 32)
        if target is None:
            advised: Plan | None = plan(wide, criterion, budget, grid_of(wide))
        else:
            advised = shortest(wide, criterion, target, budget, grid_of(wide))
        if uncertainty is None:
            return BestTest(advised, wide, None)
        lines = NO_TEST if advised is None else advised.schedule
        value = criterion.at(replace(wide, over="worst"), lines.information(wide))
        return BestTest(advised, wide, criterion.figure(value.F))
    wide, aim, worst = replace(setup, theta=setup.theta[:1]), target, 0.0
    rounds = 14  # scenarios that the search may add
    close = 1 + 2e-3  # times the variance: a scenario that is worse by less ends it
    for turn in range(rounds):
        if aim is None:
            # Which scenarios matter is found on a grid of fixed frequencies: no need to place them finely yet.
            samples = max(budget.measured(setup.theta.shape[1]), budget.measured(1) / 2)
            grid = replace(grid_of(wide), free=False)
            optimum = optimise(wide, criterion.terms(wide), samples, grid)
            advised, lines, reached = None, optimum.schedule(samples), criterion.figure(optimum.F)
        else:
            advised = shortest(wide, criterion, aim, budget, grid_of(wide))
            lines = NO_TEST if advised is None else advised.schedule
        worst, at = worst_scenario(wide, criterion, lines, uncertainty, seed=turn, mapper=mapper)
        if aim is None or target is None:
            if worst**2 <= reached**2 * close:
                break
        elif worst <= target:
            return BestTest(advised, wide, worst)
        elif advised is not None:
            amount = advised.samples if budget.samples is not None else advised.time_s or 0.0
            budget = budget.of(amount * (worst / target) ** 2)
            if worst <= target * close:
                aim *= 0.999 * target / worst  # a scenario barely worse than those that count already
                continue
        wide = replace(wide, theta=np.concatenate([wide.theta, at[None]]))
    if target is not None:
        raise UsageError(
            "no test was found whose worst case reaches the target",
            cure="assume a smaller uncertainty, or state a number of samples or a time",
        )
    final = plan(wide, criterion, budget, grid_of(wide))  # the last scenario may be new: it counts too
    worst, _ = worst_scenario(wide, criterion, final.schedule, uncertainty, seed=rounds, mapper=mapper)
    return BestTest(final, wide, worst)


def worst_scenario(
    setup: TestSetup,
    criterion: Criterion,
    schedule: Schedule,
    uncertainty: Uncertainty,
    *,
    count: int = 192,
    seed: int = 0,
    mapper: Map = map,
) -> tuple[float, Real]:
    """The worst figure of a test over uncertain values and the θ (unknowns,) at which it occurs.

    Corners and inner points, then ever smaller steps from the worst of them.  The drive is the setup's.
    """
    rng, nominal = random_generator(seed), setup.theta[0]
    measured = len(schedule.samples) > 0
    drive = setup.drive(schedule.frequency_hz, schedule.pattern) if measured else None
    test = _Test(setup, criterion, schedule, drive)
    pool = np.concatenate([setup.theta, uncertainty.draw(nominal, count, rng)])
    if isinstance(uncertainty, GaussianPrior):
        worst, theta = test.worst(pool, mapper)
        return criterion.figure(worst), theta
    width = uncertainty.width(nominal)
    if len(nominal) <= 6:  # unknowns up to which all corners of a box are tried
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(nominal))).reshape(len(nominal), -1).T
        pool = np.concatenate([pool, nominal + width * signs])
    worst, theta = test.worst(pool, mapper)
    for radius in (1.0, 0.5, 0.25, 0.1, 0.04):
        steps = radius * width * rng.uniform(-1, 1, (32, len(nominal)))
        steps *= rng.random((32, len(nominal))) < 0.5
        value, near = test.worst(np.clip(theta + steps, nominal - width, nominal + width), mapper)
        if value > worst:
            worst, theta = value, near
    return criterion.figure(worst), theta


@dataclass(frozen=True)
class _Test:
    """A test that is judged in scenarios: driven as the setup says, whatever θ; without a drive nothing is measured."""

    setup: TestSetup
    criterion: Criterion
    schedule: Schedule
    drive: Complex | None

    def worst(self, theta: Real, mapper: Map) -> tuple[float, Real]:
        """The largest F over θ (scenarios, unknowns), judged in tasks of 16 of them, and where it occurs."""
        values = np.empty(len(theta))
        tasks = ((self, first, theta[first : first + 16]) for first in range(0, len(theta), 16))
        for first, part in mapper(_judge, tasks):
            values[first : first + len(part)] = part
        top = int(np.argmax(values))
        return float(values[top]), theta[top]


def _judge(task: tuple[_Test, int, Real]) -> tuple[int, list[float]]:
    """The place of the first scenario of a task, and F in each."""
    test, first, theta = task
    every = replace(test.setup, theta=theta)
    M = every.prior
    if test.drive is not None:
        each = every.per_sample(test.schedule.frequency_hz, test.drive)
        M = M + np.einsum("i,siab->sab", test.schedule.samples, each)
    terms = test.criterion.terms(replace(every, theta=theta[:1]))
    return first, [terms.at(M[s : s + 1]).F for s in range(len(theta))]
