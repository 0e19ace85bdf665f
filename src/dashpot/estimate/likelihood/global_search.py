"""Minima of the likelihood from many starts: found, told apart, and named where others fit nearly as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.errors import ConvergenceError
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.descent import NEAR_END, ROUGH, Likelihood, Stage, descend_all
from dashpot.estimate.likelihood.local_minima import COMPETING, LocalMinima
from dashpot.estimate.likelihood.objective import directly_driven, measured
from dashpot.estimate.likelihood.starting_values import candidates, neighbours
from dashpot.estimate.likelihood.thinning import thinned
from dashpot.estimate.linear.least_squares import starts as equation_starts
from dashpot.estimate.linear.least_squares import where_finite
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.observation import SPARSE_FROM, small
from dashpot.model.unstructured import free_names
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult
from dashpot.numerics.small_systems import scaled_inverse

POOR = 1e-6  # p-value below which a repeat is searched again from its own starts
UNCERTAIN = 0.1  # p-value below which a search goes on where all is seen and starts are cheap
SOFTNESS = 0.03  # relative noise added to every channel in the middle stage of a search from afar
SOFTER = 0.3  # and in the first one, where logarithms cannot be had
POLISH = 25  # iterations for the deepest ends of a round
ENOUGH = 0.1  # share of the first starts that end in one minimum that fits: enough to end the search
ENOUGH_MISFIT = 0.5  # and in one that does not fit
FAR = 20.0  # times the χ² of a fit: no rig of this kind comes near the data
ANOTHER = 0.1  # of χ², by which another minimum is lower there
LEAST = 16  # starts of the largest rigs, and where all is seen
SEEN = 0.25  # share of the usual starts and candidates where all is seen: the equation of motion starts near
REACH = 1e4  # times the largest start: where all is seen, an end beyond it is on its way to infinity
SMALL_PART = 0.1  # of the middle candidate, below which a start by the equation of motion is no part of a rig
DRAWS = 8  # about an end whose parts noise leaves uncertain, where all is seen
AROUND = 2.0  # of its standard deviations: minima whose parts differ in sign were found from half of them
DEEPEST = 8  # minima that are followed to the bottom
SAME = 1e-3  # of the largest relative change: what differs by less between two minima is not named
TIE = 0.01  # of χ²: what fits alike
DOUBT = 9.2  # χ² by which another minimum may lie above and be told to the user: odds of 100 to 1


# From minima to the answer of each repeat


def from_minima(
    likelihood: Likelihood, minima: LocalMinima
) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
    """Each repeat from the lowest minimum and those competing with it: its end, signs (K, channels), and a warning.

    The warning is of another minimum that fits nearly as well; of repeats it says in how many there is one.
    """
    scale = _scale(likelihood, minima)
    competing = followed_minima(likelihood, minima)
    repeats = likelihood.repeats
    sign = np.repeat(competing.sign[:1], repeats, axis=0)
    best = likelihood.descend(np.repeat(competing.psi[:1], repeats, axis=0), sign)
    ends = [(np.arange(repeats), best)]
    for psi, flips in zip(competing.psi[1:], competing.sign[1:], strict=True):
        start, signs = (np.repeat(part[None], repeats, axis=0) for part in (psi, flips))
        # A few steps tell for which repeats this minimum is not out of the question.
        short = likelihood.descend(start, signs, limit=PATIENCE)
        rows = np.flatnonzero(short.cost < best.cost + DOUBT * scale)
        if not len(rows):
            continue
        end = likelihood.descend(short.x[rows], signs[rows], repeats=rows)
        ends.append((rows, end))
        sign = sign.copy()
        sign[rows[best.worse(rows, end)]] = flips
        best = best.improved(rows, end)
    if repeats > 1:
        return best, sign, _of_repeats(likelihood, best, sign, ends, DOUBT * scale)
    return best, sign, _not_unique(likelihood, best, sign, competing, DOUBT * scale)


def _scale(likelihood: Likelihood, minima: LocalMinima) -> float:
    """What a difference of χ² is counted in: the lowest one's χ² for each row, where noise is not known or no fit."""
    ratio = float(minima.cost[0] / likelihood.exact.rows)
    return max(1.0, ratio) if likelihood.data.noise_known else ratio


