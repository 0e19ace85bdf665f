"""Elements: the parts of a rig, and the law that each obeys (THEORY (E))."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Literal, TypeVar

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.io.words import shown
from dashpot.model.nonlinear.force_law import ForceLaw, unit_of
from dashpot.units import si_unit

# Laws of elements: how the unit force follows from the elongation (THEORY §1).
#
# A law is a frozen value and the only place that knows its physics: the unit force, the unit of the
# parameter, the matrix that it enters, its usual size and sign.


Scalar = TypeVar("Scalar", float, Real)

_POWERS_OF_J = (1.0, 1j, -1.0, -1j)


@dataclass(frozen=True)
class Law:
    """A linear law: the unit force is a = φ(ω) δ with φ(ω) = (jω)^power, turned by j sign(ω) if `hysteretic`.

    `power` is the derivative of the elongation δ that the unit force follows; `matrix` the letter of the matrix that
    the element enters; `quantity` what `dashpot.units` calls its parameter.  `dissipative` laws take energy out of the
    motion, and their parameters go with the damping ratio.  Below zero the parameter of no linear law has a meaning.
    """

    power: int
    matrix: Literal["M", "C", "K", "H"]
    quantity: str
    dissipative: bool = False
    hysteretic: bool = False

    def factor(self, omega: Real) -> Complex:
        """φ(ω), of the shape of `omega`, rad/s."""
        phi: Complex = _POWERS_OF_J[self.power % 4] * omega.astype(np.complex128) ** self.power
        return phi * (1j * np.sign(omega)) if self.hysteretic else phi

    def pole_factor(self, poles: Complex) -> Complex:
        """φ at complex rates λ, 1/s, of their shape: λ^power.  A hysteretic law has a meaning at Im λ > 0 alone."""
        phi: Complex = poles**self.power
        return 1j * phi if self.hysteretic else phi

    def unit(self, angular: bool = False) -> str:
        """SI unit of the parameter; `angular` where all points that the element joins are angles."""
        return si_unit(self.quantity, angular)

    def typical_size(self, mass: Scalar, rate: Scalar, damping_ratio: Scalar) -> Scalar:
        """Size of a parameter that goes with a mass (kg), a natural frequency (rad/s) and a damping ratio.

        m ω^(2 − power), times 2ζ for what dissipates: the terms of m ẍ + 2ζ m ω ẋ + m ω² x.
        """
        size = mass * rate ** (2 - self.power)
        return 2 * damping_ratio * size if self.dissipative else size


class Kind(StrEnum):
    """Kinds of element.  The unit force of element i at frequency ω is φ(ω) δ_i, its force p_i φ(ω) δ_i."""

    SPRING = "spring"
    DAMPER = "damper"
    MASS = "mass"
    INERTER = "inerter"
    HYSTERETIC = "hysteretic"

    @property
    def law(self) -> Law:
        """The law of its kind: how the unit force follows from the elongation, with unit, matrix and sign."""
        return _DECLARED[self][1]

    @property
    def section(self) -> str:
        """Name of the section of a rig file that holds elements of this kind."""
        return _DECLARED[self][0]


_DECLARED: Mapping[Kind, tuple[str, Law]] = {
    Kind.SPRING: ("springs", Law(0, "K", "stiffness")),
    Kind.DAMPER: ("dampers", Law(1, "C", "damping", dissipative=True)),
    Kind.MASS: ("masses", Law(2, "M", "mass")),
    Kind.INERTER: ("inerters", Law(2, "M", "mass")),
    Kind.HYSTERETIC: ("hysteretic", Law(0, "H", "stiffness", dissipative=True, hysteretic=True)),
}

# The matrices of a rig, each with the law of all its elements.
MATRICES: Mapping[str, Law] = MappingProxyType(
    {letter: kind.law for letter in "MCKH" for kind in Kind if kind.law.matrix == letter}
)


@dataclass(frozen=True)
class Element:
    """One element: its kind, the points that it connects, and what is known of its parameter.

    `along` maps coordinates and displacement inputs to their factors in the elongation δ = b·x + d·u; ground points
    are omitted.  `value` without `sd` is known exactly; with `sd` (same unit) it is known with that standard deviation;
    None is unknown.  `guess` is a start for the iterations; `lower` and `upper` bound the estimate if the method can.
    `same_as` ties the parameter to that of another element: p = times · p(same_as).  `free`: an entry of a free matrix
    rather than a part of the rig, so that its parameter may have any sign.  `force_law`: a nonlinear law instead of
    that of its kind; its parameter may have any sign.  `block`: name of the matrix that it is an entry of; the element
    of that name connects no points and carries the factor, which has no unit.  `only`: the one experiment of the rig
    in which it is present, where it replaces the element `stands_for` or is added.
    """

    name: str
    kind: Kind
    along: Mapping[str, float]
    value: float | None = None
    sd: float | None = None
    guess: float | None = None
    lower: float | None = None
    upper: float | None = None
    same_as: str | None = None
    times: float = 1.0
    free: bool = False
    force_law: ForceLaw | None = None
    block: str | None = None
    only: str | None = None
    stands_for: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", Kind(self.kind))
        object.__setattr__(self, "along", MappingProxyType(dict(self.along)))

    def __repr__(self) -> str:
        if self.same_as is not None:
            known = self.same_as if self.times == 1.0 else f"{self.times:g} × {self.same_as}"
        elif self.value is not None:
            known = f"{self.value:g}" if self.sd is None else f"{self.value:g} ± {self.sd:g}"
        else:
            known = "unknown" if self.guess is None else f"unknown, guess {self.guess:g}"
        law = "" if self.force_law is None else f", {self.force_law.text}"
        return f"<Element {shown(self.name)}: {self.kind}{law}, {self._elongation()}, {known}>"

    def _elongation(self) -> str:
        """The elongation as text: "x1 - x2", "x1 + 0.4 pitch - u"."""
        terms = []
        for point, factor in self.along.items():
            size = "" if abs(factor) == 1 else f"{abs(factor):g} "
            sign = "-" if factor < 0 else "+"
            terms.append(f"{sign} {size}{shown(point)}")
        text = " ".join(terms)
        return text.removeprefix("+ ") if not text.startswith("- ") else f"-{text[2:]}"

    @property
    def is_entry(self) -> bool:
        """Whether it is one entry of a block, whose name users do not see."""
        return self.block is not None and self.block != self.name

    @property
    def law(self) -> Law:
        """How its unit force follows from its elongation."""
        return self.kind.law

    def unit(self, angles: Collection[str]) -> str:
        """SI unit of the parameter: that of a torsional element where it joins nothing but `angles`."""
        if self.block is not None:
            return "1"
        angular = bool(self.along) and all(point in angles for point in self.along)
        if self.force_law is not None:
            return unit_of(self.force_law.exponents[0], force=True, angle=angular)
        return self.law.unit(angular)

    def __reduce__(self) -> tuple[object, ...]:
        known = (self.value, self.sd, self.guess, self.lower, self.upper)
        return (
            Element,
            (
                self.name,
                self.kind,
                dict(self.along),
                *known,
                self.same_as,
                self.times,
                self.free,
                self.force_law,
                self.block,
                self.only,
                self.stands_for,
            ),
        )

    def __hash__(self) -> int:
        return hash(
            (self.name, self.kind, frozenset(self.along.items()), self.value, self.same_as, self.times)
        )


def mass(name: str, at: str, **known: float | str | None) -> Element:
    """A mass at one coordinate, kg.  A Model raises ModelError if it has no such coordinate."""
    return Element(name, Kind.MASS, {at: 1.0}, **known)  # type: ignore[arg-type]


def between(name: str, kind: Kind, first: str, second: str, **known: float | str | None) -> Element:
    """A two-point element; either point may be "ground", `known` are fields of Element, SI units.

    A Model raises ModelError if it has no such point.
    """
    along = {point: factor for point, factor in ((first, 1.0), (second, -1.0)) if point != "ground"}
    return Element(name, kind, along, **known)  # type: ignore[arg-type]
