"""A test as dwells: frequency, pattern of the drive and samples of each line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.design.test_setup import UNDAMPED, TestSetup
from dashpot.errors import UsageError

# Where a test may dwell: points of a band, for each pattern of the drive.


@dataclass(frozen=True)
class FrequencyGrid:
    """Where to look for frequencies: points (g,), with their patterns (g,); `free` lets frequencies move off them."""

    frequency_hz: Real
    pattern: Ints
    free: bool = True

    @property
    def low(self) -> float:
        """Lower end of the band, Hz."""
        return float(np.min(self.frequency_hz))

    @property
    def high(self) -> float:
        """Upper end of the band, Hz."""
        return float(np.max(self.frequency_hz))


def band_grid(setup: TestSetup, low: float, high: float, step: float | None = None) -> FrequencyGrid:
    """Points in low … high (Hz) for every pattern of the drive: multiples of `step`, or about 2 % apart and free.

    Without a step, points crowd around each resonance of each scenario, where lightly damped rigs change fast.
    Raises UsageError for a band that is none.
    """
    if not (np.isfinite(low) and np.isfinite(high) and 0 < low <= high):
        raise UsageError(
            f"{low:g} to {high:g} Hz is not a band", cure="give two positive frequencies, the lower first"
        )
    if step is not None:
        if not (np.isfinite(step) and step > 0):
            raise UsageError(f"a grid step of {step:g} Hz", cure="give a positive step")
        count = np.arange(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)
        if len(count) > 20_000:
            raise UsageError(f"{len(count)} grid points", cure="give a larger step or a narrower band")
        f = count * step
        if len(f) == 0:
            raise UsageError(
                f"no multiple of {step:g} Hz lies in {low:g} to {high:g} Hz", cure="give a smaller step"
            )
    else:
        octaves = np.log(high / low)
        f = np.geomspace(low, high, int(np.clip(octaves / 0.02, 2, 400)) if high > low else 1)
        around = np.array([0, 0.3, 0.6, 1, 1.5, 2.2, 3.3, 5, 8])
        for resonance, zeta in _distinct(setup.resonances()):
            # Narrower than the grid resolves: half-widths on both sides.
            if UNDAMPED < zeta < 0.1:
                near = resonance * np.exp(np.concatenate([around, -around]) * max(zeta, 1e-5))
                f = np.concatenate([f, near[(near > low) & (near < high)]])
        f = np.unique(f)
    patterns = len(setup.drives)
    return FrequencyGrid(np.tile(f, patterns), np.repeat(np.arange(patterns), len(f)), step is None)


def _distinct(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Resonances that differ by more than half a half-width; at most 60."""
    kept: list[tuple[float, float]] = []
    for f, zeta in sorted(found):
        if not kept or f > kept[-1][0] * (1 + max(zeta, 1e-5) / 2):
            kept.append((f, zeta))
    return kept if len(kept) <= 60 else [kept[i] for i in np.linspace(0, len(kept) - 1, 60).astype(int)]


def natural_band(setup: TestSetup, rate: float | None = None) -> tuple[float, float]:
    """A band about the rig's resonances: a fifth of the lowest to three times the highest, Hz, to three digits.

    Raises UsageError where the rig has none.
    """
    resonances = [f for f, _ in setup.resonances()]
    if not resonances:
        raise UsageError("the rig has no resonance to take the band from", cure="state the band")
    high = 3 * max(resonances) if rate is None else min(3 * max(resonances), 0.4 * rate)
    return float(f"{min(0.2 * min(resonances), high / 10):.3g}"), float(f"{high:.3g}")


# How much test there is: samples or time, and what each dwell must have.


MIN_SAMPLES = 8  # of a dwell: offset, drift and a harmonic leave some residual
NYQUIST = 0.45  # highest frequency in parts of the sampling rate
ENOUGH = 1e9  # samples or seconds; more is a mistake


