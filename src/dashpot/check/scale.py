"""Whether anything fixes the size of the forces.

With displacement inputs alone, (E) reads Bᵀ (p ∘ a) = 0: p and 2p move alike.  One known parameter other than 0, one
applied force, or one measured force sets the scale; of parts that share no coordinate and no tie, each needs its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.channel import Channel, Quantity
from dashpot.errors import IdentifiabilityError, Problem
from dashpot.estimate.method import Method
from dashpot.io.words import listed, with_values
from dashpot.model.network import Model
from dashpot.model.observation import is_direct


def free_scales(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, ...], ...]:
    """Groups of unknowns whose common scale nothing fixes, whatever the data; () where all is fixed.

    A known value of 0 fixes nothing, a value with an sd does.  A force that is applied or measured counts only where
    a channel of known gain measures it.  Necessary, not sufficient, for identifiability.
    """
    parts = _parts(model)
    fixed = set()
    for i, element in enumerate(model.elements):
        root = model.elements[model.ties[i].root]
        if root.value is not None and root.value != 0:
            fixed.add(parts[("element", element.name)])
    for point in _measured_forces(model, channels):
        fixed |= {parts[end] for end in _ends(model, point)}
    groups: dict[int, list[str]] = {}
    inner = {f"{element.name}.{constant.name}" for element, constant in model.constants}
    for unknown in model.unknowns:
        if unknown.name in inner:
            continue  # constants of a law do not scale its force
        part = parts[("element", unknown.name)]
        if part not in fixed:
            groups.setdefault(part, []).append(unknown.name)
    return tuple(tuple(group) for group in groups.values())


def require_scale(model: Model, channels: Sequence[Channel], where: str | None = None) -> None:
    """Raises IdentifiabilityError where some forces scale together, one problem for each part of the rig."""
    groups = free_scales(model, channels)
    if not groups:
        return
    whole = len(groups) == 1 and len(groups[0]) == len(model.unknowns)
    problems = []
    for group in groups:
        if len(group) == 1:
            what = (
                f"any value of {group[0]} gives the same motion: there is no known force to compare it with"
            )
        elif whole:
            what = (
                "nothing is known and only displacements go in, so all forces scale together: "
                f"{listed(group)} times any factor give the same motion"
            )
        else:
            what = f"the forces of {listed(group)} scale together: times any factor they give the same motion"
        cure = f"{with_values(group)}, or measure a force (the one that moves an input, say)"
        problems.append(Problem(what, where, cure))
    raise IdentifiabilityError(problems)


Node = tuple[str, str]


def require_scale_seen(
    method: type[Method], model: Model, channels: Sequence[Channel], where: str | None = None
) -> None:
    """Raises IdentifiabilityError where the channels that the method uses leave the scale of the forces free."""
    if method.traits.by_output:
        return
    if free_scales(model, [channel for channel in channels if is_direct(model, channel)]):
        raise IdentifiabilityError(
            f"the method {method.name} does not use the channel that fixes the scale of the forces",
            where,
            "use the method ml",
        )


def _parts(model: Model) -> dict[Node, int]:
    """Which connected part each coordinate and element belongs to; inputs do not connect, for they are prescribed."""
    leader: dict[Node, Node] = {}

    def find(node: Node) -> Node:
        leader.setdefault(node, node)
        while leader[node] != node:
            leader[node] = leader[leader[node]]
            node = leader[node]
        return node

    coordinates = set(model.coordinates)
    for element in model.elements:
        node = ("element", element.name)
        find(node)
        for point in element.along:
            if point in coordinates:
                leader[find(("point", point))] = find(node)
        if element.same_as is not None:
            leader[find(("element", element.same_as))] = find(node)
    for given in model.inputs:
        for first, second in zip(list(given.at), list(given.at)[1:], strict=False):
            leader[find(("point", first))] = find(("point", second))
    number: dict[Node, int] = {}
    return {node: number.setdefault(find(node), len(number)) for node in list(leader)}


def _measured_forces(model: Model, channels: Sequence[Channel]) -> set[str]:
    """Names of the force inputs, displacement inputs and elements whose force a channel of known gain measures."""
    return {
        name
        for channel in channels
        if channel.quantity is Quantity.FORCE and channel.gain is not None
        for name in channel.of
    }


def _ends(model: Model, name: str) -> list[Node]:
    """What a force of that name acts on: an element, the coordinates of an applied force, the elements at an input."""
    for given in model.inputs:
        if given.name == name and given.kind == "force":
            return [("point", coordinate) for coordinate in given.at]
    touching = [element.name for element in model.elements if element.name == name or name in element.along]
    return [("element", element) for element in touching]
