"""Profile likelihood: χ² with one unknown held at a value and all others at their best (Venzon and Moolgavkar 1988).

Where χ² is no parabola in the unknowns the interval value ± t sd misleads; the one where the profile has risen by as
much as the parabola would at ± t sd is a likelihood-ratio interval and follows the curvature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Ints, Real, frozen
from dashpot.check.chi2_surface import Surface, surface
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
        for name in (
            "value",
            "lower",
            "upper",
            "normal_lower",
            "normal_upper",
            "points",
            "rise",
            "threshold",
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))

    @property
    def difference(self) -> Real:
        """The larger distance between ends of the two intervals, in lengths of the normal one; (...,)."""
        length = self.normal_upper - self.normal_lower
        off = np.maximum(np.abs(self.lower - self.normal_lower), np.abs(self.upper - self.normal_upper))
        return np.asarray(off / length)

    @property
    def misleads(self) -> Bools:
        """Whether the normal interval is off by more than a tenth of its length."""
        return np.asarray(self.difference > MISLEADS)


def profile(
    model: Model, spectrum: Spectrum, name: str, level: float = 0.95, estimate: Estimate | None = None
) -> Profile:
    """The profile of an unknown (a parameter, NAME.gain or NAME.delay) and the interval from it.

    `estimate`, found anew unless given, must be of a method on the bound (oiv, ml).  The rise of χ² at the ends is
    that of the parabola at the ends of the estimate's own interval: it counts the noise as the estimate does.
    Raises UsageError where there is no such unknown.
    """
    found = identify(model, spectrum) if estimate is None else estimate
    if name not in found.names:
        raise UsageError(f"{name} is not among the unknowns", cure=f"there are {', '.join(found.names)}")
    j = found.names.index(name)
    base = surface(model, spectrum, found)
    low, high = (end[..., j] for end in found.interval(level))
    half = (high - low).ravel() / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        threshold = (half / np.sqrt(base.covariance()[:, j, j])) ** 2
    walk = _Walk(base, j, np.sqrt(threshold), half)
    down, up = walk.end(-1.0), walk.end(1.0)
    points = np.array([*down.points, base.psi[0, j], *up.points])
    rise = np.array([*down.rises, 0.0, *up.rises])
    order = np.argsort(points)
    batch = found.values.shape[:-1]
    return Profile(
        name, found.units[j], level, base.psi[:, j].reshape(batch), down.end.reshape(batch), up.end.reshape(batch),
        low, high, points[order], rise[order], threshold.reshape(batch), (down.improved | up.improved).reshape(batch),
    )  # fmt: skip


@dataclass(frozen=True)
class _Side:
    """One side of the profile: where the rise is reached, what was met on the way by the first repeat."""

    end: Real
    points: list[float]
    rises: list[float]
    improved: Bools


@dataclass(frozen=True)
class _Walk:
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
            here = base.at(whole(x, which), rows[which])
            matrix = here.symmetric[:, others][:, :, others]
            return QuadraticModel(here.cost, here.gradient[:, others], matrix, matrix)

        found = minimise(
            evaluate, start[:, others], limit=60, tolerance=1e-4,
            lower=base.lower[others], upper=base.upper[others],
        )  # fmt: skip
        return self._root(found.cost, rows), whole(found.x, np.arange(len(value)))

    def _root(self, cost: Real, rows: Ints) -> Real:
        rise = np.where(np.isfinite(cost), cost - self.base.cost[rows], np.inf)
        return np.sign(rise) * np.sqrt(np.abs(rise))

    def end(self, side: float) -> _Side:
        """One side: below the estimate (−1) or above it (1)."""
        base, j = self.base, self.j
        repeats = len(base.psi)
        bound = base.upper[j] if side > 0 else base.lower[j]
        centre = base.psi[:, j]
        inner, inner_root, psi = np.zeros(repeats), np.zeros(repeats), base.psi.copy()
        slope = np.zeros_like(psi)
        outer, outer_root = np.full(repeats, np.inf), np.full(repeats, np.inf)
        end = np.full(repeats, side * np.inf)
        improved = np.zeros(repeats, dtype=bool)
        points: list[float] = []
        rises: list[float] = []
        with np.errstate(invalid="ignore", divide="ignore"):
            tangent = base.covariance()[:, j] / base.covariance()[:, j, j][:, None]
        slope = side * np.nan_to_num(tangent)
        open_ones = np.isfinite(self.half) & (self.half > 0)
        distance = np.zeros(repeats)
        for turn in range(len(FRACTIONS) + FARTHEST):
            rows = np.flatnonzero(open_ones & ~np.isfinite(outer))
            if not len(rows):
                break
            step = FRACTIONS[turn] if turn < len(FRACTIONS) else GROWTH ** (turn + 1 - len(FRACTIONS))
            distance[rows] = step * self.half[rows]
            limited = side * (centre[rows] + side * distance[rows] - bound) >= 0
            distance[rows[limited]] = np.abs(bound - centre[rows[limited]])
            start = psi[rows] + slope[rows] * (distance - inner)[rows, None]
            root, there = self.held(centre[rows] + side * distance[rows], start, rows)
            improved[rows] |= root < -CLOSE * self.root[rows]
            if rows[0] == 0 and np.isfinite(root[0]):
                points.append(float(there[0, j]))
                rises.append(float(np.sign(root[0]) * root[0] ** 2))
            beyond = root >= self.root[rows]
            outer[rows[beyond]], outer_root[rows[beyond]] = distance[rows[beyond]], root[beyond]
            stop = limited & ~beyond
            end[rows[stop]] = bound
            open_ones[rows[stop]] = False
            go = rows[~beyond & ~stop]
            new = there[~beyond & ~stop]
            slope[go] = (new - psi[go]) / (distance[go] - inner[go])[:, None]
            psi[go], inner[go], inner_root[go] = new, distance[go], root[~beyond & ~stop]
        crossing = np.isfinite(outer)
        for _ in range(REFINEMENTS):
            rows = np.flatnonzero(crossing)
            if not len(rows):
                break
            share = (self.root - inner_root)[rows] / (outer_root - inner_root)[rows]
            share = np.clip(np.where(np.isfinite(outer_root[rows]), share, 0.5), 0.02, 0.98)
            middle = inner[rows] + share * (outer - inner)[rows]
            start = psi[rows] + slope[rows] * (middle - inner[rows])[:, None]
            root, there = self.held(centre[rows] + side * middle, start, rows)
            beyond = root >= self.root[rows]
            end[rows] = centre[rows] + side * middle
            outer[rows[beyond]], outer_root[rows[beyond]] = middle[beyond], root[beyond]
            within = rows[~beyond]
            slope[within] = (there[~beyond] - psi[within]) / (middle[~beyond] - inner[within])[:, None]
            psi[within], inner[within], inner_root[within] = there[~beyond], middle[~beyond], root[~beyond]
            crossing[rows[np.abs(root - self.root[rows]) < CLOSE * self.root[rows]]] = False
        return _Side(end, points, rises, improved)
