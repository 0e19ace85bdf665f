"""Measured and estimated frequency responses as they are usually shown: output over input, with the model's band.

Where one input at a time drives what a channel shows, H = y / ((jω)^q v̂), q the derivative that the input's own channel
measures: acceleration over acceleration where the base carries an accelerometer.  The band is that of the estimate's
covariance to first order in ln H: δ ln|H| and δ arg H are the real and imaginary parts of (∂ ln H/∂ψ) δψ.  Of whole
records, the transients that were estimated of their two ends are taken out of y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.check.residuals import Residuals, calibrations_of, channel_response
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

POINTS = 400
NEAR = np.tan(
    np.linspace(-1.5, 1.5, 61)
)  # half-widths around a mode: evenly on its circle in the complex plane
MOST_UNKNOWNS = 60  # with a band
STEP = 0.1  # standard deviations, of the differences


@dataclass(frozen=True)
class FrequencyResponse:
    """One channel over the input that drives it.

    unit                 of the ratio, "" where both have the same
    lines_hz, measured, sd, phase_deg      (lines,); sd of real and of imaginary part; phases beside the model's
    frequency_hz, response, curve_deg      (points,) of the model; its phase without jumps
    log_sd, phase_sd_deg (points,) of ln|H| and of the phase, from the estimate; NaN where it has none
    """

    channel: str
    reference: str
    unit: str
    lines_hz: Real
    measured: Complex
    sd: Real
    phase_deg: Real
    frequency_hz: Real
    response: Complex
    curve_deg: Real
    log_sd: Real
    phase_sd_deg: Real

    def __post_init__(self) -> None:
        freeze(self)


def responses_of_channels(
    model: Model, estimate: Estimate, spectrum: Spectrum, found: Residuals
) -> tuple[FrequencyResponse, ...]:
    """A response for each channel that is not itself the measured input (no batch axes).

    None for nonlinear rigs, and where several inputs drive a channel at once.
    """
    if len(model.nonlinear):
        return ()
    chosen = []
    for c, channel in enumerate(spectrum.channels):
        inputs = _driving(found, c)
        if _shows_input(model, channel) is None and len(inputs) == 1:
            chosen.append((c, inputs[0]))
    if not chosen:
        return ()
    grid = _grid(estimate, found.frequency_hz)
    G, slopes = _responses(model, estimate, spectrum.channels, grid)
    covariance = estimate.covariance if len(slopes) else None
    steady = _steady(model, estimate, spectrum, found)
    return tuple(
        _response(
            model, spectrum, found, steady[:, c], c, i, grid, G[:, c, i], slopes[:, :, c, i], covariance
        )
        for c, i in chosen
    )


def _shows_input(model: Model, channel: Channel) -> str | None:
    """The input whose motion or force the channel shows and nothing else."""
    names = model.force_inputs if channel.quantity is Quantity.FORCE else model.displacement_inputs
    points = tuple(channel.of)
    return points[0] if len(points) == 1 and points[0] in names else None


def _driving(found: Residuals, c: int) -> list[int]:
    """Inputs that are not at rest where a channel was measured."""
    size = np.abs(found.inputs)
    driven = size > 1e-9 * np.max(size, axis=0, initial=0.0)
    there = np.isfinite(found.measured[:, c])
    return [int(i) for i in np.flatnonzero(np.any(driven[there], axis=0))]


def _grid(estimate: Estimate, lines_hz: Real) -> Real:
    """Frequencies of the curve, Hz: evenly on a logarithmic scale, and closely about every mode."""
    low, high = float(np.min(lines_hz)) / 1.15, float(np.max(lines_hz)) * 1.15
    grid = [np.geomspace(low, high, POINTS)]
    if estimate.modes is not None:
        for f, zeta in zip(estimate.modes.frequency_hz, estimate.modes.damping_ratio, strict=True):
            if low < f < high:
                grid.append(f * (1 + min(max(abs(float(zeta)), 1e-4), 0.05) * NEAR))
    together = np.unique(np.concatenate(grid))
    return together[(together >= low) & (together <= high)]


def _responses(
    model: Model, estimate: Estimate, channels: tuple[Channel, ...], grid: Real
) -> tuple[Complex, Complex]:
    """G (points, channels, inputs) and ∂ ln G/∂ψ (unknowns, points, channels, inputs); none where they are too many."""
    m, omega = len(model.unknowns), 2 * np.pi * grid

    def response(values: Real) -> Complex:
        calibrations = calibrations_of(model, estimate)
        calibrations |= dict(zip(estimate.names[m:], values[m:].tolist(), strict=True))
        return channel_response(model, model.parameters(values[:m]), channels, omega, calibrations)

    G = response(estimate.values)
    sd = estimate.sd
    if len(estimate.names) > MOST_UNKNOWNS or not np.all(np.isfinite(sd)):
        return G, np.zeros((0, *G.shape), dtype=np.complex128)
    slopes = np.zeros((len(estimate.names), *G.shape), dtype=np.complex128)
    for j, width in enumerate(sd):
        if width > 0:
            step = np.zeros(len(sd))
            step[j] = STEP * width
            with np.errstate(divide="ignore", invalid="ignore"):
                slopes[j] = (response(estimate.values + step) - response(estimate.values - step)) / (
                    2 * STEP * width * G
                )
    return G, slopes


def _steady(model: Model, estimate: Estimate, spectrum: Spectrum, found: Residuals) -> Complex:
    """What was measured without the transients of whole records, (lines, channels)."""
    if not spectrum.carries_loads:
        return found.measured
    p = model.parameters(estimate.values[: len(model.unknowns)])
    G = channel_response(model, p, spectrum.channels, spectrum.omega, calibrations_of(model, estimate))
    steady: Complex = found.measured - found.predicted + np.einsum("lci,li->lc", G, found.inputs)
    return steady


def _response(
    model: Model, spectrum: Spectrum, found: Residuals, steady: Complex, c: int, i: int, grid: Real, G: Complex,
    slopes: Complex, covariance: Real | None,
) -> FrequencyResponse:  # fmt: skip
    name = found.input_names[i]
    shown = [k for k, channel in enumerate(spectrum.channels) if _shows_input(model, channel) == name]
    reference = spectrum.channels[shown[0]] if shown else None
    q = 0 if reference is None or reference.quantity is Quantity.FORCE else reference.quantity.derivative
    below = found.units[shown[0]] if shown else found.input_units[i]
    there = np.isfinite(found.measured[:, c]) & (np.abs(found.inputs[:, i]) > 0)
    lines = found.frequency_hz[there]
    order = np.argsort(lines, kind="stable")
    drive = ((2j * np.pi * lines) ** q * found.inputs[there, i])[order]
    H = steady[there][order] / drive
    curve = G / (2j * np.pi * grid) ** q
    phase = np.degrees(np.unwrap(np.angle(curve)))
    at_lines = np.interp(lines[order], grid, phase)
    measured = at_lines + (np.degrees(np.angle(H)) - at_lines + 180) % 360 - 180
    turns = 360 * np.round(float(np.median(measured)) / 360) if len(H) else 0.0
    log_sd, phase_sd = _spread(slopes, covariance, len(grid))
    return FrequencyResponse(
        found.channels[c],
        name if reference is None else reference.name,
        "" if found.units[c] == below else f"{found.units[c]} per {below}",
        lines[order],
        H,
        found.sd[there, c][order] / np.abs(drive),
        measured - turns,
        grid,
        curve,
        phase - turns,
        log_sd,
        np.degrees(phase_sd),
    )


def _spread(slopes: Complex, covariance: Real | None, points: int) -> tuple[Real, Real]:
    """Standard deviations of ln|H| and arg H, (points,), from ∂ ln H/∂ψ (unknowns, points)."""
    if covariance is None:
        return np.full(points, np.nan), np.full(points, np.nan)
    with np.errstate(invalid="ignore"):
        parts = [
            np.sqrt(np.maximum(np.einsum("ip,ij,jp->p", part, covariance, part), 0.0))
            for part in (slopes.real, slopes.imag)
        ]
    return parts[0], parts[1]
