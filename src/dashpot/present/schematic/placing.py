"""Where everything of a drawing stands: parts with their strokes and texts, so that nothing crosses or overlaps.

Texts are names, values with intervals, laws and sensors.

Bodies stand in columns by their distance from the wall; between columns lie gaps with the symbols.  A body's links to
its parent lie level with its middle, its first branch goes on at that level and the others lie below.  A link that
skips bodies has a row of its own above the branch that it leads into, its symbol in the gap beside the nearer end;
links to the ground hang below.  So no line can meet a symbol; where lines cross, one hops over the other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from dashpot.channel import Channel, Quantity
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.present.estimate import parameter_rows
from dashpot.present.schematic import symbols
from dashpot.present.schematic.bodies import Body, Branch, Forest, Lane, Link, Push
from dashpot.present.schematic.symbols import (
    FIXED,
    MARGIN,
    SMALL,
    TEXT,
    Box,
    Line,
    Part,
    Point,
    Shape,
    Text,
    Tone,
    block_height,
    block_width,
    shortened,
    stacked,
    stroke,
)
from dashpot.present.words import plain, short

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
    between: frozenset[int] = frozenset()  # channels that are drawn as links
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
            for i, channel in enumerate(self.channels)
            if next(iter(channel.of)) in points and i not in self.between
        ]

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
    # What the rig file says of each parameter
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
    rows = {} if estimate is None else {row.name: row for row in parameter_rows(estimate, level)}
    for row in rows.values():
        interval = f"{row.low} … {row.high}" if row.low else row.tie
        values[row.name] = ("known" if row.known else "unknown", _with_unit(row.value, row.unit), interval)
    for name in doubtful:
        if name in values:
            values[name] = ("doubtful", *values[name][1:])
    texts: dict[str, str] = {}
    for channel in channels:
        for what, number in (("gain", channel.gain), ("delay", channel.delay), ("sign", channel.sign)):
            if number is None:
                texts[f"{channel.name}.{what}"] = "?"
    if estimate is not None:
        shared = {f"{c.name}.gain": c.unknown_gain.name for c in channels if c.unknown_gain is not None}
        shared |= {f"{c.name}.delay": c.unknown_delay.name for c in channels if c.unknown_delay is not None}
        for name in list(texts):
            entry = rows.get(name, rows.get(shared.get(name, "")))
            if entry is not None:
                texts[name] = _with_unit(entry.value, entry.unit)
        for name, sign in estimate.signs.items():
            texts[f"{name}.sign"] = "+" if float(sign) > 0 else "−"
    return Labels(model, tuple(channels), values, texts, frozenset(between), numbers)


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


ENTRY = 13.0  # px between lines that arrive side by side
LEAD = 9.0  # least length of the line on either side of a symbol
SYMBOL, HALF = 58.0, 11.0  # length of a symbol, half its width
SEPARATION = 16.0  # between branches
WALL = 12.0  # width of a wall
ARROW_ROOM = 14.0  # above the name of a base, for its arrow
WEIGHTS: dict[Tone, float] = {"unknown": 2.0, "doubtful": 2.0, "ink": 2.4, "sensor": 1.0, "known": 1.2}


@dataclass(frozen=True)
class Wire:
    """A rigid line through points, level or upright."""

    points: tuple[Point, ...]
    sensor: bool = False


@dataclass(frozen=True)
class Placed:
    """A drawing, px: lines, and from back to front what they lead to."""

    width: float
    height: float
    wires: tuple[Wire, ...]
    links: tuple[Part, ...]
    walls: tuple[Part, ...]
    bodies: tuple[Part, ...]
    forces: tuple[Part, ...]

    @property
    def parts(self) -> list[Part]:
        """Everything that is drawn."""
        # The strokes of wires: upright parts hop over the level parts of others that they cross
        level = [
            (a, b, k) for k, wire in enumerate(self.wires) for a, b in pairwise(wire.points) if a.y == b.y
        ]
        shapes = []
        for k, wire in enumerate(self.wires):
            points = [wire.points[0]]
            for a, b in pairwise(wire.points):
                crossed = [
                    c.y
                    for c, d, other in level
                    if a.x == b.x and other != k
                    if min(c.x, d.x) < a.x < max(c.x, d.x) and min(a.y, b.y) < c.y < max(a.y, b.y)
                ]
                down = 1.0 if b.y > a.y else -1.0
                for y in sorted(crossed, reverse=down < 0):
                    turns, radius = [math.pi * n / 8 for n in range(9)], 3.5  # of a bump over the line
                    points += [
                        b._replace(x=b.x + radius * math.sin(turn), y=y - down * radius * math.cos(turn))
                        for turn in turns
                    ]
                points.append(b)
            tone, weight = ("sensor", 1.0) if wire.sensor else ("ink", 1.2)
            shapes.append(Shape(tuple(points), tone, weight, dashed=wire.sensor))  # type: ignore[arg-type]
        lines = Part("", tuple(shapes))
        return [lines, *self.links, *self.walls, *self.bodies, *self.forces]


class _Columns:
    """Where columns of bodies, zones of symbols and upright lines lie, px from the left."""

    def __init__(self, widths: Sequence[float], zones: Sequence[float], entries: Sequence[int]) -> None:
        self.widths = widths
        self.left: list[float] = []  # of the bodies
        self.zone: list[tuple[float, float]] = []  # of the symbols right of them
        self._next: list[float] = []
        x = MARGIN
        for width, zone, count in zip(widths, zones, entries, strict=True):
            self.left.append(x)
            x += width + LEAD
            self.zone.append((x, x + zone))
            x += zone
            self._next.append(x + ENTRY / 2)
            x += LEAD + ENTRY * count
        self.right = x

    def middle(self, depth: int) -> float:
        """Of the symbols right of that column."""
        left, right = self.zone[depth]
        return (left + right) / 2

    def entry(self, depth: int) -> float:
        """A place for one more upright line right of that zone."""
        x = self._next[depth]
        self._next[depth] += ENTRY
        return x


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

    def __init__(self, model: Model, plan: Forest, pushes: Sequence[Push], labels: Labels) -> None:
        self.model, self.plan, self.labels = model, plan, labels
        self.pushes: dict[int, list[list[Line]]] = {}
        named = set[str]()
        for push in pushes:
            lines = labels.push(push, push.source not in named)
            named.add(push.source)
            self.pushes.setdefault(push.body, []).append(lines)
        self.texts = [self._link_lines(link) for link in plan.links]
        self.measures: dict[int, _Measures] = {}
        self.boxes: dict[int, Box] = {}
        self.arriving: dict[tuple[int, bool], int] = {}
        self.wires: list[Wire] = []
        self.links: list[Part] = []
        self.walls: list[Part] = []
        self.bodies: list[Part] = []
        self.forces: list[Part] = []

    def placed(self) -> Placed:
        """All of it, in a frame as large as it needs."""
        y, width = MARGIN, 0.0
        for root in self.plan.roots:
            nodes = root.preorder()
            for node in reversed(nodes):
                self._measure(node)
            columns = self._columns(nodes)
            measure = self.measures[root.body]
            self._place(root, y + measure.up, columns)
            y += measure.up + measure.down + SEPARATION
            width = max(width, columns.right)
        parts = map(tuple[Part, ...], (self.links, self.walls, self.bodies, self.forces))
        return Placed(width + MARGIN, y - SEPARATION + MARGIN, tuple(self.wires), *parts)

    def _link_lines(self, link: Link) -> list[Line]:
        if link.kind == "element":
            return self.labels.element(self.model.elements[link.item])
        if link.kind == "sensor":
            return self.labels.channel(link.item)
        return [] if link.factor == 1 else [Line(f"× {link.factor:.3g}".replace("-", "−"), "muted", SMALL)]

    # Heights

    def _row(self, k: int) -> tuple[float, float]:
        """(height above the axis, height below it) of a link that lies level."""
        return block_height(self.texts[k]) + HALF + 3, HALF + 3

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
        heights = [block_height(lines) + 14 for lines in self.pushes.get(node.body, ())]
        y = used if node.children else -sum(heights) / 2
        m.top = min(m.top, y)
        for height in heights:
            y += height
            m.pushes.append(y - 6)
        m.bottom = max(m.bottom, used, y if heights else used)
        m.up = max(m.up, -m.top)
        m.width = self._width(node, m)
        m.down = max(free, m.bottom + self._hanging_height(node))

    def _bundle(self, links: Sequence[int]) -> tuple[list[float], float]:
        """Axes of parallel links about their middle, and half their height."""
        rows = [self._row(k) for k in links]
        height = sum(a + b for a, b in rows)
        y, axes = -height / 2, []
        for above, under in rows:
            axes.append(y + above)
            y += above + under
        return axes, height / 2

    def _is_wall(self, node: Branch) -> bool:
        role = self.plan.bodies[node.body].role
        if node.depth == 0 and not node.children and node.hanging:  # the moved end of a stand
            return False
        return role == "ground" or (role == "base" and (node.depth == 0 or not node.children))

    def _width(self, node: Branch, m: _Measures) -> float:
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

    def _columns(self, nodes: Sequence[Branch]) -> _Columns:
        deepest = max(node.depth for node in nodes)
        widths, zones, entries = [0.0] * (deepest + 1), [0.0] * (deepest + 1), [0] * (deepest + 1)
        for node in nodes:
            widths[node.depth] = max(widths[node.depth], self.measures[node.body].width)
            rows = [k for child in node.children for k in child.bundle]
            rows += [lane.link for lanes in node.lanes for lane in lanes]
            texts = [block_width(lines) for lines in self.pushes.get(node.body, ())]
            texts += [block_width(self.texts[k]) for k in rows]
            if texts:
                zones[node.depth] = max([zones[node.depth], 84.0, *(t + 8 for t in texts)])
            if node.from_left:
                entries[node.depth - 1] += node.from_left
        return _Columns(widths, zones, entries)

    # Places

    def _place(self, root: Branch, middle: float, columns: _Columns) -> None:
        waiting, ordered = [(root, middle)], []
        while waiting:
            node, y = waiting.pop(0)
            ordered.append((node, y))
            self._place_body(node, y, columns)
            centres = self.measures[node.body].centres
            waiting += [(child, y + centre) for child, centre in zip(node.children, centres, strict=True)]
        for node, y in ordered:
            for child, centre in zip(node.children, self.measures[node.body].centres, strict=True):
                for k, axis in zip(child.bundle, self.measures[child.body].bundle, strict=True):
                    end = self._place_level(k, node, y + centre + axis, columns, child.body)
                    right = Point(self.boxes[child.body].left, end.y, child.body)
                    self._wire(end, right, sensor=self.plan.links[k].kind == "sensor")
            self._place_pushes(node, y, columns)
            self._place_hanging(node)
        # The lanes of the nearest bodies arrive first, the highest last: further right at a top.
        for node, y in reversed(ordered):
            for lanes, axes in zip(node.lanes, self.measures[node.body].lanes, strict=True):
                for lane, axis in zip(lanes, axes, strict=True):
                    self._place_lane(lane, node, y + axis, columns)

    def _wire(self, *points: Point, sensor: bool = False) -> None:
        self.wires.append(Wire(points, sensor))

    def _place_body(self, node: Branch, y: float, columns: _Columns) -> None:
        m, body = self.measures[node.body], self.plan.bodies[node.body]
        left, column = columns.left[node.depth], columns.widths[node.depth]
        top, bottom, text_top = y + m.top, y + m.bottom, y - block_height(m.lines) / 2
        points = ", ".join(body.points)
        if self._is_wall(node):
            at_left = node.depth == 0
            x = left + column - WALL if at_left else left
            self.boxes[node.body] = Box(x, top, x + WALL, bottom)
            box = Box(x, top - 4, x + WALL, bottom + 4)
            side = (x - 8, "end") if at_left else (x + WALL + 8, "start")
            texts = stacked(m.lines, side[0], text_top, node.body, side[1])  # type: ignore[arg-type]
            # An upright line, hatched on the side away from the rig within the box
            face, back = (box.right, box.left) if at_left else (box.left, box.right)
            shapes = [stroke(((face, box.top), (face, box.bottom)), "ink", 2.0, body=node.body)]
            count = max(int(box.height / 7.0), 1)  # px between the strokes
            for k in range(count):
                y = box.top + k * box.height / count
                low = min(y + (box.width - 3), box.bottom)
                end = face + (back - face) * (low - y) / box.width, low
                shapes.append(stroke(((face, y), end), "ink", 0.8, body=node.body))
            shapes += self._shaken(body, texts)
            title = f"shaken base {points}" if points else "ground"
            self.walls.append(Part(title, tuple(shapes), _written(texts), box))
            return
        x = left + (column - m.width) / 2
        self.boxes[node.body] = box = Box(x, top, x + m.width, bottom)
        texts = stacked(m.lines, box.centre, text_top, node.body)
        fill = "bar" if body.role == "lever" and not texts else "body"
        shapes = [stroke(box.corners, "ink", 1.6, body=node.body, closed=True, fill=fill)]
        if body.role == "base":
            shapes.append(stroke(box.grown(-3).corners, "ink", 0.8, body=node.body, closed=True))
        shapes += self._shaken(body, texts)
        kind = {"lever": "lever", "base": "shaken base"}.get(body.role, "body")
        self.bodies.append(Part(f"{kind} {points}".strip(), tuple(shapes), _written(texts), box))

    def _shaken(self, body: Body, texts: Sequence[Text]) -> list[Shape]:
        """The double arrow of a motion that is given, in the room above the name of a base."""
        if body.role != "base":
            return []
        room = texts[0]
        x, y = (
            room.at.x + {"start": 18.0, "middle": 0.0, "end": -18.0}[room.anchor],
            room.at.y - 0.3 * ARROW_ROOM,
        )
        shaft = stroke(((x - 12, y), (x + 12, y)), "drive", 1.8, body=room.at.body)
        return [shaft, *(_head(x + 18 * turn, y, turn, room.at.body) for turn in (1.0, -1.0))]

    def _place_level(self, k: int, node: Branch, y: float, columns: _Columns, second: int) -> Point:
        """A link whose symbol lies in the gap right of a node; the end of its symbol, which moves with `second`."""
        x = columns.middle(node.depth)
        start, end = Point(x - SYMBOL / 2, y, node.body), Point(x + SYMBOL / 2, y, second)
        box = Box(start.x, y - HALF, end.x, y + HALF)
        self._symbol(k, start, end, box, stacked(self.texts[k], x, box.top - 1 - block_height(self.texts[k])))
        sensor = self.plan.links[k].kind == "sensor"
        self._wire(Point(self.boxes[node.body].right, y, node.body), start, sensor=sensor)
        return end

    def _symbol(
        self, k: int, start: Point, end: Point, box: Box, texts: tuple[Text, ...], more: Sequence[Shape] = ()
    ) -> None:
        link, length = self.plan.links[k], math.dist(start[:2], end[:2])
        tone: Tone = "ink"
        if link.kind == "element":
            element = self.model.elements[link.item]
            strokes, tone = symbols.symbol_of(element, length), self.labels.knowledge(element)
            title = f"{element.name}: {element.kind}"
        elif link.kind == "rigid":
            strokes, title = symbols.rigid(length), "rigid link"
        else:
            strokes, tone, title = symbols.sensor(length), "sensor", "sensor between two bodies"
        shapes = [symbols.along(one, start, end, tone, WEIGHTS[tone]) for one in strokes]
        self.links.append(Part(title, (*shapes, *more), texts, box))

    def _place_pushes(self, node: Branch, y: float, columns: _Columns) -> None:
        axes = self.measures[node.body].pushes
        for lines, axis in zip(self.pushes.get(node.body, ()), axes, strict=True):
            middle, start, at = columns.middle(node.depth), self.boxes[node.body].right, y + axis
            end = middle + SYMBOL / 2
            shaft = stroke(((start, at), (end - 6, at)), "drive", 2.2, body=node.body)
            texts = stacked(lines, middle, at - 7 - block_height(lines), node.body)
            shapes = (shaft, _head(end, at, 1.0, node.body))
            self.forces.append(Part("force", shapes, _written(texts), Box(start, at - 5, end, at + 5)))

    def _place_hanging(self, node: Branch) -> None:
        box, width = self.boxes[node.body], self._hanging_width(node)
        ground = box.bottom + self._hanging_height(node) - 10
        x = box.centre - width / 2
        if self._is_wall(node):
            x = box.right - width if node.depth == 0 else box.left
        for k in node.hanging:
            lines, axis = self.texts[k], x + HALF + 4
            top = (box.bottom + ground - SYMBOL) / 2
            start, end = Point(axis, top, node.body), Point(axis, top + SYMBOL)
            texts_top = top + (SYMBOL - block_height(lines)) / 2
            texts = stacked(lines, axis + HALF + 5, texts_top, FIXED, "start")
            covered = Box(axis - HALF, start.y, axis + HALF, end.y)
            # The ground: a level line with hatching below
            half, count = 15.0, 5
            shapes = [stroke(((axis - half, ground), (axis + half, ground)), "ink", 1.6)]
            for at in [axis - half + (n + 1) * 2 * half / count for n in range(count)]:
                shapes.append(stroke(((at, ground), (at - 6, ground + 7)), "ink", 0.8))
            self._symbol(k, start, end, covered, texts, shapes)
            self._wire(Point(axis, box.bottom, node.body), start)
            self._wire(end, Point(axis, ground))
            x += self._slot(k)

    def _place_lane(self, lane: Lane, high: Branch, y: float, columns: _Columns) -> None:
        """A link that skips bodies: level above them, then down to the top of the far one or beside it."""
        low = lane.low
        end = self._place_level(lane.link, high, y, columns, low.body)
        key = low.body, lane.above
        number = self.arriving[key] = self.arriving.get(key, 0) + 1
        box, m = self.boxes[low.body], self.measures[low.body]
        if lane.above:
            x = box.left + box.width * number / (low.from_above + 1)
            corners = [(x, y), (x, box.top)]
        else:
            x = columns.entry(low.depth - 1)
            arrival = box.top - m.top + m.bundle_top - ENTRY * (number - 0.5)
            corners = [(x, y), (x, arrival), (box.left, arrival)]
        self._wire(end, *(Point(*corner, low.body) for corner in corners))


def _written(texts: Sequence[Text]) -> tuple[Text, ...]:
    """Texts without the room for an arrow."""
    return tuple(text for text in texts if text.line.text)


def _head(x: float, y: float, direction: float, body: int) -> Shape:
    """The head of an arrow with its tip at (x, y)."""
    back = x - 8 * direction
    return stroke(((x, y), (back, y - 4), (back, y + 4)), "drive", 0.5, body=body, closed=True, fill="ink")
