"""Suppositions that an element is nonlinear: candidates between any two points, by score and then by a fit in full.

A candidate with the parameter 0 changes nothing; the slope of the harmonic balance along it says what it would do to
every harmonic, at every amplitude.  Projected on what the rig's own unknowns can do, that gives the score of each, and
those that promise most are fitted (Rao's score test; for whole records the score alone, THEORY §9).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.check.explain.effect import Baseline, Effect, Phrase, as_is
from dashpot.check.explain.problem import FittedProblem, LineProblem, descended, replaced, without_raising
from dashpot.check.explain.rigs import missing_in_words, points_of, unused
from dashpot.check.explain.score import APART, score_tests, steadiness
from dashpot.data.noise import smoothed
from dashpot.data.spectrum import LinesInTime, Spectrum, WholeRecord
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.inference.time_course import UNEVEN
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import RecordFit, measured, predict, record_fit
from dashpot.estimate.linear.gram import equation_covariance, known_side
from dashpot.estimate.linear.least_squares import equation
from dashpot.estimate.nonlinear.objective import dwells_of
from dashpot.estimate.nonlinear.regression import MeasuredMotion, measured_motion, regressors_of
from dashpot.estimate.nonlinear.search import lost_dwells_regained, measured_branches_regained
from dashpot.estimate.preparation import Prepared, States, prepare
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.model.observation import (
    ObservationModel,
    Transfer,
    calibrated_transfer,
    calibration_factors,
    observation_model,
)
from dashpot.model.rigfile import element_line, element_section
from dashpot.numerics.small_systems import orthonormal, real_rows

# Nonlinear elements that a rig might have: laws between points that move, and what is said for each.


class TriedLaw(NamedTuple):
    """A law that is tried: its name and what it is called in rig files, what is said of it, and of its constant, if it
    has one, the name and which share of the motion it is."""

    kind: Kind
    name: str
    usual: str
    character: str
    constant: str = ""
    share: float = 0.0


LAWS = (
    TriedLaw(Kind.SPRING, "cubic", "k3", "odd"),
    TriedLaw(Kind.SPRING, "square", "k2", "even"),
    TriedLaw(Kind.SPRING, "quadratic", "kq", "odd"),
    TriedLaw(Kind.SPRING, "quintic", "k5", "odd"),
    TriedLaw(Kind.SPRING, "gap", "kgap", "with a clearance", "gap", 0.5),
    TriedLaw(Kind.SPRING, "one-sided", "kstop", "with a clearance on one side", "gap", 0.3),
    TriedLaw(Kind.SPRING, "jenkins", "kslip", "friction behind a spring", "slip", 0.3),
    TriedLaw(Kind.DAMPER, "quadratic", "cq", "damping that grows with speed"),
    TriedLaw(Kind.DAMPER, "cubic", "c3", "damping that grows with speed"),
    TriedLaw(Kind.DAMPER, "coulomb", "fc", "friction", "v0", 0.1),
)
# Tried where elements are compared
FURTHER = (TriedLaw(Kind.SPRING, "d**4", "k4", "quartic"), TriedLaw(Kind.DAMPER, "d**2*v", "c3", "growing"))
ONE_SIDED = "one-sided"  # a law that may act either way
FEW = 4  # coordinates up to which any two points are tried, and not only those that an element joins
# Times the usual size of a constant inside a law: others that are tried.
SCALES = tuple(float(4.0 ** (k / 2.5)) for k in (0, -1, 1, -2, 2, -3, -4, -5))


@dataclass(frozen=True)
class ScoredElement:
    """A candidate: how far χ² falls with it, from `chi2` with `dof` degrees of freedom, and the value it would have.

    psi (M,): the rig's own unknowns with it, where they are known better than by the fit without it.
    fit: of the rig with it, where it was fitted in full.
    in_place: whether it stands in the place of the rig's own nonlinear elements.
    """

    element: Element
    fall: float
    chi2: float
    dof: int
    value: float
    psi: Real | None = None
    fit: FittedProblem | None = None
    in_place: bool = False

    @property
    def left(self) -> float:
        """χ² with it."""
        return self.chi2 - self.fall

    @property
    def share(self) -> float:
        """Of χ², that it explains."""
        return self.fall / self.chi2

    @property
    def p_value(self) -> float:
        """Probability of such a fall by noise alone, what is left being noise."""
        left = max(self.left, 1e-300) / max(self.dof - 1, 1)
        return float(fdtrc(1.0, float(max(self.dof - 1, 1)), self.fall / max(left, 1.0)))

    @property
    def misfit(self) -> float:
        """χ² without it beyond what noise leaves."""
        return max(self.chi2 - self.dof, 0.0)

    def effect(self, model: Model) -> Effect:
        """As the rig `model` would have it, of the size that its fit or its score gives it."""
        of, law, size = points_of(self.element, model), self.element.force_law, (self.value,)
        if law is None:
            words = partial(missing_in_words, model, self.element)
            return Effect("element", of, as_is, words, size, found=self.fit, more=1)
        words = partial(law_in_words, model, self.element)
        words = partial(_in_place_of_laws, model, words) if self.in_place else words
        share, more = 1 / (len(LAWS) * max(len(moving_pairs(model)), 1)), 1 + len(law.constants)
        return Effect("nonlinear", of, as_is, words, size, found=self.fit, more=more, share=share)


Said = TypeVar("Said", Phrase, Finding)

# The largest elongation (m) and rate (m/s) between two points.
Motions = Mapping[tuple[str, str], tuple[float, float]]


def moving_pairs(model: Model) -> list[tuple[str, str]]:
    """Any two points that move against each other; in large rigs only those that an element joins."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    joined = {frozenset(element.along) for element in model.elements}
    return [
        (first, second)
        for first, second in combinations(points, 2)
        if (first in model.coordinates or not model.n)
        and (model.n <= FEW or frozenset({first, second} - {"ground"}) in joined)
    ]


