"""Least squares of offset, drift and harmonics over the samples of a record, without holding the design matrix.

    y_c(t) = Σ_i τ_ic P_i((t − centre)/half) + Σ_k Re(X_kc e^{jkωt}) + noise_c(t)                      (H)

P_i are Legendre polynomials, so the columns are of one size and nearly orthogonal; the normal equations are summed
over chunks of samples and refined once by the residual, which gives the accuracy of an orthogonal factorisation.
All channels and leading batch axes share it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
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
    in_cells      (channels,)  of which a value stands for all that a converter rounds to it
    """

    L: Real
    P: Real
    coefficients: Real
    squares: Real
    free: Real
    largest: Real
    in_cells: Bools

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
    rounded = False if record.cell is None else record.cell > 0
    shown, partly, times = np.ones(channels), np.zeros(channels, dtype=bool), np.zeros(channels)
    for c in np.flatnonzero(~record.whole_channels | rounded).tolist():
        found = _partly_measured(record, c, f, pieces)
        if found is None:
            continue
        P = P if np.any(partly) else np.array(P)
        coefficients[0, :, c], P[c], free[c] = found.coefficients, found.P, found.free
        shown[c] = 0.0 if found.in_cells else np.sqrt(samples / (found.free + terms))
        partly[c], times[c] = True, found.variance * found.free
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
                monitor.see(part, e * shown if np.any(partly) else e)
    correction[..., partly] = 0.0
    coefficients += cholesky_solve(L, correction)
    if np.any(partly):
        # Correlations of what is measured of both, as those of the coefficients are, and the variances found above
        size = np.maximum(np.diagonal(squares[0]), 1e-300)
        times = np.sqrt(np.where(partly, times / size, 1.0))
        squares = squares * times[:, None] * times
    return HarmonicSolution(L, P, coefficients, squares, free, largest, shown == 0)


FAR = 1e4  # standard deviations: what is beyond counts as that
TURNS = 50  # of Newton's method, of which five to ten are needed
DITHERED = 0.7  # residual in steps of a converter from which on rounding is noise like the rest
COARSEST = 0.22  # noise in steps below which the likelihood of cells is no parabola


@dataclass(frozen=True)
class PartlyMeasured:
    """The likeliest in a channel whose samples are not all measured: coefficients, their P, variance and freedom."""

    coefficients: Real
    P: Real
    variance: float
    free: float
    in_cells: bool


