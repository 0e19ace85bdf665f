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

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import (
    Alternated,
    alternate,
    compiled_balance,
    compiled_rig,
    compiled_slopes,
    compiled_start,
    factors_of_orders,
)
from dashpot.model.nonlinear.harmonics import (
    Drive,
    complex_of,
    complex_rows,
    rates_of_orders,
    real_of,
    rows_of,
    share_blocks,
)

# The linear elements of a rig at every harmonic, with a share of the nonlinear ones that keeps them
# regular.


@dataclass(frozen=True)
class LinearPart:
    """The linear elements and the share s of the nonlinear ones at each harmonic.

    inverse (N, H + 1, n, n): D⁻¹; receptance (N, H + 1, e, e): Z; share (N, H + 1, e): s; driven (N, H + 1, n):
    R U + S f less the share that inputs stretch; free (N, H + 1, e): elongation without nonlinear forces.
    """

    inverse: Complex
    receptance: Complex
    share: Complex
    driven: Complex
    free: Complex

    def rows(self, keep: Bools | Ints) -> LinearPart:
        """That of some of the dwells."""
        return LinearPart(
            self.inverse[keep], self.receptance[keep], self.share[keep], self.driven[keep], self.free[keep]
        )


def linear_part(model: Model, p: Real, drive: Drive, secant: Complex) -> LinearPart:
    """`secant` (N, e): force per elongation that is kept in the linear part, N/m at the fundamental."""
    chosen = model.nonlinear
    B, D = model.B[chosen], model.D[chosen]
    jw = drive.omega[:, None] * rates_of_orders(drive.orders)
    share = secant.real[:, None, :] + jw[..., None] * (secant.imag / drive.omega[:, None])[:, None, :]
    both = linear_stiffness(model, p, jw)
    both = both + np.einsum("nhe,ei,ej->nhij", share, B, np.concatenate([B, D], axis=1))
    n = model.n
    driven = -np.einsum("nhij,nhj->nhi", both[..., n:], drive.U) + np.einsum("ij,nhj->nhi", model.S, drive.f)
    inverse = _regular_inverse(both[..., :n])
    X = np.einsum("nhij,nhj->nhi", inverse, driven)
    return LinearPart(inverse, B @ inverse @ B.T, share, driven, X @ B.T + drive.U @ D.T)


def linear_stiffness(model: Model, p: Real, jw: Complex) -> Complex:
    """[D | −R] of the linear elements at each harmonic, (N, H + 1, n, n + r)."""
    omega = jw.imag
    factors = model.factors(omega)  # (N, H + 1, elements), 0 for nonlinear ones
    return np.einsum(
        "nhe,ei,ej->nhij", p[:, None, :] * factors, model.B, np.concatenate([model.B, model.D], axis=1)
    )


def _regular_inverse(D: Complex) -> Complex:
    """D⁻¹; what nothing holds (a floating rig at order 0) is held by a spring too soft to matter."""
    n = D.shape[-1]
    if not n:  # elements between inputs and ground alone
        return D
    constant, size = D[:, 0], np.max(np.abs(D), axis=(-2, -1))
    diagonal = np.sqrt(np.abs(np.diagonal(constant, axis1=-2, axis2=-1)))
    held = np.where(diagonal > 0, diagonal, 1.0)
    with np.errstate(all="ignore"):
        scaled = constant / (held[:, :, None] * held[:, None, :])
        least = np.linalg.svd(np.where(np.isfinite(scaled), scaled, 0.0), compute_uv=False)[:, -1]
    loose = (least < 1e-12 * n) | np.any(diagonal == 0, axis=-1)
    largest = np.max(size, axis=1)
    soft = 1e-10 * np.where(size[:, 0] > 1e-12 * largest, size[:, 0], largest)
    regular = D.copy()
    regular[:, 0] += np.where(loose, soft, 0.0)[:, None, None] * np.eye(n)
    try:
        with np.errstate(all="ignore"):
            return np.linalg.inv(regular).astype(np.complex128)
    except np.linalg.LinAlgError:
        return np.full_like(D, np.nan)


