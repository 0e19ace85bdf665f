"""Nuisance amplitudes of the likelihood: the inputs q = (U, f), which enter linearly and are solved for line by line.

Where exact channels give them they are known; else they are estimated at each line with everything else.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, structural_rank

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

    A channel sees an input that reaches its coordinates through elements; a force on another rig of the same model,
    or on a part that is connected only to moved inputs, it does not.
    """
    model, B = view.model, abs(view.model.sparse_B)
    count, part = connected_components(B.T @ B, directed=False)
    member = sparse.csr_array((np.ones(model.n), (np.arange(model.n), part)), shape=(model.n, count))
    driven = np.concatenate([B.T @ abs(model.D), abs(model.S)], axis=1)
    looking = np.abs(view.on_x) + abs(view.force) @ B
    direct = np.abs(view.on_q)
    direct[:, : model.D.shape[1]] += abs(view.force) @ abs(model.D)
    sees = ((looking @ member > 0).astype(float) @ (member.T @ driven > 0) > 0) | (direct > 0)
    patterns, which = np.unique(present, axis=0, return_inverse=True)
    ranks = [int(structural_rank(sparse.csr_array(sees & pattern[:, None]))) for pattern in patterns]
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
