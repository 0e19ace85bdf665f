"""The repeats of one method, and what they say: bias, spread, coverage, efficiency."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Real, freeze

LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)  # of the quantiles in a Summary


@dataclass(frozen=True)
class Repeats:
    """What one method made of the repeats of one scenario.

    values     (draws, unknowns)  estimates
    sd         (draws, unknowns)  the standard deviations that it stated
    half       (draws, unknowns)  half widths of its 95 % intervals
    converged  (draws,)           False where it failed
    p          (draws,)           p-value of χ² of the fit
    """

    values: Real
    sd: Real
    half: Real
    converged: Bools
    p: Real

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def good(self) -> Bools:
        """Repeats that gave an answer, (draws,)."""
        answered: Bools = self.converged & np.all(np.isfinite(self.values), axis=-1)
        return answered

    def errors(self, theta: Real) -> Real:
        """Relative errors in % of the repeats that gave an answer, (good draws, unknowns); of a true 0, the values."""
        size = np.where(theta == 0, 1.0, np.abs(theta) / 100)
        relative: Real = (self.values[self.good] - theta) / size
        return relative


def all_repeats(parts: Sequence[Repeats]) -> Repeats:
    """All repeats of several blocks, in their order."""
    return Repeats(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("values", "sd", "half", "converged", "p")
        )
    )


@dataclass(frozen=True)
class Summary:
    """One method in one scenario; arrays are (unknowns,), in % of the true value where not said otherwise.

    draws, failed   repeats, and those that gave no answer (they are left out of all that follows)
    mean, mean_se   mean error (bias) and its standard error
    spread, spread_se   standard deviation of the errors and its standard error (from their fourth moment)
    rms             root mean square error
    quantiles       of the errors at LEVELS, (5, unknowns)
    stated          root mean square of the standard deviations that the method stated
    bound           Cramér-Rao bound at the truth
    coverage, coverage_se   share of 95 % intervals that hold the truth, in %
    rejected        share of repeats whose χ² fails at 5 %, in %; NaN without χ²
    """

    draws: int
    failed: int
    mean: Real
    mean_se: Real
    spread: Real
    spread_se: Real
    rms: Real
    quantiles: Real
    stated: Real
    bound: Real
    coverage: Real
    coverage_se: Real
    rejected: float

    @property
    def efficiency(self) -> Real:
        """(bound / spread)², (unknowns,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return (self.bound / self.spread) ** 2

    @property
    def rms_bias(self) -> float:
        """Root mean square of the mean errors over the unknowns, %."""
        return float(np.sqrt(np.mean(self.mean**2)))

    @property
    def rms_spread(self) -> float:
        """Root mean square of the spreads over the unknowns, %."""
        return float(np.sqrt(np.mean(self.spread**2)))

    @property
    def rms_error(self) -> float:
        """Root mean square error over the unknowns, %."""
        return float(np.sqrt(np.mean(self.rms**2)))

    @property
    def error_over_bound(self) -> float:
        """Root mean square error over the bound, both over all unknowns; NaN where there is no bound."""
        return self.rms_error / self.rms_bound if self.rms_bound > 0 else math.nan

    @property
    def rms_bound(self) -> float:
        """Root mean square of the bounds over the unknowns, %."""
        return float(np.sqrt(np.mean(self.bound**2)))


def summarise(repeats: Repeats, theta: Real, bound_sd: Real) -> Summary:
    """Sums over the repeats of one method; `theta` and `bound_sd` (unknowns,) are the truth and its bound."""
    size = np.where(theta == 0, 1.0, np.abs(theta) / 100)
    good = repeats.good
    errors = repeats.errors(theta)
    count, unknowns = errors.shape
    bound = bound_sd / size
    draws = len(good)
    if count < 2:
        lost = np.full(unknowns, np.nan)
        return Summary(
            draws, draws - count, lost, lost, lost, lost, lost, np.full((len(LEVELS), unknowns), np.nan), lost,
            bound, lost, lost, np.nan,
        )  # fmt: skip
    mean = np.mean(errors, axis=0)
    away = errors - mean
    variance = np.sum(away**2, axis=0) / (count - 1)
    spread = np.sqrt(variance)
    fourth = np.mean(away**4, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread_se = np.sqrt(np.maximum(fourth - variance**2, 0.0) / count) / (2 * spread)
        inside = np.abs(repeats.values[good] - theta) <= repeats.half[good]
    share = np.mean(inside, axis=0)
    p = repeats.p[good]
    return Summary(
        draws,
        draws - count,
        mean,
        spread / np.sqrt(count),
        spread,
        np.where(spread > 0, spread_se, 0.0),
        np.sqrt(np.mean(errors**2, axis=0)),
        np.quantile(errors, LEVELS, axis=0),
        np.sqrt(np.mean(repeats.sd[good] ** 2, axis=0)) / size,
        bound,
        100 * share,
        100 * np.sqrt(share * (1 - share) / count),
        100 * float(np.mean(p[np.isfinite(p)] < 0.05)) if np.any(np.isfinite(p)) else np.nan,
    )