# The equations of harmonic balance in the elongations of the nonlinear elements, and Newton's method on
# them.


SETTLED = 1e-8  # of the elongation: with less than this left over, a response counts as found


@dataclass(frozen=True)
class Balance:
    """The equations of N dwells in the elongations of the nonlinear elements, δ − free + Z (p a − s δ) = 0.

    free (N, e, W) as real numbers; strength (N, e, 1): p; Z and s: receptance and share of the linear part.
    """

    linear: LinearPart
    free: Real
    strength: Real

    @property
    def scale(self) -> Real:
        """Largest elongation without nonlinear forces, (N,)."""
        return np.max(np.abs(self.free), axis=(1, 2))

    def rows(self, keep: Bools | Ints) -> Balance:
        """Those of some of the dwells."""
        return Balance(self.linear.rows(keep), self.free[keep], self.strength[keep])

    def rest(self, q: Real, unit: Real) -> Complex:
        """p a − s δ, (N, H + 1, e)."""
        rest = complex_of(self.strength * unit)
        return rest.swapaxes(1, 2) - self.linear.share * complex_of(q).swapaxes(1, 2)

    def residual(self, q: Real, unit: Real) -> Real:
        """What is left over at elongations q with the harmonics `unit` of the unit forces, (N, e, W)."""
        pulled = (self.linear.receptance @ self.rest(q, unit)[..., None])[..., 0]
        return q - self.free + real_of(pulled.swapaxes(1, 2))

    def matrix(self, slope: Real) -> Real:
        """∂residual/∂q, (N, e W, e W), for slopes ∂a/∂q (N, e, W, W)."""
        N, e, W = slope.shape[:3]
        unit = complex_of(np.eye(W)).T[None, :, None]  # (1, H + 1, 1, W): δ along its own real numbers
        inner = complex_rows(self.strength[..., None] * slope) - self.linear.share[..., None] * unit
        both = self.linear.receptance[..., None] * inner[:, :, None]  # (N, H + 1, e, e, W)
        return rows_of(both.reshape(*both.shape[:3], e * W)).reshape(N, e * W, e * W) + np.eye(e * W)

    @property
    def feeds_back(self) -> bool:
        """Whether any nonlinear element has a strength: without one, the motion is that of the linear part."""
        return bool(np.any(self.strength))

    def solved(self, slope: Real, right: Real) -> Real:
        """matrix⁻¹ right (N, e W, Q), NaN where a matrix is singular."""
        return solved(self.matrix(slope), right) if self.feeds_back else right


def balance(model: Model, p: Real, drive: Drive, secant: Complex) -> Balance:
    """The equations with `secant` (N, e) as the share of the nonlinear elements that the linear part keeps."""
    linear = linear_part(model, p, drive, secant)
    return Balance(linear, real_of(np.moveaxis(linear.free, 1, -1)), p[:, model.nonlinear, None])


def secant_of(p: Real, a: Real, q: Real) -> Complex:
    """Describing function p a₁/δ₁ of each nonlinear element, (N, e), its parts at least 0."""
    d1, a1 = complex_of(q)[..., 1], complex_of(a)[..., 1]
    size = np.abs(d1)
    with np.errstate(all="ignore"):  # of the smallest numbers, whose square is 0
        ratio = p * a1 * np.conj(d1) / np.where(size > 0, size, 1.0) ** 2
    ratio = np.where((size > 0) & np.isfinite(ratio), ratio, 0.0)
    return np.maximum(ratio.real, 0.0) + 1j * np.maximum(ratio.imag, 0.0)


@dataclass(frozen=True)
class Balanced:
    """Elongations q (N, e, W), the unit forces there, and the last Newton step over the elongation, error (N,)."""

    equations: Balance
    q: Real
    forces: Alternated
    error: Real

    @property
    def converged(self) -> Bools:
        """Whether the equations hold, (N,)."""
        return self.error <= SETTLED


