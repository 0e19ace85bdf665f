"""Periodic response of rigs with nonlinear elements by harmonic balance, with exact slopes (THEORY §9).

    x(t) = Σ_h Re(X_h e^{jhωt}), h = 0 … H        D(hω) X_h + Bᵀ (p ∘ a_h) = R U_h + S f_h

D and R hold the linear elements; a_h are the harmonics of the nonlinear elements' unit forces, found by the alternating
frequency-time transform.  Unknown are the elongations δ of the nonlinear elements alone: with Z = B D⁻¹ Bᵀ,

    δ_h = B D⁻¹ (R U_h + S f_h) + D_inc U_h − Z(hω) p a_h(δ).

A linear share s of each nonlinear element (its secant at the start) is kept in D and taken from a, so that D is regular
where the rig holds together by nonlinear elements only; the result does not depend on s.

Rows N are dwells: any mixture of frequencies, inputs and parameters.  Harmonics as real numbers come in the order
X_0, Re X_1, Im X_1, Re X_2, …, that is W = 2 H + 1 numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import Alternated, alternate

TOLERANCE = 1e-12  # of the elongation
ITERATIONS = 25
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
class Drive:
    """What drives N dwells: omega (N,) rad/s, U (N, H + 1, r) m and f (N, H + 1, s) N, order 0 being a constant."""

    omega: Real
    U: Complex
    f: Complex

    @property
    def orders(self) -> int:
        """Highest harmonic H."""
        return int(self.U.shape[1]) - 1

    def rows(self, keep: Bools) -> Drive:
        """Some of the dwells."""
        return Drive(self.omega[keep], self.U[keep], self.f[keep])

    def scaled(self, share: float) -> Drive:
        """All amplitudes multiplied."""
        return Drive(self.omega, share * self.U, share * self.f)

    def with_orders(self, orders: int) -> Drive:
        """The same drive with as many harmonics, cut off or zero."""
        return Drive(self.omega, with_orders(self.U, orders), with_orders(self.f, orders))


def with_orders(X: Complex, orders: int) -> Complex:
    """Harmonics (N, H + 1, …) cut off or filled with zeros to `orders`."""
    kept = X[:, : orders + 1]
    if kept.shape[1] == orders + 1:
        return kept
    missing = np.zeros((len(X), orders + 1 - kept.shape[1], *X.shape[2:]), dtype=X.dtype)
    return np.concatenate([kept, missing], axis=1)


@dataclass(frozen=True)
class Periodic:
    """The periodic response of N dwells and what slopes need.

    X (N, H + 1, n); delta (N, e, W) elongations of the nonlinear elements; forces: their unit forces at delta;
    error (N,) last Newton step over the elongation; converged (N,); linear: the shifted linear part.
    """

    X: Complex
    delta: Real
    forces: Alternated
    error: Real
    converged: Bools
    linear: _LinearPart
    newton: Real


def complex_of(q: Real) -> Complex:
    """(..., W) real numbers as harmonics (..., H + 1)."""
    X = np.empty((*q.shape[:-1], (q.shape[-1] + 1) // 2), dtype=np.complex128)
    X[..., 0] = q[..., 0]
    X[..., 1:] = q[..., 1::2] + 1j * q[..., 2::2]
    return X


def real_of(X: Complex) -> Real:
    """Harmonics (..., H + 1) as (..., W) real numbers; the imaginary part of order 0 is left out."""
    q = np.empty((*X.shape[:-1], 2 * X.shape[-1] - 1))
    q[..., 0] = X[..., 0].real
    q[..., 1::2], q[..., 2::2] = X[..., 1:].real, X[..., 1:].imag
    return q


def as_blocks(Z: Complex) -> Real:
    """Complex factors of each harmonic, (..., H + 1, i, j), as one real matrix (..., i, W, j, W)."""
    orders, i, j = Z.shape[-3] - 1, *Z.shape[-2:]
    W = 2 * orders + 1
    blocks = np.zeros((*Z.shape[:-3], i, W, j, W))
    blocks[..., :, 0, :, 0] = Z[..., 0, :, :].real
    h = np.arange(orders)
    part = np.moveaxis(Z[..., 1:, :, :], -3, 0)
    # Advanced indices apart from each other come first.
    blocks[..., :, 2 * h + 1, :, 2 * h + 1] = part.real
    blocks[..., :, 2 * h + 2, :, 2 * h + 2] = part.real
    blocks[..., :, 2 * h + 1, :, 2 * h + 2] = -part.imag
    blocks[..., :, 2 * h + 2, :, 2 * h + 1] = part.imag
    return blocks


@lru_cache(maxsize=8)
def _jh(orders: int) -> Complex:
    return (1j * np.arange(orders + 1)).astype(np.complex128)


@dataclass(frozen=True)
class _LinearPart:
    """The linear elements and the share s of the nonlinear ones at each harmonic.

    inverse (N, H + 1, n, n): D⁻¹; receptance (N, H + 1, e, e): Z; share (N, H + 1, e): s; driven (N, H + 1, n):
    R U + S f less the share that inputs stretch; free (N, H + 1, e): elongation without nonlinear forces.
    """

    inverse: Complex
    receptance: Complex
    share: Complex
    driven: Complex
    free: Complex


def _linear_part(model: Model, p: Real, drive: Drive, secant: Complex) -> _LinearPart:
    """`secant` (N, e): force per elongation that is kept in the linear part, N/m at the fundamental."""
    chosen = model.nonlinear
    B, D = model.B[chosen], model.D[chosen]
    jw = drive.omega[:, None] * _jh(drive.orders)
    share = secant.real[:, None, :] + jw[..., None] * (secant.imag / drive.omega[:, None])[:, None, :]
    both = _stiffness(model, p, jw)
    both = both + np.einsum("nhe,ei,ej->nhij", share, B, np.concatenate([B, D], axis=1))
    n = model.n
    driven = -np.einsum("nhij,nhj->nhi", both[..., n:], drive.U) + np.einsum("ij,nhj->nhi", model.S, drive.f)
    inverse = _regular_inverse(both[..., :n])
    X = np.einsum("nhij,nhj->nhi", inverse, driven)
    return _LinearPart(inverse, B @ inverse @ B.T, share, driven, X @ B.T + drive.U @ D.T)


def _stiffness(model: Model, p: Real, jw: Complex) -> Complex:
    """[D | −R] of the linear elements at each harmonic, (N, H + 1, n, n + r)."""
    omega = jw.imag
    factors = model.factors(omega)  # (N, H + 1, elements), 0 for nonlinear ones
    both: Complex = np.einsum(
        "nhe,ei,ej->nhij", p[:, None, :] * factors, model.B, np.concatenate([model.B, model.D], axis=1)
    )
    return both


def _regular_inverse(D: Complex) -> Complex:
    """D⁻¹; what nothing holds (a floating rig at order 0) is held by a spring too soft to matter."""
    n = D.shape[-1]
    size = np.max(np.abs(D), axis=(-2, -1), keepdims=True)
    largest = np.max(size, axis=1, keepdims=True)
    soft = np.zeros_like(size)
    soft[:, :1] = 1e-10 * np.where(size[:, :1] > 1e-12 * largest, size[:, :1], largest)
    try:
        with np.errstate(all="ignore"):
            inverse: Complex = np.linalg.inv(D + np.where(_singular(D), soft, 0.0) * np.eye(n)).astype(
                np.complex128
            )
            return inverse
    except np.linalg.LinAlgError:
        return np.full_like(D, np.nan)


def _singular(D: Complex) -> Bools:
    """Whether the constant term of the response is not held, (N, H + 1, 1, 1)."""
    n = D.shape[-1]
    loose = np.zeros((*D.shape[:2], 1, 1), dtype=bool)
    diagonal = np.sqrt(np.abs(np.diagonal(D[:, 0], axis1=-2, axis2=-1)))
    held = np.where(diagonal > 0, diagonal, 1.0)
    scaled = D[:, 0] / (held[:, :, None] * held[:, None, :])
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(scaled), scaled, 0.0)
    loose[:, 0, 0, 0] = (np.linalg.svd(finite, compute_uv=False)[:, -1] < 1e-12 * n) | np.any(
        diagonal == 0, axis=-1
    )
    return loose


def periodic_response(
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    start: Real | None = None,
    *,
    times: int | None = None,
) -> Periodic:
    """The motion that each dwell settles to, from `start` (N, e, W) or, without one, from the linear response.

    p (N, elements), constants (N, inner constants).  Where Newton's method does not settle the drive is raised step
    by step from a small one.  Which of several responses is found depends on the start: give the measured elongations.
    """
    count = samples_of(model, drive.orders) if times is None else times
    first = start if start is not None else _linear_start(model, p, constants, drive, count)
    at = _newton(model, p, constants, drive, first, count)
    lost = ~at.converged
    if np.any(lost):
        rows = drive.rows(lost)
        q = _linear_start(model, p[lost], constants[lost], rows.scaled(RAMP[0]), count)
        again = _newton(model, p[lost], constants[lost], rows.scaled(RAMP[0]), q, count)
        for share in RAMP[1:]:
            again = _newton(model, p[lost], constants[lost], rows.scaled(share), again.delta * 1.02, count)
        better = np.zeros(len(p), dtype=bool)
        better[lost] = again.converged | (again.error < at.error[lost])
        delta = at.delta.copy()
        delta[lost] = np.where(better[lost][:, None, None], again.delta, delta[lost])
        at = _newton(model, p, constants, drive, delta, count, limit=8)
    return at


def samples_of(model: Model, orders: int) -> int:
    """Instants of a period at which the laws are evaluated: more where they are not smooth."""
    rough = any(not element.force_law.smooth for element in model.elements if element.force_law is not None)
    wanted = max(16 * (orders + 1), 256) if rough else max(6 * (orders + 1), 32)
    return 1 << int(np.ceil(np.log2(wanted)))


def _linear_start(model: Model, p: Real, constants: Real, drive: Drive, times: int) -> Real:
    """Elongations with each nonlinear element replaced by its secant, found by a few rounds."""
    e = len(model.nonlinear)
    secant = np.zeros((len(p), e), dtype=np.complex128)
    q = np.zeros((len(p), e, 2 * drive.orders + 1))
    for _ in range(6):
        linear = _linear_part(model, p, drive, secant)
        free = np.where(np.isfinite(linear.free), linear.free, 0.0)
        q = real_of(np.moveaxis(free, 1, -1))
        if not np.any(free):
            secant = p[:, model.nonlinear].astype(np.complex128)
            continue
        forces = alternate(model, constants, drive.omega, q, times, slopes=False)
        secant = 0.5 * (secant + secant_of(p[:, model.nonlinear], forces.a, q))
    return q


def secant_of(p: Real, a: Real, q: Real) -> Complex:
    """Describing function p a₁/δ₁ of each nonlinear element, (N, e), its parts at least 0."""
    d1, a1 = complex_of(q)[..., 1], complex_of(a)[..., 1]
    size = np.abs(d1)
    ratio = p * a1 * np.conj(d1) / np.where(size > 0, size, 1.0) ** 2
    ratio = np.where((size > 0) & np.isfinite(ratio), ratio, 0.0)
    positive: Complex = np.maximum(ratio.real, 0.0) + 1j * np.maximum(ratio.imag, 0.0)
    return positive


def _newton(
    model: Model, p: Real, constants: Real, drive: Drive, q: Real, times: int, limit: int = ITERATIONS
) -> Periodic:
    """Newton's method with halved steps on the elongations of the nonlinear elements."""
    chosen = model.nonlinear
    e, W = q.shape[1:]
    forces = alternate(model, constants, drive.omega, q, times)
    linear = _linear_part(model, p, drive, secant_of(p[:, chosen], forces.a, q))
    Z = as_blocks(linear.receptance)
    free = real_of(np.moveaxis(linear.free, 1, -1))
    S = _share_blocks(linear.share)
    strength = p[:, chosen, None]

    def residual(at: Real, unit: Real) -> Real:
        rest = strength * unit - np.einsum("nevw,new->nev", S, at)
        r: Real = at - free + np.einsum("nevfw,nfw->nev", Z, rest)
        return r

    r = residual(q, forces.a)
    error = np.full(len(q), np.inf)
    matrix = np.empty((len(q), e * W, e * W))
    for _ in range(limit):
        inner = strength[..., None] * forces.slope - S
        matrix = (np.einsum("nevfu,nfuw->nevfw", Z, inner)).reshape(len(q), e * W, e * W) + np.eye(e * W)
        step = _solved(matrix, r.reshape(len(q), e * W, 1)).reshape(q.shape)
        size = np.maximum(np.max(np.abs(q), axis=(1, 2)), np.max(np.abs(free), axis=(1, 2)))
        size = np.where(size > 0, size, 1.0)
        with np.errstate(all="ignore"):
            error = np.max(np.abs(step), axis=(1, 2)) / size
        running = ~(error <= TOLERANCE)
        if not np.any(running):
            break
        norm = np.linalg.norm(r, axis=(1, 2))
        factor = np.where(running & np.isfinite(error), 1.0, 0.0)
        factor = np.minimum(factor, np.where(error > 0.5, 0.5 / np.maximum(error, 0.5), 1.0))
        for _ in range(6):
            trial = q - factor[:, None, None] * np.nan_to_num(step)
            there = alternate(model, constants, drive.omega, trial, times, start=forces)
            r_trial = residual(trial, there.a)
            worse = ~(np.linalg.norm(r_trial, axis=(1, 2)) <= norm * (1 + 1e-9) + 1e-14 * size) & (factor > 0)
            if not np.any(worse & (error > 1e-9)):
                break
            factor = np.where(worse & (error > 1e-9), factor / 2, factor)
        q, forces, r = trial, there, r_trial
    converged = error <= 1e-8
    inner = strength[..., None] * forces.slope - S
    matrix = (np.einsum("nevfu,nfuw->nevfw", Z, inner)).reshape(len(q), e * W, e * W) + np.eye(e * W)
    rest = complex_of(strength * forces.a - np.einsum("nevw,new->nev", S, q))
    X = np.einsum("nhij,nhj->nhi", linear.inverse, linear.driven - np.moveaxis(rest, -1, 1) @ model.B[chosen])
    return Periodic(X, q, forces, error, converged, linear, matrix)


