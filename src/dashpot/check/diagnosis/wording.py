"""Findings in words, each with the line to write in the rig file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from dashpot import units
from dashpot.channel import Channel, Quantity
from dashpot.check.diagnosis.contradictions import Contradiction
from dashpot.check.diagnosis.nonlinear_elements import with_open_constants
from dashpot.check.diagnosis.ranking import USUAL, Cause, unit_of_number
from dashpot.check.diagnosis.trials import CLOSE, Likeness, known_ratio
from dashpot.errors import DashpotError, Problem
from dashpot.estimate.assessment import Finding
from dashpot.io.words import joined
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model
from dashpot.model.rigfile import channel_line, element_line

# Channels that show another derivative of the motion than they state, in words and as they should be.


DERIVATIVES = (Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION)


def other_quantity(channel: Channel, relation: Likeness) -> tuple[Channel, str]:
    """Shown is (jω)^power times what the stated quantity would be."""
    text = f"{channel.name} behaves like another derivative of the motion than {channel.quantity.value}"
    if channel.quantity is Quantity.FORCE:
        return channel, text
    order = channel.quantity.derivative + relation.power
    if not 0 <= order <= 2:
        return channel, text
    true = DERIVATIVES[order]
    return (
        replace(channel, quantity=true, unit="", scale=1.0),
        f"{channel.name} behaves like {_article(true.value)}, not like {_article(channel.quantity.value)}",
    )


def other_quantities(model: Model, channels: Sequence[Channel], cause: Cause, relation: Likeness) -> Finding:
    """All channels of the motion that show another derivative than they state."""
    mended = tuple(other_quantity(channel, relation)[0] for channel in channels)
    true, stated = (f"{each[0].quantity.value}s".replace("ys", "ies") for each in (mended, channels))
    text = f"{joined(cause.of)} behave like {true}, not like {stated}"
    change = "[channels] " + "; ".join(channel_line(channel, model) for channel in mended)
    return Finding(cause.kind, cause.of, text, change, cause.remaining, cause.number, channels=mended)


def _article(word: str) -> str:
    return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"


Failure = TypeVar("Failure", bound=DashpotError)

USUAL_UNITS = {
    Quantity.DISPLACEMENT: ("m", "mm", "µm", "cm", "in", "deg", "rad"),
    Quantity.VELOCITY: ("m/s", "mm/s", "in/s", "rpm", "rad/s", "deg/s"),
    Quantity.ACCELERATION: ("m/s²", "g", "mm/s²", "rad/s²"),
    Quantity.FORCE: ("N", "kN", "mN", "lbf"),
}
RATIOS_IN_WORDS = {
    2**0.5: "peak values for rms",
    0.5**0.5: "rms for peak values",
    2.0: "peak to peak",
    0.5: "half of it",
}


def finding(model: Model, channels: tuple[Channel, ...], cause: Cause) -> Finding:
    """A cause in words.  Texts name no option of any command."""
    by_name = {channel.name: channel for channel in channels}
    of_channels = bool(cause.of) and all(name in by_name for name in cause.of)
    if cause.parts:
        return _together(cause, [finding(model, channels, part) for part in cause.parts])
    of_them = _of_channels(model, [by_name[name] for name in cause.of], cause) if of_channels else None
    if of_them is not None:
        return of_them
    if cause.kind in ("element", "value") and cause.element is not None:
        return _of_rig(model, cause, cause.element)
    if cause.kind == "nonlinear" and cause.element is not None:
        return nonlinear_finding(model, cause.of, cause.element, cause.number, cause.remaining)
    if cause.kind == "changed":
        return _changed(model, cause)
    text, change = _of_modes(cause) or _of_dwells(cause) or _of_data(cause)
    return Finding(cause.kind, cause.of, text, change, cause.remaining, cause.number)


def _of_channels(model: Model, channels: Sequence[Channel], cause: Cause) -> Finding | None:
    """A cause that is about channels alone and has a line to write, or another name; None for others."""
    if cause.kind == "quantity" and len(channels) > 1 and cause.likeness is not None:
        return other_quantities(model, channels, cause, cause.likeness)
    if cause.kind in ("sign", "unit", "gain", "delay", "quantity"):
        return _of_channel(model, channels[0], cause)
    if cause.kind == "swap":
        return _swap(model, channels[0], channels[1], cause)
    return None if cause.contradiction is None else _contradicting(model, cause, cause.contradiction)


def _together(cause: Cause, parts: Sequence[Finding]) -> Finding:
    """What is wrong with each of several channels at once."""
    text, change = " and ".join(part.text for part in parts), "; ".join(part.change for part in parts)
    mended = tuple(channel for part in parts for channel in part.channels)
    return Finding(cause.kind, cause.of, text, change, cause.remaining, channels=mended)


def laws_in_words(model: Model) -> str:
    """The rig's nonlinear elements, in whose place something else may stand."""
    return joined(model.elements[int(index)].name for index in model.nonlinear)


