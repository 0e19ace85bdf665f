"""Reading rig files: head, inputs, and what is wrong with the whole."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy import sparse

from dashpot.channel import RESERVED_NAMES
from dashpot.errors import DashpotError, ModelError
from dashpot.io.ledger import noted
from dashpot.io.toml_document import Place, TomlDocument, Wanted, parse_toml, read_toml
from dashpot.io.words import did_you_mean, listed, quoted, shown, written
from dashpot.model.blocks import block_elements
from dashpot.model.elements import Element
from dashpot.model.network import Input, Model
from dashpot.model.network import problems as problems_of
from dashpot.model.rigfile.channels import Measurables, read_channels, reserved
from dashpot.model.rigfile.force_laws import read_law, split_constants
from dashpot.model.rigfile.rig import Rig, default_channels, scale_of_points
from dashpot.model.rigfile.schema import (
    FREE_EXAMPLE,
    GROUND,
    SECTIONS,
    BlockEntry,
    ElementEntry,
    Head,
    InputEntry,
    RigReading,
    factors,
    in_si,
    read_numbers,
)
from dashpot.model.unstructured import LETTERS, Letter, Pairs, free_elements
from dashpot.quantities import Amount
from dashpot.units import factor_between

# The section [blocks] of a rig file: matrices in files of their own, each with a factor.


def read_blocks(
    reading: RigReading, coordinates: Sequence[str], points: Collection[str]
) -> tuple[Element, ...]:
    """Elements of all blocks; files are found from the folder of the rig file."""
    elements: list[Element] = []
    for name, raw in reading.entries("blocks"):
        entry = reading.entry(BlockEntry, "blocks", name, raw)
        if entry is None or not _points_known(reading, name, entry, points):
            reading.faulty.add(name)
            continue
        numbers = {
            "value": entry.value,
            "sd": entry.sd,
            "guess": entry.guess,
            "lower": entry.min,
            "upper": entry.max,
        }
        path = Path(reading.document.path).parent / entry.file
        rows = coordinates if entry.coordinates is None else entry.coordinates
        try:
            elements += block_elements(name, entry.matrix, _matrix(path, entry.array), rows, **numbers)
        except DashpotError as error:
            for problem in error.problems:
                reading.report.add(("blocks", name, "file"), problem.what, problem.cure)
            reading.faulty.add(name)
    return tuple(elements)


def _points_known(reading: RigReading, name: str, entry: BlockEntry, points: Collection[str]) -> bool:
    place = ("blocks", name, "coordinates")
    rows = entry.coordinates or []
    if len(set(rows)) < len(rows):
        reading.report.add(place, "a coordinate appears twice", "name each row of the matrix once")
        return False
    return reading.points_known(place, dict.fromkeys(rows, 1.0), points, False)


def _matrix(path: Path, array: str | None) -> Any:
    """The matrix in a file of Matrix Market or NumPy.  Raises ModelError where there is none."""
    try:
        if path.suffix.lower() == ".npz":
            return _of_numpy(Path(noted(path)), array)
        if path.suffix.lower() == ".mtx":
            from scipy.io import mmread

            return mmread(noted(path))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, BadZipFile) as error:
        what = f"{shown(path.name, 60)} cannot be read: {shown(str(error), 80)}"
        raise ModelError(what, cure="check that the file exists and is complete") from error
    raise ModelError(
        f"{shown(path.name, 60)} has no known ending", cure="save it as Matrix Market (.mtx) or NumPy (.npz)"
    )


def _of_numpy(path: Path, array: str | None) -> Any:
    """A matrix that scipy.sparse.save_npz wrote, or one array of several."""
    with np.load(path, allow_pickle=False) as arrays:
        if "format" in arrays.files and array is None:
            return sparse.load_npz(path)
        names = arrays.files
        if array is None and len(names) == 1:
            array = names[0]
        if array not in names:
            cure = f"say array = one of {listed(names)}"
            raise ModelError(f"{shown(path.name, 60)} holds several arrays", cure=cure)
        return arrays[array]


# The sections of a rig file that hold elements.


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


# Free matrices in a rig file: free = "MCK", or a table that says which entries may differ from 0.


def read_free(reading: RigReading, head: Head) -> tuple[Element, ...]:
    """Elements of the free matrices, none where there are none."""
    if "free" not in reading.table:
        return ()
    entries = _entries(reading.table["free"])
    if not entries:
        what = f"{written(reading.table['free'])} names no matrices"
        reading.report.add(("free",), what, f"write {FREE_EXAMPLE}")
        reading.faulty.add("free")
        return ()
    if 0 < sum(x in head.angles for x in head.coordinates) < len(head.coordinates):
        what = "free matrices of displacements and angles together have no units"
        reading.report.add(("free",), what, "describe this rig by its elements")
        reading.faulty.add("free")
        return ()
    pairs: dict[Letter, Pairs] = {}
    for name, raw in entries.items():
        letter = next((known for known in LETTERS if known == name), None)
        if letter is None:
            reading.report.add(("free", name), "no such matrix", "there are M, C and K")
            continue
        chosen = _pairs(reading, letter, raw, head.coordinates)
        if chosen is not None:
            pairs[letter] = chosen
    if set(pairs) != set(entries):
        reading.faulty.add("free")
    return free_elements(head.coordinates, pairs=pairs, letters="".join(pairs))


def _entries(raw: object) -> dict[str, Any] | None:
    """What is said of each matrix; None where it is no set of matrices."""
    if isinstance(raw, str) and raw and all(raw.count(c) == 1 and c in LETTERS for c in raw):
        return dict.fromkeys(raw, "full")
    return raw if isinstance(raw, dict) else None


def _pairs(reading: RigReading, letter: Letter, entries: object, coordinates: Sequence[str]) -> Pairs | None:
    """The off-diagonal entries of a free matrix; None where they are misnamed."""
    if entries == "full":
        return list(combinations(coordinates, 2))
    if entries == "diagonal":
        return []
    if not isinstance(entries, list):
        cure = 'write "full", "diagonal" or the pairs that are joined: [["x1", "x2"], ["x2", "x3"]]'
        reading.report.add(("free", letter), f"{written(entries)} does not describe its entries", cure)
        return None
    pairs = []
    for k, pair in enumerate(entries):
        known = isinstance(pair, list) and len(pair) == 2 and all(name in coordinates for name in pair)
        if not known or pair[0] == pair[1]:
            text = ", ".join(map(str, pair)) if isinstance(pair, list) else written(pair)
            cure = f"name two different coordinates: {listed(coordinates)}"
            reading.report.add(("free", letter, k), f"{shown(text, 60)}: not a pair of coordinates", cure)
            return None
        pairs.append((pair[0], pair[1]))
    return pairs


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
    # All points there are, those of faulty inputs too: they exist, whatever is wrong with them
    moved = [entry.name for entry in inputs if entry.kind == "displacement"]
    table = reading.table.get("inputs")
    broken = [name for name in table if name in reading.faulty] if isinstance(table, dict) else []
    points = dict.fromkeys((*head.coordinates, *moved, *broken))
    forces = frozenset(entry.name for entry in inputs if entry.kind == "force")
    angles = frozenset(head.angles)
    parts = read_elements(reading, Points(points, forces, angles))
    elements = [*read_free(reading, head), *parts, *read_blocks(reading, head.coordinates, points)]
    whole = [element for element in elements if element.name not in reading.faulty]
    complete = not reading.faulty
    for problem in problems_of(head.coordinates, inputs, whole, head.angles, complete=complete):
        reading.report.add(_place_of(reading, problem.where), problem.what, problem.cure)
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
    within = reading.within()
    reading.report.raise_any()
    model = Model(tuple(head.coordinates), tuple(inputs), tuple(elements), head.name, angles)
    used = default_channels(model) if channels is None else tuple(channels)
    return Rig(model, used, document.path, within)


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
