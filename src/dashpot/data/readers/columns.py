"""What every reader makes of a file: named columns of numbers, with the place of everything that is wrong in them."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from dashpot import units
from dashpot.arrays import Bools, Real
from dashpot.channel import Channel, Quantity
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import did_you_mean, listed, shown
from dashpot.notices import Notice
from dashpot.units import SHARE

LARGEST = 1e100  # beyond this squares overflow, and no measurement is meant
MOST_COLUMNS = 10_000
UNNAMED = "column"  # and its number from 1: what a column without a name is called
_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\]|\((?P<round>[^\[\]()]*)\))$")
_DIVIDED = re.compile(
    r"^(?P<name>.*\S)\s+(?:/|in)\s+(?P<unit>\S+)$"
)  # ISO 80000-1: x1 / mm, and what people say
_ENDING = re.compile(r"(?P<name>.*?[^\W_])[_/ ]+\(?(?P<unit>(?!in\b)[^\W\d_]+([/_]s)?(\^?2|²)?)\)?")


@lru_cache(maxsize=4096)
def bare(column: str) -> tuple[str, str | None]:
    """A column's name without the unit in brackets, or behind a stroke (x1 / mm) or `in`, and the unit."""
    match = _UNIT.match(column)
    if match:
        return match["name"], (match["unit"] or match["round"] or "").strip()
    match = _DIVIDED.match(column)
    if match and is_unit(match["unit"]):
        return match["name"], match["unit"]
    return column, None


def named_unit(column: str) -> tuple[str, str | None]:
    """A column's name and unit, as `bare` or from the end of the name: time_ms, u_mm, a2_mps2, a_m_s2."""
    name, unit = bare(column)
    match = None if unit else _ENDING.fullmatch(name)
    ending = re.sub(r"(?i)hz$", "Hz", match["unit"].replace("_", "/")) if match else ""
    return (match["name"], ending) if match and is_unit(ending) else (name, unit)


def _with_stem(column: str, written: str, new: str) -> str:
    """A column NAME_re, OUT/IN_im … with NAME, OUT or IN renamed."""
    stem, mark, ending = column.rpartition("_")
    if not mark:
        return column
    return "/".join(new if name == written else name for name in stem.split("/")) + mark + ending


