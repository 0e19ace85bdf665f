"""Minima of the likelihood from many starts: found, told apart, and named where others fit nearly as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ConvergenceError
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.descent import ROUGH, Likelihood, Stage, descend_all
from dashpot.estimate.likelihood.objective import directly_driven, measured
from dashpot.estimate.likelihood.starting_values import candidates, neighbours
from dashpot.estimate.likelihood.thinning import thinned
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import SPARSE_FROM, ObservationModel, small
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult
from dashpot.numerics.small_systems import scaled_inverse

POOR = 1e-6  # p-value below which a repeat is searched again from its own starts
SOFTNESS = 0.03  # relative noise added to every channel in the middle stage of a search from afar
SOFTER = 0.3  # and in the first one, where logarithms cannot be had
POLISH = 25  # iterations for the deepest ends of a round
ENOUGH = 0.1  # share of the first starts that end in one minimum that fits: enough to end the search
ENOUGH_MISFIT = 0.5  # and in one that does not fit
FAR = 20.0  # times the χ² of a fit: no rig of this kind comes near the data
ANOTHER = 0.1  # of χ², by which another minimum is lower there
LEAST = 16  # starts of the largest rigs
DEEPEST = 8  # minima that are followed to the bottom
COMPETING = (
    60.0  # χ² by which a minimum may lie above the lowest one of one repeat and be the lowest of another
)
TIE = 0.01  # of χ²: what fits alike
DOUBT = 9.2  # χ² by which another minimum may lie above and be told to the user: odds of 100 to 1


@dataclass(frozen=True)
class LocalMinima:
    """Where searches ended, the lowest first: psi (V, M), signs of the channels (V, channels), cost (V,)."""

    psi: Real
    sign: Real
    cost: Real

    @staticmethod
    def none(unknowns: int, channels: int) -> LocalMinima:
        """No minima yet."""
        return LocalMinima(np.empty((0, unknowns)), np.empty((0, channels)), np.empty(0))

    def with_ends(self, psi: Real, sign: Real, cost: Real) -> LocalMinima:
        """With more ends; those within 2 % of a lower one in every unknown are the same minimum and left out."""
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


# From minima to the answer of each repeat


def from_minima(
    likelihood: Likelihood, minima: LocalMinima
) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
    """Each repeat from the lowest minimum and those competing with it: its lowest end, signs, and a warning.

    The warning is of one repeat alone, where another minimum fits nearly as well.
    """
    scale = max(1.0, minima.cost[0] / likelihood.exact.rows)
    competing = _followed(likelihood, minima, COMPETING * scale)
    repeats = likelihood.repeats
    sign = np.repeat(competing.sign[:1], repeats, axis=0)
    best = likelihood.descend(np.repeat(competing.psi[:1], repeats, axis=0), sign)
    for psi, flips in zip(competing.psi[1:], competing.sign[1:], strict=True):
        start, signs = (np.repeat(part[None], repeats, axis=0) for part in (psi, flips))
        # A few steps tell for which repeats this minimum is not out of the question.
        short = likelihood.descend(start, signs, limit=PATIENCE)
        rows = np.flatnonzero(short.cost < best.cost + DOUBT * scale)
        if not len(rows):
            continue
        end = likelihood.descend(short.x[rows], signs[rows], repeats=rows)
        sign = sign.copy()
        sign[rows[best.worse(rows, end)]] = flips
        best = best.improved(rows, end)
    return best, sign, _not_unique(likelihood, best, sign, competing, DOUBT * scale) if repeats == 1 else ()


def _followed(likelihood: Likelihood, minima: LocalMinima, margin: float) -> LocalMinima:
    """The minima within `margin` of the lowest one, followed further down in the first repeat."""
    first = np.array([0])
    followed = LocalMinima(minima.psi[:0], minima.sign[:0], minima.cost[:0])
    acceptable = _acceptable(likelihood.data, likelihood.exact, minima.psi.shape[-1])
    most = 2 * DEEPEST if minima.cost[0] <= FAR * acceptable else DEEPEST // 2
    for k in np.flatnonzero(minima.cost <= minima.cost[0] + margin)[:most]:
        end = likelihood.descend(minima.psi[k : k + 1], minima.sign[k : k + 1], repeats=first, limit=ROUGH)
        if end.converged[0] or k == 0:
            followed = followed.with_ends(end.x, minima.sign[k : k + 1], end.cost)
    return followed


def _not_unique(
    likelihood: Likelihood, best: OptimizeResult, sign: Real, competing: LocalMinima, doubt: float
) -> tuple[Notice, ...]:
    """A warning where another minimum of one repeat fits nearly as well as the one that the search ended in."""
    view = likelihood.view
    sd = np.sqrt(np.abs(np.diagonal(scaled_inverse(likelihood.model_at(best.x, sign).symmetric[0]))))
    for psi, cost in zip(competing.psi, competing.cost, strict=True):
        away, above = np.abs(psi - best.x[0]), float(cost - best.cost[0])
        if above > doubt or not np.any(away > 3 * sd):
            continue  # within 3 sd it is the same flat minimum
        largest = np.argsort(-away / np.maximum(np.abs(best.x[0]), np.abs(psi)))[:4]
        other = ", ".join(f"{view.names[j]} = {psi[j]:.4g} {view.units[j]}" for j in largest)
        worse = f"almost as well (χ² is {above:.3g} larger)" if above > TIE else "equally well"
        text = f"not unique: {other} fits {worse}; add a sensor at another point, fix a parameter or give a guess"
        return (Notice("not_unique", text, tuple(view.names[j] for j in largest)),)
    return ()


def searched_again(likelihood: Likelihood, found: OptimizeResult, sign: Real) -> tuple[OptimizeResult, Real]:
    """Repeats that did not end in a fit are searched from starts of their own; the better end is kept."""
    acceptable = _acceptable(likelihood.data, likelihood.exact, found.x.shape[-1])
    poor = ~found.converged | (found.cost > np.maximum(acceptable, 1.5 * np.median(found.cost)))
    if len(poor) == 1 and likelihood.data.states is None:
        return found, sign  # its start was its own already
    x, cost, converged, iterations = (
        found.x.copy(), found.cost.copy(), found.converged.copy(), found.iterations.copy(),
    )  # fmt: skip
    sign = sign.copy()
    for repeat in np.flatnonzero(poor):
        minima = global_minima(likelihood, int(repeat))
        end, flips, _ = from_minima(likelihood.only(int(repeat)), minima)
        if not end.cost[0] >= cost[repeat]:
            x[repeat], cost[repeat], converged[repeat] = end.x[0], end.cost[0], end.converged[0]
            iterations[repeat] += end.iterations[0]
            sign[repeat] = flips[0]
    return OptimizeResult(x, cost, converged, iterations, found.history), sign


# From nothing to minima


def global_minima(likelihood: Likelihood, repeat: int) -> LocalMinima:
    """The minima that many starts of one repeat lead to, the lowest first.

    The first round starts from candidates, those after it from neighbours of the lowest minima as well.  Rounds end
    when a tenth of the first starts led to the lowest one and it fits (known noise), or half of them, or when two
    rounds in a row find nothing lower.  Raises ConvergenceError where no start ends at a finite cost.
    """
    effort = likelihood.effort
    on_basis = likelihood.view.reduced
    one = Likelihood.of(thinned(likelihood.data.only(repeat)), effort, on_basis)
    rng = np.random.default_rng([effort.seed, repeat])
    stages = _stages(one)
    acceptable = _acceptable(one.data, one.exact, len(one.view.names))
    # Large rigs: fewer starts, and none where a guess leads to a fit.
    ease = min(1.0, SPARSE_FROM / (one.view.model.n if on_basis is None else on_basis.size))
    starts = max(int(effort.starts * ease), min(effort.starts, LEAST))
    minima = _from_guesses(one, stages, rng)
    if np.any(minima.cost <= acceptable):
        return minima
    idle = 0
    for turn in range(effort.rounds):
        psi, sign = _starts_of_round(one, stages, minima, int(effort.candidates * ease), starts, turn, rng)
        psi, sign = _through(one, stages, psi, sign, straight=turn == 0)
        costs = stages[-1].cost(psi, sign)
        deep = np.argsort(costs)[:DEEPEST]
        end = one.descend(psi[deep], sign[deep], limit=POLISH)
        psi[deep], costs[deep] = end.x, end.cost
        before = minima.cost[0] if len(minima.cost) else np.inf
        minima = minima.with_ends(psi, sign, costs)
        if not len(minima.cost):
            raise ConvergenceError("no start leads to a minimum", cure="give guesses of the unknowns")
        lowest = minima.cost[0]
        # Far from any fit a lower end counts only where it is another one, not the same creeping on.
        least = ANOTHER * lowest if lowest > FAR * acceptable else 1e-3 * max(1.0, lowest / one.exact.rows)
        idle = idle + 1 if lowest > before - least else 0
        share = np.mean(costs <= lowest * 1.01 + 1) if turn == 0 else 0.0
        if share >= (ENOUGH if lowest <= acceptable else ENOUGH_MISFIT) or idle > 1:
            break
    return minima


def _from_guesses(one: Likelihood, stages: Sequence[Stage], rng: np.random.Generator) -> LocalMinima:
    """Where guesses lead, of large rigs that have one for every unknown; none of others."""
    minima = LocalMinima.none(len(one.view.names), len(one.view.channels))
    if small(one.view.model) or any(u.guess is None and u.sd is None for u in one.data.model.unknowns):
        return minima
    psi, sign = candidates(one.data, one.view, 1, rng)
    psi, sign = _through(one, stages, psi, sign, straight=True)
    end = one.descend(psi, sign)
    return minima.with_ends(end.x, sign, end.cost)


def _starts_of_round(
    one: Likelihood, stages: Sequence[Stage], minima: LocalMinima, many: int, starts: int, turn: int,
    rng: np.random.Generator,
) -> tuple[Real, Real]:  # fmt: skip
    """The best of many candidates, ranked by the first stage; after the first round neighbours of minima as well."""
    psi, sign = candidates(one.data, one.view, many + starts, rng)
    order = np.argsort(stages[0].cost(psi, sign))
    chosen = np.concatenate([[0], order[:starts]]) if turn == 0 else order[: starts // 4]
    psi, sign = psi[chosen], sign[chosen]
    if turn > 0:
        near, near_sign = neighbours(minima.psi[:DEEPEST], minima.sign[:DEEPEST], one.view, starts, rng)
        psi, sign = np.concatenate([psi, near]), np.concatenate([sign, near_sign])
    return psi, sign


def _stages(one: Likelihood) -> tuple[Stage, ...]:
    """What is minimised one after the other from afar: logarithms, softened weights, and the likelihood itself."""
    view = one.view

    by_channels = directly_driven(view, one.exact)
    if by_channels is None:
        first = Stage(view, measured(one.data, view, SOFTER))
    else:
        first = Stage(view, by_channels, _reliability(one.data, view))
    return first, Stage(view, measured(one.data, view, SOFTNESS)), Stage(view, one.exact)


def _through(
    one: Likelihood, stages: Sequence[Stage], psi: Real, sign: Real, *, straight: bool
) -> tuple[Real, Real]:
    """Where starts end that go through all stages; with `straight`, where the first half ends without the first.

    Logarithms lead nearly everything to one minimum, and that may be the wrong one.
    """
    half = (len(psi) + 1) // 2 if straight else 0
    past, signs = psi[:half], sign[:half]
    for stage in stages:
        psi = descend_all(stage, psi, sign, lower=one.lower, upper=one.upper)
    for stage in stages[1:] if half else ():
        past = descend_all(stage, past, signs, lower=one.lower, upper=one.upper)
    return np.concatenate([psi, past]), np.concatenate([sign, signs])


def _reliability(one: Prepared, view: ObservationModel) -> Real:
    """Weights of the logarithms, (lines, channels): 1 where a channel stands out of its noise, down to 0 below it."""
    power = np.abs(np.nan_to_num(one.spectrum.amplitudes[0])) ** 2
    if not one.noise_known:
        return np.where(power > 0, 1.0, 0.0)
    noise = np.diagonal(one.covariance[0], axis1=-2, axis2=-1).real
    reliability: Real = power / np.where(power + noise > 0, power + noise, 1.0)
    return reliability


def _acceptable(data: Prepared, exact: Measured, unknowns: int) -> float:
    """The χ² above which an end is no fit; inf where the noise is not known."""
    from scipy.stats import chi2

    dof = exact.rows - unknowns
    if not data.noise_known or dof <= 0:
        return np.inf
    uncertain = np.min(data.spectrum.dof)
    return float(chi2.isf(POOR, dof)) * (1.0 if np.isinf(uncertain) else 1 + 8 / max(uncertain - 4, 1.0))
