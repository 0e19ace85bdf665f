"""Least squares on nuisance columns that may depend on each other, for stacks of problems."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real

DEPENDENT = 1e-12  # of the largest eigenvalue of the columns' products: below it a column depends on others


def real_rows(values: Complex) -> Real:
    """(K, lines, rows, columns) → (K, 2 · lines · rows, columns): real parts, then imaginary ones."""
    flat = values.reshape(len(values), -1, values.shape[-1])
    return np.concatenate([flat.real, flat.imag], axis=1)


def orthonormal(A: Real) -> tuple[Real, Real, Ints]:
    """(Q, B, rank) with Q = A B, Qᵀ Q = 1 on the first `rank` directions and 0 beyond: a rank-revealing QR by products.

    A (K, rows, columns).  Columns are scaled alike first; what depends on others to DEPENDENT is left out.  One pass
    over the products leaves Q orthonormal to the root of that, the second to rounding.
    """
    size = np.sqrt(np.sum(A**2, axis=-2))
    with np.errstate(all="ignore"):
        B = np.where(size > 0, 1 / size, 0.0)[:, None, :] * np.eye(A.shape[-1])
    Q = A @ B
    kept: Bools = size > 0
    for turn in range(2):
        gram = np.swapaxes(Q, -1, -2) @ Q
        gram = np.where(np.isfinite(gram), gram, 0.0)
        values, vectors = np.linalg.eigh(gram)
        largest = np.max(values, axis=-1, keepdims=True)
        limit = DEPENDENT * largest if turn == 0 else 0.5 * largest
        kept = (values > limit) & (values > 0)
        step = vectors * np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)[:, None, :]
        Q, B = Q @ step, B @ step
    return Q, B, np.sum(kept, axis=-1)


def independent(products: Real, squares: Real | None = None) -> tuple[Real, Ints]:
    """(B, rank) with Bᵀ N B = 1 on the independent directions of columns whose products are N, and 0 beyond.

    N (..., columns, columns).  Columns are scaled alike first, by `squares` (..., columns) where N is what others have
    left of them; what depends on others to DEPENDENT is left out.
    """
    products = np.where(np.isfinite(products), products, 0.0)
    size = np.diagonal(products, axis1=-2, axis2=-1) if squares is None else np.nan_to_num(squares)
    unit = np.where(size > 0, 1 / np.sqrt(np.where(size > 0, size, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(products * unit[..., :, None] * unit[..., None, :])
    least = np.maximum(DEPENDENT * values[..., -1:], DEPENDENT if squares is not None else 1e-300)
    kept: Bools = values > least
    scale = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return unit[..., :, None] * vectors * scale[..., None, :], np.sum(kept, axis=-1)
