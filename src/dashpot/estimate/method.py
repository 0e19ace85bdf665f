"""What a method is: a small frozen value that turns prepared data into a Solution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.network import Model
from dashpot.notices import Notice


@dataclass(frozen=True)
class Prepared:
    """Data as every method gets them: one leading axis of K repeats on the amplitudes.

    `covariance` is the channels' V, (K or 1, lines, channels, channels); `states` combines the channels, None where
    some coordinate is not seen.
    """

    model: Model
    spectrum: Spectrum
    covariance: Complex
    states: States | None

    def only(self, repeat: int) -> Prepared:
        """One of the repeats."""
        V = self.covariance if len(self.covariance) == 1 else self.covariance[repeat : repeat + 1]
        spectrum = replace(
            self.spectrum, amplitudes=self.spectrum.amplitudes[repeat : repeat + 1], moments=None
        )
        states = None if self.states is None else self.states.rows(np.array([repeat]))
        return Prepared(self.model, spectrum, V, states)


@dataclass(frozen=True)
class Limits:
    """Bounds of the unknowns: lower and upper (unknowns,), ±inf where there is none.

    free (K, unknowns): where the estimate would lie without them, by one Gauss-Newton step; θ itself where none holds.
    """

    lower: Real
    upper: Real
    free: Real


@dataclass(frozen=True)
class Solution:
    """What a method found, for K repeats.

    theta (K, unknowns), followed by gains and delays where the method estimates them; covariance of the noise given
    in the spectrum, (K, unknowns, unknowns); converged and iterations (K,); history: θ after each iteration of the
    first repeat, (iterations + 1, unknowns).  `signs`: channels whose sign was found, ±1 for each repeat.
    `limits`: bounds that were held, if any.
    """

    theta: Real
    covariance: Real
    converged: Bools
    iterations: Ints
    history: Real
    signs: Mapping[str, Real] = field(default_factory=dict)
    warnings: tuple[Notice, ...] = ()
    limits: Limits | None = None


class Method(ABC):
    """An estimator.  Subclasses are frozen dataclasses; `name` is what files and the command line call it.

    `nonlinear`: it knows nonlinear elements.  `weighted`: its covariance is the inverse of the information.
    `efficient`: it maximises the likelihood of the amplitudes, as does every one `by_output`, which
    works in the channels, not in the equation of motion.
    """

    name: ClassVar[str]
    weighted: ClassVar[bool] = False
    efficient: ClassVar[bool] = False
    by_output: ClassVar[bool] = False
    nonlinear: ClassVar[bool] = False

    @abstractmethod
    def solve(self, data: Prepared) -> Solution:
        """Estimate θ for all repeats.  Raises DataError where the data lack what the method needs."""


def closed_form(theta: Real, covariance: Real) -> Solution:
    """A solution without iterations."""
    solved: Bools = np.all(np.isfinite(theta), axis=-1)
    return Solution(theta, covariance, solved, np.zeros(len(theta), dtype=np.int64), theta[:1])
