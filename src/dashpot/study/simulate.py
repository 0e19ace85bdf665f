"""Simulated tests: records sample by sample, or spectra drawn at once with exactly the same distribution.

With independent Gaussian noise of sd σ_c on N samples, least squares for trend and fundamental gives coefficients
β̂ ~ N(β, P σ_c²), P = (Hᵀ M H)⁻¹, and an independent residual product matrix R ~ Wishart(N − terms, diag σ²); H holds
cos ωt and sin ωt, M takes the trend out.  Amplitudes, estimated covariance and second moments are functions of (β̂, R)
alone, so a repeat costs two numbers a channel and a triangle of q (q + 1)/2 instead of N q samples.  Muirhead (1982),
theorems 3.1.2 and 3.2.14 (Bartlett's decomposition).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander

from dashpot.arrays import Complex, Ints, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.data.spectrum import Moments, SettledDwell, Spectrum
from dashpot.design.test_setup import drive_at_limits
from dashpot.errors import ConvergenceError, DataError, UsageError
from dashpot.estimate.nonlinear.record_problem import enough_substeps
from dashpot.estimate.nonlinear.records import (
    RecordData,
    ShownInputs,
    beside_bases,
    measured_inputs,
    shown_outputs,
    uniform_step,
)
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import matrices, response, unit_forces
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.nonlinear.continuation import channel_harmonics, grown_from_rest
from dashpot.model.nonlinear.harmonic_balance import Periodic, periodic_response, settled_orders
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.nonlinear.integration import Integrator, forcing, moving_rig
from dashpot.model.nonlinear.shooting import integrate
from dashpot.model.observation import (
    ObservationModel,
    calibration_indices,
    channel_amplitudes,
    input_channels,
    measures_input,
    noise_sd,
    nominal_calibrations,
    observation_model,
    unknown_calibrations,
)
from dashpot.model.rigfile.rig import ShakerLimits
from dashpot.quantities import LARGEST, SMALLEST

# The motion of a rig under a record of its inputs, as its channels would show it.


def driven_record(
    model: Model, theta: Real, channels: Sequence[Channel], drive: Record, rng: np.random.Generator
) -> Record:
    """What the channels show while the inputs do what `drive` measured, from rest; noise included.

    Noise is that of each channel's `noise`, and its `relative_noise` of the channel's largest value.  Inputs that are
    measured as velocity or acceleration are integrated, their mean being taken for the sensor's offset.  Known delays
    of the inputs are taken out, those of `channels` put in; before its start nothing moves.
    Raises DataError if an input is not in `drive`, ModelError if a linear rig has no motion in time,
    ConvergenceError if the motion cannot be followed.
    theta (unknowns,), SI units.
    """
    channels = tuple(channels)
    step = uniform_step(drive)
    on_time = tuple(c if c.delay is None else replace(c, delay=0.0) for c in drive.channels)
    drive = replace(drive, channels=on_time, values=_later(drive.values, -_delays(drive.channels) / step))
    view = observation_model(model, channels, np.ones(1))
    inputs = measured_inputs(model, drive if len(model.nonlinear) else _integrated(model, drive, step))
    values = _shown(view, theta, drive.source, step, inputs)
    given = {(tuple(c.of.items()), c.quantity): number for number, c in enumerate(drive.channels)}
    for c, channel in enumerate(channels):
        number = given.get((tuple(channel.of.items()), channel.quantity))
        if number is not None and measures_input(model, channel):
            values[:, c] = drive.values[:, number] / drive.channels[number].factor
    return _recorded(channels, drive.time, values, rng)


def released_record(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    held: Mapping[str, float],
    time: Real,
    rng: np.random.Generator,
) -> Record:
    """What the channels show of a rig that is held at coordinates by name (m or rad) and let go at the first instant.

    The others hang in its linear springs, inputs rest, and noise is that of `driven_record`.  time (samples,), evenly
    spaced, s; theta (unknowns,), SI units.  Raises UsageError for an unknown coordinate, and as `driven_record`.
    """
    channels = tuple(channels)
    for name in held:
        if name not in model.coordinates:
            raise UsageError(
                f"{name} is not a coordinate of the rig",
                cure=f"its coordinates are {', '.join(model.coordinates)}",
            )
    K = matrices(model, model.parameters(theta)).K
    x = np.array([held.get(name, 0.0) for name in model.coordinates])
    free = np.array([name not in held for name in model.coordinates])
    x[free] = -np.linalg.lstsq(K[np.ix_(free, free)], K[np.ix_(free, ~free)] @ x[~free], rcond=1e-12)[0]
    start = np.append(x, np.zeros(model.n))
    step = float(time[-1] - time[0]) / (len(time) - 1)
    view = observation_model(model, channels, np.ones(1))
    count = model.D.shape[1] + model.S.shape[1]
    at_rest = ShownInputs(np.zeros((len(time), count)), (0,) * count)
    return _recorded(channels, time, _shown(view, theta, "simulation", step, at_rest, start), rng)


def _integrated(model: Model, drive: Record, step: float) -> Record:
    """The drive of a linear rig with velocities and accelerations of inputs as displacements, where it has none."""
    from scipy.interpolate import CubicSpline

    sensors, values = list(drive.channels), np.array(drive.values)
    moved = [
        c
        for c, channel in enumerate(sensors)
        if measures_input(model, channel) and channel.quantity is not Quantity.FORCE
    ]
    shown = {point for c in moved if sensors[c].quantity is Quantity.DISPLACEMENT for point in sensors[c].of}
    time = step * np.arange(len(values))
    for c in moved:
        times = {Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}.get(sensors[c].quantity, 0)
        if times and not set(sensors[c].of) <= shown:
            rates = values[:, c] - np.mean(values[:, c])
            values[:, c] = CubicSpline(time, rates).antiderivative(times)(time)
            sensors[c] = replace(sensors[c], quantity=Quantity.DISPLACEMENT)
    return replace(drive, channels=tuple(sensors), values=values)


def _recorded(channels: tuple[Channel, ...], time: Real, values: Real, rng: np.random.Generator) -> Record:
    """The record of channels whose values are these (samples, channels), SI units: calibrations and noise put in."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    gain, late = true_calibrations(channels, rng)
    values = values * gain
    sd = noise_sd(channels, np.max(np.abs(values), axis=0)[None].astype(complex))[0]
    values = _later(values, (_delays(channels) + late) / step) + sd * rng.standard_normal(values.shape)
    factor = np.array([channel.factor for channel in channels])
    return Record(channels, time, factor * values, source="simulation")


