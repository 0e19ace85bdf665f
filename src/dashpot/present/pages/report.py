"""The report of an identification: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from dashpot.check.residuals import Residuals, calibrations_of, residuals
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.present.figures.identification import identification_figures
from dashpot.present.figures.style import svg
from dashpot.present.tables.estimate import parameter_rows
from dashpot.present.text.estimate import (
    MISFIT,
    basis_in_words,
    convergence_in_words,
    fit_in_words,
    warnings_in_words,
)
from dashpot.present.text.numbers import rounded, short

TEMPLATES = Path(__file__).parents[1] / "templates"


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
        warnings=warnings_in_words(estimate),
        worst=found.worst(),
        channels=_channels(found),
        lines=spectrum.lines,
        pictures=[
            {"title": shown.title, "text": shown.text, "svg": Markup(svg(shown.figure))}
            for shown in identification_figures(model, spectrum, estimate)
        ],
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
