"""What may be the matter with whole records: the engine on all of their lines, and what a channel shows in time.

In a fit to all channels the rig, its inputs and its ends give way to the one that is wrong, and its residual does not
show what it is.  Without that channel they do not, and what they predict of it shows its limits, its zero, or when its
gain changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.channel import Quantity
from dashpot.check.explain.channels import DISAGREES, limited
from dashpot.check.explain.effect import Baseline, Effect, Phrase, as_is, said
from dashpot.check.explain.engine import Explanation, explain_records
from dashpot.check.explain.problem import FitProblem, FittedProblem, LineProblem, TimeProblem
from dashpot.check.explain.steady_lines import steady_lines, working_noise
from dashpot.check.verdict import clipped_at, remedy_in_words
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.inference.time_course import Kind, TimeChange, change_notice, time_changes
from dashpot.estimate.likelihood.descent import loudest
from dashpot.estimate.likelihood.objective import record_fit
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit

MOST_LINES = 800  # of all records that the engine fits: those where the rig moves most
EXPLAINED = 0.6  # share of what is wrong that a wandering zero must explain
PIECES = 48  # of a record, whose means say how the zero wanders
STEPS, SUDDEN = 4, 0.7  # pieces that must make up this share of all that the zero moves, to be steps
LASTING = ("gain", "clock")  # changes that one channel alone can have, and that last

Predicted = Callable[[int, FittedProblem], Complex | None]


def explained_records(
    model: Model,
    spectrum: Spectrum,
    estimate: Estimate,
    *,
    silent: dict[str, str] | None = None,
    seed: int = 0,
) -> Explanation | None:
    """What may be otherwise where whole records (no batch axes) do not fit; None where they cannot be looked at.

    Noise that was read from the residuals of this very rig is taken to be as low as where it is lowest.
    """
    if not np.all(np.isfinite(estimate.values)):
        return None
    quiet = spectrum
    if RESIDUAL in spectrum.noise:
        variance = working_noise(spectrum)[:, :, None] * np.eye(len(spectrum.channels))
        quiet = replace(spectrum, covariance=variance.astype(np.complex128))
    chosen = np.arange(quiet.lines)
    if quiet.lines > MOST_LINES:
        noise = np.maximum(working_noise(quiet), 1e-300)
        power = np.sum(np.abs(np.nan_to_num(quiet.amplitudes)) ** 2 / noise, axis=1)
        chosen = loudest(quiet.frequency_hz, power, MOST_LINES // 30)
    (sign,) = quiet.signs(estimate.signs)
    try:
        lines = LineProblem(prepare(model, steady_lines(model, spectrum)), sign, (estimate.values,), False)
        whole = LineProblem(prepare(model, quiet, states=False), sign, (estimate.values,), False)
        part = LineProblem(
            prepare(model, quiet.select(chosen), states=False), sign, (estimate.values,), False
        )
        in_time = partial(channels_in_time, whole, chosen, partial(_by_all_others, whole))
        return explain_records(lines, part, in_time, silent=silent, seed=seed)
    except DashpotError:
        return None


def channels_in_time(
    whole: LineProblem | TimeProblem, chosen: Ints, predicted: Predicted, baseline: Baseline
) -> Iterator[Effect]:
    """Each channel of the motion with an error of its own, by what it shows in time against all others.

    chosen: the lines of the baseline's problem.  predicted: what a fit makes of a channel, (lines,) of `whole`; None
    where that cannot be told.
    """
    for c, (channel, fit) in enumerate(zip(baseline.problem.channels, baseline.without, strict=True)):
        if baseline.inputs[c] or not np.isfinite(fit.chi2):
            continue
        by_others = predicted(c, fit)
        kind, phrase = _shown(whole, c, by_others)
        yield Effect(kind, (channel.name,), as_is, partial(said, phrase), found=fit)
        share = 1 / np.count_nonzero(~baseline.inputs)
        beside = (by_others, predicted(c, baseline.as_is))
        yield from _stepping(whole, chosen, c, [each for each in beside if each is not None], share)


def _shown(whole: LineProblem | TimeProblem, c: int, predicted: Complex | None) -> tuple[str, Phrase]:
    """The kind of error of channel c, against what all others make of it, in words."""
    name = whole.channels[c].name
    plain = (
        "channel",
        Phrase(f"{name} {DISAGREES}", f"leave {name} out, or check its sensor and mounting"),
    )
    if predicted is None:
        return plain
    spectrum, y = whole.spectrum, whole.y[:, c]
    unit = channel_unit(whole.model, spectrum.channels[c])
    for number in spectrum.records:
        at = spectrum.in_time(number)
        shown, should = at.history(y), at.history(predicted)
        end = clipped_at(shown, should, 2 * len(at.lines))
        if end is not None:
            return "saturation", limited(name, end, unit)
        gain = float(shown @ should / (should @ should)) if np.any(should) else 0.0
        zero = _wander(shown - gain * should, at.duration_s, unit)
        if zero is not None:
            return "channel", Phrase(f"{name} {zero}", f"leave {name} out, or repair its signal chain")
    single = replace(spectrum, amplitudes=whole.y)

    def unweighted(lines: Ints, _: int) -> tuple[Complex, Complex]:
        return (y - predicted)[lines], predicted[lines]

    changes = time_changes(unweighted, single, np.array([c]))
    named = [each for each in changes if each.kind in LASTING] or [
        each for each in changes if each.kind == "jump"
    ]
    if not named:
        return plain
    return "time", _step_in_words(spectrum, named[0], named[0].size)


def _by_all_others(whole: LineProblem, c: int, fit: FittedProblem) -> Complex | None:
    """What the rig of a fit makes of channel c by all other channels, (lines,); None where that cannot be told."""
    without = whole.without(np.broadcast_to(np.arange(len(whole.channels)) == c, whole.kept.shape))
    arranged = without.arranged()
    if arranged.ends is None:
        return None
    with np.errstate(all="ignore"):
        found = record_fit(without.view, arranged, fit.psi[None], without.sign[None])
        predicted: Complex = np.einsum("lq,lq->l", found.rig.G[0, :, c], found.motion[0])
    if not np.all(np.isfinite(predicted)):
        return None
    return predicted + _of_its_ends(replace(whole.data.spectrum, amplitudes=whole.y), c, predicted)


# A clock or a gain of one channel that steps: from some time on the channel shows what it should earlier or later, or
# times a number.  Sums up to each sample say at which, for every size at once.

SLIPS = np.concatenate([np.arange(-24, 0), np.arange(1, 25)]) / 2  # sampling steps
STEPPED = 0.5  # of what is wrong with a channel that a step must leave at the most to be tried


def _stepping(
    whole: LineProblem | TimeProblem, chosen: Ints, c: int, predicted: Sequence[Complex], share: float
) -> Iterator[Effect]:
    """Channel c with a clock or gain that steps once, against what all others make of it."""
    spectrum, name = whole.spectrum, whole.channels[c].name
    steps = [
        _best_step(spectrum, whole.y[:, c], each, number, name)
        for each in predicted
        for number in spectrum.records
    ]
    left, change = min(steps, key=lambda each: each[0], default=(np.inf, None))
    if change is not None and left < STEPPED:
        act, words = (
            partial(_before_step, whole, chosen, c, change),
            partial(_step_in_words, spectrum, change),
        )
        yield Effect("time", change.channels, act, words, (change.size,), more=2, share=share)


def _best_step(
    spectrum: Spectrum, y: Complex, predicted: Complex, number: int, name: str
) -> tuple[float, TimeChange]:
    """The step that leaves least of what is wrong with a channel (lines,) in a record, and that share."""
    at = spectrum.in_time(number)
    step_s, shown, should = at.step_s, at.history(y), at.history(predicted)
    before = np.concatenate([[0.0], np.cumsum((shown - should) ** 2)])
    found: list[tuple[float, TimeChange]] = []
    edge = max(at.samples // 20, 1)  # what is otherwise from the first sample on is no step

    def add(kind: Kind, left: Real, sizes: Real | float) -> None:
        k = int(np.argmin(left[edge:-edge])) + edge
        size = float(np.broadcast_to(sizes, left.shape)[k])
        found.append((float(left[k] / before[-1]), TimeChange(kind, (name,), number, k * step_s, size)))

    for slip in SLIPS * step_s:
        later = at.history(y * np.exp(-1j * spectrum.omega * slip))
        away = np.concatenate([[0.0], np.cumsum((later - should) ** 2)])
        add("clock", before + away[-1] - away, -slip)
    yy, ye, ee = (
        np.concatenate([np.cumsum(part[::-1])[::-1], [0.0]]) for part in (shown**2, shown * should, should**2)
    )
    with np.errstate(all="ignore"):
        add("gain", np.nan_to_num(before + yy - ye**2 / ee, nan=np.inf), ye / ee)
    return min(found, key=lambda each: each[0])


def _before_step(
    whole: LineProblem | TimeProblem,
    chosen: Ints,
    c: int,
    change: TimeChange,
    problem: LineProblem | TimeProblem,
    size: float,
) -> FitProblem:
    """The problem where channel c is from the step on what it was before."""
    spectrum, y = whole.spectrum, whole.y[:, c]
    at = spectrum.in_time(change.record)
    mended = y * np.exp(1j * spectrum.omega * size) if change.kind == "clock" else y / size
    more = at.history(mended - y)
    more[: round(change.time_s / at.step_s)] = 0.0
    added = np.zeros(len(y), dtype=np.complex128)
    added[at.lines] = at.amplitudes(more)
    mended_y = np.array(problem.y)
    mended_y[:, c] += added[chosen]
    return problem.with_amplitudes(mended_y)


def _step_in_words(spectrum: Spectrum, change: TimeChange, size: float) -> Phrase:
    return remedy_in_words(change_notice(replace(change, size=size), len(spectrum.records)))


def _of_its_ends(spectrum: Spectrum, c: int, predicted: Complex) -> Complex:
    """What the ends of each record add to a channel of velocity or acceleration beyond the motion, (lines,).

    A polynomial of s for each derivative (THEORY §8), which the channels of the fit do not tell: it stands at the ends.
    """
    added: Complex = np.zeros_like(predicted)
    channel = spectrum.channels[c]
    derivative = 0 if channel.quantity is Quantity.FORCE else channel.quantity.derivative
    for number in spectrum.records if derivative else ():
        its = np.flatnonzero(spectrum.stretch == number)
        s = 1j * spectrum.omega[its] / np.max(spectrum.omega[its])
        powers = s[:, None] ** np.arange(derivative)
        left = spectrum.amplitudes[its, c] - predicted[its]
        columns, both = (np.concatenate([part.real, part.imag]) for part in (powers, left))
        added[its] = powers @ np.linalg.lstsq(columns, both, rcond=None)[0]
    return added


def _wander(away: Real, duration_s: float, unit: str) -> str | None:
    """That the zero of a channel drifts or steps, where that is most of what is wrong with it."""
    edges = np.linspace(0, len(away), PIECES + 1).astype(np.int64)
    means = np.add.reduceat(away, edges[:-1]) / np.diff(edges)
    if float(np.mean(means**2)) < EXPLAINED * float(np.mean(away**2)):
        return None
    size, steps = float(np.ptp(means)), np.abs(np.diff(means))
    k = int(np.argmax(steps))
    if np.sum(np.sort(steps)[-STEPS:]) > SUDDEN * np.sum(steps):
        at = duration_s * (k + 1) / PIECES
        return (
            f"has a zero that shifts by {steps[k]:.3g} {unit} near {at:.3g} s. Range changed, or cable moved?"
        )
    return f"has a zero that drifts by {size:.3g} {unit}. Is the amplifier or the temperature drifting?"
