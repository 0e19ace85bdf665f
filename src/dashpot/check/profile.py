"""Profile likelihood: χ² with one unknown held at a value and all others at their best (Venzon and Moolgavkar 1988).

Where χ² is not a parabola in the unknowns the interval value ± t sd misleads; the one where the profile has risen by as
much as the parabola would at ± t sd is a likelihood-ratio interval and follows the curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dashpot.arrays import Bools, Ints, Real, freeze
from dashpot.data.spectrum import SettledDwell, Spectrum
from dashpot.errors import DashpotError, DataError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.uncertainty import flat_valley
from dashpot.estimate.likelihood.descent import Stage
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import (
    bounds,
    local,
    measured,
    per_line,
)
from dashpot.estimate.preparation import prepare
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import MISFIT, Estimate
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise
from dashpot.numerics.small_systems import scaled_inverse

# χ² of the data as a function of the unknowns, around an estimate: what profiles and sensitivities are made
# of.


@dataclass(frozen=True)
class Surface:
    """χ²(ψ) of K repeats with the priors' part; psi (K, M) is its minimum near the estimate, cost (K,) the value there.

    information (K, lines, M, M) of each line at psi; lower, upper (M,) what the model allows; lacking (M, M) the
    curvature that χ² has where one repeat's information has none.
    """

    view: ObservationModel
    data: Measured
    sign: Real
    psi: Real
    cost: Real
    information: Real
    lower: Real
    upper: Real
    lacking: Real

    def at(self, psi: Real, rows: Ints) -> QuadraticModel:
        """χ², minus half its slope, and half its curvature (Gauss-Newton) at ψ, (k, M), of the repeats `rows`."""
        return local(self.view, self.data.pick(rows), psi, self.sign[rows])

    def covariance(self) -> Real:
        """Inverse of information, curvature beside it and priors, (K, M, M); NaN where that is singular."""
        held = self.lacking + np.diag(self.view.prior_precision)
        return scaled_inverse(np.sum(self.information, axis=-3) + held)


def chi2_surface(model: Model, spectrum: Spectrum, estimate: Estimate) -> Surface:
    """χ² around `estimate`, weighed as `identify` weighs; leading batch axes become one of K repeats.

    Raises DataError if the estimate has other unknowns.
    """
    data = prepare(model, spectrum)
    view = data.view
    if view.names != estimate.names:
        raise DataError(
            "the unknowns of the estimate are not those of the rig and its channels", cure="identify again"
        )
    psi = estimate.values.reshape(-1, len(view.names))
    sign = spectrum.signs(estimate.signs, len(psi))
    exact = measured(data)
    if not data.noise_known and np.any(view.prior_precision):
        # Priors weigh against noise of the right size: that which makes χ² its degrees of freedom.
        penalty = np.sum(view.prior_precision * (psi - view.prior_mean) ** 2, axis=-1)
        cost = local(view, exact, psi, sign).cost - penalty
        size = cost / np.maximum(estimate.fit.dof - penalty, 1.0)
        exact = exact.with_noise(np.maximum(size, 1e-300))
    lower, upper = bounds(view, False)

    def evaluate(at: Real, rows: Ints) -> QuadraticModel:
        return local(view, exact.pick(rows), at, sign[rows])

    minimum = minimise(evaluate, psi, limit=100, tolerance=1e-6, lower=lower, upper=upper)
    information, _, _ = per_line(view, exact, minimum.x, sign)
    # At the estimate itself, as its covariance has it.
    scale = (
        1.0
        if data.noise_known
        else float(evaluate(psi[:1], np.array([0])).cost[0]) / max(estimate.fit.dof, 1)
    )
    valley = flat_valley(view, exact, psi, sign, scale)
    lacking = np.zeros((len(view.names),) * 2) if valley is None else valley.curvature
    return Surface(view, exact, sign, minimum.x, minimum.cost, information, lower, upper, lacking)


FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the normal half-length, the first steps outwards
GROWTH, FARTHEST = 1.5, 24  # then steps grow; 1.5²⁴ is 17,000 half-lengths
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
        return np.asarray(self.difference > 0.1)  # of the normal interval's length by which an end may be off


def profile(
    model: Model, spectrum: Spectrum, name: str, level: float = 0.95, estimate: Estimate | None = None,
    surface: Surface | None = None,
) -> Profile:  # fmt: skip
    """The profile of an unknown (a parameter, NAME.gain or NAME.delay) and the interval from it.

    `estimate`, found anew unless given, must be of a method on the bound (oiv, ml).  The rise of χ² at the ends is
    that of the parabola at the ends of the estimate's normal interval: it counts the noise as the estimate does.
    `surface` is χ² around that estimate, where it has been made.
    Raises UsageError if there is no such unknown.
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
    return np.sign(known) * np.sqrt(np.abs(known))


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
        for _ in range(12):  # at most
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


