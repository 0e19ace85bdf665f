"""Mistakes of the rig: a missing element, a wrong value, a hidden body, modes outside the band."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from dashpot import units
from dashpot.arrays import Complex, Real
from dashpot.channel import Quantity
from dashpot.check.explain.channels import CLOSE, SHARE_WIDTH, rounded
from dashpot.check.explain.effect import Baseline, Effect, Phrase, plainly
from dashpot.check.explain.problem import FitProblem, LineProblem, replaced
from dashpot.check.explain.score import score_tests
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.rigfile import element_line, element_section

FOLLOWED = 8  # elements of a kind that are fitted in full, those whose score promises most
# Of a stated value, where fits begin: next to sharp resonances each ends at the nearest.
BEGUN = (1.0, 0.85, 1.18)
VALUE_WIDTH = 0.3  # nepers: a stated value that is wrong without another unit
ELEMENT_WIDTH = 1.0  # of the typical size of a kind in the rig
USUAL = {
    Kind.MASS: ("mass", ("g", "lb", "t")),
    Kind.SPRING: ("stiffness", ("N/mm", "lbf/in")),
    Kind.DAMPER: ("damping", ("N·s/mm", "lbf·s/in")),
}


def unused(model: Model, *names: str) -> str:
    """The first of some names that nothing of the rig has."""
    taken = {*model.coordinates, *(i.name for i in model.inputs), *(e.name for e in model.elements)}
    return next(name for name in names if name not in taken)


def points_of(element: Element, model: Model) -> tuple[str, ...]:
    """What a cause is about: an element of the rig by its name, a new one by the points that it joins."""
    if element.name in {existing.name for existing in model.elements}:
        return (element.name,)
    points = tuple(element.along)
    return points if len(points) > 1 else (*points, "ground")


def missing_elements(model: Model, kinds: Sequence[Kind] = (Kind.SPRING, Kind.DAMPER)) -> list[Element]:
    """An element of each kind between any two points, unless there is one, and a mass where there is none."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    there = {(e.kind, frozenset(e.along.items())) for e in model.elements if e.force_law is None}
    letters = {Kind.SPRING: "k", Kind.DAMPER: "c", Kind.HYSTERETIC: "h"}
    found = [
        between(f"{letters[kind]}_{first}_{second}", kind, first, second)
        for first, second in combinations(points, 2)
        if first in model.coordinates or not model.n  # else, between inputs and the ground, it moves nothing
        for kind in kinds
    ]
    found += [mass(f"m_{x}", x) for x in model.coordinates]
    turned = {(kind, frozenset((point, -factor) for point, factor in along)) for kind, along in there}
    return [e for e in found if (e.kind, frozenset(e.along.items())) not in there | turned]


def stated_values(model: Model) -> list[Element]:
    """The elements whose value is stated, each as if it were unknown."""
    return [
        replace(element, value=None, sd=None, guess=element.value)
        for element in model.elements
        if element.value and element.same_as is None and element.force_law is None
    ]


def scores(problem: FitProblem, psi: Real, elements: Sequence[Element]) -> dict[str, tuple[float, float]]:
    """By the name of each element: how far χ² would fall were its parameter free, and the step of it (Rao's score).

    Each by itself alongside the rig's own unknowns at ψ (M,), the best fit without it; elements of which less than
    a hundredth of the column is its own are left out.
    """
    if not elements:
        return {}
    larger = problem.from_starts((psi,)).of_rig(replaced(problem.model, *elements))
    added = {element.name for element in elements}
    names = larger.names
    tests = score_tests(names, [name in added for name in names], *larger.slopes(larger.starts[0]))
    return {test.name: (test.fall, test.step) for test in tests}


def element(baseline: Baseline) -> Iterator[Effect]:
    """A missing spring, damper or mass."""
    missing = missing_elements(baseline.problem.model)
    yield from _added(baseline, "element", [each for each in missing if baseline.problem.shows(each)])


