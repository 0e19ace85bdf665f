"""What stands beside the parts of a drawing: names, values with intervals, laws, sensors."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from dashpot.channel import Channel, Quantity
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.present.estimate import parameter_rows
from dashpot.present.schematic.bodies import Body, Push
from dashpot.present.schematic.symbols import SMALL, TEXT, Line, Tone, shortened
from dashpot.present.words import plain, short

Knowledge = Literal["unknown", "known", "doubtful"]
BADGES: Mapping[Quantity, str] = {
    Quantity.DISPLACEMENT: "d",
    Quantity.VELOCITY: "v",
    Quantity.ACCELERATION: "a",
    Quantity.FORCE: "F",
}


@dataclass(frozen=True)
class Labels:
    """Lines of text for each part of a rig; `values` are name → (knowledge, value with unit, interval)."""

    model: Model
    channels: tuple[Channel, ...]
    values: Mapping[str, tuple[Knowledge, str, str]]
    calibrations: Mapping[str, str]
    between: frozenset[int] = frozenset()  # channels that are drawn as links
    numbers: bool = True

    def knowledge(self, element: Element) -> Knowledge:
        """Whether a parameter is unknown (or estimated), known, or doubtful."""
        return self.values[element.name][0]

    def element(self, element: Element) -> list[Line]:
        """Name and value, interval, law, what it is stretched along where that is not plain, sensors of its force."""
        lines = self.value_lines(element)
        if not self.numbers:
            return lines
        if element.force_law is not None:
            lines.append(Line(f"law {shortened(law_in_symbols(element.force_law.text))}", "muted", SMALL))
            for constant in element.force_law.constants:
                name = f"{element.name}.{constant.name}"
                known, value, _ = self.values.get(name, ("known", plain(constant.value or 0.0), ""))
                lines.append(Line(f"{constant.name} = {value}{_mark(known)}", known, SMALL))
        if any(abs(factor) != 1 for factor in element.along.values()) or len(element.along) > 2:
            lines.append(Line(shortened(elongation(element.along), 34), "muted", SMALL))
        return lines + self._sensors({element.name})

    def value_lines(self, element: Element) -> list[Line]:
        """Name with value and, below it, the interval."""
        known, value, interval = self.values[element.name]
        if not self.numbers:
            return [Line(shortened(element.name, 14) + _mark(known), known, SMALL, known != "known")]
        lines = [Line(f"{shortened(element.name)} = {value}{_mark(known)}", known, TEXT, known != "known")]
        return [*lines, Line(interval, "muted", SMALL)] if interval else lines

    def body(self, body: Body) -> list[Line]:
        """Coordinates, masses and sensors of a body."""
        lines = []
        for point in body.points:
            arrow = "" if body.role == "base" else "↻ " if point in self.model.angles else "→ "
            lines.append(Line(f"{arrow}{shortened(point)}", "ink", TEXT + 1, True))
        for index in body.masses:
            element = self.model.elements[index]
            lines += self.value_lines(element)
            if any(factor != 1 for factor in element.along.values()):
                lines.append(Line(shortened(elongation(element.along), 34), "muted", SMALL))
        return lines + self._sensors(set(body.points))

    def push(self, push: Push, first: bool) -> list[Line]:
        """A force or moment with its factor; its sensors beside the first of its arrows."""
        factor = "" if push.factor == 1 else "−" if push.factor == -1 else f"{push.factor:g} "
        turning = "↻ " if push.turns else ""
        lines = [Line(f"{turning}{factor}{shortened(push.source)}", "drive", TEXT, True)]
        return lines + (self._sensors({push.source}) if first else [])

    def channel(self, index: int) -> list[Line]:
        """A sensor between two bodies."""
        return [self._sensor(self.channels[index], ends=False)]

    def _sensors(self, points: Collection[str]) -> list[Line]:
        """Channels whose first point is one of these."""
        return [
            self._sensor(channel, ends=len(channel.of) > 1)
            for i, channel in enumerate(self.channels)
            if next(iter(channel.of)) in points and i not in self.between
        ]

    def _sensor(self, channel: Channel, ends: bool) -> Line:
        text = shortened(channel.name)
        if ends:
            text += f": {shortened(elongation(channel.of), 30)}"
        for what in ("gain", "delay", "sign"):
            value = self.calibrations.get(f"{channel.name}.{what}")
            if value is not None:
                text += f", {what} {value}"
        return Line(text, "sensor", SMALL, badge=BADGES[channel.quantity])


def labels(
    model: Model,
    channels: Sequence[Channel],
    estimate: Estimate | None,
    doubtful: Collection[str],
    between: Collection[int] = (),
    level: float = 0.95,
    *,
    numbers: bool = True,
) -> Labels:
    """Labels of a rig, with values and intervals of an estimate where there is one.

    `between` are indices of channels that are drawn as links; without `numbers` only names stand there.
    """
    # What the rig file says of each parameter
    values: dict[str, tuple[Knowledge, str, str]] = {}
    for element, tie in zip(model.elements, model.ties, strict=True):
        root = model.elements[tie.root]
        known: Knowledge = "unknown" if root.value is None or root.sd is not None else "known"
        text = "?"
        if element.same_as is not None:
            text = ("" if element.times == 1 else f"{element.times:g} × ") + element.same_as
        elif element.value is not None:
            spread = "" if element.sd is None else f" ± {short(element.sd, 2)}"
            text = _with_unit(plain(element.value) + spread, model.unit(element))
        values[element.name] = (known, text, "")
    for owner, constant in model.constants:
        text = "?" if constant.value is None else plain(constant.value)
        values[f"{owner.name}.{constant.name}"] = ("unknown" if constant.unknown else "known", text, "")
    for row in () if estimate is None else parameter_rows(estimate, level):
        interval = f"{row.low} … {row.high}" if row.low else row.tie
        values[row.name] = ("known" if row.known else "unknown", _with_unit(row.value, row.unit), interval)
    for name in doubtful:
        if name in values:
            values[name] = ("doubtful", *values[name][1:])
    calibrations = _calibrations(channels, estimate)
    return Labels(model, tuple(channels), values, calibrations, frozenset(between), numbers)


def _calibrations(channels: Sequence[Channel], estimate: Estimate | None) -> dict[str, str]:
    """ "NAME.gain" → its text: what was found, or ? where it is unknown."""
    values: dict[str, str] = {}
    for channel in channels:
        for what, number in (("gain", channel.gain), ("delay", channel.delay), ("sign", channel.sign)):
            if number is None:
                values[f"{channel.name}.{what}"] = "?"
    if estimate is not None:
        rows = {row.name: row for row in parameter_rows(estimate)}
        shared = {f"{c.name}.gain": c.unknown_gain.name for c in channels if c.unknown_gain is not None}
        shared |= {f"{c.name}.delay": c.unknown_delay.name for c in channels if c.unknown_delay is not None}
        for name in list(values):
            row = rows.get(name, rows.get(shared.get(name, "")))
            if row is not None:
                values[name] = _with_unit(row.value, row.unit)
        for name, sign in estimate.signs.items():
            values[f"{name}.sign"] = "+" if float(sign) > 0 else "−"
    return values


def _with_unit(text: str, unit: str) -> str:
    return text if unit in ("", "1") or text == "?" else f"{text} {unit}"


_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def law_in_symbols(text: str) -> str:
    """A law as it is written by hand: d**2*v is d²·v."""
    raised = re.sub(r"\*\*(\d+)", lambda match: match[1].translate(_RAISED), text)
    return raised.replace("*", "·")


def _mark(known: Tone) -> str:
    return " (?)" if known == "doubtful" else ""


def elongation(along: Mapping[str, float]) -> str:
    """A combination of points: "x1 + 0.4 pitch − u"."""
    terms = []
    for point, factor in along.items():
        size = "" if abs(factor) == 1 else f"{abs(factor):.3g} "
        terms.append(f"{'−' if factor < 0 else '+'} {size}{shortened(point)}")
    text = " ".join(terms)
    return text.removeprefix("+ ") if text.startswith("+ ") else f"−{text[2:]}"
