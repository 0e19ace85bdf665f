"""The order in which bodies are drawn: a tree from left to right, and the links that skip bodies.

A tree grown depth-first leaves no link between its branches: every other link joins a body with one of its ancestors,
so that it can run in a row of its own above what it skips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from dashpot.model.network import Model
from dashpot.present.schematic.connections import GROUND, Body, Connections, Link


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
    plan = _Planner(model, found)
    return Forest(tuple(plan.roots()), tuple(plan.bodies), tuple(plan.links))


class _Planner:
    """Grows the trees; walls of the ground are added to `bodies` where elements lead to them sideways."""

    def __init__(self, model: Model, found: Connections) -> None:
        self.model = model
        self.bodies = list(found.bodies)
        self.links = list(found.links)
        self.neighbours: list[list[int]] = [[] for _ in found.bodies]
        for link in found.links:
            if link.second != GROUND:
                self.neighbours[link.first].append(link.second)
                self.neighbours[link.second].append(link.first)
        for body, near in enumerate(self.neighbours):
            self.neighbours[body] = sorted(set(near) - {body})

    def roots(self) -> list[Branch]:
        """The root of every part, in the order of their first bodies."""
        roots, seen = [], set[int]()
        for body in range(len(self.bodies)):
            if body not in seen:
                part = self._part(body)
                seen |= set(part)
                roots.append(self._grow(part))
        return roots

    def _part(self, start: int) -> list[int]:
        part, waiting = {start}, [start]
        while waiting:
            fresh = [near for near in self.neighbours[waiting.pop()] if near not in part]
            part |= set(fresh)
            waiting += fresh
        return sorted(part)

    def _grow(self, part: Sequence[int]) -> Branch:
        bases = [body for body in part if self.bodies[body].role == "base"]
        held = [body for body in part if self._held(body) and self.bodies[body].role == "body"]
        if bases:
            root = self._search(max(bases, key=lambda body: len(self.neighbours[body])))
        elif held:
            first = min(held, key=lambda body: len(self.neighbours[body]))
            wall = self._wall(first)
            root = self._search(wall)
        else:
            bodies = [body for body in part if self.bodies[body].role == "body"] or part
            root = self._search(min(bodies, key=lambda body: len(self.neighbours[body])))
        return self._finished(root)

    def _held(self, body: int) -> bool:
        """Whether a spring joins it to the ground."""
        return any(
            link.kind == "element" and self.model.elements[link.item].law.power == 0
            for link in self._to_ground(body)
        )

    def _to_ground(self, body: int) -> list[Link]:
        return [link for link in self.links if link.first == body and link.second == GROUND]

    def _wall(self, body: int) -> int:
        """A wall of the ground beside a body, to which its links to the ground now lead."""
        wall = len(self.bodies)
        self.bodies.append(Body("ground", ()))
        self.neighbours.append([body])
        self.neighbours[body] = sorted({*self.neighbours[body], wall})
        for k, link in enumerate(self.links):
            if link.first == body and link.second == GROUND:
                self.links[k] = replace(link, second=wall)
        return wall

    def _search(self, start: int) -> Branch:
        """The tree grown depth-first; bodies are visited in their order."""
        root = Branch(start, 0)
        nodes = {start: root}
        path = [(root, iter(list(self.neighbours[start])))]
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
        self._nodes = nodes
        return root

    def _finished(self, root: Branch) -> Branch:
        for node in list(self._nodes.values()):
            # A chain that ends at the ground ends at a wall beside it.
            if not node.children and node.depth > 0 and self._held(node.body):
                wall = Branch(self._wall(node.body), node.depth + 1)
                node.children.append(wall)
                self._nodes[wall.body] = wall
        parents = {child.body: node for node in self._nodes.values() for child in node.children}
        skipping: list[tuple[Branch, Branch, int]] = []
        for k, link in enumerate(self.links):
            if link.first not in self._nodes:
                continue
            first = self._nodes[link.first]
            if link.second == GROUND:
                first.hanging.append(k)
                continue
            low, high = sorted((first, self._nodes[link.second]), key=lambda node: -node.depth)
            if parents[low.body] is high:
                low.bundle.append(k)
            else:
                skipping.append((high, low, k))
        _order(root, parents, skipping)
        _assign_lanes(root, parents, skipping)
        return root


def _order(root: Branch, parents: dict[int, Branch], skipping: Sequence[tuple[Branch, Branch, int]]) -> None:
    """Branches that skipping links lead into come first: nothing then stands between those and where they lead."""
    into: dict[int, int] = {}
    for high, low, _ in skipping:
        node = low
        while node is not high:
            into[node.body] = into.get(node.body, 0) + 1
            node = parents[node.body]
    waiting = [root]
    while waiting:
        node = waiting.pop()
        node.children.sort(key=lambda child: -into.get(child.body, 0))
        waiting += node.children


def _assign_lanes(
    root: Branch, parents: dict[int, Branch], skipping: Sequence[tuple[Branch, Branch, int]]
) -> None:
    waiting = [root]
    while waiting:
        node = waiting.pop()
        node.lanes = [[] for _ in node.children]
        waiting += node.children
    for high, low, k in sorted(skipping, key=lambda item: (item[1].depth, item[2])):
        path = [low]
        while parents[path[-1].body] is not high:
            path.append(parents[path[-1].body])
        above = all(parents[node.body].children[0] is node for node in path[:-1])
        high.lanes[high.children.index(path[-1])].append(Lane(low, k, above))
        if above:
            low.from_above += 1
        else:
            low.from_left += 1
