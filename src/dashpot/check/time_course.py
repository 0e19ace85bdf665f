"""What changes in the course of a whole record: a jump off the prediction, a channel that reads more from then on.

The lines of a record are one history each of residual and prediction.  A spike, lost samples, a sensor that comes loose
or another range are spread over all lines, and there nothing but noise, which is read from the residuals themselves;
in time they stand where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import chdtrc, ndtri

from dashpot.arrays import Bools, Ints, Real
from dashpot.check.residuals import Residuals
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines
from dashpot.estimate.assessment import Finding
from dashpot.io.words import joined
from dashpot.notices import Notice

FEWEST = 200  # lines of a record whose parts can be compared
PARTS = 8  # of a record, each with a gain of its own
IMPROBABLE = 1e-4  # chance of the largest departure of a right rig
LEAST = 8.0  # deviations that a departure must have at the least: noise of real sensors has tails
NEARBY = 200  # independent samples on either side that show the usual size
AT_ONCE = 6  # of them that one departure lasts
HEAVY = 16.0  # times the usual power: more is no noise
STEP_LEVEL = 1e-6  # p-value of parts that read alike
STEP_SHARE = 0.7  # of the differences of the parts that one step must explain
STEP = 0.01  # of a gain: a smaller step is of no account


@dataclass(frozen=True)
class TimeChange:
    """A jump off the prediction, or a step of a channel's gain.

    record  number of the stretch; time_s after its start
    size    of a jump in deviations of what is left nearby; of a gain what it is after over before
    times   how often a channel jumps
    """

    kind: Literal["jump", "gain"]
    channels: tuple[str, ...]
    record: int
    time_s: float
    size: float
    times: int = 1


@dataclass(frozen=True)
class _Histories:
    """Whitened residual and prediction of one channel, (samples,); `each` samples are one independent of the others."""

    residual: Real
    prediction: Real
    step_s: float
    each: float


def time_changes(left: Residuals, spectrum: Spectrum, outputs: Bools) -> tuple[TimeChange, ...]:
    """Changes in the whole records of a spectrum, jumps of several channels at one time as one; outputs (channels,)."""
    changes: list[TimeChange] = []
    for number, stretch in enumerate(spectrum.stretches):
        lines = np.flatnonzero(spectrum.stretch == number)
        if not isinstance(stretch, WholeRecord) or len(lines) < FEWEST:
            continue
        jumps: list[TimeChange] = []
        steps: list[TimeChange] = []
        for c in np.flatnonzero(outputs):
            histories = _histories(left, lines, int(c), stretch.duration_s)
            if histories is None:
                continue
            step, jump = _gain_step(histories), _jump(histories)
            if step is not None:
                steps.append(TimeChange("gain", (left.channels[c],), number, *step))
            if jump is not None:
                jumps.append(TimeChange("jump", (left.channels[c],), number, *jump))
        if len(steps) == 1:
            # What the step leaves at its edge jumps, too.
            changes += [*steps, *(jump for jump in jumps if jump.channels != steps[0].channels)]
        else:  # several at once are no channel's gain, but a rig that is another or drives what it has not
            changes += _together(jumps, stretch.duration_s / len(lines))
    return tuple(changes)


def _histories(left: Residuals, lines: Ints, c: int, duration_s: float) -> _Histories | None:
    """Of one channel and record; None where too few lines are left."""
    away = left.measured[lines, c] - left.predicted[lines, c]
    counted = np.isfinite(left.normalised[lines, c]) & (away != 0)
    if np.count_nonzero(counted) < FEWEST:
        return None
    lines, away = lines[counted], away[counted]
    weight = np.abs(left.normalised[lines, c] / away)
    order = np.rint(left.frequency_hz[lines] * duration_s).astype(np.int64)
    # Twice what the band asks for: no peak is missed.
    samples = int(next_fast_len(4 * (int(order.max()) + 1), real=True))

    residual = history_of_lines(away * weight, order, samples)
    prediction = history_of_lines(left.predicted[lines, c] * weight, order, samples)
    return _Histories(residual, prediction, duration_s / samples, samples / (2 * len(lines)))


def _jump(histories: _Histories) -> tuple[float, float, int] | None:
    """Time, size and number of departures that noise of the size of its neighbours would not show."""
    e, each = histories.residual, histories.each
    power = np.concatenate([[0.0], np.cumsum(e**2)])
    rows = np.arange(len(e))

    def within(reach: int) -> tuple[Real, Ints]:
        begin, end = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, len(e))
        return power[end] - power[begin], end - begin

    wide, narrow = within(round(NEARBY * each)), within(round(AT_ONCE * each))
    usual = (wide[0] - narrow[0]) / np.maximum(wide[1] - narrow[1], 1)
    usual = np.maximum(usual, _louder_with_motion(histories, usual))
    size = np.abs(e) / np.sqrt(np.where(usual > 0, usual, np.inf))
    limit = max(LEAST, -float(ndtri(IMPROBABLE * each / (2 * len(e)))))
    far = np.flatnonzero(size > limit)
    if not len(far):
        return None
    largest = int(np.argmax(size))
    times = 1 + int(np.count_nonzero(np.diff(far) > AT_ONCE * each))
    return largest * histories.step_s, float(size[largest]), times


def _louder_with_motion(histories: _Histories, usual: Real) -> Real:
    """Variance of the residual as a straight line over the square of the motion, (samples,): noise may grow with it.

    usual (samples,) as it is nearby: what is far beyond tells of jumps.
    """
    square, motion = np.minimum(histories.residual**2, HEAVY * usual), histories.prediction**2
    about = motion - np.mean(motion)
    slope = max(float(np.mean(about * square)) / max(float(np.mean(about**2)), np.finfo(float).tiny), 0.0)
    line: Real = np.maximum(np.mean(square) + slope * about, 0.0)
    return line


def _gain_step(histories: _Histories) -> tuple[float, float] | None:
    """Time and ratio of a step of the channel's gain, from the gains of the parts; None where there is none."""
    edges = np.linspace(0, len(histories.residual), PARTS + 1).astype(np.int64)
    e, p = histories.residual, histories.prediction
    size = np.add.reduceat(p**2, edges[:-1])
    if not np.all(size > 0):
        return None
    gain = np.add.reduceat(e * p, edges[:-1]) / size
    left_over = (e - np.repeat(gain, np.diff(edges)) * p) * p
    # The noise may be louder where the motion is: each part tells its own.
    variance = histories.each * np.add.reduceat(left_over**2, edges[:-1]) / size**2
    weight = 1 / np.maximum(variance, np.finfo(float).tiny)

    def scatter(parts: slice) -> tuple[float, float]:
        mean = float(np.average(gain[parts], weights=weight[parts]))
        return mean, float(np.sum(weight[parts] * (gain[parts] - mean) ** 2))

    _, whole = scatter(slice(None))
    if not chdtrc(PARTS - 1, whole) < STEP_LEVEL:
        return None
    splits = [(scatter(slice(None, k)), scatter(slice(k, None))) for k in range(1, PARTS)]
    rest = [before[1] + after[1] for before, after in splits]
    best = int(np.argmin(rest))
    ratio = (1 + splits[best][1][0]) / (1 + splits[best][0][0])
    if rest[best] > (1 - STEP_SHARE) * whole or not abs(ratio - 1) > STEP:
        return None
    return _turn(e * p, p**2, splits[best], edges[best], edges[best + 2]) * histories.step_s, ratio