def in_place_of_laws(model: Model, cause: Finding) -> Finding:
    """The cause, found with the rig's nonlinear elements left out, as one that stands in their place."""
    return replace(cause, text=f"{cause.text}, in place of {laws_in_words(model)}")


def _contradicting(model: Model, cause: Cause, contradiction: Contradiction) -> Finding:
    """A channel that contradicts all others in a way that has a name."""
    name, mended = cause.of[0], contradiction.mended
    text = f"{name} contradicts all other channels: it {contradiction.text}"
    if mended is None:
        change = f"leave {name} out, or mend what it goes through"
        return Finding(cause.kind, cause.of, text, change, cause.remaining)
    line = f"[channels] {channel_line(mended, model)}"
    return Finding(cause.kind, cause.of, text, line, cause.remaining, channels=(mended,))


def _of_channel(model: Model, channel: Channel, cause: Cause) -> Finding:
    name, number = channel.name, 1.0 if cause.number is None else cause.number
    relation = cause.likeness
    if cause.kind == "sign":
        mended = replace(channel, sign=-1.0 if channel.sign is None else -channel.sign)
        text = f"{name} reads {_number(number)} × what the rig gives: wrong sign?"
    elif cause.kind == "delay":
        mended, text = _late(channel, number, 1.0 if relation is None else relation.number)
    elif cause.kind == "quantity" and relation is not None:
        mended, text = other_quantity(channel, relation)
    else:
        mended, text = _other_unit(channel, number)
    line = channel_line(mended, model)
    return Finding(
        cause.kind, cause.of, text, f"[channels] {line}", cause.remaining, cause.number, channels=(mended,)
    )


def _late(channel: Channel, late: float, factor: float) -> tuple[Channel, str]:
    """Later by so many seconds; and another sign or gain, if the factor with which it was tried is another than 1."""
    delay = (0.0 if channel.delay is None else channel.delay) + late
    mended = replace(channel, delay=float(f"{delay:.4g}"))
    text = f"{channel.name} is {1e3 * abs(late):.3g} ms {'late' if late > 0 else 'early'}"
    if factor < 0:
        mended = replace(mended, sign=-1.0 if channel.sign is None else -channel.sign)
    if abs(abs(factor) - 1) > CLOSE:
        gain = (1.0 if channel.gain is None else channel.gain) * abs(factor)
        mended = replace(mended, gain=float(f"{gain:.6g}"))
    if factor < 0 or abs(factor - 1) > CLOSE:
        text += f" and reads {_number(factor)} × what the rig gives"
    return mended, text


def _other_unit(channel: Channel, number: float) -> tuple[Channel, str]:
    text = f"{channel.name} reads {_number(number)} × what the rig gives"
    for unit in USUAL_UNITS[channel.quantity]:
        try:
            scale = units.scale(unit, channel.quantity.value, unit in ("deg", "rad", "rpm"))
        except DashpotError:
            continue
        another = abs(scale / channel.scale - 1) > 2 * CLOSE
        if another and number > 0 and abs(scale * number / channel.scale - 1) < CLOSE:
            stated = channel.unit if channel.unit else units.si_unit(channel.quantity.value)
            return replace(channel, unit=unit, scale=scale), f"{text}: {unit}, not {stated}?"
    gain = (1.0 if channel.gain is None else channel.gain) * number
    for ratio, word in RATIOS_IN_WORDS.items():
        if abs(abs(number) / ratio - 1) < CLOSE:
            text = f"{text}: {word}?"
    return replace(channel, gain=float(f"{gain:.6g}")), text


def _swap(model: Model, first: Channel, second: Channel, cause: Cause) -> Finding:
    new_first = replace(second, name=first.name)
    new_second = replace(first, name=second.name)
    change = f"[channels] {channel_line(new_first, model)}; {channel_line(new_second, model)}"
    text = f"{first.name} and {second.name} are exchanged"
    return Finding(
        cause.kind, cause.of, text, change, cause.remaining, None, channels=(new_first, new_second)
    )


