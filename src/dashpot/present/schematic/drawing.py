"""The drawing of a rig, with the values of an estimate and its modes, shown and as files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape as escaped
from itertools import accumulate, chain, pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.check.evidence import doubtful as doubtful_of
from dashpot.data.modal_data import at_coordinates
from dashpot.errors import UsageError, printable
from dashpot.estimate.result import Estimate
from dashpot.free.modes import MeasuredModes
from dashpot.io.atomic import write_bytes
from dashpot.io.words import PICTURES, chosen_format
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from dashpot.present.document import Picture
from dashpot.present.estimate import aperiodic_in_words
from dashpot.present.figures.style import DPI, style
from dashpot.present.schematic.bodies import Connections, connections, forest
from dashpot.present.schematic.placing import BADGES, Knowledge, Labels, Placed, Placer, labels
from dashpot.present.schematic.symbols import (
    MARGIN,
    SMALL,
    TITLE,
    Line,
    Part,
    Point,
    Shape,
    Text,
    Tone,
    block_width,
    stroke,
)
from dashpot.present.words import sentence, short, value_and_sd


@dataclass(frozen=True)
class Drawing:
    """A drawing of a rig: plain geometry, and what is drawn of it, with title and legend.

    frames  of one period of a mode, the first at its largest; one where nothing moves
    words   every element with what it joins and its value, for who cannot see it
    """

    title: str
    model: Model
    placed: Placed
    frames: tuple[tuple[Part, ...], ...]
    width: float
    height: float
    words: str = ""

    @property
    def parts(self) -> tuple[Part, ...]:
        """What is drawn of the first frame."""
        return self.frames[0]

    def svg(self) -> str:
        """As SVG, whose texts can be searched, and whose modes move by themselves."""
        return svg_document(self.frames, self.width, self.height, self.title, self.words)

    def _repr_svg_(self) -> str:
        """The same, for a notebook."""
        return self.svg()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as .svg, or as .png or .pdf of its first frame.  Raises UsageError, DataError."""
        kind = chosen_format(path, PICTURES)
        if kind == "svg":
            write_bytes(path, self.svg().encode())
        else:
            write_bytes(path, raster(self.parts, self.width, self.height, self.title, kind))


def schematic(
    model: Model,
    channels: Sequence[Channel] = (),
    estimate: Estimate | None = None,
    doubtful: Collection[str] = (),
    level: float = 0.95,
) -> Drawing:
    """The rig in the field's symbols; with values and intervals of an estimate where there is one.

    `doubtful` names parameters that are marked as such.  Of more than 60 elements only the kinds and names
    are drawn.  Raises UsageError if there are too many bodies for a drawing.
    """
    model, channels = model.alone, [channel for channel in channels if channel.only is None]
    parts = _few_bodies(model, channels)
    small = len(model.elements) <= 60
    between = [link.item for link in parts.links if link.kind == "sensor"]
    said = labels(model, channels if small else (), estimate, doubtful, between, level, numbers=small)
    placed = Placer(model, forest(model, parts), parts.pushes, said).placed()
    note = "" if small else f"{len(model.elements)} elements: values are left out."
    if parts.free:
        note = sentence("Entries of matrices are not elements and are not drawn")
    rows, wide, high = folded(placed.parts, placed.width, placed.height)
    heading, width, head = titled(rows, model.name, wide)
    legend, height = _legend(said, estimate is not None, level, note, width, head + high)
    texts = []
    for element in model.elements:
        if element.free or element.block is not None:
            continue
        points = [*element.along, *(["ground"] if len(element.along) == 1 and element.kind != "mass" else [])]
        known, value, interval = said.values[element.name]
        of = f"{element.name}, {element.kind} of {' and '.join(points)}: {known}"
        texts.append(of + (f", {value}" if value != "?" else "") + (f" ({interval})" if interval else ""))
    frames = ((*heading, legend),)
    return Drawing(model.name or "Rig", model, placed, frames, width, height, "; ".join(texts))


