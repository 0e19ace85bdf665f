"""How well an estimate of a nonlinear rig predicts whole records that it was not made of, from their inputs alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.check.validation import RecordPrediction
from dashpot.data.record import Record
from dashpot.estimate.nonlinear.record_prediction import predict_record
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit


def validate_records(
    model: Model, estimate: Estimate, records: Sequence[Record]
) -> tuple[RecordPrediction, ...]:
    """What the estimate predicts of each whole record of a nonlinear rig; the state at its start is taken from it.

    Raises DataError where the estimate is of another rig, or a record does not suit it.
    """
    estimate.require_unknowns([unknown.name for unknown in model.unknowns])
    return tuple(_prediction(model, estimate, record) for record in records)


def _prediction(model: Model, estimate: Estimate, record: Record) -> RecordPrediction:
    motion = predict_record(model, estimate, record)
    samples, channels = motion.measured.shape
    duration = float(motion.time[-1] + motion.time[1])
    units = {channel.name: channel_unit(model, channel) for channel in record.channels}
    lines = _lines(motion.measured)
    return RecordPrediction(
        motion.names,
        tuple(units[name] for name in motion.names),
        np.arange(len(lines)) / duration,
        lines,
        _lines(motion.predicted),
        1 - motion.relative,
        np.full(channels, np.nan),
        np.full(channels, float(samples)),
        duration,
        samples,
    )


def _lines(history: Real) -> Complex:
    """Peak amplitudes of a history (samples, channels) at the multiples of 1/T, the constant term among them."""
    lines: Complex = np.fft.rfft(history, axis=0) * (2 / len(history))
    return lines
