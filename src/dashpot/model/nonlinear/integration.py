"""Motion of rigs with nonlinear elements under any input, step by step, with slopes (THEORY §9).

The linear part is exact: matrix exponentials, the input a cubic spline between samples.  The nonlinear forces are
polynomials through four Lobatto points of each step, found by Newton's method (exponential collocation, order 6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw
from dashpot.model.nonlinear.propagation import Forcing, loads, propagator
from dashpot.model.nonlinear.step_forces import NEWTON, StepForces, held_states

SETTLED = 1e-13  # of the forces of a step


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
        self.laws: tuple[ForceLaw, ...] = tuple(
            e.force_law for e in model.elements if e.force_law is not None
        )
        self.with_state = [row for row, law in enumerate(self.laws) if law.has_state]
        self.states = 2 * model.n + len(self.with_state)
        self.offsets = model.S  # constant forces that are unknown: one direction for each force input
        self.Bn, self.Dn = model.B[model.nonlinear], model.D[model.nonlinear]
        n, e = model.n, len(self.laws)
        # Nodes come before points: rows (node, point), columns likewise.
        self.grown = np.moveaxis(self.step.E, 2, 0).reshape(2 * n, 8 * n)
        self.driven = np.moveaxis(self.step.Wf, 1, 2).reshape(8 * n, 4 * n)
        self.pulled = np.moveaxis(self.step.Wn, 1, 2).reshape(4, 2 * n, 4 * e)
        self.forced = (self.force.reshape(-1, 4 * n) @ self.driven.T).reshape(-1, 4, 2 * n)
        self.moved_d, self.moved_v = self.inputs[:, :, 0] @ self.Dn.T, self.inputs[:, :, 1] @ self.Dn.T
        self.reach_d = (self.Bn @ self.pulled[:, :n]).reshape(4 * e, 4 * e)
        self.reach_v = (self.Bn @ self.pulled[:, n:]).reshape(4 * e, 4 * e)
        self.offset_moved = np.einsum("jkxn,nq->jxq", self.step.Wf, self.offsets)

    @property
    def directions(self) -> int:
        """Columns of slopes beyond those of the starting state: unknowns of the rig and offsets of the forces."""
        return len(self.model.unknowns) + int(self.offsets.shape[1])

    def advance(
        self, state: Real, slope: Real, index: Ints, with_unknowns: bool, guess: PointForces | None = None
    ) -> Stepped:
        """One step of the segments at the steps `index` (S,); slope (S, states, Q) may have no columns.

        guess: the forces of the same step of a motion nearby.
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
        return Stepped(after, self._slopes(slope, nodes, at, index, with_unknowns), (at.a, at.z))

    def along_inputs(
        self, state: Real, slope: Real, index: Ints, moved: InputLoads, guess: PointForces | None = None
    ) -> Stepped:
        """As `advance`; the last columns of the slopes are those along the inputs, of which `moved` tells this step."""
        n, S, Q = self.model.n, len(state), slope.shape[-1]
        base = (state[:, : 2 * n] @ self.grown).reshape(S, 4, 2 * n) + self.forced[index]
        free_d = base[..., :n] @ self.Bn.T + self.moved_d[index]
        free_v = base[..., n:] @ self.Bn.T + self.moved_v[index]
        at = self._solve(free_d, free_v, state[:, 2 * n :], guess)
        end = base[:, 3] + at.a.reshape(S, -1) @ self.pulled[3].T
        grown = (self.grown.T @ slope[:, : 2 * n]).reshape(S, 4, 2 * n, Q)
        columns = moved.force.shape[-1]
        grown[..., Q - columns :] += (self.driven @ moved.force.reshape(4 * n, columns)).reshape(
            4, 2 * n, columns
        )
        direct = np.zeros((S, 4, len(self.laws), Q))
        for i, row in enumerate(self.with_state):
            direct[:, :, row] += at.by_z0[:, :, row, None] * slope[:, None, 2 * n + i]
        nothing = np.zeros((4, len(self.laws), Q - columns))
        d, v = (np.concatenate([nothing, self.Dn @ way], axis=-1) for way in (moved.shift, moved.rate))
        after = self._behind(slope, grown, direct, at, d, v)
        return Stepped(np.concatenate([end, at.z[:, 3]], axis=1), after, (at.a, at.z))

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
        x, v, force, u, du = self._instants(motion)
        n = self.model.n
        at = self._instant_forces(motion, x, v, u, du)
        K, C, _ = self.step.both
        pull = force[:, None] - x @ K.T - v @ C.T - (at.a * self.p[self.model.nonlinear]) @ self.Bn
        acceleration = (pull @ self.step.inertia.T)[:, 0]
        if motion.slope is None:
            return acceleration, None
        d_x, d_v = motion.slope[:, :n], motion.slope[:, n : 2 * n]
        d_a = at.times((self.Bn @ d_x)[:, None], (self.Bn @ d_v)[:, None])[:, 0]
        for i, row in enumerate(self.with_state):
            d_a[:, row] += at.by_z0[:, 0, row, None] * motion.slope[:, 2 * n + i]
        m, start = len(self.model.unknowns), self.states
        for row, inner in enumerate(self.model.constant_slices):
            d_a[:, row, start : start + m] += at.by_g[row][:, 0] @ self.model.constants_map[0][inner]
        load = -(K @ d_x) - C @ d_v - (self.Bn.T * self.p[self.model.nonlinear]) @ d_a
        nodes = np.concatenate([x, v], axis=-1)
        load[..., start : start + m] += self._unit_loads(nodes, at, force[:, None], u, du)[:, 0]
        load[..., start + m :] += self.offsets
        return acceleration, self.step.inertia @ load

    def acceleration_by_inputs(self, motion: Motion) -> Real:
        """Slopes of the accelerations along the cubics of each sample's interval, (samples, n, 4 (r + s)).

        The state at the sample is held.
        """
        x, v, _, u, du = self._instants(motion)
        at = self._instant_forces(motion, x, v, u, du)
        each = self.input_loads()
        first, last = each[0], each[-1]
        slopes = np.empty((len(x), self.model.n, first.force.shape[-1]))
        for chosen, moved, node in ((slice(0, -1), first, 0), (slice(-1, None), last, 3)):
            count = len(x[chosen])
            shape = (count, 1, len(self.laws), first.force.shape[-1])
            d, rate = (np.broadcast_to(self.Dn @ way[node], shape) for way in (moved.shift, moved.rate))
            d_a = at.rows(chosen).times(d, rate)[:, 0]
            slopes[chosen] = moved.force[node] - (self.Bn.T * self.p[self.model.nonlinear]) @ d_a
        by_inputs: Real = self.step.inertia @ slopes
        return by_inputs

    def _instants(self, motion: Motion) -> tuple[Real, Real, Real, Real, Real]:
        """At the samples: x, v (samples, 1, n), forces of the inputs (samples, n), u, u̇ (samples, 1, r)."""
        n, first = self.model.n, self.substeps * np.arange(self.drive.intervals)
        force = np.concatenate([self.force[first, 0], self.force[-1:, 3]])
        inputs = np.concatenate([self.inputs[first, 0], self.inputs[-1:, 3]])
        x, v = motion.state[:, None, :n], motion.state[:, None, n : 2 * n]
        return x, v, force, inputs[:, None, 0], inputs[:, None, 1]

    def _instant_forces(self, motion: Motion, x: Real, v: Real, u: Real, du: Real) -> StepForces:
        d, rate = x @ self.Bn.T + u @ self.Dn.T, v @ self.Bn.T + du @ self.Dn.T
        return self._instant(d, rate, motion.state[:, None, 2 * self.model.n :])

    def _instant(self, d: Real, v: Real, z: Real) -> StepForces:
        """Unit forces and slopes at single instants, (S, 1, e), the states z of the laws being given."""
        S, K, e = d.shape
        a, by_z0 = np.zeros((S, K, e)), np.zeros((S, K, e))
        by_d, by_v, by_g = np.zeros((S, K, e)), np.zeros((S, K, e)), []
        nothing = np.zeros((S, K))
        for row, (law, own) in enumerate(zip(self.laws, self.model.constant_slices, strict=True)):
            g = np.broadcast_to(self.constants[own], (S, own.stop - own.start))
            inside, held = nothing, None
            if law.has_state:
                inside = z[..., self.with_state.index(row)]
            if law.operator:
                held = held_states(law, d[..., row], v[..., row], inside, inside[:, 0], g, 0.0)
                inside = held.z
            at = law(d[..., row], v[..., row], inside, g)
            a[..., row] = at.value
            by_d[..., row], by_v[..., row] = at.slopes.get("d", nothing), at.slopes.get("v", nothing)
            by_z0[..., row] = by_z = at.slopes.get("z", nothing)
            columns = [np.broadcast_to(at.slopes.get(name, nothing), (S, K)) for name in law.constant_names]
            inner = np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0))
            if held is not None:
                by_d[..., row] += by_z * held.by_d[..., 0]
                by_z0[..., row] *= held.by_z0
                inner = inner + by_z[..., None] * held.by_g
            by_g.append(inner)
        return StepForces(a, by_d.reshape(S, -1), by_v.reshape(S, -1), by_z0, tuple(by_g), z, (), False)

    def _solve(self, free_d: Real, free_v: Real, z0: Real, guess: PointForces | None) -> StepForces:
        """Forces at the points of a step, from elongations and rates without them, by Newton's method on the forces."""
        S = len(free_d)
        if guess is None or not np.all(np.isfinite(guess[0])):
            first = self._forces(free_d, free_v, np.repeat(z0[:, None], 4, axis=1), z0)
            a, z = first.a.reshape(S, -1), first.z
        else:
            a, z = guess[0].reshape(S, -1), guess[1]
        for _ in range(NEWTON):
            d = free_d + (a @ self.reach_d.T).reshape(free_d.shape)
            v = free_v + (a @ self.reach_v.T).reshape(free_v.shape)
            at = self._forces(d, v, z, z0)
            z = at.z
            change = np.linalg.solve(self._matrix(at), (at.a.reshape(S, -1) - a)[..., None])[..., 0]
            a = a + change
            left = np.max(np.abs(change), initial=0.0) / (np.max(np.abs(a), initial=0.0) + 1e-300)
            if not max([left, *(held.step for held in at.held)]) > SETTLED:
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

    def _forces(self, d: Real, v: Real, z: Real, z0: Real) -> StepForces:
        """Unit forces at the nodes and how they change with d and v at the nodes and with z at the start."""
        S, K, e = d.shape
        full = bool(self.with_state)
        a, by_z0 = np.zeros((S, K, e)), np.zeros((S, K, e))
        size = (S, K, e, K, e) if full else (S, K, e)
        by_d, by_v, by_g = np.zeros(size), np.zeros(size), []
        z_new, states = z.copy(), []
        nothing, nodes = np.zeros((S, K)), np.arange(K)
        for row, (law, own) in enumerate(zip(self.laws, self.model.constant_slices, strict=True)):
            g = np.broadcast_to(self.constants[own], (S, own.stop - own.start))
            inside = nothing
            held = None
            if law.has_state:
                i = self.with_state.index(row)
                held = held_states(law, d[..., row], v[..., row], z[..., i], z0[:, i], g, self.step.h)
                inside = z_new[..., i] = held.z
                states.append(held)
            at = law(d[..., row], v[..., row], inside, g)
            a[..., row] = at.value
            slope_d, slope_v = at.slopes.get("d", nothing), at.slopes.get("v", nothing)
            if not full:
                by_d[..., row], by_v[..., row] = slope_d, slope_v
            else:
                by_d[:, nodes, row, nodes, row] = slope_d
                by_v[:, nodes, row, nodes, row] = slope_v
            columns = [np.broadcast_to(at.slopes.get(name, nothing), (S, K)) for name in law.constant_names]
            inner = np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0))
            if held is not None:
                by_z = np.broadcast_to(at.slopes.get("z", nothing), (S, K))
                by_d[:, :, row, :, row] += by_z[..., None] * held.by_d
                by_v[:, :, row, :, row] += by_z[..., None] * held.by_v
                by_z0[..., row] = by_z * held.by_z0
                inner = inner + by_z[..., None] * held.by_g
            by_g.append(inner)
        wide = (S, K * e, K * e) if full else (S, K * e)
        return StepForces(
            a, by_d.reshape(wide), by_v.reshape(wide), by_z0, tuple(by_g), z_new, tuple(states), full
        )

    def _slopes(self, slope: Real, nodes: Real, at: StepForces, index: Ints, with_unknowns: bool) -> Real:
        """Slopes of the state behind the step: the linearised step, with the loads that unknowns bring."""
        model, n, S, e, Q = self.model, self.model.n, len(slope), len(self.laws), slope.shape[-1]
        base = (self.grown.T @ slope[:, : 2 * n]).reshape(S, 4, 2 * n, Q)
        direct = np.zeros((S, 4, e, Q))  # of the unit forces at fixed d and v
        for i, row in enumerate(self.with_state):
            direct[:, :, row] += at.by_z0[:, :, row, None] * slope[:, None, 2 * n + i]
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
        after = self._behind(slope, base, direct, at)
        for i, row in enumerate(self.with_state if with_unknowns else ()):
            inner = model.constant_slices[row]
            after[:, 2 * n + i, first : first + m] += at.held[i].by_g[:, 3] @ model.constants_map[0][inner]
        return after

    def _behind(
        self, slope: Real, base: Real, direct: Real, at: StepForces, moved_d: Real | float = 0.0,
        moved_v: Real | float = 0.0,
    ) -> Real:  # fmt: skip
        """Slopes of the state behind the step, from those before it (S, states, Q).

        base (S, 4, 2 n, Q): slopes at the nodes at fixed unit forces; direct (S, 4, e, Q): of the unit forces at fixed
        elongations and rates, which inputs change by moved_d and moved_v (4, e, Q).
        """
        n, S, Q = self.model.n, len(slope), slope.shape[-1]
        free_d, free_v = (
            self.Bn @ base[:, :, :n] + moved_d,
            self.Bn @ base[:, :, n:] + moved_v,
        )  # (S, 4, e, Q)
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
        load: Real = -np.einsum("en,ske,eq->sknq", model.B, a, model.T)
        return load
