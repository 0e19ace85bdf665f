"""Maximum likelihood in the frequency domain, for any linear set of channels (THEORY §4, ml)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dashpot.arrays import Ints, Real, hermitian
from dashpot.errors import ConvergenceError
from dashpot.estimate.likelihood.objective import Measured, directly_driven, measured, predict
from dashpot.estimate.likelihood.record_start import record_starts
from dashpot.estimate.likelihood.starting_values import candidates, neighbours
from dashpot.estimate.likelihood.thinning import thinned
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.method import HeldBounds, Method, Solution, Traits
from dashpot.estimate.nonlinear.search import search
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.observation import SPARSE_FROM, ObservationModel, is_direct, observation_model, small
from dashpot.model.unstructured import free_names
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import (
    PATIENCE,
    OptimizeResult,
    QuadraticModel,
    minimise,
    without_bounds,
)
from dashpot.numerics.small_systems import scaled_inverse

Cost = Callable[[Real, Real], QuadraticModel]  # of ψ (K, M) and signs (K, channels)

POOR = 1e-6  # p-value below which a repeat is searched again from its own starts
SOFTNESS = 0.03  # relative noise added to every channel in the middle stage of a search from afar
SOFTER = 0.3  # and in the first one, where logarithms cannot be had
ROUGH = 60  # iterations of such a stage
LOG_RESIDUAL = 0.5  # nepers beyond which a residual of logarithms counts no longer by its square
POLISH = 25  # iterations for the deepest ends of a round
EASY = 0.1  # share of the first starts that end in one valley that fits: enough to end the search
PLAIN = 0.5  # and in one that does not fit
LEAST = 16  # starts of the largest rigs
DEEPEST = 8  # valleys that are followed to the bottom
RIVAL = 60.0  # χ² by which a valley may lie above the deepest one of one repeat and be the deepest of another
RECORD_TOLERANCE = 1e-4  # standard deviations, of whole records
PIECE = 2_000_000  # complex numbers of dynamic stiffness at once
TIE = 0.01  # of χ²: what fits alike
DOUBT = 9.2  # χ² by which a rival may lie above and be told to the user: odds of 100 to 1


@dataclass(frozen=True)
class LocalMinima:
    """Where searches ended, the deepest first: psi (V, M), signs of the channels (V, channels), cost (V,)."""

    psi: Real
    sign: Real
    cost: Real

    def with_ends(self, psi: Real, sign: Real, cost: Real) -> LocalMinima:
        """With more ends; those within 2 % of a deeper one in every unknown lie in its valley and are left out."""
        psi, sign = np.concatenate([self.psi, psi]), np.concatenate([self.sign, sign])
        cost = np.concatenate([self.cost, cost])
        kept: list[int] = []
        for k in np.argsort(cost):
            size = np.maximum(np.abs(psi[k]), np.abs(psi[kept]))
            near = np.abs(psi[k] - psi[kept]) <= 0.02 * size
            if np.isfinite(cost[k]) and not np.any(
                np.all(near, axis=-1) & np.all(sign[k] == sign[kept], axis=-1)
            ):
                kept.append(int(k))
            if len(kept) == 4 * DEEPEST:
                break
        return self if not kept else LocalMinima(psi[kept], sign[kept], cost[kept])


@dataclass(frozen=True)
class MaximumLikelihood(Method):
    """Minimise Σ (y − κGq̂)ᴴ V⁻¹ (y − κGq̂) over θ, unknown gains and delays; inputs measured with noise are solved for.

    Where all coordinates are seen the start is the noise-compensated least squares; elsewhere `candidates` random
    rigs of sensible size are ranked by the logarithms of their responses, and the best `starts` of them searched, first
    in logarithms, then with weights that harden step by step, for at most `rounds` rounds.  Repeats share the valleys
    that the first one finds, and look for their own where these do not lead to a fit.  `positive` holds the parts of
    the rig at or above 0, not what belongs to a free matrix; bounds of the model hold always.  With
    a `start`, values of all unknowns, and signs of the channels, one descent from there takes the search's place.
    """

    starts: int = 64
    candidates: int = 2000
    rounds: int = 6
    positive: bool = False
    max_iterations: int = 200
    tolerance: float = 1e-9
    seed: int = 0
    start: tuple[float, ...] = ()
    start_sign: tuple[float, ...] = ()
    name: ClassVar[str] = "ml"
    traits: ClassVar[Traits] = Traits(
        by_output=True,
        maximum_likelihood=True,
        weighted=True,
        bounds=True,
        transients=True,
        nonlinear=True,
    )

    def solve(self, data: Prepared) -> Solution:
        """θ, gains and delays at the maximum of the likelihood."""
        view = observation_model(data.model, data.spectrum.channels, data.spectrum.omega)
        exact = measured(data, view)
        repeats = len(exact.y)
        lower, upper = bounds(view, self.positive)
        direct = data.states is not None and all(is_direct(data.model, c) for c in data.spectrum.channels)
        warnings: tuple[Notice, ...] = ()
        if exact.nonlinear is not None:
            found, exact = search(
                data,
                view,
                exact,
                lambda part, psi, sign, limit: self._descend(view, part, psi, sign, lower, upper, limit),
                lambda one, softness: measured(one, view, softness),
            )
            sign = np.ones((repeats, len(view.channels)))
        elif self.start and repeats == 1:
            start, sign = np.array([self.start]), np.array([self.start_sign])
            found = self._descend(view, exact, start, sign, lower, upper)
        elif direct and data.states is not None:
            start, sign = _start(view, data, data.states, exact), np.ones((repeats, len(view.channels)))
            found = self._descend(view, exact, start, sign, lower, upper)
        else:
            found, sign, warnings = self._from_valleys(view, exact, self._global(data, view, 0), lower, upper)
        if exact.nonlinear is None and not self.start:
            found, sign = self._again(data, view, exact, found, sign, lower, upper)
        at = predict(view, exact, found.x, sign)
        prior = prior_precision(view)
        bread = scaled_inverse(np.sum(at.information(), axis=-3) + np.diag(prior))
        return Solution(
            found.x, bread, found.converged, found.iterations, found.history,
            signs={view.channels[int(c)].name: sign[:, c] for c in np.flatnonzero(view.flips)},
            warnings=warnings, bounds=self._held(view, exact, found.x, sign, lower, upper),
        )  # fmt: skip

    def _held(
        self, view: ObservationModel, data: Measured, psi: Real, sign: Real, lower: Real, upper: Real
    ) -> HeldBounds | None:
        if not np.any(np.isfinite(lower) | np.isfinite(upper)):
            return None
        return HeldBounds(lower, upper, without_bounds(psi, local(view, data, psi, sign), lower, upper))

    def rough(self, data: Prepared, view: ObservationModel, exact: Measured) -> tuple[Real, Real]:
        """ψ and signs of one repeat by one descent where all is seen, without a doubt of where it ends; (1, …) each."""
        lower, upper = bounds(view, self.positive)
        if data.states is not None and all(is_direct(data.model, c) for c in data.spectrum.channels):
            sign = np.ones((1, len(view.channels)))
            found = self._descend(
                view, exact, _start(view, data, data.states, exact), sign, lower, upper, limit=ROUGH
            )
            if np.all(np.isfinite(found.cost)):
                return found.x, sign
        found, sign, _ = self._from_valleys(view, exact, self._global(data, view, 0), lower, upper)
        return found.x, sign

    def _descend(
        self,
        view: ObservationModel,
        data: Measured,
        start: Real,
        sign: Real,
        lower: Real,
        upper: Real,
        limit: int | None = None,
    ) -> OptimizeResult:
        def evaluate(psi: Real, rows: Ints) -> QuadraticModel:
            return local(view, data.pick(rows), psi, sign[rows])

        most = self.max_iterations if limit is None else limit
        # What depends on what among a record's columns is decided anew at each step: no nearer than that.
        near = self.tolerance if data.ends is None else max(self.tolerance, RECORD_TOLERANCE)
        return minimise(evaluate, start, limit=most, tolerance=near, lower=lower, upper=upper)

    def _from_valleys(
        self, view: ObservationModel, data: Measured, valleys: LocalMinima, lower: Real, upper: Real
    ) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
        """Each repeat from the deepest valley and its rivals: the lowest end, its signs, and a word on close rivals."""
        unit = max(1.0, valleys.cost[0] / data.rows)
        near = np.flatnonzero(valleys.cost <= valleys.cost[0] + RIVAL * unit)[: 2 * DEEPEST]
        first = data.pick(np.array([0]))
        bottoms = LocalMinima(valleys.psi[:0], valleys.sign[:0], valleys.cost[:0])
        for k in near:
            end = self._descend(
                view, first, valleys.psi[k : k + 1], valleys.sign[k : k + 1], lower, upper, limit=ROUGH
            )
            if end.converged[0] or k == 0:
                bottoms = bottoms.with_ends(end.x, valleys.sign[k : k + 1], end.cost)
        repeats = len(data.y)
        sign = np.repeat(bottoms.sign[:1], repeats, axis=0)
        found = self._descend(view, data, np.repeat(bottoms.psi[:1], repeats, axis=0), sign, lower, upper)
        for psi, flips in zip(bottoms.psi[1:], bottoms.sign[1:], strict=True):
            start, signs = (np.repeat(part[None], repeats, axis=0) for part in (psi, flips))
            # A few steps tell for which repeats this valley is not out of the question.
            short = self._descend(view, data, start, signs, lower, upper, limit=PATIENCE)
            rows = np.flatnonzero(short.cost < found.cost + DOUBT * unit)
            if not len(rows):
                continue
            end = self._descend(view, data.pick(rows), short.x[rows], signs[rows], lower, upper)
            sign = sign.copy()
            sign[rows[found.worse(rows, end)]] = flips
            found = found.improved(rows, end)
        return found, sign, _rivals(view, first, found, sign, bottoms, DOUBT * unit) if repeats == 1 else ()

    def _stages(self, one: Prepared, view: ObservationModel, exact: Measured) -> tuple[Cost, ...]:
        """What is minimised one after the other from afar: logarithms, softened weights, and the likelihood itself."""

        def weighted(data: Measured) -> Cost:
            return lambda psi, sign: local(view, data, psi, sign)

        by_channels = directly_driven(view, exact)
        first = weighted(measured(one, view, SOFTER))
        if by_channels is not None:
            reliability = _reliability(one, view)
            first = lambda psi, sign: logarithmic(view, by_channels, reliability, psi, sign)  # noqa: E731
        return first, weighted(measured(one, view, SOFTNESS)), weighted(exact)

    def _global(self, data: Prepared, view: ObservationModel, repeat: int) -> LocalMinima:
        """The valleys that many starts of one repeat lead to, the deepest first.

        The first round starts from candidates, those after it from neighbours of the deepest valleys as well.  Rounds
        end when a tenth of the first starts led to the deepest one and it fits (known noise), or half of them, or when
        two rounds in a row find nothing deeper.  Raises ConvergenceError where no start ends at a finite cost.
        """
        one = thinned(data.only(repeat))
        view = observation_model(one.model, one.spectrum.channels, one.spectrum.omega)
        rng = np.random.default_rng([self.seed, repeat])
        lower, upper = bounds(view, self.positive)
        exact = measured(one, view)
        stages = self._stages(one, view, exact)
        acceptable = _acceptable(one, exact, len(view.names))
        valleys = LocalMinima(np.empty((0, len(view.names))), np.empty((0, len(view.channels))), np.empty(0))
        idle = 0
        # Large rigs: fewer starts, and none where a guess leads to a fit.
        ease = min(1.0, SPARSE_FROM / view.model.n)
        starts = max(int(self.starts * ease), min(self.starts, LEAST))
        if not small(view.model) and all(
            u.guess is not None or u.sd is not None for u in data.model.unknowns
        ):
            psi, sign = candidates(one, view, 1, rng)
            psi, sign = _through(view, stages, psi, sign, lower, upper, straight=True)
            end = self._descend(view, exact, psi, sign, lower, upper)
            valleys = valleys.with_ends(end.x, sign, end.cost)
            if np.any(valleys.cost <= acceptable):
                return valleys
        for turn in range(self.rounds):
            psi, sign = candidates(one, view, int(self.candidates * ease) + starts, rng)
            order = np.argsort(_cost(view, stages[0], psi, sign))
            chosen = np.concatenate([[0], order[:starts]]) if turn == 0 else order[: starts // 4]
            psi, sign = psi[chosen], sign[chosen]
            if turn > 0:
                near, near_sign = neighbours(valleys.psi[:DEEPEST], valleys.sign[:DEEPEST], view, starts, rng)
                psi, sign = np.concatenate([psi, near]), np.concatenate([sign, near_sign])
            psi, sign = _through(view, stages, psi, sign, lower, upper, straight=turn == 0)
            costs = _cost(view, stages[-1], psi, sign)
            deep = np.argsort(costs)[:DEEPEST]
            end = self._descend(view, exact, psi[deep], sign[deep], lower, upper, limit=POLISH)
            psi[deep], costs[deep] = end.x, end.cost
            before = valleys.cost[0] if len(valleys.cost) else np.inf
            valleys = valleys.with_ends(psi, sign, costs)
            if not len(valleys.cost):
                raise ConvergenceError("no start leads to a minimum", cure="give guesses of the unknowns")
            lowest = valleys.cost[0]
            idle = idle + 1 if lowest > before - 1e-3 * max(1.0, lowest / exact.rows) else 0
            share = np.mean(costs <= lowest * 1.01 + 1) if turn == 0 else 0.0
            if share >= (EASY if lowest <= acceptable else PLAIN) or idle > 1:
                break
        return valleys

    def _again(
        self,
        data: Prepared,
        view: ObservationModel,
        exact: Measured,
        found: OptimizeResult,
        sign: Real,
        lower: Real,
        upper: Real,
    ) -> tuple[OptimizeResult, Real]:
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
            valleys = self._global(data, view, int(repeat))
            new, flips, _ = self._from_valleys(view, exact.pick(np.array([repeat])), valleys, lower, upper)
            if not new.cost[0] >= cost[repeat]:
                x[repeat], cost[repeat], converged[repeat] = new.x[0], new.cost[0], new.converged[0]
                iterations[repeat] += new.iterations[0]
                sign[repeat] = flips[0]
        return OptimizeResult(x, cost, converged, iterations, found.history), sign


def _start(view: ObservationModel, data: Prepared, states: States, exact: Measured) -> Real:
    """Where all is seen: least squares less its noise, (K, unknowns), boundary loads of whole records solved for."""
    if exact.ends is not None:
        starts = record_starts(data.model, states, exact.ends)
        sign = np.ones((len(exact.y), len(view.channels)))
        with np.errstate(all="ignore"):
            costs = np.stack([local(view, exact, start, sign).cost for start in starts])
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best: Real = starts[np.argmin(costs, axis=0), np.arange(len(exact.y))]
        return best
    return compensated(data.model, states)


def _through(
    view: ObservationModel,
    stages: Sequence[Cost],
    psi: Real,
    sign: Real,
    lower: Real,
    upper: Real,
    straight: bool,
) -> tuple[Real, Real]:
    """Where starts end that go through all stages; with `straight`, where the first half ends without the first.

    Logarithms lead nearly everything to one valley, and that may be the wrong one.
    """
    half = (len(psi) + 1) // 2 if straight else 0
    past, signs = psi[:half], sign[:half]
    for stage in stages:
        psi = _descend_all(view, stage, psi, sign, lower, upper)
    for stage in stages[1:] if half else ():
        past = _descend_all(view, stage, past, signs, lower, upper)
    return np.concatenate([psi, past]), np.concatenate([sign, signs])


def _reliability(one: Prepared, view: ObservationModel) -> Real:
    """Weights of the logarithms, (lines, channels): 1 where a channel stands out of its noise, down to 0 below it."""
    power = np.abs(np.nan_to_num(one.spectrum.amplitudes[0])) ** 2
    if not one.noise_known:
        return np.where(power > 0, 1.0, 0.0)
    noise = np.diagonal(one.covariance[0], axis1=-2, axis2=-1).real
    reliability: Real = power / np.where(power + noise > 0, power + noise, 1.0)
    return reliability


def _descend_all(view: ObservationModel, cost: Cost, psi: Real, sign: Real, lower: Real, upper: Real) -> Real:
    """Search from many starts of one repeat; in logarithms of the rig's parameters where they are all positive."""
    log = (np.arange(psi.shape[-1]) < view.m) & np.all(psi > 0, axis=0)

    def evaluate(x: Real, rows: Ints) -> QuadraticModel:
        at = np.where(log, np.exp(np.where(log, x, 0.0)), x)
        here = cost(at, sign[rows])
        chain = np.where(log, at, 1.0)
        both = chain[:, :, None] * chain[:, None, :]
        return QuadraticModel(here.cost, here.gradient * chain, here.symmetric * both, here.free * both)

    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(log, np.log(np.where(log, psi, 1.0)), psi)
        low = np.where(log, np.log(np.maximum(lower, 0.0)), lower)
        high = np.where(log, np.log(np.maximum(upper, 0.0)), upper)
    # No further than 20 decades from the starts: what is hardly seen must not run out of the range of numbers.
    low = np.where(log, np.maximum(low, np.min(x, axis=0) - 46), lower)
    high = np.where(log, np.minimum(high, np.max(x, axis=0) + 46), upper)
    longest = np.where(log, 1.0, np.inf)
    found = minimise(
        evaluate, x, limit=ROUGH, tolerance=1e-6, lower=low, upper=high, longest=longest, patience=ROUGH
    )
    return np.where(log, np.exp(np.where(log, found.x, 0.0)), found.x)


