"""What stands out in a fleet: rigs that are unlike the others, and parameters that drift from rig to rig.

Both are tests over many rigs and parameters at once: of a fleet without outliers and drift, one in twenty shows any.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr, stdtrit

from dashpot.arrays import Bools, Real, freeze

LEVEL = 0.05  # share of fleets alike in which anything at all is named
FEWEST = 6  # rigs, below which nothing can be said to be usual
TO_SD = 1.482602218505602  # of the median absolute deviation of normal numbers to their standard deviation
EFFICIENCY = 0.37  # of that deviation: so many of its degrees of freedom a standard deviation would have


@dataclass(frozen=True)
class Usual:
    """One parameter over a fleet: median, robust spread (noise taken out), the noise's rms, and drift.

    z (rigs,)      (value − median) / √(spread² + sd²), NaN where there is no value
    outlier (rigs,) where |z| exceeds `limit`
    slope, slope_sd  change from the first rig to the last; p of no drift, over all parameters
    """

    name: str
    unit: str
    count: int
    median: float
    spread: float
    noise: float
    limit: float
    z: Real
    outlier: Bools
    slope: float
    slope_sd: float
    drift_p: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def drifts(self) -> bool:
        """Whether the trend over the fleet is more than chance."""
        return self.drift_p < LEVEL


def survey(
    names: Sequence[str], units: Sequence[str], values: Mapping[str, Real], sds: Mapping[str, Real]
) -> tuple[Usual, ...]:
    """Outliers and drift of every parameter, (rigs,) each in the order of the fleet; NaN where a rig has no value."""
    return tuple(
        usual(name, unit, values[name], sds[name], len(names))
        for name, unit in zip(names, units, strict=True)
    )


def usual(name: str, unit: str, values: Real, sd: Real, parameters: int = 1) -> Usual:
    """One of `parameters` parameters over the fleet; values and sd (rigs,).

    The spread is that of median absolute deviations, which up to half of the rigs cannot move; rigs count with
    their own noise beside it.  Limits are those of t (the spread has few degrees of freedom in small fleets), shared
    out over rigs and parameters (Bonferroni).
    """
    present = np.isfinite(values) & np.isfinite(sd)
    y, s = values[present], sd[present]
    count = len(y)
    z, outlier = np.full(len(values), np.nan), np.zeros(len(values), dtype=bool)
    if count < FEWEST:
        lost = float("nan")
        median = float(np.median(y)) if count else lost
        return Usual(name, unit, count, median, lost, _rms(s), lost, z, outlier, lost, lost, lost)
    median = float(np.median(y))
    total = TO_SD * float(np.median(np.abs(y - median)))
    spread = float(np.sqrt(max(total**2 - float(np.median(s**2)), 0.0)))
    scale = np.sqrt(spread**2 + s**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        z[present] = np.where(y == median, 0.0, (y - median) / scale)
    limit = -float(stdtrit(max(EFFICIENCY * (count - 1), 2.0), LEVEL / (2 * count * parameters)))
    outlier[present] = np.abs(z[present]) > limit
    slope, slope_sd, p = _trend(
        np.flatnonzero(present) / max(len(values) - 1, 1), y, scale, ~outlier[present]
    )
    return Usual(
        name,
        unit,
        count,
        median,
        spread,
        _rms(s),
        limit,
        z,
        outlier,
        slope,
        slope_sd,
        min(p * parameters, 1.0),
    )


def _rms(sd: Real) -> float:
    return float(np.sqrt(np.mean(sd**2))) if len(sd) else float("nan")


def _trend(place: Real, y: Real, scale: Real, used: Bools) -> tuple[float, float, float]:
    """Slope over the place in the fleet (0 to 1), its standard deviation from the scatter, and p; outliers left out."""
    x, y = place[used], y[used]
    dof = len(x) - 2
    weight = np.where(scale[used] > 0, 1 / np.where(scale[used] > 0, scale[used], 1.0) ** 2, 1.0)
    if dof < FEWEST - 2:
        return float("nan"), float("nan"), float("nan")
    weight = weight / np.sum(weight)
    centre, middle = float(np.sum(weight * x)), float(np.sum(weight * y))
    bent = float(np.sum(weight * (x - centre) ** 2))
    slope = float(np.sum(weight * (x - centre) * (y - middle))) / bent
    left = y - middle - slope * (x - centre)
    variance = float(np.sum(weight * left**2)) / (dof * bent)
    if variance <= 0.0:
        return slope, 0.0, 0.0 if slope else 1.0
    sd = float(np.sqrt(variance))
    return slope, sd, float(2 * stdtr(dof, -abs(slope) / sd))
