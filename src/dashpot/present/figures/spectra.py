"""Figures of an identification: lines and records as measured and predicted, residuals, what data tell; of what data
show without a rig, frequency responses and modes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, MultipleLocator

from dashpot.arrays import Complex, Real
from dashpot.check.profile import Profile
from dashpot.check.residuals import DwellHistory, FrequencyResponse
from dashpot.check.validation import RecordPrediction
from dashpot.estimate.assessment import Residuals
from dashpot.free.modes import MeasuredModes
from dashpot.free.response import MeasuredResponse
from dashpot.present.figures.interactive import AxisLabel, hover, hover_cells
from dashpot.present.figures.style import (
    BAD,
    COLOURS,
    DATA,
    HALF_PAGE,
    HEAT,
    INK,
    MODEL,
    MUTED,
    heat_bar,
    limit_axis,
    panels,
    plain_log,
    row_names,
    style,
)
from dashpot.present.words import short

FREQUENCY, PHASE = AxisLabel("frequency", "Hz"), AxisLabel("phase", "°")
MOST_PLANES = 8  # of one figure
MANY = 300  # lines from which dots are small and drawn as a picture within the picture
REACH = 1.96  # standard deviations of a 95 % band
RAYLEIGH_95 = 1.73  # of an amplitude's size over its standard deviation, √(−ln 0.05)


def rows_of_pictures(rows: int) -> list[range]:
    """Neighbouring rows for each of several pictures, about as many in each."""
    pictures = -(-rows // 3)  # rows of one picture: a printed page holds three below what stands before
    ends = [rows * k // pictures for k in range(pictures + 1)]
    return [range(first, end) for first, end in pairwise(ends)]


def frequency_axis(axes: Axes, f: Real) -> None:
    """Logarithmic where it spans much, with plain numbers."""
    if not len(f) or float(np.max(f)) <= 3 * float(np.min(f)):
        return
    axes.set_xscale("log")
    wide = float(np.max(f)) > 300 * float(np.min(f))  # more numbers would run into each other
    plain_log(axes.xaxis, (1.0,) if wide else (1.0, 2.0, 5.0))


# Amplitude and phase over frequency.


@style()
def response_figure(responses: Sequence[FrequencyResponse]) -> Figure:
    """A row for each response, amplitude left and phase right: dots with ±2 sd, the model with its 95 % band."""
    figure, pairs = _amplitudes_and_phases(
        [f"{shown.channel} over {shown.reference}" for shown in responses],
        [shown.unit for shown in responses],
        responses[0].lines_hz,
    )
    for (left, right), shown in zip(pairs, responses, strict=True):
        size, f = np.abs(shown.response), shown.frequency_hz
        _draw_measured(left, right, shown.lines_hz, np.abs(shown.measured), shown.sd, shown.phase_deg)
        if np.any(np.isfinite(shown.log_sd)):
            width = np.exp(np.minimum(REACH * np.nan_to_num(shown.log_sd), 20.0))
            _band(left, f, size / width, size * width)
        if np.any(np.isfinite(shown.phase_sd_deg)):
            width = np.minimum(REACH * np.nan_to_num(shown.phase_sd_deg), 180.0)
            _band(right, f, shown.curve_deg - width, shown.curve_deg + width)
        left.plot(f, size, color=MODEL, lw=1.2, label="model", zorder=4)
        right.plot(f, shown.curve_deg, color=MODEL, lw=1.2, label="model", zorder=4)
        _amplitude_axis(left, np.append(np.abs(shown.measured), size))
        low, high = float(np.min(shown.curve_deg)), float(np.max(shown.curve_deg))
        limit_axis(right.set_ylim, np.floor((low - 30) / 90) * 90, np.ceil((high + 30) / 90) * 90)
        right.yaxis.set_major_locator(MultipleLocator(90 if high - low < 400 else 180))
    _legend_above(figure, pairs[0][0], 3)
    return figure


@style()
def amplitude_and_phase(
    names: Sequence[str],
    units: Sequence[str],
    lines_hz: Real,
    measured: Complex,
    sd: Real,
    predicted: Complex,
) -> Figure:
    """A row for each channel, amplitude left and phase right: measured as dots with ±2 sd, predicted as crosses.

    measured, sd, predicted (lines, channels).
    """
    marks: dict[str, Any] = {"marker": "x", "ls": "", "color": MODEL, "ms": 6, "zorder": 2, "label": "model"}
    if len(lines_hz) > MANY:
        marks |= {"marker": ".", "ms": 2, "rasterized": True, "zorder": 4}
    figure, pairs = _amplitudes_and_phases(names, units, lines_hz)
    for (left, right), y, spread, model in zip(pairs, measured.T, sd.T, predicted.T, strict=True):
        expected = np.degrees(np.angle(model))
        # in the turn that is nearest to what is predicted
        phase = expected + (np.degrees(np.angle(y)) - expected + 180) % 360 - 180
        _draw_measured(left, right, lines_hz, np.abs(y), spread, phase)
        left.plot(lines_hz, np.abs(model), **marks)
        right.plot(lines_hz, expected, **marks)
        _amplitude_axis(left, np.abs(y))
        right.set_ylim(-200, 200)
        right.set_yticks([-180, -90, 0, 90, 180])
    pairs[0][0].legend(loc="best")
    return figure


def residual_channels_figure(found: Residuals, places: Sequence[int]) -> Figure:
    """Channels as measured and as predicted."""
    # Of another experiment's channel there is nothing to compare a prediction with.
    predicted = np.where(np.isfinite(found.measured), found.predicted, np.nan)[:, places]
    names, units = [found.channels[i] for i in places], [found.units[i] for i in places]
    f, measured, sd = found.frequency_hz, found.measured[:, places], found.sd[:, places]
    return amplitude_and_phase(names, units, f, measured, sd, predicted)


def _amplitudes_and_phases(
    titles: Sequence[str], units: Sequence[str], lines_hz: Real
) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """A figure with a row of two panels for each title, amplitude and phase over frequency."""
    rows, ratios = len(titles), {"width_ratios": [3, 2]}
    size = (8.6, max(1.75 * rows, 2.4) + 0.5)
    figure, flat = panels(2 * rows, 2, size, sharex=True, gridspec_kw=ratios)
    pairs = list(zip(flat[::2], flat[1::2], strict=True))
    for (left, right), title, unit in zip(pairs, titles, units, strict=True):
        left.set_title(title)
        left.set_ylabel(unit or "ratio")
        right.set_ylabel("phase, °")
        hover(left, FREQUENCY, AxisLabel("amplitude", unit))
        hover(right, FREQUENCY, PHASE)
    for axes in flat:
        frequency_axis(axes, lines_hz)
    for axes in flat[-2:]:
        axes.set_xlabel("frequency, Hz")
    return figure, pairs


def _draw_measured(left: Axes, right: Axes, lines_hz: Real, size: Real, sd: Real, phase: Real) -> None:
    """Amplitudes and phases in degrees as dots with ±2 sd, (lines,) each."""
    many = len(lines_hz) > MANY
    dots: dict[str, Any] = {"fmt": "o", "color": DATA, "rasterized": many, "zorder": 2}
    dots |= {"ms": 1.6, "elinewidth": 0.4} if many else {"ms": 3.2, "elinewidth": 0.8}
    dots["label"] = "measured, ±2 sd" if np.any(sd > 0) else "measured"
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.degrees(np.where(size > 0, sd / size, 0.0))
    # an error bar that reaches down to nothing must not flatten the picture
    reach = [np.nan_to_num(np.minimum(2 * sd, 0.999 * size)), np.nan_to_num(2 * sd)]
    left.errorbar(lines_hz, size, yerr=reach, **dots)
    right.errorbar(lines_hz, phase, yerr=np.nan_to_num(np.minimum(2 * angle, 180)), **dots)


def _band(axes: Axes, f: Real, low: Real, high: Real) -> None:
    axes.fill_between(f, low, high, color=MODEL, alpha=0.25, lw=0, zorder=3, label="95 % band of the model")


def _amplitude_axis(axes: Axes, sizes: Real) -> None:
    """Logarithmic around these amplitudes, with plain numbers where they fit."""
    positive = sizes[np.isfinite(sizes) & (sizes > 0)]
    if len(positive):
        axes.set_yscale("log")
        low, high = float(np.min(positive)) / 1.6, float(np.max(positive)) * 1.6
        limit_axis(axes.set_ylim, low, high)
        if high < 300 * low:
            plain_log(axes.yaxis)


def _legend_above(figure: Figure, axes: Axes, columns: int) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=columns)


@style()
def nyquist_figure(responses: Sequence[FrequencyResponse]) -> Figure:
    """The first responses in the complex plane: each resonance is a circle; lines join measured and model."""
    shown = responses[:MOST_PLANES]
    columns = min(len(shown), 4)
    width = 8.6 if columns > 2 else 0.4 + 2.6 * columns
    size = (width, 0.3 + width / columns * -(-len(shown) // columns))
    figure, grid = panels(len(shown), columns, size)
    for axes, response in zip(grid, shown, strict=True):
        H, curve, many = response.measured, response.response, len(response.measured) > MANY
        dots: dict[str, Any] = {
            "color": DATA,
            "ms": 1.6 if many else 3.2,
            "rasterized": many,
            "label": "measured",
        }
        axes.axhline(0, color=MUTED, lw=0.5)
        axes.axvline(0, color=MUTED, lw=0.5)
        axes.plot(curve.real, curve.imag, color=MODEL, lw=1.2, zorder=3)
        axes.plot(H.real, H.imag, "o", zorder=4, **dots)
        lines = [f"{short(float(f), 4)} Hz" for f in response.lines_hz]
        parts = AxisLabel("real part", response.unit), AxisLabel("imaginary part", response.unit)
        hover(axes, *parts, lines)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{response.channel} over {response.reference}")
        axes.set_xlabel(f"real part{', ' + response.unit if response.unit else ''}")
        axes.set_ylabel("imaginary part")
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
    return figure


# Whole records, and dwells in time.


def drawn_of(predictions: Sequence[RecordPrediction]) -> RecordPrediction:
    """What is drawn of several: the first whole record, or, where there is none, the settled lines."""
    return next((part for part in predictions if part.samples), predictions[0])


@style()
def prediction_figure(part: RecordPrediction, rows: Sequence[int] | None = None) -> Figure:
    """A whole record in time (left) and by frequency, or settled lines; of all channels or of those in these places."""
    chosen = range(len(part.channels)) if rows is None else rows
    names, units = [part.channels[i] for i in chosen], [part.units[i] for i in chosen]
    f, shown, expected = part.frequency_hz, part.measured[:, chosen], part.predicted[:, chosen]
    if not part.samples:
        return amplitude_and_phase(names, units, f, shown, np.full(shown.shape, np.nan), expected)
    time, measured, predicted = part.histories()
    looks = (("measured", DATA, 0.8), ("predicted", MODEL, 0.7), ("difference", BAD, 0.6))
    figure, flat = panels(2 * len(names), 2, (9, 2.1 * len(names) + 0.4))
    rows_of = zip(chosen, names, units, flat[::2], flat[1::2], strict=True)
    for row, (place, name, unit, left, right) in enumerate(rows_of):
        histories = measured[:, place], predicted[:, place]
        spectra = shown[:, row], expected[:, row]
        for k, (label, colour, width) in enumerate(looks):
            history = histories[k] if k < 2 else histories[0] - histories[1]
            spectrum = spectra[k] if k < 2 else spectra[0] - spectra[1]
            left.plot(time, history, color=colour, linewidth=width, label=label)
            right.semilogy(f, np.abs(spectrum), color=colour, linewidth=width, label=label)
        hover(left, AxisLabel("time", "s"), AxisLabel(name, unit))
        hover(right, FREQUENCY, AxisLabel(name, unit))
        left.set_ylabel(f"{name}, {unit}")
        right.set_ylabel(unit)
        right.set_title(name)
    _legend_above(figure, flat[0], 3)
    flat[-2].set_xlabel("time, s")
    flat[-1].set_xlabel("frequency, Hz")
    return figure


USED = "#d7e8f0"


@style()
def whole_dwells(dwells: Sequence[DwellHistory]) -> Figure:
    """A column for each dwell, a row for each channel: the reach of each period, the part used shaded."""
    figure, grid = _dwell_panels(dwells)
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
    _legend_above(figure, grid[0, 0], 2)
    return figure


@style()
def beginnings(dwells: Sequence[DwellHistory]) -> Figure:
    """The same channels around the beginning of the part used: samples as points, the prediction as a curve."""
    figure, grid = _dwell_panels(dwells)
    for column, dwell in enumerate(dwells):
        period = 1 / dwell.frequency_hz
        first = max(dwell.begin - period, 0.0)
        last = min(dwell.begin + 4.0 * period, float(dwell.time[-1]))
        kept = (dwell.time >= first) & (dwell.time <= last)
        points = 400  # of a curve
        every = max(int(np.sum(kept)) // points, 1)
        samples, measured = dwell.time[kept][::every], dwell.measured[kept][::every]
        time = np.linspace(first, last, points)
        curve = dwell.predicted(time)
        for row, axes in enumerate(grid[:, column]):
            _used(axes, dwell.begin, min(dwell.end, last))
            axes.plot(samples, measured[:, row], "o", ms=2.0, color=MUTED, zorder=2, label="measured")
            axes.plot(time, curve[:, row], color=MODEL, lw=1.0, zorder=4, label="predicted")
            hover(axes, AxisLabel("time", "s"), AxisLabel(dwell.channels[row], dwell.units[row]))
    _legend_above(figure, grid[0, 0], 2)
    return figure


def _dwell_panels(dwells: Sequence[DwellHistory]) -> tuple[Figure, Any]:
    rows = len(dwells[0].channels)
    figure = Figure(figsize=(max(3.0 * len(dwells), 5.0), max(1.1 * rows, 2.0) + 0.5))
    grid = figure.subplots(rows, len(dwells), squeeze=False, sharex="col", sharey="row")
    for dwell, column in zip(dwells, grid.T, strict=True):
        column[0].set_title(f"{short(dwell.frequency_hz, 4)} Hz")
        column[-1].set_xlabel("time, s")
    for name, unit, axes in zip(dwells[0].channels, dwells[0].units, grid[:, 0], strict=True):
        axes.set_ylabel(f"{name}, {unit}")
    return figure, grid


def _used(axes: Axes, begin: float, end: float) -> None:
    """The part used, told by its ends as well where shades cannot be."""
    axes.axvspan(begin, end, color=USED, lw=0, zorder=0)
    for place in (begin, end):
        axes.axvline(place, color=INK, lw=0.9, ls="--", zorder=3)


def _outline(time: Real, values: Real, frequency_hz: float) -> tuple[Real, Real, Real]:
    """(middles, least, greatest) of at most 300 neighbouring pieces, of a period at least, of a history."""
    periods = int(frequency_hz * float(time[-1] - time[0]))
    pieces = max(min(300, periods), 2)
    starts = np.unique(np.linspace(0, len(time), pieces, endpoint=False).astype(int))
    ends = np.append(starts[1:], len(time)) - 1
    middles: Real = (time[starts] + time[ends]) / 2
    middles[[0, -1]] = time[0], time[-1]
    return middles, np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


# What data tell: residuals, correlations, shares of the information by frequency, profiles of the likelihood.


@style()
def residual_plot(
    names: Sequence[str], lines_hz: Real, size: Real, worst: tuple[str, float, float] | None = None
) -> Figure:
    """Residuals over frequency, |measured − predicted| / sd of the amplitude, (lines, channels), the worst named.

    worst: (channel, Hz, size).  Where the model fits, 95 % lie in the band.
    """
    marks = "os^Dv<>P"
    figure = Figure(figsize=(HALF_PAGE, 2.7))
    axes = figure.subplots()
    axes.axhspan(0, RAYLEIGH_95, color=MODEL, alpha=0.08, lw=0)
    for k, name in enumerate(names):
        there = np.isfinite(size[:, k])
        if np.any(there):
            many = int(np.sum(there)) > MANY
            look: dict[str, Any] = {
                "color": COLOURS[k % len(COLOURS)],
                "ms": 2 if many else 4,
                "rasterized": many,
            }
            axes.plot(lines_hz[there], size[there, k], marks[k % len(marks)], label=name, **look)
    largest = float(np.max(size[np.isfinite(size)], initial=RAYLEIGH_95))
    if largest > 12:
        axes.set_yscale("symlog", linthresh=2)
    limit_axis(axes.set_ylim, 0, (1.25 if largest <= 12 else 2.0) * largest)
    if worst is not None and np.isfinite(worst[2]):
        name, f, value = worst
        right = f > float(np.sqrt(np.max(lines_hz) * max(np.min(lines_hz), 1e-12)))
        axes.annotate(
            f"{name}, {f:.4g} Hz: {short(value, 2)}",
            (f, value),
            textcoords="offset points",
            xytext=(-6 if right else 6, 4),
            ha="right" if right else "left",
            fontsize=8,
            color=INK,
        )
    axes.set_ylabel("residual / sd")
    hover(axes, FREQUENCY, AxisLabel("residual", "sd"))
    axes.set_xlabel("frequency, Hz")
    frequency_axis(axes, lines_hz)
    handles, labels = axes.get_legend_handles_labels()
    if handles and len(labels) <= 12:
        layout = {"ncols": 6, "handletextpad": 0.1, "columnspacing": 1.2}
        figure.legend(handles, labels, loc="outside upper left", **layout)
    return figure


@style()
def correlation_plot(names: Sequence[str], matrix: Real) -> Figure:
    """Correlation matrix of the estimates, blue for + and red for −, with numbers where there is room.

    matrix (m, m).
    """
    count = len(names)
    size = min(max(0.48 * count + 1.2, 2.4), 7.6)
    figure = Figure(figsize=(size + 0.7, size))
    axes = figure.subplots()
    axes.grid(visible=False)
    hover_cells(axes, names, names, matrix, AxisLabel("correlation"))
    image = axes.imshow(matrix, cmap="RdBu", vmin=-1, vmax=1)
    if count <= 12:
        colours = image.to_rgba(np.nan_to_num(matrix))
        for i, j in np.argwhere(np.isfinite(matrix)).tolist():
            value = float(matrix[i, j])
            text = f"{value:.2f}".replace("0.", ".").replace("-", "−") if i != j else "1"
            text = "0" if abs(value) < 0.005 else text
            # Relative luminance of the colour, WCAG 2: text on less than 0.18 is best white
            linear = [
                c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
                for c in colours[i, j, :3].tolist()
            ]
            luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
            ink = "white" if luminance < 0.18 else INK
            axes.text(j, i, text, ha="center", va="center", color=ink, fontsize=7.5)
    if count <= 40:
        axes.set_xticks(range(count), names, rotation=45 if max(map(len, names)) > 3 else 0)
        axes.set_yticks(range(count), names)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    figure.colorbar(image, ax=axes, shrink=0.8, ticks=[-1, 0, 1])
    return figure


@style()
def shares_figure(names: Sequence[str], frequency_hz: Real, shares: Real) -> Figure:
    """What lines (or bands, by their middle) tell of each unknown, per cent; shares (lines, unknowns)."""
    lines = len(frequency_hz)
    figure = Figure(figsize=(HALF_PAGE, max(1.6, 0.26 * len(names) + 1.0)))
    axes = figure.subplots()
    top = max(float(np.nanmax(shares, initial=0.0)), 1e-9)
    edges = np.arange(lines + 1), np.arange(len(names) + 1)
    look: dict[str, Any] = {
        "cmap": HEAT,
        "vmin": 0,
        "vmax": 100 * top,
        "rasterized": lines * len(names) > 2000,
    }
    mesh = axes.pcolormesh(*edges, 100 * shares.T, **look)
    places = np.arange(0, lines, max(1, -(-lines // 10)))
    axes.xaxis.set_major_locator(FixedLocator([float(k) + 0.5 for k in places]))
    axes.set_xticklabels([short(float(frequency_hz[k]), 3) for k in places])
    row_names(axes, [k + 0.5 for k in range(len(names))], names)
    axes.set_ylim(len(names), 0)
    columns = [f"{short(float(f), 4)} Hz" for f in frequency_hz]
    hover_cells(axes, names, columns, 100 * shares.T, AxisLabel("share", "%"))
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.set_xlabel("frequency, Hz")
    heat_bar(mesh, axes, "% of the information")
    return figure


@style()
def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """Rise of χ² along each unknown, all others fitted again, with the parabola of the normal interval."""
    columns = min(len(profiles), 2)
    size = (HALF_PAGE if columns == 2 else 3.2, 0.6 + 2.2 * -(-len(profiles) // columns))
    figure, grid = panels(len(profiles), columns, size)
    for axes, shown in zip(grid, profiles, strict=True):
        axes.plot(shown.points, shown.rise, color=MODEL, lw=1.4, label="profile")
        value, half = float(shown.value), (float(shown.normal_upper) - float(shown.normal_lower)) / 2
        x = np.linspace(float(np.min(shown.points)), float(np.max(shown.points)), 100)
        limit = float(shown.threshold)
        parabola = limit * ((x - value) / half) ** 2
        axes.plot(x, parabola, color=MUTED, lw=1.0, ls=(0, (3, 2)), label="normal")
        axes.axhline(limit, color=INK, lw=0.7)
        for end in (float(shown.lower), float(shown.upper)):
            if np.isfinite(end):
                axes.axvline(end, color=BAD if bool(shown.misleads) else MODEL, lw=0.8)
        limit_axis(axes.set_ylim, 0, 2.2 * limit)
        unit = "" if shown.unit == "1" else shown.unit
        hover(axes, AxisLabel(shown.name, unit), AxisLabel("rise of χ²"))
        axes.set_title(shown.name)
        axes.set_xlabel(unit)
        axes.set_ylabel("rise of χ²")
    grid[0].legend(loc="upper center")
    return figure


@style()
def measured_response_figure(found: MeasuredResponse) -> Figure:
    """Magnitude with standard deviation and 95 % interval, phase and coherence over frequency, and the complex plane,
    there over each response's largest; a column for each input."""
    nu = len(found.inputs)
    figure = Figure(figsize=(7.6 if nu == 1 else 4.6 * nu, 10.4))
    grid = figure.subplots(4, nu, squeeze=False, height_ratios=(3, 1.6, 1, 3))
    f, sd = found.frequency_hz, found.sd
    thin = 0.8 if len(f) > 300 else 1.2
    marks = "." if len(f) < 80 else ""
    for j, into in enumerate(found.inputs):
        magnitude, phase, coherence, plane = grid[:, j]
        for i, out in enumerate(found.outputs):
            H, colour, label = found.values[:, i, j], COLOURS[i % len(COLOURS)], f"{out.name}/{into.name}"
            unit = found.unit(out, into)
            label = f"{label}, {unit}" if unit else label
            magnitude.plot(f, np.abs(H), marks + "-", color=colour, lw=thin, ms=3, label=label)
            magnitude.plot(f, sd[:, i, j], ":", color=colour, lw=0.8)
            phase.plot(f, np.degrees(np.angle(H)), ".", color=colour, ms=2)
            coherence.plot(f, found.coherence[:, i], color=colour, lw=thin)
            spread = REACH * sd[:, i, j]
            low = np.maximum(np.abs(H) - spread, 1e-2 * np.abs(H))
            magnitude.fill_between(f, low, np.abs(H) + spread, color=colour, alpha=0.2, lw=0)
            turned = H / np.max(np.abs(H), initial=np.finfo(float).tiny)
            plane.plot(turned.real, turned.imag, marks + "-", color=colour, lw=thin, ms=3)
        magnitude.plot([], [], ":", color=MUTED, label="standard deviation")
        magnitude.fill_between([], [], color=MUTED, alpha=0.2, lw=0, label="95 % interval")
        magnitude.set_yscale("log")
        magnitude.set_title(f"responses to {into.name}")
        magnitude.legend(loc="best")
        phase.set_yticks([-180, -90, 0, 90, 180])
        coherence.set_ylim(0, 1.05)
        coherence.set_xlabel("frequency, Hz")
        for axes in (magnitude, phase, coherence):
            frequency_axis(axes, f)
            axes.tick_params(labelbottom=axes is coherence)
        plane.set_aspect("equal", adjustable="datalim")
        plane.set_xlabel("real part, over the largest magnitude")
    for axes, label in zip(grid[:, 0], ("magnitude", "phase, °", "coherence", "imaginary part"), strict=True):
        axes.set_ylabel(label)
    return figure


