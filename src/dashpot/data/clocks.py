"""Sensors with clocks of their own: what one moment is on each of them, and records whose channels keep their times.

A sensor's clock shows t' where the reference shows t = t' + offset + drift · (t' − middle).  Both are estimated from
what the two sensors see alike: the lag of the highest correlation in pieces of the recording, and a line through the
lags, weighted by their variances.  Sensors that do not move in phase make the lag wrong by what their phases differ.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.conditioning.drive_frequency import refine_frequency
from dashpot.data.conditioning.harmonic_fit import fit_harmonics
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.conditioning.stated_frequency import OWN
from dashpot.data.conditioning.steady_state import settled, without_start
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.io.words import counted
from dashpot.notices import Notice

PIECES = 8  # of the recording, each with a lag of its own
ROUNDS = 4
ALIKE = 0.95  # height of a second peak of the correlation at which the lag is ambiguous
TOLERANCE = 1e-3  # of a sampling step, within which two samples were taken at once
FEWEST = 0.5  # share of the shortest recording that sensors on one clock have in common


@dataclass(frozen=True)
class Clock:
    """A sensor's clock against the reference: offset in s at the middle of the recording, drift in s/s, their sd."""

    offset: float = 0.0
    drift: float = 0.0
    offset_sd: float = 0.0
    drift_sd: float = 0.0
    middle: float = 0.0

    def on_reference(self, time: Real) -> Real:
        """Times of the sensor's clock on the reference's, (samples,), s."""
        moved: Real = time + self.offset + self.drift * (time - self.middle)
        return moved


@dataclass(frozen=True)
class Sensor:
    """What one sensor recorded: times on its own clock in s, channels in SI units, (samples, channels)."""

    name: str
    channels: tuple[Channel, ...]
    time: Real
    values: Real


@dataclass(frozen=True)
class ClockedRecords:
    """Records of different sensors that were taken at once, each with its own sample times on the reference's clock.

    offset_sd  standard deviation of each part's clock, s: a phase that all its channels share
    """

    parts: tuple[Record, ...]
    offset_sd: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.parts or len(self.parts) != len(self.offset_sd):
            raise DataError("records of sensors need one clock each")

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of all parts."""
        return tuple(channel for part in self.parts for channel in part.channels)


def joined_sensors(
    sensors: Sequence[Sensor], frequency_hz: float | None, experiment: int, source: str
) -> tuple[Record | ClockedRecords, list[Notice]]:
    """One record of sensors on one clock, where they sampled at the same moments; else each with its own times.

    Time counts from the first common moment.  Raises DataError where the recordings do not overlap.
    """
    start, end = max(s.time[0] for s in sensors), min(s.time[-1] for s in sensors)
    if not end > start:
        raise DataError(
            "the sensors did not record at the same time",
            source,
            'give files of one recording, or say clock = "own" where each sensor has a clock of its own',
        )
    reference = sensors[0].time
    step = float(np.median(np.diff(reference)))
    shared = np.ones(len(reference), dtype=bool)
    nearest = []
    for sensor in sensors:
        after = np.clip(np.searchsorted(sensor.time, reference), 1, len(sensor.time) - 1)
        at = np.where(reference - sensor.time[after - 1] < sensor.time[after] - reference, after - 1, after)
        shared &= np.abs(sensor.time[at] - reference) < TOLERANCE * step
        nearest.append(at)
    shortest = min(len(sensor.time) for sensor in sensors)
    common = int(np.sum(shared))
    channels = tuple(channel for sensor in sensors for channel in sensor.channels)
    if common < max(2, FEWEST * shortest):
        parts = [_between(sensor, start, end, frequency_hz, experiment, source) for sensor in sensors]
        text = f"{source}: the sensors sampled at different moments; each channel keeps its own"
        return ClockedRecords(tuple(parts), (0.0,) * len(parts)), [Notice("own_times", text, (source,))]
    notes = []
    if common < shortest:
        text = f"{source}: {counted(shortest - common, 'sample')} left out that not all sensors have"
        notes.append(Notice("samples_not_shared", text, (source,)))
    values = np.concatenate(
        [sensor.values[at[shared]] for sensor, at in zip(sensors, nearest, strict=True)], axis=-1
    )
    time = reference[shared]
    return Record(channels, time - time[0], values, frequency_hz, experiment, source), notes


def _between(
    sensor: Sensor, start: float, end: float, frequency_hz: float | None, experiment: int, source: str
) -> Record:
    inside = (sensor.time >= start) & (sensor.time <= end)
    name = f"{source} ({sensor.name})"
    if np.sum(inside) < 2:
        raise DataError("the sensors have fewer than two samples in common", name)
    time = sensor.time[inside] - start
    return Record(sensor.channels, time, sensor.values[inside], frequency_hz, experiment, name)


def aligned_sensors(
    sensors: Sequence[Sensor], frequency_hz: float | None, experiment: int, source: str
) -> tuple[ClockedRecords, list[Notice]]:
    """Sensors with clocks of their own, set by the first one's; what was found is in the notes.

    Raises DataError where a clock cannot be set.
    """
    moved, clocks, notes = [sensors[0]], [Clock()], []
    for sensor in sensors[1:]:
        clock = estimated_clock(sensors[0], sensor, source)
        moved.append(replace(sensor, time=clock.on_reference(sensor.time)))
        clocks.append(clock)
        text = (
            f"{source}: the clock of {sensor.name} is set by that of {sensors[0].name}: "
            f"{1e3 * clock.offset:+.4g} ± {1e3 * clock.offset_sd:.2g} ms, "
            f"{1e6 * clock.drift:+.3g} ± {1e6 * clock.drift_sd:.2g} ppm"
        )
        notes.append(Notice("clock_estimated", text, (sensor.name,)))
    start, end = max(s.time[0] for s in moved), min(s.time[-1] for s in moved)
    parts = [_between(sensor, start, end, frequency_hz, experiment, source) for sensor in moved]
    return ClockedRecords(tuple(parts), tuple(clock.offset_sd for clock in clocks)), notes


def estimated_clock(reference: Sensor, sensor: Sensor, source: str) -> Clock:
    """Offset and drift of a sensor's clock, from the first channel of both.

    Raises DataError where the two share no motion, or a motion so regular that the lag is ambiguous.
    """
    step = min(float(np.median(np.diff(s.time))) for s in (reference, sensor))
    coarse, margin = _coarse_lag(reference, sensor, step)
    if margin > ALIKE:
        raise DataError(
            f"the clock of {sensor.name} cannot be aligned: the motion repeats itself too regularly",
            source,
            "record something that does not repeat, a start or a knock, or synchronise the sensors beforehand",
        )
    clock = Clock(offset=coarse, middle=float(np.mean(sensor.time)))
    for _ in range(ROUNDS):  # the lag is a first-order term: exact once it is small
        lags, variances, centres = _lags_of_pieces(reference, sensor, clock, step)
        if len(lags) < 3:
            raise DataError(
                f"the clock of {sensor.name} cannot be set: it and {reference.name} share no motion",
                source,
                "use sensors that share some motion, or synchronise them beforehand",
            )
        clock = _corrected(clock, lags, variances, centres)
    return clock


def _lags_of_pieces(reference: Sensor, sensor: Sensor, clock: Clock, step: float) -> tuple[Real, Real, Real]:
    """Lags that a clock leaves in pieces of the recording, s, their variances, and the sensor's time of each piece."""
    time = clock.on_reference(sensor.time)
    start, end = max(reference.time[0], time[0]), min(reference.time[-1], time[-1])
    rows = []
    for a, b in itertools.pairwise(np.linspace(start, end, PIECES + 1).tolist()):
        fit = _fine_lag(reference, time, sensor.values[:, 0], a, b, step)
        if fit is not None:
            rows.append((*fit, float(np.interp((a + b) / 2, time, sensor.time))))
    table = np.array(rows).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]