def hysteretic(baseline: Baseline) -> Iterator[Effect]:
    """Hysteretic damping in parallel with a spring, or in the place of a damper of a stated value."""
    model = baseline.problem.model
    joined = {frozenset(each.along) for each in model.elements if each.kind is Kind.SPRING}
    missing = [each for each in missing_elements(model, (Kind.HYSTERETIC,)) if each.kind is Kind.HYSTERETIC]
    yield from _added(baseline, "hysteretic", [each for each in missing if frozenset(each.along) in joined])
    middle_hz = float(np.exp(np.mean(np.log(baseline.problem.frequency_hz))))
    dampers = (each for each in stated_values(model) if each.kind is Kind.DAMPER)
    pairs = [(damper, each) for damper in dampers for each in missing if each.along == damper.along]
    for viscous, candidate in pairs:
        assert viscous.guess is not None
        size = viscous.guess * 2 * np.pi * middle_hz  # dissipates as much there
        damper = replace(viscous, value=0.0, guess=None)
        yield Effect(
            "hysteretic", points_of(candidate, model), partial(_with, candidate, instead=(damper,)),
            partial(_rather_hysteretic, model, damper, candidate), (size,), ELEMENT_WIDTH * size,
            unknown=candidate.name, share=1 / len(missing),
        )  # fmt: skip


def _rather_hysteretic(model: Model, damper: Element, element: Element, value: float) -> Phrase:
    """damper: as it would be, of no damping."""
    size = f"{rounded(value, '.3g')} {element.unit(model.angles)}"
    text = f"the damping of {damper.name} is hysteretic ({size}), not viscous"
    lines = "; ".join(f"{element_section(each)} {element_line(each)}" for each in (damper, element))
    return Phrase(text, lines, (), (damper, element))


def _added(baseline: Baseline, kind: str, candidates: list[Element]) -> Iterator[Effect]:
    problem, model = baseline.problem, baseline.problem.model
    promised = scores(problem, baseline.as_is.psi, candidates)
    chosen = [each for each in candidates if each.name in promised]
    for candidate in sorted(chosen, key=lambda each: -promised[each.name][0])[:FOLLOWED]:
        width = ELEMENT_WIDTH * _typical(model, baseline.as_is.psi, candidate.kind)
        yield Effect(
            kind, points_of(candidate, model), partial(_with, candidate), partial(missing_in_words, model, candidate),
            (0.0, promised[candidate.name][1]), width, unknown=candidate.name, share=1 / len(candidates),
        )  # fmt: skip


def _typical(model: Model, psi: Real, kind: Kind) -> float:
    """The typical size of an element of a kind: the geometric mean of the rig's own; of springs where it has none."""
    p = np.abs(model.parameters(psi[: len(model.unknowns)]))
    like, springs = (
        [size for each, size in zip(model.elements, p, strict=True) if each.kind is alike and size > 0]
        for alike in (kind, Kind.SPRING)
    )
    return float(np.exp(np.mean(np.log(like or springs or [1.0]))))


def _with(
    element: Element, problem: FitProblem, start: float, instead: tuple[Element, ...] = ()
) -> FitProblem:
    """instead: what elements of the rig are then."""
    return problem.of_rig(replaced(problem.model, *instead, replace(element, guess=start)))


def missing_in_words(model: Model, element: Element, value: float) -> Phrase:
    """The sentence for a missing element, with the line for the rig file."""
    points = tuple(element.along)
    where = " and ".join(points) if len(points) > 1 else f"{points[0]} and the ground"
    at = f"at {points[0]}" if element.kind is Kind.MASS else f"between {where}"
    word = "hysteretic element" if element.kind is Kind.HYSTERETIC else element.kind.value
    text = f"a {word} {at} is missing: {rounded(value, '.3g')} {element.unit(model.angles)}"
    if element.kind is Kind.SPRING and value < 0 and len(points) > 1:
        text += " (negative: typical of bending of the parts in between)"
    return Phrase(text, f"{element_section(element)} {element_line(element)}", (), (element,))


