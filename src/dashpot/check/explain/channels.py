"""Mistakes of one or two channels: sign, unit, gain, clock, quantity, filter, range or position."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from dashpot import units
from dashpot.arrays import Complex, Real
from dashpot.channel import MOTIONS, Channel, Quantity
from dashpot.check.explain.effect import Baseline, Effect, Phrase, by_size, plainly
from dashpot.check.explain.problem import FitProblem, LineProblem, TimeProblem
from dashpot.data.readers.columns import factors
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.io.toml_document import toml_key
from dashpot.model.network import Model
from dashpot.model.rigfile import channel_line, channel_section
from dashpot.notices import in_digits
from dashpot.unknowns import Unknown

# How a rig file begins to say what differs in some runs.
DIFFERENT = '[experiments.other] data = "…"'

# Ratios of usual units, rms and peak, degrees and radians, and their inverses.
RATIOS = (
    1e3, 1e-3, 1e6, 1e-6, 100.0, 0.01, 9.80665, 1 / 9.80665, 2**0.5, 0.5**0.5, 2.0, 0.5,
    180 / np.pi, np.pi / 180, 2 * np.pi, 1 / (2 * np.pi), 25.4, 1 / 25.4, 0.0254, 1 / 0.0254, 9806.65, 1 / 9806.65,
)  # fmt: skip
OF_NAMED = 0.9  # of wrong units: that it is one in which the quantity is measured, or a peak value for an rms
OF_FORCES = RATIOS[:12]  # forces are in no inches and no degrees
CLOSE = 0.015  # relative distance within which a factor is taken for a usual ratio
GAINS = (0.4, 0.6, 0.8, 0.9, 0.97, 1.03, 1.1, 1.25, 1.6, 2.5)  # where the search for a gain begins
# … a delay, periods of the highest frequency
DELAYS = (-0.4, -0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2, 0.4)
GAIN_WIDTH = 0.1  # nepers: a sensor's sensitivity is usually known to some per cent
DELAY_WIDTH = 0.2  # periods of the highest frequency: a sample or two of usual sampling
SHARE_WIDTH = 0.05  # of the other channel's size: usual cross-talk
REACH = 1.5  # periods of the highest frequency: the longest delay that is looked for
DISAGREES = (
    "disagrees with the other channels, and no common error (sign, unit, gain, delay, swap) explains it"
)
FEWEST = 6  # lines that tell a course over frequency
USUAL_UNITS = {
    Quantity.DISPLACEMENT: ("m", "mm", "µm", "cm", "in", "deg", "rad"),
    Quantity.VELOCITY: ("m/s", "mm/s", "in/s", "rpm", "rad/s", "deg/s"),
    Quantity.ACCELERATION: ("m/s²", "g", "mm/s²", "rad/s²"),
    Quantity.FORCE: ("N", "kN", "mN", "lbf"),
}
RATIOS_IN_WORDS = {
    2**0.5: "Are they peak values, read as rms?",
    0.5**0.5: "Are they rms values, read as peak?",
    2.0: "Are they peak-to-peak values?",
    0.5: "Is it half of a peak-to-peak value?",
}


def rounded(value: float, form: str = ".4g") -> str:
    """A number in a sentence."""
    return in_digits(f"{value:{form}}").replace("-", "−")


def known_ratio(factor: float) -> float | None:
    """The ratio of common units nearest to a factor of either sign; None if no common ratio is near."""
    return next((ratio for ratio in RATIOS if abs(abs(factor) / ratio - 1) < CLOSE), None)


def with_gain(channel: Channel, factor: float) -> Channel:
    """The channel with its gain multiplied by `factor`; its relative uncertainty stays."""
    prior = channel.gain_prior
    if channel.gain is not None or prior is None or prior.prior is None or prior.sd is None:
        known = 1.0 if channel.gain is None else channel.gain
        return replace(channel, gain=float(f"{known * factor:.6g}"))
    value, sd = float(f"{prior.prior * factor:.6g}"), float(f"{prior.sd * abs(factor):.6g}")
    return replace(channel, same_gain_as=None, gain_prior=Unknown(f"{channel.name}.gain", "1", value, sd))


def delayed(channel: Channel, late: float) -> Channel:
    """The channel with its delay increased by `late` (s); its uncertainty stays."""
    prior = channel.delay_prior
    if channel.delay is not None or prior is None or prior.prior is None or prior.sd is None:
        return replace(channel, delay=float(f"{(channel.delay or 0.0) + late:.4g}"))
    value = float(f"{prior.prior + late:.4g}")
    return replace(channel, delay_prior=Unknown(f"{channel.name}.delay", "s", value, prior.sd))


def _line(model: Model, channel: Channel) -> str:
    return f"{channel_section(channel)} {channel_line(channel, model)}"


# A factor: another sign, unit or gain.


def sign(baseline: Baseline) -> Iterator[Effect]:
    """Each channel with the opposite sign."""
    for c, channel in enumerate(baseline.problem.channels):
        words = turned(baseline.problem.model, channel)
        yield Effect("sign", (channel.name,), partial(times, c), words, (-1.0,))


def unit(baseline: Baseline) -> Iterator[Effect]:
    """Each channel in another usual unit."""
    for c, channel in enumerate(baseline.problem.channels):
        ratios = OF_FORCES if channel.quantity is Quantity.FORCE else RATIOS
        words = partial(factor_in_words, baseline.problem.model, channel)
        named = tuple(ratio for ratio in ratios if _question(ratio) or _other_unit(channel, ratio))
        others = tuple(ratio for ratio in ratios if ratio not in named)
        for share, values in ((OF_NAMED, named), (1 - OF_NAMED, others)):
            share *= baseline.share(c)
            yield Effect("unit", (channel.name,), partial(times, c), words, values, share=share)


def gain(baseline: Baseline) -> Iterator[Effect]:
    """Each channel with another gain."""
    for c, channel in enumerate(baseline.problem.channels):
        used, y, e = baseline.compared(c)
        found = (float(np.median((y / e).real)),) if np.sum(used) > 2 else ()
        begun = (*(each for each in found if each > 0), *GAINS)
        act, words = partial(times, c), partial(factor_in_words, baseline.problem.model, channel)
        share = baseline.share(c)
        yield Effect("gain", (channel.name,), act, words, begun, GAIN_WIDTH, 1.0, True, share=share)


def times(c: int, problem: FitProblem, factor: float) -> FitProblem:
    """The problem where channel c is `factor` times what it should be."""
    return problem.scaled(c, 1 / factor)


def turned(model: Model, channel: Channel) -> Phrase:
    mended = replace(channel, sign=-1.0 if channel.sign is None else -channel.sign)
    text = f"{channel.name} has the opposite sign to what the model predicts. Sensor reversed?"
    return Phrase(text, _line(model, mended), (mended,))


def factor_in_words(model: Model, channel: Channel, factor: float) -> Phrase:
    text = f"{channel.name} is {rounded(factor)} × what the model predicts"
    mended, question = with_gain(channel, factor), _question(factor)
    if other := _other_unit(channel, factor):
        stated = channel.stated or channel.unit or units.si_unit(channel.quantity.value)
        question = (
            f"Are the data in {other[0]}, not {stated}{', as their file states' if channel.stated else ''}?"
        )
        if not channel.stated:  # a file that states another unit than the rig file is refused
            mended = replace(channel, unit=other[0], scale=other[1])
    return Phrase(f"{text}. {question}" if question else text, _line(model, mended), (mended,))


def _question(factor: float) -> str:
    asked = (each for ratio, each in RATIOS_IN_WORDS.items() if abs(abs(factor) / ratio - 1) < CLOSE)
    return next(asked, "")


def _other_unit(channel: Channel, factor: float) -> tuple[str, float] | None:
    """The usual unit, and its size in SI, that data would be in which are `factor` times what they should be."""
    possible = [] if channel.unit else factors(channel.stated, channel.quantity.value)
    now = possible[0] if possible else channel.scale
    for each in USUAL_UNITS[channel.quantity]:
        try:
            scale = units.scale(each, channel.quantity.value, each in ("deg", "rad", "rpm"))
        except DashpotError:
            continue
        if abs(scale / now - 1) > 2 * CLOSE and factor > 0 and abs(scale * factor / now - 1) < CLOSE:
            return each, scale
    return None


# A course over frequency: late, filtered, another derivative, phases the other way.


def delay(baseline: Baseline) -> Iterator[Effect]:
    """Each channel late or early."""
    omega = baseline.courses.omega
    period = 2 * np.pi / float(np.max(omega))
    for c, channel in enumerate(baseline.problem.channels):
        used, y, e = baseline.compared(c)
        found = (_lateness(y, e, omega[used]),) if np.sum(used) > 2 else ()
        begun = (*found, *(part * period for part in DELAYS))
        act, words = by_size("late", c), partial(late, baseline.problem.model, channel)
        width, share = DELAY_WIDTH * period, baseline.share(c)
        yield Effect("delay", (channel.name,), act, words, begun, width, share=share)


def _lateness(y: Complex, e: Complex, omega: Real) -> float:
    """The delay (s) that brings y (lines,) closest to e, even if they stay far apart."""
    turn = y / e / np.abs(y / e)
    reach = 2 * np.pi * REACH / np.max(omega)
    delays = np.linspace(-reach, reach, 1201)
    match = np.mean(turn * np.exp(1j * np.outer(delays, omega)), axis=1).real
    late = float(delays[int(np.argmax(match))])
    return late - float(np.sum(np.angle(turn * np.exp(1j * omega * late)) * omega) / np.sum(omega**2))


def late(model: Model, channel: Channel, late: float) -> Phrase:
    mended = delayed(channel, late)
    text = f"{channel.name} is {1e3 * abs(late):.3g} ms {'late' if late > 0 else 'early'}"
    return Phrase(text, _line(model, mended), (mended,))


def derivative(baseline: Baseline) -> Iterator[Effect]:
    """Each channel, or all motion channels together, measuring another derivative of the motion."""
    channels, model = baseline.problem.channels, baseline.problem.model
    motions = [
        c for c in np.flatnonzero(~baseline.inputs).tolist() if channels[c].quantity is not Quantity.FORCE
    ]
    single = [(c,) for c, channel in enumerate(channels) if channel.quantity is not Quantity.FORCE]
    alike = len(motions) > 1 and len({channels[c].quantity for c in motions}) == 1
    for chosen in (*single, *([tuple(motions)] if alike else [])):
        stated = channels[chosen[0]].quantity.derivative
        powers = tuple(float(power) for power in (-2, -1, 1, 2) if 0 <= stated + power <= 2)
        of = tuple(channels[c].name for c in chosen)
        words = partial(_other_quantity, model, [channels[c] for c in chosen])
        yield Effect("quantity", of, partial(_derived, chosen), words, powers)


def _derived(chosen: tuple[int, ...], problem: LineProblem | TimeProblem, power: float) -> FitProblem:
    channels = list(problem.channels)
    for c in chosen:
        true = MOTIONS[channels[c].quantity.derivative + int(power)]
        channels[c] = replace(channels[c], quantity=true)
    return problem.of_rig(problem.model, tuple(channels))


def _other_quantity(model: Model, channels: list[Channel], power: float) -> Phrase:
    true = MOTIONS[channels[0].quantity.derivative + int(power)]
    mended = tuple(replace(channel, quantity=true, unit="", scale=1.0) for channel in channels)
    stated = channels[0].quantity.value
    if len(channels) == 1:
        text = f"{channels[0].name} behaves like {_article(true.value)}, not like {_article(stated)}"
    else:
        many, few = (f"{word}s".replace("ys", "ies") for word in (true.value, stated))
        text = f"{', '.join(channel.name for channel in channels)} behave like {many}, not like {few}"
    change = "; ".join(channel_line(channel, model) for channel in mended)
    return Phrase(text, f"[channels] {change}", mended)


def _article(word: str) -> str:
    return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"


def conjugate(baseline: Baseline) -> Iterator[Effect]:
    """Phases of one channel, or of all, with the opposite sign; unlikely for amplitudes computed from samples."""
    channels = baseline.problem.channels
    everything = tuple(range(len(channels)))
    for chosen in (*(() if baseline.of_samples else ((),)), *((c,) for c in everything)):
        of = tuple(channels[c].name for c in chosen)
        text = "all phases have the opposite sign: the data use e^(−jωt)"
        words = Phrase(text, "change the sign of the imaginary parts")
        if of:
            text = f"the phases of {of[0]} have the opposite sign"
            words = Phrase(text, f"conjugate {of[0]} in the data")
        act = plainly("conjugated", np.isin(everything, chosen or everything))
        yield Effect("conjugate", of, act, words, share=0.01 if baseline.of_samples else 1.0)


def radians(baseline: Baseline) -> Iterator[Effect]:
    """All phases in radians, read as degrees."""
    y = baseline.problem.y[baseline.problem.kept]
    small = np.max(np.abs(np.angle(y)), initial=0.0) < 1.01 * np.pi * np.pi / 180
    if small and not baseline.of_samples:
        words = Phrase("the phases are radians, read as degrees", "give the phases in rad, as NAME_phase_rad")
        yield Effect("unit", (), _phases_times, words, (180 / np.pi,))


def _phases_times(problem: LineProblem, factor: float) -> LineProblem:
    return problem.with_amplitudes(np.abs(problem.y) * np.exp(1j * factor * np.angle(problem.y)))


# Filters and ranges.


def filtered(baseline: Baseline) -> Iterator[Effect]:
    """Each channel through a low-pass or a high-pass filter of first or second order."""
    omega = baseline.courses.omega
    if len(np.unique(omega)) < FEWEST:
        return
    # A low-pass far above the band is but a delay; a high-pass shows where it turns the lowest line by a degree.
    lowest, highest = np.min(omega) / (2 * np.pi), np.max(omega) / (2 * np.pi)
    low_pass = tuple(np.geomspace(0.1 * lowest, 8 * highest, 8).tolist())
    corners = np.geomspace(lowest * np.pi / 180, 8 * highest, 120)
    for c, channel in enumerate(baseline.problem.channels):
        used, y, e = baseline.compared(c)
        for power in (1, -1):
            for order in (1, 2):
                sizes = low_pass
                if power < 0:  # where what passed, against all others, leaves least, and about it
                    passed = _passed(omega[used], power, order, corners[:, None])
                    left = np.sum(np.abs((y - e / passed) / baseline.problem.sd[used, c]) ** 2, axis=1)
                    sizes = (float(corners[int(np.argmin(left))]), *corners[12::24].tolist())
                act = partial(_through, c, power, order)
                words = partial(_filter, channel.name, power)
                yield Effect("filter", (channel.name,), act, words, sizes, 1.0, 1.0, True, share=1 / 4)


def _passed(omega: Real, power: int, order: int, corner_hz: Real | float) -> Complex:
    """One over the response of a filter of first or second order; power: 1 low-pass, −1 high-pass."""
    s = (1j * omega / (2 * np.pi * corner_hz)) ** power
    return np.asarray(1 + s if order == 1 else 1 + 2**0.5 * s + s**2, dtype=np.complex128)


def _through(
    c: int, power: int, order: int, problem: LineProblem | TimeProblem, corner_hz: float
) -> FitProblem:
    return problem.scaled(c, _passed(problem.omega, power, order, corner_hz))


def _filter(name: str, power: int, corner_hz: float) -> Phrase:
    if power > 0:
        text = f"{name} looks low-pass filtered at about {corner_hz:.2g} Hz. Is an amplifier filter on?"
    else:
        text = f"{name} looks high-pass filtered at about {corner_hz:.2g} Hz. Is it AC-coupled?"
    return Phrase(text, f"leave {name} out, or repair its signal chain")


def saturation(baseline: Baseline) -> Iterator[Effect]:
    """Each channel of the motion limited at some level: the fundamental of a clipped sine is too small."""
    for c in np.flatnonzero(~baseline.inputs).tolist():
        largest = float(np.max(np.abs(baseline.problem.y[:, c])))
        if largest > 0:
            limits = tuple(largest * share for share in (0.8, 0.87, 0.95))
            name = baseline.problem.channels[c].name
            act, words = partial(_unlimited, c), partial(limited, name)
            yield Effect("saturation", (name,), act, words, limits, 0.5, 1.0, True)


def _unlimited(c: int, problem: LineProblem, limit: float) -> LineProblem:
    """Amplitudes as they would be without the limit, by the describing function of clipping."""
    # What is shown leaves the straight line steeply at 1: close levels there
    level = np.concatenate([[0.0], 1 + np.geomspace(1e-6, 50.0, 1000)])
    part = np.minimum(1 / np.maximum(level, 1e-9), 1.0)
    shown = level * 2 / np.pi * (np.arcsin(part) + part * np.sqrt(1 - part**2))
    size = np.abs(problem.y[:, c]) / limit
    factor = np.where(size > 0, np.interp(size, shown, level) / np.where(size > 0, size, 1.0), 1.0)
    return problem.scaled(c, factor.astype(np.complex128))


def limited(name: str, limit: float, unit: str = "(SI)") -> Phrase:
    """That a channel ends at a limit, in its unit."""
    text = (
        f"{name} is too low at large amplitudes, as if limited at {limit:.3g} {unit}. Clipped or saturated?"
    )
    return Phrase(text, f"drive less, widen the range, or leave {name} out if others show the motion")


def gain_step(baseline: Baseline) -> Iterator[Effect]:
    """Each channel with a different gain from some line on; the other channels show from which."""
    if not baseline.lines.runs:
        return
    hertz = baseline.problem.frequency_hz
    for c, channel in enumerate(baseline.problem.channels):
        used, y, e = baseline.compared(c)
        if np.sum(used) < FEWEST:
            continue
        ratio, lines = (y / e).real, np.flatnonzero(used)
        # Where to part the lines, each part with its median
        splits = {
            k: (float(np.median(ratio[:k])), float(np.median(ratio[k:]))) for k in range(3, len(ratio) - 2)
        }
        left = {
            k: np.sum(np.abs(y[:k] / e[:k] - a) ** 2) + np.sum(np.abs(y[k:] / e[k:] - b) ** 2)
            for k, (a, b) in splits.items()
        }
        k = min(left, key=lambda split: left[split])
        first, second = splits[k]
        if not (first > 0 and second > 0 and abs(second / first - 1) > 1e-4):
            continue
        act, words = partial(_stepped, c, lines[k]), partial(_other_range, channel.name, hertz[lines[k]])
        size, share = (second / first,), 1 / len(splits)
        yield Effect("gain", (channel.name,), act, words, size, GAIN_WIDTH, 1.0, True, share=share)


def _stepped(c: int, line: int, problem: LineProblem, factor: float) -> LineProblem:
    return problem.scaled(
        c, np.where(np.arange(len(problem.y)) < line, 1.0, 1 / factor).astype(np.complex128)
    )


def _other_range(name: str, hertz: float, factor: float) -> Phrase:
    change = 100 * (factor - 1)
    moves = f"{'rises' if change > 0 else 'falls'} by {abs(change):.3g} % from {hertz:g} Hz on"
    text = f"the gain of {name} {moves}. Did the amplifier range change?"
    own = f'{DIFFERENT}; {toml_key(name)}.gain = "own"'
    cure = f"give those dwells a file of their own and let the gain differ there: {own}"
    return Phrase(text, cure)


# Two channels, another place, and a channel that is left out.


def swap(baseline: Baseline) -> Iterator[Effect]:
    """Any two channels exchanged, if they were measured at the same lines."""
    problem = baseline.problem
    for i, j in combinations(range(len(problem.channels)), 2):
        if np.array_equal(problem.kept[:, i], problem.kept[:, j]):
            pair = problem.channels[i], problem.channels[j]
            of = tuple(channel.name for channel in pair)
            alike = pair[0].factor / pair[0].scale == pair[1].factor / pair[1].scale
            forms = (True,) if alike else (True, False)
            for by_column in forms:
                words = _swapped(problem.model, *pair, by_column)
                yield Effect("swap", of, plainly("exchanged", i, j, by_column), words, share=1 / len(forms))


def _swapped(model: Model, first: Channel, second: Channel, by_column: bool) -> Phrase:
    if not by_column:
        text = f"{first.name} and {second.name} are exchanged, each scaled to the unit of the other"
        return Phrase(text, f"exchange {first.name} and {second.name} where they were recorded")
    mended = replace(second, name=first.name), replace(first, name=second.name)
    change = "; ".join(channel_line(channel, model) for channel in mended)
    return Phrase(f"{first.name} and {second.name} are exchanged", f"[channels] {change}", mended)


def crosstalk(baseline: Baseline) -> Iterator[Effect]:
    """A share of one channel added to another; the other channels show how large."""
    problem = baseline.problem
    power = np.array([np.mean(np.abs(problem.y[:, c]) ** 2) for c in range(len(problem.channels))])
    for c, channel in enumerate(problem.channels):
        used, y, e = baseline.compared(c)
        weight = 1 / problem.sd[used, c] ** 2
        for other in np.flatnonzero(power > 0).tolist():
            if other == c or not np.any(used):
                continue
            shown = problem.y[used, other]
            power_shown = np.sum(weight * np.abs(shown) ** 2)
            share = float(np.sum(weight * (np.conj(shown) * (y - e)).real) / power_shown)
            relative = np.sqrt(power[other] / power[c]) if power[c] > 0 else np.inf
            if 1e-4 < abs(share) * relative < 1:
                names = channel.name, problem.channels[other].name
                act, words = partial(_cleared, c, other), partial(_mixed, *names)
                width = SHARE_WIDTH / float(relative)
                yield Effect("crosstalk", names, act, words, (share,), width, share=1 / (len(power) - 1))


def _cleared(c: int, other: int, problem: LineProblem | TimeProblem, share: float) -> FitProblem:
    """The channel without its share of another, which takes its noise along."""
    y = np.array(problem.y)
    y[:, c] -= share * y[:, other]
    if isinstance(problem, TimeProblem):  # whose channels have noise of their own alone
        return problem.with_amplitudes(y)
    # A channel without noise that has a share of another's is that other, and the two would tell the same twice.
    noise = np.array(problem.V)
    noise[:, c, c] = problem.sd[:, c] ** 2
    mixing = np.eye(y.shape[1])
    mixing[c, other] = -share
    return problem.with_amplitudes(y, (mixing @ noise @ mixing.T).astype(np.complex128))


def _mixed(name: str, other: str, share: float) -> Phrase:
    text = f"{name} contains {rounded(share, '.3g')} × {other}: cross-talk?"
    return Phrase(text, f"subtract {rounded(share)} × {other} from {name}, or check cables and amplifier")


def place(baseline: Baseline) -> Iterator[Effect]:
    """Each motion channel mounted at another point, or on an element between its point and another."""
    model, channels = baseline.problem.model, baseline.problem.channels
    for c in np.flatnonzero(~baseline.inputs).tolist():
        channel = channels[c]
        if channel.quantity is Quantity.FORCE or len(channel.of) != 1:
            continue
        for point in (*model.coordinates, *model.displacement_inputs):
            if set(channel.of) != {point}:
                act, words = partial(_mounted, c, point), partial(_seen_there, model, channel, point)
                yield Effect("place", (channel.name,), act, words)
                if any({point, *channel.of} <= set(element.along) for element in model.elements):
                    yield Effect("place", (channel.name,), act, words, (0.1, 0.5), 0.3, between=(0.0, 1.0))


def _between(channel: Channel, point: str, share: float) -> Channel:
    """The channel mounted between two points: a share of the other point's motion, the rest of its own."""
    (own,) = channel.of
    return replace(channel, of={own: 1 - share, point: share} if abs(share - 1) > CLOSE else {point: 1.0})


