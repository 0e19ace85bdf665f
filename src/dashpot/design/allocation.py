"""What a test is to be good for, and the time at each frequency that is best for it: solved and certified (THEORY §6).

With C_s = M_s⁻¹ the covariance of relative errors in scenario s, a criterion is

    F = max_k Φ_k,      Φ_k = Σ_s,j a_ksj (C_s)_jj      or      Σ_s a_ks ln det (C_s)_II / |I|,

convex in the information, hence in the time at each frequency (Silvey, Optimal Design, 1980, ch. 2-3; Pukelsheim,
Optimal Design of Experiments, 2006, ch. 5).  The test is

    min F(M₀ + N Σ_i w_i M_i)   over   w ≥ 0, Σ w = 1

by a primal-dual interior point method on few candidates, to which the frequencies are added at which the directional
derivative is largest: the equivalence theorem (Kiefer 1974; for minimax Pukelsheim 2006, §4.16) says that F is optimal
when none exceeds its mean, and that what the largest exceeds it by bounds what F could still lose: the duality gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dashpot.arrays import Frozen, Ints, Real
from dashpot.design.test_setup import FrequencyGrid, Schedule, TestSetup
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.network import Model

Kind = Literal["A", "minimax", "D"]

NAMES: Mapping[Kind, str] = {
    "A": "mean relative error (A)",
    "minimax": "worst relative error (minimax)",
    "D": "volume of the confidence region (D)",
}


@dataclass(frozen=True)
class Criterion:
    """What to make small.

    kind     A: the mean relative variance (of one unknown, c-optimal), read as the rms relative standard deviation;
             minimax: the largest relative variance; D: the volume of the confidence region, read as its mean radius
    names    of the unknowns; without names those that no sd makes known already
    targets  relative standard deviations by name, the units in which minimax counts; they name the unknowns
    """

    kind: Kind
    names: tuple[str, ...] = ()
    targets: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        for name, target in (self.targets or {}).items():
            if not (np.isfinite(target) and target > 0):
                raise UsageError(
                    f"a target of {target:g} for {name}", cure="give a positive relative sd, such as 2%"
                )

    @property
    def name(self) -> str:
        """What it is called."""
        return NAMES[self.kind] if self.targets is None else "worst error in parts of the targets (minimax)"

    def terms(self, setup: TestSetup) -> InformationTerms:
        """The criterion over the scenarios of a setup.  UsageError for unknown names."""
        i = self._chosen(setup.model)
        rows, block = np.ones((1, 1)), i if self.kind == "D" else None
        if self.kind == "A":
            rows = np.zeros((1, len(setup.names)))
            rows[0, i] = 1 / len(i)
        elif self.kind == "minimax":
            rows = np.zeros((len(i), len(setup.names)))
            rows[range(len(i)), i] = [target**-2 for target in self.targets_for(setup.model, 1.0).values()]
        count = len(setup.theta)
        if setup.over == "average":
            return InformationTerms(rows[:, None, :] * np.full((count, 1), 1 / count), block)
        each = np.einsum("kq,ts->tksq", rows, np.eye(count)).reshape(-1, count, rows.shape[1])
        return InformationTerms(each, block)

    def at(self, setup: TestSetup, information: Real | float = 0.0) -> CriterionValue:
        """Its value with a test's information (scenarios, q, q), in parts of the sizes, plus what is already known."""
        return self.terms(setup).at(setup.prior + information)

    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """Relative standard deviations by name that the figure asks of the unknowns."""
        names = [model.unknowns[int(j)].name for j in self._chosen(model)]
        return {name: figure * (1.0 if self.targets is None else self.targets[name]) for name in names}

    def _chosen(self, model: Model) -> Ints:
        """Indices of the unknowns that count.  Raises UsageError for names that are no unknowns."""
        unknowns = [u.name for u in model.unknowns]
        names = self.names if self.targets is None else tuple(self.targets)
        for name in names:
            if name not in unknowns:
                raise UsageError(
                    f"'{name}' is not an unknown of this rig", cure=f"its unknowns are {', '.join(unknowns)}"
                )
        if names:
            return np.array(sorted({unknowns.index(name) for name in names}))
        free = [i for i, u in enumerate(model.unknowns) if u.sd is None]
        return np.array(free if free else range(len(unknowns)))

    def figure(self, value: float) -> float:
        """What people read for a value of F: a relative standard deviation; of D, the geometric mean of semi-axes."""
        return float(np.exp(value / 2) if self.kind == "D" else np.sqrt(value))


