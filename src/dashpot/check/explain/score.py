"""Rao's score test: how far χ² would fall if something fixed were free, by the slopes at its value (THEORY §11).

Many suppositions are judged by one evaluation of the likelihood, each by itself alongside the rig's own unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from dashpot.arrays import Real

APART = 1e-4  # part of a column that the rig's own unknowns must leave: what less leaves is lost in rounding
PARTS = 40  # of records, each of which tells a parameter by itself


@dataclass(frozen=True)
class ScoreTest:
    """What freeing one unknown promises: the fall of χ² from `chi2`, and the step of the unknown."""

    name: str
    fall: float
    chi2: float
    step: float


def score_tests(
    names: Sequence[str],
    fixed: Sequence[bool],
    information: Real,
    score: Real,
    chi2: float,
    apart: float = APART,
) -> list[ScoreTest]:
    """What each of those that are `fixed` promises, by the information (N, N) and score (N,) of all `names`.

    Left out is what the others can do as well: where less than `apart` of its column is its own.
    """
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(score))):
        return []
    own = np.diag(information)
    scale = np.sqrt(np.where(own > np.finfo(float).tiny, own, 1.0))  # what moves nothing promises nothing
    information, score = information / np.outer(scale, scale), score / scale
    free = np.flatnonzero(~np.array(fixed))
    inverse = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-12)
    listed = []
    for j in np.flatnonzero(fixed).tolist():
        cross = information[free, j]
        left = information[j, j] - cross @ inverse @ cross
        if left > apart**2:
            push = score[j] - cross @ inverse @ score[free]
            listed.append(ScoreTest(names[j], float(push**2 / left), chi2, float(push / left / scale[j])))
    return listed


def sums_of_parts(values: Real) -> Real:
    """Sums over PARTS equal parts of records, (PARTS, ...), of values (samples, ...)."""
    return np.add.reduceat(
        values, np.linspace(0, len(values), PARTS, endpoint=False).astype(np.int64), axis=0
    )


def steadiness(column: Real, residual: Real, value: float, *, uneven: bool = False) -> tuple[float, float]:
    """The parameter `value` of a column in time over its scatter over parts of the records, and the p-value of that.

    That scatter is there whatever colour and course the noise has; what comes once is no element.
    Where noise is `uneven` in time, no more parts count than tell something of the parameter.
    column, residual: (samples of all records,), or with channels on a second axis.
    """
    rows = column.reshape(len(column), -1), (residual - value * column).reshape(len(column), -1)
    each = sums_of_parts(np.sum(rows[0] * rows[1], axis=1))
    spread = max(float(np.sqrt(np.sum(each**2))), np.finfo(float).tiny)
    tell = sums_of_parts(np.sum(rows[0] ** 2, axis=1))
    count = float(np.sum(tell) ** 2 / max(np.sum(tell**2), np.finfo(float).tiny)) if uneven else PARTS
    deviations = abs(value) * float(np.sum(column * column)) / spread
    return deviations, 2 * float(stdtr(max(count - 1, 1.0), -deviations))
