"""Symbols of elements as strokes, and what they are made of: points that move with bodies, boxes, widths of texts."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags

from dashpot.model.elements import Element, Kind

Tone = Literal["ink", "muted", "unknown", "known", "doubtful", "sensor", "drive"]
Side = Literal["start", "middle", "end"]
XY = tuple[float, float]
Shifts = Mapping[int, float]  # body → px to the right

TEXT, SMALL, TITLE = 11.0, 9.5, 14.0  # px
MARGIN = 14.0  # px around a drawing
FIXED = -1  # body of points that never move


class Point(NamedTuple):
    """A place in px, y downwards, that moves with a body; or between two, `share` of the way to the other."""

    x: float
    y: float
    body: int = FIXED
    other: int = FIXED
    share: float = 0.0

    def moved(self, shifts: Shifts) -> Point:
        """Where it is when bodies are shifted."""
        with_one, with_other = shifts.get(self.body, 0.0), shifts.get(self.other, 0.0)
        return self._replace(x=self.x + (1 - self.share) * with_one + self.share * with_other)

    def shifted(self, dx: float, dy: float) -> Point:
        """The same elsewhere."""
        return self._replace(x=self.x + dx, y=self.y + dy)


@dataclass(frozen=True)
class Box:
    """A rectangle, y downwards."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def width(self) -> float:
        """Right minus left."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Bottom minus top."""
        return self.bottom - self.top

    @property
    def centre(self) -> float:
        """Of its width, px from the left."""
        return (self.left + self.right) / 2

    @property
    def corners(self) -> tuple[XY, ...]:
        """One after another."""
        left, top, right, bottom = self.left, self.top, self.right, self.bottom
        return ((left, top), (right, top), (right, bottom), (left, bottom))

    def grown(self, by: float) -> Box:
        """The box with a margin on all sides, negative to shrink it."""
        return Box(self.left - by, self.top - by, self.right + by, self.bottom + by)


@dataclass(frozen=True)
class Line:
    """One line of text; `badge` is a letter in a circle in front of it, as of a sensor."""

    text: str
    tone: Tone = "ink"
    size: float = TEXT
    bold: bool = False
    badge: str = ""

    @property
    def width(self) -> float:
        """Px, at least what it takes in usual fonts."""
        return text_width(self.text, self.size, self.bold) + (16.0 if self.badge else 0.0)

    @property
    def height(self) -> float:
        """Px."""
        return 1.3 * self.size  # line height over size


@dataclass(frozen=True)
class Text:
    """A line of text in its place: the left, middle or right of its baseline."""

    line: Line
    at: Point
    anchor: Side = "start"

    @property
    def box(self) -> Box:
        """What it covers."""
        width = self.line.width
        left = self.at.x - {"start": 0.0, "middle": width / 2, "end": width}[self.anchor]
        return Box(left, self.at.y - 0.8 * self.line.size, left + width, self.at.y + 0.25 * self.line.size)


@dataclass(frozen=True)
class Shape:
    """A stroke with its look; what is filled with "ink" has its own colour."""

    points: tuple[Point, ...]
    tone: Tone
    weight: float = 1.3
    closed: bool = False
    fill: str = ""
    dashed: bool = False


def stroke(
    places: Iterable[XY],
    tone: Tone,
    weight: float = 1.3,
    *,
    body: int = FIXED,
    closed: bool = False,
    fill: str = "",
    dashed: bool = False,
) -> Shape:
    """A stroke through places that all move with one body."""
    return Shape(tuple(Point(x, y, body) for x, y in places), tone, weight, closed, fill, dashed)


@dataclass(frozen=True)
class Part:
    """What belongs together in a drawing, with words for who cannot see it; nothing else may lie over `box`."""

    title: str
    shapes: tuple[Shape, ...]
    texts: tuple[Text, ...] = ()
    box: Box | None = None

    def shifted(self, dx: float, dy: float) -> Part:
        """The part in another place."""
        return self._by(lambda point: point.shifted(dx, dy))

    def moved(self, shifts: Shifts) -> Part:
        """The part when bodies are shifted."""
        return self._by(lambda point: point.moved(shifts))

    def _by(self, move: Callable[[Point], Point]) -> Part:
        shapes = (replace(shape, points=tuple(map(move, shape.points))) for shape in self.shapes)
        texts = (replace(text, at=move(text.at)) for text in self.texts)
        return replace(self, shapes=tuple(shapes), texts=tuple(texts))


