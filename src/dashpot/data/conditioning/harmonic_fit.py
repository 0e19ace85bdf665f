"""From samples to complex amplitudes: offset, drift and harmonics by least squares on the true sample times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Unpack, cast

import numpy as np
from scipy.special import bdtrc, chdtrc, fdtr, fdtrc

from dashpot.arrays import Bools, Complex, Frozen, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.regression import (
    HIGHEST_HARMONIC,
    HarmonicSolution,
    Terms,
    check_length,
    highest_multiple,
    solve_harmonics,
    turning,
    window,
)
from dashpot.data.conditioning.settings import (
    USUAL_DRIFT,
    Conditioning,
    Drift,
    FitTreatments,
    Noise,
    conditioning_of,
)
from dashpot.data.record import Record, real_factor
from dashpot.data.spectrum import Moments
from dashpot.errors import DataError
from dashpot.notices import Notice

# The noise of amplitudes from the residual of the fit: its size next to each harmonic, and whether it is
# white.


FEWEST_LINES = 6  # below this the local spectrum is not an estimate
SIGNIFICANT = 0.01  # level of the tests of a single dwell, all its channels and multiples together


def _noise_beside(
    record: Record, f: float, solution: HarmonicSolution, sigma: Real, exact: Bools
) -> tuple[Complex, Real, Real]:
    """Noise level at each harmonic by its residual, (batch, orders, channels, channels) per sample; lines behind it,
    (orders,); autocovariances of the residual (batch, lags, channels).

    S(kω) = mean of J Jᴴ / samples with J = Σ e(t) e^{−jω_m t} on the ten lines on each side, no farther than half way
    to the next harmonic, corrected for the share of each line that the fit itself has taken.  Where the lines are too
    few for the correlations of so many channels, the variances come from the lines and the correlations from the
    residual of all samples.
    """
    samples, channels = record.values.shape[-2:]
    terms, batch, step = solution.terms, len(solution.squares), 1 / record.duration_s
    lags = min(20, samples // 5) if samples >= 40 else 0  # of the portmanteau test
    reach, harmonics = max(min(10, int((f / step - 1) / 2 + 1e-9)), 0), f * np.array(terms.orders)[:, None]
    lines = harmonics + step * np.arange(-reach, reach + 1)
    inside = (lines > 0) & (lines < np.maximum(samples * step / 2 - step, harmonics))
    inside[:, reach] = False
    owner, offset = np.nonzero(inside)
    products, tail = np.zeros((batch, lags, channels)), np.zeros((batch, lags, channels))
    sums = np.zeros((batch, len(owner), channels), dtype=complex)
    overlap = np.zeros((len(owner), terms.count), dtype=complex)
    for rows, A, e in solution.residuals(record, f):
        turn = np.conj(turning(step, record.time[rows]))
        later = np.cumprod(np.tile(turn, (reach, 1)), axis=0)
        turns = np.concatenate([np.conj(later[::-1]), np.ones((1, len(turn))), later])
        first, last = terms.degree + 1, terms.degree + 1 + 2 * len(terms.orders)
        carriers = (A[:, first:last:2] - 1j * A[:, first + 1 : last : 2]).T
        waves = carriers[owner] * turns[offset]
        overlap += waves @ A
        sums += waves.real @ e + 1j * (waves.imag @ e)
        both = np.concatenate([tail, e], axis=1)
        for lag in range(1, lags + 1):
            earlier = both[:, lags - lag : len(both[0]) - lag]
            products[:, lag - 1] += np.einsum("btc,btc->bc", e, earlier)
        tail = both[:, len(both[0]) - lags :]
    taken = np.einsum("lk,km,lm->l", np.conj(overlap), solution.of_all, overlap).real / samples
    level = np.zeros((batch, len(harmonics), channels, channels), dtype=complex)
    counts = np.bincount(owner[taken < 0.5], minlength=len(harmonics)).astype(float)
    for order in np.flatnonzero(counts).tolist():
        mine = (taken < 0.5) & (owner == order)
        J = sums[:, mine] / np.sqrt(samples * (1 - taken[mine]))[None, :, None]
        S = np.swapaxes(J, 1, 2) @ np.conj(J) / counts[order]
        if counts[order] < 2 * int(np.max(np.sum(~exact, axis=-1), initial=0)):
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.sqrt(np.diagonal(S, axis1=1, axis2=2).real / np.diagonal(sigma, axis1=1, axis2=2))
            ratio = np.where(np.isfinite(ratio), ratio, 0.0)
            S = ratio[:, :, None] * sigma * ratio[:, None, :]
        level[:, order] = (S + np.conj(np.swapaxes(S, 1, 2))) / 2
    level[np.broadcast_to((exact[:, :, None] | exact[:, None, :])[:, None], level.shape)] = 0.0
    return level, counts, products


def _whiteness(
    products: Real, sigma: Real, exact: Bools, local: Complex, counts: Real, samples: int, free: int
) -> Real:
    """(batch,): p-value of white noise by Ljung and Box's portmanteau and by the noise level at each harmonic."""
    variance = np.diagonal(sigma, axis1=1, axis2=2)
    safe = np.where(exact, 1.0, variance)
    ps: list[Real] = []
    if lags := products.shape[1]:
        lag = np.arange(1, lags + 1)[None, :, None]
        r = products / (safe * free)[:, None, :]
        ps.append(chdtrc(lags, samples * (samples + 2.0) * np.sum(r**2 / (samples - lag), axis=1)))
    for order, count in enumerate(counts):
        if count >= FEWEST_LINES:
            ratio = np.diagonal(local[:, order], axis1=1, axis2=2).real / safe
            ps.append(
                np.minimum(1.0, 2 * np.minimum(fdtrc(2 * count, free, ratio), fdtr(2 * count, free, ratio)))
            )
    if not ps:
        return np.full(len(sigma), np.nan)
    smallest = np.min(np.where(exact, 1.0, np.stack(ps)), axis=(0, 2))
    tests = len(ps) * np.sum(~exact, axis=-1)
    return np.where(tests > 0, np.minimum(1.0, smallest * tests), np.nan)


