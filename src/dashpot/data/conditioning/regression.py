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
from scipy.special import fdtrc, log_ndtr

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.record import Record, kept
from dashpot.errors import DataError
from dashpot.numerics.harmonic_sums import even_gram, harmonic_sums
from dashpot.numerics.kernel import kernel

CHUNK = 1 << 15  # samples whose design matrix is held at a time
TILE = 1 << 21  # numbers of a batch worked on at a time
EXACT = 1e-10  # residual over amplitude below which a channel counts as noise-free
LITTLE = 1e-6  # rms of a column that is nothing
ALIKE = 1e-7  # least eigenvalue of the correlations of columns that the samples tell apart
HIGHEST_HARMONIC = 10  # that is looked for where nobody asks for more
BELOW_HALF_RATE = 0.95  # of half the sampling rate, up to which harmonics are told from others
HIGHEST_DEGREE = 3  # of the polynomials that short dwells may be bent by


def holds_a_period(time: Real, f: float) -> bool:
    """Whether the samples (samples,) span a period; unevenly sampled ones may end a step inside, on both sides."""
    return f * (float(time[-1] - time[0]) + 2 * float(np.max(np.diff(time)))) >= 1


def duration(time: Real) -> float:
    """Time that the samples stand for: the span and one mean step, s.  time (samples,)."""
    return float(time[-1] - time[0]) * len(time) / (len(time) - 1)


def window(time: Real) -> tuple[float, float]:
    """Middle and half width of the time, s.  time (samples,)."""
    return float(time[0] + time[-1]) / 2, float(time[-1] - time[0]) / 2


@dataclass(frozen=True)
class Terms:
    """What a dwell's motion may have beside noise, as columns over the samples.

    degree  of the polynomial in time; 0 is an offset alone, −1 nothing
    orders  multiples of the drive frequency, ascending
    bends   degree of the polynomials by which the sine of order 1 may grow and turn while the dwell lasts
    """

    degree: int = 1
    orders: tuple[int, ...] = (1,)
    bends: int = 0

    @property
    def count(self) -> int:
        """How many columns there are: P_0 … P_degree, cos and sin of each order, P_i cos and P_i sin of order 1."""
        return self.degree + 1 + 2 * len(self.orders) + 2 * self.bends

    def wave(self, order: int) -> list[int]:
        """The columns of an order."""
        first = self.degree + 1 + 2 * self.orders.index(order)
        return [first, first + 1]

    def within(self, other: Terms) -> list[int] | None:
        """Which columns of others these are; None where some are not among them."""
        if (
            self.degree > other.degree
            or self.bends > other.bends
            or not set(self.orders) <= set(other.orders)
        ):
            return None
        trend, waves = list(range(self.degree + 1)), [c for order in self.orders for c in other.wave(order)]
        first = other.count - 2 * other.bends
        return [*trend, *waves, *range(first, first + 2 * self.bends)]

    def columns(self, t: Real, f: float, centre: float, half: float) -> Real:
        """The columns at times t (samples,), s; (t − centre)/half runs from −1 to 1 in the dwell."""
        cycles = f * t
        z = np.exp(2j * np.pi * (cycles - np.floor(cycles)))
        columns = np.empty((len(t), self.count))
        shape = legvander((t - centre) / half, max(self.degree, self.bends, 0))
        columns[:, : self.degree + 1] = shape[:, : self.degree + 1]
        power, at = np.ones_like(z), 0
        for i, order in enumerate(self.orders):
            while at < order:
                power, at = power * z, at + 1
            columns[:, self.degree + 1 + 2 * i] = power.real
            columns[:, self.degree + 2 + 2 * i] = power.imag
        first = self.count - 2 * self.bends
        for k in range(1, self.bends + 1):
            columns[:, first + 2 * k - 2] = shape[:, k] * z.real
            columns[:, first + 2 * k - 1] = shape[:, k] * z.imag
        return columns

    def coefficients(self, trend: Real, amplitudes: Complex) -> Real:
        """(trend, amplitudes) as coefficients: Re(X e^{jφ}) = Re X cos φ − Im X sin φ."""
        pairs = np.stack([amplitudes.real, -amplitudes.imag], axis=-2)
        waves = pairs.reshape(*pairs.shape[:-3], -1, pairs.shape[-1])
        return np.concatenate([trend, waves], axis=-2)


