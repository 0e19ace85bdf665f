"""What the estimated rig predicts for each channel, and how far the measured amplitudes are from it.

The model fixes X = D⁻¹ (R U + S f), so all channels of a line are linear in its inputs v = (U, f): y = G(ω) v.  v is
found from the line's own channels by generalised least squares (exact channels are met exactly), which is the
projection that maximum likelihood makes; ŷ = G v̂.  With exact inputs ŷ is the response to them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammainc, gammaincc

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real, diagonal_matrices
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import UsedDwell
from dashpot.data.record import calibration, real_factor
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.assessment import Discrepancy, Residuals
from dashpot.estimate.likelihood.boundary_loads import with_means_of_unmeasured
from dashpot.estimate.likelihood.objective import FLOOR, measured, predict
from dashpot.estimate.likelihood.record_sums import shown_by_ends
from dashpot.estimate.nonlinear.objective import predicted_lines
from dashpot.estimate.preparation import Prepared, working_covariance
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import no_steady_response
from dashpot.model.network import Model
from dashpot.model.observation import (
    ObservationModel,
    Transfer,
    calibration_factors,
    channel_unit,
    input_channels,
    observation_model,
    small,
    transfer,
)

# Of a response: beyond it the variance of a squared residual overflows
UNBOUNDED = np.finfo(float).max ** 0.25
EXACT = 1e-9  # relative noise that exact channels are given, compared with which that of all others is large

Calibrations = Mapping[str, float]


def channel_response(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    omega: Real,
    calibrations: Calibrations | None = None,
    experiment: Ints | None = None,
) -> Complex:
    """G(ω), (lines, channels, inputs): amplitude of each channel per unit of each input, U first, then f; SI units.

    p (elements,).  `calibrations` are estimated `NAME.gain`, `NAME.sign` and `NAME.delay`; what is not estimated is
    1, 1 and 0, for known calibrations have been taken out of a Spectrum.  Raises DataError if a channel measures
    what the rig has not.
    """
    view = observation_model(model, channels, omega, experiment)
    psi, sign = of_channels(view, np.zeros(view.m), calibrations)
    G = transfer(view, p).G
    if not np.all(np.abs(G) < UNBOUNDED):
        raise no_steady_response()
    return calibration_factors(view, psi, sign)[..., None] * G


def calibrations_of(model: Model, estimate: Estimate) -> dict[str, float]:
    """What an estimate found of the channels: NAME.gain, NAME.delay (s) and NAME.sign."""
    m = len(model.unknowns)
    values = dict(zip(estimate.names[m:], estimate.values[m:].tolist(), strict=True))
    return values | {f"{name}.sign": float(sign) for name, sign in estimate.signs.items()}


def residuals_of(model: Model, spectrum: Spectrum, estimate: Estimate) -> Residuals:
    """What the estimate leaves of a spectrum, its calibrations included (no batch axes)."""
    theta = estimate.values[: len(model.unknowns)]
    return residuals(model, theta, spectrum, calibrations_of(model, estimate))


def residuals(
    model: Model, theta: Real, spectrum: Spectrum, calibrations: Calibrations | None = None
) -> Residuals:
    """Residuals of one spectrum (no batch axes) at θ (unknowns,), SI units.

    Raises DataError if a channel measures something that the rig does not have, and ModelError if the rig has no
    steady response.
    """
    known = spectrum.noise_known
    y = spectrum.amplitudes
    V = working_covariance(
        observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment), spectrum
    )
    if not known:
        # V with zeros where nothing was measured (sizes of absent channels mean nothing)
        V = np.where(np.isfinite(V), V, 0.0) + 0 * np.nan_to_num(y)[..., None]
    predicted, variance, v = _predicted(model, theta, spectrum, V, calibrations)
    difference = y - predicted
    size = np.diagonal(V, axis1=-2, axis2=-1).real
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
        spectrum.carries_loads,
    )


def _predicted(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Calibrations | None
) -> tuple[Complex, Real, Complex]:
    """Channels as the rig has them with the inputs that fit best, variance of what is left, and those inputs."""
    y, theta = spectrum.amplitudes, np.asarray(theta, dtype=float)
    seen = np.isfinite(y)
    if len(model.nonlinear):
        estimated = {} if calibrations is None else calibrations
        predicted, v = predicted_lines(model, theta, spectrum, V, estimated)
        # Inputs that are all but exact are met to the floor that the likelihood gives them.
        floor = FLOOR * np.max(np.abs(np.nan_to_num(y)), axis=0, initial=0.0)
        return predicted, np.diagonal(V, axis1=-2, axis2=-1).real + floor**2, v
    predicted, v, passed = projection(model, theta, spectrum, V, calibrations)
    rest = np.eye(y.shape[-1]) - passed
    noise = np.where(seen[:, :, None] & seen[:, None, :], V, 0.0)
    left = np.einsum("lij,ljk,lik->li", rest, noise, rest.conj(), optimize=True).real
    return predicted, left * seen, v


def projection(
    model: Model, theta: Real, spectrum: Spectrum, V: Complex, calibrations: Calibrations | None
) -> tuple[Complex, Complex, Complex]:
    """ŷ (lines, channels), v̂ (lines, inputs), and ∂ŷ/∂y (lines, channels, channels) of a linear rig at θ (unknowns,).

    Generalised least squares line by line, V (lines, channels, channels) being the covariance of the noise; exact
    channels are met exactly as far as they agree with each other.  Of whole records ŷ has the transients of their ends.
    """
    p = model.parameters(theta)
    G = channel_response(model, p, spectrum.channels, spectrum.omega, calibrations, spectrum.experiment)
    y, seen = spectrum.amplitudes, np.isfinite(spectrum.amplitudes)
    transients = np.zeros_like(y)
    if spectrum.carries_loads:
        view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
        psi, sign = of_channels(view, theta, calibrations)
        single = replace(spectrum, amplitudes=y[None], covariance=V[None], moments=None)
        data = measured(Prepared(view, single, V[None], None, True, np.ones(1, dtype=bool)))
        at_ends: Complex | None = None
        if data.ends is not None and small(model):
            at_ends = shown_by_ends(data.record_pieces, psi[None], sign[None])
        elif data.ends is not None:
            at_ends = predict(view, data, psi[None], sign[None]).at_ends
        if at_ends is not None:  # without the means by which samples that are not measured are off
            transients = at_ends[0] - np.where(seen, with_means_of_unmeasured(spectrum) - y, 0.0)
    noise = np.where(seen[:, :, None] & seen[:, None, :], V, 0.0)
    variance = np.diagonal(noise, axis1=-2, axis2=-1).real
    noisy, size = variance > 0, np.max(np.abs(np.nan_to_num(y)), axis=0, initial=0.0)
    # A channel that shows nothing at all, as that of an idle input, is exact compared with any other.
    sd = np.where(noisy, np.sqrt(np.maximum(variance, 0.0)), EXACT * np.where(size > 0, size, 1e-20))
    weight = np.where(seen, 1 / sd, 0.0)
    alike = noise * weight[:, :, None] * weight[:, None] + diagonal_matrices(np.where(noisy, 1e-13, 1.0))
    root = np.linalg.solve(np.linalg.cholesky(alike), diagonal_matrices(weight).astype(np.complex128))
    white = root @ G
    scale = np.max(np.abs(white), axis=1, keepdims=True)  # squares of a wrong rig's response may overflow
    scale = np.where(scale > 0, scale, 1.0)
    by_channel = np.linalg.pinv(white / scale, rcond=EXACT) / np.swapaxes(scale, 1, 2) @ root
    v = np.einsum("lqc,lc->lq", by_channel, np.where(seen, y - transients, 0.0))
    return np.einsum("lcq,lq->lc", G, v) + transients, v, G @ by_channel


def of_channels(view: ObservationModel, theta: Real, calibrations: Calibrations | None) -> tuple[Real, Real]:
    """ψ (unknowns and calibrations) and the signs of the channels, from θ and what an estimate found of the channels.

    What of a calibration is not estimated is as stated, else 1, 1 and 0.
    """
    given = {} if calibrations is None else calibrations
    named = zip(view.names[view.m :], view.nominal_calibrations.tolist(), strict=True)
    values = [given.get(name, value) for name, value in named]
    sign = np.array([given.get(f"{channel.name}.sign", 1.0) for channel in view.channels])
    return np.concatenate([theta, values]), sign


def correlation(covariance: Real) -> Real:
    """Correlation matrix of a covariance; NaN where a variance is 0.  (..., m, m)."""
    sd = np.sqrt(np.diagonal(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix: Real = covariance / np.outer(sd, sd)
    return matrix


# Measured and estimated frequency responses as they are usually shown: output over input, with the model's
# band.
#
# Where one input at a time drives what a channel shows, H = y / ((jω)^q v̂), q the derivative that the
# input's own channel measures: acceleration over acceleration where the base carries an accelerometer. The
# band is that of the estimate's covariance to first order in ln H: δ ln|H| and δ arg H are the real and
# imaginary parts of (∂ ln H/∂ψ) δψ. Of whole records, the transients that were estimated of their two ends
# are taken out of y.


POINTS = 400
# Half-widths around a mode: evenly on its circle in the complex plane
NEAR = np.tan(np.linspace(-1.5, 1.5, 61))


@dataclass(frozen=True)
class FrequencyResponse(Frozen):
    """One channel over the input that drives it.

    unit                 of the ratio, "" where both have the same
    lines_hz, measured, sd, phase_deg      (lines,); sd of real and of imaginary part; phases near the model's
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


