"""Tests for uncertain values: on average, in the worst case, as short as can be."""

from __future__ import annotations

import pickle
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, plan, shortest
from dashpot.design.robust import (
    GaussianPrior,
    UniformBox,
    best_test,
    slowest_settling,
    uniform_box_of,
    worst_scenario,
)
from dashpot.design.stopping import gaussian_prior_of
from dashpot.design.test_setup import TestSetup, band_grid
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from tests.designs import BAND, measured, paper_setup
from tests.rigs import paper_rig


def replace_names(estimate: Estimate) -> Estimate:
    """An estimate of somebody else's unknowns."""
    return replace(estimate, names=tuple(f"other {name}" for name in estimate.names))


def test_the_worst_case_is_the_same_whoever_searches_for_it() -> None:
    """Scenarios sent in pieces, as to other processes, and coming back in another order."""
    own = paper_setup()
    lines = plan(own, Criterion("A"), Budget(samples=1400), band_grid(own, *BAND)).schedule

    def elsewhere(function: Any, tasks: Iterable[Any]) -> list[Any]:
        sent = [pickle.loads(pickle.dumps((function, task))) for task in tasks]
        return [there(task) for there, task in reversed(sent)]

    aim = Criterion("minimax", targets={"c2": 0.02, "m1": 0.01})
    for prior in (UniformBox(0.3), GaussianPrior(np.diag((0.1 * own.theta[0]) ** 2))):
        here = worst_scenario(own, aim, lines, prior, seed=3)
        there = worst_scenario(own, aim, lines, prior, seed=3, mapper=elsewhere)
        assert here[0] == there[0]
        np.testing.assert_array_equal(here[1], there[1])


@pytest.mark.slow
def test_robust_tests() -> None:
    own = paper_setup()

    def grid_of(wide: TestSetup):  # type: ignore[no-untyped-def]
        return band_grid(wide, *BAND)

    nominal = plan(own, Criterion("A"), Budget(samples=1400), grid_of(own))
    box = UniformBox(0.3)
    before, at = worst_scenario(own, Criterion("A"), nominal.schedule, box)
    assert np.all(np.abs(at / own.theta[0] - 1) <= 0.3 + 1e-12)
    safe = best_test(own, Criterion("A"), Budget(samples=1400), box, grid_of)
    assert safe.worst < before
    assert safe.plan.gap < 1e-6
    after, _ = worst_scenario(own, Criterion("A"), safe.plan.schedule, box, count=2000, seed=9)
    assert after <= safe.worst * 1.005
    calm = best_test(
        replace(own, over="average"),
        Criterion("A"),
        Budget(samples=1400),
        GaussianPrior(np.diag((0.1 * own.theta[0]) ** 2)),
        grid_of,
    )
    assert calm.plan.gap < 1e-6
    with pytest.raises(UsageError, match="between 0 and 100"):
        best_test(own, Criterion("A"), Budget(samples=1400), UniformBox(1.5), grid_of)


@pytest.mark.slow
def test_the_shortest_robust_test() -> None:
    """Its worst case just reaches the target; the nominal test's does not; nothing to do where enough is known."""
    own = paper_setup()

    def grid_of(wide: TestSetup):  # type: ignore[no-untyped-def]
        return band_grid(wide, *BAND)

    box, budget = UniformBox(0.2), Budget(samples=1000)
    nominal = shortest(own, Criterion("A"), 0.02, budget, grid_of(own))
    safe = best_test(own, Criterion("A"), budget, box, grid_of, target=0.02)
    calm = best_test(replace(own, over="average"), Criterion("A"), budget, box, grid_of, target=0.02)
    assert nominal.samples < calm.plan.samples < safe.plan.samples
    assert safe.worst <= 0.02
    after, _ = worst_scenario(own, Criterion("A"), safe.plan.schedule, box, count=1000, seed=9)
    assert 0.0195 < after < 0.02 * 1.003
    assert worst_scenario(own, Criterion("A"), nominal.schedule, box)[0] > 0.021
    known = replace(own, earlier=np.diag((1e-3 * own.theta[0]) ** -2.0))
    assert best_test(known, Criterion("A"), budget, box, grid_of, target=0.02).plan is None


def test_doubts_of_the_rig_file_and_of_an_estimate() -> None:
    """A part of every value, less where an sd is stated; an estimate's covariance without its calibrations."""
    rig = paper_rig()
    known = rig.knowing({"m2": {"value": 2.7, "sd": 0.027}})
    box = uniform_box_of(known.model, known.theta, 0.3)
    names = [u.name for u in known.model.unknowns]
    wide = dict(zip(names, np.broadcast_to(box.relative, len(names)), strict=True))
    assert wide.pop("m2") == pytest.approx(0.0196)
    assert set(wide.values()) == {0.3}
    own = paper_setup()
    loose = tuple(replace(c, gain=None) if c.name == "dx1" else c for c in own.channels)
    data = replace(measured(own), channels=loose)
    estimate = identify(own.model, data)
    assert estimate.covariance.shape == (7, 7)
    cloud = gaussian_prior_of(own.model, estimate)
    assert np.allclose(cloud.covariance, estimate.covariance[:6, :6])
    drawn = cloud.draw(own.theta[0], 4000, np.random.default_rng(0))
    # Cut at 2.5 sd, a normal keeps 0.97 of its spread; 4,000 draws know it to 1.1 % (1 sd).
    assert np.std(drawn, axis=0) == pytest.approx(0.98 * estimate.sd[:6], rel=0.05)
    with pytest.raises(UsageError, match="contains nothing about"):
        gaussian_prior_of(rig.model, replace_names(estimate))


def test_settling_of_the_slowest_rig_of_a_doubt() -> None:
    """Masses 30 % heavier behind dampers 30 % weaker settle 1.86 times as slowly; 64 draws come near."""
    own = paper_setup()
    assert 1.3 * own.settling() < slowest_settling(own, UniformBox(0.3)) <= 1.9 * own.settling()
    assert slowest_settling(own, UniformBox(0.0)) == pytest.approx(own.settling())
