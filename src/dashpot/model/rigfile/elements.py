"""The sections of a rig file that hold elements."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, quoted, written
from dashpot.model.elements import Element
from dashpot.model.rigfile.amounts import factors, in_si, read_numbers
from dashpot.model.rigfile.force_laws import read_law, split_constants
from dashpot.model.rigfile.reading import RigReading
from dashpot.model.rigfile.rig import scale_of_points
from dashpot.model.rigfile.schema import GROUND, SECTIONS, ElementEntry
from dashpot.quantities import Amount
from dashpot.units import factor_between


@dataclass(frozen=True)
class Points:
    """What elements can be attached to, what they cannot although it is named, and which of the points are angles."""

    points: Collection[str]
    forces: frozenset[str]
    angles: frozenset[str]


def read_elements(reading: RigReading, points: Points) -> list[Element]:
    """The elements of all sections, in the order of the file."""
    elements = []
    for section in (key for key in reading.table if key in SECTIONS):
        for name, raw in reading.entries(section):
            keys, constants = split_constants(raw)
            entry = reading.entry(ElementEntry, section, name, keys)
            element = (
                None if entry is None else _element(reading, section, name, entry, raw, points, constants)
            )
            if element is None:
                reading.faulty.add(name)
            else:
                elements.append(element)
    _check_ties(reading, elements)
    return elements


def _check_ties(reading: RigReading, elements: list[Element]) -> None:
    tables = (reading.table.get(section) for section in SECTIONS)
    names = {name: None for table in tables if isinstance(table, dict) for name in table}
    for element in elements:
        target = element.same_as
        if target is not None and target not in names:
            cure = f"{did_you_mean(target, names)}there are {listed(names)}"
            place = (element.kind.section, element.name, "same_as")
            reading.report.add(place, f"{written(target)} is not an element", cure)
            reading.faulty.add(element.name)


def _element(
    reading: RigReading, section: str, name: str, entry: ElementEntry, raw: Mapping[str, Any], points: Points,
    constants: Mapping[str, Any],
) -> Element | None:  # fmt: skip
    place = (section, name)
    law, good = read_law(reading, place, entry, constants)
    along = _attachment(reading, place, entry, raw, points)
    if along is None or not good:
        return None
    element = Element(name, SECTIONS[section], along, same_as=entry.same_as, times=entry.times, force_law=law)
    numbers = _numbers(reading, place, entry, element, points.angles)
    return None if numbers is None else replace(element, **numbers)


def _numbers(
    reading: RigReading, place: Place, entry: ElementEntry, element: Element, angles: Collection[str]
) -> dict[str, Any] | None:
    """Value, sd, guess and limits in SI units under the names of Element; None, and told, where one is faulty."""

    def scale_of(unit: str) -> float:
        if element.force_law is not None:
            return factor_between(unit, element.unit(angles))
        return scale_of_points(unit, element.law.quantity, element.along, angles)

    plain = (
        1.0
        if entry.unit is None
        else in_si(reading, (*place, "unit"), Amount(1.0, entry.unit), 1.0, scale_of)
    )
    if plain is None:
        return None
    return read_numbers(reading, place, entry, plain, scale_of)


def _attachment(
    reading: RigReading, place: Place, entry: ElementEntry, raw: Mapping[str, Any], points: Points
) -> dict[str, float] | None:
    """Points and factors of the elongation; None, and the problem reported, where they are not said."""
    key = _way_of_attachment(reading, place, entry)
    if key is None or (entry.between is not None and not _two_points(reading, place, entry.between)):
        return None
    if entry.between is not None:
        along = {entry.between[0]: 1.0, entry.between[1]: -1.0}
    else:
        given = factors(reading, (*place, key), entry.at or entry.along or {}, points.angles)
        if given is None:
            return None
        along = given
    for point in along:
        if point in points.forces:
            cure = f"attach it to the coordinate that {point} acts at"
            reading.report.add((*place, key), f"{point} is a force, not a point", cure)
            return None
    if not reading.points_known((*place, key), along, points.points, isinstance(raw.get(key), dict)):
        return None
    attached = {point: factor for point, factor in along.items() if point != GROUND}
    if not attached:
        what = "it is attached to nothing but the ground"
        reading.report.add((*place, key), what, "attach it to a coordinate")
        return None
    return attached


def _way_of_attachment(reading: RigReading, place: Place, entry: ElementEntry) -> str | None:
    given = [key for key in ("at", "between", "along") if getattr(entry, key) is not None]
    if len(given) == 1:
        return given[0]
    if given:
        what = f"{' and '.join(given)} are both given"
        reading.report.add(place, what, "keep the one that is right")
    else:
        usual = 'at = "x1"' if place[0] == "masses" else 'between = ["x1", "ground"]'
        reading.report.add(place, "nothing says what it is attached to", f"add {usual}")
    return None


def _two_points(reading: RigReading, place: Place, pair: list[str]) -> bool:
    place_of_pair = (*place, "between")
    if place[0] == "masses":
        first = next((point for point in pair if point != GROUND), "x1")
        cure = f"write at = {quoted(first)}; an inertance between two points belongs in [inerters]"
        reading.report.add(place_of_pair, "a mass has one place, not two", cure)
        return False
    if pair[0] == pair[1]:
        reading.report.add(place_of_pair, f"both ends are at {pair[0]}", "name two different points")
        return False
    return True
