"""Motion of rigs with nonlinear elements under any input, by integration with slopes (THEORY §9).

The linear part is exact: matrix exponentials, the input a cubic spline between samples.  The nonlinear forces are
polynomials through four Lobatto points of each step, found by Newton's method (exponential collocation, order 6).

A record is cut into segments that are integrated side by side from states of their own; the jumps between them are
closed by Newton's method over the chain of segments (multiple shooting).  That is the same motion as one long
integration, in as many array operations as one segment has samples.  Sources: Hochbruck and Ostermann (2010), Acta
Numerica 19, 209 (exponential collocation); Bock and Plitt (1984) (multiple shooting).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from dashpot.arrays import Ints, Real
from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw

NODES = np.array([0.0, (1 - 1 / np.sqrt(5)) / 2, (1 + 1 / np.sqrt(5)) / 2, 1.0])  # Lobatto
LAGRANGE = np.linalg.inv(np.vander(NODES, increasing=True))  # (power, node): ℓ_k(c) = Σ_m LAGRANGE[m, k] c^m
WITHIN = np.array([[NODES[j] ** (m + 1) / (m + 1) for m in range(4)] for j in range(4)]) @ LAGRANGE
NEWTON = 12
SETTLED = 1e-13  # of the forces of a step
CLOSED = 1e-10  # jumps between segments over the size of the motion
SWEEPS = 30
SEGMENT = 32  # samples of a segment, about


@dataclass(frozen=True)
class Forcing:
    """Inputs of one record as cubics between samples: (samples − 1, 4, r + s), powers of the share of the interval."""

    step_s: float
    coefficients: Real

    @property
    def intervals(self) -> int:
        """Number of intervals between samples."""
        return len(self.coefficients)


def forcing(step_s: float, inputs: Real) -> Forcing:
    """Cubic splines through the samples (samples, r + s) of the inputs, `step_s` apart."""
    time = np.arange(len(inputs), dtype=float)
    spline = CubicSpline(time, inputs, axis=0)
    return Forcing(step_s, np.moveaxis(np.asarray(spline.c)[::-1], 0, 1))


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
    """Raises ModelError where a coordinate has no mass or an element is hysteretic."""
    from scipy.linalg import expm

    parts = matrices(model, p)
    n, chosen = model.n, model.nonlinear
    if np.any(parts.H):
        raise ModelError(
            "a hysteretic damper has no motion in time",
            cure="use a viscous damper, or settled dwells of a linear rig",
        )
    if np.linalg.matrix_rank(parts.M) < n:
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
        nodes: Real = values.reshape(-1, 4, drive.coefficients.shape[-1])
        return nodes

    q, dq = at(powers, 0), at(rates, 1)
    force = q[..., :r] @ parts.G.T + dq[..., :r] @ parts.F.T + q[..., r:] @ model.S.T
    if np.any(parts.J):
        force = force + at(bends, 2)[..., :r] @ parts.J.T
    return force, np.stack([q[..., :r], dq[..., :r]], axis=2)


@dataclass(frozen=True)
class Stepped:
    """One step of all segments: the state behind it and, where asked for, its slopes along Q directions.

    state (S, 2 n + z), slope (S, 2 n + z, Q); the states of laws that have one follow the motion's.
    """

    state: Real
    slope: Real


class Integrator:
    """Steps of one rig at one set of parameters.  Columns of slopes: all states, then `directions` of ψ."""

    def __init__(
        self, model: Model, theta: Real, drive: Forcing, substeps: int, offset: Real | None = None
    ) -> None:
        self.model, self.substeps, self.drive = model, substeps, drive
        self.p, self.constants = model.parameters(theta), model.inner_constants(theta)
        self.step = propagator(model, self.p, drive.step_s / substeps)
        force, self.inputs = loads(model, self.p, drive, substeps)
        constant = np.zeros(model.S.shape[1]) if offset is None else offset
        self.force = force + model.S @ constant
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

    def advance(self, state: Real, slope: Real, index: Ints, with_unknowns: bool) -> Stepped:
        """One step of the segments at the steps `index` (S,); slope (S, states, Q) may have no columns."""
        n, S = self.model.n, len(state)
        base = (state[:, : 2 * n] @ self.grown).reshape(S, 4, 2 * n) + self.forced[index]
        free_d = base[..., :n] @ self.Bn.T + self.moved_d[index]
        free_v = base[..., n:] @ self.Bn.T + self.moved_v[index]
        at = self._solve(free_d, free_v, state[:, 2 * n :])
        flat = at.a.reshape(S, -1)
        if not slope.shape[-1]:
            end = base[:, 3] + flat @ self.pulled[3].T
            return Stepped(np.concatenate([end, at.z[:, 3]], axis=1), slope)
        nodes = base + (flat @ self.pulled.reshape(-1, flat.shape[1]).T).reshape(base.shape)
        after = np.concatenate([nodes[:, 3], at.z[:, 3]], axis=1)
        return Stepped(after, self._slopes(slope, nodes, at, index, with_unknowns))

    def input_rates(self) -> list[Real]:
        """Rates and accelerations of the displacement inputs at the samples, (samples, r) each."""
        c, h = self.drive.coefficients[..., : self.model.D.shape[1]], self.drive.step_s
        ends = c[-1]
        rate = np.concatenate([c[:, 1], (ends[1] + 2 * ends[2] + 3 * ends[3])[None]]) / h
        bend = np.concatenate([2 * c[:, 2], (2 * ends[2] + 6 * ends[3])[None]]) / h**2
        return [rate, bend]

    def acceleration(self, motion: Motion) -> tuple[Real, Real | None]:
        """Accelerations at the samples, (samples, n), and their slopes like those of the motion."""
        n, first = self.model.n, self.substeps * np.arange(self.drive.intervals)
        force = np.concatenate([self.force[first, 0], self.force[-1:, 3]])
        inputs = np.concatenate([self.inputs[first, 0], self.inputs[-1:, 3]])
        x, v = motion.state[:, None, :n], motion.state[:, None, n : 2 * n]
        u, du = inputs[:, None, 0], inputs[:, None, 1]
        d, rate = x @ self.Bn.T + u @ self.Dn.T, v @ self.Bn.T + du @ self.Dn.T
        z = motion.state[:, None, 2 * n :]
        at = self._instant(d, rate, z)
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
        for row, own in enumerate(self.model.constant_slices):
            d_a[:, row, start : start + m] += at.by_g[row][:, 0] @ self.model.constants_map[0][own]
        load = -(K @ d_x) - C @ d_v - (self.Bn.T * self.p[self.model.nonlinear]) @ d_a
        nodes = np.concatenate([x, v], axis=-1)
        load[..., start : start + m] += self._unit_loads(nodes, at, force[:, None], u, du)[:, 0]
        load[..., start + m :] += self.offsets
        return acceleration, self.step.inertia @ load

    def _instant(self, d: Real, v: Real, z: Real) -> _Forces:
        """Unit forces and slopes at single instants, (S, 1, e), the states z of the laws being given."""
        S, K, e = d.shape
        a, by_z0 = np.zeros((S, K, e)), np.zeros((S, K, e))
        by_d, by_v, by_g = np.zeros((S, K, e)), np.zeros((S, K, e)), []
        nothing = np.zeros((S, K))
        for row, (law, own) in enumerate(zip(self.laws, self.model.constant_slices, strict=True)):
            g = np.broadcast_to(self.constants[own], (S, own.stop - own.start))
            held = z[..., self.with_state.index(row)] if law.has_state else nothing
            at = law(d[..., row], v[..., row], held, g)
            a[..., row] = at.value
            by_d[..., row], by_v[..., row] = at.slopes.get("d", nothing), at.slopes.get("v", nothing)
            by_z0[..., row] = at.slopes.get("z", nothing)
            columns = [np.broadcast_to(at.slopes.get(name, nothing), (S, K)) for name in law.constant_names]
            by_g.append(np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0)))
        return _Forces(a, by_d.reshape(S, -1), by_v.reshape(S, -1), by_z0, tuple(by_g), z, (), False)

    def _solve(self, free_d: Real, free_v: Real, z0: Real) -> _Forces:
        """Forces at the nodes of a step, from elongations and rates without them, by Newton's method on the forces."""
        S = len(free_d)
        z = np.repeat(z0[:, None], 4, axis=1)
        at = self._forces(free_d, free_v, z, z0)
        a = at.a.reshape(S, -1)
        for _ in range(NEWTON):
            d = free_d + (a @ self.reach_d.T).reshape(free_d.shape)
            v = free_v + (a @ self.reach_v.T).reshape(free_v.shape)
            at = self._forces(d, v, at.z, z0)
            change = np.linalg.solve(self._matrix(at), (at.a.reshape(S, -1) - a)[..., None])[..., 0]
            a = a + change
            if not np.max(np.abs(change)) > SETTLED * (np.max(np.abs(a)) + 1e-300):
                break
        return replace(at, a=a.reshape(at.a.shape))

    def _matrix(self, at: _Forces) -> Real:
        """I − ∂φ/∂d · reach_d − ∂φ/∂v · reach_v over the nodes, (S, 4 e, 4 e)."""
        if at.full:
            return np.eye(len(self.reach_d)) - at.by_d @ self.reach_d - at.by_v @ self.reach_v
        return (
            np.eye(len(self.reach_d)) - at.by_d[..., None] * self.reach_d - at.by_v[..., None] * self.reach_v
        )

    def _forces(self, d: Real, v: Real, z: Real, z0: Real) -> _Forces:
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
                held = _held(law, d[..., row], v[..., row], z[..., i], z0[:, i], g, self.step.h)
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
        return _Forces(
            a, by_d.reshape(wide), by_v.reshape(wide), by_z0, tuple(by_g), z_new, tuple(states), full
        )

    def _slopes(self, slope: Real, nodes: Real, at: _Forces, index: Ints, with_unknowns: bool) -> Real:
        """Slopes of the state behind the step: the linearised step, with the loads that unknowns bring."""
        model, n, S, e, Q = self.model, self.model.n, len(slope), len(self.laws), slope.shape[-1]
        base = (self.grown.T @ slope[:, : 2 * n]).reshape(S, 4, 2 * n, Q)
        direct = np.zeros((S, 4, e, Q))  # of the unit forces at fixed d and v
        for i, row in enumerate(self.with_state):
            direct[:, :, row] += at.by_z0[:, :, row, None] * slope[:, None, 2 * n + i]
        m, first = len(model.unknowns), Q - self.directions
        if with_unknowns:
            G = model.constants_map[0]
            for row, own in enumerate(model.constant_slices):
                if own.stop > own.start:
                    direct[:, :, row, first : first + m] += at.by_g[row] @ G[own]
            load = self._unit_loads(
                nodes, at, self.force[index], self.inputs[index, :, 0], self.inputs[index, :, 1]
            )
            base[..., first : first + m] += (self.driven @ load.reshape(S, 4 * n, m)).reshape(S, 4, 2 * n, m)
            base[..., first + m :] += self.offset_moved
        free_d, free_v = self.Bn @ base[:, :, :n], self.Bn @ base[:, :, n:]  # (S, 4, e, Q)
        right = direct + at.times(free_d, free_v)
        d_a = np.linalg.solve(self._matrix(at), right.reshape(S, 4 * e, Q))
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
                own = model.constant_slices[row]
                after[:, 2 * n + i, first : first + m] += held.by_g[:, 3] @ model.constants_map[0][own]
        return after

    def _unit_loads(self, nodes: Real, at: _Forces, force: Real, u: Real, du: Real) -> Real:
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


