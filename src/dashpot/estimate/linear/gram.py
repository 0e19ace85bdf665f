"""The equation of motion as a regression, and its normal matrix, the Gram (THEORY §2).

e = Bᵀ (p ∘ a) − S f = Φ θ − h,      Φ = Bᵀ diag(a) T,      h = S f − Bᵀ diag(a) p⁰
N = (B Bᵀ) ∘ Σ w aᵀ,   r = Σ w ∘ (B S f),   θ̂ = (Tᵀ N T)⁻¹ Tᵀ (r − N p⁰)                         (G)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.estimate.preparation import States
from dashpot.model.dynamics import kernel_rig
from dashpot.model.network import Model
from dashpot.model.observation import small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel
from dashpot.numerics.small_systems import solve_small

# The equation of motion in the compiled kernel: twins of `starts`, `equation_by_line`, `_sums` and
# `search`.


def compiled_equation(model: Model, states: States) -> Any | None:
    """The kernel's view of the measured states, None where NumPy is to do the work or must."""
    core = kernel()
    if core is None or not small(model) or not model.n or not len(states.omega):
        return None
    if not hasattr(core.Equation, "search"):  # kernels before 0.2.1
        return None
    key = (id(core), id(model))
    if key not in states.compiled:
        rig = kernel_rig(core, model, states.omega, states.experiment)
        equation = None
        if rig is not None:
            z, V = np.ascontiguousarray(states.z), np.ascontiguousarray(states.covariance)
            equation = core.Equation(rig, z, V)
        states.compiled.clear()
        states.compiled[key] = (equation, model)  # the model is kept, so that its id stays its own
    return states.compiled[key][0]


def compiled_sums(model: Model, states: States, theta: Real) -> QuadraticModel | None:
    """Cost, slope and information of all lines at θ (K, unknowns), None as above; those of the last θ are kept."""
    kept = states.compiled.get("sums")
    if kept is None or kept[0] is not model or kept[1] is not theta:
        equation = compiled_equation(model, states)
        if equation is None:
            return None
        sums = equation.evaluate(np.ascontiguousarray(theta), np.arange(len(theta)), threads())
        kept = model, theta, QuadraticModel(*sums)
        states.compiled["sums"] = kept
    return kept[2]


def compiled_result(ends: tuple[Any, ...]) -> OptimizeResult:
    """What a descent of the kernel returns, as `minimise` does."""
    x, cost, converged, iterations, history, rows = ends
    return OptimizeResult(x, cost, converged, iterations, history[:rows])


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
    return np.sum(weight[:, None] * (np.conj(w) * force).real, axis=-2)


def regressors(model: Model, a: Complex) -> Complex:
    """Φ = Bᵀ diag(a) T, shape (..., lines, n, unknowns)."""
    T = model.T
    chosen = np.argmax(T != 0, axis=0)
    factors = T[chosen, np.arange(T.shape[1])]
    if np.count_nonzero(T) == T.shape[1] and np.all(factors):
        # Each unknown belongs to one element (nothing is tied): picking columns is three times as fast as the product.
        return a[..., None, chosen] * (model.B[chosen] * factors[:, None]).T
    return (a[..., None, :] * model.B.T) @ T


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
