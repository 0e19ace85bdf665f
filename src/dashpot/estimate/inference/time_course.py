"""What changes in the course of a whole record: a jump off the prediction, a channel that reads more or later.

The lines of a record are one history each of residual and prediction.  A spike, lost samples, a sensor that comes loose
or another range are spread over all lines, and there nothing but noise, which is read from the residuals themselves;
in time they stand where they are.  Lost samples are a new start, too: its free decay is in no input and at neither end,
so that the residuals of all channels together are loud for a while, though none may stand out at any moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import fdtrc, ndtri

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines, samples_of_squares
from dashpot.estimate.inference.clock_slip import slip, step_sample
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import residuals_of_records
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.io.words import joined
from dashpot.notices import Notice

GAIN_STEP = "gain_step"
CLOCK_STEP = "clock_step"
SPIKES = "spikes"
JUMP = "residual_jump"
TIME_CHANGES = (GAIN_STEP, CLOCK_STEP, SPIKES, JUMP)  # codes of the notices made here

FEWEST = 60  # lines of a record whose parts can be compared
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
FEWEST_BLOCKS = 17  # that a loud one can stand out of
BLOCK_LEVEL = 1e-6  # p-value of blocks of equal power
LOUDER = 4.0  # times what the loudest motion elsewhere leaves over, relative to itself: then it is no misfit
DECAY = 4  # blocks that a new start decays in
MEDIAN = 0.455  # of a square of noise of variance 1
QUIET = 0.2  # of the typical variance: noise is taken for no quieter where the rig hardly moves
ALONE = 2.0  # times as far above the usual as any block apart from these

Kind = Literal["jump", "gain", "clock", "block"]
Whitened = Callable[[Ints, int], tuple[Complex, Complex]]


@dataclass(frozen=True)
class TimeChange:
    """A jump off the prediction, a step of a channel's gain or clock, or a block in which all residuals are loud.

    channels  that show it; () of a block, which shows in all together
    record    number of the stretch; time_s after its start
    size      of a jump in deviations of what is left nearby; of a gain what it is after over before; of a clock by how
              many s the channel is later than before; of a block its power over the usual one
    gradual   whether it changes all the time, and not at once
    times     how often a channel jumps
    """

    kind: Kind
    channels: tuple[str, ...]
    record: int
    time_s: float
    size: float
    gradual: bool = False
    times: int = 1


@dataclass(frozen=True)
class _Histories:
    """Whitened residual and prediction of a channel, and its slope per s, (samples,), in the record of that number.

    `each` samples are one independent of the others.
    """

    channel: str
    record: int
    residual: Real
    prediction: Real
    slope: Real
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
    variance = np.diagonal(exact.W[0], axis1=-2, axis2=-1).real

    def whitened(lines: Ints, channel: int) -> tuple[Complex, Complex]:
        weight, left = np.sqrt(variance[lines, channel]), residual[lines, channel]
        return left * weight, (exact.y[0, lines, channel] - left) * weight

    changes = time_changes(whitened, spectrum, np.flatnonzero(~view.inputs_alone))
    alike: dict[tuple[Kind, frozenset[str], bool], list[TimeChange]] = {}
    for change in changes:
        alike.setdefault((change.kind, frozenset(change.channels), change.gradual), []).append(change)
    return tuple(change_notice(some[0], len(spectrum.records), len(some) - 1) for some in alike.values())


def time_changes(whitened: Whitened, spectrum: Spectrum, outputs: Ints) -> tuple[TimeChange, ...]:
    """Changes in the whole records of a spectrum.

    whitened  residual and prediction over the noise, (lines,) each, of some lines and a channel; outputs: the channels
    """
    return tuple(c for number in spectrum.records for c in _of_record(whitened, spectrum, number, outputs))


def _of_record(whitened: Whitened, spectrum: Spectrum, number: int, outputs: Ints) -> list[TimeChange]:
    """Changes of one record, each told once: jumps of several channels at one time as one."""
    lines, stretch = np.flatnonzero(spectrum.stretch == number), spectrum.stretches[number]
    assert isinstance(stretch, WholeRecord)
    shown = {int(c): int(np.count_nonzero(whitened(lines, int(c))[0])) for c in outputs}
    shown = {c: count for c, count in shown.items() if count >= FEWEST}
    if not shown:
        return []
    near_s, total = stretch.duration_s / len(lines), sum(shown.values())
    blocks = min(BLOCKS, total // len(shown) // LINES_EACH)
    steps: list[TimeChange] = []
    jumps: list[TimeChange] = []
    by_block = np.zeros((3, blocks))
    for c, count in shown.items():  # histories of one channel at a time: those of long records are large
        of = _histories(whitened(lines, c), spectrum, lines, c, count)
        steps += _steps(of)
        jumps += [jump for jump in (_jump(of),) if jump is not None]
        if blocks >= FEWEST_BLOCKS:
            by_block += _of_blocks(of, blocks)
    if len(steps) == 1:
        # What the step leaves at its edge jumps, too.
        return [*steps, *(jump for jump in jumps if jump.channels != steps[0].channels)]
    # Several steps at once are no channel's gain, but a rig that is another or drives what it has not.
    changes = _together(jumps, near_s)
    block = _loud_block(by_block, 2 * total / blocks) if blocks >= FEWEST_BLOCKS else None
    if block is not None:
        time_s = (block + 0.5) * stretch.duration_s / blocks
        if not any(_explains(change, time_s, near_s) for change in changes):
            power = float(by_block[0, block] / np.median(by_block[0]))
            changes.append(TimeChange("block", (), number, time_s, power))
    return changes


def _histories(
    of: tuple[Complex, Complex], spectrum: Spectrum, lines: Ints, channel: int, shown: int
) -> _Histories:
    """Of a channel that so many of a record's lines show, from its residual and prediction there, (lines,) each."""
    number = int(spectrum.stretch[lines[0]])
    stretch = spectrum.stretches[number]
    assert isinstance(stretch, WholeRecord)
    residual, prediction = of
    order = stretch.orders(spectrum.frequency_hz[lines])
    samples = samples_of_squares(order)  # so that no peak is missed
    return _Histories(
        spectrum.channels[channel].name,
        number,
        history_of_lines(residual, order, samples),
        history_of_lines(prediction, order, samples),
        history_of_lines(1j * spectrum.omega[lines] * prediction, order, samples),
        stretch.duration_s / samples,
        samples / (2 * shown),
    )


