"""Samples that rest at the greatest or least value of a channel: a converter or amplifier at its limit."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Real

SHARE = 0.01  # of all samples, or of LOUD times as many loud ones, that are at the limit
LOUD = 10  # so that the short blows of a hammer count, too
HALF = 0.5  # of the way from the median to the limit, beyond which a sample is loud
AT_REST = 0.5  # of all samples: a value that so many have is where the channel rests
MOST = 1 << 20  # samples of which the median is taken, evenly spread over a record
NEXT = 8  # times as many samples as at the value next to the limit: fewer are the steps of a converter


def samples_at_limit(values: Real) -> int:
    """How many samples (samples,) are at the greatest or the least value, where three in a row are."""
    return int(np.count_nonzero(at_limits(values)))


def at_limits(values: Real, *, in_a_row: bool = True) -> Bools:
    """Which samples are at the greatest value, and which at the least, where those are limits: (2, samples).

    in_a_row: three of them have to follow each other somewhere, which of a sine with few samples a period they may not.
    """
    limits = np.zeros((2, len(values)), dtype=bool)
    if not len(values) or np.ptp(values) == 0:
        return limits
    highest, lowest = np.max(values), np.min(values)
    for side, (limit, other, extreme, beyond) in enumerate(
        ((highest, lowest, np.max, np.greater), (lowest, highest, np.min, np.less))
    ):
        at = values == limit
        count = int(np.count_nonzero(at))
        if count < 3 or count > AT_REST * len(values):
            continue
        if in_a_row and not np.any(at[2:] & at[1:-1] & at[:-2]):
            continue
        median = float(np.median(values[:: 1 + len(values) // MOST]))
        loud = len(values)
        if limit != median:
            loud = int(np.count_nonzero(beyond(values, median + HALF * (limit - median))))
        following = extreme(values, where=~at, initial=other)
        if count >= SHARE * min(len(values), LOUD * loud) and count >= NEXT * np.sum(values == following):
            limits[side] = at
    return limits
