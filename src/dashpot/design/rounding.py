"""From shares of any size to dwells of whole periods: fewer frequencies, then whole numbers of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.design.allocation import Allocation, clusters, optimise
from dashpot.design.budget import MIN_SAMPLES, Budget
from dashpot.design.criteria import Terms, criterion_value
from dashpot.design.frequency_grid import FrequencyGrid
from dashpot.design.interior_point import optimal_shares
from dashpot.design.schedule import Schedule
from dashpot.design.test_setup import TestSetup

SIMPLER = 1e-4  # of the variance: what it may cost to join dwells that crowd around one frequency
CROWDS = (0.1, 0.03, 0.01, 0.003)  # distances in ln f within which they are joined
FEW = 8  # dwells up to which frequencies shift when one is dropped


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
        periods: Real = np.maximum(np.ceil(long * self.f - 1e-9), 1.0)
        return periods

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
            if self.grid.free and self.grid.high > self.grid.low and self.count <= FEW:
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