# Profile intervals of several unknowns together: what one profile meets on its way counts for all of them.
#
# Where χ² has bent or several valleys, the way out along one profile may stay in a valley that ends early,
# while χ² is as low in another. Every point at which χ² has risen by less than at the ends of an interval
# belongs to that interval, of whichever unknown the profile was: where the interval ends short of it, the
# way is taken up again from there.


Curve = tuple[tuple[float, ...], tuple[float, ...]]

DRAWS = 40  # points from which other valleys are looked for


def joint_profiles(surface: Surface, wanted: Sequence[int], half: Real, root: Real) -> dict[int, Curve]:
    """Curves (`Profile.curve`) of the unknowns `wanted`, and of all whose normal interval is too short (no batch axes).

    half (M,): half-lengths of the normal intervals about the estimate; root (M,): of the rise of χ² at the ends.
    Nothing where ever lower χ² is met.
    """
    value, base = surface.psi[0], surface
    for _ in range(3):  # times that a lower χ² is met before nothing is said
        ways = _Ways(base, value, half, root)
        own = base.at(value[None], np.array([0])).cost - base.cost
        # Minima that draws about the estimate lead to, with the root of their rise
        away = np.random.default_rng(0).standard_normal((DRAWS, len(half)))
        # 1.5: half-lengths of the normal intervals: their standard deviation
        ends = _minimum(base, base.psi[0] + 1.5 * half * away)
        known = [
            (value, float(signed_root(own)[0])),
            *list(zip(ends.x, signed_root(ends.cost - base.cost[0]).tolist(), strict=True)),
        ]
        lower = ways.followed(wanted, known)
        if lower is None:
            return {j: ways.curve(j) for j in sorted(ways.ends)}
        minimum = _minimum(base, lower[None])
        base = replace(base, psi=minimum.x, cost=minimum.cost)
    return {}


def _minimum(base: Surface, start: Real) -> OptimizeResult:
    """Minima of χ² reached from `start`, (k, M)."""

    def evaluate(psi: Real, rows: Ints) -> QuadraticModel:
        return base.at(psi, np.zeros(len(psi), dtype=np.int64))

    return minimise(evaluate, start, limit=60, tolerance=1e-4, lower=base.lower, upper=base.upper)


class _Ways:
    """All ways outwards from one minimum, and what they met: ψ (M,) with roots of the rise."""

    def __init__(self, base: Surface, value: Real, half: Real, root: Real) -> None:
        self.base, self.value, self.half, self.root = base, value, half, root
        self.visited: list[tuple[Real, float]] = []
        self.ends: dict[int, list[float]] = {}
        self.points: dict[int, list[tuple[float, float]]] = {}
        self.count = 0

    def followed(self, wanted: Sequence[int], known: Sequence[tuple[Real, float]]) -> Real | None:
        """Follow all ways; a ψ (M,) where χ² is lower than at the minimum that they start from, if one is met.

        known: ψ (M,) and roots of the rise that were met elsewhere.
        """
        self.visited += [point for point in known if abs(point[1]) <= np.max(self.root)]
        for j in wanted:
            self._profiled(j)
        sides = [(j, side) for j in range(len(self.value)) for side in (0, 1)]
        for _ in range(6):  # rounds in which ways are taken up again
            lower = [psi for psi, root in self.visited if root < -CLOSE * np.min(self.root)]
            if lower:
                return lower[-1]
            taken_up = [self._taken_up(j, side) for j, side in sides]
            if not any(taken_up):
                break
        return None

    def _profiled(self, j: int) -> None:
        self.ends[j], self.points[j] = [self.base.psi[0, j]] * 2, [(self.base.psi[0, j], 0.0)]
        for side in (0, 1):
            self._followed(j, side, None)

    def _taken_up(self, j: int, side: int) -> bool:
        """Whether the interval of one unknown ended short of what was met elsewhere, and goes on now."""
        outwards = 2 * side - 1
        inside = [(psi, root) for psi, root in self.visited if root < (1 - CLOSE) * self.root[j]]
        if not inside or self.count >= 120:  # outwards, in all
            return False
        start = max(inside, key=lambda point: outwards * point[0][j])
        end = self.ends[j][side] if j in self.ends else self.value[j] + outwards * self.half[j]
        # 0.02 of the half-length of a normal interval: what an interval ends short of
        if outwards * (start[0][j] - end) <= 0.02 * self.half[j]:
            return False
        if j not in self.ends:
            self._profiled(j)
            return True
        self._followed(j, side, start)
        return True

    def _followed(self, j: int, side: int, start: tuple[Real, float] | None) -> None:
        walk = Walk(self.base, j, self.root[[j]], self.half[[j]])
        outwards = 2.0 * side - 1
        way = walk.end(outwards, start)
        self.count += 1
        self.visited += way.visited
        self.points[j] += zip(way.points, way.rises, strict=True)
        reached = float(way.end[0])
        if start is not None:
            self.points[j].append((float(start[0][j]), start[1] ** 2))
            reached = outwards * max(outwards * reached, outwards * float(start[0][j]))
        self.ends[j][side] = outwards * max(outwards * reached, outwards * self.ends[j][side])

    def curve(self, j: int) -> Curve:
        """(values, roots) from one end to the other, the root of the rise over that at the ends; 0 at the estimate."""
        low, high = self.ends[j]
        points = [(v, r) for v, r in self.points[j] if low < v < high and v != self.value[j]]
        values, rises = np.array(sorted(points)).reshape(-1, 2).T
        roots = np.clip(np.sqrt(np.clip(rises, 0.0, None)) / self.root[j], 0.0, 1.0)
        above = values > self.value[j]
        # At any level the interval goes as far as χ² is low anywhere.
        up = np.minimum.accumulate(roots[above][::-1])[::-1]
        down = np.minimum.accumulate(roots[~above])
        return (
            (low, *values[~above].tolist(), float(self.value[j]), *values[above].tolist(), high),
            (-1.0, *(-down).tolist(), 0.0, *up.tolist(), 1.0),
        )


