"""The sections of a rig file that hold elements, and nonlinear laws: `law = "d**3"`, constants beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from dashpot.errors import ModelError, UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, quoted, written
from dashpot.model.elements import Element
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law, unit_of
from dashpot.model.rigfile.rig import scale_of_points
from dashpot.model.rigfile.schema import GROUND, NUMBERS, SECTIONS, ConstantEntry, ElementEntry, RigReading
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


# Nonlinear laws and their inner constants.


def split_constants(raw: object) -> tuple[object, dict[str, Any]]:
    """An element's table without the inner constants of its law, and these; without a law, all of it and nothing."""
    if not isinstance(raw, dict) or "law" not in raw:
        return raw, {}
    constants = {key: value for key, value in raw.items() if key not in ElementEntry.model_fields}
    return {key: value for key, value in raw.items() if key not in constants}, constants


def read_law(
    reading: RigReading, place: Place, entry: ElementEntry, constants: Mapping[str, Any]
) -> ForceLaw | None:
    """The law that an entry gives; None where it gives none, or none that can be read."""
    if entry.law is None:
        return None
    if place[0] not in ("springs", "dampers"):
        cure = "leave it out, or write the element into [springs] or [dampers]"
        reading.report.add((*place, "law"), "laws belong to springs and dampers", cure)
        return None
    if entry.unit is not None:
        cure = "leave it out; numbers are in SI units"
        reading.report.add((*place, "unit"), "the unit follows from the law", cure)
        return None
    entries = {
        name: reading.constant_entry(
            (*place, name), raw, f"{name} is neither a key of elements nor a constant of the law"
        )
        for name, raw in constants.items()
    }
    damper, before = place[0] == "dampers", reading.problems
    try:
        law = force_law(entry.law, [Constant(name) for name in entries], damper=damper)
        inner = [
            _constant(reading, (*place, name), given, law)
            for name, given in entries.items()
            if given is not None
        ]
        whole = len(inner) == len(entries) and reading.problems == before
        return force_law(entry.law, inner, damper=damper) if whole else None
    except ModelError as error:
        reading.include((*place, "law"), error)
        return None


def _constant(reading: RigReading, place: Place, entry: ConstantEntry, law: ForceLaw) -> Constant:
    """A constant in SI units; told where its numbers make no sense."""
    name, before = str(place[-1]), reading.problems
    exponents = law.exponents[1].get(name, (0.0, 0.0))
    constant = Constant(name, **reading.stated(place, entry, partial(_scale, exponents=exponents)))
    stated = [number for number in (constant.value, constant.guess, constant.upper) if number is not None]
    if reading.problems == before and name in law.positive and any(number <= 0 for number in stated):
        reading.report.add(place, f"{name} of the law {law.text!r} must be positive", "change it")
    return constant


def _scale(unit: str, exponents: tuple[float, float]) -> float:
    """The factor of a constant's unit; between angles what counts in metres elsewhere counts in radians."""
    try:
        return factor_between(unit, unit_of(exponents))
    except UsageError:
        try:
            return factor_between(unit, unit_of(exponents, angle=True))
        except UsageError:
            pass
        raise


def law_fields(law: ForceLaw) -> dict[str, str]:
    """The keys that say a law in a rig file."""
    fields = {"law": quoted(law.text)}
    for constant in law.constants:
        numbers = {key: getattr(constant, field) for key, field in NUMBERS.items()}
        given = {key: repr(float(number)) for key, number in numbers.items() if number is not None}
        if set(given) == {"value"}:
            fields[constant.name] = given["value"]
        else:
            inside = ", ".join(f"{key} = {text}" for key, text in given.items())
            fields[constant.name] = f"{{ {inside} }}" if given else quoted("unknown")
    return fields