def _rivals(
    view: ObservationModel,
    data: Measured,
    found: OptimizeResult,
    sign: Real,
    bottoms: LocalMinima,
    doubt: float,
) -> tuple[Notice, ...]:
    """A warning where another valley of one repeat fits nearly as well as the one that the search ended in."""
    at = predict(view, data, found.x, sign)
    information = np.sum(at.information(), axis=-3)[0] + np.diag(prior_precision(view))
    sd = np.sqrt(np.abs(np.diagonal(scaled_inverse(information))))
    best = found.x[0]
    for psi, cost in zip(bottoms.psi, bottoms.cost, strict=True):
        away, above = np.abs(psi - best), float(cost - found.cost[0])
        if above > doubt or not np.any(away > 3 * sd):
            continue  # within 3 sd it is the same flat valley
        largest = np.argsort(-away / np.maximum(np.abs(best), np.abs(psi)))[:4]
        other = ", ".join(f"{view.names[j]} = {psi[j]:.4g} {view.units[j]}" for j in largest)
        worse = f"almost as well (χ² is {above:.3g} larger)" if above > TIE else "equally well"
        text = f"not unique: {other} fits {worse}; add a sensor at another point, fix a parameter or give a guess"
        return (Notice("not_unique", text, tuple(view.names[j] for j in largest)),)
    return ()