@lru_cache(maxsize=4096)
def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that is measured."""
    if any(factors(text, quantity) for quantity in units.QUANTITIES):
        return True
    with suppress(DashpotError):
        units.scale(text, "force", uncalibrated=True)  # volts and counts
        return True
    return False


def parts_of_ratio(text: str) -> list[str]:
    """The units of output and input in the unit of a response: m/s² and N of (m/s²)/N."""
    return [part.strip("() ") for part in text.rpartition("/")[::2]]


def are_units(text: str) -> bool:
    """Whether a text is the unit of a response, a unit over another."""
    return all(map(is_unit, parts_of_ratio(text)))


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
        """Position of a column, by its name, by that in front of a unit in brackets, or by its number (`names`).

        Raises DataError if there are two.
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
        place = re.fullmatch(rf"{UNNAMED}([1-9]\d{{0,4}})", name)
        if place is not None and int(place[1]) <= len(self.header) and not self.header[int(place[1]) - 1]:
            return int(place[1]) - 1
        return None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns as `find` takes them: what has none is called by its number, column2."""
        return tuple(bare(name)[0] or f"{UNNAMED}{i}" for i, name in enumerate(self.header, 1))

    def need(self, name: str, why: str = "", cure: str | None = None) -> int:
        """Position of a column.  Raises DataError with the cure, or the nearest column, where there is none."""
        at = self.find(name)
        if at is not None:
            return at
        guess = did_you_mean(name, self.header)
        known = guess or f"the columns are {listed(self.names)}; "
        cure = f"{known}{cure[:1].upper() + cure[1:] if guess else cure}" if cure else known.strip("; ")
        raise DataError(f"column {shown(name)}: missing{why}", self.heading, cure)

    def error(self, index: int, column: int, cause: str, cure: str) -> DataError:
        """The DataError at a row and a column."""
        name = shown(bare(self.header[column])[0])
        return DataError(f"column {name}: {cause}", self.place(index), cure)

    def not_read(self, read: Collection[int | None], cure: str = "") -> list[Notice]:
        """What is said of the other columns that have a name."""
        extra = [bare(name)[0] for i, name in enumerate(self.header) if name and i not in read]
        text = f"{self.source}: not read, because the rig file does not list them: {listed(extra)}{cure}"
        return [Notice("columns_not_read", text, tuple(extra))] if extra else []

    def refuse(self, column: int, wrong: Bools, cause: str, cure: str, values: Real | None = None) -> None:
        """Raises DataError at the first row that is wrong; `cause` may show the value there, as "{:g} Hz"."""
        if np.any(wrong):
            row = int(np.argmax(wrong))
            raise self.error(row, column, cause if values is None else cause.format(values[row]), cure)

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
        """Factor from the numbers of a column to SI units: `scale_of` the unit that the file states for it."""
        return self.scale_of(self.unit(column), channel)

    def scale_of_response(self, column: int, out: Channel, into: Channel) -> float:
        """Factor from the numbers of a response, such as (m/s²)/N, to the units that the rig file gives its channels.

        Of a response whose unit is no ratio it is the unit of the output.  Raises DataError as `scale_of`.
        """
        unit = self.unit(column) or ""
        above, below = parts_of_ratio(unit) if are_units(unit) else (unit, "")
        return self.scale_of(above, out) / out.scale / (self.scale_of(below, into) / into.scale)

    def scale_of(self, unit: str | None, channel: Channel) -> float:
        """Factor to SI units from a channel's numbers, whose file states a unit.

        The unit is the one that the rig file gives the channel; where it gives none, the one of the file.
        Raises DataError if they are not the same, and where the unit is one of another quantity.
        """
        if unit is None or unit in ("", channel.unit):
            return channel.scale
        if _uncalibrated(unit, channel.quantity.value) is not None:
            return self._scale_of_raw(unit, channel)
        possible = factors(unit, channel.quantity.value)
        if any(np.isclose(factor, channel.scale, rtol=1e-9, atol=0) for factor in possible):
            return channel.scale
        if len(possible) == 1 and not channel.unit and channel.scale == 1.0:
            return possible[0]
        if possible:
            raise DataError(
                f"column {shown(channel.name)}: in {shown(unit)}, the rig file says {channel.unit or 'SI units'}",
                self.heading,
                f'set unit = "{shown(unit)}" for this channel in the rig file, or correct the unit in the data',
            )
        if any(factors(unit, quantity.value) for quantity in Quantity):
            raise DataError(
                f"column {shown(channel.name)}: {shown(unit)} is not a unit of {channel.quantity.value}",
                self.heading,
                "correct the unit in the file, or the quantity in the rig file",
            )
        return channel.scale

    def described(self, column: int, channel: Channel) -> Channel:
        """The channel with the unit that the file states for the column, if it does."""
        return replace(channel, stated=self.unit(column) or "")

    def _scale_of_raw(self, unit: str, channel: Channel) -> float:
        """Factor of a column in volts or counts: the rig file has to say the same, and the sensitivity.

        Raises DataError if it does not.
        """
        if channel.unit and _same_raw(unit, channel.unit):
            return channel.scale
        raw = channel.unit and _uncalibrated(channel.unit, channel.quantity.value) is not None
        if channel.gain is None and not raw:
            return channel.scale  # an unknown gain takes every unit
        if unit == SHARE:
            what, known = ("in shares of the full scale (FS)", 'full_scale = the value of 1, such as "50 g",')
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
    if factors(unit, quantity):
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


def factors(unit: str, quantity: str) -> list[float]:
    """What the unit may mean in SI for the quantity, straight or angular; nothing where it is no such unit."""
    possible = []
    for angular in (False, True):
        with suppress(DashpotError):
            possible.append(units.scale(unit, quantity, angular))
    return possible


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


FREQUENCY, TIME = "frequency_hz", "time_s"
_TIMES = "time_s time t zeit temps tiempo timestamp datetime date_time x_value seconds millis micros"
_CLOCKS = {"millis": "ms", "micros": "µs"}  # what counting clocks are called
TIME_NAMES = set(_TIMES.split())
_FREQUENCIES = re.compile(r"((drive|driving|excitation|forcing)[ _])?(frequency|freq|frequenz|f)")
LONGEST = 1e12  # s


def time_column(columns: Columns, channels: Sequence[Channel], may_lack: bool = False) -> int | None:
    """Position of the time: `time_s`, or a usual name of it; None if there is none and there `may_lack`.

    Raises DataError if there is none, or several.
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
    return plain if plain in TIME_NAMES else named_unit(plain)[0]


