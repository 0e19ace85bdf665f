"""Moments written as text, 2025-03-06 12:21:16.125, 06.03.2025 12:21:16 or 6-Mar-2025 00:21:16 PM, as seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Real

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
_MONTHS = {
    name: number
    for number, names in enumerate(
        (
            "jan",
            "feb",
            "mar mär mae mrz",
            "apr",
            "may mai",
            "jun",
            "jul",
            "aug",
            "sep",
            "oct okt",
            "nov",
            "dec dez",
        ),
        1,
    )
    for name in names.split()
}  # of English and German, by their first letters


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
        of_day = _of_day(parts)
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


def _of_day(parts: dict[str, str | None]) -> float:
    """Seconds since midnight."""
    hours = int(parts.get("h") or 0)
    half = parts.get("half")
    if half is not None:
        hours = hours % 12 + 12 * (half in "Pp")
    return hours * 3600 + int(parts["min"] or 0) * 60 + int(parts["s"] or 0) + float(f"0.{parts['f'] or 0}")


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
