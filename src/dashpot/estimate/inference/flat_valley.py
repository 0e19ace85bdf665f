"""How far χ² stays low along a direction in which the information is singular, as where two solutions merge.

Gauss and Newton's parabola has no curvature there, and yet χ² may rise: by the fourth power, beyond a fold of the
response.  The valley is followed both ways, step by step along the weakest direction of where it has led (Allgower and
Georg, Numerical Continuation Methods, 1990), until χ² has risen as at two standard deviations.  Where it does on both
sides the curvature that a parabola with that rise has stands in for the missing one; where it does not, the data do
not tell the unknowns apart that change along the valley.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import local
from dashpot.io.words import joined, with_values
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise

# Eigenvalue of an information matrix with ones on its diagonal, below which a direction is followed
WEAK = 1e-5
RISE = 4.0  # of χ², at two standard deviations

Evaluate = Callable[[Real, Ints], QuadraticModel]


@dataclass(frozen=True)
class Valley:
    """A valley of χ² through ψ (M,), followed both ways.

    low, high   (M,) the least and the greatest values met while χ² had not risen by RISE
    bounded     whether it has risen so far at both ends
    lowest      (M,) the lowest point met, `fall` below the start
    curvature   (M, M) what the information lacks to rise as χ² does; 0 where the valley is not bounded
    """

    low: Real
    high: Real
    bounded: bool
    lowest: Real
    fall: float
    curvature: Real


def flat_valley(
    view: ObservationModel, data: Measured, psi: Real, sign: Real, scale: float = 1.0
) -> Valley | None:
    """The valley through the minimum ψ (1, M) of one repeat with signs (1, channels); None where information holds all.

    scale: χ² is counted in it, where the size of the noise is not known.  None is followed of several repeats, of
    large or nonlinear rigs, and where unknowns have bounds.
    """
    model = view.model
    if len(psi) != 1 or not small(model) or len(model.nonlinear) or np.any(np.isfinite(model.bounds)):
        return None

    def evaluate(at: Real, _: Ints) -> QuadraticModel:
        return local(view, data, at, np.repeat(sign, len(at), axis=0))

    lacking = np.zeros((psi.shape[1],) * 2)
    walks: list[_Walk] = []
    while len(walks) < 8 and all(
        walk.risen for walk in walks
    ):  # two for each direction that information lacks
        begin = _Point.at(evaluate(psi, np.zeros(1, dtype=np.int64)), psi[0], lacking)
        if begin is None or not begin.weak(scale):
            break
        both = [_Walk.followed(evaluate, begin, side, RISE * scale) for side in (-1.0, 1.0)]
        walks += both
        if all(walk.risen for walk in both):
            # The curvature that makes a parabola as wide as χ² there. The valley may have turned aside: how wide it
            # is straight on is another walk.
            both += [
                _Walk.followed(evaluate, begin, side, RISE * scale, turning=False) for side in (-1.0, 1.0)
            ]
            along = begin.weakest / begin.size
            reach = max(np.max(np.abs((walk.met - begin.psi) @ along)) for walk in both)
            lacking = lacking + RISE * scale / reach**2 * np.outer(along, along)
    if not walks:
        return None
    bounded = all(walk.risen for walk in walks)
    lowest = min((walk.lowest for walk in walks), key=lambda point: point.cost)
    fall = walks[0].begin.cost - lowest.cost
    met = np.concatenate([walk.met for walk in walks])
    fall = fall if fall > 1e-3 * scale else 0.0  # what is lower by less is the same minimum
    lacking = lacking if bounded else np.zeros_like(lacking)
    return Valley(met.min(axis=0), met.max(axis=0), bounded, lowest.psi, fall, lacking)


def require_end(valley: Valley, names: Sequence[str], units: Sequence[str], psi: Real) -> None:
    """Raises IdentifiabilityError that names the unknowns which change along a valley without end at ψ (M,)."""
    change = (valley.high - valley.low) / np.maximum(np.abs(psi), 1e-300)
    moving = [j for j in np.argsort(-change) if change[j] > 0.1]
    if valley.bounded or not moving:
        return
    low = np.where(np.abs(valley.low) < 1e-3 * valley.high, 0.0, valley.low)
    ranges = ", ".join(f"{names[j]} from {low[j]:.3g} to {valley.high[j]:.3g} {units[j]}" for j in moving[:3])
    together = [name for j, name in enumerate(names) if j in moving]
    raise IdentifiabilityError(
        f"{joined(together)} cannot be determined: the fit is equally good for {ranges}",
        cure=f"{with_values(together)}, or add a sensor at another point",
    )


def may_lack_direction(information: Real) -> bool:
    """Whether information (M, M) is weak enough in some direction for a valley to be looked for."""
    sound = np.all(np.isfinite(information)) and np.all(information.diagonal() > 0)
    return bool(sound) and _least_eigenvalue(information) < WEAK


def _least_eigenvalue(information: Real) -> float:
    """The least eigenvalue of information (M, M) scaled to ones on its diagonal."""
    root = np.sqrt(information.diagonal())
    return float(np.linalg.eigvalsh(information / np.outer(root, root))[0])


@dataclass(frozen=True)
class _Point:
    """A point of the valley: ψ (M,), χ², the unknowns' sizes (M,), and the weakest direction in them, of length 1."""

    psi: Real
    cost: float
    size: Real
    weakest: Real
    eigenvalue: float
    information: Real

    @staticmethod
    def at(around: QuadraticModel, psi: Real, lacking: Real | float = 0.0) -> _Point | None:
        """From χ² around ψ and what its information lacks; None where it is not finite there."""
        A = around.symmetric[0] + lacking
        diagonal = A.diagonal()
        if not (np.all(np.isfinite(A)) and np.isfinite(around.cost[0]) and np.all(diagonal > 0)):
            return None
        size = np.maximum(np.abs(psi), 1 / np.sqrt(diagonal))
        _, vectors = np.linalg.eigh(A * np.outer(size, size))
        return _Point(psi, float(around.cost[0]), size, vectors[:, 0], _least_eigenvalue(A), A)

    def weak(self, scale: float) -> bool:
        """Whether the parabola leaves some unknown open along one direction: by five times its value."""
        if self.eigenvalue >= WEAK:
            return False
        curvature = self.weakest @ (self.information * np.outer(self.size, self.size)) @ self.weakest
        return bool(curvature * 5.0**2 < scale * np.max(np.abs(self.weakest)) ** 2)


