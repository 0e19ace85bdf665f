"""Stacks of small linear systems: by formula, scaled, with NaN where one of the stack is singular."""

from __future__ import annotations

import contextlib
import math
from typing import cast

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian, zeros_for_nan
from dashpot.numerics.kernel import kernel_function

# Least squares on nuisance columns that may depend on each other, for stacks of problems.


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
    size = np.diagonal(products, axis1=-2, axis2=-1) if squares is None else zeros_for_nan(squares)
    unit = np.where(size > 0, 1 / np.sqrt(np.where(size > 0, size, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(products * unit[..., :, None] * unit[..., None, :])
    least = np.maximum(DEPENDENT * values[..., -1:], DEPENDENT if squares is not None else 1e-300)
    kept: Bools = values > least
    scale = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return unit[..., :, None] * vectors * scale[..., None, :], np.sum(kept, axis=-1)


def with_known_last(products: Real, squares: Real, precision: Real, count: int) -> tuple[Real, Ints]:
    """As `independent`, of N + precision, where the last `count` columns do not depend on each other.

    These, which may be many, go by a triangular factor.  (B, rank), the rank without them; squares (..., columns) of
    N's columns, precision (columns, columns) or with leading axes.
    """
    N = np.where(np.isfinite(products), products, 0.0) + precision
    size = zeros_for_nan(squares) + np.diagonal(precision, axis1=-2, axis2=-1)
    unit = np.where(size > 0, 1 / np.sqrt(np.where(size > 0, size, 1.0)), 0.0)
    N = N * unit[..., :, None] * unit[..., None, :]
    first = N.shape[-1] - count
    # Of records with fewer such columns the others are 0; what is left of two that are nearly one is rounding
    spare = np.where(unit[..., first:, None] > 0, 1e-11, 1.0) * np.eye(count)
    inverse = np.linalg.inv(np.linalg.cholesky(N[..., first:, first:] + spare))
    across = inverse @ N[..., first:, :first]
    rest = N[..., :first, :first] - np.swapaxes(across, -1, -2) @ across
    own, rank = independent(rest, np.diagonal(N, axis1=-2, axis2=-1)[..., :first])
    B = np.zeros(N.shape)
    B[..., :first, :first] = own
    back = np.swapaxes(inverse, -1, -2)
    B[..., first:, :first] = -back @ across @ own
    B[..., first:, first:] = back
    return unit[..., :, None] * B, rank


def whitening_steps(B: Real, precision: Real) -> tuple[Real, Real]:
    """(B, step) of columns that are known beforehand as well as `precision` says, (..., columns, columns).

    B Bᵀ = (N + precision)⁻¹ is given and turned so that Bᵀ precision B = λ is diagonal.  What the columns F leave of
    the products of rows is that of 1 − F B Bᵀ Fᵀ; 1 − F B step Bᵀ Fᵀ, with step = 1 / (1 + √λ), is its root, and makes
    rows white.  It is 1 in directions that are entirely unknown.
    """
    known, turn = np.linalg.eigh(np.swapaxes(B, -1, -2) @ precision @ B)
    return B @ turn, 1 / (1 + np.sqrt(np.clip(known, 0.0, 1.0)))


FREE = 0.97  # step from which on a column that is known beforehand takes a degree of freedom: known to a thousandth


SPARSE_FROM = 48  # rows or coordinates: above it a factorisation of the sparse pattern beats dense stacks
# Of a matrix's numbers, that are not zero: with more, patterns of 192 rows take three times as long as dense stacks
FILLED = 1 / 8


def mostly_zeros(stack: Complex | Real) -> bool:
    """Whether a stack of large matrices (..., n, k) holds few numbers other than zeros, and none that is not finite."""
    if min(stack.shape[-2:]) < SPARSE_FROM or np.count_nonzero(stack) > FILLED * stack.size:
        return False
    return bool(np.isfinite(np.sum(stack)))


def block_diagonal(stack: Complex | Real) -> sparse.csr_array:
    """The matrices of a stack (..., n, k) along the diagonal of one sparse matrix."""
    n, k = stack.shape[-2:]
    flat = stack.reshape(-1, n, k)
    block, row, column = flat.nonzero()
    shape = (len(flat) * n, len(flat) * k)
    return sparse.csr_array((flat[block, row, column], (block * n + row, block * k + column)), shape=shape)


def product(left: Complex | Real, right: Complex) -> Complex:
    """left @ right of stacks (..., n, k) and (..., k, j), in the pattern of `left` where that is sparse."""
    if not mostly_zeros(left):
        return left @ right
    lead, (n, k), j = np.broadcast_shapes(left.shape[:-2], right.shape[:-2]), left.shape[-2:], right.shape[-1]
    wide: Complex = np.broadcast_to(left, (*lead, n, k))
    sides: Complex = np.broadcast_to(right, (*lead, k, j))
    if not mostly_zeros(sides):
        return np.asarray(block_diagonal(wide) @ sides.reshape(-1, j)).reshape(*lead, n, j)
    found = (block_diagonal(wide) @ block_diagonal(sides)).tocoo()
    result = np.zeros((math.prod(lead), n, j), dtype=found.dtype)
    result[found.row // n, found.row % n, found.col % j] = found.data
    return result.reshape(*lead, n, j)


def summed_products(left: Complex, right: Complex) -> Real:
    """2 Re Σ_l leftᴴ right of (..., lines, n, m) and (..., lines, n, k); (..., m, k)."""
    rows = left.shape[-3] * left.shape[-2]
    left, right = (part.reshape(*part.shape[:-3], rows, part.shape[-1]) for part in (left, right))
    if right.shape[:-2] != left.shape[:-2] or not mostly_zeros(right):
        return 2 * (hermitian(left) @ right).real
    pairs = zip(left.reshape(-1, *left.shape[-2:]), right.reshape(-1, *right.shape[-2:]), strict=True)
    found = [(sparse.csr_array(b).conj().T @ a).real.T for a, b in pairs]
    return 2 * np.reshape(found, (*left.shape[:-2], left.shape[-1], right.shape[-1]))


def _solve_sparse(matrix: Complex, right: Complex) -> Complex:
    """As `solve_small`, by one factorisation of all.  Raises RuntimeError where some matrix is exactly singular."""
    lead, (n, k) = np.broadcast_shapes(matrix.shape[:-2], right.shape[:-2]), right.shape[-2:]
    whole = block_diagonal(np.broadcast_to(matrix, (*lead, n, n))).tocsc()
    kind = np.result_type(matrix, right)
    sides = np.broadcast_to(right, (*lead, n, k)).reshape(-1, k).astype(kind, copy=False)
    solved: Complex = splu(whole.astype(kind), permc_spec="MMD_AT_PLUS_A").solve(sides)
    return solved.reshape(*lead, n, k)


def solve_small(matrix: Complex, right: Complex) -> Complex:
    """matrix⁻¹ right for stacks of small matrices (..., n, n) and right sides (..., n, k); NaN where singular.

    One- and two-row systems are solved by formula: a stack of a million of them costs as much as ten thousand calls
    of LAPACK.
    """
    n = matrix.shape[-1]
    if mostly_zeros(matrix):
        with contextlib.suppress(RuntimeError):
            return _solve_sparse(matrix, right)
    if n == 0 or n > 2:
        try:
            return cast("Complex", np.linalg.solve(matrix, right))
        except np.linalg.LinAlgError:
            # One singular matrix of a batch must not cost the others their answer.
            regular = np.linalg.slogdet(matrix)[0] != 0
            safe = np.where(regular[..., None, None], matrix, np.nan)
            return cast("Complex", np.linalg.solve(safe, right))
    with np.errstate(all="ignore"):
        if n == 1:
            determinant = matrix[..., 0]
            solution = right / matrix
        else:
            a, b = matrix[..., 0, 0, None], matrix[..., 0, 1, None]
            c, d = matrix[..., 1, 0, None], matrix[..., 1, 1, None]
            determinant = a * d - b * c
            top = (d * right[..., 0, :] - b * right[..., 1, :]) / determinant
            bottom = (a * right[..., 1, :] - c * right[..., 0, :]) / determinant
            solution = np.stack([top, bottom], axis=-2)
    if not np.all(determinant):
        solution = np.where(determinant[..., None, :] == 0, np.nan, solution)
    return solution


def solve_scaled(matrix: Real, right: Real) -> Real:
    """matrix⁻¹ right for stacks of square systems, rows and columns scaled alike first; NaN where singular.

    matrix (..., m, m), right (..., m).
    """
    scale = _scale(matrix)
    scaled = matrix / (scale[..., :, None] * scale[..., None, :])
    return _solve_or_nan(scaled, (right / scale)[..., None])[..., 0] / scale


def scaled_inverse(matrix: Real) -> Real:
    """matrix⁻¹ of stacks of information matrices, scaled first; NaN where singular to rounding.  (..., m, m)."""
    # Rows up to which the kernel's inverse takes less time than LAPACK's
    compiled = kernel_function("scaled_inverse") if matrix.shape[-1] <= 24 else None
    if compiled is not None:
        return cast("Real", compiled(matrix))
    scale = _scale(matrix)
    outer = scale[..., :, None] * scale[..., None, :]
    scaled = matrix / outer
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        inverse = _solve_or_nan(scaled, np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape))
    # Of a matrix with ones on its diagonal: entries that large are rounding, not information.
    regular: Bools = np.abs(inverse).max(axis=(-2, -1)) < 1 / 1e-14
    result: Real = inverse / outer
    return result if regular.all() else np.where(regular[..., None, None], result, np.nan)


def _scale(matrix: Real) -> Real:
    """Square roots of the diagonals' sizes, 1 where these are 0; (..., m)."""
    scale: Real = np.sqrt(np.abs(matrix.diagonal(axis1=-2, axis2=-1)))
    return scale if scale.all() else np.where(scale == 0, 1.0, scale)


def _solve_or_nan(matrix: Real, right: Real) -> Real:
    try:
        return cast("Real", np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        flat = matrix.reshape(-1, *matrix.shape[-2:])
        sides = np.broadcast_to(right, (*matrix.shape[:-2], *right.shape[-2:])).reshape(
            len(flat), *right.shape[-2:]
        )
        # What LAPACK refuses is NaN; its neighbours in the stack are solved as they would be alone.
        regular = np.all(np.isfinite(flat), axis=(-2, -1))
        regular[regular] = np.linalg.slogdet(flat[regular])[0] != 0
        out = np.full_like(sides, np.nan)
        out[regular] = np.linalg.solve(flat[regular], sides[regular])
        return out.reshape(*matrix.shape[:-2], *right.shape[-2:])


def standard_deviations(covariance: Real) -> Real:
    """Square roots of the variances, (..., m); NaN where rounding has made one negative.

    covariance (..., m, m).
    """
    variance = covariance.diagonal(axis1=-2, axis2=-1)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))
