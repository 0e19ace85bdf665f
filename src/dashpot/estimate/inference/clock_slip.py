"""Where a history steps, and by how much its clock slips: from one sample on it is later than what is predicted of it.

Slips of more than a part of a cycle are no small delay: the motion has turned, or reads less, by its correlation with
the prediction at no lag.  The lag at which each part of it is most like the prediction tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from dashpot.arrays import Real

SLIPPED = 0.3  # of what the parts differ from the prediction, that a slip leaves at the most
AS_GOOD = (
    0.002  # of the correlation that a smaller slip may miss: periodic motion is like itself a period later
)
EDGE = 0.02  # of a history at either end that is left out
LEAST_REACH = 4  # samples on either side that there must be to look for one


@dataclass(frozen=True)
class Slip:
    """By how many samples a history is later from the sample `turn` on."""

    turn: int
    samples: float


@dataclass(frozen=True)
class _Lag:
    """Samples by which a part of a history is late, and what differs as it is and with that taken out, 0 … 1."""

    samples: float
    left: float
    left_at_best: float


def slip(measured: Real, prediction: Real, near: float) -> Slip | None:
    """The slip of a history (samples,) that changes near that sample; None where it is another change.

    Slips of up to half of the shorter part are looked for.
    """
    turn, count = round(near), len(measured)
    reach = round(min(turn, count - turn) / 2 - EDGE * count)
    if reach < LEAST_REACH:
        return None
    edge = round(EDGE * count)  # where the terms of a record's ends are
    before, after = (
        _lag(measured, prediction, begin, end, reach) for begin, end in ((edge, turn), (turn, count - edge))
    )
    if before is None or after is None or before.samples == after.samples:
        return None
    if max(before.left_at_best, after.left_at_best) > SLIPPED * max(before.left, after.left):
        return None
    rows = np.arange(count)

    def squares(late: float) -> Real:
        shifted: Real = np.interp(rows - late, rows, prediction)
        return (measured - shifted) ** 2

    gained = np.cumsum(squares(before.samples) - squares(after.samples))
    return Slip(reach + int(np.argmin(gained[reach : count - reach])) + 1, after.samples - before.samples)


def _lag(measured: Real, prediction: Real, begin: int, end: int, reach: int) -> _Lag | None:
    """How late the samples from begin to end are, by their correlation with the prediction; None where it is still."""
    rows = np.arange(begin - reach, end + reach)
    shown = np.where(
        (rows >= 0) & (rows < len(prediction)), prediction[np.clip(rows, 0, len(prediction) - 1)], 0.0
    )
    size = next_fast_len(len(shown) + end - begin, real=True)
    like = irfft(rfft(shown, size) * np.conj(rfft(measured[begin:end], size)), size)[: 2 * reach + 1][::-1]
    power = np.concatenate([[0.0], np.cumsum(shown**2)])
    energy = (power[end - begin :][: 2 * reach + 1] - power[: 2 * reach + 1])[::-1]
    total = float(np.sum(measured[begin:end] ** 2))
    if total <= 0 or np.min(energy) <= 0:
        return None
    left = 1 - np.maximum(like, 0.0) ** 2 / (energy * total)
    least = 1 + np.flatnonzero((left[1:-1] <= left[:-2]) & (left[1:-1] <= left[2:]))
    good = least[left[least] <= np.min(left) + AS_GOOD * (1 - np.min(left))]
    best = int(good[np.argmin(np.abs(good - reach))]) if len(good) else reach
    if not 0 < best < 2 * reach or left[best] > SLIPPED * left[reach]:
        return _Lag(0.0, float(left[reach]), float(left[reach]))
    first, middle, last = left[best - 1 : best + 2]
    bend = first - 2 * middle + last
    between = 0.5 * (first - last) / bend if bend > 0 else 0.0
    return _Lag(best - reach + float(between), float(left[reach]), float(middle))


def step_sample(product: Real, power: Real, shares: tuple[float, float], begin: int, end: int) -> int:
    """The sample from begin to end at which the share steps: least squares of the residual there."""
    before, after = shares
    # What a sample adds to the sum of squares with the share before, less what it adds with the one after.
    change = -2 * (before - after) * product[begin:end] + (before**2 - after**2) * power[begin:end]
    return int(begin + np.argmin(np.cumsum(change)) + 1)
