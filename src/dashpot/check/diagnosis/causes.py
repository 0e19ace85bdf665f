"""What would make a rig fit: remedies on data and rig, tried, and ranked by what they leave."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Real
from dashpot.channel import Channel, Quantity
from dashpot.check.diagnosis.contradictions import contradiction_of
from dashpot.check.diagnosis.nonlinear_elements import ENOUGH, called_for
from dashpot.check.diagnosis.ranking import ALIKE, HELPS, ORDER, Cause, cause_of, points_of, ranked
from dashpot.check.diagnosis.search import (
    DRAWS,
    FEWER_DRAWS,
    Promise,
    Workbench,
    changes,
    extended,
    missing_elements,
    promises,
    stated_values,
)
from dashpot.check.diagnosis.trials import (
    OF_FORCES,
    RATIOS,
    Likeness,
    Outcome,
    Trial,
    cells,
    conjugated,
    conjugated_line,
    exchanged,
    exchanged_lines,
    known_ratio,
    likeness,
    mistakes_of_a_channel,
    of_another_derivative,
    prepared,
    scaled,
    untested,
    untouched,
    with_form,
    with_phases_times,
    without,
)
from dashpot.check.verdict import BEYOND
from dashpot.data.spectrum import SettledDwell, Spectrum, Stretch
from dashpot.errors import DashpotError
from dashpot.estimate.inference.diagnostics import of_one_sign
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.preparation.prepared import Prepared, prepare
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.model.observation import measures_input, observation_model

# One dwell that is wrong: of another frequency, exchanged with another, with its phases the other way, or
# left out.


RELABELLED = 6.0  # χ² for each number of a dwell below which it belongs to another frequency


def bad_dwells(bench: Workbench, base: Trial, pool: Sequence[Real]) -> list[Cause]:
    """Each dwell left out; of the one that helps most, what else may be wrong with it.

    None where the lines are those of a record, not of dwells.
    """
    lines = len(base.y)
    if not bench.lines_are_runs or lines <= 3:
        return []
    worst = np.argsort(-np.min([bench.misfit(psi, base) for psi in pool], axis=0))[:40]
    chosen = sorted(worst.tolist())
    labels = [f"{frequency:g} Hz" for frequency in bench.data.spectrum.frequency_hz]
    trials = [without(base, "dwell", (labels[line],), cells(base.kept, line=line)) for line in chosen]
    outcomes = bench.refitted(trials, pool)
    best = int(np.argmin([outcome.reduced for outcome in outcomes]))
    line, without_it = chosen[best], outcomes[best]
    causes_found = [cause_of(outcome) for outcome in outcomes]
    # The harmonics of a nonlinear rig go with the frequency of their dwell.
    if not len(bench.data.model.nonlinear):
        number, left = bench.other_frequency(without_it.psi, base, line)
        if left < RELABELLED * base.y.shape[1] * 2:
            causes_found.append(Cause("frequency", without_it.trial.of, without_it.reduced, number))
        causes_found += _exchanged(bench, base, line, labels, without_it, pool)
    # The dwell with all phases the other way, where that explains as much as leaving it out
    turned = conjugated_line(base, "conjugate", without_it.trial.of, line)
    (end,) = bench.refitted([turned], [without_it.psi])
    return [*causes_found, *([cause_of(end)] if end.reduced < ALIKE * max(without_it.reduced, 1.0) else [])]


def _exchanged(
    bench: Workbench, base: Trial, line: int, labels: Sequence[str], without_it: Outcome, pool: Sequence[Real]
) -> list[Cause]:
    """The labels of the dwell and of another one exchanged, where that explains more than leaving the one out."""
    others = [k for k in range(len(labels)) if labels[k] != labels[line]]
    trials = [
        exchanged_lines(base, "frequency", tuple(labels[i] for i in sorted((k, line))), k, line)
        for k in others
    ]
    best = min(bench.refitted(trials, [*pool, without_it.psi]), key=lambda outcome: outcome.reduced)
    return [replace(cause_of(best), number=None)] if best.reduced < HELPS * without_it.reduced else []


# Cross-talk: a part of one channel's signal that another shows as well.


LEAST, MOST = 1e-4, 1.0  # shares of the other channel's rms over its own: what is looked for
FOLLOWED = 2  # pairs whose share is found closely
STEP = 0.2  # of a share, to both sides of it


def cross_talk(
    bench: Workbench, base: Trial, without_one: Sequence[Outcome], pool: Sequence[Real]
) -> list[Outcome]:
    """Trials with a part of one channel taken out of another, each fitted; `without_one`: fits without each channel."""
    trials = []
    for c, outcome in enumerate(without_one):
        away = np.where(base.kept[:, c], base.y[:, c] - bench.expected(outcome)[:, c], 0.0)
        variance = base.V[:, c, c].real
        weight = 1 / variance if np.all(variance > 0) else np.ones(len(variance))
        power = weight @ np.abs(base.y) ** 2
        shared = weight @ (np.conj(base.y) * away[:, None]).real
        for other in np.flatnonzero(power > 0).tolist():
            share = float(shared[other] / power[other])
            # With no power of its own a channel is left out, and has no share of another to be rid of.
            relative = abs(share) * np.sqrt(power[other] / power[c]) if power[c] > 0 else np.inf
            if other != c and LEAST < relative < MOST:
                trials.append(_cleared(bench, base, c, other, share))
    outcomes = bench.refitted(trials, pool)
    best = sorted(outcomes, key=lambda outcome: outcome.reduced)[:FOLLOWED]
    return [_closer(bench, base, outcome) for outcome in best]


def _closer(bench: Workbench, base: Trial, outcome: Outcome) -> Outcome:
    """The share at the vertex of the parabola through χ² at three of them; the outcome's where that is not lower."""
    names = [channel.name for channel in bench.view.channels]
    c, other = (names.index(name) for name in outcome.trial.of)
    share, step = outcome.trial.value, STEP * outcome.trial.value
    beside = [_cleared(bench, base, c, other, share + side * step) for side in (-1, 1)]
    low, high = (end.chi2 for end in bench.refitted(beside, [outcome.psi]))
    bend = low - 2 * outcome.chi2 + high
    if not (np.isfinite(bend) and bend > 0):
        return outcome
    nearer = _cleared(bench, base, c, other, share + 0.5 * step * (low - high) / bend)
    (end,) = bench.refitted([nearer], [outcome.psi])
    return min(outcome, end, key=lambda one: one.chi2)


