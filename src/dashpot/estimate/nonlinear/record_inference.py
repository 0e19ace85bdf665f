"""What fits of whole records of nonlinear rigs are worth: intervals that count the colour of the residuals, and how the
motion of an estimate goes beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real
from dashpot.data.noise import smoothed
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.inference.diagnostics import held as of_bounds
from dashpot.estimate.inference.diagnostics import require_determined, require_traces, unseen_laws
from dashpot.estimate.likelihood.record_noise import counted_as_exact
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.nonlinear.input_levels import (
    DRAWS,
    InputSizes,
    all_linearised,
    drawn_noise,
    moves_with_sizes,
    unknowns_matrix,
)
from dashpot.estimate.nonlinear.record_problem import HALF_WINDOW, RecordProblem, begun_problem
from dashpot.estimate.nonlinear.records import RecordData, arranged, total_samples
from dashpot.estimate.result import RESIDUALS, Estimate, Fit, estimate_of
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import without_bounds
from dashpot.numerics.small_systems import scaled_inverse
from dashpot.unknowns import Unknown, prior_precision

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
        """Beside what was measured."""
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
    each of both shows is counted with the colour that it has beside draws of white noise, and so is how well its size
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