def read_time(
    columns: Columns,
    time_at: int | None,
    others: Sequence[int],
    rate_hz: float | None,
    together: Sequence[int] = (),
    notes: list[Notice] | None = None,
) -> tuple[Real, dict[int, Real]]:
    """Time in s, (samples,), and the other columns; a unit of time that is guessed is added to `notes`.

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
    # Seconds per unit of the column
    plain = bare(columns.header[time_at])[0].lower()
    stem, named = named_unit(plain)
    named = named if stem in TIME_NAMES else _CLOCKS.get(plain)
    scale = _unit_scale(columns, time_at, "time", "give the time in s, ms, µs, min or h", named)
    time = numbers[time_at] if time_at in others else numbers.pop(time_at)
    if not named and not columns.unit(time_at):
        scale, unit = guessed_time_unit(time)
        if unit != "s" and notes is not None:
            name = columns.names[time_at]
            what = f"{columns.source}: {name} has no unit and counts in whole numbers; it is taken to be in {unit}"
            text = f"{what} (else call it {name}_s or {name}_ms)"
            notes.append(Notice("time_unit_guessed", text, (name,)))
    time = time if scale == 1.0 else time * scale
    check_range(columns, time_at, time, LONGEST, "s")
    at_once = 1 << 18
    for at in range(0, len(time) - 1, at_once):
        steps = np.diff(time[at : at + at_once + 1])
        short = (steps > 0) & (steps < 1e-30)  # whose reciprocal can hardly be squared
        if np.any(short):
            row = at + int(np.argmax(short)) + 1
            what = f"a sampling step of {steps[row - at - 1]:g} s"
            raise DataError(what, columns.place(row), "correct the times, or the step in the header")
    return time, numbers


def guessed_time_unit(time: Real) -> tuple[float, str]:
    """(s per unit, unit) of times that state none: whole numbers are those of a clock that counts, others seconds.

    No recording of a rig has samples whole seconds apart: from 1 on they are ms (1000 Hz and less), from 50 on µs
    (20 kHz and less), from 1e5 on ns.
    """
    some = time[:1000]
    steps = np.diff(some)
    steps = steps[steps > 0]  # the clock may begin again
    if not len(steps) or np.any(some != np.round(some)):
        return 1.0, "s"
    step = float(np.median(steps))
    limits = {"ns": (1e5, 1e-9), "µs": (50.0, 1e-6), "ms": (1.0, 1e-3)}
    return next((scale, unit) for unit, (least, scale) in limits.items() if step >= least)


def _unit_scale(columns: Columns, column: int, quantity: str, cure: str, named: str | None = None) -> float:
    """Factor of the column's unit, or of the one in its name; 1 where it has none.

    Raises DataError if it is none of the quantity.
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
    """Position of the drive frequency: `frequency_hz`, or a usual name of it; None if there is none, or several."""
    at = columns.find(FREQUENCY)
    if at is not None:
        return at
    taken = {channel.name for channel in channels}
    usual = []
    for i, column in enumerate(columns.header):
        name, unit = named_unit(column)[0].lower(), columns.unit(i) or named_unit(column)[1]
        force = name == "f" and (not unit or factors(unit, "force"))
        if _FREQUENCIES.fullmatch(name) and not force and taken.isdisjoint((column, bare(column)[0])):
            usual.append(i)
    return usual[0] if len(usual) == 1 else None


def frequency_scale(columns: Columns, column: int) -> float:
    """Hz per unit of the column.  Raises DataError if the unit is none of frequency."""
    cure = "give the frequency in Hz, kHz, rad/s or rpm"
    return _unit_scale(columns, column, "frequency", cure, named_unit(columns.header[column])[1])


def check_range(columns: Columns, column: int, values: Real, most: float, unit: str) -> None:
    """Raises DataError at the first value that overflows sums of squares.  values (samples,)."""
    if not len(values) or (np.min(values) >= -most and np.max(values) <= most):
        return
    wrong = ~(np.abs(values) <= most)
    columns.refuse(column, wrong, f"{{:g}} {unit} is too large", "check the unit and the number", values)


# Moments written as text, 2025-03-06 12:21:16.125, 06.03.2025 12:21:16 or 6-Mar-2025 00:21:16 PM, as seconds.