def _cleared(bench: Workbench, base: Trial, c: int, other: int, share: float) -> Trial:
    """Channel `c` without `share` times another."""
    mixing = np.eye(base.y.shape[1])
    mixing[c, other] = -share
    names = [channel.name for channel in bench.view.channels]
    of = (names[c], names[other])
    # The other's noise, times a small share, is left out.
    return replace(base, kind="crosstalk", of=of, value=share, y=base.y @ mixing.T)


# Dwells of the largest motion: where one contradicts all others, it may be the only one that shows a
# nonlinear law.


OF_A_DWELL = ("dwell", "frequency")  # kinds of causes
LOUD = 0.7  # of the largest amplitude of a channel


def at_loud_dwells(bench: Workbench, candidates: Sequence[Cause]) -> list[Cause]:
    """The causes that are of a single dwell in which a channel of the motion is about as large as in any."""
    view, Y = bench.view, np.nan_to_num(np.abs(bench.data.spectrum.amplitudes[0]))
    moves = [c for c, channel in enumerate(view.channels) if not measures_input(bench.data.model, channel)]
    size = Y[:, moves] / view.omega[:, None] ** view.derivative[moves]
    loudest = np.any(size > LOUD * np.max(size, axis=0), axis=1)
    loud = {f"{frequency:g} Hz" for frequency in bench.data.spectrum.frequency_hz[loudest]}
    return [cause for cause in candidates if cause.kind in OF_A_DWELL and not loud.isdisjoint(cause.of)]


def beside_loud_dwells(
    candidates: Sequence[Cause], doubtful: Collection[Cause], nonlinear: Sequence[Cause]
) -> list[Cause]:
    """All of the candidates but the `doubtful` ones that a nonlinear element explains about as well, and `nonlinear`.

    The element keeps all dwells as they were labelled.  One that explains no more than a single dwell does in which
    little moves, and which is therefore not doubtful, is none.
    """
    quiet = [c.remaining for c in candidates if c.kind in OF_A_DWELL and c.of and c not in doubtful]
    bad_dwell = min(quiet, default=np.inf)
    called_for = [c for c in nonlinear if bad_dwell >= ALIKE * max(c.remaining, 1.0)]
    left = min((cause.remaining for cause in called_for), default=np.inf)
    kept = [c for c in candidates if not (c in doubtful and left < ALIKE * max(c.remaining, 1.0))]
    return [*kept, *called_for]


# Two channels that are wrong at once, each with another sign or in another unit: neither mends the fit
# alone.


FACTORS = (-1.0, 1e3, 1e-3, 9.80665, 1 / 9.80665, 2**0.5, 0.5**0.5)  # that a channel reads


