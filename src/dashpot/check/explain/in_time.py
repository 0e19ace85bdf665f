"""The verdict on whole records of a nonlinear rig, and what may be the matter with them (THEORY §9).

Elements that the records call for in addition to those of the rig show that it does not fit, by the score of each: a
candidate whose parameter is 0 changes nothing; the slope of the integrated motion along it says what it would do, and
what the rig's own unknowns and the starts of the records do as well counts for nothing.  What may be otherwise, these
elements among it, is weighed by the engine on the part of a record with the largest residual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag
from scipy.special import stdtr

from dashpot.arrays import Real
from dashpot.check.element_evidence import record_candidates, with_nothing
from dashpot.check.explain.effect import Baseline, Effect, Effects, plainly
from dashpot.check.explain.engine import LARGEST, NEARLY_ALL, OF_LAWS, Explanation, explain_in_time
from dashpot.check.explain.laws import (
    CERTAIN,
    ENOUGH,
    QUIET,
    ScoredElement,
    feeds_motion,
    laws_in_words,
    with_open_constants,
)
from dashpot.check.explain.problem import FittedProblem, TimeProblem, fitted_from_starts, replaced
from dashpot.check.explain.records import CHANGED_CHANNEL, channels_in_time
from dashpot.check.explain.rigs import missing_elements, points_of
from dashpot.check.explain.score import APART, PARTS, steadiness, sums_of_parts
from dashpot.check.verdict import one_cause, powerless, rejected, settled_by_size, unphysical, worst_of
from dashpot.data.noise import smoothed
from dashpot.data.record import Record
from dashpot.errors import DashpotError, DataError
from dashpot.estimate.assessment import Assessment, Judgement, Misfit
from dashpot.estimate.nonlinear.input_levels import all_linearised, cleared, drawn_noise
from dashpot.estimate.nonlinear.record_problem import RecordProblem
from dashpot.estimate.nonlinear.records import RecordData, total_samples
from dashpot.estimate.nonlinear.search import linear_rig
from dashpot.estimate.nonlinear.whole_record import (
    CUT_RECORD,
    EXACT,
    FIRST_NOISE,
    FittedRecords,
    FollowedRecord,
    PredictedMotion,
    fit_records,
    followed_record,
    followed_records,
)
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.notices import Notice

LEAST = 0.1  # of the residuals, that a candidate must explain: noise of a measured input makes it explain a little
FELT = 1e-3  # of a channel's motion, that it must explain: exact data leave errors of the integration
TOGETHER = 4  # candidates that are integrated at once: each step solves for the forces of all
MOST_NUMBERS = 20_000_000  # in the slopes
MOST_SAMPLES = 1000  # of a record that the engine looks at
SENSITIVE = 30.0  # times that an error of the start grows over a record; in proportion to time it is eight
MOST_CALLED_FOR = 3  # elements beyond doubt by their scores that are weighed


def examined_records(
    model: Model,
    records: Sequence[Record],
    estimate: Estimate,
    fitted: FittedRecords | None = None,
    within: float | None = None,
) -> Estimate:
    """The estimate from whole records of a nonlinear rig with its assessment; `fitted` as of `assess_records`.

    Noise and what the rig leaves are not told apart there, so that nothing fits `within` a share of the motion.
    """
    assessment = assess_records(model, records, estimate, fitted)
    unknown = dict.fromkeys(assessment.relative_residual)
    assessment = replace(assessment, discrepancy=unknown, within=within)
    return replace(estimate, assessment=settled_by_size(assessment, within is not None))


def assess_records(
    model: Model, records: Sequence[Record], estimate: Estimate, fitted: FittedRecords | None = None
) -> Assessment:
    """The verdict on an estimate from whole records; "fits" where χ² of a noise known from rest is no larger.

    It is "does not fit" where χ² rejects it, parts are negative, or an element more would explain what residuals are
    left (THEORY §9).
    Residuals are those of the motion that follows from the inputs and the start of each record; where it depends too
    much on its start to be followed, none are told.

    fitted: the fit that the estimate is of.  With noise of the inputs, residuals are relative to the motion that their
    likeliest values give.  Without it the measured inputs count as exact.
    """
    against = [*unphysical(model, estimate), *rejected(estimate)]
    cut = any(notice.code == CUT_RECORD for notice in estimate.warnings)
    uncertain = fitted is not None and fitted.problem.inputs is not None and not cut
    converged = bool(estimate.converged)
    certain, trails = list[ScoredElement](), list[FollowedRecord]()
    if fitted is not None and (uncertain or cut):
        trails = followed_records(fitted.problem, fitted.psi)
    elif not cut:
        with suppress(DataError):  # no motion can be followed
            trails = [followed_record(model, estimate, record) for record in records]
    if uncertain and fitted is not None:
        certain = elements_of_uncertain(fitted.problem, fitted.psi) if converged else []
    elif trails and converged:
        certain = elements_called_for(model, trails)
    against += [_reason(model, each) for each in certain[:1]]
    doubts = [] if against else powerless(estimate)
    found, in_place = None, list[ScoredElement]()
    if against or not converged or (doubts and not uncertain):

        def without_laws(baseline: Baseline) -> Iterator[Effect]:
            in_place.extend([] if certain or converged else _without_laws(model, records))
            return _elements(in_place, baseline)

        kinds = (OF_LAWS, partial(_elements, certain)), (OF_LAWS, without_laws)
        found = _explained(model, records, trails, estimate, kinds, bool(against) or not converged)
    if found is None and not (certain or converged):
        in_place = _without_laws(model, records)
    against += [_reason(model, each) for each in in_place[:1]]
    doubts = [] if against else doubts
    if found is not None and not against and _settled(found):
        against, doubts = [one_cause(found.findings()[0])], []
    findings = found.findings() if found is not None and (against or not converged) else ()
    if not estimate.fit.known_noise:  # what a remedy leaves has no measure
        findings = tuple(replace(each, remaining=None) for each in findings)
    if found is None:
        called_for = (*certain, *in_place)
        findings = tuple(each.effect(model).finding(each.value, explains=each.share) for each in called_for)
    motions = [motion.compared() for motion in trails]
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    return Assessment(verdict, (*against, *doubts), _relative(motions), _worst(motions), findings)


def _without_laws(model: Model, records: Sequence[Record]) -> list[ScoredElement]:
    """What the records call for where the rig's own nonlinear elements are left out."""
    try:
        linear = with_nothing(linear_rig(model))
        fitted = fit_records(linear, records, exact_inputs=True)
        called_for = elements_called_for(linear, followed_records(fitted.problem, fitted.psi))
    except DashpotError:
        return []
    return [replace(each, in_place=True) for each in called_for]


