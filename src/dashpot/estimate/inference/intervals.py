"""Intervals from an estimate and its standard deviation, cut off at bounds where there are some."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Real


def bounded_interval(
    values: Real, free: Real, sd: Real, dof: Real, lower: Real, upper: Real, level: float
) -> tuple[Real, Real]:
    """Ends of the intervals at `level` around the free estimates, each (..., m), all arguments (..., m) or (m,).

    Where an unknown has bounds, the interval is that of the free estimate, cut off at them: what it holds of the
    allowed values it held before, so its coverage is kept.  Where the free estimate lies beyond a bound, the cut
    interval would shrink to nothing; there its far end is that of the distribution truncated at the bound, which
    passes into the other one smoothly.  The interval always holds the value.
    """
    from scipy.special import stdtrit  # scipy.stats costs half a second of start-up

    half = stdtrit(dof, 0.5 + level / 2) * sd
    low, high = free - half, free + half
    if np.any(np.isfinite(lower) | np.isfinite(upper)):
        high = np.where(free < lower, free + sd * truncated_reach((lower - free) / sd, dof, level), high)
        low = np.where(free > upper, free - sd * truncated_reach((free - upper) / sd, dof, level), low)
        low, high = np.clip(low, lower, upper), np.clip(high, lower, upper)
        low, high = np.minimum(low, values), np.maximum(high, values)
    return low, high


def profile_interval(
    curve: tuple[Sequence[float], Sequence[float]], dof: float, level: float
) -> tuple[float, float]:
    """Ends at `level` of the interval from a profile: (values, roots), both ascending.

    A root is that of the rise of χ², with the side's sign, over the root at the ends of the 95 % interval, −1 and 1.
    Beyond what the profile has seen the ends grow as far as it did; where it saw no limit there is none.
    """
    from scipy.special import stdtrit

    values, roots = (np.asarray(part, dtype=float) for part in curve)
    reach = float(stdtrit(dof, 0.5 + level / 2) / stdtrit(dof, 0.975))
    seen = np.isfinite(values)
    middle = float(np.interp(0.0, roots[seen], values[seen]))
    ends = []
    for root in (-reach, reach):
        edge = -1 if root > 0 else 0
        last, at = float(values[seen][edge]), float(roots[seen][edge])
        if abs(root) <= abs(at):
            ends.append(float(np.interp(root, roots[seen], values[seen])))
        elif not seen[edge]:
            ends.append(float(values[edge]))
        else:
            ends.append(middle + (last - middle) * root / at if at else last)
    return ends[0], ends[1]


def truncated_reach(beyond: Real, dof: Real, level: float) -> Real:
    """How far from its centre a t distribution cut off at `beyond` > 0 holds `level` of what is left, (...,)."""
    from scipy.special import stdtr, stdtrit

    beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
    left = (1 - level) * stdtr(dof, -beyond)
    with np.errstate(all="ignore"):
        reach = -stdtrit(dof, left)
    return np.where(np.isfinite(reach), np.maximum(reach, beyond), beyond)
