"""Tests that are good although the parameters are uncertain: on average, or in the worst case.

A box θ (1 ± relative), or the normal distribution of an Estimate.  The average is over drawn scenarios.  The worst
case over a box is found by exchange: the best test for a few scenarios, then the scenario that is worst for that
test, until none is worse (Shimizu and Aiyoshi 1980; Pronzato and Walter 1988 for designs).  Any `mapper` judges
scenarios, in tasks of a fixed size, so that the result does not depend on who computes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from dashpot.arrays import Complex, Real, freeze, random_generator
from dashpot.design.allocation import optimise
from dashpot.design.criteria import Criterion, Robustness, criterion_value
from dashpot.design.plan import Plan, plan
from dashpot.design.schedule import ENOUGH, Budget, FrequencyGrid, Schedule
from dashpot.design.test_setup import TestSetup
from dashpot.errors import UsageError
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

# The shortest test that reaches a target.


def shortest(
    setup: TestSetup,
    criterion: Criterion,
    figure: float,
    budget: Budget,
    grid: FrequencyGrid,
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Plan | None:
    """The shortest test whose criterion's figure is at most `figure`; None where what is known suffices already.

    `budget` says what is short (samples or time) and is a first guess of how much.  Raises UsageError where more than
    1e9 would be needed.
    """
    if not (np.isfinite(figure) and figure > 0):
        raise UsageError(
            f"a target of {figure:g}", cure="state a positive fraction of the value, such as 1 %"
        )
    prior = setup.prior if known is None else known
    already = criterion.figure(criterion_value(criterion.terms(setup, robustness), prior).F)
    if already <= figure:
        return None
    search = _Amount(figure, already, budget, counted=budget.samples is not None)
    best: Plan | None = None
    for _ in range(40):
        trial = _planned(setup, criterion, search.budget(), grid, known, robustness)
        reached = None if trial is None else trial.predicted.figure
        if (
            trial is not None
            and trial.predicted.figure <= figure
            and (best is None or _cost(trial) <= _cost(best))
        ):
            best = trial
        if search.ends(reached):
            break
    if best is None:
        raise UsageError("no test in this band reaches the target", cure="ask for less precision")
    return best


class _Amount:
    """How much test to try next: between the largest that was too little and the smallest that sufficed."""

    def __init__(self, figure: float, already: float, budget: Budget, counted: bool) -> None:
        self.figure, self.first, self.counted = figure, budget, counted
        self.known = already**-2 if np.isfinite(already) else 0.0
        self.low, self.high = 0.0, math.inf
        self.amount = float(budget.samples or budget.time or 1.0)

    def budget(self) -> Budget:
        """The budget to try."""
        return self.first.scaled(min(self.amount, ENOUGH) / (self.first.samples or self.first.time or 1.0))

    def ends(self, reached: float | None) -> bool:
        """Learn what that budget reached (None: no test) and move on; whether to stop there.

        Raises UsageError where more than 1e9 would be needed.
        """
        if reached is not None and reached <= self.figure:
            self.high = self.amount
            narrow = max(1.0 if self.counted else 0.0, 2e-3 * self.high)
            if reached > 0.997 * self.figure or self.high - self.low <= narrow:
                return True
        else:
            self.low = self.amount
        if self.low >= ENOUGH:
            unit = "samples" if self.counted else "s"
            raise UsageError(f"the target takes more than {ENOUGH:g} {unit}", cure="ask for less precision")
        guess = 4 * self.amount
        if reached is not None:
            # Information, 1 / variance, grows from what is known about evenly with the test.
            gained = max(reached**-2 - self.known, 1e-300)
            guess = self.amount * (1.001 * self.figure**-2 - self.known) / gained
        if not self.low < guess < self.high:
            guess = (self.low + self.high) / 2 if np.isfinite(self.high) else 2 * self.low
        self.amount = math.ceil(guess) if self.counted else guess
        return self.counted and self.amount >= self.high


def _planned(
    setup: TestSetup,
    criterion: Criterion,
    budget: Budget,
    grid: FrequencyGrid,
    known: Real | None,
    robustness: Robustness,
) -> Plan | None:
    """The best test of that budget; None where it is too small for one."""
    try:
        return plan(setup, criterion, budget, grid, known=known, robustness=robustness)
    except UsageError:
        if budget.settle == 0 and budget.min_dwell == 0 and (budget.samples or budget.time or 0.0) > 1e6:
            raise
        return None


def _cost(trial: Plan) -> float:
    return float(trial.samples) if trial.time_s is None else trial.time_s


CLOSE = 2e-3  # a scenario worse by less than this part of the variance ends the search
SLOW = 64  # scenarios drawn to find the slowest transient
TASK = 16  # scenarios that are judged together
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]

NOTHING = Schedule(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0))  # the test of no dwell


@dataclass(frozen=True)
class UniformBox:
    """Every unknown lies within value · (1 ± relative); relative (unknowns,) or one for all."""

    relative: Real | float
    kind: ClassVar[str] = "box"

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns): a third of them corners."""
        width = self.width(nominal)
        unit = rng.uniform(-1, 1, (count, len(nominal)))
        corners = count // 3
        unit[:corners] = rng.choice([-1.0, 1.0], (corners, len(nominal)))
        return nominal + width * unit

    def width(self, nominal: Real) -> Real:
        """Half the side of the box, (unknowns,), SI units.

        Raises UsageError where the uncertainty is not between 0 and 100 %.
        """
        relative = np.broadcast_to(np.asarray(self.relative, dtype=float), nominal.shape)
        if np.any(~np.isfinite(relative) | (relative < 0) | (relative >= 1)):
            raise UsageError(
                "the uncertainty of a value must lie between 0 and 100 %", cure="state it, for example 30 %"
            )
        return relative * np.abs(nominal)