def _mounted(c: int, point: str, problem: LineProblem | TimeProblem, share: float) -> FitProblem:
    channels = list(problem.channels)
    channels[c] = _between(channels[c], point, share)
    return problem.of_rig(problem.model, tuple(channels))


def _seen_there(model: Model, channel: Channel, point: str, share: float) -> Phrase:
    mended = _between(channel, point, float(f"{share:.3g}"))
    text = f"{channel.name} shows the motion of {point}. Is the sensor mounted there?"
    if len(mended.of) > 1:
        (own,) = channel.of
        part = f"{100 * share:.2g} % of the motion of {point}"
        text = f"{channel.name} shows {part} and the rest of {own}. Is it mounted between them?"
    return Phrase(text, _line(model, mended), (mended,))


def left_out(baseline: Baseline) -> Iterator[Effect]:
    """Each channel left out."""
    for c, channel in enumerate(baseline.problem.channels):
        shows = baseline.silent.get(channel.name)
        name = channel.name
        why = shows or DISAGREES
        phrase = Phrase(f"{name} {why}", f"leave {name} out, or check its sensor and mounting")
        fit = baseline.without[c]
        if shows and isinstance(fit.problem, LineProblem):  # what measured nothing need not show anything
            fit = replace(fit, problem=replace(fit.problem, lost=None))
        yield Effect("channel", (name,), partial(without, c), phrase, found=fit)


def without(c: int, problem: FitProblem, _: float = 1.0) -> FitProblem:
    """The problem without channel c."""
    dropped = np.zeros(problem.kept.shape, dtype=bool)
    dropped[:, c] = True
    return problem.without(dropped)


def in_data(cause: Finding, where: str) -> str:
    """What to do with the numbers in the file `where`, if the rig file is right for the other data."""
    names, size = " and ".join(cause.of), math.nan if cause.number is None else cause.number
    usual = known_ratio(size) if math.isfinite(size) and cause.kind in ("unit", "sign") else None
    factor = -1.0 if cause.kind == "sign" else math.copysign(usual, size) if usual is not None else size
    match cause.kind:
        case "swap":
            return f"exchange {names} in {where}"
        case "delay":
            return f"shift {names} by {rounded(-1e3 * size)} ms in {where}"
        case "frequency":
            return f"multiply the sampling rate of {where} by {size:.5g}"
        case "sign" | "unit" | "gain" if cause.of:
            return f"multiply {names} by {rounded(1 / factor, '.6g')} in {where}"
        case _:
            return f"measure {names} again in {where}"
