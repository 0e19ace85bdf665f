"""Dwells in time: measured and predicted, the part used shaded; from histories alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dashpot.arrays import Real
from dashpot.check.dwell_history import DwellHistory
from dashpot.present.figures.interactive import AxisLabel, hover
from dashpot.present.figures.style import INK, MODEL, MUTED, style
from dashpot.present.text.numbers import short

COLUMNS = 300  # of the outline of a dwell
PERIODS = 4.0  # of the beginning of the part used
POINTS = 400  # of a curve
USED = "#d7e8f0"


def whole_dwells(dwells: Sequence[DwellHistory]) -> Figure:
    """A column for each dwell, a row for each channel: the reach of each period, the part used shaded."""
    with style():
        figure, grid = _panels(dwells)
        for column, dwell in enumerate(dwells):
            inside = (dwell.time >= dwell.begin) & (dwell.time <= dwell.end)
            predicted = dwell.predicted(dwell.time[inside])
            for row, axes in enumerate(grid[:, column]):
                _used(axes, dwell.begin, dwell.end)
                middle, low, high = _outline(dwell.time, dwell.measured[:, row], dwell.frequency_hz)
                axes.fill_between(middle, low, high, color=MUTED, lw=0, zorder=2, label="measured")
                middle, low, high = _outline(dwell.time[inside], predicted[:, row], dwell.frequency_hz)
                axes.plot(middle, low, color=MODEL, lw=1.3, zorder=4, label="predicted")
                axes.plot(middle, high, color=MODEL, lw=1.3, zorder=4)
        _legend(figure, grid[0, 0])
    return figure


def beginnings(dwells: Sequence[DwellHistory]) -> Figure:
    """The same channels around the beginning of the part used: samples as points, the prediction as a curve."""
    with style():
        figure, grid = _panels(dwells)
        for column, dwell in enumerate(dwells):
            period = 1 / dwell.frequency_hz
            first = max(dwell.begin - period, 0.0)
            last = min(dwell.begin + PERIODS * period, float(dwell.time[-1]))
            kept = (dwell.time >= first) & (dwell.time <= last)
            time = np.linspace(first, last, POINTS)
            curve = dwell.predicted(time)
            every = max(int(np.sum(kept)) // POINTS, 1)
            for row, axes in enumerate(grid[:, column]):
                _used(axes, dwell.begin, min(dwell.end, last))
                axes.plot(
                    dwell.time[kept][::every], dwell.measured[kept, row][::every], "o", ms=2.0, color=MUTED,
                    zorder=2, label="measured",
                )  # fmt: skip
                axes.plot(time, curve[:, row], color=MODEL, lw=1.0, zorder=4, label="predicted")
                hover(axes, AxisLabel("time", "s"), AxisLabel(dwell.channels[row], dwell.units[row]))
        _legend(figure, grid[0, 0])
    return figure


def _panels(dwells: Sequence[DwellHistory]) -> tuple[Figure, Any]:
    rows = len(dwells[0].channels)
    figure = Figure(figsize=(max(3.0 * len(dwells), 5.0), max(1.5 * rows, 2.0) + 0.5))
    grid = figure.subplots(rows, len(dwells), squeeze=False, sharex="col", sharey="row")
    for dwell, column in zip(dwells, grid.T, strict=True):
        column[0].set_title(f"{short(dwell.frequency_hz, 4)} Hz")
        column[-1].set_xlabel("time, s")
    for name, unit, axes in zip(dwells[0].channels, dwells[0].units, grid[:, 0], strict=True):
        axes.set_ylabel(f"{name}, {unit}")
    return figure, grid


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2)


def _used(axes: Axes, begin: float, end: float) -> None:
    """The part used, told by its ends as well where shades cannot be."""
    axes.axvspan(begin, end, color=USED, lw=0, zorder=0)
    for place in (begin, end):
        axes.axvline(place, color=INK, lw=0.9, ls="--", zorder=3)


def _outline(time: Real, values: Real, frequency_hz: float) -> tuple[Real, Real, Real]:
    """(middles, least, greatest) of at most COLUMNS neighbouring pieces, of a period at least, of a history."""
    periods = int(frequency_hz * float(time[-1] - time[0]))
    pieces = max(min(COLUMNS, periods), 2)
    starts = np.unique(np.linspace(0, len(time), pieces, endpoint=False).astype(int))
    ends = np.append(starts[1:], len(time)) - 1
    middles: Real = (time[starts] + time[ends]) / 2
    middles[[0, -1]] = time[0], time[-1]
    return middles, np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
