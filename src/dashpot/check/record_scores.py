"""Elements that whole records call for beside those of a nonlinear rig, by the score of each alone (THEORY §9).

A candidate whose parameter is 0 changes nothing; the slope of the integrated motion along it says what it would do.
What the rig's own unknowns and the starts of the records do as well counts for nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from dashpot.arrays import Real
from dashpot.check.diagnosis.candidate_elements import feeds_motion
from dashpot.check.diagnosis.nonlinear_elements import APART, CERTAIN
from dashpot.check.diagnosis.rig_changes import missing_elements
from dashpot.check.diagnosis.score_test import steadiness
from dashpot.check.element_evidence import record_candidates, with_candidates
from dashpot.estimate.nonlinear.record_prediction import FollowedRecord
from dashpot.estimate.nonlinear.records import RecordData
from dashpot.model.elements import Element
from dashpot.model.network import Model

LEAST = 0.1  # of the residuals, that a candidate must explain: noise of a measured input makes it explain a little
FELT = 1e-3  # of a channel's motion, that it must explain: exact data leave errors of the integration
TOGETHER = 4  # candidates that are integrated at once: each step solves for the forces of all
MOST_NUMBERS = 20_000_000  # in the slopes


@dataclass(frozen=True)
class CalledFor:
    """An element that would explain a share of the squared residuals, and the value that it would have."""

    element: Element
    share: float
    value: float


def element_called_for(model: Model, motions: Sequence[FollowedRecord]) -> CalledFor | None:
    """The element that explains most of what records leave over, where that is beyond doubt; None where none is.

    motions: of all records of one estimate of the rig `model`.
    """
    data = motions[0].data
    candidates = elements_to_try(model, data)
    unknowns = len(motions[0].psi) + len(candidates)
    if sum(motion.residual.size for motion in motions) * unknowns > MOST_NUMBERS:
        return None
    columns = _columns(motions, candidates)
    if columns is None:
        return None
    residual, added, size = columns
    certain = CERTAIN / max(len(candidates), 1)
    total, best = float(residual @ residual), None
    relative = max(float(np.max(motion.compared().relative)) for motion in motions)
    least = max(LEAST, (FELT / max(relative, FELT)) ** 2)
    for element, column, before in zip(candidates, added.T, size, strict=True):
        left = float(column @ column)
        if not left > (APART * before) ** 2:
            continue
        value = float(column @ residual) / left
        share = value**2 * left / total
        if feeds_motion(element, value):
            continue
        if share > (least if best is None else best.share) and steadiness(column, residual, value) < certain:
            best = CalledFor(element, share, value)
    return best


def elements_to_try(model: Model, data: RecordData) -> list[Element]:
    """Elements that a record may call for, linear ones too."""
    missing = [e for e in missing_elements(model) if e.law.power == 2 or not data.bases.hide(model, e)]
    return [*record_candidates(model, data), *missing]


def _columns(
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
            larger, more, places = with_candidates(own, at, candidates[first : first + TOGETHER])
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
