"""From samples to complex amplitudes: offset, drift and harmonics by least squares on the true sample times.

    y_c(t) = Σ_i τ_ic P_i((t − centre)/half) + Σ_k Re(X_kc e^{jkωt}) + noise_c(t)                      (H)

P_i are Legendre polynomials, so the columns are of one size and nearly orthogonal; the normal equations are summed
over chunks of samples and refined once by the residual, which gives the accuracy of an orthogonal factorisation
without ever holding the design matrix.  All channels and leading batch axes share it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cho_solve
from scipy.special import bdtrc, chdtrc, fdtr, fdtrc

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.channel import Channel
from dashpot.data.record import Record
from dashpot.data.spectrum import Moments, Spectrum, concatenate
from dashpot.errors import DataError

Noise = Literal["auto", "white", "blocks"]

CHUNK = 1 << 15  # samples whose design matrix is held at a time
TILE = 1 << 21  # numbers of a batch worked on at a time
EXACT = 1e-10  # residual over amplitude below which a channel counts as noise-free
LAGS = 20  # of the portmanteau test
HALF_BAND = 10  # lines on each side of a harmonic that show the noise there
FEWEST_LINES = 6  # below this the local spectrum is no estimate
SIGNIFICANT = 0.01
HIGHEST_HARMONIC = 10  # looked for


@dataclass(frozen=True)
class HarmonicFit:
    """The harmonics of one record, x(t) = Re(X e^{jkωt}), t being the record's own time stamps; units of its values.

    orders               which multiples of frequency_hz were solved for, ascending
    amplitudes           (..., orders, channels)
    covariance           (..., orders, channels, channels)  V = E[Δ Δᴴ]; circular: Re and Im have Re V / 2 each
    real_covariance      (..., orders, channels, 2, 2)  of (Re X, Im X), exact also where the periods are not whole
    trend                (..., degree + 1, channels)  Legendre coefficients over (t − centre)/half; no offset: no rows
    residual_covariance  (..., channels, channels)  of one sample, exact channels 0
    dof                  (orders,)  real degrees of freedom behind the covariance
    noise                "white": residual covariance times the exact covariance of least squares;
                         "blocks": cross-spectrum of the residual on lines beside each harmonic
    whiteness            (...)  p-value of a white residual, smallest over channels (Bonferroni); NaN where not tested
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
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, kind in (
            ("amplitudes", np.complex128),
            ("covariance", np.complex128),
            ("real_covariance", np.float64),
            ("trend", np.float64),
            ("residual_covariance", np.float64),
            ("dof", np.float64),
            ("whiteness", np.float64),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), kind))

    def __call__(self, time: Real) -> Real:
        """The fitted signal at times in s: (..., times, channels)."""
        A = _basis(
            np.asarray(time, dtype=float), self.frequency_hz, self.orders, self.degree, self.centre, self.half
        )
        values: Real = A @ _coefficients(self.trend, self.amplitudes)
        return values

    @property
    def degree(self) -> int:
        """Degree of the drift; 0 is an offset alone, −1 is nothing."""
        return int(self.trend.shape[-2]) - 1


@dataclass(frozen=True)
class RefinedFrequency:
    """A drive frequency found from the samples: Hz, its standard deviation (white noise), and where it started."""

    frequency_hz: float
    sd: float
    nominal_hz: float


@dataclass(frozen=True)
class Settled:
    """The part of a dwell that is driven and where the transient has decayed, and what was thrown away around it.

    `note` says so in words; it is empty where nothing was thrown away and a transient would have been seen.
    """

    record: Record
    dropped_samples: int
    dropped_s: float
    note: str


# ------------------------------------------------------------------------------------------------ the fit


def fit_harmonics(
    record: Record,
    frequency_hz: float | None = None,
    *,
    orders: Sequence[int] = (1,),
    harmonics: Sequence[int] | None = None,
    drift: int | None = 1,
    noise: Noise = "auto",
) -> HarmonicFit:
    """Solve (H) for trend and harmonics of every channel together.

    `orders` are the multiples of the frequency (the record's own unless given) that are wanted.  `harmonics` are
    solved with them; None looks for those up to the tenth below half the sampling rate that are significant (F-test
    at 1 % over all of them).  `drift` is the degree of the polynomial, 0 an offset alone, None not even that.
    `noise` "auto" takes "white" unless the residual is coloured (p < 0.01) and there are enough periods for "blocks".

    Raises DataError where the record is shorter than a period, has too few samples, or cannot tell the terms apart.
    """
    f = record.frequency_hz if frequency_hz is None else frequency_hz
    if f is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    if not (np.isfinite(f) and f > 0):
        raise DataError(f"frequency {f} Hz", record.source, "frequencies must be positive and finite")
    wanted = tuple(sorted({int(order) for order in orders}))
    if not wanted or wanted[0] < 1:
        raise DataError(f"orders {tuple(orders)}", record.source, "orders of harmonics are 1, 2, 3, …")
    degree = -1 if drift is None else int(drift)
    _check_length(record, f, wanted, degree)
    if harmonics is None:
        wanted = _with_significant(record, f, wanted, degree)
    else:
        wanted = tuple(sorted({*wanted, *(int(order) for order in harmonics)}))
        _check_length(record, f, wanted, degree)
    return _fit(record, f, wanted, degree, noise)