def _few_bodies(model: Model, channels: Sequence[Channel] = ()) -> Connections:
    """What a rig consists of.  Raises UsageError if there are too many bodies for a drawing."""
    found = connections(model, channels)
    if len(found.bodies) > 40:
        raise UsageError(
            f"{len(found.bodies)} bodies are too many for a drawing (at most 40)",
            cure="draw a part of the rig",
        )
    return found


def rig_picture(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate | None = None,
    unsure: Collection[str] | None = None,
    level: float = 0.95,
) -> Picture | None:
    """The drawing of the rig for a page; None if it is too large for one.

    `unsure` names the doubtful parameters: without it those of the estimate whose intervals say little.
    """
    if unsure is None:
        unsure = () if estimate is None else doubtful_of(estimate, level)
    try:
        drawing = schematic(model, channels, estimate, unsure, level)
    except UsageError:
        return None
    # px of a drawing that still has room next to the parameters
    return Picture(drawing.svg(), drawing.title, wide=drawing.width > 640.0)


def true_rig_picture(model: Model, theta: Real, channels: Sequence[Channel]) -> Picture | None:
    """The drawing of a rig with its true values θ (unknowns,), without an estimate."""
    true = {unknown.name: float(value) for unknown, value in zip(model.unknowns, theta, strict=True)}
    elements = tuple(replace(each, value=true.get(each.name, each.value), sd=None) for each in model.elements)
    return rig_picture(replace(model, elements=elements), channels)


# Modes on the drawing of a rig: bodies move sideways as the mode has them.


FRAMES = 16  # of one period of a mode


def numbered_mode(model: Model, estimate: Estimate | None, number: int) -> tuple[str, Complex]:
    """Title and shape (coordinates,) of a mode, 1 the slowest: of an estimate, or of the values that the rig states.

    Raises ModelError if the rig states no value, UsageError if there is no such mode.
    """
    if estimate is None:
        stated = eigenmodes(model, model.parameters(model.theta({})))
        eigenvalues, shapes = stated.eigenvalues, stated.shapes
        frequencies, ratios = stated.frequency_hz, stated.damping_ratio
    else:
        found = estimate.modes
        if found is None or found.shapes.shape[-1] != model.n:
            raise UsageError(
                "the estimate has no modes of this rig", cure="give the rig file that it was made with"
            )
        eigenvalues, shapes = found.eigenvalues, found.shapes
        frequencies, ratios = found.frequency_hz, found.damping_ratio
    if number > len(eigenvalues):
        raise UsageError(
            f"there is no mode {number}", cure=f"modes are numbered from 1 to {len(eigenvalues)}"
        )
    k = number - 1
    if eigenvalues[k].imag == 0:
        return f"Mode {number}: {aperiodic_in_words(float(eigenvalues[k].real))}", shapes[k]
    title = f"Mode {number}: {short(float(frequencies[k]), 4)} Hz, damping ratio {short(float(ratios[k]), 3)}"
    return title, shapes[k]


def measured_modes_drawing(
    model: Model, channels: Sequence[Channel], found: MeasuredModes, number: int | None = None
) -> Drawing:
    """Measured shapes on the drawing of a rig: mode `number`, or all below each other.  What was not measured rests.

    Raises UsageError if there is no such mode or there are too many bodies, DataError for points that the rig has
    not.
    """
    data = at_coordinates(found.modal_data, model.coordinates, channels)
    if number is not None and number > data.modes:
        raise UsageError(f"there is no mode {number}", cure=f"modes are numbered from 1 to {data.modes}")
    at = [model.coordinates.index(point) for point in data.points]
    drawings = []
    for k in range(data.modes) if number is None else (number - 1,):
        shape = np.zeros(model.n, dtype=np.complex128)
        shape[at] = data.shapes[k]
        hz, sd = value_and_sd(float(data.frequency_hz[k]), float(found.frequency_sd[k]))
        ratio, ratio_sd = value_and_sd(float(data.damping_ratio[k]), float(found.damping_sd[k]))
        title = f"Mode {k + 1}: {hz} ± {sd} Hz, damping ratio {ratio} ± {ratio_sd}"
        drawings.append(mode_drawing(model, shape, title))
    tops = [0.0, *accumulate(each.height for each in drawings)]
    frames = (
        tuple(
            part.shifted(0, top) for each, top in zip(drawings, tops, strict=False) for part in each.frames[i]
        )
        for i in range(FRAMES)
    )
    title = drawings[0].title if len(drawings) == 1 else f"{len(drawings)} measured modes"
    wide = max(each.width for each in drawings)
    return replace(drawings[0], title=title, frames=tuple(frames), width=wide, height=tops[-1])


