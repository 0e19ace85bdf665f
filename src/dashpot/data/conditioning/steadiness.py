"""Whether dwells are steady sines: what each may contain in addition, tested over all dwells together.

Each test gives p-values of single dwells, or of their channels, which `together` makes one.  Terms that a regression
may have more are tested by `Nested`, what changes from one whole period to the next by `Blocks`.  `UNSTEADY` has what
makes dwells whole records; `settled` is the part of one that is driven and where its transient has decayed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import chdtrc, fdtrc

from dashpot.arrays import Complex, Frozen, Ints, Real
from dashpot.data.conditioning.harmonic_fit import SIGNIFICANT
from dashpot.data.conditioning.regression import (
    CHUNK,
    Terms,
    highest_multiple,
    solve_harmonics,
    turning,
    window,
)
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.noise import LEVEL, together
from dashpot.data.periods import ROUNDING
from dashpot.data.record import Record, kept
from dashpot.errors import DataError
from dashpot.notices import Notice

# In fewer a transient, drift of a sensor, another frequency and a sine that grows look alike
FEW_PERIODS = 2.0
MANY_PERIODS = 8  # from which on noise is seen next to a sine and from period to period


# Terms of a regression


BESIDE = (1, 2, 3)  # multiples solved for in addition to the fundamental, from 24 samples on
SLIGHT_DRIFT = 5e-4  # of an amplitude: a drift by less spoils no more than gains are known to


@dataclass(frozen=True)
class Nested:
    """Terms that a dwell may have more, and which of their columns those are.

    common: columns P_1 cos and P_1 sin that all channels have by one factor, of their amplitude or of their phase; else
    each has its own
    """

    terms: Terms
    columns: tuple[int, ...] = (-2, -1)
    common: Literal["amplitude", "phase"] | None = None

    def tails(self, record: Record) -> Real | float | None:
        """p-values of a dwell without them, of each channel with noise or of all; None where the samples do not tell.

        A channel without noise has them where they are no rounding.
        """
        terms, samples, f = self.terms, len(record.time), record.frequency_hz
        if f is None:
            return None
        if terms.orders == BESIDE and (samples < 24 or BESIDE[-1] > highest_multiple(record, f)):
            terms = replace(terms, orders=(1,))
        try:
            if self.common is not None:
                return common_ramp(record, f, terms, self.common).tail
            solution = solve_harmonics(record, f, terms)
        except DataError:
            return None
        if np.min(solution.free) < 1:
            return None
        noisy, some = ~solution.exact(), solution.coefficients[:, list(self.columns)]
        there = np.any(np.abs(some) > ROUNDING * solution.largest[:, None], axis=1)
        p = np.where(noisy, solution.tails([self.columns])[..., 0], 0.0)
        return np.asarray(p[noisy | there])


@dataclass(frozen=True)
class CommonRamp:
    """κ of channels X (1 + κ s), or X (1 − jκ s) for the phase, s running from −1 to 1 in the dwell.

    information  1 over the variance of κ if the noise is white and each channel has its own; 0 where nothing moves
    variance     of κ with noise that channels have in common
    widening     by which it grows where the channels contradict each other: what they share is one drive
    free         degrees of freedom of a channel's residual
    """

    kappa: float
    information: float
    variance: float
    widening: float
    free: float

    @property
    def tail(self) -> float | None:
        """p-value of κ being slight; None where nothing tells."""
        if self.free < 1 or self.information <= 0:
            return None
        variance = max(self.variance, self.widening / self.information) + SLIGHT_DRIFT**2
        return float(fdtrc(1, self.free, self.kappa**2 / variance))


def common_ramp(record: Record, f: float, terms: Terms, of: Literal["phase", "amplitude"]) -> CommonRamp:
    """The ramp of phase or of amplitude at f Hz together with other terms, over all channels and repeats.

    The columns s cos and s sin (s = (t − centre)/half) of a signal a cos + b sin have the coefficients κ (b, −a) where
    its phase runs, and κ (a, b) where its amplitude grows.  Raises DataError as `solve_harmonics`.
    """
    solution = solve_harmonics(record, f, terms)
    free, X = float(np.min(solution.free)), solution.amplitudes[:, 0]
    ramp = np.swapaxes(solution.coefficients[:, -2:], 1, 2)
    noise = solution.squares / max(free, 1) if record.status is None else solution.covariance
    size = np.abs(X) ** 2
    floor = np.maximum(1e-24 * size, (np.finfo(float).eps * solution.largest) ** 2)
    variance = np.maximum(np.diagonal(noise, axis1=1, axis2=2), np.where(floor > 0, floor, 1.0))
    weight = np.where(size > 0, 1 / variance, 0.0)
    P = solution.P[:, -2:, -2:]
    along = np.stack([-X.imag, -X.real] if of == "phase" else [X.real, -X.imag], axis=-1)
    inside = np.linalg.solve(P, along[..., None])[..., 0]
    each = weight * np.sum(along * inside, axis=-1)
    information = float(np.sum(each))
    if information <= 0:
        return CommonRamp(0.0, 0.0, np.inf, 1.0, free)
    by_channel = weight * np.sum(ramp * inside, axis=-1)
    kappa = float(np.sum(by_channel)) / information
    telling = each > 0
    apart = float(np.sum((by_channel[telling] - each[telling] * kappa) ** 2 / each[telling]))
    look = np.einsum("cij,bci->bcj", np.linalg.cholesky(P), weight[..., None] * inside)
    shared = float(np.einsum("bcj,bcd,bdj->", look, noise, look)) / information**2
    return CommonRamp(kappa, information, shared, _contradiction(apart, int(np.sum(telling)) - 1), free)


def _contradiction(apart: float, others: int) -> float:
    """χ² over its degrees of freedom where that is significant, else 1."""
    contradicted = others > 0 and float(chdtrc(others, apart)) < LEVEL
    return apart / others if contradicted else 1.0


# Whole periods of a dwell


MOST = 32  # blocks, of more periods each where there are many
SAMPLES = 8  # that a block has on average, at least


@dataclass(frozen=True)
class Blocks(Frozen):
    """An offset and a sine in each of some pieces of a dwell, by the samples measured.

    starts, ends (pieces,): the first sample of each and the one after its last
    amplitudes at the drive frequency; squares that are left over; spread of an amplitude per unit variance of a sample;
    free degrees of freedom: (pieces, batch · channels)
    """

    starts: Ints
    ends: Ints
    amplitudes: Complex
    squares: Real
    spread: Real
    free: Real

    @property
    def rms(self) -> Real:
        """Of what the sine leaves in each, (pieces, batch · channels)."""
        return np.asarray(np.sqrt(self.squares / (self.free + 3)))

    @staticmethod
    def of(record: Record, f: float, starts: Ints, ends: Ints) -> Blocks:
        """Pieces from one sample to the one before another.  Raises LinAlgError where the terms are not to be told."""
        longest, found = int(np.max(ends - starts)), []
        each = max(1, CHUNK // longest)
        for k in range(0, len(starts), each):
            rows = starts[k : k + each, None] + np.arange(longest)
            inside = rows < ends[k : k + each, None]
            rows = np.where(inside, rows, 0)
            turn = turning(f, record.time[rows])
            A = np.stack([np.ones(turn.shape), turn.real, turn.imag], axis=-1) * inside[..., None]
            y = np.moveaxis(record.values[..., rows, :], -1, -3).reshape(-1, *rows.shape).swapaxes(0, 1)
            y = y - np.mean(y, axis=-1, keepdims=True)
            counts, B = inside[:, None], A[:, None]  # (pieces, channels or 1, samples, terms)
            if record.status is not None:
                counts = np.moveaxis(record.status[rows] == 0, -1, 1) & counts
                B = B * counts[..., None]
            P = np.linalg.pinv(np.swapaxes(B, -1, -2) @ B, rcond=1e-12, hermitian=True)
            c = (P @ (np.swapaxes(B, -1, -2) @ y[..., None]))[..., 0]
            left = (y - (A[:, None] @ c[..., None])[..., 0]) * counts
            free = np.broadcast_to(np.sum(counts, axis=-1) - 3.0, c.shape[:2])
            spread = np.broadcast_to(P[..., 1, 1] + P[..., 2, 2], c.shape[:2])
            found.append((c[..., 1] - 1j * c[..., 2], np.sum(left**2, axis=-1), spread, free))
        return Blocks(starts, ends, *(np.concatenate(of) for of in zip(*found, strict=True)))


@kept
def period_blocks(record: Record) -> Blocks | None:
    """Blocks of whole periods, counted from the end; None where these are too few, or have gaps."""
    f, time, periods = record.frequency_hz, record.time, int(record.periods + 1e-6)
    each = max(1, periods // MOST, int(np.ceil(SAMPLES * periods / len(time))))
    blocks = periods // each
    if f is None or blocks < MANY_PERIODS:
        return None
    step = record.step_s
    starts = np.searchsorted(time, time[-1] + step - (each / f) * np.arange(blocks, 0, -1) - step / 4)
    ends = np.append(starts[1:], len(time))
    return None if np.min(ends - starts) < 4 else Blocks.of(record, f, starts, ends)


# The drive frequency wanders: it turns the phase of all channels together and leaves their amplitudes nearly as they
# are.  Noise, whatever its colour and however alike in the channels, and transients do as much to the one as to the
# other: so the scatter of the common phase over blocks is tested against that of the common amplitude.  Stamps that
# jitter turn the phase, too, but from sample to sample: what that explains of the scatter is no wandering.


ROUNDED = 1e-6  # of an amplitude, and rad: what scatters less is exact


@kept
def _wander(record: Record) -> float | None:
    """p-value of one dwell having one frequency; None where it has too few periods, or repeats."""
    record = wholly_measured(record)
    f = record.frequency_hz
    blocks = None if record.values.ndim != 2 else period_blocks(record)
    if f is None or blocks is None or not np.any(np.ptp(record.values, axis=0)):
        return None
    # Two neighbouring blocks under Hann's window, which keeps noise at low frequencies, and a slope, from doing more to
    # one phase than to the other
    starts, ends = blocks.starts[:-1], blocks.ends[1:]
    counts = (ends - starts)[:, None]
    k = np.arange(int(np.max(counts)))
    inside = k < counts
    rows = np.where(inside, starts[:, None] + k, 0)
    hann = np.sin(np.pi * (k + 0.5) / counts) ** 2 * inside
    turned = np.exp(-2j * np.pi * f * record.time[rows]) * inside
    carrier = (2 * hann * turned / np.sum(hann, axis=1, keepdims=True))[..., None]
    values = record.values[rows] - np.mean(record.values, axis=0)
    Z = np.sum(carrier * values, axis=1)
    even = (values - np.sum(values * inside[..., None], axis=1, keepdims=True) / counts[..., None]) * inside[
        ..., None
    ]
    sine = 2 * np.swapaxes(turned[:, None] @ even, 1, 2)[..., 0] / counts
    # What each sample adds to the amplitude beyond a steady sine, (windows, samples, channels)
    left = carrier * (even - (np.conj(turned)[..., None] * sine[:, None]).real)
    noise, size = np.median(blocks.rms, axis=0), np.mean(np.abs(Z), axis=0)
    weight = np.where(size > 0, 1 / np.where(size > 0, noise**2 + (ROUNDED * size) ** 2, 1.0), 0.0)
    turns = np.angle(np.sum(weight * Z[1:] * np.conj(Z[:-1]), axis=1))
    phase = np.concatenate([[0.0], np.cumsum(turns)])
    mean = np.mean(Z * np.exp(-1j * phase)[:, None], axis=0)
    look = weight * np.conj(mean) / float(np.abs(mean) ** 2 @ weight)
    common = np.exp(-1j * phase) * (Z @ look)
    phase = phase + np.angle(common)
    each = (left @ look) * np.exp(-1j * phase)[:, None]
    jitter = max(float(np.sum(each.imag**2) - np.sum(each.real**2)) / len(Z), 0.0)
    freedom = len(Z) - 2
    line = np.linalg.qr(legvander(np.linspace(-1, 1, len(Z)), 1))[0]
    both = np.stack([phase - phase[0], np.abs(common)], axis=1)
    of_phase, of_amplitude = np.sum((both - line @ (line.T @ both)) ** 2, axis=0) / freedom + ROUNDED**2
    return float(fdtrc(freedom, freedom, of_phase / (of_amplitude + jitter)))


# The drive's amplitude drifts: it scales the motion of all channels by one factor that changes slowly.  A sine of one
# amplitude counts the change as noise, and the rig, whose response lags behind its drive, is not the one that ratios of
# the channels show.  What changes in one channel alone, by its sensor or by hum, is no drive: there channels contradict
# each other.


AMPLITUDE = Nested(Terms(1, BESIDE, 1), common="amplitude")  # in few periods
BENT_AMPLITUDE = 2  # degree of the polynomial that the amplitude of many periods may follow


def _fading(record: Record) -> float | None:
    """p-value of one dwell having one amplitude; None where it has too few periods, or repeats.

    Of many periods by F of a slow change of the common amplitude over its scatter from block to block, which knows the
    noise.  The first eighth of the blocks has no say: what decays there is a transient, which has a test of its own.
    """
    record = wholly_measured(record)
    if record.values.ndim != 2 or record.periods < FEW_PERIODS or not record.channels:
        return None
    blocks = period_blocks(record)
    if blocks is None:
        return cast("float | None", AMPLITUDE.tails(record))
    size = np.abs(blocks.amplitudes[len(blocks.amplitudes) // 8 :])
    mean, noise = np.mean(size, axis=0), np.median(blocks.rms, axis=0)
    moves = mean > 0
    if not np.any(moves):
        return None
    relative = size[:, moves] / mean[moves]
    weight = 1 / ((noise[moves] / mean[moves]) ** 2 + SLIGHT_DRIFT**2)
    both = np.column_stack([relative, relative @ weight / np.sum(weight)])
    slow = np.linalg.qr(legvander(np.linspace(-1, 1, len(both)), BENT_AMPLITUDE))[0][:, 1:]
    away = both - np.mean(both, axis=0)
    along = slow.T @ away
    free = len(both) - 1 - BENT_AMPLITUDE
    left = np.sum(away**2, axis=0) - np.sum(along**2, axis=0)
    variance = np.maximum(left, 0.0) / free + SLIGHT_DRIFT**2
    apart = float(np.sum(np.sum((along[:, :-1] - along[:, -1:]) ** 2, axis=0) / variance[:-1]))
    widening = _contradiction(apart, BENT_AMPLITUDE * (relative.shape[1] - 1))
    F = float(np.sum(along[:, -1] ** 2)) / BENT_AMPLITUDE / (variance[-1] * widening)
    return float(fdtrc(BENT_AMPLITUDE, free, F))


def wholly_measured(record: Record) -> Record:
    """The record with only those channels whose every sample is measured.

    Where their peaks are clipped the others know little of the amplitude.
    """
    whole = record.whole_channels
    if np.all(whole):
        return record
    channels = tuple(record.channels[c] for c in np.flatnonzero(whole))
    return replace(record, channels=channels, values=record.values[..., whole], status=None)


# Dwells have not settled: their first period is another than their last.  What a long dwell shows in its first period
# hardly reaches its amplitude, and the noise next to its line contains it.


CLEAR = 6.0  # standard deviations of a change that no drift of a sensor makes: one of them is enough
SEEN = 3.0  # and of changes that are transients where there are many
MANY = 0.1  # of all dwells and channels
SLIGHT = 3e-3  # of an amplitude: what a transient may leave in it of a long dwell, whose noise contains it
FEWEST_A_BLOCK = 6  # samples, for amplitudes of single periods with a residual


def transients_show(records: Sequence[Record]) -> float:
    """p-value of no change from the first period of any dwell to its last."""
    return together(change[0] for change in map(first_to_last, records) if change is not None)


def settling(records: Sequence[Record]) -> float:
    """As `transients_show`, and 1 where changes are neither clear in some channel nor seen in many."""
    changes = [change[1] for change in map(first_to_last, records) if change is not None]
    beyond = np.concatenate([*changes, np.zeros(0)])
    clear, many = np.any(beyond > CLEAR), np.sum(beyond > SEEN) > MANY * len(beyond)
    return transients_show(records) if clear or many else 1.0


def shows_settling(record: Record) -> bool:
    """Whether a dwell has a first and a last block of whole periods, whose comparison tells if it has settled."""
    return _block(record) is not None


def _block(record: Record) -> tuple[int, int] | None:
    """Samples and periods of the shortest block that gives an amplitude; None where no two fit into the dwell."""
    if record.frequency_hz is None or record.values.ndim != 2:
        return None
    period, step = 1 / record.frequency_hz, record.step_s
    if not 2 * step < period < 1e9 * step:  # of more samples a period the stamps are damaged
        return None
    periods = max(1, int(np.ceil((FEWEST_A_BLOCK - 0.5) * step / period)))
    each = round(periods * period / step)
    return (each, periods) if len(record.time) >= 2 * each else None


@kept
def first_to_last(record: Record) -> tuple[Real, Real] | None:
    """How the amplitudes of a dwell's channels change from its first period to its last, of those with noise,
    (channels,): p-values of that being noise; by how many standard deviations, 0 where the change, spread over all
    periods, is less than gains are known to.  None where it has no two blocks to compare.
    """
    block, f, time = _block(record), record.frequency_hz, record.time
    if block is None or f is None:
        return None
    each, periods = block
    count = len(time) // each
    later = count - count // 2 if count >= MANY_PERIODS else 0
    first = np.array([0, *(len(time) - each * k for k in range(max(later, 1), 0, -1))])
    stamps = time[first[:, None] + np.arange(each)]
    # Whether each holds a period, as of `holds_a_period`
    if np.any(f * (stamps[:, -1] - stamps[:, 0] + 2 * np.max(np.diff(stamps), axis=1, initial=0.0)) < 1):
        return None
    # The record without the slope that it has in addition to its sine: seen through a period at another phase, that
    # looks like a change of amplitude
    try:
        slope = solve_harmonics(record, f, Terms()).coefficients[0, 1]
    except DataError:
        return None
    centre, half = window(time)
    record = replace(record, values=record.values - ((time - centre) / half)[:, None] * slope)
    sines = Blocks.of(record, f, first, first + each)
    difference = sines.amplitudes[0] - sines.amplitudes[-1]
    if later:
        # The scatter of the later periods knows the colour of the noise.
        variance = 2 * np.var(sines.amplitudes[1:], axis=0, ddof=1)
        dof = np.full(len(variance), 2.0 * (later - 1))
    else:
        # What a sine leaves of the first period is no noise: a transient that decays in it would hide itself.
        begin = len(time) - each * (count - 1)
        rest = Blocks.of(record, f, np.array([begin]), np.array([len(time)]))
        dof = rest.free[0]
        if np.min(dof) < 1:
            return None
        variance = 2 * rest.spread[0] * rest.squares[0] / dof * (count - 1)
    noisy = variance > (ROUNDING * np.max(np.abs(record.values), axis=0)) ** 2
    size, F = np.abs(difference[noisy]), np.abs(difference[noisy]) ** 2 / variance[noisy]
    share = size / (np.maximum(np.abs(sines.amplitudes[-1][noisy]), 1e-300) * count * periods)
    slight = SLIGHT if count * periods >= MANY_PERIODS else SLIGHT_DRIFT
    return fdtrc(2, dof[noisy], F), np.where(share > slight, np.sqrt(F), 0.0)


# Dwells of less than two periods have no first to set against a last.  A transient, or a frequency that is off, bends
# the offset and lets amplitude and phase run: two more polynomials and the sine times time, besides harmonics where
# there are samples enough, explain more of the residual than noise would.


BENDS = Nested(Terms(3, BESIDE, 1), (2, 3, -2, -1))


def bending(records: Sequence[Record]) -> float:
    """p-value of dwells of less than two periods being steady sines; 1 where few of all dwells are none."""
    short = [record for record in records if record.values.ndim == 2 and 0 < record.periods < FEW_PERIODS]
    tails = [np.asarray(tail) for tail in map(BENDS.tails, short) if tail is not None]
    bent = sum(bool(np.any(tail < LEVEL / max(tail.size, 1))) for tail in tails)
    return together(tails) if bent > MANY * len(records) else 1.0


@dataclass(frozen=True)
class Unsteady:
    """What makes dwells other than steady sines: p-value of all dwells without it, the level of the test, whether the
    settings leave it open, the reason that is given where they are used as whole records, the notice's code and text
    where they count as steady."""

    p: Callable[[Sequence[Record]], float]
    level: float
    asked: Callable[[Conditioning], bool]
    why: str
    code: str
    ignored: str

    def shows(self, records: Sequence[Record]) -> bool:
        """Whether all dwells together show it."""
        return self.p(records) < self.level


def _settling_asked(settings: Conditioning) -> bool:
    plain = settings.settle == "none" and settings.refine != "always"
    return plain and settings.transients in ("auto", "settle")


IGNORED = "within a dwell, but the dwells are treated as steady"
WANDERS = Unsteady(
    lambda records: together(map(_wander, records)),
    1e-4,
    lambda settings: settings.refine == "auto",
    "not steady (the drive frequency drifts)",
    "drive_wanders",
    f"the drive frequency drifts {IGNORED}",
)
FADES = Unsteady(
    lambda records: together(map(_fading, records)),
    LEVEL,
    lambda settings: settings.refine != "none" or settings.dwells_may_be_whole,
    "not steady (the drive amplitude drifts)",
    "drive_fades",
    f"the drive amplitude drifts {IGNORED}",
)
_IGNORED = "transients_ignored", "the dwells have not reached steady state, but are treated as settled"
UNSETTLED = Unsteady(settling, LEVEL, _settling_asked, "not settled", *_IGNORED)
BENT = Unsteady(bending, LEVEL, _settling_asked, "not steady sines", *_IGNORED)
UNSTEADY = (WANDERS, FADES, UNSETTLED, BENT)


# A slope that is taken out of a dwell of one period costs up to a half of its standard deviation, of five periods 1 %;
# one that is left in spoils the amplitude.  So it is taken out of short dwells where all of them together show it, and
# of long ones always (THEORY §11).


SLOPE_LEVEL = 0.05  # of the test: a slope too many costs less than one too few
CHEAP = 5.0  # periods from which on a slope costs nothing


def slopes_show(records: Sequence[Record], orders: Sequence[int]) -> float:
    """p-value of no slope in any dwell or channel, whose motion has these multiples of its frequency."""
    return together(map(Nested(Terms(1, tuple(orders)), (1,)).tails, records))


# The part of a dwell that is driven and where the transient has decayed.


@dataclass(frozen=True)
class Settled:
    """The part of a dwell that is driven and where the transient has decayed, and what was thrown away around it.

    `note` says so in words; it is None where nothing was thrown away and a transient would have been seen.
    """

    record: Record
    dropped_samples: int
    dropped_s: float
    note: Notice | None


def settled(record: Record) -> Settled:
    """The part of a dwell that is driven, after its transient.

    Blocks of whole periods, counted from the end, give amplitudes and residuals.  The longest run of blocks with more
    than half of the greatest lasting amplitude is what was driven.  Within it the cut is where the mean of what
    remains is known best (White's marginal standard error rule, Simulation 69, 1997), at most half way, and only if
    what comes before it differs significantly (p < 0.01) from what comes after.  A small error of the frequency does
    not matter.  Raises DataError where the frequency is not known.
    """
    f, time = record.stated_hz, record.time
    blocks = period_blocks(record)
    if blocks is None:
        text = f"{int(record.periods + 1e-6)} periods at {f:g} Hz are too few to detect a transient, or have gaps"
        return Settled(record, 0, 0.0, record.notice("transient_undetectable", text))
    starts, Z, rms = blocks.starts, blocks.amplitudes, blocks.rms
    begin, end = _driven(Z)
    if end - begin >= 8:
        # Features of blocks, in units of their scatter over the last half: amplitudes turned by the phase of the
        # steadiest channel, which makes them blind to a small error of the frequency, and residual rms
        Z = Z[begin:end]
        tail = len(Z) // 2
        size = np.median(np.abs(Z), axis=0)
        floor = np.maximum(1e-9 * size, 1e-13 * float(np.max(np.abs(record.values)))) + np.finfo(float).tiny
        steady = int(np.argmax(size / np.maximum(np.std(np.abs(Z[tail:]), axis=0), floor)))
        turned = Z * np.exp(-1j * np.angle(Z[:, steady]))[:, None]
        values = np.concatenate([turned.real, turned.imag, rms[begin:end]], axis=1)
        scatter = np.maximum(np.std(values[tail:], axis=0, ddof=1), np.tile(floor, 3))
        begin += _truncation((values - np.mean(values[tail:], axis=0)) / scatter)
    first = 0 if begin == 0 else int(starts[begin])
    last = len(time) if end == len(starts) else int(starts[end])
    dropped = len(time) - (last - first)
    if not dropped:
        return Settled(record, 0, 0.0, None)
    kept = record.part(slice(first, last))
    what = [f"the first {time[first] - time[0]:.4g} s"] * (first > 0) + [
        f"the last {time[-1] - time[last - 1]:.4g} s"
    ] * (last < len(time))
    whole = float(time[-1] - time[0])
    text = f"discarded {' and '.join(what)} of {whole:.4g} s at {f:g} Hz (transient)"
    note = record.notice("transient_discarded", text)
    return Settled(kept, dropped, float(time[-1] - time[0] - (kept.time[-1] - kept.time[0])), note)


@kept
def driven_throughout(record: Record) -> bool:
    """Whether a dwell moves from its first period to its last; True where it has too few periods to tell."""
    blocks = period_blocks(record) if record.values.ndim == 2 else None
    if blocks is None:
        return True
    Z = blocks.amplitudes
    noise = np.median(blocks.rms, axis=0) * np.sqrt(4 / np.min(blocks.ends - blocks.starts))
    heard = (
        _level(np.abs(Z)) > 6 * noise
    )  # standard deviations of a block's amplitude: no other channel tells
    return not np.any(heard) or _driven(Z[:, heard]) == (0, len(Z))


def _driven(Z: Complex) -> tuple[int, int]:
    """Longest run of driven blocks, [begin, end); those in which the drive comes or goes are left out.

    A channel's level is the greatest that it keeps for four blocks.
    """
    size = np.abs(Z)
    level = _level(size)
    on = np.ones(len(Z), dtype=bool)
    if np.any(level > 0):
        on = np.median(size[:, level > 0] / level[level > 0], axis=1) > 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]])))
    runs = edges.reshape(-1, 2)
    begin, end = (int(k) for k in runs[np.argmax(runs[:, 1] - runs[:, 0])])
    if end - begin < 4:
        return 0, len(Z)
    return begin + (begin > 0), end - (end < len(Z))


def _level(size: Real) -> Real:
    """The greatest amplitude that each channel keeps for four blocks, (channels,), of (blocks, channels)."""
    return np.max(np.min(np.lib.stride_tricks.sliding_window_view(size, 4, axis=0), axis=-1), axis=0)


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