@cache
def _law(tried: TriedLaw) -> ForceLaw:
    """A law, read once: that takes longer than all that is done with it."""
    constants = [Constant(tried.constant, 1.0)] if tried.constant else []
    return force_law(tried.name, constants, damper=tried.kind is Kind.DAMPER)


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
        for tried in (*LAWS, *(FURTHER if further else ())):
            value = tried.share * (speed if tried.constant == "v0" else size)
            law = _law(tried).with_constants([Constant(tried.constant, value)])
            for points in ((first, second), (second, first))[: 2 if tried.name == ONE_SIDED else 1]:
                word = tried.name if tried in LAWS else tried.character
                plain = between("_".join([word, tried.kind.value, *points]), tried.kind, *points)
                if (law.expression.text, frozenset(plain.along)) not in there:
                    candidates.append(replace(plain, force_law=law))
    return candidates


def with_open_constants(element: Element) -> Element:
    """The element with its inner constants unknown, what they were as guesses."""
    assert element.force_law is not None
    constants = [
        replace(c, value=None, guess=float(f"{c.value:.3g}"))
        for c in element.force_law.constants
        if c.value is not None
    ]
    return replace(element, force_law=element.force_law.with_constants(constants))


def at_each_scale(elements: Sequence[Element]) -> list[Element]:
    """The elements, those with a constant inside their law at several values of it."""
    scaled = []
    for element in elements:
        law = element.force_law
        assert law is not None
        for scale in SCALES if law.constants else (1.0,):
            constants = [replace(c, value=scale * c.value) for c in law.constants if c.value is not None]
            scaled.append(replace(element, force_law=law.with_constants(constants)))
    return scaled


def feeds_motion(element: Element, value: float) -> bool:
    """Whether it would drive the rig: friction or damping below zero, or a spring that slips backwards.

    There is none; what it explains, another law does: friction below zero stands for damping that grows with speed,
    damping below zero that grows for friction.
    """
    law = element.force_law
    return law is not None and value < 0 and (element.kind is Kind.DAMPER or bool(law.operator))


# Nonlinear elements where all motion was measured, by the equation of motion: nothing is balanced or
# searched.
#
# A candidate's force in the measured motion is one more column of a regression, weighed by what noise of
# the motion leaves in the equation. A rig that is far off, dwells next to a fold and lost branches do not
# matter here, as they do where a candidate is scored against the fit of a rig without it (THEORY §9).


SOFT = 0.01  # of each amplitude: what harmonics that were not measured leave out of a force
NEAR = 1e-4  # relative step of differences along constants inside the rig's own laws
FAR = 2.0  # times such a constant, or one over it: as far as one round moves it