@dataclass(frozen=True)
class InformationTerms(Frozen):
    """A criterion over the scenarios of a setup.

    weights  (K, scenarios, q): a_ksj; for a determinant (K, scenarios, 1): a_ks
    block    indices I of a determinant; None for sums of variances
    """

    weights: Real
    block: Ints | None = None

    def unit(self, F: float) -> float:
        """What losses count in: parts of F; of determinants, whose F is a logarithm, 1."""
        return F if self.block is None else 1.0

    def of(self, M0: Real, w: Real, Mi: Real) -> CriterionValue:
        """`at` shares w (lines,) of what the lines tell, Mi (scenarios, lines, q, q), added to M0 (scenarios, q, q)."""
        return self.at(M0 + np.einsum("i,siab->sab", w, Mi))

    def at(self, M: Real) -> CriterionValue:
        """F of the information M (scenarios, q, q); infinite where M does not determine the unknowns."""
        q = M.shape[-1]
        scale = np.sqrt(np.maximum(np.diagonal(M, axis1=-2, axis2=-1), 1e-300))
        outer = scale[:, :, None] * scale[:, None, :]
        rest = np.zeros_like(M)
        try:
            L = np.linalg.cholesky(M / outer)
        except np.linalg.LinAlgError:
            L = rest
        # Whether Cholesky notices is up to the rounding of the machine.
        if np.min(np.diagonal(L, axis1=-2, axis2=-1)) ** 2 < 10 * np.finfo(float).eps * q:
            return CriterionValue(
                self, np.inf, np.full(len(self.weights), np.inf), np.full_like(M, np.nan), rest
            )
        root = np.linalg.solve(L, np.broadcast_to(np.eye(q), M.shape))
        C = np.swapaxes(root, -1, -2) @ root / outer
        if self.block is None:
            parts = np.einsum("ksj,sjj->k", self.weights, C)
            return CriterionValue(self, float(np.max(parts)), parts, C, rest)
        other = np.setdiff1d(np.arange(q), self.block)
        logdet = -np.linalg.slogdet(M)[1]
        if len(other):
            square = np.ix_(np.arange(len(M)), other, other)
            logdet = logdet + np.linalg.slogdet(M[square])[1]
            rest[square] = np.linalg.inv(M[square])
        parts = self.weights[..., 0] @ logdet / len(self.block)
        return CriterionValue(self, float(np.max(parts)), parts, C, rest)


@dataclass(frozen=True)
class CriterionValue:
    """F at one M, its parts Φ_k (K,), the covariances C (scenarios, q, q) and, for determinants, those of the rest."""

    terms: InformationTerms
    F: float
    parts: Real
    C: Real
    rest: Real

    def slopes(self, Mi: Real) -> Real:
        """−∂Φ_k/∂w_i (for N = 1), (K, lines), ≥ 0."""
        weights, block = self.terms.weights, self.terms.block
        if block is not None:
            trace = np.sum(self.C[:, None] * Mi, axis=(-1, -2)) - np.sum(
                self.rest[:, None] * Mi, axis=(-1, -2)
            )
            return weights[..., 0] @ trace / len(block)
        K, S, q = weights.shape
        if K == 1:  # Σ a_j (C M C)_jj is the inner product of M with C diag(a) C
            return np.einsum("sab,slab->l", (self.C * weights[0][:, None]) @ self.C, Mi)[None]
        # (C M C)_jj, row by row
        gain = np.sum((self.C[:, None] @ Mi) * np.swapaxes(self.C, -1, -2)[:, None], axis=-1)
        return weights.reshape(K, S * q) @ np.swapaxes(gain, 1, 2).reshape(S * q, -1)

    def curvature(self, Mi: Real, y: Real) -> Real:
        """Hessian of Σ y_k Φ_k over w (for N = 1), (lines, lines)."""
        lines = Mi.shape[1]
        flat = Mi.reshape(len(Mi), lines, -1)
        H = np.zeros((lines, lines))
        weights = np.einsum("k,ksj->sj", y, self.terms.weights)
        for s in np.flatnonzero(np.any(weights, axis=1)):
            C, rest = self.C[s], self.rest[s]
            if self.terms.block is None:
                H += 2 * ((C * weights[s]) @ C @ Mi[s] @ C).reshape(lines, -1) @ flat[s].T
                continue
            for inverse, sign in ((C, 1.0), (rest, -1.0)):
                share = sign * weights[s, 0] / len(self.terms.block)
                H += share * ((inverse @ Mi[s] @ inverse).reshape(lines, -1) @ flat[s].T)
        return (H + H.T) / 2