class _Walk:
    """One way along the valley from `begin`, to where χ² lies `rise` above it; straight on unless `turning`.

    Steps and how far is looked, ten of them, are in sizes of the unknowns.
    """

    def __init__(self, evaluate: Evaluate, begin: _Point, side: float, rise: float, turning: bool) -> None:
        self.evaluate, self.begin, self.rise, self.turning = evaluate, begin, rise, turning
        self.point = self.lowest = begin
        self.direction = side * begin.weakest
        self.step = 1e-3
        self.met = begin.psi[None]

    @staticmethod
    def followed(
        evaluate: Evaluate, begin: _Point, side: float, rise: float, *, turning: bool = True
    ) -> _Walk:
        """The walk gone until χ² has risen, or as far as is looked."""
        walk = _Walk(evaluate, begin, side, rise, turning)
        for _ in range(80):  # at most
            far = np.any(np.abs(walk.point.psi - begin.psi) > 10.0 * begin.size)
            if walk.risen or far or not walk.stepped():
                break
        return walk

    @property
    def risen(self) -> bool:
        """Whether χ² has risen so far."""
        return self.point.cost - self.begin.cost >= self.rise

    @property
    def size(self) -> Real:
        """The sizes of the unknowns in which steps count, (M,)."""
        return self.point.size if self.turning else self.begin.size

    def stepped(self) -> bool:
        """One step on along the chord of the last, short enough for χ² to rise gently; False where none is."""
        before = self.point
        while self.step > 1e-7:
            there = self._across(before.psi + self.step * self.size * self.direction)
            if there is not None and there.cost - before.cost <= self.rise / 4:
                if self.turning:
                    chord = (there.psi - before.psi) / there.size
                    self.direction = chord / np.linalg.norm(chord)
                self.point = there
                self.met = np.concatenate([self.met, there.psi[None]])
                self.lowest = min(self.lowest, there, key=lambda point: point.cost)
                self.step = min(2 * self.step, 0.25)
                return True
            self.step /= 4
        return False

    def _across(self, start: Real) -> _Point | None:
        """The bottom of the valley across the direction at `start` (M,); None where there is none."""
        size = self.size
        # An orthonormal basis of what is across: all right singular vectors but the first.
        across = np.linalg.svd(self.direction[None])[2][1:].T * size[:, None]

        def evaluate(x: Real, rows: Ints) -> QuadraticModel:
            at = self.evaluate(start + x @ across.T, rows)
            matrix = across.T @ at.symmetric @ across
            return QuadraticModel(at.cost, at.gradient @ across, matrix, matrix)

        bottom = minimise(evaluate, np.zeros((1, across.shape[1])), limit=20, tolerance=1e-3, patience=20)
        psi = start + across @ bottom.x[0]
        return _Point.at(self.evaluate(psi[None], np.zeros(1, dtype=np.int64)), psi)
