"""Rigs of elements between points in a line of text."""

from dataclasses import replace
from typing import Any

from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model

KINDS = {"k": Kind.SPRING, "c": Kind.DAMPER, "b": Kind.INERTER, "h": Kind.HYSTERETIC}


def network(coordinates: str, inputs: str, elements: str, *more: Element, name: str = "") -> Model:
    """network("x1 x2", "u f@x1", "m1@x1 m2@x2=2.7 k1:x1-x2 c1:x2-u"): forces, masses and joints, with known values.

    The first letter of a joint's name tells its kind; `more` elements stand behind those of the text.
    """
    given = [one.partition("@") for one in inputs.split()]
    found = []
    for word in elements.split():
        what, _, value = word.partition("=")
        known = float(value) if value else None
        if "@" in what:
            found.append(mass(*what.split("@"), value=known))
        else:
            joint, ends = what.split(":")
            found.append(between(joint, KINDS[joint[0]], *ends.split("-"), value=known))
    forces = [Input(one, "force", {at: 1.0}) if at else Input(one) for one, _, at in given]
    return Model(tuple(coordinates.split()), tuple(forces), (*found, *more), name)


def changed(model: Model, name: str, **what: Any) -> Model:
    """The rig with something else stated of one element: changed(model, "k1", value=3.0)."""
    return replace(model, elements=tuple(replace(e, **what) if e.name == name else e for e in model.elements))
