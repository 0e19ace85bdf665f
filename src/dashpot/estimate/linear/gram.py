"""The equation of motion as a regression, and its normal matrix, the Gram (THEORY §2).

e = Bᵀ (p ∘ a) − S f = Φ θ − h,      Φ = Bᵀ diag(a) T,      h = S f − Bᵀ diag(a) p⁰
N = (B Bᵀ) ∘ Σ w aᵀ,   r = Σ w ∘ (B S f),   θ̂ = (Tᵀ N T)⁻¹ Tᵀ (r − N p⁰)                         (G)
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_scaled, solve_small


def gram(model: Model, w: Complex, a: Complex, weight: Real) -> Real:
    """(B Bᵀ) ∘ Σ_l weight_l Re(w̄ aᵀ), shape (..., elements, elements).  THEORY (G).

    w, a: instruments and unit forces, (..., lines, elements); weight: (lines,).
    """
    products = hermitian(w * weight[:, None]) @ a
    meeting: Real = model.B @ model.B.T
    return meeting * products.real


def gram_force(model: Model, w: Complex, f: Complex, weight: Real) -> Real:
    """r = Σ_l weight_l Re(w̄ ∘ B S f), shape (..., elements).  THEORY (G)."""
    if f.shape[-1] == 0:
        return np.zeros((*w.shape[:-2], w.shape[-1]))
    force = f @ (model.B @ model.S).T
    total: Real = np.sum(weight[:, None] * (np.conj(w) * force).real, axis=-2)
    return total


def solve_gram(model: Model, N: Real, r: Real) -> Real:
    """θ̂ = (Tᵀ N T)⁻¹ Tᵀ (r − N p⁰), shape (..., unknowns).  THEORY (G)."""
    T = model.T
    return solve_scaled(T.T @ N @ T, (r - N @ model.p0) @ T)


def regressors(model: Model, a: Complex) -> Complex:
    """Φ = Bᵀ diag(a) T, shape (..., lines, n, unknowns)."""
    T = model.T
    chosen = np.argmax(T != 0, axis=0)
    factors = T[chosen, np.arange(T.shape[1])]
    if np.count_nonzero(T) == T.shape[1] and np.all(factors):
        # Each unknown belongs to one element (nothing is tied): picking columns is three times as fast as the product.
        picked: Complex = a[..., None, chosen] * (model.B[chosen] * factors[:, None]).T
        return picked
    mixed: Complex = (a[..., None, :] * model.B.T) @ T
    return mixed


def known_side(model: Model, a: Complex, f: Complex) -> Complex:
    """h = S f − Bᵀ diag(a) p⁰, shape (..., lines, n)."""
    side: Complex = -((a * model.p0) @ model.B)
    return side + f @ model.S.T if f.shape[-1] else side


def weighted_normal(Psi: Complex, Se: Complex, Phi: Complex) -> tuple[Complex, Real]:
    """(Ω Ψ, 2 Re Σ_l Ψᴴ Ω Φ) with Ω = Se⁻¹; shapes (..., lines, n, m) and (..., m, m).

    This is (G) with B Ω Bᵀ in place of B Bᵀ, multiplied out from the side of the unknowns: m columns, not all
    elements.  The factor 2 makes it the inverse of a covariance, since Se is E[e eᴴ] of a complex amplitude.
    """
    Q = solve_small(Se, Psi)
    m = Psi.shape[-1]
    rows = Psi.shape[-3] * Psi.shape[-2]
    left = Q.reshape(*Q.shape[:-3], rows, m)
    right = Phi.reshape(*Phi.shape[:-3], rows, Phi.shape[-1])
    return Q, 2 * (hermitian(left) @ right).real
