"""The search alone: slow problems, bounds, lengths of steps, and which of two ends is kept."""

from collections.abc import Callable

import numpy as np
import pytest

from dashpot.arrays import Ints, Real
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise, without_bounds


def misfit(bend: float) -> Callable[[Real, Ints], QuadraticModel]:
    """(x + 1)² + (bend x² + x − 1)², least at 0: what Gauss and Newton leave out there is −bend of their matrix."""

    def evaluate(x: Real, _: Ints) -> QuadraticModel:
        one = x[:, 0]
        r = np.stack([one + 1, bend * one**2 + one - 1], axis=-1)
        J = np.stack([np.ones_like(one), 1 + 2 * bend * one], axis=-1)
        curvature = np.sum(J**2, axis=-1)[:, None, None]
        return QuadraticModel(np.sum(r**2, axis=-1), -np.sum(J * r, axis=-1)[:, None], curvature, curvature)

    return evaluate


def test_newtons_matrix_ends_what_creeps() -> None:
    """Near 0 a step of Gauss and Newton leaves 0.9 of the error, one of Newton next to nothing."""
    start = np.array([[0.3]])
    slow = minimise(misfit(0.9), start, limit=40, tolerance=1e-9, patience=100)
    quick = minimise(misfit(0.9), start, limit=40, tolerance=1e-9, patience=12)
    assert slow.history[-1, 0] / slow.history[-2, 0] == pytest.approx(0.9, abs=0.02)
    assert not slow.converged[0]
    assert quick.converged[0]
    assert abs(quick.x[0, 0]) < 1e-8
    assert quick.iterations[0] < 20


def bowl(x: Real, _: Ints) -> QuadraticModel:
    """(x₀ − 3)² + (x₁ − 3)² + x₀x₁."""
    W = np.broadcast_to(np.array([[1.0, 0.5], [0.5, 1.0]]), (len(x), 2, 2))
    gradient = -np.stack([x[:, 0] - 3 + x[:, 1] / 2, x[:, 1] - 3 + x[:, 0] / 2], axis=-1)
    return QuadraticModel(np.sum((x - 3) ** 2, axis=-1) + x[:, 0] * x[:, 1], gradient, W, W)


def test_a_bound_holds_its_unknown_and_the_others_move_on() -> None:
    """Minimum at (2, 2); with x₀ ≤ 1 at (1, 2.5), whence one free step leads to (2, 2)."""
    upper = np.array([1.0, np.inf])
    found = minimise(bowl, np.array([[0.0, 0.0]]), limit=20, tolerance=1e-9, upper=upper)
    assert found.converged[0]
    assert np.allclose(found.x, [[1.0, 2.5]], atol=1e-8)
    none = np.full(2, -np.inf)
    assert np.allclose(without_bounds(found.x, bowl(found.x, np.array([0])), none, upper), [[2.0, 2.0]])
    inside = np.array([[0.5, 0.5]])
    assert np.array_equal(without_bounds(inside, bowl(inside, np.array([0])), none, upper), inside)


def test_no_step_is_longer_than_the_longest() -> None:
    found = minimise(bowl, np.array([[0.0, 0.0]]), limit=40, tolerance=1e-9, longest=0.25)
    assert np.max(np.abs(np.diff(found.history, axis=0))) == pytest.approx(0.25)
    assert np.allclose(found.x, [[2.0, 2.0]])


def ends(cost: list[float], converged: list[bool]) -> OptimizeResult:
    return OptimizeResult(
        np.array(cost)[:, None], np.array(cost), np.array(converged), np.ones(len(cost), dtype=np.int64),
        np.zeros((1, 1)),
    )  # fmt: skip


def test_the_better_of_two_ends_is_kept() -> None:
    """Lower, or settled where the other had not; iterations of both count."""
    first = ends([5.0, 5.0, 5.0, 5.0], [True, True, False, True])
    other = ends([4.0, 6.0, 5.5], [True, True, True])
    found = first.improved(np.array([0, 1, 2]), other)
    assert found.x[:, 0].tolist() == [4.0, 5.0, 5.5, 5.0]
    assert found.converged.all()
    assert found.iterations.tolist() == [2, 2, 2, 1]
