"""Figures of an identification, from arrays alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, StrMethodFormatter

from dashpot.arrays import Complex, Real
from dashpot.check.profile import Profile
from dashpot.check.residuals import DwellHistory
from dashpot.present.figures.design import HEAT
from dashpot.present.figures.interactive import AxisLabel, hover, hover_cells
from dashpot.present.figures.style import BAD, COLOURS, DATA, HALF_PAGE, INK, MODEL, MUTED, limit_axis, style
from dashpot.present.text.numbers import short

# Dwells in time: measured and predicted, the part used shaded; from histories alone.


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


# Figures of what data tell: shares of the information by frequency, profiles of the likelihood.


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
            limit_axis(axes.set_ylim, 0, 2.2 * limit)
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


FREQUENCY, PHASE = AxisLabel("frequency", "Hz"), AxisLabel("phase", "°")
MANY = 300  # lines from which dots are small and drawn as a picture within the picture
MOST_ROWS = 3  # of one picture: a printed page holds it below what stands before
RAYLEIGH_95 = 1.73  # of an amplitude's size over its standard deviation, √(−ln 0.05)


def _logarithmic(f: Real) -> bool:
    return bool(len(f)) and float(np.max(f)) > 3 * float(np.min(f))


def frequency_axis(axes: Axes, f: Real) -> None:
    """Logarithmic where it spans much, with plain numbers."""
    if not _logarithmic(f):
        return
    axes.set_xscale("log")
    wide = float(np.max(f)) > 300 * float(np.min(f))  # more numbers would run into each other
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0), numticks=12))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def degrees(values: Complex) -> Real:
    """Phases in degrees, (−180, 180]."""
    return np.degrees(np.angle(values))


def rows_of_pictures(rows: int) -> list[range]:
    """Neighbouring rows for each of several pictures, about as many in each."""
    pictures = -(-rows // MOST_ROWS)
    ends = [rows * k // pictures for k in range(pictures + 1)]
    return [range(first, end) for first, end in pairwise(ends)]


def amplitude_and_phase(
    names: Sequence[str],
    units: Sequence[str],
    lines_hz: Real,
    measured: Complex,
    sd: Real,
    curve_hz: Real | None,
    curve: Complex | None,
    predicted: Complex | None,
) -> Figure:
    """A row for each channel, amplitude left and phase right: measured as dots with ±2 sd, the model as a line.

    measured, sd, predicted (lines, channels); curve (points, channels) between the lines, or None: then `predicted`
    stands as crosses at the lines.
    """
    rows = len(names)
    with style():
        figure = Figure(figsize=(8.6, max(1.8 * rows, 2.2) + 0.4))
        grid = figure.subplots(rows, 2, squeeze=False, sharex=True, gridspec_kw={"width_ratios": [3, 2]})
        for row, (name, unit) in enumerate(zip(names, units, strict=True)):
            left, right = grid[row]
            model = None if predicted is None else predicted[:, row]
            _draw_measured(left, right, lines_hz, measured[:, row], sd[:, row], model)
            if curve is not None and curve_hz is not None:
                left.plot(curve_hz, np.abs(curve[:, row]), color=MODEL, lw=1.3, label="model", zorder=2)
                phase = _unbroken(degrees(curve[:, row]))
                right.plot(curve_hz, phase, color=MODEL, lw=1.3, label="model", zorder=2)
            elif model is not None:
                marks: dict[str, Any] = {"marker": "x", "ls": "", "color": MODEL, "ms": 6, "zorder": 2}
                if len(lines_hz) > MANY:
                    marks |= {"marker": ".", "ms": 2, "rasterized": True, "zorder": 4}
                left.plot(lines_hz, np.abs(model), label="model", **marks)
                right.plot(lines_hz, degrees(model), label="model", **marks)
            _amplitude_axis(left, np.abs(measured[:, row]), None if curve is None else np.abs(curve[:, row]))
            left.set_title(name)
            left.set_ylabel(unit)
            right.set_ylabel("phase, °")
            right.set_ylim(-200, 200)
            right.set_yticks([-180, -90, 0, 90, 180])
            hover(left, FREQUENCY, AxisLabel("amplitude", unit))
            hover(right, FREQUENCY, PHASE)
            for axes in (left, right):
                frequency_axis(axes, lines_hz)
        for axes in grid[-1]:
            axes.set_xlabel("frequency, Hz")
        grid[0][0].legend(loc="best")
    return figure


def _draw_measured(
    left: Axes, right: Axes, lines_hz: Real, y: Complex, sd: Real, predicted: Complex | None
) -> None:
    """Amplitudes and phases as dots with ±2 sd; phases in the turn that is nearest to what is predicted."""
    many = len(lines_hz) > MANY
    dots: dict[str, Any] = {
        "fmt": "o",
        "color": DATA,
        "label": "measured, ±2 sd" if np.any(sd > 0) else "measured",
        "zorder": 3,
        "rasterized": many,
    }
    dots |= {"ms": 1.6, "elinewidth": 0.4} if many else {"ms": 3.2, "elinewidth": 0.8}
    size = np.abs(y)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.degrees(np.where(size > 0, sd / size, np.nan))
    reach = [np.nan_to_num(np.minimum(2 * sd, 0.999 * size)), np.nan_to_num(2 * sd)]
    left.errorbar(lines_hz, size, yerr=reach, **dots)
    phase = degrees(y) if predicted is None else _beside(degrees(y), degrees(predicted))
    right.errorbar(lines_hz, phase, yerr=np.nan_to_num(np.minimum(2 * angle, 180)), **dots)


def _amplitude_axis(axes: Axes, size: Real, model: Real | None) -> None:
    """Logarithmic, from the data and the model; an error bar that reaches down to nothing must not flatten both."""
    everything = size if model is None else np.append(size, model)
    positive = everything[np.isfinite(everything) & (everything > 0)]
    if len(positive):
        axes.set_yscale("log")
        limit_axis(axes.set_ylim, float(np.min(positive)) / 2, float(np.max(positive)) * 2)


def _beside(phase: Real, reference: Real) -> Real:
    """The same phases, in the turn that is nearest to the reference."""
    return reference + (phase - reference + 180) % 360 - 180


def _unbroken(phase: Real) -> Real:
    """A gap where the phase jumps by a turn, so that no line crosses the picture."""
    jump = np.abs(np.diff(phase)) > 180
    out = phase.copy()
    out[1:][jump] = np.nan
    return out


def residual_plot(
    names: Sequence[str], lines_hz: Real, size: Real, worst: tuple[str, float, float] | None = None
) -> Figure:
    """Residuals over frequency, |measured − predicted| / sd of the amplitude, (lines, channels), the worst named.

    worst: (channel, Hz, size).  Where the model fits, 95 % lie in the band.
    """
    marks = "os^Dv<>P"
    with style():
        figure = Figure(figsize=(HALF_PAGE, 2.7))
        axes = figure.subplots()
        axes.axhspan(0, RAYLEIGH_95, color=MODEL, alpha=0.08, lw=0)
        for k, name in enumerate(names):
            there = np.isfinite(size[:, k])
            if np.any(there):
                many = int(np.sum(there)) > MANY
                axes.plot(
                    lines_hz[there], size[there, k], marks[k % len(marks)], color=COLOURS[k % len(COLOURS)],
                    ms=2 if many else 4, label=name, rasterized=many,
                )  # fmt: skip
        largest = float(np.max(size[np.isfinite(size)], initial=RAYLEIGH_95))
        if largest > 12:
            axes.set_yscale("symlog", linthresh=2)
        limit_axis(axes.set_ylim, 0, (1.25 if largest <= 12 else 2.0) * largest)
        if worst is not None and np.isfinite(worst[2]):
            name, f, value = worst
            right = f > float(np.sqrt(np.max(lines_hz) * max(np.min(lines_hz), 1e-12)))
            axes.annotate(
                f"{name}, {f:.4g} Hz: {short(value, 2)}", (f, value), textcoords="offset points",
                xytext=(-6 if right else 6, 4), ha="right" if right else "left", fontsize=8, color=INK,
            )  # fmt: skip
        axes.set_ylabel("residual / sd")
        hover(axes, FREQUENCY, AxisLabel("residual", "sd"))
        axes.set_xlabel("frequency, Hz")
        frequency_axis(axes, lines_hz)
        handles, labels = axes.get_legend_handles_labels()
        if handles and len(labels) <= 12:
            figure.legend(
                handles, labels, loc="outside upper left", ncols=6, handletextpad=0.1, columnspacing=1.2
            )
    return figure


def _luminance(colour: Real) -> float:
    """Relative luminance of a colour (red, green, blue, …), WCAG 2: text on less than 0.18 is best white."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour[:3].tolist()]
    return float(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])


