"""Suppositions about the rig: a missing element between any two points, a stated value that is wrong.

All candidates are added to the model at once, with no effect; one evaluation of the likelihood then gives the score of
each, projected on what the rig's own unknowns can do, and by it how far χ² would fall (Rao's score test).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dashpot.arrays import Real, hermitian
from dashpot.check.diagnosis.search import LONG, Workbench
from dashpot.estimate.likelihood.objective import local, measured, predict, prior_mean, prior_precision
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise

FOLLOWED = 6  # candidates that are fitted in full
OWN = 0.01  # part of a column that the rig's own unknowns must leave for it to count as something else


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


def changes(bench: Workbench, psi: Real) -> list[Change]:
    """The candidates that the score says would help most, fitted in full from ψ (M,)."""
    model = bench.data.model
    scored = [
        *_scores(bench, psi, "element", missing_elements(model)),
        *_scores(bench, psi, "value", stated_values(model)),
    ]
    scored.sort(key=lambda entry: -entry[0])
    return [_fitted(bench, psi, kind, element) for fall, kind, element in scored[:FOLLOWED] if fall > 0]


def _extended(model: Model, kind: str, elements: Sequence[Element]) -> tuple[Model, dict[str, float]]:
    """The model with the candidates as unknowns, and the value of each that changes nothing."""
    if kind == "value":
        by_name = {element.name: element for element in elements}
        before = {e.name: float(e.value) for e in model.elements if e.name in by_name and e.value is not None}
        return replace(model, elements=tuple(by_name.get(e.name, e) for e in model.elements)), before
    return replace(model, elements=(*model.elements, *elements)), dict.fromkeys(
        (e.name for e in elements), 0.0
    )


def _start(bench: Workbench, psi: Real, extended: Model, before: dict[str, float]) -> Real:
    m = len(bench.data.model.unknowns)
    known = dict(zip((u.name for u in bench.data.model.unknowns), psi[:m].tolist(), strict=True)) | before
    return np.array([*(known[unknown.name] for unknown in extended.unknowns), *psi[m:]])


def _scores(
    bench: Workbench, psi: Real, kind: str, elements: list[Element]
) -> list[tuple[float, str, Element]]:
    """(fall of χ² that the score promises, kind, element) of each candidate."""
    if not elements:
        return []
    extended, before = _extended(bench.data.model, kind, elements)
    start = _start(bench, psi, extended, before)
    spectrum = bench.data.spectrum
    view = observation_model(extended, spectrum.channels, spectrum.omega)
    data = measured(replace(bench.data, model=extended, states=None), view)
    with np.errstate(all="ignore"):
        at = predict(view, data, start[None], bench.sign[None])
    M = len(start)
    J, PJ = at.J.reshape(-1, M), at.PJ.reshape(-1, M)
    information = 2 * (hermitian(J) @ PJ).real
    score = 2 * (hermitian(J) @ at.weighted.reshape(-1, 1)).real[:, 0]
    information = information + np.diag(prior_precision(view))
    score = score - prior_precision(view) * (start - prior_mean(view))
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(score))):
        return []
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    information, score = information / np.outer(scale, scale), score / scale
    names = list(view.names)
    added = [names.index(element.name) for element in elements]
    own = [j for j in range(M) if j not in set(added)]
    half = np.linalg.pinv(information[np.ix_(own, own)], rcond=1e-12)
    entries = []
    for j, element in zip(added, elements, strict=True):
        cross = information[own, j]
        left = information[j, j] - cross @ half @ cross
        if left <= OWN**2:
            continue
        push = score[j] - cross @ half @ score[own]
        entries.append((float(push**2 / left), kind, element))
    return entries


def _fitted(bench: Workbench, psi: Real, kind: str, element: Element) -> Change:
    extended, before = _extended(bench.data.model, kind, [element])
    start = _start(bench, psi, extended, before)
    spectrum = bench.data.spectrum
    view = observation_model(extended, spectrum.channels, spectrum.omega)
    data = measured(replace(bench.data, model=extended, states=None), view)

    def evaluate(at: Real, rows: object) -> QuadraticModel:
        return local(view, data, at, np.broadcast_to(bench.sign, (len(at), len(bench.sign))))

    ended = minimise(evaluate, start[None], limit=2 * LONG, tolerance=1e-2)
    number = float(ended.x[0, view.names.index(element.name)])
    return Change(kind, element, number, float(ended.cost[0]), data.rows - len(start))
