"""Where everything of a drawing stands, as plain geometry: a test can check that nothing crosses or overlaps.

Bodies stand in columns by their distance from the wall; between columns lie gaps with the symbols.  A body's links to
its parent lie level with its middle, its first branch goes on at that level and the others lie below.  A link that
skips bodies has a row of its own above the branch that it leads into, its symbol in the gap beside the nearer end;
links to the ground hang below.  So no line can meet a symbol; where lines cross, one hops over the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from dashpot.channel import Channel
from dashpot.model.network import Model
from dashpot.present.schematic.connections import Body, Link, Push
from dashpot.present.schematic.geometry import (
    FIXED,
    SMALL,
    Anchor,
    Box,
    Line,
    Text,
    block_height,
    block_width,
    stacked,
)
from dashpot.present.schematic.labels import Labels
from dashpot.present.schematic.placed import (
    ENTRY,
    LEAD,
    MARGIN,
    Arrow,
    ColumnPlaces,
    Layout,
    PlacedBody,
    PlacedLink,
    Wire,
    with_hops,
)
from dashpot.present.schematic.tree import Branch, Forest, Lane

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
