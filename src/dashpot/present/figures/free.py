"""Figures of what data show without a rig: frequency responses and modes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dashpot.free.response import MeasuredResponse
from dashpot.present.figures.spectra import REACH, frequency_axis
from dashpot.present.figures.style import COLOURS, MUTED, style


@style()
def response_figure(found: MeasuredResponse) -> Figure:
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