def _check_length(record: Record, f: float, orders: tuple[int, ...], degree: int) -> None:
    """Raises DataError where there are fewer samples than terms, or less than one period."""
    samples, terms = len(record.time), degree + 1 + 2 * len(orders)
    if samples <= terms:
        raise DataError(
            f"{samples} samples are too few for {terms} terms (offset, drift and harmonics) at {f:g} Hz",
            record.source,
            f"record at least {terms + 1} samples, better some hundred",
        )
    periods = f * _duration(record.time)
    step = float(
        np.max(np.diff(record.time))
    )  # unevenly sampled periods may end this far inside, on both sides
    if f * (float(record.time[-1] - record.time[0]) + 2 * step) < 1:
        raise DataError(
            f"the record holds {periods:.3g} of a period at {f:g} Hz",
            record.source,
            "record one whole period at least, better ten, or correct the frequency",
        )


def _duration(time: Real) -> float:
    """Time that the samples stand for: the span and one mean step, s."""
    return float(time[-1] - time[0]) * len(time) / (len(time) - 1)


def _basis(
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


def _coefficients(trend: Real, amplitudes: Complex) -> Real:
    """(trend, amplitudes) as coefficients of the columns of `_basis`: Re(X e^{jφ}) = Re X cos φ − Im X sin φ."""
    pairs = np.stack([amplitudes.real, -amplitudes.imag], axis=-2)
    waves = pairs.reshape(*pairs.shape[:-3], -1, pairs.shape[-1])
    return np.concatenate([trend, waves], axis=-2)


def _tiles(batch: int, rows: int, channels: int) -> Iterator[slice]:
    """Pieces of the flattened batch axis of about TILE numbers."""
    step = max(1, TILE // max(1, rows * channels))
    for start in range(0, batch, step):
        yield slice(start, min(batch, start + step))


def _rows(samples: int) -> Iterator[slice]:
    for start in range(0, samples, CHUNK):
        yield slice(start, min(samples, start + CHUNK))


@dataclass(frozen=True)
class _Solution:
    """Least squares over one basis: factor of the Gram AᵀA = L Lᵀ, its inverse, coefficients, residual sums."""

    L: Real
    P: Real
    coefficients: Real  # (batch, terms, channels)
    squares: Real  # (batch, channels, channels)
    largest: Real  # (batch, channels), of |y|


def _solve(
    record: Record,
    f: float,
    orders: Sequence[int],
    degree: int,
    ramps: bool = False,
    watch: _Watch | None = None,
) -> _Solution:
    """Two passes over the samples: normal equations, then residual (shown to `watch`) and one refinement."""
    time, centre, half = record.time, *_window(record.time)
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    batch, terms = len(Y), degree + 1 + 2 * len(orders) + 2 * ramps
    gram, right = np.zeros((terms, terms)), np.zeros((batch, terms, channels))
    largest = np.zeros((batch, channels))
    held: Real | None = None
    for rows in _rows(samples):
        A = held = _basis(time[rows], f, orders, degree, centre, half, ramps)
        gram += A.T @ A
        for part in _tiles(batch, len(A), channels):
            y = Y[part, rows]
            right[part] += A.T @ y
            np.maximum(largest[part], np.max(np.abs(y), axis=1, initial=0.0), out=largest[part])
    L: Real = _factor(gram, record, f)
    coefficients = _cho_solve(L, right)
    correction, squares = np.zeros_like(right), np.zeros((batch, channels, channels))
    for rows in _rows(samples):
        if held is not None and samples <= CHUNK:
            A = held
        else:
            A = _basis(time[rows], f, orders, degree, centre, half, ramps)
        if watch is not None:
            watch.next_rows(time[rows], A)
        for part in _tiles(batch, len(A), channels):
            e = Y[part, rows] - A @ coefficients[part]
            correction[part] += A.T @ e
            squares[part] += np.swapaxes(e, 1, 2) @ e
            if watch is not None:
                watch.see(part, e)
    coefficients += _cho_solve(L, correction)
    identity = _cho_solve(L, np.eye(terms)[None])[0]
    return _Solution(L, (identity + identity.T) / 2, coefficients, squares, largest)


def _window(time: Real) -> tuple[float, float]:
    """Middle and half width of the time, s."""
    return float(time[0] + time[-1]) / 2, float(time[-1] - time[0]) / 2


def _factor(gram: Real, record: Record, f: float) -> Real:
    """Cholesky factor of the Gram.  Raises DataError where the samples do not tell the columns apart."""
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


def _cho_solve(L: Real, right: Real) -> Real:
    """(L Lᵀ)⁻¹ right over a batch of right sides (batch, terms, columns)."""
    batch, terms, columns = right.shape
    flat = np.moveaxis(right, 1, 0).reshape(terms, -1)
    # Not by two solve_triangular: its LAPACK wakes threads for the smallest matrix, 8 ms each where cores are busy.
    whole = cho_solve((L, True), flat, check_finite=False)
    return np.ascontiguousarray(np.moveaxis(whole.reshape(terms, batch, columns), 0, 1))


# ------------------------------------------------------------------------------------------------ the noise


class _Watch:
    """Collects, while the residual streams by, its autocovariances and its Fourier sums beside each harmonic."""

    def __init__(self, record: Record, f: float, orders: Sequence[int], terms: int) -> None:
        samples, channels = record.values.shape[-2:]
        batch = int(np.prod(record.values.shape[:-2]))
        self.lags = min(LAGS, samples // 5) if samples >= 40 else 0
        self.step = 1 / _duration(record.time)
        self.first = terms - 2 * len(orders)
        self.offset, self.owner = _neighbours(f, orders, self.step, samples)
        self.products = np.zeros((batch, self.lags, channels))
        self.tail = np.zeros((batch, channels, self.lags))
        self.sums = np.zeros((batch, len(self.owner), channels), dtype=complex)
        self.overlap = np.zeros((terms, len(self.owner)), dtype=complex)
        self.waves = np.zeros((len(self.owner), 0), dtype=complex)

    def next_rows(self, t: Real, A: Real) -> None:
        """The samples that `see` shows next: their times and design rows."""
        cycles = self.step * t
        turn = np.exp(-2j * np.pi * (cycles - np.floor(cycles)))
        reach = int(np.max(np.abs(self.offset), initial=0))
        turns = np.empty((reach + 1, len(t)), dtype=complex)
        turns[0] = 1.0
        for m in range(reach):
            np.multiply(turns[m], turn, out=turns[m + 1])
        self.waves = np.empty((len(self.offset), len(t)), dtype=complex)
        for line, (order, m) in enumerate(zip(self.owner.tolist(), self.offset.tolist(), strict=True)):
            carrier = A[:, self.first + 2 * order] - 1j * A[:, self.first + 2 * order + 1]
            np.multiply(carrier, turns[m] if m >= 0 else np.conj(turns[-m]), out=self.waves[line])
        self.overlap += (self.waves @ A).T

    def see(self, part: slice, e: Real) -> None:
        """Residuals (batch, rows, channels) of the present rows."""
        self.sums[part] += self.waves.real @ e + 1j * (self.waves.imag @ e)
        if self.lags:
            rows = e.shape[1]
            both = np.concatenate([self.tail[part], np.swapaxes(e, 1, 2)], axis=2)
            later = both[:, :, self.lags :]
            for lag in range(1, self.lags + 1):
                earlier = both[:, :, self.lags - lag : self.lags - lag + rows]
                self.products[part, lag - 1] += np.einsum("bct,bct->bc", later, earlier)
            self.tail[part] = both[:, :, -self.lags :]


def _neighbours(f: float, orders: Sequence[int], step: float, samples: int) -> tuple[Ints, Ints]:
    """Lines a whole number of steps 1/duration beside each harmonic, no farther than half way to the next one.

    Returns how many steps, and beside which of the orders.
    """
    reach = min(HALF_BAND, int((f / step - 1) / 2 + 1e-9))
    offsets = np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)]) if reach > 0 else np.arange(0)
    nyquist = samples * step / 2
    offset, owner = [], []
    for i, order in enumerate(orders):
        lines = order * f + offsets * step
        inside = offsets[(lines > 0) & (lines < max(nyquist - step, order * f))]
        offset.append(inside)
        owner.append(np.full(len(inside), i))
    return np.concatenate(offset).astype(np.int64), np.concatenate(owner).astype(np.int64)


