"""Least squares of offset, drift and harmonics over the samples of a record, without holding the design matrix.

    y_c(t) = Σ_i τ_ic P_i((t − centre)/half) + Σ_k Re(X_kc e^{jkωt}) + noise_c(t)                      (H)

P_i are Legendre polynomials, so the columns are of one size and nearly orthogonal; the normal equations are summed
over chunks of samples and refined once by the residual, which gives the accuracy of an orthogonal factorisation.
All channels and leading batch axes share it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cho_solve
from scipy.special import log_ndtr

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
    for start in range(0, samples, CHUNK):
        yield slice(start, min(samples, start + CHUNK))


@dataclass(frozen=True)
class HarmonicSolution:
    """Least squares over one basis, of clipped samples by the likelihood of being beyond their value.

    L             (terms, terms)  factor of the Gram AᵀA = L Lᵀ of all samples
    P             (channels, terms, terms)  covariance of coefficients per unit variance of a sample
    coefficients  (batch, terms, channels)
    squares       (batch, channels, channels)  of the residual
    free          (channels,)  degrees of freedom of the residual
    largest       (batch, channels)  of |y|
    """

    L: Real
    P: Real
    coefficients: Real
    squares: Real
    free: Real
    largest: Real

    def amplitudes(self, degree: int) -> Complex:
        """Complex amplitudes of the harmonics, (batch, orders, channels)."""
        waves = self.coefficients[:, degree + 1 :]
        return waves[:, 0::2] - 1j * waves[:, 1::2]

    @property
    def covariance(self) -> Real:
        """Of the residual of one sample, (batch, channels, channels)."""
        return self.squares / np.sqrt(self.free[:, None] * self.free)

    def wald(self, columns: Sequence[int]) -> Real:
        """F of some coefficients being 0, (batch, channels): as of the two regressions with and without them."""
        some = list(columns)
        c = np.swapaxes(self.coefficients[:, some], 1, 2)
        inside = np.linalg.solve(self.P[:, some][:, :, some], c[..., None])[..., 0]
        variance = np.diagonal(self.squares, axis1=1, axis2=2) / self.free
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.sum(c * inside, axis=-1) / (len(some) * variance))


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
    """Two passes over the samples: normal equations, then residual (shown to `monitor`) and one refinement.

    Channels with samples that are not measured are solved for by themselves, `_partly_measured`.
    """
    time, centre, half = record.time, *window(record.time)

    def design(rows: slice) -> Real:
        return basis(time[rows], f, orders, degree, centre, half, ramps)

    terms = degree + 1 + 2 * len(orders) + 2 * ramps
    even = None if ramps else _even_sums(time, record.values, f, orders, degree)
    return solve(record, design, terms, f, monitor, even)


def solve(
    record: Record,
    design: Callable[[slice], Real],
    terms: int,
    f: float,
    monitor: Monitor | None = None,
    sums: tuple[Real, Real, Real] | None = None,
) -> HarmonicSolution:
    """Least squares over any columns: design gives the rows (samples, terms) of some samples.

    sums: Gram, right sides and largest |y| where they are known.  Raises DataError where the samples of some channel
    cannot tell the columns apart.
    """
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    batch = len(Y)
    held = design(slice(None)) if samples <= CHUNK else None

    def pieces() -> Iterator[tuple[slice, Real]]:
        for rows in chunks(samples):
            yield rows, design(rows) if held is None else held

    if sums is None:
        gram, right = np.zeros((terms, terms)), np.zeros((batch, terms, channels))
        largest = np.zeros((batch, channels))
        for rows, A in pieces():
            gram += A.T @ A
            for part in tiles(batch, len(A), channels):
                y = Y[part, rows]
                right[part] += A.T @ y
                np.maximum(largest[part], np.max(np.abs(y), axis=1, initial=0.0), out=largest[part])
    else:
        gram, right, largest = sums
    L: Real = factor(gram, record, f)
    identity = cholesky_solve(L, np.eye(terms)[None])[0]
    P = np.broadcast_to((identity + identity.T) / 2, (channels, terms, terms))
    coefficients, free = cholesky_solve(L, right), np.full(channels, float(samples - terms))
    partly = np.flatnonzero(~record.whole_channels)
    shown, variance = np.ones(channels), np.zeros(len(partly))
    if len(partly):
        P = np.array(P)
        for i, c in enumerate(partly.tolist()):
            found = _partly_measured(record, c, pieces)
            coefficients[0, :, c], P[c], variance[i], free[c] = found
            shown[c] = np.sqrt(samples / (free[c] + terms))
    correction, squares = np.zeros_like(right), np.zeros((batch, channels, channels))
    for rows, A in pieces():
        if monitor is not None:
            monitor.next_rows(record.time[rows], A)
        for part in tiles(batch, len(A), channels):
            e = Y[part, rows] - A @ coefficients[part]
            if record.status is not None:
                e[:, record.status[rows] != 0] = 0.0
            correction[part] += A.T @ e
            squares[part] += np.swapaxes(e, 1, 2) @ e
            if monitor is not None:
                monitor.see(part, e * shown if len(partly) else e)
    correction[..., partly] = 0.0
    coefficients += cholesky_solve(L, correction)
    if len(partly):
        # Correlations of what is measured of both, as those of the coefficients are, and the variances found above
        size = np.sqrt(np.maximum(squares[0, partly, partly], 1e-300))
        times = np.ones(channels)
        times[partly] = np.sqrt(variance * free[partly]) / size
        squares = squares * times[:, None] * times
    return HarmonicSolution(L, P, coefficients, squares, free, largest)


FAR = 1e4  # standard deviations: what is beyond counts as that
TURNS = 50  # of Newton's method, of which five to ten are needed


def clipped_moments(z: Real) -> tuple[Real, Real]:
    """Of standard normal noise that is known to be beyond z: its mean, and how much of its variance that takes away."""
    z = np.clip(z, -FAR, FAR)
    mean = np.exp(-(z**2) / 2 - log_ndtr(-z)) / np.sqrt(2 * np.pi)
    return mean, np.clip(mean * (mean - z), 0.0, 1.0)


def _partly_measured(
    record: Record, c: int, pieces: Callable[[], Iterator[tuple[slice, Real]]]
) -> tuple[Real, Real, float, float]:
    """A channel some of whose samples are clipped or missing: most likely coefficients, P, variance and freedom.

    What is known of a clipped sample is that the signal is beyond it, Q(z) with z = ±(y − A β)/σ (Tobin 1958,
    Econometrica 26); a missing one says nothing.  Newton's method on β, and on σ² its own equation with the degrees of
    freedom that β takes.  P holds what σ is uncertain by, too.
    """
    assert record.status is not None
    y, status = record.values[:, c], record.status[:, c]
    measured = status == 0
    gram = right = np.zeros(())
    for rows, A in pieces():
        some = A[measured[rows]]
        gram, right = gram + some.T @ some, right + some.T @ y[rows][measured[rows]]
    beta: Real = cholesky_solve(factor(gram, record, record.frequency_hz or 0.0), right[None, :, None])[
        0, :, 0
    ]
    count = int(np.count_nonzero(measured))
    free = float(count - len(beta))
    least = 1e-13 * float(np.max(np.abs(y[measured])))
    variance = np.inf
    for _ in range(TURNS):
        sigma = max(np.sqrt(variance), least)
        slope, information, squares, inside = np.zeros_like(beta), np.array(gram), 0.0, 0.0
        by_sigma, of_sigma = np.zeros_like(beta), 0.0
        for rows, A in pieces():
            e = y[rows] - A @ beta
            slope += A[measured[rows]].T @ e[measured[rows]]
            squares += float(np.sum(e[measured[rows]] ** 2))
            clipped = np.abs(status[rows]) == 1
            if not np.isfinite(sigma) or not np.any(clipped):
                continue
            B, side = A[clipped], status[rows][clipped]
            z = np.clip(side * e[clipped] / sigma, -FAR, FAR)
            mills, weight = clipped_moments(z)
            slope += B.T @ (side * mills) * sigma
            information += B.T @ (weight[:, None] * B)
            inside += float(np.sum(z * mills))
            by_sigma += B.T @ (side * (mills - z * weight))
            of_sigma += float(np.sum(weight * z**2))
        before, variance = variance, squares / max(free - inside, free / 2)
        step = np.linalg.solve(information, slope)
        beta = beta + step
        if (
            step @ information @ step <= 1e-12 * variance + least**2
            and abs(variance - before) <= 1e-6 * variance
        ):
            break
    schur = information - np.outer(by_sigma, by_sigma) / (2 * count - inside + of_sigma)
    return beta, np.asarray(np.linalg.inv(schur), dtype=np.float64), float(variance), free


def _even_sums(
    time: Real, values: Real, f: float, orders: Sequence[int], degree: int
) -> tuple[Real, Real, Real] | None:
    """Gram, right sides and largest |y| of many even samples, by the compiled pass; None where NumPy does as well.

    What the recurrence of its waves rounds off, the refinement by the residual takes out.
    """
    samples, (centre, _) = len(time), window(time)
    if kernel() is None or samples <= CHUNK or degree > 1:
        return None
    Y = values.reshape(-1, *values.shape[-2:])
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
