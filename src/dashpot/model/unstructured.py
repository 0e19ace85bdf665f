"""Free symmetric M, C, K as elements (Okuma and Nagamatsu; THEORY §1).

Every symmetric matrix is a sum of rank-one ones: p_ij bᵀb with b = e_i + e_j or e_i − e_j, and p_ii e_i e_iᵀ.  Each is
an element, so all methods find the matrices of any rig; a pair that is left out is an entry held at zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Literal

from dashpot.errors import ModelError
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model

Letter = Literal["M", "C", "K"]
LETTERS: tuple[Letter, ...] = ("M", "C", "K")
Pairs = Iterable[tuple[str, str]]
_KINDS: Mapping[Letter, tuple[Kind, Kind]] = {
    "M": (Kind.MASS, Kind.INERTER),
    "C": (Kind.DAMPER, Kind.DAMPER),
    "K": (Kind.SPRING, Kind.SPRING),
}


def free_model(
    coordinates: Sequence[str],
    inputs: Sequence[Input],
    *,
    pairs: Mapping[Letter, Pairs] | None = None,
    letters: str = "MCK",
    name: str = "free matrices",
) -> Model:
    """A model of nothing but `free_elements`: symmetric M, C, K of which every entry, or some, are unknown.

    Raises ModelError for a letter other than M, C, K and for what is not a pair of coordinates.
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
    Raises ModelError for a letter other than M, C, K and for what is not a pair of coordinates.
    """
    given: Mapping[Letter, Pairs] = {} if pairs is None else pairs
    for letter in (*letters, *given):
        if letter not in LETTERS:
            raise ModelError(f"{letter!r} is not a matrix", cure="there are M, C and K")
    elements = []
    for letter in LETTERS:
        if letter not in letters:
            continue
        alone, joint = _KINDS[letter]
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
        elements = [e for e in model.elements if e.free and e.kind in _KINDS[letter]]
        if elements:
            pairs = (tuple(element.along) for element in elements)
            entries[letter] = [(pair[0], pair[1]) for pair in pairs if len(pair) == 2]
    return entries