def check_length(record: Record, f: float, terms: Terms) -> None:
    """Raises DataError where there are fewer samples than terms, less than one period, or too slow samples.

    Harmonics beyond half the sampling rate are taken for lower ones; a fundamental there is `factor`'s to judge.
    """
    samples, count = len(record.time), terms.count
    if samples <= count:
        raise DataError(
            f"{samples} samples are too few for {count} terms (offset, drift and harmonics) at {f:g} Hz",
            record.source,
            f"record at least {count + 1} samples, better some hundred",
        )
    if not holds_a_period(record.time, f):
        raise DataError(
            f"the record holds {f * duration(record.time):.3g} of a period at {f:g} Hz",
            record.source,
            "record at least one whole period, better ten, or correct the frequency",
        )
    rate = 1 / float(np.min(np.diff(record.time)))
    highest = max(terms.orders)
    if highest > 1 and highest * f >= rate / 2:
        raise DataError(
            f"order {highest} of {f:g} Hz is {highest * f:g} Hz, beyond half the sampling rate of {rate:.4g} Hz",
            record.source,
            "ask for lower orders, or sample faster",
        )


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
    """Least squares over some terms, of clipped samples by the likelihood of being beyond their value.

    terms         what was solved for
    L             (terms, terms)  factor of the Gram AᵀA = L Lᵀ of all samples
    P             (channels, terms, terms)  covariance of coefficients per unit variance of a sample
    coefficients  (batch, terms, channels)
    squares       (batch, channels, channels)  of the residual
    free          (channels,)  degrees of freedom of the residual
    largest       (batch, channels)  of |y|
    in_cells      (channels,)  of which a value stands for all that a converter rounds to it
    """

    terms: Terms
    L: Real
    P: Real
    coefficients: Real
    squares: Real
    free: Real
    largest: Real
    in_cells: Bools

    @property
    def trend(self) -> Real:
        """Coefficients of the polynomial, (batch, degree + 1, channels)."""
        return self.coefficients[:, : self.terms.degree + 1]

    @property
    def amplitudes(self) -> Complex:
        """Complex amplitudes of the harmonics, (batch, orders, channels)."""
        first = self.terms.degree + 1
        waves = self.coefficients[:, first : first + 2 * len(self.terms.orders)]
        return waves[:, 0::2] - 1j * waves[:, 1::2]

    @property
    def covariance(self) -> Real:
        """Of the residual of one sample, (batch, channels, channels)."""
        return self.squares / np.sqrt(self.free[:, None] * self.free)

    def exact(self, share: float = EXACT) -> Bools:
        """(batch, channels): the residual is rounding, a `share` of the amplitude or of the numbers themselves."""
        rms = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))
        bound = share * np.max(np.abs(self.amplitudes), axis=1)
        return rms <= np.maximum(bound, 32 * np.finfo(float).eps * self.largest)

    def tails(self, columns: Sequence[Sequence[int]]) -> Real:
        """p-values of sets (sets, k) of coefficients being 0, (batch, channels, sets).

        By the F of the two regressions with and without them.
        """
        some = np.asarray(columns)
        c = np.swapaxes(self.coefficients, 1, 2)[..., some]
        inside = np.linalg.solve(self.P[:, some[:, :, None], some[:, None, :]], c[..., None])[..., 0]
        variance = np.diagonal(self.squares, axis1=1, axis2=2) / self.free
        with np.errstate(divide="ignore", invalid="ignore"):
            F = np.sum(c * inside, axis=-1) / (some.shape[1] * variance)[..., None]
        return np.asarray(fdtrc(some.shape[1], self.free[:, None], F))


