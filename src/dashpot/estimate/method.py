"""What a method is: a small frozen value that declares what it needs and turns prepared data into a Solution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from scipy.special import stdtr, stdtrit

from dashpot.arrays import Bools, Ints, Real
from dashpot.errors import UsageError
from dashpot.estimate.preparation import Prepared
from dashpot.notices import Notice


@dataclass(frozen=True)
class Traits:
    """What a method needs and what its answers are: the one declaration that everyone reads.

    by_output           works in the channels and uses every one of them; the others work on the equation of motion and
                        need channels that show every coordinate and input
    moments             second moments of the samples: False not used, "auto" used where the data have them, True needed
    needs_noise         the noise of the amplitudes must be known
    maximum_likelihood  its answer is the most likely one
    weighted            its covariance is the inverse of the information
    bounds              it holds the bounds of the unknowns
    transients          it knows the loads at the ends of whole records; the others work on settled lines alone
    nonlinear           it knows nonlinear elements
    definite            it keeps M, C and K definite, which differs from the others only where they are free matrices
    """

    by_output: bool = False
    moments: bool | Literal["auto"] = False
    needs_noise: bool = False
    maximum_likelihood: bool = False
    weighted: bool = False
    bounds: bool = False
    transients: bool = False
    nonlinear: bool = False
    definite: bool = False


@dataclass(frozen=True)
class HeldBounds:
    """Bounds of the unknowns that a method held: lower and upper (unknowns,), ±inf where there is none.

    free (K, unknowns): where the estimate would lie without them, by one Gauss-Newton step; θ itself where none holds.
    """

    lower: Real
    upper: Real
    free: Real


@dataclass(frozen=True)
class Solution:
    """What a method found, for K repeats.

    theta (K, unknowns), followed by gains and delays where the method estimates them; covariance of the noise given
    in the spectrum, (K, unknowns, unknowns); converged and iterations (K,), from all starts together; history: θ at the
    start and after each iteration of the descent that ended there, of the first repeat, (points, unknowns).  `signs`:
    channels whose sign was found, ±1 for each repeat.  `bounds`: those that were held, if any.  `responses` of a
    nonlinear rig that it rests on, their harmonics and branches: a NonlinearPart, opaque to methods.
    """

    theta: Real
    covariance: Real
    converged: Bools
    iterations: Ints
    history: Real
    signs: Mapping[str, Real] = field(default_factory=dict)
    warnings: tuple[Notice, ...] = ()
    bounds: HeldBounds | None = None
    responses: object = None


@dataclass(frozen=True)
class OtherMinima(Notice):
    """That other sets of values fit nearly as well, with what the intervals need of them.

    values  a set of all unknowns each, in the unit of each
    odds    of each set against the values of the estimate, by χ² and guesses; 0 of a rig that cannot be built
    """

    values: tuple[tuple[float, ...], ...] = ()
    odds: tuple[float, ...] = ()

    @np.errstate(all="ignore")  # of what is exact, or not known at all
    def ends(self, value: Real, sd: Real, dof: Real, level: float) -> tuple[Real, Real]:
        """Ends at `level` of the intervals of the mixture of minima, (m,) each; value, sd, dof (m,) of the estimate.

        An unknown is as well known, relative to its size, in one minimum as in the other.
        """
        at, width, share = self._minima(value, sd)
        reach = width * stdtrit(dof, 0.5 + level / 2)
        ends = []
        for tail in ((1 - level) / 2, (1 + level) / 2):
            low, high = np.min(at - 2 * reach, axis=0), np.max(at + 2 * reach, axis=0)
            for _ in range(60):  # halvings, to rounding
                middle = (low + high) / 2
                below = share @ stdtr(dof, (middle - at) / width) < tail
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            ends.append(high)
        return ends[0], ends[1]

    def _minima(self, value: Real, sd: Real) -> tuple[Real, Real, Real]:
        """Values and their standard deviations in all minima, (minima, m) each, and the shares of these, (minima,)."""
        at, share = np.array([value, *self.values]), np.array([1.0, *self.odds])
        return at, sd * np.where(at * value > 0, np.abs(at / value), 1.0), share / np.sum(share)

    @np.errstate(all="ignore")
    def parts(self, value: Real, sd: Real, dof: Real, level: float) -> list[list[list[float]]]:
        """The separate intervals of each unknown that together hold it with the chance `level`, least odds left out."""
        at, width, share = self._minima(value, sd)
        order = np.argsort(-share, kind="stable")
        total = np.cumsum(share[order])
        count = int(np.searchsorted(total, level)) + 1
        at, width = at[order[:count]], width[order[:count]]
        reach = width * stdtrit(dof, 0.5 + level / total[count - 1] / 2)
        found = []
        for pairs in np.stack([at - reach, at + reach], axis=-1).transpose(1, 0, 2).tolist():
            merged: list[list[float]] = []
            for low, high in sorted(pairs):
                if merged and low <= merged[-1][1]:
                    merged[-1][1] = max(high, merged[-1][1])
                else:
                    merged.append([low, high])
            found.append(merged)
        return found


class Method(ABC):
    """An estimator.  Subclasses are frozen dataclasses: their fields are the settings.

    `name` is what files and the command line call it.  A new one is such a class and one line in `registry`.
    """

    name: ClassVar[str]
    traits: ClassVar[Traits] = Traits()

    @abstractmethod
    def solve(self, data: Prepared) -> Solution:
        """Estimate θ for all repeats.  Raises DataError if the data lack what the method needs."""


def require_suited(method: Method, data: Prepared) -> None:
    """Raises DataError or UsageError if the data lack what `method` declares to need.

    Second moments of the samples are for the method to ask for: only it knows for which channels.
    """
    if not method.traits.by_output:
        _ = data.seen_states
    if method.traits.needs_noise and not data.noise_known:
        raise UsageError(
            f"{method.name} needs the size of the noise, which these data do not state",
            cure="use tls, which estimates it, or state the noise of the channels (a column NAME_sd)",
        )


def closed_form(theta: Real, covariance: Real) -> Solution:
    """A solution without iterations.  theta (K, m), covariance (K, m, m)."""
    solved: Bools = np.all(np.isfinite(theta), axis=-1)
    return Solution(theta, covariance, solved, np.zeros(len(theta), dtype=np.int64), theta[:1])
