"""Records that were not used, predicted from an estimate of a nonlinear rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.nonlinear.record_problem import RecordProblem, begun_problem
from dashpot.estimate.nonlinear.records import RecordData, arranged
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

STEPS = 24  # of Gauss and Newton for the start of a record
SETTLED = 1e-6  # of the squared residuals, that one more step would take away


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
    """The motion of an estimate; only the state at its start is taken from the record, and what accelerations of bases
    lack.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    data = arranged(model, record)
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    theta = np.array([values[u.name] for u in model.unknowns])
    gains = [values[f"{n}.gain"] for n, g in zip(data.names, data.gain, strict=True) if g >= 0]
    sd = np.ones(len(data.names))
    problem, own = begun_problem(model, (data,), theta, sd)
    offset = [values.get(f"{model.force_inputs[j]}.offset", 0.0) for j in problem.constants.offsets]
    fixed = np.concatenate([theta, gains, offset])
    psi = np.concatenate([fixed, _likeliest_start(problem, fixed, own)])
    return FollowedRecord(problem, psi, problem.residuals(psi, slopes=False)[0][0])


def _likeliest_start(problem: RecordProblem, fixed: Real, start: Real) -> Real:
    """The record's own unknowns with which the motion is nearest to the measured one; states of laws stay.

    Raises DataError where no motion follows from the first `start`.
    """
    free = problem.constants
    seen = [j for j, state in enumerate(free.starts) if state < 2 * problem.model.n]
    seen += range(len(free.starts), problem.states)
    best, least, step = start, np.inf, np.zeros(len(seen))
    for _ in range(STEPS):
        tried = best.copy()
        tried[seen] += step
        residual, J = problem.residual(0, np.concatenate([fixed, tried]))
        square = float(np.sum(residual**2)) if J is not None else np.inf
        if J is None or not square < least:
            if not np.isfinite(least):
                source = problem.records[0].source
                raise DataError(
                    "the motion cannot be followed", source, "check that it is a record of this rig"
                )
            step = step / 4
            continue
        ended = square > (1 - SETTLED) * least
        best, least = tried, square
        if ended:
            break
        along = J[..., problem.inner :][..., seen].reshape(-1, len(seen))
        step = np.linalg.lstsq(along, residual.ravel(), rcond=1e-8)[0].astype(np.float64)
    return best


def followed_records(problem: RecordProblem, psi: Real) -> list[FollowedRecord]:
    """The motions of a fit itself, ψ (M,), with the inputs that are taken for the true ones."""
    motions, last = [], problem.motions()
    for k, data in enumerate(problem.records):
        alone = np.concatenate([psi[: problem.inner], psi[problem.of_record(k)]])
        one = replace(
            problem, records=(problem.data_at(k, psi),), begun=(problem.begun[k],), substeps=(problem.substeps[k],),
            last={0: last[k]} if k in last else {}, inputs=None, sd=np.ones(len(data.names)),
        )  # fmt: skip
        motions.append(FollowedRecord(one, alone, problem.residual(k, psi, slopes=False)[0] * problem.sd))
    return motions


def predict_record(model: Model, estimate: Estimate, record: Record) -> PredictedMotion:
    """What an estimate predicts of a record; only the state at its start is taken from it.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    return followed_record(model, estimate, record).compared()
