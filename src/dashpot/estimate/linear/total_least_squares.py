"""Least squares that allow for noise in the regressors: total (tls) and noise-compensated (cls) (THEORY §4).

Φ θ ≈ h, both measured.  With v = (θ, −1), A = 2 Re Σ [Φ h]ᴴ Ω [Φ h] and G what the noise adds to A on average,
A v = G v at the truth, on average.  Compensated least squares takes G out: (N − G₁₁) θ = r − g, and needs the noise's
size.  Total least squares takes λ G out with the smallest λ that makes A − λG singular, and so finds the size itself:
generalised total least squares, min vᵀAv / vᵀGv (Golub and Van Loan 1980; Van Huffel and Vandewalle 1991, ch. 10).
Ω is the weight at weighted least squares' estimate, held fixed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.estimate.linear.gram import auxiliary, equation_covariance, regressors
from dashpot.estimate.linear.least_squares import (
    combined,
    equation,
    equation_map,
    noise_map,
    noise_sums,
    normal_sums,
    score_covariance,
    starts,
    where_finite,
    with_priors,
    without_noise,
)
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.preparation import Prepared, States
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled, solve_small


@dataclass(frozen=True)
class TotalLeastSquares(Method):
    """Generalised total least squares: the noise must be known up to one factor, which it finds.

    Stops when the factor moves by less than `tolerance` of itself, after `max_iterations` at the latest.
    """

    max_iterations: int = 60
    tolerance: float = 1e-10
    name: ClassVar[str] = "tls"

    def solve(self, data: Prepared) -> Solution:
        """θ of the v that minimises vᵀAv / vᵀGv, by Newton's method on the Schur complement of A − λG."""
        states, model = data.seen_states, data.model
        _, start, _ = starts(model, states)
        sums = noisy_sums(model, states, equation_covariance(model, model.parameters(start), states))
        repeats = len(start)
        size, low, high = np.zeros(repeats), np.zeros(repeats), sums.largest()
        theta, history = start, [start[0]]
        converged, iterations = np.zeros(repeats, dtype=bool), np.zeros(repeats, dtype=np.int64)
        for _ in range(self.max_iterations):
            theta = where_finite(np.where(converged[:, None], theta, sums.solve(size)), theta)
            ratio = sums.cost(theta) / sums.noise(theta)
            moved = np.abs(ratio - size)
            iterations += ~converged
            if not converged[0]:
                history.append(theta[0])
            # The complement is concave and falls to its root: a ratio above the size lies left of it.
            low, high = np.where(ratio >= size, size, low), np.where(ratio < size, size, high)
            # Rounding of the data bounds from below what can be told of a noise that is all but absent.
            converged |= np.isfinite(ratio) & (moved <= self.tolerance * np.maximum(ratio, 1e-9))
            if np.all(converged):
                break
            inside = (ratio > low) & (ratio < high)
            size = np.where(converged, size, np.where(inside, ratio, (low + high) / 2))
        with np.errstate(all="ignore"):
            covariance = _covariance(data, sums, theta, size, total=True)
        warnings = tuple[Notice, ...]()
        if not np.all(converged):
            text = "the noise factor did not converge: at least one unknown is hidden in the noise"
            warnings = (Notice("noise_factor_diverged", text),)
        # As close as this to the noise that makes least squares singular, the answer is worth nothing.
        elif np.any(size > 0.95 * sums.largest()):
            text = "do not rely on tls here: one combination of unknowns is almost hidden in the noise"
            warnings = (Notice("noise_near_singular", text),)
        return Solution(theta, covariance, converged, iterations, np.array(history), warnings=warnings)


@dataclass(frozen=True)
class CompensatedLeastSquares(Method):
    """Weighted least squares with the noise's own moments subtracted: an unbiased normal matrix, if the noise is known.

    Where the difference would not be positive definite, because the noise is too large, nothing is subtracted, with a
    warning.
    """

    name: ClassVar[str] = "cls"
    traits: ClassVar[Traits] = Traits(needs_noise=True)

    def solve(self, data: Prepared) -> Solution:
        """(N − G₁₁) θ = r − g."""
        states, model = data.seen_states, data.model
        _, start, plain = starts(model, states)
        sums = noisy_sums(model, states, equation_covariance(model, model.parameters(start), states))
        raw = normal_sums(sums.Se, sums.Phi, sums.h)
        theta, usable = without_noise(model, states, sums.Se, *raw)
        size = usable.astype(float)
        theta = theta + sums.correction(theta, size)
        with np.errstate(all="ignore"):
            covariance = _covariance(data, sums, theta, size, total=False)
        kept = Notice("noise_not_compensated", "the noise is too large to be compensated: cls remains biased")
        warnings = () if np.all(usable) else (kept,)
        solved = np.all(np.isfinite(theta), axis=-1)
        history = np.stack([plain[0], start[0], theta[0]])
        passes = np.full(len(theta), 2, dtype=np.int64)
        return Solution(theta, covariance, solved, passes, history, warnings=warnings)


