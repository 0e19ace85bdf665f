"""χ² of the data as a function of the unknowns, around an estimate: what profiles and sensitivities are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.estimate.inference.flat_valley import flat_valley
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import (
    bounds,
    local,
    measured,
    per_line,
    prior_mean,
    prior_precision,
)
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise
from dashpot.numerics.small_systems import scaled_inverse


@dataclass(frozen=True)
class Surface:
    """χ²(ψ) of K repeats with the priors' part; psi (K, M) is its minimum near the estimate, cost (K,) the value there.

    information (K, lines, M, M) of each line at psi; lower, upper (M,) what the model allows; lacking (M, M) the
    curvature that χ² has where one repeat's information has none.
    """

    view: ObservationModel
    data: Measured
    sign: Real
    psi: Real
    cost: Real
    information: Real
    lower: Real
    upper: Real
    lacking: Real

    def at(self, psi: Real, rows: Ints) -> QuadraticModel:
        """χ², minus half its slope, and half its curvature (Gauss-Newton) at ψ, (k, M), of the repeats `rows`."""
        return local(self.view, self.data.pick(rows), psi, self.sign[rows])

    def covariance(self) -> Real:
        """Inverse of information, curvature beside it and priors, (K, M, M); NaN where that is singular."""
        held = self.lacking + np.diag(prior_precision(self.view))
        return scaled_inverse(np.sum(self.information, axis=-3) + held)


def chi2_surface(model: Model, spectrum: Spectrum, estimate: Estimate) -> Surface:
    """χ² around `estimate`, weighed as `identify` weighs; leading batch axes become one of K repeats.

    Raises DataError where the estimate has other unknowns.
    """
    data = prepare(model, spectrum)
    view = data.view
    if view.names != estimate.names:
        raise DataError(
            "the unknowns of the estimate are not those of the rig and its channels", cure="identify again"
        )
    psi = estimate.values.reshape(-1, len(view.names))
    sign = spectrum.signs(estimate.signs, len(psi))
    exact = measured(data)
    if not data.noise_known and np.any(model.prior_precision):
        # Priors weigh against noise of the right size: that which makes χ² its degrees of freedom.
        penalty = np.sum(prior_precision(view) * (psi - prior_mean(view)) ** 2, axis=-1)
        cost = local(view, exact, psi, sign).cost - penalty
        size = cost / np.maximum(estimate.fit.dof - penalty, 1.0)
        exact = exact.with_noise(np.maximum(size, 1e-300))
    lower, upper = bounds(view, False)

    def evaluate(at: Real, rows: Ints) -> QuadraticModel:
        return local(view, exact.pick(rows), at, sign[rows])

    minimum = minimise(evaluate, psi, limit=100, tolerance=1e-6, lower=lower, upper=upper)
    information, _, _ = per_line(view, exact, minimum.x, sign)
    # At the estimate itself, as its covariance has it.
    scale = (
        1.0
        if data.noise_known
        else float(evaluate(psi[:1], np.array([0])).cost[0]) / max(estimate.fit.dof, 1)
    )
    valley = flat_valley(view, exact, psi, sign, scale)
    lacking = np.zeros((len(view.names),) * 2) if valley is None else valley.curvature
    return Surface(view, exact, sign, minimum.x, minimum.cost, information, lower, upper, lacking)