def _fit(record: Record, f: float, orders: tuple[int, ...], degree: int, noise: Noise) -> HarmonicFit:
    samples, channels = record.values.shape[-2:]
    leading, terms = record.values.shape[:-2], degree + 1 + 2 * len(orders)
    watch = None if noise == "white" else _Watch(record, f, orders, terms)
    solution = _solve(record, f, orders, degree, watch=watch)
    waves = solution.coefficients[:, degree + 1 :]
    X = waves[:, 0::2] - 1j * waves[:, 1::2]
    free = samples - terms
    sigma = solution.squares / free
    exact = _exact(sigma, X, solution.largest)
    sigma = np.where(exact[:, :, None] | exact[:, None, :], 0.0, sigma)
    # (cos, sin) coefficients are (Re X, −Im X), hence the sign of the off-diagonal
    first = degree + 1 + 2 * np.arange(len(orders))
    P = np.stack(
        [
            np.stack([solution.P[first, first], -solution.P[first, first + 1]], axis=-1),
            np.stack([-solution.P[first + 1, first], solution.P[first + 1, first + 1]], axis=-1),
        ],
        axis=-2,
    )
    spread = P[:, 0, 0] + P[:, 1, 1]
    level = np.broadcast_to(sigma[:, None].astype(complex), (len(X), len(orders), channels, channels))
    dof = np.full(len(orders), float(free))
    kind: Literal["white", "blocks"] = "white"
    whiteness = np.full(len(X), np.nan)
    notes: list[str] = []
    if watch is not None:
        local, counts = _local_level(watch, solution.L, samples, len(orders), sigma, exact)
        whiteness = _whiteness(watch, sigma, exact, local, counts, samples, free)
        enough = bool(np.all(counts >= FEWEST_LINES))
        if noise == "blocks" and not enough:
            raise DataError(
                f"{f * _duration(record.time):.3g} periods are too few to see the colour of the noise at {f:g} Hz",
                record.source,
                'record eight periods at least, or take the noise as "white"',
            )
        coloured = _coloured(whiteness)
        if noise == "blocks" or (coloured and enough):
            kind, level, dof = "blocks", local, 2.0 * counts
        elif coloured:
            notes.append(
                f"{record.source}: the residual at {f:g} Hz is not white but {f * _duration(record.time):.3g} periods "
                "are too few to see its colour; the intervals take it as white"
            )
    real = P[None, :, None] * np.diagonal(level.real, axis1=-2, axis2=-1)[..., None, None]
    centre, half = _window(record.time)
    return HarmonicFit(
        record.channels,
        float(f),
        orders,
        X.reshape(*leading, len(orders), channels),
        (spread[:, None, None] * level).reshape(*leading, len(orders), channels, channels),
        real.reshape(*leading, len(orders), channels, 2, 2),
        solution.coefficients[:, : degree + 1].reshape(*leading, degree + 1, channels),
        centre,
        half,
        sigma.reshape(*leading, channels, channels),
        samples,
        float(f * _duration(record.time)),
        dof,
        kind,
        whiteness.reshape(leading),
        tuple(notes),
    )


