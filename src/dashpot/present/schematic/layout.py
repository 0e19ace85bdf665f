"""Where everything of a drawing stands, as plain geometry: a test can check that nothing crosses or overlaps.

Bodies stand in columns by their distance from the wall; between columns lie gaps with the symbols.  A body's links to
its parent lie level with its middle, its first branch goes on at that level and the others lie below.  A link that
skips bodies has a row of its own above the branch that it leads into, its symbol in the gap beside the nearer end;
links to the ground hang below.  So no line can meet a symbol; where lines cross, one hops over the other.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from dashpot.channel import Channel, Quantity
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.present.estimate import parameter_rows
from dashpot.present.schematic.connections import GROUND, Body, Connections, Link, Push
from dashpot.present.schematic.geometry import (
    ENTRY,
    FIXED,
    LEAD,
    MARGIN,
    SMALL,
    TEXT,
    Anchor,
    Arrow,
    Box,
    ColumnPlaces,
    Layout,
    Line,
    PlacedBody,
    PlacedLink,
    Text,
    Tone,
    Wire,
    block_height,
    block_width,
    shortened,
    stacked,
    with_hops,
)
from dashpot.present.words import plain, short

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


# What stands beside the parts of a drawing: names, values with intervals, laws, sensors.


Knowledge = Literal["unknown", "known", "doubtful"]
BADGES: Mapping[Quantity, str] = {
    Quantity.DISPLACEMENT: "d",
    Quantity.VELOCITY: "v",
    Quantity.ACCELERATION: "a",
    Quantity.FORCE: "F",
}


@dataclass(frozen=True)
class Labels:
    """Lines of text for each part of a rig; `values` are name → (knowledge, value with unit, interval)."""

    model: Model
    channels: tuple[Channel, ...]
    values: Mapping[str, tuple[Knowledge, str, str]]
    calibrations: Mapping[str, str]
    numbers: bool = True

    def knowledge(self, element: Element) -> Knowledge:
        """Whether a parameter is unknown (or estimated), known, or doubtful."""
        return self.values[element.name][0]

    def element(self, element: Element) -> list[Line]:
        """Name and value, interval, law, what it is stretched along where that is not plain, sensors of its force."""
        lines = self.value_lines(element)
        if not self.numbers:
            return lines
        if element.force_law is not None:
            lines.append(Line(f"law {shortened(law_in_symbols(element.force_law.text))}", "muted", SMALL))
            for constant in element.force_law.constants:
                name = f"{element.name}.{constant.name}"
                known, value, _ = self.values.get(name, ("known", plain(constant.value or 0.0), ""))
                lines.append(Line(f"{constant.name} = {value}{_mark(known)}", known, SMALL))
        if any(abs(factor) != 1 for factor in element.along.values()) or len(element.along) > 2:
            lines.append(Line(shortened(elongation(element.along), 34), "muted", SMALL))
        return lines + self._sensors({element.name})

    def value_lines(self, element: Element) -> list[Line]:
        """Name with value and, below it, the interval."""
        known, value, interval = self.values[element.name]
        if not self.numbers:
            return [Line(shortened(element.name, 14) + _mark(known), known, SMALL, known != "known")]
        lines = [Line(f"{shortened(element.name)} = {value}{_mark(known)}", known, TEXT, known != "known")]
        return [*lines, Line(interval, "muted", SMALL)] if interval else lines

    def body(self, body: Body) -> list[Line]:
        """Coordinates, masses and sensors of a body."""
        lines = []
        for point in body.points:
            arrow = "" if body.role == "base" else "↻ " if point in self.model.angles else "→ "
            lines.append(Line(f"{arrow}{shortened(point)}", "ink", TEXT + 1, True))
        for index in body.masses:
            element = self.model.elements[index]
            lines += self.value_lines(element)
            if any(factor != 1 for factor in element.along.values()):
                lines.append(Line(shortened(elongation(element.along), 34), "muted", SMALL))
        return lines + self._sensors(set(body.points))

    def push(self, push: Push, first: bool) -> list[Line]:
        """A force or moment with its factor; its sensors beside the first of its arrows."""
        factor = "" if push.factor == 1 else "−" if push.factor == -1 else f"{push.factor:g} "
        turning = "↻ " if push.turns else ""
        lines = [Line(f"{turning}{factor}{shortened(push.source)}", "drive", TEXT, True)]
        return lines + (self._sensors({push.source}) if first else [])

    def channel(self, index: int) -> list[Line]:
        """A sensor between two bodies."""
        return [self._sensor(self.channels[index], ends=False)]

    def _sensors(self, points: Collection[str]) -> list[Line]:
        """Channels whose first point is one of these."""
        return [
            self._sensor(channel, ends=len(channel.of) > 1)
            for channel in self.channels
            if next(iter(channel.of)) in points and not self._between(channel)
        ]

    def _between(self, channel: Channel) -> bool:
        return channel.name in self.calibrations and self.calibrations[channel.name] == "between"

    def _sensor(self, channel: Channel, ends: bool) -> Line:
        text = shortened(channel.name)
        if ends:
            text += f": {shortened(elongation(channel.of), 30)}"
        for what in ("gain", "delay", "sign"):
            value = self.calibrations.get(f"{channel.name}.{what}")
            if value is not None:
                text += f", {what} {value}"
        return Line(text, "sensor", SMALL, badge=BADGES[channel.quantity])


def labels(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate | None,
    doubtful: Collection[str],
    between: Collection[int] = (),
    level: float = 0.95,
    *,
    numbers: bool = True,
) -> Labels:
    """Labels of a rig, with values and intervals of an estimate where there is one.

    `between` are indices of channels that are drawn as links; without `numbers` only names stand there.
    """
    values = _stated(model)
    if estimate is not None:
        values |= _estimated(estimate, level)
    for name in doubtful:
        if name in values:
            values[name] = ("doubtful", *values[name][1:])
    calibrations = {channel.name: "between" for i, channel in enumerate(channels) if i in between}
    return Labels(model, tuple(channels), values, calibrations | _calibrations(channels, estimate), numbers)


def _stated(model: Model) -> dict[str, tuple[Knowledge, str, str]]:
    """What the rig file says of each parameter."""
    values: dict[str, tuple[Knowledge, str, str]] = {}
    for element, tie in zip(model.elements, model.ties, strict=True):
        root = model.elements[tie.root]
        known: Knowledge = "unknown" if root.value is None or root.sd is not None else "known"
        text = "?"
        if element.same_as is not None:
            text = ("" if element.times == 1 else f"{element.times:g} × ") + element.same_as
        elif element.value is not None:
            spread = "" if element.sd is None else f" ± {short(element.sd, 2)}"
            text = _with_unit(plain(element.value) + spread, model.unit(element))
        values[element.name] = (known, text, "")
    for owner, constant in model.constants:
        text = "?" if constant.value is None else plain(constant.value)
        values[f"{owner.name}.{constant.name}"] = ("unknown" if constant.unknown else "known", text, "")
    return values


def _estimated(estimate: Estimate, level: float) -> dict[str, tuple[Knowledge, str, str]]:
    values: dict[str, tuple[Knowledge, str, str]] = {}
    for row in parameter_rows(estimate, level):
        interval = f"{row.low} … {row.high}" if row.low else row.tie
        values[row.name] = ("known" if row.known else "unknown", _with_unit(row.value, row.unit), interval)
    return values


def _calibrations(channels: Sequence[Channel], estimate: Estimate | None) -> dict[str, str]:
    """ "NAME.gain" → its text: what was found, or ? where it is unknown."""
    values: dict[str, str] = {}
    for channel in channels:
        for what, number in (("gain", channel.gain), ("delay", channel.delay), ("sign", channel.sign)):
            if number is None:
                values[f"{channel.name}.{what}"] = "?"
    if estimate is not None:
        rows = {row.name: row for row in parameter_rows(estimate)}
        shared = {f"{c.name}.gain": f"{c.same_gain_as}.gain" for c in channels if c.same_gain_as is not None}
        for name in list(values):
            row = rows.get(name, rows.get(shared.get(name, "")))
            if row is not None:
                values[name] = _with_unit(row.value, row.unit)
        for name, sign in estimate.signs.items():
            values[f"{name}.sign"] = "+" if float(sign) > 0 else "−"
    return values


def _with_unit(text: str, unit: str) -> str:
    return text if unit in ("", "1") or text == "?" else f"{text} {unit}"


_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def law_in_symbols(text: str) -> str:
    """A law as it is written by hand: d**2*v is d²·v."""
    raised = re.sub(r"\*\*(\d+)", lambda match: match[1].translate(_RAISED), text)
    return raised.replace("*", "·")


def _mark(known: Tone) -> str:
    return " (?)" if known == "doubtful" else ""


def elongation(along: Mapping[str, float]) -> str:
    """A combination of points: "x1 + 0.4 pitch − u"."""
    terms = []
    for point, factor in along.items():
        size = "" if abs(factor) == 1 else f"{abs(factor):.3g} "
        terms.append(f"{'−' if factor < 0 else '+'} {size}{shortened(point)}")
    text = " ".join(terms)
    return text.removeprefix("+ ") if text.startswith("+ ") else f"−{text[2:]}"


SYMBOL, HALF = 58.0, 11.0  # length of a symbol, half its width
SEPARATION = 16.0  # between branches
WALL = 12.0  # width of a wall
LEAST_ZONE = 84.0
ARROW_ROOM = 14.0  # above the name of a base, for its arrow


@dataclass
class _Measures:
    """Of one node, relative to its middle line: how far it and its branches reach, and where its rows are."""

    lines: list[Line] = field(default_factory=list)
    width: float = 0.0
    up: float = 0.0
    down: float = 0.0
    top: float = 0.0  # of the box
    bottom: float = 0.0
    bundle: list[float] = field(default_factory=list)  # axes of the links to the parent
    bundle_top: float = 0.0
    centres: list[float] = field(default_factory=list)  # of the children
    lanes: list[list[float]] = field(default_factory=list)
    pushes: list[float] = field(default_factory=list)


class Placer:
    """Places the trees of a forest below each other."""

    def __init__(
        self, model: Model, channels: Sequence[Channel], plan: Forest, pushes: Sequence[Push], labels: Labels
    ) -> None:
        self.model, self.plan, self.labels = model, plan, labels
        self.channels = channels
        self.pushes: dict[int, list[tuple[Push, list[Line]]]] = {}
        named = set[str]()
        for push in pushes:
            lines = labels.push(push, push.source not in named)
            named.add(push.source)
            self.pushes.setdefault(push.body, []).append((push, lines))
        self.texts = [self._link_lines(link) for link in plan.links]
        self.measures: dict[int, _Measures] = {}
        self.bodies: list[PlacedBody] = []
        self.links: list[PlacedLink] = []
        self.arrows: list[Arrow] = []
        self.wires: list[Wire] = []

    def layout(self) -> Layout:
        """All of it, in a frame as large as it needs."""
        y, width = MARGIN, 0.0
        for root in self.plan.roots:
            nodes = _preorder(root)
            for node in reversed(nodes):
                self._measure(node)
            columns = self._columns(nodes)
            measure = self.measures[root.body]
            self._place(root, y + measure.up, columns)
            y += measure.up + measure.down + SEPARATION
            width = max(width, columns.right)
        return Layout(
            width + MARGIN,
            y - SEPARATION + MARGIN,
            tuple(self.bodies),
            tuple(self.links),
            tuple(self.arrows),
            tuple(with_hops(self.wires)),
        )

    def _link_lines(self, link: Link) -> list[Line]:
        if link.kind == "element":
            return self.labels.element(self.model.elements[link.item])
        if link.kind == "sensor":
            return self.labels.channel(link.item)
        return [] if link.factor == 1 else [Line(f"× {link.factor:.3g}".replace("-", "−"), "muted", SMALL)]

    def _row(self, k: int) -> tuple[float, float]:
        """(height above the axis, height below it) of a link that lies level."""
        return block_height(self.texts[k]) + HALF + 3, HALF + 3

    # Heights

    def _measure(self, node: Branch) -> None:
        m = self.measures[node.body] = _Measures()
        body = self.plan.bodies[node.body]
        m.lines = self.labels.body(body) if body.role != "ground" else []
        if body.role == "base":
            m.lines = [Line("", size=ARROW_ROOM), *m.lines]
        text = block_height(m.lines) / 2 + 7 if m.lines else 9.0
        m.bundle, half = self._bundle(node.bundle)
        m.bundle_top = -half
        m.top, m.bottom = -max(text, half + ENTRY * node.from_left), max(text, half)
        used, free = 0.0, 0.0
        for j, child in enumerate(node.children):
            below = self.measures[child.body]
            lanes = [self._row(lane.link) for lane in node.lanes[j]]
            centre = 0.0 if j == 0 else free + SEPARATION + below.up + sum(a + b for a, b in lanes)
            y, axes = centre - below.up, []
            for above, under in lanes:
                axes.append(y - under)
                y -= above + under
            m.up = max(m.up, -y)
            m.centres.append(centre)
            m.lanes.append(axes)
            m.top = min([m.top, centre + below.bundle_top, *(axis - 10 for axis in axes)])
            used = max(used, centre - below.bundle_top)
            free = max(free, centre + below.down)
        heights = [block_height(lines) + 14 for _, lines in self.pushes.get(node.body, ())]
        y = used if node.children else -sum(heights) / 2
        m.top = min(m.top, y)
        for height in heights:
            y += height
            m.pushes.append(y - 6)
        used = max(used, y) if heights else used
        m.bottom = max(m.bottom, used)
        m.up = max(m.up, -m.top)
        m.width = self._width(node, body, m)
        m.down = max(free, m.bottom + self._hanging_height(node))

    def _bundle(self, links: Sequence[int]) -> tuple[list[float], float]:
        """Axes of links beside each other about their middle, and half their height."""
        rows = [self._row(k) for k in links]
        height = sum(a + b for a, b in rows)
        y, axes = -height / 2, []
        for above, under in rows:
            axes.append(y + above)
            y += above + under
        return axes, height / 2

    def _is_wall(self, node: Branch) -> bool:
        role = self.plan.bodies[node.body].role
        return role == "ground" or (role == "base" and (node.depth == 0 or not node.children))

    def _width(self, node: Branch, body: Body, m: _Measures) -> float:
        if self._is_wall(node):
            text = max(block_width(m.lines), 40.0) + 8 if m.lines else 0.0
            return max(WALL + text, self._hanging_width(node))
        text = block_width(m.lines) + 18 if m.lines else 12.0
        return max(text, ENTRY * (node.from_above + 1), self._hanging_width(node))

    def _hanging_width(self, node: Branch) -> float:
        return sum(self._slot(k) for k in node.hanging)

    def _slot(self, k: int) -> float:
        return 2 * HALF + 12 + block_width(self.texts[k])

    def _hanging_height(self, node: Branch) -> float:
        if not node.hanging:
            return 0.0
        return max(SYMBOL, *(block_height(self.texts[k]) for k in node.hanging)) + 2 * LEAD + 10

    # Widths

    def _columns(self, nodes: Sequence[Branch]) -> ColumnPlaces:
        deepest = max(node.depth for node in nodes)
        widths, zones, entries = [0.0] * (deepest + 1), [0.0] * (deepest + 1), [0] * (deepest + 1)
        for node in nodes:
            widths[node.depth] = max(widths[node.depth], self.measures[node.body].width)
            rows = [k for child in node.children for k in child.bundle]
            rows += [lane.link for lanes in node.lanes for lane in lanes]
            texts = [block_width(self.texts[k]) for k in rows]
            texts += [block_width(lines) for _, lines in self.pushes.get(node.body, ())]
            if texts:
                zones[node.depth] = max([zones[node.depth], LEAST_ZONE, *(t + 8 for t in texts)])
            if node.from_left:
                entries[node.depth - 1] += node.from_left
        return ColumnPlaces(widths, zones, entries)

    # Places

    def _place(self, root: Branch, middle: float, columns: ColumnPlaces) -> None:
        boxes: dict[int, Box] = {}
        arriving: dict[tuple[int, bool], int] = {}
        waiting = [(root, middle)]
        ordered: list[tuple[Branch, float]] = []
        while waiting:
            node, y = waiting.pop(0)
            ordered.append((node, y))
            boxes[node.body] = self._place_body(node, y, columns)
            m = self.measures[node.body]
            waiting += [(child, y + centre) for child, centre in zip(node.children, m.centres, strict=True)]
        for node, y in ordered:
            m = self.measures[node.body]
            for child, centre in zip(node.children, m.centres, strict=True):
                axes = self.measures[child.body].bundle
                for k, axis in zip(child.bundle, axes, strict=True):
                    self._place_level(
                        k, node, boxes[child.body].left, child, y + centre + axis, columns, boxes
                    )
            self._place_pushes(node, y, columns, boxes)
            self._place_hanging(node, boxes)
        # The lanes of the nearest bodies arrive first, the highest last: further right at a top.
        for node, y in reversed(ordered):
            m = self.measures[node.body]
            for lanes, axes in zip(node.lanes, m.lanes, strict=True):
                for lane, axis in zip(lanes, axes, strict=True):
                    self._place_lane(lane, node, y + axis, columns, boxes, arriving)

    def _place_body(self, node: Branch, y: float, columns: ColumnPlaces) -> Box:
        m, body = self.measures[node.body], self.plan.bodies[node.body]
        left, column = columns.left(node.depth), columns.widths[node.depth]
        top, bottom = y + m.top, y + m.bottom
        if self._is_wall(node):
            beside_left = node.depth == 0
            x = left + column - WALL if beside_left else left
            box = Box(x, top - 4, x + WALL, bottom + 4)
            text_x = x - 8 if beside_left else x + WALL + 8
            anchor = "end" if beside_left else "start"
            texts = stacked(m.lines, text_x, y - block_height(m.lines) / 2, node.body, anchor)  # type: ignore[arg-type]
            side = "left" if beside_left else "right"
            self.bodies.append(PlacedBody(node.body, body, box, tuple(texts), True, side))
            return Box(x, top, x + WALL, bottom)
        x = left + (column - m.width) / 2
        box = Box(x, top, x + m.width, bottom)
        texts = stacked(m.lines, (box.left + box.right) / 2, y - block_height(m.lines) / 2, node.body)
        self.bodies.append(PlacedBody(node.body, body, box, tuple(texts)))
        return box

    def _place_level(
        self,
        k: int,
        node: Branch,
        right: float,
        child: Branch,
        y: float,
        columns: ColumnPlaces,
        boxes: dict[int, Box],
    ) -> None:
        """A link whose symbol lies in the gap right of a node."""
        start, end, box, texts = self._symbol(k, node.depth, y, columns, node.body, child.body)
        self.links.append(PlacedLink(self.plan.links[k], start, end, box, texts))
        sensor = self.plan.links[k].kind == "sensor"
        self.wires.append(Wire((Anchor(boxes[node.body].right, y, node.body), start), sensor=sensor))
        self.wires.append(Wire((end, Anchor(right, y, child.body)), sensor=sensor))

    def _symbol(
        self, k: int, depth: int, y: float, columns: ColumnPlaces, first: int, second: int
    ) -> tuple[Anchor, Anchor, Box, tuple[Text, ...]]:
        left, right = columns.zone(depth)
        x = (left + right) / 2
        start, end = Anchor(x - SYMBOL / 2, y, first), Anchor(x + SYMBOL / 2, y, second)
        box = Box(start.x, y - HALF, end.x, y + HALF)
        texts = stacked(self.texts[k], x, y - HALF - 1 - block_height(self.texts[k]))
        return start, end, box, tuple(texts)

    def _place_pushes(self, node: Branch, y: float, columns: ColumnPlaces, boxes: dict[int, Box]) -> None:
        m = self.measures[node.body]
        for (_, lines), axis in zip(self.pushes.get(node.body, ()), m.pushes, strict=True):
            left, right = columns.zone(node.depth)
            start = boxes[node.body].right
            end = Anchor((left + right) / 2 + SYMBOL / 2, y + axis, node.body)
            texts = stacked(lines, (left + right) / 2, y + axis - 7 - block_height(lines), node.body)
            self.arrows.append(Arrow(Anchor(start, y + axis, node.body), end, tuple(texts)))

    def _place_hanging(self, node: Branch, boxes: dict[int, Box]) -> None:
        box = boxes[node.body]
        height = self._hanging_height(node) - 10
        width = self._hanging_width(node)
        x = (box.left + box.right - width) / 2
        if self._is_wall(node):
            x = box.right - width if node.depth == 0 else box.left
        for k in node.hanging:
            axis = x + HALF + 4
            top = box.bottom + (height - SYMBOL) / 2
            start, end = Anchor(axis, top, node.body), Anchor(axis, top + SYMBOL)
            lines = self.texts[k]
            texts = stacked(lines, axis + HALF + 5, top + (SYMBOL - block_height(lines)) / 2, FIXED, "start")
            symbol = Box(axis - HALF, start.y, axis + HALF, end.y)
            self.links.append(
                PlacedLink(self.plan.links[k], start, end, symbol, tuple(texts), box.bottom + height)
            )
            self.wires.append(Wire((Anchor(axis, box.bottom, node.body), start)))
            self.wires.append(Wire((end, Anchor(axis, box.bottom + height))))
            x += self._slot(k)

    def _place_lane(
        self, lane: Lane, high: Branch, y: float, columns: ColumnPlaces, boxes: dict[int, Box],
        arriving: dict[tuple[int, bool], int],
    ) -> None:  # fmt: skip
        """A link that skips bodies: level above them, then down to the top of the far one or beside it."""
        k, low = lane.link, lane.low
        start, end, symbol, texts = self._symbol(k, high.depth, y, columns, high.body, low.body)
        self.links.append(PlacedLink(self.plan.links[k], start, end, symbol, texts))
        self.wires.append(Wire((Anchor(boxes[high.body].right, y, high.body), start)))
        number = arriving[low.body, lane.above] = arriving.get((low.body, lane.above), 0) + 1
        box, m = boxes[low.body], self.measures[low.body]
        if lane.above:
            x = box.left + box.width * number / (low.from_above + 1)
            corners = [(x, y), (x, box.top)]
        else:
            x = columns.entry(low.depth - 1)
            arrival = box.top - m.top + m.bundle_top - ENTRY * (number - 0.5)
            corners = [(x, y), (x, arrival), (box.left, arrival)]
        self.wires.append(Wire((end, *(Anchor(*corner, low.body) for corner in corners))))


def _preorder(root: Branch) -> list[Branch]:
    """All nodes, each before its children."""
    nodes, waiting = [], [root]
    while waiting:
        node = waiting.pop()
        nodes.append(node)
        waiting += node.children
    return nodes