def mode_drawing(model: Model, shape: Complex, title: str) -> Drawing:
    """A mode of shape (coordinates,) on the drawing of the rig, with the bodies at rest behind; angles and
    displacements each to their own scale.

    Raises UsageError if there are too many bodies for a drawing.
    """
    connected = _few_bodies(model)
    said = labels(model, (), None, (), numbers=False)
    placed = Placer(model, forest(model, connected), (), said).placed()
    at = dict(zip(model.coordinates, (complex(z) for z in shape.tolist()), strict=True))
    largest = {
        angular: max((abs(z) for name, z in at.items() if (name in model.angles) is angular), default=0.0)
        for angular in (True, False)
    }
    motion: dict[int, complex] = {}
    for index, body in enumerate(connected.bodies):
        moving = [point for point in body.points if point in at]
        point = next((point for point in moving if point not in model.angles), moving[0] if moving else None)
        if point is not None:
            size = largest[point in model.angles]
            motion[index] = 18.0 * at[point] / size if size > 0 else 0j  # px that the furthest body moves
    for index, body in enumerate(connected.bodies):
        if body.along:
            motion[index] = sum((factor * motion.get(other, 0j) for other, factor in body.along), 0j)
    # Outlines of the bodies where they rest, and all parts without the marks of what is known: a mode is of values.
    outlines = [
        stroke(part.box.corners, "muted", 0.8, closed=True, dashed=True) for part in placed.bodies if part.box
    ]
    drawn = []
    for part in placed.parts:
        shapes = tuple(
            replace(shape, tone="ink", weight=min(shape.weight, 1.6))
            if shape.tone in ("unknown", "known")
            else shape
            for shape in part.shapes
        )
        drawn.append(replace(part, shapes=shapes))
    frames = []
    for k in range(FRAMES):
        turn = complex(math.cos(2 * math.pi * k / FRAMES), math.sin(2 * math.pi * k / FRAMES))
        shifts = {body: (z * turn).real for body, z in motion.items()}
        moved = [Part("at rest", tuple(outlines)), *(part.moved(shifts) for part in drawn)]
        parts, width, head = titled(moved, title, placed.width)
        frames.append(tuple(parts))
    return Drawing(title, model, placed, tuple(frames), width, head + placed.height)


# A wide drawing cut into rows below each other, so that its texts can be read on a page.


WIDEST = 960.0  # px of a row: on a page of A4 its texts have six points


