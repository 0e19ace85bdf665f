"""Maximum likelihood in the frequency domain, for any linear set of channels (THEORY §4, ml)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.likelihood.descent import ROUGH, Effort, Likelihood
from dashpot.estimate.likelihood.free_decay import decay_minima
from dashpot.estimate.likelihood.global_search import (
    fits,
    followed_minima,
    from_minima,
    global_minima,
    minima_around,
    searched_again,
    seen_directly,
)
from dashpot.estimate.likelihood.local_minima import LocalMinima
from dashpot.estimate.likelihood.record_start import record_starts
from dashpot.estimate.likelihood.reduced_search import is_reducible, reduced_search
from dashpot.estimate.likelihood.starting_values import candidates
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.method import HeldBounds, Method, Solution, Traits
from dashpot.estimate.nonlinear.search import search_harmonics
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, without_bounds


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
    is seen as well. `rivals` are further starts, with the signs of theirs, whose ends are told where they fit
    alike. `seed` is that of the random rigs. A descent ends
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

    def solve(self, data: Prepared) -> Solution:
        """θ, gains and delays at the maximum of the likelihood.

        Raises ConvergenceError where no start leads anywhere, DataError or UsageError where a nonlinear rig's dwells
        lack the harmonics or the motions that its search needs.
        """
        likelihood = Likelihood.of(data, self.effort)
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
        elif is_reducible(likelihood):
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
        return Solution(
            minimum.x, around.inverse, minimum.converged, minimum.iterations, minimum.history,
            signs={view.channels[int(c)].name: sign[:, c] for c in np.flatnonzero(view.flips)},
            warnings=warnings, bounds=bounds, responses=likelihood.exact.nonlinear,
        )  # fmt: skip

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
        of this number, of which 0 is the middle of all.
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
        rigs, _ = candidates(likelihood.data, typical + 1, np.random.default_rng(likelihood.effort.seed))
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
    best: Real = starts[np.argmin(costs, axis=0), np.arange(likelihood.repeats)]
    return best
