"""Plain geometry of drawings: points that move with a body, boxes, wires, texts; widths of texts."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.ft2font import LoadFlags

from dashpot.present.schematic.connections import Body, Link

Tone = Literal["ink", "muted", "unknown", "known", "doubtful", "sensor", "drive"]

TEXT, SMALL, TITLE = 11.0, 9.5, 14.0  # px
LEADING = 1.3  # line height over size
FIXED = -1  # body of points that never move


@dataclass(frozen=True)
class Anchor:
    """A place in px, y downwards, that moves with a body (its index) or is FIXED."""

    x: float
    y: float
    body: int = FIXED

    def moved(self, shifts: Mapping[int, float]) -> tuple[float, float]:
        """Where it is when bodies are shifted to the right by `shifts` (px)."""
        return self.x + shifts.get(self.body, 0.0), self.y


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
    def centre(self) -> tuple[float, float]:
        """The middle."""
        return (self.left + self.right) / 2, (self.top + self.bottom) / 2

    def grown(self, by: float) -> Box:
        """The box with a margin on all sides, negative to shrink it."""
        return Box(self.left - by, self.top - by, self.right + by, self.bottom + by)

    def overlaps(self, other: Box) -> bool:
        """Whether the two share an area."""
        apart = (
            self.right <= other.left
            or other.right <= self.left
            or self.bottom <= other.top
            or other.bottom <= self.top
        )
        return not apart

    def contains(self, other: Box) -> bool:
        """Whether the other lies inside."""
        return (
            self.left <= other.left
            and self.top <= other.top
            and other.right <= self.right
            and other.bottom <= self.bottom
        )

    def meets(self, a: tuple[float, float], b: tuple[float, float]) -> bool:
        """Whether a horizontal or vertical segment enters the box."""
        return self.overlaps(
            Box(
                min(a[0], b[0]) - 1e-9, min(a[1], b[1]) - 1e-9, max(a[0], b[0]) + 1e-9, max(a[1], b[1]) + 1e-9
            )
        )


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
        return LEADING * self.size


@dataclass(frozen=True)
class Text:
    """A line of text in its place: (x, y) is the left, middle or right of its baseline."""

    line: Line
    at: Anchor
    anchor: Literal["start", "middle", "end"] = "start"

    @property
    def box(self) -> Box:
        """What it covers."""
        width = self.line.width
        left = self.at.x - {"start": 0.0, "middle": width / 2, "end": width}[self.anchor]
        return Box(left, self.at.y - 0.8 * self.line.size, left + width, self.at.y + 0.25 * self.line.size)

    def shifted(self, dx: float, dy: float) -> Text:
        """The same elsewhere."""
        return replace(self, at=replace(self.at, x=self.at.x + dx, y=self.at.y + dy))


def block_width(lines: Sequence[Line]) -> float:
    """Width of lines below each other."""
    return max((line.width for line in lines), default=0.0)


def block_height(lines: Sequence[Line]) -> float:
    """Height of lines below each other."""
    return sum(line.height for line in lines)


def stacked(
    lines: Sequence[Line],
    x: float,
    top: float,
    body: int = FIXED,
    anchor: Literal["start", "middle", "end"] = "middle",
) -> list[Text]:
    """Lines below each other from `top` on."""
    texts, y = [], top
    for line in lines:
        texts.append(Text(line, Anchor(x, y + 0.8 * line.size + (line.height - line.size) / 2, body), anchor))
        y += line.height
    return texts


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


# A drawing as plain geometry: what stands where.


ENTRY = 13.0  # px between lines that arrive beside each other
LEAD = 9.0  # least length of the line on either side of a symbol
MARGIN = 14.0


@dataclass(frozen=True)
class PlacedBody:
    """A body with its texts; the box of a wall is the hatched strip."""

    index: int
    body: Body
    box: Box
    texts: tuple[Text, ...]
    wall: bool = False
    hatched: str = ""  # side of a wall that is hatched


@dataclass(frozen=True)
class PlacedLink:
    """A symbol between two points with its texts; `box` is what it covers, `ground` where it is held, if it is."""

    link: Link
    start: Anchor
    end: Anchor
    box: Box
    texts: tuple[Text, ...]
    ground: float | None = None


@dataclass(frozen=True)
class Arrow:
    """A force that pushes a body."""

    start: Anchor
    end: Anchor
    texts: tuple[Text, ...]

    @property
    def box(self) -> Box:
        """What it covers."""
        return Box(self.start.x, self.start.y - 5, self.end.x, self.start.y + 5)


@dataclass(frozen=True)
class Wire:
    """A rigid line through points, drawn with bumps over the lines that it crosses."""

    points: tuple[Anchor, ...]
    hops: tuple[tuple[float, float], ...] = ()
    sensor: bool = False

    def segments(self) -> list[tuple[Anchor, Anchor]]:
        """Its straight parts."""
        return list(zip(self.points, self.points[1:], strict=False))


@dataclass(frozen=True)
class Layout:
    """A drawing as plain geometry, px."""

    width: float
    height: float
    bodies: tuple[PlacedBody, ...]
    links: tuple[PlacedLink, ...]
    arrows: tuple[Arrow, ...]
    wires: tuple[Wire, ...]

    def texts(self) -> list[Text]:
        """All texts."""
        by_part = [part.texts for part in self.bodies]
        by_part += [part.texts for part in self.links] + [part.texts for part in self.arrows]
        return [text for texts in by_part for text in texts]


class ColumnPlaces:
    """Where columns of bodies, zones of symbols and vertical lines lie, px from the left."""

    def __init__(self, widths: Sequence[float], zones: Sequence[float], entries: Sequence[int]) -> None:
        self.widths = widths
        self._lefts, self._zones, self._next = [], [], []
        x = MARGIN
        for width, zone, count in zip(widths, zones, entries, strict=True):
            self._lefts.append(x)
            x += width + LEAD
            self._zones.append((x, x + zone))
            x += zone
            self._next.append(x + ENTRY / 2)
            x += LEAD + ENTRY * count
        self.right = x

    def left(self, depth: int) -> float:
        """Of the column of bodies."""
        return self._lefts[depth]

    def zone(self, depth: int) -> tuple[float, float]:
        """Of the symbols right of that column."""
        return self._zones[depth]

    def entry(self, depth: int) -> float:
        """A place for one more vertical line right of that zone."""
        x = self._next[depth]
        self._next[depth] += ENTRY
        return x


def with_hops(wires: Sequence[Wire]) -> list[Wire]:
    """The wires, each with the places where its upright parts cross level parts of others."""
    level = [(a, b, k) for k, wire in enumerate(wires) for a, b in wire.segments() if a.y == b.y]
    hopping = []
    for k, wire in enumerate(wires):
        hops = [
            (a.x, c.y)
            for a, b in wire.segments()
            if a.x == b.x
            for c, d, other in level
            if other != k and min(c.x, d.x) < a.x < max(c.x, d.x) and min(a.y, b.y) < c.y < max(a.y, b.y)
        ]
        hopping.append(replace(wire, hops=tuple(hops)))
    return hopping
