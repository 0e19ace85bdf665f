"""Nuisance amplitudes of the likelihood: the inputs q = (U, f), which enter linearly and are solved for line by line.

Where exact channels give them they are known; else they are estimated at each line with everything else.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import structural_rank

from dashpot.arrays import Bools, Complex, Ints, hermitian
from dashpot.model.observation import ObservationModel
from dashpot.numerics.small_systems import solve_small

BLIND = 1e-12  # relative precision of "zero" for inputs that no channel of a line sees


def inputs_by_channel(view: ObservationModel, exact: Bools) -> Complex | None:
    """Inputs by the exact channels, (lines, r + s, channels); None where they do not give them at every line."""
    C = view.direct_q * exact[..., None]
    count = C.shape[-1]
    scale = np.max(np.abs(C), axis=-1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        C = np.where(scale > 0, C / scale, 0.0)
        unit = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)[..., 0] * exact
    if count == 1:
        power = np.sum(np.abs(C) ** 2, axis=-2, keepdims=True)
        if np.any(power == 0):
            return None
        return np.asarray(hermitian(C) / power * unit[:, None, :])
    if count and np.any(np.linalg.matrix_rank(C) < count):
        return None
    by_channel: Complex = np.linalg.pinv(C) * unit[:, None, :]
    return by_channel


def inputs_seen(view: ObservationModel, present: Bools) -> Ints:
    """How many inputs each line's channels can tell apart: the generic rank of G there.

    present (lines, channels).
    """
    patterns, which = np.unique(present, axis=0, return_inverse=True)
    ranks = [int(structural_rank(sparse.csr_array(view.sees & pattern[:, None]))) for pattern in patterns]
    counts: Ints = np.array(ranks, dtype=np.int64)[which.ravel()]
    return counts


def estimated_inputs(G: Complex, W: Complex, y: Complex) -> tuple[Complex, Complex]:
    """q̂ (K, lines, r + s) and W G (Gᴴ W G)⁻¹ of generalised least squares, y = G q with weights W, line by line.

    An input that no channel of a line sees is 0 there (it was not driven): the smallest precision is added to it.
    """
    WG = W @ G
    normal = hermitian(G) @ WG
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1).real
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    outer = scale[..., :, None] * scale[..., None, :]
    regular = normal / outer + BLIND * np.eye(normal.shape[-1])
    half = hermitian(solve_small(regular, hermitian(WG / scale[..., None, :]))) / scale[..., None, :]
    q: Complex = np.einsum("...cq,...c->...q", np.conj(half), y)
    return q, half
