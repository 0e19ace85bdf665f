"""Identification of nonlinear rigs from whole records: maximum likelihood by integration in time (THEORY §9).

Unknown beside θ and gains: the state at the start of each record, and a constant offset of every force input, which
shifts the working point of a nonlinear rig and so is no matter of taking means out.  Inputs count as exact.  Noise is
white for the fit and of whatever colour the residuals have for the intervals (a sandwich with their spectrum).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.data.record import Record
from dashpot.errors import DataError, UsageError
from dashpot.estimate.nonlinear.record_inference import record_estimate
from dashpot.estimate.nonlinear.record_problem import RecordProblem, enough_substeps
from dashpot.estimate.nonlinear.record_regression import first_record_values
from dashpot.estimate.nonlinear.records import (
    RecordData,
    arranged,
    measured_coordinates,
)
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.nonlinear.integration import Integrator
from dashpot.model.nonlinear.propagation import forcing
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise
from dashpot.numerics.small_systems import solve_scaled

METHOD = "ml"  # what the search is
LIMIT = 60  # iterations
EXACT = 1e-6  # of a channel's rms: residuals below it count no less
TOLERANCE = 1e-4  # standard deviations
HALVINGS = 3  # of the integration's steps, at most
MOVED = 0.05  # standard deviations by which half steps may move an estimate
FAR = 3.0  # standard deviations beyond which one step of Gauss and Newton is not enough


@dataclass(frozen=True)
class FittedRecords:
    """Where the search over whole records ended: ψ (M,) of the problem, θ after each round, bounds."""

    problem: RecordProblem
    psi: Real
    converged: bool
    iterations: int
    history: Real
    limits: tuple[Real, Real]

    def estimate(self) -> Estimate:
        """Values with intervals.  Raises DataError and IdentifiabilityError."""
        return record_estimate(
            self.problem, self.psi, self.converged, self.iterations, self.history, self.limits
        )


def identify_records(
    model: Model,
    records: Sequence[Record],
    method: str | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Estimate the unknowns of a nonlinear rig from whole records of any excitation, by maximum likelihood.

    Raises UsageError where another `method` is named, DataError where an input or all motion is not measured, or an
    unknown needs a guess: where not all coordinates are measured as displacements, every unknown does.
    """
    if method not in (None, METHOD):
        raise UsageError(
            f"the method {method} cannot handle whole records of nonlinear rigs",
            cure=f"use the method {METHOD}",
        )
    return fit_records(model, records, progress=progress).estimate()


def fit_records(
    model: Model, records: Sequence[Record], *, progress: Callable[[int, int], None] | None = None
) -> FittedRecords:
    """The most likely ψ.  Raises as `identify_records`."""
    model.require_unknowns()
    if not len(model.nonlinear):
        raise UsageError(
            "the rig has no nonlinear element",
            cure="use `identify`, which knows whole records of linear rigs",
        )
    data = tuple(arranged(model, record) for record in records)
    if len({record.names for record in data}) > 1:
        raise DataError(
            "the records have different channels", cure="identify those of one set of channels together"
        )
    problem, psi = _begun(model, data)
    history = [psi[: problem.inner]]
    sizes = 100 * problem.sd
    limits = _bounds(problem, psi)
    for turn in range(3):
        end = _descended(problem, psi, limits)
        psi = end.x[0]
        history.append(psi[: problem.inner])
        left = np.concatenate([residual for residual, _ in problem.residuals(psi, slopes=False)])
        ratio = np.sqrt(np.mean(left**2, axis=0))
        if not np.all(np.isfinite(ratio)):
            break
        problem.sd = np.maximum(problem.sd * ratio, EXACT * sizes)
        if progress is not None:
            progress(turn + 1, 3)
        if len(problem.sd) == 1 or np.all(np.abs(ratio / ratio[0] - 1) < 0.02):
            break
    problem, psi = _refined(problem, psi, limits)
    history.append(psi[: problem.inner])
    return FittedRecords(
        problem, psi, bool(end.converged[0]), int(end.iterations[0]), np.array(history), limits
    )


def _descended(problem: RecordProblem, psi: Real, limits: tuple[Real, Real]) -> OptimizeResult:
    """The least misfit from ψ (M,) on, within bounds."""

    def evaluate(x: Real, rows: Ints) -> QuadraticModel:
        del rows
        return problem.quadratic(x)

    lower, upper = limits
    return minimise(
        evaluate, psi[None], limit=LIMIT, tolerance=TOLERANCE, lower=lower, upper=upper, patience=LIMIT
    )


def _refined(problem: RecordProblem, psi: Real, limits: tuple[Real, Real]) -> tuple[RecordProblem, Real]:
    """The problem with steps halved until that moves the estimate no more, and where it ends, ψ (M,).

    Kinks of laws make the integration's error fall with the square of the step only.
    """
    for _ in range(HALVINGS):
        finer = problem.finer()
        around = finer.quadratic(psi[None])
        step = solve_scaled(around.symmetric, around.gradient)[0]
        sd = np.sqrt(np.abs(np.diagonal(around.inverse[0])))
        moved = np.max(np.abs(step) / sd)
        if not moved > MOVED:
            break
        problem = finer
        psi = np.clip(psi + step, *limits) if moved < FAR else _descended(finer, psi, limits).x[0]
    return problem, psi


def _bounds(problem: RecordProblem, psi: Real) -> tuple[Real, Real]:
    lower, upper = np.full(len(psi), -np.inf), np.full(len(psi), np.inf)
    m = len(problem.model.unknowns)
    lower[:m], upper[:m] = problem.model.bounds
    return lower, upper


def _begun(model: Model, records: tuple[RecordData, ...]) -> tuple[RecordProblem, Real]:
    """The problem and where its search starts."""
    theta = first_record_values(model, records)
    gains = max((g for record in records for g in record.gain), default=-1) + 1
    sd = np.sqrt(np.mean(np.concatenate([record.outputs for record in records]) ** 2, axis=0))
    sd = np.where(sd > 0, 0.01 * sd, 1.0)
    substeps = tuple(enough_substeps(model, theta, record.step_s) for record in records)
    problem = RecordProblem(model, records, gains, sd, substeps)
    starts = []
    for record in records:
        machine = Integrator(model, theta, forcing(record.step_s, record.inputs[:8]), 1)
        problem.states = machine.states
        start = np.zeros(machine.states)
        x = measured_coordinates(model, record)
        if x is not None:
            start[: model.n] = x[0]
            start[model.n : 2 * model.n] = (-3 * x[0] + 4 * x[1] - x[2]) / (2 * record.step_s)
        starts.append(start)
    return problem, np.concatenate([theta, np.ones(gains), np.zeros(model.S.shape[1]), *starts])