def value(baseline: Baseline) -> Iterator[Effect]:
    """A stated value that is wrong, or given in another unit."""
    problem, model = baseline.problem, baseline.problem.model
    listed = stated_values(model)
    promised = scores(problem, baseline.as_is.psi, listed)
    listed.sort(key=lambda each: -promised.get(each.name, (0.0, 0.0))[0])
    share = 1 / max(len(listed), 1)
    for each in listed[:FOLLOWED]:
        assert each.guess is not None
        words = partial(other_value, model, each)
        yield Effect(
            "value", (each.name,), partial(_with, each), words, tuple(each.guess * part for part in BEGUN), VALUE_WIDTH,
            each.guess, True,
            unknown=each.name, share=share,
        )  # fmt: skip
        if each.kind in USUAL and not model.angles:
            quantity, usual = USUAL[each.kind]
            ratios = tuple(units.scale(unit, quantity, False) for unit in usual)
            act, words = partial(_in_unit, each), partial(_unit, model, each.name)
            yield Effect("value", (each.name,), act, words, ratios, share=share)


def _in_unit(element: Element, problem: FitProblem, ratio: float) -> FitProblem:
    assert element.guess is not None
    return problem.of_rig(replaced(problem.model, replace(element, value=element.guess * ratio, guess=None)))


def _stated(model: Model, name: str) -> Element:
    return next(own for own in model.elements if own.name == name)


def other_value(model: Model, element: Element, found: float) -> Phrase:
    """The sentence for a stated value that should be another, with the line for the rig file."""
    name = element.name
    stated = _stated(model, name)
    assert stated.value is not None
    text = f"{name} fits best at {rounded(found)} {stated.unit(model.angles)}, not {stated.value:g}"
    quantity, usual = USUAL.get(stated.kind, ("", ()))
    for unit in () if model.angles else usual:
        if abs(found / (stated.value * units.scale(unit, quantity, False)) - 1) < CLOSE:
            return _unit(model, name, units.scale(unit, quantity, False))
    mended = replace(stated, value=None, sd=None, guess=float(f"{found:.4g}") if found > 0 else None)
    return Phrase(text, f"{element_section(mended)} {element_line(mended)}", (), (mended,))


def _unit(model: Model, name: str, ratio: float) -> Phrase:
    stated = _stated(model, name)
    assert stated.value is not None
    quantity, usual = USUAL[stated.kind]
    unit = min(usual, key=lambda each: abs(np.log(units.scale(each, quantity, False) / ratio)))
    mended = replace(stated, value=float(f"{stated.value * ratio:.8g}"))
    meant = f"{mended.value:g} {stated.unit(model.angles)}"
    text = f"{name} fits best at {meant}, not {stated.value:g}. Is it {stated.value:g} {unit}?"
    return Phrase(text, f"{element_section(mended)} {element_line(mended)}", (), (mended,))


# Bodies and forces that the rig has not.


RESONANCES = 120  # frequencies of a hidden body, from the lowest line to the highest
BODY_DAMPINGS = (0.01, 0.1)  # damping ratios with which it is looked for
BODY = (0.01, 1.0)  # of the typical mass: between these the search begins
BESIDE = 1.5  # times the highest line: a body that resonates further outside shows but a mass or a spring
PEAKS = 3  # frequencies at each coordinate from which it begins


def oscillator(baseline: Baseline) -> Iterator[Effect]:
    """At each coordinate, a body on a spring and damper that the rig lacks."""
    problem, model = baseline.lines, baseline.problem.model
    if model.angles:
        return
    body = unused(model, "body", "body_2", "hidden_body")
    typical = _typical(model, baseline.as_is.psi, Kind.MASS)
    m, damping = typical * float(np.sqrt(np.prod(BODY))), float(np.sqrt(np.prod(BODY_DAMPINGS)))
    low, high = float(np.min(problem.omega)), float(np.max(problem.omega))
    middle = (low * high) ** 0.5
    for x in model.coordinates:
        joining = (between(f"k_{body}", Kind.SPRING, body, x), between(f"c_{body}", Kind.DAMPER, body, x))
        parts = (mass(f"m_{body}", body), *joining)
        larger = replace(model, coordinates=(*model.coordinates, body), elements=(*model.elements, *parts))
        begun = _resonances(problem.from_starts((baseline.as_is.psi,)).of_rig(larger), parts, typical)
        if not begun:
            continue
        yield Effect(
            "oscillator", (x,), partial(_beside_body, larger, parts, begun), partial(_body, model, parts, x),
            tuple(begun), 2.0, m * middle**2, True, unknown=parts[1].name,
            others=((parts[0].name, m), (parts[2].name, 2 * damping * m * middle)),
            between=((low / BESIDE) ** 2, (high * BESIDE) ** 2), share=1 / len(model.coordinates),
        )  # fmt: skip