# Second moments of the samples of a dwell, for the methods that work on samples.


def second_moments(record: Record, drift: Drift = USUAL_DRIFT) -> Moments:
    """Σ q qᵀ of q = (channels, cos ωt, sin ωt), trend projected out of all alike; one line.

    Raises DataError for a channel with a known delay: it turns amplitudes, not samples.
    """
    for channel in record.channels:
        if channel.delay is not None and channel.delay != 0:
            raise DataError(
                f"channel {channel.name} has a delay of {channel.delay:g} s, which cannot be removed from samples",
                record.source,
                "shift its samples first, or choose a method that works on amplitudes",
            )
    f, degree = record.stated_hz, Conditioning(drift=drift).degree
    leading, channels = record.values.shape[:-2], len(record.channels)
    factors = np.array([1 / real_factor(channel) for channel in record.channels])
    waves = Terms(-1).columns(record.time, f, *window(record.time))
    q = np.concatenate(
        [record.values * factors, np.broadcast_to(waves, (*leading, *waves.shape))], axis=-1
    ).reshape(-1, len(waves), channels + 2)
    products = np.swapaxes(q, 1, 2) @ q
    if degree >= 0:
        every = (*record.channels, *(Channel(name, {}) for name in ("cos", "sin")))
        of_all = replace(record, channels=every, values=q, sd=None, status=None, cell=None)
        products = solve_harmonics(of_all, f, Terms(degree, ())).squares
    return Moments(products.reshape(*leading, 1, channels + 2, channels + 2))


# The steps of a converter, whose codes are regressed by the likelihood of their cells.
#
# A channel that stays on one code has no residual at all, and where sampling and drive are commensurate
# every period is rounded alike, so that the error is a harmonic of the drive. Neither is an exact channel.


FINEST = 1e-7  # of the largest value: finer steps are digits of a text, not of a converter


def rounding_steps(records: Sequence[Record]) -> Real:
    """The step of each channel of each record in the units of its values, (records, channels); 0: finer than FINEST.

    All values of a quantised channel are a whole number of steps apart.  Each record may have a range of its own; where
    its codes are so few that a finer converter might skip those between by chance, those of all records count together,
    if a step is common to them.
    """
    codes = [[np.unique(c[:4096]) for c in r.values.reshape(-1, r.values.shape[-1]).T] for r in records]
    few = np.array([[2.0 ** (1 - len(own)) > SIGNIFICANT for own in of_record] for of_record in codes])
    common = np.zeros(few.shape[1:])
    for c in np.flatnonzero(np.any(few, axis=0)).tolist() if len(records) > 1 else ():
        common[c] = _common_step(np.unique(np.concatenate([own[c] for own in codes])))
    steps = np.array(np.broadcast_to(common, few.shape))
    for r, c in np.argwhere(~few | (common == 0)).tolist():
        steps[r, c] = _common_step(codes[r][c])
    return steps


