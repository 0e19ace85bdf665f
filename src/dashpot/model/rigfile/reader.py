"""Reading rig files: head, inputs, channels, elements with their nonlinear laws (`law = "d**3"`, constants beside it),
matrices, and what is wrong with the whole."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy import sparse

from dashpot.channel import RESERVED_NAMES, Channel, Experiment, Quantity
from dashpot.errors import DashpotError, ModelError, UsageError
from dashpot.io.ledger import noted
from dashpot.io.toml_document import Place, TomlDocument, Wanted, parse_toml, read_toml
from dashpot.io.words import choose_from, did_you_mean, listed, quoted, shown, written
from dashpot.model.elements import Element
from dashpot.model.matrix_elements import LETTERS, Letter, Pairs, block_elements, free_elements
from dashpot.model.network import Input, Model
from dashpot.model.network import problems as problems_of
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law, unit_of
from dashpot.model.rigfile.rig import Rig, all_angles, default_channels, is_electrical, scale_of_points
from dashpot.model.rigfile.schema import (
    EXAMPLES,
    EXPERIMENTS,
    FREE_EXAMPLE,
    GROUND,
    NOISE,
    NUMBERS,
    SECTIONS,
    SUBSTRUCTURES,
    TABLES,
    BlockEntry,
    ChannelEntry,
    ElementEntry,
    InputEntry,
    RigReading,
    is_share,
    number_of,
)
from dashpot.quantities import Amount
from dashpot.units import SHARE, factor_between, scale, sensitivity, si_unit
from dashpot.unknowns import Unknown


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
            cure = choose_from(names, target)
            place = (element.kind.section, element.name, "same_as")
            reading.report.add(place, f"{written(target)} is not an element", cure)
            reading.faulty.add(element.name)
    return elements


def read_element(reading: RigReading, place: Place, raw: object) -> Element | None:
    """The element at a place of the file that ends in its section and name; None, and reported, if it is faulty."""
    before, section, name = reading.problems, str(place[-2]), str(place[-1])
    keys, constants = split_constants(raw)
    entry = reading.entry(ElementEntry, section, name, keys, place)
    begun = reading.problems
    if entry is not None:
        law, along = read_law(reading, place, entry, constants), _attachment(reading, place, entry)
    if entry is None or reading.problems > begun:
        reading.faulty.add(name)
        return None
    element = Element(name, SECTIONS[section], along, same_as=entry.same_as, times=entry.times, force_law=law)
    scale_of = partial(
        scale_of_points, quantity=element.law.quantity, along=element.along, angles=reading.angles
    )
    if law is not None:
        scale_of = partial(factor_between, wanted=element.unit(reading.angles))
    plain = 1.0
    if entry.unit is not None:
        plain = reading.in_si((*place, "unit"), Amount(1.0, entry.unit), 1.0, scale_of)
    element = replace(element, **reading.numbers(place, entry, plain, scale_of))
    if reading.problems > before:
        reading.faulty.add(name)
        return None
    return element


def _attachment(reading: RigReading, place: Place, entry: ElementEntry) -> dict[str, float]:
    """Points and factors of the elongation; reported if they are not said."""
    given = [key for key in ("at", "between", "along") if getattr(entry, key) is not None]
    if len(given) != 1:
        usual = 'at = "x1"' if place[-2] == "masses" else 'between = ["x1", "ground"]'
        what = f"{' and '.join(given)} are both given" if given else "it is not attached to anything"
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
        inner = []
        for name, given in entries.items():
            if given is None:
                continue
            at, problems = (*place, name), reading.problems
            exponents = law.exponents[1].get(name, (0.0, 0.0))
            constant = Constant(name, **reading.stated(at, given, partial(_scale, exponents=exponents)))
            stated = [
                number for number in (constant.value, constant.guess, constant.upper) if number is not None
            ]
            if (
                reading.problems == problems
                and name in law.positive
                and any(number <= 0 for number in stated)
            ):
                reading.report.add(at, f"{name} of the law {law.text!r} must be positive", "change it")
            inner.append(constant)
        whole = len(inner) == len(entries) and reading.problems == before
        return force_law(entry.law, inner, damper=damper) if whole else None
    except ModelError as error:
        reading.include((*place, "law"), error)
        return None


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
                if not isinstance(raw, dict):
                    cure = f'write {place[-1]}.extra = {{ at = "x1", value = 0.5 }}'
                    reading.report.add(place, f"{written(raw)} is not a table", cure)
                else:
                    extra = (read_element(reading, (*place, name), entry) for name, entry in raw.items())
                    own += [replace(element, only=experiment) for element in extra if element is not None]
            elif key in reading.elements:
                numbers = raw
                if key in channels and isinstance(raw, dict):
                    numbers = {name: value for name, value in raw.items() if name not in CALIBRATIONS}
                element = None if numbers == {} and raw else _other(reading, place, numbers)
                own += [] if element is None else [element]
            elif key != "data" and key not in channels and not reading.faulty:
                names = (*reading.elements, *channels)
                cure = choose_from(names, key)
                reading.report.add(place, f"{written(key)} is neither an element nor a channel", cure)
        other = {element.stands_for for element in own[before:] if element.stands_for is not None}
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
        own += found
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
                channel = _in_experiment(reading, (EXPERIMENTS, name, key), channels[key], changes)
                own += [] if channel is None else [channel]
            elif key not in reading.elements:
                cure = f"write {key}.gain = 1.02, or a delay or sign"
                reading.report.add(
                    (EXPERIMENTS, name, key), f"{written(raw)} is not a calibration of a channel", cure
                )
        raw = table.get("data", [])
        patterns = [raw] if isinstance(raw, str) else raw
        if not isinstance(patterns, list) or not all(isinstance(each, str) and each for each in patterns):
            cure = 'write names or patterns in quotes, such as data = "run2*.csv"'
            reading.report.add(
                (EXPERIMENTS, name, "data"), f"{written(raw)} is not a file name or pattern", cure
            )
            patterns = []
        found.append(Experiment(name, tuple(patterns), tuple(own)))
    return tuple(found)


def _channel_tables(reading: RigReading) -> Mapping[str, Any]:
    """What the file says of each channel; where it lists none, those of coordinates and inputs."""
    if "channels" in reading.table:
        return dict(reading.entries("channels"))
    return {name: {"of": name} for name in dict.fromkeys((*reading.head.coordinates, *reading.inputs))}


def _in_experiment(reading: RigReading, place: Place, raw: Any, changes: Mapping[str, Any]) -> Channel | None:
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
    entry = reading.constant_entry(place, raw, f"{written(raw)} does not describe {name}")
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


# Channels recorded in counts, or in shares of the full scale, of a converter whose full scale is known.
#
#     acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 16, full_scale = "50 g" }
#     acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 24, full_scale = "10 V", gain = "100 mV/g" }
#     acc = { of = "x1", quantity = "acceleration", unit = "FS", full_scale = "50 g" }
#
# A converter of n bits spans −2^(n−1) … 2^(n−1) − 1 counts over −full_scale … full_scale.


COUNTS = "counts"


def raw_unit(entry: ChannelEntry) -> str | None:
    """The unit of the raw numbers: the one given, else counts where there are bits, else shares of the full scale."""
    if entry.unit is not None or entry.full_scale is None:
        return entry.unit
    return SHARE if entry.bits is None else COUNTS


def full_scale_gain(
    entry: ChannelEntry, unit: str, quantity: str, arms: Mapping[str, float], angles: Collection[str]
) -> float:
    """Raw numbers (in `unit`) per SI unit of the quantity, from full scale, bits and, in volts, the sensitivity.

    Raises UsageError for what is missing or contradicts itself.
    """
    full_scale, gain = entry.full_scale, entry.gain
    assert full_scale is not None
    # How many raw units the full scale is
    bits = entry.bits
    if unit == SHARE:
        if bits is not None:
            raise UsageError(
                "bits of a channel in shares of the full scale", cure='leave bits out, or say unit = "counts"'
            )
        codes = 1.0
    else:
        if unit not in (COUNTS, "count"):
            raise UsageError(
                f"a full scale of a channel in {unit}", cure='say unit = "counts" or "FS", or leave it out'
            )
        if bits is None:
            raise UsageError("the counts at full scale are not given", cure="add bits, such as bits = 16")
        if bits != int(bits) or not 2 <= bits <= 64:
            raise UsageError(f"a converter of {bits:g} bits", cure="give a whole number from 2 to 64")
        codes = 2.0 ** (int(bits) - 1)
    size = number_of(full_scale)
    of_scale = full_scale.unit if isinstance(full_scale, Amount) else None
    if not size > 0:
        raise UsageError(f"a full scale of {size:g}", cure="give a positive one")
    given = "gain" in entry.model_fields_set
    if gain is None or entry.same_gain_as is not None:
        raise UsageError(
            "both a full scale and an unknown gain", cure="leave the full scale out, or the gain"
        )
    if of_scale not in (None, COUNTS) and is_electrical(of_scale, quantity):
        volts = size * scale(of_scale, quantity, False, True)
        if not given:
            raise UsageError(
                "a full scale in volts needs a sensitivity", cure='add one such as gain = "100 mV/g"'
            )
        if isinstance(gain, str):
            gain = sensitivity(gain, "V", quantity, all_angles(arms, angles))
        return codes / volts * gain
    if given:
        raise UsageError(
            "both a gain and a full scale in the quantity itself",
            cure="leave the gain out, or give the full scale in V",
        )
    return codes / (size if of_scale is None else size * scale_of_points(of_scale, quantity, arms, angles))


def read_channels(reading: RigReading) -> list[Channel] | None:
    """The channels; None if the file has no such section."""
    # Tables of channels, and of what they are in experiments
    tables = [raw for _, raw in reading.entries("channels")]
    for _, experiment in reading.entries(EXPERIMENTS):
        tables += experiment.values() if isinstance(experiment, dict) else ()
    named = {str(table.get("of")) for raw in tables for table in split_calibrations(raw)[1].values()}
    for name, _ in reading.entries("calibrations"):
        place = ("calibrations", name)
        if name not in named:
            cure = f"say in [channels] whose it is: gain = {{ of = {quoted(name)} }}"
            reading.report.add(place, "no channel has this calibration", cure)
        elif "." in name or name in reading.elements or name in reading.points:
            reading.report.add(
                place, "something else has this name in results", "choose another, without a point"
            )
    if "channels" not in reading.table:
        return None
    # Points, force inputs and elements, faulty ones too
    channels = []
    for name, raw in reading.entries("channels"):
        place, before = ("channels", name), reading.problems
        if not name.isprintable() or name != name.strip() or not name:
            cure = "use the name of the column, without line breaks, tabs or spaces at its ends"
            reading.report.add(place, f"{written(name)} is not a usable name", cure)
            continue
        if name in RESERVED_NAMES:
            reading.report.add(place, *reserved(name))
            continue
        channel = read_channel(reading, name, raw, place)
        if channel is not None and reading.problems == before:
            channels.append(channel)
    _check_shared_gains(reading, channels)
    owners = {channel.name: channel for channel in channels}
    return [
        replace(channel, gain_prior=owners[channel.same_gain_as].gain_prior)
        if channel.same_gain_as in owners
        else channel
        for channel in channels
    ]


def read_channel(reading: RigReading, name: str, raw: object, place: Place) -> Channel | None:
    """The channel at a place of the file; None if it cannot be said, which is reported."""
    # Points, force inputs and elements, faulty ones too
    measurable = (*reading.points, *reading.inputs, *reading.elements, *sorted(reading.faulty))
    plain, tables = split_calibrations(raw)
    entry = reading.entry(ChannelEntry, "channels", name, plain, place)
    channel = None if entry is None else _channel(reading, name, entry, dict.fromkeys(measurable), place)
    return None if channel is None else _with_calibrations(reading, channel, tables, place)


# Gains and delays that are known with an uncertainty, or shared.
#
#     acc = { of = "x1", quantity = "acceleration", gain = { value = 1, sd = "1 %" }, delay = { guess = "2 ms" } }
#     [calibrations]
#     calibrator = { value = 1, sd = "1 %" }        named by gain = { of = "calibrator" }


def split_calibrations(raw: object) -> tuple[object, dict[str, dict[str, Any]]]:
    """A channel's table with "unknown" in place of the tables of gain and delay, and these."""
    if not isinstance(raw, dict):
        return raw, {}
    tables = {key: raw[key] for key in ("gain", "delay") if isinstance(raw.get(key), dict)}
    return {**raw, **dict.fromkeys(tables, "unknown")}, tables


