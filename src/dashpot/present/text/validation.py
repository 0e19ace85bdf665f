"""How well records are predicted, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.check.validation import RecordPrediction, within_noise
from dashpot.estimate.assessment import Finding
from dashpot.io.words import joined
from dashpot.present.text.assessment import diagnosis_in_words
from dashpot.present.text.numbers import short

POOR = 0.5  # FIT below which a prediction is of no use
GOOD = 0.8  # FIT from which on a factor is what a channel is off by
EXPLANATION = (
    "FIT = 1 − ‖measured − predicted‖ / ‖measured − mean‖ within the band used, from the inputs alone; only the "
    "state in which a record starts and ends is fitted to it."
)


@dataclass(frozen=True)
class _Prediction:
    """One channel of one record: FIT, and the rms of the difference over that of the noise (NaN: unknown)."""

    channel: str
    fit: float
    times_noise: float


def prediction_in_words(predictions: Sequence[RecordPrediction], findings: tuple[Finding, ...] = ()) -> str:
    """Whether the records are predicted, and by how many per cent of the motion and times the noise they are missed.

    Factors of single channels are named where no `findings` say what is wrong.
    """
    channels = _channels(predictions)
    if not channels:
        return "Nothing could be predicted."
    worst = min(channels, key=lambda channel: channel.fit)
    missed = f"{short(100 * (1 - worst.fit), 2)} % of the motion at {worst.channel}"
    within = within_noise(predictions)
    if within:
        return f"Predicted to within the noise of the sensors: the largest difference is {missed}."
    if is_poor(predictions):
        return f"Poorly predicted: measured and predicted differ by {missed}." + (
            "" if findings else _factors(predictions)
        )
    if within is None:
        return (
            f"The largest difference between measured and predicted is {missed}; whether that is more "
            "than noise cannot be said, for the noise of the sensors is not known."
        )
    loudest = max(channels, key=lambda channel: np.nan_to_num(channel.times_noise))
    return (
        f"Not predicted to within the noise of the sensors: {loudest.channel} differs by "
        f"{short(loudest.times_noise, 2)} × the noise; the largest difference is {missed}."
    )


def mistakes_in_words(findings: tuple[Finding, ...]) -> list[str]:
    """What may be wrong with the data, the likeliest first, each with what to change."""
    return diagnosis_in_words(tuple(replace(finding, remaining=None) for finding in findings))


def _factors(predictions: Sequence[RecordPrediction]) -> str:
    """Which channels are what is predicted of them but for a factor; "" where none is."""
    of_channel: dict[str, str] = {}
    for part in predictions:
        for name, fit, factor, rescaled in zip(part.channels, part.fit, *part.rescaled(), strict=True):
            if fit < POOR and rescaled > GOOD:
                of_channel[name] = f"{name} is {short(float(factor), 2)} times its prediction"
    if not of_channel:
        return ""
    return f" {joined(list(of_channel.values()))}: another unit, gain or sign, or another rig?"


def is_poor(predictions: Sequence[RecordPrediction]) -> bool:
    """Whether some channel is predicted so badly, or none at all, that the estimate is of no use for these records."""
    channels = _channels(predictions)
    return not channels or min(channel.fit for channel in channels) < POOR


def next_validation_steps(predictions: Sequence[RecordPrediction]) -> tuple[str, ...]:
    """What to do after a prediction."""
    within = within_noise(predictions)
    if within:
        return (
            "Rely on the estimate for motions as large as these, in this band; predict a test of others as well.",
        )
    if within is None and not is_poor(predictions):
        return (
            "Give the noise of the sensors (columns NAME_sd, or --noise-record), so that the difference can be tested.",
        )
    return (
        "Look for what differs between the tests: amplitude (a nonlinear element), mounting, sensors, temperature.",
        "Identify from these records as well: dashpot identify RIG DATA --report report.html.",
    )


def _channels(predictions: Sequence[RecordPrediction]) -> list[_Prediction]:
    with np.errstate(invalid="ignore"):
        return [
            _Prediction(name, float(fit), float(np.sqrt(chi2 / max(dof, 1.0))))
            for part in predictions
            for name, fit, chi2, dof in zip(part.channels, part.fit, part.chi2, part.dof, strict=True)
            if np.isfinite(fit)
        ]
