"""The true frequency of the drive, near the stated one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy import fft
from scipy.special import chdtrc, fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.conditioning.clock import FEWEST_OF_A_DWELL
from dashpot.data.conditioning.regression import check_length, duration, solve_harmonics, window
from dashpot.data.conditioning.settings import USUAL_DRIFT, Conditioning, Drift
from dashpot.data.conditioning.transients import BESIDE, MANY_SAMPLES, PeriodBlocks, period_blocks, periods_of
from dashpot.data.record import Record
from dashpot.errors import DataError, Problem
from dashpot.notices import Notice
from dashpot.numerics.variance_tests import fishers_product

# Whether the drive frequency of dwells wanders while they last: then they are no steady sines.
#
# A frequency that wanders turns the phase of all channels together and leaves their amplitudes nearly as
# they are. Noise, whatever its colour and however alike in the channels, and transients do as much to the
# one as to the other: so the scatter of the common phase over blocks of whole periods is tested against
# that of the common amplitude. Stamps that jitter turn the phase, too, but from sample to sample: what that
# explains of the scatter is no wandering.


LEVEL = 1e-4  # of the test for a frequency that wanders
ROUNDED = 1e-6  # of an amplitude, and rad: what scatters less is exact


def drive_wanders(records: Sequence[Record]) -> float:
    """p-value of every dwell having one frequency: Fisher's product of the F tests of all dwells.

    1 where no dwell has blocks enough to tell.
    """
    return float(fishers_product([p for p in map(_steady, records) if p is not None]))


def _steady(record: Record) -> float | None:
    """p-value of one dwell having one frequency; None where it has too few periods, or repeats."""
    record = _wholly_measured(record)
    f = record.frequency_hz
    blocks = None if f is None or record.values.ndim != 2 else period_blocks(record, f)
    if f is None or blocks is None or not np.any(np.ptp(record.values, axis=0)):
        return None
    windows = [
        _Window.of(record, f, *edges) for edges in zip(blocks.starts[:-1], blocks.ends[1:], strict=True)
    ]
    Z = np.array([each.amplitude for each in windows])
    noise = np.median(blocks.rms, axis=0)
    size = np.mean(np.abs(Z), axis=0)
    weight = np.where(size > 0, 1 / np.where(size > 0, noise**2 + (ROUNDED * size) ** 2, 1.0), 0.0)
    turns = np.angle(np.sum(weight * Z[1:] * np.conj(Z[:-1]), axis=1))
    phase = np.concatenate([[0.0], np.cumsum(turns)])
    mean = np.mean(Z * np.exp(-1j * phase)[:, None], axis=0)
    look = weight * np.conj(mean) / float(np.abs(mean) ** 2 @ weight)
    common = np.exp(-1j * phase) * (Z @ look)
    phase = phase + np.angle(common)
    looks = look * np.exp(-1j * phase)[:, None]
    jitter = max(float(np.mean([each.jitter(way) for each, way in zip(windows, looks, strict=True)])), 0.0)
    freedom = len(Z) - 2
    of_phase, of_amplitude = (_about_a_line(x) / freedom + ROUNDED**2 for x in (phase, np.abs(common)))
    return float(fdtrc(freedom, freedom, of_phase / (of_amplitude + jitter)))


@dataclass(frozen=True)
class _Window:
    """Two neighbouring blocks under Hann's window.

    It keeps noise at low frequencies, and a slope, from doing more to one phase than to the other.

    amplitude (channels,): at the drive's frequency; left (samples, channels): what each sample adds to it beyond a
    steady sine
    """

    amplitude: Complex
    left: Complex

    @staticmethod
    def of(record: Record, f: float, first: int, last: int) -> _Window:
        t = record.time[first:last]
        values = record.values[first:last] - np.mean(record.values, axis=0)
        share = (np.arange(len(t)) + 0.5) / len(t)
        hann = np.sin(np.pi * share) ** 2
        turned = np.exp(-2j * np.pi * f * t)
        carrier = (2 * hann * turned / np.sum(hann))[:, None]
        even = values - np.mean(values, axis=0)
        steady = np.outer(np.conj(turned), 2 * np.mean(turned[:, None] * even, axis=0)).real
        return _Window(np.sum(carrier * values, axis=0), carrier * (even - steady))

    def jitter(self, look: Complex) -> float:
        """Variance of the common phase that samples out of time with each other explain, look (channels,).

        Stamps that jitter turn the phase from sample to sample, in all channels alike; noise beside them is as large
        in phase as in amplitude.
        """
        each = self.left @ look
        return float(np.sum(each.imag**2) - np.sum(each.real**2))


def _about_a_line(x: Real) -> float:
    """Sum of squares about the line through x, (blocks,)."""
    index = np.arange(len(x)) - (len(x) - 1) / 2
    away = x - np.mean(x)
    away = away - index * (index @ away) / (index @ index)
    return float(away @ away)


# The sine of a dwell times time: how far all channels together turn or grow while the dwell lasts.


CONTRADICTED = 1e-3  # level of the test whether the channels agree


@dataclass(frozen=True)
class CommonRamp:
    """κ of channels X (1 + κ s), or X (1 − jκ s) for the phase, s running from −1 to 1 in the dwell.

    information  1 over the variance of κ if the noise is white and each channel has its own; 0 where nothing moves
    variance     of κ with noise that channels have in common
    apart        χ² of the channels' own κ about the common one, `others` degrees of freedom
    free         degrees of freedom of a channel's residual
    """

    kappa: float
    information: float
    variance: float
    apart: float
    others: int
    free: float

    @property
    def widening(self) -> float:
        """By which the variance of κ grows where the channels contradict each other: what they share is one drive."""
        return contradiction(self.apart, self.others)


def contradiction(apart: float, others: int) -> float:
    """χ² over its degrees of freedom where that is significant, else 1."""
    contradicted = others > 0 and float(chdtrc(others, apart)) < CONTRADICTED
    return apart / others if contradicted else 1.0


def common_ramp(
    record: Record, f: float, degree: int, of: Literal["phase", "amplitude"], orders: Sequence[int] = (1,)
) -> CommonRamp:
    """The ramp of phase or of amplitude at f Hz beside a polynomial of `degree` and multiples of f, over all repeats.

    The columns s cos and s sin (s = (t − centre)/half) of a signal a cos + b sin have the coefficients κ (b, −a) where
    its phase runs, and κ (a, b) where its amplitude grows.  Raises DataError as `solve_harmonics`.
    """
    solution = solve_harmonics(record, f, orders, degree, ramps=True)
    free = float(np.min(solution.free))
    a, b = solution.coefficients[:, degree + 1], solution.coefficients[:, degree + 2]
    ramp = np.swapaxes(solution.coefficients[:, -2:], 1, 2)
    noise = solution.squares / max(free, 1) if record.status is None else solution.covariance
    variance = np.diagonal(noise, axis1=1, axis2=2)
    size = a**2 + b**2
    floor = np.maximum(1e-24 * size, (np.finfo(float).eps * solution.largest) ** 2)
    weight = np.where(size > 0, 1 / np.maximum(variance, np.where(floor > 0, floor, 1.0)), 0.0)
    P = solution.P[:, -2:, -2:]
    along = np.stack([b, -a] if of == "phase" else [a, b], axis=-1)
    inside = np.linalg.solve(P, along[..., None])[..., 0]
    each = weight * np.sum(along * inside, axis=-1)
    information = float(np.sum(each))
    if information <= 0:
        return CommonRamp(0.0, 0.0, np.inf, 0.0, 0, free)
    by_channel = weight * np.sum(ramp * inside, axis=-1)
    kappa = float(np.sum(by_channel)) / information
    telling = each > 0
    apart = float(np.sum((by_channel[telling] - each[telling] * kappa) ** 2 / each[telling]))
    look = np.einsum("cij,bci->bcj", np.linalg.cholesky(P), weight[..., None] * inside)
    shared = float(np.einsum("bcj,bcd,bdj->", look, noise, look)) / information**2
    return CommonRamp(kappa, information, shared, apart, int(np.sum(telling)) - 1, free)


# Whether the drive's amplitude drifts while dwells last: then they are no steady sines.
#
# A drive that fades scales the motion of all channels by one factor that changes slowly. A sine of one
# amplitude counts the change as noise, and the rig, whose response lags behind its drive, is not the one
# that ratios of the channels show. What changes in one channel alone, by its sensor or by hum, is no drive:
# there channels contradict each other.


LEVEL_DRIVE_FADING = 1e-3  # of the test for an amplitude that drifts
FEWEST_PERIODS = 2.0  # below which drift of a sensor and a growing sine look alike
BENT = 2  # degree of the polynomial that the amplitude of many periods may follow
START = 8  # th part of a dwell in which transients decay
SLIGHT = 5e-4  # of an amplitude: a drift by less spoils no more than gains are known to
USABLE = 0.45  # of the sampling rate


def drive_fades(records: Sequence[Record]) -> float:
    """p-value of every dwell having one amplitude: Fisher's product of the F tests of all dwells.

    1 where no dwell has periods enough to tell.  Channels with samples that are not measured have no say: where their
    peaks are clipped they know little of the amplitude.
    """
    each = map(_steady_drive_fading, map(_wholly_measured, records))
    return float(fishers_product([p for p in each if p is not None]))


def _wholly_measured(record: Record) -> Record:
    """The record with those channels alone of which every sample is measured."""
    whole = record.whole_channels
    if np.all(whole):
        return record
    channels = tuple(record.channels[c] for c in np.flatnonzero(whole))
    return replace(record, channels=channels, values=record.values[..., whole], status=None)


def _steady_drive_fading(record: Record) -> float | None:
    """p-value of one dwell having one amplitude; None where it has too few periods, or repeats."""
    f = record.frequency_hz
    if f is None or record.values.ndim != 2 or periods_of(record) < FEWEST_PERIODS or not record.channels:
        return None
    blocks = period_blocks(record, f)
    return _of_few_periods(record, f) if blocks is None else _of_blocks(blocks)


def _of_few_periods(record: Record, f: float) -> float | None:
    """F of a drift of the common amplitude over the residual, taken as white."""
    rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
    many = len(record.time) >= MANY_SAMPLES and BESIDE[-1] * f < USABLE * rate
    try:
        ramp = common_ramp(record, f, 1, "amplitude", BESIDE if many else (1,))
    except DataError:
        return None
    if ramp.free < 1 or ramp.information <= 0:
        return None
    variance = max(ramp.variance, ramp.widening / ramp.information) + SLIGHT**2
    return float(fdtrc(1, ramp.free, ramp.kappa**2 / variance))


def _of_blocks(blocks: PeriodBlocks) -> float | None:
    """F of a slow change of the common amplitude over its scatter from block to block, which knows the noise.

    The first blocks have no say: what decays there is a transient, which has a test of its own.
    """
    size = np.abs(blocks.amplitudes[len(blocks.amplitudes) // START :])
    mean, noise = np.mean(size, axis=0), np.median(blocks.rms, axis=0)
    moves = mean > 0
    if not np.any(moves):
        return None
    relative = size[:, moves] / mean[moves]
    weight = 1 / ((noise[moves] / mean[moves]) ** 2 + SLIGHT**2)
    both = np.column_stack([relative, relative @ weight / np.sum(weight)])
    slow = np.linalg.qr(legvander(np.linspace(-1, 1, len(both)), BENT))[0][:, 1:]
    along = slow.T @ (both - np.mean(both, axis=0))
    free = len(both) - 1 - BENT
    left = np.sum((both - np.mean(both, axis=0)) ** 2, axis=0) - np.sum(along**2, axis=0)
    variance = np.maximum(left, 0.0) / free + SLIGHT**2
    apart = float(np.sum(np.sum((along[:, :-1] - along[:, -1:]) ** 2, axis=0) / variance[:-1]))
    widening = contradiction(apart, BENT * (relative.shape[1] - 1))
    F = float(np.sum(along[:, -1] ** 2)) / BENT / (variance[-1] * widening)
    return float(fdtrc(BENT, free, F))


FEW_PERIODS = 2.0  # below which the peak of a periodogram is as wide as the frequency is high


@dataclass(frozen=True)
class RefinedFrequency:
    """A drive frequency found from the samples: Hz, its standard deviation (white noise), and where it started."""

    frequency_hz: float
    sd: float
    nominal_hz: float


def refine_frequency(
    record: Record, nominal_hz: float | None = None, *, within: float = 0.02, drift: Drift = USUAL_DRIFT
) -> RefinedFrequency:
    """The frequency of greatest likelihood over all channels and repeats together, near the nominal one.

    A periodogram in nominal · (1 ± within), three resolution steps at least, finds the peak, but of a record of less
    than two periods; Gauss-Newton steps of the least squares fit take it to the end.  Raises DataError as
    `fit_harmonics`, and where it does not settle.
    """
    f = nominal_hz if nominal_hz is not None else record.frequency_hz
    if f is None:
        raise DataError(
            "the drive frequency is not known", record.source, "give the nominal frequency of the record"
        )
    nominal = float(f)
    degree = Conditioning(drift=drift).degree
    check_length(record, nominal, (1,), max(degree, 0) + 2)
    T = duration(record.time)
    search = min(max(within * nominal, 3 / T), 0.5 * nominal)
    f = nominal if nominal * T < FEW_PERIODS else _peak(record, nominal, search)
    sd = np.inf
    for _ in range(30):
        step, sd = frequency_step(record, f, degree)
        f += float(np.clip(step, -0.25 / T, 0.25 / T))
        if abs(f - nominal) > search + 1 / T or f <= 0:
            break
        if abs(step) * T < 1e-9 or abs(step) < 1e-3 * sd:
            return RefinedFrequency(f, sd, nominal)
    raise DataError(
        f"no drive frequency is found within {search:.3g} Hz of {nominal:g} Hz",
        record.source,
        "correct the nominal frequency, or use it as it is",
    )


def _peak(record: Record, nominal: float, search: float) -> float:
    """Highest point of the periodogram of all channels within nominal ± search.

    Samples are brought down to the nominal frequency and summed over time blocks, short enough for the search band.
    """
    time, T = record.time, duration(record.time)
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


def frequency_step(record: Record, f: float, degree: int) -> tuple[float, float]:
    """Gauss-Newton step of the frequency and its standard deviation, Hz.

    A frequency error δ shows as a ramp of the phase, κ = 2π half δ.  The deviation is that of white noise, unless the
    channels contradict each other by more: they share one drive, and what each finds beside it is a transient of its
    own.
    """
    _, half = window(record.time)
    ramp = common_ramp(record, f, degree, "phase")
    if ramp.information <= 0:
        return 0.0, np.inf
    per_turn = 2 * np.pi * half
    return ramp.kappa / per_turn, float(np.sqrt(ramp.widening / ramp.information) / per_turn)


# Whether records move at the frequency that is stated for them: refused where they do not, refined by
# evidence.
#
# A wrong label, rad/s in the place of Hz, or a time base that is wrong make every amplitude noise; a
# frequency that is off by a per cent turns the motion's phase within the dwell, and the residual is then no
# noise.


DOMINANT = 0.5  # part of a channel's power that one sine explains: that is what it moves at
ABSENT = 0.05  # part of a channel's power below which nothing is seen at the stated frequency
WITHIN = 0.025  # relative error of a stated frequency that is corrected, not refused
PADDED = 4  # points a line
MOST_SAMPLES = 1 << 18  # of a record that are looked at, and repeats
MOST_REPEATS = 4
SIGNIFICANT = 1e-3
OWN = 3.3  # standard deviations by which a dwell must differ from the common ratio to have a frequency of its own
LEAST_PERIODS = 0.98  # of a dwell that has a say
REPEATS_OF_SHORT = 4.0  # of a dwell of less than two periods that have one
LABEL = 5e-6  # relative: as labels of six digits are rounded
EVEN = 1e-7  # relative: what is nearer is the same frequency, however small the noise
USUAL = ((2 * np.pi, "rad/s"), (1 / (2 * np.pi), "Hz in the place of rad/s"), (60.0, "rpm"))
ALIKE = 0.05  # relative
MANY = 3  # dwells that are wrong alike, of which the first is told


@dataclass(frozen=True)
class DriveFrequencies:
    """The frequency of each dwell, Hz, and what was found: "stated", "clock" (one ratio for all) or "own"."""

    frequency_hz: tuple[float, ...]
    kind: str = "stated"
    ratio: float = 1.0

    def note(self, records: Sequence[Record]) -> list[Notice]:
        """What was changed, in words; nothing where the stated frequencies are used, or were rounded to six digits."""
        stated = np.array([record.frequency_hz for record in records], dtype=float)
        moved = np.flatnonzero(np.abs(np.array(self.frequency_hz) - stated) > LABEL * stated)
        if not len(moved):
            return []
        if self.kind == "clock":
            text = f"the records move at {self.ratio:.6g} × the stated frequencies ({len(records)} dwells alike): used"
            return [Notice("clock_refined", text)]
        return [
            Notice(
                "frequency_refined",
                f"{records[k].source}: driven at {self.frequency_hz[k]:.7g} Hz, not at {stated[k]:.7g} Hz",
                (records[k].source,),
            )
            for k in moved.tolist()
        ]


def require_stated(records: Sequence[Record], orders: Sequence[int]) -> None:
    """Raises DataError where records move at other frequencies than are stated.

    One problem for each dwell, or for the first of many that are wrong by one factor.
    """
    problems, ratios = [], []
    for record in records:
        peak = moves_elsewhere(record, orders)
        if peak is None or record.frequency_hz is None:
            continue
        ratios.append(record.frequency_hz / peak)
        problems.append((record, peak))
    if not problems:
        return
    middle = float(np.median(ratios))
    guess = next((f": {name}?" for ratio, name in USUAL if abs(middle / ratio - 1) < ALIKE), "")
    if len(problems) > 1 and not guess and np.ptp(ratios) < ALIKE * middle:
        guess = f": a time base or frequencies that are wrong by the factor {middle:.3g}?"
    shown = problems[:1] if guess and len(problems) > MANY else problems
    alike = f" ({len(problems)} of {len(records)} dwells alike)" if len(shown) < len(problems) else ""
    raise DataError(
        [
            Problem(
                f"{record.frequency_hz:g} Hz is stated, the record moves at {peak:.3g} Hz{guess}{alike}",
                record.source,
                "correct the frequency or the time, or leave the record out",
            )
            for record, peak in shown
        ]
    )


def beyond_half_rate(record: Record) -> bool:
    """Whether a dwell's stated frequency is beyond half its sampling rate, so that nothing can be told of it there."""
    return (record.frequency_hz or 0.0) * float(np.ptp(record.time)) > 0.5 * (len(record.time) - 1)


