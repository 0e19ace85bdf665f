"""Dynamics of a network: stiffness, response and sensitivities.

The one convention of signs and phases: x(t) = Re(X e^{jωt}).  All functions take leading batch axes on the
parameters p, (..., elements), and on the amplitudes; `omega` is (lines,) in rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dashpot.arrays import Complex, Ints, Real
from dashpot.errors import ModelError
from dashpot.model.elements import MATRICES
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_small

# The dynamic stiffness of large rigs in its sparse pattern, factorised line by line (THEORY §10).


FROM = 300  # coordinates from which responses are computed in the sparse pattern


def solve_stiffness(model: Model, weight: Complex, right: Complex) -> Complex:
    """D⁻¹ right with D = Bᵀ diag(weight) B, weight = p φ(ω) (elements,), right (n, k); NaN where D is singular."""
    return stiffness_solver(model, weight)(right)


def stiffness_solver(model: Model, weight: Complex) -> Callable[[Complex], Complex]:
    """`solve_stiffness` as a function of the right side, D being factorised once.

    SuperLU with the ordering of AᵀA's pattern is slow and full for these matrices; minimum degree on A + Aᵀ in
    symmetric mode, pivots staying on the diagonal, keeps a chain's factors as sparse as the chain.
    """
    try:
        factors = factorised(assembled(model, weight))
    except RuntimeError:  # exactly singular
        return lambda right: np.full(right.shape, np.nan, dtype=np.complex128)
    return lambda right: np.asarray(factors.solve(np.asarray(right, dtype=np.complex128)))


def assembled(model: Model, weight: Real | Complex) -> sparse.csc_array:
    """Bᵀ diag(weight) B in the sparse pattern, weight (elements,)."""
    indices, indptr, A = model.assembly
    values: Any = A @ weight
    return sparse.csc_array((values, indices, indptr), shape=(model.n, model.n))


def factorised(matrix: sparse.csc_array) -> Any:
    """SuperLU's factors of a symmetric matrix.  Raises RuntimeError where it is exactly singular."""
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def sparse_amplitudes(
    model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None, experiment: Ints | None = None
) -> Complex:
    """As `dynamics.amplitudes`, line by line in the sparse pattern: X (..., lines, n), NaN without steady response."""
    B, D, factors = model.sparse_B, model.sparse_D, model.factors(omega, experiment)
    lead = np.broadcast_shapes(p.shape[:-1], U.shape[:-2], () if f is None else f.shape[:-2])
    lines = len(omega)
    count = int(np.prod(lead, dtype=int))
    each_p = np.broadcast_to(p, (*lead, p.shape[-1])).reshape(count, p.shape[-1])
    each_U = np.broadcast_to(U, (*lead, *U.shape[-2:])).reshape(count, *U.shape[-2:])
    each_f = None if f is None else np.broadcast_to(f, (*lead, *f.shape[-2:])).reshape(count, *f.shape[-2:])
    X = np.empty((len(each_p), lines, model.n), dtype=np.complex128)
    for k, parameters in enumerate(each_p):
        for line in range(lines):
            weight = parameters * factors[line]
            load = -(B.T @ (weight * (D @ each_U[k, line])))
            if each_f is not None:
                load = load + model.S @ each_f[k, line]
            X[k, line] = solve_stiffness(model, weight, load[:, None])[:, 0]
    return X.reshape(*lead, lines, model.n)


