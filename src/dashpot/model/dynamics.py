"""Dynamics of a network: stiffness, response, sensitivities and modes.

The one convention of signs and phases: x(t) = Re(X e^{jωt}).  All functions take leading batch axes on the
parameters p, (..., elements), and on the amplitudes; `omega` is (lines,) in rad/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.errors import ModelError
from dashpot.model.elements import MATRICES
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_small


@dataclass(frozen=True)
class Matrices:
    """M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f (paper eq. 1), and H of the hysteretic dampers (K + jH at ω > 0).

    M, C, K, H: (..., n, n); F, G, J: (..., n, r).  J is not in the paper: it belongs to masses and inerters that
    hang on an input.
    """

    M: Real
    C: Real
    K: Real
    H: Real
    F: Real
    G: Real
    J: Real


def _assemble(model: Model, p: Real, letter: str) -> Real:
    """Σ p_i b_iᵀ [b_i | d_i] over the elements of M, C, K or H, flattened; (..., n (n + r))."""
    products, own = model.products[letter], p[..., model.by_matrix[letter]]
    if not own.shape[-1]:
        return np.zeros((*p.shape[:-1], products.shape[1]))
    if isinstance(products, np.ndarray):
        return own @ products
    flat: Real = own.reshape(-1, own.shape[-1]) @ products
    return flat.reshape(*p.shape[:-1], products.shape[1])


def matrices(model: Model, p: Real) -> Matrices:
    """Matrices of the rig with parameters p of shape (..., elements).  Paper eq. 1 and 6."""
    n, r = model.n, model.D.shape[1]
    both = {letter: _assemble(model, p, letter).reshape(*p.shape[:-1], n, n + r) for letter in MATRICES}
    own = {letter: part[..., :n] for letter, part in both.items()}
    driven = {letter: -part[..., n:] for letter, part in both.items()}
    return Matrices(own["M"], own["C"], own["K"], own["H"], driven["C"], driven["K"], driven["M"])


def stiffness(model: Model, p: Real, omega: Real) -> Complex:
    """Bᵀ diag(p φ) [B | D]: dynamic stiffness and, behind it, −R of the inputs; (..., lines, n, n + r), N/m."""
    n, r = model.n, model.D.shape[1]
    total = np.zeros((*p.shape[:-1], len(omega), n * (n + r)), dtype=np.complex128)
    for letter, members in model.by_matrix.items():
        if len(members):
            total += MATRICES[letter].factor(omega)[:, None] * _assemble(model, p, letter)[..., None, :]
    return total.reshape(*total.shape[:-1], n, n + r)


def dynamic_stiffness(model: Model, p: Real, omega: Real) -> Complex:
    """Bᵀ diag(p φ) B, shape (..., lines, n, n), N/m."""
    return stiffness(model, p, omega)[..., : model.n]


def input_stiffness(model: Model, p: Real, omega: Real) -> Complex:
    """R = −Bᵀ diag(p φ) D, the force on the coordinates per unit of input displacement; (..., lines, n, r), N/m."""
    return -stiffness(model, p, omega)[..., model.n :]


def no_steady_response() -> ModelError:
    """The error of a rig that hits an undamped resonance, or has a coordinate that nothing holds."""
    return ModelError(
        "the rig has no steady response at some frequency",
        cure="an undamped resonance is hit, or a coordinate has neither mass nor spring: change one of them",
    )


def amplitudes(model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None) -> Complex:
    """As `response`, with NaN where the rig has no steady response: for searches, which may pass through anything."""
    both = stiffness(model, p, omega)
    force = -np.einsum("...ij,...j->...i", both[..., model.n :], U)
    if f is not None:
        force = force + np.einsum("ij,...j->...i", model.S, f)
    return solve_small(both[..., : model.n], force[..., None])[..., 0]


def response(model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None) -> Complex:
    """Amplitudes X of the coordinates, (..., lines, n), m, to inputs U (..., lines, r) and forces f (..., lines, s).

    Raises ModelError where the rig has no steady response: an undamped resonance is hit, or nothing holds a
    coordinate.
    """
    X = amplitudes(model, p, omega, U, f)
    if not np.all(np.isfinite(X)):
        raise no_steady_response()
    return X


def elongations(model: Model, X: Complex, U: Complex) -> Complex:
    """δ_i = b_i·X + d_i·U, shape (..., lines, elements)."""
    return X @ model.B.T + U @ model.D.T


def unit_forces(model: Model, omega: Real, X: Complex, U: Complex) -> Complex:
    """a_i = φ_i(ω) (b_i·X + d_i·U), shape (..., lines, elements), N per unit of p_i.  THEORY (E)."""
    return model.factors(omega) * elongations(model, X, U)


def sensitivities(model: Model, p: Real, omega: Real, X: Complex, U: Complex) -> Complex:
    """∂X/∂p_i = −D⁻¹ b_iᵀ a_i, shape (..., lines, n, elements).  THEORY §4."""
    forces = model.B.T * unit_forces(model, omega, X, U)[..., None, :]
    return -solve_small(dynamic_stiffness(model, p, omega), forces)


@dataclass(frozen=True)
class Modes:
    """Eigenvalues with Im ≥ 0 (one of each conjugate pair, and the real ones), in order of magnitude.

    eigenvalues: (..., modes), 1/s; shapes: (..., modes, n), largest entry 1; `sensitivity` is ∂λ/∂p,
    (..., modes, elements).
    """

    eigenvalues: Complex
    shapes: Complex
    sensitivity: Complex

    @property
    def frequency_hz(self) -> Real:
        """|λ| / 2π."""
        return np.abs(self.eigenvalues) / (2 * np.pi)

    @property
    def damping_ratio(self) -> Real:
        """−Re λ / |λ|."""
        magnitude = np.abs(self.eigenvalues)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(magnitude > 0, -self.eigenvalues.real / magnitude, 0.0) + 0.0  # no −0


def modes(model: Model, p: Real) -> Modes:
    """Modes of one rig, p of shape (elements,).  (λ² M + λ C + K + jH) φ = 0.

    Massless coordinates give infinite eigenvalues, which are left out; with hysteretic dampers only Im λ > 0 has a
    meaning.  A rigid-body motion without damping is a double zero.  The sensitivity is
    ∂λ/∂p_i = −φ_i(λ) (b_i·φ)² / (φᵀ (2λM + C) φ), all matrices being symmetric; it is not finite where eigenvalues
    coincide.
    """
    parts = matrices(model, p)
    n = model.n
    # Time is scaled to make stiffness and inertia alike in size: the pencil's rank decisions depend on it.
    rate = _typical_rate(parts)
    K = parts.K + 1j * parts.H if np.any(parts.H) else parts.K
    zero, one = np.zeros((n, n)), np.eye(n)
    scale = np.max(np.abs(K)) + rate * np.max(np.abs(parts.C)) + rate**2 * np.max(np.abs(parts.M))
    if scale == 0:
        raise ModelError(
            "the rig has no modes: all its parameters are zero", cure="give it mass and stiffness"
        )
    A = np.block([[zero, one], [-K / scale, -rate * parts.C / scale]])
    E = np.block([[one, zero], [zero, rate**2 * parts.M / scale]])
    from scipy.linalg import eig  # scipy.linalg costs 50 ms of start-up, and few callers want modes

    (alpha, beta), vectors = eig(A, E, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-10 * np.abs(alpha)
    with np.errstate(all="ignore"):
        values = np.where(finite, alpha / np.where(finite, beta, 1.0), np.inf)
    if _floats(K):
        # Rounding splits a double zero into a pair of the size √ε.
        values = np.where(np.abs(values) < 1e-6, 0.0, values)
    tolerance = 1e-9 * np.abs(values)
    keep: Bools = finite & (values.imag >= -tolerance)
    values, shapes = values[keep] * rate, vectors[:n, keep].T
    values = np.where(np.abs(values.imag) <= 1e-9 * np.abs(values), values.real + 0j, values)
    order = np.lexsort((values.imag, np.round(np.abs(values), 9)))
    values, shapes = values[order], shapes[order]
    biggest = np.take_along_axis(shapes, np.argmax(np.abs(shapes), axis=-1)[:, None], axis=-1)
    shapes = shapes / np.where(biggest == 0, 1.0, biggest)
    return Modes(values, shapes, _eigenvalue_sensitivity(model, parts, values, shapes))


def _floats(K: Complex | Real) -> bool:
    """Whether some motion meets no stiffness; coordinates are scaled, for they may be lengths and angles."""
    size = np.sqrt(np.abs(np.diag(K)))
    if np.any(size == 0):
        return True
    singular = np.linalg.svd(K / np.outer(size, size), compute_uv=False)
    return bool(singular[-1] < 1e-13 * len(K) * singular[0])


def _typical_rate(parts: Matrices) -> float:
    M, C, K = (float(np.max(np.abs(matrix))) for matrix in (parts.M, parts.C, np.hypot(parts.K, parts.H)))
    if M > 0 and K > 0:
        return float(np.sqrt(K / M))
    if C > 0 and K > 0:
        return K / C
    if M > 0 and C > 0:
        return C / M
    return 1.0


def _eigenvalue_sensitivity(model: Model, parts: Matrices, values: Complex, shapes: Complex) -> Complex:
    slope = 2 * values[:, None, None] * parts.M + parts.C
    denominator = np.einsum("ki,kij,kj->k", shapes, slope, shapes)
    factor = model.pole_factors(values)
    elongation = shapes @ model.B.T
    with np.errstate(divide="ignore", invalid="ignore"):
        sensitivity: Complex = -factor * elongation**2 / denominator[:, None]
    return sensitivity
