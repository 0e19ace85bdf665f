"""Named arrays of a file, as scientific formats hold them, as parts: columns of one length each.

A scalar `frequency_hz` or `experiment` holds for all; a sampling rate (`fs`, `rate_hz`, …) or step (`dt`, …) stands
for a missing time.  Where `frequency_hz` has m values and others are n by m, each column of theirs is a dwell.  Complex
arrays are pairs NAME_re, NAME_im; other matrices are columns NAME_1, NAME_2, ….
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dashpot.data.readers.array_columns import ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.sampling import FREQUENCY, TIME, TIME_NAMES

RATES = {
    "fs",
    "rate_hz",
    "rate",
    "fsamp",
    "sample_rate",
    "samplerate",
    "sampling_rate",
    "sampling_frequency",
    "samplefrequency",
}
STEPS = {"dt", "ts", "step", "delta_t", "sampling_time", "sample_time", "tsample"}
WIDEST = 512  # matrices with more columns than this are no channels
OF_ALL = (FREQUENCY, "experiment")


def parts_of_variables(
    source: str, variables: Mapping[str, Any], units: Mapping[str, str | None] | None = None
) -> Iterator[ArrayColumns]:
    """The parts, those with most variables first.  Raises DataError where there is no array of numbers."""
    units = dict(units or {})
    scalars: dict[str, Any] = {}
    arrays: dict[str, Any] = {}
    for name, value in variables.items():
        if isinstance(value, Streamed):
            arrays[name] = value
            continue
        array = np.asarray(value)
        array = array.reshape([n for n in array.shape if n != 1]) if array.ndim else array
        if array.dtype.kind == "c":
            for ending, part in (("re", array.real), ("im", array.imag)):
                arrays[f"{name}_{ending}"] = part
                units.setdefault(f"{name}_{ending}", units.get(name))
        elif array.dtype.kind in "fiubmM":
            (arrays if array.ndim else scalars)[name] = array
    driven = arrays.get(FREQUENCY)
    if driven is not None and driven.ndim == 1:
        dwells = list(_dwells(source, arrays, scalars, units, len(driven)))
        if dwells:
            yield from dwells
            return
    yield from _by_length(source, arrays, scalars, units)


def _dwells(
    source: str,
    arrays: Mapping[str, Any],
    scalars: Mapping[str, Any],
    units: Mapping[str, str | None],
    count: int,
) -> Iterator[ArrayColumns]:
    """A part for each value of the frequency, where there are matrices with a column (or row) for each."""
    matrices = {
        name: array if array.shape[1] == count else array.T
        for name, array in arrays.items()
        if array.ndim == 2 and count in array.shape
    }
    if not matrices:
        return
    rows = next(iter(matrices.values())).shape[0]
    per_dwell = [name for name in OF_ALL if name in arrays and arrays[name].shape == (count,)]
    for k in range(count):
        columns: dict[str, Any] = {name: array[:, k] for name, array in matrices.items()}
        columns |= {n: a for n, a in arrays.items() if a.ndim == 1 and len(a) == rows and n not in per_dwell}
        constants = {**scalars, **{name: arrays[name][k] for name in per_dwell}}
        yield from _by_length(f"{source} (dwell {k + 1})", columns, constants, units)


def _by_length(
    source: str, arrays: Mapping[str, Any], scalars: Mapping[str, Any], units: Mapping[str, str | None]
) -> Iterator[ArrayColumns]:
    """A part for each length of the columns."""
    groups: dict[int, dict[str, Any]] = {}
    of_columns: dict[str, str | None] = dict(units)
    for name, array in arrays.items():
        if array.ndim == 1:
            groups.setdefault(len(array), {})[name] = array
        elif array.ndim == 2 and min(array.shape) <= WIDEST:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            for k in range(tall.shape[1]):
                groups.setdefault(len(tall), {})[f"{name}_{k + 1}"] = tall[:, k]
                of_columns[f"{name}_{k + 1}"] = units.get(name)
    if not groups:
        array_columns(source, {})  # says that there is nothing
    for rows, columns in sorted(groups.items(), key=lambda item: -len(item[1])):
        for name in OF_ALL:
            if name in scalars and name not in columns:
                columns[name] = np.full(rows, scalars[name])
        if not any(name.lower() in TIME_NAMES for name in columns):
            step = step_of(scalars)
            if step is not None:
                columns[TIME] = steps(0.0, step, rows)
        yield array_columns(source, columns, of_columns)


def step_of(scalars: Mapping[str, Any]) -> float | None:
    """The sampling step in s that the scalars of a file say; None where they say none that makes sense."""
    for name, value in scalars.items():
        try:
            number = float(value)
        except (TypeError, ValueError):
            continue
        plain = name.lower().rpartition(".")[2]
        if plain in RATES and 0 < number < 1e12:
            return 1 / number
        if plain in STEPS and 0 < number < 1e12:
            return number
    return None
