"""What the estimated rig predicts for each channel, and how far the measured amplitudes are from it.

The model fixes X = D⁻¹ (R U + S f), so all channels of a line are linear in its inputs v = (U, f): y = G(ω) v.  v is
found from the line's own channels by generalised least squares (exact channels are met exactly), which is the
projection that maximum likelihood makes; ŷ = G v̂.  With exact inputs ŷ is the response to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, freeze, hermitian
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.ends_shown import shown_by_ends
from dashpot.estimate.likelihood.objective import FLOOR, measured, predict
from dashpot.estimate.nonlinear.prediction import predicted_lines
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.weighting import working_covariance
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import no_steady_response
from dashpot.model.network import Model
from dashpot.model.observation import (
    ObservationModel,
    calibration_factors,
    channel_unit,
    input_channels,
    observation_model,
    small,
    transfer,
)

TOGETHER = 20_000  # lines that are projected at once

Calibrations = Mapping[str, float]


@dataclass(frozen=True)
class Residuals:
    """Measured against predicted, SI units.

    channels, units       names, and SI units of their amplitudes
    input_names, input_units  of the inputs
    frequency_hz, experiment  of the lines, (lines,)
    measured, predicted   complex amplitudes, (lines, channels); NaN where a channel was not measured
    sd                    of the real (and of the imaginary) part of the measured amplitude, (lines, channels)
    normalised            (measured − predicted) over the sd that this difference has after v was fitted,
                          (lines, channels); NaN where it has none.  Re and Im have variance 1 where the model is right
                          and the noise as stated.
    variance              of measured − predicted where the model is right, real and imaginary part together,
                          (lines, channels)
    inputs                v̂, (lines, inputs), in the order of `input_names`
    scaled                whether the noise was unknown and is scaled so that `normalised` has variance 1 on the whole
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    frequency_hz: Real
    experiment: Ints
    measured: Complex
    predicted: Complex
    sd: Real
    normalised: Complex
    variance: Real
    inputs: Complex
    scaled: bool

    def __post_init__(self) -> None:
        freeze(self)

    def worst(self) -> tuple[str, float, float] | None:
        """(channel, frequency in Hz, |normalised| / √2) of the largest residual; None where there is none."""
        size = np.nan_to_num(np.abs(self.normalised)) / np.sqrt(2)
        if not size.size or not np.any(size > 0):
            return None
        line, channel = np.unravel_index(int(np.argmax(size)), size.shape)
        return self.channels[int(channel)], float(self.frequency_hz[line]), float(size[line, channel])

    def rms(self) -> Real:
        """Root mean square of the normalised residuals of each channel, (channels,): 1 where all is right."""
        finite = np.isfinite(self.normalised)
        power = np.sum(np.where(finite, np.abs(self.normalised) ** 2, 0.0), axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            rms: Real = np.sqrt(power / (2 * np.sum(finite, axis=0)))
        return rms


def channel_response(
    model: Model, p: Real, channels: Sequence[Channel], omega: Real, calibrations: Calibrations | None = None
) -> Complex:
    """G(ω), (lines, channels, inputs): amplitude of each channel per unit of each input, U first, then f; SI units.

    p (elements,).  `calibrations` are estimated `NAME.gain`, `NAME.sign` and `NAME.delay`; what is not estimated is
    1, 1 and 0, for known calibrations have been taken out of a Spectrum.  Raises DataError where a channel measures
    what the rig has not.
    """
    view = observation_model(model, channels, omega)
    psi, sign = of_channels(view, np.zeros(view.m), calibrations)
    G = transfer(view, p).G
    if not np.all(np.isfinite(G)):
        raise no_steady_response()
    response: Complex = calibration_factors(view, psi, sign)[..., None] * G
    return response


def calibrations_of(model: Model, estimate: Estimate) -> dict[str, float]:
    """What an estimate found of the channels: NAME.gain, NAME.delay (s) and NAME.sign."""
    m = len(model.unknowns)
    values = dict(zip(estimate.names[m:], estimate.values[m:].tolist(), strict=True))
    return values | {f"{name}.sign": float(sign) for name, sign in estimate.signs.items()}


def residuals(
    model: Model, theta: Real, spectrum: Spectrum, calibrations: Calibrations | None = None
) -> Residuals:
    """Residuals of one spectrum (no batch axes) at θ (unknowns,), SI units.

    Raises DataError where a channel measures what the rig has not, ModelError where the rig has no steady response.
    """
    known = spectrum.noise_known
    y = spectrum.amplitudes
    V = working_covariance(observation_model(model, spectrum.channels, spectrum.omega), spectrum)
    if not known:
        V = _relative(y, V)
    predicted, spread, v = _predicted(model, theta, spectrum, V, calibrations)
    difference = y - predicted
    size = np.diagonal(V, axis1=-2, axis2=-1).real
    variance = np.diagonal(spread, axis1=-2, axis2=-1).real
    usable = np.isfinite(y) & (variance > 1e-9 * np.where(size > 0, size, np.inf))
    with np.errstate(invalid="ignore", divide="ignore"):
        normalised = np.where(usable, difference / np.sqrt(np.where(usable, variance, 1.0) / 2), np.nan)
    sd = np.sqrt(np.maximum(size, 0.0) / 2)
    if not known:
        freedom = 2 * np.sum(usable) - len(model.unknowns)
        scale = float(np.sqrt(np.nansum(np.abs(normalised) ** 2) / max(int(freedom), 1)))
        normalised, sd = normalised / (scale if scale > 0 else 1.0), sd * scale
        variance = variance * scale**2
    return Residuals(
        tuple(channel.name for channel in spectrum.channels),
        tuple(channel_unit(model, channel) for channel in spectrum.channels),
        (*model.displacement_inputs, *model.force_inputs),
        tuple(channel_unit(model, drive) for drive in input_channels(model)),
        spectrum.frequency_hz,
        spectrum.experiment,
        y,
        predicted,
        sd,
        normalised,
        np.maximum(variance, 0.0),
        v,
        not known,
    )


def _predicted(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Calibrations | None
) -> tuple[Complex, Complex, Complex]:
    """Channels as the rig has them with the inputs that fit best, covariance of what is left, and those inputs."""
    y = spectrum.amplitudes
    if len(model.nonlinear):
        estimated = {} if calibrations is None else calibrations
        predicted, v = predicted_lines(model, np.asarray(theta, dtype=float), spectrum, V, estimated)
        # Inputs that are all but exact are met to the floor that the likelihood gives them.
        floor = FLOOR * np.max(np.abs(np.nan_to_num(y)), axis=0, initial=0.0)
        return predicted, V + np.diag(floor**2), v
    p = model.parameters(np.asarray(theta, dtype=float))
    G = channel_response(model, p, spectrum.channels, spectrum.omega, calibrations)
    transients = _transients(model, theta, spectrum, V, calibrations)
    predicted, spread, v = _project(G, y - transients, V)
    return predicted + transients, spread, v


def _transients(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Calibrations | None
) -> Complex:
    """What the two ends of whole records add to the channels, (lines, channels); 0 at settled lines."""
    if not spectrum.carries_loads:
        return np.zeros(spectrum.amplitudes.shape, dtype=np.complex128)
    view = observation_model(model, spectrum.channels, spectrum.omega)
    psi, sign = of_channels(view, np.asarray(theta, dtype=float), calibrations)
    single = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=V[None], moments=None)
    exact = measured(Prepared(view, single, V[None], None, True, np.ones(1, dtype=bool)))
    if exact.ends is None:
        return np.zeros(spectrum.amplitudes.shape, dtype=np.complex128)
    at_ends: Complex | None = (
        shown_by_ends(exact, psi[None], sign[None])
        if small(model)
        else predict(view, exact, psi[None], sign[None]).at_ends
    )
    assert at_ends is not None
    transients: Complex = at_ends[0]
    return transients