SURE = 0.8  # odds of a cause by which alone a record does not fit


def _settled(found: Explanation) -> bool:
    """Whether one cause is likely and explains nearly all of much that is left over."""
    if not found.causes:
        return False
    first = found.causes[0]
    together = sum(each.odds for each in found.causes if each.group is not None and each.group == first.group)
    return found.as_is.reduced > ENOUGH and first.explains >= NEARLY_ALL and max(first.odds, together) > SURE


def _explained(
    model: Model,
    records: Sequence[Record],
    trails: Sequence[FollowedRecord],
    estimate: Estimate,
    laws: tuple[tuple[float, Effects], tuple[float, Effects]],
    against: bool,
) -> Explanation | None:
    """What may be otherwise, by the part of a record with the largest residual; None where that cannot be asked.

    laws: nonlinear elements in addition to the rig's own, and in their place.
    """
    if model.n > LARGEST or not np.all(np.isfinite(estimate.values)):
        return None
    try:
        baseline = _baseline(model, records, trails, estimate)
        if not (np.isfinite(baseline.as_is.chi2) and (against or baseline.as_is.reduced > ENOUGH)):
            return None
        chosen = np.arange(len(baseline.problem.y))
        assert isinstance(baseline.problem, TimeProblem)
        of_channel = partial(channels_in_time, baseline.problem, chosen, lambda c, fit: fit.expected[:, c])
        return explain_in_time(baseline, ((CHANGED_CHANNEL, of_channel), laws[0]), laws[1:])
    except (DashpotError, np.linalg.LinAlgError):
        return None


def _baseline(
    model: Model, records: Sequence[Record], trails: Sequence[FollowedRecord], estimate: Estimate
) -> Baseline:
    """The part with the largest residual, fitted: of records that were cut a segment, or where segments leave more
    than noise a longer part, if its motion can be followed."""
    part = _begun(model, _worst_part(records, trails), estimate)
    if len(trails) > len(records):
        outputs = [not measures_input(model, channel) for channel in part.problem.channels]
        assert isinstance(part.problem, TimeProblem)
        left = np.concatenate([trail.residual for trail in trails]) / part.problem.noise[outputs]
        if np.mean(left**2) > ENOUGH:
            longer = _begun(model, records[0].part(slice(0, MOST_SAMPLES)), estimate)
            return part if _is_sensitive(longer.as_is) else longer
    return part


