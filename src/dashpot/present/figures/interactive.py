"""Figures that answer the mouse: what a page's script needs to tell values and to zoom.

A figure says of its axes, by `hover` or `hover_cells`, that their values can be told.  `interactive_svg` then writes
the same SVG as for paper with one more attribute, a description of these axes; without a script it changes nothing.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dashpot.arrays import Real
from dashpot.present.figures.style import svg


@dataclass(frozen=True)
class AxisLabel:
    """What stands along an axis: its name and unit, in words."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class _Hover:
    x: AxisLabel
    y: AxisLabel
    at: tuple[str, ...] | None
    cells: dict[str, Any] | None = None


def hover(axes: Axes, x: AxisLabel, y: AxisLabel, at: Sequence[str] | None = None) -> None:
    """Values of the labelled points, lines and bands of these axes can be told.

    `at` names the points where neither axis does, for instance the frequencies of a curve in the complex plane.
    """
    axes._dashpot_hover = _Hover(x, y, None if at is None else tuple(at))  # type: ignore[attr-defined]


def hover_cells(
    axes: Axes, rows: Sequence[str], columns: Sequence[str], values: Real, value: AxisLabel
) -> None:
    """Values (rows, columns) of a heat map that fills the axes, first row at the top, can be told."""
    cells = {"rows": list(rows), "columns": list(columns), "values": [_numbers(row) for row in values]}
    axes._dashpot_hover = _Hover(AxisLabel(""), value, None, cells)  # type: ignore[attr-defined]


def interactive_svg(figure: Figure) -> str:
    """The SVG element of a figure, with a description of the axes whose values can be told, if there are any."""
    hovering = [(axes, axes._dashpot_hover) for axes in figure.axes if hasattr(axes, "_dashpot_hover")]
    series = []
    for number, (axes, _) in enumerate(hovering):
        gid = f"panel-{number}"
        axes.set_gid(gid)
        found: list[dict[str, Any]] = []
        for container in axes.containers:
            if isinstance(container, ErrorbarContainer) and _named(container):
                line, _, bars = container.lines
                points = _points(str(container.get_label()), line)
                drawn = bars[0].get_segments() if bars else []
                nothing = (np.nan, np.nan)  # of a point that is not there matplotlib keeps an empty segment
                ends = np.array(
                    [segment[:, 1] if np.size(segment) else nothing for segment in drawn]
                ).reshape(-1, 2)
                if len(ends) == len(points["x"]):
                    points |= {"low": _numbers(ends[:, 0]), "high": _numbers(ends[:, 1])}
                found.append(points)
        for artist in (*axes.lines, *axes.collections):
            if not _named(artist):
                continue
            name = str(artist.get_label())
            if isinstance(artist, Line2D) and artist.get_linestyle() == "None":
                found.append(_points(name, artist))
            elif isinstance(artist, Line2D | PolyCollection):
                artist.set_gid(f"{gid}-{len(found)}")
                kind = "line" if isinstance(artist, Line2D) else "band"
                found.append({"name": name, "kind": kind, "id": artist.get_gid()})
        series.append(found)
        for place, note in enumerate(axes.texts):
            note.set_gid(f"panel-{number}-note-{place}")
    text = svg(figure)  # lays the axes out: only then their place and limits stand
    if not hovering:
        return text
    panels = []
    for (axes, shown), lines in zip(hovering, series, strict=True):
        width, height = 72 * figure.get_size_inches()  # the unit of length of matplotlib's SVG is a point
        frame = axes.get_position()
        panel: dict[str, Any] = {
            "id": axes.get_gid(),
            "box": _numbers(
                [frame.x0 * width, (1 - frame.y1) * height, frame.width * width, frame.height * height]
            ),
            "x": _axis(shown.x, axes.get_xscale(), axes.get_xlim(), axes.xaxis),
            "y": _axis(shown.y, axes.get_yscale(), axes.get_ylim(), axes.yaxis),
            "shared": min(figure.axes.index(other) for other in axes.get_shared_x_axes().get_siblings(axes)),
            "series": lines,
            "notes": [note.get_gid() for note in axes.texts],
        }
        if shown.at is not None:
            panel["at"] = list(shown.at)
        if shown.cells is not None:
            panel["cells"] = shown.cells
        panels.append(panel)
    content = escape(json.dumps(panels, ensure_ascii=False, separators=(",", ":")), quote=True)
    return text.replace("<svg ", f'<svg data-panels="{content}" ', 1)


def _axis(quantity: AxisLabel, scale: str, limits: tuple[float, float], axis: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": quantity.name,
        "unit": quantity.unit,
        "scale": scale,
        "limits": [float(f"{end:.9g}") for end in limits],
    }
    if scale == "symlog":
        found["linear"] = float(axis.get_transform().linthresh)
    return found


def _named(artist: Artist | ErrorbarContainer) -> bool:
    return not str(artist.get_label()).startswith("_")


def _points(name: str, line: Line2D) -> dict[str, Any]:
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    return {"name": name, "kind": "points", "x": _numbers(x), "y": _numbers(y)}


def _numbers(values: Any) -> list[float | None]:
    """Numbers as a page needs them, null for what is not there."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, float).tolist()]
