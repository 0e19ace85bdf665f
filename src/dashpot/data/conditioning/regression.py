"""Least squares of offset, drift and harmonics over the samples of a record, without holding the design matrix.

    y_c(t) = Σ_i τ_ic P_i((t − centre)/half) + Σ_k Re(X_kc e^{jkωt}) + noise_c(t)                      (H)

P_i are Legendre polynomials, so the columns are of one size and nearly orthogonal.  Columns and channels are brought to
the triangle of their orthogonal factorisation, some samples at a time; whatever is solved for among them follows from
it.  Repeats (leading axes) share the triangle of the columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import fdtrc, log_ndtr

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.record import ABOVE, BELOW, MISSING, Record, kept
from dashpot.errors import DataError

CHUNK = 1 << 15  # samples whose design matrix is held at a time
TILE = 1 << 21  # numbers of repeats worked on at a time
EXACT = 1e-10  # residual over amplitude below which a channel counts as noise-free
ALIKE = 1e-7  # least eigenvalue of the correlations of columns that the samples tell apart
HIGHEST_HARMONIC = 10  # that is looked for where nobody asks for more
BELOW_HALF_RATE = 0.95  # of half the sampling rate, up to which harmonics are told from others


def holds_a_period(time: Real, f: float) -> bool:
    """Whether the samples (samples,) span a period; unevenly sampled ones may end a step inside, on both sides."""
    return f * (float(time[-1] - time[0]) + 2 * float(np.max(np.diff(time)))) >= 1


def highest_multiple(record: Record, f: float) -> int:
    """Of f Hz, that the samples tell from others; no more than there are samples."""
    return int(min(BELOW_HALF_RATE / (2 * record.step_s) / f, len(record.time)))


def turning(f: float, time: Real) -> Complex:
    """e^{j2πft} of times in s, of their shape."""
    cycles = f * time
    turns: Complex = np.exp(2j * np.pi * (cycles - np.floor(cycles)))
    return turns


def window(time: Real) -> tuple[float, float]:
    """Middle and half width of the time, s.  time (samples,)."""
    return float(time[0] + time[-1]) / 2, float(time[-1] - time[0]) / 2


@dataclass(frozen=True)
class Terms:
    """What a dwell's motion may contain apart from noise, as columns over the samples.

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
        z, columns = turning(f, t), np.empty((len(t), self.count))
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
            f"the record holds {f * record.duration_s:.3g} of a period at {f:g} Hz",
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


@dataclass(frozen=True)
class HarmonicSolution:
    """Least squares over some terms, of clipped samples by the likelihood of being beyond their value.

    terms         what was solved for
    of_all        (terms, terms)  covariance of coefficients per unit variance of a sample, if all samples are measured
    P             (channels, terms, terms)  the same by the samples of each channel
    coefficients  (batch, terms, channels)
    squares       (batch, channels, channels)  of the residual
    free          (channels,)  degrees of freedom of the residual
    largest       (batch, channels)  of |y|
    in_cells      (channels,)  those in which a value stands for all that a converter rounds to it
    """

    terms: Terms
    of_all: Real
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

    def residuals(self, record: Record, f: float) -> Iterator[tuple[slice, Real, Real]]:
        """Some samples after others: which, their columns (rows, terms) and the residuals (batch, rows, channels).

        Of samples that are not measured 0, and of a channel that has such as large as if all were.
        """
        samples, channels = record.values.shape[-2:]
        Y = record.values.reshape(-1, samples, channels)
        shown = np.where(self.in_cells, 0.0, np.sqrt(samples / (self.free + self.terms.count)))
        for rows, A in blocks_of_regressors(record, f, self.terms):
            e = Y[:, rows] - A @ self.coefficients
            yield rows, A, e if record.status is None else e * (record.status[rows] == 0) * shown


