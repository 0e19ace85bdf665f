"""Motion of rigs with nonlinear elements under any input, step by step, with slopes (THEORY §9).

The linear part is exact: matrix exponentials, the input a cubic spline between samples.  The nonlinear forces are
polynomials through four Lobatto points of each step, found by Newton's method (exponential collocation, order 6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.elements import MATRICES, Element, Kind
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.alternating import compiled_laws
from dashpot.model.nonlinear.force_law import ForceLaw

# One step of the linear part of a rig in time, exactly, and the inputs between samples (THEORY §9).
#
# Forces are polynomials through the four Lobatto points of a step (exponential collocation: Hochbruck and
# Ostermann 2010, Acta Numerica 19, 209).


NODES = np.array([0.0, (1 - 1 / np.sqrt(5)) / 2, (1 + 1 / np.sqrt(5)) / 2, 1.0])  # Lobatto
LAGRANGE = np.linalg.inv(np.vander(NODES, increasing=True))  # (power, node): ℓ_k(c) = Σ_m LAGRANGE[m, k] c^m
WITHIN = np.array([[NODES[j] ** (m + 1) / (m + 1) for m in range(4)] for j in range(4)]) @ LAGRANGE


@dataclass(frozen=True)
class Forcing:
    """Inputs of one record as cubics between samples: (samples − 1, 4, r + s), powers of the share of the interval.

    rated (r + s,): whether a force is the rate of its cubics, of none where it is empty.
    """

    step_s: float
    coefficients: Real
    rated: tuple[bool, ...] = ()

    @property
    def intervals(self) -> int:
        """Number of intervals between samples."""
        return len(self.coefficients)


def forcing(step_s: float, inputs: Real, rated: tuple[bool, ...] = ()) -> Forcing:
    """Cubic splines through the samples (samples, r + s) of the inputs, `step_s` apart; `rated` as of Forcing."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    time = np.arange(len(inputs), dtype=float)
    spline = CubicSpline(time, inputs, axis=0)
    return Forcing(step_s, np.moveaxis(np.asarray(spline.c)[::-1], 0, 1), rated)


@dataclass(frozen=True)
class Propagator:
    """One step of the linear part, in steps of h: states after the share c_j of it.

    E (4, 2 n, 2 n) of the state, I (4, 2 n, 4, n) of forces growing as the power m of the share.  Wf (4, 4, 2 n, n) of
    forces given at the nodes; Wn (4, 4, 2 n, e) the same of unit forces of the nonlinear elements.
    """

    h: float
    E: Real
    Wf: Real
    Wn: Real
    inertia: Real
    both: tuple[Real, Real, Real]


def propagator(model: Model, p: Real, h: float) -> Propagator:
    """Raises ModelError if a coordinate has no mass or an element is hysteretic.  p (elements,), h in s."""
    from scipy.linalg import expm

    parts = matrices(model, p)
    n, chosen = model.n, model.nonlinear
    if np.any(parts.H):
        raise ModelError(
            "a hysteretic damper cannot be simulated in time",
            cure="use a viscous damper, or settled dwells of a linear rig",
        )
    size = np.sqrt(np.abs(np.diagonal(parts.M)))  # masses of one rig may differ by many orders
    if not np.all(size) or (n and np.linalg.matrix_rank(parts.M / np.outer(size, size)) < n):
        raise ModelError(
            "a coordinate has no mass, so its motion cannot be integrated",
            cure="give every coordinate a mass",
        )
    inverse: Real = np.linalg.inv(parts.M).astype(np.float64)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ parts.K, -inverse @ parts.C]])
    chain = np.zeros((6 * n, 6 * n))
    chain[: 2 * n, : 2 * n] = A * h
    chain[n : 2 * n, 2 * n : 3 * n] = inverse * h
    for m in range(3):  # d/dc of c^m/m! is the one before it
        chain[2 * n + m * n : 3 * n + m * n, 3 * n + m * n : 4 * n + m * n] = np.eye(n)
    E, moments = np.zeros((4, 2 * n, 2 * n)), np.zeros((4, 2 * n, 4, n))
    for j, share in enumerate(NODES):
        grown = expm(chain * share)
        E[j] = grown[: 2 * n, : 2 * n]
        for m, factorial in enumerate((1, 1, 2, 6)):
            block = grown[: 2 * n, 2 * n + m * n : 3 * n + m * n]
            moments[j, :, m] = block * factorial
    Wf = np.einsum("jxmn,mk->jkxn", moments, LAGRANGE)
    Wn = -np.einsum("jkxn,en,e->jkxe", Wf, model.B[chosen], p[chosen])
    return Propagator(h, E, Wf, Wn, inverse, (parts.K, parts.C, parts.M))


