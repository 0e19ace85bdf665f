"""Stacks of small systems: the kernel's inverses against NumPy's, and what is singular."""

import numpy as np
import pytest

from dashpot.numerics.kernel import using
from dashpot.numerics.small_systems import scaled_inverse
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