def _with_calibrations(
    reading: RigReading, channel: Channel, tables: Mapping[str, dict[str, Any]], at: Place
) -> Channel:
    """The channel with the gain and the delay that tables state; reported if they make no sense."""
    changes: dict[str, Any] = {}
    for key, table in tables.items():
        place = (*at, key)
        if key == "gain" and channel.same_gain_as is not None:
            reading.report.add(place, "the gain is given as well", "keep same_gain_as, or the gain")
            return channel
        found = (
            _shared_calibration(reading, place, table, channel)
            if "of" in table
            else _calibration(reading, place, table, f"{channel.name}.{key}", key, channel)
        )
        if isinstance(found, Unknown):
            changes[f"{key}_prior"] = found
        elif found is not None:
            changes[key] = found
    return replace(channel, **changes)


def _shared_calibration(
    reading: RigReading, place: Place, table: Mapping[str, Any], channel: Channel
) -> float | Unknown | None:
    """The calibration that a table names."""
    declared, name, key = dict(reading.entries("calibrations")), table["of"], str(place[-1])
    if len(table) > 1:
        reading.report.add(place, "a shared calibration with numbers of its own", "keep `of`, or the numbers")
    elif not isinstance(name, str) or name not in declared:
        cure = choose_from(declared, str(name))
        if not declared:
            cure = f"declare it: write {name} = {EXAMPLES['calibrations']} below [calibrations]"
        reading.report.add((*place, "of"), f"{written(name)} is not a calibration", cure)
    elif reading.calibrations.setdefault(name, key) != key:
        reading.report.add((*place, "of"), f"{name} is a gain and a delay", "declare one for each")
    else:
        return _calibration(reading, ("calibrations", name), declared[name], name, key, channel)
    return None