def _explains(jump: TimeChange, time_s: float, near_s: float) -> bool:
    """Whether a jump, or one of several, may be what makes the block at that time loud."""
    return jump.times > 1 or abs(jump.time_s - time_s) < DECAY * LINES_EACH * near_s


def _jump(of: _Histories) -> TimeChange | None:
    """The largest departure that noise of the size of its neighbours would not show, and how many there are."""
    e, each = of.residual, of.each
    power = np.concatenate([[0.0], np.cumsum(e**2)])
    rows = np.arange(len(e))

    def within(reach: int) -> tuple[Real, Ints]:
        begin, end = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, len(e))
        return power[end] - power[begin], end - begin

    wide, narrow = within(round(NEARBY * each)), within(round(AT_ONCE * each))
    usual = (wide[0] - narrow[0]) / np.maximum(wide[1] - narrow[1], 1)
    usual = np.maximum(usual, _louder_with_motion(of, usual))
    size = np.abs(e) / np.sqrt(np.where(usual > 0, usual, np.inf))
    edge = round(AT_ONCE * each)  # the terms of the ends have their own errors
    size[:edge] = size[len(size) - edge :] = 0.0
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
    return TimeChange(
        "jump", (of.channel,), of.record, largest * of.step_s, float(size[largest]), times=times
    )


def _louder_with_motion(of: _Histories, usual: Real) -> Real:
    """Variance of the residual as a straight line over the square of the motion, (samples,): noise may grow with it.

    usual (samples,) as it is nearby: what is far beyond tells of jumps.
    """
    square, motion = np.minimum(of.residual**2, HEAVY * usual), of.prediction**2
    about = motion - np.mean(motion)
    slope = max(float(np.mean(about * square)) / max(float(np.mean(about**2)), np.finfo(float).tiny), 0.0)
    line: Real = np.maximum(np.mean(square) + slope * about, 0.0)
    return line


def _over_usual(of: _Histories) -> Real:
    """Squares of the residual over what is usual where the motion is as large, (samples,)."""
    typical = np.median(of.residual**2) / MEDIAN
    usual = _louder_with_motion(of, np.full(len(of.residual), typical))
    return of.residual**2 / np.maximum(usual, QUIET * typical)


@dataclass(frozen=True)
class _Change:
    """How the share of one shape of motion in the residual changes: when, from what to what, at once or gradually."""

    time_s: float
    before: float
    after: float
    gradual: bool

    def told(self, of: _Histories, kind: Kind, size: float) -> TimeChange:
        """The same as what it means."""
        return TimeChange(kind, (of.channel,), of.record, self.time_s, size, self.gradual)


def _steps(of: _Histories) -> list[TimeChange]:
    """Changes of the channel's gain or clock; where motion that is later or earlier says more, a slip of the clock.

    What is late by a good part of a cycle lacks more than its slope: it reads less, or has turned.
    """
    changes = [change for change in (_gain_change(of), _clock_change(of)) if change is not None]
    for change in changes:
        slipped = (
            None
            if change.gradual
            else slip(of.residual + of.prediction, of.prediction, change.time_s / of.step_s)
        )
        if slipped is not None:
            late_s = slipped.samples * of.step_s
            return [TimeChange("clock", (of.channel,), of.record, slipped.turn * of.step_s, late_s)]
    return changes


def _gain_change(of: _Histories) -> TimeChange | None:
    """A change of the channel's gain."""
    change = _change(of, of.prediction)
    if change is None:
        return None
    ratio = (1 + change.after) / (1 + change.before)
    return change.told(of, "gain", ratio) if abs(ratio - 1) > STEP else None