def _corrected(clock: Clock, lags: Real, variances: Real, centres: Real) -> Clock:
    """The clock with a weighted straight line through the lags added; sd from variances or scatter, the larger."""
    w = 1 / variances
    x = centres - clock.middle
    A = np.stack([np.ones_like(x), x], axis=-1) * np.sqrt(w)[:, None]
    line, _, _, _ = np.linalg.lstsq(A, lags * np.sqrt(w), rcond=None)
    scatter = float(np.sum((lags * np.sqrt(w) - A @ line) ** 2)) / max(1, len(lags) - 2)
    sd = np.sqrt(np.diagonal(np.linalg.inv(A.T @ A)) * max(1.0, scatter))
    offset, drift = clock.offset + float(line[0]), clock.drift + float(line[1])
    return Clock(offset, drift, float(sd[0]), float(sd[1]), clock.middle)


def _coarse_lag(reference: Sensor, sensor: Sensor, step: float) -> tuple[float, float]:
    """Lag of the highest correlation of the whole recordings, s, and the height of the next peak over it."""
    signals = []
    for s in (reference, sensor):
        time = np.arange(s.time[0], s.time[-1], step)
        y = np.interp(time, s.time, s.values[:, 0])
        signals.append(y - np.mean(y))
    a, b = signals
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    height = np.abs(cross)
    best = int(np.argmax(height))
    around = np.zeros(size, dtype=bool)
    peak = height >= np.maximum(np.roll(height, 1), np.roll(height, -1))
    left = right = best  # the main lobe: down to where the correlation rises again
    while height[(left - 1) % size] < height[left % size]:
        left -= 1
    while height[(right + 1) % size] < height[right % size]:
        right += 1
    around[np.arange(left, right + 1) % size] = True
    second = float(np.max(np.where(peak & ~around, height, 0.0), initial=0.0))
    shift = best if best < size // 2 else best - size
    lag = float(reference.time[0] - sensor.time[0]) + shift * step
    return lag, second / max(float(height[best]), 1e-300)


