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
from dashpot.design.criteria import Terms
from dashpot.design.test_setup import UNDAMPED, Bench
from dashpot.errors import IdentifiabilityError, UsageError

Information = Callable[[Real, Ints], Real]  # (frequencies, patterns) → (scenarios, lines, q, q)

TOLERANCE = 1e-9  # of the duality gap inside
SINGULAR = 10 * np.finfo(float).eps  # pivot of a correlation matrix, for each row: rounding
ROUNDS = 60
ZOOM = 13  # points of a bracket at once


@dataclass(frozen=True)
class Value:
    """F at one M, its parts Φ_k (K,), the covariances C (scenarios, q, q) and, for determinants, those of the rest."""

    F: float
    parts: Real
    C: Real
    rest: Real


def value(terms: Terms, M: Real) -> Value:
    """F of the information M (scenarios, q, q); infinite where M does not determine the unknowns."""
    q = M.shape[-1]
    scale = np.sqrt(np.maximum(np.diagonal(M, axis1=-2, axis2=-1), 1e-300))
    outer = scale[:, :, None] * scale[:, None, :]
    open_ = Value(np.inf, np.full(len(terms.weights), np.inf), np.full_like(M, np.nan), np.zeros_like(M))
    try:
        L = np.linalg.cholesky(M / outer)
    except np.linalg.LinAlgError:
        return open_
    if np.min(np.diagonal(L, axis1=-2, axis2=-1)) ** 2 < SINGULAR * q:
        return open_  # whether Cholesky notices is up to the rounding of the machine
    root = np.linalg.solve(L, np.broadcast_to(np.eye(q), M.shape))
    C = np.swapaxes(root, -1, -2) @ root / outer
    rest = np.zeros_like(M)
    if terms.block is None:
        parts = np.einsum("ksj,sjj->k", terms.weights, C)
    else:
        other = np.setdiff1d(np.arange(q), terms.block)
        logdet = -np.linalg.slogdet(M)[1]
        if len(other):
            square = np.ix_(np.arange(len(M)), other, other)
            logdet = logdet + np.linalg.slogdet(M[square])[1]
            rest[square] = np.linalg.inv(M[square])
        parts = terms.weights[..., 0] @ logdet / len(terms.block)
    return Value(float(np.max(parts)), parts, C, rest)


def slopes(terms: Terms, at: Value, Mi: Real) -> Real:
    """−∂Φ_k/∂w_i (for N = 1), (K, lines), ≥ 0."""
    X = at.C[:, None] @ Mi
    if terms.block is None:
        # (C M C)_jj, row by row
        gain = np.sum(X * np.swapaxes(at.C, -1, -2)[:, None], axis=-1)
        K, S, q = terms.weights.shape
        own: Real = terms.weights.reshape(K, S * q) @ np.swapaxes(gain, 1, 2).reshape(S * q, -1)
        return own
    trace = np.sum(at.C[:, None] * Mi, axis=(-1, -2)) - np.sum(at.rest[:, None] * Mi, axis=(-1, -2))
    whole: Real = terms.weights[..., 0] @ trace / len(terms.block)
    return whole


def _curvature(terms: Terms, at: Value, Mi: Real, y: Real) -> Real:
    """Hessian of Σ y_k Φ_k over w (for N = 1), (lines, lines)."""
    lines = Mi.shape[1]
    flat = Mi.reshape(len(Mi), lines, -1)
    H = np.zeros((lines, lines))
    if terms.block is None:
        a = np.einsum("k,ksj->sj", y, terms.weights)
        for s in range(len(Mi)):
            if not np.any(a[s]):
                continue
            C = at.C[s]
            left = (C * a[s]) @ C @ Mi[s] @ C
            G = left.reshape(lines, -1) @ flat[s].T
            H += G + G.T
        return H
    weight = y @ terms.weights[..., 0] / len(terms.block)
    for s in range(len(Mi)):
        for inverse, sign in ((at.C[s], 1.0), (at.rest[s], -1.0)):
            if weight[s] and np.any(inverse):
                H += sign * weight[s] * ((inverse @ Mi[s] @ inverse).reshape(lines, -1) @ flat[s].T)
    return (H + H.T) / 2


