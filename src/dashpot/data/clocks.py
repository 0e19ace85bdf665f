"""Sensors with clocks of their own: records whose channels keep their times, set by what `clock_offset.py` finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.clock_offset import TOGETHER, Clock, Sensor, estimated_clock
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

TOLERANCE = 1e-3  # of a sampling step, within which two samples were taken at once
MOST_DEGREES = 10.0  # of the drive's phase that a clock may leave open
FEWEST_TO_ALIGN = 256  # samples of the reference in the part where sensors move alike
FEWEST = 0.5  # share of the shortest recording that sensors on one clock have in common


@dataclass(frozen=True)
class ClockedRecords:
    """Records of different sensors that were taken at once, each with its own sample times on the reference's clock.

    clocks  of each part, its `middle` counted as the part's times are: an error is a phase that all its channels share
    """

    parts: tuple[Record, ...]
    clocks: tuple[Clock, ...]

    def __post_init__(self) -> None:
        if not self.parts or len(self.parts) != len(self.clocks):
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
        parts = [_between(sensor, start, end, start, frequency_hz, experiment, source) for sensor in sensors]
        text = f"{source}: the sensors sampled at different moments; each channel keeps its own"
        return ClockedRecords(tuple(parts), (Clock(),) * len(parts)), [Notice("own_times", text, (source,))]
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
    sensor: Sensor, start: float, end: float, zero: float, frequency_hz: float | None, experiment: int, source: str
) -> Record:  # fmt: skip
    """What a sensor recorded from start to end, times counted from zero."""
    inside = (sensor.time >= start) & (sensor.time <= end)
    name = f"{source} ({sensor.name})"
    if np.sum(inside) < 2:
        raise DataError("the sensors have fewer than two samples in common", name)
    time = sensor.time[inside] - zero
    return Record(sensor.channels, time, sensor.values[inside], frequency_hz, experiment, name)


def aligned_sensors(
    sensors: Sequence[Sensor], frequency_hz: float | None, experiment: int, source: str,
    align_s: tuple[float, float] | None = None,
) -> tuple[ClockedRecords, list[Notice]]:  # fmt: skip
    """Sensors with clocks of their own, set by the first one's; what was found is in the notes.

    `align_s` is the part of the first one's recording, s from its start, in which all move alike: sensors that are
    shaken together before they are mounted.  Without it the whole recording has to be so.  The records' times count
    from the same start.
    Raises DataError where a clock cannot be set, as where the phases of the rig itself hide it.
    """
    moved, clocks, notes = [sensors[0]], [Clock()], []
    for sensor in sensors[1:]:
        whole = estimated_clock(_part(sensors[0], align_s, source), sensor, source)
        used = _outside(sensors[0], whole.on_reference(sensor.time), align_s)
        clock = replace(whole, offset_sd=whole.sd_over(sensor.time[used]))
        _require_alike(sensors[0], sensor, clock, frequency_hz, source)
        moved.append(replace(sensor, time=clock.on_reference(sensor.time)))
        clocks.append(whole)
        text = (
            f"{source}: the clock of {sensor.name} is set by that of {sensors[0].name}: "
            f"{1e3 * clock.offset:+.4g} ± {1e3 * clock.offset_sd:.2g} ms, "
            f"{1e6 * clock.drift:+.3g} ± {1e6 * clock.drift_sd:.2g} ppm"
        )
        notes.append(Notice("clock_estimated", text, (sensor.name,)))
    start, end = max(s.time[0] for s in moved), min(s.time[-1] for s in moved)
    zero = sensors[0].time[0]
    parts = [_between(sensor, start, end, zero, frequency_hz, experiment, source) for sensor in moved]
    counted_alike = [
        replace(clock, middle=float(clock.on_reference(np.array(clock.middle))) - zero) for clock in clocks
    ]
    return ClockedRecords(tuple(parts), tuple(counted_alike)), notes


def _part(reference: Sensor, align_s: tuple[float, float] | None, source: str) -> Sensor:
    """That part of the reference's recording.  Raises DataError where it is not in it."""
    if align_s is None:
        return reference
    since = reference.time - reference.time[0]
    inside = (since >= align_s[0]) & (since <= align_s[1])
    if np.sum(inside) < FEWEST_TO_ALIGN:
        what = f"{counted(int(np.sum(inside)), 'sample')} of {reference.name} in align_s"
        raise DataError(
            what, source, "name the part in which all sensors were shaken together, s from the start"
        )
    return replace(reference, time=reference.time[inside], values=reference.values[inside])


def _outside(reference: Sensor, time: Real, align_s: tuple[float, float] | None) -> Bools:
    """Which samples are not in that part, all where that leaves none: the clock is carried on to them."""
    since = time - reference.time[0]
    outside = (
        np.ones(len(time), dtype=bool) if align_s is None else (since < align_s[0]) | (since > align_s[1])
    )
    return outside if np.any(outside) else ~outside


def _require_alike(
    reference: Sensor, sensor: Sensor, clock: Clock, frequency_hz: float | None, source: str
) -> None:
    """Raises DataError where the clock leaves the phase of the drive open: sensors apart on a rig do not move alike."""
    phase = 0.0 if frequency_hz is None else 360 * frequency_hz * clock.offset_sd
    if phase > MOST_DEGREES:
        raise DataError(
            f"the clock of {sensor.name} is known to ± {1e3 * clock.offset_sd:.2g} ms, {phase:.2g}° of the drive: "
            f"it and {reference.name} do not move alike, and their phases are the rig's as well",
            source,
            TOGETHER,
        )


def clocked_lines(joint: ClockedRecords, settings: Conditioning) -> Spectrum:
    """The lines of sensors that were recorded at once, each channel from its own sample times.

    Noise of different sensors is independent; the sd σ of a clock adds 2 (ωσ)² X Xᴴ among its channels.
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
    for part, fit, clock in zip(parts, fits, joint.clocks, strict=True):
        wanted = [fit.orders.index(order) for order in settings.wanted]
        h = calibration(part.channels, frequency)
        own = slice(first, first + len(part.channels))
        X[:, own] = fit.amplitudes[wanted] * h
        V[:, own, own] = fit.covariance[wanted] * h[:, :, None] * np.conj(h)[:, None, :]
        # Twice, for half of a complex variance is along X.
        phase = 2 * (2 * np.pi * frequency * clock.sd_over(part.time)) ** 2
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
