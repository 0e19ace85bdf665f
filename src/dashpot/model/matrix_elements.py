"""Matrices as elements: those of finite-element programs, and those of any rig (THEORY §1).

A symmetric matrix is a sum of rank-one ones, p_ij bᵀb with b = e_i + e_j or e_i − e_j and p_ii e_i e_iᵀ.  Each is an
element, so that every method, dense or sparse, takes blocks with factors, K = Σ θ_i K_i and M, C, H alike, and finds
free symmetric M, C, K (Okuma and Nagamatsu), where a pair that is left out is an entry held at zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy import sparse

from dashpot.errors import ModelError
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model

Letter = Literal["M", "C", "K"]
LETTERS: tuple[Letter, ...] = ("M", "C", "K")
Pairs = Iterable[tuple[str, str]]
# Kinds of what acts at one point, and between two.
KINDS: Mapping[str, tuple[Kind, Kind]] = {
    "M": (Kind.MASS, Kind.INERTER),
    "C": (Kind.DAMPER, Kind.DAMPER),
    "K": (Kind.SPRING, Kind.SPRING),
    "H": (Kind.HYSTERETIC, Kind.HYSTERETIC),
}


def block_elements(
    name: str,
    letter: Literal["M", "C", "K", "H"],
    matrix: Any,
    points: Sequence[str | None],
    **known: float | None,
) -> tuple[Element, ...]:
    """The elements of factor · matrix as a part of M, C, K or H; the first one carries the factor.

    matrix: symmetric, dense or sparse, (points, points), in SI units; `points` names its rows, coordinates or
    displacement inputs, None what is fixed to the ground; rows of one name are joined there.  `known` are value, sd,
    guess, lower and upper of the factor, whose guess is 1 where nothing is given: the model as it was drawn.
    Raises ModelError where the matrix is not square, finite and symmetric, or of another size than `points`.
    """
    # The upper half of a symmetric matrix with its diagonal, sparse, without stored zeros
    size = len(points)
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
    if away > 1e-9 * largest:  # what files round off
        raise ModelError(
            f"the matrix of {name} is not symmetric", cure="give all of it, or save it as a symmetric one"
        )
    names = list(dict.fromkeys(point for point in points if point is not None))
    if len(names) < size:
        place = {point: column for column, point in enumerate(names)}
        rows = [row for row, point in enumerate(points) if point is not None]
        columns = [place[point] for point in points if point is not None]
        joining = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(size, len(names)))
        whole = sparse.csr_array(joining.T @ whole @ joining)
    upper: Any = sparse.csr_array(sparse.triu((whole + whole.T) / 2))
    upper.eliminate_zeros()
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
        add(joint, {names[i]: 1.0, names[j]: -1.0}, -entry)
    # What rounding leaves of a row whose sum is 0 is no element.
    for i in np.flatnonzero(np.abs(rest) > 1e-14 * reach).tolist():
        add(alone, {names[i]: 1.0}, float(rest[i]))
    return tuple(parts)


def free_model(
    coordinates: Sequence[str],
    inputs: Sequence[Input],
    *,
    pairs: Mapping[Letter, Pairs] | None = None,
    letters: str = "MCK",
    name: str = "free matrices",
) -> Model:
    """A model made of `free_elements` only: symmetric M, C, K with some or all entries unknown.

    Raises ModelError for a letter other than M, C, K and for an entry that is not a pair of coordinates.
    """
    elements = free_elements(coordinates, pairs=pairs, letters=letters)
    return Model(tuple(coordinates), tuple(inputs), elements, name)


def free_elements(
    coordinates: Sequence[str], *, pairs: Mapping[Letter, Pairs] | None = None, letters: str = "MCK"
) -> tuple[Element, ...]:
    """Elements whose parameters span all symmetric M, C, K, or those whose only off-diagonal entries are `pairs`.

    Unknown m_x1 (c_x1, k_x1) acts at x1; m_x1_x2 along x1 + x2, so that it is M₁₂ itself; c_x1_x2 and k_x1_x2 along
    x1 − x2, so that they are −C₁₂ and −K₁₂: the dampers and springs between the points, where there are such.
    A letter without pairs given has all of them; `letters` leaves out whole matrices ("MK": no damping).
    Raises ModelError for a letter other than M, C, K and for an entry that is not a pair of coordinates.
    """
    given: Mapping[Letter, Pairs] = {} if pairs is None else pairs
    for letter in (*letters, *given):
        if letter not in LETTERS:
            raise ModelError(f"{letter!r} is not a matrix", cure="the matrices are M, C and K")
    elements = []
    for letter in LETTERS:
        if letter not in letters:
            continue
        alone, joint = KINDS[letter]
        prefix = letter.lower()
        elements += [Element(f"{prefix}_{x}", alone, {x: 1.0}, free=True) for x in coordinates]
        other = 1.0 if letter == "M" else -1.0
        for a, b in _ordered(coordinates, given.get(letter)):
            elements.append(Element(f"{prefix}_{a}_{b}", joint, {a: 1.0, b: other}, free=True))
    return tuple(elements)


def _ordered(coordinates: Sequence[str], pairs: Pairs | None) -> list[tuple[str, str]]:
    if pairs is None:
        return list(combinations(coordinates, 2))
    chosen = set()
    for pair in pairs:
        if len(set(pair)) != 2 or not set(pair) <= set(coordinates):
            raise ModelError(
                f"{' and '.join(map(str, pair))} is not a pair of coordinates",
                cure="name two different coordinates",
            )
        chosen.add(frozenset(pair))
    return [pair for pair in combinations(coordinates, 2) if frozenset(pair) in chosen]


def free_names(model: Model) -> set[str]:
    """Names of the elements that are entries of free matrices: any sign suits them."""
    return {element.name for element in model.elements if element.free}


def free_entries(model: Model) -> dict[Letter, list[tuple[str, str]]]:
    """The free matrices of a model, each with the pairs of coordinates whose entries may differ from 0."""
    entries: dict[Letter, list[tuple[str, str]]] = {}
    for letter in LETTERS:
        elements = [e for e in model.elements if e.free and e.kind in KINDS[letter]]
        if elements:
            pairs = (tuple(element.along) for element in elements)
            entries[letter] = [(pair[0], pair[1]) for pair in pairs if len(pair) == 2]
    return entries
