"""Maximum likelihood in the frequency domain, for any linear set of channels (THEORY §4, ml)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dashpot.arrays import Ints, Real, hermitian
from dashpot.estimate.least_squares import compensated
from dashpot.estimate.method import Method, Prepared, Solution
from dashpot.estimate.output import Measured, Outlook, measured, outlook, predict
from dashpot.estimate.regression import inverse
from dashpot.estimate.search import Found, Local, minimise
from dashpot.estimate.starts import candidates
from dashpot.estimate.states import is_direct

POOR = 1e-6  # p-value below which a repeat is searched again from its own starts


@dataclass(frozen=True)
class MaximumLikelihood(Method):
    """Minimise Σ (y − κGq̂)ᴴ V⁻¹ (y − κGq̂) over θ, unknown gains and delays; inputs measured with noise are solved for.

    Where all coordinates are seen the start is the noise-compensated least squares; elsewhere `candidates` random
    rigs of sensible size are ranked with softened weights and the best `starts` of them are searched, the weights
    hardening step by step.  Repeats share the start that the first one finds, and look for their own where it does
    not lead to a fit.  `positive` holds the parameters of the rig at or above 0; bounds of the model hold always.
    """

    starts: int = 8
    candidates: int = 400
    positive: bool = False
    max_iterations: int = 200
    tolerance: float = 1e-9
    seed: int = 0
    name: ClassVar[str] = "ml"
    weighted: ClassVar[bool] = True
    by_output: ClassVar[bool] = True

    def solve(self, data: Prepared) -> Solution:
        """θ, gains and delays at the maximum of the likelihood."""
        view = outlook(data.model, data.spectrum.channels, data.spectrum.omega)
        exact = measured(data, view)
        repeats = len(exact.y)
        lower, upper = bounds(data, view, self.positive)
        direct = data.states is not None and all(is_direct(data.model, c) for c in data.spectrum.channels)
        ones = np.ones((repeats, len(view.channels)))
        if direct and data.states is not None:
            start, sign = compensated(data.model, data.states), ones
            found = self._descend(view, exact, start, sign, lower, upper)
        else:
            psi, flips = self._global(data, view, 0)
            start, sign = np.repeat(psi, repeats, axis=0), np.repeat(flips, repeats, axis=0)
            found = self._descend(view, exact, start, sign, lower, upper)
        found, sign = self._again(data, view, exact, found, sign, lower, upper)
        at = predict(view, exact, found.x, sign)
        prior = prior_precision(view)
        bread = inverse(np.sum(at.information(), axis=-3) + np.diag(prior))
        return Solution(
            found.x, bread, found.converged, found.iterations, found.history,
            signs={view.channels[int(c)].name: sign[:, c] for c in np.flatnonzero(view.flips)},
        )  # fmt: skip

    def _descend(
        self, view: Outlook, data: Measured, start: Real, sign: Real, lower: Real, upper: Real, limit: int | None = None
    ) -> Found:
        def evaluate(psi: Real, rows: Ints) -> Local:
            return local(view, data.pick(rows) if len(data.y) > 1 else data, psi, sign[rows])

        most = self.max_iterations if limit is None else limit
        return minimise(evaluate, start, limit=most, tolerance=self.tolerance, lower=lower, upper=upper)

    def _global(self, data: Prepared, view: Outlook, repeat: int) -> tuple[Real, Real]:
        """The best ψ and signs, (1, M) and (1, channels), that many starts of one repeat lead to."""
        one = data.only(repeat)
        rng = np.random.default_rng([self.seed, repeat])
        psi, sign = candidates(one, view, self.candidates, rng)
        lower, upper = bounds(data, view, self.positive)
        count = 4 * self.starts
        for softness, limit in ((1.0, 8), (0.3, 12), (0.1, 15), (0.03, 15), (0.0, 60)):
            soft = measured(one, view, softness)
            cost = _cost(view, soft, psi, sign)
            order = np.argsort(cost)[:count]
            psi, sign = psi[order], sign[order]
            found = self._descend_all(view, soft, psi, sign, lower, upper, limit, logarithmic=softness > 0)
            psi, count = found, max(self.starts, count // 2)
        cost = _cost(view, measured(one, view), psi, sign)
        best = int(np.argmin(cost))
        return psi[best : best + 1], sign[best : best + 1]

    def _descend_all(
        self, view: Outlook, data: Measured, psi: Real, sign: Real, lower: Real, upper: Real, limit: int, logarithmic: bool
    ) -> Real:
        """Search from many starts of one repeat; in logarithms of the rig's parameters where they are positive."""
        rig = np.arange(psi.shape[-1]) < view.m
        log = rig & bool(logarithmic) & np.all(psi > 0, axis=0)

        def evaluate(x: Real, rows: Ints) -> Local:
            at = np.where(log, np.exp(np.where(log, x, 0.0)), x)
            here = local(view, data, at, sign[rows])
            chain = np.where(log, at, 1.0)
            both = chain[:, :, None] * chain[:, None, :]
            return Local(here.cost, here.gradient * chain, here.symmetric * both, here.free * both)

        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.where(log, np.log(np.where(log, psi, 1.0)), psi)
            low = np.where(log, np.log(np.maximum(lower, 0.0)), lower)
            high = np.where(log, np.log(np.maximum(upper, 0.0)), upper)
        # A decade a step, and no further than 20 from the start, keeps what is hardly seen from running away.
        low, high = np.maximum(low, np.min(x, axis=0) - 46), np.minimum(high, np.max(x, axis=0) + 46)
        low, high = np.where(log, low, lower), np.where(log, high, upper)
        longest = np.where(log, 2.3, np.inf)
        found = minimise(evaluate, x, limit=limit, tolerance=1e-6, lower=low, upper=high, longest=longest)
        return np.where(log, np.exp(np.where(log, found.x, 0.0)), found.x)

    def _again(
        self, data: Prepared, view: Outlook, exact: Measured, found: Found, sign: Real, lower: Real, upper: Real
    ) -> tuple[Found, Real]:
        """Repeats that did not end in a fit are searched from starts of their own; the better end is kept."""
        from scipy.special import chdtri

        dof = exact.rows - found.x.shape[-1]
        known = not np.any(np.isnan(data.spectrum.covariance))
        poor = ~found.converged
        if known and dof > 0:
            typical = np.median(found.cost)
            poor |= found.cost > max(float(chdtri(dof, POOR)), 1.5 * float(typical))
        if len(found.cost) == 1 and data.states is not None:
            poor |= ~found.converged
        x, cost, converged, iterations = (a.copy() for a in (found.x, found.cost, found.converged, found.iterations))
        sign = sign.copy()
        for repeat in np.flatnonzero(poor):
            if len(found.cost) == 1 and data.states is None and found.converged[0]:
                break  # this start was its own already
            psi, flips = self._global(data, view, int(repeat))
            part = exact.pick(np.array([repeat])) if len(exact.y) > 1 else exact
            new = self._descend(view, part, psi, flips, lower, upper)
            if new.cost[0] < cost[repeat] or not np.isfinite(cost[repeat]):
                x[repeat], cost[repeat], converged[repeat] = new.x[0], new.cost[0], new.converged[0]
                iterations[repeat] += new.iterations[0]
                sign[repeat] = flips[0]
        return Found(x, cost, converged, iterations, found.history), sign