def blocks_of_regressors(record: Record, f: float, terms: Terms) -> Iterator[tuple[slice, Real]]:
    """Some samples after others, and their columns (rows, terms)."""
    samples = len(record.time)
    step = max(16, min(CHUNK, TILE * samples // max(record.values.size, 1)))
    for start in range(0, samples, step):
        rows = slice(start, min(samples, start + step))
        yield rows, terms.columns(record.time[rows], f, *window(record.time))


def solve_harmonics(record: Record, f: float, terms: Terms, *, sizes: bool = True) -> HarmonicSolution:
    """Least squares of some terms over the samples.

    A record at its own frequency is factored once for all terms that are usual; of repeats the columns alone are.
    Channels with samples that are not measured are solved for by themselves, `partly_measured`.  Raises DataError
    where the samples of some channel cannot tell the columns apart.
    """
    if record.values.ndim > 2:
        return _of_repeats(record, f, terms)
    every, R = _factored(record) if f == record.frequency_hz else (terms, None)
    columns = terms.within(every)
    if R is None or columns is None:
        R = triangle(
            np.concatenate([A, record.values[rows]], axis=1)
            for rows, A in blocks_of_regressors(record, f, terms)
        )
    else:
        R = triangle([R[:, [*columns, *range(every.count, R.shape[1])]]])
    k, channels = terms.count, len(record.channels)
    P, coefficients = from_triangle(R, k, record, f)
    left = R[k:, k:]
    free, in_cells = np.full(channels, float(len(record.time) - k)), np.zeros(channels, dtype=bool)
    each = np.broadcast_to(P, (channels, k, k))
    whole = HarmonicSolution(
        terms, P, each, coefficients[None], (left.T @ left)[None], free, _largest(record), in_cells
    )
    rounded = (
        False if record.cell is None else np.diagonal(whole.covariance[0]) < (DITHERED * record.cell) ** 2
    )
    some = np.flatnonzero(~record.whole_channels | rounded).tolist()
    return _with_partly_measured(record, f, whole, some, sizes) if some else whole


def triangle(pieces: Iterable[Real]) -> Real:
    """R of the QR factors of rows (rows, columns) that come in pieces."""
    R: Real | None = None
    for rows in pieces:
        R = np.linalg.qr(rows if R is None else np.concatenate([R, rows]), mode="r")  # type: ignore[assignment]
    assert R is not None
    return R


def from_triangle(R: Real, k: int, record: Record, f: float) -> tuple[Real, Real]:
    """Inverse Gram (k, k) of the first k columns, and their coefficients (k, others) in the others, by `triangle`.

    Raises DataError where the samples do not tell the columns apart.
    """
    size = np.sqrt(np.sum(R[:k, :k] ** 2, axis=0))
    apart = len(R) >= k and np.all(
        size > 1e-6 * len(record.time) ** 0.5
    )  # the rms of a column that is nothing
    if apart and np.all(np.abs(np.diagonal(R)[:k]) > ALIKE**0.5 * size):
        both = np.linalg.solve(R[:k, :k], np.concatenate([np.eye(k), R[:k, k:]], axis=1))
        P = both[:, :k] @ both[:, :k].T
        if float(np.sum(np.diagonal(P) * size**2)) < 1 / ALIKE:
            return P, both[:, k:]
    raise DataError(
        f"the samples (about {1 / record.step_s:g} per second) cannot separate offset, drift and harmonics at {f:g} Hz",
        record.source,
        "record more periods, at a rate that is not twice the frequency or less, or ask for fewer harmonics",
    )


@kept
def _factored(record: Record) -> tuple[Terms, Real]:
    """The usual terms of a dwell at its frequency, and R of the QR factors of their columns and channels.

    Whatever is solved for among them follows from R, without the samples and as accurately as from these.
    """
    f = record.stated_hz
    highest = max(1, min(HIGHEST_HARMONIC, highest_multiple(record, f)))
    every = Terms(3, tuple(range(1, highest + 1)), 1)
    both = (
        np.concatenate([A, record.values[rows]], axis=1) for rows, A in blocks_of_regressors(record, f, every)
    )
    return every, triangle(both)


@kept
def _largest(record: Record) -> Real:
    """|y| of each channel at most, (1, channels)."""
    return np.maximum(np.max(record.values, axis=0), -np.min(record.values, axis=0))[None]


def _of_repeats(record: Record, f: float, terms: Terms) -> HarmonicSolution:
    """Of records with leading axes: normal equations, then the residual and one refinement, some repeats at a time."""
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    P, _ = from_triangle(
        triangle(A for _, A in blocks_of_regressors(record, f, terms)), terms.count, record, f
    )
    right, largest = np.zeros((len(Y), terms.count, channels)), np.zeros((len(Y), channels))
    for rows, A in blocks_of_regressors(record, f, terms):
        right += A.T @ Y[:, rows]
        largest = np.maximum(largest, np.max(np.abs(Y[:, rows]), axis=1))
    free, squares = np.full(channels, float(samples - terms.count)), np.zeros((len(Y), channels, channels))
    each, none = np.broadcast_to(P, (channels, *P.shape)), np.zeros(channels, dtype=bool)
    found = HarmonicSolution(terms, P, each, P @ right, squares, free, largest, none)
    correction = np.zeros_like(right)
    for _, A, e in found.residuals(record, f):
        correction += A.T @ e
        squares += np.swapaxes(e, 1, 2) @ e
    return replace(found, coefficients=found.coefficients + P @ correction)


def _with_partly_measured(
    record: Record, f: float, found: HarmonicSolution, some: Sequence[int], sizes: bool
) -> HarmonicSolution:
    """The solution with channels that lack samples solved separately."""
    P, free, in_cells = np.array(found.P), found.free.copy(), found.in_cells.copy()
    coefficients, variance = found.coefficients.copy(), np.diagonal(found.covariance[0]).copy()
    for c in some:
        its = partly_measured(record, c, f, found.terms, sizes=sizes)
        P[c], free[c], in_cells[c] = its.P, its.free, its.in_cells
        coefficients[0, :, c], variance[c] = its.coefficients, its.variance
    found = replace(found, P=P, coefficients=coefficients, free=free, in_cells=in_cells)
    # The variances found above, with correlations of what is measured of both, as those of the coefficients are; a
    # channel in cells is rounded by itself
    squares = np.zeros_like(found.squares[0])
    for _, _, e in replace(found, in_cells=np.zeros_like(in_cells)).residuals(record, f):
        squares += e[0].T @ e[0]
    size, sd = np.sqrt(np.maximum(np.diagonal(squares), 1e-300)), np.sqrt(variance * free)
    squares = np.where(in_cells[:, None] | in_cells, 0.0, squares / np.outer(size, size)) * np.outer(sd, sd)
    np.fill_diagonal(squares, sd**2)
    return replace(found, squares=squares[None])


FAR = 1e4  # standard deviations: what is beyond counts as that
TURNS = 50  # of Newton's method, and of sizes of the noise; three to ten are needed
DITHERED = 0.7  # residual in steps of a converter from which on rounding is noise like the rest
BEGUN = 0.25  # noise in steps with which the search begins where the residual is rounding alone
INSIDE = 8.0  # standard deviations from both ends of its cell, from which on a sample says nothing more
UNKNOWN = 3.0  # standard deviations of the noise to which codes tell the motion: less, and the noise is as good as none
ENOUGH = 50.0  # degrees of freedom with which the likeliest size of the noise stands for all
UNLIKELY = 4.0  # log-likelihood below the highest from which on other sizes are not looked at

APART = 1.5  # standard deviations from one to the next of what is summed along a direction
STEEP = 2.5  # log-likelihood that it may fall from one to the next

Likelihood = Callable[[Real, float], tuple[float, Real, Real]]  # of (β, τ), with slope and information
Summand = tuple[float, float, Real, Real]  # where it is, ln of what it has, mean and covariance


@dataclass(frozen=True)
class PartlyMeasured:
    """The likeliest in a channel whose samples are not all measured: coefficients, their P, variance and freedom."""

    coefficients: Real
    P: Real
    variance: float
    free: float
    in_cells: bool


def partly_measured(record: Record, c: int, f: float, terms: Terms, *, sizes: bool = True) -> PartlyMeasured:
    """A channel with samples that are clipped, missing or rounded to cells.

    Of a sample in a cell from a to b it is known that the noise is between: ln(Φ(τ b − A γ) − Φ(τ a − A γ)) with
    τ = 1/σ and γ = τ β; a clipped one is in a cell without an end.  That is concave in (γ, τ) (Olsen 1978, Econometrica
    46; Burridge 1981, JRSS B 43).  Newton's method goes along η = δγ − β δτ, so that β changes by η/(τ + δτ) and the
    inverse of the information is P.  The degrees of freedom that β takes are taken off.

    Codes may leave σ open, and a small one makes of the likelihood the box of all that gives these codes.  Mean and
    covariance are then those over all β and σ; the variance is that of one unrounded sample that tells as much.
    Without `sizes` they are those of least squares there, with rounding that is at worst alike until the code changes
    and in every period: in the box a test of many terms would find what is not there.
    """
    y = record.values[:, c]
    status = np.zeros(len(y)) if record.status is None else record.status[:, c]
    cell = 0.0 if record.cell is None else float(record.cell[c])
    seen = status == 0
    pieces = list(blocks_of_regressors(record, f, terms)) if len(y) <= CHUNK else None

    def columns() -> Iterable[tuple[slice, Real]]:
        return blocks_of_regressors(record, f, terms) if pieces is None else pieces

    k, count = terms.count, int(np.count_nonzero(seen))
    R = triangle(np.column_stack([A, y[rows]])[seen[rows]] for rows, A in columns())
    P, right = from_triangle(R, k, record, f)
    beta, variance = right[:, 0], float(np.sum(R[k:, k] ** 2)) / max(count - k, 1)
    if np.sqrt(variance) > DITHERED * cell:
        cell = 0.0
    largest = float(np.max(np.abs(y)))
    tau = 1 / max(np.sqrt(max(variance - cell**2 / 12, (BEGUN * cell) ** 2)), 1e-13 * largest)
    exact, far = seen & (cell == 0), 1e9 * max(largest, cell)  # as good as no end
    under = np.where((status == BELOW) | (status == MISSING), -far, -cell / 2)
    over = np.where((status == ABOVE) | (status == MISSING), far, cell / 2)

    def at(beta: Real, tau: float) -> tuple[float, Real, Real]:
        """Log-likelihood, its slope along (η, τ) and its information."""
        sharp = 0 if cell else count - k
        total, slope, info = sharp * np.log(tau), np.zeros(k + 1), np.zeros((k + 1, k + 1))
        slope[-1], info[-1, -1] = sharp / tau, sharp / tau**2
        for rows, A in columns():
            e, known = y[rows] - A @ beta, exact[rows]
            low, high = e + under[rows], e + over[rows]
            within = ~known & ((tau * low > -INSIDE) | (tau * high < INSIDE))
            L, a, b, aa, ab, bb = in_between(tau * low[within], tau * high[within])
            E, to_low, to_high = (
                np.column_stack([-A[of], end[of]]) for of, end in ((known, e), (within, low), (within, high))
            )
            total += float(np.sum(L) - np.sum((tau * e[known]) ** 2) / 2)
            slope += b @ to_high - a @ to_low - tau * e[known] @ E
            info += E.T @ E - to_low.T @ (aa[:, None] * to_low + ab[:, None] * to_high)
            info -= to_high.T @ (ab[:, None] * to_low + bb[:, None] * to_high)
        return float(total), slope, info

    least_squares, changes = beta, max(int(np.count_nonzero(np.diff(y))), 1)
    alike = f * record.duration_s * len(y) / changes
    wide = R[:k, :k] * (cell > 0) / (UNKNOWN * np.sqrt(count))
    beta, tau, _, inverse = _climbed(at, wide, beta, tau, k + 1)
    free, covariance = 0.0, None
    if inverse is not None:
        free = float(tau**2 / (2 * inverse[-1, -1]))
        covariance = (inverse + inverse.T)[:-1, :-1] / (2 * tau**2)
    if cell and free >= ENOUGH and covariance is not None:
        covariance = covariance * free / max(free - k, free / 2)
    elif cell and not sizes:
        rounding = max(variance, cell**2 / 12) * max(alike, 1.0)
        return PartlyMeasured(least_squares, P, rounding, float(max(count - k, 1)), in_cells=True)
    elif cell:
        beta, covariance = _over_sizes(at, wide, beta, tau, free, terms.degree >= 0)
    if covariance is None:
        raise DataError(
            f"the valid samples of {record.channels[c].name} cannot determine its motion at {f:g} Hz",
            record.source,
            "leave the channel out, or widen its range",
        )
    if not cell:
        return PartlyMeasured(beta, covariance * tau**2, 1 / tau**2, free, in_cells=False)
    variance = float(np.trace(R[:k, :k] @ covariance @ R[:k, :k].T)) / k
    # What is log-concave within a cell has no larger variance than what is even there
    most = min(1.0, (cell**2 / 12 + 1 / tau**2) * count / k / variance)
    return PartlyMeasured(
        beta, covariance / variance, most * variance, float(max(count - k, 1)), in_cells=True
    )


def _climbed(
    at: Likelihood, wide: Real, beta: Real, tau: float, moved: int
) -> tuple[Real, float, float, Real | None]:
    """(β, τ) where the first directions have moved to the likeliest, its log-likelihood, their inverse information.

    That is None where it is not positive, or the motion is known to less than UNKNOWN; `wide` (k, k) makes of β
    the motion in that unit, its rms over the samples.
    """
    (total, slope, info), k = at(beta, tau), len(wide)
    for _ in range(TURNS):
        inverse = _inverse(info[:moved, :moved])
        if inverse is None or np.linalg.eigvalsh(wide @ inverse[:k, :k] @ wide.T)[-1] > 1:
            return beta, tau, total, None
        step = np.zeros(len(slope))
        step[:moved] = inverse @ slope[:moved]
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
    return beta, tau, total, inverse


def _over_sizes(
    at: Likelihood, wide: Real, beta: Real, tau: float, free: float, offset: bool
) -> tuple[Real, Real | None]:
    """Mean and covariance of k coefficients over all sizes of the noise, about 1/τ, known with so many degrees of
    freedom; no covariance where none tells them.

    Given a size they are Gaussian about the likeliest (Laplace); β and σ are as likely beforehand.  From where the
    noise is smaller than what is known of the motion, the box is as it is there; where it goes on farther than the
    parabola at the likeliest, as below the limit that two codes set, it is summed up (`_along_the_least_known`).
    """
    k = len(beta)

    def given(beta: Real, tau: float) -> Summand | None:
        likeliest, _, total, inverse = _climbed(at, wide, beta, tau, k)
        if inverse is None:
            return None
        weight = total + float(np.linalg.slogdet(inverse)[1]) / 2 - (k + 1) * np.log(tau)
        return float(np.log(tau)), weight, likeliest, inverse / tau**2

    # Between sizes 1.6 standard deviations of ln σ, with which sums are exact to 1 in 1,000, and a factor at most
    apart = min(1.6 / np.sqrt(2 * max(free, 1.0)), np.log(1.5))
    sizes = (given(beta, tau / np.exp(i * apart)) for i in range(TURNS))
    first = next((size for size in sizes if size is not None), None)
    if first is None:
        return beta, None
    found, smallest = [first], 0.0
    for way in (-apart, apart):
        last = first
        while last[1] > max(size[1] for size in found) - UNLIKELY and len(found) < TURNS:
            size = given(last[2], float(np.exp(last[0] + way)))
            if size is not None:
                last = size
                found.append(size)
            elif way < apart / 2:
                smallest = float(way > 0)
                break
            else:
                way /= 2
    log_tau, _, likeliest, parabola = max(found, key=lambda size: size[1])
    middle, box = _along_the_least_known(at, wide, likeliest, float(np.exp(log_tau)), parabola, offset)
    if np.trace(wide @ (box - parabola) @ wide.T) > 0:
        found = [(x, weight, mean + middle - likeliest, box) for x, weight, mean, _ in found]
    return _summed(found, smallest)


def _along_the_least_known(
    at: Likelihood, wide: Real, beta: Real, tau: float, parabola: Real, offset: bool
) -> tuple[Real, Real]:
    """Mean and covariance of k coefficients given the noise; a parabola at the likeliest has one (k, k).

    By sums along the direction in which the motion is known least, and by parabolas in all others, each about what is
    likeliest there.  The motion about its offset is as likely beforehand at each size, with all else in proportion.
    """
    k, first = len(beta), int(offset)
    variances, axes = np.linalg.eigh(wide @ parabola @ wide.T)
    basis, both = np.linalg.solve(wide, axes), np.eye(k + 1)
    both[:k, :k] = basis

    def turned(c: Real, tau: float) -> tuple[float, Real, Real]:
        total, slope, info = at(beta + basis @ c, tau)
        return total, both.T @ slope, both.T @ info @ both

    def there(c: Real) -> tuple[Real, Summand] | None:
        c, _, total, inverse = _climbed(turned, np.eye(k - 1), c, tau, k - 1)
        if inverse is None:
            return None
        motion, others = beta + basis @ c, basis[:, :-1]
        size = float(np.linalg.norm(wide[first:, first:] @ motion[first:]))
        weight = total + float(np.linalg.slogdet(inverse)[1]) / 2 - (k - 1) * np.log(max(size, 1e-300))
        return c, (float(c[-1]), float(weight), motion, others @ inverse @ others.T / tau**2)

    middle = there(np.zeros(k))
    if middle is None:
        return beta, parabola
    found, usual = [middle[1]], APART * float(np.sqrt(variances[-1]))
    for step in (-usual, usual):
        last = middle
        while last[1][1] > middle[1][1] - UNLIKELY and len(found) < TURNS:
            following = there(last[0] + np.append(np.zeros(k - 1), step))
            if following is not None and following[1][1] > last[1][1] - STEEP:
                last = following
                found.append(last[1])
            elif abs(step) > usual / 1000:  # a wall, as good as upright
                step /= 2
            else:
                break
    return _summed(found, 0.0)


def _summed(found: Sequence[Summand], before: float) -> tuple[Real, Real]:
    """Mean and covariance of a mixture along one direction, whose last counts for as much as `before` it beyond."""
    found = sorted(found, key=lambda one: one[0])
    x, weights = np.array([one[:2] for one in found]).T
    width = np.gradient(x) if len(found) > 1 else np.ones(1)
    share = np.exp(weights - np.max(weights)) * width
    share[-1] *= 1 + before / width[-1]
    share = share / np.sum(share)
    middles = np.array([one[2] for one in found])
    mean = share @ middles
    within = np.einsum("s,sij->ij", share, np.array([one[3] for one in found]))
    away = middles - mean
    return mean, within + (share * away.T) @ away


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
