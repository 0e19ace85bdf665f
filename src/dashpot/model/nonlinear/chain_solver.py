"""Residuals of a linearised motion whose inputs have white noise, decorrelated by one sparse factorisation.

V = I + W L σ² Lᵀ W, L the tangent of a motion.  With the states, the cubics of the inputs and what is carried back
against time as further unknowns, V z = b is a system that couples each sample with the next alone.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dashpot.arrays import Ints, Real
from dashpot.model.nonlinear.tangent import Tangent, spline_matrix


class ChainSolver:
    """V⁻¹ for weights of the channels (channels,) and standard deviations of the inputs' noise (q,), above 0."""

    def __init__(self, tangent: Tangent, weight: Real, sd: Real) -> None:
        N, c, x = tangent.shown.shape
        q = len(sd)
        F = sparse.eye_array(N * x) - sparse.csr_array(_blocks(tangent.step, 1, 0, N, N))
        D = sparse.csr_array(_blocks(tangent.driven, 1, 0, N, N - 1))
        W = sparse.diags_array(np.tile(weight, N))
        every: Ints = np.arange(N)
        at: Ints = np.minimum(every, N - 2)
        Sx = W @ sparse.csr_array(_blocks(tangent.shown, 0, 0, N, N))
        Sc = W @ sparse.csr_array(_placed(tangent.direct, every, at, N, N - 1))
        T, R, Cy, Cs = _spline(N, q)
        y_shown, s_shown = Sc @ Cy, Sc @ Cs
        precision = sparse.diags_array(np.tile(1 / sd**2, N))
        one = sparse.eye_array(N * c)
        grid = [  # unknown: z, X, λ, y, s, μ
            [one, Sx, None, y_shown, s_shown, None],
            [None, F, None, -(D @ Cy), -(D @ Cs), None],
            [-Sx.T, None, F.T, None, None, None],
            [-y_shown.T, None, -(D @ Cy).T, precision, None, -R.T],
            [None, None, None, -R, T, None],
            [-s_shown.T, None, -(D @ Cs).T, None, None, T.T],
        ]
        sizes = (c, x, x, q, q, q)
        self._order = _interleaved(N, sizes)
        self._shape = (N, c)
        whole = sparse.block_array(grid, format="csc")[:, self._order][self._order]
        self._factors = splu(sparse.csc_matrix(whole), permc_spec="NATURAL")

    def solve(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K)."""
        N, c = self._shape
        right = np.zeros((len(self._order), columns.shape[2]))
        right[: N * c] = columns.reshape(N * c, -1)
        solved = np.empty_like(right)
        solved[self._order] = self._factors.solve(np.ascontiguousarray(right[self._order]))
        z: Real = solved[: N * c].reshape(columns.shape)
        return z


def _blocks(blocks: Real, down: int, right: int, rows: int, columns: int) -> sparse.coo_array:
    """Block k (count, height, width) in block row k + down and block column k + right."""
    k: Ints = np.arange(len(blocks))
    return _placed(blocks, k + down, k + right, rows, columns)


def _placed(blocks: Real, at_row: Ints, at_column: Ints, rows: int, columns: int) -> sparse.coo_array:
    _, height, width = blocks.shape
    i = at_row[:, None, None] * height + np.arange(height)[:, None] + 0 * np.arange(width)
    j = at_column[:, None, None] * width + np.arange(width) + 0 * np.arange(height)[:, None]
    return sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), (rows * height, columns * width))


def _spline(N: int, q: int) -> tuple[sparse.csr_array, ...]:
    """T s = R y for the rates s of a spline at its samples, and its cubics c = Cy y + Cs s, (…, q) interleaved."""
    rows = np.arange(N)
    bands = spline_matrix(N, transposed=False)
    T = _banded(N, (rows[:-1], rows, rows[1:]), (1, 0, -1), (bands[0, 1:], bands[1], bands[2, :-1]))
    inner, three, first = rows[1:-1], np.full(N - 2, 3.0), np.array([-2.5, 2.0, 0.5])
    R = _banded(N, (inner, inner), (1, -1), (three, -three)) + _banded(
        N,
        tuple(np.array([row]) for row in (0, 0, 0, N - 1, N - 1, N - 1)),
        (0, 1, 2, 0, -1, -2),
        tuple(np.array([value]) for value in (*first, *-first)),
    )
    k = np.arange(N - 1)
    now = sparse.csr_array((np.ones(N - 1), (k, k)), (N - 1, N))
    later = sparse.csr_array((np.ones(N - 1), (k, k + 1)), (N - 1, N))
    step = later - now
    powers = [sparse.csr_array(np.eye(4)[:, [m]]) for m in range(4)]
    Cy = sparse.kron(now, powers[0]) + sparse.kron(step, 3 * powers[2] - 2 * powers[3])
    Cs = sparse.kron(now, powers[1] - 2 * powers[2] + powers[3]) + sparse.kron(later, powers[3] - powers[2])
    each = sparse.eye_array(q)
    return tuple(sparse.csr_array(sparse.kron(matrix, each)) for matrix in (T, R, Cy, Cs))


def _banded(
    N: int, rows: tuple[Ints, ...], offsets: tuple[int, ...], values: tuple[Real, ...]
) -> sparse.csr_array:
    """Values in some rows (…,), each beside the diagonal by an offset."""
    columns = [row + offset for row, offset in zip(rows, offsets, strict=True)]
    at = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array((np.concatenate(values), at), (N, N))


def _interleaved(N: int, sizes: tuple[int, ...]) -> Ints:
    """Numbers of the unknowns, sample by sample; each kind is stacked over the samples."""
    first = np.concatenate([[0], np.cumsum(np.array(sizes) * N)])
    parts = [first[kind] + np.arange(N)[:, None] * size + np.arange(size) for kind, size in enumerate(sizes)]
    return np.concatenate(parts, axis=1).ravel()