class Monitor(Protocol):
    """What sees the residual as it streams by."""

    def next_rows(self, t: Real, A: Real) -> None:
        """The samples that `see` shows next: their times (samples,) and design rows (samples, terms)."""

    def see(self, part: slice, e: Real) -> None:
        """Residuals (batch, rows, channels) of the present rows."""


def solve_harmonics(
    record: Record, f: float, terms: Terms, monitor: Monitor | None = None
) -> HarmonicSolution:
    """Least squares of some terms over the samples; the residual is shown to `monitor`.

    A dwell at its own frequency is factored once for all terms that are usual.  Else there are two passes over the
    samples: normal equations, then the residual and one refinement.  Channels with samples that are not measured are
    solved for by themselves, `_partly_measured`.  Raises DataError where the samples of some channel cannot tell the
    columns apart.
    """
    plain = record.values.ndim == 2 and record.status is None and record.cell is None
    if plain and terms.count < len(record.time) <= CHUNK and f == record.frequency_hz:
        columns = terms.within(_factored(record)[0])
        if columns is not None:
            found = _nested(record, terms, columns)
            if monitor is not None:
                A = terms.columns(record.time, f, *window(record.time))
                monitor.next_rows(record.time, A)
                monitor.see(slice(0, 1), (record.values - A @ found.coefficients[0])[None])
            return found
    return _in_two_passes(record, f, terms, monitor)


def _in_two_passes(record: Record, f: float, terms: Terms, monitor: Monitor | None) -> HarmonicSolution:
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    batch = len(Y)
    centre, half = window(record.time)
    held = terms.columns(record.time, f, centre, half) if samples <= CHUNK else None

    def pieces() -> Iterator[tuple[slice, Real]]:
        for rows in chunks(samples):
            yield rows, terms.columns(record.time[rows], f, centre, half) if held is None else held

    sums = _even_sums(record.time, record.values, f, terms)
    if sums is None:
        gram, right = np.zeros((terms.count, terms.count)), np.zeros((batch, terms.count, channels))
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
    identity = cholesky_solve(L, np.eye(terms.count)[None])[0]
    P = np.broadcast_to((identity + identity.T) / 2, (channels, *gram.shape))
    coefficients, free = cholesky_solve(L, right), np.full(channels, float(samples - terms.count))
    rounded = False if record.cell is None else record.cell > 0
    shown, partly, times = np.ones(channels), np.zeros(channels, dtype=bool), np.zeros(channels)
    for c in np.flatnonzero(~record.whole_channels | rounded).tolist():
        found = _partly_measured(record, c, f, pieces)
        if found is None:
            continue
        P = P if np.any(partly) else np.array(P)
        coefficients[0, :, c], P[c], free[c] = found.coefficients, found.P, found.free
        shown[c] = 0.0 if found.in_cells else np.sqrt(samples / (found.free + terms.count))
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
    return HarmonicSolution(terms, L, P, coefficients, squares, free, largest, shown == 0)


@kept
def _factored(record: Record) -> tuple[Terms, Real, Real]:
    """The usual terms of a dwell at its frequency, R of the QR factors of their columns and channels, and |y| at most.

    Whatever is solved for among them follows from R, without the samples and as accurately as from these.
    """
    f = record.frequency_hz or 0.0
    rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
    highest = max(1, min(HIGHEST_HARMONIC, int(BELOW_HALF_RATE * rate / 2 / f)))
    every = Terms(HIGHEST_DEGREE, tuple(range(1, highest + 1)), 1)
    A = every.columns(record.time, f, *window(record.time))
    R: Real = np.linalg.qr(np.concatenate([A, record.values], axis=1), mode="r")  # type: ignore[assignment]
    return every, R, np.max(np.abs(record.values), axis=0)[None]


