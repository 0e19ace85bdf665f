"""A test that can be run: dwells of whole periods within a budget of samples or of time, and what it will tell."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.design.allocation import Allocation, clusters, optimal_shares, optimise
from dashpot.design.criteria import (
    AOptimal,
    Criterion,
    ExpectedPrecision,
    Robustness,
    Terms,
    criterion_value,
    expected_precision,
    information_gain,
)
from dashpot.design.schedule import (
    MIN_SAMPLES,
    Budget,
    Dwell,
    FrequencyGrid,
    Schedule,
    band_grid,
    require_rate,
)
from dashpot.design.test_setup import TestSetup
from dashpot.errors import UsageError
from dashpot.io.words import joined

# From shares of any size to dwells of whole periods: fewer frequencies, then whole numbers of samples.


SIMPLER = 1e-4  # of the variance: what it may cost to join dwells that crowd around one frequency
CROWDS = (0.1, 0.03, 0.01, 0.003)  # distances in ln f within which they are joined


@dataclass(frozen=True)
class DesignProblem:
    """What a test is to be good for, on what setup, within which budget and band; `prior` (scenarios, q, q)."""

    setup: TestSetup
    terms: Terms
    prior: Real
    budget: Budget
    grid: FrequencyGrid

    def F(self, schedule: Schedule) -> float:
        """The criterion of a test beside what is known."""
        return criterion_value(self.terms, self.prior + schedule.information(self.setup)).F

    def optimum(self, samples: float) -> Allocation:
        """The best shares of so many samples.  Raises IdentifiabilityError where none determine the unknowns."""
        return optimise(self.setup.information, self.terms, self.prior, samples, self.grid)


class DwellShares:
    """Shares of a test that lose frequencies one by one, and their rounding to whole periods."""

    def __init__(self, problem: DesignProblem, ideal: Allocation) -> None:
        self.setup, self.terms, self.prior = problem.setup, problem.terms, problem.prior
        self.budget, self.grid = problem.budget, problem.grid
        kept = ideal.share > 1e-6
        self.f, self.k = ideal.frequency_hz[kept].copy(), ideal.pattern[kept].copy()
        self.w = ideal.share[kept] / np.sum(ideal.share[kept])

    @property
    def count(self) -> int:
        """Number of dwells."""
        """Number of dwells."""
        """Number of dwells."""
        return len(self.f)

    def may_gain(self, schedule: Schedule | None) -> bool:
        """Whether fewer dwells could be better: settling costs time, or some dwell is shorter than is allowed."""
        if schedule is None or (self.budget.time is not None and self.budget.settle > 0):
            return True
        samples = max(self.budget.measured(self.count), 1.0)
        return bool(np.any(self.w * samples < self._least()))

    def join(self) -> None:
        """One dwell for those that crowd around a frequency, where that costs next to nothing.

        The optimum is flat there, and what finds it spreads the time over neighbours.
        """
        samples = max(self.budget.measured(self.count), self.budget.measured(0) / 2)
        before = self.f, self.k, self.w
        now = self._F(samples)
        for width in CROWDS:
            self.f, self.k, self.w = clusters(*before, width, self.grid.free)
            if self.count == len(before[0]):
                return
            self._improve(samples)
            slack = SIMPLER * (1.0 if self.terms.block is not None else now)
            if self._F(samples) <= now + slack:
                return
        self.f, self.k, self.w = before

    def _F(self, samples: float) -> float:
        M = self.setup.information(self.f, self.k)
        return criterion_value(self.terms, self.prior + samples * np.einsum("i,siab->sab", self.w, M)).F

    def _least(self) -> Real:
        """Fewest samples of each dwell."""
        least = np.full(self.count, float(MIN_SAMPLES))
        if self.budget.rate is not None:
            least = np.floor(self._least_periods() * self.budget.rate / self.f + 1e-9)
        return least

    def _least_periods(self) -> Real:
        rate = self.budget.rate
        assert rate is not None
        long = np.maximum(self.budget.min_dwell, MIN_SAMPLES / rate)
        return np.maximum(np.ceil(long * self.f - 1e-9), 1.0)

    def thin(self, count: int) -> None:
        """Down to `count` frequencies: drop those that cost least, then shift the others."""
        if count >= self.count:
            return
        samples = self.budget.measured(count)
        if samples <= 0:
            samples = self.budget.measured(0)
        while self.count > count:
            M = samples * self.setup.information(self.f, self.k)
            tries = []
            for out in range(self.count):
                rest = np.delete(np.arange(self.count), out)
                w = self.w[rest] / np.sum(self.w[rest])
                tries.append(
                    criterion_value(self.terms, self.prior + np.einsum("i,siab->sab", w, M[:, rest])).F
                )
            rest = np.delete(np.arange(self.count), int(np.argmin(tries)))
            self.f, self.k, self.w = self.f[rest], self.k[rest], self.w[rest] / np.sum(self.w[rest])
        self._improve(samples)

    def _improve(self, samples: float) -> None:
        """Shares and frequencies in turn, each frequency by zooming in on the best of several places."""
        last = np.inf
        for _ in range(8):
            M = samples * self.setup.information(self.f, self.k)
            if not np.isfinite(criterion_value(self.terms, self.prior + np.mean(M, axis=1)).F):
                return
            self.w = optimal_shares(self.terms, self.prior, M).w
            # With many dwells left each matters little: their shares make up for the one that went.
            # dwells up to which frequencies shift when one is dropped
            if self.grid.free and self.grid.high > self.grid.low and self.count <= 8:
                for i in range(self.count):
                    M = self._shift(i, M, samples)
            F = criterion_value(self.terms, self.prior + np.einsum("i,siab->sab", self.w, M)).F
            gain = last - F if self.terms.block is not None else (last - F) / F
            if gain < 1e-6:
                return
            last = F

    def _shift(self, i: int, M: Real, samples: float) -> Real:
        rest = self.prior + np.einsum("i,siab->sab", np.delete(self.w, i), np.delete(M, i, axis=1))
        low, high, places = self.grid.low, self.grid.high, 33
        best, lowest = M[:, i], criterion_value(self.terms, rest + self.w[i] * M[:, i]).F
        for _ in range(4):
            f = np.geomspace(low, high, places)
            moved = samples * self.setup.information(f, np.full(places, self.k[i]))
            F = np.array(
                [criterion_value(self.terms, rest + self.w[i] * moved[:, j]).F for j in range(places)]
            )
            top = int(np.argmin(F))
            if F[top] < lowest:
                self.f[i], best, lowest = f[top], moved[:, top], F[top]
            low, high, places = f[max(top - 1, 0)], f[min(top + 1, places - 1)], 9
        M = M.copy()
        M[:, i] = best
        return M

    def rounded(self) -> Schedule | None:
        """Whole periods (samples where there is no rate) within the budget; None where they do not fit."""
        rate = self.budget.rate
        if self.grid.free:
            f = np.array([float(f"{f:.6g}") for f in self.f])  # what a controller can be told
            self.f = np.clip(f, self.grid.low, self.grid.high)
        order = np.lexsort((self.f, self.k))
        self.f, self.k, self.w = self.f[order], self.k[order], self.w[order]
        total = self.budget.measured(self.count)
        # In samples of measuring time; a dwell's own samples are the whole ones among them.
        unit = np.ones(self.count) if rate is None else rate / self.f
        least = self._least() if rate is None else self._least_periods()
        units = self._cut(total, unit, least)
        if units is None:
            return None
        units = self._filled(total, unit, units)
        return Schedule(self.f, self.k, np.floor(units * unit + 1e-9))

    def _cut(self, total: float, unit: Real, least: Real) -> Real | None:
        """Whole units of each dwell, at most its share and at least `least`; None where these do not fit."""
        ideal = self.w * total
        units = np.maximum(np.floor(ideal / unit + 1e-9), least)
        while np.sum(units * unit) > total * (1 + 1e-12):
            spare = units > least
            if not np.any(spare):
                return None
            over = np.where(spare, units * unit / np.maximum(ideal, 1e-300), -np.inf)
            i = int(np.argmax(over))
            units[i] -= max(1.0, min(units[i] - least[i], np.floor((np.sum(units * unit) - total) / unit[i])))
        return units

    def _filled(self, total: float, unit: Real, units: Real) -> Real:
        """What the rounding left over, given to the dwells that gain most from it."""
        each = self.setup.information(self.f, self.k)
        for _ in range(4 * self.count):
            left = total * (1 + 1e-12) - np.sum(units * unit)
            fits = np.flatnonzero(unit <= left)
            if len(fits) == 0:
                break
            M = self.prior + np.einsum("i,siab->sab", np.floor(units * unit + 1e-9), each)
            F = [criterion_value(self.terms, M + unit[i] * each[:, i]).F for i in fits]
            now = criterion_value(self.terms, M).F
            # What is won for what it takes.
            gain = [(now - F[j]) / unit[i] if np.isfinite(now) else -F[j] for j, i in enumerate(fits)]
            units[fits[int(np.argmax(gain))]] += 1
        return units


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


# What a plan rests on, over the band: the directional derivative, and what each frequency says of each
# parameter.


MOST_POINTS = 400  # of the frequency axis


@dataclass(frozen=True)
class PlanCurves:
    """Curves of a plan over the band.

    frequency_hz  (points,)
    patterns      (curves,)              pattern of the drive of each curve
    derivative    (curves, points)       directional derivative over its mean: 1 where time is spent
    gain          (points, parameters)   what a sample adds to each parameter, best of the plan's patterns; 1 is what
                                         its average sample adds
    """

    frequency_hz: Real
    patterns: Ints
    derivative: Real
    gain: Real


def plan_curves(
    setup: TestSetup, criterion: Criterion, plan: Plan, known: Real, low: float, high: float
) -> PlanCurves:
    """Curves between `low` and `high` (Hz); known (scenarios, q, q) is the information before the test."""
    grid = band_grid(setup, low, high)
    f = grid.frequency_hz[grid.pattern == 0]
    if len(f) > MOST_POINTS:
        f = f[:: int(np.ceil(len(f) / MOST_POINTS))]
    at, pattern, derivative = plan.allocation.curve
    patterns = np.unique(pattern)[:4]
    curves = [np.interp(f, at[pattern == k], derivative[pattern == k]) for k in patterns]
    driven = [
        information_gain(setup, criterion, plan.schedule, known, f, np.full(len(f), k, dtype=np.int64))
        for k in np.unique(plan.schedule.pattern).tolist()
    ]
    return PlanCurves(f, patterns, np.array(curves), np.max(driven, axis=0))
