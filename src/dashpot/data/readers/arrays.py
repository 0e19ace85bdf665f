"""Columns of files whose numbers are arrays already, held or read as they are needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.data.readers.columns import (
    FREQUENCY,
    LARGEST,
    MOST_COLUMNS,
    TIME,
    TIME_NAMES,
    Columns,
    bare,
    columns_of_block,
)
from dashpot.errors import DataError
from dashpot.io.words import shown

LARGE = 1 << 23  # numbers from which columns are put where they stay
PIECE = 1 << 18  # numbers that are turned into float64 at a time
LONG = 1 << 20  # numbers from which a column is streamed that might be held


@dataclass(frozen=True)
class Streamed:
    """A column that is not held: arrays one after another, read again each time that they are asked for."""

    rows: int
    pieces: Callable[[], Iterator[Any]]
    ndim: int = 1

    @property
    def shape(self) -> tuple[int]:
        """As of an array."""
        return (self.rows,)

    @property
    def size(self) -> int:
        """As of an array."""
        return self.rows

    def __len__(self) -> int:
        return self.rows


def pieces_of(column: Any) -> Iterator[Any]:
    """A column, held or streamed, some numbers at a time."""
    if isinstance(column, Streamed):
        return column.pieces()
    return (column[at : at + PIECE] for at in range(0, max(len(column), 1), PIECE))


def steps(start: float, step: float, rows: int) -> Streamed:
    """A column of evenly spaced times."""
    places = range(0, rows, PIECE)
    return Streamed(rows, lambda: (start + step * np.arange(at, min(at + PIECE, rows)) for at in places))


@dataclass(frozen=True)
class ArrayColumns(Columns):
    """Columns of a file that holds arrays; those that are streamed are read when they are asked for.

    rows      their common length
    columns   arrays (rows,), or Streamed
    row_name  what a row is, for messages
    """

    rows: int
    columns: tuple[Any, ...]
    row_name: str = "sample"

    @property
    def heading(self) -> str:
        """The file itself."""
        return self.source

    def place(self, index: int) -> str:
        """Rows are counted from 1."""
        return f"{self.source}: {self.row_name} {index + 1}"

    def numbers(
        self,
        columns: Sequence[int],
        optional: Sequence[int] = (),
        infinite: Sequence[int] = (),
        together: Sequence[int] = (),
    ) -> dict[int, Real]:
        """As of Columns."""
        large = self.rows * len(together) >= LARGE
        try:
            values = columns_of_block(columns, together if large else (), self.rows)
        except MemoryError:
            what = f"{self.rows} samples need more memory than is available"
            raise DataError(what, self.source, "the file may be damaged") from None
        for column, numbers in values.items():
            self._fill(column, numbers)
            if not len(numbers) or (np.min(numbers) >= -LARGEST and np.max(numbers) <= LARGEST):
                continue
            wrong = ~np.isfinite(numbers)
            wrong |= np.abs(np.where(wrong, 0.0, numbers)) > LARGEST
            if column in infinite:
                wrong &= numbers != np.inf
            if column in optional:
                wrong &= ~np.isnan(numbers)
            if np.any(wrong):
                at = int(np.argmax(wrong))
                cause = "is too large" if np.isfinite(numbers[at]) else "is not a finite number"
                raise self.error(at, column, f"{numbers[at]:g} {cause}", "fill the gap, or remove it")
        return values

    def _fill(self, column: int, into: Real) -> None:
        """Put one column into an array of float64, its length checked."""
        shape = self.columns[column].shape
        if shape != (self.rows,):
            name = shown(bare(self.header[column])[0])
            what = f"{name} has the shape {shape}, not ({self.rows},)"
            raise DataError(what, self.source, "the file is damaged")
        filled = 0
        for piece in self._pieces_of_numbers(column):
            if piece.ndim != 1 or filled + len(piece) > self.rows:
                break
            into[filled : filled + len(piece)] = piece
            filled += len(piece)
        if filled != self.rows:
            raise self._cut_off()

    def _pieces_of_numbers(self, column: int) -> Iterator[Any]:
        """Numbers of any kind; durations in s, of dates since the first."""
        pieces = pieces_of(self.columns[column])
        values: Any = next(pieces, np.zeros(0))
        if values.dtype.kind in "fiub":
            yield values
            yield from pieces
            return
        values = np.concatenate([values, *pieces])
        if values.dtype.kind == "M":
            values = values - values[0]
        if values.dtype.kind == "m":
            yield values / np.timedelta64(1, "ns") * 1e-9
            return
        if values.dtype.kind == "O":
            values = np.array([np.nan if value is None else value for value in values.tolist()])
        if values.dtype.kind not in "fiub":
            name = shown(bare(self.header[column])[0])
            text = _first_text(values)
            if text is not None:
                what = f'sample {text[0]}: column {name}: "{shown(text[1])}" is not a number'
                raise DataError(what, self.source, "correct it, or choose another column")
            cure = "give real and imaginary part as NAME_re and NAME_im" if values.dtype.kind == "c" else ""
            raise DataError(f"{name} holds no real numbers", self.source, cure or "choose another variable")
        yield values

    def texts(self, column: int) -> list[str]:
        """As of Columns."""
        values = np.concatenate(list(pieces_of(self.columns[column])))
        return ["" if value is None else str(value) for value in values.tolist()]

    def first(self, column: int) -> str:
        """As of Columns."""
        values = next(pieces_of(self.columns[column]), np.zeros(0))
        if not self.rows or values.dtype.kind in "mM":
            return "0"
        if not len(values):
            raise self._cut_off()
        return str(values[0])

    def _cut_off(self) -> DataError:
        return DataError("a column is cut off", self.source, "copy the file again")


def _first_text(values: Any) -> tuple[int, str] | None:
    """The first of some texts that is no number, and at which sample, from 1; None if they are no texts."""
    for sample, value in enumerate(values.tolist() if values.dtype.kind == "U" else (), 1):
        try:
            float(value)
        except ValueError:
            return sample, value
    return None


def array_columns(
    source: str, variables: Mapping[str, Any], units: Mapping[str, str | None] | None = None
) -> ArrayColumns:
    """Columns, held or streamed, of one length.

    Raises DataError if there are none, too many, or where their lengths differ.
    """
    if not variables:
        raise DataError("there are no variables", source, "give a file with data")
    if len(variables) > MOST_COLUMNS:
        raise DataError(f"there are {len(variables)} variables", source, "give a file with fewer")
    columns = tuple(each if isinstance(each, Streamed) else np.asarray(each) for each in variables.values())
    if len({len(column) for column in columns}) > 1:
        lengths = zip(variables, columns, strict=True)
        short = ", ".join(f"{shown(name)}: {len(column)}" for name, column in list(lengths)[:4])
        raise DataError(
            f"the variables are of different lengths ({short})", source, "choose those that match"
        )
    named = tuple(None if units is None else units.get(name) for name in variables)
    return ArrayColumns(source, tuple(variables), named, (), len(columns[0]), columns)


# Named arrays of a file, as scientific formats hold them, as parts: columns of one length each.
#
# A scalar `frequency_hz` or `experiment` holds for all; a sampling rate (`fs`, `rate_hz`, …) or step (`dt`,
# …) stands for a missing time. Where `frequency_hz` has m values and others are n by m, each column of
# theirs is a dwell. Complex arrays are pairs NAME_re, NAME_im; other matrices are columns NAME_1, NAME_2,
# ….


_RATES = "fs rate_hz rate fsamp sample_rate samplerate sampling_rate sampling_frequency samplefrequency"
RATES = set(_RATES.split())
STEPS = {"dt", "ts", "step", "delta_t", "sampling_time", "sample_time", "tsample", "wf_increment"}
START = "wf_start_offset"  # s, next to the step of a waveform of LabVIEW
EXPERIMENT = "experiment"
OF_ALL = (FREQUENCY, EXPERIMENT)


def parts_of_variables(
    source: str, variables: Mapping[str, Any], units: Mapping[str, str | None] | None = None
) -> Iterator[ArrayColumns]:
    """The parts, those with most variables first.  Raises DataError if there is no array of numbers."""
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
        elif array.dtype.kind in ("fiubmM" if array.ndim else "fiub"):
            (arrays if array.ndim else scalars)[name] = array
        elif name == EXPERIMENT and array.dtype.kind in "OUT":  # names of those of the rig file
            (arrays if array.ndim else scalars)[name] = array.astype(str)
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
        elif array.ndim == 2 and min(array.shape) <= 512:  # wider ones are no channels
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
                columns[TIME] = steps(float(scalars.get(START, 0.0)), step, rows)
        yield array_columns(source, columns, of_columns)


def step_of(scalars: Mapping[str, Any]) -> float | None:
    """The sampling step in s that the scalars of a file say; None if they say none that makes sense."""
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
