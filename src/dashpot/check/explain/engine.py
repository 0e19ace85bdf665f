"""The engine: every effect tried on a problem, the best few fitted closely, and their odds by evidence.

The evidence of a supposition is the probability of the data under it, its unknowns weighed by their priors: the
likelihood at the best fit with noise and discrepancy averaged over, the part of its prior that a size leaves (Occam's
factor, Laplace), what left-out amplitudes might have been, and the prior of its kind.  Among them stands always that
something else is the matter, which leaves a discrepancy of any size from the rig as it is, or from what a cause makes
of it; a rig with its mistake mended leaves little of the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import log

import numpy as np
from scipy.special import chdtrc, log_ndtr, logsumexp

from dashpot.arrays import Ints, Real
from dashpot.check.explain import channels, dwells, rigs
from dashpot.check.explain import laws as laws_of_rig
from dashpot.check.explain.effect import Baseline, Effect, Effects, Subject
from dashpot.check.explain.laws import ENOUGH
from dashpot.check.explain.problem import (
    FEWER_DRAWS,
    FitProblem,
    FittedProblem,
    LineProblem,
    TimeProblem,
    fitted,
    fitted_each,
    fitted_from_starts,
    glanced,
    judged,
    roughly_lost,
    sd_of_lost,
    searched,
)
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.inference.diagnostics import of_one_sign
from dashpot.estimate.inference.uncertainty import linear_modes
from dashpot.estimate.result import MISFIT, Estimate
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.numerics.small_systems import scaled_inverse

# The kinds of effects, each with its probability before the data: what people get wrong, by how often.
KINDS: tuple[tuple[float, Effects], ...] = (
    (0.08, channels.sign),
    (0.10, channels.unit),
    (0.08, channels.gain),
    (0.08, channels.delay),
    (0.04, channels.derivative),
    (0.04, channels.conjugate),
    (0.01, channels.radians),
    (0.04, channels.filtered),
    (0.02, channels.saturation),
    (0.01, channels.gain_step),
    (0.06, channels.swap),
    (0.02, channels.crosstalk),
    (0.02, channels.place),
    (0.03, channels.left_out),
    (0.06, dwells.dwell),
    (0.04, dwells.clock),
    (0.02, dwells.hold),
    (0.02, dwells.changed),
    (0.10, rigs.element),
    (0.08, rigs.value),
    (0.01, rigs.hysteretic),
    (0.01, rigs.oscillator),
    (0.005, rigs.unmeasured),
    (0.02, rigs.residual),
)
# Kinds that take lines one by one, or bring many unknowns: harmonics of a nonlinear rig go together.
OF_LINEAR_RIGS = (dwells.dwell, dwells.changed, channels.radians, rigs.oscillator, rigs.unmeasured)
LARGEST = 12  # coordinates of the rigs that are explained: fits of larger ones take too long to wait for
OF_LAWS = 0.05  # that a nonlinear element is missing
# Kinds that say how numbers of the data may be wrong, whatever the rig.
OF_DATA = (
    channels.sign, channels.unit, channels.gain, channels.delay, channels.derivative, channels.swap, dwells.clock,
)  # fmt: skip
OF_SILENT = ("channel", "swap")  # kinds that a channel which measured nothing by its own numbers may have
FAR = ("swap", "sign", "conjugate", "quantity")  # kinds to whose rigs the way may be long
AFRESH = 6  # of them that are searched from drawn rigs
NEGATIVE = 1e-3  # that a spring of a sound rig is negative, as one that represents bending
IMPOSSIBLE = -100.0  # ln of the probability of a rig with negative masses or dampers, however negative
# That it is something else, seen from the rig as it is; so much again, from all that is listed
UNLISTED = 0.05
LISTED = 0.95  # odds that the causes named sum to
MOST = 5  # causes that are named
LIKELY = 0.5  # of the misfit that a cause explains at the least to be named
# Of it that a cause explains which leaves nothing to others, two together, or the second of what the first leaves
NEARLY_ALL = 0.9
CLOSELY = 16  # effects whose size is sought closely and whose evidence is computed
FIRST_STEP = 1e-4  # of the prior scale of a size: to both sides of none, for the slopes of χ²
BEGUN = 0.3  # of the prior scale of a size: the first step to both sides
ROUNDS = 8  # parabolas through χ² about a size, at most
# Of χ² over its degrees of freedom, by which a parabola lowers χ² at the least where another follows
SETTLED = 0.1
TOGETHER = log(10)  # difference of log likelihoods that tells two causes apart
IMPROBABLE = 1e-4  # p-value of what the best cause leaves, below which a second one is looked for
NEXT_TO_NOTHING = 0.003  # of a gross misfit, below which nothing finer is looked for: a rig is rarely better
SIZES = np.concatenate([[0.0], np.geomspace(1e-5, 3.0, 30)])  # of a discrepancy, relative to the motion
MENDED = 0.01  # of the motion: within that a rig is mostly right whose mistake is mended
APPROXIMATE = 0.05  # of the misfit, as an amplitude: within that an effect describes its cause
NOISE_KNOWN = 0.2  # of the standard deviation of noise: within that it is mostly known
# Of the noise's variance over what is known of it
EXCESSES = np.concatenate([[1.0], np.geomspace(1.05, 1e24, 120)])

Fitter = Callable[[Sequence[FitProblem]], list[FittedProblem]]
Kinds = Sequence[tuple[float, Effects]]
Supposition = tuple[Effect, float, float, FitProblem]  # an effect, its prior, a size, the problem with it


@dataclass
class Trial:
    """An effect on its way to the best of its sizes: the prior of its kind, a size, and the fit there.

    bend, step  half of the curvature of χ² about the size, and a step from it, at most three of which are taken
    """

    effect: Effect
    prior: float
    size: float
    fit: FittedProblem
    bend: float = 0.0
    step: float = 0.0

    @property
    def roughly(self) -> float:
        """Log evidence from χ² alone."""
        return self.fit.roughly + log(self.prior * self.effect.share)

    def at(self, move: float) -> float:
        """The size so far away on its scale."""
        return self.effect.size_at(self.effect.coordinate(self.size) + move, self.size)

    @property
    def scale(self) -> float:
        """χ² over its degrees of freedom, where that is more than noise leaves."""
        return max(self.fit.reduced, 1.0) if np.isfinite(self.fit.reduced) else 1.0

    def moved(self, problem: FitProblem, move: float, along: Along | None = None) -> FitProblem:
        """The problem with the effect at a size so far away, begun where this one ended or as slopes lead on."""
        begun = self.fit.psi if along is None else self.fit.psi + along.lag - move * along.following
        return self.effect.act(problem, self.at(move)).from_starts((begun,))

    def take(self, ends: Sequence[tuple[float, FittedProblem]]) -> bool:
        """Take the best of other sizes if it fits better; whether it does."""
        size, fit = min(ends, key=lambda end: end[1].chi2)
        lower = fit.chi2 < self.fit.chi2
        if lower:
            self.size, self.fit = size, fit
        return lower


@dataclass(frozen=True)
class Cause:
    """A supposition fitted: its size, where the fit ended, and what speaks for it.

    likelihood, evidence  logarithms, without and with priors
    instead   that of the evidence that it is something else, of which this fit comes near
    possible  that of the probability that the parts of the rig are those of one that can be built
    odds      among all that were tried, and what was not
    near      odds that it is something else of which this fit comes near
    explains  share of the misfit
    group     a number that causes share which the data cannot tell apart; None for one that stands alone
    beside    whether it is wrong in addition to the first, not in its place
    """

    effect: Effect
    size: float
    fit: FittedProblem
    likelihood: float
    evidence: float
    instead: float = -np.inf
    possible: float = 0.0
    odds: float = np.nan
    near: float = 0.0
    explains: float = 0.0
    group: int | None = None
    beside: bool = False

    def same(self, other: Cause) -> bool:
        """Whether it is another one, with the same size."""
        first, second = ((e.subject, e.unknown, e.width is None) for e in (self.effect, other.effect))
        return first == second and abs(self.size - other.size) <= 0.01 * abs(self.size)

    def finding(self, noise_known: bool) -> Finding:
        """As an assessment has it."""
        left = self.fit.reduced if noise_known and np.isfinite(self.fit.reduced) else None
        found = self.effect.finding(self.size, left, odds=self.odds, explains=self.explains, group=self.group)
        return replace(found, beside=self.beside)


@dataclass(frozen=True)
class Explanation:
    """The problem as it is, fitted, and what may be the matter, the likeliest first.

    unlisted  odds that it is nothing of the list, or what explains less than half
    nearest   the likeliest of what explains less than half, where that is likelier than any cause; else None
    weighed   all causes that were fitted closely, whatever they explain; what their fits stand for (odds, and `near`)
              and `as_stated` sum to 1
    """

    as_is: FittedProblem
    causes: tuple[Cause, ...]
    unlisted: float
    nearest: Cause | None = None
    weighed: tuple[Cause, ...] = ()

    @property
    def as_stated(self) -> float:
        """Odds that nothing which was fitted is the matter."""
        return max(1 - sum(cause.odds + cause.near for cause in self.weighed), 0.0)

    def findings(self) -> tuple[Finding, ...]:
        """The causes as an assessment has them; before them, where that is likelier, that it is something else."""
        named = tuple(cause.finding(self.as_is.problem.noise_known) for cause in self.causes)
        if named and self.unlisted <= self.causes[0].odds:
            return named
        # What comes nearest, and where most of what that leaves is
        left, nearest = self.causes[0].fit if self.causes else self.as_is, self.nearest
        power = np.abs(left.residual / left.problem.sd) ** 2
        line, c = np.unravel_index(int(np.argmax(np.nan_to_num(power))), power.shape)
        name = [*(channel.name for channel in left.problem.channels), "frequency", "damping ratio"][int(c)]
        largest = f"largest in {name} near {left.problem.frequency_hz[int(line)]:.4g} Hz"
        text = f"no listed cause explains half of the misfit, which is {largest}"
        if self.causes:
            text = f"every listed cause leaves too much of the misfit; after the best one, the misfit is {largest}"
        elif nearest is not None:
            best = nearest.effect.phrase(nearest.size).text
            text += f". The best one explains {100 * nearest.explains:.0f} %: {best}"
        cure = "look at the residuals there; measure more points, or test fewer at a time"
        return (Finding("unexplained", (), text, cure, None, odds=self.unlisted, explains=0.0), *named)


@np.errstate(all="ignore")  # what is supposed may be absurd
def explain(
    problem: LineProblem, *, silent: Mapping[str, str] | None = None, of_samples: bool = False, seed: int = 0
) -> Explanation:
    """What may be otherwise, so that the rig describes the data.

    silent      channels that measured nothing by their own numbers, with what they show
    of_samples  whether amplitudes were made of samples, so that their phases and frequencies are what they are
    """
    return explain_in_steps(_begun(problem, silent or {}, of_samples, seed), KINDS, laws=True)


@np.errstate(all="ignore")  # what is supposed may be absurd
def explain_beside_laws(problem: LineProblem, silent: Mapping[str, str]) -> Explanation:
    """As `explain`, of settled dwells of a rig with laws of its own, begun where its fit ended."""
    kinds = tuple((prior, kind) for prior, kind in KINDS if kind not in OF_LINEAR_RIGS)
    return explain_in_steps(begun_at(problem, silent, True), kinds)


@np.errstate(all="ignore")  # what is supposed may be absurd
def explain_in_steps(baseline: Baseline, kinds: Kinds, *, laws: bool = False) -> Explanation:
    """The likely causes among effects of some kinds: one, or two together if one leaves more than noise.

    laws: whether a nonlinear element is looked for.
    """
    first = _step(baseline, kinds, laws=laws)
    best = first.causes[0] if first.causes else first.nearest
    # With a law of the rig's own, every further trial is a search by harmonic balance.
    if best is None or len(best.fit.problem.model.nonlinear) or not _leaves_more_than_noise(best.fit):
        return first
    mended = best.fit.problem.from_starts((best.fit.psi,))
    second = _step(begun_at(mended, baseline.silent, baseline.of_samples), kinds)
    others = (each for each in second.causes if each.effect.subject != best.effect.subject)
    more = [each for each in others if each.odds > 1 - LISTED]
    if not more:
        return first
    both = replace(more[0], odds=best.odds * more[0].odds, group=None, beside=True)
    beside = tuple(
        replace(each, odds=best.odds * each.odds, near=best.odds * each.near) for each in second.weighed
    )
    alone = replace(best, odds=best.odds * second.as_stated)
    weighed = (*(each for each in first.weighed if each.effect is not best.effect), alone, *beside)
    if first.causes:
        nearly_all = not _leaves_more_than_noise(both.fit) or both.explains >= NEARLY_ALL
        causes = (best, both, *first.causes[1:])[:MOST]
        return replace(first, causes=causes, weighed=weighed) if nearly_all else first
    together = _explained(baseline.as_is, log_possible(baseline.as_is), both, _floor(baseline, [both]))
    if together < NEARLY_ALL:
        return first
    return replace(first, causes=(best, both), unlisted=1 - both.odds, weighed=weighed)


def _begun(problem: LineProblem, silent: Mapping[str, str], of_samples: bool, seed: int) -> Baseline:
    """The problem as stated and without each channel, fitted from many starts."""
    every = np.eye(len(problem.channels), dtype=bool)
    alike = [problem, *(problem.without(np.broadcast_to(own, problem.kept.shape)) for own in every)]
    if (
        problem.data.states is None
    ):  # no regression leads to the rig of an input that is turned, or in another unit
        for c, channel in enumerate(problem.channels):
            if measures_input(problem.model, channel):
                alike += [problem.scaled(c, factor) for factor in (-1.0, 1e-3, 1e3)]
        alike += [] if of_samples else [problem.conjugated(np.any(every, axis=0))]
    return _baseline(problem, searched(alike, seed), silent, of_samples)


def begun_at(
    problem: FitProblem,
    silent: Mapping[str, str] | None = None,
    of_samples: bool = False,
    fit: Fitter = fitted,
) -> Baseline:
    """The problem as stated and without each channel, fitted from its own starts."""
    fits = fit([problem, *(channels.without(c, problem) for c in range(len(problem.channels)))])
    return _baseline(problem, fits, silent or {}, of_samples)


def _baseline(
    problem: FitProblem, fits: Sequence[FittedProblem], silent: Mapping[str, str], of_samples: bool
) -> Baseline:
    """Of fits of the problem, of it without each channel, and of others, whose ends are starts as well as its own."""
    kept: list[Real] = []  # those that differ by more than a per cent in some unknown, in their order
    for psi in (psi for psi in (*(fit.psi for fit in fits), *problem.starts) if np.all(np.isfinite(psi))):
        near = (np.abs(psi - each) <= 0.01 * np.maximum(np.abs(psi), np.abs(each)) for each in kept)
        if not any(map(np.all, near)):
            kept.append(psi)
    begun = problem.from_starts(kept or [fits[0].psi])
    without = tuple(fits[1 : len(problem.channels) + 1])
    return Baseline(begun, replace(fits[0], problem=begun), without, silent, of_samples)


def _leaves_more_than_noise(fit: FittedProblem) -> bool:
    known = fit.problem.noise_known
    return known and fit.dof > 0 and bool(chdtrc(fit.dof, fit.chi2) < IMPROBABLE) and fit.reduced > 1.5


ON_RECORDS = (rigs.element, rigs.value, rigs.hysteretic)  # kinds that are tried on the records themselves
HINT = 0.3  # of what the best unknown gain or delay explains, which another must explain to be looked at
NEAR = 0.2  # nepers within which a gain is taken for a usual ratio
CALIBRATIONS = {"gain": (channels.sign, channels.unit, channels.gain), "delay": (channels.delay,)}


@np.errstate(all="ignore")  # what is supposed may be absurd
def explain_records(
    lines: LineProblem,
    problem: LineProblem,
    of_records: Kinds,
    *,
    silent: Mapping[str, str] | None = None,
    seed: int = 0,
) -> Explanation:
    """As `explain`, of whole records.

    lines       few lines of them without transients, in which gross mistakes are looked for
    problem     the records themselves, with the loads of their ends
    of_records  kinds of effects that only the records themselves show
    """
    rough = _begun(lines, silent or {}, True, seed)
    tried = _tried(rough, KINDS)
    _search_afresh(rough, tried)
    _closely(rough.problem, sorted(tried, key=lambda each: -each.roughly)[:CLOSELY], fitted_from_starts)
    tried.sort(key=lambda each: -each.roughly)
    baseline = begun_at(problem, silent, True)
    as_is = baseline.as_is
    chosen: list[Supposition] = []
    for effect, prior, of_lines, starts in _chosen(baseline, tried):
        for size in (of_lines, *_promised(baseline, effect)):
            with suppress(DashpotError):  # a rig or channels that cannot be, or too little left to fit
                supposed = effect.act(problem, size)
                assert isinstance(supposed, LineProblem)
                supposed.arranged()  # raises where it cannot be fitted
                begun = [psi for psi in (*starts, as_is.psi) if len(psi) == len(supposed.starts[0])]
                chosen.append((effect, prior, size, supposed.from_starts(begun or supposed.starts)))
    in_full = _at_best_sizes(baseline, chosen, fitted([each[3] for each in chosen]))
    again = tuple((prior, kind) for prior, kind in KINDS if kind in ON_RECORDS)
    led_to = {each.effect.subject: each.fit.psi for each in reversed(tried)}
    return _weighed_all(
        baseline, [*in_full, *_tried(baseline, (*again, *of_records), begun=led_to)], fitted_from_starts
    )


IN_TIME = (
    *OF_DATA, channels.filtered, channels.crosstalk, channels.place, dwells.hold, rigs.element, rigs.value,
)  # fmt: skip
STILL_FALLS = 0.9  # of χ², that a round leaves at the most where another is worth it
INTEGRATED = 5  # effects on records in time that are fitted in full
AFAR = 3  # of those to which no slopes lead, that are integrated


@np.errstate(all="ignore")  # what is supposed may be absurd
def explain_in_time(baseline: Baseline, of_records: Kinds, instead: Kinds) -> Explanation:
    """As `explain`, of a record whose motion is integrated: each effect by the slopes of motions that are known (Rao's
    score test), the likeliest of them followed to their ends.

    Where none explains nearly all, so are effects to which no slopes lead, and those that may be the matter `instead`.
    """
    kinds = tuple((prior, kind) for prior, kind in KINDS if kind in IN_TIME)
    tried = _tried(baseline, (*kinds, *of_records), glanced, glanced)
    known = [each for each in tried if np.isfinite(each.fit.chi2)]
    best = _likeliest_followed(baseline, known)
    if all(each.fit.reduced > (1 - NEARLY_ALL) * baseline.as_is.reduced for each in best):
        unknown = [each for each in tried if each.effect.found is None and not np.isfinite(each.fit.chi2)]
        unknown.sort(key=lambda each: -each.prior * each.effect.share)
        others = [(each.prior, partial(_alone, each.effect)) for each in unknown[:AFAR]]
        far = partial(glanced, far=True)
        best += _likeliest_followed(baseline, _tried(baseline, (*others, *instead), far, far))
    _closely(baseline.problem, best, glanced)
    _follow(baseline, best)
    return _weighed_all(baseline, best)


def _alone(effect: Effect, _: Baseline) -> Iterator[Effect]:
    yield effect


def _likeliest_followed(baseline: Baseline, tried: Sequence[Trial]) -> list[Trial]:
    """The best form of each of the likeliest effects, fitted in full."""
    tried = sorted(tried, key=lambda each: -each.roughly)
    forms = {each.effect.subject: each for each in reversed(tried)}
    best = [each for each in tried if forms[each.effect.subject] is each][:INTEGRATED]
    _follow(baseline, best)
    # The way of the likeliest may be long: from where its size is found to be, it goes on.
    for _ in range(ROUNDS if best else 0):
        likeliest = max(best, key=lambda each: each.roughly)
        before = likeliest.fit.chi2
        _closely(baseline.problem, [likeliest], glanced)
        _follow(baseline, [likeliest])
        if not likeliest.fit.chi2 < STILL_FALLS * before:
            break
    return best


def _follow(baseline: Baseline, trials: Sequence[Trial]) -> None:
    """Fit records in time completely, starting from their trials."""
    for each in trials:
        if each.effect.found is None:
            begun = each.fit.problem.from_starts((*each.fit.problem.starts[:1], each.fit.psi))
            each.fit = _on_the_same_data(baseline, fitted_from_starts([begun])[0])


def _chosen(
    baseline: Baseline, tried: Sequence[Trial]
) -> Iterator[tuple[Effect, float, float, tuple[Real, ...]]]:
    """Effects on whole records that are looked at with the transients of their ends, with sizes and starts.

    Gains and delays by the records themselves, each as an unknown of its own; all else as the lines without transients
    have it (`tried`).
    """
    problem, again = baseline.lines, {kind.__name__ for kind in ON_RECORDS}
    opened = [
        (channel.name, word, *_calibrated(baseline, c, word))
        for c, channel in enumerate(problem.channels)
        for word in CALIBRATIONS
        if getattr(channel, word) is not None
    ]
    most = max((baseline.as_is.chi2 - fit.chi2 for _, _, fit, *_ in opened), default=0.0)
    hints = [each for each in opened if baseline.as_is.chi2 - each[2].chi2 > HINT * max(most, 0.0)]
    forms = [
        (word, prior, effect)
        for word in {each[1] for each in hints}
        for prior, kind in KINDS
        if kind in CALIBRATIONS[word]
        for effect in kind(baseline)
    ]
    for name, word, _, size, psi in hints:
        for prior, effect in (each[1:] for each in forms if each[0] == word and each[2].of == (name,)):
            near = [each for each in effect.values if each * size > 0 and abs(log(each / size)) < NEAR]
            if effect.width is not None:
                yield effect, prior, size, (psi,)
            elif near:
                yield effect, prior, min(near, key=lambda each: abs(log(each / size))), (psi,)
    for each in tried:
        if each.effect.found is None and not (each.effect.unknown and each.effect.kind in again):
            yield each.effect, each.prior, each.size, (each.fit.psi,)


def _calibrated(baseline: Baseline, c: int, word: str) -> tuple[FittedProblem, float, Real]:
    """Whole records fitted with the gain or delay of channel c unknown, that size, and ψ (M,) without it."""
    problem, channel = baseline.lines, baseline.problem.channels[c]
    opened = replace(channel, gain=None) if word == "gain" else replace(channel, delay=None)
    mended = tuple(opened if k == c else each for k, each in enumerate(problem.channels))
    begun = problem.from_starts((baseline.as_is.psi, baseline.without[c].psi)).of_rig(problem.model, mended)
    at = begun.names.index(f"{channel.name}.{word}")
    turned = [np.where(np.arange(len(psi)) == at, -1.0, psi) for psi in begun.starts if word == "gain"]
    (fit,) = fitted([begun.from_starts((*begun.starts, *turned))])
    return fit, float(fit.psi[at]), np.delete(fit.psi, at)


@np.errstate(all="ignore")  # what is supposed may be absurd
def mistakes_of_data(problem: LineProblem) -> Explanation:
    """Likely mistakes in data that a rig with fixed values predicts badly."""
    baseline = replace(begun_at(problem, of_samples=True, fit=judged), fixed=True)
    return _step(baseline, tuple((1 / len(OF_DATA), kind) for kind in OF_DATA), judged, judged)


def _step(
    baseline: Baseline,
    kinds: Kinds,
    fit: Fitter = fitted,
    refit: Fitter = fitted_from_starts,
    *,
    laws: bool = False,
) -> Explanation:
    """All effects of some kinds tried once on a problem."""
    tried = _tried(baseline, kinds, fit)
    if laws:
        _search_afresh(baseline, tried)
    if laws and not any(_settles(baseline, each.fit) for each in tried):
        keeps_all = not any(each.fit.reduced < _enough(baseline) for each in tried)
        for effect in laws_of_rig.nonlinear(baseline, thorough=keeps_all):
            assert effect.found is not None
            tried.append(Trial(effect, OF_LAWS, effect.values[0], effect.found))
    return _weighed_all(baseline, tried, refit)


def _weighed_all(baseline: Baseline, tried: Sequence[Trial], refit: Fitter | None = None) -> Explanation:
    """The best trials with their odds; their sizes are refined if there is a `refit`."""
    hopeful = sorted(filter(_is_such, tried), key=lambda each: -_hope(each))[:CLOSELY]
    if refit is not None:
        _closely(baseline.problem, hopeful, refit)
    block = baseline.problem.blocks(baseline.as_is.psi)
    stated = LeftOver.of(baseline.as_is, block)
    possible_ones = (each for each in hopeful if np.isfinite(each.fit.chi2) and _is_such(each))
    weighed = [_weighed(each, block, stated.largest) for each in possible_ones]
    causes: list[Cause] = []
    for cause in sorted((each for each in weighed if each is not None), key=lambda each: -each.evidence):
        if not any(map(cause.same, causes)):  # else a fit that began elsewhere has come to the same
            causes.append(cause)
    possible = log_possible(baseline.as_is)
    as_is = stated.unlike(stated.largest) + possible
    all_listed = sum(each.prior * each.effect.share for each in tried)
    instead = [cause.instead + log(UNLISTED / all_listed) for cause in causes]
    weights = np.array([*(cause.evidence for cause in causes), *instead, as_is + log(UNLISTED)])
    odds = np.exp(weights - logsumexp(weights)).tolist()
    floor = _floor(baseline, causes)
    causes = [
        replace(cause, odds=chance, near=near, explains=_explained(baseline.as_is, possible, cause, floor))
        for cause, chance, near in zip(causes, odds, odds[len(causes) :], strict=False)
    ]
    every = tuple(causes)
    nearest = causes[0] if causes and causes[0].explains < LIKELY and causes[0].odds > odds[-1] else None
    causes = [cause for cause in causes if cause.explains >= LIKELY]
    unlisted = max(1 - sum(cause.odds for cause in causes), 0.0)
    unique: dict[Subject, Cause] = {}
    for cause in causes:  # forms of one cause are one
        best = unique.get(cause.effect.subject)
        together = cause if best is None else replace(best, odds=best.odds + cause.odds)
        unique[cause.effect.subject] = together
    listed = sorted(unique.values(), key=lambda cause: -cause.odds)
    total = np.cumsum([cause.odds for cause in listed])
    # What the data cannot tell from the first is named with it, however improbable beforehand.
    listed = [
        cause
        for cause, so_far in zip(listed, total - [cause.odds for cause in listed], strict=True)
        if so_far < LISTED * total[-1] or abs(listed[0].likelihood - cause.likelihood) < TOGETHER
    ][:MOST]
    of_group = indistinguishable([cause.likelihood for cause in listed])
    grouped = tuple(replace(cause, group=group) for cause, group in zip(listed, of_group, strict=True))
    return Explanation(baseline.as_is, grouped, unlisted, nearest, every)


def _hope(trial: Trial) -> float:
    """Log evidence of a trial from χ² and from what its rig's parts are."""
    fits = trial.fit.parts or (trial.fit,)
    positive = all(
        np.all(fit.psi[: len(fit.problem.model.unknowns)][of_one_sign(fit.problem.model)] > 0) for fit in fits
    )
    return trial.roughly + (0.0 if positive else log_possible(trial.fit, trial.effect.may_be_negative))