def loads(model: Model, p: Real, drive: Forcing, substeps: int) -> tuple[Real, Real]:
    """(force of the inputs on the coordinates at the nodes of each step (steps, 4, n), inputs (steps, 4, 2, r)).

    The inputs come with their rates; forces of masses between base and rig count the acceleration of the spline.
    """
    parts = matrices(model, p)
    r = model.D.shape[1]
    share = (NODES[None, :] + np.arange(substeps)[:, None]) / substeps  # (substeps, 4)
    powers = share[..., None] ** np.arange(4)
    rates = np.where(
        np.arange(4) > 0, np.arange(4) * share[..., None] ** np.maximum(np.arange(4) - 1, 0), 0.0
    )
    bends = np.where(
        np.arange(4) > 1,
        np.arange(4) * (np.arange(4) - 1) * share[..., None] ** np.maximum(np.arange(4) - 2, 0),
        0.0,
    )

    def at(basis: Real, order: int) -> Real:
        values = np.einsum("skm,imq->iskq", basis, drive.coefficients) / drive.step_s**order
        return values.reshape(math.prod(values.shape[:2]), *values.shape[2:])  # there may be no input

    q, dq = at(powers, 0), at(rates, 1)
    applied = np.where(drive.rated[r:], dq[..., r:], q[..., r:]) if any(drive.rated) else q[..., r:]
    force = q[..., :r] @ parts.G.T + dq[..., :r] @ parts.F.T + applied @ model.S.T
    if np.any(parts.J):
        force = force + at(bends, 2)[..., :r] @ parts.J.T
    return force, np.stack([q[..., :r], dq[..., :r]], axis=2)


# Unit forces of nonlinear laws at the Lobatto points of a step, with their slopes and the states that laws
# carry.


@dataclass(frozen=True)
class HeldStates:
    """States of a law at the nodes, (S, 4), and their slopes along d and v at all nodes (S, 4, 4), z0 and constants.

    step: the largest last change of z over its size.
    """

    z: Real
    step: float
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: Real


@dataclass(frozen=True)
class StepForces:
    """Unit forces at the nodes (S, 4, e) and their slopes: along d and v at the same node (S, 4 e), or, `full`, at all
    nodes (S, 4 e, 4 e); along the states z0 at the start (S, 4, states) and the constants; z (S, 4, states of laws).
    """

    a: Real
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: tuple[Real, ...]
    z: Real
    held: tuple[HeldStates, ...]
    full: bool

    def times(self, d: Real, v: Real) -> Real:
        """What changes of d and v at the nodes, (S, 4, e, Q), do to the unit forces."""
        if not self.full:
            shape = (*d.shape[:3], 1)
            return self.by_d.reshape(shape) * d + self.by_v.reshape(shape) * v
        wide = (len(d), -1, d.shape[-1])
        change: Real = self.by_d @ d.reshape(wide) + self.by_v @ v.reshape(wide)
        return change.reshape(d.shape)

    def rows(self, chosen: slice) -> StepForces:
        """Those of some of the segments, without the states of laws."""
        by_g = tuple(by[chosen] for by in self.by_g)
        a, by_d, by_v, by_z0 = (part[chosen] for part in (self.a, self.by_d, self.by_v, self.by_z0))
        return StepForces(a, by_d, by_v, by_z0, by_g, self.z[chosen], (), self.full)


def held_states(
    law: ForceLaw, d: Real, v: Real, z: Real, z0: Real, g: Real, h: float, width: Real | None = None
) -> HeldStates:
    """The state of a law over one step, from z0: collocation of its rate, or the operator from node to node.

    One step of Newton's method from z (S, nodes) on the collocation, with the slopes there: the caller's steps for the
    forces bring both to their end.  d, v (S, nodes), z0 (S,) at the start, g the constants of the law, h in s; width
    (S,) of an operator, along which the slope by_g (S, nodes, 1) is then.
    """
    if width is not None:
        # Stop and play from node to node; a z0 that they cannot have at the first elongation is moved to where
        # they can.  Tangents are along d at the nodes, z0 and the width.
        S, K = d.shape
        tangent, nothing = np.zeros((S, K + 2)), np.zeros((S, K + 2))
        tangent[:, K] = 1.0
        z, states, tangents = z0, [], []
        for k in range(K):
            change = nothing.copy()
            change[:, k] = 1.0
            if law.operator == "play":
                z, tangent = clipped(z, tangent, d[:, k], change, width, K + 1)
            else:
                if k:
                    change[:, k - 1] = -1.0
                    z, tangent = z + d[:, k] - d[:, k - 1], tangent + change
                z, tangent = clipped(z, tangent, np.zeros(S), nothing, width, K + 1)
            states.append(z)
            tangents.append(tangent)
        total, none = np.stack(tangents, axis=1), np.zeros((S, K, K))
        return HeldStates(
            np.stack(states, axis=1), 0.0, total[..., :K], none, total[..., K], total[..., K + 1 :]
        )
    assert law.rate is not None
    S, K = d.shape
    Q = h * WITHIN
    at = law.rate(law.values(d, v, z, g))
    nothing = np.zeros((S, K))
    along = {name: np.broadcast_to(slope, (S, K)) for name, slope in at.slopes.items()}
    inverse: Real = np.linalg.inv(np.eye(K) - Q * along.get("z", nothing)[:, None, :]).astype(np.float64)
    missing = z - z0[:, None] - np.broadcast_to(at.value, (S, K)) @ Q.T
    change = (inverse @ missing[..., None])[..., 0]
    z = z - change
    by_d, by_v = (inverse @ (Q * along.get(name, nothing)[:, None, :]) for name in ("d", "v"))
    columns = [along.get(name, nothing) @ Q.T for name in law.constant_names]
    by_g = inverse @ np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0))
    step = float(np.max(np.abs(change)) / (np.max(np.abs(z)) + 1e-300))
    return HeldStates(z, step, by_d, by_v, inverse.sum(axis=-1), by_g)


