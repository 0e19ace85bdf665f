"""The sections of a rig file that hold elements, and nonlinear laws: `law = "d**3"`, constants beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from dashpot.channel import Channel, Experiment
from dashpot.errors import ModelError, UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, quoted, written
from dashpot.model.elements import Element
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law, unit_of
from dashpot.model.rigfile.channels import read_channel
from dashpot.model.rigfile.rig import scale_of_points
from dashpot.model.rigfile.schema import (
    EXPERIMENTS,
    GROUND,
    NUMBERS,
    SECTIONS,
    ConstantEntry,
    ElementEntry,
    RigReading,
)
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
    """The element at a place of the file that ends in its section and name; None, and reported, if it is faulty."""
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
    """An element with its numbers in SI units; None, and reported, if it is not said what it is or is attached to."""
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
    """Points and factors of the elongation; reported if they are not said."""
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
    """The law that an entry gives; None if it gives none, or none that can be read."""
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
    """A constant in SI units; reported if its numbers make no sense."""
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


# Experiments in a rig file: what differs by run.
#
# [experiments.added]
# data = "run2*.csv"                            # patterns of its files; or files and rows that name it themselves
# m3 = "1.2 kg"                                 # another known value there; { value = 1.2, sd = "1 %" } as well
# c1 = "own"                                    # an unknown of its own, c1@added, with what is known of c1
# masses.extra = { at = "x2", value = 0.5 }     # an element that is there in this experiment only
# x1.gain = 1.02                                # another gain, delay or sign of a channel


CALIBRATIONS = ("gain", "delay", "sign")
OWN = "own"


def tables_of(reading: RigReading) -> dict[str, Mapping[str, Any]]:
    """The tables of the experiments by name; what is no table or no usable name is told."""
    found: dict[str, Mapping[str, Any]] = {}
    for name, raw in reading.entries(EXPERIMENTS):
        place = (EXPERIMENTS, name)
        if not isinstance(raw, dict):
            cure = f'write [experiments.{name}] and below it data = "run2*.csv"'
            reading.report.add(place, f"{written(raw)} is not a table", cure)
        elif not name.isprintable() or name != name.strip() or not name or "@" in name:
            reading.report.add(place, f"{written(name)} is not a usable name", "leave out @ and line breaks")
        else:
            found[name] = raw
    return found


def elements_of(reading: RigReading, tables: Mapping[str, Mapping[str, Any]]) -> list[Element]:
    """Elements that belong to one experiment each: those that take the place of others, and those added.

    `reading.elements` are those of the rig.  What is tied to an element that differs follows it.
    """
    own: list[Element] = []
    channels = _channel_tables(reading)
    for experiment, table in tables.items():
        before = len(own)
        for key, raw in table.items():
            place = (EXPERIMENTS, experiment, key)
            if key in SECTIONS:
                own += _added(reading, place, raw, experiment)
            elif key in reading.elements:
                numbers = raw
                if key in channels and isinstance(raw, dict):
                    numbers = {name: value for name, value in raw.items() if name not in CALIBRATIONS}
                element = None if numbers == {} and raw else _other(reading, place, numbers)
                own += [] if element is None else [element]
            elif key != "data" and key not in channels and not reading.faulty:
                names = (*reading.elements, *channels)
                cure = f"{did_you_mean(key, names)}there are {listed(names)}"
                reading.report.add(place, f"{written(key)} is neither an element nor a channel", cure)
        own += _followers(reading, own[before:], experiment)
    if own and any(element.force_law is not None for element in (*reading.elements.values(), *own)):
        cure = "identify the runs separately, with a rig file each"
        reading.report.add(
            (EXPERIMENTS,), "a nonlinear rig cannot have elements that differ by experiment", cure
        )
    return own


def experiments_of(reading: RigReading, tables: Mapping[str, Mapping[str, Any]]) -> tuple[Experiment, ...]:
    """The experiments with the patterns of their files, and the channels that are calibrated otherwise in them."""
    channels = _channel_tables(reading)
    found = []
    for name, table in tables.items():
        own: list[Channel] = []
        for key, raw in table.items():
            if key not in channels:
                continue
            changes = {k: raw[k] for k in raw if k in CALIBRATIONS} if isinstance(raw, dict) else {}
            others = [k for k in raw if k not in CALIBRATIONS] if isinstance(raw, dict) else []
            if others and key not in reading.elements:
                cure = (
                    f"{did_you_mean(others[0], CALIBRATIONS)}a channel may have another gain, delay or sign"
                )
                reading.report.add((EXPERIMENTS, name, key, others[0]), "unknown key", cure)
            elif changes:
                channel = _calibrated(reading, (EXPERIMENTS, name, key), channels[key], changes)
                own += [] if channel is None else [channel]
            elif key not in reading.elements:
                cure = f"write {key}.gain = 1.02, or a delay or sign"
                reading.report.add((EXPERIMENTS, name, key), f"{written(raw)} calibrates no channel", cure)
        found.append(Experiment(name, _patterns(reading, name, table), tuple(own)))
    return tuple(found)


def _patterns(reading: RigReading, name: str, table: Mapping[str, Any]) -> tuple[str, ...]:
    raw = table.get("data", [])
    patterns = [raw] if isinstance(raw, str) else raw
    if isinstance(patterns, list) and all(isinstance(each, str) and each for each in patterns):
        return tuple(patterns)
    cure = 'write names or patterns in quotes, such as data = "run2*.csv"'
    reading.report.add((EXPERIMENTS, name, "data"), f"{written(raw)} is no name of files", cure)
    return ()


def _channel_tables(reading: RigReading) -> Mapping[str, Any]:
    """What the file says of each channel; where it lists none, those of coordinates and inputs."""
    if "channels" in reading.table:
        return dict(reading.entries("channels"))
    return {name: {"of": name} for name in dict.fromkeys((*reading.head.coordinates, *reading.inputs))}


def _calibrated(reading: RigReading, place: Place, raw: Any, changes: Mapping[str, Any]) -> Channel | None:
    """The channel as it is in one experiment."""
    _, experiment, name = place
    if not isinstance(raw, dict):  # which has been told
        return None
    kept = {key: value for key, value in raw.items() if not (key == "same_gain_as" and "gain" in changes)}
    stated = {key: "unknown" if value == OWN else value for key, value in changes.items()}
    channel = read_channel(reading, f"{name}@{experiment}", {**kept, **stated}, place)
    return None if channel is None else replace(channel, only=str(experiment))


def _other(reading: RigReading, place: Place, raw: object) -> Element | None:
    """The element that takes the place of one of the rig in an experiment; None, and told, where it cannot be read."""
    _, experiment, name = place
    base, before = reading.elements[str(name)], reading.problems
    other = replace(base, name=f"{name}@{experiment}", only=str(experiment), stands_for=base.name)
    other = replace(other, same_as=None, times=1.0)
    if raw == OWN:
        if base.value is not None and base.sd is None:  # known elsewhere: a place to begin
            return replace(other, value=None, guess=base.value or None)
        return other
    entry = reading.constant_entry(place, raw, f"{written(raw)} says nothing of {name}")
    if entry is None:
        return None
    scale_of = partial(scale_of_points, quantity=base.law.quantity, along=base.along, angles=reading.angles)
    stated = reading.table[base.kind.section].get(name, {}) if base.kind.section in reading.table else {}
    unit = stated.get("unit") if isinstance(stated, dict) else None
    plain = reading.in_si(place, Amount(1.0, unit), 1.0, scale_of) if isinstance(unit, str) else 1.0
    numbers = reading.stated(place, entry, scale_of, plain)
    if reading.problems > before:
        return None
    nothing: dict[str, Any] = dict.fromkeys(NUMBERS.values())
    return replace(other, **(nothing | numbers))


def _added(reading: RigReading, place: Place, raw: object, experiment: str) -> list[Element]:
    """Elements that are there in one experiment only."""
    if not isinstance(raw, dict):
        cure = f'write {place[-1]}.extra = {{ at = "x1", value = 0.5 }}'
        reading.report.add(place, f"{written(raw)} is not a table", cure)
        return []
    found = (read_element(reading, (*place, name), entry) for name, entry in raw.items())
    return [replace(element, only=experiment) for element in found if element is not None]


def _followers(reading: RigReading, changed: Sequence[Element], experiment: str) -> list[Element]:
    """What is tied to elements that differ, and does not differ itself."""
    other = {element.stands_for for element in changed if element.stands_for is not None}
    found: list[Element] = []
    more = True
    while more:
        tied = [e for e in reading.elements.values() if e.same_as in other and e.name not in other]
        found += [
            replace(
                e, name=f"{e.name}@{experiment}", only=experiment, stands_for=e.name,
                same_as=f"{e.same_as}@{experiment}",
            )
            for e in tied
        ]  # fmt: skip
        other |= {e.name for e in tied}
        more = bool(tied)
    return found