def folded(drawn: Sequence[Part], width: float, height: float) -> tuple[list[Part], float, float]:
    """The parts in rows of at most about WIDEST, and the width and height of them all.

    Cut are level lines between symbols alone, and each cut is marked at both ends.  What is narrow enough stays as it
    is.
    """
    # Spans, px from the left, in which nothing is cut: symbols, bodies, texts and upright lines
    spans = []
    for part in drawn:
        spans += [(text.box.left, text.box.right) for text in part.texts]
        upright = [
            x
            for shape in part.shapes
            for a, b in pairwise(shape.points)
            if shape.closed or a.y != b.y
            for x in (a.x, b.x)
        ]
        if part.title and upright:
            spans.append((min(upright), max(upright)))
        spans += [(x, x) for x in upright]
    cuts = _cuts([(left - 3.0, right + 3.0) for left, right in spans], width)
    if not cuts:
        return list(drawn), width, height
    ends = [0.0, *cuts, width]
    parts: list[Part] = []
    below, between = 0.0, 26.0  # px from one row to the next
    for row, (left, right) in enumerate(pairwise(ends)):
        content = []
        for part in drawn:
            shapes = [piece for shape in part.shapes for piece in _pieces(shape, left, right)]
            texts = [text for text in part.texts if left <= text.box.centre < right]
            content.append(Part(part.title, tuple(shapes), tuple(texts)))
        texts = [text for part in content for text in part.texts]
        heights = [y for text in texts for y in (text.box.top, text.box.bottom)]
        heights += [point.y for part in content for shape in part.shapes for point in shape.points]
        top, bottom = min(heights, default=0.0) if row else 0.0, max(heights, default=0.0)
        dx = MARGIN - left if row else 0.0
        parts += [part.shifted(dx, below - top) for part in content if part.shapes or part.texts]
        below += bottom - top + between
    wide = max(right - left for left, right in pairwise(ends))
    return parts, wide + 2 * MARGIN, below - between + MARGIN


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


def _pieces(shape: Shape, left: float, right: float) -> Iterator[Shape]:
    places = [point.x for point in shape.points]
    if left <= min(places) and max(places) <= right:
        yield shape
        return
    run: list[Point] = []
    for a, b in pairwise(shape.points):
        if max(a.x, b.x) <= left or min(a.x, b.x) >= right:
            continue
        start, end = (Point(min(max(point.x, left), right), point.y) for point in (a, b))
        if run[-1:] != [start]:
            if run:
                yield replace(shape, points=tuple(run))
            run = [start]
        run.append(end)
        for whole, cut in ((a, start), (b, end)):
            if whole.x != cut.x:
                mark = (cut.shifted(-2, 5.0), cut.shifted(2, -5.0))  # an upright stroke of 10 px
                yield replace(shape, points=mark, weight=1.0, dashed=False)
    if run:
        yield replace(shape, points=tuple(run))


# Title and legend around a drawing.


WORDS = {
    "unknown": "to be found",
    "estimated": "found, with {level:g} % interval",
    "known": "known",
    "doubtful": "(?) doubtful",
}


def titled(drawn: Sequence[Part], title: str, width: float) -> tuple[list[Part], float, float]:
    """The parts of a drawing of that width below a title; width of it all, and how far they are moved down."""
    line, least = Line(title, "ink", TITLE, True), max(width, 320.0)
    rows = [""] if title else []
    for word in line.text.split():
        longer = f"{rows[-1]} {word}".strip()
        if replace(line, text=longer).width > least - 2 * MARGIN and rows[-1]:
            rows.append(word)
        else:
            rows[-1] = longer
    lines = [replace(line, text=text) for text in rows]
    head = 30.0 + (len(lines) - 1) * 1.3 * TITLE if lines else 0.0
    wide = max([least, *(line.width + 2 * MARGIN for line in lines)])
    texts = [Text(line, Point(MARGIN, MARGIN + TITLE * (0.9 + 1.3 * k))) for k, line in enumerate(lines)]
    parts = [Part("", (), tuple(texts))] if texts else []
    return [*parts, *(part.shifted((wide - width) / 2, head) for part in drawn)], wide, head


