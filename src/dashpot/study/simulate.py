"""Simulated tests: records sample by sample, or spectra drawn at once with exactly the same distribution.

With independent Gaussian noise of sd σ_c on N samples, least squares for trend and fundamental gives coefficients
β̂ ~ N(β, P σ_c²), P = (Hᵀ M H)⁻¹, and an independent residual product matrix R ~ Wishart(N − terms, diag σ²); H holds
cos ωt and sin ωt, M takes the trend out.  Amplitudes, estimated covariance and second moments are functions of (β̂, R)
alone, so a repeat costs two numbers a channel and a triangle of q (q + 1)/2 instead of N q samples.  Muirhead (1982),
theorems 3.1.2 and 3.2.14 (Bartlett's decomposition).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander

from dashpot.arrays import Complex, Ints, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.data.spectrum import Moments, Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.model.channel_noise import noise_sd
from dashpot.model.dynamics import response, unit_forces
from dashpot.model.network import Model
from dashpot.model.observation import channel_amplitudes, input_channels, measures_input, observation_model

NoiseBasis = Literal["given", "estimated"]
CACHED = 2**14  # random numbers at a time, which stay in the processor's cache


@dataclass(frozen=True)
class Dwells:
    """A stepped-sine test: what is driven at each frequency, and how it is sampled.

    frequency_hz  (lines,)    Hz
    samples       (lines,)    samples of every channel, evenly spaced from t = 0 on
    periods       (lines,)    time of a dwell in periods; samples are periods / (samples · frequency) apart
    U             (lines, r)  amplitudes of the displacement inputs, m
    f             (lines, s)  amplitudes of the forces, N
    """

    frequency_hz: Real
    samples: Ints
    periods: Real
    U: Complex
    f: Complex

    def __post_init__(self) -> None:
        freeze(self)
        bad = ~(np.isfinite(self.frequency_hz) & (self.frequency_hz > 0))
        if np.any(bad):
            raise DataError(
                f"frequency {self.frequency_hz[bad][0]:g} Hz", cure="frequencies must be positive and finite"
            )
        if np.any(self.samples < 1) or not np.all((self.periods > 0) & np.isfinite(self.periods)):
            raise DataError("a dwell without samples or without time", cure="give it at least one sample")

    @property
    def omega(self) -> Real:
        """2π f, (lines,), rad/s."""
        return 2 * np.pi * self.frequency_hz

    def time(self, line: int) -> Real:
        """Sample times of one dwell, (samples,), s."""
        count = int(self.samples[line])
        step = self.periods[line] / (count * self.frequency_hz[line])
        times: Real = np.arange(count) * step
        return times


def dwells(
    model: Model,
    frequency_hz: Sequence[float] | Real,
    samples: int | Sequence[int] | Ints = 56,
    *,
    amplitudes: Mapping[str, complex] | None = None,
    periods: float | Sequence[float] | Real = 1.0,
    rate: float | None = None,
) -> Dwells:
    """The test that drives every input of `model` at each frequency.

    frequency_hz (lines,); samples and periods of each dwell (lines,), or one number for all.  `amplitudes` of the
    inputs by name in SI units, 1 where not named.  Samples are spread over `periods`, or taken at `rate` (Hz).  Raises
    UsageError for an input that the rig has not.
    """
    frequencies = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    lines = len(frequencies)
    given: Mapping[str, complex] = {} if amplitudes is None else amplitudes
    names = [source.name for source in model.inputs]
    for name in given:
        if name not in names:
            raise UsageError(f"the rig has no input {name}", cure=f"it has {', '.join(names)}")
    U = np.array([given.get(name, 1.0) for name in model.displacement_inputs], dtype=complex)
    f = np.array([given.get(name, 1.0) for name in model.force_inputs], dtype=complex)
    counts = np.broadcast_to(np.asarray(samples, dtype=np.int64), (lines,))
    cycles = frequencies * counts / rate if rate is not None else np.asarray(periods, dtype=float)
    return Dwells(
        frequencies,
        counts,
        np.broadcast_to(cycles, (lines,)),
        np.broadcast_to(U, (lines, len(U))),
        np.broadcast_to(f, (lines, len(f))),
    )


# Channels and their noise


def standard_channels(model: Model, quantities: Sequence[Quantity]) -> tuple[Channel, ...]:
    """Every coordinate in each of the quantities, then the inputs without noise; SI units.

    Displacement channels bear the name of their point, velocities and accelerations `d` and `dd` before it.
    """
    prefix = {Quantity.DISPLACEMENT: "", Quantity.VELOCITY: "d", Quantity.ACCELERATION: "dd"}
    motions = [
        Channel(prefix[quantity] + point, {point: 1.0}, quantity)
        for quantity in quantities
        for point in model.coordinates
    ]
    return (*motions, *input_channels(model))


def with_constant_noise(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    level: float,
    reference: Dwells,
    *,
    drives: bool = False,
) -> tuple[Channel, ...]:
    """Channels whose noise has one size at all frequencies: level × rms amplitude of the channel over `reference`.

    p (elements,).
    """
    Y = clean_amplitudes(model, p, channels, reference)
    size = np.sqrt(np.mean(np.abs(Y) ** 2, axis=-2))
    return tuple(
        channel
        if measures_input(model, channel) and not drives
        else replace(
            channel, noise=level * float(rms) * abs(channel.factor) / channel.scale, relative_noise=0.0
        )
        for channel, rms in zip(channels, size, strict=True)
    )


def clean_amplitudes(model: Model, p: Real, channels: Sequence[Channel], test: Dwells) -> Complex:
    """Amplitudes of the channels' quantities without noise, (..., lines, channels), SI units; p (..., elements).

    Raises DataError where a channel measures what the rig has not.
    """
    view = observation_model(model, channels, test.omega)
    X = response(model, p, test.omega, test.U, test.f)
    forces = p[..., None, :] * unit_forces(model, test.omega, X, test.U)
    return channel_amplitudes(view, X, np.concatenate([test.U, test.f], axis=-1), forces)


# Sample by sample


def simulate_records(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    test: Dwells,
    rng: np.random.Generator,
    *,
    draws: int | None = None,
    offset: Real | None = None,
) -> list[Record]:
    """One steady record for each dwell, noise and calibrations of the channels included.

    p (elements,), SI units; `draws` repeats make a leading axis of the values; `offset` (channels,) is added, SI units.
    Unknown gains, delays and signs are simulated as 1, 0 and 1.  Raises ModelError where the rig has no steady
    response, DataError where a channel measures what the rig has not.
    """
    channels = tuple(channels)
    Y = clean_amplitudes(model, p, channels, test)
    sd = noise_sd(channels, Y)
    factor = np.array([channel.factor for channel in channels])
    delay = np.array([0.0 if channel.delay is None else channel.delay for channel in channels])
    level = np.zeros(len(channels)) if offset is None else np.asarray(offset, dtype=float)
    batch = () if draws is None else (draws,)
    records = []
    for line, omega in enumerate(test.omega):
        time = test.time(line)
        values = (Y[line] * np.exp(1j * omega * (time[:, None] - delay))).real
        values = values + sd[line] * rng.standard_normal((*batch, len(time), len(channels)))
        frequency = float(test.frequency_hz[line])
        records.append(
            Record(
                channels, time, factor * values + level, frequency, source=f"simulation at {frequency:g} Hz"
            )
        )
    return records


# All at once


def simulate_spectrum(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    test: Dwells,
    rng: np.random.Generator,
    *,
    draws: int | None = None,
    noise: NoiseBasis = "given",
    moments: bool = False,
    drift: int | None = None,
) -> Spectrum:
    """The Spectrum of simulated records, drawn from its exact distribution without their samples.

    `noise` "given" states the true covariance, "estimated" the one that white residuals of the records would give,
    with its degrees of freedom.  `drift` is the degree of the trend solved for (None: not even an offset), `moments`
    adds the second moments for the methods that work on samples.  The amplitudes depend on neither.
    p (elements,), SI units; `draws` repeats make a leading axis.  Raises DataError where a dwell has too few samples or
    a channel measures what the rig has not, ModelError where the rig has no steady response.
    """
    channels = tuple(channels)
    Y = clean_amplitudes(model, p, channels, test)
    sd = noise_sd(channels, Y)
    gram = _grams(test, drift)
    P = np.linalg.inv(gram)
    K = 1 if draws is None else draws
    lines = len(test.frequency_hz)
    A = _with_errors(Y, np.linalg.cholesky(P), sd, rng, K)
    free = test.samples - 2 - (0 if drift is None else drift + 1)
    spread = np.trace(P, axis1=-2, axis2=-1)
    residual = None
    if moments or noise == "estimated":
        residual = sd[:, :, None] * _wishart(rng, K, free, sd) * sd[:, None, :]
    V = _covariance(spread, sd)
    dof, basis = np.full(lines, np.inf), "given"
    if noise == "estimated" and residual is not None:
        _require_free(test, free)
        V = ((spread / free)[:, None, None] * residual).astype(np.complex128)
        dof, basis = free.astype(float), "white"
    products = _moments(A, gram, residual) if moments and residual is not None else None
    if draws is None:
        A = A[0]
        V = V[0] if V.ndim == 4 else V
        products = None if products is None else products[0]
    kept, experiment = None if products is None else Moments(products), np.zeros(lines, dtype=np.int64)
    return Spectrum(
        channels, test.frequency_hz, A, V, test.samples, dof, (basis,) * lines, experiment, kept
    )  # fmt: skip


def _with_errors(Y: Complex, root: Real, sd: Real, rng: np.random.Generator, draws: int) -> Complex:
    """Y (lines, channels) with the errors of its cosines and sines, (draws, lines, channels).

    root (lines, 2, 2) is lower triangular, sd (lines, channels).
    """
    lines, channels = Y.shape
    of_cosine, crossed, of_sine = (root[:, i, j, None] * sd for i, j in ((0, 0), (1, 0), (1, 1)))
    A = np.empty((draws, lines, channels), dtype=np.complex128)
    piece = max(1, CACHED // max(1, 2 * Y.size))
    noise = np.empty((min(piece, draws), lines, 2, channels))
    for first in range(0, draws, piece):
        part = A[first : first + piece]
        drawn = rng.standard_normal(out=noise[: len(part)])
        cosine, sine = drawn[..., 0, :], drawn[..., 1, :]
        part.real = Y.real + of_cosine * cosine
        part.imag = Y.imag - (crossed * cosine + of_sine * sine)
    return A


def clean_spectrum(
    model: Model, p: Real, channels: Sequence[Channel], test: Dwells, *, drift: int | None = None
) -> Spectrum:
    """Amplitudes without noise, with the covariance that their noise would have: what bounds are computed from.

    p (elements,).
    """
    channels = tuple(channels)
    Y = clean_amplitudes(model, p, channels, test)
    spread = np.trace(np.linalg.inv(_grams(test, drift)), axis1=-2, axis2=-1)
    lines = len(test.frequency_hz)
    return Spectrum(
        channels,
        test.frequency_hz,
        Y,
        _covariance(spread, noise_sd(channels, Y)),
        test.samples,
        np.full(lines, np.inf),
        ("given",) * lines,
        np.zeros(lines, dtype=np.int64),
    )


def with_noise_drawn(clean: Spectrum, rng: np.random.Generator, draws: int) -> Spectrum:
    """Repeats of amplitudes without noise, with noise of their covariance, which is shared, (lines, c, c), diagonal."""
    sd = np.sqrt(np.diagonal(clean.covariance, axis1=-2, axis2=-1).real / 2)
    shape = (draws, *clean.amplitudes.shape)
    error = sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    return replace(clean, amplitudes=clean.amplitudes + error)


def _covariance(spread: Real, sd: Real) -> Complex:
    """E[Δ Δᴴ] = tr P · diag σ², (lines, channels, channels)."""
    V = (spread[:, None] * sd**2)[:, :, None] * np.eye(sd.shape[-1])
    return V.astype(np.complex128)


def _grams(test: Dwells, drift: int | None) -> Real:
    """Hᵀ M H of (cos ωt, sin ωt) with the trend taken out, (lines, 2, 2).  Raises DataError where it is singular."""
    cache: dict[tuple[int, float], Real] = {}
    for count, periods in zip(test.samples.tolist(), test.periods.tolist(), strict=True):
        if (count, periods) in cache:
            continue
        phase = 2 * np.pi * periods * np.arange(count) / count
        H = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        if drift is not None:
            Q = np.linalg.qr(legvander(np.linspace(-1, 1, count), drift))[0]
            H = H - Q @ (Q.T @ H)
        gram = H.T @ H
        terms = 2 if drift is None else 3 + drift
        if count < terms or np.linalg.eigvalsh(gram)[0] < 1e-7 * count:
            raise DataError(
                f"{count} samples over {periods:g} periods cannot tell offset, drift and harmonic apart",
                cure="take more samples, or spread them otherwise",
            )
        cache[count, periods] = gram
    return np.array([cache[key] for key in zip(test.samples.tolist(), test.periods.tolist(), strict=True)])


def _require_free(test: Dwells, free: Ints) -> None:
    if np.any(free < 1):
        count = int(test.samples[int(np.argmin(free))])
        raise DataError(
            f"{count} samples leave no residual to estimate the noise from",
            cure="take more samples, or give the noise",
        )


def _wishart(rng: np.random.Generator, draws: int, dof: Ints, sd: Real) -> Real:
    """R ~ Wishart(dof, 1) for the channels that have noise at some line, (draws, lines, channels, channels).

    Bartlett: R = A Aᵀ with A_ii² ~ χ²(dof − i), A_ij ~ N(0, 1) below; columns from dof on are 0 (singular R).
    """
    lines, channels = sd.shape
    noisy = np.flatnonzero(np.any(sd > 0, axis=0))
    q = len(noisy)
    R = np.zeros((draws, lines, channels, channels))
    if q == 0:
        return R
    A = np.zeros((draws, lines, q, q))
    below = np.tril_indices(q, -1)
    A[..., below[0], below[1]] = rng.standard_normal((draws, lines, len(below[0])))
    degrees = dof[:, None] - np.arange(q)
    A[..., range(q), range(q)] = np.sqrt(rng.chisquare(np.maximum(degrees, 1), (draws, lines, q)))
    A *= (degrees > 0)[:, None, :]
    R[..., noisy[:, None], noisy] = A @ np.swapaxes(A, -1, -2)
    return R


def _moments(A: Complex, gram: Real, residual: Real) -> Real:
    """Σ q qᵀ with q = (channels, cos, sin), (draws, lines, channels + 2, channels + 2)."""
    beta = np.stack([A.real, -A.imag], axis=-2)
    rows = np.concatenate([beta, np.broadcast_to(np.eye(2), (*beta.shape[:-1], 2))], axis=-1)
    products: Real = np.swapaxes(rows, -1, -2) @ gram @ rows
    channels = A.shape[-1]
    products[..., :channels, :channels] += residual
    return products
