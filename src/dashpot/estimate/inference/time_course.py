"""What changes in the course of a whole record: a jump off the prediction, a channel that reads more or later, noise
that grows louder; and whether parts of the band agree.

The lines of a record are one history each of residual and prediction.  A spike, lost samples, a sensor that comes loose
or another range are spread over all lines, and there nothing but noise, which is read from the residuals themselves;
in time they stand where they are.  Lost samples are a new start, too: its free decay is in no input and at neither end,
so that the residuals of all channels together are loud for a while, though none may stand out at any moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc, fdtrc, stdtrit

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.noise import equal_variances, smoothed
from dashpot.data.spectrum import LinesInTime, Spectrum
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import RESIDUAL, residuals_of_records
from dashpot.estimate.likelihood.record_passes import RecordPieces
from dashpot.estimate.likelihood.record_sums import record_residuals, rows_by_line
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation import Prepared
from dashpot.io.words import joined
from dashpot.model.observation import small
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import QuadraticModel
from dashpot.numerics.small_systems import scaled_inverse

BLOCKS = 48  # of time in a record, at most
TINY = np.finfo(float).tiny

# Steps of a channel's gain or clock, jumps, and blocks in which all residuals are loud.

GAIN_STEP = "gain_step"
CLOCK_STEP = "clock_step"
SPIKES = "spikes"
JUMP = "residual_jump"
TIME_CHANGES = (GAIN_STEP, CLOCK_STEP, SPIKES, JUMP)  # codes of the notices made here

AT_ONCE = 6  # of them that one departure lasts
LINES_EACH = 10  # of a block at the least, of all channels: short records have fewer blocks
DECAY = 4  # blocks that a new start decays in

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

    def louder_with_motion(self, usual: Real) -> Real:
        """Variance of the residual as a straight line over the square of the motion, (samples,).

        usual (samples,) as it is nearby: what is beyond 16 times that is no noise, and tells of jumps.
        """
        square, motion = np.minimum(self.residual**2, 16.0 * usual), self.prediction**2
        about = motion - np.mean(motion)
        slope = max(float(np.mean(about * square)) / max(float(np.mean(about**2)), TINY), 0.0)
        return np.maximum(np.mean(square) + slope * about, 0.0)

    @property
    def typical(self) -> float:
        """Variance of the residual by its median, which a few large ones do not move."""
        return float(np.median(self.residual**2)) / 0.455  # the median of a square of noise of variance 1

    def usual(self) -> Real:
        """Variance of the residual for the motion at each sample, (samples,).

        Noise is taken for no quieter than a fifth where the rig hardly moves.
        """
        typical = self.typical
        louder = self.louder_with_motion(np.full(len(self.residual), typical))
        return np.maximum(louder, max(0.2 * typical, TINY))


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

    alike: dict[tuple[Kind, frozenset[str], bool], list[TimeChange]] = {}
    for change in time_changes(whitened, spectrum, np.flatnonzero(~view.inputs_alone)):
        alike.setdefault((change.kind, frozenset(change.channels), change.gradual), []).append(change)
    return tuple(change_notice(some[0], len(spectrum.records), len(some) - 1) for some in alike.values())


def time_changes(whitened: Whitened, spectrum: Spectrum, outputs: Ints) -> tuple[TimeChange, ...]:
    """Changes in the whole records of a spectrum.

    whitened  residual and prediction over the noise, (lines,) each, of some lines and a channel; outputs: the channels
    """
    return tuple(c for number in spectrum.records for c in _of_record(whitened, spectrum, number, outputs))


def _of_record(whitened: Whitened, spectrum: Spectrum, number: int, outputs: Ints) -> list[TimeChange]:
    """Changes of one record, each told once: jumps of several channels at one time as one."""
    at = spectrum.in_time(number).for_squares
    lines = at.lines
    shown = {int(c): int(np.count_nonzero(whitened(lines, int(c))[0])) for c in outputs}
    shown = {c: count for c, count in shown.items() if count >= 60}  # lines of parts that can be compared
    if not shown:
        return []
    near_s, total = at.duration_s / len(lines), sum(shown.values())
    blocks = min(BLOCKS, total // len(shown) // LINES_EACH)
    steps, jumps, by_block = list[TimeChange](), list[TimeChange](), np.zeros((3, blocks))
    residuals: list[Complex] = []
    for c, count in shown.items():  # histories of one channel at a time: those of long records are large
        residual, prediction = whitened(lines, c)
        residuals.append(residual)
        rate = 1j * spectrum.omega[lines] * prediction
        left, motion, slope = (at.history_of(each) for each in (residual, prediction, rate))
        name, independent = spectrum.channels[c].name, at.samples / (2 * count)
        of = _Histories(name, number, left, motion, slope, at.step_s, independent)
        steps += _steps(of)
        jumps += _jump(of)
        if blocks:
            # Mean squares of a channel in blocks of time, (3, blocks): residual, the same over what is usual, motion
            edges = np.linspace(0, len(of.residual), blocks, endpoint=False).astype(np.int64)
            square = np.minimum(of.residual**2, 16.0 * of.typical)  # what is beyond shows at its moment
            squares = square, square / of.usual(), (of.prediction + of.residual) ** 2
            samples = np.diff(np.append(edges, len(square)))
            by_block += np.stack([np.add.reduceat(values, edges) for values in squares]) / samples
    if len(steps) == 1:
        # What the step leaves at its edge jumps, too.
        return [*steps, *(jump for jump in jumps if jump.channels != steps[0].channels)]
    # Several steps at once are no channel's gain, but a rig that is another or drives what it has not.
    changes = list[TimeChange]()
    for jump in sorted(jumps, key=lambda each: -each.size):  # several channels' at one time as the largest
        for i, group in enumerate(changes):
            if abs(group.time_s - jump.time_s) <= AT_ONCE * near_s:
                channels = (*group.channels, *jump.channels)
                changes[i] = replace(group, channels=channels, times=max(group.times, jump.times))
                break
        else:
            changes.append(jump)
    block = _loud_block(by_block, 2 * _independent(np.stack(residuals, axis=1)) / max(blocks, 1))
    if block is None:
        return changes
    time_s = (block + 0.5) * at.duration_s / blocks
    if not any(each.times > 1 or abs(each.time_s - time_s) < DECAY * LINES_EACH * near_s for each in changes):
        power = float(by_block[0, block] / np.median(by_block[0]))
        changes.append(TimeChange("block", (), number, time_s, power))
    return changes


def _independent(left: Complex) -> float:
    """How many independent complex numbers scatter as the power of these (lines, channels) does.

    Satterthwaite's: noise that channels share counts once.
    """
    alike = left.conj().T @ left
    power = float(np.trace(alike).real) ** 2 / max(float(np.sum(np.abs(alike) ** 2)), TINY)
    return power * np.count_nonzero(left) / left.shape[1]


def _jump(of: _Histories) -> list[TimeChange]:
    """The largest departure that noise of the size of its neighbours would not show, and how many there are."""
    e, each = of.residual, of.each
    power = np.concatenate([[0.0], np.cumsum(e**2)])
    rows = np.arange(len(e))
    # 200: independent samples on either side that show the usual size
    near, edge = round(200 * each), round(AT_ONCE * each)
    sums, counts = list[Real](), list[Ints]()
    for reach in (near, edge):
        begin, end = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, len(e))
        sums.append(power[end] - power[begin])
        counts.append(end - begin)
    usual = (sums[0] - sums[1]) / np.maximum(counts[0] - counts[1], 1)
    usual = np.maximum(usual, of.louder_with_motion(usual))
    size = np.abs(e) / np.sqrt(np.where(usual > 0, usual, np.inf))
    size[:edge] = size[len(size) - edge :] = 0.0  # the terms of the ends have their own errors
    # Once in 10,000 records of a right rig
    far = np.flatnonzero(size > farthest((np.abs(e) / np.sqrt(of.usual()))[:: round(each)], 1e-4))
    if not len(far):
        return []
    largest, elsewhere = int(np.argmax(size)), np.ones(len(e), dtype=bool)
    for row in far:
        elsewhere[max(row - near, 0) : row + near] = False
    # A model that does not fit departs by much again and again.
    if not size[largest] > 1.25 * np.max(size, where=elsewhere, initial=0.0):
        return []
    times = 1 + int(np.count_nonzero(np.diff(far) > AT_ONCE * each))
    at_s = largest * of.step_s
    return [TimeChange("jump", (of.channel,), of.record, at_s, float(size[largest]), times=times)]


def farthest(size: Real, chance: float) -> float:
    """What the largest of independent noise exceeds with this chance, where most of it is like `size` (samples,), the
    noise over its usual size.

    Noise of real sensors has tails: it is Student's, with the scale of the median and the degrees of freedom of the
    middle one of the largest of blocks of time, taken two of its deviations larger.  A few departures spoil a few
    blocks.
    """
    blocks = min(BLOCKS, max(len(size) // LINES_EACH, 1))
    each = len(size) // blocks
    largest = np.max(size[: blocks * each].reshape(blocks, each), axis=1)
    low, middle, high = np.quantile(largest, (0.25, 0.5, 0.75))
    middle += (
        2 * 1.25 * (high - low) / 1.35 / np.sqrt(blocks)
    )  # 1.25, 1.35: of a normal's median and quartiles
    usual = float(np.median(size))
    if not usual > 0:
        return np.inf
    degrees = np.geomspace(1.0, 1e4, 400)
    ratios = stdtrit(degrees, 0.5 + 0.5 * 0.5 ** (1 / each)) / stdtrit(degrees, 0.75)
    dof = float(np.interp(-middle / usual, -ratios, degrees))
    scale = max(usual / stdtrit(dof, 0.75), 1.0)
    return float(scale * -stdtrit(dof, chance / (2 * len(size))))


def _steps(of: _Histories) -> list[TimeChange]:
    """Changes of the channel's gain or clock; where motion that is later or earlier says more, a slip of the clock.

    What is late by a good part of a cycle lacks more than its slope: it reads less, or has turned.
    """
    changes = list[TimeChange]()
    change = _share_change(of, of.prediction)
    if change is not None:
        time_s, before, after, gradual = change
        ratio = (1 + after) / (1 + before) if before != -1 else np.inf  # of what reads nothing before
        if abs(ratio - 1) > 0.01:  # a smaller step is of no account
            changes.append(TimeChange("gain", (of.channel,), of.record, time_s, ratio, gradual))
    change = _share_change(of, of.slope)
    if change is not None:
        time_s, before, after, gradual = change
        late = before - after  # what is late by δ lacks δ times the slope
        if abs(late) > 0.01 * float(np.sqrt(np.mean(of.prediction**2) / np.mean(of.slope**2))):
            changes.append(TimeChange("clock", (of.channel,), of.record, time_s, late, gradual))
    for change_at_once in (each for each in changes if not each.gradual):
        slipped = _slip(of.residual + of.prediction, of.prediction, change_at_once.time_s / of.step_s)
        if slipped is not None:
            turn_s, late_s = (number * of.step_s for number in slipped)
            return [TimeChange("clock", (of.channel,), of.record, turn_s, late_s)]
    return changes


def _share_change(of: _Histories, shape: Real) -> tuple[float, float, float, bool] | None:
    """How the share of a shape of motion (samples,) in the residual changes; None if it does not.

    The time in s, the share before and after, and whether it changes gradually.
    """
    e, parts = of.residual, np.arange(8)  # of a record, each with a share of its own
    edges = np.linspace(0, len(e), len(parts) + 1).astype(np.int64)
    size = np.add.reduceat(shape**2, edges[:-1])
    # A search that was lost predicts motion whose squares are beyond all numbers.
    with np.errstate(all="ignore"):
        share = np.add.reduceat(e * shape, edges[:-1]) / size
        left_over = (e - np.repeat(share, np.diff(edges)) * shape) * shape
        # The noise may be louder where the motion is: each part tells its own.
        variance = of.each * np.add.reduceat(left_over**2, edges[:-1]) / size**2
    if not (np.all(size > 0) and np.all(np.isfinite(variance))):
        return None
    weight = 1 / np.maximum(variance, TINY)

    def explained(*shapes: Real) -> tuple[float, Real]:
        root, columns = np.sqrt(weight), np.stack(shapes, axis=1)
        fitted = columns @ np.linalg.lstsq(root[:, None] * columns, root * share, rcond=None)[0]
        return float(np.sum(weight * (share - fitted) ** 2)), fitted

    even, freedom = np.ones(len(parts)), len(e) / of.each / len(parts) - 1  # of each part's variance
    whole, _ = explained(even)
    if not fdtrc(len(parts) - 1, freedom, whole / (len(parts) - 1)) < 1e-6:
        return None
    steps = [explained((parts < k) * even, (parts >= k) * even) for k in parts[1:]]
    best = int(np.argmin([rest for rest, _ in steps]))
    rest, fitted = steps[best]
    rest_of_line, line = explained(even, even * parts)
    if min(rest, rest_of_line) > 0.3 * whole:  # one step must explain most of the differences
        return None
    if rest_of_line < rest:
        half = (line[1] - line[0]) / 2  # from the middle of a part to its end
        return len(e) * of.step_s, float(line[0] - half), float(line[-1] + half), True
    before, after = float(fitted[0]), float(fitted[-1])
    # What a sample adds to the sum of squares with the share before, less what it adds with the one after
    near = slice(edges[best], edges[best + 2])
    change = -2 * (before - after) * (e * shape)[near] + (before**2 - after**2) * (shape**2)[near]
    turn = int(edges[best] + np.argmin(np.cumsum(change)) + 1)
    return turn * of.step_s, before, after, False


def _slip(measured: Real, prediction: Real, near: float) -> tuple[int, float] | None:
    """The sample near that one from which on a history (samples,) is later, and by how many; None if none is.

    Slips of more than a part of a cycle are no small delay: the motion has turned, or reads less, by its correlation
    with the prediction at no lag.  The lag at which each part of it is most like the prediction tells them apart; lags
    of up to half of the shorter part are looked for.
    """
    turn, count = round(near), len(measured)
    edge = round(0.02 * count)  # where the terms of a record's ends are
    reach = round(min(turn, count - turn) / 2 - 0.02 * count)
    if reach < 4:
        return None
    before, after = (
        _lag(measured, prediction, begin, end, reach) for begin, end in ((edge, turn), (turn, count - edge))
    )
    if before is None or after is None or before[0] == after[0]:
        return None
    if max(before[2], after[2]) > LEFT_BY_LAG * max(before[1], after[1]):
        return None
    rows = np.arange(count)
    squares = [(measured - np.interp(rows - late, rows, prediction)) ** 2 for late in (before[0], after[0])]
    gained = np.cumsum(squares[0] - squares[1])
    return reach + int(np.argmin(gained[reach : count - reach])) + 1, after[0] - before[0]


LEFT_BY_LAG = 0.3  # of what a part differs from the prediction, that a lag leaves at the most


def _lag(
    measured: Real, prediction: Real, begin: int, end: int, reach: int
) -> tuple[float, float, float] | None:
    """Samples by which a part of a history is late, by its correlation with the prediction, and what differs as it is
    and with that taken out, 0 … 1; None if it is still."""
    rows = np.arange(begin - reach, end + reach)
    inside = (rows >= 0) & (rows < len(prediction))
    shown = np.where(inside, prediction[np.clip(rows, 0, len(prediction) - 1)], 0.0)
    size = next_fast_len(len(shown) + end - begin, real=True)
    like = irfft(rfft(shown, size) * np.conj(rfft(measured[begin:end], size)), size)[: 2 * reach + 1][::-1]
    power = np.concatenate([[0.0], np.cumsum(shown**2)])
    energy = (power[end - begin :][: 2 * reach + 1] - power[: 2 * reach + 1])[::-1]
    total = float(np.sum(measured[begin:end] ** 2))
    if total <= 0 or np.min(energy) <= 0:
        return None
    left = 1 - np.maximum(like, 0.0) ** 2 / (energy * total)
    least = 1 + np.flatnonzero((left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:]))
    # Periodic motion is like itself a period later: a smaller lag may miss a little of the correlation.
    good = least[left[least] <= np.min(left) + 0.002 * (1 - np.min(left))]
    best = int(good[np.argmin(np.abs(good - reach))]) if len(good) else reach
    if not 0 < best < 2 * reach or left[best] > LEFT_BY_LAG * left[reach]:
        return 0.0, float(left[reach]), float(left[reach])
    first, middle, last = left[best - 1 : best + 2]
    bend = first - 2 * middle + last
    between = 0.5 * (first - last) / bend if bend > 0 else 0.0
    return best - reach + float(between), float(left[reach]), float(middle)


def _loud_block(by_block: Real, dof: float) -> int | None:
    """The block in which all residuals are loud: at once, alone, and more than the motion explains.

    A model that does not fit is loud wherever the motion is.  by_block (3, blocks): `_of_blocks` summed over channels;
    dof of a block's power.
    """
    left, over_usual, motion = by_block
    blocks = len(left)
    if blocks < 17:  # that a loud one can stand out of
        return None
    power = left / np.median(left)
    j = int(np.argmax(power))
    if not 0 < j < blocks - 1:  # the terms of the ends have their own errors
        return None
    surely = min(power[j], over_usual[j] / np.median(over_usual))
    if not fdtrc(dof, dof * (blocks - 1), surely) < 1e-6 / blocks:
        return None
    behind = np.arange(blocks) - j
    apart = (behind < -1) | (behind > DECAY)
    share = np.maximum(power - 1, 1 / np.sqrt(dof)) / np.maximum(motion, TINY)
    loudest = np.flatnonzero(apart)[np.argmax(motion[apart])]
    # Twice as far above the usual as any block apart from it, and four times what the loudest motion leaves unexplained
    alone = power[j] - 1 > 2.0 * (np.max(power[apart]) - 1)
    return j if alone and share[j] > 4.0 * share[loudest] else None


def change_in_words(change: TimeChange, records: int) -> str:
    """What changes, in words; of how many records it is one."""
    record = f" in record {change.record + 1}" if records > 1 else ""
    where = f"{change.time_s:.4g} s{record}"
    if change.kind == "block":
        return f"the residuals rise abruptly near {where} and die away again"
    names = joined(change.channels)
    if change.kind == "gain":
        when = f"from start to end{record}" if change.gradual else f"after {where}"
        return f"the gain of {names} changes by a factor of {change.size:.3g} {when}"
    if change.kind == "clock":
        word = "later" if change.size > 0 else "earlier"
        when = f"at the end than at the start{record}" if change.gradual else f"after {where} than before"
        return f"{names} is {1e3 * abs(change.size):.3g} ms {word} {when}"
    several = len(change.channels) > 1
    again = f" and at {change.times - 1} more times" if change.times > 1 else ""
    return (
        f"{names} depart{'' if several else 's'} abruptly from the prediction at {where} "
        f"({change.size:.0f} standard deviations){again}"
    )


def change_notice(change: TimeChange, records: int, more: int = 0) -> Notice:
    """The change as a warning of the estimate; of how many records it is one, and in how many more it is alike."""
    again = f", and the same in {more} more record{'s' if more > 1 else ''}" if more else ""
    said = change_in_words(change, records) + again, change.channels
    if change.kind in ("gain", "clock"):
        return Notice(GAIN_STEP, *said) if change.kind == "gain" else Notice(CLOCK_STEP, *said)
    return Notice(SPIKES, *said) if change.times > 1 else Notice(JUMP, *said)


# Noise that is louder at some times of a whole record than at others, as where it grows with the motion.
#
# Lines of a record are independent where its noise has one size throughout. Where it has not, neighbouring
# lines are correlated, and what is seen at a loud time tells less of a parameter than its lines say: with
# noise in proportion to the motion of a stepped sine, standard deviations from the lines alone are 5 to 20
# % too small. In time such noise is independent from sample to sample. So the covariance of the scores is
# summed over blocks of time, each with the power that the residual has there (the sandwich of Huber and
# White), and one Gauss-Newton step with samples weighted by that power leads to the estimate that the noise
# allows.

UNEVEN = "noise_in_time"
EACH_POWER = 20  # lines of a block at the least: each tells its power by two numbers


@dataclass(frozen=True)
class EvenNoise:
    """What the lines of one repeat say of M unknowns: information (M, M) and gradient (M,) of all of them, and the
    covariance (M, M) and its degrees of freedom (M,) where noise is even, with what estimating its size costs."""

    information: Real
    gradient: Real
    covariance: Real
    dof: Real


@dataclass(frozen=True)
class EstimateInTime:
    """An estimate of M unknowns as a step (M,) from the one that weighs lines, with its covariance (M, M) and the
    degrees of freedom of that, (M,)."""

    step: Real
    covariance: Real
    dof: Real


@dataclass(frozen=True)
class NoiseInTime:
    """Blocks of time of those channels of whole records whose noise is not even; for M unknowns.

    products (blocks, M + 1, M + 1) of whitened slopes and, last, residual, which sum to those of the lines; power
    (blocks,) of the residual over its mean in the record, and the degrees of freedom `dof` (blocks,) behind it
    """

    products: Real
    power: Real
    dof: Real

    @property
    def weight(self) -> Real:
        """Of the samples of each block, (blocks,); no block counts as quieter than a hundredth of the mean."""
        return 1 / np.maximum(self.power, 0.01)

    def bound(self, lines: EvenNoise) -> Real:
        """The least covariance that the noise allows, (M, M); 1/power of few samples is too large on the mean."""
        more = self._more(self.weight * (self.dof - 2) / self.dof)
        return scaled_inverse(lines.information + more[:-1, :-1])

    def of_lines(self, lines: EvenNoise) -> EstimateInTime:
        """The estimate that weighs lines."""
        bread = scaled_inverse(lines.information)
        return self._estimate(lines, bread, np.zeros(len(bread)), self.power)

    def of_samples(self, lines: EvenNoise) -> EstimateInTime:
        """The estimate that weighs samples by the noise at their time."""
        more = self._more(self.weight)
        bread = scaled_inverse(lines.information + more[:-1, :-1])
        # Weights and powers are of the same few samples: moments of inverse χ².
        size = self.weight**2 * self.power * self.dof / (self.dof - 4)
        return self._estimate(lines, bread, bread @ (lines.gradient + more[:-1, -1]), size)

    def notice(self) -> Notice:
        """What is to be said of it."""
        return Notice(
            UNEVEN,
            f"the noise varies in time: at its loudest, its power is {np.max(self.power):.2g} times the mean",
        )

    def _more(self, weight: Real) -> Real:
        """What weights add to the products of the lines, (M + 1, M + 1)."""
        return np.einsum("b,bij->ij", weight - 1, self.products)

    def _estimate(self, lines: EvenNoise, bread: Real, step: Real, size: Real) -> EstimateInTime:
        """With the inverse of its information, and the size of the scores' covariance in each block."""
        scores = lines.information @ lines.covariance @ lines.information + self._more(size)[:-1, :-1]
        covariance = bread @ scores @ bread
        of_blocks = bread @ self.products[:, :-1, :-1] @ bread
        shares = size[:, None] * np.diagonal(of_blocks, axis1=-2, axis2=-1)
        with np.errstate(divide="ignore"):
            dof = np.diagonal(covariance) ** 2 / np.sum(shares**2 / self.dof[:, None], axis=0)
        return EstimateInTime(step, covariance, np.minimum(lines.dof, dof))


