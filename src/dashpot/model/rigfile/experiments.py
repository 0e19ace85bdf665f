"""Experiments in a rig file: what differs by run.

[experiments.added]
data = "run2*.csv"                            # patterns of its files; or files and rows that name it themselves
m3 = "1.2 kg"                                 # another known value there; { value = 1.2, sd = "1 %" } as well
c1 = "own"                                    # an unknown of its own, c1@added, with what is known of c1
masses.extra = { at = "x2", value = 0.5 }     # an element that is there in this experiment only
x1.gain = 1.02                                # another gain, delay or sign of a channel
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from dashpot.channel import Channel
from dashpot.experiment import Experiment
from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, written
from dashpot.model.elements import Element
from dashpot.model.rigfile.channels import read_channel
from dashpot.model.rigfile.elements import read_element
from dashpot.model.rigfile.rig import scale_of_points
from dashpot.model.rigfile.schema import EXPERIMENTS, NUMBERS, SECTIONS, RigReading
from dashpot.quantities import Amount

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