def _turn(product: Real, power: Real, split: tuple[tuple[float, float], ...], begin: int, end: int) -> int:
    """The sample from begin to end at which the gain steps: least squares of the residual there."""
    (before, _), (after, _) = split
    # What a sample adds to the sum of squares with the gain before, less what it adds with the one after.
    change = -2 * (before - after) * product[begin:end] + (before**2 - after**2) * power[begin:end]
    return int(begin + np.argmin(np.cumsum(change)) + 1)


def _together(jumps: list[TimeChange], near_s: float) -> list[TimeChange]:
    """Jumps of several channels at one time as one, the largest first."""
    groups: list[TimeChange] = []
    for jump in sorted(jumps, key=lambda each: -each.size):
        for i, group in enumerate(groups):
            if abs(group.time_s - jump.time_s) <= AT_ONCE * near_s:
                channels = (*group.channels, *jump.channels)
                groups[i] = replace(group, channels=channels, times=max(group.times, jump.times))
                break
        else:
            groups.append(jump)
    return groups


def change_in_words(change: TimeChange, records: int) -> str:
    """What changes, in words; of how many records it is one."""
    where = f"{change.time_s:.4g} s" + (f" in record {change.record + 1}" if records > 1 else "")
    names = joined(change.channels)
    if change.kind == "gain":
        return f"{names} reads {change.size:.3g} × as much after {where} as before"
    several = len(change.channels) > 1
    again = f" and at {change.times - 1} more times" if change.times > 1 else ""
    return f"{names} jump{'' if several else 's'} off the prediction at {where} ({change.size:.0f} sd){again}"


def change_notice(change: TimeChange, records: int) -> Notice:
    """The change as a reason why a rig does not fit."""
    return Notice("time_change", change_in_words(change, records), change.channels)


def change_finding(change: TimeChange, records: int) -> Finding:
    """The change as what may be wrong."""
    text = change_in_words(change, records)
    if change.kind == "gain":
        text += ": another range, a loose sensor, or a rig that changed?"
        remedy = "give the parts before and after as two records, the gain of one of them unknown"
    elif change.times > 1:
        text += ": spikes of a loose contact?"
        remedy = "leave those samples out: the record is then used in pieces"
    else:
        text += ": samples lost, a spike, or a blow that no channel shows?"
        remedy = "give the parts before and after it as two records"
    return Finding("time", change.channels, text, remedy, None, change.time_s)
