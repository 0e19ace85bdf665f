"""Partial pooling: the textbook's formulas, and intervals that hold the truth as often as they say."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from dashpot.fleet.pooling import pooled, restricted_likelihood

# Eight schools (Rubin 1981; Gelman et al., Bayesian Data Analysis, table 5.2): effects and their standard errors.
EFFECTS = np.array([28.0, 8.0, -3.0, 7.0, -1.0, 1.0, 18.0, 12.0])
ERRORS = np.array([15.0, 10.0, 16.0, 11.0, 9.0, 11.0, 10.0, 18.0])


def test_eight_schools() -> None:
    """BDA 5.5: REML finds no spread; effects are drawn to about 8, and not all the way."""
    found = pooled("effect", "1", EFFECTS, ERRORS)
    assert found.spread == pytest.approx(0.0, abs=1e-6)
    assert found.mean == pytest.approx(8.0, abs=0.2)
    assert found.mean_sd > 1 / np.sqrt(np.sum(ERRORS**-2.0))  # 4.07, which takes the spread of 0 as known
    # Each between complete pooling and none; a school's own precision decides (the mean is rounded beside school 2).
    others = np.arange(8) != 1
    share = (found.values - found.mean)[others] / (EFFECTS - found.mean)[others]
    assert np.all((share > 0.2) & (share < 0.6))
    assert np.corrcoef(share, ERRORS[others])[0, 1] < -0.95
    assert int(np.argmax(found.values)) == 0


def test_equal_errors_give_the_closed_form() -> None:
    """With equal s, REML is τ² = var(θ̂) − s² exactly, and μ their plain mean."""
    rng = np.random.default_rng(1)
    y = 5 + rng.normal(0, 2, 40)
    found = pooled("k", "N/m", y, np.ones(40))
    assert found.spread == pytest.approx(np.sqrt(np.var(y, ddof=1) - 1), rel=1e-6)
    assert found.mean == pytest.approx(np.mean(y), rel=1e-12)


def test_the_restricted_likelihood_is_that_of_contrasts() -> None:
    """Up to a constant it is the likelihood of the contrasts of the data, computed the long way."""
    rng = np.random.default_rng(2)
    y, s = rng.normal(0, 2, 7), rng.uniform(0.5, 2, 7)
    contrasts = np.linalg.qr(np.ones((7, 1)), mode="complete")[0][:, 1:].T

    def direct(tau: float) -> float:
        V = contrasts @ np.diag(s**2 + tau**2) @ contrasts.T
        z = contrasts @ y
        return float(-0.5 * (np.linalg.slogdet(V)[1] + z @ np.linalg.solve(V, z)))

    taus = np.array([0.0, 0.3, 1.0, 4.0])
    away = restricted_likelihood(y, s, taus) - [direct(tau) for tau in taus]
    assert np.ptp(away) < 1e-12
    best = minimize_scalar(
        lambda tau: -direct(tau), bounds=(0, 20), method="bounded", options={"xatol": 1e-10}
    )
    found = pooled("k", "1", y, s)
    assert found.spread == pytest.approx(best.x, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rigs", "spread"), [(6, 1.0), (30, 0.0), pytest.param(30, 1.0, marks=pytest.mark.long), (30, 4.0)]
)
def test_intervals_hold_the_truth(rigs: int, spread: float) -> None:
    """150 fleets, seed 4: pooled intervals hold 95 % (92 % at least: τ is known from few rigs), closer than alone.

    Where the spread is large, errors have the size that is stated, to 3.3 standard errors of their squares.
    """
    rng = np.random.default_rng(4)
    inside, squares, alone, means, sizes = [], [], [], [], []
    for _ in range(150):
        s = 10 ** rng.uniform(-0.2, 0.2, rigs)
        truth = 5 + spread * rng.standard_normal(rigs)
        y = truth + s * rng.standard_normal(rigs)
        found = pooled("k", "N/m", y, s)
        inside.append(np.mean((found.lower <= truth) & (truth <= found.upper)))
        squares.append(np.mean((found.values - truth) ** 2))
        alone.append(np.mean((y - truth) ** 2))
        means.append(abs(found.mean - 5) < 1.96 * found.mean_sd)
        sizes.append(np.mean(((found.values - truth) / found.sd) ** 2))
    assert np.mean(inside) > 0.92
    assert np.mean(squares) < np.mean(alone)
    assert np.mean(means) > 0.9
    if spread > 1:
        assert np.mean(sizes) == pytest.approx(1, abs=3.3 * np.sqrt(2 / (150 * rigs)))


def test_outliers_and_gaps_say_nothing_of_the_population() -> None:
    rng = np.random.default_rng(7)
    y, s = 5 + rng.normal(0, 1, 20), np.full(20, 0.5)
    y[3], y[4], s[5] = 50.0, np.nan, np.nan
    used = np.ones(20, dtype=bool)
    used[3] = False
    found = pooled("k", "N/m", y, s, used)
    assert found.count == 17
    assert found.values[3] == 50.0
    assert found.upper[3] == pytest.approx(50 + 1.96 * 0.5, rel=1e-3)
    assert np.isnan(found.values[[4, 5]]).all()
    assert found.mean == pytest.approx(np.mean(np.delete(y, [3, 4, 5])))
    assert pooled("k", "N/m", y[:3], s[:3]) is None


def test_rigs_that_are_all_alike() -> None:
    """Values that rest at a bound: no scatter, and an upper end of it that their noise sets."""
    population = pooled("c", "N·s/m", np.zeros(6), np.full(6, 0.1))
    assert np.all(population.values == 0)
