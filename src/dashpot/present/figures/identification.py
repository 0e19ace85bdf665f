"""Figures of an identification: from model, data and estimate to arrays to figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from dashpot.check.residuals import (
    Residuals,
    ResponseCurve,
    calibrations_of,
    correlation,
    distance_from_end,
    residuals,
    response_curve,
)
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.present.figures import spectra as figures

MOST_PANELS = 24  # channels drawn with amplitude and phase


@dataclass(frozen=True)
class TitledFigure:
    """A figure with what it shows."""

    title: str
    text: str
    figure: Figure


def identification_figures(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[TitledFigure]:
    """Measured and predicted amplitudes, residuals, the path of the iteration, and correlations (no batch axes)."""
    found = residuals(
        model, estimate.values[: len(model.unknowns)], spectrum, calibrations_of(model, estimate)
    )
    m = len(model.unknowns)
    curve = response_curve(
        model, estimate.values[:m], spectrum, found, calibrations=calibrations_of(model, estimate)
    )
    pictures = [_responses(found, curve)]
    if np.any(np.isfinite(found.normalised)):
        unit = "its rms (the noise is unknown)" if found.scaled else "its standard deviation from the noise"
        pictures.append(
            TitledFigure(
                "Residuals",
                f"Measured minus predicted amplitude, divided by {unit}. If the model fits, 95 % lie in the band.",
                figures.residual_plot(found.channels, found.frequency_hz, found.normalised),
            )
        )
    if len(estimate.history) > 2 and estimate.history.shape[1] <= len(estimate.names):
        names = estimate.names[: estimate.history.shape[1]]
        distance = distance_from_end(estimate.history, estimate.sd[: len(names)])
        pictures.append(
            TitledFigure(
                "Convergence",
                "Distance of each unknown from its final value at every iteration; 0 is the start.",
                figures.history_plot(names, distance),
            )
        )
    if len(estimate.names) > 1:
        pictures.append(
            TitledFigure(
                "Correlation of the estimates",
                "Near ±1, two unknowns are hard to separate: their sum or difference is known better than either.",
                figures.correlation_plot(estimate.names, correlation(estimate.covariance)),
            )
        )
    return pictures


def _responses(found: Residuals, curve: ResponseCurve | None) -> TitledFigure:
    """Amplitudes and phases; of a rig with one input over that input, the input's own channel left out."""
    driven = [i for i, name in enumerate(found.channels) if name not in found.input_names] or [0]
    chosen = driven[:MOST_PANELS]
    names = [found.channels[i] for i in chosen]
    more = f" The first {MOST_PANELS} of {len(driven)} channels." if len(driven) > MOST_PANELS else ""
    if curve is None:
        # Of another experiment's channel there is nothing to compare a prediction with.
        predicted = np.where(np.isfinite(found.measured), found.predicted, np.nan)[:, chosen]
        figure = figures.amplitude_and_phase(
            names, [found.units[i] for i in chosen], found.frequency_hz, found.measured[:, chosen],
            found.sd[:, chosen], None, None, predicted,
        )  # fmt: skip
        text = "Amplitude and phase of each channel, as measured and as the model predicts from the inputs."
        return TitledFigure("Measured and predicted", text + more, figure)
    source = found.input_names[0]
    over = [f"{found.units[i]} per {found.input_units[0]}" for i in chosen]
    figure = figures.amplitude_and_phase(
        names, over, curve.lines_hz, curve.measured[:, chosen], curve.sd[:, chosen], curve.frequency_hz,
        curve.response[:, chosen], curve.predicted[:, chosen],
    )  # fmt: skip
    text = (
        f"Amplitude and phase of each channel over the input {source}, as measured and as the model predicts."
    )
    return TitledFigure("Measured and predicted", text + more, figure)
