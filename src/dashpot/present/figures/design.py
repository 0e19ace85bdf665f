"""Figures of a planned test, from arrays alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    StrMethodFormatter,
)
from matplotlib.transforms import Bbox

from dashpot.arrays import Real
from dashpot.present.figures.style import COLOURS, INK, MODEL, MUTED, style
from dashpot.present.text.numbers import short

HEAT = LinearSegmentedColormap.from_list("heat", ["#ffffff", "#d5e6ee", "#7fb6cd", "#0b6e99", "#083d56"])
OTHER, EARLIER = "#b0531a", "#7b8794"
MOST_NAMED = 8  # dwells whose frequencies are written beside them
CLEAR = 4.0  # px around a dwell and between names
PLACES = (((6, 3), "left"), ((-6, 3), "right"), ((0, 7), "center"), ((6, -8), "left"), ((-6, -8), "right"))
FRAME: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none"}  # over bars and curves


@dataclass(frozen=True)
class Bars:
    """One test's predicted relative standard deviations, per cent (parameters,), and what to call it."""

    label: str
    percent: Real


def plan_figure(
    title: str,
    frequency_hz: Real,
    curves: Sequence[tuple[str, Real]],
    dwells_hz: Real,
    dwells: Real,
    dwell_unit: str,
    names: Sequence[str],
    shares: Real,
    bars: Sequence[str],
    tests: Sequence[Bars],
) -> Figure:
    """Where to dwell and for how long, what each frequency tells of each parameter, and the expected intervals.

    frequency_hz (f,); curves: directional derivatives over it, one for each pattern of the drive, (f,); dwells_hz,
    dwells (d,); shares (f, parameters): 1 is what the average sample of the test adds.
    """
    with style():
        rows = max(1.3, 0.24 * len(names) + 0.5)
        deep = max(1.4, (0.12 + 0.11 * len(tests)) * len(bars) + 0.6)
        figure = Figure(figsize=(7.4, 2.6 + rows + deep))
        top, middle, bottom = figure.subplots(3, 1, gridspec_kw={"height_ratios": [2.3, rows, deep]})
        over = _dwells(top, frequency_hz, curves, dwells_hz, dwells, dwell_unit)
        top.set_title(title)
        _heat(middle, frequency_hz, names, shares, dwells_hz)
        _intervals(bottom, bars, tests)
        if len(dwells_hz) <= MOST_NAMED:
            figure.draw_without_rendering()  # the layout, by which places are known
            _name_dwells(over, dwells_hz, dwells)
    return figure


def _axis(axes: Axes, f: Real) -> None:
    axes.set_xlim(float(np.min(f)) / 1.02, float(np.max(f)) * 1.02)
    if float(np.max(f)) > 2 * float(np.min(f)):
        axes.set_xscale("log")
        wide = float(np.max(f)) > 8 * float(np.min(f))
        axes.xaxis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if wide else tuple(range(1, 10)), numticks=14)
        )
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_minor_locator(NullLocator())


def _dwells(
    axes: Axes, f: Real, curves: Sequence[tuple[str, Real]], dwells_hz: Real, dwells: Real, unit: str
) -> Axes:
    """The curves, and over them, in axes of their own, which are given back, the dwells."""
    for i, (label, curve) in enumerate(curves):
        axes.plot(f, curve, color=COLOURS[i % len(COLOURS)], lw=1.4, label=label, zorder=3)
    axes.axhline(1, color=MUTED, lw=0.8, ls=(0, (3, 2)), zorder=2)
    _axis(axes, f)
    axes.set_ylim(0, 1.08)
    axes.set_ylabel("worth of a sample")
    if len(curves) > 1:
        axes.legend(loc="best", **FRAME)
    twin = axes.twinx()
    twin.grid(False)
    twin.spines["right"].set_visible(True)
    most = float(np.max(dwells, initial=0.0))
    twin.vlines(dwells_hz, 0, dwells, color=OTHER, lw=2.2, zorder=4)
    twin.plot(dwells_hz, dwells, "o", color=OTHER, ms=5, zorder=5, clip_on=False)
    twin.set_ylim(0, 1.3 * most if most > 0 else 1)
    twin.set_ylabel(f"dwell, {unit}", color=OTHER)
    twin.yaxis.set_major_locator(MaxNLocator(5, integer=unit == "samples"))
    twin.tick_params(axis="y", colors=OTHER)
    return twin