def balanced(
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    q: Real,
    times: int,
    *,
    hopeless: Bools | None = None,
) -> Balanced:
    """The equations solved from q (N, e, W) by Newton's method with halved steps; rows `hopeless` stay where they are.

    A dwell leaves when it has settled, or when its residual no longer falls.
    """
    rig = compiled_rig(model, times)
    if rig is not None:
        # What the kernel's arrays are
        ends = compiled_balance(rig, model, p, constants, drive, q, times, hopeless)
        *linear, free, q, a, slope, by_constant, error = ends
        equations = Balance(LinearPart(*linear), free, p[:, model.nonlinear, None])
        parts = tuple(by_constant[..., inner] for inner in model.constant_slices)
        stateless = tuple(np.zeros((len(q), 0)) for _ in parts)
        return Balanced(equations, q, Alternated(a, slope, parts, stateless), error)
    forces = alternate(model, constants, drive.omega, q, times)
    equations = balance(model, p, drive, secant_of(p[:, model.nonlinear], forces.a, q))
    if not equations.feeds_back:
        forces = alternate(model, constants, drive.omega, equations.free, times)
        return Balanced(equations, equations.free, forces, np.zeros(len(q)))
    search = _Newton(
        model, constants, drive.omega, times, Balanced(equations, q.copy(), forces, np.full(len(q), np.inf))
    )
    if hopeless is not None:
        search.leave(hopeless)
    for _ in range(25):  # at most
        if not len(search.rows):
            break
        search.step()
    search.leave(np.ones(len(search.rows), dtype=bool))
    return search.ends


class _Newton:
    """The dwells that still move: their `rows` of `ends`, and q, forces and residual r of these rows."""

    def __init__(self, model: Model, constants: Real, omega: Real, times: int, ends: Balanced) -> None:
        self.model, self.times, self.ends = model, times, ends
        self.constants, self.omega, self.equations = constants, omega, ends.equations
        self.rows: Ints = np.arange(len(ends.q))
        self.q, self.forces, self.error = ends.q, ends.forces, ends.error.copy()
        self.r = self.equations.residual(self.q, self.forces.a)
        self.idle = np.zeros(len(self.rows), dtype=np.int64)
        self.mark = _norm(self.r)

    def leave(self, leaving: Bools) -> None:
        """Write down where some dwells are, and go on without them."""
        rows, ends = self.rows[leaving], self.ends
        ends.q[rows], ends.error[rows] = self.q[leaving], self.error[leaving]
        ends.forces.put(rows, self.forces.rows(leaving))
        stay = ~leaving
        self.rows, self.q, self.error, self.r = self.rows[stay], self.q[stay], self.error[stay], self.r[stay]
        self.forces, self.equations = self.forces.rows(stay), self.equations.rows(stay)
        self.constants, self.omega = self.constants[stay], self.omega[stay]
        self.idle, self.mark = self.idle[stay], self.mark[stay]

    def step(self) -> None:
        """One step of every running dwell; those leave that have settled or lead nowhere."""
        matrix = self.equations.matrix(self.forces.slope)
        step = solved(matrix, self.r.reshape(len(self.q), -1, 1)).reshape(self.q.shape)
        size = np.maximum(np.max(np.abs(self.q), axis=(1, 2)), self.equations.scale)
        size = np.where(size > 0, size, 1.0)
        with np.errstate(all="ignore"):
            self.error = np.max(np.abs(step), axis=(1, 2)) / size
        settled = self.error <= 1e-10  # of the elongation, before the last step, which squares it
        self.q[settled] -= step[settled]
        self.forces.a[settled] -= (self.forces.slope[settled] @ step[settled][..., None])[..., 0]
        norm = _norm(self.r)
        fallen = ~(norm > 0.5 * self.mark)
        self.mark = np.where(fallen, norm, self.mark)
        self.idle = np.where(fallen, 0, self.idle + 1)
        # The residual must fall to half within 8 iterations.
        leaving = settled | ~np.isfinite(self.error) | (self.idle > 8)
        if np.any(leaving):
            self.leave(leaving)
            step, size, norm = step[~leaving], size[~leaving], norm[~leaving]
        if len(self.rows):
            self._move(step, size, norm)

    def _move(self, step: Real, size: Real, norm: Real) -> None:
        """Take the steps, halved where the residual grows; of at most half the elongation."""
        factor = np.where(self.error > 0.5, 0.5 / np.maximum(self.error, 0.5), 1.0)
        q, forces = self.q, self.forces
        self.q = q - factor[:, None, None] * step
        self.forces = alternate(self.model, self.constants, self.omega, self.q, self.times, start=forces)
        self.r = self.equations.residual(self.q, self.forces.a)
        for _ in range(5):
            worse = ~(_norm(self.r) <= norm * (1 + 1e-9) + 1e-14 * size) & (self.error > 1e-9)
            if not np.any(worse):
                break
            factor[worse] /= 2
            nearer = q[worse] - factor[worse][:, None, None] * step[worse]
            there = alternate(
                self.model,
                self.constants[worse],
                self.omega[worse],
                nearer,
                self.times,
                start=forces.rows(worse),
            )
            self.q[worse], self.r[worse] = nearer, self.equations.rows(worse).residual(nearer, there.a)
            self.forces.put(np.flatnonzero(worse), there)


