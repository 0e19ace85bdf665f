"""Whole motions by multiple shooting (THEORY §9).

A record is cut into segments that are integrated side by side from states of their own; the jumps between them are
closed by Newton's method over the chain of segments.  That is the same motion as one long integration, in as many
array operations as one segment has samples.  Source: Bock and Plitt (1984), 9th IFAC World Congress.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.model.nonlinear.integration import Integrator, Motion, PointForces


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
                chain.begun, chain.forces = _marched(machine, start, length), {}
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
        """Newton's method on the jumps between segments, of which `begun` changes; whether it ends.

        With `slopes`, the last pass has them of all samples.
        """
        best = last = np.inf
        idle = 0
        while idle < 6:  # passes in which the jumps do not fall to half
            self.run(slopes and last <= 1e-5)  # jumps that one more step of Newton's method closes
            jumps = self.states[-1][:-1] - self.begun[1:]
            size = np.max(np.abs(self.begun), axis=0) + 1e-300
            gap = float(np.max(np.abs(jumps) / np.maximum(size, 1e-6 * np.max(size)), initial=0.0))
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
        machine, (S, x) = self.machine, self.begun.shape
        first = segments_of(machine.drive.intervals, self.length)
        state, slope = self.begun, np.zeros((S, x, x + (machine.directions if whole else 0)))
        slope[:, range(x), range(x)] = 1.0
        states, along = [state], [slope]
        last = machine.drive.intervals * machine.substeps - 1
        for step in range(self.length * machine.substeps):
            index = np.minimum(first * machine.substeps + step, last)
            stepped = machine.advance(state, slope, index, whole, self.forces.get(step))
            state, slope, self.forces[step] = stepped.state, stepped.slope, stepped.forces
            if (step + 1) % machine.substeps == 0:
                states.append(state)
                if whole:
                    along.append(slope)
        self.states, self.whole = np.array(states), whole
        self.along = np.array(along) if whole else slope

    def motion(self) -> Real:
        """States at all samples, (samples, states)."""
        # (length + 1, S, states) of segments as (samples, states)
        states = self.states
        intervals = self.machine.drive.intervals
        body = np.moveaxis(states[:-1], 1, 0).reshape(-1, states.shape[-1])[:intervals]
        last = intervals - (states.shape[1] - 1) * self.length
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
        body = total[:, :-1].reshape(-1, x, Q)[:intervals]
        last = intervals - (S - 1) * self.length
        return np.concatenate([body, total[-1, last][None]])


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
