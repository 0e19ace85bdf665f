"""Drawings as files: SVG, whose text stays text and whose modes move by themselves (SMIL), PNG and PDF."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from html import escape as escaped
from itertools import chain
from typing import Any, Literal

from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from dashpot.errors import printable
from dashpot.io.atomic import write_bytes
from dashpot.io.words import PICTURES, chosen_format
from dashpot.present.figures.style import DPI, style
from dashpot.present.schematic.symbols import Part, Shape, Text

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


def write_drawing(
    path: str | os.PathLike[str], svg: str, parts: Sequence[Part], width: float, height: float, title: str
) -> None:
    """Write a drawing; the end of the name says how: .svg, .png or .pdf.  Raises UsageError, DataError."""
    kind = chosen_format(path, PICTURES)
    if kind == "svg":
        write_bytes(path, svg.encode())
    else:
        write_bytes(path, raster(parts, width, height, title, "png" if kind == "png" else "pdf"))


def _escape(text: str) -> str:
    """Text of an SVG: what XML forbids, and what turns or hides text, is shown escaped."""
    return escaped(printable(text))


def _fill(shape: Shape) -> str:
    return COLOURS[shape.tone] if shape.fill == "ink" else FILLS.get(shape.fill, "none")


def svg_document(
    frames: Sequence[Sequence[Part]], width: float, height: float, title: str, description: str = ""
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
def raster(
    parts: Sequence[Part], width: float, height: float, title: str, kind: Literal["png", "pdf"]
) -> bytes:
    """The parts as a PNG or PDF file, the same bytes for the same drawing."""
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
