"""Dwells that crowd around one frequency become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.design.allocation import Allocation, Criterion, expected_precision
from dashpot.design.plan import Budget, DesignProblem, DwellShares, plan
from dashpot.design.test_setup import Schedule, band_grid
from dashpot.estimate.identify import identify
from tests import rigs
from tests.designs import BAND, paper_setup


def test_dwells_that_crowd_are_one() -> None:
    """The optimum is flat: neighbours are joined where that costs less than 1e-4 of the variance, and only there."""
    own, budget = paper_setup(), Budget(samples=1400)
    grid = band_grid(own, *BAND)
    f = np.array([3.79, 3.795, 3.8, 3.81, 9.4, 9.6, 25.0])
    share = np.array([0.05, 0.05, 0.05, 0.03, 0.2, 0.22, 0.4])
    crowd = Allocation(f, np.zeros(7, dtype=int), share, 0.0, 0.0, (f, np.zeros(7, dtype=int), f))
    terms = Criterion("A").terms(own)
    shares = DwellShares(DesignProblem(own, terms, budget, grid), crowd)
    shares.join()
    assert shares.count == 3
    assert np.sum(shares.w) == pytest.approx(1.0)
    before = expected_precision(
        own, Criterion("A"), Schedule(f, np.zeros(7, dtype=int), 1400 * share).information(own)
    ).figure
    after = expected_precision(
        own, Criterion("A"), Schedule(shares.f, shares.k, 1400 * shares.w).information(own)
    ).figure
    assert after <= before * (1 + 5e-5)
    # Two frequencies apart that are both needed stay two, also on a grid of fixed frequencies.
    fixed = band_grid(own, *BAND, 0.25)
    apart = Allocation(
        np.array([3.75, 9.5, 25.0]), np.zeros(3, dtype=int), np.array([0.2, 0.4, 0.4]), 0.0, 0.0,
        (f, np.zeros(7, dtype=int), f),
    )  # fmt: skip
    shares = DwellShares(DesignProblem(own, terms, budget, fixed), apart)
    shares.join()
    assert shares.f.tolist() == [3.75, 9.5, 25.0]


def test_identify_can_use_every_dwell_of_a_small_plan() -> None:
    """As few samples as dwells may have, each over one period."""
    own = paper_setup()
    schedule = plan(own, Criterion("A"), Budget(samples=32), band_grid(own, *BAND)).schedule
    assert np.min(schedule.samples) == 8
    rig = rigs.paper_rig()
    test = replace(
        rig, frequency_hz=schedule.frequency_hz, U=np.ones((len(schedule.samples), 1), dtype=complex),
        f=np.zeros((len(schedule.samples), 0), dtype=complex),
    )  # fmt: skip
    for seed in range(5):
        rng = np.random.default_rng(seed)
        records = [
            rigs.records(test, own.channels, rng, samples=int(samples), relative=0.02)[line]
            for line, samples in enumerate(schedule.samples)
        ]
        estimate = identify(rig.model, spectrum(records))
        assert bool(estimate.converged)
        assert np.all(estimate.sd < 0.5 * rig.theta)
        assert np.all(np.abs(estimate.values - rig.theta) < 6 * estimate.sd)
