"""Profile likelihood: χ² with one unknown held at a value and all others at their best (Venzon and Moolgavkar 1988).

Where χ² is not a parabola in the unknowns the interval value ± t sd misleads; the one where the profile has risen by as
much as the parabola would at ± t sd is a likelihood-ratio interval and follows the curvature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dashpot.arrays import Bools, Ints, Real, freeze
from dashpot.check.chi2_surface import Surface, chi2_surface
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise

MISLEADS = 0.1  # of the normal interval's length by which an end may be off
FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the normal half-length, the first steps outwards
GROWTH, FARTHEST = 1.5, 24  # then steps grow; 1.5²⁴ is 17,000 half-lengths
REFINEMENTS = 12
CLOSE = 1e-3  # of the root of the rise


@dataclass(frozen=True)
class Profile:
    """The profile of one unknown, in `unit`; lower … normal_upper have the estimate's batch axes.

    lower, upper      ends of the profile's interval; infinite where χ² never rises enough, the bound where one holds
    normal_lower, …   ends of value ± t sd
    points, rise      (points,), (points,): values tried for the first repeat, in order, and χ² above its minimum
    threshold         (...,): the rise at the ends
    improved          whether χ² fell below the estimate's on the way: the estimate was not the best
    """

    name: str
    unit: str
    level: float
    value: Real
    lower: Real
    upper: Real
    normal_lower: Real
    normal_upper: Real
    points: Real
    rise: Real
    threshold: Real
    improved: Bools

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def difference(self) -> Real:
        """The larger distance between ends of the two intervals, in lengths of the normal one; (...,)."""
        length = self.normal_upper - self.normal_lower
        off = np.maximum(np.abs(self.lower - self.normal_lower), np.abs(self.upper - self.normal_upper))
        return np.asarray(off / length)

    @property
    def curve(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(values, roots) from one end to the other: the root of the rise over that at the ends, of the first repeat.

        Both ascend; an end that is infinite has none.  See `profile_interval`.
        """
        value, threshold = float(np.ravel(self.value)[0]), float(np.ravel(self.threshold)[0])
        ends = float(np.ravel(self.lower)[0]), float(np.ravel(self.upper)[0])
        inside = (self.points > ends[0]) & (self.points < ends[1])
        side = np.sign(self.points[inside] - value)
        roots = side * np.sqrt(np.clip(self.rise[inside] / threshold, 0.0, 1.0))
        outwards = np.where(side > 0, np.maximum.accumulate(np.maximum(roots, 0.0)), roots)
        outwards = np.where(side < 0, np.minimum.accumulate(np.minimum(outwards, 0.0)[::-1])[::-1], outwards)
        return (
            (ends[0], *self.points[inside].tolist(), ends[1]),
            (-1.0, *outwards.tolist(), 1.0),
        )

    @property
    def misleads(self) -> Bools:
        """Whether the normal interval is off by more than a tenth of its length, (...,)."""
        return np.asarray(self.difference > MISLEADS)


def profile(
    model: Model, spectrum: Spectrum, name: str, level: float = 0.95, estimate: Estimate | None = None,
    surface: Surface | None = None,
) -> Profile:  # fmt: skip
    """The profile of an unknown (a parameter, NAME.gain or NAME.delay) and the interval from it.

    `estimate`, found anew unless given, must be of a method on the bound (oiv, ml).  The rise of χ² at the ends is
    that of the parabola at the ends of the estimate's normal interval: it counts the noise as the estimate does.
    `surface` is χ² around that estimate, where it has been made.
    Raises UsageError where there is no such unknown.
    """
    around = identify(model, spectrum) if estimate is None else estimate
    if name not in around.names:
        raise UsageError(f"{name} is not among the unknowns", cure=f"there are {', '.join(around.names)}")
    j = around.names.index(name)
    base = chi2_surface(model, spectrum, around) if surface is None else surface
    low, high = (end[..., j] for end in replace(around, profiles={}).interval(level))
    half = (high - low).ravel() / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        threshold = (half / np.sqrt(base.covariance()[:, j, j])) ** 2
    walk = Walk(base, j, np.sqrt(threshold), half)
    down, up = walk.end(-1.0), walk.end(1.0)
    points = np.array([*down.points, base.psi[0, j], *up.points])
    rise = np.array([*down.rises, 0.0, *up.rises])
    order = np.argsort(points)
    batch = around.values.shape[:-1]
    return Profile(
        name, around.units[j], level, base.psi[:, j].reshape(batch), down.end.reshape(batch), up.end.reshape(batch),
        low, high, points[order], rise[order], threshold.reshape(batch), (down.improved | up.improved).reshape(batch),
    )  # fmt: skip


