"""The random walk against slow twins: one joint normal distribution of all windows, and steps by least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from dashpot.arrays import Real
from dashpot.numerics.random_walk import RandomWalk, Windows, likeliest_walk, smoothed_walks, trajectory


def drawn(
    rng: np.random.Generator, K: int, p: int, speed: float = 0.0, step: tuple[int, int, float] | None = None
) -> tuple[Windows, Real]:
    """Windows of numbers that walk, and the numbers (K, p)."""
    factor = rng.standard_normal((K, p, 3 * p))
    information = factor @ np.swapaxes(factor, -1, -2)
    true = speed * np.cumsum(rng.standard_normal((K, p)), axis=0)
    if step is not None:
        true[step[0] :, step[1]] += step[2]
    noise = np.linalg.solve(
        np.swapaxes(np.linalg.cholesky(information), -1, -2), rng.standard_normal((K, p, 1))
    )[..., 0]
    start = np.arange(K, dtype=float)
    return Windows(start, start + 1, true + noise, information, np.zeros(p), np.zeros(p)), true


def joint(windows: Windows, walk: RandomWalk) -> tuple[Real, Real, float]:
    """Smoothed values, their covariance and the likelihood up to a constant: dense, from a flat begin."""
    K, p = windows.values.shape
    noise = np.zeros((K, p, K, p))
    for k in range(K):
        noise[k, :, k] = walk.scatter * np.linalg.inv(windows.information[k])
    when = np.concatenate([[0.0], np.cumsum(windows.gaps)])
    shared = np.minimum(when[:, None], when[None])
    moves = np.einsum("kl,ij->kilj", shared, np.diag(walk.variance)).reshape(K * p, K * p)
    total = moves + noise.reshape(K * p, K * p)
    X, y = np.tile(np.eye(p), (K, 1)), windows.values.ravel()
    W = np.linalg.inv(total)
    normal = X.T @ W @ X
    begin = np.linalg.solve(normal, X.T @ W @ y)
    left = y - X @ begin
    values = X @ begin + moves @ W @ left
    G = X - moves @ W @ X
    covariance = moves - moves @ W @ moves + G @ np.linalg.solve(normal, G.T)
    likelihood = -0.5 * (np.linalg.slogdet(total)[1] + np.linalg.slogdet(normal)[1] + left @ W @ left)
    return values.reshape(K, p), covariance.reshape(K, p, K, p), float(likelihood)


def test_filter_and_smoother_are_those_of_the_joint_distribution() -> None:
    windows, _ = drawn(np.random.default_rng(1), 7, 3, 0.3)
    walks = [RandomWalk(np.array([0.1, 0.02, 0.0])), RandomWalk(np.array([0.3, 0.0, 0.05]), 1.7)]
    at = smoothed_walks(windows, walks)
    slow = [joint(windows, walk) for walk in walks]
    for s, (values, covariance, _) in enumerate(slow):
        assert at.values[s, 0] == pytest.approx(values, abs=1e-9)
        for k in range(7):
            assert at.covariance[s, k] == pytest.approx(covariance[k, :, k], abs=1e-9)
    assert at.likelihood[1, 0] - at.likelihood[0, 0] == pytest.approx(slow[1][2] - slow[0][2], abs=1e-9)


def test_the_slope_is_that_of_the_likelihood() -> None:
    windows, _ = drawn(np.random.default_rng(2), 6, 2, 0.3)
    v = np.array([0.1, 0.05])
    at = smoothed_walks(windows, [RandomWalk(v), *(RandomWalk(v + each) for each in 1e-6 * np.eye(2))])
    assert (at.likelihood[1:, 0] - at.likelihood[0, 0]) / 1e-6 == pytest.approx(at.slope[0, 0], rel=1e-3)


def test_a_shock_is_the_step_of_generalised_least_squares() -> None:
    windows, _ = drawn(np.random.default_rng(3), 6, 2, 0.2)
    walk = RandomWalk(np.array([0.05, 0.02]))
    at = smoothed_walks(windows, [walk])
    for k, j in ((1, 0), (3, 1), (5, 0)):
        column = np.zeros((6, 2))
        column[k:, j] = 1.0
        base, bent = windows.values, windows.values + 1e-3 * column
        both = smoothed_walks(windows, [walk], np.stack([base, bent, windows.values - 1e-3 * column]))
        slope = (both.likelihood[0, 1] - both.likelihood[0, 2]) / 2e-3
        curve = (both.likelihood[0, 1] + both.likelihood[0, 2] - 2 * both.likelihood[0, 0]) / 1e-6
        assert at.pull[0, 0, k, j] == pytest.approx(-slope, rel=1e-5)
        assert at.weight[0, k, j] == pytest.approx(-curve, rel=1e-4)


def test_windows_that_tell_nothing_of_a_number_are_bridged() -> None:
    windows, _ = drawn(np.random.default_rng(4), 8, 2)
    information = windows.information.copy()
    information[3:5, 1] = information[3:5, :, 1] = 0.0
    blind = Windows(windows.start, windows.end, windows.values, information, np.zeros(2), np.zeros(2))
    at = smoothed_walks(blind, [RandomWalk(np.array([0.0, 0.1]))])
    sd = np.sqrt(at.covariance[0, :, 1, 1])
    assert np.all(sd[3:5] > np.max(sd[[2, 5]]))
    assert np.all(np.isfinite(at.values))


def test_few_windows_have_no_changes() -> None:
    for K in (1, 2):
        windows, _ = drawn(np.random.default_rng(5), K, 2)
        found = trajectory(windows)
        assert not found.changes
        assert found.values == pytest.approx(windows.values) if K == 1 else np.all(np.isfinite(found.values))


def test_a_step_is_found_in_its_place_and_a_given_walk_stays() -> None:
    windows, _ = drawn(np.random.default_rng(6), 12, 2, step=(7, 1, 4.0))
    (change,) = trajectory(windows).changes
    assert (change.component, change.window) == (1, 7)
    assert abs(change.size - 4.0) < 3 * change.sd
    assert change.time95[0] <= 7.0 <= change.time95[1]
    still = trajectory(windows, variance=np.array([0.0, 25.0]))
    assert still.speed == pytest.approx([0.0, 5.0])
    assert not still.changes


def test_the_speed_is_found() -> None:
    windows, _ = drawn(np.random.default_rng(7), 60, 2, 0.8)
    walk = likeliest_walk(windows.scaled())
    assert np.sqrt(walk.variance) * windows.scale == pytest.approx([0.8, 0.8], rel=0.1)


@pytest.mark.long
def test_false_alarms_come_as_often_as_stated_and_walks_are_covered() -> None:
    rng, alarms, covered, repeats = np.random.default_rng(8), 0, [], 100
    for seed in range(repeats):
        windows, _ = drawn(rng, 20, 3)
        alarms += bool(trajectory(windows, false_alarms=0.05, seed=seed).changes)
    assert binom.cdf(alarms, repeats, 0.05) > 1e-3
    assert binom.sf(alarms - 1, repeats, 0.05) > 1e-3
    for seed in range(20):
        windows, true = drawn(rng, 20, 3, 0.15)
        found = trajectory(windows, seed=seed)
        covered.append(np.mean(np.abs(found.values - true) < 1.96 * found.sd))
    assert 0.90 < np.mean(covered) < 0.99
