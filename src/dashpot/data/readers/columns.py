"""What every reader makes of a file: named columns of numbers, with the place of everything that is wrong in them."""

from __future__ import annotations

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from dashpot import units
from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.readers.delimited.timestamps import is_timestamp, seconds_of
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import listed, shown
from dashpot.notices import Notice
from dashpot.units import SHARE

LARGEST = 1e100  # beyond this squares overflow, and no measurement is meant
MOST_COLUMNS = 10_000
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_DIVIDED = re.compile(
    r"^(?P<name>.*\S)\s+(?:/|in)\s+(?P<unit>\S+)$"
)  # ISO 80000-1: x1 / mm, and what people say


@lru_cache(maxsize=4096)
def bare(column: str) -> tuple[str, str | None]:
    """A column's name without the unit in brackets, or behind a stroke (x1 / mm) or `in`, and the unit."""
    match = _UNIT.match(column)
    if match:
        return match["name"], match["unit"].strip()
    match = _DIVIDED.match(column)
    if match and is_unit(match["unit"]):
        return match["name"], match["unit"]
    return column, None


def _with_stem(column: str, written: str, new: str) -> str:
    """A column NAME_re, OUT/IN_im … with NAME, OUT or IN renamed."""
    stem, mark, ending = column.rpartition("_")
    if not mark:
        return column
    return "/".join(new if name == written else name for name in stem.split("/")) + mark + ending


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that is measured."""
    if any(_factors(text, quantity) for quantity in units.QUANTITIES):
        return True
    with suppress(DashpotError):
        units.scale(text, "force", uncalibrated=True)  # volts and counts
        return True
    return False


@dataclass(frozen=True)
class Columns(ABC):
    """Columns of one length, by name.

    source  the file (and the part of it), for messages
    header  names of the columns, as written
    units   the unit of each column where the format says it apart from the name; empty: nowhere
    notes   what was noticed on the way
    """

    source: str
    header: tuple[str, ...]
    units: tuple[str | None, ...]
    notes: tuple[Notice, ...]

    @property
    @abstractmethod
    def heading(self) -> str:
        """The place where the names stand, for messages."""

    @abstractmethod
    def place(self, index: int) -> str:
        """The place of a row, counted from 0, for messages."""

    def part_from(self, index: int) -> str:
        """The name of the part that begins at a row."""
        return self.place(index)

    @abstractmethod
    def numbers(
        self,
        columns: Sequence[int],
        optional: Sequence[int] = (),
        infinite: Sequence[int] = (),
        together: Sequence[int] = (),
    ) -> dict[int, Real]:
        """The columns as float64.  Gaps in `optional` ones give NaN; those of `infinite` may be inf.

        Of a large file, those of `together` are the columns of one new array, which may be taken (`whole_block`).
        Raises DataError at the first row with a gap, text, NaN or infinity.
        """

    @abstractmethod
    def texts(self, column: int) -> list[str]:
        """A column as text."""

    @abstractmethod
    def first(self, column: int) -> str:
        """The first cell of a column as text, empty where there is none."""

    def unit(self, column: int) -> str | None:
        """The unit of a column, None where the file does not say it."""
        apart = self.units[column] if self.units else None
        return apart if apart is not None else bare(self.header[column])[1]

    @cached_property
    def _bare_names(self) -> tuple[str, ...]:
        """Names of the columns in front of their units."""
        return tuple(bare(column)[0] for column in self.header)

    def find(self, name: str) -> int | None:
        """Position of a column, by its name or by its name in front of a unit in brackets.

        Raises DataError where there are two.
        """
        for names in (self.header, self._bare_names):
            if name not in names:
                continue
            if names.count(name) > 1:
                at = [i for i, column in enumerate(names) if column == name]
                raise DataError(
                    f"column {shown(name)}: named twice, in columns {at[0] + 1} and {at[1] + 1}",
                    self.heading,
                    "rename one of them",
                )
            return names.index(name)
        return None

    def need(self, name: str, why: str = "", cure: str | None = None) -> int:
        """Position of a column.  Raises DataError with the cure, or the nearest column, where there is none."""
        at = self.find(name)
        if at is not None:
            return at
        lower = {column.lower(): column for column in self.header}
        near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
        known = f"there are {listed(self.header)}{f'; {cure}' if cure else ''}"
        if near:
            known = f"did you mean {shown(lower[near[0]])}?"
        raise DataError(f"column {shown(name)}: missing{why}", self.heading, known)

    def error(self, index: int, column: int, cause: str, cure: str) -> DataError:
        """The DataError at a row and a column."""
        name = shown(bare(self.header[column])[0])
        return DataError(f"column {name}: {cause}", self.place(index), cure)

    def renamed(self, names: Mapping[str, str]) -> Self:
        """The same under other names, {as written: new}; also NAME in NAME_re, and OUT, IN in OUT/IN_re.

        Raises DataError for a name that is not there.
        """
        header = list(self.header)
        units: list[str | None] = list(self.units) if self.units else [None] * len(header)
        for written, new in names.items():
            at = self.find(written)
            if at is None and any(_with_stem(column, written, new) != column for column in self.header):
                header = [_with_stem(column, written, new) for column in header]
                continue
            at = self.need(written)
            units[at] = self.unit(at)
            header[at] = new
        return replace(self, header=tuple(header), units=tuple(units))

    def scale(self, column: int, channel: Channel) -> float:
        """Factor from the numbers of a column to SI units.

        The unit is the one that the rig file gives the channel; where it gives none, the one of the file.
        Raises DataError where they are not the same, and where the unit is one of another quantity.
        """
        unit = self.unit(column)
        if unit is None or unit in ("", channel.unit):
            return channel.scale
        if _uncalibrated(unit, channel.quantity.value) is not None:
            return self._scale_of_raw(unit, channel)
        factors = _factors(unit, channel.quantity.value)
        if any(np.isclose(factor, channel.scale, rtol=1e-9, atol=0) for factor in factors):
            return channel.scale
        if len(factors) == 1 and not channel.unit and channel.scale == 1.0:
            return factors[0]
        if factors:
            raise DataError(
                f"column {shown(channel.name)}: in {shown(unit)}, the rig file says {channel.unit or 'SI units'}",
                self.heading,
                f'set unit = "{shown(unit)}" for this channel in the rig file',
            )
        if any(_factors(unit, quantity.value) for quantity in Quantity):
            raise DataError(
                f"column {shown(channel.name)}: {shown(unit)} is not a unit of {channel.quantity.value}",
                self.heading,
                "correct the unit in the file, or the quantity in the rig file",
            )
        return channel.scale

    def _scale_of_raw(self, unit: str, channel: Channel) -> float:
        """Factor of a column in volts or counts: the rig file has to say the same, and the sensitivity.

        Raises DataError where it does not.
        """
        if channel.unit and _same_raw(unit, channel.unit):
            return channel.scale
        raw = channel.unit and _uncalibrated(channel.unit, channel.quantity.value) is not None
        if channel.gain is None and not raw:
            return channel.scale  # an unknown gain takes every unit
        if unit == SHARE:
            what, known = (
                "in shares of the full scale (FS)",
                'full_scale = what 1 stands for, such as "50 g",',
            )
        else:
            what, known = (
                f"in {shown(unit)}",
                f'gain = the sensitivity of the sensor, such as "100 {shown(unit)}/g",',
            )
        raise DataError(
            f"column {shown(channel.name)}: {what}, the rig file says {channel.unit or 'SI units'}",
            self.heading,
            f'set unit = "{shown(unit)}" and {known} for this channel in the rig file',
        )


def _uncalibrated(unit: str, quantity: str) -> float | None:
    """Volts or counts per unit, None for what is a unit of the quantity, or no unit."""
    if _factors(unit, quantity):
        return None
    with suppress(DashpotError):
        return units.scale(unit, quantity, uncalibrated=True)
    return None


def _same_raw(unit: str, stated: str) -> bool:
    """Whether two units, one of them of raw numbers, are the same: volts are no counts, counts no shares."""
    if SHARE in (unit, stated):
        return unit == stated
    with suppress(DashpotError):
        return bool(np.isclose(units.factor_between(unit, stated), 1.0, rtol=1e-9, atol=0))
    return False


def _factors(unit: str, quantity: str) -> list[float]:
    """What the unit may mean in SI for the quantity, straight or angular; nothing where it is no such unit."""
    factors = []
    for angular in (False, True):
        with suppress(DashpotError):
            factors.append(units.scale(unit, quantity, angular))
    return factors


def columns_of_block(columns: Sequence[int], together: Sequence[int], rows: int) -> dict[int, Real]:
    """Arrays (rows,) to be filled; those of `together` are the columns of one, which need not be copied."""
    block = np.empty((rows, len(together)), order="F")
    at = {column: block[:, i] for i, column in enumerate(together)}
    return {column: at[column] if column in at else np.empty(rows) for column in columns}


def whole_block(arrays: Sequence[Real]) -> Real | None:
    """The array, (rows, columns), whose columns these are, all and in order, as `columns_of_block` makes it."""
    block = arrays[0].base if arrays else None
    if not isinstance(block, np.ndarray) or block.shape != (len(arrays[0]), len(arrays)):
        return None
    if not (
        block.flags.f_contiguous and block.flags.owndata and block.flags.writeable and block.dtype == float
    ):
        return None
    same = all(array.ctypes.data == block[:, i].ctypes.data for i, array in enumerate(arrays))
    return block if same else None


# Columns of files whose numbers are arrays already, held or read as they are needed.


LARGE = 1 << 23  # numbers from which columns are put where they stay
PIECE = 1 << 18  # numbers that are turned into float64 at a time
LONG = 1 << 20  # numbers from which a column is streamed where its format allows


@dataclass(frozen=True)
class Streamed:
    """A long column that is not held: numbers (no dates) in pieces, read again each time that they are asked for."""

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


def _pieces(values: Any) -> Iterator[Any]:
    """A column in pieces; whole where it does not hold numbers alone."""
    if isinstance(values, Streamed):
        yield from values.pieces()
        return
    array = np.asarray(values)
    if array.dtype.kind not in "fiub" or len(array) <= PIECE:
        yield array
        return
    for at in range(0, len(array), PIECE):
        yield array[at : at + PIECE]


def _all_usable(numbers: Real) -> bool:
    """Whether all are finite and not too large, without an array as large as they are."""
    return not len(numbers) or bool(np.min(numbers) >= -LARGEST and np.max(numbers) <= LARGEST)


Load = Callable[[], Any]  # of a variable: a one-dimensional array, or Streamed


@dataclass(frozen=True)
class ArrayColumns(Columns):
    """Columns of a file that holds arrays; each is loaded when it is asked for.

    rows  their common length
    """

    rows: int
    loads: tuple[Load, ...]

    @property
    def heading(self) -> str:
        """The file itself."""
        return self.source

    def place(self, index: int) -> str:
        """Sample counted from 1."""
        return f"{self.source}: sample {index + 1}"

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
            what = f"{self.rows} samples ask for more memory than there is"
            raise DataError(what, self.source, "the file may be damaged") from None
        for column, numbers in values.items():
            self._fill(column, numbers)
            if _all_usable(numbers):
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
                raise self.error(at, column, f"{numbers[at]:g} {cause}", "fill the gap, or cut it out")
        return values

    def _fill(self, column: int, into: Real) -> None:
        """Put one column into an array of float64, its length checked."""
        load = self.loads[column]()
        values = load if isinstance(load, Streamed) else np.asarray(load)
        if values.ndim != 1 or len(values) != self.rows:
            name = shown(bare(self.header[column])[0])
            raise DataError(
                f"{name} has the shape {values.shape}, not ({self.rows},)", self.source, "the file is damaged"
            )
        filled = 0
        for piece in _pieces(values):
            if filled + len(piece) > self.rows:
                break
            into[filled : filled + len(piece)] = self._as_numbers(column, piece)
            filled += len(piece)
        if filled != self.rows:
            raise self._cut_off()

    def _as_numbers(self, column: int, values: Any) -> Any:
        """Numbers of any kind; durations in s, of dates since the first."""
        if values.dtype.kind == "M":
            elapsed = (values - values[0]) if len(values) else values.astype("timedelta64[ns]")
            return elapsed / np.timedelta64(1, "ns") * 1e-9
        if values.dtype.kind == "m":
            return values / np.timedelta64(1, "ns") * 1e-9
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
        return values

    def texts(self, column: int) -> list[str]:
        """As of Columns."""
        values = np.concatenate(list(_pieces(self.loads[column]())))
        return ["" if value is None else str(value) for value in values.tolist()]

    def first(self, column: int) -> str:
        """As of Columns."""
        values = next(_pieces(self.loads[column]()), np.zeros(0))
        if not self.rows or values.dtype.kind in "mM":
            return "0"
        if not len(values):
            raise self._cut_off()
        return str(values[0])

    def _cut_off(self) -> DataError:
        return DataError("a column is cut off", self.source, "copy the file again")


def _first_text(values: Any) -> tuple[int, str] | None:
    """The first of some texts that is no number, and at which sample, from 1; None where they are no texts."""
    for sample, value in enumerate(values.tolist() if values.dtype.kind == "U" else (), 1):
        try:
            float(value)
        except ValueError:
            return sample, value
    return None


def constant(value: object, rows: int) -> Load:
    """A column that has one value throughout."""
    return lambda: np.full(rows, value)


def steps(start: float, step: float, rows: int) -> Streamed:
    """A column of evenly spaced times."""

    def pieces() -> Iterator[Any]:
        for at in range(0, rows, PIECE):
            yield start + step * np.arange(at, min(at + PIECE, rows))

    return Streamed(rows, pieces)


def array_columns(
    source: str,
    variables: Mapping[str, Any],
    units: Mapping[str, str | None] | None = None,
    notes: Sequence[Notice] = (),
) -> ArrayColumns:
    """Columns of arrays (or of functions that load them) of one length.

    Raises DataError where there are none, too many, or where their lengths differ.
    """
    if not variables:
        raise DataError("there are no variables", source, "give a file with data")
    if len(variables) > MOST_COLUMNS:
        raise DataError(f"there are {len(variables)} variables", source, "give a file with fewer")
    lengths = {name: len(values) for name, values in variables.items() if not callable(values)}
    if len(set(lengths.values())) > 1:
        short = ", ".join(f"{shown(name)}: {length}" for name, length in list(lengths.items())[:4])
        raise DataError(
            f"the variables are of different lengths ({short})", source, "choose those that match"
        )
    rows = next(iter(lengths.values()), 0)
    loads = tuple(values if callable(values) else _held(values) for values in variables.values())
    named = tuple(None if units is None else units.get(name) for name in variables)
    return ArrayColumns(source, tuple(variables), named, tuple(notes), rows, loads)


def _held(values: Any) -> Load:
    return lambda: values


# The columns of time and of drive frequency, under the names and in the units that instruments give them.


FREQUENCY, TIME = "frequency_hz", "time_s"
TIME_NAMES = {
    "time_s",
    "time",
    "t",
    "zeit",
    "temps",
    "tiempo",
    "timestamp",
    "datetime",
    "date_time",
    "x_value",
    "seconds",
}
_NAMED_UNIT = re.compile(r"(?P<name>.+)_(?P<unit>s|ms|us|µs|min|h)")  # time_ms
_FREQUENCIES = {"frequency", "freq", "f", "frequenz"}
LONGEST = 1e12  # s
SHORTEST = (
    1e-30  # s between samples: far below the rounding of any time, and its reciprocal can still be squared
)


def time_column(columns: Columns, channels: Sequence[Channel], may_lack: bool = False) -> int | None:
    """Position of the time: `time_s`, or a usual name of it; None where there is none and there `may_lack`.

    Raises DataError where there is none, or several.
    """
    at = columns.find(TIME)
    if at is not None:
        return at
    taken = {channel.name for channel in channels}
    usual = [
        i
        for i, name in enumerate(columns.header)
        if _time_stem(name) in TIME_NAMES and name not in taken and bare(name)[0] not in taken
    ]
    if len(usual) == 1:
        return usual[0]
    if len(usual) > 1:
        names = ", ".join(shown(columns.header[i]) for i in usual)
        raise DataError(
            f"several columns may be the time: {names}", columns.heading, f"name one of them {TIME}"
        )
    if may_lack:
        return None
    return columns.need(TIME, cure="add it, or give rate_hz in a manifest")


def _time_stem(name: str) -> str:
    """The name of a column in small letters, without the unit."""
    plain = bare(name)[0].lower()
    match = None if plain in TIME_NAMES else _NAMED_UNIT.fullmatch(plain)
    return match["name"] if match else plain


def read_time(
    columns: Columns,
    time_at: int | None,
    others: Sequence[int],
    rate_hz: float | None,
    together: Sequence[int] = (),
) -> tuple[Real, dict[int, Real]]:
    """Time in s, (samples,), and the other columns.

    Without a column of time the samples are 1/rate_hz apart; `together` as of Columns.numbers, and so are errors.
    """
    if time_at is None or rate_hz is not None:
        numbers = columns.numbers(others, together=together)
        rows = len(next(iter(numbers.values()))) if numbers else 0
        return np.arange(rows) / (1.0 if rate_hz is None else rate_hz), numbers
    first = columns.first(time_at)
    if is_timestamp(first):
        numbers = columns.numbers(others, together=together)
        time, wrong = seconds_of(columns.texts(time_at))
        if wrong is not None:
            raise columns.error(
                wrong, time_at, "is not a date and time", "write it as 2025-03-06 12:21:16.125"
            )
        return time, numbers
    if ":" in first:
        cause = f'"{shown(first)}" is neither a number nor a date and time'
        raise columns.error(0, time_at, cause, "write it as 2025-03-06 12:21:16.125")
    numbers = columns.numbers(list(dict.fromkeys([time_at, *others])), together=together)
    scale = _time_scale(columns, time_at)
    time = numbers[time_at] if time_at in others else numbers.pop(time_at)
    time = time if scale == 1.0 else time * scale
    check_range(columns, time_at, time, LONGEST, "s")
    _check_steps(columns, time)
    return time, numbers


def _check_steps(columns: Columns, time: Real) -> None:
    """Raises DataError at the first sample that follows the one before it sooner than any clock can tell."""
    for at in range(0, len(time) - 1, PIECE):
        steps = np.diff(time[at : at + PIECE + 1])
        short = (steps > 0) & (steps < SHORTEST)
        if np.any(short):
            row = at + int(np.argmax(short)) + 1
            what = f"a sampling step of {steps[row - at - 1]:g} s"
            raise DataError(what, columns.place(row), "correct the times, or the step in the header")


def _time_scale(columns: Columns, column: int) -> float:
    """Seconds per unit of the column.  Raises DataError where the unit is none of time."""
    match = _NAMED_UNIT.fullmatch(bare(columns.header[column])[0].lower())
    named = match["unit"] if match and match["name"] in TIME_NAMES else None
    return _unit_scale(columns, column, "time", "give the time in s, ms, µs, min or h", named)


def _unit_scale(columns: Columns, column: int, quantity: str, cure: str, named: str | None = None) -> float:
    """Factor of the column's unit, or of the one in its name; 1 where it has none.

    Raises DataError where it is none of the quantity.
    """
    unit = columns.unit(column) or named
    if not unit:
        return 1.0
    try:
        return units.scale(unit, quantity)
    except DashpotError:
        what = f"column {shown(columns.header[column])}: {shown(unit)} is not a unit of {quantity}"
        raise DataError(what, columns.heading, cure) from None


def frequency_column(columns: Columns, channels: Sequence[Channel]) -> int | None:
    """Position of the drive frequency: `frequency_hz`, or a usual name of it with a unit; None where there is none."""
    at = columns.find(FREQUENCY)
    if at is not None:
        return at
    taken = {channel.name for channel in channels}
    usual = [
        i
        for i, name in enumerate(columns.header)
        if bare(name)[0].lower() in _FREQUENCIES and columns.unit(i) and bare(name)[0] not in taken
    ]
    return usual[0] if len(usual) == 1 else None


def frequency_scale(columns: Columns, column: int) -> float:
    """Hz per unit of the column.  Raises DataError where the unit is none of frequency."""
    return _unit_scale(columns, column, "frequency", "give the frequency in Hz, kHz, rad/s or rpm")


def check_range(columns: Columns, column: int, values: Real, most: float, unit: str) -> None:
    """Raises DataError at the first value that overflows sums of squares.  values (samples,)."""
    if not len(values) or (np.min(values) >= -most and np.max(values) <= most):
        return
    wrong = ~(np.abs(values) <= most)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise columns.error(i, column, f"{values[i]:g} {unit} is too large", "check the unit and the number")


# Named arrays of a file, as scientific formats hold them, as parts: columns of one length each.
#
# A scalar `frequency_hz` or `experiment` holds for all; a sampling rate (`fs`, `rate_hz`, …) or step (`dt`,
# …) stands for a missing time. Where `frequency_hz` has m values and others are n by m, each column of
# theirs is a dwell. Complex arrays are pairs NAME_re, NAME_im; other matrices are columns NAME_1, NAME_2,
# ….


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
