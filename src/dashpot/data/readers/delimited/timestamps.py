"""Moments written as text, 2025-03-06 12:21:16.125 or 06.03.2025 12:21:16, as seconds from the first."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Real

_CLOCK = r"(?P<h>\d{1,2}):(?P<min>\d{2})(?::(?P<s>\d{2})(?:[.,](?P<f>\d{1,9}))?)?"
_ZONE = r"\s*(?P<zone>Z|[+-]\d{2}:?\d{2})?"
_DATE = r"(?P<y>\d{4})[-/](?P<m>\d{1,2})[-/](?P<d>\d{1,2})|(?P<d2>\d{1,2})\.(?P<m2>\d{1,2})\.(?P<y2>\d{4})"
_MOMENT = re.compile(rf"\s*(?:(?:{_DATE})[T ]\s*)?{_CLOCK}{_ZONE}\s*")


def is_timestamp(text: str) -> bool:
    """Whether a cell is a moment: a date and a time of day, or a time of day."""
    return _MOMENT.fullmatch(text) is not None


def seconds_of(texts: Sequence[str]) -> tuple[Real, int | None]:
    """Seconds from the first moment, and the first cell that is none (None: all are).

    A time of day alone may pass midnight once or more; the zone is left out of account where all have the same.
    """
    seconds = np.zeros(len(texts))
    days = 0
    origin: np.datetime64 | None = None
    before = -1.0
    for i, text in enumerate(texts):
        match = _MOMENT.fullmatch(text)
        if match is None:
            return seconds, i
        fraction = float(f"0.{match['f']}") if match["f"] else 0.0
        of_day = int(match["h"]) * 3600 + int(match["min"]) * 60 + int(match["s"] or 0) + fraction
        year = match["y"] or match["y2"]
        if year is None:
            days += of_day < before - 43200
            before = of_day
            seconds[i] = days * 86400 + of_day
            continue
        month, day = int(match["m"] or match["m2"]), int(match["d"] or match["d2"])
        try:
            date = np.datetime64(f"{year}-{month:02d}-{day:02d}", "D")
        except ValueError:
            return seconds, i
        origin = date if origin is None else origin
        seconds[i] = float((date - origin).astype(int)) * 86400 + of_day
    return seconds - (seconds[0] if len(seconds) else 0.0), None
