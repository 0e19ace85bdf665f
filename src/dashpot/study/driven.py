"""The motion of a rig under a record of its inputs, as its channels would show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.errors import ConvergenceError, DataError
from dashpot.estimate.nonlinear.record_problem import enough_substeps
from dashpot.estimate.nonlinear.records import (
    RecordData,
    ShownInputs,
    beside_bases,
    measured_inputs,
    shown_outputs,
    uniform_step,
)
from dashpot.model.channel_noise import noise_sd
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.nonlinear.integration import Integrator
from dashpot.model.nonlinear.moving_base import moving_rig
from dashpot.model.nonlinear.propagation import forcing
from dashpot.model.nonlinear.shooting import integrate
from dashpot.model.observation import ObservationModel, measures_input, observation_model

DEGREE = 7  # of the splines that shift late channels: exact to 1e-3 at four samples a cycle


def driven_record(
    model: Model, theta: Real, channels: Sequence[Channel], drive: Record, rng: np.random.Generator
) -> Record:
    """What the channels show while the inputs do what `drive` measured, from rest; noise included.

    Noise is that of each channel's `noise`, and its `relative_noise` of the channel's largest value.  Inputs that are
    measured as velocity or acceleration are integrated, their mean being taken for the sensor's offset.  Known delays
    of the inputs are taken out, those of `channels` put in; before its start nothing moves.
    Raises DataError where an input is not in `drive` or a channel of a nonlinear rig measures forces in elements,
    ModelError where a linear rig has no motion in time, ConvergenceError where the motion cannot be followed.
    theta (unknowns,), SI units.
    """
    channels = tuple(channels)
    step = uniform_step(drive)
    drive = _on_time(drive, step)
    view = observation_model(model, channels, np.ones(1))
    if len(model.nonlinear):
        values = _nonlinear(view, theta, drive.source, step, measured_inputs(model, drive))
    else:
        p = model.parameters(theta)
        inputs = measured_inputs(model, _as_moved(model, drive, step)).values
        values = channel_samples(view, p, integrator(model, p, step).motion(inputs))
    given = {(tuple(c.of.items()), c.quantity): number for number, c in enumerate(drive.channels)}
    for c, channel in enumerate(channels):
        number = given.get((tuple(channel.of.items()), channel.quantity))
        if number is not None and measures_input(model, channel):
            values[:, c] = drive.values[:, number] / drive.channels[number].factor
    sd = noise_sd(channels, np.max(np.abs(values), axis=0)[None].astype(complex))[0]
    values = _later(values, _delays(channels) / step) + sd * rng.standard_normal(values.shape)
    factor = np.array([channel.factor for channel in channels])
    return Record(channels, drive.time, factor * values, source="simulation")


def _on_time(drive: Record, step: float) -> Record:
    """The record with known delays taken out."""
    channels = tuple(c if c.delay is None else replace(c, delay=0.0) for c in drive.channels)
    return replace(drive, channels=channels, values=_later(drive.values, -_delays(drive.channels) / step))


def _delays(channels: Sequence[Channel]) -> Real:
    """Delays of the channels, (channels,) s, 0 where they are unknown."""
    return np.array([0.0 if channel.delay is None else channel.delay for channel in channels])


def _as_moved(model: Model, drive: Record, step: float) -> Record:
    """The record with inputs as displacements where no sensor shows them as such."""
    channels, values = list(drive.channels), np.array(drive.values)
    moved = [
        c for c, channel in enumerate(channels)
        if measures_input(model, channel) and channel.quantity is not Quantity.FORCE
    ]  # fmt: skip
    shown = {
        point for c in moved if channels[c].quantity is Quantity.DISPLACEMENT for point in channels[c].of
    }
    for c in moved:
        times = {Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}.get(channels[c].quantity, 0)
        if times and not set(channels[c].of) <= shown:
            values[:, c] = _integrated(values[:, c], step, times)
            channels[c] = replace(channels[c], quantity=Quantity.DISPLACEMENT)
    return replace(drive, channels=tuple(channels), values=values)


def _integrated(rates: Real, step: float, times: int) -> Real:
    """Samples (samples,) less their mean, integrated so many times from rest."""
    from scipy.interpolate import CubicSpline

    time = step * np.arange(len(rates))
    spline = CubicSpline(time, rates - np.mean(rates)).antiderivative(times)
    displacement: Real = np.asarray(spline(time), dtype=np.float64)
    return displacement


def _later(values: Real, steps: Real) -> Real:
    """Samples (samples, channels), each channel later by so many steps (channels,); its ends go on as they are."""
    from scipy.interpolate import make_interp_spline

    out = np.array(values, dtype=np.float64)
    index = np.arange(len(values), dtype=np.float64)
    degree = min(DEGREE, (len(values) - 1) // 2 * 2 - 1)
    for c in np.flatnonzero(steps) if degree > 0 else ():
        at = np.clip(index - steps[c], 0.0, index[-1])
        out[:, c] = make_interp_spline(index, values[:, c], k=degree)(at)
    return out


def _nonlinear(view: ObservationModel, theta: Real, source: str, step: float, shown: ShownInputs) -> Real:
    """What the channels of a nonlinear rig show, (samples, channels)."""
    model, channels = view.model, view.channels
    forces = [c.name for c in channels if c.quantity is Quantity.FORCE and not measures_input(model, c)]
    if forces:
        raise DataError(
            f"channel {forces[0]} measures the force in elements, which records in time do not show",
            cure="leave it out of the rig file",
        )
    count = len(channels)
    data = RecordData(
        source, step, tuple(channel.name for channel in channels), shown.values, np.zeros((len(shown.values), count)),
        view.on_x, view.on_q, tuple(int(order) for order in view.derivative), (-1,) * count, (False,) * count,
    )  # fmt: skip
    data = beside_bases(model, data, shown.orders)
    substeps = 2 * enough_substeps(model, theta, step)
    machine = Integrator(
        moving_rig(model, data.bases), theta, forcing(step, data.inputs, data.rated), substeps
    )
    motion = integrate(machine, _at_rest(machine, model, data))
    if not motion.closed:
        raise ConvergenceError("the motion cannot be followed", cure="sample the input faster, or drive less")
    values = shown_outputs(machine, data, motion)[0]
    for c in (c for c, channel in enumerate(channels) if channel.quantity is Quantity.FORCE):
        values[:, c] = data.inputs @ data.on_q[c]
    return values


def _at_rest(machine: Integrator, model: Model, data: RecordData) -> Real:
    """The state (states,) in which the rig does not move, though a base may whose velocity is known."""
    start, bases, n = np.zeros(machine.states), data.bases, model.n
    rates = np.where(np.array(bases.orders) == 1, data.inputs[0, len(model.inputs) - len(bases.names) :], 0.0)
    start[machine.model.n : machine.model.n + n] = -bases.matrix(model.coordinates) @ rates
    start[machine.model.n + n : 2 * machine.model.n] = rates
    return start