def _nested(record: Record, terms: Terms, columns: Sequence[int]) -> HarmonicSolution:
    """Least squares of some terms, at these columns of `_factored`."""
    every, R, largest = _factored(record)
    k, channels = terms.count, len(record.channels)
    some = R[:, [*columns, *range(every.count, R.shape[1])]]
    inner: Real = np.linalg.qr(some, mode="r")  # type: ignore[assignment]
    size = np.sqrt(np.sum(inner[:, :k] ** 2, axis=0))
    require_told_apart(
        bool(np.all(size > LITTLE * len(record.time) ** 0.5)), record, record.frequency_hz or 0.0
    )
    both = np.linalg.solve(inner[:k, :k], np.concatenate([np.eye(k), inner[:k, k:]], axis=1))
    P = both[:, :k] @ both[:, :k].T
    require_told_apart(
        float(np.sum(np.diagonal(P) * size**2)) < 1 / ALIKE, record, record.frequency_hz or 0.0
    )
    left = inner[k:, k:]
    return HarmonicSolution(
        terms,
        inner[:k, :k].T,
        np.broadcast_to(P, (channels, k, k)),
        both[None, :, k:],
        (left.T @ left)[None],
        np.full(channels, float(len(record.time) - k)),
        largest,
        np.zeros(channels, dtype=bool),
    )


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
    with np.errstate(over="ignore", invalid="ignore"):
        fa, fb = (np.exp(-(z**2) / 2 - L) / np.sqrt(2 * np.pi) for z in (a, b))
        a, b = np.where(np.isfinite(a), a, 0.0), np.where(np.isfinite(b), b, 0.0)
        aa, bb = a * fa - fa**2, -b * fb - fb**2
    # What rounding leaves of these far beyond an end
    L = np.where(a > FAR, -(a**2) / 2, np.where(b < -FAR, -(b**2) / 2, L))
    fa, aa = np.where(a > FAR, a, fa), np.where(a > FAR, -1.0, aa)
    fb, bb = np.where(b < -FAR, -b, fb), np.where(b < -FAR, -1.0, bb)
    return L, fa, fb, aa, fa * fb, bb


def _even_sums(time: Real, values: Real, f: float, terms: Terms) -> tuple[Real, Real, Real] | None:
    """Gram, right sides and largest |y| of many even samples, by the compiled pass; None where NumPy does as well.

    What the recurrence of its waves rounds off, the refinement by the residual takes out.
    """
    samples, (centre, _) = len(time), window(time)
    orders, degree = terms.orders, terms.degree
    if kernel() is None or samples <= CHUNK or degree > 1 or terms.bends:
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
    some = bool(np.all(size > LITTLE * np.sqrt(len(record.time))))
    require_told_apart(some and float(np.linalg.eigvalsh(gram / np.outer(size, size))[0]) >= ALIKE, record, f)
    return np.linalg.cholesky(gram).astype(np.float64)


def require_told_apart(apart: bool, record: Record, f: float) -> None:
    """Raises DataError where the samples do not tell the columns apart."""
    if not apart:
        rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
        raise DataError(
            f"the samples (about {rate:g} per second) cannot tell offset, drift and harmonics apart at {f:g} Hz",
            record.source,
            "record more periods, at a rate that is not twice the frequency or less, or ask for fewer harmonics",
        )


def cholesky_solve(L: Real, right: Real) -> Real:
    """(L Lᵀ)⁻¹ right over a batch of right sides (batch, terms, columns)."""
    batch, terms, columns = right.shape
    flat = np.moveaxis(right, 1, 0).reshape(terms, -1)
    # Not by two solve_triangular: its LAPACK wakes threads for the smallest matrix, 8 ms each where cores are busy.
    whole = cho_solve((L, True), flat, check_finite=False)
    return np.ascontiguousarray(np.moveaxis(whole.reshape(terms, batch, columns), 0, 1))
