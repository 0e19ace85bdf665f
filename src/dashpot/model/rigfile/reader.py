"""Reading rig files: head, inputs, elements, matrices, and what is wrong with the whole."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
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
from dashpot.io.words import listed, shown, written
from dashpot.model.elements import Element
from dashpot.model.matrix_elements import LETTERS, Letter, Pairs, block_elements, free_elements
from dashpot.model.network import Input, Model
from dashpot.model.network import problems as problems_of
from dashpot.model.rigfile.channels import read_channels, reserved
from dashpot.model.rigfile.elements import elements_of, experiments_of, read_elements, tables_of
from dashpot.model.rigfile.rig import Rig, default_channels
from dashpot.model.rigfile.schema import (
    EXPERIMENTS,
    FREE_EXAMPLE,
    GROUND,
    NOISE,
    NUMBERS,
    SECTIONS,
    SUBSTRUCTURES,
    BlockEntry,
    InputEntry,
    RigReading,
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
                cure = f"there are {listed(reading.substructures) or 'none'}, in [{SUBSTRUCTURES}]"
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
                reading.report.add(("free", name), "no such matrix", "there are M, C and K")
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