def of_channels(view: ObservationModel, theta: Real, calibrations: Calibrations | None) -> tuple[Real, Real]:
    """ψ (unknowns and calibrations) and the signs of the channels, from θ and what an estimate found of the channels.

    What of a calibration is not estimated is 1, 1 and 0.
    """
    given = {} if calibrations is None else calibrations
    typical = [1.0] * view.gains + [0.0] * view.delays
    values = [given.get(name, value) for name, value in zip(view.names[view.m :], typical, strict=True)]
    sign = np.array([given.get(f"{channel.name}.sign", 1.0) for channel in view.channels])
    return np.concatenate([theta, values]), sign


def _relative(y: Complex, V: Complex) -> Complex:
    """V with zeros where nothing was measured (sizes of absent channels mean nothing)."""
    return np.where(np.isfinite(V), V, 0.0) + 0 * np.nan_to_num(y)[..., None]


def _project(G: Complex, y: Complex, V: Complex) -> tuple[Complex, Complex, Complex]:
    """(ŷ, covariance of y − ŷ, v̂): generalised least squares of v in y = G v + noise, line by line.

    Exact channels (variance 0) are met exactly as far as they agree with each other.
    """
    predicted = np.empty_like(y)
    spread = np.zeros_like(V)
    v = np.zeros((len(y), G.shape[-1]), dtype=complex)
    present = np.isfinite(y)
    kinds = present.astype(int) + (present & (np.diagonal(V, axis1=-2, axis2=-1).real <= 0))
    # Lines that have the same channels, and the same of them exact, are solved together.
    for kind in np.unique(kinds, axis=0):
        alike, there = np.flatnonzero(np.all(kinds == kind, axis=1)), np.flatnonzero(kind)
        for first in range(0, len(alike), TOGETHER):
            lines = alike[first : first + TOGETHER]
            cells = np.ix_(lines, there, there)
            g, noise = G[lines][:, there], V[cells]
            size = np.sqrt(np.sum(np.abs(g) ** 2, axis=1, keepdims=True))
            size = np.where(size > 0, size, 1.0)
            P = _estimators(g / size, noise, kind[there] == 2)
            v[lines] = (P @ y[lines][:, there, None])[..., 0] / size[:, 0]
            rest = np.eye(len(there)) - (g / size) @ P
            spread[cells] = rest @ noise @ hermitian(rest)
            predicted[lines] = (G[lines] @ v[lines, :, None])[..., 0]
    return predicted, spread, v


