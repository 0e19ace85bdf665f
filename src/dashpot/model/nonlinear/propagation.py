"""One step of the linear part of a rig in time, exactly, and the inputs between samples (THEORY §9).

Forces are polynomials through the four Lobatto points of a step (exponential collocation: Hochbruck and Ostermann 2010,
Acta Numerica 19, 209).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model

NODES = np.array([0.0, (1 - 1 / np.sqrt(5)) / 2, (1 + 1 / np.sqrt(5)) / 2, 1.0])  # Lobatto
LAGRANGE = np.linalg.inv(np.vander(NODES, increasing=True))  # (power, node): ℓ_k(c) = Σ_m LAGRANGE[m, k] c^m
WITHIN = np.array([[NODES[j] ** (m + 1) / (m + 1) for m in range(4)] for j in range(4)]) @ LAGRANGE


@dataclass(frozen=True)
class Forcing:
    """Inputs of one record as cubics between samples: (samples − 1, 4, r + s), powers of the share of the interval.

    rated (r + s,): whether a force is the rate of its cubics, of none where it is empty.
    """

    step_s: float
    coefficients: Real
    rated: tuple[bool, ...] = ()

    @property
    def intervals(self) -> int:
        """Number of intervals between samples."""
        return len(self.coefficients)


def forcing(step_s: float, inputs: Real, rated: tuple[bool, ...] = ()) -> Forcing:
    """Cubic splines through the samples (samples, r + s) of the inputs, `step_s` apart; `rated` as of Forcing."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    time = np.arange(len(inputs), dtype=float)
    spline = CubicSpline(time, inputs, axis=0)
    return Forcing(step_s, np.moveaxis(np.asarray(spline.c)[::-1], 0, 1), rated)


@dataclass(frozen=True)
class Propagator:
    """One step of the linear part, in steps of h: states after the share c_j of it.

    E (4, 2 n, 2 n) of the state, I (4, 2 n, 4, n) of forces growing as the power m of the share.  Wf (4, 4, 2 n, n) of
    forces given at the nodes; Wn (4, 4, 2 n, e) the same of unit forces of the nonlinear elements.
    """

    h: float
    E: Real
    Wf: Real
    Wn: Real
    inertia: Real
    both: tuple[Real, Real, Real]


def propagator(model: Model, p: Real, h: float) -> Propagator:
    """Raises ModelError where a coordinate has no mass or an element is hysteretic.  p (elements,), h in s."""
    from scipy.linalg import expm

    parts = matrices(model, p)
    n, chosen = model.n, model.nonlinear
    if np.any(parts.H):
        raise ModelError(
            "a hysteretic damper has no motion in time",
            cure="use a viscous damper, or settled dwells of a linear rig",
        )
    size = np.sqrt(np.abs(np.diagonal(parts.M)))  # masses of one rig may differ by many orders
    if not np.all(size) or np.linalg.matrix_rank(parts.M / np.outer(size, size)) < n:
        raise ModelError(
            "a coordinate has no mass, so its motion cannot be integrated",
            cure="give every coordinate a mass",
        )
    inverse: Real = np.linalg.inv(parts.M).astype(np.float64)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ parts.K, -inverse @ parts.C]])
    chain = np.zeros((6 * n, 6 * n))
    chain[: 2 * n, : 2 * n] = A * h
    chain[n : 2 * n, 2 * n : 3 * n] = inverse * h
    for m in range(3):  # d/dc of c^m/m! is the one before it
        chain[2 * n + m * n : 3 * n + m * n, 3 * n + m * n : 4 * n + m * n] = np.eye(n)
    E, moments = np.zeros((4, 2 * n, 2 * n)), np.zeros((4, 2 * n, 4, n))
    for j, share in enumerate(NODES):
        grown = expm(chain * share)
        E[j] = grown[: 2 * n, : 2 * n]
        for m, factorial in enumerate((1, 1, 2, 6)):
            block = grown[: 2 * n, 2 * n + m * n : 3 * n + m * n]
            moments[j, :, m] = block * factorial
    Wf = np.einsum("jxmn,mk->jkxn", moments, LAGRANGE)
    Wn = -np.einsum("jkxn,en,e->jkxe", Wf, model.B[chosen], p[chosen])
    return Propagator(h, E, Wf, Wn, inverse, (parts.K, parts.C, parts.M))


def loads(model: Model, p: Real, drive: Forcing, substeps: int) -> tuple[Real, Real]:
    """(force of the inputs on the coordinates at the nodes of each step (steps, 4, n), inputs (steps, 4, 2, r)).

    The inputs come with their rates; forces of masses between base and rig count the acceleration of the spline.
    """
    parts = matrices(model, p)
    r = model.D.shape[1]
    share = (NODES[None, :] + np.arange(substeps)[:, None]) / substeps  # (substeps, 4)
    powers = share[..., None] ** np.arange(4)
    rates = np.where(
        np.arange(4) > 0, np.arange(4) * share[..., None] ** np.maximum(np.arange(4) - 1, 0), 0.0
    )
    bends = np.where(
        np.arange(4) > 1,
        np.arange(4) * (np.arange(4) - 1) * share[..., None] ** np.maximum(np.arange(4) - 2, 0),
        0.0,
    )

    def at(basis: Real, order: int) -> Real:
        values = np.einsum("skm,imq->iskq", basis, drive.coefficients) / drive.step_s**order
        nodes: Real = values.reshape(-1, 4, drive.coefficients.shape[-1])
        return nodes

    q, dq = at(powers, 0), at(rates, 1)
    applied = np.where(drive.rated[r:], dq[..., r:], q[..., r:]) if any(drive.rated) else q[..., r:]
    force = q[..., :r] @ parts.G.T + dq[..., :r] @ parts.F.T + applied @ model.S.T
    if np.any(parts.J):
        force = force + at(bends, 2)[..., :r] @ parts.J.T
    return force, np.stack([q[..., :r], dq[..., :r]], axis=2)
