"""Periodic response of rigs with nonlinear elements by harmonic balance, with exact slopes (THEORY §9).

    x(t) = Σ_h Re(X_h e^{jhωt}), h = 0 … H        D(hω) X_h + Bᵀ (p ∘ a_h) = R U_h + S f_h

D and R hold the linear elements; a_h are the harmonics of the nonlinear elements' unit forces, found by the alternating
frequency-time transform.  Unknown are the elongations δ of the nonlinear elements alone: with Z = B D⁻¹ Bᵀ,

    δ_h = B D⁻¹ (R U_h + S f_h) + D_inc U_h − Z(hω) p a_h(δ).

A linear share s of each nonlinear element (its secant at the start) is kept in D and taken from a, so that D is regular
where the rig holds together by nonlinear elements only; the result does not depend on s.

Rows N are dwells: any mixture of frequencies, inputs and parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import Alternated, alternate
from dashpot.model.nonlinear.balance import Balance, Balanced, balanced, secant_of
from dashpot.model.nonlinear.compiled import compiled_rig, compiled_slopes, compiled_start, factors_of_orders
from dashpot.model.nonlinear.harmonics import (
    Drive,
    complex_of,
    complex_rows,
    rates_of_orders,
    real_of,
    rows_of,
    share_blocks,
)
from dashpot.model.nonlinear.linear_part import LinearPart, linear_part, linear_stiffness

RAMP = (
    0.03,
    0.1,
    0.2,
    0.35,
    0.5,
    0.7,
    0.85,
    1.0,
)  # shares of the drive on the way to a response far from linear


@dataclass(frozen=True)
class Periodic:
    """The periodic response of N dwells and what slopes need.

    X (N, H + 1, n); delta (N, e, W) elongations of the nonlinear elements; forces: their unit forces at delta;
    error (N,) last Newton step over the elongation; converged (N,); equations: those that it satisfies.
    """

    X: Complex
    delta: Real
    forces: Alternated
    error: Real
    converged: Bools
    equations: Balance

    @property
    def linear(self) -> LinearPart:
        """The linear part, which holds a share of each nonlinear element."""
        return self.equations.linear


def periodic_response(
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    start: Real | None = None,
    *,
    times: int | None = None,
    grow: bool = True,
) -> Periodic:
    """The motion that each dwell settles to, from `start` (N, e, W) or, without one, from the linear response.

    p (N, elements), constants (N, inner constants).  Where Newton's method does not settle the drive is raised step
    by step from a small one, if `grow`.  Which of several responses is found depends on the start: give the measured
    elongations.
    """
    count = samples_of(model, drive.orders) if times is None else times
    first = start if start is not None else _linear_start(model, p, constants, drive, count)
    at = balanced(model, p, constants, drive, first, count)
    if grow and not np.all(at.converged):
        at = _grown(model, p, constants, drive, at, count)
    return periodic_at(model, at)


def _grown(model: Model, p: Real, constants: Real, drive: Drive, at: Balanced, times: int) -> Balanced:
    """With the dwells that Newton's method missed followed from a small drive, as far as each comes."""
    lost = np.flatnonzero(~at.converged)
    begun = drive.rows(lost).scaled(RAMP[0])
    q = _linear_start(model, p[lost], constants[lost], begun, times)
    for share in RAMP:
        grown = balanced(model, p[lost], constants[lost], drive.rows(lost).scaled(share), q, times)
        q = grown.q * 1.02
    if not np.any(grown.converged):
        return at
    lost = lost[grown.converged]
    delta = at.q.copy()
    delta[lost] = grown.q[grown.converged]
    hopeless = ~at.converged
    hopeless[lost] = False
    return balanced(model, p, constants, drive, delta, times, hopeless=hopeless)


def samples_of(model: Model, orders: int) -> int:
    """Instants of a period at which the laws are evaluated: more where they are not smooth."""
    rough = any(not element.force_law.smooth for element in model.elements if element.force_law is not None)
    wanted = max(16 * (orders + 1), 256) if rough else max(6 * (orders + 1), 32)
    return 1 << int(np.ceil(np.log2(wanted)))


