"""Figures of what data tell: shares of the information by frequency, profiles of the likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator

from dashpot.arrays import Real
from dashpot.check.profile import Profile
from dashpot.present.figures.design import HEAT
from dashpot.present.figures.interactive import AxisLabel, hover, hover_cells
from dashpot.present.figures.style import BAD, HALF_PAGE, INK, MODEL, MUTED, style
from dashpot.present.text.numbers import short

TICKS = 10


def shares_figure(names: Sequence[str], frequency_hz: Real, shares: Real) -> Figure:
    """What lines (or bands, by their middle) tell of each unknown, per cent; shares (lines, unknowns)."""
    lines = len(frequency_hz)
    with style():
        figure = Figure(figsize=(HALF_PAGE, max(1.6, 0.26 * len(names) + 1.0)))
        axes = figure.subplots()
        top = max(float(np.nanmax(shares, initial=0.0)), 1e-9)
        mesh = axes.pcolormesh(
            np.arange(lines + 1), np.arange(len(names) + 1), 100 * shares.T, cmap=HEAT, vmin=0, vmax=100 * top,
            rasterized=lines * len(names) > 2000,
        )  # fmt: skip
        step = max(1, -(-lines // TICKS))
        places = np.arange(0, lines, step)
        axes.xaxis.set_major_locator(FixedLocator([float(k) + 0.5 for k in places]))
        axes.set_xticklabels([short(float(frequency_hz[k]), 3) for k in places])
        axes.yaxis.set_major_locator(FixedLocator([k + 0.5 for k in range(len(names))]))
        axes.set_yticklabels(list(names))
        axes.set_ylim(len(names), 0)
        columns = [f"{short(float(f), 4)} Hz" for f in frequency_hz]
        hover_cells(axes, names, columns, 100 * shares.T, AxisLabel("share", "%"))
        axes.tick_params(length=0)
        axes.grid(visible=False)
        axes.set_xlabel("frequency, Hz")
        bar = figure.colorbar(mesh, ax=axes, pad=0.01)
        bar.set_label("% of the information")
        bar.outline.set_visible(False)
    return figure


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """Rise of χ² along each unknown, all others fitted again, beside the parabola of the normal interval."""
    columns = min(len(profiles), 2)
    rows = -(-len(profiles) // columns)
    with style():
        figure = Figure(figsize=(HALF_PAGE if columns == 2 else 3.2, 0.6 + 2.2 * rows))
        grid = np.atleast_2d(figure.subplots(rows, columns, squeeze=False))
        for axes, shown in zip(grid.flat, profiles, strict=False):
            axes.plot(shown.points, shown.rise, color=MODEL, lw=1.4, label="profile")
            value, half = float(shown.value), (float(shown.normal_upper) - float(shown.normal_lower)) / 2
            x = np.linspace(float(np.min(shown.points)), float(np.max(shown.points)), 100)
            limit = float(shown.threshold)
            axes.plot(
                x, limit * ((x - value) / half) ** 2, color=MUTED, lw=1.0, ls=(0, (3, 2)), label="normal"
            )
            axes.axhline(limit, color=INK, lw=0.7)
            for end in (float(shown.lower), float(shown.upper)):
                if np.isfinite(end):
                    axes.axvline(end, color=BAD if bool(shown.misleads) else MODEL, lw=0.8)
            axes.set_ylim(0, 2.2 * limit)
            hover(
                axes, AxisLabel(shown.name, "" if shown.unit == "1" else shown.unit), AxisLabel("rise of χ²")
            )
            axes.set_title(shown.name)
            axes.set_xlabel("" if shown.unit == "1" else shown.unit)
            axes.set_ylabel("rise of χ²")
        for axes in list(grid.flat)[len(profiles) :]:
            axes.set_visible(False)
        grid.flat[0].legend(loc="upper center")
    return figure
