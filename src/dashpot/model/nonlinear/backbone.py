"""Backbones: free undamped periodic motions of a nonlinear rig, their frequency against their size (THEORY §9).

Dampers and laws that dissipate are left out and inputs stand still.  The motion is even in time, so that only real
parts of harmonics are unknown: of (K − h² ω² M) X_h + Bᵀ p a_h = 0 these and ω, at a given size of one elongation.
Source: Kerschen et al. (2009), Mechanical Systems and Signal Processing 23, 170 (nonlinear normal modes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.errors import UsageError
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate, period_basis
from dashpot.model.nonlinear.force_law import Constant
from dashpot.model.nonlinear.harmonic_balance import (
    Balanced,
    Periodic,
    balance,
    harmonic_unit_forces,
    periodic_at,
    samples_of,
)
from dashpot.model.nonlinear.harmonics import Drive, joined_drives, real_of
from dashpot.model.observation import channel_amplitudes, observation_model
from dashpot.numerics.small_systems import solve_scaled

# What channels show of periodic motions of nonlinear rigs: harmonics, and their largest value over a
# period.


def channel_harmonics(
    model: Model, p: Real, channels: Sequence[Channel], drive: Drive, at: Periodic
) -> Complex:
    """Harmonics of the channels' quantities, (N, H + 1, channels), SI units; p (N, elements) or (elements,).

    Raises DataError where a channel measures what the rig has not.
    """
    N, orders = len(drive.omega), drive.orders
    omega = (drive.omega[:, None] * np.arange(orders + 1)).ravel()
    view = observation_model(model, channels, omega)
    inputs = np.concatenate([drive.U, drive.f], axis=-1).reshape(len(omega), -1)
    strength = np.broadcast_to(p, (N, len(model.elements)))[:, None]
    forces = (strength * harmonic_unit_forces(model, drive, at)).reshape(len(omega), -1)
    X = at.X.reshape(len(omega), model.n)
    return channel_amplitudes(view, X, inputs, forces).reshape(N, orders + 1, len(channels))


def swing(harmonics: Complex) -> Real:
    """Half of what each channel moves from its lowest to its highest value, (N, channels), of (N, H + 1, channels)."""
    orders = harmonics.shape[1] - 1
    there, _, _ = period_basis(orders, 16 * (orders + 1))  # instants of a period
    period = np.einsum("tw,ncw->ntc", there, real_of(np.moveaxis(harmonics, 1, -1)))
    return (np.max(period, axis=1) - np.min(period, axis=1)) / 2


SMALLEST = 1e-3  # of the largest size: where the curve begins


@dataclass(frozen=True)
class Backbone:
    """Free motions, small to large, of the `rig` without what dissipates: drive (no input, ω of each) and motion of P
    points."""

    rig: Model
    drive: Drive
    motion: Periodic


def backbone(model: Model, theta: Real, mode: int, largest: float, *, orders: int = 7) -> Backbone:
    """The motions that start from a `mode` (0 is the lowest) until an elongation has the fundamental `largest`, m.

    The elongation is that of the nonlinear spring that moves most in the mode.  Ends earlier where the curve cannot be
    followed.  Raises UsageError where the rig has no nonlinear spring that keeps energy, or no such mode.
    """
    free = _undamped(model, theta)
    p, constants = free.p0[None], free.constants_map[1][None]
    omega, shape = _mode(free, p[0], constants[0], mode)
    delta = free.B[free.nonlinear] @ shape
    row = int(np.argmax(np.abs(delta)))
    solver = _FreeMotion(free, p, constants, orders, row)
    X = np.zeros((model.n, orders + 1))
    X[:, 1] = SMALLEST * largest * shape / delta[row]
    points: list[tuple[Real, float]] = []
    sizes = np.geomspace(SMALLEST * largest, largest, 60)
    for size, ratio in zip(sizes, np.append(1.0, sizes[1:] / sizes[:-1]), strict=True):
        ended = solver.solved(ratio * X, omega, float(size))
        if ended is None:
            break
        X, omega = ended
        points.append((X, omega))
    if not points:
        raise UsageError("the backbone of this mode cannot be followed", cure="give a smaller amplitude")
    drive = joined_drives([solver.still(omega) for _, omega in points])
    return Backbone(free, drive, solver.motion(drive, np.array([X for X, _ in points])))


def _undamped(model: Model, theta: Real) -> Model:
    """The rig at θ, all values known, without what dissipates.  Raises UsageError where no nonlinear spring is left."""
    values, constants = model.parameters(theta).tolist(), model.inner_constants(theta).tolist()
    slices = iter(model.constant_slices)
    elements = []
    for element, value in zip(model.elements, values, strict=True):
        law = element.force_law
        if law is not None:
            inner = constants[next(slices)]
            named = [Constant(name, number) for name, number in zip(law.constant_names, inner, strict=True)]
            kept = not law.has_state and "v" not in law.expression.names
            law = law.with_constants(named) if kept else None
        else:
            kept = element.kind not in (Kind.DAMPER, Kind.HYSTERETIC)
        elements.append(
            Element(element.name, element.kind, element.along, value=value if kept else 0.0, force_law=law)
        )
    if not any(element.force_law is not None for element in elements):
        raise UsageError(
            "the rig has no nonlinear spring, so its backbones are straight", cure="leave the backbone out"
        )
    return replace(model, elements=tuple(elements))


def _mode(model: Model, p: Real, constants: Real, mode: int) -> tuple[float, Real]:
    """(ω, shape (n,)) of a mode of small motions."""
    from scipy.linalg import eigh

    parts = matrices(model, p)
    zero = np.zeros((1, len(model.nonlinear), 3))
    tangent = alternate(model, constants[None], np.ones(1), zero, 32).slope[0, :, 1, 1]
    Bn = model.B[model.nonlinear]
    K = parts.K + Bn.T @ ((p[model.nonlinear] * tangent)[:, None] * Bn)
    if np.linalg.matrix_rank(parts.M) < model.n or not 0 <= mode < model.n:
        raise UsageError(
            f"there is no mode {mode + 1}", cure=f"it has {model.n}; every coordinate needs a mass"
        )
    squares, shapes = eigh(K, parts.M)
    shape: Real = shapes[:, mode]
    if squares[mode] <= 0 or not np.any(np.abs(Bn @ shape) > 1e-9 * np.max(np.abs(shape))):
        raise UsageError(
            f"mode {mode + 1} does not oscillate, or stretches no nonlinear spring",
            cure="choose another mode",
        )
    return float(np.sqrt(squares[mode])), shape


class _FreeMotion:
    """Newton's method for one point of a backbone; unknown are ω and the real parts of the coordinates' harmonics."""

    def __init__(self, model: Model, p: Real, constants: Real, orders: int, row: int) -> None:
        self.model, self.p, self.constants, self.orders, self.row = model, p, constants, orders, row
        self.times = samples_of(model, orders)
        parts = matrices(model, p[0])
        self.M, self.K = parts.M, parts.K
        self.Bn = model.B[model.nonlinear]
        self.even = np.array([0, *range(1, 2 * orders + 1, 2)])  # places of the real parts

    def still(self, omega: float) -> Drive:
        """No input at all, at ω."""
        r, s = len(self.model.displacement_inputs), len(self.model.force_inputs)
        shape = (1, self.orders + 1)
        return Drive(
            np.array([omega]),
            np.zeros((*shape, r), dtype=np.complex128),
            np.zeros((*shape, s), dtype=np.complex128),
        )

    def elongations(self, X: Real) -> Real:
        """Of the nonlinear elements, (1, e, W), for real harmonics X (n, H + 1)."""
        q = np.zeros((1, len(self.Bn), 2 * self.orders + 1))
        q[0][:, self.even] = self.Bn @ X
        return q

    def solved(self, X: Real, omega: float, size: float) -> tuple[Real, float] | None:
        """(X, ω) whose elongation `row` has the fundamental `size`, None where Newton's method does not settle."""
        n, count = len(X), X.size
        condition = np.zeros((n, self.orders + 1))
        condition[:, 1] = self.Bn[self.row]
        for _ in range(20):  # Newton's method, at most
            r, by_X, by_log = self._slopes(X, omega)
            square = np.zeros((count + 1, count + 1))
            square[:count, :count], square[:count, count] = by_X, by_log / size
            square[count, :count] = condition.ravel()
            missing = np.append(-r, size - float(np.sum(condition * X)))
            step = solve_scaled(square, missing) if np.all(np.isfinite(square)) else missing * np.nan
            if not np.all(np.isfinite(step)):
                return None
            step = step * min(1.0, 0.2 * size / max(abs(float(step[-1])), 1e-300))
            X = X + step[:-1].reshape(X.shape)
            omega *= 1 + float(step[-1]) / size
            if np.max(np.abs(step)) <= 1e-10 * size:
                return X, omega
        return None

    def _slopes(self, X: Real, omega: float) -> tuple[Real, Real, Real]:
        """(K − h² ω² M) X_h + Bᵀ p a_h, (n (H + 1),), with slopes along X and ln ω."""
        n, columns = X.shape
        squares = (np.arange(columns) * omega) ** 2
        forces = alternate(self.model, self.constants, np.array([omega]), self.elongations(X), self.times)
        strength = self.p[0, self.model.nonlinear]
        pull = self.Bn.T @ (strength[:, None] * forces.a[0][:, self.even])
        r = self.K @ X - (self.M @ X) * squares + pull
        slope = strength[:, None, None] * forces.slope[0][:, self.even][:, :, self.even]
        by_X = np.einsum("ei,ehk,ej->ihjk", self.Bn, slope, self.Bn)
        h = np.arange(columns)
        linear = self.K[:, :, None] - self.M[:, :, None] * squares
        by_X[:, h, :, h] += np.moveaxis(linear, -1, 0)
        by_log = (-2 * (self.M @ X) * squares).ravel()
        return r.ravel(), by_X.reshape(n * columns, n * columns), by_log

    def motion(self, drive: Drive, X: Real) -> Periodic:
        """The whole motions at points X (P, n, H + 1) of the curve."""
        count = len(X)
        delta = np.concatenate([self.elongations(point) for point in X])
        p, constants = np.repeat(self.p, count, axis=0), np.repeat(self.constants, count, axis=0)
        forces = alternate(self.model, constants, drive.omega, delta, self.times)
        # A damper's share in the linear part keeps it regular at its own resonance; the motion does not depend on it.
        damper = 1j * drive.omega[:, None] ** 2 * float(np.max(np.abs(self.M)))
        equations = balance(self.model, p, drive, np.repeat(damper, len(self.Bn), axis=1))
        return periodic_at(self.model, Balanced(equations, delta, forces, np.zeros(count)))