def bounds(data: Prepared, view: Outlook, positive: bool) -> tuple[Real, Real]:
    """Lower and upper bounds of ψ from the model, and 0 for its parameters where `positive`."""
    size = len(view.names)
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    for j, unknown in enumerate(data.model.unknowns):
        if positive:
            low[j] = 0.0
        if unknown.lower is not None:
            low[j] = max(low[j], unknown.lower)
        if unknown.upper is not None:
            high[j] = unknown.upper
    return low, high


def prior_precision(view: Outlook) -> Real:
    """Precision of the priors over ψ: the model's, and 0 for calibrations; (M,)."""
    return np.concatenate([view.model.prior_precision, np.zeros(view.gains + view.delays)])


def prior_mean(view: Outlook) -> Real:
    """Means of the priors over ψ, 0 where there is none; (M,)."""
    return np.concatenate([view.model.prior_mean, np.zeros(view.gains + view.delays)])


def local(view: Outlook, data: Measured, psi: Real, sign: Real) -> Local:
    """Cost, slope and curvature of −2 ln(likelihood) at ψ, (K, M)."""
    at = predict(view, data, psi, sign)
    M = psi.shape[-1]
    rows = at.J.shape[-3] * at.J.shape[-2]
    J = hermitian(at.J.reshape(*at.J.shape[:-3], rows, M))
    information = 2 * (J @ at.PJ.reshape(*at.PJ.shape[:-3], rows, M)).real
    gradient = 2 * (J @ at.weighted.reshape(*at.weighted.shape[:-2], rows, 1)).real[..., 0]
    precision = prior_precision(view)
    away = psi - prior_mean(view)
    information = information + np.diag(precision)
    cost = np.sum(at.cost_per_line, axis=-1) + np.sum(precision * away**2, axis=-1)
    return Local(cost, gradient - precision * away, information, information)


def _cost(view: Outlook, data: Measured, psi: Real, sign: Real) -> Real:
    with np.errstate(all="ignore"):
        cost = local(view, data, psi, sign).cost
    return np.where(np.isfinite(cost), cost, np.inf)