def block_width(lines: Sequence[Line]) -> float:
    """Width of lines below each other."""
    return max((line.width for line in lines), default=0.0)


def block_height(lines: Sequence[Line]) -> float:
    """Height of lines below each other."""
    return sum(line.height for line in lines)


def stacked(
    lines: Sequence[Line], x: float, top: float, body: int = FIXED, anchor: Side = "middle"
) -> tuple[Text, ...]:
    """Lines below each other from `top` on."""
    texts, y = [], top
    for line in lines:
        texts.append(Text(line, Point(x, y + 0.8 * line.size + (line.height - line.size) / 2, body), anchor))
        y += line.height
    return tuple(texts)


@lru_cache(maxsize=4096)
def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width in DejaVu Sans, one of the widest of usual fonts; characters that it lacks count as wide as they can be."""
    font = get_font(findfont(FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")))
    font.set_size(100, 72)
    total = 0.0
    for character in text:
        if font.get_char_index(ord(character)):
            total += font.load_char(ord(character), flags=LoadFlags.NO_HINTING).linearHoriAdvance / 65536
        else:
            total += 100.0 if unicodedata.east_asian_width(character) in "WF" else 70.0
    return 1.02 * total * size / 100


def shortened(text: str, longest: int = 26) -> str:
    """A name that is no longer than that."""
    text = " ".join(text.split())
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


H = 8.0  # half height of most symbols


@dataclass(frozen=True)
class Stroke:
    """A line through points (y downwards); `filled` strokes are closed and inked, `light` ones thin."""

    points: tuple[XY, ...]
    closed: bool = False
    filled: bool = False
    light: bool = False


Symbol = Sequence[Stroke]


def along(one: Stroke, start: Point, end: Point, tone: Tone, weight: float) -> Shape:
    """A stroke along the line from start to end, whose points go with both when they move."""
    length = max(math.dist(start[:2], end[:2]), 1e-9)
    c, s = (end.x - start.x) / length, (end.y - start.y) / length
    points = (
        Point(start.x + c * x - s * y, start.y + s * x + c * y, start.body, end.body, x / length)
        for x, y in one.points
    )
    dashed = tone in ("doubtful", "sensor") and not one.filled
    thin = 0.55 * weight if one.light else weight
    return Shape(tuple(points), tone, thin, one.closed, "ink" if one.filled else "", dashed)


def _line(*points: XY, light: bool = False) -> Stroke:
    return Stroke(points, light=light)


def _box(left: float, right: float, half: float = H) -> Stroke:
    return Stroke(((left, -half), (right, -half), (right, half), (left, half)), closed=True)


def spring(length: float) -> Symbol:
    """Zigzag."""
    ends, turns = 6.0, 8
    step = (length - 2 * ends) / turns
    zigzag = [(ends + step * (k + 0.5), H if k % 2 else -H) for k in range(turns)]
    return [_line((0, 0), (ends, 0), *zigzag, (length - ends, 0), (length, 0))]


def damper(length: float) -> Symbol:
    """Dashpot: a cylinder open on one side, and the piston in it."""
    left, right, piston = 0.3 * length, 0.68 * length, 0.5 * length
    return [
        _line((0, 0), (left, 0)),
        _line((right, -H), (left, -H), (left, H), (right, H)),
        _line((piston, -H + 2.5), (piston, H - 2.5)),
        _line((piston, 0), (length, 0)),
    ]


def inerter(length: float) -> Symbol:
    """A box with a flywheel."""
    left, right, middle = 0.28 * length, 0.72 * length, length / 2
    return [
        _line((0, 0), (left, 0)),
        _line((right, 0), (length, 0)),
        _box(left, right),
        _circle(middle, 0, 5.5),
        _line((middle - 5.5, 0), (middle + 5.5, 0), light=True),
        _line((middle, -5.5), (middle, 5.5), light=True),
    ]


def box(length: float) -> Symbol:
    """A box: an element of a kind that has no symbol of its own."""
    left, right = 0.26 * length, 0.74 * length
    return [_line((0, 0), (left, 0)), _line((right, 0), (length, 0)), _box(left, right)]


def hysteretic_symbol(length: float) -> Symbol:
    """A box with a hysteresis loop."""
    middle = length / 2
    loop = []
    for k in range(24):
        angle = 2 * math.pi * k / 24
        x, y = 9.5 * math.cos(angle), 2.6 * math.sin(angle)
        loop.append((middle + 0.87 * x + 0.5 * y, -0.5 * x + 0.87 * y))
    return [*box(length), Stroke(tuple(loop), closed=True)]


def slider(length: float) -> Symbol:
    """Dry friction: a block between two surfaces that rub."""
    left, right = 0.34 * length, 0.6 * length
    surface = [_line((0.22 * length, side * H), (0.78 * length, side * H)) for side in (-1, 1)]
    return [
        _line((0, 0), (left, 0)),
        _box(left, right, 5.0),
        *surface,
        _line((0.78 * length, -H), (0.78 * length, H)),
        _line((0.78 * length, 0), (length, 0)),
        _line((left, 5), (left + 3, H), light=True),
        _line((left + 7, 5), (left + 10, H), light=True),
        _line((left, -5), (left + 3, -H), light=True),
        _line((left + 7, -5), (left + 10, -H), light=True),
    ]


def spring_and_slider(length: float) -> Symbol:
    """A spring in series with dry friction: the Jenkins element."""
    half = length / 2
    moved = (replace(one, points=tuple((x + half, y) for x, y in one.points)) for one in slider(half))
    return [*spring(half), *moved]


def gap(length: float) -> Symbol:
    """A spring that ends before a stop."""
    stop = 0.82 * length
    return [
        *spring(0.66 * length),
        _line((0.66 * length, -H), (0.66 * length, H)),
        _line((stop, -H), (stop, H)),
        _line((stop, 0), (length, 0)),
    ]


def play(length: float) -> Symbol:
    """Backlash: a pin with play in a fork."""
    return [
        _line((0, 0), (0.3 * length, 0)),
        _line((0.75 * length, -H), (0.3 * length, -H), (0.3 * length, H), (0.75 * length, H)),
        _line((0.75 * length, -H), (0.75 * length, -3)),
        _line((0.75 * length, H), (0.75 * length, 3)),
        _line((0.52 * length, -H + 2.5), (0.52 * length, H - 2.5)),
        _line((0.52 * length, 0), (length, 0)),
    ]


def rigid(length: float) -> Symbol:
    """A rigid link with a pin at its end."""
    return [_line((0, 0), (length - 5, 0)), _circle(length - 2.5, 0, 2.5)]


def sensor(length: float) -> Symbol:
    """A sensor between two bodies: a line, which is drawn broken."""
    return [_line((0, 0), (length, 0))]


def nonlinear_symbol(symbol: Symbol, length: float) -> Symbol:
    """The symbol with the slanting arrow of what is not constant."""
    a, b = (0.3 * length, H + 3), (0.72 * length, -H - 3)
    slope = math.atan2(b[1] - a[1], b[0] - a[0])
    head = [
        b,
        (b[0] - 7 * math.cos(slope - 0.4), b[1] - 7 * math.sin(slope - 0.4)),
        (b[0] - 7 * math.cos(slope + 0.4), b[1] - 7 * math.sin(slope + 0.4)),
    ]
    return [*symbol, _line(a, b, light=True), Stroke(tuple(head), closed=True, filled=True)]


def _circle(x: float, y: float, radius: float) -> Stroke:
    count = 20
    points = [
        (x + radius * math.cos(2 * math.pi * k / count), y + radius * math.sin(2 * math.pi * k / count))
        for k in range(count)
    ]
    return Stroke(tuple(points), closed=True)


_LINEAR: Mapping[Kind, Callable[[float], Symbol]] = {
    Kind.SPRING: spring,
    Kind.DAMPER: damper,
    Kind.INERTER: inerter,
    Kind.HYSTERETIC: hysteretic_symbol,
    Kind.MASS: inerter,
}
_NAMED: Mapping[str, Callable[[float], Symbol]] = {
    "coulomb": slider,
    "stribeck": slider,
    "jenkins": spring_and_slider,
    "bouc-wen": spring_and_slider,
    "gap": gap,
    "one-sided": gap,
    "backlash": play,
}


def symbol_of(element: Element, length: float) -> Symbol:
    """The strokes of an element: its own symbol where its law has one, else that of its kind with an arrow."""
    linear = _LINEAR.get(element.kind, box)(length)
    if element.force_law is None:
        return linear
    named = _NAMED.get(element.force_law.text.strip().lower())
    return nonlinear_symbol(linear, length) if named is None else named(length)
