"""Partial pooling: each rig's estimate and the population it comes from inform each other (random effects).

θ̂_i = θ_i + noise of sd s_i,   θ_i = μ + spread of sd τ          over the rigs i of a fleet, for each parameter

τ is estimated by restricted maximum likelihood (REML: Harville 1977), μ by weighted means.  A rig's pooled estimate is
its own, drawn towards μ by s_i² / (s_i² + τ²); as τ is known from few rigs only, estimates and intervals are averaged
over the restricted likelihood of τ rather than taken at its maximum (Morris 1983; Carlin and Louis 2000, §3.5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtri, ndtri, stdtr, stdtrit

from dashpot.arrays import Bools, Frozen, Real

# What stands out in a fleet: rigs that are unlike the others, and parameters that drift from rig to rig.
#
# Both are tests over many rigs and parameters at once: of a fleet without outliers and drift, one in twenty
# shows any.


LEVEL = 0.05  # share of fleets alike in which anything at all is named
FEWEST = 6  # rigs, below which nothing can be said to be usual


@dataclass(frozen=True)
class Usual(Frozen):
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
    their own noise on top of it.  Limits are those of t (the spread has few degrees of freedom in small fleets), shared
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
    # of the median absolute deviation of normal numbers to their standard deviation
    total = 1.482602218505602 * float(np.median(np.abs(y - median)))
    spread = float(np.sqrt(max(total**2 - float(np.median(s**2)), 0.0)))
    scale = np.sqrt(spread**2 + s**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        z[present] = np.where(y == median, 0.0, (y - median) / scale)
    # 0.37 of that deviation: so many of its degrees of freedom a standard deviation would have
    limit = -float(stdtrit(max(0.37 * (count - 1), 2.0), LEVEL / (2 * count * parameters)))
    outlier[present] = np.abs(z[present]) > limit
    slope, slope_sd, p = _trend(
        np.flatnonzero(present) / max(len(values) - 1, 1), y, scale, ~outlier[present]
    )
    drift = (slope, slope_sd, min(p * parameters, 1.0))
    return Usual(name, unit, count, median, spread, _rms(s), limit, z, outlier, *drift)


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


@dataclass(frozen=True)
class Population(Frozen):
    """One parameter of a fleet as a population.

    mean, mean_sd      μ and its standard deviation, the uncertainty of τ counted
    spread             τ by REML; 0 where noise alone explains the scatter
    spread_interval    95 % interval of τ by its profile likelihood
    values, sd, lower, upper (rigs,)  pooled estimates with 95 % intervals, NaN where a rig has none of its own
    """

    name: str
    unit: str
    count: int
    mean: float
    mean_sd: float
    spread: float
    spread_interval: tuple[float, float]
    values: Real
    sd: Real
    lower: Real
    upper: Real


def pooled(name: str, unit: str, values: Real, sd: Real, used: Bools | None = None) -> Population | None:
    """The population of one parameter; values and their standard deviations (rigs,), NaN where a rig has none.

    Rigs that are not `used` (outliers) do not inform the population and keep their own estimate.  None of fewer than
    four rigs.
    """
    known = np.isfinite(values) & np.isfinite(sd) & (sd > 0)
    present = known if used is None else known & used
    y, s = values[present], sd[present]
    if len(y) < 4:  # rigs
        return None
    # In units of the scatter, so that the search over τ has a scale.
    unit_size = float(np.std(y)) or float(np.max(s))
    middle = float(np.median(y))
    y, s = (y - middle) / unit_size, s / unit_size
    tau, ends = _spread(y, s)
    # Values of τ that the data allow, (steps,), and their weights by the restricted likelihood
    most = _most(y, s)
    # 80 steps, to where the likelihood is 9 nepers below its maximum
    low, high = _end(y, s, tau, 9.0, 0.0), _end(y, s, tau, 9.0, most)
    grid = low + (np.arange(80) + 0.5) / 80 * (high - low)
    logs = restricted_likelihood(y, s, grid)
    weight = grid * np.exp(logs - np.max(logs))
    weight = weight / np.sum(weight)
    precision = 1 / (s**2 + grid[:, None] ** 2)
    mu_variance = 1 / np.sum(precision, axis=-1)  # of μ at each τ
    mu = mu_variance * np.sum(precision * y, axis=-1)
    mean = float(np.sum(weight * mu))
    mean_variance = float(np.sum(weight * (mu_variance + (mu - mean) ** 2)))
    centre, variance = _shrunk(y, s, grid, weight, mu, mu_variance)

    def whole(part: Real, own: Real) -> Real:
        everyone = np.where(known, own, np.nan)
        everyone[present] = part
        return everyone

    each, each_sd = whole(middle + unit_size * centre, values), whole(unit_size * np.sqrt(variance), sd)
    return Population(
        name,
        unit,
        count=len(y),
        mean=middle + unit_size * mean,
        mean_sd=unit_size * float(np.sqrt(mean_variance)),
        spread=unit_size * tau,
        spread_interval=(unit_size * ends[0], unit_size * ends[1]),
        values=each,
        sd=each_sd,
        lower=each - ndtri(0.975) * each_sd,
        upper=each + ndtri(0.975) * each_sd,
    )


def restricted_likelihood(y: Real, s: Real, tau: Real) -> Real:
    """ln of the restricted likelihood at each τ, (steps,), up to a constant."""
    variance = s**2 + tau[:, None] ** 2
    weight = 1 / variance
    total = np.sum(weight, axis=-1)
    mu = np.sum(weight * y, axis=-1) / total
    square = np.sum(weight * (y - mu[:, None]) ** 2, axis=-1)
    return -0.5 * (np.sum(np.log(variance), axis=-1) + np.log(total) + square)


def _most(y: Real, s: Real) -> float:
    """Beyond any spread that the data allow; of values all alike, as those that rest at a bound, by their noise."""
    return 5.0 * (float(np.max(np.abs(y))) or float(np.max(s)))


def _spread(y: Real, s: Real) -> tuple[float, tuple[float, float]]:
    """τ at the maximum of the restricted likelihood, and where it has fallen by half the 95 % quantile of χ²."""

    def cost(tau: float) -> float:
        return -float(restricted_likelihood(y, s, np.array([tau]))[0])

    most = _most(y, s)
    coarse = np.concatenate([[0.0], np.geomspace(1e-4, most, 60)])
    best = int(np.argmax(restricted_likelihood(y, s, coarse)))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)]
    weight = 1 / s**2
    away = y - np.sum(weight * y) / np.sum(weight)
    # By its derivative in τ², which rounding near its end at 0 cannot disturb
    rises = np.sum((weight * away) ** 2) > np.sum(weight) - np.sum(weight**2) / np.sum(weight)
    tau = 0.0
    if best > 1 or rises:
        tau = float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-9}).x)
    fall = 0.5 * float(chdtri(1, 0.05))
    return tau, (_end(y, s, tau, fall, 0.0), _end(y, s, tau, fall, most))


def _end(y: Real, s: Real, tau: float, fall: float, far: float) -> float:
    """Where between τ and `far` the restricted likelihood has fallen by `fall`; `far` where it never does."""
    top = float(restricted_likelihood(y, s, np.array([tau]))[0])

    def below(at: float) -> bool:
        return float(restricted_likelihood(y, s, np.array([at]))[0]) < top - fall

    if not below(far):
        return far
    near = tau
    for _ in range(60):
        half = 0.5 * (near + far)
        near, far = (near, half) if below(half) else (half, far)
    return 0.5 * (near + far)


def _shrunk(y: Real, s: Real, grid: Real, weight: Real, mu: Real, mu_variance: Real) -> tuple[Real, Real]:
    """Mean and variance of each rig's own value, averaged over τ; (rigs,) each.

    At given τ: B y + … with B = s² / (s² + τ²), variance s² (1 − B) + B² var μ.
    """
    first, second = np.zeros_like(y), np.zeros_like(y)
    for tau, share, centre, loose in zip(grid, weight, mu, mu_variance, strict=True):
        B = s**2 / (s**2 + tau**2)
        value = (1 - B) * y + B * centre
        first += share * value
        second += share * (s**2 * (1 - B) + B**2 * loose + value**2)
    return first, np.maximum(second - first**2, 0.0)