def _acceptable(data: Prepared, exact: Measured, unknowns: int) -> float:
    """The χ² above which an end is no fit; inf where the noise is not known."""
    from scipy.stats import chi2

    dof = exact.rows - unknowns
    if not data.noise_known or dof <= 0:
        return np.inf
    doubt = np.min(data.spectrum.dof)
    return float(chi2.isf(POOR, dof)) * (1.0 if np.isinf(doubt) else 1 + 8 / max(doubt - 4, 1.0))


def bounds(view: ObservationModel, positive: bool) -> tuple[Real, Real]:
    """Lower and upper bounds of ψ, each (M,), from the model, and 0 for its parts where `positive`."""
    model, endless = view.model, np.full(view.gains + view.delays, np.inf)
    low, high = model.bounds
    if positive:
        free = free_names(model)
        parts = np.array([unknown.name not in free for unknown in model.unknowns])
        low = np.where(parts, np.maximum(low, 0.0), low)
    return np.concatenate([low, -endless]), np.concatenate([high, endless])


def prior_precision(view: ObservationModel) -> Real:
    """Precision of the priors over ψ: the model's, and 0 for calibrations; (M,)."""
    return np.concatenate([view.model.prior_precision, np.zeros(view.gains + view.delays)])


def prior_mean(view: ObservationModel) -> Real:
    """Means of the priors over ψ, 0 where there is none; (M,)."""
    return np.concatenate([view.model.prior_mean, np.zeros(view.gains + view.delays)])


