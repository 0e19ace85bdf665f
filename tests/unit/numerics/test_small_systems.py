"""Stacks of small systems: the kernel's inverses against NumPy's, and what is singular."""

import numpy as np
import pytest

from dashpot.numerics.kernel import using
from dashpot.numerics.small_systems import mostly_zeros, product, scaled_inverse, solve_small, summed_products
from tests.kernels import apart, compiled


@pytest.mark.parametrize("m", [1, 2, 6, 16])
def test_inverses_of_the_kernel_are_those_of_numpy(m: int) -> None:
    compiled()
    rng = np.random.default_rng(m)
    J = rng.standard_normal((7, 3 * m, m)) * 10.0 ** rng.uniform(-6, 6, m)  # units far apart
    information = np.swapaxes(J, -1, -2) @ J
    with using("numpy"):
        twin = scaled_inverse(information)
    with using("compiled"):
        inverse = scaled_inverse(information)
        alone = scaled_inverse(information[3])
    size = 1 / np.sqrt(np.diagonal(twin, axis1=-2, axis2=-1))
    assert apart(inverse, twin, size[0][:, None] * size[0]) < 1e-12
    np.testing.assert_array_equal(alone, inverse[3])


@pytest.mark.parametrize("choice", ["numpy", "compiled"])
def test_singular_matrices_are_nan_and_leave_their_neighbours_alone(choice: str) -> None:
    if choice == "compiled":
        compiled()
    stack = np.array(
        [np.eye(3), np.ones((3, 3)), np.diag([1.0, 0.0, 2.0]), np.full((3, 3), np.nan), 2 * np.eye(3)]
    )
    with using(choice):
        inverse = scaled_inverse(stack)
    assert np.isnan(inverse[1:4]).all()
    np.testing.assert_allclose(inverse[[0, 4]], [np.eye(3), np.eye(3) / 2], rtol=1e-15)


def test_matrices_of_few_numbers_are_taken_as_such() -> None:
    """Banded stacks, solved and multiplied in their pattern, as NumPy does it in full; a singular one is NaN alone."""
    rng = np.random.default_rng(1)
    band = np.abs(np.subtract.outer(np.arange(60), np.arange(60))) < 2
    A, B = (
        (rng.standard_normal((2, 3, 60, 60)) + 1j * rng.standard_normal((2, 3, 60, 60))) * band for _ in "AB"
    )
    full = rng.standard_normal((2, 3, 60, 7))
    assert mostly_zeros(A)
    assert not mostly_zeros(np.where(np.eye(60) > 0, np.nan, A))
    np.testing.assert_allclose(product(A, B), A @ B, atol=1e-12)
    np.testing.assert_allclose(product(A[0], B), A[0] @ B, atol=1e-12)
    np.testing.assert_allclose(product(A, full), A @ full, atol=1e-12)
    both = np.sum(2 * (A.conj().swapaxes(-1, -2) @ B).real, axis=-3)
    np.testing.assert_allclose(summed_products(A, B), both, atol=1e-12)
    A = A + 4 * np.eye(60)
    np.testing.assert_allclose(solve_small(A, full), np.linalg.solve(A, full), atol=1e-10)
    np.testing.assert_allclose(solve_small(A[0], full), np.linalg.solve(A[0], full), atol=1e-10)
    A[1, 2, 5] = 0.0
    alone = solve_small(A, full)
    assert np.all(np.isnan(alone[1, 2]))
    np.testing.assert_allclose(alone[0], np.linalg.solve(A[0], full[0]), atol=1e-10)