@dataclass(frozen=True)
class CountedInTime:
    """Estimates of K repeats of M unknowns with what the noise in time makes of them.

    step (K, M) from those that weigh lines; covariance and bound (K, M, M); dof (K, M); uneven: the repeats' noise;
    louder (K,): variance of what the lines say, in the direction where it is largest, over that of even noise
    """

    step: Real
    covariance: Real
    bound: Real
    dof: Real
    uneven: tuple[NoiseInTime | None, ...]
    louder: Real


def counted_in_time(
    data: Prepared, solution: Solution, sums: QuadraticModel, covariance: Real, bound: Real, dof: Real
) -> CountedInTime:
    """The estimates of whole records with their noise in time, where that is not even.

    sums: at the solution; covariance, bound (K, M, M) and dof (K, M) are those of even noise.
    """
    exact, theta = measured(data), solution.theta
    signs = data.spectrum.signs(solution.signs, len(theta))
    step, uneven = np.zeros(theta.shape), list[NoiseInTime | None]([None] * len(theta))
    louder = np.ones(len(theta))
    covariance, bound, dof = covariance.copy(), bound.copy(), np.array(dof)
    for k in range(len(theta) if exact.ends is not None and small(data.model) else 0):
        one = slice(k, k + 1)
        at = exact.pick(one).record_pieces, theta[one], signs[one]
        blocks = _uneven_blocks(data, *at)
        if not blocks:
            continue
        uneven[k] = noise = NoiseInTime(*(np.concatenate(part) for part in zip(*blocks, strict=True)))
        lines = EvenNoise(sums.symmetric[k], sums.gradient[k], covariance[k], dof[k])
        best, of_samples = noise.of_lines(lines), noise.of_samples(lines)
        widened = lines.information @ best.covariance
        if np.all(np.isfinite(widened)):  # not so of unknowns without an interval, which the estimate refuses
            louder[k] = max(float(np.max(np.linalg.eigvals(widened).real)), 1.0)
        # A step that noise does not explain, by the estimate's own covariance: the model does not fit, and has no
        # better end.
        away = of_samples.step @ scaled_inverse(best.covariance) @ of_samples.step
        if solution.bounds is None and chdtrc(len(of_samples.step), away) > 1e-3:
            best = of_samples
        step[k], covariance[k], dof[k], bound[k] = best.step, best.covariance, best.dof, noise.bound(lines)
    return CountedInTime(step, covariance, bound, dof, tuple(uneven), louder)


