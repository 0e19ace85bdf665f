"""Measured and estimated frequency responses: amplitude and phase, and in the complex plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, MultipleLocator, NullFormatter, StrMethodFormatter

from dashpot.arrays import Bools, Ints, Real
from dashpot.check.residuals import FrequencyResponse
from dashpot.present.figures.interactive import AxisLabel, hover
from dashpot.present.figures.spectra import FREQUENCY, MANY, PHASE, frequency_axis
from dashpot.present.figures.style import BAD, COLOURS, DATA, MODEL, MUTED, limit_axis, style
from dashpot.present.text.numbers import short

# Amplitude-frequency curves with their unstable parts and folds, from arrays alone.


@dataclass(frozen=True)
class DrawnCurve:
    """One curve: x (P,), y (P, channels), stable (P,) or None, folds (…,); a `thin` one is a backbone."""

    label: str
    x: Real
    y: Real
    stable: Bools | None
    folds: Ints
    thin: bool = False


def response_curves(
    names: Sequence[str], units: Sequence[str], curves: Sequence[DrawnCurve], x_label: str
) -> Figure:
    """A panel for each channel: stable motions drawn through, unstable ones dashed, folds as rings."""
    with style():
        figure = Figure(figsize=(7.6, 2.6 * len(names) + 0.5))
        rows = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
        for channel, (axes, name, unit) in enumerate(zip(rows, names, units, strict=True)):
            for k, curve in enumerate(curves):
                _draw(axes, curve, channel, COLOURS[k % len(COLOURS)])
            axes.set_title(name)
            axes.set_ylabel(f"half peak-to-peak, {unit}")
            axes.set_ylim(bottom=0)
            limit_axis(axes.set_xlim, *_range([curve.x for curve in curves if not curve.thin]))
        rows[-1].set_xlabel(x_label)
        if any(curve.stable is not None and not np.all(curve.stable) for curve in curves):
            rows[0].plot([], [], color=MUTED, lw=1.2, ls=(0, (3, 2)), label="unstable")
        if any(len(curve.folds) for curve in curves):
            rows[0].plot([], [], "o", color=BAD, mfc="white", ms=4, label="fold")
        rows[0].legend(loc="best")
    return figure


def _draw(axes: Axes, curve: DrawnCurve, channel: int, colour: str) -> None:
    y = curve.y[:, channel]
    if curve.thin:
        axes.plot(curve.x, y, color=MUTED, lw=1.0, ls=(0, (6, 2, 1, 2)), label=curve.label, zorder=1)
        return
    stable = np.ones(len(y), dtype=bool) if curve.stable is None else curve.stable
    # A piece between two points is stable where both its ends are.
    through = stable & np.append(stable[1:], True)
    axes.plot(*_pieces(curve.x, y, through), color=colour, lw=1.5, label=curve.label, zorder=3)
    if not np.all(stable):
        axes.plot(*_pieces(curve.x, y, ~through), color=colour, lw=1.2, ls=(0, (3, 2)), zorder=2)
    axes.plot(curve.x[curve.folds], y[curve.folds], "o", color=BAD, mfc="white", ms=4, zorder=4)


def _range(values: Sequence[Real]) -> tuple[float, float]:
    low, high = min(float(np.min(x)) for x in values), max(float(np.max(x)) for x in values)
    margin = 0.02 * (high - low)
    return low - margin, high + margin


def _pieces(x: Real, y: Real, chosen: Bools) -> tuple[Real, Real]:
    """The pieces from each chosen point to the next, with gaps between runs of them."""
    shown = chosen.copy()
    shown[1:] |= chosen[:-1]
    return np.where(shown, x, np.nan), np.where(shown, y, np.nan)


REACH = 1.96  # standard deviations of a 95 % band
MOST_PLANES = 8


def response_figure(responses: Sequence[FrequencyResponse]) -> Figure:
    """A row for each response, amplitude left and phase right: dots with ±2 sd, the model with its 95 % band."""
    rows = len(responses)
    with style():
        figure = Figure(figsize=(8.6, max(1.75 * rows, 2.4) + 0.5))
        grid = figure.subplots(rows, 2, squeeze=False, sharex=True, gridspec_kw={"width_ratios": [3, 2]})
        for (left, right), shown in zip(grid, responses, strict=True):
            _amplitude(left, shown)
            _phase(right, shown)
            left.set_title(f"{shown.channel} over {shown.reference}")
            left.set_ylabel(shown.unit or "ratio")
            hover(left, FREQUENCY, AxisLabel("amplitude", shown.unit))
            hover(right, FREQUENCY, PHASE)
            for axes in (left, right):
                frequency_axis(axes, shown.lines_hz)
        for axes in grid[-1]:
            axes.set_xlabel("frequency, Hz")
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=3)
    return figure


def _amplitude(axes: Axes, shown: FrequencyResponse) -> None:
    size = np.abs(shown.measured)
    below = np.minimum(2 * shown.sd, 0.999 * size)
    many = len(size) > MANY
    axes.errorbar(
        shown.lines_hz, size, yerr=[np.nan_to_num(below), np.nan_to_num(2 * shown.sd)], fmt="o", color=DATA,
        ms=1.6 if many else 3.2, elinewidth=0.4 if many else 0.8, label="measured, ±2 sd", zorder=2, rasterized=many,
    )  # fmt: skip
    curve = np.abs(shown.response)
    if np.any(np.isfinite(shown.log_sd)):
        width = np.exp(np.minimum(REACH * np.nan_to_num(shown.log_sd), 20.0))
        axes.fill_between(
            shown.frequency_hz, curve / width, curve * width, color=MODEL, alpha=0.25, lw=0, zorder=3,
            label="95 % band of the model",
        )  # fmt: skip
    axes.plot(shown.frequency_hz, curve, color=MODEL, lw=1.2, label="model", zorder=4)
    axes.set_yscale("log")
    everything = np.concatenate([size, curve])
    positive = everything[np.isfinite(everything) & (everything > 0)]
    if len(positive):
        low, high = float(np.min(positive)) / 1.6, float(np.max(positive)) * 1.6
        limit_axis(axes.set_ylim, low, high)
        if high < 300 * low:
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())


def _phase(axes: Axes, shown: FrequencyResponse) -> None:
    size, many = np.abs(shown.measured), len(shown.lines_hz) > MANY
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.degrees(np.where(size > 0, shown.sd / size, 0.0))
    axes.errorbar(
        shown.lines_hz, shown.phase_deg, yerr=np.nan_to_num(np.minimum(2 * angle, 180)), fmt="o", color=DATA,
        ms=1.6 if many else 3.2, elinewidth=0.4 if many else 0.8, label="measured, ±2 sd", zorder=2, rasterized=many,
    )  # fmt: skip
    if np.any(np.isfinite(shown.phase_sd_deg)):
        width = np.minimum(REACH * np.nan_to_num(shown.phase_sd_deg), 180.0)
        axes.fill_between(
            shown.frequency_hz, shown.curve_deg - width, shown.curve_deg + width, color=MODEL, alpha=0.25,
            lw=0, zorder=3, label="95 % band of the model",
        )  # fmt: skip
    axes.plot(shown.frequency_hz, shown.curve_deg, color=MODEL, lw=1.2, label="model", zorder=4)
    low, high = float(np.min(shown.curve_deg)), float(np.max(shown.curve_deg))
    limit_axis(axes.set_ylim, np.floor((low - 30) / 90) * 90, np.ceil((high + 30) / 90) * 90)
    axes.yaxis.set_major_locator(MultipleLocator(90 if high - low < 400 else 180))
    axes.set_ylabel("phase, °")


def nyquist_figure(responses: Sequence[FrequencyResponse]) -> Figure:
    """The first responses in the complex plane: each resonance is a circle; lines join measured and model."""
    shown = responses[:MOST_PLANES]
    columns = min(len(shown), 4)
    rows = -(-len(shown) // columns)
    with style():
        width = 8.6 if columns > 2 else 0.4 + 2.6 * columns
        figure = Figure(figsize=(width, 0.3 + width / columns * rows))
        grid = np.atleast_2d(figure.subplots(rows, columns, squeeze=False))
        for axes, response in zip(grid.flat, shown, strict=False):
            H, curve, many = response.measured, response.response, len(response.measured) > MANY
            axes.axhline(0, color=MUTED, lw=0.5)
            axes.axvline(0, color=MUTED, lw=0.5)
            axes.plot(curve.real, curve.imag, color=MODEL, lw=1.2, zorder=3)
            axes.plot(
                H.real, H.imag, "o", color=DATA, ms=1.6 if many else 3.2, label="measured", zorder=4, rasterized=many
            )  # fmt: skip
            lines = [f"{short(float(f), 4)} Hz" for f in response.lines_hz]
            hover(
                axes, AxisLabel("real part", response.unit), AxisLabel("imaginary part", response.unit), lines
            )
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(f"{response.channel} over {response.reference}")
            axes.set_xlabel(f"real part{', ' + response.unit if response.unit else ''}")
            axes.set_ylabel("imaginary part")
            axes.xaxis.set_major_locator(MaxNLocator(4))
            axes.yaxis.set_major_locator(MaxNLocator(4))
        for axes in list(grid.flat)[len(shown) :]:
            axes.set_visible(False)
    return figure