def _clock_change(of: _Histories) -> TimeChange | None:
    """A change of the channel's clock."""
    change = _change(of, of.slope)
    if change is None:
        return None
    late = change.before - change.after  # what is late by δ lacks δ times the slope
    least = STEP * float(np.sqrt(np.mean(of.prediction**2) / np.mean(of.slope**2)))
    return change.told(of, "clock", late) if abs(late) > least else None


def _change(of: _Histories, shape: Real) -> _Change | None:
    """Where the share of a shape of motion (samples,) in the residual changes; None where it does not."""
    edges = np.linspace(0, len(of.residual), PARTS + 1).astype(np.int64)
    e = of.residual
    size = np.add.reduceat(shape**2, edges[:-1])
    if not np.all(size > 0):
        return None
    share = np.add.reduceat(e * shape, edges[:-1]) / size
    left_over = (e - np.repeat(share, np.diff(edges)) * shape) * shape
    # The noise may be louder where the motion is: each part tells its own.
    variance = of.each * np.add.reduceat(left_over**2, edges[:-1]) / size**2
    weight = 1 / np.maximum(variance, np.finfo(float).tiny)

    def explained(*shapes: Real) -> tuple[float, Real]:
        root, columns = np.sqrt(weight), np.stack(shapes, axis=1)
        fitted = columns @ np.linalg.lstsq(root[:, None] * columns, root * share, rcond=None)[0]
        return float(np.sum(weight * (share - fitted) ** 2)), fitted

    parts = np.arange(PARTS)
    even = np.ones(PARTS)
    whole, _ = explained(even)
    freedom = len(e) / of.each / PARTS - 1  # of each part's variance
    if not fdtrc(PARTS - 1, freedom, whole / (PARTS - 1)) < STEP_LEVEL:
        return None
    steps = [explained((parts < k) * even, (parts >= k) * even) for k in range(1, PARTS)]
    best = int(np.argmin([rest for rest, _ in steps]))
    rest, fitted = steps[best]
    rest_of_line, line = explained(even, even * parts)
    if min(rest, rest_of_line) > (1 - STEP_SHARE) * whole:
        return None
    if rest_of_line < rest:
        half = (line[1] - line[0]) / 2  # from the middle of a part to its end
        return _Change(len(e) * of.step_s, float(line[0] - half), float(line[-1] + half), gradual=True)
    before, after = float(fitted[0]), float(fitted[-1])
    turn = step_sample(e * shape, shape**2, (before, after), edges[best], edges[best + 2])
    return _Change(turn * of.step_s, before, after, gradual=False)


def _of_blocks(of: _Histories, blocks: int) -> Real:
    """Mean squares of a channel in blocks of time, (3, blocks): residual, the same over what is usual, motion."""
    edges = np.linspace(0, len(of.residual), blocks, endpoint=False).astype(np.int64)
    count = np.diff(np.append(edges, len(of.residual)))
    squares = (of.residual**2, _over_usual(of), (of.prediction + of.residual) ** 2)
    means: Real = np.stack([np.add.reduceat(values, edges) for values in squares]) / count
    return means


def _loud_block(by_block: Real, dof: float) -> int | None:
    """The block in which all residuals are loud: at once, alone, and more than the motion explains.

    A model that does not fit is loud wherever the motion is.  by_block (3, blocks): `_of_blocks` summed over channels;
    dof of a block's power.
    """
    left, over_usual, motion = by_block
    blocks, power = len(left), left / np.median(left)
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
    return j if alone and share[j] > LOUDER * share[loudest] else None


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
    record = f" in record {change.record + 1}" if records > 1 else ""
    where = f"{change.time_s:.4g} s{record}"
    if change.kind == "block":
        return f"the residuals jump near {where} and decay again"
    names = joined(change.channels)
    if change.kind == "gain":
        when = f"at the end as at the start{record}" if change.gradual else f"after {where} as before"
        return f"{names} reads {change.size:.3g} × as much {when}"
    if change.kind == "clock":
        word = "later" if change.size > 0 else "earlier"
        when = f"at the end than at the start{record}" if change.gradual else f"after {where} than before"
        return f"{names} is {1e3 * abs(change.size):.3g} ms {word} {when}"
    several = len(change.channels) > 1
    again = f" and at {change.times - 1} more times" if change.times > 1 else ""
    return f"{names} jump{'' if several else 's'} off the prediction at {where} ({change.size:.0f} sd){again}"


def change_notice(change: TimeChange, records: int, more: int = 0) -> Notice:
    """The change as a warning of the estimate; of how many records it is one, and in how many more it is alike."""
    again = f", and likewise in {more} more record{'s' if more > 1 else ''}" if more else ""
    text = change_in_words(change, records) + again
    if change.kind == "gain":
        return Notice(GAIN_STEP, text, change.channels)
    if change.kind == "clock":
        return Notice(CLOCK_STEP, text, change.channels)
    if change.times > 1:
        return Notice(SPIKES, text, change.channels)
    return Notice(JUMP, text, change.channels)
