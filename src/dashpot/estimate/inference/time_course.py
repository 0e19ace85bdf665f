"""What changes in the course of a whole record: a jump off the prediction, a channel that reads more from then on.

The lines of a record are one history each of residual and prediction.  A spike, lost samples, a sensor that comes loose
or another range are spread over all lines, and there nothing but noise, which is read from the residuals themselves;
in time they stand where they are.  Lost samples are a new start, too: its free decay is in no input and at neither end,
so that the residuals of all channels together are loud for a while, though none may stand out at any moment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import chdtrc, fdtrc, ndtri

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import residuals_of_records
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.io.words import joined
from dashpot.notices import Notice

GAIN_STEP = "gain_step"
SPIKES = "spikes"
JUMP = "residual_jump"
TIME_CHANGES = (GAIN_STEP, SPIKES, JUMP)  # codes of the notices made here

FEWEST = 170  # lines of a record whose parts can be compared
PARTS = 8  # of a record, each with a gain of its own
IMPROBABLE = 1e-4  # chance of the largest departure of a right rig
LEAST = 8.0  # deviations that a departure must have at the least: noise of real sensors has tails
APART = 1.25  # times any departure elsewhere: a model that does not fit departs by much again and again
NEARBY = 200  # independent samples on either side that show the usual size
AT_ONCE = 6  # of them that one departure lasts
HEAVY = 16.0  # times the usual power: more is no noise
STEP_LEVEL = 1e-6  # p-value of parts that read alike
STEP_SHARE = 0.7  # of the differences of the parts that one step must explain
STEP = 0.01  # of a gain: a smaller step is of no account
BLOCKS = 48  # of a record, in each of which the residuals of all channels have a power
LINES_EACH = 10  # of a block at the least: short records have fewer blocks
BLOCK_LEVEL = 1e-6  # p-value of blocks of equal power
LOUDER = 4.0  # times what the loudest motion elsewhere leaves over, relative to itself: then it is no misfit
DECAY = 4  # blocks that a new start decays in
MEDIAN = 0.455  # of a square of noise of variance 1
QUIET = 0.2  # of the typical variance: noise is taken for no quieter where the rig hardly moves
ALONE = 2.0  # times as far above the usual as any block apart from these


@dataclass(frozen=True)
class TimeChange:
    """A jump off the prediction, a step of a channel's gain, or a block in which all residuals are loud.

    channels  that show it; () of a block, which shows in all together
    record    number of the stretch; time_s after its start
    size      of a jump in deviations of what is left nearby; of a gain what it is after over before; of a block its
              power over the usual one
    times     how often a channel jumps
    """

    kind: Literal["jump", "gain", "block"]
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


def time_change_notices(data: Prepared, solution: Solution) -> tuple[Notice, ...]:
    """What changes in the whole records of a linear rig (one repeat); a search that has not ended predicts nothing."""
    spectrum, view = data.spectrum, data.view
    if len(solution.theta) != 1 or not np.all(solution.converged) or len(view.model.nonlinear):
        return ()
    exact = measured(data)
    if exact.ends is None:
        return ()
    residual, _ = residuals_of_records(view, exact, solution.theta, spectrum.signs(solution.signs))
    weight = np.sqrt(np.diagonal(exact.W[0], axis1=-2, axis2=-1).real)
    changes = time_changes(residual * weight, (exact.y[0] - residual) * weight, spectrum, ~view.inputs_alone)
    return tuple(change_notice(change, len(spectrum.records)) for change in changes)


def time_changes(
    residual: Complex, prediction: Complex, spectrum: Spectrum, outputs: Bools
) -> tuple[TimeChange, ...]:
    """Changes in the whole records of a spectrum; both over the noise, (lines, channels); outputs (channels,)."""
    changes: list[TimeChange] = []
    for number in spectrum.records:
        lines, stretch = np.flatnonzero(spectrum.stretch == number), spectrum.stretches[number]
        assert isinstance(stretch, WholeRecord)
        order = np.rint(spectrum.frequency_hz[lines] * stretch.duration_s).astype(np.int64)
        # Twice what the band asks for: no peak is missed.
        samples = int(next_fast_len(4 * (int(order.max()) + 1), real=True))
        histories = {
            spectrum.channels[c].name: _Histories(
                history_of_lines(residual[lines, c], order, samples),
                history_of_lines(prediction[lines, c], order, samples),
                stretch.duration_s / samples,
                samples / (2 * shown),
            )
            for c in np.flatnonzero(outputs)
            if (shown := np.count_nonzero(residual[lines, c])) >= FEWEST
        }
        changes += _of_record(number, histories, stretch.duration_s / len(lines))
    return tuple(changes)


def _of_record(number: int, histories: dict[str, _Histories], near_s: float) -> list[TimeChange]:
    """Changes of one record, each told once: jumps of several channels at one time as one."""
    if not histories:
        return []
    steps = [
        TimeChange("gain", (name,), number, *step)
        for name, of in histories.items()
        if (step := _gain_step(of)) is not None
    ]
    jumps = [
        TimeChange("jump", (name,), number, *jump)
        for name, of in histories.items()
        if (jump := _jump(of)) is not None
    ]
    if len(steps) == 1:
        # What the step leaves at its edge jumps, too.
        return [*steps, *(jump for jump in jumps if jump.channels != steps[0].channels)]
    # Several steps at once are no channel's gain, but a rig that is another or drives what it has not.
    changes = _together(jumps, near_s)
    block = _loud_block(list(histories.values()))
    if block is not None and not any(_explains(change, block[0], near_s) for change in changes):
        changes.append(TimeChange("block", (), number, *block))
    return changes


def _explains(jump: TimeChange, time_s: float, near_s: float) -> bool:
    """Whether a jump, or one of several, may be what makes the block at that time loud."""
    return jump.times > 1 or abs(jump.time_s - time_s) < DECAY * LINES_EACH * near_s


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
    near = np.zeros(len(e), dtype=bool)
    for row in far:
        near[max(row - round(NEARBY * each), 0) : row + round(NEARBY * each)] = True
    if not size[largest] > APART * np.max(size, where=~near, initial=0.0):
        return None
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


def _over_usual(of: _Histories) -> Real:
    """Squares of the residual over what is usual where the motion is as large, (samples,)."""
    typical = np.median(of.residual**2) / MEDIAN
    usual = _louder_with_motion(of, np.full(len(of.residual), typical))
    return of.residual**2 / np.maximum(usual, QUIET * typical)


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


def _loud_block(histories: list[_Histories]) -> tuple[float, float] | None:
    """Time and power, over the usual one, of the block in which all residuals are loud: at once, alone, and more than
    the motion explains; a model that does not fit is loud wherever the motion is."""
    lines = sum(len(of.residual) / (2 * of.each) for of in histories)
    blocks = min(BLOCKS, int(lines / len(histories)) // LINES_EACH)
    edges = np.linspace(0, len(histories[0].residual), blocks, endpoint=False).astype(np.int64)
    count = np.diff(np.append(edges, len(histories[0].residual)))
    left = sum(np.add.reduceat(of.residual**2, edges) for of in histories) / count
    over_usual = sum(np.add.reduceat(_over_usual(of), edges) for of in histories) / count
    motion = sum(np.add.reduceat((of.prediction + of.residual) ** 2, edges) for of in histories) / count
    power, dof = left / np.median(left), 2 * lines / blocks
    j = int(np.argmax(power))
    if not 0 < j < blocks - 1:  # the terms of the ends have their own errors
        return None
    surely = min(power[j], over_usual[j] / np.median(over_usual))
    if not fdtrc(dof, dof * (blocks - 1), surely) < BLOCK_LEVEL / blocks:
        return None
    behind = np.arange(blocks) - j
    apart = (behind < -1) | (behind > DECAY)
    share = np.maximum(power - 1, 1 / np.sqrt(dof)) / np.maximum(motion, np.finfo(float).tiny)
    loudest = np.flatnonzero(apart)[np.argmax(motion[apart])]
    alone = power[j] - 1 > ALONE * (np.max(power[apart]) - 1)
    if not alone or not share[j] > LOUDER * share[loudest]:
        return None
    return (j + 0.5) * len(histories[0].residual) / blocks * histories[0].step_s, float(power[j])


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
    if change.kind == "block":
        return f"the residuals jump near {where} and decay again"
    names = joined(change.channels)
    if change.kind == "gain":
        return f"{names} reads {change.size:.3g} × as much after {where} as before"
    several = len(change.channels) > 1
    again = f" and at {change.times - 1} more times" if change.times > 1 else ""
    return f"{names} jump{'' if several else 's'} off the prediction at {where} ({change.size:.0f} sd){again}"


def change_notice(change: TimeChange, records: int) -> Notice:
    """The change as a warning of the estimate; of how many records it is one."""
    text = change_in_words(change, records)
    if change.kind == "gain":
        return Notice(GAIN_STEP, text, change.channels)
    if change.times > 1:
        return Notice(SPIKES, text, change.channels)
    return Notice(JUMP, text, change.channels)
