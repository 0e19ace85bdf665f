"""The equations of harmonic balance in the elongations of the nonlinear elements, and Newton's method on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import Alternated, alternate
from dashpot.model.nonlinear.compiled import compiled_balance, compiled_rig
from dashpot.model.nonlinear.harmonics import Drive, complex_of, complex_rows, real_of, rows_of
from dashpot.model.nonlinear.linear_part import LinearPart, linear_part

TOLERANCE = 1e-10  # of the elongation, before the last step, which squares it
SETTLED = 1e-8  # of the elongation: a response of which this is left counts as found
ITERATIONS = 25
HALVINGS = 5
PATIENCE = 8  # iterations in which the residual must fall to half


@dataclass(frozen=True)
class Balance:
    """The equations of N dwells in the elongations of the nonlinear elements, δ − free + Z (p a − s δ) = 0.

    free (N, e, W) as real numbers; strength (N, e, 1): p; Z and s: receptance and share of the linear part.
    """

    linear: LinearPart
    free: Real
    strength: Real

    @property
    def scale(self) -> Real:
        """Largest elongation without nonlinear forces, (N,)."""
        size: Real = np.max(np.abs(self.free), axis=(1, 2))
        return size

    def rows(self, keep: Bools | Ints) -> Balance:
        """Those of some of the dwells."""
        return Balance(self.linear.rows(keep), self.free[keep], self.strength[keep])

    def rest(self, q: Real, unit: Real) -> Complex:
        """p a − s δ, (N, H + 1, e)."""
        rest = complex_of(self.strength * unit)
        return rest.swapaxes(1, 2) - self.linear.share * complex_of(q).swapaxes(1, 2)

    def residual(self, q: Real, unit: Real) -> Real:
        """What is left over at elongations q with the harmonics `unit` of the unit forces, (N, e, W)."""
        pulled = (self.linear.receptance @ self.rest(q, unit)[..., None])[..., 0]
        r: Real = q - self.free + real_of(pulled.swapaxes(1, 2))
        return r

    def matrix(self, slope: Real) -> Real:
        """∂residual/∂q, (N, e W, e W), for slopes ∂a/∂q (N, e, W, W)."""
        N, e, W = slope.shape[:3]
        unit = complex_of(np.eye(W)).T[None, :, None]  # (1, H + 1, 1, W): δ along its own real numbers
        inner = complex_rows(self.strength[..., None] * slope) - self.linear.share[..., None] * unit
        both = self.linear.receptance[..., None] * inner[:, :, None]  # (N, H + 1, e, e, W)
        matrix: Real = rows_of(both.reshape(*both.shape[:3], e * W)).reshape(N, e * W, e * W) + np.eye(e * W)
        return matrix

    @property
    def feeds_back(self) -> bool:
        """Whether any nonlinear element has a strength: without one, the motion is that of the linear part."""
        return bool(np.any(self.strength))

    def solved(self, slope: Real, right: Real) -> Real:
        """matrix⁻¹ right (N, e W, Q), NaN where a matrix is singular."""
        return solved(self.matrix(slope), right) if self.feeds_back else right


def balance(model: Model, p: Real, drive: Drive, secant: Complex) -> Balance:
    """The equations with `secant` (N, e) as the share of the nonlinear elements that the linear part keeps."""
    linear = linear_part(model, p, drive, secant)
    return Balance(linear, real_of(np.moveaxis(linear.free, 1, -1)), p[:, model.nonlinear, None])


def secant_of(p: Real, a: Real, q: Real) -> Complex:
    """Describing function p a₁/δ₁ of each nonlinear element, (N, e), its parts at least 0."""
    d1, a1 = complex_of(q)[..., 1], complex_of(a)[..., 1]
    size = np.abs(d1)
    with np.errstate(all="ignore"):  # of the smallest numbers, whose square is 0
        ratio = p * a1 * np.conj(d1) / np.where(size > 0, size, 1.0) ** 2
    ratio = np.where((size > 0) & np.isfinite(ratio), ratio, 0.0)
    positive: Complex = np.maximum(ratio.real, 0.0) + 1j * np.maximum(ratio.imag, 0.0)
    return positive


@dataclass(frozen=True)
class Balanced:
    """Elongations q (N, e, W), the unit forces there, and the last Newton step over the elongation, error (N,)."""

    equations: Balance
    q: Real
    forces: Alternated
    error: Real

    @property
    def converged(self) -> Bools:
        """Whether the equations hold, (N,)."""
        held: Bools = self.error <= SETTLED
        return held


def balanced(
    model: Model,
    p: Real,
    constants: Real,
    drive: Drive,
    q: Real,
    times: int,
    *,
    hopeless: Bools | None = None,
) -> Balanced:
    """The equations solved from q (N, e, W) by Newton's method with halved steps; rows `hopeless` stay where they are.

    A dwell leaves when it has settled, or when its residual no longer falls.
    """
    rig = compiled_rig(model, times)
    if rig is not None:
        return _compiled(model, p, compiled_balance(rig, model, p, constants, drive, q, times, hopeless))
    forces = alternate(model, constants, drive.omega, q, times)
    equations = balance(model, p, drive, secant_of(p[:, model.nonlinear], forces.a, q))
    if not equations.feeds_back:
        forces = alternate(model, constants, drive.omega, equations.free, times)
        return Balanced(equations, equations.free, forces, np.zeros(len(q)))
    search = _Newton(
        model, constants, drive.omega, times, Balanced(equations, q.copy(), forces, np.full(len(q), np.inf))
    )
    if hopeless is not None:
        search.leave(hopeless)
    for _ in range(ITERATIONS):
        if not len(search.rows):
            break
        search.step()
    search.leave(np.ones(len(search.rows), dtype=bool))
    return search.ends


def _compiled(model: Model, p: Real, ends: tuple[Any, ...]) -> Balanced:
    """What the kernel's arrays are."""
    *linear, free, q, a, slope, by_constant, error = ends
    equations = Balance(LinearPart(*linear), free, p[:, model.nonlinear, None])
    parts = tuple(by_constant[..., inner] for inner in model.constant_slices)
    stateless = tuple(np.zeros((len(q), 0)) for _ in parts)
    return Balanced(equations, q, Alternated(a, slope, parts, stateless), error)