def _of_rig(model: Model, cause: Cause, element: Element) -> Finding:
    number = 0.0 if cause.number is None else cause.number
    unit = element.unit(model.angles)
    if cause.kind == "value":
        stated = next(own for own in model.elements if own.name == element.name)
        text = f"{element.name} would be {number:.4g} {unit}, not {stated.value:g}"
        mended = replace(stated, value=None, guess=float(f"{number:.4g}") if number > 0 else None)
        other_unit = None if model.angles else unit_of_number(stated, stated.value, number)
        if other_unit is not None and stated.value is not None:
            text += f": {stated.value:g} {other_unit}?"
            scale = units.scale(other_unit, USUAL[stated.kind][0], False)
            mended = replace(stated, value=float(f"{stated.value * scale:.8g}"))
    else:
        where = (
            " and ".join(element.along)
            if len(element.along) > 1
            else f"{next(iter(element.along))} and the ground"
        )
        place = f"at {next(iter(element.along))}" if element.kind is Kind.MASS else f"between {where}"
        text = f"a {element.kind.value} {place} is missing: {number:.3g} {unit}"
        if element.kind is Kind.SPRING and number < 0 and len(element.along) > 1:
            text += " (negative, as where the parts between them bend)"
        mended = element
    change = f"[{mended.kind.section}] {element_line(mended)}"
    return Finding(cause.kind, cause.of, text, change, cause.remaining, cause.number, elements=(mended,))


def _changed(model: Model, cause: Cause) -> Finding:
    """A rig that is another in some of the runs."""
    shows = "shows" if cause.where.startswith("experiment") else "show"
    text = f"{cause.where} {shows} another rig than the others"
    if cause.element is not None and cause.number is not None:
        unit = cause.element.unit(model.angles)
        place = cause.element.name
        if place not in {element.name for element in model.elements}:
            place = f"a {cause.element.kind.value} between {' and '.join(cause.of)}"
        text += f": {place} differs by {_number(cause.number, '+.3g')} {unit}"
    change = f"identify {cause.where} by itself, or find out what was changed"
    return Finding(cause.kind, cause.of, text, change, cause.remaining, cause.number)


def _of_dwells(cause: Cause) -> tuple[str, str] | None:
    """What one dwell, or two, may have wrong; None where it is another thing."""
    match cause.kind:
        case "conjugate" if cause.of and cause.of[0].endswith(" Hz"):
            return (
                f"the phases of the dwell at {cause.of[0]} have the opposite sign",
                f"conjugate the amplitudes at {cause.of[0]}",
            )
        case "dwell":
            return (
                f"the dwell at {cause.of[0]} contradicts all others",
                f"leave out {cause.of[0]}, or measure it again",
            )
        case "frequency" if len(cause.of) == 2:
            first, second = cause.of
            return (
                f"the dwells labelled {first} and {second} are exchanged",
                f"label the dwell at {first} {second}, and the one at {second} {first}",
            )
        case "frequency" if cause.of:
            return (
                f"the dwell labelled {cause.of[0]} moves like one at {cause.number:.4g} Hz",
                f"label it {cause.number:.4g} Hz",
            )
        case _:
            return None


def _of_data(cause: Cause) -> tuple[str, str]:
    match cause.kind:
        case "conjugate" if cause.of:
            return f"the phase of {cause.of[0]} has the opposite sign", f"conjugate {cause.of[0]} in the data"
        case "conjugate":
            return (
                "all phases have the opposite sign: the data use e^(−jωt)",
                "change the sign of the imaginary parts",
            )
        case "crosstalk":
            first, second = cause.of
            share = 0.0 if cause.number is None else cause.number
            return (
                f"{first} shows {_number(share)} × {second} beside its own signal: cross-talk?",
                f"subtract {_number(share)} × {second} from {first}, or check cables and amplifier",
            )
        case "unit":
            return "the phases are radians, read as degrees", "give the phases in rad, as NAME_phase_rad"
        case "frequency":
            return _rate(1.0 if cause.number is None else cause.number)
        case _:
            name = cause.of[0] if cause.of else "one channel"
            return (
                f"{name} {cause.shows or 'contradicts all other channels, for no simple reason'}",
                f"leave {name} out, or check its sensor and where it is mounted",
            )


def _of_modes(cause: Cause) -> tuple[str, str] | None:
    """What measured modes alone may have wrong; None where it is another thing."""
    match cause.kind:
        case "sign":
            return (
                f"{cause.of[0]} counts the other way in all shapes: wrong sign?",
                f"change the sign of {cause.of[0]} in the shapes",
            )
        case "swap":
            first, second = cause.of
            return f"{first} and {second} are exchanged", f"exchange {first} and {second} in the shapes"
        case "unit" | "gain" if cause.of:
            number = _number(1.0 if cause.number is None else cause.number)
            return (
                f"{cause.of[0]} reads {number} × what the rig gives in all shapes",
                f"divide {cause.of[0]} by {number} in the shapes",
            )
        case "damping":
            ratio = 1.0 if cause.number is None else cause.number
            word = "loss factors" if ratio == 2.0 else "per cent"
            return (
                f"the damping ratios are {ratio:g} × what the rig gives: {word}?",
                f"divide them by {ratio:g}",
            )
        case "mode":
            return (
                f"the mode at {cause.of[0]} contradicts all others",
                f"leave out the mode at {cause.of[0]}, or measure it again",
            )
        case _:
            return None


