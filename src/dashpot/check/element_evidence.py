"""Nonlinear elements compared by evidence: which the data ask for, ranked, and how many of them (THEORY §9).

ln E of a rig with k more unknowns over the rig as it is, by Schwarz's approximation: ½ N ln(S₀/S₁) − ½ k ln N, S the
sum of squared residuals of N independent numbers; where the noise is known ½ (χ²₀ − χ²₁) − ½ k ln N.  Coloured
residuals of whole records count as N over the square of what colour does to intervals.  Nothing is added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.check.explain.laws import SOFT_NONLINEAR_ELEMENTS as SOFT
from dashpot.check.explain.laws import (
    Motions,
    candidate_elements,
    feeds_motion,
    fitted_in_full,
    free_name,
    motions_of,
    moving_pairs,
    scored_in_dwells,
    seen_candidates,
    softened,
    with_open_constants,
)
from dashpot.check.explain.problem import LineProblem
from dashpot.check.explain.record_channels import require_sound_channels
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.records import RecordData, recorded_motion
from dashpot.estimate.nonlinear.whole_record import FittedRecords, fit_records
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import FORMAT, Estimate
from dashpot.io.json_document import to_json
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import force_law
from dashpot.model.rigfile import element_line

FOLLOWED = 4  # single candidates that are fitted in full
TOGETHER = (2, 1)  # sets of two and of three elements that are
DECISIVE = 5.0  # ln E above which an element is worth its unknowns


@dataclass(frozen=True)
class ElementEvidence:
    """A rig with some more elements: they and their parameters, what is left of the misfit, and ln E.

    remaining: rms of the residuals over that of the rig as it is.
    """

    elements: tuple[Element, ...]
    values: tuple[float, ...]
    remaining: float
    evidence: float

    @property
    def passive(self) -> bool:
        """Whether none of the elements would drive the rig."""
        return not any(map(feeds_motion, self.elements, self.values))


@dataclass(frozen=True)
class ElementComparison:
    """Candidates by their evidence, the best first; `chosen`: those that together are worth their unknowns, if any.

    Those that would drive the rig are ranked, as friction below zero is, but never chosen.

    numbers: how many independent numbers the residuals are worth.
    """

    model: str
    numbers: float
    ranked: tuple[ElementEvidence, ...]
    chosen: ElementEvidence | None

    def to_json(self) -> str:
        """The candidates with the entries of the rig file that they would be."""

        def content(one: ElementEvidence) -> dict[str, Any]:
            return {
                "elements": [
                    {"name": e.name, "section": e.kind.section, "entry": element_line(e), "value": v}
                    for e, v in zip(one.elements, one.values, strict=True)
                ],
                "remaining": one.remaining,
                "ln_evidence": one.evidence,
            }

        return to_json(
            {
                "dashpot": FORMAT,
                "model": self.model,
                "independent_numbers": self.numbers,
                "candidates": [content(one) for one in self.ranked],
                "called_for": None if self.chosen is None else content(self.chosen),
            }
        )


def compare_in_dwells(model: Model, spectrum: Spectrum) -> ElementComparison:
    """From settled dwells.  Raises what `identify` raises, and UsageError if no candidate can be tried."""
    estimate = identify(model, spectrum, "ml")
    (sign,) = spectrum.signs(estimate.signs)
    problem = LineProblem(prepare(model, spectrum), sign, (estimate.values,))
    begun = softened(problem)
    scored = seen_candidates(problem, further=True)
    if not scored:
        scored = scored_in_dwells(begun, candidate_elements(model, motions_of(begun), further=True), SOFT)
    chi2 = problem.balanced().slopes(estimate.values)[2]
    if not scored:
        raise UsageError("nonlinear elements cannot be tried on these data", cure="measure every input")
    ranked = []
    for candidate in scored[:FOLLOWED]:
        full = fitted_in_full(begun, candidate, chi2, 0.0 if candidate.psi is not None else SOFT)
        assert full.element.force_law is not None
        added = 1 + len(full.element.force_law.constants)
        numbers = full.dof + len(estimate.values)
        ln_evidence = (full.fall - added * np.log(numbers)) / 2
        left = float(np.sqrt(max(full.chi2 - full.fall, 0.0) / full.chi2))
        named = with_open_constants(full.element)
        element = replace(named, name=free_name(model, named), guess=float(f"{full.value:.4g}"))
        ranked.append(ElementEvidence((element,), (full.value,), left, float(ln_evidence)))
    ranked.sort(key=lambda one: -one.evidence)
    best = next((one for one in ranked if one.evidence > DECISIVE and one.passive), None)
    return ElementComparison(model.name, float(scored[0].dof), tuple(ranked), best)


def compare_in_records(
    model: Model, records: Sequence[Record], *, progress: Callable[[int, int], None] | None = None
) -> ElementComparison:
    """From whole records, by integration: candidates are scored at the fit of the rig as it is, the best fitted.

    Inputs are treated as exact: were their true values unknown, errors of theirs could explain what an element would.
    Raises what `fit_records` raises, and DataError if channels contradict each other.
    """
    require_sound_channels(model, records)
    base = model if len(model.nonlinear) else with_nothing(model)
    fitted = fit_records(base, records, exact_inputs=True)
    estimate = fitted.estimate()
    # How many independent numbers the residuals are worth
    ratio = float(np.median(estimate.sd / estimate.bound_sd))
    numbers = sum(record.outputs.size for record in fitted.problem.records) / max(ratio, 1.0) ** 2
    candidates = record_candidates(base, fitted.problem.records[0], further=True)
    scored = _scored(fitted, candidates)
    if scored is None or not candidates:
        raise UsageError(
            "nonlinear elements cannot be tried on these records", cure="measure more coordinates"
        )
    trials = scored.trials()
    fits = []
    for done, chosen in enumerate(trials):
        tried = [
            replace(candidates[i], guess=value)
            for i, value in zip(chosen, scored.values(chosen).tolist(), strict=True)
        ]
        evidence = _evidence(base, estimate, fitted, tried, records, numbers)
        if evidence is not None:
            fits.append(evidence)
        if progress is not None:
            progress(done + 1, len(trials))
    fits.sort(key=lambda one: -one.evidence)
    # The fewest elements to which more are not worth adding
    passive = [one for one in fits if one.passive]
    most = passive[0].evidence if passive else 0.0
    worth = [one for one in passive if one.evidence > max(DECISIVE, most - DECISIVE)]
    called_for = min(worth, key=lambda one: len(one.elements)) if worth else None
    return ElementComparison(model.name, numbers, tuple(fits), called_for)


def with_nothing(model: Model) -> Model:
    """A linear rig as a nonlinear one whose nonlinear element does nothing."""
    point = (*model.coordinates, *model.displacement_inputs)[0]
    idle = replace(between("idle", Kind.SPRING, point, "ground", value=0.0), force_law=force_law("d**9"))
    return replace(model, elements=(*model.elements, idle))


def record_candidates(model: Model, record: RecordData, further: bool = False) -> list[Element]:
    """Candidates where an element is, constants sized by the measured motion; without it, those without constants.

    further: with the laws that are tried where elements are compared.
    """
    at = recorded_motion(model, record)
    motions: dict[tuple[str, str], tuple[float, float]] = {}
    joined = {frozenset(element.along) for element in model.elements}
    for first, second in moving_pairs(model):
        if frozenset({first, second} - {"ground"}) not in joined:
            continue
        size, speed = 1.0, 1.0
        line = between("probe", Kind.SPRING, first, second, value=0.0)
        if record.bases.hide(model, line):
            continue
        if at is not None:
            probe = replace(model, elements=(*model.elements, line))
            d = at.x @ probe.B[-1] + at.u @ probe.D[-1]
            size = float(np.max(np.abs(d - np.mean(d))))
            speed = float(np.max(np.abs(np.diff(d)))) / record.step_s
        if size > 0:
            motions[first, second] = size, speed
    reach: Motions = motions
    every = candidate_elements(model, reach, further)
    return [e for e in every if at is not None or (e.force_law is not None and not e.force_law.constants)]


@dataclass(frozen=True)
class _Scored:
    """Normal equations of a rig with all candidates, at the fit of the rig as it is; scaled.

    matrix (M, M), right (M,), scale (M,); kept: columns of the rig as it is, added: those of the candidates.
    """

    matrix: Real
    right: Real
    scale: Real
    kept: tuple[int, ...]
    added: tuple[int, ...]

    def trials(self) -> list[tuple[int, ...]]:
        """Candidates, and sets of some, that lower the squared residuals most."""
        single: list[tuple[int, ...]] = [(i,) for i in range(len(self.added))]
        single.sort(key=self.fall, reverse=True)
        trials = single[:FOLLOWED]
        promising = sorted(i for (i,) in single[:20])  # single candidates from which sets are made
        for size, count in enumerate(TOGETHER, 2):
            trials += sorted(combinations(promising, size), key=self.fall, reverse=True)[:count]
        return trials

    def fall(self, chosen: tuple[int, ...]) -> float:
        """By how much the squared residuals fall with these candidates more, in a linear rig."""
        columns = self._columns(chosen)
        return float(self._solution(chosen) @ self.right[columns])

    def values(self, chosen: tuple[int, ...]) -> Real:
        """Parameters that the candidates would have, (count,)."""
        all_values: Real = self._solution(chosen) / self.scale[self._columns(chosen)]
        return all_values[len(self.kept) :]

    def _columns(self, chosen: tuple[int, ...]) -> list[int]:
        return [*self.kept, *(self.added[i] for i in chosen)]

    def _solution(self, chosen: tuple[int, ...]) -> Real:
        columns = self._columns(chosen)
        return np.linalg.pinv(self.matrix[np.ix_(columns, columns)], rcond=1e-12) @ self.right[columns]


def _scored(fitted: FittedRecords, candidates: Sequence[Element]) -> _Scored | None:
    """What the slopes along the candidates say, None where no motion follows."""
    larger, at, added = fitted.problem.with_elements(fitted.psi, candidates)
    gram, right = np.zeros((len(at), len(at))), np.zeros(len(at))
    for k, (residual, J) in enumerate(larger.sure_residuals(at)):
        if J is None:
            return None
        own = larger.columns(k)
        flat = J.reshape(-1, len(own))
        gram[np.ix_(own, own)] += flat.T @ flat
        right[own] += flat.T @ residual.ravel()
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    kept = tuple(j for j in range(len(at)) if j not in added)
    return _Scored(gram / np.outer(scale, scale), right / scale, scale, kept, added)


def _evidence(
    base: Model, estimate: Estimate, fitted: FittedRecords, chosen: Sequence[Element], records: Sequence[Record],
    numbers: float,
) -> ElementEvidence | None:  # fmt: skip
    """The rig with the candidates fitted in full, from their guesses; None if that fails."""
    model, names = base, []
    for element in chosen:
        named = replace(with_open_constants(element), name=free_name(model, element))
        names.append(named.name)
        model = replace(model, elements=(*model.elements, named))
    found = _fitted(model, base, estimate, fitted, records)
    if found is None:
        return None
    share = found.problem.sd / fitted.problem.sd
    if float(np.mean(np.log(share))) > 0:  # a larger rig fits no worse: its search has gone astray
        return None
    unknowns = [u.name for u in found.problem.model.unknowns]
    added = len(unknowns) - len(base.unknowns)
    weight = numbers / len(share)
    ln_evidence = -weight * float(np.sum(np.log(share))) - added / 2 * np.log(numbers)
    values = tuple(float(found.psi[unknowns.index(name)]) for name in names)
    guesses = dict(zip(names, values, strict=True))
    elements = tuple(
        replace(element, guess=float(f"{guesses[element.name]:.4g}"))
        for element in found.problem.rig.elements
        if element.name in names
    )
    return ElementEvidence(elements, values, float(np.exp(np.mean(np.log(share)))), float(ln_evidence))


def _fitted(
    model: Model, base: Model, estimate: Estimate, before: FittedRecords, records: Sequence[Record]
) -> FittedRecords | None:
    """The larger rig fitted; None if that fails.

    Where all is seen the motion itself tells better where to begin than the fit of the smaller rig does, whose linear
    parts make up for what it lacks.
    """
    seen = all(recorded_motion(model, record) is not None for record in before.problem.records)
    stateless = not any(e.force_law is not None and e.force_law.has_state for e in model.elements)
    stated = {element.name for element in base.elements if element.guess is not None}
    starts = [with_guesses(model, estimate)]
    if seen and stateless:  # without guesses but those that are stated in the rig
        elements = [e if e.name in stated else replace(e, guess=None) for e in model.elements]
        starts.insert(0, replace(model, elements=tuple(elements)))
    for start in starts:
        try:
            found = fit_records(start, records, exact_inputs=True)
        except DashpotError:
            continue
        if found.converged:
            return found
    return None


def with_guesses(model: Model, estimate: Estimate) -> Model:
    """The model with the estimate as guesses where nothing is stated."""
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    elements = []
    for element in model.elements:
        if element.value is None and element.name in values:
            element = replace(element, guess=values[element.name])
        law = element.force_law
        if law is not None:
            constants = [
                replace(c, guess=values.get(f"{element.name}.{c.name}", c.guess)) if c.value is None else c
                for c in law.constants
            ]
            element = replace(element, force_law=law.with_constants(constants))
        elements.append(element)
    return replace(model, elements=tuple(elements))
