"""Records that were not used, predicted from an estimate of a nonlinear rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.nonlinear.record_problem import RecordProblem, enough_for_record
from dashpot.estimate.nonlinear.records import RecordData, arranged, measured_coordinates
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model


@dataclass(frozen=True)
class PredictedMotion:
    """A record that was not used: time (samples,), measured and predicted (samples, channels), rms error of each.

    relative: rms error over the rms of what was measured, less its mean.
    """

    names: tuple[str, ...]
    time: Real
    measured: Real
    predicted: Real
    rms: Real
    relative: Real


@dataclass(frozen=True)
class FollowedRecord:
    """The motion that an estimate gives one record, from the start that suits it best.

    psi (M,): unknowns of the problem, its standard deviations 1; residual (samples, channels), SI units.
    """

    problem: RecordProblem
    psi: Real
    residual: Real

    @property
    def data(self) -> RecordData:
        """The record."""
        return self.problem.records[0]

    def compared(self) -> PredictedMotion:
        """Beside what was measured."""
        data, residual = self.data, self.residual
        spread = np.sqrt(np.mean((data.outputs - np.mean(data.outputs, axis=0)) ** 2, axis=0))
        rms = np.sqrt(np.mean(residual**2, axis=0))
        time: Real = data.step_s * np.arange(data.samples, dtype=np.float64)
        return PredictedMotion(
            data.names,
            time,
            data.outputs,
            data.outputs - residual,
            rms,
            rms / np.where(spread > 0, spread, 1),
        )


def followed_record(model: Model, estimate: Estimate, record: Record) -> FollowedRecord:
    """The motion of an estimate; only the state at its start is taken from the record.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    data = arranged(model, record)
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    theta = np.array([values[u.name] for u in model.unknowns])
    gains = [values[f"{n}.gain"] for n, g in zip(data.names, data.gain, strict=True) if g >= 0]
    offset = np.array([values.get(f"{name}.offset", 0.0) for name in model.force_inputs])
    sd = np.ones(len(data.names))
    x = measured_coordinates(model, data)
    problem = RecordProblem(model, (data,), len(gains), sd, (enough_for_record(model, theta, data, x),))
    fixed = np.concatenate([theta, gains, offset])
    start = np.zeros(problem.states)
    if x is not None:
        start[: model.n] = x[0]
    for _ in range(2):
        residual, J = problem.residuals(np.concatenate([fixed, start]))[0]
        if J is None:
            raise DataError(
                "the motion cannot be followed", record.source, "check that it is a record of this rig"
            )
        by_inner = J[..., problem.inner :].reshape(-1, problem.states)
        seen = 2 * model.n  # states of laws keep what they began with
        start[:seen] += np.linalg.lstsq(by_inner[:, :seen], residual.ravel(), rcond=1e-8)[0]
    psi = np.concatenate([fixed, start])
    return FollowedRecord(problem, psi, problem.residuals(psi, slopes=False)[0][0])


def followed_records(problem: RecordProblem, psi: Real) -> list[FollowedRecord]:
    """The motions of a fit itself, ψ (M,), with the inputs that are taken for the true ones."""
    motions = []
    for k, data in enumerate(problem.records):
        first = problem.inner + k * problem.states
        alone = np.concatenate([psi[: problem.inner], psi[first : first + problem.states]])
        one = replace(
            problem, records=(problem.data_at(k, psi),), substeps=(problem.substeps[k],), last={}, inputs=None,
            sd=np.ones(len(data.names)),
        )  # fmt: skip
        motions.append(FollowedRecord(one, alone, problem.residual(k, psi, slopes=False)[0] * problem.sd))
    return motions


def predict_record(model: Model, estimate: Estimate, record: Record) -> PredictedMotion:
    """What an estimate predicts of a record; only the state at its start is taken from it.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    return followed_record(model, estimate, record).compared()