def followed_minima(likelihood: Likelihood, minima: LocalMinima) -> LocalMinima:
    """The minima that compete with the lowest one, followed further down in the first repeat.

    They may have been found in fewer lines: where they are many, some steps of all of them tell which are low here.
    """
    first = np.array([0])
    acceptable = _acceptable(likelihood.data, likelihood.exact, minima.psi.shape[-1])
    most = 2 * DEEPEST if minima.cost[0] <= FAR * acceptable else DEEPEST // 2
    minima = minima.within(COMPETING * _scale(likelihood, minima))
    none = LocalMinima.none(minima.psi.shape[1], minima.sign.shape[1])
    for limit in (PATIENCE, ROUGH) if len(minima.cost) > most else ():
        rows = np.zeros(len(minima.cost), dtype=int)
        ends = likelihood.descend_in(likelihood.exact, minima.psi, minima.sign, limit, rows, near=NEAR_END)
        minima = none.with_ends(ends.x, minima.sign, ends.cost)
        minima = minima.within(COMPETING * _scale(likelihood, minima))
    deeper = none
    for k in range(min(len(minima.cost), most)):
        end = likelihood.descend(minima.psi[k : k + 1], minima.sign[k : k + 1], repeats=first, limit=ROUGH)
        if end.converged[0] or k == 0:
            deeper = deeper.with_ends(end.x, minima.sign[k : k + 1], end.cost)
    return deeper


def _not_unique(
    likelihood: Likelihood, best: OptimizeResult, sign: Real, competing: LocalMinima, doubt: float
) -> tuple[Notice, ...]:
    """A warning where another minimum of one repeat fits nearly as well as the one that the search ended in."""
    view = likelihood.view
    sd = likelihood.model_at(best.x, sign).sd[0]
    for psi, cost in zip(competing.psi, competing.cost, strict=True):
        above = float(cost - best.cost[0])
        if above <= doubt and apart(best.x[0], psi, sd):
            return (not_unique(view.names, view.units, best.x[0], psi, above),)
    return ()


def _of_repeats(
    likelihood: Likelihood, best: OptimizeResult, sign: Real, ends: Sequence[tuple[Ints, OptimizeResult]],
    doubt: float,
) -> tuple[Notice, ...]:  # fmt: skip
    """A warning that says for how many repeats another of the `ends` fits nearly as well as the best one."""
    information = likelihood.model_at(best.x, sign).symmetric
    sd = np.sqrt(np.abs(np.diagonal(scaled_inverse(information), axis1=-2, axis2=-1)))
    rival = np.zeros(likelihood.repeats, dtype=bool)
    for rows, end in ends:
        alike = end.converged & (end.cost - best.cost[rows] <= doubt)
        rival[rows] |= alike & np.any(np.abs(end.x - best.x[rows]) > 3 * sd[rows], axis=-1)
    if not np.any(rival):
        return ()
    text = f"not unique in {np.sum(rival)} of {len(rival)} repeats: there another minimum fits nearly as well"
    return (Notice("not_unique", text),)


def apart(psi: Real, other: Real, sd: Real) -> bool:
    """Whether two ends are different minima: within 3 sd they are the same flat one.  All arguments (unknowns,)."""
    return bool(np.any(np.abs(other - psi) > 3 * sd))


def not_unique(names: Sequence[str], units: Sequence[str], psi: Real, other: Real, above: float) -> Notice:
    """The notice that another minimum, whose χ² lies `above` that of `psi`, fits alike.  Both (M,)."""
    change = np.abs(other - psi) / np.maximum(np.maximum(np.abs(psi), np.abs(other)), 1e-300)
    largest = [j for j in np.argsort(-change)[:4] if change[j] > SAME * np.max(change)]
    values = ", ".join(f"{names[j]} = {other[j]:.4g} {units[j]}" for j in largest)
    worse = f"almost as well (χ² is {above:.3g} larger)" if above > TIE else "equally well"
    worse = f"better (χ² is {-above:.3g} smaller)" if above < -TIE else worse
    text = (
        f"not unique: {values} fits {worse}; add a sensor at another point, fix a parameter or give a guess"
    )
    return Notice("not_unique", text, tuple(names[j] for j in largest))


def searched_again(
    likelihood: Likelihood, found: OptimizeResult, sign: Real
) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
    """Repeats that did not end in a fit are searched from starts of their own; the better end is kept.

    The notice is that of `from_minima`, of one repeat alone.  sign (K, channels).
    """
    acceptable = _acceptable(likelihood.data, likelihood.exact, found.x.shape[-1])
    others = 1.5 * np.median(found.cost) if len(found.cost) > 1 else 0.0
    poor = ~found.converged | (found.cost > np.maximum(acceptable, others))
    if len(poor) == 1 and not seen_directly(likelihood.data):
        return found, sign, ()  # its start was its own already
    x, cost, converged, iterations = (
        found.x.copy(), found.cost.copy(), found.converged.copy(), found.iterations.copy(),
    )  # fmt: skip
    sign, notices, history = sign.copy(), tuple[Notice, ...](), found.history
    for repeat in np.flatnonzero(poor):
        minima = global_minima(likelihood, int(repeat))
        end, flips, notices_of_end = from_minima(likelihood.only(int(repeat)), minima)
        if not end.cost[0] >= cost[repeat]:
            x[repeat], cost[repeat], converged[repeat] = end.x[0], end.cost[0], end.converged[0]
            iterations[repeat] += end.iterations[0]
            sign[repeat] = flips[0]
            notices = notices_of_end if len(poor) == 1 else ()
            if repeat == 0:
                history = end.history
    return OptimizeResult(x, cost, converged, iterations, history), sign, notices


