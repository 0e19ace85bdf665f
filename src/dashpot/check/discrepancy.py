"""How much of a channel's motion the rig leaves unexplained beyond noise, as a share of that motion, with bounds.

The residual is taken as m + e: noise e, and what the rig as a model leaves, m = a ŷ, with ŷ the predicted motion and
a complex coefficient a that is alike within a block of lines.  The share is s, s² = Σ E_b |a_b|² / Σ |y|² with
E_b = Σ |ŷ|² over a block and y the measured motion.  Where the noise is known otherwise, each line is a block and
nothing is supposed of a.  Where these very residuals tell it, blocks are no wider than the nearest mode is sharp: noise
does not follow the motion from line to line, so that its size is that of the scatter within blocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc, gammaincc

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.check.residuals import Residuals
from dashpot.estimate.assessment import Discrepancy
from dashpot.estimate.result import Estimate

LEVEL = 0.05  # of either one-sided bound
LINES_OF_A_BLOCK = 4  # at the least, where the scatter within blocks sizes the noise
LEAST_WITHIN, MOST_WITHIN = (
    0.01,
    0.05,
)  # shares of the motion within which a rig fits, unless another is asked for
# Half-power width over the distance to the pole, measured along ∫ dω / |jω − λ|.
HALF_POWER = 2 * math.asinh(1.0)


def discrepancies(
    left: Residuals, estimate: Estimate, motions: Bools, known_noise: bool, within: float | None = None
) -> dict[str, Discrepancy | None]:
    """What the rig leaves of each moving channel; None where noise and discrepancy cannot be told apart.

    motions (channels,) those that show motion; known_noise: whether the noise is known from more than `left`; within:
    the share of the motion that is asked for.
    """
    shown = {str(left.channels[c]): int(c) for c in np.flatnonzero(motions)}
    shown = {name: c for name, c in shown.items() if np.any(np.isfinite(left.measured[:, c]))}
    if estimate.fit.dof < LINES_OF_A_BLOCK:  # too few to tell noise from what the unknowns have taken up
        return dict.fromkeys(shown)
    block = np.arange(len(left.frequency_hz)) if known_noise else _blocks(left, estimate)
    if block is None:
        return dict.fromkeys(shown)
    channels = {name: _ChannelBlocks.of(left, c, block, known_noise) for name, c in shown.items()}
    told = 2 * sum(len(each.weight) for each in channels.values() if each is not None)
    free = max(
        1 - len(estimate.names) / max(told, 1), 0.0
    )  # of the noise, beside what the unknowns have taken up
    return {name: None if each is None else each.bounded(free, within) for name, each in channels.items()}


@dataclass(frozen=True)
class _ChannelBlocks:
    """|a|² of one channel in blocks, its noise, and E over the motion's energy, (blocks,) each; noise over motion."""

    square: Real
    noise: Real
    weight: Real
    relative_noise: float

    @staticmethod
    def of(left: Residuals, c: int, block: Ints, known_noise: bool) -> _ChannelBlocks | None:
        """None where blocks of enough lines hold less than half of the motion."""
        seen = (
            np.isfinite(left.measured[:, c])
            & np.isfinite(left.variance[:, c])
            & (np.abs(left.predicted[:, c]) > 0)
        )
        if not np.any(np.abs(left.measured[seen, c]) > 0):
            return None
        y, v, motion = left.predicted[seen, c], left.variance[seen, c], np.abs(left.measured[seen, c]) ** 2
        r, block = left.measured[seen, c] - y, block[seen]
        number, lines = np.unique(block, return_inverse=True, return_counts=True)[1:]

        def summed(values: Real) -> Real:
            return np.bincount(number, values, len(lines)).astype(np.float64)

        power = np.abs(y) ** 2
        energy, noisy, motions = summed(power), summed(power * v), summed(motion)
        product = np.conj(y) * r
        a = (summed(product.real) + 1j * summed(product.imag)) / energy
        if not known_noise:
            enough = lines >= LINES_OF_A_BLOCK
            if np.sum(motions[enough]) < np.sum(motions) / 2:
                return None
            rest = np.abs(r - a[number] * y) ** 2
            inside = enough[number] & (v > 0)
            if not np.any(inside):
                return None
            size = np.sum(rest[inside] / v[inside]) / np.sum(lines[enough] - 1)
            v, noisy = size * v, size * noisy
            a, energy, noisy, motions = a[enough], energy[enough], noisy[enough], motions[enough]
        # Where residuals tell the noise, they tell more of it where the rig moves most and is most wrong.
        typical = np.mean(v) if known_noise else np.median(v)
        weight, relative = energy / np.sum(motions), float(np.sqrt(typical / np.mean(motion)))
        return _ChannelBlocks(np.abs(a) ** 2, noisy / energy**2, weight, relative)

    def bounded(self, free: float, asked: float | None) -> Discrepancy:
        """The share with one-sided bounds: Patnaik's approximation of the weighted sum of noncentral χ².

        The upper bound is that of CLs (Read 2002, J. Phys. G 28:2693): residuals that are small by chance do not make
        a rig better than the data can show.
        """
        w, n = self.weight, free * self.noise
        total = float(w @ self.square)
        mean, spread = float(w @ n), (float(w**2 @ n**2), float(2 * w**2 @ n))

        def tail(square: float, upper: bool) -> float:
            """Chance that so large a sum, or a larger (a smaller) one, comes of a share whose square is given."""
            expected, variance = square + mean, spread[0] + spread[1] * square
            if variance <= 0:
                return float(total >= expected if upper else total <= expected)
            shape = expected**2 / variance
            return float((gammaincc if upper else gammainc)(shape, shape * total / expected))

        value = math.sqrt(max(total - mean, 0.0))
        within = min(max(LEAST_WITHIN, self.relative_noise), MOST_WITHIN) if asked is None else asked
        if spread[0] <= 0:
            return Discrepancy(value, value, value, within)
        beyond = total + mean + 10 * math.sqrt(spread[0]) + 40 * spread[1]
        least = 0.0
        if tail(0.0, True) < LEVEL:
            least = _crossing(lambda square: tail(square, True) < LEVEL, beyond)
        asked = LEVEL * tail(0.0, False)
        while tail(beyond, False) > asked:
            beyond *= 4
        most = _crossing(lambda square: tail(square, False) > asked, beyond)
        return Discrepancy(value, math.sqrt(least), math.sqrt(max(most, 0.0)), within)


