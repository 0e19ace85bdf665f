"""What would make a rig fit: remedies on data and rig, tried, and ranked by what they leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.check.diagnosis.bad_dwells import bad_dwells
from dashpot.check.diagnosis.contradictions import contradiction_of
from dashpot.check.diagnosis.crosstalk import cross_talk
from dashpot.check.diagnosis.likeness import OF_FORCES, RATIOS, Likeness, known_ratio, likeness
from dashpot.check.diagnosis.loud_dwells import OF_A_DWELL, at_loud_dwells, beside_loud_dwells
from dashpot.check.diagnosis.nonlinear_elements import ENOUGH, called_for
from dashpot.check.diagnosis.open_calibrations import as_stated, with_open_calibrations
from dashpot.check.diagnosis.possible_parts import negative_parts
from dashpot.check.diagnosis.ranking import ALIKE, HELPS, ORDER, Cause, cause_of, points_of, ranked
from dashpot.check.diagnosis.rig_changes import changes
from dashpot.check.diagnosis.run_groups import run_groups
from dashpot.check.diagnosis.score_test import promises
from dashpot.check.diagnosis.search import DRAWS, FEWER_DRAWS, Workbench
from dashpot.check.diagnosis.trials import (
    Outcome,
    Trial,
    cells,
    conjugated,
    exchanged,
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
from dashpot.check.diagnosis.two_channels import two_channels
from dashpot.data.stretch import SettledDwell, Stretch
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.observation import measures_input, observation_model

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
EXCHANGED = 6  # pairs of channels, the most hopeful, searched afresh where nothing explains the misfit
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
    searched = bench.searched([base, *dropped, *_inputs_otherwise(bench, base)], seed)
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
            cause_of(outcome), untested=untested(bench.view, base, outcome.trial),
            shows=silent.get(outcome.trial.of[0], ""),
        )
        for outcome in outcomes
    ]  # fmt: skip


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
            "nonlinear", points_of(scored.element, bench.data.model), (scored.chi2 - scored.fall) / scored.dof,
            scored.value, element=scored.element,
        )
        for scored in called_for(bench.data, as_is.psi, bench.sign, thorough=thorough)
    ]  # fmt: skip
    return beside_loud_dwells(candidates, doubtful, nonlinear)


def _of_another_rig(bench: Workbench, as_is: Outcome) -> list[Cause]:
    """A missing element, a stated value that is wrong."""
    return [
        Cause(
            change.kind, points_of(change.element, bench.data.model), change.reduced, change.number,
            element=change.element,
        )
        for change in changes(bench, as_is.psi)
    ]  # fmt: skip


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
    afresh = bench.searched([each.trial for each in far[:EXCHANGED]], seed)
    outcomes = [*cross_talk(bench, base, without_one, pool), *afresh]
    return [
        *(cause_of(outcome) for outcome in outcomes),
        *_changed(bench, base, pool),
        *two_channels(bench, base, pool, noise),
    ]


def _changed(bench: Workbench, base: Trial, pool: Sequence[Real]) -> list[Cause]:
    """A part of the rig that is not the same in all runs, where two groups of them fit each by itself."""
    groups = run_groups(bench, base, pool)
    if groups is None:
        return []
    of = () if groups.element is None else points_of(groups.element, bench.data.model)
    left = groups.chi2 / groups.dof
    return [Cause("changed", of, left, groups.step, element=groups.element, where=groups.where)]


def _inputs_otherwise(bench: Workbench, base: Trial) -> list[Trial]:
    """An input's channel with the other sign or in another unit: leaving it out tells little of the rig.

    Where not all motion is seen, all phases the other way as well: no regression leads to that rig.
    """
    trials = [] if bench.data.states is not None else _turned(bench, base)
    for c, channel in enumerate(bench.view.channels):
        if measures_input(bench.data.model, channel):
            trials.append(scaled(base, "sign", channel.name, c, -1.0, -1.0))
            trials += [scaled(base, "unit", channel.name, c, 1 / ratio, ratio) for ratio in RATIOS[:4]]
    return trials


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