def moves_elsewhere(record: Record, orders: Sequence[int] = (1,)) -> float | None:
    """The frequency, Hz, at which most channels move where none moves at the stated one; None where all is well.

    A channel moves at what one sine explains half of its power by; nothing is seen at the stated frequency (or its
    `orders`) where it explains less than a twentieth in every channel.
    """
    f = record.frequency_hz
    count = min(len(record.time), MOST_SAMPLES)
    if f is None or count < 8:
        return None
    time = record.time[:count]
    step = float(time[-1] - time[0]) / (count - 1)
    if abs(f * step - 0.5) < 0.05:
        return None  # too near to half the sampling rate to tell
    values = record.values.reshape(-1, *record.values.shape[-2:])[:MOST_REPEATS, :count]
    Y = np.moveaxis(values, 1, 0).reshape(count, -1)
    line = np.arange(count) - (count - 1) / 2
    Y = Y - Y.mean(axis=0)
    Y = Y - np.outer(line, line @ Y / (line @ line))
    power = np.sum(Y**2, axis=0)
    Y = Y[:, power > 1e-20 * count * np.max(np.abs(values), initial=0.0) ** 2]
    if not Y.shape[1]:
        return None
    size = int(fft.next_fast_len(PADDED * count))
    share = np.minimum(2 * np.abs(fft.rfft(Y, size, axis=0)) ** 2 / (count * np.sum(Y**2, axis=0)), 1.0)
    frequency = np.arange(len(share)) / (size * step)
    resolution = 1 / (count * step)
    near = np.zeros(len(frequency), dtype=bool)
    for order in orders:
        seen_at = abs(order * f - round(order * f * step) / step)  # beyond half the sampling rate folded back
        near |= np.abs(frequency - seen_at) <= max(resolution, WITHIN * order * f)
    if np.max(share[near], initial=0.0) > ABSENT:
        return None
    peaks = np.argmax(share, axis=0)
    dominant = peaks[share[peaks, np.arange(share.shape[1])] > DOMINANT]
    if 2 * len(dominant) < share.shape[1] or not len(dominant):
        return None
    peak = float(np.median(frequency[dominant]))
    alike = np.abs(frequency[dominant] - peak) <= resolution
    return peak if 2 * np.sum(alike) >= share.shape[1] else None


