"""Identification of nonlinear rigs from whole records: maximum likelihood by integration in time (THEORY §9).

Unknown beside θ and gains: the state at the start of each record, and a constant offset of every force input, which
shifts the working point of a nonlinear rig and so is no matter of taking means out.  Where the measured inputs show
noise, their true values are unknown too (`input_levels`).  Noise is white for the fit and of whatever colour the
residuals have for the intervals (a sandwich with their spectrum).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.data.conditioning.still import Still
from dashpot.data.record import Record
from dashpot.errors import DataError, UsageError
from dashpot.estimate.nonlinear.input_levels import (
    InputSizes,
    despite_wander,
    steadied,
    with_uncertain_inputs,
)
from dashpot.estimate.nonlinear.objective import must_be_positive
from dashpot.estimate.nonlinear.record_inference import record_estimate
from dashpot.estimate.nonlinear.record_problem import (
    NotSolvedError,
    RecordConstants,
    RecordProblem,
    begun_problem,
    record_constants,
)
from dashpot.estimate.nonlinear.record_regression import first_record_values, mostly_linear_values
from dashpot.estimate.nonlinear.records import (
    NoiseAtRest,
    RecordData,
    arranged,
    noise_of_channels,
    total_samples,
)
from dashpot.estimate.result import Estimate
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.moving_base import moving_rig
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise
from dashpot.numerics.small_systems import solve_scaled

# Starts far from the end of a whole record: the motion is held near the measured one, less and less.
#
# Of a motion that is integrated freely the misfit has many valleys where the rig is strongly nonlinear.
# Springs and dampers between what a channel shows of the rig and what it measured keep the motion near;
# with them the misfit has one wide valley, whose bottom moves to that of the free motion as they are
# weakened. Source: Vyasarayani, Uchida, Carvalho and McPhee (2012), Multibody System Dynamics 26, 411.


HOLDS = (3.0, 1.0, 0.3, 0.1, 0.03)  # natural frequency of a channel on its spring over that of its motion
DAMPING = 0.7  # of that spring
NEAR = 4.0  # misfit of the free motion over that of the held one at which it need be held no more
FOLLOWED = 30.0  # the same of pieces, which are short enough for the search to go on from there
CUTS = 5  # halvings of a record, at most
SHORTEST = 32  # samples of a piece


def released(
    problem: RecordProblem, psi: Real, descend: Callable[[RecordProblem, Real], OptimizeResult]
) -> tuple[RecordProblem, Real]:
    """(problem, ψ) from which the free motion's misfit leads to its least; `descend` finds the least of a held problem.

    Records whose free motion is lost between one end and the other are cut into pieces with starts of their own.  As
    given where no channel shows a displacement with a known gain.
    """
    shown = _shown(problem.records[0])
    if not len(shown):
        return problem, psi
    records = tuple(_with_measured_motion(problem.model, data, shown) for data in problem.records)
    least = np.inf
    for hold in HOLDS:
        held = replace(
            problem, model=_held(problem, psi, shown, hold), records=records, last=problem.motions()
        )
        if not np.isfinite(held.misfit(psi)):
            held.last = {}
        end = descend(held, psi)
        if not (end.converged[0] and end.cost[0] < NEAR * least):  # too weak to hold this motion
            break
        psi, least, problem.last = end.x[0], float(end.cost[0]), held.motions()
        if problem.misfit(psi) < NEAR * least:
            return problem, psi
    states = [problem.last[k].state for k in range(len(problem.records)) if k in problem.last]
    problem.last = {}  # the free motion may be far from the last one that was held
    for _ in range(CUTS if states else 0):
        if min(data.samples for data in problem.records) < 2 * SHORTEST:
            break
        problem, psi, states = _halved(problem, psi, states)
        if problem.misfit(psi) < FOLLOWED * least:
            break
    return problem, psi


def _halved(problem: RecordProblem, psi: Real, states: list[Real]) -> tuple[RecordProblem, Real, list[Real]]:
    """The same with each record cut in two, and likewise the states (samples, states) of their motions."""
    free = problem.constants
    records, parts, own = [], [], [psi[: problem.inner]]
    for k, (data, state) in enumerate(zip(problem.records, states, strict=True)):
        middle = data.samples // 2
        for part in (slice(0, middle), slice(middle, data.samples)):
            records.append(replace(data, inputs=data.inputs[part], outputs=data.outputs[part]))
            parts.append(state[part])
            own += [state[part][0, free.starts], psi[problem.of_record(k)][len(free.starts) :]]
    begun = tuple(part[0] for part in parts)
    substeps = tuple(count for count in problem.substeps for _ in range(2))
    return (
        replace(problem, records=tuple(records), begun=begun, substeps=substeps, pieces=2 * problem.pieces),
        np.concatenate(own),
        parts,
    )


def _shown(data: RecordData) -> list[int]:
    """Outputs that are displacements with known gains, and move."""
    moves = np.ptp(data.outputs, axis=0) > 0
    return [c for c in range(len(data.names)) if data.derivative[c] == 0 and data.gain[c] < 0 and moves[c]]


def _with_measured_motion(model: Model, data: RecordData, shown: list[int]) -> RecordData:
    """The record with what channels show of the coordinates as further displacement inputs."""
    r = model.D.shape[1]
    motion = data.outputs[:, shown] - data.inputs @ data.on_q[shown].T
    inputs = np.concatenate([data.inputs[:, :r], motion, data.inputs[:, r:]], axis=1)
    on_q = np.insert(data.on_q, r, np.zeros((len(shown), 1)), axis=1)
    rated = (*data.rated[:r], *[False] * len(shown), *data.rated[r:]) if data.rated else ()
    return replace(data, inputs=inputs, on_q=on_q, rated=rated)


def _held(problem: RecordProblem, psi: Real, shown: list[int], hold: float) -> Model:
    """The rig with a spring and a damper from each of the channels to its own measurement."""
    model, data = problem.model, problem.records[0]
    inverse = np.linalg.inv(matrices(model, model.parameters(psi[: len(model.unknowns)])).M)
    inputs, elements = [], []
    for c in shown:
        seen = data.on_x[c]
        mass = 1 / float(seen @ inverse @ seen)
        signal = data.outputs[:, c] - np.mean(data.outputs[:, c])
        rate = np.sqrt(np.sum(np.diff(signal) ** 2) / np.sum(signal**2)) / data.step_s
        omega = hold * float(rate)
        name = f"{data.names[c]} as measured"
        along = dict(zip(model.coordinates, seen.tolist(), strict=True)) | {name: -1.0}
        along = {point: factor for point, factor in along.items() if factor}
        inputs.append(Input(name))
        elements.append(Element(f"{name}, spring", Kind.SPRING, along, value=mass * omega**2))
        elements.append(Element(f"{name}, damper", Kind.DAMPER, along, value=2 * DAMPING * mass * omega))
    forces = [source for source in model.inputs if source.kind == "force"]
    moved = [source for source in model.inputs if source.kind != "force"]
    return replace(model, inputs=(*moved, *inputs, *forces), elements=(*model.elements, *elements))


METHOD = "ml"  # what the search is
LIMIT = 60  # iterations
ROUNDS = 3  # of the search, with the noise that the one before has left
FIRST_NOISE = 0.01  # of a channel's rms: its noise before anything is known
UNLIKE = 0.2  # of the channels' rms: residuals of the first motion that is far off
HELD, ROUGHLY = 12, 0.1  # iterations with a held motion, and the standard deviations at which they end
EXACT = 1e-6  # of a channel's rms: residuals below it count no less
TOLERANCE = 1e-4  # standard deviations
HALVINGS = 6  # of the integration's steps, at most
MOST_STEPS = 10**6  # of all records, which halving must not exceed
MOVED = 0.05  # standard deviations by which half steps may move an estimate
SHORTEST_WHOLE_RECORD = 1e-6  # of a start: the least that lengths and speeds inside laws may become
QUIETER = 0.5  # of the noise so far: residuals with finer steps, which coarser ones had made
ERRORS_OF_STEPS = 0.1  # of the squared residuals: what halving the steps changes where these are too long
FAR = 3.0  # standard deviations beyond which one step of Gauss and Newton is not enough


@dataclass(frozen=True)
class FittedRecords:
    """Where the search over whole records ended: ψ (M,) of the problem, θ after each round, bounds.

    noise: of the inputs, None where they show none or are `held` at what was measured, whose errors defy reckoning.
    """

    problem: RecordProblem
    psi: Real
    converged: bool
    iterations: int
    history: Real
    limits: tuple[Real, Real]
    noise: InputSizes | None = None
    held: bool = False

    def estimate(self) -> Estimate:
        """Values with intervals.  Raises DataError and IdentifiabilityError."""
        return record_estimate(
            self.problem,
            self.psi,
            self.converged,
            self.iterations,
            self.history,
            self.limits,
            self.noise,
            self.held,
        )


def identify_records(
    model: Model,
    records: Sequence[Record],
    method: str | None = None,
    *,
    still: Still | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Estimate the unknowns of a nonlinear rig from whole records of any excitation, by maximum likelihood.

    still: the noise that a record at rest shows; without it the residuals tell how large it is.

    Raises UsageError where another `method` is named, DataError where an input or all motion is not measured, or an
    unknown needs a guess: where not all coordinates are measured as displacements, every unknown does.
    """
    return fit_records(model, records, method, still=still, progress=progress).estimate()


