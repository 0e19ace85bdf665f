"""The true frequency of the drive, near the stated one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.data.conditioning.ramps import common_ramp
from dashpot.data.conditioning.regression import check_length, duration, window
from dashpot.data.conditioning.settings import USUAL_DRIFT, Conditioning, Drift
from dashpot.data.record import Record
from dashpot.errors import DataError

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