@dataclass(frozen=True)
class Shares:
    """Shares w (lines,) of the samples, multipliers y (K,) of the parts of F, and F."""

    w: Real
    y: Real
    F: float


@dataclass(frozen=True)
class _Iterate:
    """Shares w, bound t of the parts, their slacks s, and the multipliers: y of s, z of w, ν of Σ w = 1.

    t and s are in units of the size of F at the start.
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
        w, t, s = self.w + primal * step.w, self.t + primal * step.t, self.s + primal * step.s
        return _Iterate(w, t, s, self.y + dual * step.y, self.z + dual * step.z, self.nu + dual * step.nu)


def _reach(x: Real, dx: Real) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down], initial=np.inf))


def optimal_shares(terms: InformationTerms, M0: Real, Mi: Real) -> Shares:
    """Near-optimal shares of candidates with information Mi (scenarios, lines, q, q) added to M0 (scenarios, q, q).

    By slacks t − Φ_k of the parts of F (Boyd and Vandenberghe 2004, §11.7).  Where the iteration stalls it returns the
    best that it had, and the caller's gap says how good that is.
    """
    lines, K = Mi.shape[1], len(terms.weights)
    w, y = np.full(lines, 1 / lines), np.full(K, 1 / K)
    at = terms.of(M0, w, Mi)
    if not np.isfinite(at.F):
        return Shares(w, y, at.F)
    unit = max(terms.unit(at.F), 1e-300)
    t = float(np.max(at.parts)) / unit + 0.1
    g = -at.slopes(Mi) / unit
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
        if gap < 1e-9 * terms.unit(at.F) / unit:
            break
        step = _newton_step(x, parts, g, at.curvature(Mi, x.y) / unit)
        if step is None:
            break
        x = x.moved(step)
        at = terms.of(M0, x.w, Mi)
        if not np.isfinite(at.F):
            break
        g = -at.slopes(Mi) / unit
    return best


def _newton_step(x: _Iterate, parts: Real, g: Real, curvature: Real) -> _Iterate | None:
    """Newton's step to the central path a tenth ahead; None if its equations are singular.

    parts (K,) and g (K, lines): Φ_k and its slopes by w; curvature (lines, lines) of Σ y_k Φ_k; all over the unit.
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

    def schedule(self, samples: float) -> Schedule:
        """The test of so many samples, without what barely contributes."""
        kept = self.share > 1e-6
        return Schedule(self.frequency_hz[kept], self.pattern[kept], samples * self.share[kept])


def optimise(setup: TestSetup, terms: InformationTerms, samples: float, grid: FrequencyGrid) -> Allocation:
    """The shares of `samples` over the frequencies of a band that make F smallest, given what is already known.

    Raises IdentifiabilityError if no test in the band determines the unknowns.
    """
    on_grid = samples * setup.information(grid.frequency_hz, grid.pattern)
    if not np.isfinite(terms.at(setup.prior + np.mean(on_grid, axis=1)).F):
        raise IdentifiabilityError(
            "no test in this band determines the unknowns",
            cure="give an unknown a value, add a sensor, or widen the band",
        )
    return _Columns(setup, terms, samples, grid, on_grid).run()