def two_channels(bench: Workbench, base: Trial, pool: Sequence[Real], most: float) -> list[Cause]:
    """The best two, where all motion is seen: each trial has then a start of its own; [] elsewhere.

    most: χ² per degree of freedom that they may leave, for two of so many explain a part of anything.
    Motions are blamed before inputs: with all signs turned the fit is the same.
    """
    model, channels = bench.data.model, bench.view.channels
    if bench.data.states is None or len(channels) > 8:
        return []
    order = sorted(range(len(channels)), key=lambda c: measures_input(model, channels[c]))
    trials, members = [], []
    for pair in combinations(order, 2):
        for factors in product(FACTORS, repeat=2):
            trial, both = base, []
            for c, factor in zip(pair, factors, strict=True):
                kind = "sign" if factor < 0 else "unit"
                trial = scaled(trial, kind, channels[c].name, c, 1 / factor, factor)
                both.append((kind, channels[c].name, factor))
            trials.append(trial)
            members.append(both)
    outcomes = bench.refitted(trials, pool)
    best = min(range(len(outcomes)), key=lambda k: round(outcomes[k].reduced, 6))
    left = outcomes[best].reduced
    parts = tuple(Cause(kind, (name,), left, factor) for kind, name, factor in members[best])
    if not left < most:
        return []
    return [Cause("two", tuple(name for part in parts for name in part.of), left, parts=parts)]


# A rig that is not the same in all runs: one part of them fits one rig, the rest another.
#
# Both parts are fitted by themselves. Where each then shows little but noise, the difference of the two
# sets of parameters is laid to the one part of the rig that explains most of it.


MOST_GROUPS = 24  # ways to part the runs that are tried
FOLLOWED_RUN_GROUPS = 3  # of them that are fitted closely
SPARE = 1.5  # real numbers for each unknown that a part must have
EXPLAINED = 0.8  # part of the difference that one part of the rig must explain to be named


@dataclass(frozen=True)
class RunGroups:
    """Runs in two groups that show different rigs.

    where     the second group in words
    element   what differs, None where no one part of the rig explains it
    step      of its parameter, from the other runs to these; None where there is no such element
    chi2, dof of both groups together, each fitted by itself
    """

    where: str
    element: Element | None
    step: float | None
    chi2: float
    dof: int


def run_groups(bench: Workbench, base: Trial, pool: Sequence[Real]) -> RunGroups | None:
    """The two groups of runs that fit, each by itself or one with a part otherwise; None where no two do."""
    parted = _partings(bench, base)
    if not parted:
        return None
    first = bench.refitted([_part(base, where, ~lines) for where, _, lines in parted], pool)
    second = bench.refitted([_part(base, where, lines) for _, where, lines in parted], pool)
    likely = np.argsort([a.chi2 + b.chi2 for a, b in zip(first, second, strict=True)])[
        :FOLLOWED_RUN_GROUPS
    ].tolist()
    near = [outcome.psi for k in likely for outcome in (first[k], second[k])]
    again = bench.refitted([outcome.trial for k in likely for outcome in (first[k], second[k])], near)
    pairs = list(zip(again[::2], again[1::2], strict=True))
    best = min(pairs, key=lambda pair: pair[0].chi2 + pair[1].chi2)
    if best[0].chi2 + best[1].chi2 < ENOUGH * (best[0].dof + best[1].dof):
        return _with_what_differs(bench, *best)
    both_ways = (*zip(first, second, strict=True), *zip(second, first, strict=True))
    fitting = sorted((pair for pair in both_ways if pair[0].reduced < ENOUGH), key=lambda pair: -pair[0].dof)
    otherwise = [_one_part_otherwise(bench, *pair) for pair in fitting[:FOLLOWED_RUN_GROUPS]]
    fits = [groups for groups in otherwise if groups is not None and groups.chi2 < ENOUGH * groups.dof]
    return min(fits, key=lambda groups: groups.chi2 / groups.dof, default=None)


def _one_part_otherwise(bench: Workbench, fitting: Outcome, other: Outcome) -> RunGroups | None:
    """The groups, the other one with a stated value otherwise or a part that the rig lacks; None if there is none."""
    rest = Workbench(prepared(bench.data, other.trial), fitting.psi, bench.sign)
    best = min(changes(rest, fitting.psi), key=lambda change: change.chi2, default=None)
    if best is None:
        return None
    stated = next((e.value for e in bench.data.model.elements if e.name == best.element.name), 0.0)
    step = best.number - (0.0 if stated is None else stated)
    (where,) = other.trial.of
    return RunGroups(where, best.element, step, fitting.chi2 + best.chi2, fitting.dof + best.dof)


def _partings(bench: Workbench, base: Trial) -> list[tuple[str, str, Bools]]:
    """Two groups in words, and the second as lines: each experiment; what follows each run, in the data's order."""
    spectrum = bench.data.spectrum
    experiments = np.unique(spectrum.experiment)
    parted = []
    if 1 < len(experiments) <= MOST_GROUPS:
        for number in experiments.tolist():
            parted.append(
                (f"all runs but experiment {number}", f"experiment {number}", spectrum.experiment == number)
            )
    order = np.arange(spectrum.lines)
    ends = np.unique(np.linspace(1, spectrum.lines - 1, MOST_GROUPS).astype(int)).tolist()
    for k in ends if bench.lines_are_runs and spectrum.lines > 1 else ():
        before, on = (f"{spectrum.frequency_hz[line]:g} Hz" for line in (k - 1, k))
        parted.append((f"the runs up to {before}", f"the runs from {on} on", order >= k))
    least = SPARE * len(bench.psi)
    numbers = 2 * np.sum(base.kept, axis=1) - 2 * len(bench.data.model.inputs)
    return [
        (first, second, lines)
        for first, second, lines in parted
        if np.sum(numbers[lines]) > least and np.sum(numbers[~lines]) > least
    ]


