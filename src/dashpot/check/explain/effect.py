"""One way in which the rig or the data may differ from what the rig file says, as the engine weighs it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from dashpot.arrays import Bools, Complex
from dashpot.channel import Channel
from dashpot.check.explain.problem import FitProblem, FittedProblem, LineProblem, ModalProblem, TimeProblem
from dashpot.errors import DashpotError, Problem
from dashpot.estimate.assessment import Finding
from dashpot.model.elements import Element
from dashpot.model.observation import measures_input


@dataclass(frozen=True)
class Phrase:
    """The sentence for a cause, and the edit that mends it.

    text, change        what is wrong; the line to write in the rig file, or what to do with the data
    channels, elements  entries of the rig file as they would be; () where the data must be mended
    """

    text: str
    change: str
    channels: tuple[Channel, ...] = ()
    elements: tuple[Element, ...] = ()


Subject = tuple[str, tuple[str, ...]]  # the kind of an effect and what it is of


@dataclass(frozen=True)
class Effect:
    """A supposition, with a size where it has one.

    kind, of   as in a Finding
    act        the problem with the supposition at a size
    words      what a person reads, by the size that was found where that is in it
    values     sizes that are tried: alternatives, or where the search for a size begins
    width      the prior scale of a size that is sought, about `null`; None where `values` are alternatives.  The prior
               is Cauchy's: most mistakes are small, some are large
    of_ratio   whether sizes are ratios, sought and scaled by their logarithm
    unknown    the unknown of the problem that is the size, where `act` makes it one
    others     further unknowns that it brings, which are positive, each with its likely size: their priors are as wide
               as a factor of e
    between    what the size is, or over the first of the others, if it is what its kind says
    found      the fit, where the search for the effect has made it already
    more       further unknowns that it brings, about which as much is known beforehand as one number of the data tells
    share      of the probability of its kind
    """

    kind: str
    of: tuple[str, ...]
    act: Callable[[Any, float], FitProblem]
    words: Phrase | Callable[[float], Phrase]
    values: tuple[float, ...] = (1.0,)
    width: float | None = None
    null: float = 0.0
    of_ratio: bool = False
    unknown: str = ""
    others: tuple[tuple[str, float], ...] = ()
    between: tuple[float, float] = (-np.inf, np.inf)
    found: FittedProblem | None = None
    more: int = 0
    share: float = 1.0

    @property
    def subject(self) -> Subject:
        """What it supposes of what: forms of one cause have it alike."""
        return self.kind, self.of

    @property
    def may_be_negative(self) -> str:
        """The unknown that it brings and that may be: an element stands for what others have too much."""
        return self.unknown if self.kind == "element" else ""

    def coordinate(self, size: float) -> float:
        """Where a size lies on the scale on which it is sought."""
        return float(np.log(abs(size))) if self.of_ratio else size

    def size_at(self, coordinate: float, like: float) -> float:
        """The size at a coordinate, of the sign of another one."""
        return float(np.copysign(np.exp(coordinate), like)) if self.of_ratio else coordinate

    def phrase(self, size: float) -> Phrase:
        """What a person reads at a size."""
        return self.words if isinstance(self.words, Phrase) else self.words(size)

    def finding(
        self, size: float, remaining: float | None = None, *, odds: float | None = None,
        explains: float | None = None, group: int | None = None,
    ) -> Finding:  # fmt: skip
        """At a size, as an assessment has it; remaining: χ² over its degrees of freedom with it mended."""
        said = self.phrase(size)
        number = None if self.values == (1.0,) else size
        return Finding(
            self.kind, self.of, said.text, said.change, remaining, number, said.channels, said.elements,
            odds, explains, group,
        )  # fmt: skip

    def log_prior(self, size: float) -> float:
        """Logarithm of the prior density of a size that is sought, over its coordinate."""
        assert self.width is not None
        away = (self.coordinate(size) - self.coordinate(self.null)) / self.width
        return float(np.log(2 / (np.pi * self.width)) - 2 * np.log1p(away**2))


@dataclass(frozen=True)
class Baseline:
    """What effects are built from: the problem as stated, its fit, and the fits without each channel.

    silent     channels that measured nothing by their own numbers, with what they show
    of_samples whether amplitudes were made of samples, whose phases are what they are
    fixed      whether the values of the rig stand
    """

    problem: FitProblem
    as_is: FittedProblem
    without: tuple[FittedProblem, ...]
    silent: Mapping[str, str] = field(default_factory=dict)
    of_samples: bool = False
    fixed: bool = False

    @property
    def lines(self) -> LineProblem:
        """The problem, of amplitudes at lines."""
        assert isinstance(self.problem, LineProblem)
        return self.problem

    @property
    def courses(self) -> LineProblem | TimeProblem:
        """The problem, of whose channels a course over frequency is known."""
        assert not isinstance(self.problem, ModalProblem)
        return self.problem

    @cached_property
    def inputs(self) -> Bools:
        """Which channels measure inputs, (channels,)."""
        return np.array([measures_input(self.problem.model, channel) for channel in self.problem.channels])

    def share(self, c: int) -> float:
        """Share of the probability of a channel mistake; inputs are often alone and are checked more carefully."""
        return 0.5 if self.inputs[c] else 1.0

    def compared(self, c: int) -> tuple[Bools, Complex, Complex]:
        """The lines that count, with channel c there and what all other channels predict for it."""
        y, expected = self.problem.y[:, c], self.without[c].expected[:, c]
        with np.errstate(invalid="ignore"):
            used = self.problem.kept[:, c] & np.isfinite(expected) & (np.abs(expected) > 0) & (np.abs(y) > 0)
        return used, y[used], expected[used]


def by_size(method: str, *of: Any) -> Callable[[Any, float], FitProblem]:
    """For `act`: the problem that its method gives, with the size for last argument."""
    return lambda problem, size: getattr(problem, method)(*of, size)


def plainly(method: str, *of: Any) -> Callable[[Any, float], FitProblem]:
    """For `act` of an effect without a size: the problem that its method gives."""
    return lambda problem, _: getattr(problem, method)(*of)


def as_is(problem: FitProblem, _: float) -> FitProblem:
    """For `act` of an effect that was `found`."""
    return problem


Effects = Callable[[Baseline], Iterator[Effect]]

Failure = TypeVar("Failure", bound=DashpotError)


def with_likely_causes(error: Failure, findings: Sequence[Finding]) -> Failure:
    """The error with its likely causes; "no listed cause" is not one of them."""
    findings = [each for each in findings if each.kind != "unexplained"]
    if not findings:
        return error
    more = [Problem(f"a likely cause: {each.text}", cure=each.change) for each in findings]
    explained = type(error)([*error.problems, *more])
    explained.causes = tuple(findings)
    return explained