def _uneven_blocks(
    data: Prepared, pieces: RecordPieces, theta: Real, sign: Real
) -> list[tuple[Real, Real, Real]]:
    """Products, power and degrees of freedom of the blocks of time of each output in each record whose residual is not
    as loud in all of them; of one repeat."""
    residual = record_residuals(pieces, theta, sign)[0][0]
    spectrum = data.spectrum
    sought = np.array(spectrum.noise) == RESIDUAL
    compared = list[tuple[LinesInTime, int, int, float, float]]()
    for number in spectrum.records:
        record = spectrum.in_time(number)
        for channel in np.flatnonzero(~data.view.inputs_alone).tolist():
            told = sought[record.lines] & (residual[record.lines, channel] != 0)
            at = replace(record, lines=record.lines[told], order=record.order[told])
            blocks = min(BLOCKS, len(at.lines) // EACH_POWER)
            if blocks < 6:  # that can be compared
                continue
            # Where inputs are noisy, too, residuals are louder at some lines, which then tell more than others.
            loud = smoothed(np.abs(residual[at.lines, channel]) ** 2, EACH_POWER // 2)
            dof = float(2 * np.sum(loud) ** 2 / np.sum(loud**2) / blocks)
            parts = _in_blocks(residual[:, channel], at, blocks)
            p_even = equal_variances(np.array([np.mean(part**2) for part in parts]), dof)
            compared.append((at, channel, blocks, dof, p_even))
    found = [each for each in compared if each[-1] < 0.01 / len(compared)]
    rows = rows_by_line(pieces, theta, sign)[0] if found else residual
    uneven = []
    for at, channel, blocks, dof, _ in found:
        parts = _in_blocks(rows[:, channel], at, blocks)
        products = np.stack([part.T @ part for part in parts])
        power = products[:, -1, -1] / np.array([len(part) for part in parts])
        scale = 4 / sum(len(part) for part in parts)
        uneven.append((products * scale, power / np.mean(power), np.full(blocks, dof)))
    return uneven


def _in_blocks(rows: Complex, at: LinesInTime, blocks: int) -> list[Real]:
    """Rows (lines, ...) in the time of a record: those of each block, (samples, ...)."""
    history = at.for_squares.history(rows)
    begins = np.linspace(0, len(history), blocks, endpoint=False).astype(np.int64)
    return np.split(history, begins[1:])


# Whether parts of the band agree on the parameters, and how far they move when one part is left out (THEORY
# §11).
#
# What χ² rejects moves parameters by more than χ²/dof tells: over 60 random rigs with eight kinds of
# misfit, intervals widened by χ²/dof hold the truth in 74 %, widened to the scatter of the parts, too, in
# 92 %.
#
# A record whose noise is read from its own residuals has no χ² that could fail: what the model lacks counts
# as noise. A wrong model still asks each part of the band for parameters of its own, which noise does not.
# Both figures come from the information and the scores of the lines at the estimate, so that nothing is
# fitted again.

DISAGREE = "bands_disagree"


@dataclass(frozen=True)
class BandStability:
    """What parts of the band know at an estimate, for K repeats.

    information (K, parts, M, M) and scores (K, parts, M) of each part; total (K, M, M): their sum with the priors
    """

    information: Real
    scores: Real
    total: Real

    @property
    def dof(self) -> Real:
        """Degrees of freedom behind `covariance`, (K, 1); a line that knows more than a share leaves parts empty."""
        filled = np.any(_variances(self.information) > 0, axis=-1)
        return np.maximum(np.sum(filled, axis=-1, keepdims=True) - 1.0, 1.0)

    @cached_property
    def p(self) -> Real:
        """Tail probability that noise alone makes the parts differ as much, (K,): Σ Sᵀ I⁻¹ S of their scores S."""
        tails = np.ones(len(self.total))
        for k, total in enumerate(self.total):
            size = np.sqrt(np.diagonal(total))
            size = np.where(size > 0, size, 1.0)  # nothing is known of an unknown that has run away
            values, vectors = np.linalg.eigh(total / (size[:, None] * size))
            usable = values > 1e-12 * values[-1]
            root = vectors[:, usable] / np.sqrt(values[usable]) / size[:, None]
            statistic, dof = 0.0, -int(np.sum(usable))
            for part, score in zip(self.information[k], self.scores[k], strict=True):
                known, axes = np.linalg.eigh(root.T @ part @ root)
                seen = (
                    known > 0.02
                )  # parts that know less of a direction than that of the whole do not judge it
                along = (axes.T @ (root.T @ score))[seen]
                statistic += float(np.sum(along**2 / known[seen]))
                dof += int(np.sum(seen))
            tails[k] = 1.0 if dof < 1 else float(chdtrc(dof, statistic))
        return tails

    def in_noise(self, louder: Real) -> BandStability:
        """The same where noise has so many times (K,) the variance that the lines count."""
        ratio = 1 / louder[:, None, None]
        return BandStability(self.information * ratio[..., None], self.scores * ratio, self.total * ratio)

    @property
    def disagree(self) -> Bools:
        """Where the parts differ by more than noise makes them, (K,)."""
        return self.p < 1e-3

    @cached_property
    def moved(self) -> Real:
        """How far the unknowns move when each of the parts is left out, (K, parts, M)."""
        without = np.nan_to_num(scaled_inverse(self.total[:, None] - self.information))
        return -np.einsum("kgij,kgj->kgi", without, self.scores)

    @property
    def covariance(self) -> Real:
        """Of the estimate by leaving out one part at a time, (K, M, M)."""
        away = self.moved - np.mean(self.moved, axis=1, keepdims=True)
        parts = away.shape[1]
        return (parts - 1) / parts * np.einsum("kgi,kgj->kij", away, away)

    @property
    def apart(self) -> Real:
        """By how many of its standard deviations from noise each unknown moves, at most, (K, M)."""
        noise = np.sqrt(np.abs(_variances(scaled_inverse(self.total))))
        return np.max(np.abs(self.moved), axis=1) / noise

    def widened(self, covariance: Real, degrees: Real, where: Bools) -> tuple[Real, Real]:
        """Covariances (K, M, M) with their degrees of freedom (K, M), by the scatter of the parts where it is larger.

        where (K,): the repeats for which the parts count
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = _variances(self.covariance) / _variances(covariance)
        larger = where[:, None] & (np.nan_to_num(ratio) > 1.0)
        factor = np.sqrt(np.where(larger, ratio, 1.0))
        return (
            covariance * factor[:, :, None] * factor[:, None, :],
            np.where(larger, np.minimum(degrees, self.dof), degrees),
        )

    def notices(self, names: tuple[str, ...]) -> list[Notice]:
        """What the first repeat shows."""
        if not self.disagree[0]:
            return []
        most = np.argsort(-self.apart[0], kind="stable")[:2]
        moves = joined(f"{names[int(j)]} by up to {self.apart[0, j]:.2g}" for j in most)
        text = f"parts of the band disagree: leaving out one sixth of it shifts {moves} standard deviations"
        return [Notice(DISAGREE, text, tuple(names[int(j)] for j in most))]


def band_stability(frequency_hz: Real, information: Real, scores: Real, prior: Real) -> BandStability:
    """Six parts of the band that know equally much of the unknowns; as many as there are lines where these are fewer.

    frequency_hz (lines,); information (K, lines, M, M) and scores (K, lines, M), minus half the slope of the cost, at
    the estimate; prior (M, M) precision.
    """
    total = np.sum(information, axis=1) + prior
    # 1 where a line belongs to a part, (K, lines, parts): ascending in frequency, with equal shares of information
    share = np.einsum("klij,kji->kl", information, scaled_inverse(total))
    share = np.where(np.isfinite(share), np.maximum(share, 0.0), 0.0)
    order = np.argsort(frequency_hz, kind="stable")
    run = np.cumsum(share[:, order], axis=1)
    parts = min(6, len(order))
    part = np.empty(share.shape, dtype=np.int64)
    part[:, order] = np.minimum((parts * run / np.maximum(run[:, -1:], 1e-300)).astype(int), parts - 1)
    belongs = (part[..., None] == np.arange(parts)).astype(float)
    return BandStability(
        np.einsum("klg,klij->kgij", belongs, information), np.einsum("klg,kli->kgi", belongs, scores), total
    )


def _variances(covariance: Real) -> Real:
    return np.diagonal(covariance, axis1=-2, axis2=-1)