def _enough(baseline: Baseline) -> float:
    """χ² over its degrees of freedom that leaves nothing to explain: noise, or next to nothing of a gross misfit."""
    return max(ENOUGH, NEXT_TO_NOTHING * baseline.as_is.reduced)


def _settles(baseline: Baseline, end: FittedProblem) -> bool:
    """Whether an effect explains the whole misfit while keeping all data and a single rig."""
    return end.reduced < _enough(baseline) and roughly_lost(end.problem) == 0.0 and not end.parts


def _tried(
    baseline: Baseline,
    kinds: Kinds,
    fit: Fitter = fitted,
    of_rigs: Fitter = fitted_each,
    begun: Mapping[Subject, Real] | None = None,
) -> list[Trial]:
    """Each effect of some kinds at the best of its sizes.

    of_rigs  fits those that are another rig
    begun    ψ (M,) of effects by kind and what they are of, one more start of those that are another rig
    """
    suppositions: list[Supposition] = []
    found: list[Trial] = []
    for prior, kind in kinds:
        for effect in kind(baseline):
            if effect.kind not in OF_SILENT and not baseline.silent.keys().isdisjoint(effect.of):
                continue  # of what measured nothing no gain and no sign can be told
            if effect.found is not None:
                found.append(Trial(effect, prior, effect.values[0], effect.found))
                continue
            there = begun.get(effect.subject) if begun and effect.unknown else None
            sizes = effect.values[:1]  # in time slopes along an unknown lead from the first to the others
            if not (effect.unknown and isinstance(baseline.problem, TimeProblem)):
                sizes = (*effect.values, *_promised(baseline, effect))
            for size in sizes:
                with suppress(DashpotError):  # a rig or channels that cannot be
                    supposed = effect.act(baseline.problem, size)
                    if there is not None and len(there) == len(supposed.starts[0]):
                        supposed = supposed.from_starts((*supposed.starts, there))
                    suppositions.append((effect, prior, size, supposed))
    # Of another rig each is followed to its end: from a rig that does not fit, the first steps say little.
    suppositions.sort(key=lambda each: not each[0].unknown)
    count = sum(bool(each[0].unknown) for each in suppositions)
    problems = [each[3] for each in suppositions]
    fits = [*of_rigs(problems[:count]), *fit(problems[count:])]
    return [each for each in (*found, *_at_best_sizes(baseline, suppositions, fits)) if _is_such(each)]


