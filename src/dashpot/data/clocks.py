"""Sensors with clocks of their own: records whose channels keep their times, set by what `clock_offset.py` finds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.clock import within_times
from dashpot.data.conditioning.drive_frequency import OWN, refine_frequency
from dashpot.data.conditioning.harmonic_fit import rounding_steps
from dashpot.data.conditioning.lines import driven_parts, evened_and_marked, settled_lines
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.io.words import counted
from dashpot.notices import Notice

# How a sensor's clock runs against a reference's, from what the two sensors see alike.
#
# A sensor's clock shows t' where the reference shows t = t' + offset + drift · (t' − middle). Both are
# estimated from the lag of the highest correlation in pieces of the recording, and a line through the lags,
# weighted by their variances. Sensors that do not move in phase make the lag wrong by what their phases
# differ, over their frequency: as a clock delays all frequencies alike and a rig does not, the spread of
# the lags of several bands of frequency says how much that may be, and counts as uncertainty of the offset.


PIECES = 8  # of the recording, each with a lag of its own
TOGETHER = (
    "shake all sensors together on one body first, and name that part with align_s, or synchronise them"
)
BANDS = 8  # of frequency, in which the sensors' lags are compared


@dataclass(frozen=True)
class Clock:
    """A sensor's clock against the reference: offset at the middle, s, drift, s/s, their sd and covariance."""

    offset: float = 0.0
    drift: float = 0.0
    offset_sd: float = 0.0
    drift_sd: float = 0.0
    middle: float = 0.0
    covariance: float = 0.0

    def on_reference(self, time: Real) -> Real:
        """Times of the sensor's clock on the reference's, (samples,), s."""
        return time + self.offset + self.drift * (time - self.middle)

    def sd_over(self, time: Real) -> float:
        """Standard deviation of the phase of a motion over times of the sensor's clock, (samples,), s.

        That at their mean: a drift turns what comes before it one way and what comes after it the other.
        """
        x = float(np.mean(time)) - self.middle
        return float(
            np.sqrt(max(0.0, self.offset_sd**2 + 2 * self.covariance * x + (self.drift_sd * x) ** 2))
        )


@dataclass(frozen=True)
class Sensor:
    """What one sensor recorded: times on its own clock in s, channels in SI units, (samples, channels)."""

    name: str
    channels: tuple[Channel, ...]
    time: Real
    values: Real


def estimated_clock(reference: Sensor, sensor: Sensor, source: str) -> Clock:
    """Offset and drift of a sensor's clock, from the first channel of both.

    Raises DataError if the two share no motion, or a motion so regular that the lag is ambiguous.
    """
    step = min(float(np.median(np.diff(s.time))) for s in (reference, sensor))
    coarse, margin = _coarse_lag(reference, sensor, step)
    if margin > 0.95:  # a second peak nearly as high: the lag is ambiguous
        raise DataError(
            f"the clock of {sensor.name} cannot be synchronised: the motion repeats itself too regularly",
            source,
            TOGETHER,
        )
    clock = Clock(offset=coarse, middle=float(np.mean(sensor.time)))
    for _ in range(4):  # the lag is a first-order term: exact once it is small
        time = clock.on_reference(sensor.time)
        start, end = max(reference.time[0], time[0]), min(reference.time[-1], time[-1])
        rows = []
        for a, b in itertools.pairwise(np.linspace(start, end, PIECES + 1).tolist()):
            fit = _fine_lag(reference, time, sensor.values[:, 0], a, b, step)
            if fit is not None:
                rows.append((*fit, float(np.interp((a + b) / 2, time, sensor.time))))
        table = np.array(rows).reshape(-1, 3)
        lags, variances, centres = table[:, 0], table[:, 1], table[:, 2]
        if len(lags) < 3:
            raise DataError(
                f"cannot synchronise {sensor.name} with {reference.name}: they share no motion",
                source,
                TOGETHER,
            )
        w = 1 / variances
        x = centres - clock.middle
        A = np.stack([np.ones_like(x), x], axis=-1) * np.sqrt(w)[:, None]
        line, _, _, _ = np.linalg.lstsq(A, lags * np.sqrt(w), rcond=None)
        scatter = float(np.sum((lags * np.sqrt(w) - A @ line) ** 2)) / max(1, len(lags) - 2)
        V = np.linalg.inv(A.T @ A) * max(1.0, scatter)
        sd = np.sqrt(np.diagonal(V))
        offset, drift = clock.offset + float(line[0]), clock.drift + float(line[1])
        clock = Clock(offset, drift, float(sd[0]), float(sd[1]), clock.middle, float(V[0, 1]))
    spread = _spread_over_bands(reference, sensor, clock, step)
    if spread is None:
        raise DataError(
            f"cannot synchronise {sensor.name} with {reference.name}: they share a single frequency, where a "
            "clock offset cannot be separated from the rig's own phase",
            source,
            TOGETHER,
        )
    return replace(clock, offset_sd=float(np.hypot(clock.offset_sd, spread)))