UNITS = {"gain": "1", "delay": "s"}


def _calibration(
    reading: RigReading, place: Place, raw: object, name: str, key: str, channel: Channel
) -> float | Unknown | None:
    """A gain or a delay as stated: known, or an unknown of this name; None, and reported, if it cannot be read."""
    before = reading.problems
    entry = reading.constant_entry(place, raw, f"{written(raw)} is not a calibration")
    if entry is None:
        return None

    def in_si(unit: str) -> float:
        if key == "delay":
            return scale(unit, "time")
        if place[0] == "calibrations":
            raise UsageError(
                f"a gain in {unit} that channels share", cure="write a number, a factor of all of them"
            )
        return sensitivity(
            f"1 {unit}", channel.unit, channel.quantity, all_angles(channel.of, reading.angles)
        )

    stated = reading.stated(place, entry, in_si)
    value, guess = stated.pop("value", None), stated.get("guess")
    if key == "gain" and 0 in (value, guess):
        reading.report.add(place, "a gain of 0 measures nothing", 'give another one, or "unknown"')
    if reading.problems > before:
        return None
    return value if value is not None and "sd" not in stated else Unknown(name, UNITS[key], value, **stated)


def reserved(name: str) -> tuple[str, str]:
    """What is wrong with a channel of a name that data files use themselves, and the cure."""
    cause = f"{written(name)} is reserved for a column of data files"
    return cause, "name the channel differently, in the data too"


