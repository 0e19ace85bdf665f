"""The dynamic stiffness of large rigs in its sparse pattern, factorised line by line (THEORY §10)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dashpot.arrays import Complex, Real
from dashpot.model.network import Model

FROM = 300  # coordinates from which responses are computed in the sparse pattern


def solve_stiffness(model: Model, weight: Complex, right: Complex) -> Complex:
    """D⁻¹ right with D = Bᵀ diag(weight) B, weight = p φ(ω) (elements,), right (n, k); NaN where D is singular.

    SuperLU with the ordering of AᵀA's pattern is slow and full for these matrices; minimum degree on A + Aᵀ in
    symmetric mode, pivots staying on the diagonal, keeps a chain's factors as sparse as the chain.
    """
    indices, indptr, A = model.assembly
    values: Any = A @ weight
    D: Any = sparse.csc_array((values, indices, indptr), shape=(model.n, model.n))
    try:
        factors: Any = splu(D, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return np.full(right.shape, np.nan, dtype=np.complex128)
    solved: Complex = factors.solve(np.asarray(right, dtype=np.complex128))
    return solved


def sparse_amplitudes(model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None) -> Complex:
    """As `dynamics.amplitudes`, line by line in the sparse pattern: X (..., lines, n), NaN without steady response."""
    B, D, factors = model.sparse_B, model.sparse_D, model.factors(omega)
    lead = np.broadcast_shapes(p.shape[:-1], U.shape[:-2], () if f is None else f.shape[:-2])
    lines = len(omega)
    count = int(np.prod(lead, dtype=int))
    each_p = np.broadcast_to(p, (*lead, p.shape[-1])).reshape(count, p.shape[-1])
    each_U = np.broadcast_to(U, (*lead, *U.shape[-2:])).reshape(count, *U.shape[-2:])
    each_f = None if f is None else np.broadcast_to(f, (*lead, *f.shape[-2:])).reshape(count, *f.shape[-2:])
    X = np.empty((len(each_p), lines, model.n), dtype=np.complex128)
    for k, parameters in enumerate(each_p):
        for line in range(lines):
            weight = parameters * factors[line]
            load = -(B.T @ (weight * (D @ each_U[k, line])))
            if each_f is not None:
                load = load + model.S @ each_f[k, line]
            X[k, line] = solve_stiffness(model, weight, load[:, None])[:, 0]
    return X.reshape(*lead, lines, model.n)