def responses_of_channels(
    model: Model, estimate: Estimate, channels: Sequence[Channel], found: Residuals
) -> tuple[FrequencyResponse, ...]:
    """A response for each of the `channels` of the residuals that is not itself the measured input (no batch axes).

    None for nonlinear rigs, and where several inputs drive a channel at once.
    """
    if len(model.nonlinear):
        return ()
    chosen = []
    for c, channel in enumerate(channels):
        size = np.abs(found.inputs)
        driven = size > 1e-9 * np.max(size, axis=0, initial=0.0)
        there = np.isfinite(found.measured[:, c])
        inputs = [int(i) for i in np.flatnonzero(np.any(driven[there], axis=0))]
        if _shows_input(model, channel) is None and len(inputs) == 1:
            chosen.append((c, inputs[0]))
    if not chosen:
        return ()
    # Frequencies of the curve, Hz: evenly on a logarithmic scale, and closely about every mode
    low, high = float(np.min(found.frequency_hz)) / 1.15, float(np.max(found.frequency_hz)) * 1.15
    pieces = [np.geomspace(low, high, POINTS)]
    if estimate.modes is not None:
        for f, zeta in zip(estimate.modes.frequency_hz, estimate.modes.damping_ratio, strict=True):
            if low < f < high:
                pieces.append(f * (1 + min(max(abs(float(zeta)), 1e-4), 0.05) * NEAR))
    together = np.unique(np.concatenate(pieces))
    grid = together[(together >= low) & (together <= high)]
    # What was measured without the transients of whole records, (lines, channels)
    theta, calibrations = estimate.values[: len(model.unknowns)], calibrations_of(model, estimate)
    steady = found.measured
    if found.transients:
        p, omega = model.parameters(theta), 2 * np.pi * found.frequency_hz
        G = channel_response(model, p, channels, omega, calibrations, found.experiment)
        steady = steady - found.predicted + np.einsum("lci,li->lc", G, found.inputs)
    responses: list[FrequencyResponse] = []
    for rig, lines in model.by_experiment(found.experiment):
        of = np.zeros(len(found.frequency_hz), dtype=bool)
        of[lines] = True
        view = observation_model(rig, channels, 2 * np.pi * grid)
        psi, sign = of_channels(view, theta, calibrations)
        kappa = calibration_factors(view, psi, sign)[..., None]
        of_rig = transfer(view, rig.parameters(theta)).calibrated(kappa, psi)
        responses += [
            _response(rig, channels, estimate, found, of, steady[:, c], c, i, grid, of_rig)
            for c, i in chosen
            if np.any(np.isfinite(found.measured[of, c]))
        ]
    return tuple(responses)


