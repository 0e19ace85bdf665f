"""Elements that whole records call for where their inputs are uncertain: scores in the metric of all noise (THEORY §9).

What the errors of the inputs can explain counts for nothing, as what the rig's own unknowns can.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtr

from dashpot.arrays import Real
from dashpot.check.diagnosis.candidate_elements import feeds_motion
from dashpot.check.diagnosis.nonlinear_elements import APART, CERTAIN
from dashpot.check.diagnosis.score_test import PARTS, sums_of_parts
from dashpot.check.element_evidence import with_candidates
from dashpot.check.record_scores import LEAST, MOST_NUMBERS, TOGETHER, CalledFor, elements_to_try
from dashpot.estimate.nonlinear.input_levels import all_linearised, stated_precision
from dashpot.estimate.nonlinear.record_problem import RecordProblem
from dashpot.estimate.nonlinear.records import total_samples
from dashpot.estimate.nonlinear.restricted_likelihood import cleared, drawn_noise
from dashpot.model.elements import Element


def element_of_uncertain(problem: RecordProblem, psi: Real) -> CalledFor | None:
    """The element that explains most of what is left over, where that is beyond doubt; None where none is.

    psi (M,): the end of the search of a problem with uncertain inputs.
    """
    candidates = elements_to_try(problem.rig, problem.records[0])
    if total_samples(problem.records) * (len(psi) + len(candidates)) > MOST_NUMBERS:
        return None
    linear = all_linearised(problem, psi)
    columns = _columns(problem, psi, candidates)
    if not linear or columns is None:
        return None
    prior = stated_precision(problem)
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
    best = None
    for element, size, own, score, sd in zip(candidates, before, left, product, spread, strict=True):
        if not own > APART**2 * size:
            continue
        share = float(score**2 / own / total)
        if feeds_motion(element, float(score / own)):
            continue
        chance = 2 * float(stdtr(PARTS - 1, -abs(score) / sd))
        if share > (LEAST if best is None else best.share) and chance < CERTAIN / len(candidates):
            best = CalledFor(element, share, float(score / own))
    return best


def _columns(problem: RecordProblem, psi: Real, candidates: Sequence[Element]) -> list[Real] | None:
    """Slopes of what the channels show along the candidates, (samples, channels, count) of each record."""
    parts: list[list[Real]] = [[] for _ in problem.records]
    for first in range(0, len(candidates), TOGETHER):
        larger, at, places = with_candidates(problem, psi, candidates[first : first + TOGETHER])
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
