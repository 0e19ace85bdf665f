"""A test that can be run: dwells of whole periods within a budget of samples or of time, and what it will tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.design.allocation import Allocation
from dashpot.design.budget import Budget, require_rate
from dashpot.design.criteria import AOptimal, Criterion, Robustness, Terms
from dashpot.design.frequency_grid import FrequencyGrid
from dashpot.design.precision import ExpectedPrecision, expected_precision
from dashpot.design.rounding import DesignProblem, DwellShares
from dashpot.design.schedule import Dwell, Schedule
from dashpot.design.test_setup import TestSetup
from dashpot.errors import UsageError
from dashpot.io.words import joined


@dataclass(frozen=True)
class Plan:
    """The test: dwells, what they will tell, and how far from the best possible.

    ideal   the figure before rounding, for as much measuring (settling not counted), with shares of any size
    gap     the duality gap of that optimum (the equivalence theorem's certificate)
    loss    what rounding, smallest dwells and a limited number of them cost: figure / ideal − 1
    """

    criterion: Criterion
    dwells: tuple[Dwell, ...]
    schedule: Schedule
    predicted: ExpectedPrecision
    ideal: float
    gap: float
    loss: float
    allocation: Allocation
    notes: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Samples in all."""
        return sum(dwell.samples for dwell in self.dwells)

    @property
    def time_s(self) -> float | None:
        """Time in all, settling included; None where there is no rate."""
        if any(dwell.time_s is None for dwell in self.dwells):
            return None
        return sum((dwell.time_s or 0.0) + dwell.settle_s for dwell in self.dwells)


def plan(
    setup: TestSetup,
    criterion: Criterion,
    budget: Budget,
    grid: FrequencyGrid,
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Plan:
    """The best test within a budget.

    `known` (scenarios, q, q) is information from earlier data, in parts of the setup's sizes, the rig's priors
    included; without it, those priors alone.

    Raises UsageError where the budget holds no test, IdentifiabilityError where no test determines the unknowns.
    """
    require_rate(grid, budget)
    prior = setup.prior if known is None else known
    problem = DesignProblem(setup, criterion.terms(setup, robustness), prior, budget, grid)
    ideal = _continuous(problem)
    if problem.terms.block is None and not np.isfinite(problem.F(_sampled(ideal, budget.measured(1)))):
        # One parameter's best test may leave the others open; a test that identifies must not.
        every = np.mean(AOptimal().terms(setup, robustness).weights, axis=0)
        problem = replace(problem, terms=Terms(problem.terms.weights + 1e-3 * every))
        ideal = _continuous(problem)
    schedule = _rounded(problem, ideal)
    samples = budget.measured(len(schedule.frequency_hz))
    if budget.time is not None and budget.settle > 0:
        # The bound is for as much time of measuring as the plan has.
        ideal = problem.optimum(samples)
    F = problem.F(schedule)
    if grid.free and ideal.F - 1e-9 * abs(ideal.F) > F:
        # Between the points of a coarse grid lies a better test than the search saw: let it see.
        ideal = replace(problem, grid=_with(grid, schedule)).optimum(samples)
    return _assembled(problem, criterion, robustness, ideal, schedule)


def _rounded(problem: DesignProblem, ideal: Allocation) -> Schedule:
    """The best of the roundings to fewer and fewer dwells; stops when fewer stop being better."""
    budget = problem.budget
    best, lowest, worse = None, np.inf, 0
    shares = DwellShares(problem, ideal)
    shares.join()
    for count in range(shares.count, 0, -1):
        shares.thin(count)
        if budget.most is not None and count > budget.most:
            continue
        schedule = shares.rounded()
        F = np.inf if schedule is None else problem.F(schedule)
        if schedule is not None and (best is None or lowest > F):
            best, lowest, worse = schedule, F, 0
        elif best is not None:
            worse += 1
        if best is not None and (worse > 1 or not shares.may_gain(schedule)):
            break
    if best is None or not np.isfinite(lowest):
        raise UsageError(
            "the budget holds no test that determines the unknowns",
            cure="allow more samples, time or frequencies",
        )
    return best


def _continuous(problem: DesignProblem) -> Allocation:
    """The optimum without rounding; settling is counted for as many dwells as it has."""
    budget = problem.budget
    most = 10**6 if budget.most is None else budget.most
    dwells = max(1, min((len(problem.setup.names) + 1) // 2, most))
    for _ in range(4):
        samples = budget.measured(dwells)
        while samples <= 0 and dwells > 1:
            dwells -= 1
            samples = budget.measured(dwells)
        if samples <= 0:
            raise UsageError(
                f"settling alone takes {budget.settle:.3g} s, the whole test",
                cure="allow more time, or state a shorter settling time",
            )
        ideal = problem.optimum(samples)
        count = min(len(ideal.share), most)
        if budget.time is None or budget.settle == 0 or count >= dwells:
            return ideal
        dwells = count
    return ideal


def _with(grid: FrequencyGrid, schedule: Schedule) -> FrequencyGrid:
    """The grid with the frequencies of a test."""
    f, k = (
        np.concatenate([grid.frequency_hz, schedule.frequency_hz]),
        np.concatenate([grid.pattern, schedule.pattern]),
    )
    _, first = np.unique(np.stack([k, f]), axis=1, return_index=True)
    return FrequencyGrid(f[first], k[first], grid.free)


def _sampled(ideal: Allocation, samples: float) -> Schedule:
    """An allocation as a test of so many samples, without what hardly counts."""
    kept = ideal.share > 1e-6
    return Schedule(ideal.frequency_hz[kept], ideal.pattern[kept], samples * ideal.share[kept])


def _assembled(
    problem: DesignProblem,
    criterion: Criterion,
    robustness: Robustness,
    ideal: Allocation,
    schedule: Schedule,
) -> Plan:
    setup = problem.setup
    information = problem.prior + schedule.information(setup)
    predicted = expected_precision(setup, criterion, information, robustness)
    bound = criterion.figure(ideal.F)
    return Plan(
        criterion, _dwells(setup, problem.budget, schedule), schedule, predicted, bound, ideal.gap,
        predicted.figure / bound - 1, ideal, _remarks(setup, schedule),
    )  # fmt: skip


def _dwells(setup: TestSetup, budget: Budget, schedule: Schedule) -> tuple[Dwell, ...]:
    names = [*setup.model.displacement_inputs, *setup.model.force_inputs]
    drive = setup.drive(schedule.frequency_hz, schedule.pattern)
    dwells = []
    for f, count, q in zip(schedule.frequency_hz, schedule.samples, drive, strict=True):
        amplitudes = {name: complex(z) for name, z in zip(names, q, strict=True)}
        periods = time = None
        if budget.rate is not None:
            periods = round((count + 0.5) * f / budget.rate) if count * f / budget.rate >= 1 else 1
            periods = max(periods, math.ceil(count * f / budget.rate - 1e-9))
            time = float(periods / f)
        dwells.append(Dwell(float(f), amplitudes, int(count), periods, time, budget.settle))
    return tuple(dwells)


def _remarks(setup: TestSetup, schedule: Schedule) -> tuple[str, ...]:
    """What the user should know of the sensors at the chosen frequencies of a linear rig."""
    if len(setup.model.nonlinear):
        return ()
    seen = setup.seen(schedule.frequency_hz, schedule.pattern)
    size = np.abs(seen.Y)
    largest = np.max(size, axis=0, initial=0.0)
    still: dict[float, list[str]] = {}
    for i, channel in enumerate(setup.channels):
        faint = (size[:, i] > 0) & (size[:, i] < 1e-3 * largest[i])
        if channel.noise == 0 and channel.relative_noise > 0 and np.any(faint):
            first = float(schedule.frequency_hz[int(np.argmax(faint))])
            still.setdefault(first, []).append(channel.name)
    return tuple(
        f"{joined(names)} hardly {'moves' if len(names) == 1 else 'move'} at {f:.4g} Hz, where noise "
        "stated in per cent alone is next to nothing: state a noise floor as well"
        for f, names in still.items()
    )