def clipped(
    free: Real, tangent: Real, centre: Real, tangent_centre: Real, width: Real, column: int
) -> tuple[Real, Real]:
    """`free` (...,) held within centre ± width, and its tangent (..., columns).

    The width is the unknown of `column`.
    """
    above, below = free > centre + width, free < centre - width
    z = np.where(above, centre + width, np.where(below, centre - width, free))
    edge = np.broadcast_to(tangent_centre, tangent.shape).copy()
    edge[:, column] += np.where(above, 1.0, -1.0)
    return z, np.where((above | below)[:, None], edge, tangent)


PointForces = tuple[Real, Real]  # unit forces (S, 4, e) and states of laws (S, 4, z) at the points of a step


@dataclass(frozen=True)
class Stepped:
    """One step of all segments: the state behind it and, where asked for, its slopes along Q directions.

    state (S, 2 n + z), slope (S, 2 n + z, Q); the states of laws that have one follow the motion's.  forces: those at
    the points of the step, from which the same step of a motion nearby is found sooner.
    """

    state: Real
    slope: Real
    forces: PointForces


@dataclass(frozen=True)
class Motion:
    """States at all samples, (samples, states), with slopes along the start's states, unknowns and force offsets.

    slope (samples, states, states + directions), None where it was not asked for; closed: whether the jumps between
    segments vanished.  For a motion nearby: starts (S, states) of the segments, along (S, states, Q) their slopes where
    asked for, at (Q,) where on these directions this motion is, and the forces of each step of the segments.
    """

    state: Real
    slope: Real | None
    starts: Real
    closed: bool
    along: Real | None
    at: Real
    forces: dict[int, PointForces]


@dataclass(frozen=True)
class Followed:
    """Segments followed from states of their own: states at their samples (samples, S, states), slopes of the ends
    (S, states, Q) or, along unknowns too, of all samples (samples, S, states, Q), and the forces of each step."""

    states: Real
    slopes: Real
    forces: dict[int, PointForces]


@dataclass(frozen=True)
class InputLoads:
    """What unit inputs do at the nodes of one step: forces on the coordinates (4, n, columns), shift and rate of the
    displacement inputs (4, r, columns)."""

    force: Real
    shift: Real
    rate: Real


