"""The columns of time and of drive frequency, under the names, in the units and forms that instruments give them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dashpot import units
from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers.columns import Columns, bare
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown

FREQUENCY, TIME = "frequency_hz", "time_s"
_TIMES = "time_s time t zeit temps tiempo timestamp datetime date_time x_value seconds"
TIME_NAMES = set(_TIMES.split())
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
    # Seconds per unit of the column
    match = _NAMED_UNIT.fullmatch(bare(columns.header[time_at])[0].lower())
    named = match["unit"] if match and match["name"] in TIME_NAMES else None
    scale = _unit_scale(columns, time_at, "time", "give the time in s, ms, µs, min or h", named)
    time = numbers[time_at] if time_at in others else numbers.pop(time_at)
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
    """The date as 2025-03-06, which need not be one of the calendar; None where there is none."""
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
