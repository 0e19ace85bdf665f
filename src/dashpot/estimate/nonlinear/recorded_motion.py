"""The motion of a whole record as its channels show it, to begin a search from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.nonlinear.records import RecordData
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw


@dataclass(frozen=True)
class BaseTravel:
    """Where bases known by velocity or acceleration were, travel (samples, bases) in m, as well as channels tell.

    start (bases, 3): their displacement and velocity at the start, and what the measured acceleration lacks; beside:
    rms of the rig's coordinates from where the bases carry them, as far as channels of displacement show them.
    """

    travel: Real
    start: Real
    beside: float


@dataclass(frozen=True)
class RecordedMotion:
    """Displacements of the rig's coordinates x (samples, n) and of its displacement inputs u (samples, r).

    beside (samples, n): the coordinates from where bases that are known by a rate carry them; bases: how these travel.
    """

    x: Real
    u: Real
    beside: Real
    bases: BaseTravel


@dataclass(frozen=True)
class Start:
    """Of a record: the state (states,) of the rig as it moves, and constants that force inputs lack (forces,)."""

    state: Real
    forces: Real


def recorded_motion(model: Model, data: RecordData) -> RecordedMotion | None:
    """The motion of a rig; None where channels of displacement with known gains do not show all its coordinates."""
    C = data.on_x[_displacements(data)][:, : model.n]
    if np.linalg.matrix_rank(C) < model.n if C.size else True:
        return None
    bases = data.bases
    course = base_travel(model, data)
    travel = course.travel
    beside = _beside(model, data, travel)
    x = beside + travel @ bases.matrix(model.coordinates).T
    shown = [j for j, name in enumerate(model.displacement_inputs) if name not in bases.names]
    moved = [model.displacement_inputs.index(name) for name in bases.names]
    u = np.empty((data.samples, len(model.displacement_inputs)))
    u[:, shown], u[:, moved] = data.inputs[:, : len(shown)], travel
    return RecordedMotion(x, u, beside, course)


def start_of(model: Model, data: RecordData, at: RecordedMotion | None) -> Start:
    """Where a record of a rig starts, at rest where no motion is measured."""
    bases = len(data.bases.names)
    n, total = model.n, model.n + bases
    laws = laws_with_state(model)
    state, forces = np.zeros(2 * total + len(laws)), np.zeros(len(model.force_inputs) + bases)
    if at is not None:
        x = at.beside
        for i, (row, law) in enumerate(laws, 2 * total):
            if law.operator == "play":  # the middle of where it may be: an edge would hold it
                state[i] = at.x[0] @ model.B[row] + at.u[0] @ model.D[row]
        state[:n] = x[0]
        state[total : total + n] = (-3 * x[0] + 4 * x[1] - x[2]) / (2 * data.step_s)
    if bases:
        base = (base_travel(model, data) if at is None else at.bases).start
        state[n:total], state[total + n : 2 * total], forces[-bases:] = base.T
    return Start(state, forces)


def laws_with_state(model: Model) -> list[tuple[int, ForceLaw]]:
    """Elements whose laws carry a state, by their rows, in order."""
    laws = [(row, element.force_law) for row, element in enumerate(model.elements)]
    return [(row, law) for row, law in laws if law is not None and law.has_state]


def largest_states(model: Model, theta: Real, data: RecordData, at: RecordedMotion | None) -> Real:
    """How large the states of laws may be, (laws with a state,) m: as elongations, and the width of stop and play.

    Where no motion is measured, as the displacement inputs.  theta (unknowns,).
    """
    largest = []
    inner = dict(zip(model.nonlinear.tolist(), model.constant_slices, strict=True))
    constants = model.inner_constants(theta)
    for row, law in laws_with_state(model):
        if at is not None:
            d = at.x @ model.B[row] + at.u @ model.D[row]
        else:
            shown = [j for j, name in enumerate(model.displacement_inputs) if name not in data.bases.names]
            d = data.inputs[:, : len(shown)] @ model.D[row, shown]
        width = abs(float(constants[inner[row]][0])) if law.operator else 0.0
        largest.append(float(np.max(np.abs(d))) + width)
    sizes = np.array(largest)
    return np.where(sizes > 0, sizes, 1.0)


def base_travel(model: Model, data: RecordData) -> BaseTravel:
    """How the bases travel: what was measured, integrated, and a course with which the rig moves least beside them."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    count = len(data.bases.names)
    travel, start = np.zeros((data.samples, count)), np.zeros((count, 3))
    if not count:
        return BaseTravel(travel, start, 0.0)
    time = data.step_s * np.arange(data.samples)
    measured = data.inputs[:, -count:]
    for j, order in enumerate(data.bases.orders):
        travel[:, j] = CubicSpline(time, measured[:, j]).antiderivative(order)(time)
        start[j, 1] = measured[0, j] if order == 1 else 0.0
    chosen = _displacements(data)
    reach = np.linalg.pinv(data.on_x[chosen][:, : model.n]) @ data.on_x[chosen][:, model.n :]  # (n, bases)
    beside = _beside(model, data, travel)
    if not chosen:  # nothing shows where the bases are: they travel as little as they may
        courses = np.stack([np.ones_like(time), time, time**2 / 2], axis=1)
        course = np.linalg.lstsq(courses, -travel, rcond=None)[0].T
        course[np.array(data.bases.orders) == 1, 2] = 0.0
        travel, start = travel + courses @ course.T, start + course
    if np.any(reach):
        courses, begun = _courses(data)
        columns = np.einsum("tk,nj->tnjk", courses, reach).reshape(beside.size, -1)
        size = np.linalg.norm(columns, axis=0)
        size = np.where(size > 0, size, 1.0)
        course = (np.linalg.lstsq(columns / size, beside.ravel(), rcond=None)[0] / size).reshape(count, -1)
        moved = courses @ course.T
        travel, start, beside = travel + moved, start + course @ begun, beside - moved @ reach.T
    return BaseTravel(travel, start, float(np.sqrt(np.mean(beside**2))) if len(chosen) else 0.0)


def _courses(data: RecordData) -> tuple[Real, Real]:
    """Courses (samples, k) that bases may take beside what was measured, and how these begin, (k, 3).

    Value, rate, bend; parabolas, or splines where noise of the rates moves bases otherwise.
    """
    from scipy.interpolate import BSpline

    time = data.step_s * np.arange(data.samples)
    if not data.steady:
        return np.stack([np.ones_like(time), time, time**2 / 2], axis=1), np.eye(3)
    knots = np.linspace(0, time[-1], max(data.samples // data.steady, 1) + 1)
    padded = np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])
    spline = BSpline(padded, np.eye(len(padded) - 4), 3)
    # The bend is that of the noise at its start, not a constant of the sensor.
    return spline(time), np.stack([spline(0.0), spline(0.0, 1), np.zeros(len(padded) - 4)], axis=1)


def _displacements(data: RecordData) -> list[int]:
    """Channels of displacement with known gains."""
    return [c for c in range(len(data.names)) if data.derivative[c] == 0 and data.gain[c] < 0]


def _beside(model: Model, data: RecordData, travel: Real) -> Real:
    """Coordinates from where the bases carry them, (samples, n), as channels of displacement show them."""
    chosen = _displacements(data)
    seen = data.outputs[:, chosen] - data.inputs @ data.on_q[chosen].T
    seen = seen - travel @ data.on_x[chosen][:, model.n :].T
    y: Real = seen @ np.linalg.pinv(data.on_x[chosen][:, : model.n]).T
    return y