def true_calibrations(
    channels: Sequence[Channel], rng: np.random.Generator | None = None, draws: int | None = None
) -> tuple[Real, Real]:
    """Gain and delay (s) that each channel has besides what is exactly known, (channels,) or (draws, channels).

    Drawn by `rng` from what is stated with an sd; else as stated or guessed, else 1 and 0.
    """
    unknowns, (gain, delay) = unknown_calibrations(channels), calibration_indices(channels)
    values: Real = np.tile(nominal_calibrations(unknowns), (*(() if draws is None else (draws,)), 1))
    sd = np.array([unknown.sd or 0.0 for unknown in unknowns])
    if rng is not None and np.any(sd > 0):
        values = values + sd * rng.standard_normal(values.shape)
    values = np.concatenate([values, np.ones((*values.shape[:-1], 1)), np.zeros((*values.shape[:-1], 1))], -1)
    gains = int(np.max(gain, initial=-1)) + 1
    return values[..., np.where(gain < 0, -2, gain)], values[..., np.where(delay < 0, -1, gains + delay)]


def _factors(
    channels: Sequence[Channel], omega: Real, rng: np.random.Generator | None = None, draws: int | None = None
) -> Complex:
    """What such calibrations make of amplitudes at ω (lines,), rad/s: (lines, channels) or (draws, lines, channels)."""
    gain, delay = true_calibrations(channels, rng, draws)
    return gain[..., None, :] * np.exp(-1j * omega[:, None] * delay[..., None, :])


def _delays(channels: Sequence[Channel]) -> Real:
    """Known delays of the channels, (channels,) s, else 0."""
    return np.array([0.0 if channel.delay is None else channel.delay for channel in channels])