def _part(base: Trial, where: str, lines: Bools) -> Trial:
    """The data of some lines alone."""
    return without(base, "changed", (where,), np.broadcast_to(~lines[:, None], base.y.shape))


def _with_what_differs(bench: Workbench, first: Outcome, second: Outcome) -> RunGroups:
    """The groups with the one part of the rig that explains the difference of their parameters."""
    (where,) = second.trial.of
    chi2, dof = first.chi2 + second.chi2, first.dof + second.dof
    model = bench.data.model
    sign = bench.sign[None]
    at_first = local(bench.view, measured(prepared(bench.data, first.trial)), first.psi[None], sign)
    elements = [*missing_elements(model), *stated_values(model)]
    larger, start = extended(bench, second.psi, elements)
    larger = prepared(larger, second.trial)
    at_second = local(larger.view, measured(larger), start[None], sign)
    names = list(larger.view.names)
    free = [names.index(name) for name in bench.view.names]
    information = at_second.symmetric[0]
    inverse = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-12)
    inverse_first = np.linalg.pinv(at_first.symmetric[0], rcond=1e-12)
    # What moves the parameters of the second group: one of them, or what the rig has not got or takes as known.
    moves = {name: np.eye(len(free))[j] for j, name in enumerate(bench.view.names)}
    moves |= {e.name: inverse @ information[free, names.index(e.name)] for e in elements}
    difference = second.psi - first.psi
    weight = np.linalg.pinv(inverse + inverse_first, rcond=1e-12)
    whole = float(difference @ weight @ difference)
    listed = []
    for name, move in moves.items():
        strength = float(move @ weight @ move)
        if strength > 0 and np.isfinite(strength):
            step = float(move @ weight @ difference) / strength
            listed.append((step**2 * strength, step, name))
    by_name = {e.name: e for e in (*model.elements, *elements)}
    explained, step, name = max(listed, default=(0.0, 0.0, ""))
    if not explained > EXPLAINED * whole or name not in by_name:
        return RunGroups(where, None, None, chi2, dof)
    return RunGroups(where, by_name[name], float(step), chi2, dof)


# Whether a rig as a trial's fit has it can be built: parts that are negative beyond doubt cannot.


def negative_parts(bench: Workbench, outcome: Outcome) -> Bools:
    """Parts of the rig that are negative beyond doubt where a trial ended, (unknowns,).

    Where the noise is not known, or the trial leaves more than noise, deviations are as large as the residuals say.
    """
    model, data = bench.data.model, prepared(bench.data, outcome.trial)
    with np.errstate(all="ignore"):
        at = local(bench.view, measured(data), outcome.psi[None], bench.sign[None])
        sd = np.sqrt(np.diagonal(at.inverse[0]))[: bench.view.m]
    scale = outcome.reduced**0.5
    if bench.data.noise_known:
        scale = max(1.0, scale)
    return (outcome.psi[: bench.view.m] < -BEYOND * scale * sd) & of_one_sign(model)


# Channels whose gain and delay are to be found, and the unknowns at which they are as stated.


def with_open_calibrations(model: Model, spectrum: Spectrum) -> tuple[tuple[Channel, ...], tuple[str, ...]]:
    """The channels with gain and delay to be found where they have noise, and the names of inputs that have none."""
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    noisy = np.any(variance.reshape(-1, len(spectrum.channels)) > 0, axis=0).tolist()
    channels = tuple(
        replace(channel, gain=None, delay=None) if heard and channel.same_gain_as is None else channel
        for channel, heard in zip(spectrum.channels, noisy, strict=True)
    )
    exact = [
        c.name
        for c, heard in zip(spectrum.channels, noisy, strict=True)
        if not heard and measures_input(model, c)
    ]
    return channels, tuple(exact)


def as_stated(names: Sequence[str], known: Mapping[str, float]) -> Real:
    """ψ (M,) by `names`: what is `known`, the gain 1 and the delay 0 elsewhere, and 0 for what else was added."""
    return np.array([known.get(name, 1.0 if name.endswith(".gain") else 0.0) for name in names])


# Tests of a fit that point at one thing: the gain or delay of a channel, an element between two points
# (THEORY §11).
#
# χ² spreads what it finds over all amplitudes; a score test looks along one column, projected out of what
# the rig's own unknowns can do, and finds a tenth of the misfit that χ² needs. All columns come from one
# evaluation of the likelihood.