def _resonances(
    larger: LineProblem, parts: Sequence[Element], typical: float
) -> dict[float, tuple[float, ...]]:
    """Mass, stiffness and damping of a body to begin with, by its resonance (rad/s), the most promising first.

    Of a light body the motion shows m ω² times a resonance: that is one more column with those of the rig's unknowns,
    for each frequency and damping, and what χ² falls by it (Rao's score) has a peak at that of the body.
    """
    names, omega = larger.names, larger.omega
    light = 1e-6 * typical  # so that it moves nothing
    rates = np.geomspace(np.min(omega), np.max(omega), RESONANCES)
    every, damping = np.tile(rates, len(BODY_DAMPINGS)), np.repeat(BODY_DAMPINGS, RESONANCES)
    ways = np.stack(
        [np.ones(len(every)), every**2, 2 * damping * every], axis=1
    )  # of the parts with the mass
    chosen = [names.index(each.name) for each in parts]
    free = np.setdiff1d(np.arange(len(names)), chosen)
    psi = np.tile(larger.starts[0], (len(ways), 1))
    psi[:, chosen] = light * ways
    information, score, _ = larger.slopes_at(psi)
    # The rig's own unknowns, which know nothing of so light a body, and with them each way by itself
    along = np.einsum("kmc,kc->km", information[:, :, chosen], ways)
    whole = np.diag(np.concatenate([np.zeros(len(free)), np.sum(along[:, chosen] * ways, axis=1)]))
    whole[: len(free), : len(free)] = information[0][np.ix_(free, free)]
    whole[: len(free), len(free) :] = along[:, free].T
    pull = np.concatenate([score[0, free], np.sum(score[:, chosen] * ways, axis=1)])
    numbers = np.arange(len(pull)) - len(free)
    falls, begun = np.zeros(RESONANCES), dict[float, tuple[float, ...]]()
    for test in score_tests(list(map(str, numbers)), (numbers >= 0).tolist(), whole, pull, 0.0):
        way, k = int(test.name), int(test.name) % RESONANCES
        if test.step > 0 and test.fall > falls[k]:
            falls[k] = test.fall
            m = min(max(test.step, BODY[0] * typical), BODY[1] * typical)
            begun[rates[k]] = tuple((m * ways[way]).tolist())
    beside = np.pad(falls, 1)
    peaks = np.flatnonzero((falls > 0) & (falls >= beside[:-2]) & (falls >= beside[2:]))
    best = peaks[np.argsort(-falls[peaks], kind="stable")][:PEAKS]
    return {rates[k]: begun[rates[k]] for k in best}


def _beside_body(
    larger: Model,
    parts: Sequence[Element],
    begun: dict[float, tuple[float, ...]],
    problem: LineProblem,
    rate: float,
) -> LineProblem:
    sizes = [replace(each, guess=size) for each, size in zip(parts, begun[rate], strict=True)]
    there = larger.elements[: -len(sizes)]
    return problem.of_rig(replace(larger, elements=(*there, *sizes))).of_rig(larger)


def _body(model: Model, parts: tuple[Element, ...], x: str, stiffness: float) -> Phrase:
    lines = "; ".join(f"{element_section(each)} {element_line(each)}" for each in parts)
    text = f"a body on a spring is missing at {x} ({rounded(stiffness, '.3g')} N/m)"
    return Phrase(text, f'add a coordinate "{parts[0].name.removeprefix("m_")}"; {lines}', elements=parts)


