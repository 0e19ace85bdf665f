"""Reading rig files: head, inputs, and what is wrong with the whole."""

from __future__ import annotations

import os
from collections.abc import Sequence

from dashpot.channel import RESERVED_NAMES
from dashpot.errors import ModelError
from dashpot.io.toml_document import Place, TomlDocument, Wanted, parse_toml, read_toml
from dashpot.model import validation
from dashpot.model.elements import Element
from dashpot.model.network import Input, Model
from dashpot.model.rigfile.amounts import factors
from dashpot.model.rigfile.blocks import read_blocks
from dashpot.model.rigfile.channels import Measurables, read_channels, reserved
from dashpot.model.rigfile.elements import Points, read_elements
from dashpot.model.rigfile.free import read_free
from dashpot.model.rigfile.reading import RigReading
from dashpot.model.rigfile.rig import Rig, default_channels
from dashpot.model.rigfile.schema import SECTIONS, Head, InputEntry

_WANTED = Wanted("rig file", 'describe a rig, starting with coordinates = ["x1"]')


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig in the TOML file `path`.

    Raises ModelError with every problem found, each at file:line and key, DataError where the path is a device.
    """
    return _rig(read_toml(path, ModelError, _WANTED))


def parse_rig(text: str, path: str = "rig.toml") -> Rig:
    """The rig described by a TOML text; `path` is named in messages.

    Raises ModelError with every problem found, each at file:line and key.
    """
    return _rig(parse_toml(text, path, ModelError, _WANTED))


def _rig(document: TomlDocument) -> Rig:
    reading = RigReading(document)
    head = reading.head()
    inputs = _inputs(reading, head)
    points = _points(reading, head, inputs)
    forces = frozenset(entry.name for entry in inputs if entry.kind == "force")
    angles = frozenset(head.angles)
    parts = read_elements(reading, Points(points, forces, angles))
    elements = [*read_free(reading, head), *parts, *read_blocks(reading, head.coordinates, points)]
    _check_model(reading, head, inputs, elements)
    measurables = Measurables(
        points,
        {entry.name: entry for entry in inputs},
        {element.name: element for element in elements if element.block is None},
        angles,
        frozenset(reading.faulty),
    )
    channels = read_channels(reading, measurables)
    if channels is None:
        _check_names_of_columns(reading, head.coordinates, inputs)
    reading.report.raise_any()
    model = Model(tuple(head.coordinates), tuple(inputs), tuple(elements), head.name, angles)
    return Rig(model, default_channels(model) if channels is None else tuple(channels), document.path)


def _inputs(reading: RigReading, head: Head) -> list[Input]:
    inputs = []
    for name, raw in reading.entries("inputs"):
        entry = reading.entry(InputEntry, "inputs", name, raw)
        if entry is None:
            reading.faulty.add(name)
            continue
        at = factors(reading, ("inputs", name, "at"), entry.at or {}, head.angles)
        if at is None:
            reading.faulty.add(name)
            continue
        as_table = isinstance(raw.get("at"), dict)
        if entry.kind == "displacement" or reading.points_known(
            ("inputs", name, "at"), at, head.coordinates, as_table, "coordinate"
        ):
            inputs.append(Input(name, entry.kind, at))
        else:
            reading.faulty.add(name)
    return inputs


def _points(reading: RigReading, head: Head, inputs: Sequence[Input]) -> dict[str, None]:
    """All points there are, those of faulty inputs too: they exist, whatever is wrong with them."""
    moved = [entry.name for entry in inputs if entry.kind == "displacement"]
    table = reading.table.get("inputs")
    broken = [name for name in table if name in reading.faulty] if isinstance(table, dict) else []
    return dict.fromkeys((*head.coordinates, *moved, *broken))


def _check_model(
    reading: RigReading, head: Head, inputs: Sequence[Input], elements: Sequence[Element]
) -> None:
    whole = [element for element in elements if element.name not in reading.faulty]
    complete = not reading.faulty
    for problem in validation.problems(head.coordinates, inputs, whole, head.angles, complete=complete):
        reading.report.add(_place_of(reading, problem.where), problem.what, problem.cure)


def _check_names_of_columns(reading: RigReading, coordinates: Sequence[str], inputs: Sequence[Input]) -> None:
    """Without a section of channels every coordinate and input is one, of its own name."""
    for section, names in (("coordinates", coordinates), ("inputs", [source.name for source in inputs])):
        for name in names:
            if name in RESERVED_NAMES:
                place = ("coordinates",) if section == "coordinates" else (section, name)
                reading.report.add(place, *reserved(name))


def _place_of(reading: RigReading, name: str | None) -> Place:
    """The last place in the file where `name`, of a coordinate, input or element, is given."""
    if name is None:
        return ()
    places: list[Place] = []
    coordinates = reading.table.get("coordinates")
    if isinstance(coordinates, list):
        places += [("coordinates", i) for i, entry in enumerate(coordinates) if entry == name]
    for section in ("inputs", "blocks", *SECTIONS):
        table = reading.table.get(section)
        if isinstance(table, dict) and name in table:
            places.append((section, name))
    return max(places, key=reading.document.line) if places else (name,)