def _common_step(codes: Real) -> float:
    """The greatest common step of the distances of ascending codes; 0 where there is none to speak of.

    Euclid's algorithm on the smallest distances, with the rounding of floating point as its zero.
    """
    largest = float(np.max(np.abs(codes), initial=0.0))
    apart = np.diff(codes)
    # A converter has one number for each code: a sine that was computed, at few phases, comes back by its last digits.
    if not len(apart) or np.min(apart) < FINEST * largest:
        return 0.0
    step = float(np.min(apart))
    for distance in np.sort(apart)[:200].tolist():  # distances of codes that are looked at
        rest = float(distance)
        while abs(rest) > 1e-3 * step and step > FINEST * largest:
            rest -= round(rest / step) * step
            if abs(rest) > 1e-3 * step:
                step, rest = abs(rest), step
    if step <= FINEST * largest:
        return 0.0
    multiples = np.round(apart / step)
    if np.max(np.abs(apart / step - multiples)) > 0.01:
        return 0.0
    return float(np.sum(apart) / np.sum(multiples))


@dataclass(frozen=True)
class HarmonicFit(Frozen):
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
                         "blocks": cross-spectrum of the residual on lines next to each harmonic
    whiteness            (...,)  p-value of a white residual, smallest over channels (Bonferroni); NaN where not tested
    notes                what was found on the way
    told                 (orders, channels)  share of an amplitude's information that comes from measured samples
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
    told: Real = field(default_factory=lambda: np.ones((1, 1)))

    def __call__(self, time: Real) -> Real:
        """The fitted signal at times in s: (..., times, channels)."""
        terms = Terms(self.degree, self.orders)
        A = terms.columns(np.asarray(time, dtype=float), self.frequency_hz, self.centre, self.half)
        return A @ terms.coefficients(self.trend, self.amplitudes)

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
    f = record.stated_hz if frequency_hz is None else frequency_hz
    if not (np.isfinite(f) and f > 0):
        raise DataError(f"frequency {f} Hz", record.source, "frequencies must be positive and finite")
    settings = conditioning_of(conditioning, treatments)
    asked = fit_harmonics, f, settings.wanted, settings.nuisance_orders, settings.degree, settings.noise
    if asked not in record.kept:
        terms = Terms(settings.degree, settings.wanted)
        check_length(record, f, terms)
        if settings.nuisance_orders is None:
            terms = _with_significant(record, f, terms)
        else:
            terms = replace(terms, orders=tuple(sorted({*terms.orders, *settings.nuisance_orders})))
            check_length(record, f, terms)
        record.kept[asked] = _fit(record, f, terms, settings.noise)
    return cast("HarmonicFit", record.kept[asked])


def _fit(record: Record, f: float, terms: Terms, noise: Noise) -> HarmonicFit:
    """With the white noise of the residual at every harmonic alike, or that on the lines next to each, which is chosen
    where it is another.  Raises DataError where it is asked for and the record is too short."""
    solution, samples = solve_harmonics(record, f, terms), len(record.time)
    sigma, exact, orders = solution.covariance, solution.exact(), len(terms.orders)
    sigma = np.where(exact[:, :, None] | exact[:, None, :], 0.0, sigma)
    level = np.broadcast_to(sigma[:, None].astype(complex), (len(sigma), orders, *sigma.shape[1:]))
    white = _seen_through(record, f, solution, level)
    if noise == "white":
        return white
    local, counts, products = _noise_beside(record, f, solution, sigma, exact)
    # What rounding leaves over in cells is no noise, nor are the digits of the numbers, which repeat with the drive:
    # no sensor is as quiet as a millionth of its amplitude
    quiet = exact | solution.exact(1e-6) | solution.in_cells
    p = _whiteness(products, sigma, quiet, local, counts, samples, samples - terms.count)
    white = replace(white, whiteness=p.reshape(white.whiteness.shape))
    # One decision for all repeats: more of them fail at 1 % than chance allows, and more than a few per cent
    tested, enough = p[np.isfinite(p)], bool(np.all(counts >= FEWEST_LINES))
    failed = int(np.sum(tested < SIGNIFICANT))
    chance = float(bdtrc(failed - 1, len(tested), SIGNIFICANT)) if failed else 1.0
    coloured = failed >= 0.03 * len(tested) and chance <= SIGNIFICANT * (1 + 1e-9)
    if noise == "blocks" and not enough:
        raise DataError(
            f"{white.periods:.3g} periods are too few to measure coloured noise at {f:g} Hz",
            record.source,
            'record at least eight periods, or use the noise model "white"',
        )
    if noise == "blocks" or (coloured and enough):
        apart = solution.in_cells[:, None] | solution.in_cells
        blocks = _seen_through(record, f, solution, np.where(apart, level, local))
        return replace(blocks, dof=2.0 * counts, noise="blocks", whiteness=white.whiteness)
    if not coloured:
        return white
    text = (
        f"the noise at {f:g} Hz is not white, but {white.periods:.3g} periods are too few to measure it; "
        "the intervals treat it as white"
    )
    return replace(white, notes=(record.notice("colour_unresolved", text),))


