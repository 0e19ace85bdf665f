"""The sections of a rig file that hold elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, quoted, written
from dashpot.model.elements import Element
from dashpot.model.rigfile.force_laws import read_law, split_constants
from dashpot.model.rigfile.rig import scale_of_points
from dashpot.model.rigfile.schema import GROUND, SECTIONS, ElementEntry, RigReading
from dashpot.quantities import Amount
from dashpot.units import factor_between


def read_elements(reading: RigReading) -> list[Element]:
    """The elements of all sections, in the order of the file."""
    elements = []
    for section in (key for key in reading.table if key in SECTIONS):
        for name, raw in reading.entries(section):
            element = read_element(reading, (section, name), raw)
            elements += [] if element is None else [element]
    tables = (reading.table.get(section) for section in SECTIONS)
    names = {name: None for table in tables if isinstance(table, dict) for name in table}
    for element in elements:
        target = element.same_as
        if target is not None and target not in names:
            cure = f"{did_you_mean(target, names)}there are {listed(names)}"
            place = (element.kind.section, element.name, "same_as")
            reading.report.add(place, f"{written(target)} is not an element", cure)
            reading.faulty.add(element.name)
    return elements


def read_element(reading: RigReading, place: Place, raw: object) -> Element | None:
    """The element at a place of the file that ends in its section and name; None, and told, where it is faulty."""
    before, section, name = reading.problems, str(place[-2]), str(place[-1])
    keys, constants = split_constants(raw)
    entry = reading.entry(ElementEntry, section, name, keys, place)
    element = None if entry is None else _element(reading, place, entry, constants)
    if element is None or reading.problems > before:
        reading.faulty.add(name)
        return None
    return element


def _element(
    reading: RigReading, place: Place, entry: ElementEntry, constants: Mapping[str, Any]
) -> Element | None:
    """An element with its numbers in SI units; None, and told, where it is not said what it is or is attached to."""
    before = reading.problems
    law = read_law(reading, place, entry, constants)
    along = _attachment(reading, place, entry)
    if reading.problems > before:
        return None
    section, name = str(place[-2]), str(place[-1])
    element = Element(name, SECTIONS[section], along, same_as=entry.same_as, times=entry.times, force_law=law)
    scale_of = partial(
        scale_of_points, quantity=element.law.quantity, along=element.along, angles=reading.angles
    )
    if law is not None:
        scale_of = partial(factor_between, wanted=element.unit(reading.angles))
    plain = 1.0
    if entry.unit is not None:
        plain = reading.in_si((*place, "unit"), Amount(1.0, entry.unit), 1.0, scale_of)
    return replace(element, **reading.numbers(place, entry, plain, scale_of))


def _attachment(reading: RigReading, place: Place, entry: ElementEntry) -> dict[str, float]:
    """Points and factors of the elongation; told where they are not said."""
    given = [key for key in ("at", "between", "along") if getattr(entry, key) is not None]
    if len(given) != 1:
        usual = 'at = "x1"' if place[-2] == "masses" else 'between = ["x1", "ground"]'
        what = f"{' and '.join(given)} are both given" if given else "nothing says what it is attached to"
        reading.report.add(place, what, "keep the one that is right" if given else f"add {usual}")
        return {}
    at, before = (*place, given[0]), reading.problems
    if entry.between is not None:
        first, second = entry.between
        if place[-2] == "masses":
            point = next((point for point in entry.between if point != GROUND), "x1")
            cure = f"write at = {quoted(point)}; an inertance between two points belongs in [inerters]"
            reading.report.add(at, "a mass has one place, not two", cure)
        elif first == second:
            reading.report.add(at, f"both ends are at {first}", "name two different points")
        along = {first: 1.0, second: -1.0}
    else:
        along = reading.factors(at, entry.at or entry.along or {})
    if reading.problems > before:
        return along
    for point in along:
        if point in reading.inputs and reading.inputs[point].kind == "force":
            cure = f"attach it to the coordinate that {point} acts at"
            reading.report.add(at, f"{point} is a force, not a point", cure)
            return along
    reading.require_points(at, along, reading.attachable)
    attached = {point: factor for point, factor in along.items() if point != GROUND}
    if not attached:
        what = "it is attached to nothing but the ground"
        reading.report.add(at, what, "attach it to a coordinate")
    return attached
