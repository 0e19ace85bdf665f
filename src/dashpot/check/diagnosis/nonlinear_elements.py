"""Suppositions that an element is nonlinear: candidates between any two points, by score and then by a fit in full.

A candidate with the parameter 0 changes nothing; the slope of the harmonic balance along it says what it would do to
every harmonic, at every amplitude.  Projected on what the rig's own unknowns can do, that gives the score of each, and
those that promise most are fitted (Rao's score test; for whole records the score alone, THEORY §9).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.check.diagnosis.candidate_elements import (
    ONE_SIDED,
    Motions,
    ScoredElement,
    candidate_elements,
    feeds_motion,
    moving_pairs,
    with_open_constants,
)
from dashpot.check.diagnosis.score_test import Promise, promised, promises
from dashpot.check.diagnosis.search import descended
from dashpot.check.diagnosis.seen_elements import scored_by_equation
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.nuisance import estimated_inputs
from dashpot.estimate.likelihood.objective import local, measured, predict
from dashpot.estimate.nonlinear.dwells import dwells_of
from dashpot.estimate.nonlinear.search import lost_dwells_regained, measured_branches_regained
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.force_law import force_law
from dashpot.model.nonlinear.harmonic_balance import periodic_response, samples_of
from dashpot.model.nonlinear.harmonics import complex_of, real_of
from dashpot.model.observation import ObservationModel, Transfer, calibrated_transfer

CERTAIN = 1e-6  # p-value below which a nonlinear element is called for
MARKED = 0.3  # share of the misfit that it must explain
APART = 1e-4  # part of a column that the rig's own unknowns must leave
TOGETHER = 12  # candidates that are scored at once
FULLY = 4  # candidates that are fitted in full where all motion is seen
FOLLOWED, SOFTLY = 2, 4  # candidates that are fitted in full, the second number from the softened data
NEARLY = 4.0  # times the χ² that the best leaves: others that leave no more are named, too
ENOUGH = 2.0  # χ² per degree of freedom at which no other candidate is followed
GLANCE, LIMIT = 5, 15  # iterations of such a fit: before it must have begun to help, and in all
HINT = 0.4  # share of the misfit that a candidate must promise to be followed
LEFT = 0.1  # share of the misfit in the equation of motion that a candidate may leave
ROUGHLY = 7.0  # or χ² of a degree of freedom that it may leave there
FALLEN = 0.1  # share by which the softened misfit must have fallen for a fit to go on
SOFT = 0.05  # relative noise of the softened data
STILL = 1e-9  # of the largest elongation: points that move no further do not move
ROUNDED = 1e-9  # of the largest harmonic of a force: what is smaller is none


def scored_in_dwells(
    data: Prepared, psi: Real, sign: Real, elements: Sequence[Element], softness: float
) -> list[ScoredElement]:
    """The candidates by their score at ψ (M,), the best fit of the data with that softness, the best first.

    data: of one repeat, settled dwells.  Softened, all amplitudes have a say: beside a small noise those near
    resonance, where a wrong rig fails most, would decide alone.  [] where none can be had.  Without even harmonics a
    stop on one side does what stops on both do by half.
    """
    elements = _told_apart(data, elements)
    if not len(data.model.nonlinear):
        try:
            return _best_first(_scored_beside_linear(data, psi, sign, elements, softness))
        except DashpotError:
            return []
    scored = []
    for rough in (False, True):  # laws that are not smooth take many instants of each period
        alike = [e for e in elements if e.force_law is not None and e.force_law.smooth is not rough]
        for first in range(0, len(alike), TOGETHER):
            try:
                scored += _scored(data, psi, sign, alike[first : first + TOGETHER], softness)
            except DashpotError:
                continue
    return _best_first(scored)


def _told_apart(data: Prepared, elements: Sequence[Element]) -> Sequence[Element]:
    """Without stops on one side where no even harmonic, which tells them from those on both, is measured."""
    if np.any(dwells_of(data.model, data.spectrum).order % 2 == 0):
        return elements
    return [e for e in elements if e.force_law is not None and e.force_law.text != ONE_SIDED]


def _best_first(scored: Sequence[ScoredElement]) -> list[ScoredElement]:
    return sorted(scored, key=lambda candidate: -candidate.fall)


def _scored_beside_linear(
    data: Prepared, psi: Real, sign: Real, elements: Sequence[Element], softness: float
) -> list[ScoredElement]:
    """As `_scored`, of a linear rig: its motion is that without the candidates, so that nothing is balanced.

    The column of a candidate is what its forces under that motion do to the channels.
    """
    if not elements:
        return []
    exact = measured(replace(data, states=None), softness)
    here, turned = psi[None], sign[None]
    with np.errstate(all="ignore"):
        at, base = predict(data.view, exact, here, turned), local(data.view, exact, here, turned)
    added = _columns(data, psi, sign, elements, at.q)
    weighted = exact.W @ added
    if exact.q is None:
        G = calibrated_transfer(data.view, here, turned).G
        _, half = estimated_inputs(G, exact.W, exact.y)
        weighted = weighted - half @ (hermitian(G) @ weighted)
    each = hermitian(added)
    cross = 2 * np.sum((each @ at.PJ).real, axis=1)[0]
    within = 2 * np.sum((each @ weighted).real, axis=1)[0]
    score = 2 * np.sum((each @ at.weighted[..., None]).real, axis=1)[0, :, 0]
    names = [*data.view.names, *(element.name for element in elements)]
    fixed = [False] * len(psi) + [True] * len(elements)
    listed = promised(
        names, fixed, np.block([[base.symmetric[0], cross.T], [cross, within]]),
        np.concatenate([base.gradient[0], score]), float(base.cost[0]), APART,
    )  # fmt: skip
    return _as_scored(data, len(psi), elements, listed)


def _columns(data: Prepared, psi: Real, sign: Real, elements: Sequence[Element], q: Complex) -> Complex:
    """What the candidates do to the channels per unit of their parameters, (1, lines, channels, candidates).

    q (1, lines, r + s): the inputs.
    """
    bent = replace(data.model, elements=(*data.model.elements, *elements))
    straight = replace(
        data.model, elements=(*data.model.elements, *(replace(e, force_law=None) for e in elements))
    )
    rig = calibrated_transfer(
        data.of_rig(straight).view,
        _with_elements(straight, {element.name: 0.0 for element in elements}, psi)[None], sign[None],
    )  # fmt: skip
    assert isinstance(rig, Transfer)
    r, chosen = data.model.D.shape[1], bent.nonlinear
    X = np.einsum("...nq,...q->...n", rig.X, q)[0]
    lines = X @ bent.B[chosen].T + q[0, :, :r] @ bent.D[chosen].T
    dwells = dwells_of(bent, data.spectrum)
    harmonics = np.zeros((len(dwells.omega), dwells.orders + 1, len(chosen)), dtype=np.complex128)
    harmonics[dwells.dwell, dwells.order] = lines
    constants = np.tile(bent.inner_constants(np.zeros(len(bent.unknowns))), (len(dwells.omega), 1))
    forces = alternate(
        bent, constants, dwells.omega, real_of(np.moveaxis(harmonics, 1, -1)), samples_of(bent, dwells.orders),
        slopes=False,
    )  # fmt: skip
    at_harmonics = np.moveaxis(complex_of(forces.a), -1, 1)
    unit_forces = at_harmonics[dwells.dwell, dwells.order]
    # The square of a sine has no fundamental but rounding.
    rounding = ROUNDED * np.max(np.abs(at_harmonics), axis=1)[dwells.dwell]
    unit_forces = np.where(np.abs(unit_forces) > rounding, unit_forces, 0.0)
    columns: Complex = rig.E[..., chosen] * unit_forces[:, None, :]
    return columns


def _scored(
    data: Prepared, psi: Real, sign: Real, elements: Sequence[Element], softness: float
) -> list[ScoredElement]:
    extended = replace(data.model, elements=(*data.model.elements, *elements))
    larger = replace(data.of_rig(extended), states=None)
    exact = measured(larger, softness)
    start = _with_elements(extended, {element.name: 0.0 for element in elements}, psi)
    names = {element.name for element in elements}
    return _as_scored(data, len(psi), elements, promises(larger.view, exact, start, sign, names, APART))


def _as_scored(
    data: Prepared, unknowns: int, elements: Sequence[Element], listed: Sequence[Promise]
) -> list[ScoredElement]:
    dof = max(2 * int(np.sum(np.isfinite(data.spectrum.amplitudes))) - unknowns - 1, 1)
    by_name = {element.name: element for element in elements}
    return [ScoredElement(by_name[p.name], min(p.fall, p.chi2), p.chi2, dof, p.step) for p in listed]


def _with_elements(model: Model, added: Mapping[str, float], psi: Real) -> Real:
    """ψ of the larger rig `model`, in which elements have the values `added` and their open constants the guesses."""
    guesses = {
        f"{element.name}.{constant.name}": constant.guess
        for element in model.elements
        if element.name in added and element.force_law is not None
        for constant in element.force_law.constants
        if constant.guess is not None
    }
    known = {**added, **guesses}
    unknowns = [unknown.name for unknown in model.unknowns]
    count = sum(name not in known for name in unknowns)
    before = iter(psi[:count].tolist())
    theta = [known[name] if name in known else next(before) for name in unknowns]
    return np.concatenate([theta, psi[count:]])


def motions_of(data: Prepared, psi: Real) -> Motions:
    """How far any two points move against each other by the rig at ψ (M,); {} where the inputs are not seen."""
    model, both = data.model, moving_pairs(data.model)
    probes = [
        replace(between(f"probe_{a}_{b}", Kind.SPRING, a, b, value=0.0), force_law=force_law("cubic"))
        for a, b in both
    ]
    larger = replace(model, elements=(*model.elements, *probes))
    try:
        part = measured(replace(data.of_rig(larger), states=None)).nonlinear
    except DashpotError:
        return {}
    assert part is not None
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    theta = psi[: len(model.unknowns)]
    p = np.tile(larger.parameters(theta), (len(drive.omega), 1))
    constants = np.tile(larger.inner_constants(theta), (len(drive.omega), 1))
    moved = periodic_response(larger, p, constants, drive).delta[:, -len(probes) :]
    return _moving(both, np.nan_to_num(np.abs(complex_of(moved)[..., 1])), drive.omega)


def measured_motions(data: Prepared) -> Motions:
    """As `motions_of`, from the motion as it was measured; {} where not all of it is seen."""
    model, states = data.model, data.states
    if states is None:
        return {}
    both = moving_pairs(model)
    probes = [between(f"probe_{a}_{b}", Kind.SPRING, a, b, value=0.0) for a, b in both]
    larger = replace(model, elements=(*model.elements, *probes))
    chosen = slice(len(model.elements), None)
    delta = np.abs(states.X[0] @ larger.B[chosen].T + states.U[0] @ larger.D[chosen].T)
    return _moving(both, delta, data.spectrum.omega)


def _moving(pairs: Sequence[tuple[str, str]], delta: Real, omega: Real) -> Motions:
    """The largest elongation (m) and rate (m/s) of those pairs that move; delta (lines, pairs), omega (lines,)."""
    size, speed = np.max(delta, axis=0), np.max(delta * omega[:, None], axis=0)
    return {
        pair: (float(d), float(v))
        for pair, d, v in zip(pairs, size, speed, strict=True)
        if d > STILL * np.max(size)
    }


def softened(data: Prepared, psi: Real, sign: Real) -> Real:
    """ψ (M,) of the rig as it is from the softened data, from ψ of the data themselves."""
    return _descended(data.view, measured(replace(data, states=None), SOFT), psi, sign, 2 * LIMIT)[0]


def _descended(
    view: ObservationModel, exact: Measured, psi: Real, sign: Real, limit: int
) -> tuple[Real, float]:
    """(ψ, χ²) downhill from ψ (M,); ψ itself where nothing leads on."""
    end, chi2 = descended(view, exact, psi[None], sign[None], np.zeros(1, dtype=np.int64), limit)
    return (end[0], float(chi2[0])) if np.isfinite(chi2[0]) else (psi, np.inf)


def _followed(
    view: ObservationModel, exact: Measured, psi: Real, sign: Real, most: float, *, regaining: bool = False
) -> tuple[Real, float]:
    """(ψ, χ²) downhill from ψ (M,) of a candidate, a few steps only where χ² does not come below `most` by then.

    regaining: where it does not, dwells that are lost near a fold, or move otherwise than was measured, are looked for
    first.
    """
    ended, cost = _descended(view, exact, psi, sign, GLANCE)
    lost = regaining and cost > ENOUGH * exact.rows
    here, turned = ended[None], sign[None]
    if (lost and measured_branches_regained(view, exact, here, turned)) or (
        lost and cost > most and lost_dwells_regained(view, exact, here)
    ):
        ended, cost = _descended(view, exact, ended, sign, GLANCE)
    return _descended(view, exact, ended, sign, LIMIT - GLANCE) if cost < most else (ended, cost)


def called_for(data: Prepared, psi: Real, sign: Real, *, thorough: bool = True) -> list[ScoredElement]:
    """Nonlinear elements that the dwells call for, fitted in full, the best first; [] where none is certain.

    ψ (M,): the best fit of the rig as it is.  Where all motion is seen, those that the equation of motion does not
    show are looked for only if `thorough`: to reach them from a rig that does not fit takes seconds.
    """
    chi2 = misfit(data, psi, sign)
    seen = _passive(seen_candidates(data, psi))
    mending = [each for each in seen if _mends(each)]
    fitted = _passive([fitted_in_full(data, psi, sign, each, chi2, 0.0) for each in mending[:FULLY]])
    if any(_certain(each) for each in fitted) or (seen and not thorough):
        return _nearly_best(fitted)
    for softness, start, followed in (
        (0.0, psi, FOLLOWED),
        (SOFT, softened(data, psi, sign), SOFTLY),
    ):
        candidates = candidate_elements(data.model, motions_of(data, start))
        scored = _passive(scored_in_dwells(data, start, sign, candidates, softness))
        for candidate in scored[:followed]:
            if candidate.fall > HINT * candidate.chi2:
                fitted += _passive([fitted_in_full(data, start, sign, candidate, chi2, softness)])
            if fitted and fitted[-1].chi2 - fitted[-1].fall < ENOUGH * fitted[-1].dof:
                return [fitted[-1]] if fitted[-1].p_value < CERTAIN else []
    return _nearly_best(fitted)


def _passive(scored: Sequence[ScoredElement]) -> list[ScoredElement]:
    """Those that do not drive the rig."""
    return [each for each in scored if not feeds_motion(each.element, each.value)]


def _nearly_best(fitted: Sequence[ScoredElement]) -> list[ScoredElement]:
    """The certain ones that leave hardly more than the best of them, or than noise; the best first."""
    certain = sorted(filter(_certain, fitted), key=lambda each: -each.fall)
    most = max((NEARLY * (certain[0].chi2 - certain[0].fall), ENOUGH * certain[0].dof)) if certain else 0.0
    return [each for each in certain if each.chi2 - each.fall <= most]


def _certain(fitted: ScoredElement) -> bool:
    """Whether an element that was fitted in full is called for beyond doubt."""
    return fitted.p_value < CERTAIN and fitted.fall > MARKED * fitted.chi2


def _mends(scored: ScoredElement) -> bool:
    """Whether the equation of motion holds with a candidate: what is left is little, or nearly noise.

    Where something else is wrong, a fit in full takes long and comes to nothing.
    """
    left, beyond_noise = scored.chi2 - scored.fall, max(scored.chi2 - scored.dof, 0.0)
    promising = scored.fall > HINT * beyond_noise and scored.p_value < CERTAIN
    return promising and (left < LEFT * scored.chi2 or left < ROUGHLY * scored.dof)


def seen_candidates(data: Prepared, psi: Real, further: bool = False) -> list[ScoredElement]:
    """Candidates by the equation of motion at ψ (M,), the best first; [] where not all motion is seen."""
    elements = candidate_elements(data.model, measured_motions(data), further)
    return scored_by_equation(data, psi, _told_apart(data, elements))


def misfit(data: Prepared, psi: Real, sign: Real) -> float:
    """χ² of the rig as it is at ψ (M,)."""
    with np.errstate(all="ignore"):
        at = local(data.view, measured(replace(data, states=None)), psi[None], sign[None])
    return float(at.cost[0])


def _without_raising(data: Measured) -> Measured:
    """The same data, in which a dwell that a candidate keeps from settling counts as lost: it is not what is wrong."""
    assert data.nonlinear is not None
    return replace(data, nonlinear=replace(data.nonlinear, patient=False, raised=False))


def fitted_in_full(
    data: Prepared, psi: Real, sign: Real, candidate: ScoredElement, chi2: float, softness: float
) -> ScoredElement:
    """The candidate's value and how far χ² falls from `chi2` with all unknowns at their best, from ψ (M,)."""
    assert candidate.element.force_law is not None
    element = with_open_constants(candidate.element)
    extended = replace(data.model, elements=(*data.model.elements, element))
    seen = candidate.psi is not None  # the motion is then followed from the measured one
    larger = data.of_rig(extended) if seen else replace(data.of_rig(extended), states=None)
    view, exact = larger.view, _without_raising(measured(larger))
    best, least = _with_elements(extended, {element.name: 0.0}, psi), np.inf
    for value in (candidate.value, 0.3 * candidate.value)[: 1 if seen else 2]:
        start = _with_elements(
            extended, {element.name: value}, psi if candidate.psi is None else candidate.psi
        )
        if softness > 0:
            soft = _without_raising(measured(larger, softness))
            start, left = _followed(view, soft, start, sign, candidate.chi2)
            if left > (1 - FALLEN) * candidate.chi2:
                continue  # what does not help there leads nowhere in sharper data
        ended, cost = _followed(view, exact, start, sign, chi2, regaining=True)
        if cost < least:
            best, least = ended, cost
        if least < chi2:  # a smaller value leads to the same end
            break
    names = [unknown.name for unknown in extended.unknowns]
    values = dict(zip(names, best[: len(names)].tolist(), strict=True))
    law = candidate.element.force_law
    constants = [replace(c, value=values[f"{element.name}.{c.name}"]) for c in law.constants]
    fitted_element = replace(candidate.element, force_law=law.with_constants(constants))
    fall = max(chi2 - least, 0.0)
    return replace(candidate, element=fitted_element, fall=fall, chi2=chi2, value=values[element.name])
