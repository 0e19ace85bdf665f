"""A layout as strokes and texts, at rest or with its bodies shifted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dashpot.model.network import Model
from dashpot.present.schematic import symbols
from dashpot.present.schematic.geometry import Arrow, Box, Layout, PlacedBody, PlacedLink, Text, Tone, Wire
from dashpot.present.schematic.layout import ARROW_ROOM, Labels
from dashpot.present.schematic.symbols import XY, Stroke

HATCH = 7.0  # between the strokes of a hatched side
HOP = 3.5  # radius of a bump over a line

Shifts = Mapping[int, float]


@dataclass(frozen=True)
class Shape:
    """A stroke in its place with its look; `fill` "paper" hides what is behind it, "ink" is its own colour."""

    points: tuple[XY, ...]
    tone: Tone
    weight: float = 1.3
    closed: bool = False
    fill: str = ""
    dashed: bool = False


@dataclass(frozen=True)
class Part:
    """What belongs together in a drawing, with words for who cannot see it."""

    title: str
    shapes: tuple[Shape, ...]
    texts: tuple[Text, ...] = ()

    def shifted(self, dx: float, dy: float) -> Part:
        """The part in another place."""
        shapes = tuple(
            replace(shape, points=tuple((x + dx, y + dy) for x, y in shape.points)) for shape in self.shapes
        )
        return Part(self.title, shapes, tuple(text.shifted(dx, dy) for text in self.texts))


def scene_parts(
    layout: Layout, model: Model, labels: Labels, shifts: Shifts | None = None, *, texts: bool = True
) -> list[Part]:
    """Everything that is drawn, from back to front; the same number of parts and shapes for any shifts."""
    moved: Shifts = {} if shifts is None else shifts
    parts = [Part("", tuple(_wire(wire, moved) for wire in layout.wires))]
    parts += [_link(link, model, labels, moved, texts) for link in layout.links]
    parts += [_body(body, moved, texts) for body in layout.bodies]
    parts += [_arrow(arrow, moved, texts) for arrow in layout.arrows]
    return parts


def _wire(wire: Wire, shifts: Shifts) -> Shape:
    points = [wire.points[0].moved(shifts)]
    for point in wire.points[1:]:
        last, to = points[-1], point.moved(shifts)
        crossed = sorted((hop[1] for hop in wire.hops if hop[0] == to[0] == last[0]), reverse=to[1] < last[1])
        down = 1.0 if to[1] > last[1] else -1.0
        for y in crossed:
            points += [
                (
                    to[0] + HOP * math.sin(math.pi * k / 8),
                    y - down * HOP * math.cos(math.pi * k / 8),
                )
                for k in range(9)
            ]
        points.append(to)
    return (
        Shape(tuple(points), "sensor", 1.0, dashed=True) if wire.sensor else Shape(tuple(points), "ink", 1.2)
    )


def _link(link: PlacedLink, model: Model, labels: Labels, shifts: Shifts, texts: bool) -> Part:
    start, end = link.start.moved(shifts), link.end.moved(shifts)
    length = math.dist(start, end)
    tone: Tone = "ink"
    if link.link.kind == "element":
        element = model.elements[link.link.item]
        strokes, tone = symbols.symbol_of(element, length), labels.knowledge(element)
        title = f"{element.name}: {element.kind}"
    elif link.link.kind == "rigid":
        strokes, title = symbols.rigid(length), "rigid link"
    else:
        strokes, tone, title = symbols.sensor(length), "sensor", "sensor between two bodies"
    weight = {"unknown": 2.0, "doubtful": 2.0, "ink": 2.4, "sensor": 1.0}.get(tone, 1.2)
    shapes = [_placed(stroke, start, end, tone, weight) for stroke in strokes]
    if link.ground is not None:
        shapes += _ground(end[0], link.ground)
    return Part(title, tuple(shapes), link.texts if texts else ())


def _placed(stroke: Stroke, start: XY, end: XY, tone: Tone, weight: float) -> Shape:
    """A stroke along the line from start to end."""
    length = max(math.dist(start, end), 1e-9)
    c, s = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    points = tuple((start[0] + c * x - s * y, start[1] + s * x + c * y) for x, y in stroke.points)
    thin = 0.55 * weight if stroke.light else weight
    fill = "ink" if stroke.filled else ""
    dashed = tone in ("doubtful", "sensor") and not stroke.filled
    return Shape(points, tone, thin, stroke.closed, fill, dashed)


def _ground(x: float, y: float) -> list[Shape]:
    """A level line with hatching below, its middle at (x, y)."""
    half = 15.0
    shapes = [Shape(((x - half, y), (x + half, y)), "ink", 1.6)]
    count = 5
    for k in range(count):
        at = x - half + (k + 1) * 2 * half / count
        shapes.append(Shape(((at, y), (at - 6, y + 7)), "ink", 0.8))
    return shapes


def _body(body: PlacedBody, shifts: Shifts, texts: bool) -> Part:
    dx = shifts.get(body.index, 0.0)
    box = Box(body.box.left + dx, body.box.top, body.box.right + dx, body.box.bottom)
    moved = tuple(text.shifted(dx, 0.0) for text in body.texts) if texts else ()
    moved = tuple(text for text in moved if text.line.text)
    if body.wall:
        shapes = _wall(box, body.hatched)
        if body.body.role == "base":
            shapes += _shaken(body, dx)
        title = f"shaken base {', '.join(body.body.points)}" if body.body.points else "ground"
        return Part(title, tuple(shapes), moved)
    fill = "bar" if body.body.role == "lever" and not body.texts else "body"
    outline = Shape(corners(box), "ink", 1.6, True, fill)
    shapes = [outline]
    if body.body.role == "base":
        shapes += [Shape(corners(box.grown(-3)), "ink", 0.8, True), *_shaken(body, dx)]
    kind = {"lever": "lever", "base": "shaken base"}.get(body.body.role, "body")
    return Part(f"{kind} {', '.join(body.body.points)}".strip(), tuple(shapes), moved)


def corners(box: Box) -> tuple[XY, ...]:
    """Of a box, one after another."""
    return ((box.left, box.top), (box.right, box.top), (box.right, box.bottom), (box.left, box.bottom))


def _wall(box: Box, side: str) -> list[Shape]:
    """An upright line, hatched on one side within the box."""
    face, back = (box.right, box.left) if side == "left" else (box.left, box.right)
    shapes = [Shape(((face, box.top), (face, box.bottom)), "ink", 2.0)]
    count = max(int(box.height / HATCH), 1)
    for k in range(count):
        y = box.top + k * box.height / count
        low = min(y + (box.width - 3), box.bottom)
        shapes.append(Shape(((face, y), (face + (back - face) * (low - y) / box.width, low)), "ink", 0.8))
    return shapes


def _shaken(body: PlacedBody, dx: float) -> list[Shape]:
    """The double arrow of a motion that is given, in the room above the name."""
    room = next(text for text in body.texts if not text.line.text)
    x = room.at.x + dx + {"start": 18.0, "middle": 0.0, "end": -18.0}[room.anchor]
    y = room.at.y - 0.3 * ARROW_ROOM
    shaft = Shape(((x - 12, y), (x + 12, y)), "drive", 1.8)
    return [shaft, _head((x + 18, y), 1.0), _head((x - 18, y), -1.0)]


def _head(tip: XY, direction: float) -> Shape:
    x, y = tip
    back = x - 8 * direction
    return Shape(((x, y), (back, y - 4), (back, y + 4)), "drive", 0.5, True, "ink")


def _arrow(arrow: Arrow, shifts: Shifts, texts: bool) -> Part:
    start, end = arrow.start.moved(shifts), arrow.end.moved(shifts)
    dx = end[0] - arrow.end.x
    moved = tuple(text.shifted(dx, 0.0) for text in arrow.texts) if texts else ()
    shaft = Shape((start, (end[0] - 6, end[1])), "drive", 2.2)
    return Part("force", (shaft, _head(end, 1.0)), moved)


def visible(shapes: Sequence[Shape]) -> Box:
    """What shapes cover."""
    points = [point for shape in shapes for point in shape.points]
    return Box(
        min(x for x, _ in points),
        min(y for _, y in points),
        max(x for x, _ in points),
        max(y for _, y in points),
    )
