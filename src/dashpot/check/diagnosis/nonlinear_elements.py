"""Suppositions that an element is nonlinear: candidates between any two points, by score and then by a fit in full.

A candidate with the parameter 0 changes nothing; the slope of the harmonic balance along it says what it would do to
every harmonic, at every amplitude.  Projected on what the rig's own unknowns can do, that gives the score of each, and
those that promise most are fitted (Rao's score test; for whole records the score alone, THEORY §9).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Real, hermitian
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import local, measured, predict, prior_mean, prior_precision
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise

# Kind, law and the share of the motion that its constant is, if it has one.
LAWS: tuple[tuple[Kind, str, str, float], ...] = (
    (Kind.SPRING, "cubic", "", 0.0),
    (Kind.SPRING, "square", "", 0.0),
    (Kind.SPRING, "quadratic", "", 0.0),
    (Kind.SPRING, "quintic", "", 0.0),
    (Kind.SPRING, "gap", "gap", 0.5),
    (Kind.DAMPER, "quadratic", "", 0.0),
    (Kind.DAMPER, "cubic", "", 0.0),
    (Kind.DAMPER, "coulomb", "v0", 0.1),
)
FURTHER = (
    (Kind.SPRING, "d**4", "", 0.0),
    (Kind.DAMPER, "d**2*v", "", 0.0),
)  # tried where elements are compared
WORDS = {"d**4": "quartic", "d**2*v": "growing"}  # in names of elements
CERTAIN = 1e-6  # p-value below which a nonlinear element is called for
MARKED = 0.3  # share of the misfit that it must explain
OWN = 1e-4  # part of a column that the rig's own unknowns must leave
FEW = 4  # coordinates up to which any two points are tried, and not only those that an element joins
FOLLOWED = 2  # candidates that are fitted in full
ENOUGH = 2.0  # χ² per degree of freedom at which no other candidate is followed
LIMIT = 15  # iterations of such a fit
HINT = 0.1  # share of the softened misfit that a candidate must promise to be followed
SOFT = 0.05  # relative noise of the softened data


@dataclass(frozen=True)
class ScoredElement:
    """A candidate: how far χ² falls with it, from `chi2` with `dof` degrees of freedom, and the value it would have."""

    element: Element
    fall: float
    chi2: float
    dof: int
    value: float

    @property
    def p_value(self) -> float:
        """Probability of such a fall by noise alone, what is left being noise."""
        left = max(self.chi2 - self.fall, 1e-300) / max(self.dof - 1, 1)
        return float(fdtrc(1.0, float(max(self.dof - 1, 1)), self.fall / max(left, 1.0)))


Motions = Mapping[
    tuple[str, str], tuple[float, float]
]  # elongation (m) and its rate (m/s) between two points


def moving_pairs(model: Model) -> list[tuple[str, str]]:
    """Any two points that move against each other; in large rigs only those that an element joins."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    joined = {frozenset(element.along) for element in model.elements}
    return [
        (first, second)
        for first, second in combinations(points, 2)
        if first in model.coordinates
        and (model.n <= FEW or frozenset({first, second} - {"ground"}) in joined)
    ]  # fmt: skip


def candidate_elements(model: Model, motions: Motions, further: bool = False) -> list[Element]:
    """Every law of LAWS, and of FURTHER, between the points that move, their constants in proportion to the motion.

    Where the rig has such an element already there is none.
    """
    there = {
        (element.force_law.expression.text, frozenset(element.along))
        for element in model.elements
        if element.force_law is not None
    }
    candidates = []
    for (first, second), (size, speed) in motions.items():
        for kind, name, constant, share in (*LAWS, *(FURTHER if further else ())):
            value = share * (speed if constant == "v0" else size)
            law = force_law(name, [Constant(constant, value)] if constant else [], damper=kind is Kind.DAMPER)
            plain = between(f"{WORDS.get(name, name)}_{kind.value}_{first}_{second}", kind, first, second)
            if (law.expression.text, frozenset(plain.along)) not in there:
                candidates.append(replace(plain, force_law=law))
    return candidates