def _check_shared_gains(reading: RigReading, channels: Sequence[Channel]) -> None:
    """Whoever shares a gain shares an unknown one, of a channel that has it from nobody else."""
    by_name = {channel.name: channel for channel in channels}
    table = reading.table["channels"]
    names = table if isinstance(table, dict) else {}
    for channel in channels:
        owner = channel.same_gain_as
        place = ("channels", channel.name, "same_gain_as")
        if owner is None:
            continue
        if owner not in names:
            others = [name for name in names if name != channel.name]
            cure = choose_from(others, owner) if others else "list it"
            reading.report.add(place, f"{written(owner)} is not a channel", cure)
        elif owner == channel.name:
            reading.report.add(place, "the channel shares its gain with itself", "name another one")
        elif owner in by_name and by_name[owner].gain is not None:
            reading.report.add(place, f"the gain of {owner} is known", f'give {owner} gain = "unknown"')
        elif owner in by_name and by_name[owner].same_gain_as is not None:
            cure = f"name {by_name[owner].same_gain_as}"
            reading.report.add(place, f"{owner} has its gain from another channel", cure)


def _channel(
    reading: RigReading, name: str, entry: ChannelEntry, measurable: Collection[str], place: Place
) -> Channel | None:
    """A channel; None if it cannot be said, which is reported unless it follows from another problem."""
    before = reading.problems
    given = {point: factor for point, factor in entry.of.items() if point != GROUND}
    of = reading.factors((*place, "of"), given)
    for key, what, cure in _wrong_numbers(entry):
        reading.report.add((*place, key), what, cure)
    if not of:
        reading.report.add((*place, "of"), "the ground does not move", "name what the channel measures")
    called = "point, input or element"
    reading.require_points((*place, "of"), of, measurable, called, ("coordinates", *TABLES))
    if reading.problems > before or reading.faulty & of.keys():
        return None
    if entry.quantity is not None:
        quantity = Quantity(entry.quantity)
    else:  # force inputs and elements do nothing else
        quantity = Quantity.DISPLACEMENT if any(point in reading.points for point in of) else Quantity.FORCE
    fault = _not_measurable(reading, of, quantity)
    if fault is not None:
        reading.report.add((*place, "of"), *fault)
        return None
    return _calibrated(reading, name, entry, of, quantity, place)


