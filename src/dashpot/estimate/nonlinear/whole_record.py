"""Identification of nonlinear rigs from whole records: maximum likelihood by integration in time (THEORY §9).

Unknown beside θ and gains: the state at the start of each record, and a constant offset of every force input, which
shifts the working point of a nonlinear rig and so is no matter of taking means out.  Inputs count as exact.  Noise is
white for the fit and of whatever colour the residuals have for the intervals (a sandwich with their spectrum).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.data.record import Record
from dashpot.errors import DataError, UsageError
from dashpot.estimate.inference.derived import known_values, tied_values
from dashpot.estimate.inference.diagnostics import require_determined
from dashpot.estimate.nonlinear.record_regression import fitted, weak_form
from dashpot.estimate.nonlinear.records import (
    RecordData,
    arranged,
    measured_coordinates,
    shown,
    total_samples,
)
from dashpot.estimate.nonlinear.starting_values import constants_to_try
from dashpot.estimate.result import Estimate, Fit
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from dashpot.model.nonlinear.integration import Integrator, forcing, integrate
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise
from dashpot.numerics.small_systems import scaled_inverse

LIMIT = 60  # iterations
EXACT = 1e-6  # of a channel's rms: residuals below it count no less
TOLERANCE = 1e-4  # standard deviations
HALF_BAND = 30  # lines on each side over which the residuals' spectrum is smoothed
STEP = 0.8  # of a step times the fastest rate of the linear rig
ROUGH = 2  # more steps where laws are not smooth
COLOURED = 1.5  # ratio of intervals with and without the residuals' colour that is told


@dataclass
class _Problem:
    """All that one evaluation needs; `starts` holds the last motion of each record, from which the next is found."""

    model: Model
    records: tuple[RecordData, ...]
    gains: int
    sd: Real
    substeps: tuple[int, ...]
    starts: dict[int, Real] = field(default_factory=dict)
    states: int = 0

    @property
    def inner(self) -> int:
        """Unknowns before the starts of the records: θ, gains, offsets."""
        return len(self.model.unknowns) + self.gains + int(self.model.S.shape[1])

    def residuals(self, psi: Real, slopes: bool = True) -> list[tuple[Real, Real | None]]:
        """For each record: measured less shown, in standard deviations, and slopes of what is shown, (…, unknowns)."""
        m, s = len(self.model.unknowns), self.model.S.shape[1]
        theta, gain = psi[:m], psi[m : m + self.gains]
        offset = psi[m + self.gains : self.inner]
        results: list[tuple[Real, Real | None]] = []
        for k, data in enumerate(self.records):
            machine = Integrator(
                self.model, theta, forcing(data.step_s, data.inputs), self.substeps[k], offset
            )
            first = self.inner + k * self.states
            start = psi[first : first + self.states]
            motion = integrate(machine, start, self.starts.get(k), slopes=slopes)
            if not motion.closed:
                results.append((np.full_like(data.outputs, np.inf), None))
                continue
            y, J = shown(machine, data, motion)
            factor = np.array([1.0 if g < 0 else gain[g] for g in data.gain])
            residual = data.outputs - factor * y
            zero = np.array(data.drift)
            residual = residual - np.where(zero, np.mean(residual, axis=0), 0.0)
            if J is None:
                results.append((residual / self.sd, None))
                continue
            total = np.zeros((*J.shape[:2], len(psi)))
            total[..., :m] = J[..., self.states : self.states + m]
            total[..., m + self.gains : self.inner] = J[..., self.states + m : self.states + m + s]
            total[..., first : first + self.states] = J[..., : self.states]
            total *= factor[:, None]
            for c, g in enumerate(data.gain):
                if g >= 0:
                    total[:, c, m + g] = y[:, c]
            total = total - np.where(zero[:, None], np.mean(total, axis=0), 0.0)
            self.starts[k] = motion.starts
            results.append((residual / self.sd, total / self.sd[:, None]))
        return results

    def quadratic(self, psi: Real) -> QuadraticModel:
        """Cost with priors, slope and curvature at ψ (1, M)."""
        M = psi.shape[-1]
        cost, gradient, matrix = 0.0, np.zeros(M), np.zeros((M, M))
        impossible = not np.all(np.isfinite(psi))
        for residual, J in [] if impossible else self.residuals(psi[0]):
            if J is None:
                impossible = True
                break
            flat = J.reshape(-1, M)
            cost += float(np.sum(residual**2))
            gradient += flat.T @ residual.ravel()
            matrix += flat.T @ flat
        if impossible:
            nothing = np.full((1, M, M), np.nan)
            return QuadraticModel(np.array([np.inf]), nothing[..., 0], nothing, nothing)
        prior, mean = np.zeros(M), np.zeros(M)
        m = len(self.model.unknowns)
        prior[:m], mean[:m] = self.model.prior_precision, self.model.prior_mean
        away = psi[0] - mean
        matrix += np.diag(prior)
        total = cost + float(np.sum(prior * away**2))
        return QuadraticModel(np.array([total]), (gradient - prior * away)[None], matrix[None], matrix[None])


def identify_records(
    model: Model, records: Sequence[Record], *, progress: Callable[[int, int], None] | None = None
) -> Estimate:
    """Estimate the unknowns of a nonlinear rig from whole records of any excitation.

    Raises DataError where an input or all motion is not measured, or an unknown needs a guess: where not all
    coordinates are measured as displacements, every unknown does.
    """
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
    lower, upper = _bounds(problem, psi)
    for turn in range(3):

        def evaluate(x: Real, rows: Ints) -> QuadraticModel:
            del rows
            return problem.quadratic(x)

        end = minimise(
            evaluate, psi[None], limit=LIMIT, tolerance=TOLERANCE, lower=lower, upper=upper, patience=LIMIT
        )  # fmt: skip
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
    return _estimate(
        problem, psi, bool(end.converged[0]), int(end.iterations[0]), np.array(history), (lower, upper)
    )


def _bounds(problem: _Problem, psi: Real) -> tuple[Real, Real]:
    lower, upper = np.full(len(psi), -np.inf), np.full(len(psi), np.inf)
    m = len(problem.model.unknowns)
    lower[:m], upper[:m] = problem.model.bounds
    return lower, upper


def _begun(model: Model, records: tuple[RecordData, ...]) -> tuple[_Problem, Real]:
    """The problem and where its search starts."""
    theta = _first_values(model, records)
    gains = max((g for record in records for g in record.gain), default=-1) + 1
    sd = np.sqrt(np.mean(np.concatenate([record.outputs for record in records]) ** 2, axis=0))
    sd = np.where(sd > 0, 0.01 * sd, 1.0)
    substeps = tuple(_substeps(model, theta, record.step_s) for record in records)
    problem = _Problem(model, records, gains, sd, substeps)
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


def _substeps(model: Model, theta: Real, step_s: float) -> int:
    """Steps between samples: enough for the fastest mode of the linear part, and for kinks of the laws."""
    parts = matrices(model, model.parameters(theta))
    n = model.n
    try:
        inverse = np.linalg.inv(parts.M)
    except np.linalg.LinAlgError:
        return 1
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ parts.K, -inverse @ parts.C]])
    fastest = float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))
    rough = any(e.force_law is not None and not e.force_law.smooth for e in model.elements)
    return max(1, int(np.ceil(fastest * step_s / STEP))) * (ROUGH if rough else 1)


def _first_values(model: Model, records: tuple[RecordData, ...]) -> Real:
    """Guesses where all are given; else the weak form of the equation where all coordinates are measured."""
    given = [u.prior if u.prior is not None else u.guess for u in model.unknowns]
    open_names = [u.name for u, value in zip(model.unknowns, given, strict=True) if value is None]
    if not open_names:
        return np.array(given, dtype=float)
    x = measured_coordinates(model, records[0])
    if x is None or any(e.force_law is not None and e.force_law.has_state for e in model.elements):
        why = "not all coordinates are measured as displacements" if x is None else "a law has a state"
        raise DataError(
            f"{', '.join(open_names)} {'has' if len(open_names) == 1 else 'have'} no guess, and {why}",
            cure="write guess = … for the unknowns in the rig file",
        )
    record, r = records[0], model.D.shape[1]
    form = weak_form(model, record.step_s, x, record.inputs[:, :r], record.inputs[:, r:])
    chosen = model.nonlinear
    d, v = form.elongation[:, chosen], form.rate[:, chosen]
    best: tuple[float, Real] | None = None
    for constants in constants_to_try(model, np.max(np.abs(d), axis=0), np.max(np.abs(v), axis=0)):
        unit = np.empty_like(d)
        for row, (index, own) in enumerate(zip(chosen, model.constant_slices, strict=True)):
            law = model.elements[int(index)].force_law
            assert law is not None
            unit[:, row] = law(d[:, row], v[:, row], d[:, row], constants[own]).value
        p, residual = fitted(form, unit)
        slope, known = model.constants_map
        theta = (constants - known) @ slope
        theta[np.any(model.T, axis=0)] = p
        if np.all(np.isfinite(theta)) and (best is None or residual < best[0]):
            best = residual, theta
    if best is None:
        raise DataError(
            "the motion does not determine the unknowns", record.source, "give guesses in the rig file"
        )
    low, high = model.bounds
    return np.clip(np.where(model.prior_precision > 0, model.prior_mean, best[1]), low, high)


def _estimate(
    problem: _Problem, psi: Real, converged: bool, iterations: int, history: Real, limits: tuple[Real, Real]
) -> Estimate:
    """Values, and intervals that count the colour of the residuals."""
    model, M, inner = problem.model, len(psi), problem.inner
    matrix, meat = np.zeros((M, M)), np.zeros((M, M))
    squares = 0.0
    for residual, J in problem.residuals(psi):
        if J is None:
            raise DataError(
                "no motion follows from the start", cure="give guesses of the unknowns nearer to the truth"
            )
        flat = J.reshape(-1, M)
        matrix += flat.T @ flat
        squares += float(np.sum(residual**2))
        for c in range(residual.shape[1]):
            meat += _coloured(residual[:, c], J[:, c])
    dof = max(total_samples(problem.records) - M, 1)
    m = len(model.unknowns)
    prior = np.zeros(M)
    prior[:m] = model.prior_precision
    bread = scaled_inverse(matrix + np.diag(prior))
    white = bread * squares / dof
    coloured = bread @ (meat + np.diag(prior)) @ bread * total_samples(problem.records) / dof
    names, units = _names(problem)
    values = psi[:inner]
    covariance = coloured[:inner, :inner]
    require_determined(names, values, white[:inner, :inner])
    sd, plain = np.sqrt(np.diagonal(covariance)), np.sqrt(np.diagonal(white)[:inner])
    warnings = []
    if np.median(sd / plain) > COLOURED:
        text = (
            f"the residuals are coloured: intervals are {float(np.median(sd / plain)):.2g} times those of white noise; "
            "the model or the measured input lacks something"
        )
        warnings.append(Notice("coloured_residuals", text))
    rms = ", ".join(f"{n} {s:.3g}" for n, s in zip(problem.records[0].names, problem.sd, strict=True))
    notes = (Notice("record_residuals", f"residuals of the whole records, rms in SI units: {rms}"),)
    lower, upper = limits[0][:inner], limits[1][:inner]
    held = (values <= lower) | (values >= upper)
    warnings += [
        Notice("at_bound", f"{name} is at its bound", (name,))
        for name, at in zip(names, held, strict=True)
        if at
    ]
    return Estimate(
        model=model.name, method="ml", names=names, units=units, values=values, covariance=covariance,
        noise_covariance=covariance, bound_sd=plain, dof=np.full(inner, float(dof)), lower=lower, upper=upper,
        free_values=values, basis="residuals", converged=np.asarray(converged),
        iterations=np.asarray(iterations, dtype=np.int64), history=history,
        fit=Fit(np.asarray(float(dof)), dof, np.asarray(np.nan), known_noise=False), known=known_values(model),
        tied=tied_values(model), modes=None, signs={}, warnings=tuple(warnings), notes=notes,
    )  # fmt: skip


def _names(problem: _Problem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    model, first = problem.model, problem.records[0]
    gains = [
        next(n for n, g in zip(first.names, first.gain, strict=True) if g == k) for k in range(problem.gains)
    ]
    names = [u.name for u in model.unknowns] + [f"{name}.gain" for name in gains]
    units = [u.unit for u in model.unknowns] + ["1"] * problem.gains
    offsets = [f"{name}.offset" for name in model.force_inputs]
    return (*names, *offsets), (*units, *["N"] * len(offsets))


def _coloured(residual: Real, J: Real) -> Real:
    """Σ_tτ J_t R(t − τ) J_τᵀ with the autocovariance R of the residuals, by their smoothed spectrum."""
    N = len(residual)
    spectrum = np.abs(np.fft.rfft(residual)) ** 2 / N
    width = min(2 * HALF_BAND + 1, len(spectrum))
    kernel = np.ones(width) / width
    padded = np.pad(spectrum, width // 2, mode="reflect") if len(spectrum) > width // 2 else spectrum
    smooth = np.convolve(padded, kernel, mode="valid")[: len(spectrum)]
    lines = np.fft.rfft(J, axis=0)
    weight = np.full(len(spectrum), 2.0)
    weight[0] = 1.0
    if N % 2 == 0:
        weight[-1] = 1.0
    meat: Real = ((np.conj(lines) * (weight * smooth)[:, None]).T @ lines).real / N
    return meat


@dataclass(frozen=True)
class Prediction:
    """A record that was not used: time (samples,), measured and predicted (samples, channels), rms error of each.

    relative: rms error over the rms of what was measured, less its mean.
    """

    names: tuple[str, ...]
    time: Real
    measured: Real
    predicted: Real
    rms: Real
    relative: Real


def predict_record(model: Model, estimate: Estimate, record: Record) -> Prediction:
    """What an estimate predicts of a record; only the state at its start is taken from it.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    data = arranged(model, record)
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    theta = np.array([values[u.name] for u in model.unknowns])
    gains = [values[f"{n}.gain"] for n, g in zip(data.names, data.gain, strict=True) if g >= 0]
    offset = np.array([values.get(f"{name}.offset", 0.0) for name in model.force_inputs])
    sd = np.ones(len(data.names))
    problem = _Problem(model, (data,), len(gains), sd, (_substeps(model, theta, data.step_s),))
    machine = Integrator(model, theta, forcing(data.step_s, data.inputs[:8]), 1)
    problem.states = machine.states
    fixed = np.concatenate([theta, gains, offset])
    start = np.zeros(machine.states)
    x = measured_coordinates(model, data)
    if x is not None:
        start[: model.n] = x[0]
    for _ in range(2):
        residual, J = problem.residuals(np.concatenate([fixed, start]))[0]
        if J is None:
            raise DataError("the motion cannot be followed", record.source, "see whether it is of this rig")
        own = J[..., problem.inner :].reshape(-1, machine.states)
        seen = 2 * machine.model.n  # states of laws keep what they began with
        start[:seen] += np.linalg.lstsq(own[:, :seen], residual.ravel(), rcond=1e-8)[0]
    residual = problem.residuals(np.concatenate([fixed, start]), slopes=False)[0][0]
    spread = np.sqrt(np.mean((data.outputs - np.mean(data.outputs, axis=0)) ** 2, axis=0))
    rms = np.sqrt(np.mean(residual**2, axis=0))
    time: Real = data.step_s * np.arange(data.samples, dtype=np.float64)
    return Prediction(
        data.names, time, data.outputs, data.outputs - residual, rms, rms / np.where(spread > 0, spread, 1)
    )