def _later(values: Real, steps: Real) -> Real:
    """Samples (samples, channels), each channel later by so many steps (channels,); its ends go on as they are."""
    from scipy.interpolate import make_interp_spline

    out = np.array(values, dtype=np.float64)
    index = np.arange(len(values), dtype=np.float64)
    # Of the splines that shift late channels: exact to 1e-3 at four samples a cycle
    degree = min(7, (len(values) - 1) // 2 * 2 - 1)
    for c in np.flatnonzero(steps) if degree > 0 else ():
        at = np.clip(index - steps[c], 0.0, index[-1])
        out[:, c] = make_interp_spline(index, values[:, c], k=degree)(at)
    return out


def _shown(
    view: ObservationModel,
    theta: Real,
    source: str,
    step: float,
    shown: ShownInputs,
    released: Real | None = None,
) -> Real:
    """What the channels of a rig show, (samples, channels), from rest or from a state `released` (2n,)."""
    model, channels = view.model, view.channels
    if not len(model.nonlinear):
        p = model.parameters(theta)
        return channel_samples(view, p, integrator(model, p, step).motion(shown.values, released))
    count = len(channels)
    nothing = np.zeros((len(shown.values), count))
    orders = tuple(map(int, view.derivative))
    how = (view.on_x, view.on_q, view.force, orders, (-1,) * count, (False,) * count)
    data = RecordData(source, step, tuple(channels), shown.values, nothing, *how)
    data = beside_bases(model, data, shown.orders)
    substeps = 2 * enough_substeps(model, theta, step)
    machine = Integrator(
        moving_rig(model, data.bases), theta, forcing(step, data.inputs, data.rated), substeps
    )
    # The state (states,) in which the rig does not move, though a base may whose velocity is known
    start, bases, n = np.zeros(machine.states), data.bases, model.n
    rates = np.where(np.array(bases.orders) == 1, data.inputs[0, len(model.inputs) - len(bases.names) :], 0.0)
    start[machine.model.n : machine.model.n + n] = -bases.matrix(model.coordinates) @ rates
    start[machine.model.n + n : 2 * machine.model.n] = rates
    if released is not None:
        start[:n], start[machine.model.n : machine.model.n + n] = np.split(released, 2)
    motion = integrate(machine, start)
    if not motion.closed:
        raise ConvergenceError("the simulation fails", cure="sample the input faster, or reduce the drive")
    values = shown_outputs(machine, data, motion)[0]
    for c, channel in enumerate(channels):
        if channel.quantity is Quantity.FORCE and measures_input(model, channel):
            values[:, c] = data.inputs @ data.on_q[c]
    return values


# The response to a record of the inputs that an estimate predicts, with what its uncertainty makes of it.


def response_band(
    model: Model, estimate: Estimate, channels: Sequence[Channel], drive: Record
) -> tuple[Record, Real]:
    """What the channels would show under the inputs of `drive`, from rest, without noise, and its standard deviation.

    The second is (samples, channels) in the units of the record's values: √(g Σ gᵀ) with the slopes g of each sample
    and the covariance Σ of the estimate.  Gains, delays and signs are those of the estimate where it has them.
    Raises DataError if the estimate is not of this rig, and as `driven_record`.
    """
    estimate.require_unknowns(model.unknown_names)
    m, names = len(model.unknowns), estimate.names
    nobody = np.random.default_rng(0)  # the channels have no noise to draw

    def shown(psi: Real) -> Record:
        values = dict(zip(names, psi.tolist(), strict=True))
        ours, driving = (
            tuple(_calibrated(channel, values, estimate.signs) for channel in each)
            for each in (channels, drive.channels)
        )
        return driven_record(model, psi[:m], ours, replace(drive, channels=driving), nobody)

    psi, covariance = np.array(estimate.values), np.array(estimate.covariance)
    predicted = shown(psi)
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    slopes = np.zeros((*predicted.values.shape, len(psi)))
    for j in np.flatnonzero(sd > 0):
        step = 0.1 * sd[j]  # of the central differences
        away = step * np.eye(len(psi))[j]
        slopes[..., j] = (shown(psi + away).values - shown(psi - away).values) / (2 * step)
    band = np.sqrt(np.maximum(np.einsum("sci,ij,scj->sc", slopes, covariance, slopes, optimize=True), 0.0))
    return predicted, band


def _calibrated(channel: Channel, values: Mapping[str, float], signs: Mapping[str, Real]) -> Channel:
    """A channel without noise, with the gain, delay and sign that an estimate found."""
    unknown, late = channel.unknown_gain, channel.unknown_delay
    gain = channel.gain if unknown is None else values.get(unknown.name)
    delay = channel.delay if late is None else values.get(late.name)
    sign = float(signs[channel.name]) if channel.sign is None and channel.name in signs else channel.sign
    return replace(
        channel, noise=0.0, relative_noise=0.0, gain=gain, delay=delay, sign=sign, same_gain_as=None
    )


NoiseBasis = Literal["given", "estimated"]


@dataclass(frozen=True)
class Dwells:
    """A stepped-sine test: the drive at each frequency, and its sampling.

    frequency_hz  (lines,)    Hz
    samples       (lines,)    samples of every channel, evenly spaced from t = 0 on
    periods       (lines,)    duration of a dwell in periods; samples are periods / (samples · frequency) apart
    U             (lines, r)  amplitudes of the displacement inputs, m
    f             (lines, s)  amplitudes of the forces, N
    """

    frequency_hz: Real
    samples: Ints
    periods: Real
    U: Complex
    f: Complex

    def __post_init__(self) -> None:
        freeze(self)
        bad = ~((self.frequency_hz >= SMALLEST) & (self.frequency_hz <= LARGEST))
        if np.any(bad):
            cure = f"frequencies must be from {SMALLEST:g} to {LARGEST:g} Hz"
            raise DataError(f"frequency {self.frequency_hz[bad][0]:g} Hz", cure=cure)
        if np.any(self.samples < 1) or not np.all((self.periods > 0) & np.isfinite(self.periods)):
            raise DataError("a dwell without samples or without time", cure="give it at least one sample")

    @property
    def omega(self) -> Real:
        """2π f, (lines,), rad/s."""
        return 2 * np.pi * self.frequency_hz

    def time(self, line: int) -> Real:
        """Sample times of one dwell, (samples,), s."""
        count = int(self.samples[line])
        step = self.periods[line] / (count * self.frequency_hz[line])
        return np.arange(count) * step


def dwells(
    model: Model,
    frequency_hz: Sequence[float] | Real,
    samples: int | Sequence[int] | Ints = 56,
    *,
    amplitudes: Mapping[str, complex | Complex] | None = None,
    periods: float | Sequence[float] | Real = 1.0,
    rate: float | None = None,
) -> Dwells:
    """The test that drives every input of `model` at each frequency.

    frequency_hz (lines,); samples and periods of each dwell (lines,), or one number for all.  `amplitudes` of the
    inputs by name in SI units, one value or one per frequency, default 1.  Samples are spread over `periods`, or taken
    at `rate` (Hz).  Raises UsageError for an input that the rig does not have.
    """
    frequencies = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    lines = len(frequencies)
    if not lines:
        raise DataError("a test without frequencies", cure="give it at least one")
    given: Mapping[str, complex | Complex] = {} if amplitudes is None else amplitudes
    names = [source.name for source in model.inputs]
    for name in given:
        if name not in names:
            raise UsageError(f"the rig has no input {name}", cure=f"it has {', '.join(names)}")
    U, f = (
        np.array([np.broadcast_to(given.get(name, 1.0), (lines,)) for name in inputs], dtype=complex)
        .reshape(-1, lines)
        .T
        for inputs in (model.displacement_inputs, model.force_inputs)
    )
    counts = np.broadcast_to(np.asarray(samples, dtype=np.int64), (lines,))
    cycles = frequencies * counts / rate if rate is not None else np.asarray(periods, dtype=float)
    return Dwells(frequencies, counts, np.broadcast_to(cycles, (lines,)), U, f)


def amplitudes_within(
    model: Model,
    theta: Real,
    limits: ShakerLimits,
    frequency_hz: Sequence[float] | Real,
    given: Mapping[str, complex | Complex],
) -> dict[str, complex | Complex]:
    """Amplitudes by name: those that are given, all others together as large as the shaker can at each frequency.

    theta (unknowns,), frequency_hz (lines,).  Raises UsageError if no limit is met.
    """
    at = np.asarray(frequency_hz, dtype=float)
    names = [*model.displacement_inputs, *model.force_inputs]
    unit = np.array([name not in given for name in names], dtype=complex)
    if not np.any(unit):
        return dict(given)
    lines = np.broadcast_to(unit, (len(at), len(unit)))
    drive = drive_at_limits(model, model.parameters(theta)[None], limits, at, lines)
    return {name: given.get(name, drive[:, j]) for j, name in enumerate(names)}


# Channels and their noise


def standard_channels(model: Model, quantities: Sequence[Quantity]) -> tuple[Channel, ...]:
    """Every coordinate in each of the quantities, then the inputs without noise; SI units.

    Displacement channels bear the name of their point, velocities and accelerations `d` and `dd` before it.
    """
    prefix = {Quantity.DISPLACEMENT: "", Quantity.VELOCITY: "d", Quantity.ACCELERATION: "dd"}
    motions = [
        Channel(prefix[quantity] + point, {point: 1.0}, quantity)
        for quantity in quantities
        for point in model.coordinates
    ]
    return (*motions, *input_channels(model))


def with_constant_noise(
    model: Model, p: Real, channels: Sequence[Channel], level: float, reference: Dwells
) -> tuple[Channel, ...]:
    """Channels whose noise has one size at all frequencies: level × rms amplitude of the channel over `reference`.

    p (elements,).
    """
    Y = clean_amplitudes(model, p, channels, reference) * _factors(channels, reference.omega)
    size = np.sqrt(np.mean(np.abs(Y) ** 2, axis=-2))
    return tuple(
        channel
        if measures_input(model, channel)
        else replace(
            channel, noise=level * float(rms) * abs(channel.factor) / channel.scale, relative_noise=0.0
        )
        for channel, rms in zip(channels, size, strict=True)
    )


def clean_amplitudes(model: Model, p: Real, channels: Sequence[Channel], test: Dwells) -> Complex:
    """Amplitudes of the channels' quantities without noise, (..., lines, channels), SI units; p (..., elements).

    Raises DataError if a channel measures something that the rig lacks.
    """
    view = observation_model(model, channels, test.omega)
    X = response(model, p, test.omega, test.U, test.f)
    forces = p[..., None, :] * unit_forces(model, test.omega, X, test.U)
    return channel_amplitudes(view, X, np.concatenate([test.U, test.f], axis=-1), forces)


# Sample by sample


def simulate_records(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    test: Dwells,
    rng: np.random.Generator,
    *,
    draws: int | None = None,
    offset: Real | None = None,
) -> list[Record]:
    """One simulated steady-state record per dwell, with noise and calibrations of the channels.

    p (elements,), SI units; `draws` repeats make a leading axis of the values; `offset` (channels,) is added, SI units.
    Gains and delays stated with an sd are drawn once for all records; unknown ones, and signs, are set to their guess,
    or else to 1, 0 and 1.  Raises ModelError if the rig has no steady response, and DataError if a channel measures
    something that the rig does not have.
    """
    Y = clean_amplitudes(model, p, channels, test)
    return steady_records(channels, np.stack([np.zeros_like(Y), Y], axis=1), test, rng, draws, offset)


def steady_records(
    channels: Sequence[Channel],
    harmonics: Complex,
    test: Dwells,
    rng: np.random.Generator,
    draws: int | None = None,
    offset: Real | None = None,
) -> list[Record]:
    """As `simulate_records`, of motion given by its harmonics, (lines, H + 1, channels), SI units."""
    channels, count = tuple(channels), len(channels)
    gain, late = true_calibrations(channels, rng)
    harmonics = harmonics * gain
    sd, delay = noise_sd(channels, harmonics[:, 1]), _delays(channels) + late
    factor = np.array([channel.factor for channel in channels])
    level = np.zeros(count) if offset is None else np.asarray(offset, dtype=float)
    batch = () if draws is None else (draws,)
    orders = np.arange(harmonics.shape[1])[:, None]
    records = []
    for line, omega in enumerate(test.omega):
        time = test.time(line)
        turns = np.exp(1j * omega * orders * (time[:, None, None] - delay))  # (samples, H + 1, channels)
        values = np.sum((turns * harmonics[line]).real, axis=1)
        values = values + sd[line] * rng.standard_normal((*batch, len(time), count))
        frequency = float(test.frequency_hz[line])
        source = f"simulation at {frequency:g} Hz"
        records.append(Record(channels, time, factor * values + level, frequency, source=source))
    return records


# All at once


def simulate_spectrum(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    test: Dwells,
    rng: np.random.Generator,
    *,
    draws: int | None = None,
    noise: NoiseBasis = "given",
    moments: bool = False,
    drift: int | None = None,
) -> Spectrum:
    """Simulate the Spectrum of such records from its exact distribution, without computing samples.

    Gains and delays stated with an sd are drawn for each repeat; the noise has the same size in all.
    `noise` "given" states the true covariance, "estimated" the one that white residuals of the records would give,
    with its degrees of freedom.  `drift` is the degree of the trend solved for (None: not even an offset), `moments`
    adds the second moments for the methods that work on samples.  The amplitudes depend on neither.
    p (elements,), SI units; `draws` repeats make a leading axis.  Raises DataError if a dwell has too few samples or
    a channel measures what the rig has not, ModelError if the rig has no steady response, UsageError if `draws`
    or `drift` is negative.
    """
    for name, count in {"draws": draws, "drift": drift}.items():
        if count is not None and count < 0:
            raise UsageError(f"{name} is {count}", cure="give a whole number from 0 on, or leave it out")
    channels = tuple(channels)
    clean, nominal = clean_amplitudes(model, p, channels, test), _factors(channels, test.omega)
    Y = clean * nominal
    sd = noise_sd(channels, Y)
    gram = _grams(test, drift)
    P = np.linalg.inv(gram)
    K = 1 if draws is None else draws
    A = _with_errors(Y, np.linalg.cholesky(P), sd, rng, K)
    if any(unknown.sd for unknown in unknown_calibrations(channels)):
        A += clean * (_factors(channels, test.omega, rng, K) - nominal)
    free = test.samples - 2 - (0 if drift is None else drift + 1)
    spread = np.trace(P, axis1=-2, axis2=-1)
    residual = None
    if moments or noise == "estimated":
        residual = sd[:, :, None] * _wishart(rng, K, free, sd) * sd[:, None, :]
    V = _covariance(spread, sd)
    if noise == "estimated" and residual is not None:
        if np.any(free < 1):
            few = int(test.samples[int(np.argmin(free))])
            what = f"{few} samples leave no residual from which to estimate the noise"
            raise DataError(what, cure="use more samples, or give the noise")
        V = ((spread / free)[:, None, None] * residual).astype(np.complex128)
    products: Real | None = None
    if (
        moments and residual is not None
    ):  # Σ q qᵀ with q = (channels, cos, sin), (draws, lines, channels + 2, ditto)
        beta = np.stack([A.real, -A.imag], axis=-2)
        rows = np.concatenate([beta, np.broadcast_to(np.eye(2), (*beta.shape[:-1], 2))], axis=-1)
        products = np.swapaxes(rows, -1, -2) @ gram @ rows
        products[..., : A.shape[-1], : A.shape[-1]] += residual
    if draws is None:
        A = A[0]
        V = V[0] if V.ndim == 4 else V
        products = None if products is None else products[0]
    kept = None if products is None else Moments(products)
    return _lines(channels, test, A, V, free.astype(float) if noise == "estimated" else None, kept)


def _lines(
    channels: tuple[Channel, ...],
    test: Dwells,
    A: Complex,
    V: Complex,
    dof: Real | None = None,
    moments: Moments | None = None,
) -> Spectrum:
    """Amplitudes of settled dwells; noise that residuals showed has `dof` degrees of freedom, (lines,)."""
    lines = len(test.frequency_hz)
    noise = ("given" if dof is None else "white",) * lines
    freedom = np.full(lines, np.inf) if dof is None else dof
    experiment = np.zeros(lines, dtype=np.int64)
    return Spectrum(channels, test.frequency_hz, A, V, test.samples, freedom, noise, experiment, moments)


def _with_errors(Y: Complex, root: Real, sd: Real, rng: np.random.Generator, draws: int) -> Complex:
    """Y (lines, channels) with the errors of its cosines and sines, (draws, lines, channels).

    root (lines, 2, 2) is lower triangular, sd (lines, channels).
    """
    lines, channels = Y.shape
    of_cosine, crossed, of_sine = (root[:, i, j, None] * sd for i, j in ((0, 0), (1, 0), (1, 1)))
    A = np.empty((draws, lines, channels), dtype=np.complex128)
    # Random numbers at a time, which stay in the processor's cache
    piece = max(1, 2**14 // max(1, 2 * Y.size))
    noise = np.empty((min(piece, draws), lines, 2, channels))
    for first in range(0, draws, piece):
        part = A[first : first + piece]
        drawn = rng.standard_normal(out=noise[: len(part)])
        cosine, sine = drawn[..., 0, :], drawn[..., 1, :]
        part.real = Y.real + of_cosine * cosine
        part.imag = Y.imag - (crossed * cosine + of_sine * sine)
    return A


def clean_spectrum(
    model: Model, p: Real, channels: Sequence[Channel], test: Dwells, *, drift: int | None = None
) -> Spectrum:
    """Amplitudes without noise, with the covariance that their noise would have: what bounds are computed from.

    p (elements,).
    """
    channels = tuple(channels)
    Y = clean_amplitudes(model, p, channels, test) * _factors(channels, test.omega)
    spread = np.trace(np.linalg.inv(_grams(test, drift)), axis1=-2, axis2=-1)
    return _lines(channels, test, Y, _covariance(spread, noise_sd(channels, Y)))


def with_noise_drawn(clean: Spectrum, rng: np.random.Generator, draws: int | None = None) -> Spectrum:
    """Amplitudes without noise with noise of their covariance, (lines, c, c), diagonal.

    `draws` repeats, which share it, make a leading axis.
    """
    sd = np.sqrt(np.diagonal(clean.covariance, axis1=-2, axis2=-1).real / 2)
    shape = (*(() if draws is None else (draws,)), *clean.amplitudes.shape)
    error = sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    motion = clean.amplitudes
    if any(unknown.sd for unknown in unknown_calibrations(clean.channels)):
        nominal = _factors(clean.channels, clean.omega)
        motion = motion * (_factors(clean.channels, clean.omega, rng, draws) / nominal)
    return replace(clean, amplitudes=motion + error)


def _covariance(spread: Real, sd: Real) -> Complex:
    """E[Δ Δᴴ] = tr P · diag σ², (lines, channels, channels)."""
    V = (spread[:, None] * sd**2)[:, :, None] * np.eye(sd.shape[-1])
    return V.astype(np.complex128)


def _grams(test: Dwells, drift: int | None) -> Real:
    """Hᵀ M H of (cos ωt, sin ωt) with the trend taken out, (lines, 2, 2).  Raises DataError if it is singular."""
    cache: dict[tuple[int, float], Real] = {}
    for count, periods in zip(test.samples.tolist(), test.periods.tolist(), strict=True):
        if (count, periods) in cache:
            continue
        phase = 2 * np.pi * periods * np.arange(count) / count
        H = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        if drift is not None:
            Q = np.linalg.qr(legvander(np.linspace(-1, 1, count), drift))[0]
            H = H - Q @ (Q.T @ H)
        gram = H.T @ H
        terms = 2 if drift is None else 3 + drift
        if count < terms or np.linalg.eigvalsh(gram)[0] < 1e-7 * count:
            raise DataError(
                f"{count} samples over {periods:g} periods cannot separate offset, drift and harmonic",
                cure="use more samples, or spread them differently",
            )
        cache[count, periods] = gram
    return np.array([cache[key] for key in zip(test.samples.tolist(), test.periods.tolist(), strict=True)])


def _wishart(rng: np.random.Generator, draws: int, dof: Ints, sd: Real) -> Real:
    """R ~ Wishart(dof, 1) for the channels that have noise at some line, (draws, lines, channels, channels).

    Bartlett: R = A Aᵀ with A_ii² ~ χ²(dof − i), A_ij ~ N(0, 1) below; columns from dof on are 0 (singular R).
    """
    lines, channels = sd.shape
    noisy = np.flatnonzero(np.any(sd > 0, axis=0))
    q = len(noisy)
    R = np.zeros((draws, lines, channels, channels))
    if q == 0:
        return R
    A = np.zeros((draws, lines, q, q))
    below = np.tril_indices(q, -1)
    A[..., below[0], below[1]] = rng.standard_normal((draws, lines, len(below[0])))
    degrees = dof[:, None] - np.arange(q)
    A[..., range(q), range(q)] = np.sqrt(rng.chisquare(np.maximum(degrees, 1), (draws, lines, q)))
    A *= (degrees > 0)[:, None, :]
    R[..., noisy[:, None], noisy] = A @ np.swapaxes(A, -1, -2)
    return R


# Simulated tests of rigs with nonlinear elements: settled dwells by harmonic balance, records by
# integration.


def settled_motion(model: Model, theta: Real, channels: Sequence[Channel], test: Dwells) -> Complex:
    """The motion that each dwell of a test settles to, with as many harmonics as it needs; theta (unknowns,).

    Harmonics of the channels, (dwells, H + 1, channels), SI units, of unknown calibrations 1.  Where several motions
    are possible it is that which a drive raised slowly from rest leads to.
    Raises ConvergenceError, which names the frequency, where none is found.
    """
    rows = len(test.frequency_hz)
    # Harmonics to begin with
    U, f = (np.zeros((rows, 7 + 1, part.shape[1]), dtype=np.complex128) for part in (test.U, test.f))
    U[:, 1], f[:, 1] = test.U, test.f
    p, constants = (np.tile(of(theta), (rows, 1)) for of in (model.parameters, model.inner_constants))
    drive = Drive(test.omega, U, f)
    # With few harmonics first, which costs little
    at = _followed(model, theta, drive, periodic_response(model, p, constants, drive))
    # Truncation error of the elongations
    at, drive = settled_orders(model, p, constants, drive, at.delta, tolerance=1e-6)
    at = _followed(model, theta, drive, at)
    return channel_harmonics(model, p, channels, drive, at)


def _followed(model: Model, theta: Real, drive: Drive, at: Periodic) -> Periodic:
    """The motions with those that Newton's method missed found by following the drive's growth, through folds.

    Raises ConvergenceError, which names the frequency, where that fails as well.
    """
    if np.all(at.converged):
        return at
    delta, rows = at.delta.copy(), len(at.delta)
    for row in np.flatnonzero(~at.converged):
        try:
            delta[row] = grown_from_rest(model, theta, drive.rows(np.arange(rows) == row))
        except ConvergenceError as error:
            what = f"harmonic balance finds no response at {drive.omega[row] / (2 * np.pi):g} Hz"
            raise ConvergenceError(what, cure="reduce the drive there, or leave it out") from error
    p, constants = (np.tile(of(theta), (rows, 1)) for of in (model.parameters, model.inner_constants))
    return periodic_response(model, p, constants, drive, delta)


def settled_spectrum(channels: Sequence[Channel], motion: Complex, test: Dwells) -> Spectrum:
    """Amplitudes of the first harmonics of each dwell, without noise, with the covariance that white noise on the
    samples of whole periods gives them; motion (dwells, H + 1, channels)."""
    dwells, count = len(test.frequency_hz), min(5, motion.shape[1] - 1)  # harmonics in tables of amplitudes
    frequency_hz = np.outer(test.frequency_hz, np.arange(1, count + 1)).ravel()
    Y = motion[:, 1 : count + 1].reshape(dwells * count, -1) * _factors(channels, 2 * np.pi * frequency_hz)
    sd = np.repeat(noise_sd(channels, Y[::count]), count, axis=0)
    samples, dof = np.repeat(test.samples, count), np.full(len(Y), np.inf)
    given, experiment = ("given",) * len(Y), np.zeros(len(Y), dtype=np.int64)
    dwell, settled = np.repeat(np.arange(dwells), count), tuple(map(SettledDwell, test.frequency_hz.tolist()))
    V = _covariance(4 / samples, sd)
    of_lines = (tuple(channels), frequency_hz, Y, V, samples, dof, given, experiment)
    return Spectrum(*of_lines, stretch=dwell, stretches=settled)
