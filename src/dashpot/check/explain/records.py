"""Likely causes in whole records: the engine on all of their lines, and what each channel shows over time.

In a fit to all channels the rig, its inputs and its ends give way to the one that is wrong, and its residual does not
show what it is.  Without that channel they do not, and what they predict of it shows its limits, its zero, or when its
gain changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from dashpot.arrays import Complex, Ints, Real, diagonal_matrices
from dashpot.channel import Quantity
from dashpot.check.explain.channels import DISAGREES, limited
from dashpot.check.explain.dwells import held_words
from dashpot.check.explain.effect import Baseline, Effect, Phrase, as_is
from dashpot.check.explain.engine import Explanation, explain_records
from dashpot.check.explain.problem import (
    FitProblem,
    FittedProblem,
    LineProblem,
    TimeProblem,
    fitted_from_starts,
)
from dashpot.check.explain.steady_lines import steady_lines, working_noise
from dashpot.check.verdict import clipped_beyond, remedy_in_words
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.errors import DashpotError
from dashpot.estimate.inference.time_course import Kind, TimeChange, change_notice, time_changes
from dashpot.estimate.likelihood.descent import loudest
from dashpot.estimate.likelihood.objective import RecordFit, record_fit
from dashpot.estimate.likelihood.record_noise import RESIDUAL, residuals_of_records, share_without_misfit
from dashpot.estimate.preparation import prepare
from dashpot.model.network import Model
from dashpot.model.observation import calibrated_transfer, channel_unit, observation_model

CHANGED_CHANNEL = 0.06  # that a channel has an error that shows in time alone
MOST_LINES = 800  # of all records that the engine fits: those where the rig moves most
EXPLAINED = 0.6  # share of what is wrong that a wandering zero must explain
PIECES = 48  # of a record, whose means say how the zero wanders
STEPS, SUDDEN = 4, 0.7  # pieces that must make up this share of all that the zero moves, to be steps
LASTING = ("gain", "clock")  # changes that one channel alone can have, and that last

Predicted = Callable[[int, FittedProblem], Complex | None]
Clipped = tuple[float, Complex] | None  # where a channel ends in a record, and what it loses; None: nowhere


def explained_records(
    model: Model,
    spectrum: Spectrum,
    starts: tuple[Real, ...],
    sign: Real,
    *,
    silent: dict[str, str] | None = None,
    seed: int = 0,
) -> Explanation | None:
    """Likely causes if whole records (no batch axes) do not fit, begun at values of ψ (M,) and signs (channels,).

    None if they cannot be sought.

    Noise that was read from the residuals of this very rig is taken to be as low as where it is lowest, and without
    what free local models explain.
    """
    quiet = spectrum
    if RESIDUAL in spectrum.noise:
        weighed = LineProblem(prepare(model, spectrum, states=False), sign, starts, False)
        residual = weighed.y - _as_fitted(weighed, starts[0])
        share = share_without_misfit(spectrum, weighed.view.inputs_alone, residual)
        variance = np.minimum(working_noise(spectrum), weighed.variance * share)
        quiet = replace(spectrum, covariance=diagonal_matrices(variance))
    chosen = np.arange(quiet.lines)
    if quiet.lines > MOST_LINES:
        noise = np.maximum(working_noise(quiet), 1e-300)
        power = np.sum(np.abs(np.nan_to_num(quiet.amplitudes)) ** 2 / noise, axis=1)
        chosen = loudest(quiet.frequency_hz, power, MOST_LINES // 30)
    try:
        lines = LineProblem(prepare(model, steady_lines(model, spectrum)), sign, starts, False)
        whole = LineProblem(prepare(model, quiet, states=False), sign, starts, False)
        part = LineProblem(prepare(model, quiet.select(chosen), states=False), sign, starts, False)
        in_time = partial(channels_in_time, whole, chosen, partial(_by_all_others, whole))
        of_records = ((CHANGED_CHANNEL, in_time), (UNDRIVEN, tones), (HELD, between_samples))
        return explain_records(lines, part, of_records, silent=silent, seed=seed)
    except DashpotError:
        return None


def channels_in_time(
    whole: LineProblem | TimeProblem, chosen: Ints, predicted: Predicted, baseline: Baseline
) -> Iterator[Effect]:
    """Each motion channel with an error of its own, judged over time against all other channels.

    chosen: the lines of the baseline's problem.  predicted: what a fit makes of a channel, (lines,) of `whole`; None
    where that cannot be told.
    """
    as_fitted = (
        baseline.as_is.expected if isinstance(whole, TimeProblem) else _as_fitted(whole, baseline.as_is.psi)
    )
    for c, (channel, fit) in enumerate(zip(baseline.problem.channels, baseline.without, strict=True)):
        if baseline.inputs[c] or not np.isfinite(fit.chi2):
            continue
        by_others = predicted(c, fit)
        fits = (by_others, predicted(c, baseline.as_is), as_fitted[:, c])
        beside = [each for each in fits if each is not None]
        ends = [
            [clipped_beyond(whole.spectrum, k, whole.y[:, c], each) for k in whole.spectrum.records]
            for each in beside
        ]
        kind, phrase = _shown(whole, c, by_others, ends[0])
        yield Effect(kind, (channel.name,), as_is, phrase, found=fit)
        share = 1 / np.count_nonzero(~baseline.inputs)
        yield from _stepping(whole, chosen, c, beside, share)
        yield from _clipping(whole, chosen, c, ends, share)


def _shown(
    whole: LineProblem | TimeProblem, c: int, predicted: Complex | None, ends: Sequence[Clipped]
) -> tuple[str, Phrase]:
    """The kind of error of channel c, against what all others make of it, in words; ends: where it clips, by record."""
    name = whole.channels[c].name
    plain = "channel", Phrase(f"{name} {DISAGREES}", f"leave {name} out, or check its sensor and mounting")
    if predicted is None:
        return plain
    spectrum, y = whole.spectrum, whole.y[:, c]
    unit = channel_unit(whole.model, spectrum.channels[c])
    for number, clipped in zip(spectrum.records, ends, strict=True):
        if clipped is not None:
            return "saturation", limited(name, clipped[0], unit)
        at = spectrum.in_time(number)
        shown, should = at.history(y), at.history(predicted)
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


def _as_fitted(whole: LineProblem, psi: Real) -> Complex:
    """What the rig makes of all channels by all of them, with what their ends add, (lines, channels)."""
    residual, _ = residuals_of_records(whole.view, whole.arranged(), psi[None], whole.sign[None])
    return whole.y - residual


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


def _clipping(
    whole: LineProblem | TimeProblem, chosen: Ints, c: int, ends: Sequence[Sequence[Clipped]], share: float
) -> Iterator[Effect]:
    """Channel c with what it loses beyond some level put back, by each fit that says where it ends in each record."""
    channel = whole.spectrum.channels[c]
    for by_record in ends:
        if clipped := [each for each in by_record if each is not None]:
            limit, lost = clipped[0][0], np.zeros(whole.y.shape, dtype=np.complex128)
            lost[:, c] = sum(each[1] for each in clipped)
            words = limited(channel.name, limit, channel_unit(whole.model, channel))
            act = partial(_without_part, lost[chosen])
            yield Effect("saturation", (channel.name,), act, words, (limit,), more=3, share=share)


# A clock or a gain of one channel that steps: from some time on the channel shows what it should earlier or later, or
# times a number.  Sums up to each sample say at which, for every size at once.

SLIPS = np.concatenate([np.arange(-24, 0), np.arange(1, 25)]) / 2  # sampling steps


def _stepping(
    whole: LineProblem | TimeProblem, chosen: Ints, c: int, predicted: Sequence[Complex], share: float
) -> Iterator[Effect]:
    """Channel c with a clock or gain that steps once, against what all others make of it."""
    spectrum, name = whole.spectrum, whole.channels[c].name
    tried = ((each, number) for each in predicted for number in spectrum.records)
    steps = [_best_step(spectrum, whole.y[:, c], *each, name) for each in tried]
    _, change = min(steps, key=lambda each: each[0], default=(np.inf, None))
    if change is not None:
        act = partial(_before_step, whole, chosen, c, change)
        words = partial(_step_in_words, spectrum, change)
        yield Effect("time", change.channels, act, words, (change.size,), more=3, share=share)


def _best_step(
    spectrum: Spectrum, y: Complex, predicted: Complex, number: int, name: str
) -> tuple[float, TimeChange]:
    """The step that leaves the smallest error of a channel (lines,) in a record, and the share it leaves."""
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
    """The problem with channel c corrected from the step on."""
    spectrum, y = whole.spectrum, whole.y[:, c]
    at = spectrum.in_time(change.record)
    mended = y * np.exp(1j * spectrum.omega * size) if change.kind == "clock" else y / size
    more = at.history(mended - y)
    first = round(change.time_s / at.step_s)
    more[:first] = 0.0
    added = np.zeros(len(y), dtype=np.complex128)
    added[at.lines] = at.amplitudes(more)
    mended_y = np.array(problem.y)
    mended_y[:, c] += added[chosen]
    # A gain is that of the noise as well, which is one for all of the record.
    after = (at.samples - first) / at.samples if change.kind == "gain" else 0.0
    return problem.scaled(c, (1 - after + after / size**2) ** 0.5).with_amplitudes(mended_y)


# An input that is held from sample to sample: besides its spectrum in the band, times sin(x)/x and half a step late, it
# has images about every multiple of the sampling rate, and what they move is sampled as motion in the band.

HELD = 0.02  # that an input is
IMAGES = 8  # to either side: beyond, a rig shows its highest derivative alone
SETTLING = 4  # fits, each with the images of the rig of the last


def between_samples(baseline: Baseline) -> Iterator[Effect]:
    """Each measured input held between its samples, or straight from one to the next."""
    problem = baseline.lines
    steps = {each.step_s for each in problem.spectrum.stretches if isinstance(each, WholeRecord)}
    if len(steps) != 1 or len(problem.model.nonlinear):
        return
    (step,) = steps
    alone = [c for c in np.flatnonzero(baseline.inputs).tolist() if len(problem.channels[c].of) == 1]
    for c in alone:
        for straight in (False, True):
            fit, starts = baseline.as_is, problem.starts
            with suppress(DashpotError, np.linalg.LinAlgError):
                for _ in range(SETTLING):
                    mended = _without_images(problem, c, fit.psi, step, straight)
                    (fit,) = fitted_from_starts([mended.from_starts((fit.psi, *starts))])
                    starts = ()
                name, words = problem.channels[c].name, held_words(problem.channels[c].name, step)
                if straight:
                    text = f"{name} looks as if it ran straight from sample to sample ({1e3 * step:.3g} ms)"
                    cure = f"give {name} more finely, as it is between samples"
                    words = Phrase(f"{text}. By a simulator?", cure)
                yield Effect("hold", (name,), as_is, words, (step,), found=fit, share=0.5)


def _without_images(problem: LineProblem, c: int, psi: Real, step: float, straight: bool) -> LineProblem:
    """The amplitudes as they would be, had the input of channel c followed its own spectrum alone."""
    omega, rate = problem.omega, 2 * np.pi / step
    far = 1e3 * rate  # where a rig shows its highest derivative alone
    images = np.arange(-IMAGES, IMAGES + 1)
    every = np.append((omega + rate * images[:, None]).ravel(), far)
    view = observation_model(problem.model, problem.channels, np.abs(every))
    G = calibrated_transfer(view, psi, problem.sign).G
    inputs = (*problem.model.displacement_inputs, *problem.model.force_inputs)
    at = inputs.index(next(iter(problem.channels[c].of)))
    shown = G[:, :, at] / G[:, c, at][:, None]
    shown = np.where(every[:, None] < 0, np.conj(shown), shown)
    last, shown = shown[-1].real, shown[:-1].reshape(len(images), len(omega), -1)
    half = (omega + rate * images[:, None]) * step / 2
    weight = (np.sin(omega * step / 2) / half) ** 2
    if not straight:
        weight = np.sin(omega * step / 2) / half * np.exp(-0.5j * omega * step)
    held_shown = np.sum((shown - last) * weight[..., None], axis=0) + last
    y = problem.y - (held_shown - shown[IMAGES]) * problem.y[:, c][:, None]
    return problem.with_amplitudes(np.where(problem.kept, y, 0.0))


def _step_in_words(spectrum: Spectrum, change: TimeChange, size: float) -> Phrase:
    return remedy_in_words(change_notice(replace(change, size=size), len(spectrum.records)))


# A tone that nothing drives, in one channel or as a force.  At the lines k/T of a record it is the transform of a
# cosine and of a sine of its frequency, so that its two sizes are linear once the frequency is known.

UNDRIVEN = 0.02  # that a record has one
HEARD = 2 / 3  # that one is in a channel alone, as hum is, and moves nothing


def tones(baseline: Baseline) -> Iterator[Effect]:
    """A tone in each channel of the motion, and a force of one frequency at each coordinate."""
    problem = baseline.lines
    arranged = problem.arranged()
    if arranged.ends is None:
        return
    found = record_fit(problem.view, arranged, baseline.as_is.psi[None], problem.sign[None])
    motions, points = np.flatnonzero(~baseline.inputs).tolist(), problem.model.coordinates
    every = np.eye(len(problem.channels), dtype=np.complex128)
    # What a unit of each shows, (lines, channels)
    alone = {problem.channels[c].name: np.broadcast_to(every[c], problem.y.shape) for c in motions}
    pushed = {x: found.rig.G[0, :, :, arranged.ends.inputs + i] for i, x in enumerate(points)}
    for number in problem.spectrum.records:
        for of, shape in (*alone.items(), *pushed.items()):
            frequency, tone = _loudest_tone(found, problem, number, shape)
            near = f"leave the lines near {frequency:.4g} Hz out"
            text = f"{of} contains a tone of {frequency:.4g} Hz that nothing drives: hum?"
            kind, words, share = "tone", Phrase(text, near), HEARD / len(motions)
            if shape is pushed.get(of):
                text = f"a force of {frequency:.4g} Hz acts at {of}, which no channel measures"
                words = Phrase(text, f"stop it, measure it, or {near}")
                kind, share = "input", (1 - HEARD) / len(points)
            yield Effect(kind, (of,), partial(_without_part, tone), words, more=3, share=share)


def _loudest_tone(
    found: RecordFit, problem: LineProblem, number: int, shape: Complex
) -> tuple[float, Complex]:
    """Frequency, Hz, of the tone that explains most of a record, and its amplitudes (lines, channels).

    shape (lines, channels): what a unit of it shows.
    """
    record, lines = problem.spectrum.stretches[number], np.flatnonzero(problem.spectrum.stretch == number)
    assert isinstance(record, WholeRecord)
    left = (found.root @ found.r[..., None])[0, ..., 0]
    heard = np.any(np.abs(shape) > 0, axis=0)
    peak = lines[int(np.argmax(np.sum(np.abs(left[lines][:, heard]) ** 2, axis=1)))]
    order, best, tone = problem.frequency_hz[peak] * record.duration_s, 0.0, np.zeros_like(left)
    about = order
    # Ten frequencies to a line next to the peak, then ten times as closely about the best, and again
    for reach in (1.0, 0.1, 0.01):
        orders = np.maximum(about + reach * np.linspace(-1, 1, 21), 1.0)  # less is a drift
        columns = np.zeros((*left.shape, len(orders), 2), dtype=np.complex128)
        columns[lines] = shape[lines, :, None, None] * _sines(record, problem.omega[lines], orders)[:, None]
        white = found.root @ found.left_of(columns.reshape(1, *left.shape, -1))
        for k, pair in enumerate(np.moveaxis(white.reshape(left.size, len(orders), 2), 1, 0)):
            size = np.linalg.lstsq(_parts(pair), _parts(left.ravel()))[0]
            explained = float(_parts(left.ravel()) @ _parts(pair) @ size)
            if explained > best:
                order, best, tone = orders[k], explained, columns[:, :, k] @ size
        about = order
    return float(order / record.duration_s), tone


def _parts(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _sines(record: WholeRecord, omega: Real, orders: Real) -> Complex:
    """Amplitudes at angular frequencies `omega` (lines,) of a cosine and a sine of k/T each, (lines, orders, 2)."""

    def mean(rate: Real) -> Complex:
        """Of e^{jδt} over all samples, by δ."""
        half = rate * record.step_s / 2
        half = np.where(half == 0, 1e-12, half)
        size = np.sin(record.samples * half) / (record.samples * np.sin(half))
        return np.asarray(size * np.exp(1j * (record.samples - 1) * half))

    rate = 2 * np.pi * orders / record.duration_s
    up, down = mean(rate - omega[:, None]), mean(-rate - omega[:, None])
    return np.stack([up + down, (up - down) / 1j], axis=-1)


def _without_part(part: Complex, problem: LineProblem | TimeProblem, _: float) -> FitProblem:
    """Without a part of the amplitudes, (lines, channels)."""
    return problem.with_amplitudes(np.where(problem.kept, problem.y - part, 0.0))


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
        powers = (s[:, None] ** np.arange(derivative)).astype(np.complex128)
        left = spectrum.amplitudes[its, c] - predicted[its]
        columns, both = _parts(powers), _parts(left)
        added[its] = powers @ np.linalg.lstsq(columns, both, rcond=None)[0]
    return added


def _wander(away: Real, duration_s: float, unit: str) -> str | None:
    """A drift or step of a channel's zero, if that is most of its error."""
    edges = np.linspace(0, len(away), PIECES + 1).astype(np.int64)
    means = np.add.reduceat(away, edges[:-1]) / np.diff(edges)
    if float(np.mean(means**2)) < EXPLAINED * float(np.mean(away**2)):
        return None
    size, steps = float(np.ptp(means)), np.abs(np.diff(means))
    k = int(np.argmax(steps))
    if np.sum(np.sort(steps)[-STEPS:]) > SUDDEN * np.sum(steps):
        at = duration_s * (k + 1) / PIECES
        moved = f"shifts by {steps[k]:.3g} {unit} near {at:.3g} s"
        return f"has a zero that {moved}. Range changed, or cable moved?"
    return f"has a zero that drifts by {size:.3g} {unit}. Is the amplifier or the temperature drifting?"