def scored_by_equation(problem: LineProblem, elements: Sequence[Element]) -> list[ScoredElement]:
    """The best candidate of each place and law, with all values of the rig, the best first.

    Of settled dwells of a rig without unknown calibrations; the constants inside its own laws are moved from where the
    problem begins, its best fit.  [] where some motion is not seen.
    """
    data, psi = problem.data, problem.starts[0]
    model, states = data.model, data.states
    if states is None or len(psi) > len(model.unknowns) or not elements:
        return []
    every = [replace(e, name=f"{e.name} {k}") for k, e in enumerate(at_each_scale(elements))]
    extended = replaced(model, *every)
    try:
        motion = measured_motion(data.of_rig(extended))
        own = measured_motion(data) if len(model.nonlinear) else None
    except DashpotError:
        return []
    count = len(model.elements)
    added = motion.unit_forces(extended.constants_map[1])[..., count:]
    columns = added[0, :, None, :] * extended.B[count:].T
    soft = (SOFT * np.abs(states.z)) ** 2  # the noise that unmeasured harmonics amount to
    states = replace(states, covariance=states.covariance + soft[..., None] * np.eye(soft.shape[-1]))
    scored = _Regression(data, states, own, columns).scored(psi, every)
    best: dict[str, ScoredElement] = {}
    for candidate in sorted(scored, key=lambda each: -each.fall):
        name = candidate.element.name.rsplit(" ", 1)[0]
        best.setdefault(name, replace(candidate, element=replace(candidate.element, name=name)))
    return list(best.values())


@dataclass(frozen=True)
class _Regression:
    """The equation of motion at all lines; columns (lines, n, candidates): unit forces on the coordinates.

    own: the measured motion, where the rig has laws of its own.
    """

    data: Prepared
    states: States
    own: MeasuredMotion | None
    columns: Complex

    def scored(self, psi: Real, elements: Sequence[Element]) -> list[ScoredElement]:
        """All candidates, weighed with the values that the best one asks for."""
        scored: list[ScoredElement] = []
        for _ in range(3):  # rounds of weights, which depend on the values
            scored = self._weighed_at(psi, elements)
            if not scored:
                return []
            best = max(scored, key=lambda each: each.fall)
            assert best.psi is not None
            psi = best.psi
        return scored

    def _weighed_at(self, psi: Real, elements: Sequence[Element]) -> list[ScoredElement]:
        """With weights of the values ψ (M,)."""
        model = self.data.model
        Phi, h = self._of_the_rig(psi)
        Se = equation_covariance(model, model.parameters(psi[None]), self.states)
        every = np.concatenate([Phi[0], h[0, ..., None], self.columns], axis=-1)
        try:
            white = np.linalg.solve(np.linalg.cholesky(Se[0]), every)
        except np.linalg.LinAlgError:
            return []
        rows = real_rows(white[None])[0]
        m = Phi.shape[-1]
        own, side, columns = rows[:, :m], rows[:, m], rows[:, m + 1 :]
        Q, back, _ = (part[0] for part in orthonormal(own[None]))
        residual, left = side - Q @ (Q.T @ side), columns - Q @ (Q.T @ columns)
        squares = np.sum(left**2, axis=0)
        apart = squares > APART**2 * np.sum(columns**2, axis=0)
        value = np.where(apart, left.T @ residual / np.where(apart, squares, 1.0), 0.0)
        theta = _within_reach(model, psi, back @ (Q.T @ (side[:, None] - value * columns)))
        chi2, dof = 2 * float(residual @ residual), max(len(side) - m - 1, 1)
        return [
            ScoredElement(element, 2 * float(p**2 * size), chi2, dof, float(p), values)
            for element, p, size, values, usable in zip(elements, value, squares, theta.T, apart, strict=True)
            if usable
        ]

    def _of_the_rig(self, psi: Real) -> tuple[Complex, Complex]:
        """Φ and h of the rig as it is, e = Φ θ − h, linear in the constants inside its laws about ψ (M,)."""
        model = self.data.model
        if self.own is None:
            return equation(model, self.states)
        constants, p = model.inner_constants(psi), model.parameters(psi)
        a = self.own.unit_forces(constants)
        Phi, h = regressors_of(model, a), known_side(model, a, self.own.f)
        along = model.constants_map[0]
        for column in np.flatnonzero(np.any(along, axis=0)):
            step = NEAR * max(abs(psi[column]), np.finfo(float).tiny)
            moved = self.own.unit_forces(constants + step * along[:, column])
            slope = ((moved - a) / step * p) @ model.B
            Phi[..., column] += slope
            h = h + slope * psi[column]
        return Phi, h


def _within_reach(model: Model, psi: Real, theta: Real) -> Real:
    """θ (unknowns, candidates) with constants inside laws no further from ψ (unknowns,) than slopes can tell."""
    inner = np.any(model.constants_map[0], axis=0)
    near = np.abs(psi[:, None])
    return np.where(inner[:, None], np.clip(theta, near / FAR, near * FAR), theta)


