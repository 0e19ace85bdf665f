"""What a channel shows in a whole record in the place of what all others say of it: in frequency and in time.

The fit without the channel predicts it.  Beside that stand the forms that one sensor alone can give a motion: another
sign, unit or delay, an end of its range, a zero that wanders, a filter, spikes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.check.diagnosis.contradictions import Contradiction, filtered
from dashpot.check.diagnosis.likeness import ALIKE, Likeness, known_ratio, likeness
from dashpot.check.limited_channels import limited
from dashpot.data.stretch import history_of_lines

EXPLAINED = 0.6  # share of what is wrong that a form must explain
LOUD = 0.95  # share of a channel's power in the lines by which it is compared
PIECES = 48  # of a record, whose means say how the zero wanders
STEPS, SUDDEN = 4, 0.7  # pieces that must make up this share of all that the zero moves, to be steps
SURELY = 5.0  # standard deviations of a gain that differs from 1
RIGHT = 0.02  # of a gain: what is nearer to 1 is right


@dataclass(frozen=True)
class ComparedLines:
    """A channel of one record beside what it should show, (lines,): amplitudes, Hz, multiples of 1/T; T in s."""

    y: Complex
    expected: Complex
    frequency_hz: Real
    order: Ints
    duration_s: float


def contradiction_in_record(of: ComparedLines, unit: str) -> Likeness | Contradiction | None:
    """How a channel differs from what it should show, in its `unit`; None where no one form says it."""
    samples = 2 * (int(np.max(of.order)) + 1)
    shown, should = (history_of_lines(values, of.order, samples) for values in (of.y, of.expected))
    limit = limited(shown, should, 2 * len(of.order))
    if limit is not None:
        text = f"reads too little where it moves much, as if it ended at {limit:.3g} {unit}: clipped, or saturated?"
        return Contradiction(text)
    gain = float(shown @ should / (should @ should)) if np.any(should) else 0.0
    left = float(np.sum((shown - gain * should) ** 2) / max(np.sum(shown**2), np.finfo(float).tiny))
    times = Likeness(gain, 0, 0.0, False, left)
    loud = _loud(of.expected)
    form = times if left < ALIKE else likeness(of.y, of.expected, 2 * np.pi * of.frequency_hz, loud)
    if form is not None and form.kind in ("sign", "unit", "quantity", "delay"):
        ratio = known_ratio(form.number) if form.kind == "unit" else None
        return form if ratio is None else replace(form, number=float(np.copysign(ratio, form.number)))
    wander = _wander(shown - gain * should, of.duration_s, unit)
    through = filtered(of.frequency_hz[loud], of.expected[loud], of.y[loud]) if wander is None else wander
    if through is not None or form is None or form.kind != "gain":
        return through
    uncertain = float(np.sqrt(left * np.sum(shown**2) / np.sum(should**2) / (2 * len(of.order))))
    return times if abs(gain - 1) > max(RIGHT, SURELY * uncertain) else None


def _wander(away: Real, duration_s: float, unit: str) -> Contradiction | None:
    """That the zero of a channel drifts or steps, where that is most of what is wrong with it."""
    edges = np.linspace(0, len(away), PIECES + 1).astype(np.int64)
    means = np.add.reduceat(away, edges[:-1]) / np.diff(edges)
    if float(np.mean(means**2)) < EXPLAINED * float(np.mean(away**2)):
        return None
    size, steps = float(np.ptp(means)), np.abs(np.diff(means))
    k = int(np.argmax(steps))
    if np.sum(np.sort(steps)[-STEPS:]) > SUDDEN * np.sum(steps):
        at = duration_s * (k + 1) / PIECES
        text = f"has a zero that steps by {steps[k]:.3g} {unit} near {at:.3g} s: another range, or a cable that moved?"
        return Contradiction(text)
    return Contradiction(f"has a zero that drifts by {size:.3g} {unit}: its amplifier, or the temperature?")


def _loud(expected: Complex) -> Bools:
    """The loudest lines (lines,), of most of the power."""
    power = np.abs(expected) ** 2
    order = np.argsort(-power)
    kept = order[: int(np.searchsorted(np.cumsum(power[order]), LOUD * np.sum(power))) + 1]
    return np.isin(np.arange(len(power)), kept)
