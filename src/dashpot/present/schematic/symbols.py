"""Symbols of elements as strokes, drawn from the origin along x over a length; the field's usual ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from dashpot.model.elements import Element, Kind
from dashpot.present.schematic.shapes import XY, Point, Shape, Tone

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
    moved = [
        Stroke(tuple((x + half, y) for x, y in stroke.points), stroke.closed, stroke.filled, stroke.light)
        for stroke in slider(half)
    ]
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
