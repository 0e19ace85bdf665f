"""Predictions of records that an estimate was not made of, as a document: how well, and what may be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.channel import Channel
from dashpot.check.validation import RecordPrediction, within_noise
from dashpot.estimate.assessment import Finding
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.present.document import Document, Provenance, Section, TableColumn, columns_of, section
from dashpot.present.estimate import diagnosis_in_words
from dashpot.present.figures.spectra import drawn_of, prediction_figure, rows_of_pictures
from dashpot.present.page import figure_picture, page_html
from dashpot.present.schematic.drawing import rig_picture
from dashpot.present.words import capitalised, short

POOR = 0.5  # FIT below which a prediction is of no use
EXPLANATION = (
    "FIT = 1 − ‖measured − predicted‖ / ‖measured − mean‖ within the band used, from the inputs alone; only "
    "the initial and final state of each record is fitted."
)


def validation_document(
    predictions: Sequence[RecordPrediction], findings: tuple[Finding, ...] = ()
) -> Document:
    """What is printed: a row for each channel of each record, whether they are predicted, what may be wrong."""
    said = prediction_in_words(predictions, findings), *mistakes_in_words(findings), EXPLANATION
    return Document("", (section("", validation_columns(predictions)), section("", *said)))


def validation_report(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate,
    predictions: Sequence[RecordPrediction],
    findings: tuple[Finding, ...] = (),
    provenance: Provenance | None = None,
) -> str:
    """HTML page of predictions of what was not used, with what may be wrong with it."""
    return page_html(
        Document(
            model.name or "Validation",
            (prediction_section("Measured and predicted", predictions),),
            "good" if within_noise(predictions) else "bad" if is_poor(predictions) else "open",
            "Records that the estimate was not made from, predicted from their inputs.",
            prediction_in_words(predictions, findings),
            (*mistakes_in_words(findings), EXPLANATION),
            (),
            section("FIT of every channel", validation_columns(predictions)),
            rig_picture(model, channels, estimate),
            next_validation_steps(predictions),
            ("FIT", "χ²"),
            provenance,
        )
    )


def prediction_section(title: str, predictions: Sequence[RecordPrediction], *more: str) -> Section:
    """FIT of each record and channel, and histories of the first record."""
    texts = [capitalised(text) for text in fits_in_words(predictions)]
    records = [part for part in predictions if part.samples]
    shown = "Histories and spectra" if records else "Amplitudes and phases"
    drawn = drawn_of(predictions)
    pictures = [
        figure_picture(
            prediction_figure(drawn, rows),
            f"{shown} of {joined([drawn.channels[k] for k in rows])}, measured and predicted",
        )
        for rows in rows_of_pictures(len(drawn.channels))
    ]
    if records:
        low, high = (short(float(end), 4) for end in (min(drawn.frequency_hz), max(drawn.frequency_hz)))
        texts.append(
            f"The histories last {short(drawn.duration_s, 4)} s and contain the {len(drawn.frequency_hz)} lines "
            f"from {low} to {high} Hz that were used; motion at other frequencies is left out of all curves."
        )
    return section(title, *texts, *more, *pictures, whole=True)


def fits_in_words(predictions: Sequence[RecordPrediction]) -> list[str]:
    """FIT of every channel, a sentence for each record."""
    texts = []
    for k, part in enumerate(predictions):
        fits = [
            f"{name} {short(100 * float(fit), 3)} %"
            for name, fit in zip(part.channels, part.fit, strict=True)
        ]
        record = f"record {k + 1}: " if len(predictions) > 1 else ""
        texts.append(f"{record}FIT {joined(fits)}.")
    return texts


def validation_columns(predictions: Sequence[RecordPrediction]) -> list[TableColumn]:
    """A row for each channel of each record: FIT, rms error and χ² over its degrees of freedom."""
    rows = []
    for number, part in enumerate(predictions, start=1):
        errors = part.rms_error
        for c, channel in enumerate(part.channels):
            name = f"{number} ({part.duration_s:.4g} s)" if part.samples else "settled lines"
            ratio = float(part.chi2[c]) / max(float(part.dof[c]), 1.0)
            fit = f"{100 * part.fit[c]:.2f}" if np.isfinite(part.fit[c]) else "–"
            error = f"{errors[c]:.3g} {part.units[c]}" if part.samples else "–"
            rows.append((name, channel, str(len(part.frequency_hz)), fit, error, short(ratio)))
    columns = columns_of(["record", "channel", "lines>", "FIT, %>", "rms error>", "χ² / dof>"], rows)
    return columns if any(part.samples for part in predictions) else [*columns[:4], *columns[5:]]


# Sentences.


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
        factors = ""
        if not findings:
            of_channel: dict[str, str] = {}
            for part in predictions:
                for name, fit, factor, rescaled in zip(
                    part.channels, part.fit, *part.rescaled(), strict=True
                ):
                    if fit < POOR and rescaled > 0.8:  # from this FIT on a factor is what a channel is off by
                        of_channel[name] = f"{name} is {short(float(factor), 2)} times its prediction"
            if of_channel:
                factors = f" {joined(list(of_channel.values()))}: another unit, gain or sign, or another rig?"
        return f"Poorly predicted: measured and predicted differ by {missed}." + factors
    if within is None:
        return (
            f"The largest difference between measured and predicted is {missed}; it cannot be tested, because "
            "the noise of the sensors is not known."
        )
    loudest = max(channels, key=lambda channel: np.nan_to_num(channel.times_noise))
    return (
        f"Not predicted to within the noise of the sensors: {loudest.channel} differs by "
        f"{short(loudest.times_noise, 2)} × the noise; the largest difference is {missed}."
    )


def mistakes_in_words(findings: tuple[Finding, ...]) -> list[str]:
    """What may be wrong with the data, the most probable first, each with what to change."""
    return diagnosis_in_words(tuple(replace(finding, remaining=None) for finding in findings))


def is_poor(predictions: Sequence[RecordPrediction]) -> bool:
    """Whether some channel is predicted so badly, or none at all, that the estimate is of no use for these records."""
    channels = _channels(predictions)
    return not channels or min(channel.fit for channel in channels) < POOR


def next_validation_steps(predictions: Sequence[RecordPrediction]) -> tuple[str, ...]:
    """What to do after a prediction."""
    within = within_noise(predictions)
    if within:
        return (
            "Rely on the estimate for motions as large as these, in this band; predict other tests, too.",
        )
    if within is None and not is_poor(predictions):
        return (
            "Give the noise of the sensors (columns NAME_sd, or --noise-record): the difference is then testable.",
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
