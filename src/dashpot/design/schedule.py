"""A test as dwells: frequency, pattern of the drive and samples of each line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.design.test_setup import TestSetup
from dashpot.errors import UsageError


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
        total: Real = np.einsum("i,siab->sab", self.samples, each)
        return total


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
