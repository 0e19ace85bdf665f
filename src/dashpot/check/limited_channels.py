"""Channels of whole records that bend away from what they should show where it is large: clipped, or saturated."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Bools, Real
from dashpot.check.residuals import Residuals
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines
from dashpot.notices import Notice

LIMITED = "limited_channel"
LEVELS = (0.3, 0.5, 0.7, 0.85)  # of the largest motion, beyond which a channel may read less
SIDES = np.array([1.0, -1.0])  # of the motion
FAR = 0.999  # quantile of the motion that counts as the largest
IMPROBABLE = 1e-6  # p-value of a form by chance
BENT = 0.6  # of the slope in the middle: what a channel near its limit shows at most
ENDS = 0.02  # of a record at either end, where what its ends leave in its lines is least well known
BY_BENDING = 0.4  # share of what a straight line leaves that bending must explain


def limited_channels(left: Residuals, spectrum: Spectrum, motions: Bools) -> list[Notice]:
    """Motions (channels,) that end in some whole record, by the fit to all channels, with where they do."""
    notices: dict[str, Notice] = {}
    for number in spectrum.records:
        its, stretch = np.flatnonzero(spectrum.stretch == number), spectrum.stretches[number]
        assert isinstance(stretch, WholeRecord)
        order = stretch.orders(spectrum.frequency_hz[its])
        samples = 2 * (int(np.max(order)) + 1)
        for c in np.flatnonzero(motions):
            y, p = left.measured[its, c], left.predicted[its, c]
            if not np.all(np.isfinite(y) & np.isfinite(p)):
                continue
            end = limited(
                history_of_lines(y, order, samples), history_of_lines(p, order, samples), 2 * len(its)
            )
            if end is not None:
                name = left.channels[c]
                text = f"{name} reads too little where it moves much, as if it ended at {end:.3g} {left.units[c]}"
                notices.setdefault(name, Notice(LIMITED, text, (name,)))
    return list(notices.values())


def limited(shown: Real, should: Real, independent: int) -> float | None:
    """Where a channel ends, if what it shows (samples,) bends away from what it should, whatever the time.

    independent: how many of the samples are.  None where it does not bend, or where that explains too little.
    """
    ends = int(ENDS * len(should))
    shown, should = shown[ends : len(shown) - ends], should[ends : len(should) - ends]
    largest = float(np.quantile(np.abs(should), FAR))
    if largest == 0:
        return None
    p = should / largest
    beyond = [np.maximum(side * p - level, 0.0) for side in SIDES for level in LEVELS]
    straight = np.stack([np.ones(len(p)), p], axis=1)
    whole = np.column_stack([straight, *beyond])
    rest = _left(straight, shown)[1]
    values, bent = _left(whole, shown)
    freedom = independent - whole.shape[1]
    if not 0 < bent < (1 - BY_BENDING) * rest or freedom < 1:
        return None
    if not fdtrc(len(beyond), freedom, (rest - bent) / len(beyond) / (bent / freedom)) < IMPROBABLE:
        return None
    offset, slope = values[:2]
    bends = values[2:].reshape(len(SIDES), len(LEVELS))
    slopes = slope + SIDES * np.sum(bends, axis=1)  # beyond the last level
    k = int(np.argmin(np.abs(slopes)))
    if not abs(slopes[k]) < BENT * abs(slope):
        return None
    return float(abs(offset + SIDES[k] * slope + bends[k] @ (1 - np.array(LEVELS))))


def _left(columns: Real, y: Real) -> tuple[Real, float]:
    """Values of a least-squares fit and the sum of squares that it leaves."""
    values: Real = np.linalg.lstsq(columns, y, rcond=1e-10)[0].astype(np.float64)
    return values, float(np.sum((y - columns @ values) ** 2))