def _fine_lag(
    reference: Sensor, time: Real, values: Real, start: float, end: float, step: float
) -> tuple[float, float] | None:
    """How late the sensor is in one piece and the variance of that, by least squares on y_r = α y + β ẏ; or None."""
    inside = (reference.time >= start) & (reference.time <= end)
    t = reference.time[inside]
    inner = (t > time[1]) & (t < time[-2])
    t, target = t[inner], reference.values[inside, 0][inner]
    if len(t) < 32:
        return None
    y = np.interp(t, time, values)
    slope = (np.interp(t + step, time, values) - np.interp(t - step, time, values)) / (2 * step)
    A = np.stack([y, slope, np.ones_like(t)], axis=-1)
    if not np.all(np.ptp(A[:, :2], axis=0) > 0):
        return None
    coefficients, _, rank, _ = np.linalg.lstsq(A, target, rcond=None)
    rest = target - A @ coefficients
    explained = 1 - float(np.sum(rest**2)) / max(float(np.sum((target - np.mean(target)) ** 2)), 1e-300)
    if rank < 3 or explained < 0.25 or coefficients[0] == 0:
        return None
    V = np.linalg.inv(A.T @ A) * float(np.sum(rest**2)) / (len(t) - 3)
    alpha, beta = coefficients[:2]
    # y_r(t) = α y(t + β/α): the sensor's sample of time t belongs to t − β/α.
    lag = -beta / alpha
    gradient = np.array([beta / alpha**2, -1 / alpha])
    variance = float(gradient @ V[:2, :2] @ gradient)
    return float(lag), max(variance, 1e-24)


def clocked_lines(joint: ClockedRecords, settings: Conditioning) -> Spectrum:
    """The lines of sensors that were recorded at once, each channel from its own sample times.

    Noise of different sensors is independent; the sd σ of a clock adds (ωσ)² X Xᴴ among its channels.
    Raises DataError as `fit_harmonics`, and where there is no drive frequency or moments of samples are asked for.
    """
    if settings.moments:
        cure = "choose a method that works on amplitudes"
        raise DataError(
            "sensors with clocks of their own have no sample moments", joint.parts[0].source, cure
        )
    parts = _treated(joint.parts, settings)
    fits = [fit_harmonics(part, None, settings) for part in parts]
    lines, channels = len(settings.wanted), sum(len(part.channels) for part in parts)
    X, V = np.zeros((lines, channels), complex), np.zeros((lines, channels, channels), complex)
    frequency = fits[0].frequency_hz * np.array(settings.wanted, dtype=float)
    first, dof = 0, np.full(lines, np.inf)
    for part, fit, sd in zip(parts, fits, joint.offset_sd, strict=True):
        wanted = [fit.orders.index(order) for order in settings.wanted]
        h = calibration(part.channels, frequency)
        own = slice(first, first + len(part.channels))
        X[:, own] = fit.amplitudes[wanted] * h
        V[:, own, own] = fit.covariance[wanted] * h[:, :, None] * np.conj(h)[:, None, :]
        phase = (2 * np.pi * frequency * sd) ** 2
        V[:, own, own] += phase[:, None, None] * X[:, own, None] * np.conj(X[:, None, own])
        dof = np.minimum(dof, fit.dof[wanted])
        first = own.stop
    kind = "blocks" if any(fit.noise == "blocks" for fit in fits) else "white"
    samples = np.full(lines, min(fit.samples for fit in fits))
    experiment = np.full(lines, parts[0].experiment)
    notes = tuple(dict.fromkeys(note for fit in fits for note in fit.notes))
    return Spectrum(joint.channels, frequency, X, V, samples, dof, (kind,) * lines, experiment, notes=notes)


def _treated(parts: Sequence[Record], settings: Conditioning) -> list[Record]:
    """The parts settled together and at one frequency, as far as that is wanted."""
    if any(part.frequency_hz is None for part in parts):
        cure = "give it; a record without one needs sensors on one clock"
        raise DataError("the drive frequency is not known", parts[0].source, cure)
    if settings.settle == "auto":
        parts = _settled_together(parts)
    elif settings.settle != "none":
        parts = [without_start(part, float(settings.settle)) for part in parts]
    return list(parts) if settings.refine == "none" else _at_one_frequency(parts, settings)


def _settled_together(parts: Sequence[Record]) -> list[Record]:
    """From where the last of them has settled to where the first of them ends."""
    kept = [settled(part).record for part in parts]
    start, end = max(part.time[0] for part in kept), min(part.time[-1] for part in kept)
    return [
        replace(part, time=part.time[inside], values=part.values[inside])
        for part in parts
        if np.any(inside := (part.time >= start) & (part.time <= end))
    ]


def _at_one_frequency(parts: Sequence[Record], settings: Conditioning) -> list[Record]:
    """At the weighted mean of their frequencies; with "auto" only where that is not the stated one."""
    refined = [refine_frequency(part, drift=settings.drift) for part in parts]
    weights = np.array([1 / max(r.sd, 1e-15) ** 2 for r in refined])
    frequency = float(np.sum(weights * np.array([r.frequency_hz for r in refined])) / np.sum(weights))
    beyond = abs(frequency - refined[0].nominal_hz) * np.sqrt(np.sum(weights)) > OWN
    if settings.refine == "auto" and not beyond:
        return list(parts)
    return [replace(part, frequency_hz=frequency) for part in parts]