@dataclass(frozen=True)
class _Held:
    """States of a law at the nodes, (S, 4), and their slopes along d and v at all nodes (S, 4, 4), z0 and constants."""

    z: Real
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: Real


@dataclass(frozen=True)
class _Forces:
    """Unit forces at the nodes (S, 4, e) and their slopes: along d and v at the same node (S, 4 e), or, `full`, at all
    nodes (S, 4 e, 4 e); along the states z0 at the start and the constants; z (S, 4, laws with a state).
    """

    a: Real
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: tuple[Real, ...]
    z: Real
    held: tuple[_Held, ...]
    full: bool

    def times(self, d: Real, v: Real) -> Real:
        """What changes of d and v at the nodes, (S, 4, e, Q), do to the unit forces."""
        if not self.full:
            shape = (*d.shape[:3], 1)
            return self.by_d.reshape(shape) * d + self.by_v.reshape(shape) * v
        wide = (len(d), -1, d.shape[-1])
        change: Real = self.by_d @ d.reshape(wide) + self.by_v @ v.reshape(wide)
        return change.reshape(d.shape)


def _held(law: ForceLaw, d: Real, v: Real, z: Real, z0: Real, g: Real, h: float) -> _Held:
    """The state of a law over one step, from z0: collocation of its rate, or the operator from node to node."""
    S, K = d.shape
    if law.operator:
        return _operated_nodes(law, d, z0, g)
    assert law.rate is not None
    Q = h * WITHIN
    for _ in range(NEWTON):
        at = law.rate(law.values(d, v, z, g))
        rate = np.broadcast_to(at.value, (S, K))
        by_z = np.broadcast_to(at.slopes.get("z", np.zeros((S, K))), (S, K))
        missing = z - z0[:, None] - rate @ Q.T
        matrix = np.eye(K) - Q[None] * by_z[:, None, :]
        change = np.linalg.solve(matrix, missing[..., None])[..., 0]
        z = z - change
        if not np.max(np.abs(change)) > 1e-14 * (np.max(np.abs(z)) + 1e-300):
            break
    at = law.rate(law.values(d, v, z, g))
    nothing = np.zeros((S, K))
    by_z = np.broadcast_to(at.slopes.get("z", nothing), (S, K))
    inverse = np.linalg.inv(np.eye(K) - Q[None] * by_z[:, None, :])
    by_d = inverse @ (Q[None] * np.broadcast_to(at.slopes.get("d", nothing), (S, K))[:, None, :])
    by_v = inverse @ (Q[None] * np.broadcast_to(at.slopes.get("v", nothing), (S, K))[:, None, :])
    columns = [np.broadcast_to(at.slopes.get(name, nothing), (S, K)) @ Q.T for name in law.constant_names]
    by_g: Real = (inverse @ np.stack(columns, axis=-1)).astype(np.float64) if columns else np.zeros((S, K, 0))
    return _Held(z, by_d, by_v, inverse.sum(axis=-1), by_g)


