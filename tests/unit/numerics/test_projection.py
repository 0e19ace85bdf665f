"""The rank-revealing projection against NumPy's own decompositions."""

import numpy as np

from dashpot.numerics.small_systems import orthonormal, real_rows


def test_dependent_and_absent_columns_are_left_out() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(3, 40, 6)) * np.array([1, 1e8, 1e-9, 1, 1, 1])
    A[:, :, 4] = A[:, :, 0] - 3 * A[:, :, 3]
    A[1, :, 5] = 0
    Q, B, rank = orthonormal(A)
    assert rank.tolist() == [5, 4, 5]
    np.testing.assert_allclose(A @ B, Q, atol=1e-10)
    y = rng.normal(size=(3, 40, 2))
    for k in range(3):
        away = y[k] - Q[k] @ (Q[k].T @ y[k])
        size = np.linalg.norm(A[k], axis=0)
        scaled = A[k] / np.where(size > 0, size, 1)
        expected = y[k] - scaled @ np.linalg.lstsq(scaled, y[k], rcond=1e-10)[0]
        np.testing.assert_allclose(away, expected, atol=1e-10)


def test_nearly_dependent_columns_stay_orthonormal() -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(1, 200, 4))
    A[..., 3] = A[..., 0] + 1e-5 * A[..., 3]
    Q, _, rank = orthonormal(A)
    assert rank.tolist() == [4]
    np.testing.assert_allclose(Q[0].T @ Q[0], np.eye(4), atol=1e-10)


def test_real_rows_keep_squares() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(2, 5, 3, 4)) + 1j * rng.normal(size=(2, 5, 3, 4))
    rows = real_rows(values)
    expected = np.einsum("klci,klcj->kij", np.conj(values), values).real
    np.testing.assert_allclose(np.swapaxes(rows, -1, -2) @ rows, expected, rtol=1e-12)
