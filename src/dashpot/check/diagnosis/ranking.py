"""Causes of a misfit in order: by what they leave, and among those that leave alike the particular ones first."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot import units
from dashpot.check.diagnosis.contradictions import Contradiction
from dashpot.check.diagnosis.trials import CLOSE, Likeness, Outcome
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model

# Stated values of elements whose numbers are in another unit than was written.


USUAL = {
    Kind.MASS: ("mass", ("g", "lb", "t")),
    Kind.SPRING: ("stiffness", ("N/mm", "lbf/in")),
    Kind.DAMPER: ("damping", ("N·s/mm", "lbf·s/in")),
}


def unit_of_number(element: Element, stated: float | None, value: float | None) -> str | None:
    """The unit in which the number `stated`, taken for the SI one, would be `value`; None where none is usual."""
    quantity, usual = USUAL.get(element.kind, ("", ()))
    if stated is None or value is None or stated == 0:
        return None
    for unit in usual:
        if abs(value / (stated * units.scale(unit, quantity, False)) - 1) < CLOSE:
            return unit
    return None


# What explains as much and is more particular is named first.
ORDER = (
    "sign", "unit", "swap", "conjugate", "quantity", "frequency", "damping", "dwell", "mode", "delay", "gain", "value",
    "element", "two", "crosstalk", "nonlinear", "changed", "channel",
)  # fmt: skip
HELPS = 0.5  # χ² per degree of freedom must fall below this part of what it was
NEARLY = 0.3  # or below this part of what noise does not explain
FINELY = 1 / 6  # of a small misfit above 1 is the share of the handicaps, and of what counts as alike
# Handicap of leaving out a dwell (or a mode), a channel, or an input.
LEFT_OUT_DWELL, LEFT_OUT, LEFT_OUT_INPUT = 1.7, 2.0, 4.0
# Ratio of what is left within which two causes explain alike, and where even the best leaves more than noise.
ALIKE, ALIKE_OF_A_ROUGH_RIG = 1.6, 1.7
GIVEN_UP = 0.25  # share of the lines that test nothing without a channel, above which it says little of them
MOSTLY = 0.1  # of χ² that a remedy which explains most of it leaves at the most


@dataclass(frozen=True)
class Cause:
    """What may be wrong, and χ² per degree of freedom with it mended.

    untested: share of the lines that test nothing any more, because what is left of them only gives the input.
    shows: what a channel's own numbers say against it, empty where nothing.
    contradiction: how a channel differs from what all others say of it, None where no simple form does.
    parts: of two channels that are wrong at once, what is wrong with each.
    """

    kind: str
    of: tuple[str, ...]
    remaining: float
    number: float | None = None
    likeness: Likeness | None = None
    element: Element | None = None
    where: str = ""
    untested: float = 0.0
    shows: str = ""
    contradiction: Contradiction | None = None
    parts: tuple[Cause, ...] = ()


def cause_of(outcome: Outcome) -> Cause:
    """What a trial supposed, as a cause."""
    left, trial = outcome.reduced if outcome.dof > 0 else np.inf, outcome.trial  # nothing left to test it by
    derivative = Likeness(1.0, int(trial.value), 0.0, False, 0.0) if trial.kind == "quantity" else None
    return Cause(trial.kind, trial.of, left, trial.value, derivative)


def points_of(element: Element, model: Model) -> tuple[str, ...]:
    """What a cause is about: an element of the rig by its name, a new one by the points that it joins."""
    if element.name in {existing.name for existing in model.elements}:
        return (element.name,)
    points = tuple(element.along)
    return points if len(points) > 1 else (*points, "ground")


def _helps(cause: Cause, start: float, small: bool) -> bool:
    return cause.remaining < HELPS * start or (small and cause.remaining - 1 < NEARLY * (start - 1))


def ranked(
    candidates: Sequence[Cause], start: float, inputs: Collection[str] = (), *, noise: float = np.inf,
    surely: Collection[Cause] = (), impossible: Collection[str] = (),
) -> list[Cause]:  # fmt: skip
    """Those that explain half of the misfit or more, and `surely`; what explains alike in the order of ORDER.

    Channels that by their own numbers measured nothing stand first where the rest fits without them.
    Without the channel of an input (`inputs`) it moves as it likes at every line, which explains nearly anything.
    Without one of two channels that a line has its motion is as it likes: that explains less than any remedy by which
    most of the misfit goes and all lines stay tested.
    Of values that explain alike, those that would be another unit's stand first.
    Of signs that explain alike, those of the channels `impossible` stand last: with them no such rig can be built.
    Where the misfit is small and yet beyond what `noise` leaves by chance (∞: not known), half of it is less than
    noise: there counts what is left above 1.
    """
    small = start > noise
    helpful = [cause for cause in candidates if cause in surely or _helps(cause, start, small)]
    if not helpful:
        return []
    mended = any(cause.remaining < MOSTLY * start and not cause.untested for cause in helpful)
    in_question = [cause for cause in helpful if not (mended and cause.untested > GIVEN_UP)]
    best = max(min(cause.remaining for cause in in_question), 1.0)
    alike = ALIKE if best < noise else ALIKE_OF_A_ROUGH_RIG
    share = min(1.0, FINELY * (start - 1)) if small else 1.0

    def place(cause: Cause) -> tuple[bool, bool, float, int, bool, bool, float]:
        # Leaving data out leaves less to explain: what keeps them and explains nearly as much says more.
        channel = LEFT_OUT_INPUT if set(cause.of) & set(inputs) else LEFT_OUT
        handicap = {"channel": channel, "dwell": LEFT_OUT_DWELL, "mode": LEFT_OUT_DWELL}.get(cause.kind, 1.0)
        left = cause.remaining * (1 + share * (handicap - 1))
        tier = np.floor(np.log(max(left, best) / best) / np.log(1 + share * (alike - 1)))
        backwards = cause.kind == "sign" and cause.of[0] in impossible
        # Whether it is a stated value that would be another one for no reason of units
        element = cause.element if cause.kind == "value" else None
        return (
            not cause.shows,
            cause not in in_question,
            float(tier),
            ORDER.index(cause.kind),
            backwards,
            element is not None and not unit_of_number(element, element.guess, cause.number),
            cause.remaining,
        )

    named: dict[tuple[str, tuple[str, ...]], Cause] = {}
    for cause in sorted(helpful, key=place):
        named.setdefault((cause.kind, cause.of), cause)
    return list(named.values())[:5]  # findings that are named
