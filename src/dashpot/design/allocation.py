"""Time at each frequency: a convex programme, solved and certified (THEORY §6).

    min F(M₀ + N Σ_i w_i M_i)   over   w ≥ 0, Σ w = 1

by a primal-dual interior point method on few candidates, to which the frequencies are added at which the directional
derivative is largest: the equivalence theorem (Kiefer 1974; for minimax Pukelsheim 2006, §4.16) says that F is optimal
when none exceeds its mean, and that what the largest exceeds it by bounds what F could still lose: the duality gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.design.criteria import (
    CriterionValue,
    Terms,
    criterion_curvature,
    criterion_slopes,
    criterion_value,
)
from dashpot.design.schedule import FrequencyGrid
from dashpot.errors import IdentifiabilityError

# Shares of the time at few frequencies: a convex programme by a primal-dual interior point method.
#
# min F(M₀ + Σ_i w_i M_i) over w ≥ 0, Σ w = 1
#
# with slacks t − Φ_k of the parts of F (Boyd and Vandenberghe 2004, §11.7).


TOLERANCE = 1e-9  # of the duality gap inside


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
    for _ in range(60):  # at most
        # What F could still lose at most: (max Φ − Σ y Φ) + (Σ w h − min h) with h = Σ y_k ∂Φ_k/∂w
        parts = at.parts / unit
        share = x.y / np.sum(x.y)
        h = share @ g
        gap = float(np.max(parts) - share @ parts + h @ x.w - np.min(h))
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


Information = Callable[[Real, Ints], Real]  # (frequencies, patterns) → (scenarios, lines, q, q)

ZOOM = 13  # points of a bracket at once


@dataclass(frozen=True)
class Allocation:
    """The best shares of a test.

    frequency_hz, pattern, share  (support,)  what is driven, and which part of the samples it gets
    F             the criterion's value
    gap           F − gap is a lower bound of what any test could reach: relative for sums of variances, absolute
                  for determinants
    curve         (grid frequencies (g,), pattern (g,), directional derivative relative to its mean (g,)): at most
                  1 + gap everywhere, 1 where time is spent
    """

    frequency_hz: Real
    pattern: Ints
    share: Real
    F: float
    gap: float
    curve: tuple[Real, Ints, Real]


def optimise(
    information: Information,
    terms: Terms,
    prior: Real,
    samples: float,
    grid: FrequencyGrid,
    tolerance: float = 1e-7,
) -> Allocation:
    """The shares of `samples` over the frequencies of a band that make F smallest.

    `information` is of one sample; `prior` (scenarios, q, q) is what is known before.  Raises IdentifiabilityError
    where no test in the band determines the unknowns.
    """
    on_grid = samples * information(grid.frequency_hz, grid.pattern)
    spread = prior + np.mean(on_grid, axis=1)
    if not np.isfinite(criterion_value(terms, spread).F):
        raise IdentifiabilityError(
            "no test in this band determines the unknowns",
            cure="give an unknown a value, add a sensor, or widen the band",
        )
    search = _Columns(information, terms, prior, samples, grid, on_grid)
    return search.run(tolerance)


class _Columns:
    """Column generation: few candidates, joined by those at which the directional derivative is largest."""

    def __init__(
        self,
        information: Information,
        terms: Terms,
        prior: Real,
        samples: float,
        grid: FrequencyGrid,
        on_grid: Real,
    ) -> None:
        self.information, self.terms, self.prior = information, terms, prior
        self.samples, self.grid, self.on_grid = samples, grid, on_grid
        step = max(1, len(grid.frequency_hz) // 60)
        some = np.arange(0, len(grid.frequency_hz), step)
        self.f, self.k, self.M = grid.frequency_hz[some], grid.pattern[some], on_grid[:, some]
        if not np.isfinite(criterion_value(terms, prior + np.mean(self.M, axis=1)).F):
            self.f, self.k, self.M = grid.frequency_hz, grid.pattern, on_grid

    def run(self, tolerance: float) -> Allocation:
        """Add columns until the gap is closed, then join the pairs that stand for one frequency."""
        best: Allocation | None = None
        try_below = 1e-5
        for turn in range(30):
            weights = optimal_shares(self.terms, self.prior, self.M)
            trial, peaks = self._certified(weights)
            if best is None or trial.gap < best.gap:
                best = trial
            if trial.gap < tolerance:
                break
            if self.grid.free and trial.gap < try_below:
                try_below = 0.03 * trial.gap
                # Columns that crowd around one frequency slow the search down: one column that moves is better.
                columns = self.f, self.k, self.M
                joined = self._joined(best, tolerance)
                if joined is not None:
                    return joined
                self.f, self.k, self.M = columns
            self._exchange(weights.w, peaks, keep=1e-9 if turn else 1e-6)
        assert best is not None
        joined = self._joined(best, tolerance) if self.grid.free else None
        return best if joined is None else joined

    def _slope(self, at: CriterionValue, share: Real, f: Real, k: Ints) -> Real:
        return share @ criterion_slopes(self.terms, at, self.samples * self.information(f, k))

    def _certified(self, weights: Shares) -> tuple[Allocation, tuple[Real, Ints]]:
        """The design with its gap over the whole band, and the frequencies at which the derivative peaks."""
        w, share = weights.w, weights.y / np.sum(weights.y)
        at = criterion_value(self.terms, self.prior + np.einsum("i,siab->sab", w, self.M))
        at_columns = share @ criterion_slopes(self.terms, at, self.M)
        mean = float(at_columns @ w)
        curve = share @ criterion_slopes(self.terms, at, self.on_grid)
        f, k, height = self._peaks(at, share, curve, np.max(at_columns))
        top = max(float(np.max(curve)), float(np.max(height, initial=0.0)))
        lost = at.F - float(share @ at.parts) + top - mean
        gap = lost if self.terms.block is not None else lost / at.F
        kept = w > 1e-7 * np.max(w)
        allocation = Allocation(
            self.f[kept], self.k[kept], w[kept] / np.sum(w[kept]), at.F, max(gap, 0.0),
            (self.grid.frequency_hz, self.grid.pattern, curve / mean if mean > 0 else curve),
        )  # fmt: skip
        return allocation, (f, k)

    def _peaks(self, at: CriterionValue, share: Real, curve: Real, own: float) -> tuple[Real, Ints, Real]:
        """Local maxima of the derivative in each pattern, between grid points where frequencies are free."""
        found_f, found_k, found_h = [], [], []
        for pattern in np.unique(self.grid.pattern):
            rows = np.flatnonzero(self.grid.pattern == pattern)
            f, h = self.grid.frequency_hz[rows], curve[rows]
            padded = np.concatenate([[-np.inf], h, [-np.inf]])
            top = np.flatnonzero((h >= padded[:-2]) & (h >= padded[2:]) & (h > 0.9 * own))
            if len(top) == 0:
                continue
            if not self.grid.free or len(f) < 2:
                found_f.append(f[top])
                found_h.append(h[top])
            else:
                low, high = f[np.maximum(top - 1, 0)], f[np.minimum(top + 1, len(f) - 1)]
                x, height = self._highest(at, share, low, high, int(pattern))
                ends = np.array([f[top], x])
                better = (height > h[top]).astype(int)
                found_f.append(ends[better, np.arange(len(top))])
                found_h.append(np.maximum(height, h[top]))
            found_k.append(np.full(len(top), pattern, dtype=np.int64))
        if not found_f:
            return np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0)
        return np.concatenate(found_f), np.concatenate(found_k), np.concatenate(found_h)

    def _highest(
        self, at: CriterionValue, share: Real, low: Real, high: Real, pattern: int
    ) -> tuple[Real, Real]:
        """The highest point of each bracket: zoom in on the best of several points, all brackets at once, over ln f."""
        a, b = np.log(low), np.log(high)
        rows = np.arange(len(a))
        part = np.linspace(0, 1, ZOOM)
        for _ in range(5):
            x = a[:, None] + (b - a)[:, None] * part
            f = np.clip(np.exp(x.ravel()), self.grid.low, self.grid.high)
            h = self._slope(at, share, f, np.full(f.size, pattern, dtype=np.int64)).reshape(x.shape)
            top = np.argmax(h, axis=1)
            a, b = x[rows, np.maximum(top - 1, 0)], x[rows, np.minimum(top + 1, ZOOM - 1)]
        best = f.reshape(x.shape)[rows, top]
        # exp(ln f) misses the ends of the band by rounding.
        for end in (self.grid.low, self.grid.high):
            best = np.where(np.abs(best / end - 1) < 1e-9, end, best)
        return best, h[rows, top]

    def _exchange(self, w: Real, peaks: tuple[Real, Ints], keep: float) -> None:
        """Keep what has weight, add the peaks."""
        kept = w > keep * np.max(w)
        if not np.isfinite(criterion_value(self.terms, self.prior + np.mean(self.M[:, kept], axis=1)).F):
            kept[:] = True  # the best test for some leaves others open: the search must not start from there
        f, k = peaks
        new = [
            i
            for i in range(len(f))
            if not np.any((k[i] == self.k[kept]) & (np.abs(self.f[kept] / f[i] - 1) < 1e-10))
        ]
        f, k = f[new], k[new]
        if len(f) == 0:
            self.f, self.k, self.M = self.f[kept], self.k[kept], self.M[:, kept]
            return
        more = self.samples * self.information(f, k)
        self.f, self.k = np.concatenate([self.f[kept], f]), np.concatenate([self.k[kept], k])
        self.M = np.concatenate([self.M[:, kept], more], axis=1)

    def _joined(self, best: Allocation, tolerance: float) -> Allocation | None:
        """Neighbours within a step of the grid stand for one frequency between them: join them while the gap allows."""
        steps = np.diff(np.log(np.unique(self.grid.frequency_hz)))
        width = float(np.median(steps)) if len(steps) else 0.0
        last = 0
        for _ in range(8):
            kept = best.share > 1e-6
            f, k, _ = clusters(best.frequency_hz[kept], best.pattern[kept], best.share[kept], width)
            if len(f) != last:
                last = len(f)
                self.f, self.k = f, k
                joined = self._settle(tolerance)
                if joined is not None:
                    return joined
            width /= 4
        return None

    def _settle(self, tolerance: float) -> Allocation | None:
        """Shift each frequency to the peak near it and weigh again until the gap is closed; None: it stays open."""
        best: Allocation | None = None
        for _ in range(12):
            self.M = self.samples * self.information(self.f, self.k)
            if not np.isfinite(criterion_value(self.terms, self.prior + np.mean(self.M, axis=1)).F):
                break
            trial, (f, k) = self._certified(optimal_shares(self.terms, self.prior, self.M))
            if best is not None and trial.gap > 0.5 * best.gap:
                break
            best = trial
            if trial.gap < 0.1 * tolerance:
                break
            moved = self.f.copy()
            for i in range(len(moved)):
                near = np.flatnonzero(k == self.k[i])
                if len(near):
                    nearest = f[near[np.argmin(np.abs(np.log(f[near] / moved[i])))]]
                    if abs(np.log(nearest / moved[i])) < 0.05:
                        moved[i] = nearest
            self.f = moved
        return best if best is not None and best.gap < tolerance else None


def clusters(
    frequency_hz: Real, pattern: Ints, share: Real, width: float, between: bool = True
) -> tuple[Real, Ints, Real]:
    """One line for each run of frequencies of one pattern that are closer than `width` in ln f.

    Its frequency is their weighted mean in ln f or, unless it may lie between them, that of the largest share.
    All (lines,).
    """
    f, k, w = [], [], []
    for drive in np.unique(pattern):
        rows = np.flatnonzero(pattern == drive)
        rows = rows[np.argsort(frequency_hz[rows])]
        x = np.log(frequency_hz[rows])
        group = np.concatenate([[0], np.cumsum(np.diff(x) > width)])
        for g in np.unique(group):
            members = rows[group == g]
            total = float(np.sum(share[members]))
            mean = float(np.exp(np.sum(x[group == g] * share[members]) / total))
            f.append(
                mean
                if between and len(members) > 1
                else float(frequency_hz[members[np.argmax(share[members])]])
            )
            k.append(int(drive))
            w.append(total)
    return np.array(f), np.array(k, dtype=np.int64), np.array(w)