@dataclass(frozen=True)
class GaussianPrior:
    """The unknowns are normal about their values with this covariance (unknowns, unknowns), SI units."""

    covariance: Real

    def __post_init__(self) -> None:
        freeze(self)

    def draw(self, nominal: Real, count: int, rng: np.random.Generator) -> Real:
        """Scenarios, (count, unknowns), cut at 2.5 standard deviations and at a tenth of the value."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        theta = nominal + np.clip(rng.standard_normal((count, len(nominal))), -2.5, 2.5) @ root.T
        small = theta * np.sign(nominal) < 0.1 * np.abs(nominal)
        return np.where(small, 0.1 * nominal, theta)


def uniform_box_of(model: Model, nominal: Real, relative: float) -> UniformBox:
    """The same uncertainty for every unknown; at most 1.96 sd where the rig file states an sd.

    nominal (unknowns,).
    """
    size = np.where(nominal == 0, 1.0, np.abs(nominal))
    known = np.array([np.inf if u.sd is None else 1.96 * u.sd for u in model.unknowns])
    return UniformBox(np.minimum(relative, known / size))


def gaussian_prior_of(model: Model, estimate: Estimate) -> GaussianPrior:
    """The uncertainty that an estimate leaves in the unknowns of the rig, by their names.

    Raises UsageError where it is of other unknowns, or has no finite covariance.
    """
    names = model.unknown_names
    missing = [name for name in names if name not in estimate.names]
    if missing:
        raise UsageError(
            f"the estimate says nothing about {', '.join(missing)}", cure="give an estimate of this rig"
        )
    i = [estimate.names.index(name) for name in names]
    covariance = estimate.covariance[np.ix_(i, i)]
    if not np.all(np.isfinite(covariance)):
        raise UsageError(
            "the estimate's covariance is not finite", cure="state the uncertainty instead, for example 30 %"
        )
    return GaussianPrior(covariance)


def slowest_settling(setup: TestSetup, prior: UniformBox | GaussianPrior, seed: int = 0) -> float:
    """Settling time of the slowest of several scenarios, s.  Raises UsageError where one never settles."""
    nominal = setup.theta[0]
    drawn = prior.draw(nominal, SLOW, random_generator(seed))
    return setup.with_scenarios(np.concatenate([nominal[None], drawn])).settling()


@dataclass(frozen=True)
class Robust:
    """A plan with the setup of its scenarios, and how bad it may get.

    plan     None where what is known suffices already
    worst    the criterion's figure in the worst scenario that was found
    search   the figures of the worst scenarios on the way
    """

    plan: Plan | None
    setup: TestSetup
    worst: float
    search: tuple[float, ...]


def on_average(
    setup: TestSetup,
    criterion: Criterion,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[TestSetup], FrequencyGrid],
    *,
    target: float | None = None,
    count: int = 32,
    known: Real | None = None,
    seed: int = 0,
) -> Robust:
    """The test with the best mean of the criterion over `count` scenarios; with a target, the shortest that has it.

    `known` is information in SI units (q, q).
    """
    nominal = setup.theta[0]
    theta = np.concatenate([nominal[None], prior.draw(nominal, count, random_generator(seed))])
    wide = setup.with_scenarios(theta)
    already = _prior(wide, known)
    grid = grid_of(wide)
    advised = (
        plan(wide, criterion, budget, grid, known=already, robustness="average")
        if target is None
        else shortest(wide, criterion, target, budget, grid, known=already, robustness="average")
    )
    M = _prior(wide, known)
    at = criterion_value(
        criterion.terms(wide, "worst"), M if advised is None else M + advised.schedule.information(wide)
    )
    return Robust(advised, wide, criterion.figure(at.F), ())


def in_the_worst_case(
    setup: TestSetup,
    criterion: Criterion,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[TestSetup], FrequencyGrid],
    *,
    known: Real | None = None,
    rounds: int = 14,
    seed: int = 0,
    mapper: Map = map,
) -> Robust:
    """The test whose worst scenario is best.  `known` is information in SI units (q, q)."""
    nominal = setup.theta[0]
    theta = nominal[None]
    search: list[float] = []
    samples = max(budget.measured(len(nominal)), budget.measured(1) / 2)
    for turn in range(rounds):
        # Which scenarios matter is found on a grid of fixed frequencies: no need to place them finely yet.
        wide = setup.with_scenarios(theta)
        grid = replace(grid_of(wide), free=False)
        optimum = optimise(
            wide.information, criterion.terms(wide, "worst"), _prior(wide, known), samples, grid
        )
        lines = Schedule(optimum.frequency_hz, optimum.pattern, samples * optimum.share)
        worst, at = worst_scenario(
            wide, criterion, lines, prior, known=known, seed=seed + turn, mapper=mapper
        )
        search.append(worst)
        if worst**2 <= criterion.figure(optimum.F) ** 2 * (1 + CLOSE):
            break
        theta = np.concatenate([theta, at[None]])
    # The last scenario may be new: it counts too.
    wide = setup.with_scenarios(theta)
    already = _prior(wide, known)
    final = plan(wide, criterion, budget, grid_of(wide), known=already, robustness="worst")
    worst, _ = worst_scenario(
        wide, criterion, final.schedule, prior, known=known, seed=seed + rounds, mapper=mapper
    )
    return Robust(final, wide, worst, tuple(search))


def shortest_in_the_worst_case(
    setup: TestSetup,
    criterion: Criterion,
    target: float,
    budget: Budget,
    prior: UniformBox | GaussianPrior,
    grid_of: Callable[[TestSetup], FrequencyGrid],
    *,
    known: Real | None = None,
    rounds: int = 14,
    seed: int = 0,
    mapper: Map = map,
) -> Robust:
    """The shortest test whose worst scenario reaches the target, as far as a search finds it.

    `budget` says what is short (samples or time) and is a first guess; `known` is information in SI units (q, q).
    Raises UsageError where the search for scenarios does not end.
    """
    theta, aim = setup.theta[:1], target
    search: list[float] = []
    for turn in range(rounds):
        wide = setup.with_scenarios(theta)
        already = _prior(wide, known)
        advised = shortest(wide, criterion, aim, budget, grid_of(wide), known=already)
        lines = NOTHING if advised is None else advised.schedule
        worst, at = worst_scenario(
            wide, criterion, lines, prior, known=known, seed=seed + turn, mapper=mapper
        )
        search.append(worst)
        if worst <= target:
            return Robust(advised, wide, worst, tuple(search))
        if advised is not None and worst <= target * (1 + CLOSE):
            aim *= 0.999 * target / worst  # a scenario hardly worse than those that count already
        else:
            theta = np.concatenate([theta, at[None]])
        if advised is not None:
            amount = advised.samples if budget.samples is not None else advised.time_s
            assert amount is not None
            budget = budget.scaled(amount * (worst / target) ** 2 / (budget.samples or budget.time or 1.0))
    raise UsageError(
        "no test was found whose worst case reaches the target",
        cure="assume a smaller uncertainty, or state a number of samples or a time",
    )


def _prior(setup: TestSetup, known: Real | None) -> Real:
    return setup.prior if known is None else setup.known(known)


def worst_scenario(
    setup: TestSetup,
    criterion: Criterion,
    schedule: Schedule,
    prior: UniformBox | GaussianPrior,
    *,
    known: Real | None = None,
    count: int = 192,
    seed: int = 0,
    mapper: Map = map,
) -> tuple[float, Real]:
    """The worst figure of a test over the prior and the θ (unknowns,) at which it occurs.

    Corners and inner points, then ever smaller steps from the worst of them.  The drive is the setup's.
    """
    rng = random_generator(seed)
    nominal = setup.theta[0]
    F = _figures_of(_Judged.of(setup, criterion, schedule, known), mapper)
    pool = np.concatenate([setup.theta, prior.draw(nominal, count, rng)])
    if not isinstance(prior, UniformBox):
        worst, theta = _largest(F, pool)
        return criterion.figure(worst), theta
    width = prior.width(nominal)
    if len(nominal) <= 6:  # unknowns up to which all corners of a box are tried
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(nominal))).reshape(len(nominal), -1).T
        pool = np.concatenate([pool, nominal + width * signs])
    worst, theta = _largest(F, pool)
    for radius in (1.0, 0.5, 0.25, 0.1, 0.04):
        steps = radius * width * rng.uniform(-1, 1, (32, len(nominal)))
        steps *= rng.random((32, len(nominal))) < 0.5
        value, near = _largest(F, np.clip(theta + steps, nominal - width, nominal + width))
        if value > worst:
            worst, theta = value, near
    return criterion.figure(worst), theta


@dataclass(frozen=True)
class _Judged:
    """A test that is judged in scenarios: driven as the setup says, whatever θ; without a drive nothing is measured."""

    setup: TestSetup
    criterion: Criterion
    schedule: Schedule
    known: Real | None
    drive: Complex | None

    @classmethod
    def of(cls, setup: TestSetup, criterion: Criterion, schedule: Schedule, known: Real | None) -> _Judged:
        measured = len(schedule.samples) > 0
        drive = setup.drive(schedule.frequency_hz, schedule.pattern) if measured else None
        return cls(setup, criterion, schedule, known, drive)

    def figures(self, theta: Real) -> Real:
        """F at each of θ (scenarios, unknowns), (scenarios,)."""
        every = self.setup.with_scenarios(theta)
        M = _prior(every, self.known)
        if self.drive is not None:
            each = every.per_sample(self.schedule.frequency_hz, self.drive)
            M = M + np.einsum("i,siab->sab", self.schedule.samples, each)
        values = np.empty(len(theta))
        for s in range(len(theta)):
            alone = every.with_scenarios(theta[s : s + 1])
            values[s] = criterion_value(self.criterion.terms(alone, "worst"), M[s : s + 1]).F
        return values


def _judge(task: tuple[_Judged, int, Real]) -> tuple[int, Real]:
    """A task of `_figures_of`: the place of its first scenario, and F of each."""
    test, first, theta = task
    return first, test.figures(theta)


def _figures_of(test: _Judged, mapper: Map) -> Callable[[Real], Real]:
    """F of a test at each of θ (scenarios, unknowns), (scenarios,)."""

    def F(theta: Real) -> Real:
        values = np.empty(len(theta))
        tasks = ((test, first, theta[first : first + TASK]) for first in range(0, len(theta), TASK))
        for first, part in mapper(_judge, tasks):
            values[first : first + len(part)] = part
        return values

    return F


def _largest(F: Callable[[Real], Real], theta: Real) -> tuple[float, Real]:
    values = F(theta)
    top = int(np.argmax(values))
    return float(values[top]), theta[top]