def _not_measurable(
    reading: RigReading, of: Mapping[str, float], quantity: Quantity
) -> tuple[str, str] | None:
    """What is wrong with measuring `quantity` of `of`, and the cure."""
    if quantity is not Quantity.FORCE:
        motionless = next((name for name in of if name not in reading.points), None)
        if motionless is None:
            return None
        kind = "an element" if motionless in reading.elements else "a force"
        return f"{motionless} is {kind}: it has no {quantity}", 'say quantity = "force", or name points'
    if all(name in reading.elements for name in of):
        return None
    if len(of) > 1:
        return "a force of several things", "name one input, or elements only"
    (name,) = of
    if name in reading.points and name not in reading.inputs:
        cure = f"name an input or elements: {listed((*reading.inputs, *reading.elements))}"
        return f"{name} is a coordinate: no force is measured there", cure
    return None


def _wrong_numbers(entry: ChannelEntry) -> Iterator[tuple[str, str, str]]:
    """Keys whose numbers make no sense, what is wrong with them, and the cure."""
    if entry.same_gain_as is not None and "gain" in entry.model_fields_set and entry.gain is not None:
        yield "same_gain_as", "the gain is given as well", 'write gain = "unknown", or leave it out'
    if entry.gain == 0:
        yield "gain", "a gain of 0 measures nothing", 'give another one, or "unknown"'
    if entry.sign is not None and entry.sign not in (1.0, -1.0):
        yield "sign", f"the sign is {entry.sign:g}", 'write 1, -1 or "unknown"; a factor belongs in gain'
    if entry.bits is not None and entry.full_scale is None:
        yield "bits", "bits without a full scale", 'add full_scale, such as "50 g"'
    for key in ("noise", "relative_noise"):
        if number_of(getattr(entry, key)) < 0:
            yield key, f"a standard deviation of {number_of(getattr(entry, key)):g}", "give 0 or more"
    if is_share(entry.noise) and "relative_noise" in entry.model_fields_set:
        yield "noise", "the relative noise is given twice", "leave out relative_noise, or noise"
    if entry.rate is not None and number_of(entry.rate) <= 0:
        yield (
            "rate",
            f"a rate of {number_of(entry.rate):g} Hz",
            "give a positive number of samples per second",
        )