LEVEL = 1e-3  # of all directions together: one clean test in a thousand
APART = 0.03  # part of a column that the rig's own unknowns must leave
LARGEST = 12  # coordinates
MOST_AMPLITUDES = 20_000
MOST_DIRECTED = 3  # causes that are named


def directed_causes(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Cause]:
    """What of a fit that χ² passes is off beyond doubt, the clearest first; [] where nothing is, or no noise is known.

    Each direction is tested by itself beside the rig's unknowns, at LEVEL over their number.
    """
    settled = all(isinstance(stretch, SettledDwell) for stretch in spectrum.stretches)
    small = model.n <= LARGEST and spectrum.amplitudes.size <= MOST_AMPLITUDES
    able = settled and small and not len(model.nonlinear) and estimate.fit.known_noise
    if not able or not bool(estimate.converged) or estimate.fit.dof < 1:
        return []
    elements = missing_elements(model)
    extended = replace(model, elements=(*model.elements, *elements))
    channels, exact_inputs = with_open_calibrations(model, spectrum)
    try:
        data = prepare(extended, replace(spectrum, channels=channels, moments=None), states=False)
        exact = measured(data)
    except DashpotError:
        return []  # channels that contradict each other, say
    view = data.view
    known = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    (sign,) = spectrum.signs(estimate.signs)
    added = set(view.names) - known.keys()
    # An input without noise is late where all that it moves is early.
    together = {
        f"{exact_inputs[0]}.{word}": [name for name in added if name.endswith(f".{word}")]
        for word in ("gain", "delay")
        if len(exact_inputs) == 1
    }
    # Where the noise was estimated, χ² scatters as much more as the intervals are wider.
    with np.errstate(invalid="ignore", divide="ignore"):
        widened = float(np.nanmax(np.append((estimate.noise_sd / estimate.bound_sd) ** 2, 1.0)))
    tested = promises(view, exact, as_stated(view.names, known), sign, added, APART, together)
    certain = [
        promise for promise in tested if float(chdtrc(1, promise.fall / widened)) * len(tested) < LEVEL
    ]
    certain.sort(key=lambda promise: -promise.fall)
    return [
        _cause(promise, promise.name in together, estimate, elements) for promise in certain[:MOST_DIRECTED]
    ]


def _cause(promise: Promise, opposite: bool, estimate: Estimate, elements: Sequence[Element]) -> Cause:
    """The cause that a direction stands for, and χ² per degree of freedom with it."""
    name, step = promise.name, -promise.step if opposite else promise.step
    remaining = (promise.chi2 - promise.fall) / max(estimate.fit.dof - 1, 1)
    channel, _, calibration = name.rpartition(".")
    if channel and calibration == "gain":
        return Cause("gain", (channel,), remaining, 1.0 + step)
    if channel and calibration == "delay":
        return Cause("delay", (channel,), remaining, step)
    element = next(candidate for candidate in elements if candidate.name == name)
    points = tuple(element.along)
    return Cause(
        "element", points if len(points) > 1 else (*points, "ground"), remaining, step, element=element
    )


GAINS = tuple(np.exp(np.linspace(np.log(0.4), np.log(2.5), 11)))
DELAYS = (-0.4, -0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2, 0.4)  # periods of the highest frequency
OF_SAMPLES = {"white", "blocks", "periods"}  # kinds of noise that were read from samples
# What is left out explains little.
PARTICULAR = tuple(kind for kind in ORDER if kind not in ("dwell", "mode", "channel"))
# Runs that differ in amplitude may differ because of a nonlinear element.
SURER = tuple(kind for kind in PARTICULAR if kind != "changed")
RATES = (2 * np.pi, 1 / (2 * np.pi), 2.0, 0.5, 60.0, 1 / 60)
OF_ITS_OWN = 0.01  # part of the column of a gain or a delay that the rig's own unknowns must leave
SLIGHT = 0.5  # change of a gain by which its score is followed
GROSS = 0.02  # part of the misfit that a gross mistake leaves, beside which nothing finer is looked for
BY_CHANCE = 5.0  # standard deviations by which noise alone may leave more
RADIANS = 180 / np.pi  # times which phases are radians that were read as degrees
SIGN = Likeness(-1.0, 0, 0.0, False, 0.0)


