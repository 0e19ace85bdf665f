"""What a rig consists of when it is drawn: bodies, what joins them, and the order in which they are drawn.

Coordinates that are motions of one rigid body (an angle with the displacement of the same body) are one body.  What
acts on a combination of bodies hangs on a lever: a body of its own, held by rigid links.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from dashpot.channel import Channel, Quantity
from dashpot.model.elements import Kind
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
    """Bodies, links (relative sensors among them) and forces."""

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
        # Bodies that it acts on, each with a factor: that of its displacement rather than of its angle
        ends: dict[int, float] = {}
        for point, factor in element.along.items():
            body = body_of[point]
            if factor != 0 and (body not in ends or point not in model.angles):
                ends[body] = factor
        if element.kind is Kind.MASS and len(ends) == 1:
            masses[next(iter(ends))].append(i)
        elif element.kind is Kind.MASS:
            levers.append(Body("lever", (), (i,), tuple(ends.items())))
        else:
            links.append(_link(i, ends, count, levers))
    # Rigid bodies with their points and masses; those of moved points alone are bases
    points: list[list[str]] = [[] for _ in masses]
    for point, index in body_of.items():
        points[index].append(point)
    moved = set(model.displacement_inputs)
    bodies = [
        *[
            Body("base" if set(names) <= moved else "body", tuple(names), tuple(carried))
            for names, carried in zip(points, masses, strict=True)
        ],
        *levers,
    ]
    for k, lever in enumerate(levers):
        links += [Link("rigid", body, count + k, factor=factor) for body, factor in lever.along]
    # Channels that show the difference of two bodies which something joins, as links beside it
    joined = {frozenset((link.first, link.second)) for link in links}
    found = []
    for i, channel in enumerate(channels):
        if channel.quantity is Quantity.FORCE or sorted(channel.of.values()) != [-1.0, 1.0]:
            continue
        pair = [body_of[point] for point in channel.of]
        if len(set(pair)) == 2 and frozenset(pair) in joined:
            found.append(Link("sensor", pair[0], pair[1], i))
    links += found
    return Connections(
        tuple(bodies),
        tuple(links),
        tuple(
            Push(body_of[coordinate], source.name, factor, coordinate in model.angles)
            for source in model.inputs
            if source.kind == "force"
            for coordinate, factor in source.at.items()
        ),
        any(e.free or e.block for e in model.elements),
    )


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


# The order in which bodies are drawn: a tree from left to right, and the links that skip bodies.
#
# A tree grown depth-first leaves no link between its branches: every other link joins a body with one of
# its ancestors, so that it can run in a row of its own above what it skips.


@dataclass
class Branch:
    """A body in the tree.

    body      its index among the bodies
    bundle    links to the parent, side by side
    hanging   links to the ground, drawn below
    lanes     links that skip bodies, by the child that they pass, the nearest descendant first
    """

    body: int
    depth: int
    bundle: list[int] = field(default_factory=list)
    hanging: list[int] = field(default_factory=list)
    children: list[Branch] = field(default_factory=list)
    lanes: list[list[Lane]] = field(default_factory=list)
    from_above: int = 0  # skipping links that arrive at its top
    from_left: int = 0  # skipping links that arrive at its side, for something stands above it

    def preorder(self) -> list[Branch]:
        """It and all nodes below, each before its children."""
        nodes, waiting = [], [self]
        while waiting:
            node = waiting.pop()
            nodes.append(node)
            waiting += node.children
        return nodes


@dataclass(frozen=True)
class Lane:
    """A link that skips bodies, to a descendant: `above` where nothing stands between its row and that one's top."""

    low: Branch
    link: int
    above: bool


@dataclass(frozen=True)
class Forest:
    """Trees below each other, and the bodies with the walls that were added to them."""

    roots: tuple[Branch, ...]
    bodies: tuple[Body, ...]
    links: tuple[Link, ...]


def forest(model: Model, found: Connections) -> Forest:
    """Trees of all parts of a rig that only the ground joins."""
    return _Planner(model, found).forest()