class _Newton:
    """The dwells that still move: their `rows` of `ends`, and q, forces and residual r of these rows."""

    def __init__(self, model: Model, constants: Real, omega: Real, times: int, ends: Balanced) -> None:
        self.model, self.times, self.ends = model, times, ends
        self.constants, self.omega, self.equations = constants, omega, ends.equations
        self.rows: Ints = np.arange(len(ends.q))
        self.q, self.forces, self.error = ends.q, ends.forces, ends.error.copy()
        self.r = self.equations.residual(self.q, self.forces.a)
        self.idle = np.zeros(len(self.rows), dtype=np.int64)
        self.mark = _norm(self.r)

    def leave(self, leaving: Bools) -> None:
        """Write down where some dwells are, and go on without them."""
        rows, ends = self.rows[leaving], self.ends
        ends.q[rows], ends.error[rows] = self.q[leaving], self.error[leaving]
        ends.forces.put(rows, self.forces.rows(leaving))
        stay = ~leaving
        self.rows, self.q, self.error, self.r = self.rows[stay], self.q[stay], self.error[stay], self.r[stay]
        self.forces, self.equations = self.forces.rows(stay), self.equations.rows(stay)
        self.constants, self.omega = self.constants[stay], self.omega[stay]
        self.idle, self.mark = self.idle[stay], self.mark[stay]

    def step(self) -> None:
        """One step of every running dwell; those leave that have settled or lead nowhere."""
        matrix = self.equations.matrix(self.forces.slope)
        step = solved(matrix, self.r.reshape(len(self.q), -1, 1)).reshape(self.q.shape)
        size = np.maximum(np.max(np.abs(self.q), axis=(1, 2)), self.equations.scale)
        size = np.where(size > 0, size, 1.0)
        with np.errstate(all="ignore"):
            self.error = np.max(np.abs(step), axis=(1, 2)) / size
        settled = self.error <= TOLERANCE
        self.q[settled] -= step[settled]
        self.forces.a[settled] -= (self.forces.slope[settled] @ step[settled][..., None])[..., 0]
        norm = _norm(self.r)
        fallen = ~(norm > 0.5 * self.mark)
        self.mark = np.where(fallen, norm, self.mark)
        self.idle = np.where(fallen, 0, self.idle + 1)
        leaving = settled | ~np.isfinite(self.error) | (self.idle > PATIENCE)
        if np.any(leaving):
            self.leave(leaving)
            step, size, norm = step[~leaving], size[~leaving], norm[~leaving]
        if len(self.rows):
            self._move(step, size, norm)

    def _move(self, step: Real, size: Real, norm: Real) -> None:
        """Take the steps, halved where the residual grows; of at most half the elongation."""
        factor = np.where(self.error > 0.5, 0.5 / np.maximum(self.error, 0.5), 1.0)
        q, forces = self.q, self.forces
        self.q = q - factor[:, None, None] * step
        self.forces = alternate(self.model, self.constants, self.omega, self.q, self.times, start=forces)
        self.r = self.equations.residual(self.q, self.forces.a)
        for _ in range(HALVINGS):
            worse = ~(_norm(self.r) <= norm * (1 + 1e-9) + 1e-14 * size) & (self.error > 1e-9)
            if not np.any(worse):
                break
            factor[worse] /= 2
            nearer = q[worse] - factor[worse][:, None, None] * step[worse]
            there = alternate(
                self.model,
                self.constants[worse],
                self.omega[worse],
                nearer,
                self.times,
                start=forces.rows(worse),
            )
            self.q[worse], self.r[worse] = nearer, self.equations.rows(worse).residual(nearer, there.a)
            self.forces.put(np.flatnonzero(worse), there)


def _norm(r: Real) -> Real:
    size: Real = np.linalg.norm(r, axis=(1, 2))
    return size


def solved(matrix: Real, right: Real) -> Real:
    """matrix⁻¹ right, (N, n, n) and (N, n, k); NaN where a matrix is singular."""
    try:
        with np.errstate(all="ignore"):
            return np.linalg.solve(matrix, right).astype(np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)
