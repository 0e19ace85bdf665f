"""Whole motions by multiple shooting (THEORY §9).

A record is cut into segments that are integrated side by side from states of their own; the jumps between them are
closed by Newton's method over the chain of segments.  That is the same motion as one long integration, in as many
array operations as one segment has samples.  Source: Bock and Plitt (1984), 9th IFAC World Congress.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.model.nonlinear.integration import Integrator, Motion

CLOSED = 1e-10  # jumps between segments over the size of the motion
SWEEPS = 30
SEGMENT = 32  # samples of a segment, about


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
