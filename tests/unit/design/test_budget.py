"""Budgets that hold no test, or contradict themselves."""

from __future__ import annotations

import pytest

from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, plan
from dashpot.design.test_setup import band_grid
from dashpot.errors import UsageError
from tests.designs import BAND, paper_setup


def test_too_small_a_budget() -> None:
    own = paper_setup()
    grid = band_grid(own, *BAND)
    with pytest.raises(UsageError, match="settling alone"):
        plan(own, Criterion("A"), Budget(time=1, rate=100, settle=2), grid)
    with pytest.raises(UsageError, match="holds no test"):
        plan(own, Criterion("A"), Budget(samples=3), grid)
    with pytest.raises(UsageError, match="sampling rate"):
        plan(own, Criterion("A"), Budget(samples=300, rate=30), grid)
    with pytest.raises(UsageError, match="needs the sampling rate"):
        Budget(time=10)
    with pytest.raises(UsageError, match="a number of samples or a time"):
        Budget()
