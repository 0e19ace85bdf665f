"""Whole records of a nonlinear rig: the measured channels, and what a motion shows of them (THEORY §9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.unmeasured import with_likely
from dashpot.data.noise import Still
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw
from dashpot.model.nonlinear.integration import NO_BASES, Bases, Integrator, Motion, bases_of
from dashpot.model.observation import channel_incidence, measures_input, observation_model
from dashpot.unknowns import Unknown


@dataclass(frozen=True)
class RecordData:
    """One record, arranged: inputs (samples, r + s) and outputs (samples, channels) in SI units on one uniform clock.

    channels: of the outputs; on_x (channels, n), on_q (channels, r + s), derivative (channels,): what they show of the
    motion, force (channels, elements): of the forces in the first elements of the rig as it moves; gain (channels,):
    index of an unknown gain, −1 where known; drift (channels,): whether the sensor's zero is unknown.
    bases: those known by velocity or acceleration, which stand behind the coordinates in n and behind the forces in s;
    rated (r + s,): which inputs are such velocities, none where it is empty; steady: samples over which noise of these
    rates hardly moves a base, whose place the outputs show; all of them where it is 0.  counts (samples, channels):
    which outputs were measured, all where it is None; the others are likely ones.
    """

    source: str
    step_s: float
    channels: tuple[Channel, ...]
    inputs: Real
    outputs: Real
    on_x: Real
    on_q: Real
    force: Real
    derivative: tuple[int, ...]
    gain: tuple[int, ...]
    drift: tuple[bool, ...]
    bases: Bases = NO_BASES
    rated: tuple[bool, ...] = ()
    steady: int = 0
    gains: tuple[Unknown, ...] = ()
    counts: Bools | None = None

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.outputs)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the channels."""
        return tuple(channel.name for channel in self.channels)

    def with_forces_of(self, rig: Model, count: int) -> RecordData:
        """The same with what the channels show of the forces in the last `count` elements of a larger rig."""
        force = channel_incidence(rig, self.channels)[2][:, len(rig.elements) - count :]
        return replace(self, force=np.hstack([self.force, force]))

    def part(self, samples: slice) -> RecordData:
        """Some of its samples."""
        counts = None if self.counts is None else self.counts[samples]
        return replace(self, inputs=self.inputs[samples], outputs=self.outputs[samples], counts=counts)

    @property
    def numbers(self) -> int:
        """Of outputs that were measured."""
        return self.outputs.size if self.counts is None else int(np.count_nonzero(self.counts))

    def judged(self, values: Real) -> Real:
        """Values (samples, channels, …) less their mean where the zero is unknown, 0 where nothing was measured."""
        axes = (slice(None), slice(None), *[None] * (values.ndim - 2))
        drift = np.array(self.drift)[axes[1:]]
        if self.counts is None:
            return values - np.where(drift, np.mean(values, axis=0), 0.0)
        counts = self.counts[axes]
        mean = np.sum(np.where(counts, values, 0.0), axis=0) / np.maximum(np.sum(counts, axis=0), 1)
        return np.where(counts, values - np.where(drift, mean, 0.0), 0.0)


def arranged(model: Model, record: Record) -> RecordData:
    """Raises DataError if an input is not measured, a channel cannot be compared with a motion, or times slip."""
    step = uniform_step(record)
    measured = None if record.status is None else record.status == 0
    record = record if measured is None else with_likely(record)[0]
    view = observation_model(model, record.channels, np.ones(1))
    shown = measured_inputs(model, record)
    values = record.values / _calibration(record)
    outputs = [i for i, channel in enumerate(record.channels) if not measures_input(model, channel)]
    if not outputs:
        raise DataError("no channel shows the motion", record.source, "measure a coordinate")
    still = [record.channels[i].name for i in outputs if not np.ptp(record.values[:, i]) > 0]
    if still:
        raise DataError(
            f"{joined(still)} show{'s' if len(still) == 1 else ''} no motion: all samples have the same "
            "value",
            record.source,
            "check that the sensor is connected, or leave the channel out of the rig file",
        )
    orders = tuple(int(view.derivative[i]) for i in outputs)
    data = RecordData(
        record.source,
        step,
        tuple(record.channels[i] for i in outputs),
        shown.values,
        values[:, outputs],
        view.on_x[outputs],
        view.on_q[outputs],
        view.force[outputs],
        derivative=orders,
        gain=tuple(int(view.gain[i]) for i in outputs),
        drift=tuple(order > 0 or not model.force_inputs for order in orders),
        gains=view.unknowns[view.m : view.m + view.gains],
        counts=None if measured is None else measured[:, outputs],
    )
    return beside_bases(model, data, shown.orders)