def _at_best_sizes(
    baseline: Baseline, suppositions: Sequence[Supposition], fits: Sequence[FittedProblem]
) -> list[Trial]:
    """Each effect at the size whose fit is the likeliest."""
    best: dict[int, Trial] = {}
    for (effect, prior, size, _), fit in zip(suppositions, fits, strict=True):
        end = _on_the_same_data(baseline, fit)
        if id(effect) not in best or end.roughly > best[id(effect)].fit.roughly:
            best[id(effect)] = Trial(effect, prior, size, end)
    return list(best.values())


def _promised(baseline: Baseline, effect: Effect) -> tuple[float, ...]:
    """The size that one step from the rig as it is promises (Rao's score at ψ), of what is sought by its size.

    Where a channel is all that tells a part of the rig, what the others predict of it is no size to begin at.
    """
    problem = baseline.problem
    if effect.width is None or effect.unknown or not isinstance(problem, LineProblem):
        return ()
    with suppress(DashpotError):
        # Not every scale of sizes begins at none: those of filters and limits do not.
        if not np.allclose(effect.act(problem, effect.null).y, problem.y, rtol=1e-9, atol=0.0):
            return ()
        null = Trial(effect, 1.0, effect.null, baseline.as_is)
        move = Along.of(null, problem).move(effect.width)
        size = null.at(move) if move else 0.0
        return (size,) if size and np.isfinite(size) else ()  # a promise may be beyond all numbers
    return ()


