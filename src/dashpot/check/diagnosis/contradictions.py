"""What a channel that contradicts all others shows in their place: through a filter, in two ranges, of another point.

The fit without the channel says what it should show; its ratio to that is compared with the few forms that one sensor
alone can give it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.check.diagnosis.search import FEWER_DRAWS, Workbench
from dashpot.check.diagnosis.trials import Outcome, Trial, untouched
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.observation import observation_model

FITS = 4.0  # χ² per degree of freedom of the fit without the channel, above which it says little of it
LEFT = 0.1  # of the squares of what is wrong with the channel that a form may leave
FEWEST = 6  # lines
MUCH_LESS = 0.5  # of what a filter of the first order leaves must one of the second
STEP = 0.02  # of a gain, that two ranges must differ by
AS_WELL = 1.6  # times what the fit without the channel leaves: what the rig with it elsewhere may leave
GROUP = 3  # lines in each of two ranges
LEVELS = 60  # of a limit that are tried
PASSED = 0.7  # of the lines that a filter lets through, what is left of them at the least
CUT_OFF = (0.02, 50.0)  # times the lowest and the highest frequency: where a filter's corner may be


@dataclass(frozen=True)
class Contradiction:
    """What a channel shows, in words behind its name, and the channel as it would be right, None where none is."""

    text: str
    mended: Channel | None = None


@dataclass(frozen=True)
class _Shown:
    """A channel against what it should show, lines in the order of the test: frequency, should and ratio (lines,)."""

    frequency_hz: Real
    expected: Complex
    ratio: Complex

    def left(self, form: Complex | Real) -> float:
        """Part of the squares of what is wrong that a form of the ratio, (lines,), leaves; lines that leap count 1."""
        away, wrong = (np.minimum(np.abs(self.ratio - each), 1.0) ** 2 for each in (form, 1.0))
        return float(np.sum(away) / max(np.sum(wrong), np.finfo(float).tiny))


def contradiction_of(bench: Workbench, base: Trial, c: int, outcome: Outcome) -> Contradiction | None:
    """How channel c differs from what the fit without it gives; None where no form does, or that fit is a bad one."""
    if not outcome.reduced < FITS:
        return None
    expected = bench.expected(outcome)[:, c]
    used = base.kept[:, c] & (np.abs(expected) > 0) & np.isfinite(expected)
    if np.sum(used) < FEWEST:
        return None
    shown = _Shown(bench.data.spectrum.frequency_hz[used], expected[used], base.y[used, c] / expected[used])
    forms: tuple[Callable[[_Shown], tuple[float, Contradiction]], ...] = (
        _low_pass,
        _high_pass,
        _limited,
        _in_two,
    )
    found = [form(shown) for form in forms] + _elsewhere(bench, c, outcome)
    left, best = min(found, key=lambda each: each[0])
    return best if left < LEFT else None


def filtered(frequency_hz: Real, expected: Complex, y: Complex) -> Contradiction | None:
    """The filter through which lines y (lines,) show what they should, `expected`; None where none explains them.

    Some of the lines must pass: what is less everywhere is another motion, or another unit.
    """
    shown = _Shown(frequency_hz, expected, y / expected)
    if np.quantile(np.abs(shown.ratio), 0.9) < PASSED:
        return None
    left, best = min((form(shown) for form in (_low_pass, _high_pass)), key=lambda each: each[0])
    return best if left < LEFT else None


def _low_pass(shown: _Shown) -> tuple[float, Contradiction]:
    left, corner = _filtered(shown, 1.0)
    return left, Contradiction(
        f"reads as through a low-pass filter of about {corner:.2g} Hz: that of its amplifier?"
    )


def _high_pass(shown: _Shown) -> tuple[float, Contradiction]:
    left, corner = _filtered(shown, -1.0)
    return left, Contradiction(
        f"reads as through a high-pass filter of about {corner:.2g} Hz: is it coupled by AC?"
    )


def _filtered(shown: _Shown, power: float) -> tuple[float, float]:
    """What 1 / (1 + a s + b s²) leaves, s being (jω)^power, a and b above 0; and its corner, Hz."""
    omega = 2 * np.pi * shown.frequency_hz
    s = (1j * omega) ** power
    columns = shown.ratio[:, None] * np.stack([s, s**2], axis=1)
    rows, side = (np.concatenate([each.real, each.imag]) for each in (columns, 1 - shown.ratio))
    best = (np.inf, np.nan)
    for order in (1, 2):
        size = np.linalg.norm(rows[:, :order], axis=0)
        values = np.linalg.lstsq(rows[:, :order] / size, side, rcond=None)[0] / size
        if not np.all(values > 0):
            continue
        corner = float(values[-1] ** (-power / order)) / (2 * np.pi)
        inside = CUT_OFF[0] * np.min(shown.frequency_hz) < corner < CUT_OFF[1] * np.max(shown.frequency_hz)
        left = shown.left(1 / (1 + np.stack([s, s**2], axis=1)[:, :order] @ values))
        if inside and left < (1.0 if order == 1 else MUCH_LESS) * best[0]:
            best = (left, corner)
    return best


def _limited(shown: _Shown) -> tuple[float, Contradiction]:
    """A sensor that goes no further than a limit: the fundamental of a clipped sine."""
    size = np.abs(shown.expected)
    best, limit = np.inf, np.nan
    for level in np.geomspace(0.1, 1.0, LEVELS) * np.max(size):
        part = np.minimum(level / size, 1.0)
        left = shown.left(2 / np.pi * (np.arcsin(part) + part * np.sqrt(1 - part**2)))
        if left < best:
            best, limit = left, float(level)
    return best, Contradiction(
        f"reads too little where it moves much, as if it ended at {limit:.3g} (SI): saturated?"
    )


def _in_two(shown: _Shown) -> tuple[float, Contradiction]:
    """A gain that is another one from some line on."""
    best, text = np.inf, ""
    for split in range(GROUP, len(shown.ratio) - GROUP + 1):
        first, second = (float(np.median(part.real)) for part in np.split(shown.ratio, [split]))
        if first == 0 or abs(second / first - 1) < STEP:
            continue
        left = shown.left(np.where(np.arange(len(shown.ratio)) < split, first, second))
        if left < best:
            best = left
            text = f"reads {second / first:.4g} × as much from {shown.frequency_hz[split]:g} Hz on as before"
    return best, Contradiction(f"{text}: another range of its amplifier?".replace("reads -", "reads −"))


def _elsewhere(bench: Workbench, c: int, outcome: Outcome) -> list[tuple[float, Contradiction]]:
    """The channel as one of each other point that moves, where the rig then fits."""
    model, channel = bench.data.model, bench.view.channels[c]
    points = [p for p in (*model.coordinates, *model.displacement_inputs) if set(channel.of) != {p}]
    if set(channel.of) <= set(model.force_inputs) or bench.view.gains or bench.view.delays:
        return []
    listed = []
    for point in points:
        mended = replace(channel, of={point: 1.0})
        channels = tuple(mended if k == c else each for k, each in enumerate(bench.view.channels))
        spectrum = replace(bench.data.spectrum, channels=channels)
        view = observation_model(model, channels, bench.view.omega)
        data = replace(bench.data, view=view, spectrum=spectrum, states=None)
        data = replace(data, states=states_if_seen(view, spectrum, data.covariance))
        (end,) = Workbench(data, outcome.psi, bench.sign).searched([untouched(data)], draws=FEWER_DRAWS)
        if end.reduced < AS_WELL * max(outcome.reduced, 1.0):
            text = f"shows what the rig does at {point}: is it mounted there?"
            listed.append((0.0, Contradiction(text, mended)))
    return listed