def signed_root(rise: Real) -> Real:
    """The root of a rise of χ², negative where χ² falls; infinite where it is none."""
    known = np.where(np.isfinite(rise), rise, np.inf)
    root: Real = np.sign(known) * np.sqrt(np.abs(known))
    return root


@dataclass(frozen=True)
class Side:
    """One side of the profile: where the rise is reached; what the first repeat met on the way.

    points, rises: values of the unknown and χ² above the minimum; visited: ψ (M,) and the root of the rise there.
    """

    end: Real
    points: list[float]
    rises: list[float]
    improved: Bools
    visited: list[tuple[Real, float]]


@dataclass(frozen=True)
class Walk:
    """Outwards along the profile of unknown j, to where the root of the rise is `root`, (K,)."""

    base: Surface
    j: int
    root: Real
    half: Real

    def held(self, value: Real, start: Real, rows: Ints) -> tuple[Real, Real]:
        """(root of the rise, ψ) with the unknown at `value`, (k,), the others searched from `start`, (k, M)."""
        j, base = self.j, self.base
        others = np.arange(start.shape[1]) != j
        if not np.any(others):
            cost = base.at(value[:, None], rows).cost
            return self._root(cost, rows), value[:, None]

        def whole(x: Real, which: Ints) -> Real:
            psi = np.empty((len(x), len(others)))
            psi[:, others] = x
            psi[:, j] = value[which]
            return psi

        def evaluate(x: Real, which: Ints) -> QuadraticModel:
            at = base.at(whole(x, which), rows[which])
            matrix = at.symmetric[:, others][:, :, others]
            return QuadraticModel(at.cost, at.gradient[:, others], matrix, matrix)

        starts = start + self._kicks[:, None]
        tried = len(starts)
        rows, value = np.tile(rows, tried), np.tile(value, tried)
        minimum = minimise(
            evaluate, starts.reshape(-1, start.shape[1])[:, others], limit=60, tolerance=1e-4,
            lower=base.lower[others], upper=base.upper[others],
        )  # fmt: skip
        cost = np.where(np.isfinite(minimum.cost), minimum.cost, np.inf).reshape(tried, -1)
        best = np.argmin(cost, axis=0) * len(start) + np.arange(len(start))
        return self._root(minimum.cost[best], rows[best]), whole(minimum.x, np.arange(len(value)))[best]

    @cached_property
    def _kicks(self) -> Real:
        """Displacements (k, M) of starts, of which the first is none: beside a fold the way out is along a ridge."""
        none = np.zeros((1, self.base.psi.shape[1]))
        if not np.any(self.base.lacking):
            return none
        covariance = self.base.covariance()[0]
        away = covariance / np.sqrt(np.diagonal(covariance))[:, None]
        return np.concatenate([none, away, -away])

    def _root(self, cost: Real, rows: Ints) -> Real:
        return signed_root(cost - self.base.cost[rows])

    def end(self, side: float, start: tuple[Real, float] | None = None) -> Side:
        """One side: below the estimate (−1) or above it (1); of the first repeat on from ψ (M,) with its root."""
        bracket = _Bracket(self, side)
        if start is not None:
            bracket.start_from(*start)
        for turn in range(len(FRACTIONS) + FARTHEST):
            step = FRACTIONS[turn] if turn < len(FRACTIONS) else GROWTH ** (turn + 1 - len(FRACTIONS))
            if not bracket.step_out(step):
                break
        for _ in range(REFINEMENTS):
            if not bracket.refine():
                break
        return Side(bracket.end, bracket.points, bracket.rises, bracket.improved, bracket.visited)