def drive_frequencies(records: Sequence[Record]) -> DriveFrequencies:
    """The frequencies of the drive: as stated, unless all dwells together show that they are off (p < 1e-3).

    Where one ratio, of two clocks, explains it, all dwells get it; a dwell that differs from it gets its own, unless it
    has less than two periods: there a transient looks like another frequency.
    """
    stated = np.array([record.frequency_hz for record in records], dtype=float)
    steps = [_evidence(record) for record in records]
    z = np.array([0.0 if step is None else step[0] / step[1] for step in steps])
    tested = int(np.sum([step is not None for step in steps]))
    if not tested or float(chdtrc(tested, float(z @ z))) > SIGNIFICANT:
        return DriveFrequencies(tuple(stated.tolist()))
    frequency, sd = _refined(records, stated)
    off = frequency / stated - 1
    weight = (stated / sd) ** 2
    ratio = 1 + float(weight @ off) / float(np.sum(weight)) if np.sum(weight) > 0 else 1.0
    apart = np.abs(frequency - ratio * stated) > np.maximum(OWN * sd, EVEN * stated)
    if tested > 2 and np.sum(apart) <= 0.1 * tested:
        used = np.where(apart, frequency, ratio * stated)
        return DriveFrequencies(tuple(used.tolist()), "own" if np.any(apart) else "clock", ratio)
    long = np.array([periods_of(record) >= FEW_PERIODS for record in records])
    off_alone = long & (np.abs(frequency - stated) > np.maximum(OWN * sd, EVEN * stated))
    used = np.where(off_alone, frequency, stated)
    return DriveFrequencies(tuple(used.tolist()), "own")


