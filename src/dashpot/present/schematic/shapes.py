"""What drawings are made of: points that move with bodies, boxes, strokes and texts; widths of texts."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, NamedTuple

from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags

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
        return self._with([tuple(p.shifted(dx, dy) for p in s.points) for s in self.shapes], dx, dy)

    def moved(self, shifts: Shifts) -> Part:
        """The part when bodies are shifted."""
        points = [tuple(point.moved(shifts) for point in shape.points) for shape in self.shapes]
        texts = tuple(replace(text, at=text.at.moved(shifts)) for text in self.texts)
        return replace(self._with(points), texts=texts)

    def _with(self, points: Sequence[tuple[Point, ...]], dx: float = 0.0, dy: float = 0.0) -> Part:
        shapes = tuple(replace(shape, points=one) for shape, one in zip(self.shapes, points, strict=True))
        texts = tuple(replace(text, at=text.at.shifted(dx, dy)) for text in self.texts)
        return replace(self, shapes=shapes, texts=texts)


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