def causes(bench: Workbench, silent: Mapping[str, str], seed: int = 0) -> tuple[float, list[Cause]]:
    """χ² per degree of freedom of the data as they are, and what would lower it to a half at least, the best first.

    silent: of channels that measured nothing by their own numbers, what they show: of them no gain or sign can be told.
    """
    base = untouched(bench.data)
    channels = [channel.name for channel in bench.view.channels]
    dropped = [
        without(base, "channel", (name,), cells(base.kept, column=c)) for c, name in enumerate(channels)
    ]
    # An input's channel with the other sign or in another unit: leaving it out tells little of the rig. Where
    # not all motion is seen, all phases the other way as well: no regression leads to that rig.
    trials = [] if bench.data.states is not None else _turned(bench, base)
    for c, channel in enumerate(bench.view.channels):
        if measures_input(bench.data.model, channel):
            trials.append(scaled(base, "sign", channel.name, c, -1.0, -1.0))
            trials += [scaled(base, "unit", channel.name, c, 1 / ratio, ratio) for ratio in RATIOS[:4]]
    searched = bench.searched([base, *dropped, *trials], seed)
    as_is, without_one, inputs = searched[0], searched[1 : len(channels) + 1], searched[len(channels) + 1 :]
    pool = [outcome.psi for outcome in searched]
    candidates = _left_out(bench, base, without_one, silent)
    candidates += [cause_of(outcome) for outcome in inputs]
    candidates += _mended_channels(bench, base, without_one, pool)
    usual = [*_rearranged(bench, base, channels), *_usual_mistakes(bench, base)]
    otherwise = bench.refitted(usual, pool)
    candidates += [cause_of(outcome) for outcome in otherwise]
    if not _explained(candidates, ORDER[: ORDER.index("gain") + 1]):
        candidates += _slightly_off(bench, base, as_is, pool)
    candidates += bad_dwells(bench, base, pool)
    candidates += _of_another_rig(bench, as_is)
    positive = _of_possible_parts(bench, as_is, [*inputs, *otherwise])
    candidates += positive
    # Where one dwell alone is wrong, neither the time base nor the amplitude is to blame.
    if not _explained(candidates, (*ORDER[: ORDER.index("frequency")], "dwell")):
        candidates += _rates(bench, base, seed)
    noise = max(_by_chance(as_is), GROSS * as_is.reduced)
    if not _explained(candidates, (*PARTICULAR, "dwell"), noise):
        candidates += _unusual_mistakes(bench, base, without_one, otherwise, pool, noise, seed)
    candidates = _with_nonlinear(bench, as_is, candidates)
    inputs_alone = {each.name for each in bench.view.channels if measures_input(bench.data.model, each)}
    by_chance = _by_chance(as_is) if bench.data.noise_known else np.inf
    impossible = _impossible_signs(bench, as_is, [*inputs, *otherwise])
    sensible = [each for each in candidates if each.shows or silent.keys().isdisjoint(each.of)]
    best = ranked(
        sensible, as_is.reduced, inputs_alone, noise=by_chance, surely=positive, impossible=impossible
    )
    return as_is.reduced, _with_contradictions(bench, base, best, without_one)


def _with_contradictions(
    bench: Workbench, base: Trial, ranked_causes: Sequence[Cause], without_one: Sequence[Outcome]
) -> list[Cause]:
    """The causes, channels that contradict the others with how they do."""
    by_name = {outcome.trial.of: (c, outcome) for c, outcome in enumerate(without_one)}
    return [
        replace(cause, contradiction=contradiction_of(bench, base, *by_name[cause.of]))
        if cause.kind == "channel" and not (cause.shows or cause.untested)
        else cause
        for cause in ranked_causes
    ]


def _left_out(
    bench: Workbench, base: Trial, outcomes: Sequence[Outcome], silent: Mapping[str, str]
) -> list[Cause]:
    """Each channel left out, with what it shows if it measured nothing."""
    return [
        replace(
            cause_of(outcome),
            untested=untested(bench.view, base, outcome.trial),
            shows=silent.get(outcome.trial.of[0], ""),
        )
        for outcome in outcomes
    ]


def _explained(candidates: Sequence[Cause], kinds: Sequence[str], noise: float = ENOUGH) -> bool:
    """Whether one of these kinds leaves little more than noise."""
    return any(cause.remaining < noise and cause.kind in kinds for cause in candidates)


def _of_possible_parts(bench: Workbench, as_is: Outcome, outcomes: Sequence[Outcome]) -> list[Cause]:
    """What fits as well with parts that are all possible, where some of the rig as it is are negative beyond doubt.

    Phases that count the other way, or a channel in another unit, may leave χ² as it is.
    """
    limit = _by_chance(as_is) if bench.data.noise_known else ALIKE * as_is.reduced
    if as_is.reduced > limit or not np.any(negative_parts(bench, as_is)):
        return []
    return [
        cause_of(outcome)
        for outcome in outcomes
        if outcome.reduced < limit and not np.any(negative_parts(bench, outcome))
    ]


def _impossible_signs(bench: Workbench, as_is: Outcome, outcomes: Sequence[Outcome]) -> set[str]:
    """Channels of which the other sign helps, but makes parts of the rig negative.

    Of two motions either may be turned, but for the force that then counts backwards.
    """
    return {
        outcome.trial.of[0]
        for outcome in outcomes
        if outcome.trial.kind == "sign"
        and outcome.reduced < HELPS * as_is.reduced
        and np.any(negative_parts(bench, outcome))
    }