CERTAIN = 1e-6  # p-value below which a nonlinear element is called for
MARKED = 0.3  # share of the misfit that it must explain
TOGETHER = 12  # candidates that are scored at once
FOLLOWED, SOFTLY = 2, 4  # candidates that are fitted in full, the second number from the softened data
NEARLY_NONLINEAR_ELEMENTS = 4.0  # times the χ² that the best leaves: others that leave no more are named, too
ENOUGH = 2.0  # χ² over its degrees of freedom that leaves nothing to explain
GLANCE, LIMIT = 5, 15  # iterations of such a fit: before it must have begun to help, and in all
HINT = 0.4  # share of the misfit that a candidate must promise to be followed
LEFT = 0.1  # share of the misfit in the equation of motion that a candidate may leave
ROUGHLY = 7.0  # or χ² of a degree of freedom that it may leave there
FALLEN = 0.1  # share by which the softened misfit must have fallen for a fit to go on
SOFT_NONLINEAR_ELEMENTS = 0.05  # relative noise of the softened data


def scored_in_dwells(
    problem: LineProblem, elements: Sequence[Element], softness: float
) -> list[ScoredElement]:
    """The candidates by their score where the problem begins, its best fit with that softness, the best first.

    Of settled dwells.  Softened, all amplitudes have a say: with little noise those near resonance, where a wrong
    rig fails most, would decide alone.  [] where none can be had.
    """
    dof = max(problem.dof - 1, 1)
    elements = _told_apart(problem.data, elements)
    scored: list[ScoredElement] = []
    for rough in (False, True):  # laws that are not smooth take many instants of each period
        alike = [e for e in elements if e.force_law is not None and e.force_law.smooth is not rough]
        for first in range(0, len(alike), TOGETHER):
            by_name = {element.name: element for element in alike[first : first + TOGETHER]}
            with suppress(DashpotError):
                larger = problem.balanced().of_rig(replaced(problem.model, *by_name.values()))
                at = larger.slopes(larger.starts[0], softness)
                tests = score_tests(larger.names, [name in by_name for name in larger.names], *at)
                scored += [
                    ScoredElement(by_name[p.name], min(p.fall, p.chi2), p.chi2, dof, p.step) for p in tests
                ]
    return sorted(scored, key=lambda candidate: -candidate.fall)


def _told_apart(data: Prepared, elements: Sequence[Element]) -> Sequence[Element]:
    """Without stops on one side where no even harmonic, which tells them from those on both, is measured.

    Without it a stop on one side does what stops on both do by half.
    """
    if np.any(dwells_of(data.model, data.spectrum).order % 2 == 0):
        return elements
    return [e for e in elements if e.force_law is not None and e.force_law.text != ONE_SIDED]


def motions_of(problem: LineProblem) -> Motions:
    """How far any two points move against each other where the problem begins; {} where the inputs are not seen."""
    model, both = problem.model, moving_pairs(problem.model)
    probes = [
        replace(between(f"probe_{a}_{b}", Kind.SPRING, a, b, value=0.0), force_law=force_law("cubic"))
        for a, b in both
    ]
    larger = replaced(model, *probes)
    try:
        part = problem.balanced().of_rig(larger).arranged().nonlinear
    except DashpotError:
        return {}
    assert part is not None
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    theta = problem.starts[0][: len(model.unknowns)]
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
    larger = replaced(model, *probes)
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


def softened(problem: LineProblem) -> LineProblem:
    """The problem begun where softened data lead from its start."""
    exact = problem.balanced().arranged(SOFT_NONLINEAR_ELEMENTS)
    end, _ = _descended(problem.view, exact, problem.starts[0], problem.sign, 2 * LIMIT)
    return problem.from_starts((end,))


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
    here, turned = ended[None], sign[None]
    if (
        regaining
        and cost > ENOUGH * exact.rows
        and (
            measured_branches_regained(view, exact, here, turned)
            or (cost > most and lost_dwells_regained(view, exact, here))
        )
    ):
        ended, cost = _descended(view, exact, ended, sign, GLANCE)
    return _descended(view, exact, ended, sign, LIMIT - GLANCE) if cost < most else (ended, cost)


