"""The best and the shortest test within a budget: samples spent, time kept, dwells rounded, what is known counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.design.allocation import Allocation, Criterion, expected_precision
from dashpot.design.plan import Budget, DesignProblem, DwellShares, plan, shortest
from dashpot.design.stopping import after, values_after
from dashpot.design.test_setup import Schedule, band_grid, nominal_setup
from dashpot.estimate.identify import identify
from tests import rigs
from tests.designs import BAND, measured, paper_setup
from tests.rigs import paper_rig


def test_time_counts_settling_and_whole_periods() -> None:
    own = paper_setup()
    budget = Budget(time=30, rate=100, settle=own.settling(), min_dwell=2.0)
    found = plan(own, Criterion("A"), budget, band_grid(own, *BAND))
    assert found.time_s is not None
    assert 29 < found.time_s <= 30
    for dwell in found.dwells:
        assert dwell.time_s is not None
        assert dwell.time_s >= 2.0
        assert dwell.time_s * dwell.frequency_hz == pytest.approx(dwell.periods, abs=1e-9)
        assert dwell.samples == int(dwell.time_s * 100 + 1e-9)


@pytest.mark.slow
def test_long_settling_and_few_dwells() -> None:
    """With settling of a third of the time fewer dwells are better; never more than are allowed."""
    own, grid = paper_setup(), band_grid(paper_setup(), *BAND)
    free = plan(own, Criterion("A"), Budget(time=60, rate=100, settle=0.1), grid)
    slow = plan(own, Criterion("A"), Budget(time=60, rate=100, settle=20.0), grid)
    assert len(slow.dwells) < len(free.dwells)
    two = plan(own, Criterion("A"), Budget(samples=1400, most=2), grid)
    assert len(two.dwells) == 2
    # No pair of frequencies of a grid with any split does better.
    f = np.geomspace(*BAND, 25)
    M = own.information(f, np.zeros(25, dtype=int))[0]
    best = np.inf
    for i in range(25):
        for j in range(i):
            for part in np.linspace(0.2, 0.8, 13):
                C = np.linalg.inv(1400 * (part * M[i] + (1 - part) * M[j]))
                best = min(best, float(np.trace(C)) / 6)
    assert two.predicted.figure <= np.sqrt(best) * 1.001


@pytest.mark.parametrize(
    ("name", "percent"),
    [("m1", 0.534), ("m2", 0.579), ("c1", 0.950), ("c2", 0.902), ("c3", 0.421), ("c4", 1.161)],
)
def test_the_best_test_for_each_parameter(name: str, percent: float) -> None:
    """What examples/06_design says; no test of three dwells drawn at random does better."""
    own = paper_setup()
    found = plan(own, Criterion("A", (name,)), Budget(samples=1400), band_grid(own, *BAND))
    assert found.gap < 1e-6
    assert 100 * found.predicted.figure == pytest.approx(percent, abs=1e-3)
    rng = np.random.default_rng(0)
    f = np.exp(rng.uniform(*np.log(BAND), (300, 3)))
    w = rng.dirichlet(np.ones(3), 300)
    M = own.information(f.ravel(), np.zeros(900, dtype=int))[0].reshape(300, 3, 6, 6)
    C = np.linalg.inv(1400 * np.einsum("ti,tiab->tab", w, M))
    j = own.names.index(name)
    assert np.min(C[:, j, j]) >= found.predicted.figure**2


def test_existing_data_count() -> None:
    """Information of earlier data is added: the rest of a test knows what its beginning has told."""
    own = paper_setup()
    estimate = identify(own.model, measured(own))
    here = nominal_setup(own.model, own.channels, values_after(own.model, estimate))
    known = after(here, estimate)
    before = expected_precision(known, Criterion("A"), 0.0)
    assert np.allclose(before.sd, estimate.sd, rtol=1e-6)
    found = plan(known, Criterion("A"), Budget(samples=700), band_grid(here, *BAND))
    alone = plan(here, Criterion("A"), Budget(samples=700), band_grid(here, *BAND))
    assert found.predicted.figure < min(before.figure, alone.predicted.figure)
    assert found.gap < 1e-6


def test_known_with_an_sd_is_known() -> None:
    """A prior so tight that nothing is left to find costs no samples."""
    rig = paper_rig()
    tight = rig.knowing({"m2": {"value": 2.7, "sd": 1e-6}})
    own = nominal_setup(tight.model, paper_setup().channels, tight.theta)
    found = plan(own, Criterion("A"), Budget(samples=1400), band_grid(own, *BAND))
    assert found.predicted.sd[found.predicted.names.index("m2")] == pytest.approx(1e-6, rel=1e-3)
    free = plan(
        paper_setup(),
        Criterion("A", ("m1", "c1", "c2", "c3", "c4")),
        Budget(samples=1400),
        band_grid(own, *BAND),
    )
    assert found.predicted.figure < free.predicted.figure


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
        np.array([3.75, 9.5, 25.0]),
        np.zeros(3, dtype=int),
        np.array([0.2, 0.4, 0.4]),
        0.0,
        0.0,
        (f, np.zeros(7, dtype=int), f),
    )
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
        rig,
        frequency_hz=schedule.frequency_hz,
        U=np.ones((len(schedule.samples), 1), dtype=complex),
        f=np.zeros((len(schedule.samples), 0), dtype=complex),
    )
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


@pytest.mark.parametrize("target", [0.02, 0.005])
def test_the_shortest_test_just_reaches_its_target(target: float) -> None:
    own = paper_setup()
    grid = band_grid(own, *BAND)
    found = shortest(own, Criterion("minimax"), target, Budget(samples=100), grid)
    assert 0.99 * target < np.max(found.predicted.relative) <= target
    fewer = plan(own, Criterion("minimax"), Budget(samples=round(0.98 * found.samples)), grid)
    assert np.max(fewer.predicted.relative) > target