# From nothing to minima


def minima_around(likelihood: Likelihood, start: Real, sign: Real) -> LocalMinima:
    """Where `start` (1, M) leads, and draws about that end, AROUND standard deviations wide; sign (1, channels)."""
    end = likelihood.descend(start, sign)
    minima = LocalMinima.none(start.shape[1], sign.shape[1]).with_ends(end.x, sign, end.cost)
    around = likelihood.model_at(end.x, sign)
    covariance, sd = around.inverse[0], around.sd[0]
    if not np.all(np.isfinite(sd)):
        return minima
    share, directions = np.linalg.eigh(covariance / np.outer(sd, sd))
    drawn = np.random.default_rng(likelihood.effort.seed).standard_normal((DRAWS, len(sd)))
    away = (drawn * np.sqrt(np.maximum(share, 0.0))) @ directions.T
    signs = np.repeat(sign, DRAWS, axis=0)
    others = likelihood.descend(end.x + AROUND * sd * away, signs)
    ended = others.converged
    return minima.with_ends(others.x[ended], signs[ended], others.cost[ended])


def global_minima(likelihood: Likelihood, repeat: int) -> LocalMinima:
    """The minima that many starts of one repeat lead to, the lowest first.

    The first round starts from candidates, those after it from neighbours of the lowest minima as well.  Rounds end
    when a tenth of the first starts led to the lowest one and it fits (known noise), or half of them, or when two
    rounds in a row find nothing lower.  Raises ConvergenceError where no start ends at a finite cost.
    """
    effort = likelihood.effort
    on_basis = likelihood.view.reduced
    one = Likelihood.of(thinned(likelihood.data.only(repeat)), effort)
    rng = np.random.default_rng([effort.seed, repeat])
    stages = _stages(one)
    level = UNCERTAIN if seen_directly(one.data) else POOR
    acceptable = _acceptable(one.data, one.exact, len(one.view.names), level)
    # Large rigs: fewer starts, and none where a guess leads to a fit.
    ease = min(1.0, SPARSE_FROM / (one.view.model.n if on_basis is None else on_basis.size))
    ease = min(ease, SEEN) if seen_directly(one.data) else ease
    starts = max(int(effort.starts * ease), min(effort.starts, LEAST))
    minima = _from_guesses(one, stages, rng)
    if np.any(minima.cost <= acceptable):
        return minima
    idle, last_sure = 0, int(seen_directly(one.data))
    for turn in range(effort.rounds):
        psi, sign = _starts_of_round(one, stages, minima, int(effort.candidates * ease), starts, turn, rng)
        reach = REACH * np.max(np.abs(psi), axis=0) if seen_directly(one.data) else np.inf
        psi, sign = _through(one, stages, psi, sign, straight=turn == 0)
        costs = np.where(np.all(np.abs(psi) <= reach, axis=-1), stages[-1].cost(psi, sign), np.inf)
        deep = np.argsort(costs)[:DEEPEST]
        end = one.descend(psi[deep], sign[deep], limit=POLISH)
        psi[deep], costs[deep] = end.x, np.where(np.isfinite(costs[deep]), end.cost, np.inf)
        before = minima.cost[0] if len(minima.cost) else np.inf
        minima = minima.with_ends(psi, sign, costs)
        if not len(minima.cost):
            raise ConvergenceError("no start leads to a minimum", cure="give guesses of the unknowns")
        lowest = minima.cost[0]
        # Far from any fit a lower end counts only where it is another one, not the same creeping on.
        least = ANOTHER * lowest if lowest > FAR * acceptable else 1e-3 * max(1.0, lowest / one.exact.rows)
        idle = idle + 1 if lowest > before - least else 0
        share = np.mean(costs <= lowest * 1.01 + 1) if turn == last_sure else 0.0
        if share >= (ENOUGH if lowest <= acceptable else ENOUGH_MISFIT) or idle > 1:
            break
    return minima


def _from_guesses(one: Likelihood, stages: Sequence[Stage], rng: np.random.Generator) -> LocalMinima:
    """Where guesses lead, of large rigs that have one for every unknown; none of others."""
    minima = LocalMinima.none(len(one.view.names), len(one.view.channels))
    if small(one.view.model) or any(u.guess is None and u.sd is None for u in one.data.model.unknowns):
        return minima
    psi, sign = candidates(one.data, 1, rng)
    psi, sign = _through(one, stages, psi, sign, straight=True)
    end = one.descend(psi, sign)
    return minima.with_ends(end.x, sign, end.cost)


