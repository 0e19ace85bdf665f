"""Suppositions about the rig: a missing element between any two points, a stated value that is wrong.

All candidates are added to the model at once, with no effect; one evaluation of the likelihood then gives the score of
each, projected on what the rig's own unknowns can do, and by it how far χ² would fall (Rao's score test).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dashpot.arrays import Real
from dashpot.check.diagnosis.score_test import promises
from dashpot.check.diagnosis.search import LONG, Workbench, descended
from dashpot.estimate.likelihood.global_search import seen_directly
from dashpot.estimate.likelihood.objective import bounds, measured
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Model

FOLLOWED = 6  # candidates that are fitted in full
APART = 0.01  # part of a column that the rig's own unknowns must leave for it to count as something else


@dataclass(frozen=True)
class Change:
    """A rig with one thing otherwise, fitted: the element as it would be, its parameter and what is left of χ²."""

    kind: str
    element: Element
    number: float
    chi2: float
    dof: int

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom."""
        return self.chi2 / max(self.dof, 1)


def missing_elements(model: Model) -> list[Element]:
    """A spring and a damper between any two points, unless there is one, and a mass where there is none."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    there = {(element.kind, frozenset(element.along.items())) for element in model.elements}
    candidates = []
    for first, second in combinations(points, 2):
        if first not in model.coordinates:
            continue  # between inputs, or an input and the ground: it moves nothing
        for kind, letter in ((Kind.SPRING, "k"), (Kind.DAMPER, "c")):
            candidates.append(between(f"{letter}_{first}_{second}", kind, first, second))
    candidates += [mass(f"m_{x}", x) for x in model.coordinates]
    return [
        element
        for element in candidates
        if (element.kind, frozenset(element.along.items())) not in there
        and (element.kind, frozenset((point, -factor) for point, factor in element.along.items()))
        not in there
    ]


def stated_values(model: Model) -> list[Element]:
    """The elements whose value is stated as exact, each as if it were unknown."""
    return [
        replace(element, value=None, guess=element.value)
        for element in model.elements
        if element.value is not None and element.sd is None and element.same_as is None and element.value != 0
    ]


def changes(bench: Workbench, psi: Real, followed: int = FOLLOWED) -> list[Change]:
    """The candidates that the score says would help most, `followed` of them fitted in full from ψ (M,)."""
    model, stated = bench.data.model, stated_values(bench.data.model)
    scored = [
        *_scores(bench, psi, "element", missing_elements(model)),
        *_scores(bench, psi, "value", stated),
    ]
    scored.sort(key=lambda entry: -entry[0])
    chosen = [(kind, element) for fall, kind, element in scored[:followed] if fall > 0]
    if (
        bench.data.states is not None
    ):  # a value that is far off has a rig without slopes, yet is found by regression
        named = {element.name for _, element in chosen}
        chosen += [("value", element) for element in stated[:followed] if element.name not in named]
    return [_fitted(bench, psi, kind, element) for kind, element in chosen]


def extended(bench: Workbench, psi: Real, elements: Sequence[Element]) -> tuple[Prepared, Real]:
    """The bench's data of a rig with the candidates as unknowns, and the ψ there that means the same as ψ (M,).

    Candidates are elements of the bench's own rig or new ones.
    """
    model = bench.data.model
    candidates = {element.name: element for element in elements}
    start = dict.fromkeys(candidates, 0.0)
    start |= {e.name: float(e.value) for e in model.elements if e.name in candidates and e.value is not None}
    m = len(model.unknowns)
    start |= zip((unknown.name for unknown in model.unknowns), psi[:m].tolist(), strict=True)
    there = tuple(candidates.pop(e.name, e) for e in model.elements)
    larger = bench.data.of_rig(replace(model, elements=(*there, *candidates.values())))
    return larger, np.array([*(start[unknown.name] for unknown in larger.model.unknowns), *psi[m:]])


def _scores(
    bench: Workbench, psi: Real, kind: str, elements: list[Element]
) -> list[tuple[float, str, Element]]:
    """(fall of χ² that the score promises, kind, element) of each candidate."""
    if not elements:
        return []
    larger, start = extended(bench, psi, elements)
    by_name = {element.name: element for element in elements}
    listed = promises(larger.view, measured(larger), start, bench.sign, by_name.keys(), APART)
    return [(promise.fall, kind, by_name[promise.name]) for promise in listed]


def _fitted(bench: Workbench, psi: Real, kind: str, element: Element) -> Change:
    larger, start = extended(bench, psi, [element])
    view, data = larger.view, measured(larger)
    starts = start[None]
    if larger.states is not None and seen_directly(larger):
        # A rig that lacks a part may have ended among negative masses, from which nothing leads back.
        starts = np.concatenate([starts, compensated(larger.model, larger.states)])
        starts = starts[np.all(np.isfinite(starts), axis=1)]
    rows, signs = np.zeros(len(starts), dtype=np.int64), np.repeat(bench.sign[None], len(starts), axis=0)
    ends, chi2 = descended(view, data, starts, signs, rows, 2 * LONG)
    # A rig of other parts that are possible, not one that turns the given one round: exchanged channels would be that.
    possible = np.all(ends > bounds(view, positive=True)[0], axis=1)
    possible[0] = True
    best = int(np.argmin(np.where(possible, chi2, np.inf)))
    number = float(ends[best, view.names.index(element.name)])
    return Change(kind, element, number, float(chi2[best]), data.rows - len(start))
