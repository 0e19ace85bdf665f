"""A large rig on the span of few motions: its channels at any parameters near those where the motions were computed.

x ≈ V y with real V (n, k) that spans the responses to the inputs and the adjoints of the channels at some lines.  By
Galerkin's projection Vᵀ D V y = Vᵀ (R U + S f) the error of a channel is the product of the errors of response and
adjoint: where both lie in the span, values and slopes are exact.  Everything is affine in θ, so that Vᵀ (…) V is
computed once for each unknown, and an evaluation afterwards costs nothing that grows with n.

Modes alike: on the span of the shapes and of their slopes in the unknowns, eigenvalues are exact to second order and
shapes to first about the parameters where the span was made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from dashpot.arrays import Complex, Real
from dashpot.model.dynamics import Matrices, assembled, factorised, solve_stiffness
from dashpot.model.elements import MATRICES
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, calibration_slopes
from dashpot.numerics.small_systems import solve_small

# Squared share of a unit column that lies outside the span, below which it adds rounding only
STRIP = 64  # columns of the basis that are worked on at once


@dataclass(frozen=True)
class ReducedPart:
    """The elements of one matrix that go with one unknown (or, for `unknown` None, their known parameters).

    inner (k, k): Vᵀ B_iᵀ t B_i V; driven (k, r): Vᵀ B_iᵀ t D_i; of channels that measure element forces and reactions
    on_y (channels, k): F_i t B_i V, on_u (channels, r): F_i t D_i.
    """

    letter: str
    unknown: int | None
    inner: Real
    driven: Real
    on_y: Real
    on_u: Real


@dataclass(frozen=True)
class ReducedRig:
    """The parts of a rig on the span of V, and what the channels show there: on_y (channels, k), S (k, s)."""

    parts: tuple[ReducedPart, ...]
    on_y: Real
    S: Real
    size: int

    def transfer(self, view: ObservationModel, theta: Real) -> ReducedTransfer:
        """The channels at θ (..., unknowns); NaN where the reduced rig has no steady response."""
        lead, lines = theta.shape[:-1], len(view.omega)
        k, r = self.size, view.model.D.shape[1]
        stiff = np.zeros((*lead, lines, k, k), dtype=np.complex128)
        driven = np.zeros((*lead, lines, k, r), dtype=np.complex128)
        C_y = np.broadcast_to(view.rates[..., None] * self.on_y, (*lead, lines, *self.on_y.shape)).copy()
        C_q = np.broadcast_to(view.direct_q, (*lead, *view.direct_q.shape)).copy()
        for part in self.parts:
            # The unknown of a part, (..., 1): the factor that its matrices have
            weight = MATRICES[part.letter].factor(view.omega) * (
                np.ones((*theta.shape[:-1], 1)) if part.unknown is None else theta[..., part.unknown, None]
            )
            stiff += weight[..., None, None] * part.inner
            driven += weight[..., None, None] * part.driven
            C_y += weight[..., None, None] * part.on_y
            C_q[..., :r] += weight[..., None, None] * part.on_u
        S = np.broadcast_to(self.S.astype(np.complex128), (*lead, lines, *self.S.shape))
        right = np.concatenate([np.swapaxes(C_y, -1, -2), -driven, S], axis=-1)
        solved = solve_small(stiff, right)
        adjoint, y = np.split(solved, [C_y.shape[-2]], axis=-1)
        return ReducedTransfer(view, self, C_q + C_y @ y, y, adjoint)


@dataclass(frozen=True)
class ReducedTransfer:
    """The channels as functions of the inputs, y = G q, on the span; as `observation.Transfer`.

    G (..., lines, channels, r + s); motion (..., lines, k, r + s) and adjoint (..., lines, k, channels) on the span
    """

    view: ObservationModel
    rig: ReducedRig
    G: Complex
    motion: Complex
    adjoint: Complex
    psi: Real | None = None
    kappa: Complex | None = None

    def calibrated(self, kappa: Complex, psi: Real) -> ReducedTransfer:
        """The same with calibrations κ (..., lines, channels, 1) at ψ."""
        return replace(self, G=kappa * self.G, kappa=kappa, psi=psi)

    def amplitudes(self, q: Complex) -> Complex:
        """y = G q under inputs q (..., lines, r + s); (..., lines, channels)."""
        return np.einsum("...cq,...q->...c", self.G, q)

    def slopes(self, q: Complex) -> Complex:
        """∂y/∂ψ at fixed inputs q (..., lines, r + s), ∂y/∂θ without calibrations; (..., lines, channels, M)."""
        view = self.view
        y = np.einsum("...kq,...q->...k", self.motion, q)
        U = q[..., : view.model.D.shape[1]]
        by_theta = np.zeros((*self.G.shape[:-1], view.m), dtype=np.complex128)
        for part in self.rig.parts:
            if part.unknown is None:
                continue
            phi = MATRICES[part.letter].factor(view.omega)[:, None]
            loads = phi * (y @ part.inner.T + U @ part.driven.T)
            shown = phi * (y @ part.on_y.T + U @ part.on_u.T)
            by_theta[..., part.unknown] += shown - np.einsum("...kc,...k->...c", self.adjoint, loads)
        if self.kappa is not None:
            by_theta = self.kappa * by_theta
        if self.psi is None or not (view.gains or view.delays):
            return by_theta
        return np.concatenate([by_theta, calibration_slopes(view, self.psi, self.amplitudes(q))], axis=-1)


# From motions to a reduced rig


def line_motions(view: ObservationModel, p: Real, line: int) -> Complex:
    """Responses to unit inputs and adjoints of the channels at one line, (n, r + s + channels), at p (elements,).

    NaN where the rig has no steady response.
    """
    model = view.model
    weight = p * view.factors[line]
    C_x = view.rates[line][:, None] * view.on_x
    forces = np.flatnonzero(np.any(view.force, axis=-1))
    if len(forces):
        C_x[forces] += (view.force[forces] * weight) @ model.sparse_B
    driven = model.sparse_B.T @ (weight[:, None] * model.D)
    right = np.concatenate([-driven, model.S.astype(np.complex128), C_x.T], axis=1)
    return solve_stiffness(model, weight, right)


def extended_basis(V: Real, motions: Complex) -> Real:
    """The columns of V and an orthonormal basis of what real and imaginary parts of `motions` (n, …) add to them."""
    columns = np.concatenate([motions.real, motions.imag], axis=1)
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, np.isfinite(size) & (size > 0)]
    columns /= np.linalg.norm(columns, axis=0)
    for turn in range(2):  # once leaves rounding of the share taken out; twice is enough (Giraud et al. 2005)
        if V.shape[1]:
            columns -= V @ (V.T @ columns)
        values, vectors = np.linalg.eigh(columns.T @ columns)
        kept = values > (1e-14 if turn == 0 else 0.5)
        columns = columns @ (vectors[:, kept] / np.sqrt(values[kept]))
    return np.concatenate([V, columns], axis=1)


def reduced(view: ObservationModel, V: Real) -> ReducedRig:
    """The rig projected on the span of V (n, k)."""
    model = view.model
    found = []
    for letter, unknown, rows, times in _weights(model):
        B, D = model.sparse_B[rows], model.sparse_D[rows]
        driven = V.T @ (B.T @ (times[:, None] * D.toarray()))
        F = sparse.csr_array(view.force[:, rows] * times)
        on_y, on_u = (F @ B) @ V, (F @ D).toarray()
        found.append(ReducedPart(letter, unknown, _inner(model, rows, times, V), driven, on_y, on_u))
    parts = tuple(found)
    return ReducedRig(parts, view.on_x @ V, V.T @ model.S, V.shape[1])


def _weights(model: Model) -> Iterator[tuple[str, int | None, np.ndarray, Real]]:
    """(letter, unknown, elements, factors) of everything that enters a matrix with one common factor."""
    T = model.sparse_T.tocoo()
    of_element = np.full(len(model.elements), -1, dtype=np.int64)
    times = model.p0.copy()
    of_element[T.row], times[T.row] = T.col, T.data
    by_matrix: Mapping[str, np.ndarray] = model.by_matrix
    for letter, members in by_matrix.items():
        for unknown in np.unique(of_element[members]):
            rows = members[of_element[members] == unknown]
            if np.any(times[rows]):
                yield letter, None if unknown < 0 else int(unknown), rows, times[rows]


def _inner(model: Model, rows: np.ndarray, times: Real, V: Real) -> Real:
    """Vᵀ Bᵀ t B V of some elements, (k, k)."""
    B = model.sparse_B[rows]
    stiff = sparse.csr_array(B.T @ (B * times[:, None]))
    inner = np.empty((V.shape[1], V.shape[1]))
    for first in range(0, V.shape[1], STRIP):
        strip = slice(first, first + STRIP)
        inner[:, strip] = V.T @ (stiff @ V[:, strip])
    return (inner + inner.T) / 2


# Modes


@dataclass(frozen=True)
class ModalRig:
    """M, C, K and H of a rig on the span of V (n, k): of each matrix the part of each unknown, (letter, unknown, (k,
    k)), and for `unknown` None what is known."""

    V: Real
    parts: tuple[tuple[str, int | None, Real], ...]
    unknowns: int

    @staticmethod
    def of(model: Model, V: Real) -> ModalRig:
        """The rig projected on V."""
        weights = _weights(model)
        parts = tuple(
            (letter, unknown, _inner(model, rows, times, V)) for letter, unknown, rows, times in weights
        )
        return ModalRig(V, parts, len(model.unknowns))

    def matrices(self, theta: Real) -> Matrices:
        """At θ (K, unknowns), each (K, k, k)."""
        k = self.V.shape[1]
        total = {letter: np.zeros((len(theta), k, k)) for letter in MATRICES}
        for letter, unknown, inner in self.parts:
            total[letter] += inner if unknown is None else theta[:, unknown, None, None] * inner
        none = np.zeros((len(theta), k, 0))
        return Matrices(total["M"], total["C"], total["K"], total["H"], none, none, none)

    def forces(self, values: Complex, shapes: Complex) -> Complex:
        """−∂P/∂θ φ at eigenvalues (..., modes) and shapes (..., modes, k); (..., modes, k, unknowns)."""
        found = np.zeros((*shapes.shape, self.unknowns), dtype=np.complex128)
        for letter, unknown, inner in self.parts:
            if unknown is not None:
                found[..., unknown] -= MATRICES[letter].pole_factor(values)[..., None] * (shapes @ inner)
        return found


def lowest_shapes(model: Model, p: Real, highest: float, least: int) -> Real:
    """Shapes (n, modes) of the rig without its dampers, by frequency: those below `highest` (rad/s), `least` or more.

    p (elements,).  Lanczos' method about a rate below all of them, so that free bodies have their rigid motions.
    Raises RuntimeError where nothing holds a coordinate.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh  # which takes long to load

    def matrix(letter: str) -> sparse.csc_array:
        weight, members = np.zeros(len(p)), model.by_matrix[letter]
        weight[members] = p[members]
        return assembled(model, weight)

    K, M, shift = matrix("K"), matrix("M"), -((0.1 * highest) ** 2)
    factors = factorised(sparse.csc_array(K - shift * M))
    solve = LinearOperator(K.shape, matvec=factors.solve, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(model.n)
    count, most = least, max(least, min(128, model.n // 3))  # modes of a span
    while True:
        squares, shapes = eigsh(K, count, M=M, sigma=shift, OPinv=solve, v0=start)
        if np.max(squares) > highest**2 or count >= most:
            return np.asarray(shapes)
        count = min(2 * count, most)


def mode_motions(
    model: Model, p: Real, span: ModalRig, values: Complex, shapes: Complex
) -> tuple[Complex, Real]:
    """What the span lacks about modes of its rig, (n, columns), and by how much it misses their eigenvalues, |δλ / λ|.

    values (modes,), shapes on the span (modes, k), p (elements,).  Of each mode what its residual P(λ)φ asks for, which
    gives δλ = φᵀP P⁻¹ Pφ / φᵀP′φ, and its slopes, P⁻¹ ∂P/∂θ φ, next to other modes of the span: P is taken
    a thousandth off λ, where it has an inverse.
    """
    columns, missed = [], []
    for lam, on_span in zip(values, shapes, strict=True):
        phi = span.V @ on_span
        stretch = model.pole_factors(lam) * (model.sparse_B @ phi)
        residual = model.sparse_B.T @ (p * stretch)
        forces = model.sparse_B.T @ (model.sparse_T * stretch[:, None])
        near = lam * (1 + 1e-3)
        asked = np.column_stack([residual, forces.toarray()])
        found = solve_stiffness(model, p * model.pole_factors(near), asked)
        step = 1e-6 * lam
        steeper = p * (model.pole_factors(lam + step) - model.pole_factors(lam - step)) / (2 * step)
        slope = np.sum(steeper * (model.sparse_B @ phi) ** 2)
        columns.append(found)
        missed.append(abs(residual @ found[:, 0] / slope / lam))
    return np.concatenate(columns, axis=1), np.array(missed)
