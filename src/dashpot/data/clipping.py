"""Samples that rest at the greatest or least value of a channel: a converter or amplifier at its limit."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real

SHARE = 0.01  # of all samples, or of LOUD times as many loud ones, that are at the limit
LOUD = 10  # so that the short blows of a hammer count, too
HALF = 0.5  # of the way from the median to the limit, beyond which a sample is loud
AT_REST = 0.5  # of all samples: a value that so many have is where the channel rests
NEXT = 8  # times as many samples as at the value next to the limit: fewer are the steps of a converter


def samples_at_limit(values: Real) -> int:
    """How many samples (samples,) are at the greatest or the least value, where three in a row are."""
    if not len(values) or np.ptp(values) == 0:
        return 0
    median, clipped = float(np.median(values)), 0
    for limit, other, extreme in (
        (np.max(values), np.min(values), np.max),
        (np.min(values), np.max(values), np.min),
    ):
        at = values == limit
        count = int(np.count_nonzero(at))
        if count < 3 or count > AT_REST * len(values) or not np.any(at[2:] & at[1:-1] & at[:-2]):
            continue
        loud = (
            int(np.count_nonzero((values - median) / (limit - median) > HALF))
            if limit != median
            else len(values)
        )
        following = extreme(values, where=~at, initial=other)
        if count >= SHARE * min(len(values), LOUD * loud) and count >= NEXT * np.sum(values == following):
            clipped += count
    return clipped