def _by_chance(as_is: Outcome) -> float:
    """χ² per degree of freedom that noise alone hardly exceeds."""
    return float(1 + BY_CHANCE * (2 / max(as_is.dof, 1)) ** 0.5)


def _with_nonlinear(bench: Workbench, as_is: Outcome, candidates: list[Cause]) -> list[Cause]:
    """The candidates with the nonlinear elements that the dwells call for, where nothing surer explains the misfit."""
    doubtful = at_loud_dwells(bench, candidates)
    certain = [cause for cause in candidates if cause not in doubtful]
    enough = max(ENOUGH, GROSS * as_is.reduced)
    if _explained(certain, (*SURER, "dwell"), enough) or not np.all(np.isfinite(as_is.psi)):
        return candidates
    thorough = not _explained(doubtful, OF_A_DWELL, enough)
    nonlinear = [
        Cause(
            "nonlinear",
            points_of(scored.element, bench.data.model),
            (scored.chi2 - scored.fall) / scored.dof,
            scored.value,
            element=scored.element,
        )
        for scored in called_for(bench.data, as_is.psi, bench.sign, thorough=thorough)
    ]
    return beside_loud_dwells(candidates, doubtful, nonlinear)


def _of_another_rig(bench: Workbench, as_is: Outcome) -> list[Cause]:
    """A missing element, a stated value that is wrong."""
    return [
        Cause(
            change.kind,
            points_of(change.element, bench.data.model),
            change.reduced,
            change.number,
            element=change.element,
        )
        for change in changes(bench, as_is.psi)
    ]


def _unusual_mistakes(
    bench: Workbench, base: Trial, without_one: Sequence[Outcome], otherwise: Sequence[Outcome],
    pool: Sequence[Real], noise: float, seed: int,
) -> list[Cause]:  # fmt: skip
    """Cross-talk, a rig that changed between runs, two wrong channels, and exchanged channels searched afresh.

    From where the channels as they are led, the way to the rig of two exchanged ones can be too long; where not all is
    seen, so can that of a channel, or all phases, with the other sign, or that of another derivative.
    """
    kinds = ("swap",) if bench.data.states is not None else ("swap", "sign", "conjugate", "quantity")
    far = sorted((each for each in otherwise if each.trial.kind in kinds), key=lambda each: each.reduced)
    # pairs of channels, the most hopeful, searched afresh where nothing explains the misfit
    afresh = bench.searched([each.trial for each in far[:6]], seed)
    outcomes = [*cross_talk(bench, base, without_one, pool), *afresh]
    # A part of the rig that is not the same in all runs, where two groups of them fit each by itself
    groups = run_groups(bench, base, pool)
    if groups is None:
        changed = []
    else:
        of = () if groups.element is None else points_of(groups.element, bench.data.model)
        left = groups.chi2 / groups.dof
        changed = [Cause("changed", of, left, groups.step, element=groups.element, where=groups.where)]
    return [
        *(cause_of(outcome) for outcome in outcomes),
        *changed,
        *two_channels(bench, base, pool, noise),
    ]


def _usual_mistakes(bench: Workbench, base: Trial) -> list[Trial]:
    """Each channel with its sign or its phases turned, in another unit, with another gain, earlier or later."""
    omega = bench.view.omega
    period = 2 * np.pi / np.max(omega)
    trials = []
    for c, channel in enumerate(bench.view.channels):
        name = channel.name
        trials += mistakes_of_a_channel(base, channel, c, omega)
        trials += [scaled(base, "gain", name, c, 1 / gain, gain) for gain in GAINS]
        for delay in (part * period for part in DELAYS):
            trials.append(
                scaled(base, "delay", name, c, np.exp(1j * omega * delay).astype(np.complex128), delay)
            )
    channels = bench.view.channels
    motions = [c for c, channel in enumerate(channels) if not measures_input(bench.data.model, channel)]
    return trials + of_another_derivative(base, channels, motions, omega)


def _slightly_off(bench: Workbench, base: Trial, as_is: Outcome, pool: Sequence[Real]) -> list[Cause]:
    """Gains and delays between those that are usual, each as large as its score says, at the best fit and again."""
    steps = _calibration_steps(bench, bench.data, as_is.psi)
    trials = [_recalibrated(bench, base, name, word, step) for (name, word), step in steps.items()]
    outcomes = bench.refitted(trials, pool)
    again = []
    for (name, word), outcome in zip(steps, outcomes, strict=True):
        step = _calibration_steps(bench, prepared(bench.data, outcome.trial), outcome.psi).get(
            (name, word), 0.0
        )
        first = outcome.trial.value
        value = first + step if word == "delay" else first * (1.0 + step) - 1.0
        again.append(_recalibrated(bench, base, name, word, value))
    return [cause_of(outcome) for outcome in bench.refitted(again, [outcome.psi for outcome in outcomes])]


