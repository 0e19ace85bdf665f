"""Intervals of several methods in one picture, from arrays alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri

from dashpot.arrays import Real
from dashpot.estimate.comparison import Comparison
from dashpot.estimate.result import Cost, Cycle, Estimate
from dashpot.present.figures.style import (
    BAD,
    COLOURS,
    HALF_PAGE,
    INK,
    MODEL,
    ShownFigure,
    limit_axis,
    panels,
    row_names,
    style,
)

ROW, PANEL = 0.24, 2.45  # inches a method, and a panel


def comparison_figure(comparison: Comparison, level: float = 0.95) -> Figure:
    """One panel for each unknown: every method's value with its interval, the truth and the bound's interval."""
    methods = list(comparison.estimates)
    values = np.array([[comparison.estimates[m][name].value for name in comparison.names] for m in methods])
    ends = np.empty((2, *values.shape))
    for i, method in enumerate(methods):
        estimate = comparison.estimates[method]
        index = [estimate.names.index(name) for name in comparison.names]
        for side, end in enumerate(estimate.interval(level)):
            ends[side, i] = end[index]
    bands = {}
    for name in comparison.names:
        centre, bound = comparison.centre(name), comparison.bound_sd(name)
        if centre is not None and bound is not None:
            bands[name] = (centre, bound)
    return interval_plot(
        comparison.names, comparison.units, methods, values, ends[0], ends[1], comparison.truth, bands, level
    )


def estimate_figure(estimate: Estimate, level: float = 0.95) -> Figure:
    """One panel for each unknown with its interval, and that of the bound behind it.

    What was stated of an unknown with an sd stands below as a row of its own.
    """
    low, high = estimate.interval(level)
    numbers = zip(estimate.names, estimate.values.tolist(), estimate.bound_sd.tolist(), strict=True)
    bands = {name: (value, sd) for name, value, sd in numbers if np.isfinite(sd)}
    rows, values, lows, highs = ["estimate" if estimate.stated else ""], [estimate.values], [low], [high]
    if estimate.stated:
        prior, sd = estimate.priors
        reach = _reach(level)
        rows, values = [*rows, "stated"], [*values, prior]
        lows, highs = [*lows, prior - reach * sd], [*highs, prior + reach * sd]
    return interval_plot(
        estimate.names,
        estimate.units,
        rows,
        np.stack(values),
        np.stack(lows),
        np.stack(highs),
        {},
        bands,
        level,
        (HALF_PAGE - 0.6) / 3,
    )


@style()
def cost_figure(costs: Sequence[Cost]) -> Figure:
    """The largest shares of variance that what was stated costs the unknowns, per cent, as bars."""
    shown = costs[:12]  # bars of a picture
    places = np.arange(len(shown))
    figure = ShownFigure(figsize=(HALF_PAGE, 0.8 + ROW * len(shown)))
    axes = figure.subplots()
    names = list(dict.fromkeys(cost.of for cost in costs))
    colours = [COLOURS[names.index(cost.of) % len(COLOURS)] for cost in shown]
    axes.barh(places, [100 * cost.share for cost in shown], height=0.7, color=colours)
    row_names(axes, places.tolist(), [f"{cost.of} → {cost.on}" for cost in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(0, 100)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("% of the variance")
    return figure


@style()
def change_figure(names: list[str], change: Real, low: Real, high: Real) -> Figure:
    """Changes (unknowns,) with the ends of their intervals, per cent, a row each; dark where the interval leaves 0
    out."""
    places = np.arange(len(names))
    figure = ShownFigure(figsize=(HALF_PAGE, 0.8 + ROW * len(names)))
    axes = figure.subplots()
    axes.axvline(0, color=INK, linewidth=0.8)
    for place, value, ends in zip(places, change, np.stack([low, high], axis=-1), strict=True):
        moved = ends[0] > 0 or ends[1] < 0
        colour = BAD if moved else MODEL
        axes.plot(ends, [place, place], color=colour, linewidth=1.5)
        axes.plot([value], [place], "o", color=colour, markersize=4)
    row_names(axes, places.tolist(), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("change, %")
    return figure


@style()
def cycle_figure(cycles: Sequence[Cycle]) -> Figure:
    """Equivalent stiffness and damping of one specimen over the amplitude, a curve for each frequency, ± 2 sd.

    Over the frequency, where each has one amplitude.
    """
    angular = cycles[0].unit == "rad"
    length, scale = ("rad", 1.0) if angular else ("mm", 1e3)
    units = {
        "stiffness": f"N{'·m/rad' if angular else '/m'}",
        "damping": f"N·{'m·s/rad' if angular else 's/m'}",
    }
    figure, grid = panels(2, 2, (HALF_PAGE, 2.9))
    frequencies = sorted({cycle.frequency_hz for cycle in cycles})
    single = len(frequencies) == len(cycles)
    curves = [
        [c for c in sorted(cycles, key=lambda c: c.amplitude) if c.frequency_hz == f]
        for f in frequencies[:: -(-len(frequencies) // len(COLOURS))]
    ]
    for axes, (name, unit) in zip(grid, units.items(), strict=True):
        for colour, curve in zip(
            COLOURS, [sorted(cycles, key=lambda c: c.frequency_hz)] if single else curves, strict=False
        ):
            axes.errorbar(
                [c.frequency_hz if single else scale * c.amplitude for c in curve],
                [getattr(c, name) for c in curve],
                [2 * getattr(c, f"{name}_sd") for c in curve],
                color=colour,
                marker="o",
                ms=3.5,
                lw=1.2,
                capsize=2,
                label=f"{curve[0].frequency_hz:.4g} Hz",
            )
        axes.set_title(f"Equivalent {name}, {unit}")
        axes.set_xlabel("frequency, Hz" if single else f"amplitude, {length}")
    if not single:
        grid[1].legend()
    return figure


@style()
def interval_plot(
    names: Sequence[str],
    units: Sequence[str],
    methods: Sequence[str],
    values: Real,
    low: Real,
    high: Real,
    truth: Mapping[str, float],
    bands: Mapping[str, tuple[float, float]],
    level: float = 0.95,
    panel: float = PANEL,
) -> Figure:
    """`values`, `low`, `high`: (methods, names).

    Intervals that miss the truth are red, with an open dot; those that run out of the picture end in an arrow.

    bands: name → (centre, standard deviation) at the Cramér-Rao bound, drawn as wide as an interval.  panel: width of
    one unknown, inches.
    """
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    reach, wider = _reach(level), False
    size = (0.6 + panel * columns, rows * (0.75 + ROW * len(methods)) + 0.35)
    figure, grid = panels(len(names), columns, size, sharey=True)
    for k, (name, axes) in enumerate(zip(names, grid, strict=True)):
        if name in bands:
            centre, half = bands[name][0], reach * bands[name][1]
            axes.axvspan(centre - half, centre + half, color=MODEL, alpha=0.12, lw=0)
        wider |= _panel(axes, methods, values[:, k], low[:, k], high[:, k], truth.get(name))
        axes.xaxis.set_major_locator(MaxNLocator(4 if panel >= PANEL else 3, min_n_ticks=2))
        axes.set_title(name)
        axes.set_xlabel("" if units[k] == "1" else units[k], labelpad=1)
    dot: dict[str, Any] = {"marker": "o", "ms": 4, "lw": 1.6}
    filled: dict[str, Any] = {"color": COLOURS[0], "mec": "white", "mew": 0.6}
    handles: list[Line2D | Patch] = [
        Line2D([], [], label=f"value and {100 * level:g} % interval", **dot, **filled)
    ]
    if bool(truth):
        handles.append(Line2D([], [], color=BAD, mfc="white", mew=1.0, label="misses the truth", **dot))
        handles.append(Line2D([], [], color=INK, lw=0.9, label="truth"))
    if bool(bands):
        handles.append(Patch(color=MODEL, alpha=0.12, lw=0, label="interval at the Cramér-Rao bound"))
    if wider:
        arrow: dict[str, Any] = {"marker": ">", "ms": 4.5, "mew": 0, "lw": 1.6}
        handles.append(Line2D([], [], color=COLOURS[0], label="beyond the axis", **arrow))
    layout: dict[str, Any] = {
        "ncols": (5 if columns == 3 else columns),
        "handlelength": 1.8,
        "columnspacing": 1.6,
    }
    figure.legend(handles=handles, loc="outside lower center", **layout)
    return figure


def _reach(level: float) -> float:
    """Standard deviations to either end of an interval."""
    return float(ndtri(0.5 + level / 2))


def _panel(
    axes: Axes, methods: Sequence[str], value: Real, low: Real, high: Real, truth: float | None
) -> bool:
    """Draws one unknown; whether some interval runs out of the picture."""
    place = np.arange(len(methods))
    # What part of the axis is shown: all of the intervals but those WIDE times wider than the narrowest
    width = high - low
    finite = np.isfinite(width) & (width > 0)
    if not np.any(finite):
        middle = float(np.nanmean(value))
        left, right = middle - max(abs(middle), 1.0), middle + max(abs(middle), 1.0)
    else:
        # 6.0: times the narrowest interval: wider ones run out of the picture, for the others would be dots
        shown = finite & (width <= 6.0 * np.min(width[finite]))
        ends = [float(np.min(low[shown])), float(np.max(high[shown]))]
        if truth is not None:
            ends.append(truth)
        margin = 0.08 * (max(ends) - min(ends))
        left, right = min(ends) - margin, max(ends) + margin
    wider = False
    if truth is not None:
        axes.axvline(truth, color=INK, lw=0.9)
    for i in place:
        missed = truth is not None and (truth < low[i] or truth > high[i])
        colour = BAD if missed else COLOURS[0]
        if np.isfinite(low[i]) and np.isfinite(high[i]):
            axes.plot([low[i], high[i]], [i, i], color=colour, lw=1.6, solid_capstyle="butt")
        inner, edge = ("white", BAD) if missed else (colour, "white")
        axes.plot(value[i], i, "o", color=inner, ms=4, mec=edge, mew=1.0 if missed else 0.6)
        for end, arrow, beyond in ((left, "<", low[i] < left), (right, ">", high[i] > right)):
            if beyond:
                wider = True
                axes.plot(end, i, arrow, color=colour, ms=4.5, mew=0, clip_on=False)
    limit_axis(axes.set_xlim, left, right)
    axes.set_ylim(len(methods) - 0.4, -0.6)
    row_names(axes, place.tolist(), methods)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.ticklabel_format(axis="x", useOffset=False, scilimits=(-4, 6))
    return wider