@dataclass(frozen=True)
class Along:
    """How χ² goes along the scale of an effect's size where ψ follows; all 0 where that cannot be told.

    fall, bend      half of its slope, downhill, and of its curvature
    lag, following  (M,) how far ψ is from its end there, and by how much the end goes back for a step of one
    """

    fall: float = 0.0
    bend: float = 0.0
    lag: Real | float = 0.0
    following: Real | float = 0.0

    @staticmethod
    def of(trial: Trial, problem: FitProblem) -> Along:
        """By slopes of the problem with the effect of a trial, where that was fitted and a little off its size."""
        effect, psi = trial.effect, trial.fit.psi
        assert effect.width is not None
        step = FIRST_STEP * effect.width
        with suppress(DashpotError, np.linalg.LinAlgError):
            sides = [effect.act(problem, trial.at(side)) for side in (-step, step)]
            for each in sides:
                if isinstance(each, LineProblem) and isinstance(problem, LineProblem):
                    each.begun_beside(problem)
            (_, low, before), (_, high, after) = (each.slopes(psi) for each in sides)
            information, gradient, chi2 = trial.fit.slopes
            cross = (low - high) / (2 * step)
            lag, following = (scaled_inverse(information) @ np.column_stack([gradient, cross])).T
            bend = float((before - 2 * chi2 + after) / (2 * step**2) - cross @ following)
            fall = float((before - after) / (4 * step) - cross @ lag)
            if np.isfinite(fall) and np.isfinite(bend):
                return Along(fall, bend, lag, following)
        return Along()

    def move(self, usual: float) -> float:
        """To the vertex; where χ² falls ever faster, on that side as far as sizes usually are."""
        return self.fall / self.bend if self.bend > 0 else float(np.sign(self.fall) * usual)


