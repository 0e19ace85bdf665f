"""Quantities, shares and lists of frequencies as people write them: "4.6 kN/m", "5 %", "1:10:0.5", "1:10/25".

One syntax for the command line and for study files.  All raise UsageError that says how to write it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from dashpot.errors import UsageError
from dashpot.units import scale, si_unit

LARGEST, SMALLEST = 1e30, 1e-30  # beyond these, squares and products of a few quantities leave floating point
MOST_FREQUENCIES = 1_000_000
FREQUENCY_SYNTAX = "1,2,5, or a range start:stop:step or start:stop/points (1:10:0.5, 1:10/25; Hz)"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_AMOUNT = re.compile(rf"\s*({_NUMBER})\s*([^\s\d:,].*?)?\s*", re.DOTALL)
_POINTS = re.compile(rf"\s*({_NUMBER}\s*[^\d:]*?)\s*/\s*(\d+)\s*(log)?\s*")


@dataclass(frozen=True)
class Amount:
    """A number and the unit written behind it; `unit` is None where none is written, which means SI."""

    number: float
    unit: str | None = None

    def si(self, quantity: str, angular: bool = False) -> float:
        """The value in SI units (Hz for a frequency).  `quantity`, `angular` as in `units.scale`.

        Raises UsageError if the unit is not one of that quantity, or the value leaves the range of numbers.
        """
        factor = 1.0 if self.unit is None else scale(self.unit, quantity, angular)
        return within_range(self.number * factor, str(self))

    def __str__(self) -> str:
        return f"{self.number:g}" if self.unit is None else f"{self.number:g} {self.unit}"


def amount(text: str) -> Amount:
    """A number with or without a unit: "5mm", "4.6 kN/m", "3".  Raises UsageError."""
    match = _AMOUNT.fullmatch(text)
    if match is None:
        raise UsageError(
            f"{text.strip()!r} is not a quantity", cure="write a number, with a unit if you like: 2 mm"
        )
    return Amount(within_range(float(match[1]), text), match[2])


def fraction(text: str) -> float:
    """A share of something as a number: "5 %" and "0.05" are 0.05.  Raises UsageError."""
    bare = text.strip().removesuffix("%")
    per_cent = bare != text.strip()
    try:
        number = float(bare) / (100.0 if per_cent else 1.0)
    except ValueError:
        number = math.nan
    if not re.fullmatch(_NUMBER, bare.strip()) or not math.isfinite(number):
        raise UsageError(f"{text.strip()!r} is not a share", cure="write it as 5% or 0.05")
    return within_range(number, text)


def positive(value: float, text: str) -> float:
    """The value, if it is above 0.  Raises UsageError."""
    if not value > 0:
        raise UsageError(f"{text.strip()!r} is out of range", cure="give a number above 0")
    return value


def quantity(text: str, kind: str, angular: bool = False) -> float:
    """A quantity in SI units, such as `quantity("90 s", "time")`; `kind` is one of `units.QUANTITIES`."""
    return amount(text).si(kind, angular)


def frequency(text: str, unit: str | None = None) -> float:
    """A frequency in Hz; `unit` is what a bare number is in (None: Hz).  Raises UsageError."""
    try:
        given = amount(text)
        value = Amount(given.number, given.unit or unit).si("frequency")
    except UsageError:
        if re.fullmatch(_NUMBER, text.strip()):
            raise  # a number, but out of range
        value = math.nan
    if math.isnan(value):
        raise UsageError(
            f"{text.strip()!r} is not a frequency", cure=f"write frequencies as {FREQUENCY_SYNTAX}"
        )
    if not 0 < value < 1e12:  # Hz; nothing vibrates so fast
        raise UsageError(f"{text.strip()!r} is out of range", cure="frequencies are positive, in Hz")
    return value


def band(text: str) -> tuple[float, float]:
    """A band of frequencies, "0.5:25": its lower and its upper end, Hz.  Raises UsageError."""
    pieces = text.split(":")
    if len(pieces) != 2:
        raise UsageError(
            f"{text.strip()!r} is not a band", cure="write it as lower:upper, such as 0.5:25 (Hz)"
        )
    unit = _unit_of(pieces[1])
    low, high = (frequency(piece, unit) for piece in pieces)
    if low >= high:
        raise UsageError(f"{text.strip()!r} is not a band", cure="the upper end must be above the lower one")
    return low, high


def frequencies(text: str) -> tuple[float, ...]:
    """Frequencies in Hz, in the order written: values, and ranges by step or by number of points, with commas between.

    "1,2,5"; "1:10:0.5" from 1 to at most 10 in steps of 0.5; "1:10/25" 25 points from 1 to 10, evenly spaced, and
    "1:10/25log" evenly on a logarithmic scale.  A unit behind the last number of a part holds for the whole part.
    Raises UsageError.
    """
    listed: list[float] = []
    for part in text.split(","):
        for value in _frequencies_of_part(part):
            listed.append(value)
            if len(listed) > MOST_FREQUENCIES:
                raise UsageError(
                    f"{part.strip()!r} makes more than {MOST_FREQUENCIES:,} frequencies",
                    cure="use a larger step",
                )
    return tuple(listed)


def _frequencies_of_part(part: str) -> Iterable[float]:
    pieces = part.split(":")
    if len(pieces) == 1:
        return [frequency(part)]
    points = _POINTS.fullmatch(pieces[1]) if len(pieces) == 2 else None
    if points is None and len(pieces) != 3:
        raise UsageError(
            f"{part.strip()!r} is not a range of frequencies", cure=f"write frequencies as {FREQUENCY_SYNTAX}"
        )
    last = pieces[1] if points is None else points[1]
    unit = _unit_of(pieces[-1] if points is None else last)
    start, stop = frequency(pieces[0], unit), frequency(last, unit)
    if start >= stop:
        raise UsageError(
            f"{part.strip()!r} ends below its start", cure="write start:stop with start below stop"
        )
    if points is None:
        step = frequency(pieces[2], unit)
        steps = math.floor((stop - start) / step * (1 + 1e-12) + 1e-9)
        return (start + k * step for k in range(steps + 1))
    count = int(points[2])
    if not 2 <= count <= MOST_FREQUENCIES:
        raise UsageError(
            f"{part.strip()!r} asks for {count:,} points", cure=f"take 2 to {MOST_FREQUENCIES:,} points"
        )
    shares = (k / (count - 1) for k in range(count))
    if points[3] is not None:
        return (start * (stop / start) ** share for share in shares)
    return (start + (stop - start) * share for share in shares)


def _unit_of(piece: str) -> str | None:
    match = _AMOUNT.fullmatch(piece)
    return None if match is None else match[2]


def within_range(value: float, text: str) -> float:
    """The value; raises UsageError if squares and products of it would leave floating point."""
    if not (value == 0 or SMALLEST <= abs(value) <= LARGEST):
        raise UsageError(
            f"{text.strip()!r} is out of range", cure=f"give a magnitude from {SMALLEST:g} to {LARGEST:g}"
        )
    return value


def quantity_of_unit(unit: str) -> tuple[str, bool] | None:
    """Which quantity a parameter's SI unit belongs to, and whether it is an angular one; None for a bare number."""
    for kind in ("mass", "damping", "stiffness"):
        for angular in (False, True):
            if si_unit(kind, angular) == unit:
                return kind, angular
    return None
