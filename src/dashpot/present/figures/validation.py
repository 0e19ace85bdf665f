"""Measured and predicted histories, spectra and lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dashpot.arrays import Complex, Real
from dashpot.check.validation import RecordPrediction
from dashpot.present.figures.interactive import AxisLabel, hover
from dashpot.present.figures.spectra import FREQUENCY, amplitude_and_phase
from dashpot.present.figures.style import BAD, DATA, MODEL, style


def prediction_figure(part: RecordPrediction, rows: Sequence[int] | None = None) -> Figure:
    """A whole record in time and by frequency, or settled lines; of all channels or of those in these places."""
    chosen = range(len(part.channels)) if rows is None else rows
    names, units = [part.channels[i] for i in chosen], [part.units[i] for i in chosen]
    shown, expected = part.measured[:, chosen], part.predicted[:, chosen]
    if not part.samples:
        unknown = np.full(shown.shape, np.nan)
        return amplitude_and_phase(names, units, part.frequency_hz, shown, unknown, None, None, expected)
    time, measured, predicted = part.histories()
    return histories_and_spectra(
        names, units, time, measured[:, chosen], predicted[:, chosen], part.frequency_hz, shown, expected
    )


def drawn_of(predictions: Sequence[RecordPrediction]) -> RecordPrediction:
    """What is drawn of several: the first whole record, or, where there is none, the settled lines."""
    return next((part for part in predictions if part.samples), predictions[0])


def histories_and_spectra(
    names: Sequence[str],
    units: Sequence[str],
    time: Real,
    measured: Real,
    predicted: Real,
    frequency_hz: Real,
    shown: Complex,
    expected: Complex,
) -> Figure:
    """A row for each channel: the history with its prediction left, the spectra with their difference right.

    measured, predicted (samples, channels); shown, expected (lines, channels) complex amplitudes.
    """
    with style():
        figure = Figure(figsize=(9, 2.1 * len(names) + 0.4))
        rows = figure.subplots(len(names), 2, squeeze=False)
        for row, (name, unit) in enumerate(zip(names, units, strict=True)):
            left, right = rows[row]
            left.plot(time, measured[:, row], color=DATA, linewidth=0.8, label="measured")
            left.plot(time, predicted[:, row], color=MODEL, linewidth=0.7, label="predicted")
            left.plot(
                time, measured[:, row] - predicted[:, row], color=BAD, linewidth=0.6, label="difference"
            )
            left.set_ylabel(f"{name}, {unit}")
            curves = (
                (shown[:, row], DATA, 0.7),
                (expected[:, row], MODEL, 0.7),
                (shown[:, row] - expected[:, row], BAD, 0.5),
            )
            for (values, colour, width), label in zip(
                curves, ("measured", "predicted", "difference"), strict=True
            ):
                right.semilogy(frequency_hz, np.abs(values), color=colour, linewidth=width, label=label)
            hover(left, AxisLabel("time", "s"), AxisLabel(name, unit))
            hover(right, FREQUENCY, AxisLabel(name, unit))
            right.set_ylabel(unit)
            right.set_title(name)
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=3)
        rows[-1][0].set_xlabel("time, s")
        rows[-1][1].set_xlabel("frequency, Hz")
    return figure