def _search_afresh(baseline: Baseline, tried: Sequence[Trial]) -> None:
    """Search from drawn rigs as well: each stated value, to which nothing leads where not all motion is seen; and where
    nothing settles it, the most hopeful of what changes the motion itself."""
    if baseline.lines.data.states is None:
        for each in (each for each in tried if each.effect.kind == "value" and each.effect.unknown):
            assert isinstance(each.fit.problem, LineProblem)
            with suppress(DashpotError):
                (end,) = searched([each.fit.problem], draws=FEWER_DRAWS)
                if end.chi2 < each.fit.chi2:
                    each.fit = _on_the_same_data(baseline, end)
    if any(_settles(baseline, each.fit) for each in tried):
        return
    far = [each for each in tried if each.effect.kind in FAR and each.effect.found is None]
    far = sorted(far, key=lambda each: -each.fit.roughly)[:AFRESH]
    supposed = (each.effect.act(baseline.lines, each.size) for each in far)
    ends = searched([problem for problem in supposed if isinstance(problem, LineProblem)])
    for each, end in zip(far, ends, strict=True):
        if end.chi2 < each.fit.chi2:
            each.fit = _on_the_same_data(baseline, end)


def _on_the_same_data(baseline: Baseline, end: FittedProblem) -> FittedProblem:
    """The fit, charged for numbers that test the rig as it is and only give inputs here: they may be of any size."""
    problem = end.problem
    taken_up = baseline.problem.rows - problem.rows - _numbers_lost(problem) + _numbers_lost(baseline.problem)
    if taken_up <= 0:
        return end
    on = problem.counted
    sizes = np.log(np.maximum(np.abs(problem.y[on]) / problem.sd[on], 1.0))
    typical = float(np.mean(sizes)) if len(sizes) else 0.0
    charged = replace(problem, given_up=problem.given_up - taken_up * (0.5 + typical))
    return replace(end, problem=charged)


