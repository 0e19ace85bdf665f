"""Shares of the time at few frequencies: a convex programme by a primal-dual interior point method.

    min F(M₀ + Σ_i w_i M_i)   over   w ≥ 0, Σ w = 1

with slacks t − Φ_k of the parts of F (Boyd and Vandenberghe 2004, §11.7).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.design.criteria import Terms, criterion_curvature, criterion_slopes, criterion_value

TOLERANCE = 1e-9  # of the duality gap inside
ROUNDS = 60


@dataclass(frozen=True)
class Shares:
    """Shares w (lines,) of the samples, multipliers y (K,) of the parts of F, and F."""

    w: Real
    y: Real
    F: float


@dataclass(frozen=True)
class _Iterate:
    """Shares w, bound t of the parts, their slacks s, and the multipliers: y of s, z of w, ν of Σ w = 1.

    t and s are in units of `unit`, the size of F at the start.
    """

    w: Real
    t: float
    s: Real
    y: Real
    z: Real
    nu: float

    def moved(self, step: _Iterate) -> _Iterate:
        """As far along a step as all that must stay positive does."""
        primal = min(1.0, 0.99 * _reach(self.w, step.w), 0.99 * _reach(self.s, step.s))
        dual = min(1.0, 0.99 * min(_reach(self.z, step.z), _reach(self.y, step.y)))
        return _Iterate(
            self.w + primal * step.w, self.t + primal * step.t, self.s + primal * step.s,
            self.y + dual * step.y, self.z + dual * step.z, self.nu + dual * step.nu,
        )  # fmt: skip


def optimal_shares(terms: Terms, M0: Real, Mi: Real, tolerance: float = TOLERANCE) -> Shares:
    """Near-optimal shares of candidates with information Mi (scenarios, lines, q, q) beside M0 (scenarios, q, q).

    Where the iteration stalls it returns the best that it had, and the caller's gap says how good that is.
    """
    lines, K = Mi.shape[1], len(terms.weights)
    w, y = np.full(lines, 1 / lines), np.full(K, 1 / K)
    at = criterion_value(terms, M0 + np.einsum("i,siab->sab", w, Mi))
    if not np.isfinite(at.F):
        return Shares(w, y, at.F)
    unit = 1.0 if terms.block is not None else max(at.F, 1e-300)
    t = float(np.max(at.parts)) / unit + 0.1
    g = -criterion_slopes(terms, at, Mi) / unit
    nu = float(-(y @ g) @ w)
    x = _Iterate(w, t, t - at.parts / unit, y, np.maximum(y @ g + nu, 0.0) + 0.1, nu)
    best, closest = Shares(w, y, at.F), np.inf
    for _ in range(ROUNDS):
        gap = _gap(at.parts / unit, g, x.w, x.y)
        if gap < closest:
            best, closest = Shares(x.w, x.y, at.F), gap
        if gap < tolerance * (1.0 if terms.block is not None else at.F / unit):
            return best
        step = _newton_step(x, at.parts / unit, g, criterion_curvature(terms, at, Mi, x.y) / unit)
        if step is None:
            break
        x = x.moved(step)
        at = criterion_value(terms, M0 + np.einsum("i,siab->sab", x.w, Mi))
        if not np.isfinite(at.F):
            break
        g = -criterion_slopes(terms, at, Mi) / unit
    return best


def _newton_step(x: _Iterate, parts: Real, g: Real, curvature: Real) -> _Iterate | None:
    """Newton's step to the central path a tenth ahead; None where its equations are singular.

    parts (K,) and g (K, lines): Φ_k and its slopes by w; curvature (lines, lines) of Σ y_k Φ_k; all over `unit`.
    Unknowns dw, dt, dν; dz = μ/w − z − z dw/w, dy = (μ − y s − y ds)/s with ds = (dt − g·dw) + residual.
    """
    w, s, y, z = x.w, x.s, x.y, x.z
    lines = len(w)
    mu = 0.1 * float(z @ w + y @ s) / (lines + len(y))
    residual = x.t - parts - s  # what the curvature of Φ has left
    weight = y / s
    pull = (mu - y * s) / s - weight * residual
    A = np.zeros((lines + 2, lines + 2))
    A[:lines, :lines] = curvature + np.diag(z / w) + (g.T * weight) @ g
    A[:lines, lines] = A[lines, :lines] = -(g.T @ weight)
    A[:lines, lines + 1] = A[lines + 1, :lines] = 1.0
    A[lines, lines] = np.sum(weight)
    right = np.concatenate(
        [-(y @ g + x.nu - mu / w) - g.T @ pull, [np.sum(y) - 1 + np.sum(pull), 1 - np.sum(w)]]
    )
    try:
        step = np.linalg.solve(A, right)
    except np.linalg.LinAlgError:
        return None
    if not np.all(np.isfinite(step)):
        return None
    dw, dt, dnu = step[:lines], float(step[lines]), float(step[lines + 1])
    ds = dt - g @ dw + residual
    return _Iterate(dw, dt, ds, (mu - y * s - y * ds) / s, mu / w - z - z * dw / w, dnu)


def _reach(x: Real, dx: Real) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down], initial=np.inf))


def _gap(parts: Real, g: Real, w: Real, y: Real) -> float:
    """What F could still lose at most: (max Φ − Σ y Φ) + (Σ w h − min h) with h = Σ y_k ∂Φ_k/∂w."""
    share = y / np.sum(y)
    h = share @ g
    return float(np.max(parts) - share @ parts + h @ w - np.min(h))