@dataclass(frozen=True)
class Weights:
    """Shares w (lines,) of the samples, multipliers y (K,) of the parts of F, and F."""

    w: Real
    y: Real
    F: float


def weigh(terms: Terms, M0: Real, Mi: Real, tolerance: float = TOLERANCE) -> Weights:
    """Near-optimal shares of candidates with information Mi (scenarios, lines, q, q) beside M0.

    Primal-dual interior point with slacks t − Φ_k (Boyd and Vandenberghe 2004, §11.7); where it stalls it returns the
    best it had, and the caller's gap tells.
    """
    lines = Mi.shape[1]
    K = len(terms.weights)
    w = np.full(lines, 1 / lines)
    at = value(terms, M0 + np.einsum("i,siab->sab", w, Mi))
    if not np.isfinite(at.F):
        return Weights(w, np.full(K, 1 / K), at.F)
    unit = 1.0 if terms.block is not None else max(at.F, 1e-300)
    y = np.full(K, 1 / K)
    t = float(np.max(at.parts)) + 0.1 * unit
    s = (t - at.parts) / unit
    nu, z = 0.0, np.ones(lines)
    best, closest = Weights(w, y, at.F), np.inf
    for turn in range(ROUNDS):
        g = -slopes(terms, at, Mi) / unit
        mean = y @ g
        if turn == 0:
            nu = float(-mean @ w)
            z = np.maximum(mean + nu, 0.0) + 0.1
        gap = _gap(at.parts / unit, g, w, y)
        if gap < closest:
            best, closest = Weights(w, y, at.F), gap
        if gap < tolerance * (1.0 if terms.block is not None else at.F / unit):
            return best
        mu = 0.1 * float(z @ w + y @ s) / (lines + K)
        # Unknowns dw, dt, dν; dz = μ/w − z − z dw/w, dy = (μ − y s − y ds)/s with ds = (dt − g·dw) + residual.
        H = _curvature(terms, at, Mi, y) / unit + np.diag(z / w) + (g.T * (y / s)) @ g
        lost = t / unit - at.parts / unit - s  # what the curvature of Φ has left
        side_w = -(mean + nu - mu / w) - g.T @ ((mu - y * s) / s - y / s * lost)
        ones = np.ones(lines)
        gy = g.T @ (y / s)
        A = np.zeros((lines + 2, lines + 2))
        A[:lines, :lines] = H
        A[:lines, lines] = -gy
        A[lines, :lines] = -gy
        A[:lines, lines + 1] = ones
        A[lines + 1, :lines] = ones
        A[lines, lines] = np.sum(y / s)
        side_t = -(1 - np.sum(y)) + np.sum((mu - y * s) / s - y / s * lost)
        right = np.concatenate([side_w, [side_t, 1 - np.sum(w)]])
        try:
            step = np.linalg.solve(A, right)
        except np.linalg.LinAlgError:
            break
        if not np.all(np.isfinite(step)):
            break
        dw, dt, dnu = step[:lines], float(step[lines]), float(step[lines + 1])
        dz = mu / w - z - z * dw / w
        ds = dt - g @ dw + lost
        dy = (mu - y * s - y * ds) / s
        primal = min(1.0, 0.99 * _reach(w, dw))
        dual = min(1.0, 0.99 * min(_reach(z, dz), _reach(y, dy)))
        primal = min(primal, 0.99 * _reach(s, ds))
        w, t, s = w + primal * dw, t + primal * dt * unit, s + primal * ds
        at = value(terms, M0 + np.einsum("i,siab->sab", w, Mi))
        if not np.isfinite(at.F):
            break
        y, z, nu = y + dual * dy, z + dual * dz, nu + dual * dnu
    return best


def _reach(x: Real, dx: Real) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down], initial=np.inf))


def _gap(parts: Real, g: Real, w: Real, y: Real) -> float:
    """What F could still lose at most: (max Φ − Σ y Φ) + (Σ w h − min h) with h = Σ y_k ∂Φ_k/∂w."""
    share = y / np.sum(y)
    h = share @ g
    return float(np.max(parts) - share @ parts + h @ w - np.min(h))


# Frequencies between and beyond the candidates