def _linear_start(model: Model, p: Real, constants: Real, drive: Drive, times: int) -> Real:
    """Elongations with each nonlinear element replaced by its secant, found by a few rounds."""
    rig = compiled_rig(model, times)
    if rig is not None:
        return compiled_start(rig, model, p, constants, drive, times)
    e = len(model.nonlinear)
    secant = np.zeros((len(p), e), dtype=np.complex128)
    q = np.zeros((len(p), e, 2 * drive.orders + 1))
    for _ in range(6):
        linear = linear_part(model, p, drive, secant)
        free = np.where(np.isfinite(linear.free), linear.free, 0.0)
        q = real_of(np.moveaxis(free, 1, -1))
        forces = alternate(model, constants, drive.omega, q, times, slopes=False)
        moves = np.any(free, axis=(1, 2))[:, None]
        along = 0.5 * (secant + secant_of(p[:, model.nonlinear], forces.a, q))
        secant = np.where(moves, along, p[:, model.nonlinear])
    return q


def periodic_at(model: Model, at: Balanced) -> Periodic:
    """The whole motion for elongations that satisfy the equations."""
    linear = at.equations.linear
    load = linear.driven - at.equations.rest(at.q, at.forces.a) @ model.B[model.nonlinear]
    X = np.einsum("nhij,nhj->nhi", linear.inverse, load)
    return Periodic(X, at.q, at.forces, at.error, at.converged, at.equations)


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the response with respect to Q real unknowns.

    X (N, H + 1, n, Q) of the coordinates; unit_forces (N, H + 1, elements, Q) of all elements' unit forces; delta
    (N, e, W, Q) of the elongations.
    """

    X: Complex
    unit_forces: Complex
    delta: Real


def harmonic_unit_forces(model: Model, drive: Drive, at: Periodic) -> Complex:
    """a of all elements at every harmonic, (N, H + 1, elements); N per unit of the parameter."""
    a = factors_of_orders(model, drive.omega, drive.orders) * (at.X @ model.B.T + drive.U @ model.D.T)
    a[..., model.nonlinear] = np.moveaxis(complex_of(at.forces.a), -1, 1)
    return a


def slopes(
    model: Model, p: Real, drive: Drive, at: Periodic, a: Complex, along_p: Real, along_constants: Real,
    along_U: Complex | None = None, along_f: Complex | None = None,
) -> Slopes:  # fmt: skip
    """Slopes along Q directions of the parameters, (elements, Q), the constants, (G, Q), and the inputs' harmonics.

    a: the unit forces of all elements, by `harmonic_unit_forces`.
    along_U (N or 1, H + 1, r, Q) and along_f (N or 1, H + 1, s, Q).
    """
    chosen, linear = model.nonlinear, at.linear
    rig = compiled_rig(model)
    if rig is not None:
        parts = linear.inverse, linear.receptance, linear.share
        along = along_p, along_constants, along_U, along_f
        return Slopes(*compiled_slopes(rig, model, p, drive, parts, at.forces, a, along))
    Bn, Dn, n = model.B[chosen], model.D[chosen], model.n
    N, orders, Q = len(p), drive.orders, along_p.shape[1]
    strength = p[:, chosen]
    # Explicit load: −Bᵀ (a ∘ dp) − Bᵀ p ∂a/∂g dg + R dU + S df
    load = -np.einsum("ei,nhe,eq->nhiq", model.B, a, along_p)
    by_constant = _by_constants(model, at, along_constants)  # (N, H + 1, e, Q)
    load = load - np.einsum("ei,ne,nheq->nhiq", Bn, strength, by_constant)
    inner = strength[:, :, None, None] * at.forces.slope - share_blocks(linear.share)
    stretched = np.zeros((N, orders + 1, len(chosen), Q), dtype=np.complex128)
    if along_U is not None:
        jw = drive.omega[:, None] * rates_of_orders(orders)
        R = -linear_stiffness(model, p, jw)[..., n:] - np.einsum("nhe,ei,ej->nhij", linear.share, Bn, Dn)
        load = load + R @ along_U
        stretched = stretched + Dn @ along_U
    if along_f is not None:
        load = load + model.S @ along_f
    moved = linear.inverse @ load
    explicit = Bn @ moved + stretched  # (N, H + 1, e, Q)
    e, W = len(chosen), 2 * orders + 1
    right = rows_of(explicit).reshape(N, e * W, Q)
    d_delta = at.equations.solved(at.forces.slope, right).reshape(N, e, W, Q)
    d_rest = complex_rows(np.einsum("nevw,newq->nevq", inner, d_delta))
    dX = moved - linear.inverse @ np.einsum("ei,nheq->nhiq", Bn, d_rest)
    elongation = model.B @ dX
    if along_U is not None:
        elongation = elongation + model.D @ along_U
    d_a = factors_of_orders(model, drive.omega, drive.orders)[..., None] * elongation
    d_a[:, :, chosen] = complex_rows(np.einsum("nevw,newq->nevq", at.forces.slope, d_delta)) + by_constant
    return Slopes(dX, d_a, d_delta)


def _by_constants(model: Model, at: Periodic, along: Real) -> Complex:
    """∂a/∂g dg of the nonlinear elements at fixed motion, (N, H + 1, e, Q)."""
    N, e, W = at.delta.shape
    real = np.zeros((N, e, W, along.shape[1]))
    for row, (index, inner) in enumerate(zip(model.nonlinear, model.constant_slices, strict=True)):
        del index
        if inner.stop > inner.start:
            real[:, row] = np.einsum("nwg,gq->nwq", at.forces.by_constant[row], along[inner])
    return complex_rows(real)


def truncation(model: Model, p: Real, constants: Real, drive: Drive, at: Periodic) -> Real:
    """Error of the elongations for harmonics left out, over their size: the force at twice the orders, (N,)."""
    wider = drive.with_orders(2 * drive.orders + 1)
    W = 2 * wider.orders + 1
    q = np.zeros((*at.delta.shape[:2], W))
    q[..., : at.delta.shape[-1]] = at.delta
    times = 2 * samples_of(model, wider.orders)
    forces = alternate(model, constants, drive.omega, q, times, slopes=False)
    chosen = model.nonlinear
    linear = linear_part(model, p, wider, secant_of(p[:, chosen], forces.a, q))
    S = share_blocks(linear.share)
    rest = complex_of(p[:, chosen, None] * forces.a - np.einsum("nevw,new->nev", S, q))
    missing = (
        np.moveaxis(complex_of(q), -1, 1)
        - linear.free
        + np.einsum("nhef,nhf->nhe", linear.receptance, np.moveaxis(rest, -1, 1))
    )
    size = np.max(np.abs(at.delta), axis=(1, 2))
    error: Real = np.max(np.abs(missing), axis=(1, 2)) / np.where(size > 0, size, 1.0)
    return error


def settled_orders(
    model: Model, p: Real, constants: Real, drive: Drive, start: Real | None = None,
    *, tolerance: float = 1e-7, most: int = 63,
) -> tuple[Periodic, Drive]:  # fmt: skip
    """The response with as many harmonics as bring the truncation error below `tolerance`, at most `most`.

    p (lines, elements), constants (lines, G).
    """
    while True:
        at = periodic_response(model, p, constants, drive, start)
        error = truncation(model, p, constants, drive, at)
        worst = float(np.max(np.where(at.converged, error, 0.0), initial=0.0))
        if worst <= tolerance or drive.orders >= most:
            return at, drive
        drive = drive.with_orders(min(2 * drive.orders + 1, most))
        start = np.zeros((*at.delta.shape[:2], 2 * drive.orders + 1))
        start[..., : at.delta.shape[-1]] = at.delta
