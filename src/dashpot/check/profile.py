"""Profile likelihood: χ² with one unknown held at a value and all others at their best (Venzon and Moolgavkar 1988).

Where χ² is not a parabola in the unknowns the interval value ± t sd misleads; the one where the profile has risen by as
much as the parabola would at ± t sd is a likelihood-ratio interval and follows the curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dashpot.arrays import Bools, Frozen, Real
from dashpot.data.spectrum import SettledDwell, Spectrum
from dashpot.errors import DashpotError, DataError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.uncertainty import flat_valley
from dashpot.estimate.likelihood.descent import Stage
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import bounds, local, measured, per_line
from dashpot.estimate.preparation import prepare
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import MISFIT, Estimate
from dashpot.io.words import choose_from, joined
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel
from dashpot.numerics.small_systems import scaled_inverse

# χ² of the data as a function of the unknowns, around an estimate: what profiles and sensitivities are made
# of.


@dataclass(frozen=True)
class Surface:
    """χ²(ψ) of one repeat with the priors' part; psi (M,) is its minimum near the estimate, cost the value there.

    sign (channels,); information (lines, M, M) of each line at psi; lower, upper (M,) what the model allows; lacking
    (M, M) the curvature that χ² has where the information has none.
    """

    view: ObservationModel
    data: Measured
    sign: Real
    psi: Real
    cost: float
    information: Real
    lower: Real
    upper: Real
    lacking: Real

    def at(self, psi: Real) -> QuadraticModel:
        """χ², minus half its slope, and half its curvature (Gauss-Newton) at ψ, (k, M)."""
        return Stage(self.view, self.data).model_at(psi, np.repeat(self.sign[None], len(psi), axis=0))

    def minimum(
        self, start: Real, held: tuple[int, float] | None = None, *, limit: int = 60, tolerance: float = 1e-4
    ) -> OptimizeResult:
        """Minima of χ² reached from `start`, (k, M); with one unknown held at a value, if given."""
        lower, upper = self.lower.copy(), self.upper.copy()
        if held is not None:
            lower[held[0]] = upper[held[0]] = held[1]
        signs, rows = np.repeat(self.sign[None], len(start), axis=0), self.data.rows_of(len(start))
        return Stage(self.view, self.data).descend(
            start, signs, rows, limit=limit, tolerance=tolerance, lower=lower, upper=upper
        )

    def root(self, cost: Real) -> Real:
        """The root of the rise to χ² of `cost` (k,), negative where χ² falls; infinite where it is none."""
        rise = np.where(np.isfinite(cost), cost, np.inf) - self.cost
        return np.sign(rise) * np.sqrt(np.abs(rise))

    def covariance(self) -> Real:
        """Inverse of the sum of information, further curvature and priors, (M, M); NaN where that is singular."""
        held = self.lacking + np.diag(self.view.prior_precision)
        return scaled_inverse(np.sum(self.information, axis=-3) + held)


def chi2_surface(model: Model, spectrum: Spectrum, estimate: Estimate) -> Surface:
    """χ² around `estimate` (no batch axes), weighed as `identify` weighs.

    Raises DataError if the estimate has other unknowns.
    """
    data = prepare(model, spectrum)
    view = data.view
    if view.names != estimate.names:
        raise DataError(
            "the unknowns of the estimate are not those of the rig and its channels", cure="identify again"
        )
    psi, sign = estimate.values[None], spectrum.signs(estimate.signs)
    exact = measured(data)
    if not data.noise_known and np.any(view.prior_precision):
        # Priors weigh against noise of the right size: that which makes χ² its degrees of freedom.
        penalty = np.sum(view.prior_precision * (psi - view.prior_mean) ** 2, axis=-1)
        cost = local(view, exact, psi, sign).cost - penalty
        size = cost / np.maximum(estimate.fit.dof - penalty, 1.0)
        exact = exact.with_noise(np.maximum(size, 1e-300))
    lower, upper = bounds(view, False)
    none = np.zeros((len(view.names),) * 2)
    around = Surface(view, exact, sign[0], psi[0], np.nan, none[None], lower, upper, none)
    minimum = around.minimum(psi, limit=100, tolerance=1e-6)
    information, _, _ = per_line(view, exact, minimum.x, sign)
    # At the estimate itself, as its covariance has it.
    scale = 1.0 if data.noise_known else float(around.at(psi).cost[0]) / max(estimate.fit.dof, 1)
    valley = flat_valley(view, exact, psi, sign, scale)
    return replace(
        around, psi=minimum.x[0], cost=float(minimum.cost[0]), information=information[0],
        lacking=none if valley is None else valley.curvature,
    )  # fmt: skip


FRACTIONS = (0.25, 0.5, 0.75, 1.0)  # of the normal half-length, the first steps outwards
GROWTH, FARTHEST = 1.5, 24  # then steps grow; 1.5²⁴ is 17,000 half-lengths
CLOSE = 1e-3  # of the root of the rise


@dataclass(frozen=True)
class Profile(Frozen):
    """The profile of one unknown, in `unit`.

    lower, upper      ends of the profile's interval; infinite where χ² never rises enough, the bound where one holds
    normal_lower, …   ends of value ± t sd
    points, rise      (points,), (points,): values tried, in order, and χ² above its minimum
    threshold         the rise at the ends
    improved          whether χ² fell below the estimate's on the way: the estimate was not the best
    """

    name: str
    unit: str
    level: float
    value: float
    lower: float
    upper: float
    normal_lower: float
    normal_upper: float
    points: Real
    rise: Real
    threshold: float
    improved: bool

    @property
    def difference(self) -> float:
        """The larger distance between ends of the two intervals, in lengths of the normal one."""
        length = self.normal_upper - self.normal_lower
        return max(abs(self.lower - self.normal_lower), abs(self.upper - self.normal_upper)) / length

    @property
    def misleads(self) -> bool:
        """Whether the normal interval is off by more than a tenth of its length."""
        return self.difference > 0.1  # of the normal interval's length by which an end may be off


def profile(
    model: Model, spectrum: Spectrum, name: str, level: float = 0.95, estimate: Estimate | None = None
) -> Profile:
    """The profile of an unknown (a parameter, NAME.gain or NAME.delay) and the interval from it (no batch axes).

    `estimate`, found anew unless given, must be of a method on the bound (oiv, ml).  The rise of χ² at the ends is
    that of the parabola at the ends of the estimate's normal interval: it counts the noise as the estimate does.
    Raises UsageError if there is no such unknown.
    """
    around = identify(model, spectrum) if estimate is None else estimate
    if name not in around.names:
        raise UsageError(f"{name} is not among the unknowns", cure=choose_from(around.names))
    j = around.names.index(name)
    base = chi2_surface(model, spectrum, around)
    low, high = (float(end[j]) for end in replace(around, profiles={}).interval(level))
    half = (high - low) / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        root = float(half / np.sqrt(base.covariance()[j, j]))
    walk = Walk(base, j, root, half)
    down, up = walk.end(-1.0), walk.end(1.0)
    points = np.array([*down.points, base.psi[j], *up.points])
    order = np.argsort(points, kind="stable")
    return Profile(
        name, around.units[j], level, float(base.psi[j]), down.end, up.end, low, high, points[order],
        np.array([*down.rises, 0.0, *up.rises])[order], root**2, down.improved or up.improved,
    )  # fmt: skip


@dataclass
class Side:
    """One side of the profile: where the rise is reached, and what was met on the way.

    points, rises: values of the unknown and χ² above the minimum; visited: ψ (M,) and the root of the rise there.
    """

    end: float
    points: list[float] = field(default_factory=list)
    rises: list[float] = field(default_factory=list)
    improved: bool = False
    visited: list[tuple[Real, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Walk:
    """Outwards along the profile of unknown j, to where the root of the rise is `root`."""

    base: Surface
    j: int
    root: float
    half: float

    def held(self, value: float, start: Real) -> tuple[float, Real]:
        """(root of the rise, ψ) with the unknown at `value`, the others searched from `start`, (M,)."""
        minimum = self.base.minimum(start + self._kicks, (self.j, value))
        best = int(np.argmin(np.where(np.isfinite(minimum.cost), minimum.cost, np.inf)))
        return float(self.base.root(minimum.cost[[best]])[0]), minimum.x[best]

    @cached_property
    def _kicks(self) -> Real:
        """Displacements (k, M) of starts, the first of which is none: next to a fold the way out is along a ridge."""
        none = np.zeros((1, len(self.base.psi)))
        if not np.any(self.base.lacking):
            return none
        covariance = self.base.covariance()
        away = covariance / np.sqrt(np.diagonal(covariance))[:, None]
        return np.concatenate([none, away, -away])

    def end(self, side: float, start: tuple[Real, float] | None = None) -> Side:
        """One side: below the estimate (−1) or above it (1); on from ψ (M,) with its root, if given."""
        base, j, centre = self.base, self.j, self.base.psi[self.j]
        way = Side(side * np.inf)
        if not (np.isfinite(self.half) and self.half > 0):
            return way
        bound = float(base.upper[j] if side > 0 else base.lower[j])
        # ψ is the profile's point at the distance `inner` from the estimate, slope its change per unit of distance
        psi, inner, inner_root = base.psi, 0.0, 0.0
        covariance = base.covariance()[:, j]
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = side * np.nan_to_num(covariance / covariance[j])
        if start is not None:
            psi, inner_root = start
            inner = abs(float(psi[j] - centre))
            slope = np.where(np.arange(len(psi)) == j, side, 0.0)

        def held(distance: float) -> tuple[float, Real]:
            root, at = self.held(centre + side * distance, psi + slope * (distance - inner))
            if np.isfinite(root):
                way.visited.append((at, root))
            return root, at

        def moved(distance: float, root: float, at: Real) -> tuple[Real, float, float, Real]:
            more = distance - inner
            return at, distance, root, (at - psi) / more if more != 0 else slope

        first = inner
        for turn in range(len(FRACTIONS) + FARTHEST):  # outwards, until the rise is reached
            step = FRACTIONS[turn] if turn < len(FRACTIONS) else GROWTH ** (turn + 1 - len(FRACTIONS))
            outer = first + step * self.half
            limited = side * (centre + side * outer - bound) >= 0
            outer = abs(bound - centre) if limited else outer
            outer_root, at = held(outer)
            way.improved |= outer_root < -CLOSE * self.root
            if np.isfinite(outer_root):
                way.points.append(float(at[j]))
                way.rises.append(float(np.sign(outer_root) * outer_root**2))
            if outer_root >= self.root:
                break
            if limited:
                way.end = bound
                return way
            psi, inner, inner_root, slope = moved(outer, outer_root, at)
        else:
            return way
        for _ in range(12):  # at most, between the two
            share = (self.root - inner_root) / (outer_root - inner_root) if np.isfinite(outer_root) else 0.5
            middle = inner + float(np.clip(share, 0.02, 0.98)) * (outer - inner)
            root, at = held(middle)
            way.end = float(centre + side * middle)
            if abs(root - self.root) < CLOSE * self.root:
                break
            if root >= self.root:
                outer, outer_root = middle, root
            else:
                psi, inner, inner_root, slope = moved(middle, root, at)
        return way


# Profile intervals of several unknowns together: what one profile meets on its way counts for all of them.
#
# Where χ² has bent or several valleys, the way out along one profile may stay in a valley that ends early,
# while χ² is as low in another. Every point at which χ² has risen by less than at the ends of an interval
# belongs to that interval, of whichever unknown the profile was: where the interval ends short of it, the
# way is taken up again from there.


Curve = tuple[tuple[float, ...], tuple[float, ...]]

DRAWS = 40  # points from which other valleys are looked for


def joint_profiles(surface: Surface, wanted: Sequence[int], half: Real, root: Real) -> dict[int, Curve]:
    """Curves (`_Ways.curve`) of the unknowns `wanted`, and of all whose normal interval is too short (no batch axes).

    half (M,): half-lengths of the normal intervals about the estimate; root (M,): of the rise of χ² at the ends.
    Nothing where ever lower χ² is met.
    """
    value, base = surface.psi, surface
    for _ in range(3):  # times that a lower χ² is met before nothing is said
        ways = _Ways(base, value, half, root)
        # Minima that draws about the estimate lead to, with the root of their rise
        away = np.random.default_rng(0).standard_normal((DRAWS, len(half)))
        # 1.5: half-lengths of the normal intervals: their standard deviation
        ends = base.minimum(base.psi + 1.5 * half * away)
        own = float(base.root(base.at(value[None]).cost)[0])
        known = [(value, own), *zip(ends.x, base.root(ends.cost).tolist(), strict=True)]
        lower = ways.followed(wanted, known)
        if lower is None:
            return {j: ways.curve(j) for j in sorted(ways.ends)}
        minimum = base.minimum(lower[None])
        base = replace(base, psi=minimum.x[0], cost=float(minimum.cost[0]))
    return {}


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
        self.ends[j], self.points[j] = [self.base.psi[j]] * 2, [(self.base.psi[j], 0.0)]
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
        outwards = 2.0 * side - 1
        way = Walk(self.base, j, float(self.root[j]), float(self.half[j])).end(outwards, start)
        self.count += 1
        self.visited += way.visited
        self.points[j] += zip(way.points, way.rises, strict=True)
        reached = way.end
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

    It is unchanged where that takes long, where intervals count a misfit, and where bounds hold unknowns.  A warning
    names the unknowns to which χ² sets no limit: the best fit may be anywhere along a valley.
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
            surface, bent.tolist(), half, half / np.sqrt(np.diagonal(surface.covariance()))
        )
    except DashpotError:
        return estimate  # nothing is said of the surface of such a rig
    profiles = {estimate.names[j]: curve for j, curve in curves.items()}
    endless = tuple(name for name, (points, _) in profiles.items() if not np.all(np.isfinite(points)))
    text = f"the data set no limit to {joined(endless)} on one side: ± is that of the nearest values only"
    warnings = (*estimate.warnings, *([Notice("open_interval", text, endless)] if endless else []))
    return replace(estimate, profiles=profiles, warnings=warnings)


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