class _Columns:
    """Column generation: few candidates, joined by those at which the directional derivative is largest."""

    tolerance = 1e-7  # of the gap

    def __init__(
        self, setup: TestSetup, terms: InformationTerms, samples: float, grid: FrequencyGrid, on_grid: Real
    ) -> None:
        self.setup, self.terms, self.samples, self.grid, self.on_grid = setup, terms, samples, grid, on_grid
        some = np.arange(0, len(grid.frequency_hz), max(1, len(grid.frequency_hz) // 60))
        self.f, self.k, self.M = grid.frequency_hz[some], grid.pattern[some], on_grid[:, some]
        if not self._determined(self.M):
            self.f, self.k, self.M = grid.frequency_hz, grid.pattern, on_grid

    def run(self) -> Allocation:
        """Add columns until the gap is closed, then join the pairs that stand for one frequency."""
        best: Allocation | None = None
        try_below = 1e-5
        for turn in range(30):
            weights = optimal_shares(self.terms, self.setup.prior, self.M)
            trial, peaks = self._certified(weights)
            if best is None or trial.gap < best.gap:
                best = trial
            if trial.gap < self.tolerance:
                break
            if self.grid.free and trial.gap < try_below:
                try_below = 0.03 * trial.gap
                # Columns that crowd around one frequency slow the search down: one column that moves is better.
                columns = self.f, self.k, self.M
                joined = self._joined(best)
                if joined is not None:
                    return joined
                self.f, self.k, self.M = columns
            self._exchange(weights.w, peaks, keep=1e-9 if turn else 1e-6)
        assert best is not None
        joined = self._joined(best) if self.grid.free else None
        return best if joined is None else joined

    def _information(self, f: Real, k: Ints) -> Real:
        return self.samples * self.setup.information(f, k)

    def _determined(self, M: Real) -> bool:
        return bool(np.isfinite(self.terms.at(self.setup.prior + np.mean(M, axis=1)).F))

    def _certified(self, weights: Shares) -> tuple[Allocation, tuple[Real, Ints]]:
        """The design with its gap over the whole band, and the frequencies at which the derivative peaks."""
        w, share = weights.w, weights.y / np.sum(weights.y)
        at = self.terms.of(self.setup.prior, w, self.M)
        at_columns = share @ at.slopes(self.M)
        mean = float(at_columns @ w)
        curve = share @ at.slopes(self.on_grid)
        f, k, height = self._peaks(at, share, curve, np.max(at_columns))
        top = max(float(np.max(curve)), float(np.max(height, initial=0.0)))
        gap = (at.F - float(share @ at.parts) + top - mean) / self.terms.unit(at.F)
        kept = w > 1e-7 * np.max(w)
        over = (self.grid.frequency_hz, self.grid.pattern, curve / mean if mean > 0 else curve)
        share_kept = w[kept] / np.sum(w[kept])
        found = Allocation(self.f[kept], self.k[kept], share_kept, at.F, max(gap, 0.0), over)
        return found, (f, k)

    def _peaks(self, at: CriterionValue, share: Real, curve: Real, own: float) -> tuple[Real, Ints, Real]:
        """Local maxima of the derivative in each pattern, between grid points where frequencies are free."""
        found: list[tuple[Real, Ints, Real]] = [(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0))]
        for pattern in np.unique(self.grid.pattern):
            rows = np.flatnonzero(self.grid.pattern == pattern)
            f, h = self.grid.frequency_hz[rows], curve[rows]
            padded = np.concatenate([[-np.inf], h, [-np.inf]])
            top = np.flatnonzero((h >= padded[:-2]) & (h >= padded[2:]) & (h > 0.9 * own))
            if len(top) == 0:
                continue
            at_f, height = f[top], h[top]
            if self.grid.free and len(f) > 1:
                low, high = f[np.maximum(top - 1, 0)], f[np.minimum(top + 1, len(f) - 1)]
                between, higher = self._highest(at, share, low, high, int(pattern))
                at_f, height = np.where(higher > height, between, at_f), np.maximum(higher, height)
            found.append((at_f, np.full(len(top), pattern, dtype=np.int64), height))
        f, k, height = (np.concatenate(part) for part in zip(*found, strict=True))
        return f, k, height

    def _highest(
        self, at: CriterionValue, share: Real, low: Real, high: Real, pattern: int
    ) -> tuple[Real, Real]:
        """The highest point of each bracket: zoom in on the best of 13 points, all brackets at once, over ln f."""
        a, b = np.log(low), np.log(high)
        rows, part = np.arange(len(a)), np.linspace(0, 1, 13)
        for _ in range(5):
            x = a[:, None] + (b - a)[:, None] * part
            f = np.clip(np.exp(x.ravel()), self.grid.low, self.grid.high)
            M = self._information(f, np.full(f.size, pattern, dtype=np.int64))
            h = (share @ at.slopes(M)).reshape(x.shape)
            top = np.argmax(h, axis=1)
            a, b = x[rows, np.maximum(top - 1, 0)], x[rows, np.minimum(top + 1, len(part) - 1)]
        best = f.reshape(x.shape)[rows, top]
        # exp(ln f) misses the ends of the band by rounding.
        for end in (self.grid.low, self.grid.high):
            best = np.where(np.abs(best / end - 1) < 1e-9, end, best)
        return best, h[rows, top]

    def _exchange(self, w: Real, peaks: tuple[Real, Ints], keep: float) -> None:
        """Keep what has weight, add the peaks."""
        kept = w > keep * np.max(w)
        if not self._determined(self.M[:, kept]):
            kept[:] = True  # the best test for some leaves others open: the search must not start from there
        f, k = peaks
        same = (k[:, None] == self.k[kept]) & (np.abs(self.f[kept] / f[:, None] - 1) < 1e-10)
        f, k = f[~np.any(same, axis=1)], k[~np.any(same, axis=1)]
        self.f, self.k = np.concatenate([self.f[kept], f]), np.concatenate([self.k[kept], k])
        self.M = self.M[:, kept]
        if len(f):
            self.M = np.concatenate([self.M, self._information(f, k)], axis=1)

    def _joined(self, best: Allocation) -> Allocation | None:
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
                joined = self._settle()
                if joined is not None:
                    return joined
            width /= 4
        return None

    def _settle(self) -> Allocation | None:
        """Shift each frequency to the peak near it and weigh again until the gap is closed; None: it stays open."""
        best: Allocation | None = None
        for _ in range(12):
            self.M = self._information(self.f, self.k)
            if not self._determined(self.M):
                break
            trial, (f, k) = self._certified(optimal_shares(self.terms, self.setup.prior, self.M))
            if best is not None and trial.gap > 0.5 * best.gap:
                break
            best = trial
            if trial.gap < 0.1 * self.tolerance:
                break
            for i, at in enumerate(self.f):
                away = np.where(k == self.k[i], np.abs(np.log(f / at)), np.inf)
                if np.min(away, initial=np.inf) < 0.05:
                    self.f[i] = f[np.argmin(away)]
        return best if best is not None and best.gap < self.tolerance else None


def clusters(
    frequency_hz: Real, pattern: Ints, share: Real, width: float, between: bool = True
) -> tuple[Real, Ints, Real]:
    """One line for each run of frequencies of one pattern that are closer than `width` in ln f.

    Its frequency is their weighted mean in ln f or, unless it may lie between them, that of the largest share.
    All (lines,).
    """
    order = np.lexsort((frequency_hz, pattern))
    x, k, w = np.log(frequency_hz[order]), pattern[order], share[order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(x) > width) | (np.diff(k) != 0)]))
    total = np.add.reduceat(w, first)
    f = np.exp(np.add.reduceat(x * w, first) / total)
    for i, (start, end) in enumerate(zip(first, [*first[1:], len(x)], strict=True)):
        if end == start + 1 or not between:
            f[i] = frequency_hz[order[start + int(np.argmax(w[start:end]))]]
    return f, k[first], total


