"""Shares against brute force, and among equal columns."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dashpot.design.allocation import Criterion, optimal_shares, optimise
from dashpot.design.test_setup import FrequencyGrid
from tests.designs import random_information, setup_in_scenarios


@pytest.mark.parametrize("criterion", [Criterion("A"), Criterion("minimax"), Criterion("D")], ids=str)
@pytest.mark.parametrize("robustness", ["average", "worst"])
def test_brute_force_on_small_grids(criterion: Criterion, robustness: str) -> None:
    """No split of 20 parts over four frequencies beats the programme, and the best of them comes near."""
    own = replace(setup_in_scenarios(2), over=robustness)
    terms = criterion.terms(own)
    f = np.array([2.0, 4.0, 9.5, 20.0])
    M = own.information(f, np.zeros(4, dtype=int))
    found = optimise(own, terms, 1.0, FrequencyGrid(f, np.zeros(4, dtype=int), free=False))
    parts = 20
    splits = [s for s in product(range(parts + 1), repeat=3) if sum(s) <= parts]
    best = min(
        terms.at(np.einsum("i,siab->sab", np.array([*s, parts - sum(s)]) / parts, M)).F for s in splits
    )
    slack = 1e-7 * (1 if terms.block is not None else best)
    assert best + slack >= found.F
    assert best - found.F < 0.03 * (1 if terms.block is not None else best)
    assert found.gap < 1e-6


def test_a_crowd_of_equal_columns_is_no_trouble() -> None:
    rng = np.random.default_rng(2)
    own = setup_in_scenarios(1)
    M = np.repeat(random_information(rng, 8, 6, 1), 5, axis=1)
    found = optimal_shares(Criterion("A").terms(own), np.zeros((1, 6, 6)), M)
    alone = optimal_shares(Criterion("A").terms(own), np.zeros((1, 6, 6)), M[:, ::5])
    assert pytest.approx(alone.F, rel=1e-7) == found.F
    assert np.sum(found.w) == pytest.approx(1.0)
