"""How large noise is: of samples at rest or near half their rate, of amplitudes by neighbouring lines or other dwells.

What residuals of a fit tell is found with the fit (`conditioning/harmonic_fit.py`, `estimate/likelihood`), by the same
two formulas: the mean power of what is left over its degrees of freedom, `smoothed` over neighbouring lines, and
`sizes_of_parts` that a variance is made of.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy import fft
from scipy.special import chdtrc, chdtri, digamma, gammaincinv, polygamma

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.conditioning.clock import even_step
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.notices import Notice

HALF_WINDOW = 30  # lines on either side over which noise is smoothed
Values = TypeVar("Values", Real, Complex)


def smoothed(values: Values, half_window: int = HALF_WINDOW) -> Values:
    """Mean over the nearest 2·half_window + 1 lines (axis 0), fewer lines on one side taken from the other."""
    lines = len(values)
    width = min(2 * half_window + 1, lines)
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    first = np.clip(np.arange(lines) - width // 2, 0, lines - width)
    return np.asarray((sums[first + width] - sums[first]) / width, dtype=values.dtype)


def sizes_of_parts(power: Real, parts: Real, left: Real | float, sizes: Real, steps: int = 200) -> Real:
    """Sizes (parts,) of the parts (rows, parts) of variances, from powers (rows,), shares `left` of which are expected.

    Each of at most so many steps raises the likelihood of powers that are γ-distributed about left · parts @ sizes, and
    restricted likelihood where `left` is what a fit has left of each (Zhou et al. 2019, Journal of Computational and
    Graphical Statistics 28).
    """
    largest = sizes.max()
    for _ in range(steps):
        variance = parts @ sizes
        shown, expected = (power / variance**2) @ parts, (left / variance) @ parts
        ratio = np.sqrt(shown / expected)
        sizes = np.maximum(sizes * ratio, 1e-9 * largest)  # of the larger part of a channel's noise
        each = sizes.tolist()
        largest = max(each)
        if all(
            abs(of - 1) < 1e-4 or size <= 1e-6 * largest
            for of, size in zip(ratio.tolist(), each, strict=True)
        ):
            break
    return sizes


def constant_and_share(variance: Real, power: Real) -> tuple[float, float]:
    """a² and b² of variances a² + b²|y|², as estimates of these (rows,) at powers |y|² (rows,) have them likeliest.

    Each estimate weighs by what is fitted there: by itself, those that happen to be small would count most.
    """
    size = float(np.mean(power))
    parts = np.stack([np.full(len(power), size), power], axis=1)
    # Before the first step half of the scatter each
    constant, share = sizes_of_parts(variance, parts, 1.0, np.full(2, 0.5 * float(np.mean(variance)) / size))
    return float(constant) * size, float(share)


# As at-rest records show it: the best there is, and cheap in the laboratory (THEORY §8).  A record may bring its own:
# before an earthquake, between the blows of a hammer.


BLOCK = 32  # samples, at least, of the parts of a record that may be at rest
IN_A_ROW = 8  # parts, at least: what moves at random is quiet for a part or two as well
QUIETEST = 0.05  # share of the parts that are at rest, if any are
STANDS_OUT = 4.0  # standard deviations of a mean power above that of noise: there is motion
LEVEL = 1e-3  # of all tests of what data are taken for: what is so is refused once in a thousand


@dataclass(frozen=True, eq=False)
class Still:
    """The noise of all channels as an at-rest record shows it: periodogram of its samples.

    frequency_hz (lines,); power (lines, channels, channels): 2/N of Σ Y Yᴴ smoothed over neighbouring lines, which is
    E[Δ Δᴴ] of peak amplitudes times the number of samples; dof: real degrees of freedom behind each line.
    """

    frequency_hz: Real
    power: Complex
    dof: float

    def covariance(self, frequency_hz: Real, samples: int) -> Complex:
        """V of peak amplitudes of a record of so many samples, (lines, channels, channels)."""
        at = np.searchsorted((self.frequency_hz[1:] + self.frequency_hz[:-1]) / 2, frequency_hz)
        return self.power[at] / samples


def noise_at_rest(records: Sequence[Record], *, source: str = "") -> Still:
    """The noise that records with nothing driven show, smoothed over neighbouring lines and over the records.

    The longest record gives the lines; raises DataError for uneven samples, records too short, and no records.
    """
    if not records:
        raise DataError("a noise record has samples, not amplitudes", source, "give a record over time")
    longest = max(records, key=lambda record: len(record.time))
    width, parts = 2 * HALF_WINDOW + 1, []
    for record in records:
        step = even_step(record)
        samples = len(record.time)
        lines = (samples - 1) // 2
        if lines < width:
            raise DataError(
                f"the at-rest record has only {samples} samples",
                record.source,
                f"at least {2 * width + 2} are needed",
            )
        centred = record.values - record.values.mean(axis=0)
        Y = fft.rfft(centred, axis=0)[1 : lines + 1] * (2 / samples)
        frequency = np.arange(1, lines + 1) / (samples * step)
        power = smoothed(np.einsum("lc,ld->lcd", Y, np.conj(Y))) * samples
        parts.append(Still(frequency, power, 2.0 * width))
    grid = parts[[record is longest for record in records].index(True)].frequency_hz
    total = np.zeros((len(grid), len(longest.channels), len(longest.channels)), dtype=np.complex128)
    dof = 0.0
    for part in parts:
        if part.power.shape[1:] != total.shape[1:]:
            raise DataError("the at-rest records have different channels", longest.source)
        total += part.dof * part.covariance(grid, 1)
        dof += part.dof
    return Still(grid, total / dof, dof)


def variance_at_rest(values: Real) -> float:
    """Variance of white noise in the samples of one channel, (samples,), while it is at rest; 0 where it never is.

    At rest are parts of the record in a row that vary alike, without colour, and far less than the others.
    """
    count = min(256, len(values) // BLOCK)  # parts, at most
    if count < 2 * IN_A_ROW:
        return 0.0
    size = len(values) // count
    parts = values[: count * size].reshape(count, size)
    along = np.linspace(-1.0, 1.0, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    parts = parts - (parts @ along / (along @ along))[:, None] * along
    dof = size - 2
    variance = np.sum(parts**2, axis=1) / dof
    quietest = max(IN_A_ROW, int(QUIETEST * count))
    level, still = float(np.median(np.sort(variance)[:quietest])), np.zeros(count, dtype=bool)
    for _ in range(count):
        # Those among IN_A_ROW quiet neighbours, the first and last of which may still move
        still = variance < level * (1 + STANDS_OUT * (2 / dof) ** 0.5)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        inner = np.zeros(len(still), dtype=bool)
        for first, end in edges.reshape(-1, 2).tolist():
            if end - first >= IN_A_ROW:
                inner[first + 1 : end - 1] = True
        before, still = still, inner
        if not np.any(still) or np.array_equal(before, still):
            break
        level = float(np.mean(variance[still]))
    # Parts at rest have at most a tenth of the mean power of all.
    if not np.any(still) or not 0 < level < 0.1 * float(np.mean(variance)):
        return 0.0
    steps = float(np.sum(np.diff(parts[still], axis=1) ** 2) / np.sum(parts[still] ** 2))
    white = abs(steps / 2 - 1) < STANDS_OUT / (np.sum(still) * dof) ** 0.5 + 2 / size
    return level if white and equal_variances(variance[still], float(dof)) > LEVEL else 0.0


# As the lines of a record show it near half the sampling rate, where nothing moves.


BIN = 30  # lines, at least, whose mean power says whether something moves there
TOP = (0.6, 0.98)  # of half the sampling rate: where the floor is read
ALIKE = 1.4  # by which the mean power of second differences scatters more: neighbours share lines
FAR_BELOW = 0.1  # of the mean power of the lines: a floor is noise, not motion


def without_leakage(Y: Complex) -> Real:
    """Power of neighbouring lines (k, ...) of a record without what its ends leak into them, (k − 2, ...).

    A record that ends elsewhere than it began leaks into all lines, smoothly from one to the next: second differences
    have none of it, and six times the power of what is independent from line to line.
    """
    return np.abs(np.diff(Y, 2, axis=0)) ** 2 / 6


def most_noise(Y: Complex) -> Real:
    """What white noise in neighbouring lines (k, ...) of a record can be at most, E|Δ|² (...,): by their quietest part.

    Its mean power over how low chance makes the least of so many means, which once in twenty is lower still.  Less than
    three lines show none: inf.
    """
    power = without_leakage(Y)
    if not len(power):
        return np.full(Y.shape[1:], np.inf)
    width = min(2 * HALF_WINDOW + 1, len(power))
    looks = width / ALIKE**2
    windows = 6 * len(power) / width  # that slide have chances as six times those side by side
    lowest = float(gammaincinv(looks, 0.05 / windows)) / looks
    least = np.maximum(np.min(smoothed(power), axis=0), np.finfo(float).eps * np.sum(power, axis=0))
    return np.asarray(least / lowest)


def white_floor(power: Real) -> float:
    """E[Δ Δ*] of white noise, from the power (N/2 + 1,) of the lines of one channel near half the sampling rate.

    0 if they are not flat, or not far below the others: then they show motion rather than noise.
    """
    top = power[int(TOP[0] * len(power)) : int(TOP[1] * len(power))]
    if len(top) < 2 * BIN:
        return 0.0
    low, high = sorted(float(np.mean(half)) for half in np.array_split(top, 2))
    level = (low + high) / 2
    even = high - low <= STANDS_OUT * ALIKE * level * 2 / len(top) ** 0.5
    return level if even and level < FAR_BELOW * float(np.mean(power[1:])) else 0.0


# As amplitudes for which none is given scatter about smooth curves over frequency.
#
# Amplitudes of densely spaced lines are smooth: about each line a complex polynomial goes through its neighbours, and
# what scatters about it is noise (Schoukens et al., Mechanical Systems and Signal Processing 20, 2006).  The scatter of
# all lines is drawn together as var = a² + b²|y|² for each channel (THEORY §11).  Where a polynomial of higher degree
# leaves much less, the lines are too far apart for the motion between them, and show no noise.


SMOOTH = "smooth"  # kind of noise
WINDOW = 9  # lines that a polynomial goes through
DEGREES = (3, 5)  # of the polynomial, and of the one that must leave as much


def with_local_noise(spectrum: Spectrum) -> Spectrum:
    """The same lines with the noise that they show; as they are where noise is known, or the lines are too far apart.

    A channel that is the same at all lines, as the input of a response function, is exact.
    """
    if spectrum.batch or spectrum.noise != ("unknown",) * spectrum.lines or spectrum.records:
        return spectrum
    covariance = np.zeros(spectrum.covariance.shape, dtype=np.complex128)
    dof = np.full(spectrum.lines, np.inf)
    for experiment in np.unique(spectrum.experiment):
        lines = np.flatnonzero(spectrum.experiment == experiment)
        lines = lines[np.argsort(spectrum.frequency_hz[lines], kind="stable")]
        f, y = spectrum.frequency_hz[lines], spectrum.amplitudes[lines]
        if len(lines) < 24 or np.any(np.diff(f) <= 0) or np.any(np.isnan(y)):  # lines of an experiment
            return spectrum
        behind = np.inf
        for c in range(y.shape[1]):
            if np.ptp(y[:, c].real) == 0 and np.ptp(y[:, c].imag) == 0:
                continue
            noise = _noise_of(f, y[:, c])
            if noise is None:
                return spectrum
            covariance[lines, c, c] = noise[0]
            behind = min(behind, noise[1])
        dof[lines] = behind
    if not np.any(covariance):
        return spectrum
    text = "no noise given: it is estimated from the scatter of the amplitudes about smooth curves over frequency"
    notes = (*spectrum.notes, Notice("noise_from_neighbours", text))
    return replace(spectrum, covariance=covariance, dof=dof, noise=(SMOOTH,) * spectrum.lines, notes=notes)


def _noise_of(f: Real, y: Complex) -> tuple[Real, float] | None:
    """Variance E|Δ|² of each line of a channel and the degrees of freedom behind it; None if none is to be seen."""
    low, high = (_about_polynomials(f, y, degree) for degree in DEGREES)
    # 1.5: ratio of the variances that the two leave, above which the lower one is bent
    straight: Bools = _drawn_together(low) <= 1.5 * _drawn_together(high)
    # 0.5: share of the lines at which it must not be
    # 1e-18 of the mean square of the motion
    if np.mean(straight) < 0.5 or np.median(low[straight]) < 1e-18 * float(np.mean(np.abs(y) ** 2)):
        return None
    constant, share = constant_and_share(low[straight], np.abs(y[straight]) ** 2)
    variance = constant + share * np.abs(y) ** 2
    # 0.3 of the motion: what scatters more is no noise about a curve
    if np.median(variance / np.maximum(np.abs(y) ** 2, 1e-300)) > 0.3**2:
        return None
    # Neighbouring windows share their lines: as many degrees of freedom as one window in WINDOW lines would give.
    free = 2.0 * (WINDOW - DEGREES[0] - 1) * np.sum(straight) / WINDOW
    return variance, float(free)


def _drawn_together(scatter: Real) -> Real:
    """The mean over neighbouring windows."""
    return np.convolve(np.pad(scatter, WINDOW // 2, mode="edge"), np.ones(WINDOW) / WINDOW, mode="valid")


def _about_polynomials(f: Real, y: Complex, degree: int) -> Real:
    """(lines,): variance E|Δ|² about a polynomial through the WINDOW lines nearest to each."""
    count = len(f)
    first = np.clip(np.arange(count) - WINDOW // 2, 0, count - WINDOW)
    at = first[:, None] + np.arange(WINDOW)
    t = f[at] - f[at].mean(axis=1, keepdims=True)
    t = t / np.max(np.abs(t), axis=1, keepdims=True)
    Q = np.linalg.qr(t[..., None] ** np.arange(degree + 1))[0]
    z = y[at]
    left = z - np.einsum("lwd,ld->lw", Q, np.einsum("lwd,lw->ld", Q, z))
    return np.sum(np.abs(left) ** 2, axis=1) / (WINDOW - degree - 1)


# Variances of short dwells, moderated by those of the others (Smyth 2004; THEORY §11).
#
# Stat. Appl. Genet. Mol. Biol. 3, article 3. A dwell of ten samples knows its noise to a factor of two. All
# dwells of a channel together show how the noise goes with the amplitude, and the scatter of ln s² about
# that line how far a single dwell may be from it: as if d₀ further samples had been seen. V = (d₀ V₀ + ν V)
# / (d₀ + ν), with d₀ + ν degrees of freedom.


FOR_A_SLOPE = (
    6  # lines from which on it is asked how the noise goes with the amplitude; below it is proportional
)


def moderated(spectrum: Spectrum, told: Real | None = None, *, kind: str = "white") -> Spectrum:
    """The same lines with the noise of those that have few samples moderated, and a note.

    told (lines, channels): share of an amplitude's information that the samples measured have.  It is unchanged where
    all have many samples.  Lines whose noise is of one `kind` are moderated, white noise estimated from samples or the
    scatter of periods; repeats share d₀.
    """
    chosen = np.array([each == kind for each in spectrum.noise]) & np.isfinite(spectrum.dof)
    # With 50 degrees of freedom a dwell knows its own noise well enough; fewer than three lines show nothing in common.
    short = chosen & (spectrum.dof < 50)
    if not np.any(short) or np.sum(chosen) < 3 or np.any(np.isnan(spectrum.amplitudes)):
        return spectrum
    lines = spectrum.select(np.flatnonzero(chosen).tolist())
    V = lines.covariance.reshape(-1, *lines.covariance.shape[-3:])
    count = lines.samples[:, None] * (1.0 if told is None else told[chosen])
    variance = np.diagonal(V, axis1=-2, axis2=-1).real
    level = variance * count / 4
    power = np.abs(lines.amplitudes).reshape(-1, *lines.amplitudes.shape[-2:]) ** 2
    usable = np.all((variance > 0) & (power > 0), axis=(0, 1))
    d0, fitted = _scatter(level, power, lines.dof, usable)
    if np.isfinite(d0):
        fitted = fitted + float(digamma(d0 / 2) - np.log(d0 / 2))
    d0 = min(d0, (len(lines.dof) - 2) * float(np.mean(lines.dof)))
    with np.errstate(divide="ignore", invalid="ignore"):
        s0 = np.where(usable, np.exp(fitted) * 4 / count, variance)
        correlation = V / np.sqrt(variance[..., :, None] * variance[..., None, :])
    share = lines.dof / np.sum(lines.dof)
    R = np.sum(np.nan_to_num(correlation) * share[:, None, None], axis=-3, keepdims=True)
    sd = np.sqrt(s0)
    V0: Complex = R * sd[..., :, None] * sd[..., None, :]
    prior = V0.reshape(lines.covariance.shape)
    nu = lines.dof
    channels = len(spectrum.channels)
    total = nu + d0
    weight = (nu / total)[:, None, None]
    V = weight * lines.covariance + (1 - weight) * prior
    # Too few samples in all for a weight that has a mean: the line counts for little, but counts.  The scatter of
    # amplitudes has two degrees of freedom for each complex number.
    # Below 4 degrees of freedom beyond the channels a weight has no mean.
    enough = np.maximum(total, (1 if kind == "white" else 2) * channels + 4.0)
    V = V * (enough / total)[:, None, None]
    covariance, dof = np.array(spectrum.covariance), np.array(spectrum.dof)
    covariance[..., chosen, :, :] = V
    dof[chosen] = enough
    few = int(np.sum(short))
    what = ("short dwell" if kind == "white" else "line") + ("s" if few > 1 else "")
    text = (
        f"the noise of {few} {what} ({np.min(nu):.3g} degrees of freedom) is pooled with that of all {len(nu)}, which "
        f"adds {d0:.3g} degrees of freedom to each"
    )
    note = Notice("noise_moderated", text)
    return replace(spectrum, covariance=covariance, dof=dof, notes=(*spectrum.notes, note))


def _scatter(level: Real, power: Real, nu: Real, usable: Bools) -> tuple[float, Real]:
    """d₀, and E ln s² of each line and channel as all dwells show it, (repeats, lines, channels)."""
    y = np.log(np.where(usable, level, 1.0)) - (digamma(nu / 2) - np.log(nu / 2))[:, None]
    x = np.log(np.where(usable, power, 1.0))
    known = polygamma(1, nu / 2)
    w = (1 / (known + 0.05))[:, None]
    x_mean, y_mean = (np.sum(w * v, axis=-2, keepdims=True) / np.sum(w) for v in (x, y))
    dx, dy = x - x_mean, y - y_mean
    slope, used = np.ones_like(x_mean), 1
    if y.shape[-2] >= FOR_A_SLOPE:
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = np.sum(w * dx * dy, axis=-2, keepdims=True) / np.sum(w * dx**2, axis=-2, keepdims=True)
        slope, used = np.clip(np.nan_to_num(slope, nan=1.0), 0.0, 1.0), 2
    fitted = y_mean + slope * dx
    left = (y - fitted)[..., usable]
    lines = y.shape[-2]
    if not left.size:
        return np.inf, fitted
    # Σ w r² has the expectation Σ w (trigamma(ν/2) + trigamma(d₀/2)) (lines − used) / lines.
    mean = float(np.mean(np.sum(w * left**2, axis=-2))) * lines / (lines - used)
    beyond = (mean - float(np.sum(w[:, 0] * known))) / float(np.sum(w))
    return (2 * _trigamma_inverse(beyond) if beyond > 0 else np.inf), fitted


def _trigamma_inverse(value: float) -> float:
    """x with ψ′(x) = value, by Newton's method on 1/ψ′ (Smyth 2004, appendix)."""
    x = 0.5 + 1 / value
    for _ in range(50):
        at = float(polygamma(1, x))
        step = at * (1 - at / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-10 * x:
            break
    return x


# Tests of variances, and independent tests taken together.


def together(tails: Iterable[Real | float | None]) -> float:
    """One p-value of independent ones: the squares of the normal numbers that have these are χ²; 1 of none."""
    every = [np.ravel(tail) for tail in tails if tail is not None]
    p = np.concatenate(every) if every else np.zeros(0)
    return float(chdtrc(len(p), np.sum(chdtri(1, np.clip(p, 1e-250, 1.0))))) if len(p) else 1.0


def equal_variances(variance: Real, dof: float) -> float:
    """p-value of variances (groups,), each of so many degrees of freedom, that differ by chance only; 1 of fewer than
    two.

    M. S. Bartlett (1937), Proceedings of the Royal Society A 160, 268.
    """
    groups = len(variance)
    if groups < 2 or not np.any(variance):
        return 1.0
    with np.errstate(divide="ignore"):
        statistic = dof * groups * (np.log(np.mean(variance)) - np.mean(np.log(variance)))
    return float(chdtrc(groups - 1, statistic / (1 + (groups + 1) / (3 * groups * dof))))
