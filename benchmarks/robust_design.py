"""Worst case of robust tests against that of nominal ones, ±30 % in every unknown, on random rigs.

`python3 dev.py bench robust_design`, or with `--rigs 50` the number that is claimed.  Both tests are judged by one
search for the worst scenario that neither has seen.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.channel import Quantity
from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, plan
from dashpot.design.robust import UniformBox, best_test, worst_scenario
from dashpot.design.test_setup import (
    FrequencyGrid,
    ShakerLimits,
    TestSetup,
    band_grid,
    natural_band,
    nominal_setup,
)

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the random rigs of the tests
from tests.rigs import channels, random_rig

DOUBT = UniformBox(0.3)
LIMITS = ShakerLimits(stroke=0.01, velocity=0.2, acceleration=10.0)


def random_bench(rng: np.random.Generator) -> TestSetup:
    """One to three coordinates, a base or a force, displacement and acceleration sensors with floor and 5 % noise."""
    n, forces = int(rng.integers(1, 4)), int(rng.integers(0, 2))
    rig = random_rig(rng, n, displacements=1 - forces, forces=forces)
    inputs = {*rig.model.displacement_inputs, *rig.model.force_inputs}
    sensors = [
        c
        if set(c.of) <= inputs
        else replace(c, relative_noise=0.05, noise=1e-4 * (2 * np.pi * 5) ** c.quantity.derivative)
        for c in channels(rig, (Quantity.DISPLACEMENT, Quantity.ACCELERATION))
    ]
    return nominal_setup(rig.model, sensors, rig.theta, limits=LIMITS)


def ratio(own: TestSetup) -> float:
    """Worst relative error of the nominal test over that of the robust one."""
    low, high = natural_band(own)

    def grid_of(wide: TestSetup) -> FrequencyGrid:
        return band_grid(wide, low, high)

    nominal = plan(own, Criterion("A"), Budget(samples=1e4), grid_of(own))
    safe = best_test(own, Criterion("A"), Budget(samples=1e4), DOUBT, grid_of)
    before, after = (
        worst_scenario(safe.setup, Criterion("A"), lines, DOUBT, count=1000, seed=99)[0]
        for lines in (nominal.schedule, safe.plan.schedule)
    )
    return before / after


def main() -> None:
    """Ratios of the worst cases."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rigs", type=int, default=10)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    count, rng = given.rigs, np.random.default_rng(given.seed)
    start = time.perf_counter()
    found = np.array([ratio(random_bench(rng)) for _ in range(count)])
    low, middle, high = np.quantile(found, [0.1, 0.5, 0.9])
    print(f"the robust test's worst case is better on {np.sum(found > 1)} of {count} rigs,", end=" ")
    print(f"by more than 1 % on {np.sum(found > 1.01)}, by more than 10 % on {np.sum(found > 1.1)}")
    print(
        f"worst relative error, nominal over robust: median {middle:.3g}, 80 % between {low:.3g} and {high:.3g}"
    )
    print(f"least {np.min(found):.4g}, most {np.max(found):.3g}; {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