def called_for(problem: LineProblem, *, thorough: bool = True) -> list[ScoredElement]:
    """Nonlinear elements that the dwells call for, fitted in full, the best first; [] where none is certain.

    The problem begins at the best fit of the rig as it is.  Where all motion is seen, those that the equation of motion
    does not show are looked for only if `thorough`: to reach them from a rig that does not fit takes seconds.  [] as
    well where the rig differs by experiment, which harmonic balance does not know.
    """
    if problem.model.differs:
        return []
    chi2 = problem.balanced().slopes(problem.starts[0])[2]
    seen = _passive(seen_candidates(problem))
    mending = [each for each in seen if _mends(each)]
    # candidates that are fitted in full where all motion is seen
    fitted = _passive([fitted_in_full(problem, each, chi2, 0.0) for each in mending[:4]])
    if any(_certain(each) for each in fitted) or (seen and not thorough):
        return _nearly_best(fitted)
    for softness, followed in ((0.0, FOLLOWED), (SOFT_NONLINEAR_ELEMENTS, SOFTLY)):
        begun = softened(problem) if softness else problem
        scored = scored_in_dwells(begun, candidate_elements(problem.model, motions_of(begun)), softness)
        for candidate in _passive(scored)[:followed]:
            if candidate.fall > HINT * candidate.misfit:
                fitted += _passive([fitted_in_full(begun, candidate, chi2, softness)])
            if fitted and fitted[-1].left < ENOUGH * fitted[-1].dof:
                return [fitted[-1]] if fitted[-1].p_value < CERTAIN else []
    return _nearly_best(fitted)


def _passive(scored: Sequence[ScoredElement]) -> list[ScoredElement]:
    """Those that do not drive the rig."""
    return [each for each in scored if not feeds_motion(each.element, each.value)]


def _nearly_best(fitted: Sequence[ScoredElement]) -> list[ScoredElement]:
    """The certain ones that leave hardly more than the best of them, or than noise; the best first."""
    certain = sorted(filter(_certain, fitted), key=lambda each: -each.fall)
    most = max((max(NEARLY_NONLINEAR_ELEMENTS * e.left, ENOUGH * e.dof) for e in certain[:1]), default=0.0)
    return [each for each in certain if each.left <= most]


def _certain(fitted: ScoredElement) -> bool:
    """Whether an element that was fitted in full is called for beyond doubt."""
    return fitted.p_value < CERTAIN and fitted.fall > MARKED * fitted.misfit


def _mends(scored: ScoredElement) -> bool:
    """Whether the equation of motion holds with a candidate: what is left is little, or nearly noise.

    Where something else is wrong, a fit in full takes long and comes to nothing.
    """
    promising = scored.fall > HINT * scored.misfit and scored.p_value < CERTAIN
    return promising and (scored.left < LEFT * scored.chi2 or scored.left < ROUGHLY * scored.dof)


def seen_candidates(problem: LineProblem, further: bool = False) -> list[ScoredElement]:
    """Candidates by the equation of motion from where the problem begins, the best first; [] where not all is seen."""
    elements = candidate_elements(problem.model, measured_motions(problem.data), further)
    return scored_by_equation(problem, _told_apart(problem.data, elements))


def fitted_in_full(
    problem: LineProblem, candidate: ScoredElement, chi2: float, softness: float
) -> ScoredElement:
    """The candidate's value and how far χ² falls from `chi2` with all unknowns at their best, from the start."""
    assert candidate.element.force_law is not None
    element = with_open_constants(candidate.element)
    extended = replaced(problem.model, element)
    seen = candidate.psi is not None  # the motion is then followed from the measured one
    own = problem.starts[0] if candidate.psi is None else candidate.psi
    larger = (problem if seen else problem.balanced()).from_starts((problem.starts[0], own)).of_rig(extended)
    view, sign, exact = larger.view, larger.sign, without_raising(larger.arranged())
    best, least = larger.starts[0], np.inf
    for value in (candidate.value, 0.3 * candidate.value)[: 1 if seen else 2]:
        start = np.where(np.array(larger.names) == element.name, value, larger.starts[1])
        if softness > 0:
            soft = without_raising(larger.arranged(softness))
            start, left = _followed(view, soft, start, sign, candidate.chi2)
            if left > (1 - FALLEN) * candidate.chi2:
                continue  # what does not help there leads nowhere in sharper data
        ended, cost = _followed(view, exact, start, sign, chi2, regaining=True)
        if cost < least:
            best, least = ended, cost
        if least < chi2:  # a smaller value leads to the same end
            break
    values = dict(zip(larger.names, best.tolist(), strict=True))
    law = candidate.element.force_law
    constants = [replace(c, value=values[f"{element.name}.{c.name}"]) for c in law.constants]
    fitted_element = replace(candidate.element, force_law=law.with_constants(constants))
    fall = max(chi2 - least, 0.0)
    fit = FittedProblem(larger.from_starts((best,)), best, chi2 - fall, larger.dof)
    return replace(
        candidate, element=fitted_element, fall=fall, chi2=chi2, dof=max(larger.dof, 1), value=values[element.name],
        fit=fit if np.isfinite(least) else None,
    )  # fmt: skip