class _Planner:
    """Grows the trees; walls of the ground are added to `bodies` where elements lead to them sideways."""

    def __init__(self, model: Model, found: Connections) -> None:
        self.model = model
        self.bodies = list(found.bodies)
        self.links = list(found.links)
        near: list[set[int]] = [set() for _ in found.bodies]
        for link in found.links:
            if link.second != GROUND:
                near[link.first].add(link.second)
                near[link.second].add(link.first)
        self.neighbours = [sorted(others - {body}) for body, others in enumerate(near)]

    def forest(self) -> Forest:
        """A tree for every part, in the order of their first bodies."""
        roots, seen = [], set[int]()
        for body in range(len(self.bodies)):
            if body in seen:
                continue
            part, waiting = {body}, [body]
            while waiting:
                fresh = [near for near in self.neighbours[waiting.pop()] if near not in part]
                part |= set(fresh)
                waiting += fresh
            seen |= part
            roots.append(self._grown(sorted(part)))
        return Forest(tuple(roots), tuple(self.bodies), tuple(self.links))

    def _grown(self, part: Sequence[int]) -> Branch:
        """The tree of a part: from its base, else from a wall beside a body that is held, else from an end."""
        of_role = {
            role: [body for body in part if self.bodies[body].role == role] for role in ("base", "body")
        }
        held = [body for body in of_role["body"] if self._held(body)]
        if of_role["base"]:
            start = max(of_role["base"], key=lambda body: len(self.neighbours[body]))
        else:
            start = min(held or of_role["body"] or part, key=lambda body: len(self.neighbours[body]))
            start = self._wall(start) if held else start
        root = Branch(start, 0)
        nodes = self._searched(root)
        for node in list(nodes.values()):
            # A chain that ends at the ground ends at a wall beside it.
            if not node.children and node.depth > 0 and self._held(node.body):
                wall = Branch(self._wall(node.body), node.depth + 1)
                node.children.append(wall)
                nodes[wall.body] = wall
        parents = {child.body: node for node in nodes.values() for child in node.children}
        skipping: list[tuple[Branch, Branch, int]] = []
        for k, link in enumerate(self.links):
            if link.first not in nodes:
                continue
            first = nodes[link.first]
            if link.second == GROUND:
                first.hanging.append(k)
                continue
            low, high = sorted((first, nodes[link.second]), key=lambda node: -node.depth)
            if parents[low.body] is high:
                low.bundle.append(k)
            else:
                skipping.append((high, low, k))
        _assign_lanes(root, parents, skipping)
        return root

    def _held(self, body: int) -> bool:
        """Whether a spring joins it to the ground."""
        return any(
            link.kind == "element" and self.model.elements[link.item].law.power == 0
            for link in self.links
            if (link.first, link.second) == (body, GROUND)
        )

    def _wall(self, body: int) -> int:
        """A wall of the ground beside a body, to which its links to the ground now lead."""
        wall = len(self.bodies)
        self.bodies.append(Body("ground", ()))
        self.neighbours.append([body])
        self.neighbours[body] = sorted({*self.neighbours[body], wall})
        for k, link in enumerate(self.links):
            if (link.first, link.second) == (body, GROUND):
                self.links[k] = replace(link, second=wall)
        return wall

    def _searched(self, root: Branch) -> dict[int, Branch]:
        """The nodes of the tree grown depth-first; bodies are visited in their order."""
        nodes = {root.body: root}
        path = [(root, iter(list(self.neighbours[root.body])))]
        while path:
            node, rest = path[-1]
            near = next((body for body in rest if body not in nodes), None)
            if near is None:
                path.pop()
                continue
            child = Branch(near, node.depth + 1)
            nodes[near] = child
            node.children.append(child)
            path.append((child, iter(list(self.neighbours[near]))))
        return nodes


def _assign_lanes(
    root: Branch, parents: Mapping[int, Branch], skipping: Sequence[tuple[Branch, Branch, int]]
) -> None:
    """Rows for the links (high, low, link) that skip bodies, by the child of the high one that they pass.

    Branches that such links lead into come first: nothing then stands between those and where they lead.
    """
    paths = {}
    into: dict[int, int] = {}
    for high, low, k in skipping:
        path = [low]
        while parents[path[-1].body] is not high:
            path.append(parents[path[-1].body])
        paths[k] = path
        for node in path:
            into[node.body] = into.get(node.body, 0) + 1
    for node in root.preorder():
        node.children.sort(key=lambda child: -into.get(child.body, 0))
        node.lanes = [[] for _ in node.children]
    for high, low, k in sorted(skipping, key=lambda item: (item[1].depth, item[2])):
        path = paths[k]
        above = all(parents[node.body].children[0] is node for node in path[:-1])
        high.lanes[high.children.index(path[-1])].append(Lane(low, k, above))
        if above:
            low.from_above += 1
        else:
            low.from_left += 1
