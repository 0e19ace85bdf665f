"""From samples to complex amplitudes: offset, drift and harmonics by least squares on the true sample times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Unpack

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real, freeze
from dashpot.channel import Channel
from dashpot.data.conditioning.regression import (
    basis,
    check_length,
    coefficients_of,
    duration,
    exact_channels,
    solve_harmonics,
    window,
)
from dashpot.data.conditioning.residual_noise import (
    ResidualMonitor,
    noise_beside_harmonics,
    white_noise,
)
from dashpot.data.conditioning.settings import Conditioning, FitTreatments, Noise, conditioning_of
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.notices import Notice

SIGNIFICANT = 0.01
HIGHEST_HARMONIC = 10  # looked for
DIGITS = 1e-6  # residual over amplitude below which it is how numbers are written: no sensor is as quiet


@dataclass(frozen=True)
class HarmonicFit:
    """The harmonics of one record, x(t) = Re(X e^{jkωt}), t being the record's own time stamps; units of its values.

    samples, periods     of the record, periods at frequency_hz
    orders               which multiples of frequency_hz were solved for, ascending
    amplitudes           (..., orders, channels)
    covariance           (..., orders, channels, channels)  V = E[Δ Δᴴ]; circular: Re and Im have Re V / 2 each
    real_covariance      (..., orders, channels, 2, 2)  of (Re X, Im X), exact also where the periods are not whole
    trend                (..., degree + 1, channels)  Legendre coefficients over (t − centre)/half; no offset: no rows
    centre, half         of the time stamps, s
    residual_covariance  (..., channels, channels)  of one sample, exact channels 0
    dof                  (orders,)  real degrees of freedom behind the covariance
    noise                "white": residual covariance times the exact covariance of least squares;
                         "blocks": cross-spectrum of the residual on lines beside each harmonic
    whiteness            (...,)  p-value of a white residual, smallest over channels (Bonferroni); NaN where not tested
    notes                what was found on the way
    """

    channels: tuple[Channel, ...]
    frequency_hz: float
    orders: tuple[int, ...]
    amplitudes: Complex
    covariance: Complex
    real_covariance: Real
    trend: Real
    centre: float
    half: float
    residual_covariance: Real
    samples: int
    periods: float
    dof: Real
    noise: Literal["white", "blocks"]
    whiteness: Real
    notes: tuple[Notice, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)

    def __call__(self, time: Real) -> Real:
        """The fitted signal at times in s: (..., times, channels)."""
        A = basis(
            np.asarray(time, dtype=float), self.frequency_hz, self.orders, self.degree, self.centre, self.half
        )
        values: Real = A @ coefficients_of(self.trend, self.amplitudes)
        return values

    @property
    def degree(self) -> int:
        """Degree of the drift; 0 is an offset alone, −1 is nothing."""
        return int(self.trend.shape[-2]) - 1


def fit_harmonics(
    record: Record,
    frequency_hz: float | None = None,
    conditioning: Conditioning | None = None,
    **treatments: Unpack[FitTreatments],
) -> HarmonicFit:
    """Solve (H) for trend and harmonics of every channel together.

    `conditioning`, or its fields `orders`, `harmonics`, `drift` and `noise` as keywords, says what is solved for, at
    the multiples of the frequency (the record's own unless given).

    Raises DataError where the record is shorter than a period, has too few samples, or cannot tell the terms apart.
    """
    f = record.frequency_hz if frequency_hz is None else frequency_hz
    if f is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    if not (np.isfinite(f) and f > 0):
        raise DataError(f"frequency {f} Hz", record.source, "frequencies must be positive and finite")
    settings = conditioning_of(conditioning, treatments)
    orders = settings.wanted
    check_length(record, f, orders, settings.degree)
    beside = settings.nuisance_orders
    if beside is None:
        orders = _with_significant(record, f, orders, settings.degree)
    else:
        orders = tuple(sorted({*orders, *beside}))
        check_length(record, f, orders, settings.degree)
    return _fit(record, f, orders, settings.degree, settings.noise)


def _fit(record: Record, f: float, orders: tuple[int, ...], degree: int, noise: Noise) -> HarmonicFit:
    samples, channels = record.values.shape[-2:]
    leading, terms = record.values.shape[:-2], degree + 1 + 2 * len(orders)
    monitor = None if noise == "white" else ResidualMonitor(record, f, orders, terms)
    solution = solve_harmonics(record, f, orders, degree, monitor=monitor)
    X = solution.amplitudes(degree)
    free = samples - terms
    sigma = solution.squares / free
    exact = exact_channels(sigma, X, solution.largest)
    sigma = np.where(exact[:, :, None] | exact[:, None, :], 0.0, sigma)
    level = white_noise(sigma, len(orders), free)
    if monitor is not None:
        written = exact_channels(sigma, X, solution.largest, DIGITS)
        local = noise_beside_harmonics(monitor, solution.L, samples, free, sigma, exact, written)
        level = local.chosen(level, noise, record, f)
    P = _real_and_imaginary(solution.P, degree, len(orders))
    spread = P[:, 0, 0] + P[:, 1, 1]
    real = P[None, :, None] * np.diagonal(level.level.real, axis1=-2, axis2=-1)[..., None, None]
    centre, half = window(record.time)
    return HarmonicFit(
        record.channels,
        float(f),
        orders,
        X.reshape(*leading, len(orders), channels),
        (spread[:, None, None] * level.level).reshape(*leading, len(orders), channels, channels),
        real.reshape(*leading, len(orders), channels, 2, 2),
        solution.coefficients[:, : degree + 1].reshape(*leading, degree + 1, channels),
        centre,
        half,
        sigma.reshape(*leading, channels, channels),
        samples,
        float(f * duration(record.time)),
        level.dof,
        level.kind,
        level.whiteness.reshape(leading),
        level.notes,
    )


def _real_and_imaginary(P: Real, degree: int, orders: int) -> Real:
    """Covariance of (Re X, Im X) per unit variance of a sample, (orders, 2, 2), from that of the coefficients."""
    # (cos, sin) coefficients are (Re X, −Im X), hence the sign of the off-diagonal
    first = degree + 1 + 2 * np.arange(orders)
    return np.stack(
        [
            np.stack([P[first, first], -P[first, first + 1]], axis=-1),
            np.stack([-P[first + 1, first], P[first + 1, first + 1]], axis=-1),
        ],
        axis=-2,
    )


def _with_significant(record: Record, f: float, orders: tuple[int, ...], degree: int) -> tuple[int, ...]:
    """The orders asked for and those harmonics that are there beyond doubt."""
    samples, channels = record.values.shape[-2:]
    nyquist = (samples - 1) / float(record.time[-1] - record.time[0]) / 2
    highest = min(HIGHEST_HARMONIC, int(0.95 * nyquist / f), (samples - degree - 1) // 6)
    candidates = tuple(k for k in range(1, highest + 1) if k not in orders)
    if not candidates:
        return orders
    every = tuple(sorted({*orders, *candidates}))
    try:
        solution = solve_harmonics(record, f, every, degree)
    except DataError:
        return orders  # the record cannot tell them apart
    free = samples - degree - 1 - 2 * len(every)
    waves = solution.coefficients[:, degree + 1 :]
    X = solution.amplitudes(degree)
    sigma = solution.squares / free
    exact = exact_channels(sigma, X, solution.largest)
    variance = np.where(exact, 1.0, np.diagonal(sigma, axis1=1, axis2=2))
    strongest = np.maximum(np.max(np.abs(X), axis=1), 1e-5 * solution.largest)
    level = SIGNIFICANT / (len(candidates) * channels * len(X))
    significant = list(orders)
    for i, order in enumerate(every):
        if order in orders:
            continue
        pair = waves[:, 2 * i : 2 * i + 2]
        first = degree + 1 + 2 * i
        inside = np.linalg.solve(solution.P[first : first + 2, first : first + 2], pair)
        F = np.sum(pair * inside, axis=1) / (2 * variance)
        there = np.where(exact, np.abs(X[:, i]) > 1e-9 * strongest, fdtrc(2, free, F) < level)
        if np.any(there):
            significant.append(order)
    return tuple(sorted(significant))
