"""Modes: eigenvalues and shapes of the quadratic pencil λ² M + λ C + K + jH, and their sensitivities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.errors import ModelError
from dashpot.model.dynamics import Matrices, matrices
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_small


@dataclass(frozen=True)
class Modes:
    """Eigenvalues with Im ≥ 0 (one of each conjugate pair, and the real ones), in order of magnitude.

    eigenvalues  λ, (..., modes), 1/s
    shapes       (..., modes, n), largest entry 1
    sensitivity  ∂λ/∂p, (..., modes, elements)
    """

    eigenvalues: Complex
    shapes: Complex
    sensitivity: Complex

    @property
    def frequency_hz(self) -> Real:
        """|λ| / 2π, (..., modes), Hz."""
        return np.abs(self.eigenvalues) / (2 * np.pi)

    @property
    def damping_ratio(self) -> Real:
        """−Re λ / |λ|, (..., modes)."""
        magnitude = np.abs(self.eigenvalues)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(magnitude > 0, -self.eigenvalues.real / magnitude, 0.0) + 0.0  # no −0


def eigenmodes(model: Model, p: Real) -> Modes:
    """Modes of one rig, p of shape (elements,).  (λ² M + λ C + K + jH) φ = 0.

    Massless coordinates give infinite eigenvalues, which are left out; with hysteretic dampers only Im λ > 0 has a
    meaning.  A rigid-body motion without damping is a double zero.  The sensitivity is
    ∂λ/∂p_i = −φ_i(λ) (b_i·φ)² / (φᵀ (2λM + C) φ), all matrices being symmetric; it is not finite where eigenvalues
    coincide.  None of a rig without coordinates.  Raises ModelError if all parameters are zero.
    """
    if not model.n:
        nothing = np.zeros((0, 0), dtype=np.complex128)
        return Modes(nothing.ravel(), nothing, np.zeros((0, len(model.elements)), dtype=np.complex128))
    parts = matrices(model, p)
    poles, shapes = _in_order(parts)
    denominator = ((2 * poles[:, None] * (shapes @ parts.M) + shapes @ parts.C) * shapes).sum(axis=-1)
    factor = model.pole_factors(poles)
    elongation = shapes @ model.B.T
    with np.errstate(divide="ignore", invalid="ignore"):
        sensitivity: Complex = -factor * elongation**2 / denominator[:, None]
    return Modes(poles, shapes, sensitivity)


def _in_order(parts: Matrices) -> tuple[Complex, Complex]:
    """Eigenvalues with Im ≥ 0 of one rig by their size, (modes,), and shapes (modes, n), largest entry 1."""
    # The largest entries of M, C and K + jH
    stiffness = np.hypot(parts.K, parts.H) if parts.H.any() else parts.K
    inertia, damping, stiff = (float(np.abs(matrix).max()) for matrix in (parts.M, parts.C, stiffness))
    rate = _typical_rate(inertia, damping, stiff)
    n = parts.M.shape[-1]
    K = parts.K + 1j * parts.H if parts.H.any() else parts.K
    # Time is scaled to make stiffness and inertia alike in size: the pencil's rank decisions depend on it.
    scale = stiff + rate * damping + rate**2 * inertia
    if scale == 0:
        raise ModelError(
            "the rig has no modes: all its parameters are zero", cure="give it mass and stiffness"
        )
    A = np.zeros((2 * n, 2 * n), dtype=K.dtype)
    A[np.arange(n), n + np.arange(n)] = 1.0
    A[n:, :n], A[n:, n:] = -K / scale, -rate * parts.C / scale
    poles, vectors, finite = _pencil(A, rate**2 * parts.M / scale)
    size = np.abs(poles)
    tiny = size < 1e-6
    if tiny.any() and _floats(K):
        # Rounding splits a double zero into a pair of the size √ε.
        poles, size = np.where(tiny, 0.0, poles), np.where(tiny, 0.0, size)
    keep: Bools = finite & (poles.imag >= -1e-9 * size)
    poles, size, shapes = poles[keep], size[keep], vectors[:n, keep].T
    poles = rate * np.where(np.abs(poles.imag) <= 1e-9 * size, poles.real + 0j, poles).astype(np.complex128)
    if not (parts.C.any() or parts.H.any()):  # λ² is real: an imaginary part left by rounding is no damping
        poles = np.where(np.abs(poles.imag) >= np.abs(poles.real), 1j * poles.imag, poles.real)
    order = np.lexsort((poles.imag, np.round(np.abs(poles), 9)))
    poles, shapes = poles[order], shapes[order]
    largest = shapes[np.arange(len(shapes)), np.abs(shapes).argmax(axis=-1), None]
    shapes = shapes / np.where(largest == 0, 1.0, largest)
    return poles, shapes


def _pencil(A: Complex | Real, M: Real) -> tuple[Complex, Complex, Bools]:
    """Eigenvalues and vectors of A − λ diag(1, M), and which are finite; by M⁻¹ where M is regular, else by QZ."""
    n = len(M)
    size = np.sqrt(np.abs(M.diagonal()))
    if size.all():
        scaled = M / (size[:, None] * size)
        # Masses that nothing couples leave ones on the diagonal.
        # With a least eigenvalue beyond this the inverse is as good as QZ.
        if np.count_nonzero(M) == n or np.linalg.eigvalsh(scaled)[0] > 1e-3:
            A = A.copy()
            A[n:] = np.linalg.solve(scaled, A[n:] / size[:, None]) / size[:, None]
            poles, vectors = np.linalg.eig(A)
            return poles.astype(np.complex128), vectors, np.isfinite(poles)
    from scipy.linalg import eig  # scipy.linalg costs 50 ms of start-up, and few callers need this

    E = np.eye(2 * n)
    E[n:, n:] = M
    (alpha, beta), vectors = eig(A, E, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-10 * np.abs(alpha)
    with np.errstate(all="ignore"):
        poles = np.where(finite, alpha / np.where(finite, beta, 1.0), np.inf)
    return poles, vectors, finite


def _floats(K: Complex | Real) -> bool:
    """Whether some motion meets no stiffness; coordinates are scaled, for they may be lengths and angles."""
    size = np.sqrt(np.abs(np.diag(K)))
    if np.any(size == 0):
        return True
    singular = np.linalg.svd(K / np.outer(size, size), compute_uv=False)
    return bool(singular[-1] < 1e-13 * len(K) * singular[0])


def _typical_rate(M: float, C: float, K: float, damping: float = 0.5, otherwise: float = 1.0) -> float:
    """√(K/M); at a damping ratio 2ζ K/C or C/(2ζ M) where one of them is 0."""
    if M > 0 and K > 0:
        return float(np.sqrt(K / M))
    if C > 0 and K > 0:
        return 2 * damping * K / C
    if M > 0 and C > 0:
        return C / M / (2 * damping)
    return otherwise


def eigenpairs(model: Model, p: Real) -> tuple[Complex, Complex]:
    """Eigenvalues (K, 2n) and shapes (K, 2n, n) of many rigs, p (K, elements); NaN where a rig has fewer.

    All of them, conjugates and real ones included, in no order; only Im λ > 0 has a meaning with hysteretic dampers.
    """
    return eigenpairs_of(matrices(model, p))


def eigenpairs_of(parts: Matrices) -> tuple[Complex, Complex]:
    """As `eigenpairs`, of matrices (K, n, n).

    Rigs whose mass matrix is regular are solved together, which is faster than `eigenmodes` of each; without damping
    as the symmetric problem that they are, of half the size.
    """
    n = parts.M.shape[-1]
    K = parts.K + 1j * parts.H if np.any(parts.H) else parts.K
    values = np.full((len(K), 2 * n), np.nan + 0j)
    shapes = np.full((len(K), 2 * n, n), np.nan + 0j)
    size = np.sqrt(np.abs(np.diagonal(parts.M, axis1=-2, axis2=-1)))
    size = np.where(size > 0, size, 1.0)
    scaled = parts.M / (size[:, :, None] * size[:, None, :])
    finite = np.all(np.isfinite(parts.M) & np.isfinite(parts.C) & np.isfinite(K), axis=(-1, -2))
    least = np.full(len(K), np.nan)
    least[finite] = np.linalg.eigvalsh(scaled[finite])[:, 0]
    regular = finite & (least > 1e-9)
    indefinite = finite & (least < 0)
    regular[indefinite] = np.linalg.svd(scaled[indefinite], compute_uv=False)[:, -1] > 1e-9
    still = regular & (least > 0) & ~np.any(parts.C, axis=(-1, -2)) & ~np.any(parts.H, axis=(-1, -2))
    if np.any(still):
        inverse = np.linalg.inv(np.linalg.cholesky(scaled[still])) / size[still][:, None, :]
        turned = np.swapaxes(inverse, -1, -2)
        squares, vectors = np.linalg.eigh(inverse @ K[still].real @ turned)
        poles = np.sqrt(-squares + 0j)
        values[still] = np.concatenate([poles, -poles], axis=-1)
        shapes[still] = np.tile(np.swapaxes(turned @ vectors, -1, -2), (1, 2, 1))
    damped = regular & ~still
    if np.any(damped):
        both = np.concatenate([K[damped], parts.C[damped].astype(K.dtype)], axis=-1)
        right = both / size[damped][:, :, None] / np.concatenate([size[damped]] * 2, axis=-1)[:, None, :]
        A = np.zeros((int(np.sum(damped)), 2 * n, 2 * n), dtype=K.dtype)
        A[:, :n, n:] = np.eye(n)
        A[:, n:] = -np.linalg.solve(scaled[damped], right)
        # Where a search has run off to, rounding may leave nothing finite: such a rig has no modes.
        whole = np.all(np.isfinite(A), axis=(-1, -2))
        poles, vectors = np.linalg.eig(np.where(whole[:, None, None], A, 0.0))
        values[damped] = np.where(whole[:, None], poles, np.nan)
        shapes[damped] = np.swapaxes(vectors[:, :n], -1, -2) / size[damped][:, None, :]
    for k in np.flatnonzero(finite & ~regular):  # massless coordinates: fewer modes, found one rig at a time
        own = Matrices(*(part[k] for part in (parts.M, parts.C, parts.K, parts.H, parts.F, parts.G, parts.J)))
        poles, vectors = _in_order(own)
        values[k, : len(poles)] = poles
        shapes[k, : len(poles)] = vectors
    return values, shapes


def mode_sensitivities(
    model: Model, p: Real, values: Complex, shapes: Complex, along: Real | None = None
) -> tuple[Complex, Complex]:
    """∂λ (..., modes, u) and ∂φ (..., modes, n, u) with φᴴ ∂φ = 0, along directions (elements, u) of p.

    Of each element by itself where `along` is not given.  p (..., elements); values (..., modes); shapes (..., modes,
    n).  Not finite where eigenvalues coincide.
    """
    stretch = model.pole_factors(values) * (shapes @ model.B.T)
    forces = -np.swapaxes(model.B * stretch[..., None], -1, -2)
    return sensitivities_of(matrices(model, p), forces if along is None else forces @ along, values, shapes)


def sensitivities_of(
    parts: Matrices, forces: Complex, values: Complex, shapes: Complex
) -> tuple[Complex, Complex]:
    """∂λ (..., modes, u) and ∂φ (..., modes, n, u) under forces −∂P φ (..., modes, n, u); φᴴ ∂φ = 0.

    From (λ²M + λC + K + jH) φ = 0, differentiated and bordered (Nelson 1976; Lee, Jung and Lee 1999):
    [P, P′φ; φᴴ, 0] (∂φ; ∂λ) = (−∂P φ; 0), one solve a mode for all u.
    """
    n, count = forces.shape[-2:]
    K = (parts.K + 1j * parts.H)[..., None, :, :]
    M, C = parts.M[..., None, :, :], parts.C[..., None, :, :]
    lam = values[..., None, None]
    P = lam**2 * M + lam * C + K
    slope = ((2 * lam * M + C) @ shapes[..., None])[..., 0]
    # Rows in units of the largest entry, ∂λ in units of |λ|, so that the border is as large as what it borders.
    size = np.max(np.abs(P), axis=(-1, -2), keepdims=True)
    size = np.where(size > 0, size, 1.0)
    rate = np.where(np.abs(values) > 0, np.abs(values), 1.0)[..., None]
    length = np.linalg.norm(shapes, axis=-1, keepdims=True)
    system = np.zeros((*values.shape, n + 1, n + 1), dtype=complex)
    system[..., :n, :n] = P / size
    system[..., :n, n] = slope * (rate / length) / size[..., 0]
    system[..., n, :n] = np.conj(shapes) / length
    right = np.zeros((*values.shape, n + 1, count), dtype=complex)
    right[..., :n, :] = forces / size
    both = solve_small(system, right)
    dlam: Complex = both[..., n, :] * rate / length
    return dlam, both[..., :n, :]


def typical_sizes(model: Model) -> tuple[Mapping[Kind, float], float]:
    """(a parameter's size by kind, a typical ω in rad/s) from known values and guesses, where nothing states.

    A damping ratio of 0.05 goes with them, and 30 rad/s where nothing tells.
    """
    ratio = 0.05
    typical = []
    for letter in "MCK":
        elements = (
            e for e in model.elements if e.law.matrix == letter and e.force_law is None and e.block is None
        )
        numbers = (e.guess if e.value is None else e.value for e in elements)
        given = [number for number in numbers if number is not None and number > 0]
        typical.append(float(np.exp(np.mean(np.log(given)))) if given else 0.0)
    m, c, k = typical
    rate = _typical_rate(m, c, k, ratio, otherwise=30.0)
    mass = m or (k / rate**2 if k else c / rate / (2 * ratio) if c else 1.0)
    middle = {"M": m, "C": c, "K": k}
    sizes = {kind: middle.get(kind.law.matrix) or kind.law.typical_size(mass, rate, ratio) for kind in Kind}
    return sizes, rate