_CLOCK = r"(?P<h>\d{1,2}):(?P<min>\d{2})(?::(?P<s>\d{2})(?:[.,](?P<f>\d{1,9}))?)?(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
_ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
_DATE = (
    r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|(?P<d2>\d{1,2})\.(?P<m2>\d{1,2})\.(?P<y2>\d{4})"
    r"|(?P<one>\d{1,2})/(?P<other>\d{1,2})/(?P<y3>\d{4})"
    r"|(?P<d4>\d{1,2})(?:\.\s*|[-\s])(?P<name>[^\W\d_]{3,9})\.?[-\s](?P<y4>\d{4})"
)
_MOMENT = re.compile(rf"\s*(?:(?:{_DATE})[T\s]\s*)?{_CLOCK}{_ZONE}\s*")
_DAY = re.compile(rf"\s*(?:{_DATE})\s*")
_MINUTES = re.compile(r"\s*(?P<min>\d{1,4}):(?P<s>\d{2})[.,](?P<f>\d{1,9})\s*")  # and seconds
# Of English and German, by their first letters.
_MONTH_NAMES = "jan feb mar,mär,mae,mrz apr may,mai jun jul aug sep oct,okt nov dec,dez"
_MONTHS = {name: i for i, names in enumerate(_MONTH_NAMES.split(), 1) for name in names.split(",")}


def is_timestamp(text: str) -> bool:
    """Whether a cell is a moment: a date and a time of day, a time of day, or minutes and seconds."""
    return _MOMENT.fullmatch(text) is not None or _MINUTES.fullmatch(text) is not None


def is_date(text: str) -> bool:
    """Whether a cell is a date alone."""
    return _DAY.fullmatch(text) is not None


def seconds_of(texts: Sequence[str]) -> tuple[Real, int | None]:
    """Seconds from the first moment, and the first cell that is none (None: all are).

    A time of day alone may pass midnight once or more; the zone is left out of account where all have the same.  Of
    3/4/2025 the first number is the month where the moments then lie closer together, as they do across midnight.
    """
    seconds, wrong = _seconds(texts, month_first=True)
    if any("/" in text for text in texts[:1]):
        other, wrong_too = _seconds(texts, month_first=False)
        if wrong is not None and (wrong_too is None or wrong_too > wrong):
            return other, wrong_too
        if wrong_too is None and np.ptp(other) < np.ptp(seconds):
            return other, None
    return seconds, wrong


def _seconds(texts: Sequence[str], month_first: bool) -> tuple[Real, int | None]:
    seconds = np.zeros(len(texts))
    days = 0
    origin: np.datetime64 | None = None
    before = -1.0
    for i, text in enumerate(texts):
        match = _MOMENT.fullmatch(text) or _MINUTES.fullmatch(text)
        if match is None:
            return seconds, i
        parts = match.groupdict()
        # Seconds since midnight
        hours = int(parts.get("h") or 0)
        half = parts.get("half")
        if half is not None:
            hours = hours % 12 + 12 * (half in "Pp")
        of_day = (
            hours * 3600 + int(parts["min"] or 0) * 60 + int(parts["s"] or 0) + float(f"0.{parts['f'] or 0}")
        )
        date = _date(parts, month_first)
        if date is None:
            days += of_day < before - 43200
            before = of_day
            seconds[i] = days * 86400 + of_day
            continue
        try:
            day = np.datetime64(date, "D")
        except ValueError:
            return seconds, i
        origin = day if origin is None else origin
        seconds[i] = float((day - origin).astype(int)) * 86400 + of_day
    return seconds - (seconds[0] if len(seconds) else 0.0), None


def _date(parts: dict[str, str | None], month_first: bool) -> str | None:
    """The date as 2025-03-06, which need not be one of the calendar; None if there is none."""
    if parts.get("y") or parts.get("y2"):
        year, month, day = (parts[key] or parts[f"{key}2"] for key in ("y", "m", "d"))
    elif parts.get("y3"):
        year, month, day = parts["y3"], parts["one"], parts["other"]
        month, day = (month, day) if month_first else (day, month)
    elif parts.get("y4"):
        year, day = parts["y4"], parts["d4"]
        month = str(_MONTHS.get((parts["name"] or "")[:3].casefold(), 0))
    else:
        return None
    return f"{year}-{int(month or 0):02d}-{int(day or 0):02d}"