def _tried_as(element: Element) -> TriedLaw:
    """The row of a candidate's law."""
    assert element.force_law is not None
    like = element.kind, element.force_law.text
    return next(law for law in (*LAWS, *FURTHER) if (law.kind, law.name) == like)


def law_in_words(model: Model, element: Element, value: float) -> Phrase:
    """A nonlinear element that the data call for, in words; the p-value is below that of CERTAIN."""
    points, law = points_of(element, model), _tried_as(element)
    character = law.character
    if law.kind is Kind.SPRING and law.name not in ("square", "jenkins"):
        character += ", stiffening" if value > 0 else ", softening"
    text = f"the data call for a nonlinear element between {' and '.join(points)}, {character} (p < 1e-6)"
    named = replace(with_open_constants(element), name=free_name(model, element), guess=float(f"{value:.4g}"))
    change = f"{element_section(named)} {element_line(named)}"
    return Phrase(text, change, (), (named,))


def nonlinear(baseline: Baseline, *, thorough: bool) -> Iterator[Effect]:
    """Nonlinear elements that the dwells call for, each as it was fitted in full."""
    problem, psi = baseline.lines, baseline.as_is.psi
    if not np.all(np.isfinite(psi)):
        return
    for scored in called_for(problem.from_starts((psi,)), thorough=thorough):
        if scored.fit is not None:
            yield scored.effect(problem.model)


def laws_in_words(model: Model) -> str:
    """The rig's nonlinear elements, in whose place something else may stand."""
    return joined(model.elements[int(index)].name for index in model.nonlinear)


def in_place_of_laws(model: Model, said: Said) -> Said:
    """What is said of a cause that was found with the rig's nonlinear elements left out: it stands in their place."""
    return replace(said, text=f"{said.text}, in place of {laws_in_words(model)}")


def _in_place_of_laws(model: Model, words: Callable[[float], Phrase], size: float) -> Phrase:
    return in_place_of_laws(model, words(size))


def free_name(model: Model, element: Element) -> str:
    """A name that the rig has not: what the law is usually called."""
    word = _tried_as(element).usual
    return unused(model, word, *(f"{word}_{'_'.join(element.along)}{suffix}" for suffix in ("", "_2", "_3")))


# Nonlinear elements that whole records call for in addition to a linear rig, by the score of each alone (THEORY
# §9).
#
# Under the motion of the record a candidate pushes with a force that is known in time; its lines, carried
# to the channels by the linear rig, are one column, the inputs and the ends of the records taken out. What
# a linear spring or damper at the same place does as well counts for nothing: a missing linear element must
# not pass for a nonlinear one.


MOST_AMPLITUDES = 100_000  # complex numbers of all channels
STEADY = 1e-3  # p-value below which all parts of the records agree that there is one
OVERSAMPLED = 2  # times the samples of a record: kinks of a law reach beyond its lines
LEAST = 0.02  # of what is left over, that a candidate must explain: mistakes of other kinds leave it less by chance
NEARLY = 0.5  # of what the best explains: others that explain as much are named, too
MOST = 3  # candidates that are named
HANDICAP = 0.85  # of what a law explains by such a choice, compared with laws without one
QUIET = 0.05  # share of the lines that have nothing but noise at the least
STILL = 1e-9  # of the largest elongation: points that move no further do not move