def unmeasured(baseline: Baseline) -> Iterator[Effect]:
    """An unmeasured force at one coordinate, with its own amplitude at each line."""
    model = baseline.problem.model
    motions = np.flatnonzero(~baseline.inputs)
    if len(motions) < 3 or not baseline.problem.noise_known:  # it would take up what tests the rig
        return
    name = unused(model, "disturbance", "disturbance_2")
    for x in model.coordinates:
        larger = replace(model, inputs=(*model.inputs, Input(name, "force", {x: 1.0})))
        text = f"an unmeasured force at {x} explains the residuals"
        phrase = Phrase(text, f'measure it, or add [inputs] {name} = {{ kind = "force", at = "{x}" }}')
        yield Effect("input", (x,), plainly("of_rig", larger), phrase, share=1 / model.n)


# Resonances outside the band, over its highest and its lowest frequency: of what is so stiff that only its compliance
# shows, or so slow that only its mass does, they are infinite and 0.
ABOVE = (np.inf, 8.0, 4.0, 2.8, 2.0, 1.6, 1.3, 1.15)
BELOW = (0.0, 0.25, 0.5, 0.75)


def residual(baseline: Baseline) -> Iterator[Effect]:
    """What a mode outside the band adds to a channel: a compliance from above, a mass line from below."""
    problem, model = baseline.lines, baseline.problem.model
    channels, omega = problem.channels, problem.omega
    resonances = [float(np.max(omega)) * ratio for ratio in ABOVE]
    resonances += [float(np.min(omega)) * ratio for ratio in BELOW]
    sources = np.flatnonzero(baseline.inputs).tolist()
    motions = [
        c for c in np.flatnonzero(~baseline.inputs).tolist() if channels[c].quantity is not Quantity.FORCE
    ]
    for source in sources:
        # A base moves the bodies that ride on it by its acceleration.
        force = set(channels[source].of) <= set(model.force_inputs)
        for c in motions:
            used, y, expected = baseline.compared(c)
            order = channels[c].quantity.derivative
            order += 0 if force else 2 - channels[source].quantity.derivative
            for resonance in resonances:
                sd = problem.sd[used, c]
                shown = _of_mode(omega, resonance, order)[used] * problem.y[used, source] / sd
                power = float(np.sum(np.abs(shown) ** 2))
                if power == 0:
                    continue
                # As large as what is left of the channel by all others says
                size = float(np.sum((np.conj(shown) * (y - expected) / sd).real)) / power
                width = SHARE_WIDTH * float(np.sqrt(np.sum(np.abs(y / sd) ** 2) / power))
                phrase = _outside(channels[c].name, channels[source].name, float(np.max(omega)), resonance)
                act = partial(_beyond, c, source, order, resonance)
                yield Effect(
                    "residual", (channels[c].name,), act, phrase, (size,), width,
                    share=0.5 if np.isinf(resonance) else 0.5 / (len(resonances) - 1),
                )  # fmt: skip


def _of_mode(omega: Real, resonance: float, order: int) -> Complex:
    """What a mode whose resonance (rad/s) is outside the band shows, as a derivative, (lines,)."""
    above = resonance > np.max(omega)
    course = 1 / (1 - (omega / resonance) ** 2) if above else 1 / (resonance**2 - omega**2)
    return np.asarray((1j * omega) ** order * course, dtype=np.complex128)


def _beyond(
    c: int, source: int, order: int, resonance: float, problem: LineProblem, size: float
) -> LineProblem:
    y = np.array(problem.y)
    y[:, c] -= size * _of_mode(problem.omega, resonance, order) * y[:, source]
    return problem.with_amplitudes(y)


def _outside(name: str, source: str, top: float, resonance: float) -> Phrase:
    adds = "a compliance" if resonance > top else "a mass line"
    near = f", as one near {resonance / (2 * np.pi):.3g} Hz would" if 0 < resonance < np.inf else ""
    text = f"modes outside the band add {adds} to the response of {name} to {source}{near}"
    return Phrase(text, f"narrow the band, or model the stiffer or softer parts at {name}")