@dataclass(frozen=True)
class Matrices:
    """M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f (paper eq. 1), and H of the hysteretic dampers (K + jH at ω > 0).

    M, C, K, H: (..., n, n); F, G, J: (..., n, r); SI units.  J is not in the paper: it comes from masses and
    inerters attached to an input.
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
    products, parameters = model.products[letter], p[..., model.by_matrix[letter]]
    if not parameters.shape[-1]:
        return np.zeros((*p.shape[:-1], products.shape[1]))
    if isinstance(products, np.ndarray):
        return parameters @ products
    flat: Real = parameters.reshape(-1, parameters.shape[-1]) @ products
    return flat.reshape(*p.shape[:-1], products.shape[1])


def matrices(model: Model, p: Real) -> Matrices:
    """Matrices of the rig with parameters p of shape (..., elements), SI units.  Paper eq. 1 and 6.

    p is the result of `model.parameters(theta)`, which raises ModelError if values are missing; NumPy raises
    ValueError if p has a different number of elements.
    """
    n, r = model.n, model.D.shape[1]
    both = {letter: _assemble(model, p, letter).reshape(*p.shape[:-1], n, n + r) for letter in MATRICES}
    inner = {letter: part[..., :n] for letter, part in both.items()}
    driven = {letter: -part[..., n:] for letter, part in both.items()}
    return Matrices(inner["M"], inner["C"], inner["K"], inner["H"], driven["C"], driven["K"], driven["M"])


def stiffness(model: Model, p: Real, omega: Real, experiment: Ints | None = None) -> Complex:
    """Bᵀ diag(p φ) [B | D]: dynamic stiffness and, behind it, −R of the inputs; (..., lines, n, n + r), N/m.

    `experiment` (lines,) says in which one the lines were measured, of a rig that differs by experiment.
    """
    n, r = model.n, model.D.shape[1]
    total = np.zeros((*p.shape[:-1], len(omega), n * (n + r)), dtype=np.complex128)
    for rig, lines in model.by_experiment(experiment):
        for letter, members in rig.by_matrix.items():
            if len(members):
                factor = MATRICES[letter].factor(omega[lines])[:, None]
                total[..., lines, :] += factor * _assemble(rig, p, letter)[..., None, :]
    return total.reshape(*total.shape[:-1], n, n + r)


def stiffness_over_lines(model: Model, p: Real, omega: Real, experiment: Ints | None = None) -> Complex:
    """As `stiffness` with the lines last, (..., n, n + r, lines): for sums over many lines."""
    n, r = model.n, model.D.shape[1]
    total = np.zeros((*p.shape[:-1], n * (n + r), len(omega)), dtype=np.complex128)
    for rig, lines in model.by_experiment(experiment):
        for letter, members in rig.by_matrix.items():
            if len(members):
                factor = MATRICES[letter].factor(omega[lines])
                total[..., lines] += _assemble(rig, p, letter)[..., :, None] * factor
    return total.reshape(*total.shape[:-2], n, n + r, len(omega))


def dynamic_stiffness(model: Model, p: Real, omega: Real, experiment: Ints | None = None) -> Complex:
    """Bᵀ diag(p φ) B, shape (..., lines, n, n), N/m."""
    return stiffness(model, p, omega, experiment)[..., : model.n]


def require_masses(M: Real | Complex) -> None:
    """Raises ModelError if a mass matrix (..., n, n) is singular but for rounding: no motion in time follows."""
    if not M.shape[-1]:
        return
    size = np.sqrt(np.abs(np.diagonal(M, axis1=-2, axis2=-1)))
    if np.any(size == 0) or np.any(np.linalg.cond(M / (size[..., :, None] * size[..., None, :])) > 1e13):
        raise ModelError(
            "the rig has a coordinate without mass, so its motion in time is not determined",
            cure="give every coordinate a mass",
        )


def no_steady_response() -> ModelError:
    """The error of a rig that hits an undamped resonance, or has a coordinate that nothing holds."""
    return ModelError(
        "the rig has no steady state at some frequency",
        cure="it is an undamped resonance, or a coordinate has neither mass nor spring: change one of them",
    )


def amplitudes(
    model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None, experiment: Ints | None = None
) -> Complex:
    """As `response`, (..., lines, n), with NaN where there is no steady response: searches pass through anything."""
    if model.n >= FROM:
        return sparse_amplitudes(model, p, omega, U, f, experiment)
    both = stiffness(model, p, omega, experiment)
    force = -np.einsum("...ij,...j->...i", both[..., model.n :], U)
    if f is not None:
        force = force + np.einsum("ij,...j->...i", model.S, f)
    return solve_small(both[..., : model.n], force[..., None])[..., 0]


def response(model: Model, p: Real, omega: Real, U: Complex, f: Complex | None = None) -> Complex:
    """Amplitudes X of the coordinates, (..., lines, n), m, to inputs U (..., lines, r) and forces f (..., lines, s).

    p (..., elements), SI units; omega (lines,), rad/s.  Raises ModelError if the rig has no steady response: it is
    driven at an undamped resonance, or a coordinate is unsupported.
    """
    X = amplitudes(model, p, omega, U, f)
    if not np.all(np.isfinite(X)):
        raise no_steady_response()
    return X


def elongations(model: Model, X: Complex, U: Complex) -> Complex:
    """δ_i = b_i·X + d_i·U, shape (..., lines, elements)."""
    if model.n < FROM:
        return X @ model.B.T + U @ model.D.T
    flat: Complex = np.asarray(X.reshape(-1, model.n) @ model.sparse_B.T)
    return flat.reshape(*X.shape[:-1], len(model.elements)) + U @ model.D.T


def unit_forces(model: Model, omega: Real, X: Complex, U: Complex, experiment: Ints | None = None) -> Complex:
    """a_i = φ_i(ω) (b_i·X + d_i·U), shape (..., lines, elements), N per unit of p_i.  THEORY (E)."""
    return model.factors(omega, experiment) * elongations(model, X, U)


def sensitivities(model: Model, p: Real, omega: Real, X: Complex, U: Complex) -> Complex:
    """∂X/∂p_i = −D⁻¹ b_iᵀ a_i, shape (..., lines, n, elements), m per unit of p_i.  THEORY §4.

    p (..., elements), SI units; X (..., lines, n) is the response to U (..., lines, r) at omega (lines,), rad/s.  NaN
    (no error) where the rig has no steady response.
    """
    forces = model.B.T * unit_forces(model, omega, X, U)[..., None, :]
    return -solve_small(dynamic_stiffness(model, p, omega), forces)


def kernel_rig(kernel: Any, model: Model, omega: Real, experiment: Ints | None = None) -> Any | None:
    """A rig at its lines as the compiled kernel takes it; the last ones are kept.

    omega (lines,), rad/s.  None of nonlinear rigs, of those without coordinates, and where the rig differs by the
    experiment of the lines.
    """
    if len(model.nonlinear) or not model.n:
        return None
    if experiment is not None and model.differs and np.any(model.kind_of(experiment)):
        return None
    key = (kernel, omega.tobytes())
    if key not in model.views:
        factors = np.stack([law.factor(omega) for law in MATRICES.values()])
        imaginary = np.any(factors.imag, axis=-1)
        real = np.where(imaginary[:, None], factors.imag, factors.real)
        rig = (model.B, model.D, model.T, model.p0, model.S, model.letters)
        prior = (model.prior_precision, model.prior_mean)
        model.views[key] = kernel.Rig(*rig, real, imaginary, np.ascontiguousarray(omega), *prior)
    return model.views[key]
