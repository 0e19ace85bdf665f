"""Rigs under any excitation, in time: records for tests of whole records, and the slow likelihood of all samples.

The motion is carried exactly through a cubic spline of a much finer sampling than the record's (its own module is
tested against closed forms); nothing of it is in the frequency domain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares

from dashpot.arrays import Bools, Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind, between, mass
from dashpot.model.modes import eigenmodes
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Input, Model
from dashpot.model.observation import ObservationModel, observation_model
from tests import rigs

FINER = 8  # samples of the integration in one of the record
DWELLS = 8  # of a stepped sine


def with_ends(lines: Spectrum, *, polynomial: int, loads: bool = True) -> Spectrum:
    """The lines of a whole record with another number of polynomial columns, and with loads at its ends or without."""
    (record,) = lines.stretches
    assert isinstance(record, WholeRecord)
    return replace(lines, stretches=(replace(record, polynomial=polynomial, loads=loads),))


@dataclass(frozen=True)
class WholeTest:
    """A rig, its true unknowns, and a record of it without noise."""

    model: Model
    theta: Real
    record: Record

    @property
    def size(self) -> Real:
        """Root mean square of each channel, (channels,)."""
        return np.std(self.record.values, axis=0)

    def noisy(self, rng: np.random.Generator, sd: Real) -> Record:
        """The record with white noise of standard deviations sd (channels,)."""
        values = self.record.values + rng.normal(size=self.record.values.shape) * sd
        return Record(self.record.channels, self.record.time, values)


def chain(
    n: int, zeta: float = 0.02, *, force: bool = False, base: bool = True, seed: int = 0
) -> tuple[Model, Real]:
    """n masses in a row on a base that may move (or is the ground), all springs and dampers unknown; θ true.

    The masses are known but the last one, with a force on the last coordinate where `force`.
    """
    rng = np.random.default_rng(seed)
    names = [f"x{i + 1}" for i in range(n)]
    inputs = [Input("u")] if base else []
    inputs += [Input("f", "force", {names[-1]: 1.0})] if force else []
    elements, theta = [], []
    m, k = rng.uniform(0.8, 1.25, n), 4000 * rng.uniform(0.8, 1.25, n)
    for i, name in enumerate(names):
        known = i < n - 1 or n == 1
        elements.append(mass(f"m{i + 1}", name, **({"value": float(m[i])} if known else {})))
        theta += [] if known else [m[i]]
    omega = 2 * np.sqrt(4000) * np.sin(np.pi / (2 * (2 * n + 1)))
    below = "u" if base else "ground"
    for i, name in enumerate(names):
        elements.append(between(f"k{i + 1}", Kind.SPRING, name, names[i - 1] if i else below))
        theta.append(k[i])
    for i, name in enumerate(names):
        elements.append(between(f"c{i + 1}", Kind.DAMPER, name, names[i - 1] if i else below))
        theta.append(2 * zeta / omega * k[i])
    model = Model(tuple(names), tuple(inputs), tuple(elements))
    order = {unknown.name: j for j, unknown in enumerate(model.unknowns)}
    by_name = dict(zip([e.name for e in elements if e.value is None], theta, strict=True))
    true = np.zeros(len(order))
    for name, value in by_name.items():
        true[order[name]] = value
    return model, true


def four_seen_at_two(seed: int, at: tuple[str, str], hz: Real) -> tuple[rigs.Rig, tuple[Channel, ...]]:
    """Four masses on a base, all but one unknown, with accelerometers at two of them, at the lines `hz`."""
    model, theta = chain(4, 0.03, seed=seed)
    values = dict(zip((e.name for e in model.elements), model.parameters(theta).tolist(), strict=True))
    opened = ("m2", "m3", "m4")
    elements = tuple(replace(e, value=None) if e.name in opened else e for e in model.elements)
    model = replace(model, elements=elements)
    theta = np.array([values[unknown.name] for unknown in model.unknowns])
    lines = len(hz)
    rig = rigs.Rig(model, theta, hz, np.ones((lines, 1), complex), np.zeros((lines, 0), complex))
    sensors = (Channel(f"a_{name}", {name: 1.0}, Quantity.ACCELERATION) for name in at)
    return rig, (*sensors, Channel("u", {"u": 1.0}))


def tones(time: Real, hz: Real, X: Complex) -> Real:
    """Σ Re(X e^{2πjft}) at even times: e^{2πjft} of every so-manieth one by that of the few behind it."""
    each = 1 + int(np.sqrt(len(time)))
    coarse, fine = (np.exp(2j * np.pi * np.outer(at, hz)) for at in (time[::each], time[:each] - time[0]))
    return np.real((coarse * X) @ fine.T).ravel()[: len(time)]


def excitation(kind: str, time: Real, low_hz: float, high_hz: float, rng: np.random.Generator) -> Real:
    """Samples of one input: "random" tones, "sweep", "hammer", "tap", "earthquake", "stepped"; else 0."""
    T = time[-1]
    if kind == "random":
        f = rng.uniform(low_hz, high_hz, 60)
        phase = rng.uniform(0, 2 * np.pi, 60)
        return tones(time, f, np.exp(1j * phase)) / 8
    if kind == "sweep":
        rate = np.log(high_hz / low_hz) / T
        return np.sin(2 * np.pi * low_hz / rate * (np.exp(rate * time) - 1))
    if kind == "hammer":
        out = np.zeros_like(time)
        for at in (0.05 * T, 0.45 * T):
            inside = np.abs(time - at) < 1 / high_hz
            out[inside] += np.cos(np.pi * (time[inside] - at) * high_hz / 2) ** 4
        return out
    if kind == "tap":  # as short as a steel tip makes it
        since = (time - 0.05 * T) * high_hz / 0.4
        return np.where((since > 0) & (since < 1), np.sin(np.pi * since) ** 2, 0.0)
    if kind == "stepped":
        dwell = np.minimum((DWELLS * time / T).astype(int), DWELLS - 1)
        hz = np.linspace(low_hz, high_hz, DWELLS)[dwell]
        return np.sin(2 * np.pi * np.concatenate([[0.0], np.cumsum(hz[:-1] * np.diff(time))]))
    if kind == "earthquake":
        rise = (time / (0.15 * T)) ** 2 * np.exp(2 * (1 - time / (0.15 * T)))
        return rise * excitation("random", time, low_hz, high_hz, rng)
    return np.zeros_like(time)


def record_of(
    model: Model,
    theta: Real,
    kind: str,
    *,
    samples_per_cycle: float = 20.0,
    decay_times: float = 8.0,
    moving: bool = True,
    quantities: tuple[Quantity, ...] = (Quantity.DISPLACEMENT,),
    seen: tuple[str, ...] | None = None,
    input_quantity: Quantity = Quantity.DISPLACEMENT,
    seed: int = 0,
) -> WholeTest:
    """A record of a rig, from rest or from a moving start.

    samples_per_cycle of the highest mode; decay_times (1/e) of the slowest mode; each of `quantities` at each
    coordinate of `seen` in turn.
    """
    rng = np.random.default_rng(seed)
    p = model.parameters(theta)
    of = eigenmodes(model, p)
    low, high = float(np.min(of.frequency_hz)), float(np.max(of.frequency_hz))
    rate = samples_per_cycle * high
    slowest = 1 / np.min(np.abs(of.eigenvalues.real))
    samples = int(max(decay_times * slowest, 6 / low) * rate)
    fine = np.arange((samples - 1) * FINER + 1) / (rate * FINER)
    count = len(model.inputs)
    inputs = np.zeros((len(fine), count))
    for j in range(count):
        inputs[:, j] = excitation(kind, fine, 0.5 * low, 1.3 * high, rng)
    scale = np.array([1e-3 if given.kind == "displacement" else 4.0 for given in model.inputs])
    start = np.zeros(2 * model.n)
    if moving or kind == "none":
        start[: model.n] = rng.normal(size=model.n) * 1e-3
        start[model.n :] = rng.normal(size=model.n) * 1e-3 * 2 * np.pi * low
    steps = integrator(model, p, 1 / (rate * FINER))
    motion = steps.motion(inputs * scale, start)
    points = seen or model.coordinates
    channels = [
        Channel(f"{point}_{quantity.value[:3]}", {point: 1.0}, quantity)
        for point in points
        for quantity in quantities
    ]
    for given in model.inputs:
        if given.kind == "force":
            channels.append(Channel(given.name, {given.name: 1.0}, Quantity.FORCE))
        else:
            channels.append(Channel(given.name, {given.name: 1.0}, input_quantity))
    view = observation_model(model, channels, np.ones(1))
    values = channel_samples(view, p, motion)[::FINER]
    return WholeTest(model, theta, Record(tuple(channels), np.arange(samples) / rate, values))


def stepped_sine(
    model: Model, theta: Real, channels: Sequence[Channel], frequencies: Sequence[float], noise: float, *,
    periods: float = 5, settle: float = 0.0, seed: int = 0, drift: float = 0.0,
) -> list[Record]:  # fmt: skip
    """Dwells of 20 samples a period of the one input, each from the state that the last one left, clocks restarted.

    noise of every channel but the last, against its own size; the first `settle` seconds of each dwell are left out.
    In the rest the drive's amplitude runs from 1 − drift to 1 + drift, in mm.
    """
    rng = np.random.default_rng(seed)
    p = model.parameters(theta)
    view = observation_model(model, channels, np.ones(1))
    state: Real = np.zeros(2 * model.n)
    records = []
    for f in frequencies:
        step = 1 / (20 * f)
        wait = int(settle * 20 * f)
        count = wait + int(20 * periods)
        fine = np.arange(8 * count + 1) * step / 8
        size = 1e-3 * np.interp(fine, [wait * step, fine[-1]], [1 - drift, 1 + drift])
        motion = integrator(model, p, step / 8).motion((size * np.sin(2 * np.pi * f * fine))[:, None], state)
        state = np.concatenate([motion.x[-1], motion.v[-1]])
        values = channel_samples(view, p, motion)[:-1:8][wait:]
        noisy = np.arange(len(channels)) < len(channels) - 1
        values = values + noise * np.std(values, axis=0) * rng.normal(size=values.shape) * noisy
        records.append(Record(tuple(channels), step * np.arange(len(values)), values, f))
    return records


def sampled_free_motion(view: ObservationModel, p: Real, step: float, jw: complex) -> Complex:
    """h Σ y(kh) e^{−jωkh} of the channels' motion after an impulse at each coordinate, and after a doublet at each.

    (channels, 2 n); exact, from the matrix exponential of the state, at one line jω.
    """
    at, n = matrices(view.model, p), view.model.n
    inverse = np.linalg.inv(at.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ at.K, -inverse @ at.C]])
    impulse = np.concatenate([np.zeros((n, n)), inverse])
    start = np.concatenate([impulse, A @ impulse], axis=1)
    states = step * np.linalg.solve(np.eye(2 * n) - np.exp(-jw * step) * expm(A * step), start)
    motions = np.stack([states[:n], states[n:], (A @ states)[n:]])
    return np.stack([on_x @ motions[d] for on_x, d in zip(view.on_x, view.derivative, strict=True)])


@dataclass(frozen=True)
class Twin:
    """The likelihood of all samples in time: θ and its covariance, and χ² at its minimum."""

    theta: Real
    covariance: Real
    chi2: float


def twin(test: WholeTest, record: Record, sd: Real, start: Real, there: Bools | None = None) -> Twin:
    """Least squares of the samples over θ, the unknown starting state and the offset of each channel, inputs exact.

    there (samples, channels): which of them are measured.  Slow, and nobody's code path.

    The inputs are splines through the record's own samples; the last channels are those of the inputs (displacement
    or force), which have no noise.
    """
    model = test.model
    count = len(model.inputs)
    step = float(record.time[1] - record.time[0])
    outputs = record.channels[: len(record.channels) - count]
    view = observation_model(model, outputs, np.ones(1))
    inputs = record.values[:, len(outputs) :] if count else np.zeros((len(record.time), 0))
    weight = np.broadcast_to(1 / np.asarray(sd)[: len(outputs)], (len(record.time), len(outputs)))
    if there is not None:
        weight = weight * there[:, : len(outputs)]

    def residuals(x: Real) -> Real:
        theta = x[: len(start)] * start
        p = model.parameters(theta)
        steps = integrator(model, p, step)
        forced = channel_samples(view, p, steps.motion(inputs))
        free = np.stack([
            channel_samples(view, p, steps.motion(np.zeros_like(inputs), each)) for each in np.eye(2 * model.n)
        ])  # fmt: skip
        r = ((record.values[:, : len(outputs)] - forced) * weight).ravel()
        offsets = (np.eye(len(outputs)) * (weight * sd[: len(outputs)])[..., None]).reshape(-1, len(outputs))
        A = np.concatenate([(free * weight).reshape(2 * model.n, -1).T, offsets], axis=1)
        size = np.linalg.norm(A, axis=0)
        state = np.linalg.lstsq(A / size, r, rcond=1e-12)[0]
        return r - (A / size) @ state

    found = least_squares(residuals, np.ones(len(start)), jac="3-point", method="lm", xtol=1e-13, ftol=1e-13)
    covariance = np.linalg.inv(found.jac.T @ found.jac) * np.outer(start, start)
    return Twin(found.x * start, covariance, float(2 * found.cost))
