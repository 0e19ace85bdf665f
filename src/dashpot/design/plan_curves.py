"""What a plan rests on, over the band: the directional derivative, and what each frequency says of each parameter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.design.criteria import Criterion
from dashpot.design.frequency_grid import band_grid
from dashpot.design.plan import Plan
from dashpot.design.precision import information_gain
from dashpot.design.test_setup import TestSetup

MOST_CURVES = 4
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
    patterns = np.unique(pattern)[:MOST_CURVES]
    curves = [np.interp(f, at[pattern == k], derivative[pattern == k]) for k in patterns]
    driven = [
        information_gain(setup, criterion, plan.schedule, known, f, np.full(len(f), k, dtype=np.int64))
        for k in np.unique(plan.schedule.pattern).tolist()
    ]
    return PlanCurves(f, patterns, np.array(curves), np.max(driven, axis=0))