def _recalibrated(bench: Workbench, base: Trial, name: str, word: str, step: float) -> Trial:
    """One channel with a delay of `step` s, or with a gain of 1 + `step`."""
    column = [channel.name for channel in bench.view.channels].index(name)
    if word == "delay":
        late = np.exp(1j * bench.view.omega * step).astype(np.complex128)
        return scaled(base, word, name, column, late, step)
    return scaled(base, word, name, column, 1 / (1.0 + step), 1.0 + step)


def _calibration_steps(bench: Workbench, data: Prepared, psi: Real) -> dict[tuple[str, str], float]:
    """By channel and "gain" or "delay", the step that its score promises at the best fit ψ (M,) of one repeat."""
    channels, _ = with_open_calibrations(data.model, data.spectrum)
    view = observation_model(data.model, channels, data.view.omega)
    added = set(view.names) - set(data.view.names)
    if not added or not np.all(np.isfinite(psi)):
        return {}
    opened = replace(data, view=view, spectrum=replace(data.spectrum, channels=channels), states=None)
    start = as_stated(view.names, dict(zip(data.view.names, psi.tolist(), strict=True)))
    steps = {}
    for promise in promises(view, measured(opened), start, bench.sign, added, OF_ITS_OWN):
        name, _, word = promise.name.rpartition(".")
        if word == "delay" or abs(promise.step) < SLIGHT:
            steps[name, word] = promise.step
    return steps


def _mended_channels(
    bench: Workbench, base: Trial, without_one: Sequence[Outcome], pool: Sequence[Real]
) -> list[Cause]:
    """Each channel that the others contradict, put right by the simplest relation to what they expect of it."""
    omega = bench.view.omega
    trials, relations = [], []
    for c, outcome in enumerate(without_one):
        expected = bench.expected(outcome)[:, c]
        relation = likeness(base.y[:, c], expected, omega, base.kept[:, c])
        force = bench.view.channels[c].quantity is Quantity.FORCE
        for form in (SIGN, *([] if relation is None else relation.rounded())):
            if force and form.kind == "unit" and known_ratio(form.number) not in OF_FORCES:
                continue
            trials.append(with_form(base, bench.view.channels[c].name, c, form, omega))
            relations.append(form)
    return [
        Cause(form.kind, outcome.trial.of, outcome.reduced, form.found, form)
        for outcome, form in zip(bench.refitted(trials, pool), relations, strict=True)
    ]


def _turned(bench: Workbench, base: Trial) -> list[Trial]:
    """All phases the other way; [] where samples gave them."""
    if set(bench.data.spectrum.noise) <= OF_SAMPLES:
        return []
    return [conjugated(base, "conjugate", (), np.ones(base.y.shape[1], dtype=bool))]


def _rearranged(bench: Workbench, base: Trial, channels: Sequence[str]) -> list[Trial]:
    """All phases turned or in radians, two channels swapped; the phases of samples are as they should be."""
    trials = []
    if not set(bench.data.spectrum.noise) <= OF_SAMPLES:
        trials += _turned(bench, base)
        if np.max(np.abs(np.angle(base.y[base.kept])), initial=0.0) < 1.01 * np.pi / RADIANS:
            trials.append(with_phases_times(base, "unit", RADIANS))
    return trials + exchanged(base, channels)


def _at_rate(stretch: Stretch, rate: float) -> Stretch:
    """A settled dwell of another frequency; whole records keep theirs."""
    if not isinstance(stretch, SettledDwell) or stretch.fundamental_hz is None:
        return stretch
    return replace(stretch, fundamental_hz=rate * stretch.fundamental_hz)


def _rates(bench: Workbench, base: Trial, seed: int) -> list[Cause]:
    """All frequencies times one factor: rad/s for Hz, a time base that is twice too fast."""
    spectrum = bench.data.spectrum
    relabelled = []
    for rate in RATES:
        stretches = tuple(_at_rate(stretch, rate) for stretch in spectrum.stretches)
        shifted = replace(spectrum, frequency_hz=spectrum.frequency_hz * rate, stretches=stretches)
        view = observation_model(bench.data.model, spectrum.channels, shifted.omega)
        seen = bench.data.states is not None
        states = states_if_seen(view, shifted, bench.data.covariance) if seen else None
        data = replace(bench.data, view=view, spectrum=shifted, states=states)
        # What all coordinates show gives a start that drawn rigs hardly better.
        draws = FEWER_DRAWS if seen else DRAWS
        outcome = Workbench(data, bench.psi, bench.sign).searched([base], seed, draws)[0]
        relabelled.append(Cause("frequency", (), outcome.reduced, rate))
    return relabelled