def _starts_of_round(
    one: Likelihood, stages: Sequence[Stage], minima: LocalMinima, many: int, starts: int, turn: int,
    rng: np.random.Generator,
) -> tuple[Real, Real]:  # fmt: skip
    """The best of many candidates, ranked by the first stage; after the first round neighbours of minima as well."""
    psi, sign = candidates(one.data, many + starts, rng)
    order = np.argsort(stages[0].cost(psi, sign))
    chosen = np.concatenate([[0], order[:starts]]) if turn == 0 else order[: starts // 4]
    if seen_directly(one.data):  # the rank favours one valley, and starts are cheap
        chosen = np.concatenate([chosen[: 1 + starts // 2], 1 + np.arange(starts)])
    middle, psi, sign = psi[0], psi[chosen], sign[chosen]
    if turn == 0 and one.data.states is not None and seen_directly(one.data):
        near = _from_equation(one.data, one.data.states, middle)
        psi, sign = np.concatenate([near, psi]), np.concatenate([np.ones((len(near), sign.shape[1])), sign])
    if turn > 0:
        near, near_sign = neighbours(minima.psi[:DEEPEST], minima.sign[:DEEPEST], one.view, starts, rng)
        psi, sign = np.concatenate([psi, near]), np.concatenate([sign, near_sign])
    return psi, sign


def seen_directly(data: Prepared) -> bool:
    """Whether channels whose calibration is known, and no others, show every coordinate and input."""
    return data.states is not None and bool(data.view.is_direct.all())


def _from_equation(data: Prepared, states: States, middle: Real) -> Real:
    """Least squares on the equation of motion, (3, M); parts that are negative there are small ones.

    Noise of a fifth of the motion makes some parts negative, and what starts there stays there.
    """
    psi = where_finite(np.concatenate(equation_starts(data.model, states)), middle)
    free = free_names(data.model)
    part = np.array([unknown.name not in free for unknown in data.model.unknowns])
    return np.where(part & (psi < SMALL_PART * middle), SMALL_PART * middle, psi)


def _stages(one: Likelihood) -> tuple[Stage, ...]:
    """What is minimised one after the other from afar: logarithms, softened weights, and the likelihood itself.

    Where all is seen the likelihood has few valleys, and softened weights lead past the right one.
    """
    view = one.view
    by_channels = directly_driven(view, one.exact)
    if by_channels is None:
        first = Stage(view, measured(one.data, SOFTER))
    else:
        first = Stage(view, by_channels, _reliability(one.data))
    exact = Stage(view, one.exact)
    if seen_directly(one.data):
        return first, exact
    return first, Stage(view, measured(one.data, SOFTNESS)), exact


def _through(
    one: Likelihood, stages: Sequence[Stage], psi: Real, sign: Real, *, straight: bool
) -> tuple[Real, Real]:
    """Where starts end that go through all stages; with `straight`, where the first half ends without the first.

    Logarithms lead nearly everything to one minimum, and that may be the wrong one.
    """
    half = (len(psi) + 1) // (1 if len(stages) == 2 else 2) if straight else 0
    past, signs = psi[:half], sign[:half]
    for stage in stages:
        psi = descend_all(stage, psi, sign, lower=one.lower, upper=one.upper)
    for stage in stages[1:] if half else ():
        past = descend_all(stage, past, signs, lower=one.lower, upper=one.upper)
    return np.concatenate([psi, past]), np.concatenate([sign, signs])


def _reliability(one: Prepared) -> Real:
    """Weights of the logarithms, (lines, channels): 1 where a channel stands out of its noise, down to 0 below it."""
    power = np.abs(np.nan_to_num(one.spectrum.amplitudes[0])) ** 2
    if not one.noise_known:
        return np.where(power > 0, 1.0, 0.0)
    noise = np.diagonal(one.covariance[0], axis1=-2, axis2=-1).real
    reliability: Real = power / np.where(power + noise > 0, power + noise, 1.0)
    return reliability


def fits(likelihood: Likelihood, end: OptimizeResult) -> bool:
    """Whether the end of a search of one repeat may be the truth, as its χ² is no surprise."""
    return bool(end.cost[0] <= _acceptable(likelihood.data, likelihood.exact, end.x.shape[-1]))


def _acceptable(data: Prepared, exact: Measured, unknowns: int, level: float = POOR) -> float:
    """The χ² above which an end is no fit at a p-value of `level`; inf where the noise is not known."""
    from scipy.special import chdtri  # scipy.stats costs half a second of start-up

    dof = exact.rows - unknowns
    if not data.noise_known or dof <= 0:
        return np.inf
    uncertain = np.min(data.spectrum.dof)
    return float(chdtri(dof, level)) * (1.0 if np.isinf(uncertain) else 1 + 8 / max(uncertain - 4, 1.0))
