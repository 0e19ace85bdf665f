"""The report of an identification: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

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
from dashpot.present.tables.estimate import (
    MISFIT,
    basis_in_words,
    convergence_in_words,
    fit_in_words,
    parameter_rows,
    worth_telling,
)
from dashpot.present.text.numbers import rounded, short

TEMPLATES = Path(__file__).parents[1] / "templates"
MOST_PANELS = 24  # channels drawn with amplitude and phase


@dataclass(frozen=True)
class Picture:
    """A figure with what it shows."""

    title: str
    text: str
    svg: Markup


def identification_report(
    model: Model, spectrum: Spectrum, estimate: Estimate, level: float = 0.95, sources: Sequence[str] = ()
) -> str:
    """HTML page of an estimate and the spectrum it came from (no batch axes); `sources` are the files it names."""
    found = residuals(
        model, estimate.values[: len(model.unknowns)], spectrum, calibrations_of(model, estimate)
    )
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("identification.html").render(
        title=estimate.model or "Identification",
        sources=list(sources),
        level=f"{100 * level:g}",
        convergence=convergence_in_words(estimate),
        converged=bool(estimate.converged),
        fit=fit_in_words(estimate.fit),
        verdict=_verdict(estimate),
        basis=basis_in_words(estimate),
        misfit=estimate.basis == MISFIT,
        rows=parameter_rows(estimate, level),
        signs={name: "+" if float(sign) > 0 else "−" for name, sign in estimate.signs.items()},
        modes=_modes(estimate),
        coordinates=model.coordinates,
        warnings=worth_telling(estimate),
        worst=found.worst(),
        channels=_channels(found),
        lines=spectrum.lines,
        pictures=_pictures(model, spectrum, estimate, found),
        short=short,
    )


def _verdict(estimate: Estimate) -> str:
    if not estimate.fit.known_noise or estimate.fit.dof <= 0:
        return "open"
    return "bad" if bool(estimate.fit.rejected) else "good"


def _modes(estimate: Estimate) -> list[dict[str, object]]:
    modes = estimate.modes
    if modes is None:
        return []
    rows = []
    for k, eigenvalue in enumerate(modes.eigenvalues.tolist()):
        swings = eigenvalue.imag != 0
        frequency = rounded(float(modes.frequency_hz[k]), float(modes.frequency_sd[k]))
        damping = rounded(float(modes.damping_ratio[k]), float(modes.damping_sd[k]))
        shape = [
            f"{abs(z):.2f} ∠ {round(float(np.degrees(np.angle(z)))):d}°" for z in modes.shapes[k].tolist()
        ]
        time = short(1 / abs(eigenvalue.real)) if eigenvalue.real != 0 else "∞"
        rows.append(
            {"swings": swings, "frequency": frequency, "damping": damping, "shape": shape, "time": time}
        )
    return rows


def _channels(found: Residuals) -> list[tuple[str, str]]:
    """Channels with the rms of their normalised residuals."""
    pairs = zip(found.channels, found.rms().tolist(), strict=True)
    return [(name, short(rms, 2)) for name, rms in pairs if np.isfinite(rms)]


def _pictures(model: Model, spectrum: Spectrum, estimate: Estimate, found: Residuals) -> list[Picture]:
    m = len(model.unknowns)
    curve = response_curve(
        model, estimate.values[:m], spectrum, found, calibrations=calibrations_of(model, estimate)
    )
    pictures = [_responses(found, curve)]
    if np.any(np.isfinite(found.normalised)):
        unit = (
            "their own rms, for the noise is unknown" if found.scaled else "the sd that the noise gives them"
        )
        pictures.append(
            Picture(
                "Residuals",
                f"Measured minus predicted amplitude over {unit}. Where all is right, 95 % lie in the band.",
                Markup(
                    figures.svg(figures.residual_plot(found.channels, found.frequency_hz, found.normalised))
                ),
            )
        )
    if len(estimate.history) > 2 and estimate.history.shape[1] <= len(estimate.names):
        names = estimate.names[: estimate.history.shape[1]]
        distance = distance_from_end(estimate.history, estimate.sd[: len(names)])
        pictures.append(
            Picture(
                "Convergence",
                "How far each unknown was from its end at every iteration; 0 is the start.",
                Markup(figures.svg(figures.history_plot(names, distance))),
            )
        )
    if len(estimate.names) > 1:
        pictures.append(
            Picture(
                "Correlation of the estimates",
                "Near ±1, two unknowns can be told apart only together: their sum or difference is known better "
                "than either.",
                Markup(
                    figures.svg(figures.correlation_plot(estimate.names, correlation(estimate.covariance)))
                ),
            )
        )
    return pictures


def _responses(found: Residuals, curve: ResponseCurve | None) -> Picture:
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
        return Picture("Measured and predicted", text + more, Markup(figures.svg(figure)))
    source = found.input_names[0]
    over = [f"{found.units[i]} per {found.input_units[0]}" for i in chosen]
    figure = figures.amplitude_and_phase(
        names, over, curve.lines_hz, curve.measured[:, chosen], curve.sd[:, chosen], curve.frequency_hz,
        curve.response[:, chosen], curve.predicted[:, chosen],
    )  # fmt: skip
    text = (
        f"Amplitude and phase of each channel over the input {source}, as measured and as the model predicts."
    )
    return Picture("Measured and predicted", text + more, Markup(figures.svg(figure)))