def _calibrated(
    reading: RigReading,
    name: str,
    entry: ChannelEntry,
    of: Mapping[str, float],
    quantity: Quantity,
    place: Place,
) -> Channel | None:
    """A channel with its unit, calibration, noise and rate; None, and reported, if a unit does not fit."""
    key = "unit"
    try:
        # Points and factors that decide between m and rad, N and N·m
        first = next(iter(of))
        if quantity is not Quantity.FORCE or first in reading.points:
            arms = of
        elif first not in reading.elements:
            arms = reading.inputs[first].at
        else:
            if len({all_angles(reading.elements[name].along, reading.angles) for name in of}) > 1:
                raise UsageError("forces and torques cannot be added", cure="name elements of one kind")
            arms = reading.elements[first].along
        angles = reading.angles
        unit = raw_unit(entry) or si_unit(quantity.value, all_angles(arms, angles))
        # A voltage with a stated gain is in V per SI unit; with the default gain of 1 nobody has calibrated it.
        gain = None if entry.same_gain_as is not None else entry.gain
        electrical = gain is None or bool({"gain", "full_scale"} & entry.model_fields_set)
        factor = scale_of_points(unit, quantity.value, arms, angles, electrical)
        key = "gain" if entry.full_scale is None else "full_scale"
        if entry.full_scale is not None:
            gain = full_scale_gain(entry, unit, quantity.value, arms, angles)
        elif isinstance(gain, str):
            gain = sensitivity(gain, unit, quantity.value, all_angles(arms, angles))
    except UsageError as error:
        reading.include((*place, key), error)
        return None

    def in_channel_units(noise_unit: str) -> float:
        if is_electrical(noise_unit, quantity.value) != is_electrical(unit, quantity.value):
            raise UsageError(f"noise in {noise_unit} of a channel in {unit}", cure=f"write it in {unit}")
        return scale_of_points(noise_unit, quantity.value, arms, angles, electrical) / factor

    def timed(key: str, of_what: str) -> float | None:
        given = getattr(entry, key)
        return (
            None
            if given is None
            else reading.in_si((*place, key), given, 1.0, partial(scale, quantity=of_what))
        )

    relative, noise = entry.relative_noise, 0.0
    if is_share(entry.noise):
        relative = number_of(entry.noise) / 100
    else:
        noise = reading.in_si((*place, "noise"), entry.noise, 1.0, in_channel_units)
    return Channel(
        name,
        of,
        quantity,
        unit,
        scale=factor,
        gain=gain,
        delay=timed("delay", "time"),
        sign=entry.sign,
        noise=noise,
        relative_noise=relative,
        rate=timed("rate", "frequency"),
        same_gain_as=entry.same_gain_as,
    )