def _seen_through(record: Record, f: float, solution: HarmonicSolution, level: Complex) -> HarmonicFit:
    """The harmonics with the covariance of one sample, (batch, orders, channels, channels), that counts at each."""
    samples, channels = record.values.shape[-2:]
    leading, terms, orders = record.values.shape[:-2], solution.terms, len(solution.terms.orders)
    P, exact = _real_and_imaginary(solution.P, terms), solution.exact()
    spread = P[..., 0, 0] + P[..., 1, 1]  # (orders, channels)
    real = P * np.diagonal(level.real, axis1=-2, axis2=-1)[..., None, None]
    told = np.ones(spread.shape)
    if not np.all(record.whole_channels & ~solution.in_cells):
        of_all = _real_and_imaginary(solution.of_all[None], terms)
        told = np.minimum((of_all[..., 0, 0] + of_all[..., 1, 1]) / spread, 1.0)
    both = np.sqrt(spread[:, :, None] * spread[:, None, :])
    of_samples = np.where(exact[:, :, None] | exact[:, None, :], 0.0, solution.covariance)
    return HarmonicFit(
        record.channels,
        float(f),
        terms.orders,
        solution.amplitudes.reshape(*leading, orders, channels),
        (both * level).reshape(*leading, orders, channels, channels),
        real.reshape(*leading, orders, channels, 2, 2),
        solution.trend.reshape(*leading, terms.degree + 1, channels),
        *window(record.time),
        of_samples.reshape(*leading, channels, channels),
        samples,
        float(f * record.duration_s),
        np.full(orders, float(np.min(solution.free))),
        "white",
        np.full(leading, np.nan),
        told=told,
    )


def _real_and_imaginary(P: Real, terms: Terms) -> Real:
    """Covariance of (Re X, Im X) per unit variance of a sample, (orders, channels, 2, 2), from that of coefficients."""
    # (cos, sin) coefficients are (Re X, −Im X), hence the sign of the off-diagonal
    pair = terms.degree + 1 + 2 * np.arange(len(terms.orders))[:, None] + np.arange(2)
    blocks = P[:, pair[:, :, None], pair[:, None, :]] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.swapaxes(blocks, 0, 1)


def _with_significant(record: Record, f: float, terms: Terms) -> Terms:
    """The terms asked for and those harmonics that are there beyond doubt."""
    samples = len(record.time)
    if record.status is not None:
        samples = int(np.min(np.count_nonzero(record.status == 0, axis=0)))
    highest = min(HIGHEST_HARMONIC, highest_multiple(record, f), (samples - terms.degree - 1) // 6)
    candidates = [order for order in range(1, highest + 1) if order not in terms.orders]
    every = replace(terms, orders=tuple(sorted({*terms.orders, *candidates})))
    try:
        solution = solve_harmonics(record, f, every, sizes=False) if candidates else None
    except DataError:
        return terms  # the record cannot tell them apart
    if solution is None:
        return terms
    size, exact = np.abs(solution.amplitudes), solution.exact()
    strongest = np.maximum(np.max(size, axis=1), 1e-5 * solution.largest)
    level = SIGNIFICANT / (len(candidates) * exact.size)
    sizes = np.stack([size[:, every.orders.index(order)] for order in candidates], axis=-1)
    p = solution.tails([every.wave(order) for order in candidates])
    there = np.where(exact[..., None], sizes > 1e-9 * strongest[..., None], p < level)
    significant = np.array(candidates)[np.any(there, axis=(0, 1))].tolist()
    return replace(terms, orders=tuple(sorted([*terms.orders, *significant])))