def _partly_measured(
    record: Record, c: int, f: float, pieces: Callable[[], Iterator[tuple[slice, Real]]]
) -> PartlyMeasured | None:
    """A channel with samples that are clipped, missing or rounded to cells; None where all are as good as measured.

    Of a sample in a cell from a to b it is known that the noise is between: ln(Φ(τ b − A γ) − Φ(τ a − A γ)) with
    τ = 1/σ and γ = τ β; a clipped one is in a cell without an end.  That is concave in (γ, τ) (Olsen 1978, Econometrica
    46; Burridge 1981, JRSS B 43).  Newton's method goes along η = δγ − β δτ, so that β changes by η/(τ + δτ) and the
    inverse of the information is P.  The degrees of freedom that β takes are taken off.
    """
    y = record.values[:, c]
    status = np.zeros(len(y)) if record.status is None else record.status[:, c]
    cell = 0.0 if record.cell is None else float(record.cell[c])
    seen = status == 0
    gram = right = np.zeros(())
    for rows, A in pieces():
        some = A[seen[rows]]
        gram, right = gram + some.T @ some, right + some.T @ y[rows][seen[rows]]
    beta: Real = cholesky_solve(factor(gram, record, f), right[None, :, None])[0, :, 0]
    left = sum(float(np.sum((y[rows] - A @ beta)[seen[rows]] ** 2)) for rows, A in pieces())
    terms, count = len(beta), int(np.count_nonzero(seen))
    variance = left / max(count - terms, 1)
    if np.sqrt(variance) > DITHERED * cell:
        cell = 0.0
    if not cell and np.all(seen):
        return None
    least = 1e-13 * float(np.max(np.abs(y[seen])))
    tau = 1 / max(np.sqrt(max(variance - cell**2 / 12, (2 * COARSEST * cell) ** 2)), least)

    def at(beta: Real, tau: float) -> tuple[float, Real, Real]:
        """Log-likelihood, its slope along (η, τ) and its information."""
        k = (0 if cell else count) - terms
        total, slope, info = k * np.log(tau), np.zeros(terms + 1), np.zeros((terms + 1, terms + 1))
        slope[-1], info[-1, -1] = k / tau, k / tau**2
        for rows, A in pieces():
            e, side = y[rows] - A @ beta, status[rows]
            if not cell:
                B, exact = A[side == 0], e[side == 0]
                along, square = B.T @ exact, float(exact @ exact)
                total -= tau**2 * square / 2
                slope += tau * np.append(along, -square)
                info += np.block([[B.T @ B, -along[:, None]], [-along, square]])
            within = np.abs(side) <= 1 if cell else np.abs(side) == 1
            A, e, side = A[within], e[within], side[within]
            low, high = np.where(side < 0, -np.inf, e - cell / 2), np.where(side > 0, np.inf, e + cell / 2)
            L, a, b, aa, ab, bb = in_between(tau * low, tau * high)
            low, high = np.where(side < 0, 0.0, low), np.where(side > 0, 0.0, high)
            cross = A.T @ (aa * low + ab * (low + high) + bb * high)
            square = -float(np.sum(aa * low**2 + 2 * ab * low * high + bb * high**2))
            total += float(np.sum(L))
            slope += np.append(A.T @ (a - b), np.sum(b * high - a * low))
            info += np.block([[A.T @ (-(aa + 2 * ab + bb)[:, None] * A), cross[:, None]], [cross, square]])
        return float(total), slope, info

    total, slope, info = at(beta, tau)
    inverse = None
    for _ in range(TURNS):
        inverse = _inverse(info)
        if inverse is None or 1 / tau < COARSEST * cell:
            break
        step = inverse @ slope
        if step @ slope < 1e-12:
            break
        other, found = (beta, tau), (total, slope, info)
        for _ in range(TURNS):
            if tau + step[-1] > tau / 10:
                other = beta + step[:-1] / (tau + step[-1]), tau + float(step[-1])
                found = at(*other)
                if found[0] >= total - 1e-9 * abs(total):
                    break
            step = step / 2
        (beta, tau), (total, slope, info) = other, found
    free = 0.0 if inverse is None else float(tau**2 / (2 * inverse[-1, -1]))
    if cell and (free < 1 or 1 / tau < COARSEST * cell):
        return _partly_measured(replace(record, cell=None), c, f, pieces)
    if inverse is None:
        raise DataError(
            f"the samples that {record.channels[c].name} did measure cannot tell its motion at {f:g} Hz",
            record.source,
            "leave the channel out, or widen its range",
        )
    P: Real = (inverse + inverse.T)[:-1, :-1] / 2
    return PartlyMeasured(beta, P, 1 / tau**2, free, cell > 0)


def _inverse(information: Real) -> Real | None:
    """Its inverse; None where it is not positive definite, or no number."""
    size = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    if not (np.all(np.isfinite(information)) and np.all(size > 0)):
        return None
    scaled = information / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < 1e-12:
        return None
    inverse: Real = np.linalg.inv(scaled) / np.outer(size, size)
    return inverse


def in_between(a: Real, b: Real) -> tuple[Real, Real, Real, Real, Real, Real]:
    """L = ln(Φ(b) − Φ(a)), −∂L/∂a, ∂L/∂b, and the second derivatives by aa, ab, bb."""
    flip = a + b > 0
    x, w = np.where(flip, -b, a), np.where(flip, -a, b)
    top = log_ndtr(w)
    L = top + np.log1p(-np.exp(log_ndtr(x) - top))
    fa, fb = (np.exp(-(z**2) / 2 - L) / np.sqrt(2 * np.pi) for z in (a, b))
    a, b = np.where(np.isfinite(a), a, 0.0), np.where(np.isfinite(b), b, 0.0)
    aa, bb = a * fa - fa**2, -b * fb - fb**2
    # What rounding leaves of these far beyond an end
    L = np.where(a > FAR, -(a**2) / 2, np.where(b < -FAR, -(b**2) / 2, L))
    fa, aa = np.where(a > FAR, a, fa), np.where(a > FAR, -1.0, aa)
    fb, bb = np.where(b < -FAR, -b, fb), np.where(b < -FAR, -1.0, bb)
    return L, fa, fb, aa, fa * fb, bb


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
