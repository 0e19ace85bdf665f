"""Drawings as PNG and PDF, from the same strokes and texts."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, Literal

from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from dashpot.present.figures.style import style
from dashpot.present.schematic.geometry import Text
from dashpot.present.schematic.scene import Part, Shape
from dashpot.present.schematic.svg import COLOURS, FILLS

PX = 72.0  # px of the drawing in an inch: a px is a point
DPI = 180


def raster(
    parts: Sequence[Part], width: float, height: float, title: str, kind: Literal["png", "pdf"]
) -> bytes:
    """The parts as a PNG or PDF file, the same bytes for the same drawing."""
    with style():
        figure = Figure(figsize=(width / PX, height / PX))
        figure.set_layout_engine("none")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(0, width)
        axes.set_ylim(height, 0)
        axes.axis("off")
        for part in parts:
            for shape in part.shapes:
                axes.add_patch(_shape(shape))
            for text in part.texts:
                _text(figure, text, width, height)
                if text.line.badge:
                    centre = (text.box.left + 6, text.at.y - 3.4)
                    axes.add_patch(
                        Circle(centre, 5.6, fill=False, edgecolor=COLOURS[text.line.tone], linewidth=1)
                    )
        out = io.BytesIO()
        about = {"Title": title, "CreationDate": None} if kind == "pdf" else {"Software": None}
        figure.savefig(out, format=kind, dpi=DPI, metadata=about, facecolor="white")
    return out.getvalue()


def _shape(shape: Shape) -> Polygon:
    colour = COLOURS[shape.tone]
    fill = colour if shape.fill == "ink" else FILLS.get(shape.fill, "none")
    return Polygon(
        shape.points, closed=shape.closed, facecolor=fill, edgecolor=colour, linewidth=shape.weight,
        linestyle=(0, (5 / shape.weight, 3 / shape.weight)) if shape.dashed else "-", joinstyle="round",
        capstyle="round", fill=fill != "none",
    )  # fmt: skip


def _text(figure: Figure, text: Text, width: float, height: float) -> None:
    line, x, y = text.line, text.at.x, text.at.y
    aligned = {"start": "left", "middle": "center", "end": "right"}[text.anchor]
    look: dict[str, Any] = {"color": COLOURS[line.tone], "va": "baseline", "parse_math": False}
    if line.badge:
        figure.text(
            (text.box.left + 6) / width, 1 - (y - 0.6) / height, line.badge, ha="center", fontsize=8, **look
        )
        x, aligned = text.box.left + 16, "left"
    figure.text(
        x / width, 1 - y / height, line.text, ha=aligned, fontsize=line.size,
        fontweight="bold" if line.bold else "normal", **look,
    )  # fmt: skip