@dataclass(frozen=True)
class NoisySums:
    """A and G in parts, priors included, for K repeats with a fixed weight Ω = Se⁻¹.

    Se (K, lines, n, n); Phi (K, lines, n, unknowns); h (K, lines, n);
    N (K, unknowns, unknowns) and r (K, unknowns): 2 Re Σ ΦᴴΩΦ and 2 Re Σ ΦᴴΩh with the rows of the priors;
    G and g, of the same shapes: what the noise adds to them on average
    """

    model: Model
    states: States
    Se: Complex
    Phi: Complex
    h: Complex
    N: Real
    r: Real
    G: Real
    g: Real

    def solve(self, size: Real) -> Real:
        """(N − λG) θ = r − λg with one round of refinement by the residual, (K, unknowns)."""
        matrix = self.N - size[:, None, None] * self.G
        theta = solve_scaled(matrix, self.r - size[:, None] * self.g)
        return theta + self.correction(theta, size)

    def correction(self, theta: Real, size: Real) -> Real:
        """What (N − λG) θ = r − λg still lacks at θ, from the residuals: near a resonance Ω spans powers of ten."""
        model = self.model
        left = self.h - np.einsum("klnu,ku->kln", self.Phi, theta)
        right = normal_sums(self.Se, self.Phi, left)[1] + model.prior_precision * (model.prior_mean - theta)
        matrix = self.N - size[:, None, None] * self.G
        return solve_scaled(matrix, right + size[:, None] * self.noise_part(theta))

    def noise_part(self, theta: Real) -> Real:
        """G θ − g, half the slope of `noise`; (K, unknowns)."""
        slope: Real = np.einsum("kuv,kv->ku", np.broadcast_to(self.G, (len(theta), *self.G.shape[1:])), theta)
        return slope - self.g

    def cost(self, theta: Real) -> Real:
        """vᵀAv, (K,): 2 Σ eᴴΩe and the priors."""
        e = np.einsum("klnu,ku->kln", self.Phi, theta) - self.h
        squares = 2 * np.sum((np.conj(e) * solve_small(self.Se, e[..., None])[..., 0]).real, axis=(-1, -2))
        away = theta - self.model.prior_mean
        return squares + np.sum(self.model.prior_precision * away**2, axis=-1)

    def noise(self, theta: Real) -> Real:
        """vᵀGv, (K,): what `cost` is on average where θ is true; each row of a prior adds 1."""
        spread = equation_covariance(self.model, self.model.parameters(theta), self.states)
        rows = np.trace(solve_small(self.Se, spread), axis1=-2, axis2=-1).real
        return 2 * np.sum(rows, axis=-1) + np.count_nonzero(self.model.prior_precision)

    def largest(self) -> Real:
        """The smallest λ that makes N − λG singular, (K,); inf where G is 0."""
        scale = np.sqrt(np.diagonal(self.N, axis1=-2, axis2=-1))
        scale = np.where(scale > 0, scale, 1.0)
        outer = scale[..., :, None] * scale[..., None, :]
        with np.errstate(all="ignore"):  # where the data determine nothing, nothing is finite
            values, vectors = np.linalg.eigh(np.nan_to_num(self.N / outer))
            root = vectors / np.sqrt(np.maximum(values, 1e-15 * values[..., -1:]))[..., None, :]
            noise = np.swapaxes(root, -1, -2) @ (self.G / outer) @ root
            worst = np.linalg.eigvalsh(np.nan_to_num(noise, posinf=0.0, neginf=0.0))[..., -1]
        with np.errstate(divide="ignore"):
            return np.where(worst > 0, 1 / np.maximum(worst, 1e-300), np.inf)


def noisy_sums(model: Model, states: States, Se: Complex) -> NoisySums:
    """The parts of A and G with weight Se⁻¹.  Se (..., lines, n, n)."""
    Phi, h = equation(model, states)
    N, r = with_priors(model, *normal_sums(Se, Phi, h))
    G, g = noise_sums(model, states, Se)
    return NoisySums(model, states, Se, Phi, h, N, r, G, g)


def _covariance(data: Prepared, sums: NoisySums, theta: Real, size: Real, *, total: bool) -> Real:
    """Sandwich of the score 2 Re ΦᴴΩe − λ (Gθ − g), quadratic in the noise; (K, unknowns, unknowns).

    For total least squares λ = vᵀAv / vᵀGv is noisy too: the score is 2 Re (Φ − e kᵀ)ᴴ Ω e, k = (Gθ − g) / vᵀGv.
    Regressors are those of the amplitudes that satisfy the model: measured ones would count the noise twice.
    """
    model, sampled = data.model, combined(data)
    at = auxiliary(model, model.parameters(theta), sums.states)
    Psi = regressors(model, at.w)
    Q = equation_map(sampled, model.parameters(theta))
    Gamma = noise_map(sampled)
    V = sampled.V
    if total:
        k = sums.noise_part(theta) / sums.noise(theta)[:, None]
        Gamma = Gamma - Q[..., :, None, :] * k[:, None, None, :, None]
        V = V * size[:, None, None, None]
    twice, once = np.full_like(sampled.weight, 2.0), np.ones_like(sampled.weight)
    meat = score_covariance(
        solve_small(sums.Se, Psi), Q, np.zeros_like(at.e), Gamma, solve_small(sums.Se, Q), V, twice, once
    )
    if total:
        # In units of the noise as stated, as with every method; its true size comes in from χ².
        meat = meat / np.where(size > 0, size, 1.0)[:, None, None]
    half = scaled_inverse(sums.N - size[:, None, None] * sums.G)
    return half @ (meat + np.diag(model.prior_precision)) @ half