@style()
def modes_figure(found: MeasuredModes) -> Figure:
    """The outputs as measured and fitted, and above them poles of least-squares fits of growing order.

    Poles that the order below has too are dots; the modes that were found are lines.
    """
    figure = Figure(figsize=(7.6, 6.6))
    poles, lines = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 2))
    f, of_orders = found.frequency, found.stabilisation
    inside = (of_orders.frequency_hz > f[0]) & (of_orders.frequency_hz < f[-1])
    for stable, marker, colour, label in ((False, "+", MUTED, "new pole"), (True, "o", MODEL, "stable pole")):
        some = inside & (of_orders.stable == stable)
        poles.plot(
            of_orders.frequency_hz[some], of_orders.order[some], marker, ms=3, color=colour, label=label
        )
    poles.set_ylabel("order")
    poles.set_title("stabilisation")
    size, fitted = (np.sqrt(np.sum(np.abs(x) ** 2, axis=1)) for x in (found.measured, found.modelled))
    error = np.sqrt(np.sum(np.abs(found.measured - found.modelled) ** 2, axis=1))
    lines.plot(f, size, ".", color=DATA, ms=3 if len(f) < 500 else 1.5, label="measured")
    lines.plot(f, error, ".", color=MUTED, ms=1.5, label="difference")
    lines.plot(f, fitted, color=MODEL, lw=1.0, label="fitted")
    for k, hz in enumerate(found.frequency_hz):
        for axes in (poles, lines):
            axes.axvline(hz, color=COLOURS[1], lw=0.8, zorder=1, label="mode" if k == 0 else None)
    lines.set_yscale("log")
    lines.set_title("all outputs together (root of the sum of squares)")
    lines.set_xlabel("frequency, Hz")
    frequency_axis(lines, f)
    for axes in (poles, lines):
        axes.legend(loc="best")
    return figure
