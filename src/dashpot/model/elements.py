"""Elements: the parts of a rig, and the law that each obeys (THEORY (E))."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from dashpot.arrays import Complex, Real


class Kind(StrEnum):
    """Kinds of element.  The unit force of element i at frequency ω is φ(ω) δ_i, its force p_i φ(ω) δ_i."""

    SPRING = "spring"
    DAMPER = "damper"
    MASS = "mass"
    INERTER = "inerter"
    HYSTERETIC = "hysteretic"

    @property
    def unit(self) -> str:
        """SI unit of the parameter where all points are displacements."""
        return {"spring": "N/m", "damper": "N·s/m", "mass": "kg", "inerter": "kg", "hysteretic": "N/m"}[
            self.value
        ]

    @property
    def angular_unit(self) -> str:
        """SI unit of the parameter where all points are angles."""
        return {
            "spring": "N·m/rad", "damper": "N·m·s/rad", "mass": "kg·m²", "inerter": "kg·m²", "hysteretic": "N·m/rad",
        }[self.value]  # fmt: skip

    @property
    def derivative(self) -> int:
        """Which derivative of the elongation the unit force is (hysteretic: the displacement, turned by 90°)."""
        return {"spring": 0, "damper": 1, "mass": 2, "inerter": 2, "hysteretic": 0}[self.value]

    def factor(self, omega: Real) -> Complex:
        """φ(ω): 1, jω, −ω², −ω², j sign(ω); shape of `omega` (rad/s)."""
        match self:
            case Kind.SPRING:
                return np.ones_like(omega, dtype=np.complex128)
            case Kind.DAMPER:
                return (1j * omega).astype(np.complex128)
            case Kind.MASS | Kind.INERTER:
                return (-(omega**2)).astype(np.complex128)
            case Kind.HYSTERETIC:
                return (1j * np.sign(omega)).astype(np.complex128)


@dataclass(frozen=True)
class Element:
    """One element: its kind, the points along which it is stretched, and what is known of its parameter.

    `along` maps coordinates and displacement inputs to their factors in the elongation δ = b·x + d·u; what is fixed
    to the ground does not appear.  `value` without `sd` is known exactly, with `sd` (same unit) known with that
    standard deviation, None is unknown; `guess` is a start for the iterations, `lower` and `upper` bound the estimate
    where the method can.  `same_as` ties the parameter to another element's: p = times · p(same_as).  `free`: no part
    of the rig but of a free matrix, so that its parameter may have any sign.
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", Kind(self.kind))
        object.__setattr__(self, "along", MappingProxyType(dict(self.along)))

    def __reduce__(self) -> tuple[object, ...]:
        known = (self.value, self.sd, self.guess, self.lower, self.upper)
        return (
            Element,
            (self.name, self.kind, dict(self.along), *known, self.same_as, self.times, self.free),
        )

    def __hash__(self) -> int:
        return hash(
            (self.name, self.kind, frozenset(self.along.items()), self.value, self.same_as, self.times)
        )


def mass(name: str, at: str, **known: float | str | None) -> Element:
    """A mass at one coordinate, kg."""
    return Element(name, Kind.MASS, {at: 1.0}, **known)  # type: ignore[arg-type]


def between(name: str, kind: Kind, first: str, second: str, **known: float | str | None) -> Element:
    """A two-point element; either point may be "ground"."""
    along = {point: factor for point, factor in ((first, 1.0), (second, -1.0)) if point != "ground"}
    return Element(name, kind, along, **known)  # type: ignore[arg-type]
