"""Figures of what data show without a rig: frequency responses and modes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dashpot.free.modes import MeasuredModes
from dashpot.free.response import MeasuredResponse
from dashpot.present.figures.spectra import REACH, frequency_axis
from dashpot.present.figures.style import COLOURS, DATA, MODEL, MUTED, style


@style()
def measured_response_figure(found: MeasuredResponse) -> Figure:
    """Magnitude with its standard deviation, phase and coherence over frequency; a column for each input."""
    nu = len(found.inputs)
    figure = Figure(figsize=(7.6 if nu == 1 else 4.6 * nu, 7.2))
    grid = figure.subplots(3, nu, squeeze=False, sharex=True, height_ratios=(3, 1.6, 1))
    f, sd = found.frequency_hz, found.sd
    thin = 0.8 if len(f) > 300 else 1.2
    marks = "." if len(f) < 80 else ""
    for j, into in enumerate(found.inputs):
        magnitude, phase, coherence = grid[:, j]
        for i, out in enumerate(found.outputs):
            H, colour, label = found.values[:, i, j], COLOURS[i % len(COLOURS)], f"{out.name}/{into.name}"
            unit = found.unit(out, into)
            label = f"{label}, {unit}" if unit else label
            magnitude.plot(f, np.abs(H), marks + "-", color=colour, lw=thin, ms=3, label=label)
            magnitude.plot(f, sd[:, i, j], ":", color=colour, lw=0.8)
            phase.plot(f, np.degrees(np.angle(H)), ".", color=colour, ms=2)
            coherence.plot(f, found.coherence[:, i], color=colour, lw=thin)
            if marks:
                spread = REACH * sd[:, i, j]
                low = np.maximum(np.abs(H) - spread, 1e-2 * np.abs(H))
                magnitude.fill_between(f, low, np.abs(H) + spread, color=colour, alpha=0.2, lw=0)
        magnitude.plot([], [], ":", color=MUTED, label="standard deviation")
        magnitude.set_yscale("log")
        magnitude.set_title(f"responses to {into.name}")
        magnitude.legend(loc="best")
        phase.set_yticks([-180, -90, 0, 90, 180])
        coherence.set_ylim(0, 1.05)
        coherence.set_xlabel("frequency, Hz")
        frequency_axis(coherence, f)
    for axes, label in zip(grid[:, 0], ("magnitude", "phase, °", "coherence"), strict=True):
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
