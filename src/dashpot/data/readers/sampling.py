"""The columns of time and of drive frequency, under the names and in the units that instruments give them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dashpot import units
from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers.columns import Columns, bare
from dashpot.data.readers.delimited.timestamps import is_timestamp, seconds_of
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown

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
    return time, numbers


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