def _share_blocks(share: Complex) -> Real:
    """The linear share of each element, (N, H + 1, e), as real matrices (N, e, W, W)."""
    per_element = np.moveaxis(share, -1, 1)[..., None, None]
    blocks = as_blocks(per_element)
    return blocks[..., 0, :, 0, :]


def _solved(matrix: Real, right: Real) -> Real:
    try:
        with np.errstate(all="ignore"):
            return np.linalg.solve(matrix, right).astype(np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the response with respect to Q real unknowns.

    X (N, H + 1, n, Q) of the coordinates; unit_forces (N, H + 1, elements, Q) of all elements' unit forces.
    """

    X: Complex
    unit_forces: Complex


def unit_forces(model: Model, drive: Drive, at: Periodic) -> Complex:
    """a of all elements at every harmonic, (N, H + 1, elements); N per unit of the parameter."""
    omega = (drive.omega[:, None] * _jh(drive.orders)).imag
    a = model.factors(omega) * (at.X @ model.B.T + drive.U @ model.D.T)
    a[..., model.nonlinear] = np.moveaxis(complex_of(at.forces.a), -1, 1)
    return a


def slopes(
    model: Model, p: Real, drive: Drive, at: Periodic, along_p: Real, along_constants: Real,
    along_U: Complex | None = None, along_f: Complex | None = None,
) -> Slopes:  # fmt: skip
    """Slopes along Q directions of the parameters, (elements, Q), the constants, (G, Q), and the inputs' harmonics.

    along_U (N or 1, H + 1, r, Q) and along_f (N or 1, H + 1, s, Q).
    """
    chosen, linear = model.nonlinear, at.linear
    Bn, Dn, n = model.B[chosen], model.D[chosen], model.n
    a = unit_forces(model, drive, at)
    N, orders, Q = len(p), drive.orders, along_p.shape[1]
    strength = p[:, chosen]
    # Explicit load: −Bᵀ (a ∘ dp) − Bᵀ p ∂a/∂g dg + R dU + S df
    load = -np.einsum("ei,nhe,eq->nhiq", model.B, a, along_p)
    by_constant = _by_constants(model, at, along_constants)  # (N, H + 1, e, Q)
    load = load - np.einsum("ei,ne,nheq->nhiq", Bn, strength, by_constant)
    inner = strength[:, :, None, None] * at.forces.slope - _share_blocks(linear.share)
    stretched = np.zeros((N, orders + 1, len(chosen), Q), dtype=np.complex128)
    if along_U is not None:
        jw = drive.omega[:, None] * _jh(orders)
        R = -_stiffness(model, p, jw)[..., n:] - np.einsum("nhe,ei,ej->nhij", linear.share, Bn, Dn)
        load = load + R @ along_U
        stretched = stretched + Dn @ along_U
    if along_f is not None:
        load = load + model.S @ along_f
    moved = linear.inverse @ load
    explicit = Bn @ moved + stretched  # (N, H + 1, e, Q)
    e, W = len(chosen), 2 * orders + 1
    right = _to_rows(explicit).reshape(N, e * W, Q)
    d_delta = _solved(at.newton, right).reshape(N, e, W, Q)
    d_rest = complex_rows(np.einsum("nevw,newq->nevq", inner, d_delta))
    dX = moved - linear.inverse @ np.einsum("ei,nheq->nhiq", Bn, d_rest)
    omega = (drive.omega[:, None] * _jh(orders)).imag
    elongation = model.B @ dX
    if along_U is not None:
        elongation = elongation + model.D @ along_U
    d_a = model.factors(omega)[..., None] * elongation
    d_a[:, :, chosen] = complex_rows(np.einsum("nevw,newq->nevq", at.forces.slope, d_delta)) + by_constant
    return Slopes(dX, d_a)


def _by_constants(model: Model, at: Periodic, along: Real) -> Complex:
    """∂a/∂g dg of the nonlinear elements at fixed motion, (N, H + 1, e, Q)."""
    N, e, W = at.delta.shape
    real = np.zeros((N, e, W, along.shape[1]))
    for row, (index, own) in enumerate(zip(model.nonlinear, model.constant_slices, strict=True)):
        del index
        if own.stop > own.start:
            real[:, row] = np.einsum("nwg,gq->nwq", at.forces.by_constant[row], along[own])
    return complex_rows(real)


def _to_rows(X: Complex) -> Real:
    """(N, H + 1, e, Q) complex as (N, e, W, Q) real."""
    return np.moveaxis(real_of(np.moveaxis(X, 1, -1)), -1, -2)


def complex_rows(q: Real) -> Complex:
    """(N, e, W, Q) real as (N, H + 1, e, Q) complex."""
    return np.moveaxis(complex_of(np.moveaxis(q, -2, -1)), -1, 1)


def truncation(model: Model, p: Real, constants: Real, drive: Drive, at: Periodic) -> Real:
    """Error of the elongations for harmonics left out, over their size: the force at twice the orders, (N,)."""
    wider = drive.with_orders(2 * drive.orders + 1)
    W = 2 * wider.orders + 1
    q = np.zeros((*at.delta.shape[:2], W))
    q[..., : at.delta.shape[-1]] = at.delta
    times = 2 * samples_of(model, wider.orders)
    forces = alternate(model, constants, drive.omega, q, times, slopes=False)
    chosen = model.nonlinear
    linear = _linear_part(model, p, wider, secant_of(p[:, chosen], forces.a, q))
    S = _share_blocks(linear.share)
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
    """The response with as many harmonics as bring the truncation error below `tolerance`, at most `most`."""
    while True:
        at = periodic_response(model, p, constants, drive, start)
        error = truncation(model, p, constants, drive, at)
        worst = float(np.max(np.where(at.converged, error, 0.0), initial=0.0))
        if worst <= tolerance or drive.orders >= most:
            return at, drive
        drive = drive.with_orders(min(2 * drive.orders + 1, most))
        start = np.zeros((*at.delta.shape[:2], 2 * drive.orders + 1))
        start[..., : at.delta.shape[-1]] = at.delta


__all__ = [
    "Drive", "Periodic", "Slopes", "complex_of", "periodic_response", "real_of", "replace", "settled_orders",
    "slopes", "truncation", "unit_forces", "with_orders",
]  # fmt: skip