def _numbers_lost(problem: FitProblem) -> int:
    """Real numbers that are left out."""
    return 0 if problem.lost is None else int(np.sum(np.isfinite(problem.lost) * problem.numbers))


def _closely(problem: FitProblem, every: Sequence[Trial], refit: Fitter) -> None:
    """Take sizes to the vertex of the parabola through χ² along their scale, with half of its curvature there.

    Of sizes that are unknowns of the problem the curvature is their own information.  Slopes tell where whole fits
    would end; of what is judged where it stands, or after a single step, the parabola goes through three sizes.
    """
    sought = [each for each in every if each.effect.width is not None and not each.effect.unknown]
    for each in sought:
        each.step = BEGUN * (each.effect.width or 0.0)
    for _ in range(ROUNDS):
        sought = (_by_slopes if refit is fitted_from_starts else _by_three)(problem, sought, refit)


def _by_slopes(problem: FitProblem, sought: Sequence[Trial], refit: Fitter) -> list[Trial]:
    """One round of `_closely` by slopes at each size; those that go on."""
    going: list[tuple[Trial, Along, float]] = []
    for each in sought:
        along = Along.of(each, problem)
        each.bend = along.bend if along.bend > 0 else each.bend
        move = float(np.clip(along.move(each.step), -3 * each.step, 3 * each.step))
        if move and (along.bend <= 0 or along.fall**2 / along.bend > SETTLED * each.scale):
            going.append((each, along, move))
    ends = refit([each.moved(problem, move, along) for each, along, move in going])
    left = []
    for (each, along, move), end in zip(going, ends, strict=True):
        lower = each.take([(each.at(move), end)])
        each.step = each.step if lower else abs(move) / 4
        # No nearer than χ² tells two sizes apart.
        if lower or (along.bend > 0 and each.step**2 * along.bend > SETTLED * each.scale):
            left.append(each)
    return left


def _by_three(problem: FitProblem, sought: Sequence[Trial], refit: Fitter) -> list[Trial]:
    """The same by fits at each size and to both sides of it."""
    sides = refit([each.moved(problem, side * each.step) for each in sought for side in (-1, 1)])
    moves = []
    for each, low, high in zip(sought, sides[::2], sides[1::2], strict=True):
        bend = (low.chi2 - 2 * each.fit.chi2 + high.chi2) / (2 * each.step**2)
        bent = np.isfinite(bend) and bend > 0
        along = Along((low.chi2 - high.chi2) / (4 * each.step), bend) if bent else Along()
        each.bend = along.bend or each.bend
        moves.append(float(np.clip(along.move(each.step), -3 * each.step, 3 * each.step)))
    nearer = refit([each.moved(problem, move) for each, move in zip(sought, moves, strict=True)])
    left = []
    for each, low, high, move, end in zip(sought, sides[::2], sides[1::2], moves, nearer, strict=True):
        before = each.fit.chi2
        lower = each.take([(each.at(-each.step), low), (each.at(each.step), high), (each.at(move), end)])
        near = 2 * float(np.sqrt(each.scale / each.bend)) if each.bend > 0 else np.inf
        settled = each.step <= near and before - each.fit.chi2 < SETTLED * each.scale
        if (not settled) if each.bend > 0 else lower:
            each.step = min(each.step, near)
            left.append(each)
    return left


def _weighed(trial: Trial, block: Ints, largest: tuple[float, float]) -> Cause | None:
    """The cause with its evidence, and that of something else, where the rig as it is leaves `largest` (`LeftOver`);
    None for a rig that cannot be built."""
    effect, size, fit = trial.effect, trial.size, trial.fit
    over = LeftOver.of(fit, block)
    likelihood = over.mended(largest)
    possible = log_possible(fit, effect.may_be_negative)
    left = 0.0
    scale = max(fit.reduced, 1.0) if np.isfinite(fit.reduced) else 1.0
    if effect.more:
        left = -0.5 * effect.more * log(max(fit.dof, 2))
    elif effect.unknown:
        size, of_priors = _of_unknowns(effect, fit, scale)
        if of_priors is None:
            return None
        left = of_priors
    elif effect.width is None:
        left = -log(len(effect.values))
    else:
        # No vaguer than the prior itself, where χ² bends too little to tell.
        sharpness = max(trial.bend / scale, 1 / effect.width**2)
        left = effect.log_prior(size) + 0.5 * log(2 * np.pi / sharpness)
    left += possible
    left += log(trial.prior * effect.share)
    return Cause(effect, size, fit, likelihood, likelihood + left, over.unlike(largest) + left, possible)


def _brought(effect: Effect, fit: FittedProblem) -> tuple[list[int], Real, Real]:
    """Places in ψ of the unknowns that an effect brings, the first its size, and the units of the scale on which each
    is sought, and its prior scale there, (unknowns,) both."""
    if not effect.unknown:
        return [], np.ones(0), np.ones(0)
    names = fit.problem.names
    chosen = [names.index(name) for name in (effect.unknown, *(name for name, _ in effect.others))]
    stretch = np.abs(fit.psi[chosen]) if effect.of_ratio or effect.others else np.ones(1)
    widths = np.array([effect.width if effect.width is not None else 1.0, *([1.0] * len(effect.others))])
    return chosen, stretch, widths


