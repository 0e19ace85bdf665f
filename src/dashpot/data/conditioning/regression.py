"""Least squares of offset, drift and harmonics over the samples of a record, without holding the design matrix.

    y_c(t) = Σ_i τ_ic P_i((t − centre)/half) + Σ_k Re(X_kc e^{jkωt}) + noise_c(t)                      (H)

P_i are Legendre polynomials, so the columns are of one size and nearly orthogonal; the normal equations are summed
over chunks of samples and refined once by the residual, which gives the accuracy of an orthogonal factorisation.
All channels and leading batch axes share it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cho_solve

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.numerics.harmonic_sums import even_gram, harmonic_sums
from dashpot.numerics.kernel import kernel

CHUNK = 1 << 15  # samples whose design matrix is held at a time
TILE = 1 << 21  # numbers of a batch worked on at a time
EXACT = 1e-10  # residual over amplitude below which a channel counts as noise-free


def check_length(record: Record, f: float, orders: tuple[int, ...], degree: int) -> None:
    """Raises DataError where there are fewer samples than terms, less than one period, or too slow samples.

    Harmonics beyond half the sampling rate are taken for lower ones; a fundamental there is `factor`'s to judge.
    """
    samples, terms = len(record.time), degree + 1 + 2 * len(orders)
    if samples <= terms:
        raise DataError(
            f"{samples} samples are too few for {terms} terms (offset, drift and harmonics) at {f:g} Hz",
            record.source,
            f"record at least {terms + 1} samples, better some hundred",
        )
    if not holds_a_period(record.time, f):
        raise DataError(
            f"the record holds {f * duration(record.time):.3g} of a period at {f:g} Hz",
            record.source,
            "record at least one whole period, better ten, or correct the frequency",
        )
    rate = 1 / float(np.min(np.diff(record.time)))
    highest = max(orders)
    if highest > 1 and highest * f >= rate / 2:
        raise DataError(
            f"order {highest} of {f:g} Hz is {highest * f:g} Hz, beyond half the sampling rate of {rate:.4g} Hz",
            record.source,
            "ask for lower orders, or sample faster",
        )


def holds_a_period(time: Real, f: float) -> bool:
    """Whether the samples (samples,) span a period; unevenly sampled ones may end a step inside, on both sides."""
    return f * (float(time[-1] - time[0]) + 2 * float(np.max(np.diff(time)))) >= 1


def duration(time: Real) -> float:
    """Time that the samples stand for: the span and one mean step, s.  time (samples,)."""
    return float(time[-1] - time[0]) * len(time) / (len(time) - 1)


def window(time: Real) -> tuple[float, float]:
    """Middle and half width of the time, s.  time (samples,)."""
    return float(time[0] + time[-1]) / 2, float(time[-1] - time[0]) / 2


def basis(
    t: Real, f: float, orders: Sequence[int], degree: int, centre: float, half: float, ramps: bool = False
) -> Real:
    """Columns P_0 … P_degree, cos kωt and sin kωt of each order, then those of order 1 times (t − centre)/half."""
    s = (t - centre) / half
    cycles = f * t
    z = np.exp(2j * np.pi * (cycles - np.floor(cycles)))
    columns = np.empty((len(t), degree + 1 + 2 * len(orders) + 2 * ramps))
    if degree >= 0:
        columns[:, : degree + 1] = legvander(s, degree)
    power, at = np.ones_like(z), 0
    for i, order in enumerate(orders):
        while at < order:
            power, at = power * z, at + 1
        columns[:, degree + 1 + 2 * i] = power.real
        columns[:, degree + 2 + 2 * i] = power.imag
    if ramps:
        columns[:, -2] = s * z.real
        columns[:, -1] = s * z.imag
    return columns


def coefficients_of(trend: Real, amplitudes: Complex) -> Real:
    """(trend, amplitudes) as coefficients of the columns of `_basis`: Re(X e^{jφ}) = Re X cos φ − Im X sin φ."""
    pairs = np.stack([amplitudes.real, -amplitudes.imag], axis=-2)
    waves = pairs.reshape(*pairs.shape[:-3], -1, pairs.shape[-1])
    return np.concatenate([trend, waves], axis=-2)


def tiles(batch: int, rows: int, channels: int) -> Iterator[slice]:
    """Pieces of the flattened batch axis of about TILE numbers."""
    step = max(1, TILE // max(1, rows * channels))
    for start in range(0, batch, step):
        yield slice(start, min(batch, start + step))


def chunks(samples: int) -> Iterator[slice]:
    """The samples, CHUNK at a time."""
    """The samples, CHUNK at a time."""
    """The samples, CHUNK at a time."""
    for start in range(0, samples, CHUNK):
        yield slice(start, min(samples, start + CHUNK))


@dataclass(frozen=True)
class HarmonicSolution:
    """Least squares over one basis: factor of the Gram AᵀA = L Lᵀ, its inverse, coefficients, residual sums."""

    L: Real
    P: Real
    coefficients: Real  # (batch, terms, channels)
    squares: Real  # (batch, channels, channels)
    largest: Real  # (batch, channels), of |y|

    def amplitudes(self, degree: int) -> Complex:
        """Complex amplitudes of the harmonics, (batch, orders, channels)."""
        waves = self.coefficients[:, degree + 1 :]
        return waves[:, 0::2] - 1j * waves[:, 1::2]


class Monitor(Protocol):
    """What sees the residual as it streams by."""

    def next_rows(self, t: Real, A: Real) -> None:
        """The samples that `see` shows next: their times (samples,) and design rows (samples, terms)."""

    def see(self, part: slice, e: Real) -> None:
        """Residuals (batch, rows, channels) of the present rows."""


def solve_harmonics(
    record: Record,
    f: float,
    orders: Sequence[int],
    degree: int,
    ramps: bool = False,
    monitor: Monitor | None = None,
) -> HarmonicSolution:
    """Two passes over the samples: normal equations, then residual (shown to `monitor`) and one refinement."""
    time, centre, half = record.time, *window(record.time)
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    batch, terms = len(Y), degree + 1 + 2 * len(orders) + 2 * ramps
    gram, right = np.zeros((terms, terms)), np.zeros((batch, terms, channels))
    largest = np.zeros((batch, channels))
    held: Real | None = None
    even = None if ramps else _even_sums(time, Y, f, orders, degree)
    if even is not None:
        gram, right, largest = even
    for rows in chunks(samples) if even is None else ():
        A = held = basis(time[rows], f, orders, degree, centre, half, ramps)
        gram += A.T @ A
        for part in tiles(batch, len(A), channels):
            y = Y[part, rows]
            right[part] += A.T @ y
            np.maximum(largest[part], np.max(np.abs(y), axis=1, initial=0.0), out=largest[part])
    L: Real = factor(gram, record, f)
    coefficients = cholesky_solve(L, right)
    correction, squares = np.zeros_like(right), np.zeros((batch, channels, channels))
    for rows in chunks(samples):
        if held is not None and samples <= CHUNK:
            A = held
        else:
            A = basis(time[rows], f, orders, degree, centre, half, ramps)
        if monitor is not None:
            monitor.next_rows(time[rows], A)
        for part in tiles(batch, len(A), channels):
            e = Y[part, rows] - A @ coefficients[part]
            correction[part] += A.T @ e
            squares[part] += np.swapaxes(e, 1, 2) @ e
            if monitor is not None:
                monitor.see(part, e)
    coefficients += cholesky_solve(L, correction)
    identity = cholesky_solve(L, np.eye(terms)[None])[0]
    return HarmonicSolution(L, (identity + identity.T) / 2, coefficients, squares, largest)


def _even_sums(
    time: Real, Y: Real, f: float, orders: Sequence[int], degree: int
) -> tuple[Real, Real, Real] | None:
    """Gram, right sides and largest |y| of many even samples, by the compiled pass; None where NumPy does as well.

    What the recurrence of its waves rounds off, the refinement by the residual takes out.
    """
    samples, (centre, _) = len(time), window(time)
    if kernel() is None or samples <= CHUNK or degree > 1:
        return None
    step = float(time[-1] - time[0]) / (samples - 1)
    due = time[0] + step * np.arange(samples)
    if np.max(np.abs(time - due)) > 8 * np.finfo(float).eps * np.max(np.abs(time)):
        return None
    phase = 2 * np.pi * ((f * centre) % 1.0)
    gram = even_gram(samples, f * step, phase, orders, degree)
    if gram is None:
        return None
    turned = np.exp(1j * phase * np.asarray(orders))[:, None]
    right = np.empty((len(Y), len(gram), Y.shape[-1]))
    largest = np.empty((len(Y), Y.shape[-1]))
    for k, y in enumerate(Y):
        sums = harmonic_sums(y, f * step * np.asarray(orders, dtype=np.float64))
        right[k, : degree + 1] = np.stack([sums.plain, 2 * sums.moment / (samples - 1)])[: degree + 1]
        waves = turned * sums.waves
        right[k, degree + 1 :: 2], right[k, degree + 2 :: 2] = waves.real, waves.imag
        largest[k] = sums.largest
    return gram, right, largest


def factor(gram: Real, record: Record, f: float) -> Real:
    """Cholesky factor of the Gram.  Raises DataError where the samples do not tell the columns apart.

    (..., columns, columns).
    """
    size = np.sqrt(np.diagonal(gram))
    singular = not np.all(size > 1e-6 * np.sqrt(len(record.time)))
    if not singular:
        singular = float(np.linalg.eigvalsh(gram / np.outer(size, size))[0]) < 1e-7
    if singular:
        rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
        raise DataError(
            f"the samples (about {rate:g} per second) cannot tell offset, drift and harmonics apart at {f:g} Hz",
            record.source,
            "record more periods, at a rate that is not twice the frequency or less, or ask for fewer harmonics",
        )
    return np.linalg.cholesky(gram).astype(np.float64)


def cholesky_solve(L: Real, right: Real) -> Real:
    """(L Lᵀ)⁻¹ right over a batch of right sides (batch, terms, columns)."""
    batch, terms, columns = right.shape
    flat = np.moveaxis(right, 1, 0).reshape(terms, -1)
    # Not by two solve_triangular: its LAPACK wakes threads for the smallest matrix, 8 ms each where cores are busy.
    whole = cho_solve((L, True), flat, check_finite=False)
    return np.ascontiguousarray(np.moveaxis(whole.reshape(terms, batch, columns), 0, 1))


def exact_channels(sigma: Real, X: Complex, largest: Real, share: float = EXACT) -> Bools:
    """(batch, channels): the residual is rounding, a `share` of the amplitude or of the numbers themselves."""
    rms = np.sqrt(np.maximum(np.diagonal(sigma, axis1=1, axis2=2), 0.0))
    strongest = np.max(np.abs(X), axis=1)
    bound = np.maximum(share * strongest, 32 * np.finfo(float).eps * largest)
    return rms <= bound
