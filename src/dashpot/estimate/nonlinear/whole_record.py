"""Identification of nonlinear rigs from whole records: maximum likelihood by integration in time (THEORY §9).

Unknown besides θ and gains: the state at the start of each record, and a constant offset of every force input, which
shifts the working point of a nonlinear rig and so is no matter of taking means out.  Where the measured inputs show
noise, their true values are unknown too (`input_levels`).  Noise is white for the fit and of whatever colour the
residuals have for the intervals (a sandwich with their spectrum).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real
from dashpot.data.noise import Still, smoothed
from dashpot.data.record import Record
from dashpot.errors import ConvergenceError, DataError, UsageError
from dashpot.estimate.inference.diagnostics import held as of_bounds
from dashpot.estimate.inference.diagnostics import (
    of_one_sign,
    require_determined,
    require_traces,
    unseen_laws,
)
from dashpot.estimate.likelihood.global_search import DOUBT, rival_notice
from dashpot.estimate.likelihood.record_noise import counted_as_exact
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.nonlinear.input_levels import (
    DRAWS,
    InputSizes,
    all_linearised,
    despite_wander,
    drawn_noise,
    moves_with_sizes,
    steadied,
    unknowns_matrix,
    with_uncertain_inputs,
)
from dashpot.estimate.nonlinear.record_problem import (
    HALF_WINDOW,
    NotSolvedError,
    RecordConstants,
    RecordProblem,
    Trail,
    begun_problem,
    record_constants,
)
from dashpot.estimate.nonlinear.record_regression import mostly_linear_values, valley_starts
from dashpot.estimate.nonlinear.records import (
    NoiseAtRest,
    RecordData,
    arranged,
    displacement_channels,
    noise_of_channels,
    total_samples,
)
from dashpot.estimate.result import RESIDUALS, Estimate, Fit, estimate_of
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.integration import moving_rig
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, without_bounds
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled
from dashpot.unknowns import Unknown, prior_precision

# What fits of whole records of nonlinear rigs are worth: intervals that count the colour of the residuals, and how
# the motion of an estimate departs from what was measured.


# The motion that an estimate gives a record.


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
        """Relative to what was measured."""
        data, residual = self.data, self.residual
        spread = np.sqrt(np.mean((data.outputs - np.mean(data.outputs, axis=0)) ** 2, axis=0))
        rms = np.sqrt(np.mean(residual**2, axis=0))
        time: Real = data.step_s * np.arange(data.samples, dtype=np.float64)
        relative = rms / np.where(spread > 0, spread, 1)
        return PredictedMotion(data.names, time, data.outputs, data.outputs - residual, rms, relative)


def followed_record(model: Model, estimate: Estimate, record: Record) -> FollowedRecord:
    """The motion of an estimate; only the state at its start is taken from the record, and what accelerations of bases
    lack.

    Raises DataError where the record does not suit the rig, or the motion cannot be followed.
    """
    data = arranged(model, record)
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    theta = np.array([values[u.name] for u in model.unknowns])
    gains = [values[gain.name] for gain in data.gains]
    problem, own = begun_problem(model, (data,), theta, np.ones(len(data.names)))
    offset = [values.get(f"{model.force_inputs[j]}.offset", 0.0) for j in problem.constants.offsets]
    # ψ (M,) whose motion is nearest to the one record, its own unknowns being free; states of laws stay
    free = problem.constants
    seen = [j for j, state in enumerate(free.starts) if state < 2 * problem.model.n]
    seen += range(len(free.starts), problem.states)
    columns = problem.inner + np.array(seen, dtype=np.int64)
    best, least, step = np.concatenate([theta, gains, offset, own]), np.inf, np.zeros(len(columns))
    for _ in range(24):  # steps of Gauss and Newton
        tried = best.copy()
        tried[columns] += step
        residual, J = problem.residual(0, tried)
        square = float(np.sum(residual**2)) if J is not None else np.inf
        if J is None or not square < least:
            if not np.isfinite(least):
                source = problem.records[0].source
                raise DataError(
                    "the simulation does not follow the measured motion",
                    source,
                    "check that the record belongs to this rig",
                )
            step = step / 4
            continue
        ended = square > (1 - 1e-6) * least  # what one more step would take away
        best, least = tried, square
        if ended:
            break
        along = J[..., columns].reshape(residual.size, len(columns))
        step = np.linalg.lstsq(along, residual.ravel(), rcond=1e-8)[0].astype(np.float64)
    return FollowedRecord(problem, best, problem.residual(0, best, slopes=False)[0])


def followed_records(problem: RecordProblem, psi: Real) -> list[FollowedRecord]:
    """The motions of a fit itself, ψ (M,), with the inputs that are taken for the true ones."""
    motions = []
    for k in range(len(problem.records)):
        alone, at = problem.only(k, psi)
        residual = problem.residual(k, psi, slopes=False)[0] * problem.sd
        motions.append(FollowedRecord(alone, at, residual))
    return motions


# The Estimate of a fit.

CUT_RECORD = "cut_record"  # code of a notice


@dataclass(frozen=True)
class FittedRecords:
    """Where the search over whole records ended: ψ (M,) of the problem, θ after each round, bounds.

    noise: of the inputs, None where they show none or are `held` at what was measured, whose errors defy reckoning.
    rivals: other minima, ψ (M,) and by how much χ² is higher there.
    """

    problem: RecordProblem
    psi: Real
    converged: bool
    iterations: int
    history: Real
    limits: tuple[Real, Real]
    noise: InputSizes | None = None
    held: bool = False
    rivals: tuple[tuple[Real, float], ...] = ()

    def estimate(self) -> Estimate:
        """Values with intervals that count the colour of the residuals.  Raises DataError and IdentifiabilityError."""
        problem, psi, noise = self.problem, self.psi, self.noise
        model, inner = problem.rig, problem.inner
        white, coloured, dof = record_covariances(problem, psi, noise)
        unknowns = _unknowns(problem)
        names = tuple(unknown.name for unknown in unknowns)
        values, bound, covariance = psi[:inner], white[:inner, :inner], coloured[:inner, :inner]
        require_determined(
            names,
            values,
            bound,
            traces=lambda: require_traces(model, names, problem.quadratic(psi[None]).symmetric[0]),
        )
        lower, upper = self.limits[0][:inner], self.limits[1][:inner]
        free = psi[None]
        if np.any((values <= lower) | (values >= upper)):
            free = without_bounds(free, problem.quadratic(free), *self.limits)
        bounds = HeldBounds(lower, upper, free[:, :inner])
        warnings = list[Notice]()
        wider = float(np.median(np.sqrt(np.diagonal(covariance) / np.diagonal(bound))))
        if wider > 1.5:  # a smaller ratio is not worth a warning
            text = (
                f"the residuals are coloured: intervals are {wider:.2g} times those for white noise; "
                "something is unmodelled, or the measured input is incomplete"
            )
            warnings.append(Notice("coloured_residuals", text))
        warnings += unseen_laws(model, values, covariance)
        if self.held:
            text = (
                "the response is too sensitive to the inputs to model their noise: they are treated as "
                "exact; input noise may bias the values and is not in the intervals"
            )
            warnings.append(Notice("exact_inputs", text, tuple(source.name for source in model.inputs)))
        warnings += of_bounds(names, values, bounds)
        others = [(end[:inner], rise) for end, rise in self.rivals]
        warnings += rival_notice(unknowns, values, np.sqrt(np.diagonal(covariance)), others, 1.0)
        if problem.pieces > 1:
            cut = "the response is too sensitive to its initial state for one simulation"
            warnings.append(Notice(CUT_RECORD, f"{cut}: the record was split into {problem.pieces} segments"))
        rms = ", ".join(f"{n} {s:.3g}" for n, s in zip(problem.records[0].names, problem.sd, strict=True))
        about = [] if self.held else counted_as_exact([source.name for source in model.inputs])
        return estimate_of(
            model,
            "ml",
            unknowns,
            values[None],
            covariance[None],
            noise=covariance[None],
            bound=bound[None],
            dof=np.full((1, inner), float(dof)),
            fit=_fit(problem, psi, dof, noise),
            basis=RESIDUALS,
            converged=np.array([self.converged]),
            iterations=np.array([self.iterations], dtype=np.int64),
            history=self.history,
            bounds=bounds,
            warnings=warnings,
            notes=[
                Notice("record_residuals", f"residuals of the continuous records, rms in SI units: {rms}"),
                *(about if noise is None else _input_notes(problem, noise)),
            ],
        )


def _unknowns(problem: RecordProblem) -> tuple[Unknown, ...]:
    """What is reported: θ, gains, offsets."""
    model = problem.rig
    offsets = (Unknown(f"{model.force_inputs[j]}.offset", "N") for j in problem.constants.offsets)
    return (*model.unknowns, *problem.records[0].gains, *offsets)


def _fit(problem: RecordProblem, psi: Real, dof: int, noise: InputSizes | None) -> Fit:
    """χ², where a record at rest tells how large the noise is."""
    if noise is None or not noise.at_rest:
        return Fit(np.asarray(float(dof)), dof, np.asarray(np.nan), known_noise=False)
    chi2 = float(problem.quadratic(psi[None]).cost[0])
    means = sum(int(np.sum(data.drift)) for data in problem.records)
    left = max(dof - means + int(np.count_nonzero(prior_precision(_unknowns(problem)))), 1)
    return Fit(np.asarray(chi2), left, np.asarray(chdtrc(left, chi2)))


def record_covariances(
    problem: RecordProblem, psi: Real, noise: InputSizes | None = None
) -> tuple[Real, Real, int]:
    """Covariance of all of ψ, (M, M), were the residuals white, the same for their colour, and degrees of freedom.

    Scores have the autocovariance of the residuals, Σ_tτ J_t R(t − τ) J_τᵀ, by their smoothed spectrum.  Where the
    inputs are uncertain, with `noise`, they are sums over the noise of the channels and the errors of the inputs; what
    each of both shows is counted with its colour relative to draws of white noise, and so is how well its size
    is known.  Raises DataError where no motion follows.
    """
    linear = all_linearised(problem, psi)
    if not linear:
        raise DataError(
            "the simulation fails with the initial guesses", cure="give guesses closer to the true values"
        )
    prior, tiny = problem.priors()[0], np.finfo(float).tiny
    dof = max(total_samples(problem.records) - len(psi), 1)
    bread, meat = scaled_inverse(unknowns_matrix(linear, prior)), np.diag(prior)
    if noise is None or problem.inputs is None:
        for record in linear:
            for c in range(record.residual.shape[1]):
                power = _smoothed_power(record.residual[:, c])
                meat[np.ix_(record.chosen, record.chosen)] += _meat(record.slopes[:, c], power)
        squares = sum(record.cost for record in linear)
        return bread * squares / dof, bread @ meat @ bread * total_samples(problem.records) / dof, dof
    # Draws of 50,000 samples in all: too few of short records are too loud or too quiet in the band that tells the
    # unknowns, always the same way.
    drawn = drawn_noise(linear, prior, int(np.clip(50_000 // total_samples(problem.records), DRAWS, 160)))
    for k, record in enumerate(linear):
        scores = np.zeros((len(record.chosen), len(record.chosen)))
        for c in range(record.residual.shape[1]):
            power = _smoothed_power(drawn.data[k][:, c])
            usual = np.mean(_smoothed_power(drawn.draws[k][:, c]), axis=1)
            scores += _meat(record.weighed_slopes[:, c], power / np.maximum(usual, tiny))
        usual = smoothed(np.mean(drawn.drawn_errors[k] ** 2, axis=-1), HALF_WINDOW)
        colour = smoothed(drawn.errors[k] ** 2, HALF_WINDOW) / np.maximum(usual, tiny)
        along = record.errors_along()
        scores += np.einsum("nq,nqp,nqr->pr", colour, along, along)
        meat[np.ix_(record.chosen, record.chosen)] += scores
    moved = moves_with_sizes(problem, psi, noise)
    return bread, bread @ meat @ bread + moved @ noise.spread @ moved.T, dof


def _smoothed_power(residual: Real) -> Real:
    """The power of residuals (samples, ...) at their lines, smoothed; their variance where they are white."""
    return smoothed(np.abs(np.fft.rfft(residual, axis=0)) ** 2 / len(residual))


def _meat(J: Real, power: Real) -> Real:
    """Covariance of the scores of slopes J (samples, P) for noise of a power at its lines, (P, P)."""
    N = len(J)
    lines = np.fft.rfft(J, axis=0)
    weight = np.full(len(power), 2.0)
    weight[0] = 1.0
    if N % 2 == 0:
        weight[-1] = 1.0
    return ((np.conj(lines) * (weight * power)[:, None]).T @ lines).real / N


def _input_notes(problem: RecordProblem, noise: InputSizes) -> list[Notice]:
    """How much noise the inputs have, and how that is known."""
    sources = [*problem.model.displacement_inputs, *problem.model.force_inputs]
    sd = np.sqrt(noise.variance)
    groups = (
        (noise.at_rest & (sd > 0), "from the at-rest record"),
        (noise.from_spectrum, "from the quiet part of the record or spectrum"),
        (~noise.from_spectrum & (sd > 0) & (not noise.at_rest), "from the residuals of the outputs"),
    )
    notices = []
    for chosen, how in groups:
        names = [source for source, there in zip(sources, chosen, strict=True) if there]
        if names:
            sizes = ", ".join(f"{n} {s:.3g}" for n, s in zip(names, sd[chosen], strict=True))
            text = (
                f"input noise, standard deviation in SI units: {sizes}, {how}; the true inputs are "
                "estimated too"
            )
            notices.append(Notice("input_noise", text, tuple(names)))
    return notices


ROUGH = 10.0  # times the doubt between minima: what a rough search may still be above its own
FIRST_NOISE = 0.01  # of a channel's rms: its noise before anything is known
EXACT = 1e-6  # of a channel's rms: residuals below it count no less
HALVINGS = 6  # of the integration's steps, at most
MOST_STEPS = 10**6  # of all records, which halving must not exceed

Progress = Callable[[int, int], None]


def fit_records(
    model: Model,
    records: Sequence[Record],
    method: str | None = None,
    *,
    still: Still | None = None,
    exact_inputs: bool = False,
    progress: Progress | None = None,
) -> FittedRecords:
    """The most likely unknowns of a nonlinear rig from whole records of any excitation; `estimate()` of it tells them.

    still: the noise that a record at rest shows; without it the residuals tell how large it is.  exact_inputs: with the
    measured inputs for the true ones, whatever their noise.

    Raises UsageError if another `method` is named, DataError if an input or all motion is not measured, or an
    unknown needs a guess: where not all coordinates are measured as displacements, every unknown does.
    """
    if method not in (None, "ml"):
        raise UsageError(
            f"the method {method} cannot handle continuous records of nonlinear rigs",
            cure="use the method ml",
        )
    model.require_unknowns()
    if not len(model.nonlinear):
        raise UsageError(
            "the rig has no nonlinear element",
            cure="use `identify`, which handles continuous records of linear rigs",
        )
    if slow := [law.text for law in model.laws if law.states > 1]:
        raise UsageError(
            f"the law {slow[0]} can be identified from settled dwells only; these are continuous records",
            cure="give dwells, with frequency_hz, or use jenkins or bouc-wen instead",
        )
    data = tuple(arranged(model, record) for record in records)
    if len({(record.names, record.bases.names, record.bases.orders) for record in data}) > 1:
        raise DataError(
            "the records have different channels", cure="identify records with the same channels together"
        )
    data = data if exact_inputs else steadied(model, data)
    problem, psi, others = _of_valleys(model, data)
    at_rest = None if still is None else noise_of_channels(model, records[0], still)
    if not exact_inputs:
        # Where noise of bases carries the rig far from where it was, the true inputs are unknown from the first.
        held = problem.afresh()
        begun = despite_wander(held, psi, data)
        if begun is not None:
            exact = FittedRecords(held, begun, True, 0, psi[None, : held.inner], held.bounds(psi))
            ended = _with_true_inputs(exact, data, at_rest)
            if ended.noise is not None:
                return _refined(ended)
    ended = _with_exact_inputs(problem, psi, progress)
    ended = replace(ended, rivals=tuple(_risen(ended, other) for other in others))
    if ended.converged and not exact_inputs:
        ended = _with_true_inputs(ended, data, at_rest)
    return _refined(ended)


def _with_exact_inputs(problem: RecordProblem, psi: Real, progress: Progress | None) -> FittedRecords:
    """The fit with the measured inputs for the true ones, from ψ (M,) or wherever a start must be looked for."""
    model, data, before = problem.rig, problem.records, problem.afresh()
    # Where the motion at the start is off by a fifth of the measured one, the search might end anywhere.
    far = not problem.misfit(psi) * FIRST_NOISE**2 / total_samples(data) < 0.2**2
    if far:
        linear = mostly_linear_values(model, data)  # noise makes laws of what the motion hardly shows
        if linear is not None:
            # A start at θ (unknowns,), whose linear elements are fitted without the nonlinear ones first
            names = model.unknown_names
            values = dict(zip(names, linear.tolist(), strict=True))
            idle = replace(model, elements=tuple(_idle(element, values) for element in model.elements))
            free = record_constants(moving_rig(model, data[0].bases), data[0])
            problem, psi = _begun(idle, data, np.array([values[name] for name in idle.unknown_names]), free)
            end = _searched(problem, psi, None)[1].x[0]
            values |= dict(zip(idle.unknown_names, end.tolist(), strict=False))
            problem, psi = _begun(model, data, np.array([values[name] for name in names]))
            psi[len(names) :] = end[len(idle.unknowns) :]
            before, far = problem.afresh(), False
    if far:
        problem, psi = _released(problem, psi)
    problem, search = _searched(problem, psi, progress)
    if not search.converged[0]:
        problem, search = _with_finer_steps(problem, search, progress)
    if not (far or search.converged[0]):
        problem, search = _searched(*_released(before, psi), progress)
    end, limits = search.x[0], problem.bounds(search.x[0])
    converged, iterations = bool(search.converged[0]), int(search.iterations[0])
    return FittedRecords(problem, end, converged, iterations, search.history, limits)


def _with_true_inputs(
    exact: FittedRecords, measured: Sequence[RecordData], at_rest: NoiseAtRest | None
) -> FittedRecords:
    """The fit with the true inputs unknown, where those measured show noise; as it is where they show none."""
    try:
        better = with_uncertain_inputs(exact.problem, exact.psi, measured, exact.limits, at_rest)
    except NotSolvedError:
        return replace(exact, held=True)
    if better is None:
        return exact
    problem, end, noise = better
    history = np.concatenate([exact.history, end.x[:, : problem.inner]])
    iterations = exact.iterations + int(end.iterations[0])
    return FittedRecords(problem, end.x[0], bool(end.converged[0]), iterations, history, exact.limits, noise)


# Starts


def _of_valleys(model: Model, records: tuple[RecordData, ...]) -> tuple[RecordProblem, Real, list[Real]]:
    """The problem, ψ (M,) where its search starts, and other ψ that fit almost as well, roughly."""
    thetas, begun = valley_starts(model, records), list[tuple[RecordProblem, Real]]()
    for theta in thetas:
        try:
            begun.append(_begun(model, records, theta))
        except ConvergenceError:  # too fast a rig to integrate
            if theta is thetas[-1] and not begun:
                raise
    if len(begun) == 1:
        return *begun[0], []
    ends = list[tuple[float, RecordProblem, OptimizeResult]]()
    for problem, psi in begun:
        # The states at the start first: what they are off by would else draw the laws with it.
        lower, upper = problem.bounds(psi)
        inner = np.arange(len(psi)) < problem.inner
        psi = problem.descend(psi, (np.where(inner, psi, lower), np.where(inner, psi, upper)), 3, 0.1).x[0]
        end = problem.descend(psi, limit=12, tolerance=0.1)
        ends.append((float(end.cost[0]), problem, end))
    # Of χ², whose scale the least misfit tells
    doubt = min(cost for cost, _, _ in ends) * DOUBT / total_samples(records)
    near = [each for each in ends if each[0] <= min(cost for cost, _, _ in ends) + ROUGH * doubt]
    positive = np.flatnonzero(of_one_sign(model))
    ranked = list[tuple[float, RecordProblem, Real]]()
    for cost, problem, end in near:
        if len(near) > 1 and not end.converged[0]:
            end = problem.descend(end.x[0], tolerance=0.1)
            cost = float(end.cost[0])
        # What cannot be built is not taken for what can where they fit alike.
        cost += doubt if np.any(end.x[0, positive] < 0) else 0.0
        ranked.append((cost, problem, end.x[0]))
    ranked.sort(key=lambda each: each[0])
    least, problem, psi = ranked[0]
    return problem, psi, [other for cost, _, other in ranked[1:] if cost <= least + 2 * doubt]


def _risen(fitted: FittedRecords, psi: Real) -> tuple[Real, float]:
    """Another minimum, ψ (M,) where the search from ψ ends, and how much higher χ² is there."""
    problem = fitted.problem.afresh()
    end = problem.descend(psi, fitted.limits, tolerance=0.1)
    return end.x[0], float(end.cost[0]) - float(problem.quadratic(fitted.psi[None]).cost[0])


def _begun(
    model: Model, records: tuple[RecordData, ...], theta: Real, free: RecordConstants | None = None
) -> tuple[RecordProblem, Real]:
    """The problem and where its search starts, at θ (unknowns,).

    free: which constants of the records are unknown; those that can be found where it is not given.
    """
    sd = np.sqrt(np.mean(np.concatenate([record.outputs for record in records]) ** 2, axis=0))
    problem, own = begun_problem(model, records, theta, np.where(sd > 0, FIRST_NOISE * sd, 1.0), free)
    gains = [1.0 if gain.nominal is None else gain.nominal for gain in records[0].gains]
    return problem, np.concatenate([theta, gains, np.zeros(len(problem.constants.offsets)), own])


def _idle(element: Element, values: Mapping[str, float]) -> Element:
    """A nonlinear element without a force, the constants of its law known; others as they are."""
    law = element.force_law
    if law is None:
        return element
    constants = [
        replace(c, value=values.get(f"{element.name}.{c.name}", c.value), sd=None) for c in law.constants
    ]
    return replace(element, value=0.0, sd=None, guess=None, force_law=law.with_constants(constants))


# Starts far from the end of a whole record: the motion is held near the measured one, less and less.
#
# Of a motion that is integrated freely the misfit has many valleys where the rig is strongly nonlinear. Springs and
# dampers between what a channel shows of the rig and what it measured keep the motion near; with them the misfit has
# one wide valley, whose bottom moves to that of the free motion as they are weakened. Source: Vyasarayani, Uchida,
# Carvalho and McPhee (2012), Multibody System Dynamics 26, 411.

NEAR = 4.0  # misfit of the free motion over that of the held one at which it need be held no more


def _released(problem: RecordProblem, psi: Real) -> tuple[RecordProblem, Real]:
    """The problem and ψ (M,) from which the free motion's misfit leads to its least.

    Records whose free motion is lost between one end and the other are cut into pieces with starts of their own.  As
    given where no channel shows a displacement with a known gain that moves.
    """
    first, limits = problem.records[0], problem.bounds(psi)
    shown = [c for c in displacement_channels(first) if np.ptp(first.outputs[:, c]) > 0]
    if not shown:
        return problem, psi
    least, records = (
        np.inf,
        tuple(_with_measured_motion(problem.model, data, shown) for data in problem.records),
    )
    for hold in (
        3.0,
        1.0,
        0.3,
        0.1,
        0.03,
    ):  # natural frequency of a channel on its spring over that of its motion
        model = _held(problem, psi, shown, hold)
        held = replace(problem, model=model, records=records, trail=Trail(problem.motions()))
        if not np.isfinite(held.misfit(psi)):
            held = held.afresh()
        end = held.descend(psi, limits, 12, 0.1)  # roughly
        if not (end.converged[0] and end.cost[0] < NEAR * least):  # too weak to hold this motion
            break
        psi, least = end.x[0], float(end.cost[0])
        problem = replace(problem, trail=Trail(held.motions()))
        if problem.misfit(psi) < NEAR * least:
            return problem, psi
    motions = problem.trail.motions
    states = [motions[k].state for k in range(len(problem.records)) if k in motions]
    problem = problem.afresh()  # the free motion may be far from the last one that was held
    for _ in range(5 if states else 0):  # times that a record is cut, into pieces of 32 samples at least
        if min(data.samples for data in problem.records) < 64:
            break
        problem, psi, states = _halved(problem, psi, states)
        # Pieces are short enough for the search to go on from farther off.
        if problem.misfit(psi) < 30.0 * least:
            break
    return problem, psi


def _halved(problem: RecordProblem, psi: Real, states: list[Real]) -> tuple[RecordProblem, Real, list[Real]]:
    """The same with each record cut in two, and likewise the states (samples, states) of their motions."""
    free = problem.constants
    records, parts, own = [], [], [psi[: problem.inner]]
    for k, (data, state) in enumerate(zip(problem.records, states, strict=True)):
        middle = data.samples // 2
        for part in (slice(0, middle), slice(middle, data.samples)):
            records.append(data.part(part))
            parts.append(state[part])
            own += [state[part][0, free.starts], psi[problem.of_record(k)][len(free.starts) :]]
    cut = replace(
        problem,
        records=tuple(records),
        begun=tuple(part[0] for part in parts),
        substeps=tuple(count for count in problem.substeps for _ in range(2)),
        pieces=2 * problem.pieces,
    )
    return cut, np.concatenate(own), parts


def _with_measured_motion(model: Model, data: RecordData, shown: list[int]) -> RecordData:
    """The record with what channels show of the coordinates as further displacement inputs."""
    r = model.D.shape[1]
    motion = data.outputs[:, shown] - data.inputs @ data.on_q[shown].T
    inputs = np.concatenate([data.inputs[:, :r], motion, data.inputs[:, r:]], axis=1)
    on_q = np.insert(data.on_q, r, np.zeros((len(shown), 1)), axis=1)
    rated = (*data.rated[:r], *[False] * len(shown), *data.rated[r:]) if data.rated else ()
    return replace(data, inputs=inputs, on_q=on_q, rated=rated)


def _held(problem: RecordProblem, psi: Real, shown: list[int], hold: float) -> Model:
    """The rig with a spring and a damper (ratio 0.7) from each of the channels to its own measurement."""
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
        elements.append(Element(f"{name}, damper", Kind.DAMPER, along, value=2 * 0.7 * mass * omega))
    forces = [source for source in model.inputs if source.kind == "force"]
    moved = [source for source in model.inputs if source.kind != "force"]
    return replace(model, inputs=(*moved, *inputs, *forces), elements=(*model.elements, *elements))


# The search


def _searched(
    problem: RecordProblem, psi: Real, progress: Progress | None
) -> tuple[RecordProblem, OptimizeResult]:
    """The least misfit from ψ (M,) on, and the problem with the noise of the channels that this leaves.

    history (rounds + 1, unknowns before the starts).
    """
    limits = problem.bounds(psi)
    history = [psi[: problem.inner]]
    sizes = problem.sd / FIRST_NOISE
    for turn in range(3):  # rounds, with the noise that the one before has left
        end = problem.descend(psi, limits)
        psi = end.x[0]
        history.append(psi[: problem.inner])
        ratio = problem.noise_left(psi)  # residuals over noise, (channels,)
        if not np.all(np.isfinite(ratio)):
            break
        problem = replace(problem, sd=np.maximum(problem.sd * ratio, EXACT * sizes))
        if progress is not None:
            progress(turn + 1, 3)
        if len(problem.sd) == 1 or np.all(np.abs(ratio / ratio[0] - 1) < 0.02):
            break
    return problem, replace(end, history=np.array(history))


def _with_finer_steps(
    problem: RecordProblem, search: OptimizeResult, progress: Progress | None
) -> tuple[RecordProblem, OptimizeResult]:
    """A search that did not end, gone on with halved steps while the residual is mostly their error.

    Corners of laws within steps make the misfit a staircase, on whose last steps a search of exact data goes round.
    """
    for _ in range(HALVINGS):
        finer, psi = problem.finer(), search.x[0]
        if search.converged[0] or finer.steps > MOST_STEPS:
            break
        coarse, fine = problem.stacked(psi), finer.stacked(psi)
        with np.errstate(invalid="ignore"):  # a motion that does not close is no number
            if not np.sum((fine - coarse) ** 2) > 0.1 * np.sum(coarse**2):
                break
        problem, search = _searched(finer, psi, progress)
    return problem, search


def _refined(fitted: FittedRecords) -> FittedRecords:
    """A fit that has converged with steps halved until that moves no unknown by 0.05 of its standard deviation.

    Kinks of laws make the integration's error fall with the square of the step only.
    """
    if not fitted.converged:
        return fitted
    problem, psi = fitted.problem, fitted.psi
    for _ in range(HALVINGS):
        finer = problem.finer()
        if finer.steps > MOST_STEPS:
            break
        around = finer.quadratic(psi[None])
        step = solve_scaled(around.symmetric, around.gradient)[0]
        moved = np.max(np.abs(step) / around.sd[0])
        if not moved > 0.05:
            break
        problem = finer
        if moved < 3.0:  # near enough for one step of Gauss and Newton
            psi = np.clip(psi + step, *fitted.limits)
        else:
            psi = finer.descend(psi, fitted.limits).x[0]
        if problem.inputs is None:
            ratio = problem.noise_left(psi)
            if np.all(ratio < 0.5):  # most of what was left were errors of coarser steps
                problem = replace(problem, sd=np.maximum(problem.sd * ratio, EXACT * problem.sizes()))
    history = np.concatenate([fitted.history, psi[None, : problem.inner]])
    return replace(fitted, problem=problem, psi=psi, history=history)
