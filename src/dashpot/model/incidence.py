"""Products of sparse incidence matrices, row by row, without a loop over the rows."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def row_products(left: sparse.csr_array, right: sparse.csr_array) -> sparse.csr_array:
    """Row i: the outer product of row i of both, flattened; (rows, columns of left · columns of right)."""
    width = right.shape[1]
    of_left, of_right = np.diff(left.indptr), np.diff(right.indptr)
    pairs = of_left.astype(np.int64) * of_right
    row = np.repeat(np.arange(left.shape[0]), pairs)
    ends = np.cumsum(pairs)
    within = np.arange(len(row)) - np.repeat(ends - pairs, pairs)
    across = np.maximum(of_right, 1)[row]
    a = left.indptr[row] + within // across
    b = right.indptr[row] + within % across
    columns = left.indices[a].astype(np.int64) * width + right.indices[b]
    indptr = np.concatenate([[0], ends])
    shape = (left.shape[0], left.shape[1] * width)
    return sparse.csr_array((left.data[a] * right.data[b], columns, indptr), shape=shape)