def scored_in_dwells(
    data: Prepared, psi: Real, sign: Real, elements: Sequence[Element], softness: float
) -> list[ScoredElement]:
    """The candidates by their score at ψ (M,), the best fit of the data with that softness, the best first.

    data: of one repeat, settled dwells.  Softened, all amplitudes have a say: beside a small noise those near
    resonance, where a wrong rig fails most, would decide alone.  [] where none can be had.
    """
    found = []
    for element in elements:
        extended = replace(data.model, elements=(*data.model.elements, element))
        try:
            scored = _score(replace(data, model=extended), psi, sign, element, softness)
        except DashpotError:
            continue
        if scored is not None:
            found.append(scored)
    return sorted(found, key=lambda scored: -scored.fall)


def _score(data: Prepared, psi: Real, sign: Real, element: Element, softness: float) -> ScoredElement | None:
    spectrum = data.spectrum
    view = observation_model(data.model, spectrum.channels, spectrum.omega)
    start = _with_element(data.model, element, psi, 0.0)
    with np.errstate(all="ignore"):
        at = predict(view, measured(replace(data, states=None), view, softness), start[None], sign[None])
    if not (np.all(np.isfinite(at.J)) and np.all(np.isfinite(at.weighted))):
        return None
    J, PJ = at.J.reshape(-1, at.J.shape[-1]), at.PJ.reshape(-1, at.J.shape[-1])
    information = 2 * (hermitian(J) @ PJ).real + np.diag(prior_precision(view))
    score = 2 * (hermitian(J) @ at.weighted.reshape(-1, 1)).real[:, 0]
    score = score - prior_precision(view) * (start - prior_mean(view))
    place = [unknown.name for unknown in data.model.unknowns].index(element.name)
    chi2 = float(np.sum(at.cost_per_line))
    rows = 2 * int(np.sum(np.isfinite(spectrum.amplitudes)))
    return _projected(element, information, score, place, chi2, rows - len(start))