def _norm(r: Real) -> Real:
    return np.linalg.norm(r, axis=(1, 2))


def solved(matrix: Real, right: Real) -> Real:
    """matrix⁻¹ right, (N, n, n) and (N, n, k); NaN where a matrix is singular."""
    try:
        with np.errstate(all="ignore"):
            return np.linalg.solve(matrix, right).astype(np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


# Shares of the drive on the way to a response far from linear
RAMP = (0.03, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0)


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
        lost = np.flatnonzero(~at.converged)
        begun = drive.rows(lost).scaled(RAMP[0])
        q = _linear_start(model, p[lost], constants[lost], begun, count)
        for share in RAMP:
            grown = balanced(model, p[lost], constants[lost], drive.rows(lost).scaled(share), q, count)
            q = grown.q * 1.02
        if np.any(grown.converged):
            lost = lost[grown.converged]
            delta = at.q.copy()
            delta[lost] = grown.q[grown.converged]
            hopeless = ~at.converged
            hopeless[lost] = False
            at = balanced(model, p, constants, drive, delta, count, hopeless=hopeless)
    return periodic_at(model, at)


def samples_of(model: Model, orders: int) -> int:
    """Instants of a period at which the laws are evaluated: more where they are not smooth."""
    smooth = all(law.smooth for law in model.laws)
    wanted = max(6 * (orders + 1), 32) if smooth else max(16 * (orders + 1), 256)
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
    model: Model,
    p: Real,
    drive: Drive,
    at: Periodic,
    a: Complex,
    along_p: Real,
    along_constants: Real,
    along_U: Complex | None = None,
    along_f: Complex | None = None,
) -> Slopes:
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
    real = np.zeros((*at.delta.shape, Q))  # ∂a/∂g dg at fixed motion
    for row, own in enumerate(model.constant_slices):
        if own.stop > own.start:
            real[:, row] = np.einsum("nwg,gq->nwq", at.forces.by_constant[row], along_constants[own])
    by_constant = complex_rows(real)  # (N, H + 1, e, Q)
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


MOST_HARMONICS = 63  # with which motions are followed


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
    return np.max(np.abs(missing), axis=(1, 2)) / np.where(size > 0, size, 1.0)


def settled_orders(
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    start: Real | None = None,
    *,
    tolerance: float = 1e-7,
    most: int = MOST_HARMONICS,
) -> tuple[Periodic, Drive]:
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
