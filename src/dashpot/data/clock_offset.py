"""How a sensor's clock runs against a reference's, from what the two sensors see alike.

A sensor's clock shows t' where the reference shows t = t' + offset + drift · (t' − middle).  Both are estimated from
the lag of the highest correlation in pieces of the recording, and a line through the lags, weighted by their variances.
Sensors that do not move in phase make the lag wrong by what their phases differ, over their frequency: as a clock
delays all frequencies alike and a rig does not, the spread of the lags of several bands of frequency says how much that
may be, and counts as uncertainty of the offset.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.errors import DataError

PIECES = 8  # of the recording, each with a lag of its own
ROUNDS = 4
ALIKE = 0.95  # height of a second peak of the correlation at which the lag is ambiguous
TOGETHER = (
    "shake all sensors together on one body first, and name that part with align_s, or synchronise them"
)
BANDS = 8  # of frequency, in which the sensors' lags are compared
CHANCE = 0.01  # of a band that is held for shared though nothing in it is
HIGHEST = 0.2  # of the sampling rate: above, interpolation changes the phase
_WINDOW = 0.35875, -0.48829, 0.14128, -0.01168  # of Blackman and Harris: strong lines stay within their band


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
        moved: Real = time + self.offset + self.drift * (time - self.middle)
        return moved

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

    Raises DataError where the two share no motion, or a motion so regular that the lag is ambiguous.
    """
    step = min(float(np.median(np.diff(s.time))) for s in (reference, sensor))
    coarse, margin = _coarse_lag(reference, sensor, step)
    if margin > ALIKE:
        raise DataError(
            f"the clock of {sensor.name} cannot be aligned: the motion repeats itself too regularly",
            source,
            TOGETHER,
        )
    clock = Clock(offset=coarse, middle=float(np.mean(sensor.time)))
    for _ in range(ROUNDS):  # the lag is a first-order term: exact once it is small
        lags, variances, centres = _lags_of_pieces(reference, sensor, clock, step)
        if len(lags) < 3:
            raise DataError(
                f"the clock of {sensor.name} cannot be set: it and {reference.name} share no motion",
                source,
                TOGETHER,
            )
        clock = _corrected(clock, lags, variances, centres)
    spread = _spread_over_bands(reference, sensor, clock, step)
    if spread is None:
        raise DataError(
            f"the clock of {sensor.name} cannot be set: it and {reference.name} share motion of one frequency alone, "
            "whose phase is the rig's as well",
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
    window = sum(a * np.cos(k * turn) for k, a in enumerate(_WINDOW))
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
    edges = np.geomspace(4 / (size * step), HIGHEST / step, BANDS + 1)
    found = []
    for low, high in itertools.pairwise(edges.tolist()):
        inside = (f >= low) & (f < high)
        looks = len(starts) * np.sum(inside) / 2  # that are independent, for windows and bins overlap
        if looks < 2:
            continue
        total = np.sum(cross[inside])
        coherence = float(abs(total) ** 2 / (np.sum(powers[0][inside]) * np.sum(powers[1][inside])))
        if not coherence > 1 - CHANCE ** (1 / (looks - 1)):
            continue
        omega = 2 * np.pi * float(np.average(f[inside], weights=np.abs(cross[inside])))
        variance = max(1 - coherence, 1e-12) / (2 * coherence * looks)
        found.append((float(np.angle(total)) / omega, variance / omega**2))
    return found


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
    V = np.linalg.inv(A.T @ A) * max(1.0, scatter)
    sd = np.sqrt(np.diagonal(V))
    offset, drift = clock.offset + float(line[0]), clock.drift + float(line[1])
    return Clock(offset, drift, float(sd[0]), float(sd[1]), clock.middle, float(V[0, 1]))


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
    """Correlation of two signals over the deviation of what of b lies beside a, by the shift of b, around a circle.

    It is at most the root energy of what of a lies beside b: what is loud elsewhere, or rests on another offset,
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
    likeness: Real = (cross - of_a * of_b / count) / np.sqrt(np.maximum(energy, floor))
    return likeness


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