# What a test will tell: standard deviations of the unknowns, and what each frequency adds to them.


@dataclass(frozen=True)
class ExpectedPrecision(Frozen):
    """What a test will tell, at the nominal values.

    sd, relative  (q,)    standard deviations of ψ in SI units, and in parts of the values
    covariance    (q, q)  SI units
    figure        the criterion, as a relative standard deviation
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    covariance: Real
    figure: float

    @property
    def relative(self) -> Real:
        """sd in parts of |value| (of 1 where the value is 0)."""
        return self.sd / np.where(self.values == 0, 1.0, np.abs(self.values))

    def rms(self, names: Sequence[str] = ()) -> float:
        """Root mean square of the relative standard deviations of all (or some) of the parameters."""
        chosen = [self.names.index(name) for name in names] if names else list(range(len(self.names)))
        return float(np.sqrt(np.mean(self.relative[chosen] ** 2)))


def expected_precision(
    setup: TestSetup, criterion: Criterion, information: Real | float
) -> ExpectedPrecision:
    """What a test's information (scenarios, q, q) in parts of the sizes, plus what is already known, will give.

    Raises IdentifiabilityError if it leaves some parameter open.
    """
    at = criterion.at(setup, information)
    if not np.isfinite(at.F):
        raise IdentifiabilityError(
            "this test does not determine the unknowns", cure="give it more frequencies, or another sensor"
        )
    size = setup.sizes[0]
    C = at.C[0] * size[:, None] * size
    # Calibrations are errors of ln gain and of delay; their value is 1 and 0.
    late = [unknown.unit == "s" for unknown in setup.calibrations]
    units = tuple(unknown.unit for unknown in (*setup.model.unknowns, *setup.calibrations))
    values = np.concatenate([setup.theta[0], [0.0 if delay else 1.0 for delay in late]])
    return ExpectedPrecision(setup.names, units, values, np.sqrt(np.diagonal(C)), C, criterion.figure(at.F))


def information_gain(
    setup: TestSetup, criterion: Criterion, schedule: Schedule, frequency_hz: Real, pattern: Ints
) -> Real:
    """How much a sample at each frequency adds to what is known of each parameter, (frequencies, q).

    (C M(f) C)_jj / C_jj at the nominal values, times the test's samples: 1 is what its average sample adds.
    """
    C = criterion.at(setup, schedule.information(setup)).C[0]
    each = setup.information(frequency_hz, pattern)[0]
    gain = np.einsum("ja,iab,bj->ij", C, each, C)
    return float(np.sum(schedule.samples)) * gain / np.diagonal(C)