def local(view: ObservationModel, data: Measured, psi: Real, sign: Real) -> QuadraticModel:
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
    return QuadraticModel(cost, gradient - precision * away, information, information)


def logarithmic(
    view: ObservationModel, data: Measured, weight: Real, psi: Real, sign: Real
) -> QuadraticModel:
    """Cost of the residuals ρ = ln y − ln ŷ, with slope and curvature, at ψ, (K, M).

    Amplitude in nepers and phase in radians weigh alike at resonances and between them, so that the cost of a wrong
    resonance grows with its distance and has no valley of its own: Sidman, DeAngelis and Verghese (1991), IEEE
    Transactions on Automatic Control 36, 1065.  Large residuals count by their size (pseudo-Huber).  `data` must give
    the inputs.
    """
    at = predict(view, data, psi, sign)
    rows, M = at.J.shape[-3] * at.J.shape[-2], psi.shape[-1]
    shown = data.y - at.r
    seen = (data.y != 0) & (weight > 0)
    with np.errstate(all="ignore"):
        rho = np.where(seen, np.log(np.where(seen, data.y, 1.0) / shown), 0.0)
        J = np.where(seen[..., None], at.J / shown[..., None], 0.0).reshape(len(psi), rows, M)
    stretch = np.sqrt(1 + np.abs(rho) ** 2 / LOG_RESIDUAL**2)
    cost = 4 * LOG_RESIDUAL**2 * np.sum(weight * (stretch - 1), axis=(-2, -1))
    weighted = hermitian(J) * (weight / stretch).reshape(len(psi), 1, rows)
    information = 2 * (weighted @ J).real
    gradient = 2 * (weighted @ rho.reshape(len(psi), rows, 1)).real[..., 0]
    precision = prior_precision(view)
    away = psi - prior_mean(view)
    information = information + np.diag(precision)
    cost = cost + np.sum(precision * away**2, axis=-1)
    return QuadraticModel(cost, gradient - precision * away, information, information)


def _cost(view: ObservationModel, cost: Cost, psi: Real, sign: Real) -> Real:
    """The cost at many ψ of one repeat, inf where there is none, in pieces that fit into memory."""
    model, channels = view.model, len(view.channels)
    one = model.n * (model.n + channels) if small(model) else 2 * channels * len(model.elements)
    size = max(1, PIECE // (len(view.omega) * one))
    pieces = []
    with np.errstate(all="ignore"):
        for first in range(0, len(psi), size):
            pieces.append(cost(psi[first : first + size], sign[first : first + size]).cost)
    total = np.concatenate(pieces)
    return np.where(np.isfinite(total), total, np.inf)
