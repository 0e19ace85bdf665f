"""Rao's score test: how far χ² would fall if something fixed were free, by the slopes at its present value.

Source: THEORY §11.
Many suppositions are judged by one evaluation of the likelihood, each by itself beside the rig's own unknowns.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.special import stdtr

from dashpot.arrays import Real
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import local
from dashpot.model.observation import ObservationModel

PARTS = 40  # of records, each of which tells a parameter by itself


@dataclass(frozen=True)
class Promise:
    """What freeing one unknown promises: the fall of χ² from `chi2`, and the step of the unknown."""

    name: str
    fall: float
    chi2: float
    step: float


def promises(
    view: ObservationModel, data: Measured, psi: Real, sign: Real, added: Collection[str], apart: float,
    together: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> list[Promise]:  # fmt: skip
    """What each of the unknowns `added` promises at ψ (M,), the best fit of the others.

    Left out is what the others can do as well: where less than `apart` of its column is its own.  Each name of
    `together` is one more unknown, by which some of the added move alike.
    """
    with np.errstate(all="ignore"):
        at = local(view, data, psi[None], sign[None])
    information, score = at.symmetric[0], at.gradient[0]
    names = (*view.names, *together)
    alike = [[float(name in members) for name in view.names] for members in together.values()]
    moves = np.concatenate([np.eye(len(psi)), np.reshape(alike, (-1, len(psi)))])
    fixed = [name in added or name in together for name in names]
    return promised(names, fixed, moves @ information @ moves.T, moves @ score, float(at.cost[0]), apart)


def promised(
    names: Sequence[str], fixed: Sequence[bool], information: Real, score: Real, chi2: float, apart: float
) -> list[Promise]:
    """What each of those that are `fixed` promises, by the information (N, N) and score (N,) of all `names`.

    chi2 and apart as in `promises`.
    """
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(score))):
        return []
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    information, score = information / np.outer(scale, scale), score / scale
    free = np.flatnonzero(~np.array(fixed))
    inverse = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-12)
    listed = []
    for j in np.flatnonzero(fixed).tolist():
        cross = information[free, j]
        left = information[j, j] - cross @ inverse @ cross
        if left > apart**2:
            push = score[j] - cross @ inverse @ score[free]
            listed.append(Promise(names[j], float(push**2 / left), chi2, float(push / left / scale[j])))
    return listed


def sums_of_parts(values: Real) -> Real:
    """Sums over PARTS equal parts of records, (PARTS, ...), of values (samples, ...)."""
    sums: Real = np.add.reduceat(
        values, np.linspace(0, len(values), PARTS, endpoint=False).astype(np.int64), axis=0
    )
    return sums


def steadiness(column: Real, residual: Real, value: float, *, uneven: bool = False) -> float:
    """p-value of the parameter `value` of a column in time by its scatter over parts of the records.

    That scatter is there whatever colour and course the noise has; what comes once is no element.
    Where noise is `uneven` in time, no more parts count than tell something of the parameter.
    column, residual: (samples of all records,), or with channels on a second axis.
    """
    rows = column.reshape(len(column), -1), (residual - value * column).reshape(len(column), -1)
    each = sums_of_parts(np.sum(rows[0] * rows[1], axis=1))
    spread = max(float(np.sqrt(np.sum(each**2))), np.finfo(float).tiny)
    tell = sums_of_parts(np.sum(rows[0] ** 2, axis=1))
    count = float(np.sum(tell) ** 2 / max(np.sum(tell**2), np.finfo(float).tiny)) if uneven else PARTS
    return 2 * float(stdtr(max(count - 1, 1.0), -abs(value) * float(np.sum(column * column)) / spread))
