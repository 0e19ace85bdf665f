"""Figures of Monte Carlo studies, from arrays alone, and of the unknowns of a rig over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.special import ndtri

from dashpot.arrays import Real
from dashpot.fleet.tracking import Track
from dashpot.present.figures.style import (
    BAD,
    DATA,
    INK,
    MODEL,
    MUTED,
    limit_axis,
    panels,
    plain_log,
    row_names,
    style,
)

BOUND: dict[str, Any] = {"color": INK, "lw": 1.1, "ls": (0, (4, 2))}  # the Cramér-Rao bound
WASH: dict[str, Any] = {"color": MUTED, "alpha": 0.25, "lw": 7}  # a band in a legend


def _legend(figure: Figure, handles: Sequence[Line2D | Patch], length: float = 1.8) -> None:
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), handlelength=length)


@dataclass(frozen=True)
class Band:
    """A line with a band around it; `low` and `high` are its edges, all (points,)."""

    label: str
    colour: str
    middle: Real
    low: Real
    high: Real
    dashed: bool = False

    @property
    def stroke(self) -> dict[str, Any]:
        """Line properties."""
        return {"color": self.colour, "lw": 1.7, "ls": (0, (4, 2.2)) if self.dashed else "-"}


@dataclass(frozen=True)
class Mark:
    """Single points, (points,) each."""

    label: str
    colour: str
    x: Real
    y: Real

    @property
    def stroke(self) -> dict[str, Any]:
        """Line properties."""
        return {"ls": "", "marker": "D", "ms": 5, "mfc": self.colour, "mec": "white", "mew": 0.9}


@style()
def band_panels(
    titles: Sequence[str],
    x: Real,
    bands: Sequence[Sequence[Band]],
    *,
    x_label: str,
    marks: Sequence[Sequence[Mark]] = (),
    logarithmic: bool,
    limits: Sequence[tuple[float, float]],
) -> Figure:
    """A panel for each title with relative errors in per cent over x (points,): lines, bands of 95 %, points.

    What lies outside `limits` is cut off.
    """
    marks = marks or [[] for _ in titles]
    columns = min(len(titles), 3)
    size = (2.9 * columns + 1.0, 2.9 * -(-len(titles) // columns) + 0.6)
    figure, grid = panels(len(titles), columns, size)
    for axes, title, lines, points, ends in zip(grid, titles, bands, marks, limits, strict=True):
        axes.axhline(0.0, color=MUTED, lw=0.8, zorder=1)
        for band in lines:
            axes.fill_between(x, band.low, band.high, color=band.colour, alpha=0.16, lw=0, zorder=2)
            for edge in (band.low, band.high):
                axes.plot(x, edge, color=band.colour, lw=0.5, alpha=0.6, zorder=2)
            axes.plot(x, band.middle, zorder=3, **band.stroke)
        for mark in points:
            axes.plot(mark.x, mark.y, zorder=5, clip_on=False, **mark.stroke)
        axes.set_title(title)
        _abscissa(axes, x, logarithmic)
        limit_axis(axes.set_ylim, *ends)
    for axes in grid[-columns:]:
        axes.set_xlabel(x_label)
    for axes in grid[::columns]:
        axes.set_ylabel("relative error, %")
    lines_of = {band.label: band for panel in bands for band in panel}.values()
    marks_of = {mark.label: mark for panel in marks for mark in panel}.values()
    handles = [Line2D([], [], label=band.label, **band.stroke) for band in lines_of]
    handles.append(Line2D([], [], label="band: 95 % of the draws", **WASH))
    handles += [Line2D([], [], label=mark.label, **mark.stroke) for mark in marks_of]
    _legend(figure, handles, 1.6)
    return figure


def _abscissa(axes: Axes, x: Real, logarithmic: bool) -> None:
    low, high = float(np.min(x)), float(np.max(x))
    if logarithmic:
        axes.set_xscale("log")
        plain_log(axes.xaxis, form="{x:,g}")
        limit_axis(axes.set_xlim, low / 1.06, high * 1.06)
    else:
        limit_axis(axes.set_xlim, min(0.0, low), high)


@dataclass(frozen=True)
class Spread:
    """Where draws lie, for each row: mean and the edges of the middle 95 %, (rows,); `printed` or NaN."""

    label: str
    colour: str
    mean: Real
    low: Real
    high: Real
    printed: Real


@style()
def spread_panels(titles: Sequence[str], rows: Sequence[str], spreads: Sequence[Sequence[Spread]]) -> Figure:
    """A panel for each title; in it, for each row, a bar of the middle 95 % of each kind and its printed value."""
    columns = min(2, len(titles))
    size = (3.9 * columns + 0.4, (0.42 * len(rows) + 0.75) * -(-len(titles) // columns) + 0.5)
    mean: dict[str, Any] = {"ls": "", "marker": "|", "ms": 7, "mew": 1.6}
    printed: dict[str, Any] = {"ls": "", "marker": "D", "ms": 4.6, "mec": "white", "mew": 0.8}
    figure, grid = panels(len(titles), columns, size)
    for axes, title, panel in zip(grid, titles, spreads, strict=True):
        axes.axvline(0.0, color=MUTED, lw=0.8, zorder=1)
        step = 0.62 / max(len(panel), 1)
        for k, spread in enumerate(panel):
            y = np.arange(len(rows)) + (k - (len(panel) - 1) / 2) * step
            look: dict[str, Any] = {"color": spread.colour, "alpha": 0.28, "lw": 0, "zorder": 2}
            axes.barh(y, spread.high - spread.low, left=spread.low, height=0.78 * step, **look)
            axes.plot(spread.mean, y, color=spread.colour, zorder=3, **mean)
            axes.plot(spread.printed, y, mfc=spread.colour, zorder=4, **printed)
        row_names(axes, range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.45, -0.55)
        axes.use_sticky_edges = False
        axes.margins(x=0.04)
        axes.grid(visible=False, axis="y")
        axes.set_title(title)
    for axes in grid[-columns:]:
        axes.set_xlabel("relative error, %")
    colours = {spread.label: spread.colour for panel in spreads for spread in panel}
    handles: list[Line2D | Patch] = [
        Patch(color=colour, alpha=0.28, lw=0, label=f"{label}, 95 % of draws")
        for label, colour in colours.items()
    ]
    handles.append(Line2D([], [], color=INK, label="mean of the draws", **mean))
    handles.append(Line2D([], [], mfc=INK, label="printed in the paper", **printed))
    _legend(figure, handles, 1.4)
    return figure


@dataclass(frozen=True)
class Series:
    """Values with standard errors over a few named places, (places,)."""

    label: str
    colour: str
    values: Real
    errors: Real


@style()
def bar_panels(
    titles: Sequence[str], places: Sequence[str], series: Sequence[Sequence[Series]], bounds: Sequence[Real]
) -> Figure:
    """A panel for each title with groups of bars, rms relative spreads in per cent, and a short line at each bound.

    bounds: (places,) each.
    """
    wide = max(3.9, min(0.6 + 0.28 * len(places) * len(series[0]), 10.0)) if len(titles) == 1 else 3.9
    figure, grid = panels(len(titles), len(titles), (wide * len(titles) + 0.4, 3.4), sharey=True)
    for axes, title, panel, bound in zip(grid, titles, series, bounds, strict=True):
        width = 0.74 / len(panel)
        letters: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 7.5 if len(panel) < 3 else 6.5}
        for k, each in enumerate(panel):
            x = np.arange(len(places)) + (k - (len(panel) - 1) / 2) * width
            ends = {"elinewidth": 0.9, "ecolor": INK}
            reach = 1.96 * each.errors
            axes.bar(x, each.values, 0.92 * width, yerr=reach, color=each.colour, error_kw=ends)
            for at, value, above in zip(x, each.values, each.values + reach, strict=True):
                axes.annotate(f"{value:.2f}", (at, above), (0, 2), textcoords="offset points", **letters)
        for at, value in enumerate(bound):
            axes.plot([at - 0.42, at + 0.42], [value, value], zorder=4, **BOUND)
        axes.set_xticks(range(len(places)), places)
        axes.grid(visible=False, axis="x")
        axes.tick_params(axis="x", length=0)
        axes.set_title("\n".join(wrap(title, int(11 * wide))))
        axes.margins(y=0.12)
    grid[0].set_ylabel("rms relative spread, %")
    handles: list[Patch | Line2D] = [Patch(color=each.colour, label=each.label) for each in series[0]]
    _legend(figure, [*handles, Line2D([], [], label="Cramér-Rao bound", **BOUND)])
    return figure


@dataclass(frozen=True)
class Accuracy:
    """How one method does along an abscissa: rms spread, bias (points,) and coverage (points, parameters), %."""

    label: str
    colour: str
    spread: Real
    bias: Real
    coverage: Real

    @property
    def stroke(self) -> dict[str, Any]:
        """Line properties."""
        return {"color": self.colour, "lw": 1.5, "marker": "o", "ms": 3.4}


@style()
def accuracy_panels(
    x: Real, methods: Sequence[Accuracy], bound: Real, x_label: str, *, logarithmic: bool
) -> Figure:
    """Spread with the bound, bias, and coverage of 95 % intervals, side by side.  x and bound (points,)."""
    figure, grid = panels(3, 3, (9.7, 3.4))
    left, middle, right = grid
    for method in methods:
        left.plot(x, method.spread, zorder=3, **method.stroke)
        middle.plot(x, method.bias, zorder=3, **method.stroke)
        least, most = np.min(method.coverage, axis=1), np.max(method.coverage, axis=1)
        right.fill_between(x, least, most, color=method.colour, alpha=0.14, lw=0)
        right.plot(x, np.mean(method.coverage, axis=1), zorder=3, **method.stroke)
    left.plot(x, bound, zorder=4, **BOUND)
    right.axhline(95, color=INK, lw=0.9, ls=(0, (1, 2)), zorder=2)
    _positive(left)
    _positive(middle)
    least_of_all = min(float(np.nanmin(method.coverage)) for method in methods)
    limit_axis(right.set_ylim, min(90.0, max(0.0, least_of_all - 2)), 100.5)
    titles = ("rms spread, %", "rms bias, %", "coverage of 95 % intervals, %")
    for axes, title in zip(grid, titles, strict=True):
        axes.set_title(title)
        axes.set_xlabel(x_label)
        _abscissa(axes, x, logarithmic)
    handles = [Line2D([], [], label=method.label, **method.stroke) for method in methods]
    handles.append(Line2D([], [], label="Cramér-Rao bound", **BOUND))
    handles.append(Line2D([], [], label="least to greatest over the parameters", **WASH))
    _legend(figure, handles)
    return figure


def _positive(axes: Axes) -> None:
    """A logarithmic ordinate with plain numbers."""
    low, high = axes.dataLim.y0, axes.dataLim.y1
    if not (np.isfinite(low) and low > 0):
        return
    axes.set_yscale("log")
    room = (high / low) ** 0.06 if high > low else 1.5
    limit_axis(axes.set_ylim, low / room, high * room)
    plain_log(axes.yaxis, (1.0, 2.0, 5.0) if high / low < 1e3 else (1.0,), "{x:,g}")


@style()
def track_figure(track: Track, level: float = 0.95) -> Figure:
    """A panel for each unknown: windows alone with their standard deviations, all together with intervals, changes."""
    count = len(track.names)
    figure = Figure(figsize=(7.6, 1.2 + 1.5 * count))
    grid = figure.subplots(count, 1, squeeze=False, sharex=True)[:, 0]
    middle, reach = (track.start_s + track.end_s) / 2, float(ndtri((1 + level) / 2))
    size = 2.5 if len(middle) < 200 else 1.0
    for j, axes in enumerate(grid):
        value, spread = track.values[:, j], reach * track.sd[:, j]
        shown = np.isfinite(track.alone_sd[:, j])
        axes.errorbar(
            middle[shown],
            track.alone[shown, j],
            track.alone_sd[shown, j],
            fmt=".",
            ms=size,
            lw=0.6,
            color=DATA,
            label="window alone, ± sd",
        )
        axes.fill_between(middle, value - spread, value + spread, color=MODEL, alpha=0.25, lw=0, step="mid")
        axes.plot(middle, value, color=MODEL, lw=1.2, ds="steps-mid", label=f"all windows, {100 * level:g} %")
        for change in track.changes:
            if change.name == track.names[j] and change.kind == "abrupt":
                axes.axvspan(*change.time95_s, color=BAD, alpha=0.15, lw=0)
                axes.axvline(change.time_s, color=BAD, lw=0.9, label="abrupt change")
        axes.set_ylabel(f"{track.names[j]}, {track.units[j]}" if track.units[j] else track.names[j])
    grid[0].legend(loc="best")
    grid[-1].set_xlabel("time, s")
    return figure