def _legend(
    labels: Labels, estimated: bool, level: float, note: str, width: float, top: float
) -> tuple[Part, float]:
    """What lines and letters mean, as far as they occur, in as many rows as the width needs."""
    shapes: list[Shape] = []
    texts: list[Text] = []
    x, y = MARGIN, top + 12.0
    present = {known for known, _, _ in labels.values.values()}
    entries: list[tuple[Tone | None, Line]] = []
    knowledge: Knowledge
    for knowledge in ("unknown", "known", "doubtful"):
        if knowledge in present:
            words = WORDS["estimated" if estimated and knowledge == "unknown" else knowledge]
            entries.append((knowledge, Line(words.format(level=100 * level), "muted", SMALL)))
    for quantity, badge in BADGES.items():
        if any(channel.quantity is quantity for channel in labels.channels):
            entries.append((None, Line(f"{quantity} sensor", "muted", SMALL, badge=badge)))
    if note:
        entries.append((None, Line(note, "muted", SMALL)))
    length = 26.0  # of a sample of a line
    for sample, line in entries:
        need = (length + 6 if sample else 0.0) + block_width([line])
        if x > MARGIN and x + need > width - MARGIN:
            x, y = MARGIN, y + 17.0
        if sample is not None:
            weight = 1.2 if sample == "known" else 2.0
            ends = (x, y - 3.5), (x + length, y - 3.5)
            shapes.append(stroke(ends, sample, weight, dashed=sample == "doubtful"))
            texts.append(Text(line, Point(x + length + 6, y)))
        else:
            texts.append(Text(line, Point(x, y)))
        x += need + 18.0
    return Part("legend", tuple(shapes), tuple(texts)), y + MARGIN


# Drawings as files: SVG, whose text stays text and whose modes move by themselves (SMIL), PNG and PDF.


# Blue, orange and grey are told apart by all kinds of colour vision; weight and dashes tell the same without colour.
COLOURS: Mapping[str, str] = {
    "ink": "#1f2933",
    "muted": "#52606d",
    "unknown": "#0b5f86",
    "known": "#616e7c",
    "doubtful": "#a8480f",
    "sensor": "#6b3f86",
    "drive": "#1f2933",
}
FILLS: Mapping[str, str] = {"body": "#eef3f7", "bar": "#52606d"}
FONT = "DejaVu Sans, Verdana, Segoe UI, Helvetica, Arial, sans-serif"
# SMIL knows neither print nor readers who want no motion: what moves is there a second time, at its largest.
STILL = (
    "<style>.still{display:none}@media print,(prefers-reduced-motion:reduce)"
    "{.still{display:inline}.moving{display:none}}</style>"
)


def _escape(text: str) -> str:
    """Text of an SVG: what XML forbids, and what turns or hides text, is shown escaped."""
    return escaped(printable(text))


def _fill(shape: Shape) -> str:
    return COLOURS[shape.tone] if shape.fill == "ink" else FILLS.get(shape.fill, "none")


def svg_document(
    frames: Sequence[Sequence[Part]], width: float, height: float, title: str, description: str
) -> str:
    """Frames of one motion as one SVG element that needs nothing else; of a single frame nothing moves.

    Parts and shapes of all frames correspond; the first frame stands in print and where no motion is wanted.
    """
    groups = [STILL] if len(frames) > 1 else []
    for k, part in enumerate(frames[0]):
        still, moving = _group([part]), _group([frame[k] for frame in frames])
        if "<animate " in moving:
            still = f'<g class="moving">{moving}</g><g class="still">{still}</g>'
        groups.append(still)
    about = f"<desc>{_escape(description)}</desc>" if description else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{_escape(title)}" font-family="{FONT}">'
        f"<title>{_escape(title)}</title>{about}{''.join(groups)}</svg>\n"
    )


def _group(frames: Sequence[Part]) -> str:
    """One part in all frames."""
    title = f"<title>{_escape(frames[0].title)}</title>" if frames[0].title else ""
    shapes = zip(*(frame.shapes for frame in frames), strict=True)
    texts = zip(*(frame.texts for frame in frames), strict=True)
    return f"<g>{title}{''.join(chain(map(_path, shapes), map(_text, texts)))}</g>\n"