def _exact(sigma: Real, X: Complex, largest: Real) -> Bools:
    """(batch, channels): the residual is rounding, of the amplitude or of the numbers themselves."""
    rms = np.sqrt(np.maximum(np.diagonal(sigma, axis1=1, axis2=2), 0.0))
    strongest = np.max(np.abs(X), axis=1)
    bound = np.maximum(EXACT * strongest, 32 * np.finfo(float).eps * largest)
    small: Bools = rms <= bound
    return small


def _local_level(
    watch: _Watch, L: Real, samples: int, orders: int, sigma: Real, exact: Bools
) -> tuple[Complex, Real]:
    """Noise level at each harmonic, (batch, orders, channels, channels) per sample, and lines behind it, (orders,).

    S(kω) = mean of J Jᴴ / samples with J = Σ e(t) e^{−jω_m t} on neighbouring lines, corrected for the share of each
    line that the fit itself has taken.  Where the lines are too few for the correlations of so many channels, the
    variances come from the lines and the correlations from the residual of all samples.
    """
    batch, _, channels = watch.sums.shape
    seen = cho_solve((L, True), watch.overlap, check_finite=False)
    share = np.sum((np.conj(watch.overlap) * seen).real, axis=0) / samples
    usable = share < 0.5
    level = np.zeros((batch, orders, channels, channels), dtype=complex)
    counts = np.zeros(orders)
    active = int(np.max(np.sum(~exact, axis=-1), initial=0))
    for order in range(orders):
        mine = usable & (watch.owner == order)
        counts[order] = np.sum(mine)
        if not counts[order]:
            continue
        J = watch.sums[:, mine] / np.sqrt(samples * (1 - share[mine]))[None, :, None]
        S = np.swapaxes(J, 1, 2) @ np.conj(J) / counts[order]
        if counts[order] < 2 * active:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.sqrt(np.diagonal(S, axis1=1, axis2=2).real / np.diagonal(sigma, axis1=1, axis2=2))
            ratio = np.where(np.isfinite(ratio), ratio, 0.0)
            S = ratio[:, :, None] * sigma * ratio[:, None, :]
        level[:, order] = (S + np.conj(np.swapaxes(S, 1, 2))) / 2
    level[np.broadcast_to((exact[:, :, None] | exact[:, None, :])[:, None], level.shape)] = 0.0
    return level, counts


