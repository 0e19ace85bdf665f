"""Maximum likelihood in the frequency domain, for any linear set of channels (THEORY §4, ml)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from dashpot.arrays import Complex, Ints, Real, hermitian, random_generator
from dashpot.data.spectrum import taken_as_measured
from dashpot.estimate.likelihood.boundary_loads import RecordEnds, projector
from dashpot.estimate.likelihood.descent import ROUGH, Effort, Likelihood
from dashpot.estimate.likelihood.global_search import (
    LocalMinima,
    candidates,
    decay_minima,
    fits,
    followed_minima,
    from_minima,
    global_minima,
    minima_around,
    searched_again,
    seen_directly,
)
from dashpot.estimate.likelihood.objective import per_line
from dashpot.estimate.linear.gram import equation_covariance
from dashpot.estimate.linear.least_squares import (
    compensated,
    equation,
    where_finite,
    with_priors,
    without_noise,
)
from dashpot.estimate.method import HeldBounds, Method, Solution, Traits
from dashpot.estimate.nonlinear.search import search_harmonics
from dashpot.estimate.preparation import Prepared, States
from dashpot.model.dynamics import stiffness
from dashpot.model.network import Model
from dashpot.model.reduced import extended_basis, line_motions, reduced
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, without_bounds
from dashpot.numerics.small_systems import solve_scaled

# The search of large rigs: on the span of few motions, which are computed anew where each search ends
# (THEORY §10).
#
# Responses and adjoints at some lines span a reduced rig that is exact at those lines and parameters, with
# its slopes. All of the search that a small rig gets runs there; its end gives new motions, until it stays
# where they were computed. What has been left out of the basis, lines between those of the basis, the full
# rig checks at the end.


FROM = 400  # coordinates from which the search is on a basis
LINES = 20  # at which motions are computed


def reduced_search(likelihood: Likelihood) -> tuple[Likelihood, OptimizeResult, Real, tuple[Notice, ...]]:
    """The minimum of one repeat of a large rig, with the likelihood on the basis there.

    Returns that likelihood, the minimum, the signs of its channels (1, channels), and a notice where it is not unique.

    Raises ConvergenceError if no start leads to a minimum.
    """
    view = likelihood.view
    psi, sign = candidates(likelihood.data, 1, random_generator(likelihood.effort.seed))
    # Lines for the basis: all of few, else LINES of them, spread evenly over the sorted frequencies
    order = np.argsort(view.omega, kind="stable")
    lines = np.sort(order[np.unique(np.linspace(0, len(order) - 1, min(LINES, len(order))).astype(int))])
    V = np.zeros((view.model.n, 0))
    minima, notices, history, settled = None, tuple[Notice, ...](), [psi[0]], False
    iterations = np.zeros(1, dtype=np.int64)
    for _ in range(25):  # refreshes at most
        # The basis with the motions at ψ; where it would grow too wide, they take its place
        p = view.model.parameters(psi[0][: view.m])
        motions = np.concatenate([line_motions(view, p, int(line)) for line in lines], axis=1)
        wider = extended_basis(V, motions)
        V = wider if wider.shape[1] <= 260 or not V.shape[1] else extended_basis(V[:, :0], motions)
        on_basis = likelihood.on_basis(reduced(view, V))
        if minima is None:
            minima, sign, notices = from_minima(on_basis, global_minima(on_basis, 0))
        else:
            minima = on_basis.descend(psi, sign)
        iterations += minima.iterations
        history.append(minima.x[0])
        still = _steps(minima.x - psi, on_basis, minima.x, sign) < 1e-4
        psi = minima.x
        if still:  # where its motions were computed
            more = _left_out(likelihood, on_basis, lines, psi, sign)
            settled = not len(more)
            if settled:
                break
            lines = np.union1d(lines, more)
    assert minima is not None
    converged = minima.converged & settled
    whole = OptimizeResult(psi, minima.cost, converged, iterations, np.array(history))
    return on_basis, whole, sign, notices


def _steps(step: Real, likelihood: Likelihood, psi: Real, sign: Real) -> float:
    """A step (1, M) in standard deviations, the largest; steps within rounding of the value count as none."""
    around = likelihood.model_at(psi, sign)
    rounding = np.abs(step[0]) <= 1e-9 * np.abs(psi[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.where(rounding, 0.0, np.abs(step[0]) / around.sd[0])
    return float(np.max(np.nan_to_num(sizes, nan=np.inf)))


def _left_out(likelihood: Likelihood, on_basis: Likelihood, lines: Ints, psi: Real, sign: Real) -> Ints:
    """Lines that belong into the basis: those at which the full rig differs most, where it would move the end."""
    if len(lines) == len(likelihood.view.omega):
        return np.zeros(0, dtype=np.int64)
    information, scores, cost = per_line(likelihood.view, likelihood.exact, psi, sign)
    _, near, near_cost = per_line(on_basis.view, on_basis.exact, psi, sign)
    change = np.sum(scores - near, axis=-2)
    step = solve_scaled(np.sum(information, axis=-3), change)
    if _steps(step, on_basis, psi, sign) < 0.05:
        return np.zeros(0, dtype=np.int64)
    worst = np.argsort(-np.abs(cost - near_cost)[0], kind="stable")
    fresh = worst[~np.isin(worst, lines)]
    return np.asarray(fresh[: LINES // 2], dtype=np.int64)


# A start for whole records whose coordinates are all seen: the equation of motion with its boundary loads
# solved for.
#
# D X = R U + S f + a + jω b is linear in the unknowns and the loads. Weighted by the noise of the equation
# at the last values, with the noise's own moments taken out at the end, as the starts of settled data are.


def record_starts(model: Model, data: States, ends: RecordEnds, rig: Real | None = None) -> Real:
    """Values of the unknowns to begin with, (starts, K, unknowns): after each pass, with the noise in and taken out.

    The first pass takes the noise of the equation from a `rig`, (unknowns,), or as even at all lines, which where lines
    of motion are few or displacements are integrated is far from it.

    Where little but transients moves, taking the noise out may lead astray, and leaving it in is biased: what they fit
    decides.  Stated values count as much as the data do: without a force these leave a scale free, in which the error
    of the equation grows, so that by their own weights all unknowns would shrink from pass to pass.
    """
    Phi, h = equation(model, data)
    stated = model.prior_precision > 0
    if rig is None:
        even = np.broadcast_to(np.eye(model.n, dtype=complex), (*Phi.shape[:2], model.n, model.n))
        N, right = _sums(Phi, h, even, _loads(model, data, ends), ends)
        firmly = np.diagonal(N, axis1=-2, axis2=-1) * stated
        theta = solve_scaled(*with_priors(model, N, right, firmly))
    else:
        theta = np.broadcast_to(rig, (len(data.z), len(rig)))
    starts = [theta]
    for _ in range(4):  # passes at most
        p = model.parameters(theta)
        Se = equation_covariance(model, p, data)
        columns = _loads(model, data, ends, p)
        N, right = _sums(Phi, h, Se, columns, ends)
        firmly = np.maximum(np.diagonal(N, axis1=-2, axis2=-1) * stated, model.prior_precision)
        theta = where_finite(solve_scaled(*with_priors(model, N, right, firmly)), theta)
        clean, usable = without_noise(model, data, Se, N, right, firmly)
        starts.append(theta)
        theta = np.where(usable[..., None], where_finite(clean, theta), theta)
        starts.append(theta)
        # A descent goes on from where passes change all unknowns by no more than a hundredth.
        if len(starts) > 3 and np.all(np.abs(theta - starts[-3]) <= 0.01 * np.abs(theta)):
            break
    return np.stack(starts)


def _loads(model: Model, data: States, ends: RecordEnds, p: Real | None = None) -> Complex:
    """What the ends add to the equation of motion: loads at coordinates, and polynomials of channels through H."""
    lead = (len(data.z), len(data.omega))
    each = np.broadcast_to(np.eye(model.n, dtype=complex), (*lead, model.n, model.n))
    polynomials = np.zeros((*lead, model.n, len(ends.channel)), dtype=np.complex128)
    if p is not None:
        H = stiffness(model, p, data.omega, data.experiment)
        read = data.reconstruction[..., : H.shape[-1], :] @ ends.polynomials()
        polynomials = H @ read - model.S @ (data.reconstruction[..., H.shape[-1] :, :] @ ends.polynomials())
    return np.concatenate([each, ends.s[:, None, None] * each, polynomials], axis=-1)


def _sums(Phi: Complex, h: Complex, Se: Complex, columns: Complex, ends: RecordEnds) -> tuple[Real, Real]:
    """2 Re Φᴴ Ω Φ and 2 Re Φᴴ Ω h with the columns of each record projected out; (K, m, m) and (K, m)."""
    L = np.linalg.cholesky(Se)
    m, sides = Phi.shape[-1], Phi.shape[-1] + 1
    together = np.concatenate([Phi, h[..., None], columns], axis=-1)
    white = np.linalg.solve(np.broadcast_to(L, (*together.shape[:2], *L.shape[-2:])), together)
    regression, loads = white[..., :sides], white[..., sides:]
    rest = regression - loads @ projector(ends, loads).coefficients(regression)
    flat = rest.reshape(len(rest), -1, sides)
    products = 2 * (hermitian(flat) @ flat).real
    return products[:, :m, :m], products[:, :m, m]


@dataclass(frozen=True)
class MaximumLikelihood(Method):
    """Minimise Σ (y − κGq̂)ᴴ V⁻¹ (y − κGq̂) over θ, unknown gains and delays; inputs measured with noise are solved for.

    Where all coordinates are seen the start is the noise-compensated least squares; elsewhere `candidates` random
    rigs of sensible size are ranked by the logarithms of their responses, and the best `starts` of them searched, first
    in logarithms, then with weights that harden step by step, for at most `rounds` rounds.  Repeats share the minima
    that the first one finds, and look for their own where these do not lead to a fit. `positive` holds the parts of
    the rig at or above 0, not what belongs to a free matrix; bounds of the model hold always. With a `start`,
    values of all unknowns, and `start_sign`, signs of the channels, one descent from there takes the search's
    place, and some about its end if it is to be `thorough`; without, a `thorough` search draws its starts where all
    is seen as well. `rivals` are further starts with their signs; where they end is reported if it fits equally
    well. `seed` is that of the random rigs. A descent ends
    where no unknown moves by more than `tolerance` standard deviations, after `max_iterations` at the latest.
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
    rivals: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = ()
    thorough: bool = False
    name: ClassVar[str] = "ml"
    traits: ClassVar[Traits] = Traits(
        by_output=True, maximum_likelihood=True, weighted=True, bounds=True, transients=True, nonlinear=True
    )

    def __post_init__(self) -> None:
        random_generator(self.seed)  # refuses what is no seed

    def solve(self, data: Prepared) -> Solution:
        """θ, gains and delays at the maximum of the likelihood.

        Raises ConvergenceError if no start leads anywhere, DataError or UsageError if a nonlinear rig's dwells
        lack the harmonics or the motions that its search needs.
        """
        likelihood = Likelihood.of(data, self.effort)
        if not self.start and likelihood.exact.ends is not None and likelihood.exact.ends.missing:
            # What is put in for samples that are not measured is near enough to search with
            first = self.solve(replace(data, spectrum=taken_as_measured(data.spectrum)))
            sign = data.spectrum.signs(first.signs)[0]
            near = replace(self, start=tuple(first.theta[0].tolist()), start_sign=tuple(sign.tolist()))
            found = near.solve(data)
            return replace(found, warnings=(*first.warnings, *found.warnings))
        view, warnings = likelihood.view, tuple[Notice, ...]()
        if likelihood.exact.nonlinear is not None:
            minimum, exact, warnings = search_harmonics(likelihood)
            sign = np.ones((likelihood.repeats, len(view.channels)))
            likelihood = replace(likelihood, exact=exact)
        elif self.start and likelihood.repeats == 1 and len(self.start) == len(view.names):  # of this rig
            minimum, sign, warnings = self._from_start(likelihood)
        elif (decays := _from_decays(likelihood)) is not None:
            minimum, sign, warnings = from_minima(likelihood, decays)
        elif data.states is not None and seen_directly(data) and not self.thorough:
            start = _start(likelihood, data.states)
            sign = np.ones((likelihood.repeats, len(view.channels)))
            minimum = likelihood.descend(start, sign)
        elif (
            view.model.n >= FROM
            and likelihood.exact.ends is None
            and likelihood.repeats == 1
            and view.m <= 100
            and not view.model.differs
        ):
            # Large enough for a basis to pay, with few unknowns, each of which has a projected matrix of its own
            likelihood, minimum, sign, warnings = reduced_search(likelihood)
        else:
            minimum, sign, warnings = from_minima(likelihood, global_minima(likelihood, 0))
        if likelihood.exact.nonlinear is None and not self.start and not self.thorough:
            minimum, sign, again = searched_again(likelihood, minimum, sign)
            warnings += again
        around = likelihood.model_at(minimum.x, sign)
        bounds = None
        if np.any(np.isfinite(likelihood.lower) | np.isfinite(likelihood.upper)):
            free = without_bounds(minimum.x, around, likelihood.lower, likelihood.upper)
            bounds = HeldBounds(likelihood.lower, likelihood.upper, free)
        ended = minimum.converged, minimum.iterations, minimum.history
        signs = {view.channels[int(c)].name: sign[:, c] for c in np.flatnonzero(view.flips)}
        responses = likelihood.exact.nonlinear
        return Solution(minimum.x, around.inverse, *ended, signs, warnings, bounds, responses)

    def _from_start(self, likelihood: Likelihood) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
        """Where the start of one repeat leads, alone, with draws about it, or with its rivals; signs and a warning."""
        start = np.array([self.start])
        sign = np.array([self.start_sign or (1.0,) * len(likelihood.view.channels)])
        if self.thorough:
            return from_minima(likelihood, minima_around(likelihood, start, sign))
        if self.rivals:
            others, flips = (np.array(part) for part in zip(*self.rivals, strict=True))
            minima = _at(likelihood, np.concatenate([start, others]), np.concatenate([sign, flips]))
            return from_minima(likelihood, minima)
        return likelihood.descend(start, sign), sign, ()

    def rough(
        self, data: Prepared, more: Prepared | None = None, *, typical: int | None = None
    ) -> LocalMinima:
        """What the descents of one repeat end in, whatever it is, the lowest first, and what competes with it.

        One descent where all is seen, from the equation of motion weighted evenly, or as a typical rig has it: that
        of this number, where 0 is the middle of all.
        Elsewhere `more` lines than those that are searched tell which minima are low.
        Raises as `solve`.
        """
        likelihood = Likelihood.of(data, self.effort)
        if data.states is not None and seen_directly(data):
            sign = np.ones((1, len(likelihood.view.channels)))
            start = _start(likelihood, data.states, typical=typical)
            end = likelihood.descend(start, sign, limit=ROUGH)
            if np.all(np.isfinite(end.cost)):
                return LocalMinima(end.x, sign, end.cost)
        judged = likelihood if more is None else Likelihood.of(more, self.effort)
        ends = followed_minima(judged, global_minima(likelihood, 0))
        return ends.competing(judged.exact.rows)

    @property
    def effort(self) -> Effort:
        """The settings that a search needs."""
        return Effort(**{entry.name: getattr(self, entry.name) for entry in fields(Effort)})


