"""What a method is: a small frozen value that declares what it needs and turns prepared data into a Solution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

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
    nonlinear rig that it rests on, their harmonics and branches: a NonlinearPart, of which methods know nothing.
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

    Second moments of the samples are for the method to ask for: only it knows of which channels.
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