def _operated_nodes(law: ForceLaw, d: Real, z0: Real, g: Real) -> _Held:
    S, K = d.shape
    tangent = np.zeros((S, K + 2))  # along d at the nodes, z0 and the width
    tangent[:, K] = 1.0
    z, states, tangents = z0, [z0], [tangent]
    width = g[:, 0]
    for k in range(1, K):
        change = np.zeros((S, K + 2))
        change[:, k] = 1.0
        if law.operator == "stop":
            change[:, k - 1] = -1.0
            z, tangent = clipped(
                z + d[:, k] - d[:, k - 1], tangent + change, np.zeros(S), np.zeros_like(change), width, K + 1
            )
        else:
            z, tangent = clipped(z, tangent, d[:, k], change, width, K + 1)
        states.append(z)
        tangents.append(tangent)
    total = np.stack(tangents, axis=1)
    return _Held(
        np.stack(states, axis=1), total[..., :K], np.zeros((S, K, K)), total[..., K], total[..., K + 1 :]
    )


def clipped(
    free: Real, tangent: Real, centre: Real, tangent_centre: Real, width: Real, column: int
) -> tuple[Real, Real]:
    """`free` held within centre ± width, and its tangent; the width is the unknown of `column`."""
    above, below = free > centre + width, free < centre - width
    z = np.where(above, centre + width, np.where(below, centre - width, free))
    edge = np.broadcast_to(tangent_centre, tangent.shape).copy()
    edge[:, column] += np.where(above, 1.0, -1.0)
    return z, np.where((above | below)[:, None], edge, tangent)


