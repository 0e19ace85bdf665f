"""The true frequency of the drive, near the stated one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.special import chdtrc

from dashpot.data.conditioning.clock import FEWEST_OF_A_DWELL
from dashpot.data.conditioning.regression import Terms, check_length, turning, window
from dashpot.data.conditioning.settings import USUAL_DRIFT, Conditioning, Drift
from dashpot.data.conditioning.steadiness import FEW_PERIODS, common_ramp, wholly_measured
from dashpot.data.noise import LEVEL
from dashpot.data.record import Record
from dashpot.errors import DataError, Problem
from dashpot.notices import Notice


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
    nominal = float(nominal_hz if nominal_hz is not None else record.stated_hz)
    degree = Conditioning(drift=drift).degree
    check_length(record, nominal, Terms(max(degree, 0) + 2))
    T = record.duration_s
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
    time, T = record.time, record.duration_s
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    blocks = int(min(max(16, np.ceil(8 * search * T)), 1 << 20))
    edges = np.searchsorted(time, time[0] + (T / blocks) * np.arange(1, blocks))
    carrier = np.conj(turning(nominal, time))
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
    channels contradict each other by more: they share one drive, and what each finds off it is a transient of its
    own.
    """
    _, half = window(record.time)
    ramp = common_ramp(record, f, Terms(degree, (1,), 1), "phase")
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
OWN = 3.3  # standard deviations by which a dwell must differ from the common ratio to have a frequency of its own
LABEL = 5e-6  # relative: as labels of six digits are rounded
EVEN = 1e-7  # relative: what is nearer is the same frequency, however small the noise
USUAL = ((2 * np.pi, "rad/s"), (1 / (2 * np.pi), "Hz, not rad/s"), (60.0, "rpm"))
ALIKE = 0.05  # relative


def driven_at(record: Record, f: float) -> Notice:
    """That a record is driven at another frequency than is stated, Hz."""
    digits = next(n for n in range(7, 18) if n == 17 or f"{f:.{n}g}" != f"{record.frequency_hz:.{n}g}")
    text = f"driven at {f:.{digits}g} Hz, not at {record.frequency_hz:.{digits}g} Hz"
    return record.notice("frequency_refined", text)


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
    guess = next((f". Is it in {name}?" for ratio, name in USUAL if abs(middle / ratio - 1) < ALIKE), "")
    if len(problems) > 1 and not guess and np.ptp(ratios) < ALIKE * middle:
        guess = f". Are time base or frequencies wrong by the factor {middle:.3g}?"
    shown = problems[:1] if guess and len(problems) > 3 else problems
    alike = f" ({len(problems)} of {len(records)} dwells alike)" if len(shown) < len(problems) else ""
    raise DataError(
        [
            Problem(
                f"{record.frequency_hz:g} Hz is stated, but the response is at {peak:.3g} Hz{guess}{alike}",
                record.source,
                "correct the frequency or the time, or leave the record out",
            )
            for record, peak in shown
        ]
    )


def moves_elsewhere(record: Record, orders: Sequence[int] = (1,)) -> float | None:
    """The frequency, Hz, at which most channels move where none moves at the stated one; None where all is well.

    A channel moves at what one sine explains half of its power by; nothing is seen at the stated frequency (or its
    `orders`) where it explains less than a twentieth in every channel.
    """
    f = record.frequency_hz
    count = min(len(record.time), 1 << 18)  # samples that are looked at, of four repeats
    if f is None or count < 8:
        return None
    time = record.time[:count]
    step = float(time[-1] - time[0]) / (count - 1)
    if abs(f * step - 0.5) < 0.05:
        return None  # too near to half the sampling rate to tell
    values = record.values.reshape(-1, *record.values.shape[-2:])[:4, :count]
    Y = np.moveaxis(values, 1, 0).reshape(count, -1)
    line = np.arange(count) - (count - 1) / 2
    Y = Y - Y.mean(axis=0)
    Y = Y - np.outer(line, line @ Y / (line @ line))
    power = np.sum(Y**2, axis=0)
    Y = Y[:, power > 1e-20 * count * np.max(np.abs(values), initial=0.0) ** 2]
    if not Y.shape[1]:
        return None
    size = int(fft.next_fast_len(4 * count))
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


def at_drive_frequencies(records: Sequence[Record]) -> tuple[list[Record], list[Notice]]:
    """The records at the frequencies of the drive: as stated, unless all dwells together show that they are off
    (p < 1e-3); and what was changed, but for labels that were rounded to six digits.

    Where one ratio, of two clocks, explains it, all dwells get it; a dwell that differs from it gets its own, unless it
    has less than two periods: there a transient looks like another frequency.
    """
    stated = np.array([record.frequency_hz for record in records], dtype=float)
    # Channels that measured all of their samples tell it at once: all share one drive
    telling = [wholly_measured(record) if np.any(record.whole_channels) else record for record in records]
    steps = [_evidence(record) for record in telling]
    z = np.array([0.0 if step is None else step[0] / step[1] for step in steps])
    tested = int(np.sum([step is not None for step in steps]))
    if not tested or float(chdtrc(tested, float(z @ z))) > LEVEL:
        return list(records), []
    frequency, sd = stated.copy(), np.full(len(stated), np.inf)
    for k, record in enumerate(telling):
        try:
            refined = None if steps[k] is None else refine_frequency(record, within=WITHIN)
        except DataError:
            continue
        near = max(WITHIN * stated[k], 0.25 / record.duration_s)
        if refined is not None and abs(refined.frequency_hz - stated[k]) <= near:
            frequency[k], sd[k] = refined.frequency_hz, refined.sd
    weight = (stated / sd) ** 2
    off = float(weight @ (frequency / stated - 1))
    common = (1 + off / float(np.sum(weight)) if np.sum(weight) > 0 else 1.0) * stated
    differ = np.maximum(OWN * sd, EVEN * stated)
    apart = np.abs(frequency - common) > differ
    alike = tested > 2 and np.sum(apart) <= 0.1 * tested
    if not alike:
        long = np.array([record.periods >= FEW_PERIODS for record in records])
        common, apart = stated, long & (np.abs(frequency - stated) > differ)
    used = np.where(apart, frequency, common)
    moved = np.flatnonzero(np.abs(used - stated) > LABEL * stated).tolist()
    notes = [driven_at(records[k], used[k]) for k in moved]
    if moved and alike and not np.any(apart):
        text = (
            f"the response is at {used[0] / stated[0]:.6g} × the stated frequencies ({len(records)} dwells "
            "alike): this ratio is used"
        )
        notes = [Notice("clock_refined", text)]
    every = zip(records, used.tolist(), strict=True)
    return [of if of.frequency_hz == f else replace(of, frequency_hz=f) for of, f in every], notes


def _evidence(record: Record) -> tuple[float, float] | None:
    """(step of the frequency that the samples ask for, its sd), Hz; None where a dwell says nothing of it."""
    f = record.frequency_hz
    if f is None or record.periods < 0.98 or len(record.time) < FEWEST_OF_A_DWELL:
        return None
    try:
        step, sd = frequency_step(record, f, 1)
    except DataError:
        return None
    if record.periods < FEW_PERIODS:
        # The step is off by a tenth of its deviation, with the square of the noise: more repeats than four do not
        # average that out.
        sd *= max(1.0, float(np.sqrt(np.prod(record.values.shape[:-2]) / 4)))
    return (step, sd) if np.isfinite(sd) and sd > 0 else None
