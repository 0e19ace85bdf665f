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
from dashpot.estimate.starts import candidates, neighbours
from dashpot.estimate.states import is_direct

POOR = 1e-6  # p-value below which a repeat is searched again from its own starts


@dataclass(frozen=True)
class MaximumLikelihood(Method):
    """Minimise Σ (y − κGq̂)ᴴ V⁻¹ (y − κGq̂) over θ, unknown gains and delays; inputs measured with noise are solved for.

    Where all coordinates are seen the start is the noise-compensated least squares; elsewhere `candidates` random
    rigs of sensible size are ranked with softened weights and the best `starts` of them are searched, the weights
    hardening step by step, for at most `rounds` rounds.  Repeats share the start that the first one finds, and look
    for their own where it does not lead to a fit.  `positive` holds the parameters of the rig at or above 0; bounds
    of the model hold always.
    """

    starts: int = 64
    candidates: int = 2000
    rounds: int = 6
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
        self,
        view: Outlook,
        data: Measured,
        start: Real,
        sign: Real,
        lower: Real,
        upper: Real,
        limit: int | None = None,
    ) -> Found:
        def evaluate(psi: Real, rows: Ints) -> Local:
            return local(view, data.pick(rows), psi, sign[rows])

        most = self.max_iterations if limit is None else limit
        return minimise(evaluate, start, limit=most, tolerance=self.tolerance, lower=lower, upper=upper)

    def _global(self, data: Prepared, view: Outlook, repeat: int) -> tuple[Real, Real]:
        """The best ψ and signs, (1, M) and (1, channels), that many starts of one repeat lead to.

        Rounds end when the best end fits (known noise) and was reached at least twice, or when two rounds in a row
        bring nothing; later rounds search around the best ends as well.
        """
        one = data.only(repeat)
        rng = np.random.default_rng([self.seed, repeat])
        lower, upper = bounds(data, view, self.positive)
        exact, soft, softer = measured(one, view), measured(one, view, 0.1), measured(one, view, 1.0)
        acceptable = _acceptable(one, exact, len(view.names))
        best, signs, costs = np.empty((0, len(view.names))), np.empty((0, len(view.channels))), np.empty(0)
        idle = 0
        for turn in range(self.rounds):
            psi, sign = candidates(one, view, self.candidates, rng)
            chosen = np.argsort(_cost(view, softer, psi, sign))[: self.starts]
            if turn == 0:
                chosen = np.union1d(chosen, [0])
            psi, sign = psi[chosen], sign[chosen]
            if turn > 0:
                near, near_sign = neighbours(best[: self.starts // 8], signs, view, self.starts, rng)
                psi, sign = np.concatenate([psi, near]), np.concatenate([sign, near_sign])
            for data_now, limit in ((softer, 30), (soft, 20), (exact, 60)):
                psi = self._descend_all(
                    view, data_now, psi, sign, lower, upper, limit, logarithmic=data_now is not exact
                )
            before = costs[0] if len(costs) else np.inf
            best, signs = np.concatenate([best, psi]), np.concatenate([signs, sign])
            costs = np.concatenate([costs, _cost(view, exact, psi, sign)])
            order = np.argsort(costs)[: 4 * self.starts]
            best, signs, costs = best[order], signs[order], costs[order]
            reached = int(np.sum(costs <= costs[0] + 1e-3 * max(1.0, costs[0])))
            idle = idle + 1 if costs[0] > before * (1 - 1e-3) else 0
            if (costs[0] <= acceptable and reached > 1) or idle > 1:
                break
        return best[:1], signs[:1]

    def _descend_all(
        self,
        view: Outlook,
        data: Measured,
        psi: Real,
        sign: Real,
        lower: Real,
        upper: Real,
        limit: int,
        logarithmic: bool,
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
        found = minimise(
            evaluate, x, limit=limit, tolerance=1e-6, lower=low, upper=high, longest=longest, patience=limit
        )
        return np.where(log, np.exp(np.where(log, found.x, 0.0)), found.x)

    def _again(
        self,
        data: Prepared,
        view: Outlook,
        exact: Measured,
        found: Found,
        sign: Real,
        lower: Real,
        upper: Real,
    ) -> tuple[Found, Real]:
        """Repeats that did not end in a fit are searched from starts of their own; the better end is kept."""
        poor = ~found.converged | (
            found.cost > np.maximum(_acceptable(data, exact, found.x.shape[-1]), 1.5 * np.median(found.cost))
        )
        if len(poor) == 1 and data.states is None:
            return found, sign  # its start was its own already
        x, cost, converged, iterations = (
            found.x.copy(), found.cost.copy(), found.converged.copy(), found.iterations.copy(),
        )  # fmt: skip
        sign = sign.copy()
        for repeat in np.flatnonzero(poor):
            psi, flips = self._global(data, view, int(repeat))
            new = self._descend(view, exact.pick(np.array([repeat])), psi, flips, lower, upper)
            if not new.cost[0] >= cost[repeat]:
                x[repeat], cost[repeat], converged[repeat] = new.x[0], new.cost[0], new.converged[0]
                iterations[repeat] += new.iterations[0]
                sign[repeat] = flips[0]
        return Found(x, cost, converged, iterations, found.history), sign


def _acceptable(data: Prepared, exact: Measured, unknowns: int) -> float:
    """The χ² above which an end is no fit; inf where the noise is not known."""
    from scipy.stats import chi2

    dof = exact.rows - unknowns
    if np.any(np.isnan(data.spectrum.covariance)) or dof <= 0:
        return np.inf
    doubt = np.min(data.spectrum.dof)
    return float(chi2.isf(POOR, dof)) * (1.0 if np.isinf(doubt) else 1 + 8 / max(doubt - 4, 1.0))


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