def called_for_in_records(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[ScoredElement]:
    """Candidates that the whole records put beyond doubt, the best first; [] where there is none.

    spectrum: without batch axes, with the noise that the estimate of a linear rig rests on.
    """
    whole = bool(spectrum.records) and len(spectrum.records) == len(spectrum.stretches)
    if not whole or spectrum.amplitudes.size > MOST_AMPLITUDES or not np.all(np.isfinite(estimate.values)):
        return []
    try:
        data = prepare(model, spectrum, states=False)
        exact = measured(data)
    except DashpotError:
        return []
    if exact.ends is None:
        return []
    psi, sign = estimate.values[None], spectrum.signs(estimate.signs)
    with np.errstate(all="ignore"):
        fit = record_fit(data.view, exact, psi, sign)
        slopes = predict(data.view, exact, psi, sign).J
    if not np.all(np.isfinite(slopes)):
        return []

    def rows(columns: Complex) -> Real:
        """Columns (lines, channels, k) with unit noise, inputs and ends taken out, (rows, k)."""
        return real_rows(fit.root @ fit.left_of(columns[None]))[0]

    places = _places(data.view, spectrum, fit, exact, psi, sign)
    times, rate = _in_time(spectrum), 1j * spectrum.omega
    linear = [
        place.effect * (factor * place.motion)[:, None] for place in places.values() for factor in (1.0, rate)
    ]
    own = real_rows(fit.root @ slopes)
    beside = np.concatenate([own[0], rows(np.stack(linear, axis=-1))], axis=-1)
    test = _Test(
        times, orthonormal(own)[0][0], orthonormal(beside[None])[0][0], real_rows(fit.root @ fit.r[..., None])[0, :, 0],
        max(exact.rows - int(fit.of_ends.rank[0]) - beside.shape[-1] - 1, 1),
        any(notice.code == UNEVEN for notice in estimate.warnings),
    )  # fmt: skip
    scored = []
    motions = {pair: (place.size, float(np.max(np.abs(place.rate)))) for pair, place in places.items()}
    for element in at_each_scale(candidate_elements(model, motions)):
        place = next(place for place in places.values() if set(place.along) == set(element.along))
        column = rows((place.effect * _amplitudes(times, place.force(element))[:, None])[..., None])[:, 0]
        candidate = test.of(element, column)
        if candidate is not None and candidate.share > LEAST:
            moved = np.linalg.lstsq(own[0], column, rcond=None)[0]
            scored.append(replace(candidate, psi=psi[0] - candidate.value * moved))
    return _named(_passive(scored))


def _in_time(spectrum: Spectrum) -> list[LinesInTime]:
    """The lines of each whole record, finer than its samples."""
    records = ((spectrum.in_time(number), spectrum.stretches[number]) for number in spectrum.records)
    return [
        replace(at, samples=int(next_fast_len(OVERSAMPLED * record.samples, real=True)))
        for at, record in records
        if isinstance(record, WholeRecord)
    ]


def _history(records: Sequence[LinesInTime], amplitudes: Complex) -> Real:
    """Motion in time of amplitudes (lines, ...), one record after the other, (samples of all, ...)."""
    return np.concatenate([at.history(amplitudes) for at in records])


def _amplitudes(records: Sequence[LinesInTime], history: Real) -> Complex:
    """Lines (lines,) of a history (samples of all,)."""
    out = np.zeros(sum(len(at.lines) for at in records), dtype=np.complex128)
    for at, piece in zip(
        records, np.split(history, np.cumsum([at.samples for at in records])[:-1]), strict=True
    ):
        out[at.lines] = at.amplitudes(piece)
    return out


@dataclass(frozen=True)
class _Place:
    """Two points between which an element may be: how they move, and what a unit force between them does.

    along: the points with their signs; motion (lines,); effect (lines, channels); elongation, rate (samples of all,), m
    and m/s
    """

    along: Mapping[str, float]
    motion: Complex
    effect: Complex
    elongation: Real
    rate: Real

    @property
    def size(self) -> float:
        """The largest elongation, m."""
        return float(np.max(np.abs(self.elongation)))

    def force(self, element: Element) -> Real:
        """Unit force of an element here, (samples of all,), along the place, whichever way round the element is."""
        law = element.force_law
        assert law is not None
        constants = np.array([constant.value for constant in law.constants], dtype=float)
        way = next(element.along[point] * factor for point, factor in self.along.items())
        d, v = way * self.elongation, way * self.rate
        z = operated_states(law, d, constants) if law.operator else d
        return way * np.broadcast_to(law(d, v, z, constants).value, v.shape)


def _places(
    view: ObservationModel, spectrum: Spectrum, fit: RecordFit, exact: Measured, psi: Real, sign: Real
) -> dict[tuple[str, str], _Place]:
    """The places by their points, of those that move.

    The motion is that of the linear rig, and what the residuals of the channels add to it beyond noise (Wiener).
    """
    model, pairs = view.model, moving_pairs(view.model)
    probes = [between(f"place {a} {b}", Kind.SPRING, a, b, value=0.0) for a, b in pairs]
    larger = replaced(model, *probes)
    rig = calibrated_transfer(
        observation_model(larger, view.channels, view.omega, view.experiment), psi, sign
    )
    assert isinstance(rig, Transfer)
    assert isinstance(fit.rig, Transfer)
    effect = rig.E[0][..., len(model.elements) :]
    X = np.einsum("lnq,lq->ln", fit.rig.X[0], fit.motion[0])
    r = fit.r[0]
    # Share of the residuals that is no noise: white noise is as low as where they are quietest
    power = np.empty(r.shape)
    for number in spectrum.records:
        lines = np.flatnonzero(spectrum.stretch == number)
        power[lines] = smoothed(np.abs(r[lines]) ** 2)
    noise = np.quantile(power, QUIET, axis=0)
    share = np.maximum(1 - noise / np.maximum(power, np.finfo(float).tiny), 0.0)
    moving = np.any(view.on_x, axis=1) & ~np.any(view.force, axis=1)
    rates = (1j * view.omega[:, None]) ** view.derivative * calibration_factors(view, psi, sign)[0]
    X = X + (share * r / rates)[:, moving] @ np.linalg.pinv(view.on_x[moving]).T
    U = fit.motion[0, :, : model.D.shape[1]]
    motion = X @ larger.B[len(model.elements) :].T + U @ larger.D[len(model.elements) :].T
    times = _in_time(spectrum)
    elongation = _history(times, motion)
    rate = _history(times, 1j * view.omega[:, None] * motion)
    reach = np.max(np.abs(elongation), axis=0)
    return {
        pair: _Place(probes[j].along, motion[:, j], effect[..., j], elongation[:, j], rate[:, j])
        for j, pair in enumerate(pairs)
        if reach[j] > STILL * np.max(reach)
    }


def _named(scored: Sequence[ScoredElement]) -> list[ScoredElement]:
    """The best of each place and law, the best first, as far as they explain nearly as much as the best of all."""

    def explains(candidate: ScoredElement) -> float:
        law = candidate.element.force_law
        in_length = candidate.element.kind is Kind.SPRING and law is not None and law.constants
        return candidate.fall * (HANDICAP if in_length else 1.0)

    best: dict[str, ScoredElement] = {}
    for candidate in sorted(scored, key=explains, reverse=True):
        best.setdefault(candidate.element.name, candidate)
    named = list(best.values())
    return [candidate for candidate in named if explains(candidate) >= NEARLY * explains(named[0])][:MOST]


@dataclass(frozen=True)
class _Test:
    """What a candidate explains of the residual beyond others; orthonormal columns and sides with unit noise.

    own (rows, M): of the rig's own unknowns; beside (rows, M + 2 places): with the linear elements; residual (rows,);
    rows: real parts of lines by channels, then imaginary ones.  Of noise that is `uneven` in time no test holds but
    that of all parts of the records.
    """

    times: Sequence[LinesInTime]
    own: Real
    beside: Real
    residual: Real
    dof: int
    uneven: bool

    def of(self, element: Element, column: Real) -> ScoredElement | None:
        """The candidate with its column (rows,); None where it is in doubt."""
        nonlinear = _left(self.beside, column)
        if not np.linalg.norm(nonlinear) > APART * np.linalg.norm(column):
            return None
        beyond = _left(self.beside, self.residual)
        value = float(nonlinear @ beyond) / float(nonlinear @ nonlinear)
        # The cost is −2 ln L: twice the square of what has unit noise.
        chi2, fall = 2 * float(beyond @ beyond), 2 * value * float(nonlinear @ beyond)
        test = ScoredElement(element, fall, chi2, self.dof, value)
        if not (test.p_value < CERTAIN and self._steady(nonlinear, beyond, value)):
            return None
        alone = _left(self.own, column)
        value = float(alone @ self.residual) / float(alone @ alone)
        chi2 = 2 * float(self.residual @ self.residual)
        return ScoredElement(element, 2 * value * float(alone @ self.residual), chi2, self.dof, value)

    def _steady(self, column: Real, residual: Real, value: float) -> bool:
        """Whether the parameter is beyond doubt by its scatter over parts of the records in time."""
        lines = sum(len(at.lines) for at in self.times)
        both = (np.split(rows, 2) for rows in (column, residual))
        of_column, of_residual = (  # (samples of all, channels)
            _history(self.times, (real + 1j * imaginary).reshape(lines, -1)) for real, imaginary in both
        )
        _, p_value = steadiness(of_column, of_residual, value, uneven=self.uneven)
        return p_value < (CERTAIN if self.uneven else STEADY)


def _left(basis: Real, column: Real) -> Real:
    return column - basis @ (basis.T @ column)
