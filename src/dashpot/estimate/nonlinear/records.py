"""Whole records of a nonlinear rig: the measured channels, and what a motion shows of them (THEORY §9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.still import Still
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.nonlinear.integration import Integrator, Motion
from dashpot.model.nonlinear.moving_base import NO_BASES, Bases, bases_of
from dashpot.model.observation import measures_input, observation_model

UNIFORM = 1e-3  # of the step: how far sample times may lie off
EXACT = 1e-9  # of an input: how much of others may be in what channels show of it


@dataclass(frozen=True)
class RecordData:
    """One record, arranged: inputs (samples, r + s) and outputs (samples, channels) in SI units on one uniform clock.

    on_x (channels, n), on_q (channels, r + s), derivative (channels,): what the outputs show; gain (channels,): index
    of an unknown gain, −1 where known; drift (channels,): whether the sensor's zero is unknown.
    bases: those known by velocity or acceleration, which stand behind the coordinates in n and behind the forces in s;
    rated (r + s,): which inputs are such velocities, none where it is empty; steady: samples over which noise of these
    rates hardly moves a base, whose place the outputs show; all of them where it is 0.
    """

    source: str
    step_s: float
    names: tuple[str, ...]
    inputs: Real
    outputs: Real
    on_x: Real
    on_q: Real
    derivative: tuple[int, ...]
    gain: tuple[int, ...]
    drift: tuple[bool, ...]
    bases: Bases = NO_BASES
    rated: tuple[bool, ...] = ()
    steady: int = 0

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.outputs)


def arranged(model: Model, record: Record) -> RecordData:
    """Raises DataError where an input is not measured, a channel cannot be compared with a motion, or times slip."""
    step = uniform_step(record)
    view = observation_model(model, record.channels, np.ones(1))
    shown = measured_inputs(model, record)
    values = record.values / _calibration(record)
    outputs = [i for i, channel in enumerate(record.channels) if not measures_input(model, channel)]
    _require_motion(record, outputs)
    by_force = bool(len(model.force_inputs))
    data = RecordData(
        record.source, step, tuple(record.channels[i].name for i in outputs), shown.values, values[:, outputs],
        view.on_x[outputs], view.on_q[outputs], tuple(int(view.derivative[i]) for i in outputs),
        tuple(int(view.gain[i]) for i in outputs),
        tuple(int(view.derivative[i]) > 0 or not by_force for i in outputs),
    )  # fmt: skip
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
    return replace(
        data, inputs=inputs, on_x=np.concatenate([data.on_x, on_base], axis=1), on_q=on_q, bases=bases,
        rated=(*[False] * first, *(orders[j] == 1 for j in moved)),
    )  # fmt: skip


def in_pieces(data: RecordData) -> list[RecordData]:
    """A record in pieces of its steady length, about."""
    count = max(data.samples // data.steady, 1) if data.steady else 1
    edges = np.linspace(0, data.samples, count + 1).astype(int).tolist()
    parts = [slice(first, last) for first, last in pairwise(edges)]
    return [replace(data, inputs=data.inputs[part], outputs=data.outputs[part], steady=0) for part in parts]


@dataclass(frozen=True)
class ShownInputs:
    """The inputs as their channels show them: values (samples, r + s), SI units; orders (r + s,): which derivative."""

    values: Real
    orders: tuple[int, ...]


def measured_inputs(model: Model, record: Record) -> ShownInputs:
    """The inputs of a record.  Raises DataError where one is missing."""
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
            if measures_input(model, channel) and view.derivative[i] == order and view.gain[i] < 0
            and not np.any(view.on_q[i, ~open_])
        ]  # fmt: skip
        C = view.on_q[usable]
        if not C.size:
            continue
        inverse = np.linalg.pinv(C)
        told = open_ & (np.max(np.abs(inverse @ C - np.eye(q)), axis=1) < EXACT)
        weights[np.ix_(told, usable)] = inverse[told]
        orders[told] = order
    if np.any(orders < 0):
        raise DataError(
            "an input of the rig is not measured",
            record.source,
            "give every moved point a channel of displacement, velocity or acceleration, and every force one of force, "
            "with a known gain",
        )
    return weights, tuple(orders.tolist())


@dataclass(frozen=True)
class NoiseAtRest:
    """Standard deviations of the outputs (channels,) and variances of the inputs (q,) in a record at rest."""

    outputs: Real
    inputs: Real


def noise_of_channels(model: Model, record: Record, still: Still) -> NoiseAtRest:
    """What a record at rest shows of the noise of a record's outputs and inputs.

    Raises DataError where it has other channels, or one of the outputs shows no noise.
    """
    if still.power.shape[1] != len(record.channels):
        raise DataError("the record at rest has other channels", record.source, "record all of them at rest")
    factor = _calibration(record)
    covariance = np.mean(still.power, axis=0).real / (4 * np.outer(factor, factor))  # power is 4 σ²
    outputs = [i for i, channel in enumerate(record.channels) if not measures_input(model, channel)]
    sd = np.sqrt(np.diagonal(covariance)[outputs])
    if not np.all(sd > 0):
        name = record.channels[outputs[int(np.argmin(sd))]].name
        raise DataError(
            f"the record at rest shows no noise of {name}", cure="record it with the sensor connected"
        )
    weights, orders = _input_channels(model, record)
    inputs = np.einsum("qc,cd,qd->q", weights, covariance, weights)
    return NoiseAtRest(sd, inputs[np.argsort(np.array(orders) > 0, kind="stable")])


def uniform_step(record: Record) -> float:
    """The sampling step, s.  Raises DataError where samples are not evenly spaced."""
    step = float((record.time[-1] - record.time[0]) / (len(record.time) - 1))
    slip = np.max(np.abs(record.time - record.time[0] - step * np.arange(len(record.time))))
    if slip > UNIFORM * step * max(1.0, 0.01 * len(record.time)) and slip > 0.5 * step:
        raise DataError(
            "the samples are not evenly spaced",
            record.source,
            "resample the record, or cut it where the clock slips",
        )
    return step


def _calibration(record: Record) -> Real:
    """Known gains and signs of the channels, 1 where they are unknown; (channels,).

    Raises DataError where a channel has a delay or an unknown sign.
    """
    for channel in record.channels:
        if channel.delay is None or channel.delay != 0 or (channel.sign is None and channel.gain is not None):
            raise DataError(
                f"channel {channel.name} has a delay or an unknown sign, which whole records of nonlinear rigs "
                "cannot have",
                record.source,
                'shift the record, or write gain = "unknown" for the sign',
            )
    known = np.array([c.gain if c.gain is not None else 1.0 for c in record.channels])
    sign = np.array([c.sign if c.sign is not None else 1.0 for c in record.channels])
    factors: Real = known * sign
    return factors


def _require_motion(record: Record, outputs: Sequence[int]) -> None:
    """Raises DataError where no channel shows the motion, one stands still, or one shows a force in elements."""
    if not outputs:
        raise DataError("no channel shows the motion", record.source, "measure a coordinate")
    still = [record.channels[i].name for i in outputs if not np.ptp(record.values[:, i]) > 0]
    if still:
        raise DataError(
            f"{joined(still)} show{'s' if len(still) == 1 else ''} no motion: the samples are all one number",
            record.source,
            "check that the sensor is connected, or leave the channel out of the rig file",
        )
    forces = [record.channels[i].name for i in outputs if record.channels[i].quantity is Quantity.FORCE]
    if forces:
        raise DataError(
            f"channel {forces[0]} measures the force in elements, which whole records of nonlinear rigs do not use",
            record.source,
            "leave it out of the rig file",
        )


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
    return y, J


def total_samples(records: Sequence[RecordData]) -> int:
    """Numbers measured in all records."""
    return sum(record.outputs.size for record in records)
