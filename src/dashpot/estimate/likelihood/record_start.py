"""A start for whole records whose coordinates are all seen: the equation of motion with its boundary loads solved for.

D X = R U + S f + a + jω b is linear in the unknowns and the loads.  Weighted by the noise of the equation at the last
values, with the noise's own moments taken out at the end, as the starts of settled data are.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.estimate.likelihood.boundary_loads import RecordEnds, projector
from dashpot.estimate.linear.auxiliary_model import equation_covariance
from dashpot.estimate.linear.least_squares import equation, where_finite, without_noise
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.dynamics import stiffness
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_scaled

PASSES = 4  # at most
STEADY = 0.01  # change of all unknowns from pass to pass at which they end: a descent goes on from there


def record_starts(model: Model, data: States, ends: RecordEnds, rig: Real | None = None) -> Real:
    """Values of the unknowns to begin with, (starts, K, unknowns): after each pass, with the noise in and taken out.

    The first pass takes the noise of the equation from a `rig`, (unknowns,), or as even at all lines, which where lines
    of motion are few or displacements are integrated is far from it.

    Where little but transients moves, taking the noise out may lead astray, and leaving it in is biased: what they fit
    decides.
    """
    Phi, h = equation(model, data)
    prior = np.diag(model.prior_precision)
    stated = model.prior_precision * model.prior_mean
    if rig is None:
        even = np.broadcast_to(np.eye(model.n, dtype=complex), (*Phi.shape[:2], model.n, model.n))
        N, right = _sums(Phi, h, even, _loads(model, data, ends), ends)
        # Without weights the sums have no unit noise: stated values count as much as the data do.
        scale = np.diagonal(N, axis1=-2, axis2=-1) * (model.prior_precision > 0)
        theta = solve_scaled(N + scale[..., None] * np.eye(len(prior)), right + scale * model.prior_mean)
    else:
        theta = np.broadcast_to(rig, (len(data.z), len(rig)))
    starts = [theta]
    for _ in range(PASSES):
        p = model.parameters(theta)
        Se = equation_covariance(model, p, data)
        columns = _loads(model, data, ends, p)
        N, right = _sums(Phi, h, Se, columns, ends)
        theta = where_finite(solve_scaled(N + prior, right + stated), theta)
        clean, usable = without_noise(model, data, Se, N, right)
        starts.append(theta)
        theta = np.where(usable[..., None], where_finite(clean, theta), theta)
        starts.append(theta)
        if len(starts) > 3 and np.all(np.abs(theta - starts[-3]) <= STEADY * np.abs(theta)):
            break
    return np.stack(starts)


def _loads(model: Model, data: States, ends: RecordEnds, p: Real | None = None) -> Complex:
    """What the ends add to the equation of motion: loads at coordinates, and polynomials of channels through H."""
    lead = (len(data.z), len(data.omega))
    each = np.broadcast_to(np.eye(model.n, dtype=complex), (*lead, model.n, model.n))
    polynomials = np.zeros((*lead, model.n, len(ends.channel)), dtype=np.complex128)
    if p is not None:
        H = stiffness(model, p, data.omega)
        read = data.reconstruction[..., : H.shape[-1], :] @ ends.polynomials()
        polynomials = H @ read
        if model.S.shape[1]:
            polynomials = polynomials - model.S @ (
                data.reconstruction[..., H.shape[-1] :, :] @ ends.polynomials()
            )
    return np.concatenate([each, ends.s[:, None, None] * each, polynomials], axis=-1)


def _sums(Phi: Complex, h: Complex, Se: Complex, columns: Complex, ends: RecordEnds) -> tuple[Real, Real]:
    """2 Re Φᴴ Ω Φ and 2 Re Φᴴ Ω h with the columns of each record projected out; (K, m, m) and (K, m)."""
    L = np.linalg.cholesky(Se)
    m, sides = Phi.shape[-1], Phi.shape[-1] + 1
    together = np.concatenate([Phi, h[..., None], columns], axis=-1)
    white = np.linalg.solve(np.broadcast_to(L, (*together.shape[:2], *L.shape[-2:])), together)
    regression, loads = white[..., :sides], white[..., sides:]
    rest = regression - loads @ projector(ends, loads).coefficients(regression)
    flat = rest.reshape(len(rest), -1, sides)
    products = 2 * (hermitian(flat) @ flat).real
    return products[:, :m, :m], products[:, :m, m]
