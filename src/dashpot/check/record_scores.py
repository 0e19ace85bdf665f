"""Elements that whole records call for beside those of a nonlinear rig, by the score of each alone (THEORY §9).

A candidate whose parameter is 0 changes nothing; the slope of the integrated motion along it says what it would do.
What the rig's own unknowns and the starts of the records do as well counts for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import log, log1p

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp, stdtr

from dashpot.arrays import Real
from dashpot.check.element_evidence import record_candidates
from dashpot.check.explain.effect import Effect, as_is
from dashpot.check.explain.engine import UNLISTED, count_listed, indistinguishable
from dashpot.check.explain.laws import APART, CERTAIN, feeds_motion, law_effect
from dashpot.check.explain.rigs import missing_elements, missing_in_words, points_of
from dashpot.check.explain.score import PARTS, steadiness, sums_of_parts
from dashpot.estimate.assessment import Finding
from dashpot.estimate.nonlinear.input_levels import all_linearised, cleared, drawn_noise
from dashpot.estimate.nonlinear.record_inference import FollowedRecord
from dashpot.estimate.nonlinear.record_problem import RecordProblem
from dashpot.estimate.nonlinear.records import RecordData, total_samples
from dashpot.model.elements import Element
from dashpot.model.network import Model

LEAST = 0.1  # of the residuals, that a candidate must explain: noise of a measured input makes it explain a little
FELT = 1e-3  # of a channel's motion, that it must explain: exact data leave errors of the integration
TOGETHER = 4  # candidates that are integrated at once: each step solves for the forces of all
MOST_NUMBERS = 20_000_000  # in the slopes


@dataclass(frozen=True)
class _CalledFor:
    """An element beyond doubt: the share of the squared residuals that it would explain, its value, and that in
    standard deviations by its scatter over parts of the records.
    """

    element: Element
    share: float
    value: float
    deviations: float


def _causes(model: Model, certain: Sequence[_CalledFor]) -> tuple[Finding, ...]:
    """The elements as causes by their odds, the likeliest first, as lines of the file of the rig `model`.

    None was fitted: the likelihood of each is that of what it leaves of as many independent numbers as its scatter
    shows of the one that explains most.
    """
    if not certain:
        return ()
    best = max(certain, key=lambda each: each.share)
    numbers = best.deviations**2 * (1 - best.share) / best.share
    effects, likelihood, evidence = [], [], []
    for each in certain:
        element, of = each.element, points_of(each.element, model)
        if element.force_law is None:
            words, more = partial(missing_in_words, model, element), 1
            effect = Effect("element", of, as_is, words, (each.value,), more=more)
        else:
            effect = law_effect(model, element)
        effects.append(effect)
        likelihood.append(-numbers / 2 * log1p(-min(each.share, 1 - 1e-12)))
        evidence.append(likelihood[-1] - effect.more / 2 * log(max(numbers, 2.0)))
    odds = np.exp(np.array(evidence) - logsumexp([*evidence, log(UNLISTED)]))
    place: dict[tuple[str, tuple[str, ...]], int] = {}
    for k in np.argsort(-odds, kind="stable").tolist():
        place.setdefault((effects[k].kind, effects[k].of), k)
    listed = list(place.values())
    listed = listed[: count_listed([float(odds[k]) for k in listed])]
    return tuple(
        effects[k].finding(certain[k].value, odds=float(odds[k]), explains=certain[k].share, group=group)
        for k, group in zip(listed, indistinguishable([likelihood[k] for k in listed]), strict=True)
    )


def elements_called_for(
    model: Model, motions: Sequence[FollowedRecord], stated: Model | None = None
) -> tuple[Finding, ...]:
    """Elements that explain much of what records leave over, where that is beyond doubt, the likeliest first.

    motions: of all records of one estimate of the rig `model`; stated: the rig in whose file they would stand, where
    that is another one.
    """
    data = motions[0].data
    candidates = elements_to_try(model, data)
    unknowns = len(motions[0].psi) + len(candidates)
    if sum(motion.residual.size for motion in motions) * unknowns > MOST_NUMBERS:
        return ()
    columns = _columns_record_scores(motions, candidates)
    if columns is None:
        return ()
    residual, added, size = columns
    certain: list[_CalledFor] = []
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
        deviations, chance = steadiness(column, residual, value)
        if chance < improbable:
            certain.append(_CalledFor(element, share, value, deviations))
    return _causes(model if stated is None else stated, certain)


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
        own, at, each = replace(motion.problem, sd=np.where(sd > 0, sd, 1.0)), motion.psi, []
        residual, J = own.sure_residuals(at)[0]
        for first in range(0, len(candidates), TOGETHER):
            larger, more, places = own.with_elements(at, candidates[first : first + TOGETHER])
            slopes = larger.sure_residuals(more)[0][1]
            if J is None or slopes is None:
                return None
            each.append(slopes[..., list(places)].reshape(residual.size, -1))
        assert J is not None
        flat = J.reshape(residual.size, -1)
        rows.append(residual.ravel())
        shared.append(flat[:, : own.inner])
        starts.append(flat[:, own.inner :])
        added.append(np.concatenate(each, axis=1))
    own_columns = np.concatenate([np.concatenate(shared), block_diag(*starts)], axis=1)
    both = np.column_stack([np.concatenate(rows), np.concatenate(added)])
    own_columns = own_columns / np.maximum(np.linalg.norm(own_columns, axis=0), np.finfo(float).tiny)
    left = both - own_columns @ np.linalg.lstsq(own_columns, both, rcond=1e-12)[0]
    return left[:, 0], left[:, 1:], np.linalg.norm(both[:, 1:], axis=0)


# Elements that whole records call for where their inputs are uncertain: scores in the metric of all noise
# (THEORY §9).
#
# What the errors of the inputs can explain counts for nothing, as what the rig's own unknowns can.


def elements_of_uncertain(problem: RecordProblem, psi: Real) -> tuple[Finding, ...]:
    """Elements that explain much of what is left over, where that is beyond doubt, the likeliest first.

    psi (M,): the end of the search of a problem with uncertain inputs.
    """
    candidates = elements_to_try(problem.rig, problem.records[0])
    if total_samples(problem.records) * (len(psi) + len(candidates)) > MOST_NUMBERS:
        return ()
    linear = all_linearised(problem, psi)
    columns = _columns(problem, psi, candidates)
    if not linear or columns is None:
        return ()
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
    for element, size, own, score, sd in zip(candidates, before, left, product, spread, strict=True):
        if not own > APART**2 * size or feeds_motion(element, float(score / own)):
            continue
        share, deviations = float(score**2 / own / total), float(abs(score) / sd)
        if share > LEAST and 2 * float(stdtr(PARTS - 1, -deviations)) < CERTAIN / len(candidates):
            certain.append(_CalledFor(element, share, float(score / own), deviations))
    return _causes(problem.rig, certain)


def _columns(problem: RecordProblem, psi: Real, candidates: Sequence[Element]) -> list[Real] | None:
    """Slopes of what the channels show along the candidates, (samples, channels, count) of each record."""
    parts: list[list[Real]] = [[] for _ in problem.records]
    for first in range(0, len(candidates), TOGETHER):
        larger, at, places = problem.with_elements(psi, candidates[first : first + TOGETHER])
        for k in range(len(problem.records)):
            slopes = larger.residual(k, at)[1]
            if slopes is None:
                return None
            parts[k].append(slopes[..., list(places)])
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