def _at(likelihood: Likelihood, psi: Real, sign: Real) -> LocalMinima:
    """Starts ψ (k, M) with signs (k, channels) in the order of their χ²."""
    none = LocalMinima.none(psi.shape[1], sign.shape[1])
    return none.with_ends(psi, sign, likelihood.model_at(psi, sign).cost)


def _from_decays(likelihood: Likelihood) -> LocalMinima | None:
    """Where the modes of free decays lead, if that is a fit; of one repeat whose noise is known."""
    if likelihood.repeats > 1 or not likelihood.data.noise_known:
        return None
    minima = decay_minima(likelihood.data, likelihood.effort)
    if not len(minima.cost):
        return None
    minima = _at(likelihood, minima.psi, minima.sign)
    return minima if fits(likelihood, likelihood.descend(minima.psi[:1], minima.sign[:1])) else None


def _start(likelihood: Likelihood, states: States, *, typical: int | None = None) -> Real:
    """Where all is seen: least squares less its noise, (K, unknowns), boundary loads of whole records solved for.

    These begin with even weights, or with those of the `typical` rig of this number.
    """
    model, ends = likelihood.data.model, likelihood.exact.ends
    if ends is None:
        return compensated(model, states)
    rig: Real | None = None
    if typical is not None:
        rigs, _ = candidates(likelihood.data, typical + 1, random_generator(likelihood.effort.seed))
        rig = rigs[typical]
    starts = record_starts(model, states, ends, rig)
    channels = len(likelihood.view.channels)
    # Those of one repeat together: a call costs more than its few numbers.
    together = [starts[:, 0]] if likelihood.repeats == 1 else list(starts)
    with np.errstate(all="ignore"):
        costs = np.stack(
            [likelihood.model_at(some, np.ones((len(some), channels))).cost for some in together]
        )
    costs = costs.reshape(starts.shape[:2])
    costs = np.where(np.isfinite(costs), costs, np.inf)
    return starts[np.argmin(costs, axis=0), np.arange(likelihood.repeats)]