_WANTED = Wanted("rig file", 'describe a rig, starting with coordinates = ["x1"]')


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig in the TOML file `path`.

    Raises ModelError with every problem found, each at file:line and key, DataError if the path is a device.
    """
    return _rig(read_toml(path, ModelError, _WANTED))


def parse_rig(text: str, path: str = "rig.toml") -> Rig:
    """The rig described by a TOML text; `path` is named in messages.

    Raises ModelError with every problem found, each at file:line and key.
    """
    return _rig(parse_toml(text, path, ModelError, _WANTED))


def _rig(document: TomlDocument) -> Rig:
    reading = RigReading(document)
    head = reading.head
    read_inputs(reading)
    elements = read_elements(reading)
    elements = [*read_free(reading), *elements, *read_blocks(reading)]
    reading.elements = {element.name: element for element in elements if element.block is None}
    tables = tables_of(reading)
    elements += elements_of(reading, tables)
    inputs = tuple(reading.inputs.values())
    whole = [element for element in elements if element.name not in reading.faulty]
    complete = not reading.faulty
    for problem in problems_of(head.coordinates, inputs, whole, head.angles, complete=complete):
        reading.report.add(_place_of(reading, problem.where), problem.what, problem.cure)
    channels = read_channels(reading)
    if channels is None:  # every coordinate and input is a channel, of its own name
        places: dict[str, Place] = dict.fromkeys(head.coordinates, ("coordinates",))
        for name, place in (places | {name: ("inputs", name) for name in reading.inputs}).items():
            if name in RESERVED_NAMES:
                reading.report.add(place, *reserved(name))
    within, experiments = reading.within(), experiments_of(reading, tables)
    shaker, distribution = reading.shaker(), reading.distribution()
    if distribution == "student" and any(element.force_law is not None for element in whole):
        reading.report.add(
            (NOISE, "distribution"), "heavy tails are for linear rigs only", 'write "auto", or leave it out'
        )
    reading.report.raise_any()
    model = Model(
        tuple(head.coordinates),
        inputs,
        tuple(elements),
        head.name,
        reading.angles,
        tuple(tables),
        distribution=distribution,
    )
    used = default_channels(model) if channels is None else tuple(channels)
    return Rig(model, used, document.path, within, experiments, shaker)


def read_inputs(reading: RigReading) -> None:
    """Read the inputs, and with them all points."""
    for name, raw in reading.entries("inputs"):
        place, before = ("inputs", name, "at"), reading.problems
        entry = reading.entry(InputEntry, "inputs", name, raw)
        at = {} if entry is None else reading.factors(place, entry.at or {})
        if entry is not None and entry.kind == "force":
            reading.require_points(place, at, reading.head.coordinates, "coordinate")
        if entry is None or reading.problems > before:
            reading.faulty.add(name)
            reading.points[name] = None
        else:
            reading.inputs[name] = Input(name, entry.kind, at)
    moved = [name for name, entry in reading.inputs.items() if entry.kind == "displacement"]
    broken = [name for name in reading.points if name in reading.faulty]
    reading.points = dict.fromkeys((*reading.head.coordinates, *moved, *broken))
    reading.attachable = {**reading.points, GROUND: None}


def _place_of(reading: RigReading, name: str | None) -> Place:
    """The last place in the file where `name`, of a coordinate, input or element, is given."""
    if name is None:
        return ()
    places: list[Place] = []
    coordinates = reading.table.get("coordinates")
    if isinstance(coordinates, list):
        places += [("coordinates", i) for i, entry in enumerate(coordinates) if entry == name]
    element, _, experiment = name.partition("@")
    if experiment:
        places.append((EXPERIMENTS, experiment, element))
    for section in ("inputs", SUBSTRUCTURES, "blocks", *SECTIONS):
        table = reading.table.get(section)
        if isinstance(table, dict) and name in table:
            places.append((section, name))
    return max(places, key=reading.document.line) if places else (name,)


# The section [blocks] of a rig file: matrices in files of their own, each with a factor.


def read_blocks(reading: RigReading) -> list[Element]:
    """Elements of all blocks; files are found from the folder of the rig file."""
    elements: list[Element] = []
    for name, points in reading.substructures.items():
        reading.require_points(
            (SUBSTRUCTURES, name, "joined"), dict.fromkeys(points, 1.0), reading.attachable
        )
    for name, raw in reading.entries("blocks"):
        place, before = ("blocks", name, "coordinates"), reading.problems
        entry = reading.entry(BlockEntry, "blocks", name, raw)
        if entry is not None:
            rows = entry.coordinates or []
            if entry.of is not None and entry.of not in reading.substructures:
                cure = f"{choose_from(reading.substructures)}, in [{SUBSTRUCTURES}]"
                reading.report.add(("blocks", name, "of"), f"{written(entry.of)} is not a substructure", cure)
            if entry.of is not None and rows:
                cure = "the rows are those of the substructure: leave the coordinates out"
                reading.report.add(place, "of and coordinates both say what the rows are", cure)
            if len(set(rows)) < len(rows):
                cure = "name each row of the matrix once"
                reading.report.add(place, "a coordinate appears twice", cure)
            else:
                reading.require_points(place, dict.fromkeys(rows, 1.0), reading.attachable)
        if entry is not None and reading.problems == before:
            numbers = {field: getattr(entry, key) for key, field in NUMBERS.items()}
            path = Path(reading.document.path).parent / entry.file
            points = entry.coordinates or reading.head.coordinates
            if entry.of is not None:
                points = reading.substructures[entry.of]
            fixed = [None if point == GROUND else point for point in points]
            try:
                matrix = _matrix(path, entry.array)
                elements += block_elements(name, entry.matrix, matrix, fixed, **numbers)
            except DashpotError as error:
                reading.include(("blocks", name, "file"), error)
        if reading.problems > before:
            reading.faulty.add(name)
    return elements


def _matrix(path: Path, array: str | None) -> Any:
    """The matrix in a file of Matrix Market, NumPy, MATLAB (to version 7.2) or CSV.  Raises ModelError."""
    name, kind = shown(path.name, 60), path.suffix.lower()
    try:
        if kind == ".npz":
            found = noted(path)
            with np.load(found, allow_pickle=False) as arrays:
                if "format" in arrays.files and array is None:
                    return sparse.load_npz(found)
                return _one_of(dict(arrays), array, name)
        if kind == ".mat":
            from scipy.io import loadmat

            variables = loadmat(noted(path))
            return _one_of({key: value for key, value in variables.items() if key[:2] != "__"}, array, name)
        if kind == ".mtx":
            from scipy.io import mmread

            return mmread(noted(path))
        if kind == ".csv":
            text = Path(noted(path)).read_text(encoding="utf-8-sig")
            mark = next((mark for mark in ";,\t" if mark in text), None)
            return np.loadtxt(text.splitlines(), delimiter=mark, ndmin=2)
    except NotImplementedError as error:
        cure = "save it with -v7 in MATLAB, or as Matrix Market"
        raise ModelError(f"{name} is a MATLAB file of version 7.3", cure=cure) from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, BadZipFile) as error:
        what = f"{name} cannot be read: {shown(str(error), 80)}"
        raise ModelError(what, cure="check that the file exists and is complete") from error
    known = "Matrix Market (.mtx), NumPy (.npz), MATLAB (.mat) or CSV (.csv)"
    raise ModelError(f"{name} has no known ending", cure=f"save it as {known}")


def _one_of(arrays: Mapping[str, Any], array: str | None, name: str) -> Any:
    """The array of that name, the only one where none is named."""
    if array is None and len(arrays) == 1:
        (array,) = arrays
    if array is None or array not in arrays:
        raise ModelError(f"{name} holds several arrays", cure=f"say array = one of {listed(arrays)}")
    return arrays[array]


# Free matrices in a rig file: free = "MCK", or a table that says which entries may differ from 0.


def read_free(reading: RigReading) -> tuple[Element, ...]:
    """Elements of the free matrices, none where there are none."""
    if "free" not in reading.table:
        return ()
    before, raw, head = reading.problems, reading.table["free"], reading.head
    if isinstance(raw, str) and raw and all(raw.count(c) == 1 and c in LETTERS for c in raw):
        raw = dict.fromkeys(raw, "full")
    pairs: dict[Letter, Pairs] = {}
    if not (isinstance(raw, dict) and raw):
        reading.report.add(("free",), f"{written(raw)} names no matrices", f"write {FREE_EXAMPLE}")
    elif 0 < sum(x in head.angles for x in head.coordinates) < len(head.coordinates):
        what = "free matrices of displacements and angles together have no units"
        reading.report.add(("free",), what, "describe this rig by its elements")
    else:
        for name, entries in raw.items():
            letter = next((known for known in LETTERS if known == name), None)
            if letter is None:
                reading.report.add(("free", name), "no such matrix", "the matrices are M, C and K")
            else:
                pairs[letter] = _pairs(reading, letter, entries, head.coordinates)
    if reading.problems > before:
        reading.faulty.add("free")
    return free_elements(head.coordinates, pairs=pairs, letters="".join(pairs)) if pairs else ()


def _pairs(reading: RigReading, letter: Letter, entries: object, coordinates: Sequence[str]) -> Pairs:
    """The off-diagonal entries of a free matrix; none, and reported, if they are misnamed."""
    if entries == "full":
        return list(combinations(coordinates, 2))
    if entries == "diagonal":
        return []
    if not isinstance(entries, list):
        cure = 'write "full", "diagonal" or the pairs that are joined: [["x1", "x2"], ["x2", "x3"]]'
        reading.report.add(("free", letter), f"{written(entries)} does not describe its entries", cure)
        return []
    pairs = []
    for k, pair in enumerate(entries):
        known = isinstance(pair, list) and len(pair) == 2 and all(name in coordinates for name in pair)
        if not known or pair[0] == pair[1]:
            text = ", ".join(map(str, pair)) if isinstance(pair, list) else written(pair)
            cure = f"name two different coordinates: {listed(coordinates)}"
            reading.report.add(("free", letter, k), f"{shown(text, 60)}: not a pair of coordinates", cure)
            return []
        pairs.append((pair[0], pair[1]))
    return pairs
