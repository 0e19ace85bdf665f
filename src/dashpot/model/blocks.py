"""Matrices of a finite-element model as blocks with factors: K = Σ θ_i K_i, and M, C, H alike.

A symmetric matrix is a sum of rank-one ones, one for each entry off its diagonal and one for what is left of the
diagonal: Σ −A_ij (e_i − e_j)(e_i − e_j)ᵀ + Σ_i (Σ_j A_ij) e_i e_iᵀ.  Each is an element whose parameter is tied to
the factor, so that every method, dense or sparse, takes the matrices of any program.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from scipy import sparse

from dashpot.errors import ModelError
from dashpot.model.elements import Element, Kind

Letter = Literal["M", "C", "K", "H"]
SYMMETRIC = 1e-9  # of the largest entry: what files round off
ROUNDING = 1e-14  # of the entries of a row: what is left of a sum that is 0
# Kinds of what acts at one point, and between two.
KINDS: dict[Letter, tuple[Kind, Kind]] = {
    "M": (Kind.MASS, Kind.INERTER),
    "C": (Kind.DAMPER, Kind.DAMPER),
    "K": (Kind.SPRING, Kind.SPRING),
    "H": (Kind.HYSTERETIC, Kind.HYSTERETIC),
}


def block_elements(
    name: str, letter: Letter, matrix: Any, points: Sequence[str], **known: float | None
) -> tuple[Element, ...]:
    """The elements of factor · matrix as a part of M, C, K or H; the first one carries the factor.

    matrix: symmetric, dense or sparse, (points, points), in SI units; `points` names its rows, coordinates or
    displacement inputs.  `known` are value, sd, guess, lower and upper of the factor, whose guess is 1 where nothing
    is given: the model as it was drawn.
    Raises ModelError where the matrix is not square, finite and symmetric, or of another size than `points`.
    """
    upper = _upper_half(name, matrix, len(points))
    if known.get("value") is None and known.get("guess") is None:
        known = {**known, "guess": 1.0}
    alone, joint = KINDS[letter]
    parts = [Element(name, alone, {}, block=name, **known)]  # type: ignore[arg-type]

    def add(kind: Kind, along: dict[str, float], entry: float) -> None:
        part = f"{name}[{len(parts)}]"
        parts.append(Element(part, kind, along, same_as=name, times=entry, block=name))

    rest, reach = upper.diagonal(), np.abs(upper.diagonal())
    off: Any = sparse.coo_array(sparse.triu(upper, 1))
    for i, j, entry in zip(off.row.tolist(), off.col.tolist(), off.data.tolist(), strict=True):
        rest[i] += entry
        rest[j] += entry
        reach[i] += abs(entry)
        reach[j] += abs(entry)
        add(joint, {points[i]: 1.0, points[j]: -1.0}, -entry)
    for i in np.flatnonzero(np.abs(rest) > ROUNDING * reach).tolist():
        add(alone, {points[i]: 1.0}, float(rest[i]))
    return tuple(parts)


def _upper_half(name: str, matrix: Any, size: int) -> Any:
    """The upper half of a symmetric matrix with its diagonal, sparse, without stored zeros."""
    whole = sparse.csr_array(matrix)
    if whole.shape != (size, size):
        shape = " × ".join(map(str, whole.shape))
        raise ModelError(
            f"the matrix of {name} is {shape}, for {size} points", cure="name the points of its rows in order"
        )
    if np.iscomplexobj(whole.data) or not np.all(np.isfinite(whole.data)):
        raise ModelError(f"the matrix of {name} has entries that are not real and finite")
    largest = float(np.max(np.abs(whole.data), initial=0.0))
    if largest == 0:
        raise ModelError(f"the matrix of {name} is 0", cure="leave the block out")
    away = float(np.max(np.abs((whole - whole.T).data), initial=0.0))
    if away > SYMMETRIC * largest:
        raise ModelError(
            f"the matrix of {name} is not symmetric", cure="give all of it, or save it as a symmetric one"
        )
    upper: Any = sparse.csr_array(sparse.triu((whole + whole.T) / 2))
    upper.eliminate_zeros()
    return upper
