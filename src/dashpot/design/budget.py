"""How much test there is: samples or time, and what each dwell must have."""

from __future__ import annotations

from dataclasses import dataclass

from dashpot.design.frequency_grid import FrequencyGrid
from dashpot.errors import UsageError

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
