"""The shortest test reaches its target, and no shorter one does."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, plan, shortest
from dashpot.design.test_setup import band_grid
from tests.designs import BAND, paper_setup


@pytest.mark.parametrize("target", [0.02, 0.005])
def test_the_shortest_test_just_reaches_its_target(target: float) -> None:
    own = paper_setup()
    grid = band_grid(own, *BAND)
    found = shortest(own, Criterion("minimax"), target, Budget(samples=100), grid)
    assert 0.99 * target < np.max(found.predicted.relative) <= target
    fewer = plan(own, Criterion("minimax"), Budget(samples=round(0.98 * found.samples)), grid)
    assert np.max(fewer.predicted.relative) > target


def test_targets_by_name() -> None:
    own = paper_setup()
    found = shortest(
        own,
        Criterion("minimax", targets={"c2": 0.02, "m1": 0.005}),
        1.0,
        Budget(samples=100),
        band_grid(own, *BAND),
    )
    by_name = dict(zip(found.predicted.names, found.predicted.relative, strict=True))
    assert by_name["c2"] <= 0.02
    assert by_name["m1"] <= 0.005
