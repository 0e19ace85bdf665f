"""What stands out in a fleet: limits hold for whole fleets, and what is planted is found."""

import numpy as np
import pytest

from dashpot.fleet.pooling import survey, usual


@pytest.mark.parametrize("rigs", [8, 40, 500])
def test_fleets_alike_show_something_in_one_of_twenty(rigs: int) -> None:
    """300 fleets of three parameters: outliers and drift in at most 5 %, to 3.3 standard errors; seed 3."""
    rng = np.random.default_rng(3)
    outliers = drifts = 0
    names = ("m", "c", "k")
    for _ in range(300):
        sds = {name: 10 ** rng.uniform(-0.5, 0.5, rigs) for name in names}
        spread = rng.choice([0.0, 1.0, 5.0])
        values = {name: 7 + np.hypot(spread, sds[name]) * rng.standard_normal(rigs) for name in names}
        found = survey(names, ("kg", "N·s/m", "N/m"), values, sds)
        outliers += any(one.outlier.any() for one in found)
        drifts += any(one.drifts for one in found)
    most = 0.05 + 3.3 * np.sqrt(0.05 * 0.95 / 300)
    assert outliers / 300 < most
    assert 0.005 < drifts / 300 < most


def test_planted_outliers_and_drift_are_named() -> None:
    rng = np.random.default_rng(5)
    sd = np.full(60, 0.1)
    values = 10 + 0.3 * rng.standard_normal(60) + 0.1 * rng.standard_normal(60)
    values[[7, 41]] += [3.0, -2.5]
    found = usual("k", "N/m", values, sd)
    assert list(np.flatnonzero(found.outlier)) == [7, 41]
    assert found.z[7] > found.limit
    assert found.spread == pytest.approx(0.3, rel=0.2)
    assert not found.drifts
    drifting = usual("k", "N/m", values + np.linspace(0, 1, 60), sd)
    assert drifting.drifts
    assert abs(drifting.slope - 1) < 3 * drifting.slope_sd


def test_a_rig_measured_badly_is_no_outlier() -> None:
    rng = np.random.default_rng(6)
    values, sd = 10 + 0.1 * rng.standard_normal(30), np.full(30, 0.1)
    values[3], sd[3] = 13.0, 2.0
    found = usual("k", "N/m", values, sd)
    assert not found.outlier[3]
    sd[3] = 0.1
    assert usual("k", "N/m", values, sd).outlier[3]


def test_of_few_rigs_nothing_is_said() -> None:
    values = np.array([1.0, np.nan, 2.0, 1.0, 100.0, 1.0])
    found = usual("k", "N/m", values, np.ones(6))
    assert found.count == 5
    assert not found.outlier.any()
    assert not found.drifts
    assert np.isnan(found.spread)


def test_values_that_are_all_the_same_drift_nowhere() -> None:
    found = usual("k", "N/m", np.full(10, 3.0), np.full(10, 1e-9))
    assert (found.slope, found.drift_p) == (0.0, 1.0)
    assert not found.outlier.any()