def _whiteness(
    watch: _Watch, sigma: Real, exact: Bools, local: Complex, counts: Real, samples: int, free: int
) -> Real:
    """(batch,): p-value of white noise by Ljung and Box's portmanteau and by the noise level at each harmonic."""
    variance = np.diagonal(sigma, axis1=1, axis2=2)
    safe = np.where(exact, 1.0, variance)
    ps: list[Real] = []
    if watch.lags:
        lag = np.arange(1, watch.lags + 1)[None, :, None]
        r = watch.products / (safe * free)[:, None, :]
        ps.append(chdtrc(watch.lags, samples * (samples + 2.0) * np.sum(r**2 / (samples - lag), axis=1)))
    for order, count in enumerate(counts):
        if count >= FEWEST_LINES:
            ratio = np.diagonal(local[:, order], axis1=1, axis2=2).real / safe
            ps.append(
                np.minimum(1.0, 2 * np.minimum(fdtrc(2 * count, free, ratio), fdtr(2 * count, free, ratio)))
            )
    if not ps:
        return np.full(len(sigma), np.nan)
    smallest = np.min(np.where(exact, np.nan_to_num(1.0), np.stack(ps)), axis=(0, 2))
    tests = len(ps) * np.sum(~exact, axis=-1)
    return np.where(tests > 0, np.minimum(1.0, smallest * tests), np.nan)


def _coloured(whiteness: Real) -> bool:
    """One decision for all repeats: more of them fail at 1 % than chance allows, and more than a few per cent."""
    tested = whiteness[np.isfinite(whiteness)]
    failed = int(np.sum(tested < SIGNIFICANT))
    if not failed:
        return False
    chance = float(bdtrc(failed - 1, len(tested), SIGNIFICANT))
    return failed >= 0.03 * len(tested) and chance <= SIGNIFICANT * (1 + 1e-9)


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
        solution = _solve(record, f, every, degree)
    except DataError:
        return orders  # the record cannot tell them apart
    free = samples - degree - 1 - 2 * len(every)
    waves = solution.coefficients[:, degree + 1 :]
    X = waves[:, 0::2] - 1j * waves[:, 1::2]
    sigma = solution.squares / free
    exact = _exact(sigma, X, solution.largest)
    variance = np.where(exact, 1.0, np.diagonal(sigma, axis1=1, axis2=2))
    strongest = np.maximum(np.max(np.abs(X), axis=1), 1e-5 * solution.largest)
    level = SIGNIFICANT / (len(candidates) * channels * len(X))
    found = list(orders)
    for i, order in enumerate(every):
        if order in orders:
            continue
        pair = waves[:, 2 * i : 2 * i + 2]
        first = degree + 1 + 2 * i
        inside = np.linalg.solve(solution.P[first : first + 2, first : first + 2], pair)
        F = np.sum(pair * inside, axis=1) / (2 * variance)
        there = np.where(exact, np.abs(X[:, i]) > 1e-9 * strongest, fdtrc(2, free, F) < level)
        if np.any(there):
            found.append(order)
    return tuple(sorted(found))


# ------------------------------------------------------------------------------------------------ frequency, settling


def refine_frequency(
    record: Record, nominal_hz: float | None = None, *, within: float = 0.02, drift: int | None = 1
) -> RefinedFrequency:
    """The frequency of greatest likelihood over all channels and repeats together, near the nominal one.

    A periodogram in nominal · (1 ± within), three resolution steps at least, finds the peak; Gauss-Newton steps of
    the least squares fit take it to the end.  Raises DataError as `fit_harmonics`, and where it does not settle.
    """
    f = nominal_hz if nominal_hz is not None else record.frequency_hz
    if f is None:
        raise DataError(
            "the drive frequency is not known", record.source, "give the nominal frequency of the record"
        )
    nominal = float(f)
    degree = -1 if drift is None else int(drift)
    _check_length(record, nominal, (1,), max(degree, 0) + 2)
    T = _duration(record.time)
    search = min(max(within * nominal, 3 / T), 0.5 * nominal)
    f = _peak(record, nominal, search)
    sd = np.inf
    for _ in range(30):
        step, sd = _frequency_step(record, f, degree)
        f += float(np.clip(step, -0.25 / T, 0.25 / T))
        if abs(f - nominal) > search + 1 / T or f <= 0:
            break
        if abs(step) * T < 1e-9 or abs(step) < 1e-3 * sd:
            return RefinedFrequency(f, sd, nominal)
    raise DataError(
        f"no frequency of the drive is found within {search:.3g} Hz of {nominal:g} Hz",
        record.source,
        "correct the nominal frequency, or use it as it is",
    )