def _name_dwells(axes: Axes, dwells_hz: Real, dwells: Real) -> None:
    """The frequency of each dwell beside its dot, the longest first, where it touches no other name or dwell."""
    dots = axes.transData.transform(np.stack([dwells_hz, dwells], axis=1))
    bottom = axes.get_window_extent().y0
    stems = [Bbox([[x - CLEAR, bottom], [x + CLEAR, y + CLEAR]]) for x, y in dots]
    names: list[Bbox] = []
    for k in np.argsort(-dwells):
        x, y = float(dwells_hz[k]), float(dwells[k])
        taken = [*names, *(stem for i, stem in enumerate(stems) if i != k)]
        for offset, sideways in PLACES:
            text = axes.annotate(
                f"{x:.4g} Hz", (x, y), textcoords="offset points", xytext=offset, fontsize=8, color=OTHER, ha=sideways,
                zorder=6, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8},
            )  # fmt: skip
            box = text.get_window_extent()
            inside = axes.get_window_extent().contains(box.x0, box.y0) and axes.get_window_extent().contains(
                box.x1, box.y1
            )
            if inside and not any(box.overlaps(other) for other in taken):
                names.append(box.padded(CLEAR))
                break
            text.remove()


def _heat(axes: Axes, f: Real, names: Sequence[str], shares: Real, dwells_hz: Real) -> None:
    edges = (
        np.concatenate([[f[0]], np.sqrt(f[1:] * f[:-1]), [f[-1]]])
        if len(f) > 1
        else np.array([f[0] / 1.1, f[0] * 1.1])
    )
    mesh = axes.pcolormesh(
        edges, np.arange(len(names) + 1), np.clip(shares.T, 0, 3), cmap=HEAT, vmin=0, vmax=3, rasterized=True
    )
    axes.vlines(dwells_hz, 0, len(names), color=OTHER, lw=1.0, ls=(0, (2, 2)))
    axes.set_ylim(len(names), 0)
    axes.yaxis.set_major_locator(FixedLocator([i + 0.5 for i in range(len(names))]))
    axes.set_yticklabels(list(names))
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.set_title("What a sample at each frequency tells about each parameter")
    _axis(axes, f)
    axes.set_xlabel("frequency, Hz")
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01, ticks=[0, 1, 2, 3])
    bar.ax.set_yticklabels(["0", "1", "2", "≥ 3"])
    bar.set_label("× mean")
    bar.outline.set_visible(False)


def _intervals(axes: Axes, names: Sequence[str], tests: Sequence[Bars]) -> None:
    colours = [MODEL, OTHER, EARLIER, COLOURS[2]]
    height = 0.78 / max(len(tests), 1)
    y = np.arange(len(names))
    largest = max(
        (float(np.max(test.percent[np.isfinite(test.percent)], initial=0.0)) for test in tests), default=1.0
    )
    smallest = min((float(np.min(test.percent)) for test in tests), default=largest)
    logarithmic = largest > 30 * smallest > 0
    for i, test in enumerate(tests):
        at = y + (i - (len(tests) - 1) / 2) * height
        axes.barh(
            at, test.percent, height * 0.86, color=colours[i % len(colours)], label=test.label, zorder=3
        )
        for value, place in zip(test.percent, at, strict=True):
            if np.isfinite(value) and height > 0.15:
                axes.annotate(
                    short(value, 2), (value, place), textcoords="offset points", xytext=(3, 0), va="center", fontsize=7,
                    color=INK,
                )  # fmt: skip
    axes.set_yticks(y)
    axes.set_yticklabels(list(names))
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    if logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.set_xlim(smallest / 2, largest * 2)
    else:
        axes.set_xlim(0, 1.14 * largest)
    axes.set_xlabel("expected standard deviation, per cent of the value")
    axes.set_title("Expected intervals")
    if len(tests) > 1:
        axes.legend(loc="best", **FRAME)


def progress_figure(
    names: Sequence[str], samples: Real, relative: Real, ahead: Real, extrapolated: Real, targets: Real
) -> Figure:
    """Relative standard deviations in per cent against samples: so far (steps, parameters), and as they would go on.

    ahead (points,), extrapolated (points, parameters); targets (parameters,), NaN where there is none.
    """
    with style():
        figure = Figure(figsize=(7.4, 3.6))
        axes = figure.subplots()
        for j, name in enumerate(names):
            colour = COLOURS[j % len(COLOURS)]
            axes.plot(samples, relative[:, j], "o-", color=colour, ms=3.5, lw=1.4, label=name)
            axes.plot(ahead, extrapolated[:, j], color=colour, lw=1.0, ls=(0, (3, 2)))
        for target in np.unique(targets[np.isfinite(targets)]):
            axes.axhline(float(target), color=INK, lw=0.9)
            axes.annotate(
                f"target: {target:.3g} %", (1, float(target)), xycoords=("axes fraction", "data"), fontsize=8,
                textcoords="offset points", xytext=(-2, 3), ha="right",
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set_xscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("samples")
        axes.set_ylabel("standard deviation, per cent")
        axes.set_title("Intervals as data come in, and with more of the same (dashed)")
        axes.legend(ncols=2 if len(names) > 5 else 1, loc="upper right")
    return figure