def correlation_plot(names: Sequence[str], matrix: Real) -> Figure:
    """Correlation matrix of the estimates, blue for + and red for −, with numbers where there is room.

    matrix (m, m).
    """
    count = len(names)
    size = min(max(0.48 * count + 1.2, 2.4), 7.6)
    with style():
        figure = Figure(figsize=(size + 0.7, size))
        axes = figure.subplots()
        axes.grid(visible=False)
        hover_cells(axes, names, names, matrix, AxisLabel("correlation"))
        image = axes.imshow(matrix, cmap="RdBu", vmin=-1, vmax=1)
        if count <= 12:
            colours = image.to_rgba(np.nan_to_num(matrix))
            for i in range(count):
                for j in range(count):
                    value = float(matrix[i, j])
                    if np.isfinite(value):
                        ink = "white" if _luminance(colours[i, j]) < 0.18 else INK
                        text = f"{value:.2f}".replace("0.", ".").replace("-", "−") if i != j else "1"
                        text = "0" if abs(value) < 0.005 else text
                        axes.text(j, i, text, ha="center", va="center", color=ink, fontsize=7.5)
        if count <= 40:
            axes.set_xticks(range(count), names, rotation=45 if max(map(len, names)) > 3 else 0)
            axes.set_yticks(range(count), names)
        axes.tick_params(length=0)
        for spine in axes.spines.values():
            spine.set_visible(False)
        figure.colorbar(image, ax=axes, shrink=0.8, ticks=[-1, 0, 1])
    return figure