def _is_such(trial: Trial) -> bool:
    """Whether all that the effect brings is what its kind says: the others positive, a body with a resonance near the
    band, the step of a held input no less than none."""
    effect, size = trial.effect, trial.size
    low, high = effect.between
    if not effect.others:
        return low <= size <= high
    values = trial.fit.psi[_brought(effect, trial.fit)[0]]
    return bool(np.all(values > 0) and low <= values[0] / values[1] <= high)


def _of_unknowns(effect: Effect, fit: FittedProblem, scale: float) -> tuple[float, float | None]:
    """The size that is an unknown of the problem, and what the priors of all that the effect brings leave (Laplace).

    None where the data tell nothing of them.
    """
    chosen, stretch, widths = _brought(effect, fit)
    values = fit.psi[chosen]
    size = float(values[0])
    information, _, _ = fit.slopes
    if not np.all(np.isfinite(information)):
        return size, None
    covariance = scale * _inverse(information)[np.ix_(chosen, chosen)] / np.outer(stretch, stretch)
    # A posterior is no wider than its prior.
    precision = np.linalg.pinv(covariance, rcond=1e-14) + np.diag(1 / widths**2)
    left = 0.5 * (len(chosen) * log(2 * np.pi) - float(np.linalg.slogdet(precision)[1]))
    left += effect.log_prior(size) if effect.width is not None else 0.0
    for (_, likely), value in zip(effect.others, values[1:], strict=True):
        left -= log(np.pi * (1 + float(np.log(value / likely)) ** 2))
    return size, left


def _inverse(information: Real) -> Real:
    """Of information (M, M) in whatever units, 0 along what it knows nothing of."""
    diagonal = np.diag(information)
    unit = np.sqrt(np.where(diagonal > np.finfo(float).tiny, diagonal, np.inf))
    return np.linalg.pinv(information / unit / unit[:, None], rcond=1e-14) / unit / unit[:, None]


def log_possible(fit: FittedProblem, but: str = "") -> float:
    """ln of the probability that what must be positive of a rig is, as known as the fit leaves it; `but` may be not."""
    if fit.parts:
        return sum(log_possible(part, but) for part in fit.parts)
    model = fit.problem.model
    information, _, _ = fit.slopes
    if not np.all(np.isfinite(information)):
        return 0.0
    scale = max(fit.reduced, 1.0 if fit.problem.noise_known else 0.0)
    if not np.isfinite(scale):
        return 0.0
    m = len(model.unknowns)
    stiff = {element.name for element in model.elements if element.kind is Kind.SPRING}
    held = of_one_sign(model) & np.array([unknown.name != but for unknown in model.unknowns], dtype=bool)
    with np.errstate(all="ignore"):
        sd = np.sqrt(np.maximum(scale * np.diag(_inverse(information)), 0.0))
        away = np.where(sd[:m] > 0, fit.psi[:m] / sd[:m], 0.0)
    logs = log_ndtr(np.nan_to_num(away))
    springs = np.array([unknown.name in stiff for unknown in model.unknowns], dtype=bool)
    bending = float(np.logaddexp(np.sum(logs[held & springs]), log(NEGATIVE)))
    return bending + max(float(np.sum(logs[held & ~springs])), IMPOSSIBLE)


def _explained(as_is: FittedProblem, possible: float, cause: Cause, floor: float) -> float:
    """Share of the misfit that goes: of what is more than a `floor` of χ² over its degrees of freedom.

    A rig that cannot be built is a misfit, as improbable as it is.
    """
    before = max(as_is.reduced - floor, 0.0) - 2 * possible / max(as_is.dof, 1)
    after = max(cause.fit.reduced - floor, 0.0) - 2 * cause.possible / max(cause.fit.dof, 1)
    return 1 - min(after / before, 1.0) if before > 0 else 0.0


def _floor(baseline: Baseline, causes: Sequence[Cause]) -> float:
    """χ² over its degrees of freedom that is noise: 1, or where the noise is smaller, what the best fit to all data
    leaves; 0 where no noise is known."""
    if not baseline.problem.noise_known:
        return 0.0
    on_all = (cause.fit.reduced for cause in causes if cause.fit.problem.rows == baseline.problem.rows)
    return min((1.0, *on_all))  # there may be none


def indistinguishable(likelihoods: Sequence[float]) -> list[int | None]:
    """A number for each of those, by the logarithms of their likelihoods, that the data cannot tell apart."""
    found: list[list[int]] = []
    for k, likelihood in enumerate(likelihoods):
        near = (g for g in found if all(abs(likelihoods[j] - likelihood) < TOGETHER for j in g))
        group = next(near, None)
        if group is None:
            found.append([k])
        else:
            group.append(k)
    numbers = {k: number for number, group in enumerate(found, start=1) for k in group if len(group) > 1}
    return [numbers.get(k) for k in range(len(likelihoods))]


@dataclass(frozen=True)
class LeftOver:
    """ln p(data | fit), relative to the noise alone, by what is left over of the motion and how large the noise is.

    Of each channel a part ŷ a of its motion is left, a one complex number for each block of lines with a variance of
    s², in noise whose variance is v times what is known of it.  s and v are the same in all channels.

    table     (len(log_v), len(SIZES)); what numbers that were given up add is not in it
    """

    fit: FittedProblem
    log_v: Real
    table: Real

    @staticmethod
    def of(fit: FittedProblem, block: Ints) -> LeftOver:
        """Of a fit, at lines (rows,) of these blocks."""
        problem = fit.problem
        total = max(int(np.sum(problem.counted * problem.numbers)), 1)
        used = min(max(fit.dof, 1) / total, 1.0)  # of each square: unknowns and inputs have taken up the rest
        log_v = np.log(EXCESSES if problem.noise_known else np.concatenate([1 / EXCESSES[:0:-1], EXCESSES]))
        table = np.zeros((len(log_v), len(SIZES)))
        with np.errstate(over="ignore", invalid="ignore"):
            for c, number in enumerate(problem.numbers):
                table += _of_channel(fit, c, block, used * number / 2, log_v)
        return LeftOver(fit, log_v, table)

    @property
    def as_known(self) -> int:
        """Row of the table of noise that is as known."""
        return int(np.argmin(np.abs(self.log_v)))

    @property
    def largest(self) -> tuple[float, float]:
        """What is left at the most: s where noise is as known, and √v − 1 where there is no s."""
        likeliest = self.table[self.as_known]
        by_noise = np.sqrt(max(self.fit.reduced, 1.0)) - 1 if np.isfinite(self.fit.reduced) else 0.0
        return float(SIZES[int(np.argmax(np.nan_to_num(likeliest, nan=-np.inf)))]), float(by_noise)

    def mended(self, largest: tuple[float, float]) -> float:
        """ln p for a rig that is right: half of the probability for no s and for the noise that is known, the rest
        falling off, as Cauchy's do, beyond what such a rig leaves (MENDED, NOISE_KNOWN) and what an effect may leave of
        the `largest` s and √v − 1 that it is to explain (APPROXIMATE)."""
        s, excess = largest
        return self._summed(self._known(excess), _half_for(1 / (1 + SIZES / (MENDED + APPROXIMATE * s)), 0))

    def unlike(self, largest: tuple[float, float]) -> float:
        """ln p for a rig that is not: of the `largest` s, or else of the `largest` √v − 1, some part is left, one as
        likely as another, and hardly more."""
        s, excess = largest
        root = np.exp(self.log_v / 2)
        noise = root / (1 + ((root - 1) / max(excess, NOISE_KNOWN)) ** 3)
        sizes = np.maximum(SIZES, SIZES[1]) / (1 + (SIZES / max(s, SIZES[1])) ** 3)
        with np.errstate(divide="ignore"):
            none = np.log(SIZES == 0)
        by_s = self._summed(self._known(excess), np.log(sizes / np.sum(sizes)))
        by_v = self._summed(np.log(noise / np.sum(noise)), none)
        return float(np.logaddexp(by_s, by_v)) - log(2)

    def _known(self, excess: float) -> Real:
        fall = 1 / (1 + (np.expm1(self.log_v / 2) / (NOISE_KNOWN + APPROXIMATE * excess)) ** 2)
        return _half_for(fall, self.as_known)

    def _summed(self, log_of_v: Real, log_of_size: Real) -> float:
        even = _half_for(np.ones(len(self.log_v)), self.as_known)
        log_of_v = log_of_v if self.fit.problem.noise_known else even
        with np.errstate(over="ignore", invalid="ignore"):
            value = float(logsumexp(self.table + log_of_v[:, None] + log_of_size[None, :]))
            value += sum(part.problem.by_priors(part.psi) for part in self.fit.parts or (self.fit,))
            value += self.fit.problem.given_up + _of_lost(self.fit, self.log_v, even)
        return value if np.isfinite(value) else -np.inf