@dataclass(frozen=True)
class Motion:
    """States at all samples, (samples, states), with slopes along the start's states, unknowns and force offsets.

    slope (samples, states, states + directions), None where it was not asked for; starts (S, states) of the segments;
    closed: whether the jumps between segments vanished.  `forces` (samples, e): unit forces are found from states.
    """

    state: Real
    slope: Real | None
    starts: Real
    closed: bool


def segments_of(intervals: int, length: int = SEGMENT) -> Ints:
    """First intervals of the segments, the last of which may be shorter; (S,)."""
    return np.arange(0, intervals, length)


def integrate(
    machine: Integrator, start: Real, starts: Real | None = None, *, slopes: bool = False
) -> Motion:
    """The motion from `start` (states,).

    `starts` (S, states): states of the segments to begin with, such as those of a motion nearby.
    """
    length = SEGMENT
    first = segments_of(machine.drive.intervals, length)
    begun = np.zeros((len(first), machine.states)) if starts is None else starts.copy()
    begun[0] = start
    with np.errstate(all="ignore"):
        states, closed = _close(machine, begun, length)
        if not closed:
            begun = _marched(machine, start, length)
            states, closed = _close(machine, begun, length)
    if not slopes:
        return Motion(_in_order(states, machine.drive.intervals, length), None, begun, closed)
    states, along = _pass(machine, begun, length, "all")
    return Motion(
        _in_order(states, machine.drive.intervals, length),
        _chained(along, machine, length), begun, closed,
    )  # fmt: skip