@dataclass(frozen=True)
class Allocation:
    """The best shares of a test.

    frequency_hz, pattern, share  (support,)  what is driven, and which part of the samples it gets
    F             the goal's value
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


@dataclass(frozen=True)
class Grid:
    """Where to look for frequencies: points (g,), with their patterns (g,); `free` lets frequencies move off them."""

    frequency_hz: Real
    pattern: Ints
    free: bool = True

    @property
    def low(self) -> float:
        """Lower end of the band, Hz."""
        return float(np.min(self.frequency_hz))

    @property
    def high(self) -> float:
        """Upper end of the band, Hz."""
        return float(np.max(self.frequency_hz))


def optimise(
    information: Information, terms: Terms, prior: Real, samples: float, grid: Grid, tolerance: float = 1e-7
) -> Allocation:
    """The shares of `samples` over the frequencies of a band that make F smallest.

    `information` is of one sample; `prior` (scenarios, q, q) is what is known before.  Raises IdentifiabilityError
    where no test in the band determines the unknowns.
    """
    on_grid = samples * information(grid.frequency_hz, grid.pattern)
    spread = prior + np.mean(on_grid, axis=1)
    if not np.isfinite(value(terms, spread).F):
        raise IdentifiabilityError(
            "no test in this band determines the unknowns",
            cure="give one of them a value, add a sensor, or widen the band",
        )
    search = _Columns(information, terms, prior, samples, grid, on_grid)
    return search.run(tolerance)


class _Columns:
    """Column generation: few candidates, joined by those at which the directional derivative is largest."""

    def __init__(
        self, information: Information, terms: Terms, prior: Real, samples: float, grid: Grid, on_grid: Real
    ) -> None:
        self.information, self.terms, self.prior = information, terms, prior
        self.samples, self.grid, self.on_grid = samples, grid, on_grid
        step = max(1, len(grid.frequency_hz) // 60)
        some = np.arange(0, len(grid.frequency_hz), step)
        self.f, self.k, self.M = grid.frequency_hz[some], grid.pattern[some], on_grid[:, some]
        if not np.isfinite(value(terms, prior + np.mean(self.M, axis=1)).F):
            self.f, self.k, self.M = grid.frequency_hz, grid.pattern, on_grid

    def run(self, tolerance: float) -> Allocation:
        """Add columns until the gap is closed, then join the pairs that stand for one frequency."""
        best: Allocation | None = None
        try_below = 1e-5
        for turn in range(30):
            weights = weigh(self.terms, self.prior, self.M)
            found, peaks = self._certified(weights)
            if best is None or found.gap < best.gap:
                best = found
            if found.gap < tolerance:
                break
            if self.grid.free and found.gap < try_below:
                try_below = 0.03 * found.gap
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

    def _slope(self, at: Value, share: Real, f: Real, k: Ints) -> Real:
        own: Real = share @ slopes(self.terms, at, self.samples * self.information(f, k))
        return own

    def _certified(self, weights: Weights) -> tuple[Allocation, tuple[Real, Ints]]:
        """The design with its gap over the whole band, and the frequencies at which the derivative peaks."""
        w, share = weights.w, weights.y / np.sum(weights.y)
        at = value(self.terms, self.prior + np.einsum("i,siab->sab", w, self.M))
        own = share @ slopes(self.terms, at, self.M)
        mean = float(own @ w)
        curve = share @ slopes(self.terms, at, self.on_grid)
        f, k, height = self._peaks(at, share, curve, np.max(own))
        top = max(float(np.max(curve)), float(np.max(height, initial=0.0)))
        lost = at.F - float(share @ at.parts) + top - mean
        gap = lost if self.terms.block is not None else lost / at.F
        kept = w > 1e-7 * np.max(w)
        allocation = Allocation(
            self.f[kept], self.k[kept], w[kept] / np.sum(w[kept]), at.F, max(gap, 0.0),
            (self.grid.frequency_hz, self.grid.pattern, curve / mean if mean > 0 else curve),
        )  # fmt: skip
        return allocation, (f, k)

    def _peaks(self, at: Value, share: Real, curve: Real, own: float) -> tuple[Real, Ints, Real]:
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

    def _highest(self, at: Value, share: Real, low: Real, high: Real, pattern: int) -> tuple[Real, Real]:
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
        if not np.isfinite(value(self.terms, self.prior + np.mean(self.M[:, kept], axis=1)).F):
            kept[:] = True  # the best test for some leaves others open: the search must not start from there
        f, k = peaks
        new = [
            i for i in range(len(f))
            if not np.any((k[i] == self.k[kept]) & (np.abs(self.f[kept] / f[i] - 1) < 1e-10))
        ]  # fmt: skip
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
            if not np.isfinite(value(self.terms, self.prior + np.mean(self.M, axis=1)).F):
                break
            found, (f, k) = self._certified(weigh(self.terms, self.prior, self.M))
            if best is not None and found.gap > 0.5 * best.gap:
                break
            best = found
            if found.gap < 0.1 * tolerance:
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
    """
    f, k, w = [], [], []
    for drive in np.unique(pattern):
        rows = np.flatnonzero(pattern == drive)
        rows = rows[np.argsort(frequency_hz[rows])]
        x = np.log(frequency_hz[rows])
        group = np.concatenate([[0], np.cumsum(np.diff(x) > width)])
        for g in np.unique(group):
            own = rows[group == g]
            total = float(np.sum(share[own]))
            mean = float(np.exp(np.sum(x[group == g] * share[own]) / total))
            f.append(mean if between and len(own) > 1 else float(frequency_hz[own[np.argmax(share[own])]]))
            k.append(int(drive))
            w.append(total)
    return np.array(f), np.array(k, dtype=np.int64), np.array(w)


