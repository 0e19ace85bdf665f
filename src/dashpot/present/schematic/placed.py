"""A drawing as plain geometry: what stands where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dashpot.present.schematic.connections import Body, Link
from dashpot.present.schematic.geometry import Anchor, Box, Text

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