def beside_bases(model: Model, data: RecordData, orders: Sequence[int]) -> RecordData:
    """The record with inputs known by a derivative, of these orders (r + s,), as bases that move by themselves.

    The mean of a velocity or an acceleration counts as its sensor's offset.
    """
    moved: list[int] = np.flatnonzero(orders).tolist()
    if not moved:
        return data
    bases = bases_of(model, {model.displacement_inputs[j]: orders[j] for j in moved})
    order = [*np.flatnonzero(np.asarray(orders) == 0), *moved]
    inputs, on_q = data.inputs[:, order].copy(), data.on_q[:, order]
    first = len(order) - len(moved)
    inputs[:, first:] -= np.mean(inputs[:, first:], axis=0)
    on_base = data.on_x @ bases.matrix(model.coordinates) + on_q[:, first:]
    on_q[:, first:] = 0.0
    rated = (*[False] * first, *(orders[j] == 1 for j in moved))
    on_x = np.concatenate([data.on_x, on_base], axis=1)
    force = np.pad(data.force, ((0, 0), (0, len(moved))))  # behind the rig's own, what makes the bases heavy
    return replace(data, inputs=inputs, on_x=on_x, on_q=on_q, force=force, bases=bases, rated=rated)


def in_pieces(data: RecordData) -> list[RecordData]:
    """A record in pieces of its steady length, about."""
    count = max(data.samples // data.steady, 1) if data.steady else 1
    edges = np.linspace(0, data.samples, count + 1).astype(int).tolist()
    return [replace(data.part(slice(*ends)), steady=0) for ends in pairwise(edges)]


@dataclass(frozen=True)
class ShownInputs:
    """The inputs as their channels show them: values (samples, r + s), SI units; orders (r + s,): which derivative."""

    values: Real
    orders: tuple[int, ...]


def measured_inputs(model: Model, record: Record) -> ShownInputs:
    """The inputs of a record.  Raises DataError if one is missing."""
    weights, orders = _input_channels(model, record)
    return ShownInputs((record.values / _calibration(record)) @ weights.T, orders)


def _input_channels(model: Model, record: Record) -> tuple[Real, tuple[int, ...]]:
    """Weights (r + s, channels) with which the inputs follow from the channels, and the derivatives that follow.

    Displacements and forces come first, then velocities, then accelerations.
    """
    view = observation_model(model, record.channels, np.ones(1))
    q = view.on_q.shape[1]
    weights, orders = np.zeros((q, len(record.channels))), np.full(q, -1)
    for order in range(3):
        open_ = orders < 0
        usable = [
            i
            for i, channel in enumerate(record.channels)
            if measures_input(model, channel)
            and view.derivative[i] == order
            and view.gain[i] < 0
            and not np.any(view.on_q[i, ~open_])
        ]
        C = view.on_q[usable]
        if not C.size:
            continue
        inverse = np.linalg.pinv(C)
        told = open_ & (np.max(np.abs(inverse @ C - np.eye(q)), axis=1) < 1e-9)
        weights[np.ix_(told, usable)] = inverse[told]
        orders[told] = order
    if np.any(orders < 0):
        raise DataError(
            "an input of the rig is not measured",
            record.source,
            "give every moving input a channel of displacement, velocity or acceleration, and every "
            "force a force channel, with a known gain",
        )
    return weights, tuple(orders.tolist())


@dataclass(frozen=True)
class NoiseAtRest:
    """Standard deviations of the outputs (channels,) and variances of the inputs (q,) in a record at rest."""

    outputs: Real
    inputs: Real


def noise_of_channels(model: Model, record: Record, still: Still) -> NoiseAtRest:
    """What a record at rest shows of the noise of a record's outputs and inputs.

    Raises DataError if it has other channels, or one of the outputs shows no noise.
    """
    if still.power.shape[1] != len(record.channels):
        raise DataError("the at-rest record has other channels", record.source, "record all of them at rest")
    factor = _calibration(record)
    covariance = np.mean(still.power, axis=0).real / (4 * np.outer(factor, factor))  # power is 4 σ²
    outputs = [i for i, channel in enumerate(record.channels) if not measures_input(model, channel)]
    sd = np.sqrt(np.diagonal(covariance)[outputs])
    if not np.all(sd > 0):
        name = record.channels[outputs[int(np.argmin(sd))]].name
        raise DataError(
            f"the at-rest record shows no noise of {name}", cure="record it with the sensor connected"
        )
    weights, orders = _input_channels(model, record)
    inputs = np.einsum("qc,cd,qd->q", weights, covariance, weights)
    return NoiseAtRest(sd, inputs[np.argsort(np.array(orders) > 0, kind="stable")])


def uniform_step(record: Record) -> float:
    """The sampling step, s.  Raises DataError if samples are not evenly spaced."""
    step = record.step_s
    slip = np.max(np.abs(record.time - record.time[0] - step * np.arange(len(record.time))))
    if slip > 0.5 * step and slip > 1e-3 * step * max(1.0, 0.01 * len(record.time)):
        raise DataError(
            "the samples are not evenly spaced",
            record.source,
            "resample the record, or split it where the clock slips",
        )
    return step


def _calibration(record: Record) -> Real:
    """Known gains and signs of the channels, 1 where they are unknown; (channels,).

    Raises DataError if a channel has a delay or an unknown sign.
    """
    for channel in record.channels:
        if channel.delay is None or channel.delay != 0 or (channel.sign is None and channel.gain is not None):
            raise DataError(
                f"channel {channel.name} has a delay or an unknown sign, which continuous records of "
                "nonlinear rigs do not support",
                record.source,
                'shift the record, or write gain = "unknown" for the sign',
            )
    known = np.array([c.gain if c.gain is not None else 1.0 for c in record.channels])
    sign = np.array([c.sign if c.sign is not None else 1.0 for c in record.channels])
    return known * sign


def shown_outputs(machine: Integrator, data: RecordData, motion: Motion) -> tuple[Real, Real | None]:
    """Outputs of a motion before gains, (samples, channels), and slopes along states, unknowns and offsets."""
    model = machine.model
    n = model.n
    rates = [motion.state[:, :n], motion.state[:, n : 2 * n]]
    slopes = None if motion.slope is None else [motion.slope[:, :n], motion.slope[:, n : 2 * n]]
    if max(data.derivative) == 2:
        acceleration, slope = machine.acceleration(motion)
        rates.append(acceleration)
        if slopes is not None and slope is not None:
            slopes.append(slope)
    base = [data.inputs[:, : model.D.shape[1]]]
    if max(data.derivative) > 0:
        base += machine.input_rates()
    y = np.empty((data.samples, len(data.names)))
    J = None if slopes is None else np.empty((data.samples, len(data.names), slopes[0].shape[-1]))
    r = model.D.shape[1]
    for c, power in enumerate(data.derivative):
        y[:, c] = rates[power] @ data.on_x[c] + base[power] @ data.on_q[c, :r]
        if J is not None and slopes is not None:
            J[:, c] = np.einsum("n,tnq->tq", data.on_x[c], slopes[power])
    if np.any(data.force):
        known = data.force.shape[1]
        forces, by = machine.element_forces(motion)
        y += forces[:, :known] @ data.force.T
        if J is not None and by is not None:
            J += data.force @ by[:, :known]
    return y, J


def total_samples(records: Sequence[RecordData]) -> int:
    """Numbers measured in all records."""
    return sum(record.numbers for record in records)


# The motion of a whole record as its channels show it, to begin a search from.


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


def recorded_motion(model: Model, data: RecordData) -> RecordedMotion | None:
    """The motion of a rig; None if channels of displacement with known gains do not show all its coordinates."""
    C = data.on_x[displacement_channels(data)][:, : model.n]
    if model.n and not (C.size and np.linalg.matrix_rank(C) == model.n):
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


def start_of(model: Model, data: RecordData, at: RecordedMotion | None) -> tuple[Real, Real]:
    """Where a record of a rig starts, at rest where no motion is measured.

    The state (states,) of the rig as it moves, and constants that force inputs lack (forces,).
    """
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
    return state, forces


def laws_with_state(model: Model) -> list[tuple[int, ForceLaw]]:
    """Elements whose laws carry a state, by their rows, in order; once for each of their states."""
    pairs = zip(model.nonlinear.tolist(), model.laws, strict=True)
    return [(row, law) for row, law in pairs for _ in range(law.states)]


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
    """How the bases travel: what was measured, integrated, and the course about which the rig moves least."""
    from scipy.interpolate import BSpline, CubicSpline  # with them comes all of scipy.optimize

    count = len(data.bases.names)
    travel, start = np.zeros((data.samples, count)), np.zeros((count, 3))
    if not count:
        return BaseTravel(travel, start, 0.0)
    time = data.step_s * np.arange(data.samples)
    measured = data.inputs[:, -count:]
    for j, order in enumerate(data.bases.orders):
        travel[:, j] = CubicSpline(time, measured[:, j]).antiderivative(order)(time)
        start[j, 1] = measured[0, j] if order == 1 else 0.0
    chosen = displacement_channels(data)
    reach = np.linalg.pinv(data.on_x[chosen][:, : model.n]) @ data.on_x[chosen][:, model.n :]  # (n, bases)
    beside = _beside(model, data, travel)
    if not chosen:  # nothing shows where the bases are: they travel as little as they may
        courses = np.stack([np.ones_like(time), time, time**2 / 2], axis=1)
        course = np.linalg.lstsq(courses, -travel, rcond=None)[0].T
        course[np.array(data.bases.orders) == 1, 2] = 0.0
        travel, start = travel + courses @ course.T, start + course
    if np.any(reach):
        # Courses (samples, k) that bases may take besides what was measured, and how these begin, (k, 3): value, rate,
        # bend; parabolas, or splines where noise of the rates moves bases otherwise
        courses, begun = np.stack([np.ones_like(time), time, time**2 / 2], axis=1), np.eye(3)
        if data.steady:
            knots = np.linspace(0, time[-1], max(data.samples // data.steady, 1) + 1)
            padded = np.concatenate([np.repeat(knots[0], 3), knots, np.repeat(knots[-1], 3)])
            spline = BSpline(padded, np.eye(len(padded) - 4), 3)
            # The bend is that of the noise at its start, not a constant of the sensor.
            begun = np.stack([spline(0.0), spline(0.0, 1), np.zeros(len(padded) - 4)], axis=1)
            courses = spline(time)
        columns = np.einsum("tk,nj->tnjk", courses, reach).reshape(beside.size, -1)
        size = np.linalg.norm(columns, axis=0)
        size = np.where(size > 0, size, 1.0)
        course = (np.linalg.lstsq(columns / size, beside.ravel(), rcond=None)[0] / size).reshape(count, -1)
        moved = courses @ course.T
        travel, start, beside = travel + moved, start + course @ begun, beside - moved @ reach.T
    return BaseTravel(travel, start, float(np.sqrt(np.mean(beside**2))) if len(chosen) else 0.0)


def displacement_channels(data: RecordData) -> list[int]:
    """Channels of displacement with known gains."""
    shown = [not np.any(force) for force in data.force]
    return [c for c, there in enumerate(shown) if there and data.derivative[c] == 0 and data.gain[c] < 0]


def _beside(model: Model, data: RecordData, travel: Real) -> Real:
    """Coordinates from where the bases carry them, (samples, n), as channels of displacement show them."""
    chosen = displacement_channels(data)
    seen = data.outputs[:, chosen] - data.inputs @ data.on_q[chosen].T
    seen = seen - travel @ data.on_x[chosen][:, model.n :].T
    return seen @ np.linalg.pinv(data.on_x[chosen][:, : model.n]).T