def _is_sensitive(fit: FittedProblem) -> bool:
    """Whether an error of the start grows from the first to the last eighth of a record as it does in chaos."""
    assert isinstance(fit.problem, TimeProblem)
    slopes = fit.problem.body.residual(0, fit.psi)[1]
    if slopes is None:
        return True
    starts = [name.startswith("start ") for name in fit.problem.names]
    size = np.linalg.norm(slopes[..., starts], axis=1)
    eighth = max(len(size) // 8, 1)
    grown = np.max(size[-eighth:], axis=0) / np.maximum(np.max(size[:eighth], axis=0), 1e-300)
    return bool(np.max(grown) > SENSITIVE)


def _worst_part(records: Sequence[Record], trails: Sequence[FollowedRecord]) -> Record:
    """The part of a record, MOST_SAMPLES at most, with the largest residual relative to the sizes of the channels.

    trails: of all records, or of the segments that each was cut into because no motion can be followed for longer.
    """
    best, most, begins = records[0].part(slice(0, MOST_SAMPLES)), -1.0, 0
    segments = max(len(trails) // len(records), 1)
    for number, trail in enumerate(trails):
        record = records[number // segments]
        begins = begins if number % segments else 0
        size = np.std(trail.data.outputs, axis=0)
        left = np.sum((trail.residual / np.where(size > 0, size, np.inf)) ** 2, axis=1)
        so_far = np.concatenate([[0.0], np.cumsum(left)])
        width = min(MOST_SAMPLES, len(left))
        of_parts = so_far[width:] - so_far[:-width]
        if np.max(of_parts) > most:
            first, most = int(np.argmax(of_parts)), float(np.max(of_parts))
            best = record.part(slice(begins + first, begins + first + width))
        begins += len(left)
    return best


def _begun(model: Model, record: Record, estimate: Estimate) -> Baseline:
    """The record fitted as it is and without each channel, with as much noise as the quietest lines of what is left."""
    outputs = np.array([not measures_input(model, channel) for channel in record.channels])
    size = np.sqrt(np.mean(record.values**2, axis=0))
    noise = np.where(outputs, FIRST_NOISE * np.where(size > 0, size, 1.0), 0.0)
    problem = TimeProblem.of(model, record, [estimate.values], noise)
    every = [problem.from_starts((*problem.starts, *problem.by_equation))]
    if np.count_nonzero(outputs) > 1:
        own = np.eye(len(outputs), dtype=bool)
        every += [problem.without(own[None, c]) for c in np.flatnonzero(outputs).tolist()]
    fits = fitted_from_starts(every)
    for c in np.flatnonzero(outputs).tolist():
        power = [
            smoothed(np.abs(fit.residual[:, c]) ** 2) for fit in fits if np.any(fit.problem.counted[:, c])
        ]
        floor = min((float(np.quantile(each, QUIET)) for each in power if np.any(each > 0)), default=0.0)
        noise[c] = max(np.sqrt(floor * len(record.time)) / 2, EXACT * size[c])
    every = [
        replace(each, noise=noise).from_starts((fit.psi,)) for each, fit in zip(every, fits, strict=True)
    ]
    fits = fitted_from_starts(every)
    pool = tuple({fit.psi.tobytes(): fit.psi for fit in fits if len(fit.psi) == len(fits[0].psi)}.values())
    begun = every[0].from_starts(pool)
    as_is = replace(fits[0], problem=begun)
    blind = replace(as_is, chi2=np.inf, dof=0)  # an input that is left out leaves nothing to be integrated
    ends = iter(fits[1:])
    return Baseline(begun, as_is, tuple(next(ends, blind) if shown else blind for shown in outputs), {}, True)


def _elements(called_for: Sequence[ScoredElement], baseline: Baseline) -> Iterator[Effect]:
    """Nonlinear elements that are beyond doubt by the scores of all records."""
    model = baseline.problem.model
    for each in called_for[:MOST_CALLED_FOR]:
        if each.element.force_law is None:
            continue
        rig = linear_rig(model) if each.in_place else model
        larger = replaced(rig, replace(with_open_constants(each.element), guess=each.value))
        yield replace(each.effect(model), act=plainly("of_rig", larger))


def _reason(model: Model, cause: ScoredElement) -> Notice:
    """That an element explains much of the residuals."""
    element, points, share = cause.element, points_of(cause.element, model), cause.share
    part = f"a missing {element.kind.value}" if element.force_law is None else "a nonlinear element"
    place = f"at {points[0]}" if element.kind is Kind.MASS else f"between {joined(points)}"
    of = f" of the rig without {laws_in_words(model)}" if cause.in_place else ""
    text = f"{part} {place} explains {100 * share:.0f} % of the residuals{of} (p < 1e-6)"
    return Notice("element_called_for", text, points)


def _relative(motions: Sequence[PredictedMotion]) -> dict[str, float]:
    """Rms of measured − predicted over rms of measured, less its mean, over all records."""
    if not motions:
        return {}
    away = np.sum([len(motion.time) * motion.rms**2 for motion in motions], axis=0)
    size = np.sum([len(motion.time) * np.var(motion.measured, axis=0) for motion in motions], axis=0)
    parts = np.sqrt(away / np.where(size > 0, size, np.inf))
    return dict(zip(motions[0].names, parts.tolist(), strict=True))


def _worst(motions: Sequence[PredictedMotion]) -> tuple[Misfit, ...]:
    """The lines of the residuals' spectra that stand out most, against the rms of all lines of their channel."""
    misfits = []
    for motion in motions:
        residual = motion.measured - motion.predicted
        lines = np.abs(np.fft.rfft(residual - np.mean(residual, axis=0), axis=0))[1:]
        duration = len(motion.time) * float(motion.time[1] - motion.time[0])
        size = lines / np.maximum(np.sqrt(np.mean(lines**2, axis=0)), 1e-300)
        for name, column in zip(motion.names, size.T, strict=True):
            line = int(np.argmax(column))
            misfits.append(Misfit(name, (line + 1) / duration, float(column[line])))
    return worst_of(misfits)


# Elements that the records call for.


def elements_called_for(model: Model, motions: Sequence[FollowedRecord]) -> list[ScoredElement]:
    """Elements that explain much of what records leave over, where that is beyond doubt, what explains most first.

    motions: of all records of one estimate of the rig `model`.
    """
    data = motions[0].data
    candidates = elements_to_try(model, data)
    unknowns = len(motions[0].psi) + len(candidates)
    if sum(motion.residual.size for motion in motions) * unknowns > MOST_NUMBERS:
        return []
    columns = _columns_record_scores(motions, candidates)
    if columns is None:
        return []
    residual, added, size = columns
    certain: list[ScoredElement] = []
    total, improbable = float(residual @ residual), CERTAIN / max(len(candidates), 1)
    relative = max(float(np.max(motion.compared().relative)) for motion in motions)
    least = max(LEAST, (FELT / max(relative, FELT)) ** 2)
    for element, column, before in zip(candidates, added.T, size, strict=True):
        left = float(column @ column)
        if not left > (APART * before) ** 2:
            continue
        value = float(column @ residual) / left
        share = value**2 * left / total
        if feeds_motion(element, value) or not share > least:
            continue
        if steadiness(column, residual, value)[1] < improbable:
            certain.append(ScoredElement(element, share * total, total, len(residual), value))
    return _by_share(certain)


def _by_share(certain: Sequence[ScoredElement]) -> list[ScoredElement]:
    """The best of each place, what explains most first."""
    best: dict[object, ScoredElement] = {}
    for each in sorted(certain, key=lambda each: -each.share):
        best.setdefault((each.element.force_law is None, frozenset(each.element.along)), each)
    return list(best.values())


def elements_to_try(model: Model, data: RecordData) -> list[Element]:
    """Elements that a record may call for, linear ones too."""
    missing = [e for e in missing_elements(model) if e.law.power == 2 or not data.bases.hide(model, e)]
    return [*record_candidates(model, data), *missing]


def _columns_record_scores(
    motions: Sequence[FollowedRecord], candidates: Sequence[Element]
) -> tuple[Real, Real, Real] | None:
    """Residuals (rows,) and columns of the candidates (rows, count) less what the rig itself can do, in order of time.

    And the size of the columns before, (count,).  None where no motion follows.
    """
    sd = np.sqrt(np.mean(np.concatenate([motion.residual for motion in motions]) ** 2, axis=0))
    rows, shared, starts, added = [], [], [], []
    for motion in motions:
        own = replace(motion.problem, sd=np.where(sd > 0, sd, 1.0))
        ((residual, J),) = own.sure_residuals(motion.psi)
        along = _columns(own, motion.psi, candidates)
        if J is None or along is None:
            return None
        flat = J.reshape(residual.size, -1)
        rows.append(residual.ravel())
        shared.append(flat[:, : own.inner])
        starts.append(flat[:, own.inner :])
        added.append(along[0].reshape(residual.size, -1))
    own_columns = np.concatenate([np.concatenate(shared), block_diag(*starts)], axis=1)
    both = np.column_stack([np.concatenate(rows), np.concatenate(added)])
    own_columns = own_columns / np.maximum(np.linalg.norm(own_columns, axis=0), np.finfo(float).tiny)
    left = both - own_columns @ np.linalg.lstsq(own_columns, both, rcond=1e-12)[0]
    return left[:, 0], left[:, 1:], np.linalg.norm(both[:, 1:], axis=0)


# Elements that whole records call for where their inputs are uncertain: scores in the metric of all noise
# (THEORY §9).
#
# What the errors of the inputs can explain counts for nothing, as what the rig's own unknowns can.


def elements_of_uncertain(problem: RecordProblem, psi: Real) -> list[ScoredElement]:
    """Elements that explain much of what is left over, where that is beyond doubt, what explains most first.

    psi (M,): the end of the search of a problem with uncertain inputs.
    """
    candidates = elements_to_try(problem.rig, problem.records[0])
    if total_samples(problem.records) * (len(psi) + len(candidates)) > MOST_NUMBERS:
        return []
    linear = all_linearised(problem, psi)
    columns = _columns(problem, psi, candidates)
    if not linear or columns is None:
        return []
    prior = problem.priors()[0]
    alone = [record.weighed(column) for record, column in zip(linear, columns, strict=True)]
    solved = cleared(linear, prior, columns)
    noise = drawn_noise(linear, prior)
    before, left, product = np.zeros((3, len(candidates)))
    for k, record in enumerate(linear):
        before += np.sum(columns[k] * alone[k], axis=(0, 1))
        left += np.sum(columns[k] * solved[k], axis=(0, 1))
        product += np.einsum("nck,nc->k", solved[k], record.residual)
    spread = np.sqrt(left * _course(solved, noise.data, noise.draws))
    total = sum(record.cost for record in linear)
    certain = []
    rows = sum(record.residual.size for record in linear)
    for element, size, own, score, sd in zip(candidates, before, left, product, spread, strict=True):
        if not own > APART**2 * size or feeds_motion(element, float(score / own)):
            continue
        fall, deviations = float(score**2 / own), float(abs(score) / sd)
        if fall > LEAST * total and 2 * float(stdtr(PARTS - 1, -deviations)) < CERTAIN / len(candidates):
            certain.append(ScoredElement(element, fall, total, rows, float(score / own)))
    return _by_share(certain)


def _columns(problem: RecordProblem, psi: Real, candidates: Sequence[Element]) -> list[Real] | None:
    """Slopes of what the channels show along the candidates, (samples, channels, count) of each record.

    None where no motion follows.
    """
    parts: list[list[Real]] = [[] for _ in problem.records]
    for first in range(0, len(candidates), TOGETHER):
        larger, at, places = problem.with_elements(psi, candidates[first : first + TOGETHER])
        for part, (_, slopes) in zip(parts, larger.sure_residuals(at), strict=True):
            if slopes is None:
                return None
            part.append(slopes[..., list(places)])
    return [np.concatenate(part, axis=-1) for part in parts]


def _course(columns: Sequence[Real], data: Sequence[Real], draws: Sequence[Real]) -> Real:
    """How much more candidates' scores scatter over parts of the records than those of drawn noise, at least 1."""
    measured, usual = np.zeros(columns[0].shape[2]), np.zeros(columns[0].shape[2])
    for column, residual, noise in zip(columns, data, draws, strict=True):
        each = sums_of_parts(np.einsum("nck,nc->nk", column, residual))
        drawn = sums_of_parts(np.einsum("nck,ncd->nkd", column, noise))
        measured += np.sum((each - np.mean(each, axis=0)) ** 2, axis=0)
        usual += np.mean(np.sum((drawn - np.mean(drawn, axis=0)) ** 2, axis=0), axis=-1)
    return np.maximum(measured / np.maximum(usual, np.finfo(float).tiny), 1.0)