def fit_records(
    model: Model,
    records: Sequence[Record],
    method: str | None = None,
    *,
    still: Still | None = None,
    exact_inputs: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> FittedRecords:
    """The most likely ψ; still: the noise that a record at rest shows.

    exact_inputs: with the measured inputs for the true ones, whatever their noise.  Raises as `identify_records`.
    """
    _require_able(model, method)
    data = tuple(arranged(model, record) for record in records)
    if len({(record.names, record.bases.names, record.bases.orders) for record in data}) > 1:
        raise DataError(
            "the records have different channels", cure="identify those of one set of channels together"
        )
    data = data if exact_inputs else steadied(model, data)
    problem, psi = _begun(model, data)
    at_rest = None if still is None else noise_of_channels(model, records[0], still)
    ended = None if exact_inputs else _despite_wander(problem, psi, data, at_rest)
    if ended is None:
        ended = _with_exact_inputs(problem, psi, progress)
        if ended.converged and not exact_inputs:
            ended = _with_true_inputs(ended, data, at_rest)
    return _refined(ended) if ended.converged else ended


def _with_exact_inputs(
    problem: RecordProblem, psi: Real, progress: Callable[[int, int], None] | None
) -> FittedRecords:
    """The fit with the measured inputs for the true ones, from ψ (M,) or wherever a start must be looked for."""
    model, data = problem.rig, problem.records
    before = replace(problem, last={})  # a search changes the noise and the last motions of its problem
    # Whether the motion at the start ψ (M,) is so unlike the measured one that the search might end anywhere
    power = problem.misfit(psi) * FIRST_NOISE**2 / total_samples(problem.records)
    far = not power < UNLIKE**2
    if far:
        linear = mostly_linear_values(model, data)  # noise makes laws of what the motion hardly shows
        if linear is not None:
            problem, psi = _from_linear(model, data, linear)
            before, far = replace(problem, last={}), False
    if far:
        problem, psi = _released(problem, psi)
    search = _searched(problem, psi, progress)
    if not search.converged[0]:
        problem, search = _with_finer_steps(problem, search, progress)
    if not (far or search.converged[0]):
        problem, psi = _released(before, psi)
        search = _searched(problem, psi, progress)
    limits = _bounds(problem, search.x[0])
    return FittedRecords(
        problem, search.x[0], bool(search.converged[0]), int(search.iterations[0]), search.history, limits
    )


def _despite_wander(
    problem: RecordProblem, psi: Real, measured: Sequence[RecordData], at_rest: NoiseAtRest | None
) -> FittedRecords | None:
    """The fit where noise of bases carries the rig far from where it was; None where it does not."""
    problem = replace(problem, last={})

    def descend(held: RecordProblem, x: Real, limit: int) -> OptimizeResult:
        return _descended(held, x, _bounds(held, x), limit)

    begun = despite_wander(problem, psi, measured, descend)
    if begun is None:
        return None
    exact = FittedRecords(problem, begun, True, 0, psi[None, : problem.inner], _bounds(problem, psi))
    ended = _with_true_inputs(exact, measured, at_rest)
    return None if ended.noise is None else ended


def _require_able(model: Model, method: str | None) -> None:
    """Raises UsageError where another method is named or the rig is linear, ModelError where nothing is unknown."""
    if method not in (None, METHOD):
        raise UsageError(
            f"the method {method} cannot handle whole records of nonlinear rigs",
            cure=f"use the method {METHOD}",
        )
    model.require_unknowns()
    if not len(model.nonlinear):
        raise UsageError(
            "the rig has no nonlinear element",
            cure="use `identify`, which knows whole records of linear rigs",
        )


def _with_true_inputs(
    exact: FittedRecords, measured: Sequence[RecordData], at_rest: NoiseAtRest | None
) -> FittedRecords:
    """The fit with the true inputs unknown, where those measured show noise; as it is where they show none."""

    def descend(problem: RecordProblem, psi: Real, limit: int) -> OptimizeResult:
        return _descended(problem, psi, exact.limits, limit)

    try:
        better = with_uncertain_inputs(exact.problem, exact.psi, measured, descend, at_rest)
    except NotSolvedError:
        return replace(exact, held=True)
    if better is None:
        return exact
    problem, end, noise = better
    history = np.concatenate([exact.history, end.x[:, : problem.inner]])
    iterations = exact.iterations + int(end.iterations[0])
    return FittedRecords(problem, end.x[0], bool(end.converged[0]), iterations, history, exact.limits, noise)


def _released(problem: RecordProblem, psi: Real) -> tuple[RecordProblem, Real]:
    """The problem, perhaps in pieces, and ψ (M,) that follow from holding the motion near the measured one."""
    limits = _bounds(problem, psi)
    return released(problem, psi, lambda held, x: _descended(held, x, limits, HELD, ROUGHLY))


def _searched(
    problem: RecordProblem,
    psi: Real,
    progress: Callable[[int, int], None] | None,
) -> OptimizeResult:
    """The least misfit from ψ (M,) on, and the noise of the channels, which `problem` learns.

    history (rounds + 1, unknowns before the starts).
    """
    limits = _bounds(problem, psi)
    history = [psi[: problem.inner]]
    sizes = problem.sd / FIRST_NOISE
    for turn in range(ROUNDS):
        end = _descended(problem, psi, limits)
        psi = end.x[0]
        history.append(psi[: problem.inner])
        left = np.concatenate([residual for residual, _ in problem.residuals(psi, slopes=False)])
        ratio = np.sqrt(np.mean(left**2, axis=0))
        if not np.all(np.isfinite(ratio)):
            break
        problem.sd = np.maximum(problem.sd * ratio, EXACT * sizes)
        if progress is not None:
            progress(turn + 1, ROUNDS)
        if len(problem.sd) == 1 or np.all(np.abs(ratio / ratio[0] - 1) < 0.02):
            break
    return replace(end, history=np.array(history))


def _with_finer_steps(
    problem: RecordProblem, search: OptimizeResult, progress: Callable[[int, int], None] | None
) -> tuple[RecordProblem, OptimizeResult]:
    """A search that did not end, gone on with halved steps while what is left over is mostly their error.

    Corners of laws within steps make the misfit a staircase, on whose last steps a search of exact data goes round.
    """
    for _ in range(HALVINGS):
        finer, psi = problem.finer(), search.x[0]
        if search.converged[0] or finer.steps > MOST_STEPS or not _steps_are_coarse(problem, finer, psi):
            break
        problem = finer
        search = _searched(problem, psi, progress)
    return problem, search


def _steps_are_coarse(problem: RecordProblem, finer: RecordProblem, psi: Real) -> bool:
    """Whether steps half as long move what channels show by as much as it is off, at ψ (M,)."""
    coarse, fine = (
        np.concatenate([residual for residual, _ in each.residuals(psi, slopes=False)])
        for each in (problem, finer)
    )
    with np.errstate(invalid="ignore"):  # a motion that does not close is no number
        return bool(np.sum((fine - coarse) ** 2) > ERRORS_OF_STEPS * np.sum(coarse**2))


def _descended(
    problem: RecordProblem,
    psi: Real,
    limits: tuple[Real, Real],
    limit: int = LIMIT,
    tolerance: float = TOLERANCE,
) -> OptimizeResult:
    """The least misfit from ψ (M,) on, within bounds."""

    def evaluate(x: Real, rows: Ints) -> QuadraticModel:
        del rows
        return problem.quadratic(x)

    lower, upper = limits
    return minimise(
        evaluate, psi[None], limit=limit, tolerance=tolerance, lower=lower, upper=upper, patience=limit
    )


def _refined(fitted: FittedRecords) -> FittedRecords:
    """The fit with steps halved until that moves the estimate no more.

    Kinks of laws make the integration's error fall with the square of the step only.
    """
    problem, psi = fitted.problem, fitted.psi
    for _ in range(HALVINGS):
        finer = problem.finer()
        if finer.steps > MOST_STEPS:
            break
        around = finer.quadratic(psi[None])
        step = solve_scaled(around.symmetric, around.gradient)[0]
        moved = np.max(np.abs(step) / around.sd[0])
        if not moved > MOVED:
            break
        problem = finer
        if moved < FAR:
            psi = np.clip(psi + step, *fitted.limits)
        else:
            psi = _descended(finer, psi, fitted.limits).x[0]
        _quietened(problem, psi)
    history = np.concatenate([fitted.history, psi[None, : problem.inner]])
    return replace(fitted, problem=problem, psi=psi, history=history)


def _quietened(problem: RecordProblem, psi: Real) -> None:
    """Let the problem know less noise where the residuals at ψ (M,) were errors of coarser steps."""
    if problem.inputs is not None:
        return
    left = np.concatenate([residual for residual, _ in problem.residuals(psi, slopes=False)])
    ratio = np.sqrt(np.mean(left**2, axis=0))
    if np.all(ratio < QUIETER):
        problem.sd = np.maximum(problem.sd * ratio, EXACT * problem.sizes())


def _bounds(problem: RecordProblem, psi: Real) -> tuple[Real, Real]:
    lower, upper = np.full(len(psi), -np.inf), np.full(len(psi), np.inf)
    m = len(problem.model.unknowns)
    lower[:m], upper[:m] = problem.model.bounds
    # A law may be even in a length or a speed inside it; what is at 0 divides by it.
    lengths = np.any(problem.model.constants_map[0][must_be_positive(problem.model)] > 0, axis=0)
    lower[:m] = np.where(lengths, np.maximum(lower[:m], SHORTEST_WHOLE_RECORD * np.abs(psi[:m])), lower[:m])
    return lower, upper


def _from_linear(model: Model, records: tuple[RecordData, ...], theta: Real) -> tuple[RecordProblem, Real]:
    """A start at θ (unknowns,), whose linear elements are fitted without the nonlinear ones first."""
    names = model.unknown_names
    values = dict(zip(names, theta.tolist(), strict=True))
    idle = replace(model, elements=tuple(_idle(element, values) for element in model.elements))
    free = record_constants(moving_rig(model, records[0].bases), records[0])
    problem, psi = _begun(idle, records, np.array([values[name] for name in idle.unknown_names]), free)
    end = _searched(problem, psi, None).x[0]
    values |= dict(zip(idle.unknown_names, end.tolist(), strict=False))
    begun, start = _begun(model, records, np.array([values[name] for name in names]))
    start[len(names) :] = end[len(idle.unknowns) :]
    return begun, start


def _idle(element: Element, values: Mapping[str, float]) -> Element:
    """A nonlinear element without a force, the constants of its law known; others as they are."""
    law = element.force_law
    if law is None:
        return element
    constants = [
        replace(c, value=values.get(f"{element.name}.{c.name}", c.value), sd=None) for c in law.constants
    ]
    return replace(element, value=0.0, sd=None, guess=None, force_law=law.with_constants(constants))


def _begun(
    model: Model,
    records: tuple[RecordData, ...],
    values: Real | None = None,
    free: RecordConstants | None = None,
) -> tuple[RecordProblem, Real]:
    """The problem and where its search starts: at θ (unknowns,), or where the motion itself suggests.

    free: which constants of the records are unknown; those that can be found where it is not given.
    """
    theta = first_record_values(model, records) if values is None else values
    sd = np.sqrt(np.mean(np.concatenate([record.outputs for record in records]) ** 2, axis=0))
    sd = np.where(sd > 0, FIRST_NOISE * sd, 1.0)
    problem, own = begun_problem(model, records, theta, sd, free)
    return problem, np.concatenate(
        [theta, np.ones(problem.gains), np.zeros(len(problem.constants.offsets)), own]
    )