# The band


def band_grid(bench: Bench, low: float, high: float, step: float | None = None) -> Grid:
    """Points in low … high (Hz) for every pattern of the drive: multiples of `step`, or about 2 % apart and free.

    Without a step, points crowd around each resonance of each scenario, where lightly damped rigs change fast.
    Raises UsageError for a band that is none.
    """
    if not (np.isfinite(low) and np.isfinite(high) and 0 < low <= high):
        raise UsageError(f"{low:g} to {high:g} Hz is no band", cure="write it as --band 0.5:25")
    if step is not None:
        if not (np.isfinite(step) and step > 0):
            raise UsageError(f"a grid step of {step:g} Hz", cure="give a positive step")
        count = np.arange(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)
        if len(count) > 20_000:
            raise UsageError(f"{len(count)} grid points", cure="give a larger step or a narrower band")
        f = count * step
        if len(f) == 0:
            raise UsageError(
                f"no multiple of {step:g} Hz lies in {low:g} to {high:g} Hz", cure="give a smaller step"
            )
    else:
        octaves = np.log(high / low)
        f = np.geomspace(low, high, int(np.clip(octaves / 0.02, 2, 400)) if high > low else 1)
        around = np.array([0, 0.3, 0.6, 1, 1.5, 2.2, 3.3, 5, 8])
        for own, zeta in _distinct(bench.resonances()):
            # Narrower than the grid resolves: half-widths on both sides.
            if UNDAMPED < zeta < 0.1:
                near = own * np.exp(np.concatenate([around, -around]) * max(zeta, 1e-5))
                f = np.concatenate([f, near[(near > low) & (near < high)]])
        f = np.unique(f)
    patterns = len(bench.drives)
    return Grid(np.tile(f, patterns), np.repeat(np.arange(patterns), len(f)), step is None)


def _distinct(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Resonances that differ by more than half a half-width; at most 60."""
    kept: list[tuple[float, float]] = []
    for f, zeta in sorted(found):
        if not kept or f > kept[-1][0] * (1 + max(zeta, 1e-5) / 2):
            kept.append((f, zeta))
    return kept if len(kept) <= 60 else [kept[i] for i in np.linspace(0, len(kept) - 1, 60).astype(int)]


def natural_band(bench: Bench, rate: float | None = None) -> tuple[float, float]:
    """A band about the rig's resonances: a fifth of the lowest to three times the highest, Hz, to three digits.

    Raises UsageError where the rig has none.
    """
    found = [f for f, _ in bench.resonances()]
    if not found:
        raise UsageError("the rig has no resonance to take the band from", cure="give it with --band 0.5:25")
    high = 3 * max(found) if rate is None else min(3 * max(found), 0.4 * rate)
    return float(f"{min(0.2 * min(found), high / 10):.3g}"), float(f"{high:.3g}")