def _rate(number: float) -> tuple[str, str]:
    """Frequencies are `number` times what is stated."""
    usual = {
        0.159155: "rad/s given as Hz",
        6.283185: "Hz given as rad/s",
        0.016667: "per minute for Hz",
    }
    word = next(
        (word for ratio, word in usual.items() if abs(number / ratio - 1) < 1e-3), "the time base is wrong"
    )
    text = f"the rig moves as at {number:.4g} × the stated frequencies: {word}"
    return text, f"multiply the frequencies by {number:.6g}"


def _number(value: float, form: str = ".4g") -> str:
    return f"{value:{form}}".replace("-", "−")


CHARACTER = {
    ("spring", "cubic"): "odd", ("spring", "quintic"): "odd", ("spring", "quadratic"): "odd",
    ("spring", "square"): "even", ("spring", "gap"): "with a clearance",
    ("spring", "one-sided"): "with a clearance on one side", ("spring", "jenkins"): "friction behind a spring",
    ("damper", "quadratic"): "damping that grows with speed", ("damper", "cubic"): "damping that grows with speed",
    ("damper", "coulomb"): "friction",
}  # fmt: skip


def nonlinear_finding(
    model: Model, points: tuple[str, ...], element: Element, number: float | None, remaining: float
) -> Finding:
    """A nonlinear element that the data call for, in words; the p-value is below that of CERTAIN."""
    assert element.force_law is not None
    value = 0.0 if number is None else number
    character = CHARACTER[element.kind.value, element.force_law.text]
    if element.kind is Kind.SPRING and element.force_law.text not in ("square", "jenkins"):
        character += ", stiffening" if value > 0 else ", softening"
    text = f"the data call for a nonlinear element between {' and '.join(points)}, {character} (p < 1e-6)"
    named = replace(with_open_constants(element), name=free_name(model, element), guess=float(f"{value:.4g}"))
    change = f"[{named.kind.section}] {element_line(named)}"
    return Finding("nonlinear", points, text, change, remaining, number, elements=(named,))


def free_name(model: Model, element: Element) -> str:
    """A name that the rig has not: what the law is usually called."""
    assert element.force_law is not None
    usual = {
        "cubic": "k3",
        "square": "k2",
        "quintic": "k5",
        "quadratic": "kq",
        "gap": "kgap",
        "one-sided": "kstop",
        "jenkins": "kslip",
        "coulomb": "fc",
        "d**4": "k4",
        "d**2*v": "c3",
    }
    word = usual[element.force_law.text]
    if element.kind is Kind.DAMPER and word.startswith("k"):
        word = "c" + word[1:]
    taken = {other.name for other in model.elements} | {*model.coordinates, *(i.name for i in model.inputs)}
    candidates = (word, *(f"{word}_{'_'.join(element.along)}{suffix}" for suffix in ("", "_2", "_3")))
    return next(name for name in candidates if name not in taken)


def mended_in_data(cause: Finding, where: str) -> Finding:
    """The finding with what to do with the numbers in `where`: the line of the rig file is right for other data."""
    number, names = cause.number, joined(cause.of)
    usual = None if number is None or cause.kind == "gain" else known_ratio(number)
    if number is not None and (cause.kind == "sign" or usual is not None):
        number = -1.0 if usual is None else math.copysign(usual, number)
    match cause.kind:
        case "swap":
            change = f"exchange {names} in {where}"
        case "delay" if number is not None:
            change = f"shift {names} by {_number(-1e3 * number)} ms in {where}"
        case "frequency" if number is not None:
            change = f"multiply the sampling rate of {where} by {number:.5g}"
        case "sign" | "unit" | "gain" if number is not None:
            change = f"multiply {names} by {_number(1 / number, '.6g')} in {where}"
        case _:
            change = f"measure {names} again in {where}"
    return replace(cause, change=change, channels=(), elements=())


def with_likely_causes(error: Failure, findings: Sequence[Finding]) -> Failure:
    """The error, with what may be behind it."""
    if not findings:
        return error
    more = [Problem(f"a likely cause: {each.text}", cure=each.change) for each in findings]
    explained = type(error)([*error.problems, *more])
    explained.causes = tuple(findings)
    return explained
