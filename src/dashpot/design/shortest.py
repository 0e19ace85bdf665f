"""The shortest test that reaches a target."""

from __future__ import annotations

import math

import numpy as np

from dashpot.arrays import Real
from dashpot.design.budget import ENOUGH, Budget
from dashpot.design.criteria import Criterion, Robustness, criterion_value
from dashpot.design.frequency_grid import FrequencyGrid
from dashpot.design.plan import Plan, plan
from dashpot.design.test_setup import TestSetup
from dashpot.errors import UsageError


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
