"""What estimates from whole records of nonlinear rigs are worth: intervals that count the colour of the residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.inference.diagnostics import require_determined, require_traces, unseen_laws
from dashpot.estimate.likelihood.input_noise import counted_as_exact
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.nonlinear.input_levels import (
    DRAWS,
    InputSizes,
    all_linearised,
    drawn_noise,
    moves_with_sizes,
    stated_precision,
    unknowns_matrix,
)
from dashpot.estimate.nonlinear.record_problem import HALF_WINDOW, RecordProblem, around, begun_problem
from dashpot.estimate.nonlinear.records import RecordData, arranged, total_samples
from dashpot.estimate.result import RESIDUALS, Estimate, Fit, estimate_of
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse

# Records that were not used, predicted from an estimate of a nonlinear rig.


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
    for _ in range(24):  # steps of Gauss and Newton for the start of a record
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


DRAWN = 50_000  # samples of all draws with which the colour of residuals is compared
MOST_DRAWS = 160  # of short records
HALF_BAND = 30  # lines on each side over which the residuals' spectrum is smoothed
CUT_RECORD = "cut_record"  # code of a notice
EXACT_INPUTS = "exact_inputs"  # code of a notice
COLOURED = 1.5  # ratio of intervals with and without the residuals' colour that is told


def record_estimate(
    problem: RecordProblem,
    psi: Real,
    converged: bool,
    iterations: int,
    history: Real,
    limits: tuple[Real, Real],
    noise: InputSizes | None = None,
    held: bool = False,
) -> Estimate:
    """Values ψ (M,), and intervals that count the colour of the residuals; history (iterations + 1, M).

    noise: of the inputs, whose true values were estimated too; held: inputs count as exact though they may not be.
    """
    model, inner = problem.rig, problem.inner
    if noise is None or problem.inputs is None:
        white, coloured, dof = record_covariances(problem, psi)
    else:
        white, coloured, dof = uncertain_covariances(problem, psi, noise)
    names, units = record_unknowns(problem)
    values, covariance = psi[:inner], coloured[:inner, :inner]
    require_determined(
        names, values, white[:inner, :inner], traces=lambda: _require_traces(problem, psi, names)
    )
    plain = np.sqrt(np.diagonal(white)[:inner])
    lower, upper = limits[0][:inner], limits[1][:inner]
    warnings = _coloured_notice(np.sqrt(np.diagonal(covariance)) / plain)
    warnings += unseen_laws(model, values, covariance)
    warnings += _held_inputs(model) if held else []
    warnings += _bound_notices(names, values, lower, upper) + _cut_notices(problem)
    rms = ", ".join(f"{n} {s:.3g}" for n, s in zip(problem.records[0].names, problem.sd, strict=True))
    notes = [Notice("record_residuals", f"residuals of the whole records, rms in SI units: {rms}")]
    notes += (
        _input_notes(problem, noise)
        if noise is not None
        else []
        if held
        else counted_as_exact([source.name for source in model.inputs])
    )
    return estimate_of(
        model,
        "ml",
        names,
        units,
        values[None],
        covariance[None],
        noise=covariance[None],
        bound=white[None, :inner, :inner],
        dof=np.full((1, inner), float(dof)),
        fit=_fit(problem, psi, dof, noise),
        basis=RESIDUALS,
        converged=np.array([converged]),
        iterations=np.array([iterations], dtype=np.int64),
        history=history,
        bounds=HeldBounds(lower, upper, values[None]),
        warnings=warnings,
        notes=notes,
    )


def _bound_notices(names: tuple[str, ...], values: Real, lower: Real, upper: Real) -> list[Notice]:
    at_bound = (values <= lower) | (values >= upper)
    return [
        Notice("at_bound", f"{name} is at its bound", (name,))
        for name, at in zip(names, at_bound, strict=True)
        if at
    ]


def _cut_notices(problem: RecordProblem) -> list[Notice]:
    if problem.pieces <= 1:
        return []
    cut = f"the motion depends too much on its start to be followed whole: cut into {problem.pieces} pieces"
    return [Notice(CUT_RECORD, cut)]


def _require_traces(problem: RecordProblem, psi: Real, names: tuple[str, ...]) -> None:
    """Raises IdentifiabilityError that names what leaves no trace in the motion at ψ (M,)."""
    require_traces(problem.rig, names, problem.quadratic(psi[None]).symmetric[0])


def _fit(problem: RecordProblem, psi: Real, dof: int, noise: InputSizes | None) -> Fit:
    """χ², where a record at rest tells how large the noise is."""
    if noise is None or not noise.at_rest:
        return Fit(np.asarray(float(dof)), dof, np.asarray(np.nan), known_noise=False)
    chi2 = float(problem.quadratic(psi[None]).cost[0])
    means = sum(int(np.sum(data.drift)) for data in problem.records)
    left = max(dof - means + int(np.sum(problem.model.prior_precision > 0)), 1)
    return Fit(np.asarray(chi2), left, np.asarray(chdtrc(left, chi2)))


def record_covariances(problem: RecordProblem, psi: Real) -> tuple[Real, Real, int]:
    """Covariance of all of ψ, (M, M), were the residuals white, the same for their colour, and degrees of freedom.

    Raises DataError where no motion follows.
    """
    M = len(psi)
    matrix, meat, squares = np.zeros((M, M)), np.zeros((M, M)), 0.0
    for residual, J in problem.residuals(psi):
        if J is None:
            raise DataError(
                "no motion follows from the start", cure="give guesses of the unknowns nearer to the truth"
            )
        flat = J.reshape(-1, M)
        matrix += flat.T @ flat
        squares += float(np.sum(residual**2))
        for c in range(residual.shape[1]):
            meat += coloured_scores(residual[:, c], J[:, c])
    dof = max(total_samples(problem.records) - M, 1)
    prior = stated_precision(problem)
    bread = scaled_inverse(matrix + np.diag(prior))
    coloured = bread @ (meat + np.diag(prior)) @ bread * total_samples(problem.records) / dof
    return bread * squares / dof, coloured, dof


def _coloured_notice(ratio: Real) -> list[Notice]:
    """A warning where intervals are far wider than white residuals would make them, by the `ratio` of both."""
    wider = float(np.median(ratio))
    if wider <= COLOURED:
        return []
    text = (
        f"the residuals are coloured: intervals are {wider:.2g} times those of white noise; "
        "the model or the measured input lacks something"
    )
    return [Notice("coloured_residuals", text)]


def record_unknowns(problem: RecordProblem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and SI units of what is reported: θ, gains, offsets."""
    model, first = problem.rig, problem.records[0]
    gains = [
        next(n for n, g in zip(first.names, first.gain, strict=True) if g == k) for k in range(problem.gains)
    ]
    names = [u.name for u in model.unknowns] + [f"{name}.gain" for name in gains]
    units = [u.unit for u in model.unknowns] + ["1"] * problem.gains
    offsets = [f"{model.force_inputs[j]}.offset" for j in problem.constants.offsets]
    return (*names, *offsets), (*units, *["N"] * len(offsets))


