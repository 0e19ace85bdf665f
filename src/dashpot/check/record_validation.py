"""How well an estimate of a nonlinear rig predicts whole records that it was not made of, from their inputs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.check.validation import RecordPrediction
from dashpot.data.conditioning.still import Still
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.nonlinear.record_prediction import FollowedRecord, followed_record
from dashpot.estimate.nonlinear.records import NoiseAtRest, noise_of_channels
from dashpot.estimate.nonlinear.uncertain_inputs import (
    LinearisedRecord,
    NotSolvedError,
    OutputCovariance,
    known_inputs,
)
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit


def validate_records(
    model: Model, estimate: Estimate, records: Sequence[Record], still: Still | None = None
) -> tuple[RecordPrediction, ...]:
    """What the estimate predicts of each whole record of a nonlinear rig; the state at its start is taken from it.

    still: the noise that a record at rest shows; χ² counts that of the channels and, through the rig, of the inputs.
    Raises DataError where the estimate is of another rig, or a record does not suit it.
    """
    estimate.require_unknowns([unknown.name for unknown in model.unknowns])
    return tuple(_prediction(model, estimate, record, still) for record in records)


def _prediction(model: Model, estimate: Estimate, record: Record, still: Still | None) -> RecordPrediction:
    followed = followed_record(model, estimate, record)
    motion = followed.compared()
    samples, channels = motion.measured.shape
    duration = float(motion.time[-1] + motion.time[1])
    units = {channel.name: channel_unit(model, channel) for channel in record.channels}
    lines = _lines(motion.measured)
    chi2, dof = np.full(channels, np.nan), np.full(channels, float(samples))
    if still is not None and len(model.inputs):
        chi2, dof = _chi2(followed, noise_of_channels(model, record, still))
    return RecordPrediction(
        motion.names,
        tuple(units[name] for name in motion.names),
        np.arange(len(lines)) / duration,
        lines,
        _lines(motion.predicted),
        1 - motion.relative,
        chi2,
        dof,
        duration,
        samples,
    )


def _chi2(followed: FollowedRecord, noise: NoiseAtRest) -> tuple[Real, Real]:
    """χ² of each channel's residual by itself, and its degrees of freedom, (channels,): the start is free.

    Noise of the inputs counts as the rig passes it on; NaN where the motion hangs too much on them for that.
    """
    data = followed.data
    known = known_inputs(data.inputs, np.sqrt(noise.inputs))
    problem = replace(followed.problem, sd=noise.outputs, inputs=(known,), errors={}, covariances={})
    residual, J = problem.residual(0, followed.psi)
    if J is None:
        raise DataError("the motion cannot be followed", data.source, "check that it is a record of this rig")
    V, starts = problem.covariances[0], np.arange(problem.inner, len(followed.psi))
    chi2, dof = np.empty(len(data.names)), np.empty(len(data.names))
    for c in range(len(data.names)):
        only = np.array([c])
        along = replace(V.tangent, shown=V.tangent.shown[:, only], direct=V.tangent.direct[:, only])
        by_itself = OutputCovariance(along, V.weight[only], known)
        drifting = np.flatnonzero(np.array(data.drift)[only])
        linear = LinearisedRecord(by_itself, residual[:, only], J[:, only][..., starts], starts, drifting)
        try:
            normal = linear.normal_equations()
        except NotSolvedError:
            chi2[c] = np.nan
        else:
            free = np.linalg.lstsq(normal.matrix, normal.gradient, rcond=1e-12)[0]
            chi2[c] = normal.cost - float(normal.gradient @ free)
        dof[c] = data.samples - len(starts) - len(drifting)
    return chi2, dof


def _lines(history: Real) -> Complex:
    """Peak amplitudes of a history (samples, channels) at the multiples of 1/T, the constant term among them."""
    lines: Complex = np.fft.rfft(history, axis=0) * (2 / len(history))
    return lines
