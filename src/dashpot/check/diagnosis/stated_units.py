"""Stated values of elements whose numbers are in another unit than was written."""

from __future__ import annotations

from dashpot import units
from dashpot.check.diagnosis.likeness import CLOSE
from dashpot.model.elements import Element, Kind

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
