"""Profile intervals of several unknowns together: what one profile meets on its way counts for all of them.

Where χ² has bent or several valleys, the way out along one profile may stay in a valley that ends early, while χ² is as
low in another.  Every point at which χ² has risen by less than at the ends of an interval belongs to that interval, of
whichever unknown the profile was: where the interval ends short of it, the way is taken up again from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.check.chi2_surface import Surface
from dashpot.check.profile import CLOSE, Walk, signed_root
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise

Curve = tuple[tuple[float, ...], tuple[float, ...]]

ROUNDS = 6  # in which ways are taken up again
MOST_WAYS = 120  # outwards, in all
SHORT = 0.02  # of the half-length of a normal interval: what an interval ends short of
LOWERED = 3  # times that a lower χ² is met before nothing is said
DRAWS = 40  # points from which other valleys are looked for
SPREAD = 1.5  # half-lengths of the normal intervals: their standard deviation


def joint_profiles(
    surface: Surface, wanted: Sequence[int], half: Real, root: Real, seed: int = 0
) -> dict[int, Curve]:
    """Curves (`Profile.curve`) of the unknowns `wanted`, and of all whose normal interval is too short (no batch axes).

    half (M,): half-lengths of the normal intervals about the estimate; root (M,): of the rise of χ² at the ends.
    Nothing where ever lower χ² is met.
    """
    value, base = surface.psi[0], surface
    for _ in range(LOWERED):
        ways = _Ways(base, value, half, root)
        own = base.at(value[None], np.array([0])).cost - base.cost
        known = [(value, float(signed_root(own)[0])), *_valleys(base, half, seed)]
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


def _valleys(base: Surface, half: Real, seed: int) -> list[tuple[Real, float]]:
    """Minima that draws about the estimate lead to, with the root of their rise."""
    away = np.random.default_rng(seed).standard_normal((DRAWS, len(half)))
    ends = _minimum(base, base.psi[0] + SPREAD * half * away)
    return list(zip(ends.x, signed_root(ends.cost - base.cost[0]).tolist(), strict=True))


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
        for _ in range(ROUNDS):
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
        if not inside or self.count >= MOST_WAYS:
            return False
        start = max(inside, key=lambda point: outwards * point[0][j])
        end = self.ends[j][side] if j in self.ends else self.value[j] + outwards * self.half[j]
        if outwards * (start[0][j] - end) <= SHORT * self.half[j]:
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