def _peak(record: Record, nominal: float, search: float) -> float:
    """Highest point of the periodogram of all channels within nominal ± search.

    Samples are brought down to the nominal frequency and summed over time blocks, short enough for the search band.
    """
    time, T = record.time, _duration(record.time)
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    blocks = int(min(max(16, np.ceil(8 * search * T)), 1 << 20))
    edges = np.searchsorted(time, time[0] + (T / blocks) * np.arange(1, blocks))
    cycles = nominal * time
    carrier = np.exp(-2j * np.pi * (cycles - np.floor(cycles)))
    starts = np.concatenate([[0], edges])
    empty = np.diff(np.concatenate([starts, [samples]])) == 0
    starts = np.minimum(starts, samples - 1)
    likelihood = np.zeros(4 * blocks)
    for y in Y:
        z = y - np.mean(y, axis=0)
        power = np.sum(z**2, axis=0)
        sums = np.add.reduceat(carrier[:, None] * z, starts, axis=0)
        sums[empty] = 0
        share = (
            2
            * np.abs(np.fft.fft(sums, 4 * blocks, axis=0)) ** 2
            / (samples * np.where(power > 0, power, np.inf))
        )
        likelihood -= np.sum(np.log1p(-np.minimum(share, 1 - 1e-12)), axis=1)
    offset = np.fft.fftfreq(4 * blocks, T / blocks)
    likelihood[np.abs(offset) > search] = -np.inf
    return nominal + float(offset[int(np.argmax(likelihood))])


def _frequency_step(record: Record, f: float, degree: int) -> tuple[float, float]:
    """Gauss-Newton step of the frequency and its standard deviation, Hz.

    With the columns s cos, s sin (s = (t − centre)/half) added, a frequency error δ shows as their coefficients
    κ (b, −a), κ = 2π half δ, of a signal a cos + b sin.
    """
    _, half = _window(record.time)
    free = len(record.time) - degree - 5
    solution = _solve(record, f, (1,), degree, ramps=True)
    a, b = solution.coefficients[:, degree + 1], solution.coefficients[:, degree + 2]
    ramp = solution.coefficients[:, -2:]
    variance = np.diagonal(solution.squares, axis1=1, axis2=2) / max(free, 1)
    size = a**2 + b**2
    floor = np.maximum(1e-24 * size, (np.finfo(float).eps * solution.largest) ** 2)
    weight = np.where(size > 0, 1 / np.maximum(variance, np.where(floor > 0, floor, 1.0)), 0.0)
    g = np.stack([b, -a], axis=1)
    inside = np.linalg.solve(solution.P[-2:, -2:], g)
    information = float(np.sum(weight * np.sum(g * inside, axis=1)))
    if information <= 0:
        return 0.0, np.inf
    kappa = float(np.sum(weight * np.sum(ramp * inside, axis=1))) / information
    return kappa / (2 * np.pi * half), float(1 / (2 * np.pi * half * np.sqrt(information)))


