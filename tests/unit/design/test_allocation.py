"""Certified optima of the paper's rig and of one parameter alone."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.design.allocation import Criterion, optimise
from dashpot.design.test_setup import FrequencyGrid, band_grid, nominal_setup
from dashpot.errors import IdentifiabilityError
from tests.designs import paper_setup
from tests.rigs import paper_rig


def test_the_gap_bounds_every_other_test() -> None:
    """F − gap lies below any random test; also where the search is stopped far from the optimum."""
    rng = np.random.default_rng(5)
    own = paper_setup()
    terms = Criterion("minimax").terms(own)
    grid = band_grid(own, 0.25, 25)
    found = optimise(own, terms, 1.0, grid)
    M = own.information(grid.frequency_hz, grid.pattern)
    for _ in range(200):
        w = rng.dirichlet(np.full(len(grid.frequency_hz), 0.05))
        assert found.F * (1 - found.gap) - 1e-15 <= terms.at(np.einsum("i,siab->sab", w, M)).F


def test_one_parameter_whose_best_test_leaves_the_others_open() -> None:
    """The search passes by tests that determine too little; the least variance is that of any test's own limit."""
    own = paper_setup()
    grid = band_grid(own, 0.25, 25, 0.25)
    terms = Criterion("D", ("c3",)).terms(own)
    found = optimise(own, terms, 1400, grid)
    alone = optimise(own, Criterion("A", ("c3",)).terms(own), 1400, grid)
    assert found.gap < 1e-6
    assert np.exp(found.F) == pytest.approx(alone.F, rel=1e-6)


def test_the_papers_rig_with_relative_noise() -> None:
    """1,400 samples, 10 %: 0.89 % from about 3.8, 9.5 and 25 Hz (a prototype's figure)."""
    own = paper_setup()
    found = optimise(own, Criterion("A").terms(own), 1400, band_grid(own, 0.25, 25))
    assert np.sqrt(found.F) == pytest.approx(0.0089, abs=1e-5)
    assert found.frequency_hz == pytest.approx([3.8, 9.5, 25.0], rel=0.01)
    assert found.gap < 1e-6


def test_the_papers_rig_with_constant_noise() -> None:
    own = paper_setup(None, 0.0, 0.05, 1.5)
    found = optimise(own, Criterion("A").terms(own), 1400, band_grid(own, 0.25, 25))
    assert np.sqrt(found.F) <= 0.0092
    assert found.gap < 1e-6


def test_each_parameters_own_test_is_best_for_it() -> None:
    own = paper_setup()
    grid = band_grid(own, 0.25, 25)
    together = optimise(own, Criterion("A").terms(own), 1400, grid)
    M = 1400 * np.einsum(
        "i,siab->sab", together.share, own.information(together.frequency_hz, together.pattern)
    )
    spread = np.diagonal(np.linalg.inv(M[0]))
    for j, name in enumerate(own.names):
        alone = optimise(own, Criterion("A", (name,)).terms(own), 1400, grid)
        assert alone.gap < 1e-6
        assert spread[j] > alone.F


def test_a_band_that_tells_too_little() -> None:
    rig = paper_rig()
    own = nominal_setup(
        rig.model, [Channel("x1", {"x1": 1.0}, relative_noise=0.1), Channel("u", {"u": 1.0})], rig.theta
    )
    f = np.array([3.0, 4.0])  # 4 numbers for 6 unknowns
    with pytest.raises(IdentifiabilityError, match="no test in this band"):
        optimise(
            own,
            Criterion("A").terms(own),
            1,
            FrequencyGrid(f, np.zeros(2, dtype=int)),
        )
