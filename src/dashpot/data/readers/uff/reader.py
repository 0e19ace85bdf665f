"""Universal files as parts: functions over the same abscissa are columns of one part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dashpot.data.readers.arrays import ArrayColumns, array_columns, steps
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.time_columns import FREQUENCY, TIME
from dashpot.data.readers.uff.function import (
    FRF,
    MARK,
    OF_FREQUENCY,
    SPECTRUM,
    TIME_RESPONSE,
    TRANSMISSIBILITY,
    NodalFunction,
    NodePoint,
    UffStream,
    dataset_starts,
    read_function,
    skip_dataset,
)
from dashpot.errors import DataError

KINDS = (TIME_RESPONSE, FRF, TRANSMISSIBILITY, SPECTRUM)


def is_universal(file: DataFile) -> bool:
    """The first lines are the mark of a dataset and its number."""
    lines = file.head[:1000].split(b"\n", 3)
    lines = [line for line in lines if line.strip()]
    if len(lines) < 2 or lines[0].strip() != MARK or not lines[0].startswith(b"  "):
        return False
    return lines[1][:6].strip().isdigit()


def read_universal(file: DataFile) -> Iterator[ArrayColumns]:
    """Samples over time, spectra and frequency responses.

    A column has the name of ID line 1 where that differs among the functions, else of the entity, else its node and
    direction, such as 3+Z; FRFs are OUT/IN.  The third axis, where it is a frequency, is the drive frequency.
    Raises DataError, with the line, for what is damaged or cut off.
    """
    count = 0
    held: list[NodalFunction] = []
    others: set[int] = set()
    for function in functions_of(file, others):
        if function.kind not in KINDS:
            continue
        if held and not _together(held, function):
            count += 1
            yield _part(file.name, count, held)
            held = []
        held.append(function)
    if held:
        yield _part(file.name, count + 1, held)
    elif not count:
        cure = "export samples over time, spectra or frequency responses (dataset 58)"
        what = "the file holds no samples, spectra or frequency responses"
        if 55 in others:
            what, cure = (
                f"{what}, but modes (dataset 55)",
                "identify a rig that has their coordinates by it",
            )
        raise DataError(what, file.name, cure)


def functions_of(file: DataFile, others: set[int] | None = None) -> Iterator[NodalFunction]:
    """All functions of a universal file (datasets 58 and 58b); the numbers of other datasets go to `others`.

    Raises DataError where the file is damaged or cut off.
    """
    with file.reading() as raw:
        stream = UffStream(raw, file)
        before: NodalFunction | None = None
        for start in dataset_starts(stream):
            if start.number == 58:
                function = read_function(stream, start)
                if before is not None and function.beside(before):
                    function = replace(function, abscissa=before.abscissa)  # shared, not held twice
                before = function
                yield function
            else:
                skip_dataset(stream)
                if others is not None:
                    others.add(start.number)


def _together(held: Sequence[NodalFunction], function: NodalFunction) -> bool:
    """Whether a function belongs to those before it: the same kind and abscissa, and another measurement."""
    first = held[0]
    return (
        (first.kind == TIME_RESPONSE) == (function.kind == TIME_RESPONSE)
        and (first.z_kind, first.z_value) == (function.z_kind, function.z_value)
        and _measured(function) not in [_measured(other) for other in held]
        and function.beside(first)
    )


def _measured(function: NodalFunction) -> tuple[NodePoint, NodePoint, tuple[str, ...]]:
    return function.response, function.reference, function.ids[:1]


def _part(source: str, number: int, functions: Sequence[NodalFunction]) -> ArrayColumns:
    """Functions over one abscissa as columns."""
    place = source if number == 1 else f"{source} (part {number})"
    first = functions[0]
    columns: dict[str, Any] = {FREQUENCY: first.abscissa}
    units: dict[str, str | None] = {}
    if first.kind == TIME_RESPONSE:
        columns = {TIME: first.abscissa if first.long is None else first.long.time}
        if first.z_kind == OF_FREQUENCY and first.z_value > 0:
            columns[FREQUENCY] = steps(first.z_value, 0.0, len(columns[TIME]))
    for function, name in zip(functions, _column_names(functions), strict=True):
        values: dict[str, Any] = {name: function.ordinate if function.long is None else function.long.values}
        if function.kind != TIME_RESPONSE:
            values = {f"{name}_re": function.ordinate.real, f"{name}_im": np.imag(function.ordinate)}
        for column, numbers in values.items():
            if column in columns:
                raise DataError(f"{column} is there twice", place, "give each function a point of its own")
            columns[column] = numbers
            units[column] = function.unit or None
    return array_columns(place, columns, units)


def _column_names(functions: Sequence[NodalFunction]) -> list[str]:
    """ID line 1 where it tells the functions apart, else the response; of FRFs OUT/IN."""
    responses = _names([f.response for f in functions])
    references = _names([f.reference for f in functions])
    titles = [f.ids[0] if f.ids else "" for f in functions]
    titled = len(set(titles)) == len(titles) and all(titles)
    names = []
    for function, response, reference, title in zip(functions, responses, references, titles, strict=True):
        name = title if titled else response
        if function.kind in (FRF, TRANSMISSIBILITY):
            name = title if titled and title.count("/") == 1 else f"{response}/{reference}"
        names.append(name)
    return names


def _names(points: Sequence[NodePoint]) -> list[str]:
    """Names of points: the entities where they tell the points apart, else nodes and directions."""
    entities = {point.entity for point in points}
    if "" not in entities and len(entities) == len(set(points)):
        return [point.entity for point in points]
    return [point.name for point in points]
