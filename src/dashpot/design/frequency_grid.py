"""Where a test may dwell: points of a band, for each pattern of the drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.design.test_setup import UNDAMPED, TestSetup
from dashpot.errors import UsageError


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
