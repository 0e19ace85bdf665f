"""Drawings as SVG: text stays text, every part has a title; modes move by themselves (SMIL)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape as escaped

from dashpot.errors import printable
from dashpot.present.schematic.geometry import Text
from dashpot.present.schematic.scene import Part, Shape

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
FILLS: Mapping[str, str] = {"body": "#eef3f7", "bar": "#52606d", "paper": "#ffffff"}
FONT = "DejaVu Sans, Verdana, Segoe UI, Helvetica, Arial, sans-serif"
DASHES = "5 3"
# SMIL knows neither print nor readers who want no motion: what moves is there a second time, at its largest.
STILL = (
    "<style>.still{display:none}@media print,(prefers-reduced-motion:reduce)"
    "{.still{display:inline}.moving{display:none}}</style>"
)


def escape(text: str) -> str:
    """Text of an SVG: what XML forbids, and what turns or hides text, is shown escaped."""
    return escaped(printable(text))


def svg_document(
    parts: Sequence[Part], width: float, height: float, title: str, description: str = ""
) -> str:
    """The parts as one SVG element that needs nothing else."""
    return _framed([_group(part) for part in parts], width, height, title, description)


def moving_document(
    frames: Sequence[Sequence[Part]], width: float, height: float, title: str, seconds: float
) -> str:
    """Frames of one motion, the first in print and where no motion is wanted; parts and shapes of all correspond."""
    groups = [STILL]
    for k, part in enumerate(frames[0]):
        shapes = [
            _shape(shape, [frame[k].shapes[j] for frame in frames], seconds)
            for j, shape in enumerate(part.shapes)
        ]
        texts = [
            _text(text, [frame[k].texts[j] for frame in frames], seconds) for j, text in enumerate(part.texts)
        ]
        group = _wrapped(part, [*shapes, *texts])
        moves = "<animate " in group
        groups += [f'<g class="moving">{group}</g><g class="still">{_group(part)}</g>' if moves else group]
    return _framed(groups, width, height, title, "")


def _framed(groups: Sequence[str], width: float, height: float, title: str, description: str) -> str:
    about = f"<desc>{escape(description)}</desc>" if description else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(title)}" font-family="{FONT}">'
        f"<title>{escape(title)}</title>{about}{''.join(groups)}</svg>\n"
    )


def _group(part: Part) -> str:
    return _wrapped(part, [*(_shape(shape) for shape in part.shapes), *(_text(text) for text in part.texts)])


def _wrapped(part: Part, content: Sequence[str]) -> str:
    title = f"<title>{escape(part.title)}</title>" if part.title else ""
    return f"<g>{title}{''.join(content)}</g>\n"


def _path(shape: Shape) -> str:
    numbers = [f"{x:.4g},{y:.4g}" if abs(x) < 1e3 > abs(y) else f"{x:.1f},{y:.1f}" for x, y in shape.points]
    return f"M{' '.join(numbers)}{'Z' if shape.closed else ''}"


def _shape(shape: Shape, frames: Sequence[Shape] = (), seconds: float = 1.0) -> str:
    colour = COLOURS[shape.tone]
    fill = colour if shape.fill == "ink" else FILLS.get(shape.fill, "none")
    dashes = f' stroke-dasharray="{DASHES}"' if shape.dashed else ""
    path = _path(shape)
    paths = [_path(frame) for frame in frames]
    moving = (
        f'<animate attributeName="d" values="{";".join([*paths, paths[0]])}" dur="{seconds:g}s" '
        'repeatCount="indefinite"/>'
        if len(set(paths)) > 1
        else ""
    )
    return (
        f'<path d="{path}" fill="{fill}" stroke="{colour}" stroke-width="{shape.weight:.3g}"{dashes} '
        f'stroke-linejoin="round" stroke-linecap="round">{moving}</path>'
        if moving
        else f'<path d="{path}" fill="{fill}" stroke="{colour}" stroke-width="{shape.weight:.3g}"{dashes} '
        'stroke-linejoin="round" stroke-linecap="round"/>'
    )


def _text(text: Text, frames: Sequence[Text] = (), seconds: float = 1.0) -> str:
    line, x, y = text.line, text.at.x, text.at.y
    colour = COLOURS[line.tone]
    parts = []
    if line.badge:
        left = text.box.left
        parts.append(
            f'<circle cx="{left + 6:.1f}" cy="{y - 3.4:.1f}" r="5.6" fill="none" stroke="{colour}"/>'
            f'<text x="{left + 6:.1f}" y="{y - 0.6:.1f}" font-size="8" text-anchor="middle" fill="{colour}">'
            f"{escape(line.badge)}</text>"
        )
    anchor = text.anchor
    if line.badge:
        x, anchor = text.box.left + 16, "start"
    weight = ' font-weight="bold"' if line.bold else ""
    places = [frame.at.x - text.at.x + x for frame in frames]
    moving = ""
    if len(set(places)) > 1:
        values = ";".join(f"{place:.1f}" for place in [*places, places[0]])
        moving = f'<animate attributeName="x" values="{values}" dur="{seconds:g}s" repeatCount="indefinite"/>'
    parts.append(
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{line.size:g}" text-anchor="{anchor}"{weight} fill="{colour}">'
        f"{escape(line.text)}{moving}</text>"
    )
    return "".join(parts)
