"""Nonlinear elements that a rig might have: laws between points that move, and what is said for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

from scipy.special import fdtrc

from dashpot.arrays import Real
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law

# Kind, law and the share of the motion that its constant is, if it has one.
LAWS: tuple[tuple[Kind, str, str, float], ...] = (
    (Kind.SPRING, "cubic", "", 0.0),
    (Kind.SPRING, "square", "", 0.0),
    (Kind.SPRING, "quadratic", "", 0.0),
    (Kind.SPRING, "quintic", "", 0.0),
    (Kind.SPRING, "gap", "gap", 0.5),
    (Kind.SPRING, "one-sided", "gap", 0.3),
    (Kind.SPRING, "jenkins", "slip", 0.3),
    (Kind.DAMPER, "quadratic", "", 0.0),
    (Kind.DAMPER, "cubic", "", 0.0),
    (Kind.DAMPER, "coulomb", "v0", 0.1),
)
FURTHER = (
    (Kind.SPRING, "d**4", "", 0.0),
    (Kind.DAMPER, "d**2*v", "", 0.0),
)  # tried where elements are compared
ONE_SIDED = "one-sided"  # a law that may act either way
WORDS = {"d**4": "quartic", "d**2*v": "growing"}  # in names of elements
FEW = 4  # coordinates up to which any two points are tried, and not only those that an element joins
SCALES = (1.0, 0.4, 0.2, 1.6)  # times the usual clearance: others that are tried


@dataclass(frozen=True)
class ScoredElement:
    """A candidate: how far χ² falls with it, from `chi2` with `dof` degrees of freedom, and the value it would have.

    psi (M,): the rig's own unknowns beside it, where they are known better than by the fit without it.
    """

    element: Element
    fall: float
    chi2: float
    dof: int
    value: float
    psi: Real | None = None

    @property
    def p_value(self) -> float:
        """Probability of such a fall by noise alone, what is left being noise."""
        left = max(self.chi2 - self.fall, 1e-300) / max(self.dof - 1, 1)
        return float(fdtrc(1.0, float(max(self.dof - 1, 1)), self.fall / max(left, 1.0)))


# The largest elongation (m) and rate (m/s) between two points.
Motions = Mapping[tuple[str, str], tuple[float, float]]


def moving_pairs(model: Model) -> list[tuple[str, str]]:
    """Any two points that move against each other; in large rigs only those that an element joins."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    joined = {frozenset(element.along) for element in model.elements}
    return [
        (first, second)
        for first, second in combinations(points, 2)
        if first in model.coordinates
        and (model.n <= FEW or frozenset({first, second} - {"ground"}) in joined)
    ]  # fmt: skip


@cache
def _law(kind: Kind, name: str, constant: str) -> ForceLaw:
    """A law, read once: that takes longer than all that is done with it."""
    constants = [Constant(constant, 1.0)] if constant else []
    return force_law(name, constants, damper=kind is Kind.DAMPER)


def candidate_elements(model: Model, motions: Motions, further: bool = False) -> list[Element]:
    """Every law of LAWS, and of FURTHER, between the points that move, their constants in proportion to the motion.

    Where the rig has such an element already there is none.
    """
    there = {
        (element.force_law.expression.text, frozenset(element.along))
        for element in model.elements
        if element.force_law is not None
    }
    candidates = []
    for (first, second), (size, speed) in motions.items():
        for kind, name, constant, share in (*LAWS, *(FURTHER if further else ())):
            value = share * (speed if constant == "v0" else size)
            law = _law(kind, name, constant).with_constants([Constant(constant, value)])
            for points in ((first, second), (second, first))[: 2 if name == ONE_SIDED else 1]:
                plain = between("_".join([WORDS.get(name, name), kind.value, *points]), kind, *points)
                if (law.expression.text, frozenset(plain.along)) not in there:
                    candidates.append(replace(plain, force_law=law))
    return candidates


def with_open_constants(element: Element) -> Element:
    """The element with its inner constants unknown, what they were as guesses."""
    assert element.force_law is not None
    constants = [
        replace(c, value=None, guess=float(f"{c.value:.3g}"))
        for c in element.force_law.constants
        if c.value is not None
    ]
    return replace(element, force_law=element.force_law.with_constants(constants))


def at_each_scale(elements: Sequence[Element]) -> list[Element]:
    """The elements, springs with a clearance at several values of it."""
    scaled = []
    for element in elements:
        law = element.force_law
        assert law is not None
        for scale in SCALES if has_clearance(element) else (1.0,):
            constants = [replace(c, value=scale * c.value) for c in law.constants if c.value is not None]
            scaled.append(replace(element, force_law=law.with_constants(constants)))
    return scaled


def feeds_motion(element: Element, value: float) -> bool:
    """Whether it would drive the rig: friction or damping below zero, or a spring that slips backwards.

    There is none; what it explains, another law does: friction below zero stands for damping that grows with speed,
    damping below zero that grows for friction.
    """
    law = element.force_law
    return law is not None and value < 0 and (element.kind is Kind.DAMPER or bool(law.operator))


def has_clearance(element: Element) -> bool:
    """Whether a spring's law has a length in it."""
    return element.kind is Kind.SPRING and element.force_law is not None and bool(element.force_law.constants)