def _projected(
    element: Element, information: Real, score: Real, place: int, chi2: float, dof: int
) -> ScoredElement | None:
    """What the column `place` adds to the others."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    information, score = information / np.outer(scale, scale), score / scale
    rest = [j for j in range(len(score)) if j != place]
    half = np.linalg.pinv(information[np.ix_(rest, rest)], rcond=1e-12)
    cross = information[rest, place]
    left = information[place, place] - cross @ half @ cross
    if left <= OWN**2:
        return None
    push = score[place] - cross @ half @ score[rest]
    fall = float(push**2 / left)
    return ScoredElement(element, min(fall, chi2), chi2, max(dof, 1), float(push / left / scale[place]))


def _with_element(model: Model, element: Element, psi: Real, value: float) -> Real:
    """ψ of the larger rig, in which the element has `value` and its constants their guesses."""
    assert element.force_law is not None
    added = {element.name: value}
    added |= {f"{element.name}.{c.name}": c.guess for c in element.force_law.constants if c.guess is not None}
    unknowns = [unknown.name for unknown in model.unknowns]
    count = sum(name not in added for name in unknowns)
    before = iter(psi[:count].tolist())
    theta = [added[name] if name in added else next(before) for name in unknowns]
    return np.concatenate([theta, psi[count:]])


def with_open_constants(element: Element) -> Element:
    """The element with its inner constants unknown, what they were as guesses."""
    assert element.force_law is not None
    constants = [
        replace(c, value=None, guess=float(f"{c.value:.3g}"))
        for c in element.force_law.constants
        if c.value is not None
    ]
    return replace(element, force_law=element.force_law.with_constants(constants))


def motions_of(data: Prepared, psi: Real) -> Motions:
    """How far any two points move against each other by the rig at ψ; {} where the inputs are not seen."""
    model, both = data.model, moving_pairs(data.model)
    probes = [
        replace(between(f"probe_{a}_{b}", Kind.SPRING, a, b, value=0.0), force_law=force_law("cubic"))
        for a, b in both
    ]
    larger = replace(model, elements=(*model.elements, *probes))
    spectrum = data.spectrum
    view = observation_model(larger, spectrum.channels, spectrum.omega)
    try:
        part = measured(replace(data, model=larger, states=None), view).nonlinear
    except DashpotError:
        return {}
    assert part is not None
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    theta = psi[: len(model.unknowns)]
    p = np.tile(larger.parameters(theta), (len(drive.omega), 1))
    constants = np.tile(larger.inner_constants(theta), (len(drive.omega), 1))
    moved = periodic_response(larger, p, constants, drive).delta[:, -len(probes) :]
    delta = np.nan_to_num(np.abs(complex_of(moved)[..., 1]))
    size, speed = np.max(delta, axis=0), np.max(delta * drive.omega[:, None], axis=0)
    return {
        pair: (float(d), float(v))
        for pair, d, v in zip(both, size, speed, strict=True)
        if d > 1e-9 * np.max(size)
    }  # fmt: skip


def softened(data: Prepared, psi: Real, sign: Real) -> Real:
    """ψ (M,) of the rig as it is from the softened data, from ψ of the data themselves."""
    view = observation_model(data.model, data.spectrum.channels, data.spectrum.omega)
    return _descended(view, measured(replace(data, states=None), view, SOFT), psi, sign, 2 * LIMIT)[0]


def _descended(
    view: ObservationModel, exact: Measured, psi: Real, sign: Real, limit: int
) -> tuple[Real, float]:
    """(ψ, χ²) downhill from ψ (M,); ψ itself where nothing leads on."""

    def evaluate(at: Real, rows: object) -> QuadraticModel:
        return local(view, exact, at, np.broadcast_to(sign, (len(at), len(sign))))

    with np.errstate(all="ignore"):
        ended = minimise(evaluate, psi[None], limit=limit, tolerance=1e-2)
    return (ended.x[0], float(ended.cost[0])) if np.isfinite(ended.cost[0]) else (psi, np.inf)


def called_for(data: Prepared, psi: Real, sign: Real) -> list[ScoredElement]:
    """Nonlinear elements that the dwells call for, fitted in full, the best first; [] where none is certain.

    ψ (M,): the best fit of the rig as it is.
    """
    chi2, fitted = misfit(data, psi, sign), list[ScoredElement]()
    for softness, start in ((0.0, psi), (SOFT, softened(data, psi, sign))):
        candidates = candidate_elements(data.model, motions_of(data, start))
        scored = scored_in_dwells(data, start, sign, candidates, softness)
        for candidate in scored[:FOLLOWED]:
            if candidate.fall > HINT * candidate.chi2:
                fitted.append(fitted_in_full(data, start, sign, candidate, chi2, softness))
            if fitted and fitted[-1].chi2 - fitted[-1].fall < ENOUGH * fitted[-1].dof:
                return [fitted[-1]] if fitted[-1].p_value < CERTAIN else []
    certain = [one for one in fitted if one.p_value < CERTAIN and one.fall > MARKED * one.chi2]
    return sorted(certain, key=lambda one: -one.fall)


def misfit(data: Prepared, psi: Real, sign: Real) -> float:
    """χ² of the rig as it is at ψ (M,)."""
    view = observation_model(data.model, data.spectrum.channels, data.spectrum.omega)
    with np.errstate(all="ignore"):
        at = local(view, measured(replace(data, states=None), view), psi[None], sign[None])
    return float(at.cost[0])


def fitted_in_full(
    data: Prepared, psi: Real, sign: Real, candidate: ScoredElement, chi2: float, softness: float
) -> ScoredElement:
    """The candidate's value and how far χ² falls from `chi2` with all unknowns at their best, from ψ (M,)."""
    assert candidate.element.force_law is not None
    element = with_open_constants(candidate.element)
    extended = replace(data.model, elements=(*data.model.elements, element))
    larger = replace(data, model=extended, states=None)
    view = observation_model(extended, data.spectrum.channels, data.spectrum.omega)
    exact = measured(larger, view)
    best, least = _with_element(extended, element, psi, 0.0), np.inf
    for value in (candidate.value, 0.3 * candidate.value):
        start = _with_element(extended, element, psi, value)
        if softness > 0:
            start = _descended(view, measured(larger, view, softness), start, sign, LIMIT)[0]
        ended, cost = _descended(view, exact, start, sign, LIMIT)
        if cost < least:
            best, least = ended, cost
        if least < ENOUGH * candidate.dof:
            break
    names = [unknown.name for unknown in extended.unknowns]
    values = dict(zip(names, best[: len(names)].tolist(), strict=True))
    law = candidate.element.force_law
    constants = [replace(c, value=values[f"{element.name}.{c.name}"]) for c in law.constants]
    found = replace(candidate.element, force_law=law.with_constants(constants))
    fall = max(chi2 - least, 0.0)
    return replace(candidate, element=found, fall=fall, chi2=chi2, value=values[element.name])