class Integrator:
    """Steps of one rig at one set of parameters.  Columns of slopes: all states, then `directions` of ψ."""

    def __init__(
        self, model: Model, theta: Real, drive: Forcing, substeps: int, offset: Real | None = None
    ) -> None:
        self.model, self.substeps, self.drive = model, substeps, drive
        self.theta = theta
        self.p, self.constants = model.parameters(theta), model.inner_constants(theta)
        self.step = propagator(model, self.p, drive.step_s / substeps)
        force, self.inputs = loads(model, self.p, drive, substeps)
        self.offset = np.zeros(model.S.shape[1]) if offset is None else offset
        self.force = force + model.S @ self.offset
        self.laws = model.laws
        self.with_state = [row for row, law in enumerate(self.laws) for _ in range(law.states)]
        self.states = 2 * model.n + len(self.with_state)
        self.offsets = model.S  # constant forces that are unknown: one direction for each force input
        self.Bn, self.Dn = model.B[model.nonlinear], model.D[model.nonlinear]
        n, e = model.n, len(self.laws)
        # Nodes come before points: rows (node, point), columns likewise.
        self.grown = np.moveaxis(self.step.E, 2, 0).reshape(2 * n, 8 * n)
        self.driven = np.moveaxis(self.step.Wf, 1, 2).reshape(8 * n, 4 * n)
        self.pulled = np.moveaxis(self.step.Wn, 1, 2).reshape(4, 2 * n, 4 * e)
        steps = len(self.force)
        self.forced = (self.force.reshape(steps, 4 * n) @ self.driven.T).reshape(steps, 4, 2 * n)
        self.moved_d, self.moved_v = self.inputs[:, :, 0] @ self.Dn.T, self.inputs[:, :, 1] @ self.Dn.T
        self.reach_d = (self.Bn @ self.pulled[:, :n]).reshape(4 * e, 4 * e)
        self.reach_v = (self.Bn @ self.pulled[:, n:]).reshape(4 * e, 4 * e)
        self.offset_moved = np.einsum("jkxn,nq->jxq", self.step.Wf, self.offsets)

    @property
    def directions(self) -> int:
        """Columns of slopes beyond those of the starting state: unknowns of the rig and offsets of the forces."""
        return len(self.model.unknowns) + int(self.offsets.shape[1])

    def advance(
        self,
        state: Real,
        slope: Real,
        index: Ints,
        with_unknowns: bool,
        guess: PointForces | None = None,
        moved: InputLoads | None = None,
    ) -> Stepped:
        """One step of the segments at the steps `index` (S,); slope (S, states, Q) may have no columns.

        guess: the forces of the same step of a motion nearby; moved: what inputs do in it, where the last columns of
        the slopes are along these.
        """
        n, S = self.model.n, len(state)
        base = (state[:, : 2 * n] @ self.grown).reshape(S, 4, 2 * n) + self.forced[index]
        free_d = base[..., :n] @ self.Bn.T + self.moved_d[index]
        free_v = base[..., n:] @ self.Bn.T + self.moved_v[index]
        at = self._solve(free_d, free_v, state[:, 2 * n :], guess)
        flat = at.a.reshape(S, -1)
        if not slope.shape[-1]:
            end = base[:, 3] + flat @ self.pulled[3].T
            return Stepped(np.concatenate([end, at.z[:, 3]], axis=1), slope, (at.a, at.z))
        nodes = base + (flat @ self.pulled.reshape(8 * n, flat.shape[1]).T).reshape(base.shape)
        after = np.concatenate([nodes[:, 3], at.z[:, 3]], axis=1)
        return Stepped(after, self._slopes(slope, nodes, at, index, with_unknowns, moved), (at.a, at.z))

    def follow(
        self, begun: Real, first: Ints, intervals: int, columns: int, forces: Mapping[int, PointForces]
    ) -> Followed:
        """Segments from their states `begun` (S, states) on, side by side, from the intervals `first` (S,) of each.

        columns: of slopes: 0, those of the states, or with the unknowns.  forces: those of the same steps of a motion
        nearby.  Beyond the record the last step is repeated.
        """
        S, x, whole = len(begun), self.states, columns > self.states
        first, steps = self.substeps * first, intervals * self.substeps
        compiled = compiled_laws(self.laws)
        if compiled is not None:
            known: list[Real | None] = [None, None]
            if all(step in forces for step in range(steps)):
                known = [np.stack([forces[step][part] for step in range(steps)]) for part in range(2)]
            at = (first, np.ascontiguousarray(begun), steps, self.substeps, columns, whole, *known)
            states, slopes, a, z = compiled.follow(*self._compiled, *at)
            return Followed(states, slopes if whole else slopes[0], dict(enumerate(zip(a, z, strict=True))))
        state, slope = begun, np.zeros((S, x, columns))
        slope[:, range(min(x, columns)), range(min(x, columns))] = 1.0
        every, along, found = [state], [slope], dict[int, PointForces]()
        for step in range(steps):
            index = np.minimum(first + step, len(self.force) - 1)
            stepped = self.advance(state, slope, index, whole, forces.get(step))
            state, slope, found[step] = stepped.state, stepped.slope, stepped.forces
            if (step + 1) % self.substeps == 0:
                every.append(state)
                if whole:
                    along.append(slope)
        return Followed(np.array(every), np.array(along) if whole else slope, found)

    @cached_property
    def _compiled(self) -> tuple[Any, ...]:
        """What the kernel's `follow` needs of the rig and its inputs."""
        model, step = self.model, self.step
        power = [-1 if e.force_law is not None else e.law.power for e in model.elements]
        numbers = (
            WITHIN, self.grown, self.driven, self.pulled, self.reach_d, self.reach_v, self.offset_moved, self.forced,
            self.moved_d, self.moved_v, self.force, self.inputs, model.B, model.D, model.T, self.p, self.constants,
            model.constants_map[0], *step.both[:2], step.inertia,
        )  # fmt: skip
        return (
            step.h,
            *(np.ascontiguousarray(each, dtype=np.float64) for each in numbers),
            *(np.ascontiguousarray(each, dtype=np.int64) for each in (power, model.nonlinear)),
        )

    def input_loads(self) -> list[InputLoads]:
        """What the coefficients of the inputs' cubics do in each of the steps between two samples."""
        inputs = self.drive.coefficients.shape[-1]
        columns = 4 * inputs
        unit = Forcing(self.drive.step_s, np.eye(columns).reshape(columns, 4, inputs), self.drive.rated)
        force, moved = loads(self.model, self.p, unit, self.substeps)
        force = np.moveaxis(force.reshape(columns, self.substeps, 4, self.model.n), 0, -1)
        moved = np.moveaxis(moved.reshape(columns, self.substeps, 4, 2, -1), 0, -1)
        return [InputLoads(f, m[:, 0], m[:, 1]) for f, m in zip(force, moved, strict=True)]

    def input_rates(self) -> list[Real]:
        """Rates and accelerations of the displacement inputs at the samples, (samples, r) each."""
        c, h = self.drive.coefficients[..., : self.model.D.shape[1]], self.drive.step_s
        ends = c[-1]
        rate = np.concatenate([c[:, 1], (ends[1] + 2 * ends[2] + 3 * ends[3])[None]]) / h
        bend = np.concatenate([2 * c[:, 2], (2 * ends[2] + 6 * ends[3])[None]]) / h**2
        return [rate, bend]

    def acceleration(self, motion: Motion) -> tuple[Real, Real | None]:
        """Accelerations at the samples, (samples, n), and their slopes like those of the motion."""
        return self._accelerated(motion)[:2]

    def element_forces(self, motion: Motion) -> tuple[Real, Real | None]:
        """Forces p ∘ a in all elements at the samples, (samples, elements), N, and their slopes like those of the
        motion."""
        model, n, chosen = self.model, self.model.n, self.model.nonlinear
        acceleration, d_acceleration, at, d_a = self._accelerated(motion)
        _, _, _, u, du = self._instants(motion)
        coordinates = (motion.state[:, :n], motion.state[:, n : 2 * n], acceleration)
        inputs = (u[:, 0], du[:, 0], self.input_rates()[1])
        orders = [(MATRICES[letter].power, rows) for letter, rows in model.by_matrix.items()]
        a = np.zeros((len(motion.state), len(model.elements)))
        a[:, chosen] = at.a[:, 0]
        for power, rows in orders:
            a[:, rows] = coordinates[power] @ model.B[rows].T + inputs[power] @ model.D[rows].T
        if motion.slope is None or d_acceleration is None or d_a is None:
            return a * self.p, None
        along = (motion.slope[:, :n], motion.slope[:, n : 2 * n], d_acceleration)
        slope = np.zeros((*a.shape, motion.slope.shape[-1]))
        slope[:, chosen] = d_a
        for power, rows in orders:
            slope[:, rows] = model.B[rows] @ along[power]
        slope *= self.p[:, None]
        slope[..., self.states : self.states + len(model.unknowns)] += a[..., None] * model.T
        return a * self.p, slope

    def _accelerated(self, motion: Motion) -> tuple[Real, Real | None, StepForces, Real | None]:
        """Accelerations and the unit forces of the laws at the samples, each with its slopes (samples, …, Q)."""
        x, v, force, u, du = self._instants(motion)
        n = self.model.n
        at = self._instant_forces(motion, x, v, u, du)
        K, C, _ = self.step.both
        pull = force[:, None] - x @ K.T - v @ C.T - (at.a * self.p[self.model.nonlinear]) @ self.Bn
        acceleration = (pull @ self.step.inertia.T)[:, 0]
        if motion.slope is None:
            return acceleration, None, at, None
        d_x, d_v = motion.slope[:, :n], motion.slope[:, n : 2 * n]
        d_a = at.times((self.Bn @ d_x)[:, None], (self.Bn @ d_v)[:, None])[:, 0]
        for i, row in enumerate(self.with_state):
            d_a[:, row] += at.by_z0[:, 0, i, None] * motion.slope[:, 2 * n + i]
        m, start = len(self.model.unknowns), self.states
        for row, inner in enumerate(self.model.constant_slices):
            d_a[:, row, start : start + m] += at.by_g[row][:, 0] @ self.model.constants_map[0][inner]
        load = -(K @ d_x) - C @ d_v - (self.Bn.T * self.p[self.model.nonlinear]) @ d_a
        nodes = np.concatenate([x, v], axis=-1)
        load[..., start : start + m] += self._unit_loads(nodes, at, force[:, None], u, du)[:, 0]
        load[..., start + m :] += self.offsets
        return acceleration, self.step.inertia @ load, at, d_a

    def by_inputs(self, motion: Motion) -> tuple[Real, Real]:
        """Slopes of the accelerations, (samples, n, 4 (r + s)), and of the unit forces of the laws,
        (samples, e, 4 (r + s)), along the cubics of each sample's interval, the state at the sample being held."""
        x, v, _, u, du = self._instants(motion)
        at = self._instant_forces(motion, x, v, u, du)
        each = self.input_loads()
        first, last = each[0], each[-1]
        slopes = np.empty((len(x), self.model.n, first.force.shape[-1]))
        by_laws = np.empty((len(x), len(self.laws), first.force.shape[-1]))
        for chosen, moved, node in ((slice(0, -1), first, 0), (slice(-1, None), last, 3)):
            count = len(x[chosen])
            shape = (count, 1, len(self.laws), first.force.shape[-1])
            d, rate = (np.broadcast_to(self.Dn @ way[node], shape) for way in (moved.shift, moved.rate))
            by_laws[chosen] = d_a = at.rows(chosen).times(d, rate)[:, 0]
            slopes[chosen] = moved.force[node] - (self.Bn.T * self.p[self.model.nonlinear]) @ d_a
        return self.step.inertia @ slopes, by_laws

    def _instants(self, motion: Motion) -> tuple[Real, Real, Real, Real, Real]:
        """At the samples: x, v (samples, 1, n), forces of the inputs (samples, n), u, u̇ (samples, 1, r)."""
        n, first = self.model.n, self.substeps * np.arange(self.drive.intervals)
        force = np.concatenate([self.force[first, 0], self.force[-1:, 3]])
        inputs = np.concatenate([self.inputs[first, 0], self.inputs[-1:, 3]])
        x, v = motion.state[:, None, :n], motion.state[:, None, n : 2 * n]
        return x, v, force, inputs[:, None, 0], inputs[:, None, 1]

    def _instant_forces(self, motion: Motion, x: Real, v: Real, u: Real, du: Real) -> StepForces:
        d, rate = x @ self.Bn.T + u @ self.Dn.T, v @ self.Bn.T + du @ self.Dn.T
        z = motion.state[:, None, 2 * self.model.n :]
        return self._forces(d, rate, z, z[:, 0], 0.0)

    def _solve(self, free_d: Real, free_v: Real, z0: Real, guess: PointForces | None) -> StepForces:
        """Forces at the points of a step, from elongations and rates without them, by Newton's method on the forces."""
        S = len(free_d)
        if guess is None or not np.all(np.isfinite(guess[0])):
            first = self._forces(free_d, free_v, np.repeat(z0[:, None], 4, axis=1), z0, self.step.h)
            a, z = first.a.reshape(S, -1), first.z
        else:
            a, z = guess[0].reshape(S, -1), guess[1]
        for _ in range(24):  # Newton's method, at most
            d = free_d + (a @ self.reach_d.T).reshape(free_d.shape)
            v = free_v + (a @ self.reach_v.T).reshape(free_v.shape)
            at = self._forces(d, v, z, z0, self.step.h)
            z = at.z
            change = np.linalg.solve(self._matrix(at), (at.a.reshape(S, -1) - a)[..., None])[..., 0]
            a = a + change
            left = np.max(np.abs(change), initial=0.0) / (np.max(np.abs(a), initial=0.0) + 1e-300)
            if not max([left, *(held.step for held in at.held)]) > 1e-13:  # of the forces of a step
                break
        else:
            if guess is not None:
                return self._solve(free_d, free_v, z0, None)
        return replace(at, a=a.reshape(at.a.shape))

    def _matrix(self, at: StepForces) -> Real:
        """I − ∂φ/∂d · reach_d − ∂φ/∂v · reach_v over the nodes, (S, 4 e, 4 e)."""
        if at.full:
            return np.eye(len(self.reach_d)) - at.by_d @ self.reach_d - at.by_v @ self.reach_v
        return (
            np.eye(len(self.reach_d)) - at.by_d[..., None] * self.reach_d - at.by_v[..., None] * self.reach_v
        )

    def _forces(self, d: Real, v: Real, z: Real, z0: Real, h: float) -> StepForces:
        """Unit forces at the nodes and how they change with d and v at the nodes and with z at the start.

        At single instants, h = 0, states that follow a rate are given.
        """
        S, K, e = d.shape
        full = bool(self.with_state)
        a, by_z0 = np.zeros((S, K, e)), np.zeros((S, K, len(self.with_state)))
        size = (S, K, e, K, e) if full else (S, K, e)
        by_d, by_v, by_g = np.zeros(size), np.zeros(size), []
        z_new, states = z.copy(), []
        nothing, nodes = np.zeros((S, K)), np.arange(K)
        for row, (law, own) in enumerate(zip(self.laws, self.model.constant_slices, strict=True)):
            g = np.broadcast_to(self.constants[own], (S, own.stop - own.start))
            inside, mine, sliders = nothing, list[HeldStates](), None
            first = self.with_state.index(row) if law.has_state else 0
            own_states = range(first, first + law.states)
            if law.operator:
                sliders, inside = law.sliders(g), np.zeros((S, K))
                for j, i in enumerate(own_states):
                    width = sliders.widths[:, j]
                    held = held_states(law, d[..., row], v[..., row], z[..., i], z0[:, i], g, h, width)
                    z_new[..., i] = held.z
                    inside = inside + sliders.weights[:, j, None] * held.z
                    mine.append(replace(held, by_g=held.by_g * sliders.by_widths[:, j, None]))
            elif law.has_state:
                inside = z[..., first]
                if h:
                    mine = [held_states(law, d[..., row], v[..., row], inside, z0[:, first], g, h)]
                    inside = z_new[..., first] = mine[0].z
            states += mine
            at = law(d[..., row], v[..., row], inside, g)
            a[..., row] = at.value
            place = (slice(None), nodes, row, nodes, row) if full else (..., row)
            by_d[place], by_v[place] = at.slopes.get("d", nothing), at.slopes.get("v", nothing)
            columns = [np.broadcast_to(at.slopes.get(name, nothing), (S, K)) for name in law.constant_names]
            inner = np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0))
            by_z = np.broadcast_to(at.slopes.get("z", nothing), (S, K))
            for i in own_states if not mine else ():
                by_z0[..., i] = by_z
            for j, held in enumerate(mine):
                share = by_z if sliders is None else by_z * sliders.weights[:, j, None]
                by_d[:, :, row, :, row] += share[..., None] * held.by_d
                by_v[:, :, row, :, row] += share[..., None] * held.by_v
                by_z0[..., first + j] = share * held.by_z0
                inner = inner + share[..., None] * held.by_g
                if sliders is not None:
                    inner = inner + (by_z * held.z)[..., None] * sliders.by_weights[:, j, None]
            by_g.append(inner)
        wide = (S, K * e, K * e) if full else (S, K * e)
        return StepForces(
            a, by_d.reshape(wide), by_v.reshape(wide), by_z0, tuple(by_g), z_new, tuple(states), full
        )

    def _slopes(
        self,
        slope: Real,
        nodes: Real,
        at: StepForces,
        index: Ints,
        with_unknowns: bool,
        moved: InputLoads | None,
    ) -> Real:
        """Slopes of the state behind the step, from those before it (S, states, Q): the linearised step, with the loads
        that unknowns and inputs bring."""
        model, n, S, e, Q = self.model, self.model.n, len(slope), len(self.laws), slope.shape[-1]
        base = (self.grown.T @ slope[:, : 2 * n]).reshape(S, 4, 2 * n, Q)  # at fixed unit forces
        direct = np.zeros((S, 4, e, Q))  # of the unit forces at fixed d and v
        for i, row in enumerate(self.with_state):
            direct[:, :, row] += at.by_z0[:, :, i, None] * slope[:, None, 2 * n + i]
        m, first = len(model.unknowns), Q - self.directions
        if with_unknowns:
            G = model.constants_map[0]
            for row, inner in enumerate(model.constant_slices):
                if inner.stop > inner.start:
                    direct[:, :, row, first : first + m] += at.by_g[row] @ G[inner]
            load = self._unit_loads(
                nodes, at, self.force[index], self.inputs[index, :, 0], self.inputs[index, :, 1]
            )
            base[..., first : first + m] += (self.driven @ load.reshape(S, 4 * n, m)).reshape(S, 4, 2 * n, m)
            base[..., first + m :] += self.offset_moved
        free_d, free_v = self.Bn @ base[:, :, :n], self.Bn @ base[:, :, n:]  # (S, 4, e, Q)
        if moved is not None:
            columns = moved.force.shape[-1]
            driven = (self.driven @ moved.force.reshape(4 * n, columns)).reshape(4, 2 * n, columns)
            base[..., Q - columns :] += driven
            free_d[..., Q - columns :] += self.Bn @ driven[:, :n] + self.Dn @ moved.shift
            free_v[..., Q - columns :] += self.Bn @ driven[:, n:] + self.Dn @ moved.rate
        right = direct + at.times(free_d, free_v)
        d_a = np.linalg.solve(self._matrix(at), right.reshape(S, -1, Q))
        after = np.empty_like(slope)
        after[:, : 2 * n] = base[:, 3] + self.pulled[3] @ d_a
        if self.with_state:
            d_d = free_d + (self.reach_d @ d_a).reshape(free_d.shape)
            d_v = free_v + (self.reach_v @ d_a).reshape(free_v.shape)
        for i, row in enumerate(self.with_state):
            held = at.held[i]
            after[:, 2 * n + i] = (
                held.by_z0[:, 3, None] * slope[:, 2 * n + i]
                + np.einsum("sl,slq->sq", held.by_d[:, 3], d_d[:, :, row])
                + np.einsum("sl,slq->sq", held.by_v[:, 3], d_v[:, :, row])
            )
            if with_unknowns:
                inner = model.constant_slices[row]
                after[:, 2 * n + i, first : first + m] += held.by_g[:, 3] @ model.constants_map[0][inner]
        return after

    def _unit_loads(self, nodes: Real, at: StepForces, force: Real, u: Real, du: Real) -> Real:
        """−Bᵀ (a ∘ ∂p/∂θ) at the nodes, (S, 4, n, unknowns)."""
        model, n = self.model, self.model.n
        K, C, _ = self.step.both
        x, v = nodes[..., :n], nodes[..., n:]
        nonlinear = (at.a * self.p[model.nonlinear]) @ self.Bn
        acceleration = (force - x @ K.T - v @ C.T - nonlinear) @ self.step.inertia.T
        motion = (x @ model.B.T + u @ model.D.T, v @ model.B.T + du @ model.D.T, acceleration @ model.B.T)
        a = np.zeros((*x.shape[:2], len(model.elements)))
        for i, element in enumerate(model.elements):
            if element.force_law is None:
                a[..., i] = motion[element.law.power][..., i]
        a[..., model.nonlinear] = at.a
        return -np.einsum("en,ske,eq->sknq", model.B, a, model.T)