def _estimators(g: Complex, V: Complex, exact: Bools) -> Complex:
    """P (lines, q, channels) with v̂ = P y minimising (y − g v)ᴴ V⁻¹ (y − g v) at each line.

    g (lines, channels, q), V (lines, channels, channels).  Channels that are `exact` come first, the rest of v from
    the noisy ones.
    """
    lines, channels, q = g.shape
    P = np.zeros((lines, q, channels), dtype=complex)
    free = np.broadcast_to(np.eye(q, dtype=complex), (lines, q, q))
    if np.any(exact):
        P[:, :, exact] = np.linalg.pinv(g[:, exact], rcond=1e-10)
        _, s, Vh = np.linalg.svd(g[:, exact])
        rank = np.sum(s > 1e-10 * s[:, :1], axis=-1)
        if np.any(rank != rank[0]):
            for k in np.unique(rank):
                P[rank == k] = _estimators(g[rank == k], V[rank == k], exact)
            return P
        free = hermitian(Vh[:, rank[0] :])
    noisy = ~exact
    if free.shape[-1] and np.any(noisy):
        of_noisy = V[:, noisy][:, :, noisy]
        sd = np.sqrt(np.diagonal(of_noisy, axis1=-2, axis2=-1).real)
        L = np.linalg.cholesky(of_noisy / sd[:, :, None] / sd[:, None] + 1e-13 * np.eye(sd.shape[-1]))
        white = np.linalg.solve(L, (g[:, noisy] @ free) / sd[:, :, None])
        scale = (np.eye(sd.shape[-1]) / sd[:, :, None]).astype(complex)
        half = np.linalg.pinv(white, rcond=1e-10) @ np.linalg.solve(L, scale)
        P[:, :, noisy] = free @ half
        P[:, :, exact] -= free @ (half @ (g[:, noisy] @ P[:, :, exact]))
    return P


@dataclass(frozen=True)
class ResponseCurve:
    """Frequency response of each channel to the one input of a rig.

    frequency_hz (points,), response (points, channels): the model's; lines_hz (lines,), measured (lines, channels):
    measured amplitudes over the input's, sd of their real and imaginary parts; predicted likewise; SI units over SI
    unit of the input.
    """

    frequency_hz: Real
    response: Complex
    lines_hz: Real
    measured: Complex
    predicted: Complex
    sd: Real


def response_curve(
    model: Model,
    theta: Real,
    spectrum: Spectrum,
    found: Residuals,
    points: int = 400,
    calibrations: Calibrations | None = None,
) -> ResponseCurve | None:
    """The model's response between the lines; None where the rig has more than one input.  theta (unknowns,)."""
    if len(model.inputs) != 1:
        return None
    low, high = float(np.min(found.frequency_hz)), float(np.max(found.frequency_hz))
    grid = np.geomspace(low / 1.25, high * 1.25, points)
    p = model.parameters(np.asarray(theta, dtype=float))
    G = channel_response(model, p, spectrum.channels, 2 * np.pi * grid, calibrations)[..., 0]
    v = found.inputs[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return ResponseCurve(
            grid, G, found.frequency_hz, found.measured / v, found.predicted / v, found.sd / np.abs(v)
        )


def correlation(covariance: Real) -> Real:
    """Correlation matrix of a covariance; NaN where a variance is 0.  (..., m, m)."""
    sd = np.sqrt(np.diagonal(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix: Real = covariance / np.outer(sd, sd)
    return matrix