def _animation(attribute: str, values: Sequence[str]) -> str:
    """The change of an attribute through all frames and back to the first; empty where there is none."""
    if len(set(values)) == 1:
        return ""
    through = ";".join([*values, values[0]])
    return f'<animate attributeName="{attribute}" values="{through}" dur="2s" repeatCount="indefinite"/>'


def _path(frames: Sequence[Shape]) -> str:
    shape = frames[0]
    paths = []
    for frame in frames:
        places = [
            f"{p.x:.4g},{p.y:.4g}" if abs(p.x) < 1e3 > abs(p.y) else f"{p.x:.1f},{p.y:.1f}"
            for p in frame.points
        ]
        paths.append(f"M{' '.join(places)}{'Z' if frame.closed else ''}")
    dashes = ' stroke-dasharray="5 3"' if shape.dashed else ""
    return (
        f'<path d="{paths[0]}" fill="{_fill(shape)}" stroke="{COLOURS[shape.tone]}" '
        f'stroke-width="{shape.weight:.3g}"{dashes} stroke-linejoin="round" stroke-linecap="round">'
        f"{_animation('d', paths)}</path>"
    )


def _text(frames: Sequence[Text]) -> str:
    text = frames[0]
    line, x, y, anchor = text.line, text.at.x, text.at.y, text.anchor
    colour, badge = COLOURS[line.tone], ""
    if line.badge:
        left = text.box.left
        badge = (
            f'<circle cx="{left + 6:.1f}" cy="{y - 3.4:.1f}" r="5.6" fill="none" stroke="{colour}"/>'
            f'<text x="{left + 6:.1f}" y="{y - 0.6:.1f}" font-size="8" text-anchor="middle" fill="{colour}">'
            f"{_escape(line.badge)}</text>"
        )
        x, anchor = left + 16, "start"
    weight = ' font-weight="bold"' if line.bold else ""
    moving = _animation("x", [f"{frame.at.x - text.at.x + x:.1f}" for frame in frames])
    return (
        f'{badge}<text x="{x:.1f}" y="{y:.1f}" font-size="{line.size:g}" text-anchor="{anchor}"{weight} '
        f'fill="{colour}">{_escape(line.text)}{moving}</text>'
    )


@style()
def raster(parts: Sequence[Part], width: float, height: float, title: str, kind: str) -> bytes:
    """The parts as a file, "png" or "pdf", the same bytes for the same drawing."""
    figure = Figure(figsize=(width / 72, height / 72))  # a px of the drawing is a point
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    for part in parts:
        for shape in part.shapes:
            fill = _fill(shape)
            axes.add_patch(
                Polygon(
                    [point[:2] for point in shape.points],
                    closed=shape.closed,
                    facecolor=fill,
                    edgecolor=COLOURS[shape.tone],
                    linewidth=shape.weight,
                    linestyle=(0, (5 / shape.weight, 3 / shape.weight)) if shape.dashed else "-",
                    joinstyle="round",
                    capstyle="round",
                    fill=fill != "none",
                )
            )
        for text in part.texts:
            line, x, y = text.line, text.at.x, text.at.y
            side = {"start": "left", "middle": "center", "end": "right"}[text.anchor]
            colour, left = COLOURS[line.tone], text.box.left
            look: dict[str, Any] = {"color": colour, "va": "baseline", "parse_math": False}
            if line.badge:
                axes.add_patch(Circle((left + 6, y - 3.4), 5.6, fill=False, edgecolor=colour, linewidth=1))
                axes.text(left + 6, y - 0.6, line.badge, ha="center", fontsize=8, **look)
                x, side = left + 16, "left"
            bold = "bold" if line.bold else "normal"
            axes.text(x, y, line.text, ha=side, fontsize=line.size, fontweight=bold, **look)
    out = io.BytesIO()
    about = {"Title": title, "CreationDate": None} if kind == "pdf" else {"Software": None}
    figure.savefig(out, format=kind, dpi=DPI, metadata=about, facecolor="white")
    return out.getvalue()