def _evidence(record: Record) -> tuple[float, float] | None:
    """(step of the frequency that the samples ask for, its sd), Hz; None where a dwell says nothing of it."""
    f = record.frequency_hz
    if f is None or periods_of(record) < LEAST_PERIODS or len(record.time) < FEWEST_OF_A_DWELL:
        return None
    try:
        step, sd = frequency_step(record, f, 1)
    except DataError:
        return None
    if periods_of(record) < FEW_PERIODS:
        # The step is off by a tenth of its deviation, with the square of the noise: repeats do not average that out.
        sd *= max(1.0, float(np.sqrt(np.prod(record.values.shape[:-2]) / REPEATS_OF_SHORT)))
    return (step, sd) if np.isfinite(sd) and sd > 0 else None


def _refined(records: Sequence[Record], stated: Real) -> tuple[Real, Real]:
    """Refined frequencies and their sd; as stated with an infinite sd where there is none near."""
    frequency, sd = stated.copy(), np.full(len(stated), np.inf)
    for k, record in enumerate(records):
        if _evidence(record) is None:
            continue
        try:
            refined = refine_frequency(record, within=WITHIN)
        except DataError:
            continue
        near = max(WITHIN * stated[k], 0.25 / duration(record.time))
        if abs(refined.frequency_hz - stated[k]) <= near:
            frequency[k], sd[k] = refined.frequency_hz, refined.sd
    return frequency, sd


def at_frequencies(records: Sequence[Record], drive: DriveFrequencies) -> list[Record]:
    """The records at the frequencies found."""
    return [
        record if record.frequency_hz == f else replace(record, frequency_hz=f)
        for record, f in zip(records, drive.frequency_hz, strict=True)
    ]
