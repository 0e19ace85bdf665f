"""What lines of a Spectrum have in common: a settled dwell, or a whole record with its transient (THEORY §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from dashpot.arrays import Complex, Ints, Real
from dashpot.errors import DataError

MOST_TERMS = 6  # of a polynomial


@dataclass(frozen=True)
class SettledDwell:
    """Lines of a steady state: no transient is in them.

    fundamental_hz: drive frequency whose multiples the lines are; None where each line stands for itself.
    """

    fundamental_hz: float | None = None

    def orders(self, frequency_hz: Real) -> Ints:
        """Multiples of the fundamental that lines at `frequency_hz` are, 1 without one; shape of `frequency_hz`."""
        if self.fundamental_hz is None:
            return np.ones(np.shape(frequency_hz), dtype=np.int64)
        return np.rint(np.asarray(frequency_hz) / self.fundamental_hz).astype(np.int64)


@dataclass(frozen=True)
class WholeRecord:
    """Lines k / T of one stretch of samples, whose motion need not return to where it began.

    duration_s   T = N times the sampling step, s
    samples      N
    loads        whether the lines carry boundary loads, an impulse and a doublet at every coordinate (THEORY (W));
                 False where the motion is periodic in T, or starts and ends at rest
    polynomial   how many of the columns 1, jω, (jω)², … each output channel has for what the ends of the record alias
    ramp         whether each output channel has the column 1/jω of a linear drift as well
    drive_hz     drive frequency of a dwell that may have settled, which is then steady motion at that frequency
    weaker       channels some of whose samples were put in by estimate and tell nothing: name, and times what the
                 variance of an amplitude would be had they been measured
    """

    duration_s: float
    samples: int
    loads: bool = True
    polynomial: int = 4
    ramp: bool = False
    drive_hz: float | None = None
    weaker: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not (0 < self.duration_s < np.inf and self.samples > 0 and 0 <= self.polynomial <= MOST_TERMS):
            raise DataError(
                f"a record of {self.samples} samples in {self.duration_s:g} s with {self.polynomial} polynomials",
                cure="its duration and samples must be positive, its columns 0 to 6",
            )

    @property
    def step_s(self) -> float:
        """Sampling step, s."""
        return self.duration_s / self.samples

    def orders(self, frequency_hz: Real) -> Ints:
        """Multiples of 1/T that lines at `frequency_hz` are, of its shape."""
        return np.rint(np.asarray(frequency_hz) * self.duration_s).astype(np.int64)


Stretch = SettledDwell | WholeRecord


def samples_of_squares(order: Ints) -> int:
    """Samples of a history of these lines at which its squares alias nothing: twice what the lines ask for."""
    return int(next_fast_len(4 * (int(np.max(order)) + 1), real=True))


def history_of_lines(amplitudes: Complex, order: Ints, samples: int) -> Real:
    """The motion of a record whose lines k/T are those of `order` (lines,), without all others, (samples, ...).

    amplitudes (lines, ...), peak, in any unit: the history has the same.  Other than the record's own number of samples
    show the same motion more or less finely.
    """
    lines = np.zeros((samples // 2 + 1, *amplitudes.shape[1:]), dtype=np.complex128)
    lines[order] = amplitudes * samples / 2
    return np.fft.irfft(lines, samples, axis=0)


def joined_stretches(
    parts: Sequence[tuple[Ints, tuple[Stretch, ...]]],
) -> tuple[Ints, tuple[Stretch, ...]]:
    """Stretches of several spectra put one after another, (lines of all,).

    Records and dwells stay apart, even where they are alike; lines that stand for themselves share one stretch.
    """
    stretches: list[Stretch] = []
    alone = SettledDwell()
    lines = []
    for stretch, values in parts:
        number = np.zeros(len(values), dtype=np.int64)
        for i, value in enumerate(values):
            if value == alone and alone in stretches:
                number[i] = stretches.index(alone)
                continue
            number[i] = len(stretches)
            stretches.append(value)
        lines.append(number[stretch])
    return np.concatenate(lines) if lines else np.zeros(0, dtype=np.int64), tuple(stretches)


def selected(stretch: Ints, stretches: tuple[Stretch, ...]) -> tuple[Ints, tuple[Stretch, ...]]:
    """The stretches that are still used by lines with the numbers `stretch`, renumbered.  stretch (lines,)."""
    if not len(stretch):
        return stretch, stretches[:1]
    used, number = np.unique(stretch, return_inverse=True)
    return number.astype(np.int64), tuple(stretches[int(i)] for i in used)
