"""What a rig consists of when it is drawn: bodies, and what joins them.

Coordinates that are motions of one rigid body (an angle with the displacement of the same body) are one body.  What
acts on a combination of bodies hangs on a lever: a body of its own, held by rigid links.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from dashpot.channel import Channel, Quantity
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model

Role = Literal["body", "base", "lever", "ground"]
LinkKind = Literal["element", "rigid", "sensor"]
GROUND = -1  # as an end of a link


@dataclass(frozen=True)
class Body:
    """What moves as one: its coordinates (or displacement input) and the masses it carries.

    `along` of a lever: body → factor.
    """

    role: Role
    points: tuple[str, ...]
    masses: tuple[int, ...] = ()
    along: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class Link:
    """What joins two bodies, by index, or a body and the GROUND: an element, a rigid link or a relative sensor.

    `item` is the index of the element or channel; `factor` that of a rigid link.
    """

    kind: LinkKind
    first: int
    second: int
    item: int = -1
    factor: float = 1.0


@dataclass(frozen=True)
class Push:
    """A force input at a body, or a moment where it `turns` it."""

    body: int
    source: str
    factor: float
    turns: bool


@dataclass(frozen=True)
class Connections:
    """Bodies, links, forces; `where` maps channel index → body or link it is seen at (relative sensors are links)."""

    bodies: tuple[Body, ...]
    links: tuple[Link, ...]
    pushes: tuple[Push, ...]
    free: bool  # whether free matrices were left out


def connections(model: Model, channels: Sequence[Channel] = ()) -> Connections:
    """Bodies and links of a rig; relative channels become links between the bodies they compare."""
    body_of = _rigid_bodies(model)
    count = max(body_of.values()) + 1
    masses: list[list[int]] = [[] for _ in range(count)]
    levers: list[Body] = []
    links: list[Link] = []
    for i, element in enumerate(model.elements):
        if element.free or element.block is not None:
            continue
        ends = _ends(element, body_of, model.angles)
        if element.kind is Kind.MASS and len(ends) == 1:
            masses[next(iter(ends))].append(i)
        elif element.kind is Kind.MASS:
            levers.append(Body("lever", (), (i,), tuple(ends.items())))
        else:
            links.append(_link(i, ends, count, levers))
    bodies = [*_bodies(model, body_of, masses), *levers]
    for k, lever in enumerate(levers):
        links += [Link("rigid", body, count + k, factor=factor) for body, factor in lever.along]
    links += _relative(channels, body_of, links)
    return Connections(
        tuple(bodies),
        tuple(links),
        tuple(_pushes(model, body_of)),
        any(e.free or e.block for e in model.elements),
    )


def _bodies(model: Model, body_of: Mapping[str, int], masses: Sequence[Sequence[int]]) -> list[Body]:
    """Rigid bodies with their points and masses; those of moved points alone are bases."""
    points: list[list[str]] = [[] for _ in masses]
    for point, index in body_of.items():
        points[index].append(point)
    moved = set(model.displacement_inputs)
    return [
        Body("base" if set(names) <= moved else "body", tuple(names), tuple(carried))
        for names, carried in zip(points, masses, strict=True)
    ]


def _ends(element: Element, body_of: Mapping[str, int], angles: Collection[str]) -> dict[int, float]:
    """Bodies that an element acts on, each with a factor: that of its displacement rather than of its angle."""
    ends: dict[int, float] = {}
    for point, factor in element.along.items():
        body = body_of[point]
        if factor != 0 and (body not in ends or point not in angles):
            ends[body] = factor
    return ends


def _link(i: int, ends: Mapping[int, float], count: int, levers: list[Body]) -> Link:
    """An element between two sides; a side of several bodies is a lever, which is added."""
    if len(ends) == 1:
        return Link("element", next(iter(ends)), GROUND, i)
    sides = []
    for sign in (1, -1):
        side = tuple((body, factor) for body, factor in ends.items() if factor * sign > 0)
        if len(side) > 1:
            known = [k for k, lever in enumerate(levers) if lever.along == side and not lever.masses]
            if not known:
                levers.append(Body("lever", (), (), side))
            sides.append(count + (known[0] if known else len(levers) - 1))
        else:
            sides.append(side[0][0] if side else GROUND)
    first, second = sides if sides[0] != GROUND else (sides[1], sides[0])
    return Link("element", first, second, i)


def _rigid_bodies(model: Model) -> dict[str, int]:
    """Anchor → body.  An angle moves as one with the displacement that all elements combine it with."""
    names = [*model.displacement_inputs, *model.coordinates]
    root = {name: name for name in names}
    for angle in model.coordinates:
        if angle not in model.angles:
            continue
        partners = [
            [point for point in element.along if point in model.coordinates and point not in model.angles]
            for element in model.elements
            if angle in element.along and not (element.free or element.block)
        ]
        mixed = [points for points in partners if points]
        common = [point for point in (mixed[0] if mixed else ()) if all(point in points for points in mixed)]
        if common:
            root[angle] = common[0]
    groups = list(dict.fromkeys(root.values()))
    return {name: groups.index(root[name]) for name in names}


def _pushes(model: Model, body_of: Mapping[str, int]) -> Iterable[Push]:
    for source in model.inputs:
        if source.kind == "force":
            for coordinate, factor in source.at.items():
                yield Push(body_of[coordinate], source.name, factor, coordinate in model.angles)


def _relative(channels: Sequence[Channel], body_of: Mapping[str, int], links: Sequence[Link]) -> list[Link]:
    """Channels that show the difference of two bodies which something joins, as links beside it."""
    joined = {frozenset((link.first, link.second)) for link in links}
    found = []
    for i, channel in enumerate(channels):
        if channel.quantity is Quantity.FORCE or sorted(channel.of.values()) != [-1.0, 1.0]:
            continue
        ends = [body_of[point] for point in channel.of]
        if len(set(ends)) == 2 and frozenset(ends) in joined:
            found.append(Link("sensor", ends[0], ends[1], i))
    return found