# Rigs on bases that are known by velocity or acceleration, as rigs that move in time (THEORY §9).
#
# Such a base is a coordinate of its own whose acceleration is prescribed; where it is at the start, and how fast, is
# part of the state. The other coordinates count from where the base alone would carry them, so what joins the rig to
# the base sees none of the base's own motion, however far that wanders.

HEAVY = 2.0**99  # kg: forces of the rig move what weighs that by less than rounding
ROUNDING = 1e-12  # of a factor


@dataclass(frozen=True)
class Bases:
    """Displacement inputs that are known by their `orders`-th derivative, 1 or 2.

    carried: how far a unit of each base carries the rig's coordinates with it.
    """

    names: tuple[str, ...] = ()
    orders: tuple[int, ...] = ()
    carried: tuple[Mapping[str, float], ...] = ()

    def matrix(self, coordinates: Sequence[str]) -> Real:
        """How far the bases carry the coordinates, (n, bases)."""
        factors = [[along.get(name, 0.0) for along in self.carried] for name in coordinates]
        return np.array(factors, dtype=float).reshape(len(coordinates), len(self.names))

    def beside(self, element: Element) -> Element:
        """The element in coordinates that count from where the bases carry them."""
        if not self.names:
            return element
        along = {point: factor for point, factor in element.along.items() if point not in self.names}
        for name, carried in zip(self.names, self.carried, strict=True):
            terms = [element.along.get(name, 0.0)]
            terms += [factor * carried.get(point, 0.0) for point, factor in element.along.items()]
            if abs(sum(terms)) > ROUNDING * sum(abs(term) for term in terms):
                along[coordinate_of(name)] = sum(terms)
        return replace(element, along=along)

    def stretch(self, element: Element) -> bool:
        """Whether an element is stretched where the bases move and the rig with them."""
        return any(coordinate_of(name) in self.beside(element).along for name in self.names)

    def hide(self, rig: Model, element: Element) -> bool:
        """Whether nobody knows how far an element is stretched: no other tells where the bases are."""
        holding = (e for e in rig.elements if e.law.power < 2 and not does_nothing(e))
        return self.stretch(element) and not any(self.stretch(e) for e in holding)