def _crossing(below: Callable[[float], bool], high: float) -> float:
    """Where from 0 to `high` what holds below ends, to the digits of a number."""
    low = 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if below(middle) else (low, middle)
    return high


def _blocks(left: Residuals, estimate: Estimate) -> Ints | None:
    """`blocks_of` an estimate's own modes; None: unknown."""
    if estimate.modes is None or not len(estimate.modes.eigenvalues):
        return None
    return blocks_of(left.frequency_hz, left.experiment, estimate.modes.eigenvalues)


def blocks_of(frequency_hz: Real, experiment: Ints, poles: Complex) -> Ints:
    """A number for each line, the same in a block: of one experiment, and no wider than a mode is sharp.

    poles rad/s.  Far from all modes blocks may reach further, in proportion to their distance.
    """
    omega = 2 * np.pi * frequency_hz
    block = np.zeros(len(omega), dtype=np.int64)
    for number in np.unique(experiment):
        lines = np.flatnonzero(experiment == number)
        lines = lines[np.argsort(omega[lines], kind="stable")]
        at = omega[lines]
        away = np.min(np.abs(1j * at[:, None] - poles), axis=1)
        steps = 2 * np.diff(at) / np.maximum(away[1:] + away[:-1], np.finfo(float).tiny)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        cell, count = np.unique(
            (along / HALF_POWER).astype(np.int64), return_inverse=True, return_counts=True
        )[1:]
        # Many lines of a cell are blocks of few, so that little is supposed to be alike.
        first = np.cumsum(count) - count
        parts = np.maximum(count // LINES_OF_A_BLOCK, 1)
        part = (np.arange(len(lines)) - first[cell]) * parts[cell] // count[cell]
        block[lines] = np.max(block, initial=0) + 1 + (np.cumsum(parts) - parts)[cell] + part
    return block
