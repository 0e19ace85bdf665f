"""Whether χ² is a parabola as far as the intervals reach, and intervals that follow it where it is not (THEORY §11).

Along the tangent of its profile each unknown is moved by twice its standard deviation to both sides, the others with
it: where χ² is a parabola it rises by 4.  That costs two values of χ² for each unknown; profiles are taken of those
alone whose rise is another.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.check.chi2_surface import chi2_surface
from dashpot.check.joint_profiles import joint_profiles
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import SettledDwell
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.descent import Stage
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import MISFIT, Estimate
from dashpot.model.network import Model

REACH = 2.0  # standard deviations
BENT = 0.12  # relative error of the root of the rise there
OPEN = 5.0  # sd over the value from which on the data say nothing of it, along whatever curve
MOST_UNKNOWNS = 40
MOST_AMPLITUDES = 3000  # with more, profiles take longer than anyone waits
MOST_PROFILES = 12


def with_profile_intervals(model: Model, spectrum: Spectrum, estimate: Estimate) -> Estimate:
    """The estimate with the profile's 95 % interval of each unknown along which χ² is no parabola (no batch axes).

    It is unchanged where that takes long, where intervals count a misfit, and where bounds hold unknowns.
    """
    if not _profiled(model, spectrum, estimate):
        return estimate
    try:
        precise = estimate.noise_sd < OPEN * np.abs(estimate.values)
        bent = np.flatnonzero(bent_unknowns(model, spectrum, estimate) & precise)[:MOST_PROFILES]
        if not len(bent):
            return estimate
        surface = chi2_surface(model, spectrum, estimate)
        low, high = replace(estimate, profiles={}).interval()
        half = (high - low) / 2
        curves = joint_profiles(
            surface, bent.tolist(), half, half / np.sqrt(np.diagonal(surface.covariance()[0]))
        )
    except DashpotError:
        return estimate  # nothing is said of the surface of such a rig
    return replace(estimate, profiles={estimate.names[j]: curve for j, curve in curves.items()})


def bent_unknowns(model: Model, spectrum: Spectrum, estimate: Estimate) -> Bools:
    """(unknowns,): whether χ² at ± 2 standard deviations is far from what the covariance says (no batch axes)."""
    data = prepare(model, spectrum)
    stage = Stage(data.view, measured(data))
    sd = estimate.noise_sd
    with np.errstate(all="ignore"):
        away = REACH * estimate.noise_covariance / sd
        points = np.concatenate([estimate.values[None], estimate.values + away.T, estimate.values - away.T])
        # Intervals of estimated noise are wider than the parabola of that noise.
        widened = np.where(estimate.bound_sd > 0, sd / estimate.bound_sd, 1.0)
        sign = spectrum.signs(estimate.signs, len(points))
        cost = stage.cost(points, sign, np.zeros(len(points), dtype=np.int64))
        scale = 1.0 if data.noise_known else cost[0] / max(estimate.fit.dof, 1)
        root: Real = np.sqrt(np.maximum(cost[1:] - cost[0], 0.0) / scale).reshape(2, -1) / widened
    bent: Bools = ~np.all(np.abs(root / REACH - 1) < BENT, axis=0)
    return bent & np.isfinite(sd) & (sd > 0)


def _profiled(model: Model, spectrum: Spectrum, estimate: Estimate) -> bool:
    """Whether profiles are worth their time, and mean what they say."""
    plain = all(isinstance(stretch, SettledDwell) for stretch in spectrum.stretches)
    small = len(estimate.names) <= MOST_UNKNOWNS and spectrum.amplitudes.size <= MOST_AMPLITUDES
    sound = bool(estimate.converged) and estimate.basis != MISFIT
    free = np.array_equal(estimate.free_values, estimate.values)
    unweighed = estimate.fit.known_noise or not np.any(model.prior_precision)
    efficient = estimate.method in AUTOMATIC and not len(model.nonlinear)
    return plain and small and sound and free and unweighed and efficient
