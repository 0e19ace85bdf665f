"""The section [blocks] of a rig file: matrices in files of their own, each with a factor."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy import sparse

from dashpot.errors import DashpotError, ModelError
from dashpot.io.ledger import noted
from dashpot.io.words import listed, shown
from dashpot.model.blocks import block_elements
from dashpot.model.elements import Element
from dashpot.model.rigfile.reading import RigReading
from dashpot.model.rigfile.schema import BlockEntry


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
