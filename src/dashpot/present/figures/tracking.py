"""Figures of the unknowns of a rig over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtri

from dashpot.fleet.tracking import Track
from dashpot.present.figures.style import BAD, DATA, MODEL, style


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