class _Bracket:
    """Distances from the estimate between which each repeat's rise is reached: `inner` is short of it, `outer` beyond.

    psi (K, M) is the profile's point at `inner`, slope its change per unit of distance; inner_root, outer_root are
    roots of the rise.
    """

    def __init__(self, walk: Walk, side: float) -> None:
        base, j, repeats = walk.base, walk.j, len(walk.base.psi)
        self.walk, self.side = walk, side
        self.bound = float(base.upper[j] if side > 0 else base.lower[j])
        self.centre, self.psi = base.psi[:, j], base.psi.copy()
        self.inner, self.inner_root, self.distance = np.zeros((3, repeats))
        self.outer, self.outer_root = np.full((2, repeats), np.inf)
        self.end = np.full(repeats, side * np.inf)
        self.improved = np.zeros(repeats, dtype=bool)
        self.searching = np.isfinite(walk.half) & (walk.half > 0)
        self.points: list[float] = []
        self.rises: list[float] = []
        self.visited: list[tuple[Real, float]] = []
        self.first = np.zeros(repeats)
        covariance = base.covariance()[:, j]
        with np.errstate(invalid="ignore", divide="ignore"):
            tangent = covariance / covariance[:, j][:, None]
        self.slope = side * np.nan_to_num(tangent)

    def start_from(self, psi: Real, root: float) -> None:
        """Begin the first repeat's way at ψ (M,), where the root of the rise is known, and the others stay."""
        self.psi[0] = psi
        self.first[0] = self.inner[0] = abs(float(psi[self.walk.j] - self.centre[0]))
        self.inner_root[0] = root
        self.slope[0] = np.where(np.arange(len(psi)) == self.walk.j, self.side, 0.0)

    def step_out(self, step: float) -> bool:
        """Try `step` half-widths of the normal interval further where nothing is beyond yet; False: nowhere."""
        walk, side = self.walk, self.side
        rows = np.flatnonzero(self.searching & ~np.isfinite(self.outer))
        if not len(rows):
            return False
        self.distance[rows] = self.first[rows] + step * walk.half[rows]
        limited = side * (self.centre[rows] + side * self.distance[rows] - self.bound) >= 0
        self.distance[rows[limited]] = np.abs(self.bound - self.centre[rows[limited]])
        root, psi = self._held(rows, self.distance[rows])
        self.improved[rows] |= root < -CLOSE * walk.root[rows]
        if rows[0] == 0 and np.isfinite(root[0]):
            self.points.append(float(psi[0, walk.j]))
            self.rises.append(float(np.sign(root[0]) * root[0] ** 2))
        beyond = root >= walk.root[rows]
        self.outer[rows[beyond]], self.outer_root[rows[beyond]] = self.distance[rows[beyond]], root[beyond]
        stop = limited & ~beyond
        self.end[rows[stop]] = self.bound
        self.searching[rows[stop]] = False
        on = ~beyond & ~stop
        self._move_inner(rows[on], self.distance[rows[on]], root[on], psi[on])
        return True

    def refine(self) -> bool:
        """Try between `inner` and `outer` where the end is not close yet; False: nowhere."""
        rows = np.flatnonzero(np.isfinite(self.outer) & self.searching)
        if not len(rows):
            return False
        root_wanted = self.walk.root[rows]
        inner, outer = self.inner[rows], self.outer[rows]
        share = (root_wanted - self.inner_root[rows]) / (self.outer_root - self.inner_root)[rows]
        share = np.clip(np.where(np.isfinite(self.outer_root[rows]), share, 0.5), 0.02, 0.98)
        middle = inner + share * (outer - inner)
        root, psi = self._held(rows, middle)
        self.end[rows] = self.centre[rows] + self.side * middle
        beyond = root >= root_wanted
        self.outer[rows[beyond]], self.outer_root[rows[beyond]] = middle[beyond], root[beyond]
        self._move_inner(rows[~beyond], middle[~beyond], root[~beyond], psi[~beyond])
        self.searching[rows[np.abs(root - root_wanted) < CLOSE * root_wanted]] = False
        return True

    def _held(self, rows: Ints, distance: Real) -> tuple[Real, Real]:
        """(root of the rise, ψ) at a distance from the estimate."""
        start = self.psi[rows] + self.slope[rows] * (distance - self.inner[rows])[:, None]
        root, psi = self.walk.held(self.centre[rows] + self.side * distance, start, rows)
        if rows[0] == 0 and np.isfinite(root[0]):
            self.visited.append((psi[0], float(root[0])))
        return root, psi

    def _move_inner(self, rows: Ints, distance: Real, root: Real, psi: Real) -> None:
        moved = (distance - self.inner[rows])[:, None]
        self.slope[rows] = np.where(
            moved != 0, (psi - self.psi[rows]) / np.where(moved != 0, moved, 1.0), self.slope[rows]
        )
        self.psi[rows], self.inner[rows], self.inner_root[rows] = psi, distance, root