def uncertain_covariances(problem: RecordProblem, psi: Real, noise: InputSizes) -> tuple[Real, Real, int]:
    """As `record_covariances`, where the inputs are uncertain.

    The scores are sums over the noise of the channels and the errors of the inputs; what each of both shows is counted
    with the colour that it has beside draws of white noise, and so is how well its size is known.
    """
    prior = stated_precision(problem)
    linear = all_linearised(problem, psi)
    if not linear:
        raise DataError("no motion follows", cure="give guesses of the unknowns nearer to the truth")
    # Too few draws of short records are too loud or too quiet in the band that tells the unknowns, always the same way.
    drawn = drawn_noise(
        linear, prior, int(np.clip(DRAWN // total_samples(problem.records), DRAWS, MOST_DRAWS))
    )
    meat = np.diag(prior)
    for k, record in enumerate(linear):
        scores = np.zeros((len(record.chosen), len(record.chosen)))
        for c in range(record.residual.shape[1]):
            power = _smoothed_power(drawn.data[k][:, c])
            usual = np.mean([_smoothed_power(each) for each in drawn.draws[k][:, c].T], axis=0)
            scores += _meat(record.weighed_slopes[:, c], power / np.maximum(usual, np.finfo(float).tiny))
        colour = around(drawn.errors[k] ** 2, HALF_WINDOW) / np.maximum(
            around(np.mean(drawn.drawn_errors[k] ** 2, axis=-1), HALF_WINDOW), np.finfo(float).tiny
        )
        along = record.errors_along()
        scores += np.einsum("nq,nqp,nqr->pr", colour, along, along)
        meat[np.ix_(record.chosen, record.chosen)] += scores
    bread = scaled_inverse(unknowns_matrix(linear, prior))
    moved = moves_with_sizes(problem, psi, noise)
    dof = max(total_samples(problem.records) - len(psi), 1)
    return bread, bread @ meat @ bread + moved @ noise.spread @ moved.T, dof


def _held_inputs(model: Model) -> list[Notice]:
    """That the inputs count as exact because the motion hangs too much on them."""
    text = (
        "the motion depends too much on its inputs for their noise to be counted: they count as exact, so noise in "
        "them biases the values and is not in the intervals"
    )
    return [Notice(EXACT_INPUTS, text, tuple(source.name for source in model.inputs))]


def _input_notes(problem: RecordProblem, noise: InputSizes) -> list[Notice]:
    """How much noise the inputs have, and how that is known."""
    sources = [*problem.model.displacement_inputs, *problem.model.force_inputs]
    sd = np.sqrt(noise.variance)
    groups = (
        (noise.at_rest & (sd > 0), "as the record at rest shows"),
        (noise.from_spectrum, "as the quiet part of its record or spectrum shows"),
        (~noise.from_spectrum & (sd > 0) & (not noise.at_rest), "as the residuals of the outputs show"),
    )
    notices = []
    for chosen, how in groups:
        names = [source for source, there in zip(sources, chosen, strict=True) if there]
        if names:
            sizes = ", ".join(f"{n} {s:.3g}" for n, s in zip(names, sd[chosen], strict=True))
            text = f"noise of the inputs, sd in SI units: {sizes}, {how}; their true values are estimated too"
            notices.append(Notice("input_noise", text, tuple(names)))
    return notices


def coloured_scores(residual: Real, J: Real) -> Real:
    """Σ_tτ J_t R(t − τ) J_τᵀ with the autocovariance R of the residuals, by their smoothed spectrum."""
    return _meat(J, _smoothed_power(residual))


def _smoothed_power(residual: Real) -> Real:
    """The power of a residual (samples,) at its lines, smoothed; its variance where it is white."""
    spectrum = np.abs(np.fft.rfft(residual)) ** 2 / len(residual)
    width = min(2 * HALF_BAND + 1, len(spectrum))
    kernel = np.ones(width) / width
    padded = np.pad(spectrum, width // 2, mode="reflect") if len(spectrum) > width // 2 else spectrum
    return np.convolve(padded, kernel, mode="valid")[: len(spectrum)]


def _meat(J: Real, smooth: Real) -> Real:
    """The sum of `coloured_scores` for a power at the lines."""
    N = len(J)
    lines = np.fft.rfft(J, axis=0)
    weight = np.full(len(smooth), 2.0)
    weight[0] = 1.0
    if N % 2 == 0:
        weight[-1] = 1.0
    return ((np.conj(lines) * (weight * smooth)[:, None]).T @ lines).real / N
