"""Motion of rigs with nonlinear elements under any input, by integration with slopes (THEORY §9).

The linear part is exact: matrix exponentials, the input a cubic spline between samples.  The nonlinear forces are
polynomials through four Lobatto points of each step, found by Newton's method (exponential collocation, order 6).

A record is cut into segments that are integrated side by side from states of their own; the jumps between them are
closed by Newton's method over the chain of segments (multiple shooting).  That is the same motion as one long
integration, in as many array operations as one segment has samples.  Sources: Hochbruck and Ostermann (2010), Acta
Numerica 19, 209 (exponential collocation); Bock and Plitt (1984) (multiple shooting).
"""

from __future__ import annotations

from dataclasses import dataclass

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

    def __init__(self, model: Model, theta: Real, drive: Forcing, substeps: int) -> None:
        self.model, self.substeps, self.drive = model, substeps, drive
        self.p, self.constants = model.parameters(theta), model.inner_constants(theta)
        self.step = propagator(model, self.p, drive.step_s / substeps)
        self.force, self.inputs = loads(model, self.p, drive, substeps)
        self.laws: tuple[ForceLaw, ...] = tuple(
            e.force_law for e in model.elements if e.force_law is not None
        )
        self.with_state = [row for row, law in enumerate(self.laws) if law.has_state]
        self.states = 2 * model.n + len(self.with_state)
        self.offsets = model.S  # constant forces that are unknown: one direction for each force input
        self.Bn, self.Dn = model.B[model.nonlinear], model.D[model.nonlinear]

    @property
    def directions(self) -> int:
        """Columns of slopes beyond those of the starting state: unknowns of the rig and offsets of the forces."""
        return len(self.model.unknowns) + int(self.offsets.shape[1])

    def advance(self, state: Real, slope: Real, index: Ints, offset: Real, with_unknowns: bool) -> Stepped:
        """One step of the segments at the steps `index` (S,); slope (S, states, Q) may have no columns."""
        n, model, h = self.model.n, self.model, self.step.h
        force = self.force[index] + offset @ self.offsets.T
        base = np.einsum("jxy,sy->sjx", self.step.E, state[:, : 2 * n])
        base = base + np.einsum("jkxn,skn->sjx", self.step.Wf, force)
        u, du = self.inputs[index, :, 0], self.inputs[index, :, 1]
        add_d, add_v = u @ self.Dn.T, du @ self.Dn.T  # (S, 4, e)
        d, v = base[..., :n] @ self.Bn.T + add_d, base[..., n:] @ self.Bn.T + add_v
        z = np.repeat(state[:, None, 2 * n :], 4, axis=1)
        reach_d = np.einsum("en,jkny->jkey", self.Bn, self.step.Wn[:, :, :n])
        reach_v = np.einsum("en,jkny->jkey", self.Bn, self.step.Wn[:, :, n:])
        d, v, z, at = self._solve(d, v, z, state[:, 2 * n :], reach_d, reach_v)
        nodes = base + np.einsum("jkxe,ske->sjx", self.step.Wn, at.a)
        after = np.concatenate([nodes[:, 3], z[:, 3]], axis=1)
        if not slope.shape[-1]:
            return Stepped(after, slope)
        return Stepped(
            after,
            self._slopes(slope, nodes, d, v, z, at, force, u, du, with_unknowns, reach_d, reach_v, h, model),
        )

    def _solve(
        self, free_d: Real, free_v: Real, z: Real, z0: Real, reach_d: Real, reach_v: Real
    ) -> tuple[Real, Real, Real, _Forces]:
        """Elongations, rates and states of laws at the nodes of a step, by Newton's method."""
        d, v = free_d.copy(), free_v.copy()
        S, _, e = d.shape
        size = np.max(np.abs(d)) + self.step.h * np.max(np.abs(v)) + 1e-300
        at = self._forces(d, v, z, z0)
        d, v = (
            free_d + np.einsum("jkey,sky->sje", reach_d, at.a),
            free_v + np.einsum("jkey,sky->sje", reach_v, at.a),
        )
        for _ in range(NEWTON):
            at = self._forces(d, v, z, z0)
            r_d = d - free_d - np.einsum("jkey,sky->sje", reach_d, at.a)
            r_v = v - free_v - np.einsum("jkey,sky->sje", reach_v, at.a)
            matrix = self._matrix(at, reach_d, reach_v)
            right = np.concatenate([r_d[:, 1:].reshape(S, -1), r_v[:, 1:].reshape(S, -1)], axis=1)
            change = np.linalg.solve(matrix, right[..., None])[..., 0]
            d[:, 1:] -= change[:, : 3 * e].reshape(S, 3, e)
            v[:, 1:] -= change[:, 3 * e :].reshape(S, 3, e)
            z = at.z
            moved = np.max(np.abs(change[:, : 3 * e])) + self.step.h * np.max(np.abs(change[:, 3 * e :]))
            if not moved > 1e-13 * size:
                break
        at = self._forces(d, v, z, z0)
        return d, v, at.z, at

    def _matrix(self, at: _Forces, reach_d: Real, reach_v: Real) -> Real:
        """I − ∂(reach · a)/∂(d, v) over the nodes 1 to 3, (S, 6 e, 6 e)."""
        S, e = at.a.shape[0], at.a.shape[2]
        # d and v at node l change the forces at node k: through the law, and through its state.
        by_d, by_v = at.by_d[:, 1:, 1:], at.by_v[:, 1:, 1:]  # (S, k, l, e)
        blocks = [
            np.einsum("jkfe,skle->sjfle", reach[1:, 1:], by).reshape(S, 3 * e, 3 * e)
            for reach in (reach_d, reach_v)
            for by in (by_d, by_v)
        ]
        top, bottom = np.concatenate(blocks[:2], axis=2), np.concatenate(blocks[2:], axis=2)
        matrix: Real = np.eye(6 * e) - np.concatenate([top, bottom], axis=1)
        return matrix

    def _forces(self, d: Real, v: Real, z: Real, z0: Real) -> _Forces:
        """Unit forces at the nodes and how they change with d and v at all nodes and with z at the start."""
        S, K, e = d.shape
        a = np.zeros((S, K, e))
        by_d, by_v = np.zeros((S, K, K, e)), np.zeros((S, K, K, e))
        by_z0, by_g = np.zeros((S, K, e)), [np.zeros((S, K, 0))] * e
        z_new, z_slopes = z.copy(), []
        diagonal = np.arange(K)
        for row, (law, own) in enumerate(zip(self.laws, self.model.constant_slices, strict=True)):
            g = np.broadcast_to(self.constants[own], (S, own.stop - own.start))
            nothing = np.zeros((S, K))
            if not law.has_state:
                at = law(d[..., row], v[..., row], nothing, g)
                a[..., row] = at.value
                by_d[:, diagonal, diagonal, row] = at.slopes.get("d", nothing)
                by_v[:, diagonal, diagonal, row] = at.slopes.get("v", nothing)
                names = law.constant_names
                by_g[row] = (
                    np.stack([np.broadcast_to(at.slopes.get(k, nothing), (S, K)) for k in names], -1)
                    if names
                    else by_g[row]
                )
                continue
            i = self.with_state.index(row)
            held = _held(law, d[..., row], v[..., row], z[..., i], z0[:, i], g, self.step.h)
            z_new[..., i] = held.z
            z_slopes.append(held)
            at = law(d[..., row], v[..., row], held.z, g)
            a[..., row] = at.value
            by_z = np.broadcast_to(at.slopes.get("z", nothing), (S, K))
            by_d[..., row] = by_z[..., None] * held.by_d
            by_v[..., row] = by_z[..., None] * held.by_v
            by_z0[..., row] = by_z * held.by_z0
            by_g[row] = by_z[..., None] * held.by_g
        return _Forces(a, by_d, by_v, by_z0, tuple(by_g), z_new, tuple(z_slopes))

    def _slopes(
        self, slope: Real, nodes: Real, d: Real, v: Real, z: Real, at: _Forces, force: Real, u: Real, du: Real,
        with_unknowns: bool, reach_d: Real, reach_v: Real, h: float, model: Model,
    ) -> Real:  # fmt: skip
        """Slopes of the state behind the step: the linearised step, with the loads that unknowns bring."""
        n, S, e, Q = model.n, len(slope), len(self.laws), slope.shape[-1]
        base = np.einsum("jxy,syq->sjxq", self.step.E, slope[:, : 2 * n])
        direct = np.zeros((S, 4, e, Q))  # of the unit forces at fixed d and v
        for i, row in enumerate(self.with_state):
            direct[:, :, row] += at.by_z0[:, :, row, None] * slope[:, None, 2 * n + i]
        if with_unknowns:
            m, G = len(model.unknowns), model.constants_map[0]
            first = Q - self.directions
            for row, own in enumerate(model.constant_slices):
                direct[:, :, row, first : first + m] += at.by_g[row] @ G[own]
            load = self._unit_loads(nodes, at, force, u, du)  # (S, 4, n, m)
            base[..., first : first + m] += np.einsum("jkxn,sknq->sjxq", self.step.Wf, load)
            base[..., first + m :] += np.einsum("jkxn,nq->jxq", self.step.Wf, self.offsets)[None]
        free_d, free_v = (
            np.einsum("en,sjnq->sjeq", self.Bn, base[:, :, :n]),
            np.einsum("en,sjnq->sjeq", self.Bn, base[:, :, n:]),
        )
        # At node 0 elongation and rate are those of the state.
        known = (
            direct
            + at.by_d[:, :, 0, :, None] * free_d[:, None, 0]
            + at.by_v[:, :, 0, :, None] * free_v[:, None, 0]
        )
        right_d = free_d + np.einsum("jkey,skyq->sjeq", reach_d, known)
        right_v = free_v + np.einsum("jkey,skyq->sjeq", reach_v, known)
        right = np.concatenate(
            [right_d[:, 1:].reshape(S, 3 * e, Q), right_v[:, 1:].reshape(S, 3 * e, Q)], axis=1
        )
        moved = np.linalg.solve(self._matrix(at, reach_d, reach_v), right)
        d_d, d_v = np.zeros((S, 4, e, Q)), np.zeros((S, 4, e, Q))
        d_d[:, 1:], d_v[:, 1:] = moved[:, : 3 * e].reshape(S, 3, e, Q), moved[:, 3 * e :].reshape(S, 3, e, Q)
        d_d[:, 0], d_v[:, 0] = free_d[:, 0], free_v[:, 0]
        d_a = direct + np.einsum("skle,sleq->skeq", at.by_d, d_d) + np.einsum("skle,sleq->skeq", at.by_v, d_v)
        after = np.empty_like(slope)
        after[:, : 2 * n] = base[:, 3] + np.einsum("kxe,skeq->sxq", self.step.Wn[3], d_a)
        for i, row in enumerate(self.with_state):
            held = at.held[i]
            after[:, 2 * n + i] = (
                held.by_z0[:, 3, None] * slope[:, 2 * n + i]
                + np.einsum("sl,slq->sq", held.by_d[:, 3], d_d[:, :, row])
                + np.einsum("sl,slq->sq", held.by_v[:, 3], d_v[:, :, row])
            )
            if with_unknowns:
                own = model.constant_slices[row]
                first = Q - self.directions
                after[:, 2 * n + i, first : first + len(model.unknowns)] += (
                    held.by_g[:, 3] @ model.constants_map[0][own]
                )
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
    a: Real
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: tuple[Real, ...]
    z: Real
    held: tuple[_Held, ...]


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
    machine: Integrator, start: Real, offset: Real, starts: Real | None = None, *, slopes: bool = False
) -> Motion:
    """The motion from `start` (states,) under the forcing and constant extra forces `offset` (s,).

    `starts` (S, states): states of the segments to begin with, such as those of a motion nearby.
    """
    length = SEGMENT
    first = segments_of(machine.drive.intervals, length)
    begun = np.zeros((len(first), machine.states)) if starts is None else starts.copy()
    begun[0] = start
    closed = False
    best = np.inf
    for _ in range(SWEEPS):
        states, slope = _pass(machine, begun, offset, length, "states")
        jumps = states[-1][:-1] - begun[1:]
        size = np.max(np.abs(begun), axis=0) + 1e-300
        gap = float(np.max(np.abs(jumps) / np.maximum(size, 1e-6 * np.max(size)), initial=0.0))
        if not np.isfinite(gap):
            break
        if gap <= CLOSED:
            closed = True
            break
        change = np.zeros(machine.states)
        factor = 1.0 if gap < best * 2 else 0.5
        best = min(best, gap)
        for k in range(len(first) - 1):
            change = slope[k] @ change + jumps[k]
            begun[k + 1] += factor * change
    if not slopes:
        return Motion(_in_order(states, machine.drive.intervals, length), None, begun, closed)
    states, along = _pass(machine, begun, offset, length, "all")
    return Motion(
        _in_order(states, machine.drive.intervals, length),
        _chained(along, machine, length), begun, closed,
    )  # fmt: skip


def _pass(machine: Integrator, begun: Real, offset: Real, length: int, what: str) -> tuple[Real, Real]:
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
            stepped = machine.advance(state, slope, index, offset, what == "all")
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
