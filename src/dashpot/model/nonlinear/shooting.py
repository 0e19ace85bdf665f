"""Motions by multiple shooting, and how they change with the samples of the inputs, to first order (THEORY §9).

The linearised motion is a chain of small matrices, one from each sample to the next; the cubics between the samples of
the inputs are linear in these.  Both are carried forwards and, transposed, backwards, at the cost of a banded solve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.linalg import solve_banded
from scipy.linalg.blas import dtbsv
from scipy.sparse.linalg import splu

from dashpot.arrays import Ints, Real
from dashpot.model.nonlinear.integration import Integrator, Motion, PointForces

FEWEST = 4  # samples of a record whose inputs may move


@dataclass(frozen=True)
class Tangent:
    """The linearised motion: step (samples − 1, x, x) from each sample to the next, driven (samples − 1, x, 4 q) by the
    cubics of the interval's q inputs; shown (samples, channels, x) and direct (samples, channels, 4 q): what channels
    show of the state, and of the cubics of the interval that a sample begins (the last one: ends).
    """

    step: Real
    driven: Real
    shown: Real
    direct: Real

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.shown)

    def times(self, change: Real) -> Real:
        """What the channels show of changed inputs (samples, q, K), from the same start; (samples, channels, K)."""
        N, q, K = change.shape
        c = spline_coefficients(change.reshape(N, -1)).reshape(N - 1, 4 * q, K)
        states = np.zeros((N, self.step.shape[1], K))
        states[1:] = self.driven @ c
        states = self._carried(states, transposed=False)
        outputs: Real = self.shown @ states
        outputs[:-1] += self.direct[:-1] @ c
        outputs[-1] += self.direct[-1] @ c[-1]
        return outputs

    def transposed(self, outputs: Real) -> Real:
        """The transpose of `times`: (samples, channels, K) to (samples, q, K)."""
        N, _, K = outputs.shape
        states = self._carried(np.swapaxes(self.shown, 1, 2) @ outputs, transposed=True)
        c = np.swapaxes(self.driven, 1, 2) @ states[1:]
        c += np.swapaxes(self.direct[:-1], 1, 2) @ outputs[:-1]
        c[-1] += self.direct[-1].T @ outputs[-1]
        change = spline_transposed(c.reshape(N - 1, 4, -1))
        return change.reshape(N, -1, K)

    def _carried(self, loads: Real, *, transposed: bool) -> Real:
        """States (samples, x, K) that follow from loads at the samples along the chain, or against it, transposed."""
        N, x, K = loads.shape
        if not x:
            return loads
        ab = np.zeros((2 * x, N * x), order="F")
        for row in range(x):
            for column in range(x):
                ab[x + row - column, column : (N - 1) * x : x] = -self.step[:, row, column]
        flat = np.asfortranarray(loads.reshape(N * x, K))
        for k in range(K):
            flat[:, k] = dtbsv(2 * x - 1, ab, flat[:, k], lower=1, trans=int(transposed), diag=1)
        return flat.reshape(N, x, K)


def tangent(
    machine: Integrator, motion: Motion, on_x: Real, on_q: Real, derivative: tuple[int, ...], force: Real
) -> Tangent:
    """Of a motion of a rig, as channels show it: on_x (channels, n), on_q (channels, r + s), derivative (channels,) of
    motions, force (channels, elements) of forces in the first elements.

    Raises numpy's LinAlgError if the forces of a step have no one answer.
    """
    N, n, h = machine.drive.intervals + 1, machine.model.n, machine.drive.step_s
    q = machine.drive.coefficients.shape[-1]
    state = motion.state[:-1]
    slope = np.zeros((N - 1, machine.states, machine.states + 4 * q))
    slope[:, range(machine.states), range(machine.states)] = 1.0
    # The forces that a motion was found with, (samples − 1, substeps, …); None if it does not tell
    steps = len(motion.forces)
    if not steps or steps % machine.substeps:
        known = None
    else:
        S = len(motion.starts)
        parts = []
        for part in range(2):
            each = np.stack([motion.forces[k][part] for k in range(steps)], axis=1)
            parts.append(each.reshape(S * steps // machine.substeps, machine.substeps, *each.shape[2:]))
        known = parts[0][: machine.drive.intervals], parts[1][: machine.drive.intervals]
    for sub, moved in enumerate(machine.input_loads()):
        index = np.arange(N - 1) * machine.substeps + sub
        guess = None if known is None else (known[0][:, sub], known[1][:, sub])
        stepped = machine.advance(state, slope, index, False, guess, moved)
        state, slope = stepped.state, stepped.slope
    shown, direct = np.zeros((N, len(derivative), machine.states)), np.zeros((N, len(derivative), 4 * q))
    instants = _Instants(machine, motion)
    r = machine.model.D.shape[1]
    for c, power in enumerate(derivative):
        if power < 2:
            shown[:, c, power * n : (power + 1) * n] = on_x[c]
        else:
            shown[:, c] = on_x[c] @ instants.accelerations_by_state
            direct[:, c] = on_x[c] @ instants.by_inputs[0]
        direct[:, c] += _input_itself(N, h, power, np.where(np.arange(q) < r, on_q[c], 0.0))
    if np.any(force):
        by_state, by_input = instants.element_forces()
        shown += force @ by_state[:, : force.shape[1]]
        direct += force @ by_input[:, : force.shape[1]]
    return Tangent(slope[..., : machine.states], slope[..., machine.states :], shown, direct)


def _input_itself(N: int, h: float, power: int, on_q: Real) -> Real:
    """What a channel shows of the inputs themselves, or their rates, along the cubics; (samples, 4 q)."""
    at = np.zeros((N, 4))
    at[:-1, power] = (1.0, 1.0, 2.0)[power]
    at[-1] = ((1, 1, 1, 1), (0, 1, 2, 3), (0, 0, 2, 6))[power]
    return (at[:, :, None] / h**power * on_q).reshape(N, -1)


@dataclass(frozen=True)
class _Instants:
    """What changes at each sample of a motion, at once, with the state there and with the cubics of its interval."""

    machine: Integrator
    motion: Motion

    @cached_property
    def _alone(self) -> Motion:
        """The motion with the slopes of each state along itself."""
        motion, x = self.motion, self.machine.states
        slope = np.zeros((len(motion.state), x, x + self.machine.directions))
        slope[:, range(x), range(x)] = 1.0
        return Motion(motion.state, slope, motion.starts, True, None, motion.at, motion.forces)

    @cached_property
    def accelerations_by_state(self) -> Real:
        """Of the coordinates, (samples, n, x)."""
        slope = self.machine.acceleration(self._alone)[1]
        assert slope is not None
        return slope[..., : self.machine.states]

    @cached_property
    def by_inputs(self) -> tuple[Real, Real]:
        """Of accelerations (samples, n, 4 q) and of unit forces of laws (samples, e, 4 q)."""
        return self.machine.by_inputs(self.motion)

    def element_forces(self) -> tuple[Real, Real]:
        """Of the forces in elements by the state (samples, elements, x) and by the cubics (samples, elements, 4 q)."""
        machine, model = self.machine, self.machine.model
        by_state = machine.element_forces(self._alone)[1]
        assert by_state is not None
        accelerations, laws = self.by_inputs
        by_input = np.empty((len(laws), len(model.elements), laws.shape[-1]))
        by_input[:, model.nonlinear] = laws
        D = np.pad(model.D, ((0, 0), (0, laws.shape[-1] // 4 - model.D.shape[1])))
        for i, element in enumerate(model.elements):
            if element.force_law is None:
                power = element.law.power
                by_input[:, i] = _input_itself(len(laws), machine.drive.step_s, power, D[i])
                if power == 2:
                    by_input[:, i] += model.B[i] @ accelerations
        return by_state[..., : machine.states], machine.p[:, None] * by_input


def spline_coefficients(values: Real) -> Real:
    """Cubics of the spline through values (samples, K), (samples − 1, 4, K): powers of the share of the interval.

    That of `propagation.forcing`: the third derivative is continuous at the second and the last sample but one.
    """
    steps = np.diff(values, axis=0)
    right = np.empty_like(values)
    right[1:-1] = 3 * (steps[1:] + steps[:-1])
    right[0], right[-1] = (5 * steps[0] + steps[1]) / 2, (5 * steps[-1] + steps[-2]) / 2
    rate = solve_banded((1, 1), spline_matrix(len(values), transposed=False), right)
    bend, twist = 3 * steps - 2 * rate[:-1] - rate[1:], rate[:-1] + rate[1:] - 2 * steps
    return np.stack([values[:-1], rate[:-1], bend, twist], axis=1)


def spline_transposed(c: Real) -> Real:
    """The transpose of `spline_coefficients`: (samples − 1, 4, K) to (samples, K)."""
    N = len(c) + 1
    values, rate = np.zeros((N, c.shape[2])), np.zeros((N, c.shape[2]))
    values[:-1] = c[:, 0]
    rate[:-1] = c[:, 1] - 2 * c[:, 2] + c[:, 3]
    rate[1:] += c[:, 3] - c[:, 2]
    steps = 3 * c[:, 2] - 2 * c[:, 3]
    right = solve_banded((1, 1), spline_matrix(N, transposed=True), rate)
    steps[1:] += 3 * right[1:-1]
    steps[:-1] += 3 * right[1:-1]
    steps[0] += 2.5 * right[0]
    steps[1] += 0.5 * right[0]
    steps[-1] += 2.5 * right[-1]
    steps[-2] += 0.5 * right[-1]
    values[1:] += steps
    values[:-1] -= steps
    return values


def spline_matrix(N: int, *, transposed: bool) -> Real:
    """Bands (3, samples) of the equations for the rates of a cubic spline at its samples."""
    above, below = np.ones(N - 1), np.ones(N - 1)
    above[0] = below[-1] = 2.0
    bands = np.zeros((3, N))
    bands[0, 1:], bands[2, :-1] = (below, above) if transposed else (above, below)
    bands[1] = 4.0
    bands[1, 0] = bands[1, -1] = 1.0
    return bands


# Residuals of a linearised motion whose inputs have white noise, decorrelated by one sparse factorisation.
#
# V = I + W L σ² Lᵀ W, L the tangent of a motion. With the states, the cubics of the inputs and what is
# carried back against time as further unknowns, V z = b is a system that couples each sample with the next
# alone.


class ChainSolver:
    """V⁻¹ for weights of the channels (channels,) and standard deviations of the inputs' noise (q,), above 0."""

    def __init__(self, tangent: Tangent, weight: Real, sd: Real) -> None:
        N, c, x = tangent.shown.shape
        q = len(sd)
        F = sparse.eye_array(N * x) - sparse.csr_array(_blocks(tangent.step, 1, 0, N, N))
        D = sparse.csr_array(_blocks(tangent.driven, 1, 0, N, N - 1))
        W = sparse.diags_array(np.tile(weight, N))
        every: Ints = np.arange(N)
        at: Ints = np.minimum(every, N - 2)
        Sx = W @ sparse.csr_array(_blocks(tangent.shown, 0, 0, N, N))
        Sc = W @ sparse.csr_array(_placed(tangent.direct, every, at, N, N - 1))
        T, R, Cy, Cs = _spline(N, q)
        y_shown, s_shown = Sc @ Cy, Sc @ Cs
        precision = sparse.diags_array(np.tile(1 / sd**2, N))
        one = sparse.eye_array(N * c)
        grid = [  # unknown: z, X, λ, y, s, μ
            [one, Sx, None, y_shown, s_shown, None],
            [None, F, None, -(D @ Cy), -(D @ Cs), None],
            [-Sx.T, None, F.T, None, None, None],
            [-y_shown.T, None, -(D @ Cy).T, precision, None, -R.T],
            [None, None, None, -R, T, None],
            [-s_shown.T, None, -(D @ Cs).T, None, None, T.T],
        ]
        sizes = (c, x, x, q, q, q)
        # Numbers of the unknowns, sample by sample; each kind is stacked over the samples
        first = np.concatenate([[0], np.cumsum(np.array(sizes) * N)])
        parts = [
            first[kind] + np.arange(N)[:, None] * size + np.arange(size) for kind, size in enumerate(sizes)
        ]
        self._order = np.concatenate(parts, axis=1).ravel()
        self._shape = (N, c)
        whole = sparse.block_array(grid, format="csc")[:, self._order][self._order]
        self._factors = splu(sparse.csc_matrix(whole), permc_spec="NATURAL")

    def solve(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K)."""
        N, c = self._shape
        right = np.zeros((len(self._order), columns.shape[2]))
        right[: N * c] = columns.reshape(N * c, -1)
        solved = np.empty_like(right)
        solved[self._order] = self._factors.solve(np.ascontiguousarray(right[self._order]))
        return solved[: N * c].reshape(columns.shape)


def _blocks(blocks: Real, down: int, right: int, rows: int, columns: int) -> sparse.coo_array:
    """Block k (count, height, width) in block row k + down and block column k + right."""
    k: Ints = np.arange(len(blocks))
    return _placed(blocks, k + down, k + right, rows, columns)


def _placed(blocks: Real, at_row: Ints, at_column: Ints, rows: int, columns: int) -> sparse.coo_array:
    _, height, width = blocks.shape
    i = at_row[:, None, None] * height + np.arange(height)[:, None] + 0 * np.arange(width)
    j = at_column[:, None, None] * width + np.arange(width) + 0 * np.arange(height)[:, None]
    return sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), (rows * height, columns * width))


def _spline(N: int, q: int) -> tuple[sparse.csr_array, ...]:
    """T s = R y for the rates s of a spline at its samples, and its cubics c = Cy y + Cs s, (…, q) interleaved."""
    rows = np.arange(N)
    bands = spline_matrix(N, transposed=False)
    T = _banded(N, (rows[:-1], rows, rows[1:]), (1, 0, -1), (bands[0, 1:], bands[1], bands[2, :-1]))
    inner, three, first = rows[1:-1], np.full(N - 2, 3.0), np.array([-2.5, 2.0, 0.5])
    R = _banded(N, (inner, inner), (1, -1), (three, -three)) + _banded(
        N,
        tuple(np.array([row]) for row in (0, 0, 0, N - 1, N - 1, N - 1)),
        (0, 1, 2, 0, -1, -2),
        tuple(np.array([value]) for value in (*first, *-first)),
    )
    k = np.arange(N - 1)
    now = sparse.csr_array((np.ones(N - 1), (k, k)), (N - 1, N))
    later = sparse.csr_array((np.ones(N - 1), (k, k + 1)), (N - 1, N))
    step = later - now
    powers = [sparse.csr_array(np.eye(4)[:, [m]]) for m in range(4)]
    Cy = sparse.kron(now, powers[0]) + sparse.kron(step, 3 * powers[2] - 2 * powers[3])
    Cs = sparse.kron(now, powers[1] - 2 * powers[2] + powers[3]) + sparse.kron(later, powers[3] - powers[2])
    each = sparse.eye_array(q)
    return tuple(sparse.csr_array(sparse.kron(matrix, each)) for matrix in (T, R, Cy, Cs))


def _banded(
    N: int, rows: tuple[Ints, ...], offsets: tuple[int, ...], values: tuple[Real, ...]
) -> sparse.csr_array:
    """Values in some rows (…,), each off the diagonal by an offset."""
    columns = [row + offset for row, offset in zip(rows, offsets, strict=True)]
    at = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array((np.concatenate(values), at), (N, N))


# Whole motions by multiple shooting (THEORY §9).
#
# A record is cut into segments that are integrated side by side from states of their own; the jumps between them are
# closed by Newton's method over the chain of segments.  That is the same motion as one long integration, in as many
# array operations as one segment has samples.  Source: Bock and Plitt (1984), 9th IFAC World Congress.


def segment_length(intervals: int) -> int:
    """Intervals of a segment: as long as passing along one and joining all of them take about the same time."""
    return int(np.clip(np.sqrt(intervals) / 16, 4, 32))


def segments_of(intervals: int, length: int) -> Ints:
    """First intervals of the segments, the last of which may be shorter; (S,)."""
    return np.arange(0, intervals, length)


def integrate(
    machine: Integrator, start: Real, near: Motion | None = None, *, slopes: bool = False
) -> Motion:
    """The motion from `start` (states,); `near` is one of the same record, from which it is found sooner.

    Where it is too far from `near` it does not close; without one it is then followed from sample to sample.
    """
    length = segment_length(machine.drive.intervals)
    first = segments_of(machine.drive.intervals, length)
    at = np.concatenate([start, machine.theta, machine.offset])
    begun, forces = np.zeros((len(first), machine.states)), {}
    if near is not None:
        begun, forces = near.starts.copy(), near.forces.copy()
        if near.along is not None and np.all(np.isfinite(near.along)):
            begun += near.along @ (at - near.at)
    begun[0] = start
    chain = _Chain(machine, begun, length, forces)
    try:
        with np.errstate(all="ignore"):
            closed = chain.close(slopes)
            if near is None and not closed:
                # One integration after another, from sample to sample: slow, and never astray
                alone = machine.follow(start[None], first[:1], machine.drive.intervals, 0, {})
                chain.begun, chain.forces = alone.states[:-1:length, 0], {}
                closed = chain.close(slopes)
            slope = chain.slopes() if closed and slopes else None
    except np.linalg.LinAlgError:  # the forces of a step have no one answer for such parameters
        nowhere = np.full((machine.drive.intervals + 1, machine.states), np.nan)
        return Motion(nowhere, None, chain.begun, False, None, at, {})
    if slope is None:
        return Motion(chain.motion(), None, chain.begun, closed, None, at, chain.forces)
    return Motion(chain.motion(), slope, chain.begun, closed, slope[first], at, chain.forces)


class _Chain:
    """Segments of a record, integrated side by side from their own states `begun` (S, states).

    states (length + 1, S, states) of the last pass; along: slopes of their ends or, `whole`, of all samples.
    """

    def __init__(self, machine: Integrator, begun: Real, length: int, forces: dict[int, PointForces]) -> None:
        self.machine, self.begun, self.length, self.forces = machine, begun, length, forces
        self.states, self.along, self.whole = begun[None], np.zeros((0, 0, 0)), False

    def close(self, slopes: bool) -> bool:
        """Newton's method on the jumps between segments, which moves their starts `begun`; whether it ends.

        With `slopes`, the last pass has them of all samples.
        """
        best = last = np.inf
        idle = 0
        while idle < 6:  # passes in which the jumps do not fall to half
            self.run(slopes and last <= 1e-5)  # jumps that one more step of Newton's method closes
            jumps = self.states[-1][:-1] - self.begun[1:]
            size = np.max(np.abs(self.begun), axis=0) + 1e-300
            gap = float(
                np.max(np.abs(jumps) / np.maximum(size, 1e-6 * np.max(size, initial=0.0)), initial=0.0)
            )
            if gap <= 1e-10:  # jumps between segments over the size of the motion
                if slopes and not self.whole:
                    self.run(True)
                return True
            if not np.isfinite(gap) or gap > 1e3 * max(best, 1.0):
                break
            factor = 1.0 if gap < best * 2 else 0.5
            idle = 0 if gap < best / 2 else idle + 1
            best, last = min(best, gap), gap
            ends = self.along[-1] if self.whole else self.along
            change = np.zeros(self.machine.states)
            for k in range(len(self.begun) - 1):
                change = ends[k][:, : len(change)] @ change + jumps[k]
                self.begun[k + 1] += factor * change
        return False

    def run(self, whole: bool) -> None:
        """One pass over all segments from their own states."""
        machine = self.machine
        first = segments_of(machine.drive.intervals, self.length)
        columns = machine.states + (machine.directions if whole else 0)
        followed = machine.follow(self.begun, first, self.length, columns, self.forces)
        self.states, self.along, self.forces = followed.states, followed.slopes, followed.forces
        self.whole = whole

    def motion(self) -> Real:
        """States at all samples, (samples, states)."""
        # (length + 1, S, states) of segments as (samples, states)
        states = self.states
        intervals = self.machine.drive.intervals
        length, S, x = states[:-1].shape
        body = np.moveaxis(states[:-1], 1, 0).reshape(S * length, x)[:intervals]
        last = intervals - (S - 1) * self.length
        return np.concatenate([body, states[last, -1][None]])

    def slopes(self) -> Real:
        """Slopes of all samples with respect to the record's start, unknowns and offsets, once the jumps are closed."""
        along = self.along
        x, intervals = self.machine.states, self.machine.drive.intervals
        S, Q = along.shape[1], along.shape[-1]
        start = np.zeros((x, Q))
        start[:, :x] = np.eye(x)
        total = np.empty((S, self.length + 1, x, Q))
        for k in range(S):
            within = along[:, k]
            total[k] = within[..., :x] @ start
            total[k, ..., x:] += within[..., x:]
            start = total[k, -1]
        body = total[:, :-1].reshape(S * self.length, x, Q)[:intervals]
        last = intervals - (S - 1) * self.length
        return np.concatenate([body, total[-1, last][None]])
