"""The equation of motion as a regression, and its normal matrix, the Gram (THEORY §2).

e = Bᵀ (p ∘ a) − S f = Φ θ − h,      Φ = Bᵀ diag(a) T,      h = S f − Bᵀ diag(a) p⁰
N = (B Bᵀ) ∘ Σ w aᵀ,   r = Σ w ∘ (B S f),   θ̂ = (Tᵀ N T)⁻¹ Tᵀ (r − N p⁰)                         (G)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.estimate.preparation import States
from dashpot.model.dynamics import kernel_rig, stiffness, unit_forces
from dashpot.model.network import Model
from dashpot.model.observation import small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel
from dashpot.numerics.small_systems import product, solve_small, summed_products

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
    return Q, summed_products(Q, Phi)


# The auxiliary model: what the amplitudes would be without noise, were θ true (paper eq. 18; THEORY §4).


@dataclass(frozen=True)
class Auxiliary:
    """Equation error and instruments at one θ, (..., lines, …).

    e   (..., lines, n)        equation error of the measured amplitudes, N
    Se  (..., lines, n, n)     its covariance E[e eᴴ] = Ω⁻¹
    Oe  (..., lines, n)        Ω e
    w   (..., lines, elements) unit forces of the amplitudes ẑ that satisfy the model and lie nearest to the data
    """

    e: Complex
    Se: Complex
    Oe: Complex
    w: Complex

    def cost_per_line(self) -> Real:
        """2 eᴴ Ω e, (..., lines): χ² distributed at the truth, 2 n degrees of freedom each."""
        return 2 * np.sum((np.conj(self.e) * self.Oe).real, axis=-1)

    def cost(self) -> Real:
        """2 Σ eᴴ Ω e, (...,)."""
        return np.sum(self.cost_per_line(), axis=-1)


def auxiliary(model: Model, p: Real, data: States) -> Auxiliary:
    """Project the amplitudes on the model: ẑ = z − Σ Hᴴ Ω H z with H = [D, −R, −S], Ω = (H Σ Hᴴ)⁻¹.

    Where the inputs are exact this is the response of the auxiliary model to them; where they are noisy, inputs and
    outputs are both corrected, as maximum likelihood does.  ẑ satisfies H ẑ = 0 exactly.
    """
    H, spread, Se = _equation_noise(model, p, data)
    e = np.einsum("...ij,...j->...i", H, data.z)
    Oe = solve_small(Se, e[..., None])
    z = data.z - (spread @ Oe)[..., 0]
    n, r = data.n, data.r
    return Auxiliary(
        e, Se, Oe[..., 0], unit_forces(model, data.omega, z[..., :n], z[..., n : n + r], data.experiment)
    )


def equation_covariance(model: Model, p: Real, data: States) -> Complex:
    """Se = H Σ Hᴴ alone, (..., lines, n, n)."""
    return _equation_noise(model, p, data)[2]


def _equation_noise(model: Model, p: Real, data: States) -> tuple[Complex, Complex, Complex]:
    """H, Σ Hᴴ and Se = H Σ Hᴴ."""
    H = stiffness(model, p, data.omega, data.experiment)
    if model.S.shape[1]:
        S = np.broadcast_to(-model.S.astype(complex), (*H.shape[:-1], model.S.shape[1]))
        H = np.concatenate([H, S], axis=-1)
    spread = product(data.covariance, hermitian(H))
    Se = product(H, spread)
    # Exact channels next to noisy ones would make Se singular: a floor far below the noise keeps it regular.
    variance = np.diagonal(Se, axis1=-2, axis2=-1).real
    floor = 1e-13 * np.where(variance > 0, variance, np.max(variance, axis=-1, keepdims=True, initial=0.0))
    return H, spread, Se + floor[..., None] * np.eye(model.n)


def information(model: Model, at: Auxiliary) -> Real:
    """Fisher information of each line, 2 Re Ψᴴ Ω Ψ with Ψ from the auxiliary model; (..., lines, m, m)."""
    Psi = regressors(model, at.w)
    return 2 * (hermitian(Psi) @ solve_small(at.Se, Psi)).real


def equation_by_line(model: Model, data: States, theta: Real) -> tuple[Real, Real, Real]:
    """Information (K, lines, m, m), minus half the slope (K, lines, m) and cost (K, lines) of each line at θ (K, m)."""
    equation = compiled_equation(model, data)
    if equation is not None:
        information, scores, cost = equation.lines(np.ascontiguousarray(theta), threads())
        return information, scores, cost
    at = auxiliary(model, model.parameters(theta), data)
    Psi = regressors(model, at.w)
    weighted: Complex = solve_small(at.Se, np.concatenate([Psi, at.e[..., None]], axis=-1))
    products = 2 * (hermitian(Psi) @ weighted).real
    return (
        products[..., :-1],
        -products[..., -1],
        2 * np.sum((np.conj(at.e) * weighted[..., -1]).real, axis=-1),
    )


def equation_sums(model: Model, data: States, theta: Real) -> QuadraticModel:
    """Cost, slope and information of all lines at θ (K, m), with the priors' rows."""
    sums = compiled_sums(model, data, theta)
    if sums is not None:
        return sums
    information, scores, cost = equation_by_line(model, data, theta)
    return sums_of_lines(information, scores, cost, theta, model.prior_precision, model.prior_mean)


def sums_of_lines(
    information: Real, scores: Real, cost: Real, theta: Real, precision: Real, mean: Real
) -> QuadraticModel:
    """Sums over lines of what belongs to each, (K, lines, …), with the rows of priors (m,)."""
    away = np.where(precision > 0, theta - mean, 0.0)  # θ without a prior may be beyond what has a square
    total = np.sum(information, axis=-3) + np.diag(precision)
    return QuadraticModel(
        np.sum(cost, axis=-1) + np.sum(precision * away**2, axis=-1),
        np.sum(scores, axis=-2) - precision * away,
        total,
        total,
    )


def normal_equations(model: Model, at: Auxiliary, Phi: Complex) -> tuple[Real, Real, Real]:
    """(N of the instruments w with the measured Φ, N of w with itself, gradient −Re Ψᴴ Ω e · 2)."""
    Psi = regressors(model, at.w)
    Q, symmetric = weighted_normal(Psi, at.Se, Psi)
    return summed_products(Q, Phi), symmetric, -summed_products(Q, at.e[..., None])[..., 0]