def _close(machine: Integrator, begun: Real, length: int) -> tuple[Real, bool]:
    """Newton's method on the jumps between segments, whose starts `begun` are changed; states, and whether it ends."""
    best, states = np.inf, begun[None]
    for _ in range(SWEEPS):
        states, slope = _pass(machine, begun, length, "states")
        jumps = states[-1][:-1] - begun[1:]
        size = np.max(np.abs(begun), axis=0) + 1e-300
        gap = float(np.max(np.abs(jumps) / np.maximum(size, 1e-6 * np.max(size)), initial=0.0))
        if gap <= CLOSED:
            return states, True
        if not np.isfinite(gap) or gap > 1e3 * max(best, 1.0):
            break
        factor = 1.0 if gap < best * 2 else 0.5
        best = min(best, gap)
        change = np.zeros(machine.states)
        for k in range(len(begun) - 1):
            change = slope[k] @ change + jumps[k]
            begun[k + 1] += factor * change
    return states, False


def _marched(machine: Integrator, start: Real, length: int) -> Real:
    """States at the starts of the segments by one integration after another: slow, and never astray."""
    state, begun, nothing = start[None], [], np.zeros((1, machine.states, 0))
    for interval in range(machine.drive.intervals):
        if interval % length == 0:
            begun.append(state[0])
        for sub in range(machine.substeps):
            state = machine.advance(
                state, nothing, np.array([interval * machine.substeps + sub]), False
            ).state
    return np.array(begun)


def _pass(machine: Integrator, begun: Real, length: int, what: str) -> tuple[Real, Real]:
    """All segments from their own states: states (length + 1, S, states), slopes of the ends or of all samples."""
    S, x = begun.shape
    first = segments_of(machine.drive.intervals, length)
    Q = x + (machine.directions if what == "all" else 0)
    state, slope = begun, np.zeros((S, x, Q))
    slope[:, range(x), range(x)] = 1.0
    states, kept = [state], [slope]
    steps = machine.drive.intervals * machine.substeps
    for sample in range(length):
        for sub in range(machine.substeps):
            index = np.minimum((first + sample) * machine.substeps + sub, steps - 1)
            stepped = machine.advance(state, slope, index, what == "all")
            state, slope = stepped.state, stepped.slope
        states.append(state)
        if what == "all":
            kept.append(slope)
    return np.array(states), np.array(kept) if what == "all" else slope


def _in_order(states: Real, intervals: int, length: int) -> Real:
    """(length + 1, S, states) of segments as (samples, states)."""
    body = np.moveaxis(states[:-1], 1, 0).reshape(-1, states.shape[-1])[:intervals]
    last = intervals - (states.shape[1] - 1) * length
    return np.concatenate([body, states[last, -1][None]])


def _chained(along: Real, machine: Integrator, length: int) -> Real:
    """Slopes of all samples with respect to the record's start, unknowns and offsets, from those within segments."""
    x, intervals = machine.states, machine.drive.intervals
    S, Q = along.shape[1], along.shape[-1]
    start = np.zeros((x, Q))
    start[:, :x] = np.eye(x)
    total = np.empty((S, length + 1, x, Q))
    for k in range(S):
        within = along[:, k]
        total[k] = within[..., :x] @ start
        total[k, ..., x:] += within[..., x:]
        start = total[k, -1]
    body = total[:, :-1].reshape(-1, x, Q)[:intervals]
    last = intervals - (S - 1) * length
    return np.concatenate([body, total[-1, last][None]])