def _spread_over_bands(reference: Sensor, sensor: Sensor, clock: Clock, step: float) -> float | None:
    """Standard deviation of the lags that a clock leaves in bands of frequency, s, beyond that of noise.

    By the method of moments (DerSimonian and Laird 1986).  None where fewer than two bands are shared.
    """
    table = np.array(_lags_of_bands(reference, sensor, clock, step)).reshape(-1, 2)
    if len(table) < 2:
        return None
    lags, w = table[:, 0], 1 / table[:, 1]
    mean = np.sum(w * lags) / np.sum(w)
    excess = float(np.sum(w * (lags - mean) ** 2)) - (len(lags) - 1)
    return float(np.sqrt(max(0.0, excess) / (np.sum(w) - np.sum(w**2) / np.sum(w))))


def _lags_of_bands(reference: Sensor, sensor: Sensor, clock: Clock, step: float) -> list[tuple[float, float]]:
    """Lag, s, and its variance in each band of frequency that both sensors feel, by their cross spectrum."""
    own = clock.on_reference(sensor.time)
    time = np.arange(max(reference.time[0], own[0]), min(reference.time[-1], own[-1]), step)
    size = 2 * (len(time) // PIECES)
    if size < 4 * BANDS:
        return []
    turn = 2 * np.pi * np.arange(size) / size
    # Blackman and Harris: strong lines stay within their band.
    weights = (0.35875, -0.48829, 0.14128, -0.01168)
    window = sum(a * np.cos(k * turn) for k, a in enumerate(weights))
    starts = range(0, len(time) - size + 1, size // 2)
    spectra = [
        np.stack([np.fft.rfft(window * (y[k : k + size] - np.mean(y[k : k + size]))) for k in starts])
        for y in (
            np.interp(time, reference.time, reference.values[:, 0]),
            np.interp(time, own, sensor.values[:, 0]),
        )
    ]
    f = np.arange(size // 2 + 1) / (size * step)
    cross = np.sum(spectra[0] * np.conj(spectra[1]), axis=0)
    powers = [np.sum(np.abs(each) ** 2, axis=0) for each in spectra]
    # Up to a fifth of the sampling rate: above, interpolation changes the phase.
    edges = np.geomspace(4 / (size * step), 0.2 / step, BANDS + 1)
    found = []
    for low, high in itertools.pairwise(edges.tolist()):
        inside = (f >= low) & (f < high)
        looks = len(starts) * np.sum(inside) / 2  # that are independent, for windows and bins overlap
        if looks < 2:
            continue
        total = np.sum(cross[inside])
        coherence = float(abs(total) ** 2 / (np.sum(powers[0][inside]) * np.sum(powers[1][inside])))
        if not coherence > 1 - 0.01 ** (1 / (looks - 1)):  # what chance alone gives in 1 % of bands
            continue
        omega = 2 * np.pi * float(np.average(f[inside], weights=np.abs(cross[inside])))
        variance = max(1 - coherence, 1e-12) / (2 * coherence * looks)
        found.append((float(np.angle(total)) / omega, variance / omega**2))
    return found


def _coarse_lag(reference: Sensor, sensor: Sensor, step: float) -> tuple[float, float]:
    """Lag at which the whole recordings are most alike, s, and the height of the next peak over it."""
    signals = []
    for s in (reference, sensor):
        time = np.arange(s.time[0], s.time[-1], step)
        y = np.interp(time, s.time, s.values[:, 0])
        signals.append(y - np.mean(y))
    height = np.abs(_likeness(*signals))
    size = len(height)
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
    shift = best if best < len(signals[0]) else best - size
    lag = float(reference.time[0] - sensor.time[0]) + shift * step
    return lag, second / max(float(height[best]), 1e-300)


def _likeness(a: Real, b: Real) -> Real:
    """Correlation of two signals over the deviation of what of b overlaps a, by the shift of b, around a circle.

    It is at most the root energy of what of a overlaps b: what is loud elsewhere, or rests on another offset,
    stands no higher than what is alike, and neither does what has little in common.
    """
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    cross = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    shift = np.arange(size)
    shift = np.where(shift < len(a), shift, shift - size)
    start = np.maximum(shift, 0)
    stop = np.maximum(np.minimum(len(a), len(b) + shift), start)
    count = np.maximum(stop - start, 1)
    sums_a, sums_b, squares = (np.concatenate([[0.0], np.cumsum(y)]) for y in (a, b, b**2))
    of_a = sums_a[stop] - sums_a[start]
    first, last = np.clip([start - shift, stop - shift], 0, len(b))
    of_b = sums_b[last] - sums_b[first]
    energy = squares[last] - squares[first] - of_b**2 / count
    floor = 1e-9 * max(float(squares[-1]), 1e-300)
    return (cross - of_a * of_b / count) / np.sqrt(np.maximum(energy, floor))


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

    Time counts from the first common moment.  Raises DataError if the recordings do not overlap.
    """
    start, end = max(s.time[0] for s in sensors), min(s.time[-1] for s in sensors)
    if not end > start:
        raise DataError(
            "the sensors did not record at the same time",
            source,
            'give files of one recording, or say clock = "own" where each sensor has its own clock',
        )
    reference = sensors[0].time
    step = float(np.median(np.diff(reference)))
    shared = np.ones(len(reference), dtype=bool)
    nearest = []
    for sensor in sensors:
        after = np.clip(np.searchsorted(sensor.time, reference), 1, len(sensor.time) - 1)
        at = np.where(reference - sensor.time[after - 1] < sensor.time[after] - reference, after - 1, after)
        shared &= np.abs(sensor.time[at] - reference) < 1e-3 * step  # taken at once
        nearest.append(at)
    shortest = min(len(sensor.time) for sensor in sensors)
    common = int(np.sum(shared))
    channels = tuple(channel for sensor in sensors for channel in sensor.channels)
    if common < max(2, shortest / 2):
        parts = [_between(sensor, start, end, start, frequency_hz, experiment, source) for sensor in sensors]
        text = f"{source}: the sensors sampled at different moments; each channel keeps its own"
        return ClockedRecords(tuple(parts), (Clock(),) * len(parts)), [Notice("own_times", text, (source,))]
    notes = []
    if common < shortest:
        text = f"{source}: {counted(shortest - common, 'sample')} not present in all sensor files left out"
        notes.append(Notice("samples_not_shared", text, (source,)))
    values = np.concatenate(
        [sensor.values[at[shared]] for sensor, at in zip(sensors, nearest, strict=True)], axis=-1
    )
    time = reference[shared]
    return Record(channels, time - time[0], values, frequency_hz, experiment, source), notes


def _between(
    sensor: Sensor,
    start: float,
    end: float,
    zero: float,
    frequency_hz: float | None,
    experiment: int,
    source: str,
) -> Record:
    """What a sensor recorded from start to end, times counted from zero."""
    inside = (sensor.time >= start) & (sensor.time <= end)
    name = f"{source} ({sensor.name})"
    if np.sum(inside) < 2:
        raise DataError("the sensors share fewer than two samples", name)
    time = sensor.time[inside] - zero
    return Record(sensor.channels, time, sensor.values[inside], frequency_hz, experiment, name)


def aligned_sensors(
    sensors: Sequence[Sensor],
    frequency_hz: float | None,
    experiment: int,
    source: str,
    align_s: tuple[float, float] | None = None,
) -> tuple[ClockedRecords, list[Notice]]:
    """Sensors with clocks of their own, set by the first one's; what was found is in the notes.

    `align_s` is the part of the first one's recording, s from its start, in which all move alike: sensors that are
    shaken together before they are mounted.  Without it the whole recording has to be so.  The records' times count
    from the same start.
    Raises DataError if a clock cannot be set, as where the phases of the rig itself hide it.
    """
    moved, clocks, notes = [sensors[0]], [Clock()], []
    for sensor in sensors[1:]:
        reference = sensors[0]
        if align_s is None:
            alike = reference
        else:
            since = reference.time - reference.time[0]
            inside = (since >= align_s[0]) & (since <= align_s[1])
            if np.sum(inside) < 256:  # samples of the reference in the part where sensors move alike
                what = f"{counted(int(np.sum(inside)), 'sample')} of {reference.name} in align_s"
                raise DataError(
                    what, source, "name the part in which all sensors were shaken together, s from the start"
                )
            alike = replace(reference, time=reference.time[inside], values=reference.values[inside])
        whole = estimated_clock(alike, sensor, source)
        # Samples outside that part, all where that leaves none: the clock is carried on to them
        time = whole.on_reference(sensor.time)
        since = time - sensors[0].time[0]
        outside = (
            np.ones(len(time), dtype=bool) if align_s is None else (since < align_s[0]) | (since > align_s[1])
        )
        used = outside if np.any(outside) else ~outside
        clock = replace(whole, offset_sd=whole.sd_over(sensor.time[used]))
        phase = 0.0 if frequency_hz is None else 360 * frequency_hz * clock.offset_sd
        if phase > 10:  # degrees of the drive that a clock may leave open
            raise DataError(
                f"the clock of {sensor.name} is known to ± {1e3 * clock.offset_sd:.2g} ms only ({phase:.2g}° of "
                f"the drive): it and {sensors[0].name} move differently, and a clock offset cannot be separated "
                "from the rig's phase",
                source,
                TOGETHER,
            )
        moved.append(replace(sensor, time=clock.on_reference(sensor.time)))
        clocks.append(whole)
        text = (
            f"{source}: the clock of {sensor.name} was synchronised with {sensors[0].name}: "
            f"{1e3 * clock.offset:+.4g} ± {1e3 * clock.offset_sd:.2g} ms, {1e6 * clock.drift:+.3g} ± "
            f"{1e6 * clock.drift_sd:.2g} ppm"
        )
        notes.append(Notice("clock_estimated", text, (sensor.name,)))
    start, end = max(s.time[0] for s in moved), min(s.time[-1] for s in moved)
    zero = sensors[0].time[0]
    parts = [_between(sensor, start, end, zero, frequency_hz, experiment, source) for sensor in moved]
    counted_alike = [
        replace(clock, middle=float(clock.on_reference(np.array(clock.middle))) - zero) for clock in clocks
    ]
    return ClockedRecords(tuple(parts), tuple(counted_alike)), notes


def clocked_lines(joint: ClockedRecords, settings: Conditioning) -> Spectrum:
    """The lines of sensors that were recorded at once, each channel from its own sample times.

    Noise of different sensors is independent; the sd σ of a clock adds 2 (ωσ)² X Xᴴ among its channels.
    Raises DataError as `fit_harmonics`, and where there is no drive frequency or moments of samples are asked for.
    """
    source = joint.parts[0].source
    if settings.moments:
        cure = "choose a method that works on amplitudes"
        raise DataError("sensors with their own clocks have no common sample times", source, cure)
    if any(part.frequency_hz is None for part in joint.parts):
        cure = "give it; a record without one needs sensors on one clock"
        raise DataError("the drive frequency is not known", source, cure)
    parts, marks = evened_and_marked(joint.parts, settings)
    driven, cuts = driven_parts(parts, settings)
    if any(len(part.time) < len(of.time) for part, of in zip(driven, parts, strict=True)):
        # From where the last of them is driven to where the first of them ends
        start, end = max(part.time[0] for part in driven), min(part.time[-1] for part in driven)
        driven = [within_times(part, start, end) for part in driven]
    parts, notes = _at_one_frequency(driven, settings), [*marks, *cuts]
    cells = [replace(part, cell=rounding_steps([part])[0]) for part in parts]
    each = [settled_lines(part, settings, settings.wanted)[0] for part in cells]
    X = np.concatenate([one.amplitudes for one in each], axis=-1)
    V, first = np.zeros((*X.shape, X.shape[-1]), dtype=np.complex128), 0
    for part, one, clock in zip(parts, each, joint.clocks, strict=True):
        own = slice(first, first + len(one.channels))
        # Twice, for half of a complex variance is along X.
        phase = 2 * (one.omega * clock.sd_over(part.time)) ** 2
        along = one.amplitudes[:, :, None] * np.conj(one.amplitudes[:, None])
        V[:, own, own] = one.covariance + phase[:, None, None] * along
        first = own.stop
    return replace(
        each[0],
        channels=joint.channels,
        amplitudes=X,
        covariance=V,
        samples=np.min([one.samples for one in each], axis=0),
        dof=np.min([one.dof for one in each], axis=0),
        noise=max((one.noise for one in each), key=lambda noise: "blocks" in noise),
        notes=tuple(dict.fromkeys([*notes, *(note for one in each for note in one.notes)])),
    )


def _at_one_frequency(parts: Sequence[Record], settings: Conditioning) -> Sequence[Record]:
    """At the weighted mean of their frequencies; with "auto" only where that is not the stated one."""
    if settings.refine == "none":
        return parts
    refined = [refine_frequency(part, drift=settings.drift) for part in parts]
    weights = np.array([1 / max(r.sd, 1e-15) ** 2 for r in refined])
    frequency = float(np.sum(weights * np.array([r.frequency_hz for r in refined])) / np.sum(weights))
    beyond = abs(frequency - refined[0].nominal_hz) * np.sqrt(np.sum(weights)) > OWN
    if settings.refine == "auto" and not beyond:
        return parts
    return [replace(part, frequency_hz=frequency) for part in parts]