NO_BASES = Bases()


def coordinate_of(base: str) -> str:
    """Name of the coordinate that a base becomes."""
    return f"{base}, moving"


def bases_of(rig: Model, orders: Mapping[str, int]) -> Bases:
    """The bases of a rig with the derivatives that are known of them, `orders`.

    The rig is carried as its springs and dampers would have it, were all of them stiff.
    """
    holding = [
        i for i, element in enumerate(rig.elements) if element.law.power < 2 and not does_nothing(element)
    ]
    carried = []
    for name in orders:
        pulled = -rig.D[holding, rig.displacement_inputs.index(name)]
        along = np.linalg.lstsq(rig.B[holding], pulled, rcond=None)[0]
        along = np.where(np.abs(along) > ROUNDING, along, 0.0)
        whole = np.round(along)
        along = np.where(np.abs(along - whole) < ROUNDING, whole, along)
        carried.append({c: f for c, f in zip(rig.coordinates, along.tolist(), strict=True) if f})
    return Bases(tuple(orders), tuple(orders.values()), tuple(carried))


def moving_rig(rig: Model, bases: Bases) -> Model:
    """The rig with the bases as coordinates, behind its own; the force inputs of their names are accelerations, m/s².

    Its inputs are the other displacements, the forces, and the bases.
    """
    if not bases.names:
        return rig
    points = tuple(coordinate_of(name) for name in bases.names)
    elements = tuple(bases.beside(element) for element in rig.elements)
    weights = tuple(Element(f"mass of {p}", Kind.MASS, {p: 1.0}, value=HEAVY) for p in points)
    driven = (Input(n, "force", {p: HEAVY}) for n, p in zip(bases.names, points, strict=True))
    others = [source for source in rig.inputs if source.name not in bases.names]
    others.sort(key=lambda source: source.kind == "force")
    turning = frozenset(coordinate_of(n) if n in bases.names else n for n in rig.angles)
    return Model((*rig.coordinates, *points), (*others, *driven), (*elements, *weights), rig.name, turning)


def does_nothing(element: Element) -> bool:
    """Whether the parameter of an element is known to be 0."""
    return element.value == 0 and element.sd is None and element.same_as is None
