"""A rig file to start from: a chain of masses, shaken, pushed or let go, or an element on its stand; all unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from dashpot.errors import ModelError
from dashpot.io.toml_document import PLACEHOLDER, toml_key
from dashpot.io.words import quoted

MOST_MASSES = 50
STAND_IN = 1.0  # kg, of a first mass that nobody has weighed where nothing else gives the scale


Drive = Literal["base", "force", "release", "stand"]


@dataclass(frozen=True)
class ChannelLine:
    """A channel of a rig file: its column, the point, what is measured in which unit; PLACEHOLDER where it is open."""

    column: str
    of: str
    quantity: str
    unit: str
    raw: bool = False  # volts or counts, which want a sensitivity

    @property
    def line(self) -> str:
        """Its line in [channels]."""
        gain = f', gain = "{PLACEHOLDER}"' if self.raw else ""
        fields = (
            f"of = {quoted(self.of)}, quantity = {quoted(self.quantity)}, unit = {quoted(self.unit)}{gain}"
        )
        return f"{toml_key(self.column)} = {{ {fields} }}"


@dataclass(frozen=True)
class Chain:
    """What a few questions tell of a rig.

    masses     in a row, x1 the farthest from the base
    drive      "base": the base moves; "force": a force on the last mass, the base stands still; "release": nothing
               drives, the masses are let go; "stand": no masses, an element between a moved end and the ground
    motion     what the sensors on the masses (and on the base) measure
    unit       of their numbers
    force_unit of the force's
    known      kg of x1; None: it was not weighed, and where no force gives the scale STAND_IN stands there
    at         the mass that the force acts on; None: the last
    forces     how many forces act, f, f2, …; where the others do is left open
    sensors    the channels; none: every coordinate and what drives, of those names
    """

    name: str = "My rig"
    masses: int = 2
    drive: Drive = "base"
    motion: Literal["displacement", "velocity", "acceleration"] = "acceleration"
    unit: str = "m/s²"
    force_unit: str = "N"
    known: float | None = None
    at: str | None = None
    forces: int = 1
    sensors: tuple[ChannelLine, ...] = ()

    @property
    def lacks_scale(self) -> bool:
        """Whether only ratios to the first mass can be found."""
        return self.known is None and self.drive not in ("force", "stand")


def starter_text(chain: Chain) -> str:
    """The rig file, TOML, with what to do next in its comments.  Raises ModelError for numbers out of range."""
    if not 1 <= chain.masses <= MOST_MASSES:
        raise ModelError(f"a chain of {chain.masses} masses", cure=f"give 1 to {MOST_MASSES}")
    if chain.known is not None and not 0 < chain.known < 1e12:
        raise ModelError(f"a mass of {chain.known:g} kg", cure="give one above 0")
    names = [] if chain.drive == "stand" else [f"x{i + 1}" for i in range(chain.masses)]
    base = "u" if chain.drive == "base" else "ground"
    coordinates = ", ".join(f'"{name}"' for name in names)
    lines = [f"name = {quoted(chain.name)}", f"coordinates = [{coordinates}]"]
    if chain.drive in ("base", "stand"):
        lines += ["", "[inputs]", 'u = { kind = "displacement" }']
    elif chain.drive == "force":
        lines += ["", "[inputs]", f'f = {{ kind = "force", at = {quoted(chain.at or names[-1])} }}']
        for number in range(2, chain.forces + 1):
            lines.append(f'f{number} = {{ kind = "force", at = "{PLACEHOLDER}" }}')
    lines += [
        "",
        (
            "# An element without a value is estimated; value = …, sd = … is prior knowledge, such as a weighed "
            "mass."
        ),
        *_elements(chain, names, [*names, base] if names else ["u", "ground"]),
        "",
        "# One entry for each column of the data, under its name.",
        "[channels]",
        *([sensor.line for sensor in chain.sensors] or _usual(chain, names)),
    ]
    return "\n".join(lines) + "\n"


def _elements(chain: Chain, names: Sequence[str], points: Sequence[str]) -> Iterator[str]:
    """Sections of masses, springs and dampers; each spring and damper joins a point to the next."""
    if names:
        yield "[masses]"
        if chain.lacks_scale:
            yield (
                "# PLACEHOLDER: no force is measured, so one mass must be known. Replace this value by the "
                "weighed mass."
            )
    first = STAND_IN if chain.lacks_scale else chain.known
    for i, name in enumerate(names):
        value = f", value = {first!r}" if i == 0 and first is not None else ""
        yield f'm{i + 1} = {{ at = "{name}"{value} }}'
    for number, (section, letter) in enumerate((("springs", "k"), ("dampers", "c"))):
        yield from ("", f"[{section}]") if names or number else (f"[{section}]",)
        for i in range(len(points) - 1):
            yield f'{letter}{i + 1} = {{ between = ["{points[i]}", "{points[i + 1]}"] }}'


def _usual(chain: Chain, names: Sequence[str]) -> Iterator[str]:
    """Channels of every coordinate, and of the base or the force."""
    fields = f'quantity = "{chain.motion}", unit = {quoted(chain.unit)}'
    for name in [*names, "u"] if chain.drive == "base" else names:
        yield f'{name} = {{ of = "{name}", {fields} }}'
    if chain.drive == "force":
        yield f'f = {{ of = "f", unit = {quoted(chain.force_unit)} }}'