# Whether χ² is a parabola as far as the intervals reach, and intervals that follow it where it is not
# (THEORY §11).
#
# Along the tangent of its profile each unknown is moved by twice its standard deviation to both sides, the
# others with it: where χ² is a parabola it rises by 4. That costs two values of χ² for each unknown;
# profiles are taken of those alone whose rise is another.


REACH = 2.0  # standard deviations
MOST_AMPLITUDES = 3000  # with more, profiles take longer than anyone waits


def with_profile_intervals(model: Model, spectrum: Spectrum, estimate: Estimate) -> Estimate:
    """The estimate with the profile's 95 % interval of each unknown along which χ² is no parabola (no batch axes).

    It is unchanged where that takes long, where intervals count a misfit, and where bounds hold unknowns.
    """
    # Whether profiles are worth their time, and mean what they say
    plain = all(isinstance(stretch, SettledDwell) for stretch in spectrum.stretches)
    small = len(estimate.names) <= 40 and spectrum.amplitudes.size <= MOST_AMPLITUDES
    sound = bool(estimate.converged) and estimate.basis != MISFIT
    free = np.array_equal(estimate.free_values, estimate.values)
    unweighed = estimate.fit.known_noise or not estimate.stated
    efficient = estimate.method in AUTOMATIC and not len(model.nonlinear)
    if not (plain and small and sound and free and unweighed and efficient):
        return estimate
    try:
        # 5.0: sd over the value from which on the data contain no information on it, along whatever curve
        precise = estimate.noise_sd < 5.0 * np.abs(estimate.values)
        bent = np.flatnonzero(bent_unknowns(model, spectrum, estimate) & precise)[:12]
        if not len(bent):
            return estimate
        surface = chi2_surface(model, spectrum, estimate)
        low, high = replace(estimate, profiles={}).interval()
        half = (high - low) / 2
        curves = joint_profiles(
            surface, bent.tolist(), half, half / np.sqrt(np.diagonal(surface.covariance()[0]))
        )
    except DashpotError:
        return estimate  # nothing is said of the surface of such a rig
    return replace(estimate, profiles={estimate.names[j]: curve for j, curve in curves.items()})


def bent_unknowns(model: Model, spectrum: Spectrum, estimate: Estimate) -> Bools:
    """(unknowns,): whether χ² at ± 2 standard deviations is far from what the covariance says (no batch axes)."""
    data = prepare(model, spectrum)
    stage = Stage(data.view, measured(data))
    sd = estimate.noise_sd
    with np.errstate(all="ignore"):
        away = REACH * estimate.noise_covariance / sd
        points = np.concatenate([estimate.values[None], estimate.values + away.T, estimate.values - away.T])
        # Intervals of estimated noise are wider than the parabola of that noise.
        widened = np.where(estimate.bound_sd > 0, sd / estimate.bound_sd, 1.0)
        sign = spectrum.signs(estimate.signs, len(points))
        cost = stage.cost(points, sign, np.zeros(len(points), dtype=np.int64))
        scale = 1.0 if data.noise_known else cost[0] / max(estimate.fit.dof, 1)
        root: Real = np.sqrt(np.maximum(cost[1:] - cost[0], 0.0) / scale).reshape(2, -1) / widened
    # 0.12: relative error of the root of the rise there
    bent: Bools = ~np.all(np.abs(root / REACH - 1) < 0.12, axis=0)
    return bent & np.isfinite(sd) & (sd > 0)
