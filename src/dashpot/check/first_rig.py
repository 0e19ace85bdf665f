"""A first rig for data that nobody has described: what their columns seem to measure, and what moves the rig.

Units say what is measured, names say it where there is no unit, and what is said by neither is left open.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dashpot.channel import RESERVED_NAMES, Quantity
from dashpot.data.inspection import Inspection, recognised
from dashpot.data.readers.columns import factors, is_unit, named_unit
from dashpot.errors import UsageError
from dashpot.io.toml_document import PLACEHOLDER
from dashpot.io.words import choose_from, listed
from dashpot.model.rigfile.writer import MOST_MASSES, Chain, ChannelLine, Drive
from dashpot.units import PIXELS

DECAYED = 0.5  # rms of the last quarter of a record over that of its first, below which the rig was let go


@dataclass(frozen=True)
class SeenColumn:
    """A column of the data: its name, unit and quantity (None: unknown), whether it may be the motion of the base."""

    name: str
    unit: str | None
    quantity: str | None
    of_base: bool
    decay: float = np.nan

    @property
    def raw(self) -> bool:
        """Whether its numbers are volts or counts, which want a sensitivity."""
        return bool(self.unit) and not any(factors(str(self.unit), quantity.value) for quantity in Quantity)

    def may_be_in(self, unit: str) -> bool:
        """Whether the unit is one of what its name says, where that says anything."""
        return self.quantity is None or not is_unit(unit) or bool(factors(unit, self.quantity))

    def in_unit(self, unit: str) -> SeenColumn:
        """The same in a unit that somebody has said.  Raises UsageError if it is none."""
        if not is_unit(unit):
            raise UsageError(
                f"{unit!r} is not a unit of a measured quantity", cure="use one such as mm, m/s, g, N or V"
            )
        quantity = next((q.value for q in Quantity if factors(unit, q.value)), self.quantity)
        return replace(self, unit=unit, quantity=quantity)


@dataclass(frozen=True)
class SeenData:
    """All columns of some files, and what drives the rig as far as they tell.

    timed  whether samples have times, or need none
    sure   whether no other drive is as likely
    renamed  {file: {channel: its column}} of files that hold the channels of the first file under other names
    """

    columns: tuple[SeenColumn, ...]
    drive: Drive
    sure: bool
    timed: bool
    renamed: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def seen_data(inspections: Sequence[Inspection]) -> SeenData:
    """What files seem to hold.  Raises UsageError if they hold no channel, or too many."""
    by_name: dict[str, SeenColumn] = {}
    renamed, first = dict[str, Mapping[str, str]](), list[SeenColumn]()
    for inspection in inspections:
        mine = _columns(inspection)
        first = first or mine
        if names := _renamed(first, mine):
            renamed[inspection.source] = names
            continue
        for column in mine:
            by_name.setdefault(column.name, column)
    columns = tuple(by_name.values())
    parts = [part for inspection in inspections for part in inspection.parts]
    if not columns or len(columns) > MOST_MASSES:
        what = f"{len(columns)} channels" if columns else "no channel in these data"
        raise UsageError(what, cure=f"start from files with 1 to {MOST_MASSES} channels, or with dashpot new")
    timed = all(part.complexes or part.rates_hz is not None for part in parts if part.columns)
    forces = [c for c in columns if c.quantity == "force"]
    bases = [c for c in columns if c.quantity != "force" and c.of_base]
    others = [c for c in columns if c not in forces and c not in bases]
    if forces:
        travel = [c for c in (*bases, *others) if c.quantity == "displacement"]
        stand = len(forces) == 1 and len(columns) == 2 and len(travel) == 1
        stand = stand and not any(part.complexes for part in parts)
        return SeenData(columns, "stand" if stand else "force", bool(others) and not stand, timed, renamed)
    if bases and others:
        return SeenData(columns, "base", True, timed, renamed)
    decays = [c.decay for c in columns if np.isfinite(c.decay)]
    let_go = bool(decays) and max(decays) < DECAYED
    return SeenData(columns, "release" if let_go else "base", let_go, timed, renamed)


def _columns(inspection: Inspection) -> list[SeenColumn]:
    """The columns of a file that may be channels."""
    found: dict[str, SeenColumn] = {}
    for channel in (each for part in inspection.parts for each in part.channels):
        if channel.name.lower() not in RESERVED_NAMES:
            stated = channel.unit if channel.unit and is_unit(channel.unit) else None
            unit, quantity, of_base = recognised(channel.name, stated)
            of_base |= channel.of_input and quantity != "force"
            found.setdefault(channel.name, SeenColumn(channel.name, unit, quantity, of_base, channel.decay))
    return list(found.values())


def _renamed(first: Sequence[SeenColumn], other: Sequence[SeenColumn]) -> dict[str, str]:
    """{channel: column} where another file holds what drives and what moves in the same order, all under other names.

    Quantities, units and numbers in the names agree: sensors that were moved, a1 and then a4, are other channels.
    """
    if len(first) != len(other) or {c.name for c in first} & {c.name for c in other}:
        return {}
    for a, b in zip(first, other, strict=True):
        same = [re.findall(r"\d+", named_unit(c.name)[0])[-1:] for c in (a, b)]
        scales = [factors(c.unit or "", c.quantity or "time") for c in (a, b)]
        alike = a.quantity == b.quantity is not None and a.of_base == b.of_base and scales[0] == scales[1]
        if not alike or (all(same) and same[0] != same[1]):
            return {}
    driven = any(c.of_base or c.quantity == "force" for c in first)
    return {a.name: b.name for a, b in zip(first, other, strict=True)} if driven else {}


def _same_point(column: SeenColumn, columns: Sequence[SeenColumn], points: Mapping[str, str]) -> str | None:
    """The point of an earlier column of another quantity whose name ends in the same number: x1 and a1."""
    number = re.search(r"\d+$", named_unit(column.name)[0])
    for other in columns:
        if other is column or number is None:
            return None
        alike = re.search(r"\d+$", named_unit(other.name)[0])
        known = column.quantity and other.quantity and column.quantity != other.quantity
        if other.name in points and alike is not None and alike[0] == number[0] and known:
            return points[other.name]
    return None


def first_rig(
    data: SeenData,
    name: str,
    drive: Drive,
    known: float | None = None,
    at: str | None = None,
    base: str | None = None,
) -> Chain:
    """The rig of some columns: a mass for each that moves, in the order of the columns, the last next to the base.

    Columns of different quantities whose names end in one number are of one mass.  `known` kg of the first mass, `at`
    the one that the force acts on, `base` the column of the base.  What is unknown of a channel is left open.  Raises
    UsageError if the columns cannot be those of such a rig.
    """
    sensors, points = list[ChannelLine](), dict[str, str]()
    forces = [c for c in data.columns if c.quantity == "force"]
    bases = [c for c in data.columns if c not in forces and c.of_base]
    moving = [c for c in data.columns if c not in forces]
    if base is not None:
        bases = [c for c in moving if c.name == base]
        if drive != "base" or not bases:
            what = f"no motion channel is called {base}" if drive == "base" else f"{base} cannot be the base"
            raise UsageError(what, cure=f"{choose_from(c.name for c in moving)}, driven by the base")
    if drive == "base":
        moving = [c for c in moving if c not in bases]
        if not moving:  # all are called like a base
            bases, moving = bases[-1:], bases[:-1]
    if (drive == "force" and not forces) or (drive == "stand" and len(forces) != 1):
        what = f"{len(forces)} columns are forces" if forces else "no column is a force"
        cure = "a test stand needs exactly one" if drive == "stand" else "choose another"
        raise UsageError(what, "--driven-by", cure)
    if drive != "stand" and not moving:
        raise UsageError("no column is a motion of the rig", "--driven-by", "choose another")
    if drive == "stand" and len(moving) != 1:
        raise UsageError(
            f"{len(moving)} columns are motions", "--driven-by", "a test stand needs exactly one"
        )
    camera = all(column.unit in PIXELS for column in data.columns)  # one scale, which no value depends on
    for column in data.columns:
        if column in forces:
            number = forces.index(column) + 1
            of = {"stand": "u", "force": "f" if number == 1 else f"f{number}"}.get(drive, PLACEHOLDER)
        elif drive == "stand" or (drive == "base" and column in bases):
            of = "u"
        else:
            of = points.setdefault(
                column.name, _same_point(column, data.columns, points) or f"x{len(set(points.values())) + 1}"
            )
        gain = (1 if camera else PLACEHOLDER) if column.raw else None
        quantity, unit = column.quantity or PLACEHOLDER, column.unit or PLACEHOLDER
        sensors.append(ChannelLine(column.name, of, quantity, unit, gain))
    masses = len(set(points.values()))
    if drive == "base" and not bases and sensors:  # the base is one of the columns, and nothing states which
        sensors[-1] = replace(sensors[-1], of=PLACEHOLDER)
        masses = max(masses - 1, 1)
    if drive == "force" and at is None:
        at = "x1" if masses == 1 else PLACEHOLDER
    elif drive == "force" and at not in (places := [f"x{i + 1}" for i in range(masses)]):
        raise UsageError(
            f"there is no mass {at} for the force to act on", cure=f"choose one of {listed(places)}"
        )
    return Chain(name, max(masses, 1), drive, known=known, at=at, forces=len(forces), sensors=tuple(sensors))
