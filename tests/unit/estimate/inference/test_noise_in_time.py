"""Noise that changes in the course of a record: what its blocks make of an estimate."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.estimate.inference.time_course import EvenNoise, NoiseInTime

MANY = 1e9  # degrees of freedom: powers that are known


def means(power: list[float], residual: list[float]) -> tuple[NoiseInTime, EvenNoise]:
    """One unknown that each block shows once, with the residuals from the mean of all."""
    rows = np.column_stack([np.ones(len(power)), residual])
    products = rows[:, :, None] * rows[:, None, :]
    total = np.sum(products, axis=0)
    even = EvenNoise(total[:1, :1], total[:1, 1], 1 / total[:1, :1], np.full(1, np.inf))
    return NoiseInTime(products, np.array(power), np.full(len(power), MANY)), even


def test_a_mean_of_unequal_observations() -> None:
    """The variance of a plain mean is Σ v / n², that of the weighted one 1 / Σ (1/v)."""
    power, residual = [0.5, 1.5, 0.25, 1.75], [0.3, -0.4, 0.2, -0.1]
    noise, even = means(power, residual)
    v = np.array(power)
    least = 1 / np.sum(1 / v)
    plain, weighted = noise.of_lines(even), noise.of_samples(even)
    assert plain.covariance[0, 0] == pytest.approx(np.sum(v) / 16, rel=1e-6)
    assert plain.step == pytest.approx([0.0])
    assert weighted.covariance[0, 0] == pytest.approx(least, rel=1e-6)
    assert weighted.step[0] == pytest.approx(least * np.sum(residual / v))
    assert noise.bound(even)[0, 0] == pytest.approx(least, rel=1e-6)


def test_even_power_changes_nothing() -> None:
    """Neither covariance nor estimate."""
    noise, even = means([1.0] * 5, [0.1, -0.1, 0.2, -0.2, 0.0])
    paid = replace(even, covariance=1.1 * even.covariance, dof=np.full(1, 50.0))
    for result in (noise.of_lines(paid), noise.of_samples(paid)):
        assert result.covariance == pytest.approx(paid.covariance)
        assert result.step == pytest.approx([0.0])
        assert result.dof == pytest.approx([50.0])