def settled(record: Record, frequency_hz: float | None = None) -> Settled:
    """The part of a dwell that is driven, after its transient.

    Blocks of whole periods, counted from the end, give amplitudes and residuals.  The longest run of blocks with more
    than half of the greatest lasting amplitude is what was driven.  Within it the cut is where the mean of what
    remains is known best (White's marginal standard error rule, Simulation 69, 1997), at most half way, and only if
    what comes before it differs significantly (p < 0.01) from what comes after.  A small error of the frequency does
    not matter.  Raises DataError where the frequency is not known.
    """
    f = record.frequency_hz if frequency_hz is None else frequency_hz
    if f is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    time = record.time
    periods = int(f * _duration(time) + 1e-6)
    each = max(1, periods // 32, int(np.ceil(8 * periods / len(time))))
    blocks = periods // each
    if blocks < 8:
        note = f"{record.source}: {periods} periods at {f:g} Hz are too few to see a transient; none was cut"
        return Settled(record, 0, 0.0, note)
    step = (time[-1] - time[0]) / (len(time) - 1)
    starts = np.searchsorted(time, time[-1] + step - (each / f) * np.arange(blocks, 0, -1) - step / 4)
    ends = np.append(starts[1:], len(time))
    if np.min(ends - starts) < 4:
        return Settled(record, 0, 0.0, f"{record.source}: too many gaps to see a transient; none was cut")
    Z, rms = _block_amplitudes(record, f, starts, ends)
    begin, end = _driven(Z)
    if end - begin >= 8:
        begin += _truncation(_features(Z[begin:end], rms[begin:end], float(np.max(np.abs(record.values)))))
    first = 0 if begin == 0 else int(starts[begin])
    last = len(time) if end == blocks else int(starts[end])
    dropped = len(time) - (last - first)
    if not dropped:
        return Settled(record, 0, 0.0, "")
    kept = replace(record, time=time[first:last], values=record.values[..., first:last, :])
    what = [f"the first {time[first] - time[0]:.4g} s"] * (first > 0) + [
        f"the last {time[-1] - time[last - 1]:.4g} s"
    ] * (last < len(time))
    whole = float(time[-1] - time[0])
    note = f"{record.source}: {' and '.join(what)} of {whole:.4g} s at {f:g} Hz are not settled: thrown away"
    return Settled(kept, dropped, float(time[-1] - time[0] - (kept.time[-1] - kept.time[0])), note)


def _block_amplitudes(record: Record, f: float, starts: Ints, ends: Ints) -> tuple[Complex, Real]:
    """Amplitude and residual rms of each block, both (blocks, batch · channels)."""
    samples, channels = record.values.shape[-2:]
    values = record.values.reshape(-1, samples, channels)
    amplitudes, rms = [], []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        t = record.time[start:end]
        A = _basis(t, f, (1,), 0, *_window(t))
        y = np.moveaxis(values[:, start:end], 1, 0).reshape(len(t), -1)
        c = np.linalg.lstsq(A, y, rcond=None)[0]
        amplitudes.append(c[1] - 1j * c[2])
        rms.append(np.sqrt(np.mean((y - A @ c) ** 2, axis=0)))
    return np.array(amplitudes), np.array(rms)


def _driven(Z: Complex) -> tuple[int, int]:
    """Longest run of driven blocks, [begin, end); those in which the drive comes or goes are left out.

    A channel's level is the greatest that it keeps for four blocks.
    """
    size = np.abs(Z)
    level = np.max(np.min(np.lib.stride_tricks.sliding_window_view(size, 4, axis=0), axis=-1), axis=0)
    on = np.ones(len(Z), dtype=bool)
    if np.any(level > 0):
        on = np.median(size[:, level > 0] / level[level > 0], axis=1) > 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    runs = edges.reshape(-1, 2)
    begin, end = (int(k) for k in runs[np.argmax(runs[:, 1] - runs[:, 0])])
    if end - begin < 4:
        return 0, len(Z)
    return begin + (begin > 0), end - (end < len(Z))


def _features(Z: Complex, rms: Real, largest: float) -> Real:
    """(blocks, features) in units of their scatter over the last half: amplitudes turned by the phase of the steadiest
    channel, which makes them blind to a small error of the frequency, and residual rms."""
    tail = len(Z) // 2
    size = np.median(np.abs(Z), axis=0)
    floor = np.maximum(1e-9 * size, 1e-13 * largest) + np.finfo(float).tiny
    steady = int(np.argmax(size / np.maximum(np.std(np.abs(Z[tail:]), axis=0), floor)))
    turned = Z * np.exp(-1j * np.angle(Z[:, steady]))[:, None]
    values = np.concatenate([turned.real, turned.imag, rms], axis=1)
    scatter = np.maximum(np.std(values[tail:], axis=0, ddof=1), np.tile(floor, 3))
    normal: Real = (values - np.mean(values[tail:], axis=0)) / scatter
    return normal


def _truncation(features: Real) -> int:
    """Number of blocks to drop."""
    blocks, width = features.shape
    score = []
    for cut in range(blocks // 2 + 1):
        rest = features[cut:]
        spread = np.sum((rest - np.mean(rest, axis=0)) ** 2) + len(rest) * 1e-3 * width
        score.append(spread / len(rest) ** 2)
    cut = int(np.argmin(score))
    if cut == 0:
        return 0
    before, rest = features[:cut], features[cut:]
    free = len(rest) - 1
    spread = np.sum((rest - np.mean(rest, axis=0)) ** 2, axis=0) + free * 1e-3
    F = np.sum((before - np.mean(rest, axis=0)) ** 2, axis=0) / cut / (spread / free)
    p = fdtrc(cut, free, F / (1 + 1 / len(rest)))
    return cut if float(np.min(p)) * width < SIGNIFICANT else 0


# ------------------------------------------------------------------------------------------------ spectra


def spectrum(
    records: Sequence[Record],
    *,
    orders: Sequence[int] = (1,),
    harmonics: Sequence[int] | None = None,
    drift: int | None = 1,
    noise: Noise = "auto",
    moments: bool = False,
    refine: bool = False,
    settle: bool = False,
) -> Spectrum:
    """One line for each record and order, with the known sign, gain and delay of every channel taken out.

    Options as of `fit_harmonics`.  `settle` drops the transient of each record first, `refine` replaces its frequency
    by the most likely one, `moments` adds the second moments of the samples (order 1 alone, no known delays).
    spectrum(a + b) == spectrum(a) + spectrum(b).  Raises DataError as `fit_harmonics`.
    """
    if not records:
        raise DataError("there are no records", cure="give one record at least")
    if moments and tuple(orders) != (1,):
        raise DataError("second moments exist for the fundamental alone", cure="ask for orders (1,)")
    return concatenate(
        [
            _lines(record, tuple(orders), harmonics, drift, noise, moments, refine, settle)
            for record in records
        ]
    )


def _lines(
    record: Record,
    orders: tuple[int, ...],
    harmonics: Sequence[int] | None,
    drift: int | None,
    noise: Noise,
    moments: bool,
    refine: bool,
    settle: bool,
) -> Spectrum:
    """The lines of one record."""
    notes: list[str] = []
    if settle:
        part = settled(record)
        record = part.record
        notes.append(part.note)
    if refine:
        found = refine_frequency(record, drift=drift)
        if abs(found.frequency_hz - found.nominal_hz) > 3 * found.sd:
            notes.append(
                f"{record.source}: driven at {found.frequency_hz:.7g} Hz, not at {found.nominal_hz:.7g} Hz"
            )
        record = replace(record, frequency_hz=found.frequency_hz)
    fit = fit_harmonics(record, orders=orders, harmonics=harmonics, drift=drift, noise=noise)
    own = [fit.orders.index(order) for order in sorted(set(orders))]
    frequencies = fit.frequency_hz * np.array([fit.orders[i] for i in own], dtype=float)
    h = calibration(record.channels, frequencies)
    return Spectrum(
        record.channels,
        frequencies,
        fit.amplitudes[..., own, :] * h,
        fit.covariance[..., own, :, :] * h[:, :, None] * np.conj(h)[:, None, :],
        np.full(len(own), fit.samples),
        fit.dof[own],
        (fit.noise,) * len(own),
        np.full(len(own), record.experiment),
        second_moments(record, drift) if moments else None,
        tuple(note for note in (*notes, *fit.notes) if note),
    )


def calibration(channels: Sequence[Channel], frequency_hz: Real) -> Complex:
    """Factors that turn raw amplitudes into the quantity, (lines, channels): e^{jωτ} / (sign · gain).

    What is unknown stays in.  Raises DataError for a gain or sign of zero.
    """
    h = np.ones((len(frequency_hz), len(channels)), dtype=complex)
    for i, channel in enumerate(channels):
        h[:, i] /= _real_factor(channel)
        if channel.delay is not None and channel.delay != 0:
            h[:, i] *= np.exp(2j * np.pi * frequency_hz * channel.delay)
    return h


def _real_factor(channel: Channel) -> float:
    """Known sign · gain."""
    factor = (1.0 if channel.gain is None else channel.gain) * (1.0 if channel.sign is None else channel.sign)
    if factor == 0 or not np.isfinite(factor):
        raise DataError(
            f"channel {channel.name} has gain · sign = {factor:g}", cure="give a factor other than zero"
        )
    return factor


def second_moments(record: Record, drift: int | None = 1) -> Moments:
    """Σ q qᵀ of q = (channels, cos ωt, sin ωt), trend projected out of all alike; one line.

    Raises DataError for a channel with a known delay: it turns amplitudes, not samples.
    """
    for channel in record.channels:
        if channel.delay is not None and channel.delay != 0:
            raise DataError(
                f"channel {channel.name} has a delay of {channel.delay:g} s, which samples cannot be freed of",
                record.source,
                "shift its samples beforehand, or choose a method that works on amplitudes",
            )
    if record.frequency_hz is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    degree = -1 if drift is None else int(drift)
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    factors = np.array([1 / _real_factor(channel) for channel in record.channels])
    centre, half = _window(record.time)
    gram = np.zeros((degree + 1, degree + 1))
    right = np.zeros((len(Y), degree + 1, channels + 2))
    for rows in _rows(samples):
        A = _basis(record.time[rows], record.frequency_hz, (1,), degree, centre, half)
        gram += A[:, : degree + 1].T @ A[:, : degree + 1]
        for part in _tiles(len(Y), len(A), channels):
            right[part, :, :channels] += A[:, : degree + 1].T @ (Y[part, rows] * factors)
            right[part, :, channels:] += A[:, : degree + 1].T @ A[:, degree + 1 :]
    trend = _cho_solve(_factor(gram, record, record.frequency_hz), right) if degree >= 0 else right
    products = np.zeros((len(Y), channels + 2, channels + 2))
    for rows in _rows(samples):
        A = _basis(record.time[rows], record.frequency_hz, (1,), degree, centre, half)
        for part in _tiles(len(Y), len(A), channels + 2):
            y = Y[part, rows] * factors
            q = np.concatenate([y, np.broadcast_to(A[:, degree + 1 :], (*y.shape[:-1], 2))], axis=-1)
            q = q - A[:, : degree + 1] @ trend[part]
            products[part] += np.swapaxes(q, 1, 2) @ q
    return Moments(products.reshape(*record.values.shape[:-2], 1, channels + 2, channels + 2))