def _shows_input(model: Model, channel: Channel) -> str | None:
    """The input whose motion or force the channel shows and nothing else."""
    names = model.force_inputs if channel.quantity is Quantity.FORCE else model.displacement_inputs
    points = tuple(channel.of)
    return points[0] if len(points) == 1 and points[0] in names else None


def _response(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate,
    found: Residuals,
    of: Bools,
    steady: Complex,
    c: int,
    i: int,
    grid: Real,
    of_rig: Transfer,
) -> FrequencyResponse:
    """Channel c over input i at the lines `of` the model's experiment."""
    name = found.input_names[i]
    shown = [k for k, channel in enumerate(channels) if _shows_input(model, channel) == name]
    reference = channels[shown[0]] if shown else None
    q = 0 if reference is None or reference.quantity is Quantity.FORCE else reference.quantity.derivative
    below = found.units[shown[0]] if shown else found.input_units[i]
    there = of & np.isfinite(found.measured[:, c]) & (np.abs(found.inputs[:, i]) > 0)
    lines = found.frequency_hz[there]
    order = np.argsort(lines, kind="stable")
    drive = ((2j * np.pi * lines) ** q * found.inputs[there, i])[order]
    H = steady[there][order] / drive
    curve = of_rig.G[:, c, i] / (2j * np.pi * grid) ** q
    unit = np.broadcast_to(np.arange(of_rig.G.shape[-1]) == i, (len(grid), of_rig.G.shape[-1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = of_rig.slopes(unit.astype(np.complex128))[:, c] / of_rig.G[:, c, [i]]
        log_sd, phase_sd = (
            np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", part, estimate.covariance, part), 0.0))
            for part in (slopes.real, slopes.imag)
        )
    phase = np.degrees(np.unwrap(np.angle(curve)))
    at_lines = np.interp(lines[order], grid, phase)
    measured = at_lines + (np.degrees(np.angle(H)) - at_lines + 180) % 360 - 180
    here = model.here
    apart = here is not None and channels[c].only != here
    return FrequencyResponse(
        f"{found.channels[c]}@{here}" if apart else found.channels[c],
        name if reference is None else reference.name,
        "" if found.units[c] == below else f"{found.units[c]} per {below}",
        lines[order],
        H,
        found.sd[there, c][order] / np.abs(drive),
        measured,
        grid,
        curve,
        phase,
        log_sd,
        np.degrees(phase_sd),
    )


# Dwells in time: what was measured, what the estimated rig predicts of the steady motion, which part was
# used.


MOST_DWELLS, MOST_CHANNELS = 3, 4


@dataclass(frozen=True)
class DwellHistory(Frozen):
    """Some channels of one dwell.

    time (samples,) s from its first sample, measured (samples, channels) SI without offset; begin, end: of the part
    used, s; lines_hz (lines,), amplitudes (lines, channels) of the predicted motion, x(t) = Re(X e^{jωt}).
    """

    source: str
    frequency_hz: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    time: Real
    measured: Real
    begin: float
    end: float
    lines_hz: Real
    amplitudes: Complex

    def predicted(self, time: Real) -> Real:
        """The predicted steady motion at times in s, (times, channels)."""
        turning = np.exp(2j * np.pi * np.asarray(time)[:, None] * self.lines_hz)
        return (turning @ self.amplitudes).real


def dwell_histories(dwells: Sequence[UsedDwell], found: Residuals) -> tuple[DwellHistory, ...]:
    """The dwell of the largest residual, the one with the least part used, and the first or another, by frequency.

    `found` are the residuals of the spectrum that the dwells' lines are in; channels with the largest are taken.
    """
    if not dwells:
        return ()
    size = np.nan_to_num(np.abs(found.normalised))
    worst = [float(np.max(size[dwell.lines])) for dwell in dwells]
    wanted = [int(np.argmax(worst)), int(np.argmax([dwell.discarded for dwell in dwells]))]
    wanted = list(dict.fromkeys([*wanted, 0, len(dwells) - 1, len(dwells) // 2]))[:MOST_DWELLS]
    measured = np.flatnonzero(np.any(np.isfinite(found.measured), axis=0))
    order = np.argsort(-np.nan_to_num(found.rms()[measured]), kind="stable")
    channels = sorted(measured[order[:MOST_CHANNELS]].tolist())
    shown = sorted((dwells[k] for k in wanted), key=lambda dwell: float(found.frequency_hz[dwell.lines[0]]))
    return tuple(_history(dwell, found, channels) for dwell in shown)


def _history(dwell: UsedDwell, found: Residuals, channels: Sequence[int]) -> DwellHistory:
    record, lines = dwell.record, dwell.lines
    start = float(record.time[0])
    factor = np.array([real_factor(channel) for channel in record.channels])
    at = [found.channels.index(channel.name) for channel in record.channels]
    own = [at.index(c) for c in channels if c in at]
    values = record.values / factor
    inside = (record.time >= dwell.begin) & (record.time <= dwell.end)
    values = values - np.mean(values[inside], axis=0)
    f = found.frequency_hz[lines]
    # As the sensor shows it: late by its known delay, and with phases counted from the first sample on.
    shown = found.predicted[lines][:, at] / (calibration(record.channels, f) * factor)
    shown = shown * np.exp(2j * np.pi * f * start)[:, None]
    return DwellHistory(
        record.source,
        float(f[0]),
        tuple(found.channels[at[c]] for c in own),
        tuple(found.units[at[c]] for c in own),
        record.time - start,
        values[:, own],
        dwell.begin - start,
        dwell.end - start,
        f,
        np.nan_to_num(shown[:, own]),
    )


# How much of a channel's motion the rig leaves unexplained beyond noise, as a share of that motion, with bounds.
#
# The residual is taken as m + e: noise e, and what the rig as a model leaves, m = a ŷ, with ŷ the predicted motion
# and a complex coefficient a that is alike within a block of lines.  The share is s, s² = Σ E_b |a_b|² / Σ |y|² with
# E_b = Σ |ŷ|² over a block and y the measured motion.  Where the noise is known otherwise, each line is a block and
# nothing is supposed of a.  Where these very residuals tell it, blocks are no wider than the nearest mode is sharp:
# noise does not follow the motion from line to line, so that its size is that of the scatter within blocks.


LEVEL = 0.05  # of either one-sided bound
LINES_OF_A_BLOCK = 4  # at the least, where the scatter within blocks sizes the noise
LEAST_WITHIN, MOST_WITHIN = (
    0.01,
    0.05,
)  # shares of the motion within which a rig fits, unless another is asked for
# Half-power width over the distance to the pole, measured along ∫ dω / |jω − λ|.
HALF_POWER = 2 * math.asinh(1.0)


def discrepancies(
    left: Residuals, estimate: Estimate, motions: Bools, known_noise: bool, within: float | None = None
) -> dict[str, Discrepancy | None]:
    """What the rig leaves of each moving channel; None where noise and discrepancy cannot be told apart.

    motions (channels,) those that show motion; known_noise: whether the noise is known from more than `left`; within:
    the share of the motion that is asked for.
    """
    shown = {str(left.channels[c]): int(c) for c in np.flatnonzero(motions)}
    shown = {name: c for name, c in shown.items() if np.any(np.isfinite(left.measured[:, c]))}
    if estimate.fit.dof < LINES_OF_A_BLOCK:  # too few to tell noise from what the unknowns have taken up
        return dict.fromkeys(shown)
    block = np.arange(len(left.frequency_hz))
    if not known_noise:
        if estimate.modes is None or not len(estimate.modes.eigenvalues):
            return dict.fromkeys(shown)
        block = blocks_of(left.frequency_hz, left.experiment, estimate.modes.eigenvalues)
    channels = {name: _ChannelBlocks.of(left, c, block, known_noise) for name, c in shown.items()}
    told = 2 * sum(len(each.weight) for each in channels.values() if each is not None)
    free = max(
        1 - len(estimate.names) / max(told, 1), 0.0
    )  # of the noise, apart from what the unknowns have taken up
    return {name: None if each is None else each.bounded(free, within) for name, each in channels.items()}


@dataclass(frozen=True)
class _ChannelBlocks:
    """|⟨ŷ, r⟩|² / |ŷ|² of one channel in blocks and its noise, over the motion's energy; the block's part of |ŷ|².

    (blocks,) each; noise over motion.  The size of ŷ, which of a wrong rig may be any, does not enter.
    """

    square: Real
    noise: Real
    weight: Real
    relative_noise: float

    @staticmethod
    def of(left: Residuals, c: int, block: Ints, known_noise: bool) -> _ChannelBlocks | None:
        """None where blocks of enough lines hold less than half of the motion."""
        there = np.isfinite(left.measured[:, c]) & np.isfinite(left.variance[:, c])
        shape = left.predicted[:, c] / np.max(np.abs(left.predicted[there, c]), initial=np.finfo(float).tiny)
        seen = there & (np.abs(shape) ** 2 > np.finfo(float).tiny)
        if not np.any(np.abs(left.measured[seen, c]) > 0):
            return None
        y, v, motion = shape[seen], left.variance[seen, c], np.abs(left.measured[seen, c]) ** 2
        r, block = left.measured[seen, c] - left.predicted[seen, c], block[seen]
        number, lines = np.unique(block, return_inverse=True, return_counts=True)[1:]

        def summed(values: Real) -> Real:
            return np.bincount(number, values, len(lines)).astype(np.float64)

        energy, motions = summed(np.abs(y) ** 2), summed(motion)
        y = y / np.sqrt(energy)[number]
        noisy, product = summed(np.abs(y) ** 2 * v), np.conj(y) * r
        a = summed(product.real) + 1j * summed(product.imag)
        if not known_noise:
            enough = lines >= LINES_OF_A_BLOCK
            if np.sum(motions[enough]) < np.sum(motions) / 2:
                return None
            rest = np.abs(r - a[number] * y) ** 2
            inside = enough[number] & (v > 0)
            if not np.any(inside):
                return None
            size = np.sum(rest[inside] / v[inside]) / np.sum(lines[enough] - 1)
            v, noisy = size * v, size * noisy
            a, energy, noisy, motions = a[enough], energy[enough], noisy[enough], motions[enough]
        # Where residuals tell the noise, they tell more of it where the rig moves most and is most wrong.
        typical = np.mean(v) if known_noise else np.median(v)
        total, relative = np.sum(motions), float(np.sqrt(typical / np.mean(motion)))
        return _ChannelBlocks(np.abs(a) ** 2 / total, noisy / total, energy / np.sum(energy), relative)

    def bounded(self, free: float, asked: float | None) -> Discrepancy:
        """The share with one-sided bounds: Patnaik's approximation of the weighted sum of noncentral χ².

        The upper bound is that of CLs (Read 2002, J. Phys. G 28:2693): residuals that are small by chance do not make
        a rig better than the data can show.
        """
        n, total = free * self.noise, float(np.sum(self.square))
        mean, spread = float(np.sum(n)), (float(n @ n), float(2 * self.weight @ n))

        def tail(square: float, upper: bool) -> float:
            """Chance that so large a sum, or a larger (a smaller) one, comes of a share whose square is given."""
            expected, variance = square + mean, spread[0] + spread[1] * square
            if variance <= 0:
                return float(total >= expected if upper else total <= expected)
            shape = expected**2 / variance
            return float((gammaincc if upper else gammainc)(shape, shape * total / expected))

        value = math.sqrt(max(total - mean, 0.0))
        within = min(max(LEAST_WITHIN, self.relative_noise), MOST_WITHIN) if asked is None else asked
        if spread[0] <= 0:
            return Discrepancy(value, value, value, within)
        beyond = total + mean + 10 * math.sqrt(spread[0]) + 40 * spread[1]
        least = 0.0
        if tail(0.0, True) < LEVEL:
            least = _crossing(lambda square: tail(square, True) < LEVEL, beyond)
        asked = LEVEL * tail(0.0, False)
        while tail(beyond, False) > asked:
            beyond *= 4
        most = _crossing(lambda square: tail(square, False) > asked, beyond)
        return Discrepancy(value, math.sqrt(least), math.sqrt(max(most, 0.0)), within)


def _crossing(below: Callable[[float], bool], high: float) -> float:
    """Where from 0 to `high` what holds below ends, to the digits of a number."""
    low = 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if below(middle) else (low, middle)
    return high


def blocks_of(frequency_hz: Real, experiment: Ints, poles: Complex) -> Ints:
    """A number for each line, the same in a block: of one experiment, and no wider than a mode is sharp.

    poles rad/s.  Far from all modes blocks may reach further, in proportion to their distance.
    """
    omega = 2 * np.pi * frequency_hz
    block = np.zeros(len(omega), dtype=np.int64)
    for number in np.unique(experiment):
        lines = np.flatnonzero(experiment == number)
        lines = lines[np.argsort(omega[lines], kind="stable")]
        at = omega[lines]
        away = np.min(np.abs(1j * at[:, None] - poles), axis=1)
        steps = 2 * np.diff(at) / np.maximum(away[1:] + away[:-1], np.finfo(float).tiny)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        cell, count = np.unique(
            (along / HALF_POWER).astype(np.int64), return_inverse=True, return_counts=True
        )[1:]
        # Many lines of a cell are blocks of few, so that little is supposed to be alike.
        first = np.cumsum(count) - count
        parts = np.maximum(count // LINES_OF_A_BLOCK, 1)
        part = (np.arange(len(lines)) - first[cell]) * parts[cell] // count[cell]
        block[lines] = np.max(block, initial=0) + 1 + (np.cumsum(parts) - parts)[cell] + part
    return block
