"""A wide drawing cut into rows below each other, so that its texts can be read on a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from dashpot.present.schematic.placed import MARGIN
from dashpot.present.schematic.scene import Part, Shape
from dashpot.present.schematic.symbols import XY

WIDEST = 960.0  # px of a row: on a page of A4 its texts have six points
BETWEEN = 26.0  # px from one row to the next
CLEAR = 3.0  # px around whatever is not cut
MARK = 5.0  # half the height of the stroke that marks a cut line


@dataclass(frozen=True)
class _Window:
    """What of the drawing a row shows, px from its left."""

    left: float
    right: float


def folded(drawn: Sequence[Part], width: float, height: float) -> tuple[list[Part], float, float]:
    """The parts in rows of at most about WIDEST, and the width and height of them all.

    Cut are level lines between symbols alone, and each cut is marked at both ends.  What is narrow enough stays as it
    is.
    """
    cuts = _cuts(_uncut(drawn), width)
    if not cuts:
        return list(drawn), width, height
    ends = [0.0, *cuts, width]
    parts: list[Part] = []
    below = 0.0
    for row, (left, right) in enumerate(pairwise(ends)):
        content = [_within(part, _Window(left, right)) for part in drawn]
        heights = [y for part in content for y in _heights(part)]
        top, bottom = min(heights, default=0.0) if row else 0.0, max(heights, default=0.0)
        dx = MARGIN - left if row else 0.0
        parts += [part.shifted(dx, below - top) for part in content if part.shapes or part.texts]
        below += bottom - top + BETWEEN
    wide = max(right - left for left, right in pairwise(ends))
    return parts, wide + 2 * MARGIN, below - BETWEEN + MARGIN


def _cuts(uncut: Sequence[tuple[float, float]], width: float) -> list[float]:
    """Where to cut, px from the left: rows of about the same width."""
    if width <= WIDEST:
        return []
    spans = sorted(uncut)
    free, reach = [], 0.0
    for left, right in spans:
        if left > reach:
            free.append((reach + left) / 2)
        reach = max(reach, right)
    rows = int(-(-width // WIDEST))
    cuts: list[float] = []
    for row in range(1, rows):
        after = cuts[-1] if cuts else 0.0
        wanted = after + (width - after) / (rows - row + 1)
        possible = [x for x in free if x > after + WIDEST / 4]
        if possible:
            cuts.append(min(possible, key=lambda x: abs(x - wanted)))
    return cuts


def _uncut(drawn: Sequence[Part]) -> list[tuple[float, float]]:
    """Spans, px from the left, in which nothing is cut: symbols, bodies, texts and upright lines."""
    spans = []
    for part in drawn:
        spans += [(text.box.left, text.box.right) for text in part.texts]
        upright = [
            x
            for shape in part.shapes
            for a, b in pairwise(shape.points)
            if shape.closed or a[1] != b[1]
            for x in (a[0], b[0])
        ]
        if part.title and upright:
            spans.append((min(upright), max(upright)))
        spans += [(x, x) for x in upright]
    return [(left - CLEAR, right + CLEAR) for left, right in spans]


def _within(part: Part, window: _Window) -> Part:
    """What of a part lies in a window, with marks where lines are cut."""
    shapes = [piece for shape in part.shapes for piece in _pieces(shape, window)]
    texts = [text for text in part.texts if window.left <= text.box.centre[0] < window.right]
    return Part(part.title, tuple(shapes), tuple(texts))


def _pieces(shape: Shape, window: _Window) -> Iterator[Shape]:
    left, right = min(x for x, _ in shape.points), max(x for x, _ in shape.points)
    if window.left <= left and right <= window.right:
        yield shape
        return
    run: list[XY] = []
    for (x0, y0), (x1, y1) in pairwise(shape.points):
        if max(x0, x1) <= window.left or min(x0, x1) >= window.right:
            continue
        start, end = (min(max(x, window.left), window.right) for x in (x0, x1))
        if run[-1:] != [(start, y0)]:
            if run:
                yield replace(shape, points=tuple(run))
            run = [(start, y0)]
        run.append((end, y1))
        for x, clipped in ((x0, start), (x1, end)):
            if x != clipped:
                mark = ((clipped - 2, y0 + MARK), (clipped + 2, y0 - MARK))
                yield replace(shape, points=mark, weight=1.0, dashed=False)
    if run:
        yield replace(shape, points=tuple(run))


def _heights(part: Part) -> Iterator[float]:
    for shape in part.shapes:
        yield from (y for _, y in shape.points)
    for text in part.texts:
        yield from (text.box.top, text.box.bottom)
