"""Rigs on bases that are known by velocity or acceleration, as rigs that move in time (THEORY §9).

Such a base is a coordinate of its own whose acceleration is prescribed; where it is at the start, and how fast, is part
of the state.  The other coordinates count from where the base alone would carry them, so what joins the rig to the
base sees none of the base's own motion, however far that wanders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model

HEAVY = 2.0**99  # kg: forces of the rig move what weighs that by less than rounding
ROUNDING = 1e-12  # of a factor


@dataclass(frozen=True)
class Bases:
    """Displacement inputs that are known by their `orders`-th derivative, 1 or 2.

    carried: how far a unit of each base carries the rig's coordinates with it.
    """

    names: tuple[str, ...] = ()
    orders: tuple[int, ...] = ()
    carried: tuple[Mapping[str, float], ...] = ()

    def matrix(self, coordinates: Sequence[str]) -> Real:
        """How far the bases carry the coordinates, (n, bases)."""
        factors = [[along.get(name, 0.0) for along in self.carried] for name in coordinates]
        return np.array(factors, dtype=float).reshape(len(coordinates), len(self.names))

    def beside(self, element: Element) -> Element:
        """The element in coordinates that count from where the bases carry them."""
        if not self.names:
            return element
        along = {point: factor for point, factor in element.along.items() if point not in self.names}
        for name, carried in zip(self.names, self.carried, strict=True):
            terms = [element.along.get(name, 0.0)]
            terms += [factor * carried.get(point, 0.0) for point, factor in element.along.items()]
            if abs(sum(terms)) > ROUNDING * sum(abs(term) for term in terms):
                along[coordinate_of(name)] = sum(terms)
        return replace(element, along=along)

    def stretch(self, element: Element) -> bool:
        """Whether an element is stretched where the bases move and the rig with them."""
        return any(coordinate_of(name) in self.beside(element).along for name in self.names)

    def hide(self, rig: Model, element: Element) -> bool:
        """Whether nobody knows how far an element is stretched: no other tells where the bases are."""
        holding = (e for e in rig.elements if e.law.power < 2 and not does_nothing(e))
        return self.stretch(element) and not any(self.stretch(e) for e in holding)


NO_BASES = Bases()


def coordinate_of(base: str) -> str:
    """Name of the coordinate that a base becomes."""
    return f"{base}, moving"


def bases_of(rig: Model, orders: Mapping[str, int]) -> Bases:
    """The bases of a rig with the derivatives that are known of them, `orders`.

    The rig is carried as its springs and dampers would have it, were all of them stiff.
    """
    holding = [
        i for i, element in enumerate(rig.elements) if element.law.power < 2 and not does_nothing(element)
    ]
    carried = []
    for name in orders:
        pulled = -rig.D[holding, rig.displacement_inputs.index(name)]
        along = np.linalg.lstsq(rig.B[holding], pulled, rcond=None)[0]
        along = np.where(np.abs(along) > ROUNDING, along, 0.0)
        whole = np.round(along)
        along = np.where(np.abs(along - whole) < ROUNDING, whole, along)
        carried.append({c: f for c, f in zip(rig.coordinates, along.tolist(), strict=True) if f})
    return Bases(tuple(orders), tuple(orders.values()), tuple(carried))


def moving_rig(rig: Model, bases: Bases) -> Model:
    """The rig with the bases as coordinates, behind its own; the force inputs of their names are accelerations, m/s².

    Its inputs are the other displacements, the forces, and the bases.
    """
    if not bases.names:
        return rig
    points = tuple(coordinate_of(name) for name in bases.names)
    elements = tuple(bases.beside(element) for element in rig.elements)
    weights = tuple(Element(f"mass of {p}", Kind.MASS, {p: 1.0}, value=HEAVY) for p in points)
    driven = (Input(n, "force", {p: HEAVY}) for n, p in zip(bases.names, points, strict=True))
    others = [source for source in rig.inputs if source.name not in bases.names]
    others.sort(key=lambda source: source.kind == "force")
    turning = frozenset(coordinate_of(n) if n in bases.names else n for n in rig.angles)
    return Model((*rig.coordinates, *points), (*others, *driven), (*elements, *weights), rig.name, turning)


def does_nothing(element: Element) -> bool:
    """Whether the parameter of an element is known to be 0."""
    return element.value == 0 and element.sd is None and element.same_as is None