def _of_channel(fit: FittedProblem, c: int, block: Ints, used: float, log_v: Real) -> Real:
    """ln p of one channel for each v and s; used: the part of each of its squares that is left to test the fit by."""
    problem = fit.problem
    on = problem.counted[:, c]
    if not np.any(on):
        return np.zeros((len(log_v), len(SIZES)))
    sd, r = problem.sd[on, c], fit.residual[on, c]
    z, g = r / sd, (problem.y[on, c] - r) / sd
    number, count = np.unique(block[on], return_inverse=True, return_counts=True)[1:]

    def summed(values: Real) -> Real:
        return np.bincount(number, values, len(count)).astype(np.float64)

    energy, product = summed(np.abs(g) ** 2), np.conj(g) * z
    coherent = (summed(product.real) ** 2 + summed(product.imag) ** 2) / np.maximum(energy, 1e-300)
    rest = max(float(np.sum(np.abs(z) ** 2)) - float(np.sum(coherent)), 0.0)
    v = np.exp(log_v)[:, None]
    widened = v[:, :, None] + SIZES[None, :, None] ** 2 * energy
    table = -np.sum(np.log(widened) * used + coherent / widened, axis=-1)
    return np.asarray(table - used * (len(z) - len(count)) * log_v[:, None] - rest / v)


def _of_lost(fit: FittedProblem, log_v: Real, prior_v: Real) -> float:
    """ln p of what is left out against what it should be, in noise of any size."""
    problem = fit.problem
    if problem.lost is None:
        return 0.0
    expected = fit.expected
    out = np.isfinite(problem.lost) & np.isfinite(expected)
    if not np.array_equal(out, np.isfinite(problem.lost)):
        return roughly_lost(problem) - problem.given_up
    square = float(np.sum(np.abs((problem.lost - expected)[out] / sd_of_lost(problem)[out]) ** 2))
    return float(logsumexp(-_numbers_lost(problem) / 2 * log_v - square / np.exp(log_v) + prior_v))


def _half_for(shares: Real, k: int) -> Real:
    """Logarithms of probabilities: one half for the value at k, the rest shared by the others."""
    others = np.where(np.arange(len(shares)) == k, 0.0, shares)
    weights = 0.5 * others / np.sum(others)
    weights[k] = 0.5
    return np.log(weights)


def allowing_for_causes(model: Model, estimate: Estimate, found: Explanation) -> Estimate:
    """The estimate with intervals that allow for what its unknowns would be with each cause mended, by its odds.

    The values stay those of the rig as it is stated.  To their covariance comes, for each of the likeliest fits, whose
    odds sum to 95 %, its own covariance and the square of its distance from them, by its odds.  The engine's fit of the
    rig as it is, which weighs the lines otherwise than the estimate does, stands for what is not listed.
    """
    names, moves = estimate.names, list[tuple[float, Real, Real | float]]()
    fits: list[tuple[float, Effect | None, tuple[FittedProblem, ...]]] = [
        (cause.odds + cause.near, cause.effect, cause.fit.parts or (cause.fit,)) for cause in found.weighed
    ]
    fits.append((found.as_stated, None, (found.as_is,)))
    fits.sort(key=lambda each: -each[0])
    total = 0.0
    for odds, effect, parts in fits:
        if total >= LISTED:
            break
        total += odds
        for part in parts:
            there = part.problem.names
            if not set(names) <= set(there):
                continue
            places = [there.index(name) for name in names]
            spread: Real | float = 0.0
            if effect is not None:
                # By χ² over its degrees of freedom wider than noise gives it, where that is larger.  What the data do
                # not tell of the unknowns that the effect brings, their priors do.
                information, _, _ = part.slopes
                information = information / max(part.reduced, 1.0 if part.problem.noise_known else 0.0)
                chosen, stretch, widths = _brought(effect, part)
                information[chosen, chosen] += 1 / (stretch * widths) ** 2
                spread = scaled_inverse(information)[np.ix_(places, places)]
            moves.append((odds / len(parts), part.psi[places], spread))
    return allowing_for(model, estimate, moves)


@np.errstate(all="ignore")  # values where a search was lost may be absurd
def allowing_for(
    model: Model, estimate: Estimate, moves: Sequence[tuple[float, Real, Real | float]]
) -> Estimate:
    """The estimate with intervals that allow for other values (M,) of its unknowns, each with odds and a covariance."""
    covariance = estimate.covariance
    for odds, values, spread in moves:
        away = values - estimate.values
        added = odds * (np.outer(away, away) + spread)
        # Information of a direction that is lost in rounding has an inverse that is no covariance.
        if np.all(np.isfinite(added)) and np.all(np.diagonal(added) >= 0):
            covariance = covariance + added
    if not np.all(np.isfinite(covariance)):
        return estimate
    m = len(model.unknowns)
    modes = linear_modes(model, estimate.values[:m], covariance[:m, :m])
    return replace(estimate, covariance=covariance, basis=MISFIT, modes=modes)