@dataclass(frozen=True)
class Budget:
    """How much test there is: `samples` in all, or `time` in s, settling included.

    rate        samples a second; None: each dwell spreads its samples over whole periods as it likes
    settle      s before each dwell
    min_dwell   s of measuring at least, in each dwell
    most        at most that many dwells

    Raises UsageError where both or neither are stated, or a number makes no sense.
    """

    samples: float | None = None
    time: float | None = None
    rate: float | None = None
    settle: float = 0.0
    min_dwell: float = 0.0
    most: int | None = None

    def __post_init__(self) -> None:
        if (self.samples is None) == (self.time is None):
            raise UsageError(
                "the budget is either samples or time", cure="state a number of samples or a time"
            )
        if self.time is not None and self.rate is None:
            raise UsageError(
                "a budget of time needs the sampling rate",
                cure="state the rate, here or for the channels in the rig file, or a number of samples",
            )
        if self.min_dwell > 0 and self.rate is None:
            raise UsageError(
                "a shortest dwell needs the sampling rate",
                cure="state the rate, here or for the channels in the rig file",
            )
        for name, number in (("samples", self.samples), ("time", self.time), ("rate", self.rate)):
            if number is not None and not 0 < number <= ENOUGH:
                raise UsageError(f"{name} of {number:g}", cure=f"give a positive number up to {ENOUGH:g}")
        for name, number in (("settling time", self.settle), ("shortest dwell", self.min_dwell)):
            if not 0 <= number <= ENOUGH:
                raise UsageError(f"a {name} of {number:g} s", cure="give a time of 0 s or more")
        if self.most is not None and self.most < 1:
            raise UsageError(f"at most {self.most} frequencies", cure="allow at least one")

    def measured(self, dwells: int) -> float:
        """Samples that are left for measuring with that many dwells; not positive where settling eats the time."""
        if self.samples is not None:
            return float(self.samples)
        assert self.time is not None
        assert self.rate is not None
        return (self.time - dwells * self.settle) * self.rate

    def scaled(self, factor: float) -> Budget:
        """The same budget with more or less of it."""
        samples = None if self.samples is None else self.samples * factor
        time = None if self.time is None else self.time * factor
        return Budget(samples, time, self.rate, self.settle, self.min_dwell, self.most)


def require_rate(grid: FrequencyGrid, budget: Budget) -> None:
    """Raises UsageError where the band comes too near half the sampling rate."""
    if budget.rate is not None and grid.high > NYQUIST * budget.rate:
        raise UsageError(
            f"the band ends at {grid.high:g} Hz, too near half the sampling rate of {budget.rate:g} Hz",
            cure=f"end the band at {NYQUIST * budget.rate:.4g} Hz, or sample faster",
        )


@dataclass(frozen=True)
class Dwell:
    """One line of the test: amplitudes of the inputs (SI), whole periods, samples, times in s (None: no rate)."""

    frequency_hz: float
    amplitudes: Mapping[str, complex]
    samples: int
    periods: int | None
    time_s: float | None
    settle_s: float


@dataclass(frozen=True)
class Schedule:
    """A test as the information sees it: frequency, pattern of the drive and samples of each line."""

    frequency_hz: Real
    pattern: Ints
    samples: Real

    def __post_init__(self) -> None:
        freeze(self)

    def information(self, setup: TestSetup) -> Real:
        """Of all lines together, (scenarios, q, q)."""
        if len(self.frequency_hz) == 0:
            return np.zeros_like(setup.prior)
        each = setup.information(self.frequency_hz, self.pattern)
        return np.einsum("i,siab->sab", self.samples, each)


def even_schedule(
    frequencies: Sequence[float], samples: float, weights: Sequence[float] | None = None
) -> Schedule:
    """A test of given frequencies that share the samples evenly, or as `weights` say.

    Raises UsageError where there is no frequency, or one is not positive.
    """
    f = np.asarray(frequencies, dtype=float)
    if len(f) == 0:
        raise UsageError(
            "the test to compare with has no frequencies", cure="list them in Hz, such as 1,1.5,2"
        )
    if np.any(~np.isfinite(f) | (f <= 0)):
        raise UsageError("a frequency that is not positive", cure="write frequencies in Hz, such as 1,1.5,2")
    w = np.ones(len(f)) if weights is None else np.asarray(weights, dtype=float)
    return Schedule(f, np.zeros(len(f), dtype=np.int64), samples * w / np.sum(w))
