"""Mistakes of dwells, runs and clocks: one bad dwell, a wrong label, the time base, a rig that changed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from dashpot.arrays import Bools
from dashpot.check.explain.channels import DIFFERENT, rounded
from dashpot.check.explain.effect import Baseline, Effect, Phrase, as_is, by_size, plainly
from dashpot.check.explain.problem import (
    FEWER_DRAWS,
    FitProblem,
    FittedProblem,
    LineProblem,
    TimeProblem,
    exchanging,
    fitted,
    replaced,
    searched,
)
from dashpot.check.explain.rigs import missing_elements, points_of, stated_values
from dashpot.check.explain.score import score_tests
from dashpot.data.spectrum import WholeRecord
from dashpot.model.elements import Element
from dashpot.model.rigfile import element_line
from dashpot.numerics.small_systems import scaled_inverse

SUSPECTS = 40  # dwells, each of which is left out in turn
NAMED = 3  # of them whose label, phases or sign may be what is wrong
# Factors of frequencies in other units or time bases
RATES = (2 * np.pi, 1 / (2 * np.pi), 2.0, 0.5, 60.0, 1 / 60)
RATE_WIDTH = 0.01  # relative: clocks that are off are off by little
LABEL_WIDTH = 0.2  # nepers: a dwell's own frequency relative to its label
LABEL_STARTS = (300, 3)  # of the scan for a dwell's own frequency: points, decades
RATES_IN_WORDS = {
    0.159155: "Are they rad/s, given as Hz?",
    6.283185: "Are they Hz, given as rad/s?",
    0.016667: "Are they per minute, given as Hz?",
}


def dwell(baseline: Baseline) -> Iterator[Effect]:
    """Each of the worst dwells left out; for the best of them, also a wrong label or wrong channels."""
    problem = baseline.lines
    lines = len(problem.y)
    if not problem.runs or lines <= 3:
        return
    worst = np.argsort(-problem.chi2_of_lines(baseline.as_is.psi), kind="stable")[:SUSPECTS].tolist()
    share, labels = 1 / lines, problem.labels
    # What drove the rig is still what the inputs' channels show.
    motions = ~baseline.inputs if np.any(~baseline.inputs) else np.ones_like(baseline.inputs)
    dropped = [(np.arange(lines) == line)[:, None] & motions for line in worst]
    ends = fitted([problem.without(each) for each in dropped])
    order = sorted(range(len(worst)), key=lambda k: ends[k].chi2)
    for k in order:
        label = labels[worst[k]]
        text = f"the dwell at {label} disagrees with all others"
        words = Phrase(text, f"leave out {label}, or measure it again")
        yield Effect("dwell", (label,), plainly("without", dropped[k]), words, share=share)
    for k in order[:NAMED]:
        line, label = worst[k], labels[worst[k]]
        if not len(problem.model.nonlinear):  # else harmonics go with the frequency of their dwell
            begun, own = _own_frequency(ends[k], problem, line), partial(_relabelled, label)
            act = partial(_labelled, line)
            yield Effect("frequency", (label,), act, own, begun, LABEL_WIDTH, 1.0, True, share=share)
            for other in range(lines):
                if other != line and labels[other] != label:
                    pair = tuple(labels[i] for i in sorted((line, other)))
                    text = f"the dwells labelled {pair[0]} and {pair[1]} are swapped"
                    cure = f"label the dwell at {pair[0]} {pair[1]}, and the one at {pair[1]} {pair[0]}"
                    swapped = partial(_exchanged, line, other)
                    yield Effect("frequency", pair, swapped, Phrase(text, cure), share=share / lines)
        if not baseline.of_samples:
            text = f"the phases of the dwell at {label} have the opposite sign"
            words = Phrase(text, f"conjugate the amplitudes at {label}")
            at_line = np.broadcast_to((np.arange(lines) == line)[:, None], problem.kept.shape)
            yield Effect("conjugate", (label,), plainly("conjugated", at_line), words, share=share)


def _own_frequency(end: FittedProblem, problem: LineProblem, line: int) -> tuple[float, ...]:
    """Frequencies at which one line fits best, given the fit to all other lines."""
    stated = float(problem.data.spectrum.frequency_hz[line])
    points, decades = LABEL_STARTS
    grid = stated * np.logspace(-decades / 2, decades / 2, points)
    rows = np.full(points, line)
    cost = problem.at_lines(rows).at_frequencies(grid).chi2_of_lines(end.psi)
    inner = np.flatnonzero((cost[1:-1] <= cost[:-2]) & (cost[1:-1] <= cost[2:])) + 1
    best = inner[np.argsort(cost[inner], kind="stable")][:3]
    begun = []
    for k in best.tolist():
        fine = grid[k] * np.logspace(-decades / points, decades / points, 60)
        cost_there = problem.at_lines(np.full(60, line)).at_frequencies(fine).chi2_of_lines(end.psi)
        begun.append(float(fine[int(np.argmin(cost_there))]) / stated)
    return tuple(begun) or (1.1,)


def _labelled(line: int, problem: LineProblem, ratio: float) -> LineProblem:
    frequency = np.array(problem.data.spectrum.frequency_hz)
    frequency[line] *= ratio
    return problem.at_frequencies(frequency)


def _relabelled(label: str, ratio: float) -> Phrase:
    own = float(label.split()[0]) * ratio
    return Phrase(f"the dwell labelled {label} fits {own:.4g} Hz", f"label it {own:.4g} Hz")


def _exchanged(first: int, second: int, problem: LineProblem, _: float) -> LineProblem:
    order = exchanging(len(problem.y), first, second)
    return problem.with_amplitudes(problem.y[order], problem.V[order], problem.kept[order])


def clock(baseline: Baseline) -> Iterator[Effect]:
    """All frequencies multiplied by one factor: a wrong unit, or a time base that is off."""
    problem, at_rate = baseline.problem, by_size("at_rate")
    hidden = isinstance(problem, LineProblem) and problem.runs and problem.data.states is None
    if baseline.fixed or not hidden:
        yield Effect("frequency", (), at_rate, _rate, RATES)
    else:  # where not all motion is seen, nothing leads from the rig as it is to that of another clock
        for rate in RATES:
            (fit,) = searched([baseline.lines.at_rate(rate)], draws=FEWER_DRAWS)
            yield Effect("frequency", (), at_rate, _rate, (rate,), found=fit, share=1 / len(RATES))
    yield Effect("frequency", (), at_rate, _rate, (0.98, 0.995, 1.005, 1.02), RATE_WIDTH, 1.0, True)


def _rate(rate: float) -> Phrase:
    question = next((text for ratio, text in RATES_IN_WORDS.items() if abs(rate / ratio - 1) < 1e-3), "")
    text = f"the response is at {rate:.4g} × the stated frequencies. {question or 'Is the time base wrong?'}"
    return Phrase(text, f"multiply the frequencies by {rate:.6g}")


def hold(baseline: Baseline) -> Iterator[Effect]:
    """Each input held between samples: half a step late, and weaker at high frequencies."""
    steps = {each.step_s for each in baseline.courses.spectrum.stretches if isinstance(each, WholeRecord)}
    period = 2 * np.pi / float(np.max(baseline.courses.omega))
    begun = tuple(sorted(steps)) or tuple(part * period for part in (0.02, 0.1, 0.3))
    for c in np.flatnonzero(baseline.inputs).tolist():
        name = baseline.problem.channels[c].name
        width = None if steps else 0.1 * period
        act, words = partial(_held, c), partial(held_words, name)
        yield Effect("hold", (name,), act, words, begun, width, between=(0.0, np.inf))


def _held(c: int, problem: LineProblem | TimeProblem, step: float) -> FitProblem:
    """The true drive of an input that was recorded at the samples and held for a step."""
    half = problem.omega * step / 2
    return problem.scaled(c, (np.sinc(half / np.pi) * np.exp(-1j * half)).astype(np.complex128))


def held_words(name: str, step: float) -> Phrase:
    text = f"{name} looks held constant between samples ({1e3 * step:.3g} ms)"
    cure = f"first try delay = {-step / 2:.3g} in its line, or give {name} as it is between samples"
    return Phrase(f"{text}. Is it the output of a D/A converter or a simulator?", cure)


MOST_SPLITS = 24  # ways to part the runs that are tried
ALL_AT_ONCE = 0.05  # of the probability of a rig that was changed: that no one part explains it
SPARE = 3.0  # real numbers for each unknown that a part must have


def changed(baseline: Baseline) -> Iterator[Effect]:
    """A rig that changed between runs: each experiment, or all from some run on, is fitted separately."""
    problem = baseline.lines
    spectrum = problem.data.spectrum
    numbers = 2 * np.sum(problem.kept, axis=1) - 2 * len(problem.model.inputs)
    least = SPARE * len(problem.starts[0])
    parts: list[tuple[str, Bools]] = []
    if problem.model.differs:  # in which it is another one already, with unknowns that the others do not show
        return
    experiments = np.unique(spectrum.experiment)
    if 1 < len(experiments) <= MOST_SPLITS:
        parts += [(f"experiment {each}", spectrum.experiment == each) for each in experiments.tolist()]
    if problem.runs and spectrum.lines > 1:
        order = np.arange(spectrum.lines)
        ends = np.unique(np.linspace(1, spectrum.lines - 1, MOST_SPLITS).astype(int)).tolist()
        parts += [(f"the runs from {problem.labels[k]} on", order >= k) for k in ends]
    parts = [each for each in parts if min(np.sum(numbers[each[1]]), np.sum(numbers[~each[1]])) > least]
    if not parts:
        return

    def only(lines: Bools) -> LineProblem:
        return problem.with_amplitudes(problem.y, None, problem.kept & lines[:, None])

    fits = fitted([only(chosen) for _, lines in parts for chosen in (~lines, lines)], kept=2 * MOST_SPLITS)
    pairs = sorted(
        zip(parts, zip(fits[::2], fits[1::2], strict=True), strict=True),
        key=lambda each: each[1][0].chi2 + each[1][1].chi2,
    )
    for (where, _), (first, second) in pairs[:NAMED]:
        whole = FittedProblem(
            problem, first.psi, first.chi2 + second.chi2, first.dof + second.dof, (first, second)
        )
        subject = f"{where} behave{'s' if where.startswith('experiment') else ''} like a different rig"
        change = f"identify {where} separately, or find out what was changed"
        yield Effect(
            "changed", (), as_is, Phrase(subject, change), found=whole, more=len(first.psi),
            share=ALL_AT_ONCE / len(parts),
        )  # fmt: skip
        for part, step, rise in _one_part_otherwise(first, second)[:NAMED]:
            other = second
            if part not in problem.model.elements:  # stated, with a tolerance or without, or new
                larger = second.problem.from_starts((second.psi,)).of_rig(replaced(problem.model, part))
                (other,) = fitted([larger])
            chi2, fell = first.chi2 + other.chi2, second.chi2 - other.chi2
            extra = max(rise + fell, 0.0)  # for what else would have to be the same
            less = replace(problem, given_up=problem.given_up - extra / 2)
            single = FittedProblem(less, first.psi, chi2 + extra, whole.dof, (first, other))
            unit, there = part.unit(problem.model.angles), {each.name for each in problem.model.elements}
            text = f"{subject}: {part.name} differs by {rounded(step, '+.3g')} {unit}"
            own = replace(part, only="other", stands_for=part.name if part.name in there else None)
            cure = f"{change}; or let it differ in that test: {DIFFERENT}; {element_line(own)}"
            yield Effect(
                "changed", points_of(part, problem.model), as_is, Phrase(text, cure), (step,),
                found=single, more=1, share=1 / len(parts),
            )  # fmt: skip


def _one_part_otherwise(first: FittedProblem, second: FittedProblem) -> list[tuple[Element, float, float]]:
    """Elements that may be otherwise in the second of two groups of lines, the best first.

    Each with its step, and by how much χ² of both together rises where all else is the same, by the parabolas about
    the two fits.  Elements are the rig's own and those that it lacks.
    """
    model, names = first.problem.model, first.problem.names
    larger = replaced(model, *missing_elements(model), *stated_values(model))
    there = second.problem.from_starts((second.psi,)).of_rig(larger)
    information, score, _ = there.slopes(there.starts[0])
    alone, _, _ = first.slopes
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(alone))):
        return []
    free = [there.names.index(name) for name in names]
    away = second.psi - first.psi
    pull = alone @ away
    both = information[np.ix_(free, free)] + alone
    # Unknowns of both groups at the end of the second, and with them each of the second alone.
    whole = np.block([[both, information[free]], [information[:, free], information]])
    apart = [False] * len(names) + [True] * len(there.names)
    tests = score_tests([*names, *there.names], apart, whole, np.append(-pull, score), 0.0)
    alike = float(away @ pull - pull @ scaled_inverse(both) @ pull)
    if not np.isfinite(alike):
        return []
    elements = {each.name: each for each in larger.elements}
    found = [(elements[t.name], t.step, alike - t.fall) for t in tests if t.name in elements]
    return sorted(found, key=lambda each: each[2])
