"""What one entry of a rig file may hold: values that say what is wrong with them, and how to write them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import ErrorDetails, PydanticCustomError

from dashpot.channel import Quantity
from dashpot.errors import UsageError
from dashpot.io.words import did_you_mean, listed, quoted, shown, written
from dashpot.model.elements import Kind
from dashpot.quantities import Amount, amount

GROUND = "ground"
SECTIONS: Mapping[str, Kind] = {kind.section: kind for kind in Kind}
HEAD_KEYS = ("name", "coordinates", "angles")
MOST_COORDINATES = 1_000_000
TABLES = ("inputs", "free", "blocks", *SECTIONS, "channels")


def _wrong(what: str, cure: str | None = None) -> PydanticCustomError:
    return PydanticCustomError("rig", "{what}", {"what": what, "cure": cure})


def _number(value: object) -> float:
    if isinstance(value, str):
        if re.fullmatch(r"\s*-?\d+,\d+\s*", value):
            cure = f"write {_plain(value.strip().replace(',', '.'))}, with a point and without quotes"
            raise _wrong(f"{written(value)} is text", cure)
        bare = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\D.*)?", value)
        if bare is not None and bare[2] is not None:
            cure = f"write {_plain(bare[1])} without quotes: this number has no unit"
            raise _wrong(f"{written(value)} is text", cure)
        if bare is not None:
            raise _wrong(f"{written(value)} is text", f"write {_plain(bare[1])} without quotes")
        if value.strip().lower() in ("unknown", "?", ""):
            raise _wrong(f"{written(value)} is text", "leave the key out where the value is unknown")
        raise _wrong(f"{written(value)} is text", "write a number")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(f"{written(value)} is not a number", "write a number")
    try:
        number = float(value)
    except OverflowError:
        raise _wrong("the number is too large", "write a finite number") from None
    if not math.isfinite(number):
        raise _wrong(f"{written(value)} is not finite", "write a finite number")
    return number


def _plain(digits: str) -> str:
    """A number as TOML takes it: .5 and 5. are not."""
    digits = digits.removeprefix("+")
    digits = re.sub(r"^(-?)\.", r"\g<1>0.", digits)
    digits = re.sub(r"^(-?)0+(?=\d)", r"\1", digits)
    return re.sub(r"\.(?!\d)", ".0", digits)


def _amount(value: object) -> float | Amount:
    """A number, or a text of a number and its unit."""
    if isinstance(value, str) and _WITH_UNIT.fullmatch(value):
        try:
            return amount(value)
        except UsageError as error:
            raise _wrong(error.problems[0].what, error.problems[0].cure) from None
    return _number(value)


def _amount_or_unknown(value: object) -> float | Amount | None:
    return None if isinstance(value, str) and value.strip().lower() == "unknown" else _amount(value)


def _share(value: object) -> float:
    """A number, or a text in per cent."""
    given = _amount(value)
    if not isinstance(given, Amount):
        return given
    if given.unit != "%":
        raise _wrong(f"{written(value)} is not a share", "write a number or per cent, such as 0.05 or 5 %")
    return given.number / 100


def _number_or_unknown(value: object) -> float | None:
    if isinstance(value, str) and value.strip().lower() == "unknown":
        return None
    return _number(value)


def _gain(value: object) -> float | str | None:
    """A number, None for "unknown", or a sensitivity such as "100 mV/g", which needs the channel's quantity."""
    if isinstance(value, str) and re.match(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*[A-Za-zµμ]", value):
        return value
    return _number_or_unknown(value)


def _text(value: object) -> str:
    if not isinstance(value, str):
        cure = (
            "write it in quotes" if isinstance(value, dict | list) else f'write "{written(value)}" in quotes'
        )
        raise _wrong(f"{written(value)} is not text", cure)
    return value


def _texts(value: object) -> list[str]:
    if isinstance(value, str):
        raise _wrong(f"{written(value)} is text, not a list", f"write [{quoted(value[:40])}]")
    if not isinstance(value, list):
        raise _wrong(f"{written(value)} is not a list", 'write a list of names, such as ["x1", "x2"]')
    return value


def _coordinates(value: object) -> list[str]:
    """A list of names, or a range of them: "q1:q1200"."""
    ends = re.fullmatch(r"([^\d:]*)(\d{1,9}):([^\d:]*)(\d{1,9})", value) if isinstance(value, str) else None
    if ends is None:
        return _texts(value)
    first, last = int(ends[2]), int(ends[4])
    if ends[1] != ends[3] or not first <= last < first + MOST_COORDINATES:
        cure = (
            f"write a range such as {quoted('q1:q1200')} of at most {MOST_COORDINATES:,} names, or list them"
        )
        raise _wrong(f"{written(value)} is not a range of names", cure)
    return [f"{ends[1]}{k}" for k in range(first, last + 1)]


def _pair(value: object) -> list[str]:
    names = _texts(value)
    if len(names) != 2:
        raise _wrong(
            f"{len(names)} point{'' if len(names) == 1 else 's'} instead of two",
            'write two points, such as ["x1", "ground"]; a lever with more takes along = { x1 = 0.6, x2 = 0.4 }',
        )
    return names


def _one_or_table(value: object) -> dict[str, Any]:
    if isinstance(value, str):
        return {value: 1.0}
    if isinstance(value, list):
        raise _wrong(
            "a list has no factors", "name one point, or write a table of factors { x1 = 1, x2 = -1 }"
        )
    if not isinstance(value, dict):
        raise _wrong(
            f"{written(value)} is not a point", 'name one, such as "x1", or a table { x1 = 1, x2 = -1 }'
        )
    if not value:
        raise _wrong("the table names no point", "name one, such as { x1 = 1 }")
    return value


def _one_or_many(value: object) -> dict[str, Any]:
    if isinstance(value, list):
        if not value:
            raise _wrong("the list is empty", 'name a coordinate, such as "x1"')
        if not all(isinstance(name, str) for name in value):
            raise _wrong("the list holds more than names", 'list names, such as ["x1", "x2"]')
        if len(set(value)) < len(value):
            raise _wrong("a name appears twice in the list", "write a table of factors, such as { x1 = 2 }")
        return dict.fromkeys(value, 1.0)
    return _one_or_table(value)


def _table(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(
            f"{written(value)} is not a table", "write a table of factors, such as { x1 = 0.6, x2 = 0.4 }"
        )
    return _one_or_table(value)


def _one_of(*choices: str) -> BeforeValidator:
    def chosen(value: object) -> str:
        if _text(value) in choices:
            return str(value)
        guess = did_you_mean(str(value), choices)
        raise _wrong(
            f"{written(value)} is not one of the choices", f"{guess}use {' or '.join(map(quoted, choices))}"
        )

    return BeforeValidator(chosen)


_WITH_UNIT = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*[^\s\d.,:].*")

Number = Annotated[float, BeforeValidator(_number)]
GivenAmount = Annotated[float | Amount, BeforeValidator(_amount)]
AmountOrUnknown = Annotated[float | Amount | None, BeforeValidator(_amount_or_unknown)]
Share = Annotated[float, BeforeValidator(_share)]
NumberOrUnknown = Annotated[float | None, BeforeValidator(_number_or_unknown)]
Gain = Annotated[float | str | None, BeforeValidator(_gain)]
Text = Annotated[str, BeforeValidator(_text)]
Names = Annotated[list[Text], BeforeValidator(_texts)]
OnePointOrTable = Annotated[dict[str, GivenAmount], BeforeValidator(_one_or_table)]
OneOrMany = Annotated[dict[str, GivenAmount], BeforeValidator(_one_or_many)]
PointTable = Annotated[dict[str, GivenAmount], BeforeValidator(_table)]


class Entry(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Head(Entry):
    name: Text = ""
    coordinates: Annotated[list[Text], BeforeValidator(_coordinates)]
    angles: Names = Field(default_factory=list)


class InputEntry(Entry):
    kind: Annotated[Literal["displacement", "force"], _one_of("displacement", "force")] = "displacement"
    at: OneOrMany | None = None


class ElementEntry(Entry):
    at: OnePointOrTable | None = None
    between: Annotated[list[Text], BeforeValidator(_pair)] | None = None
    along: PointTable | None = None
    value: GivenAmount | None = None
    sd: GivenAmount | None = None
    guess: GivenAmount | None = None
    min: GivenAmount | None = None
    max: GivenAmount | None = None
    unit: Text | None = None
    same_as: Text | None = None
    times: Share = 1.0
    law: Text | None = None


class BlockEntry(Entry):
    matrix: Annotated[Literal["M", "C", "K", "H"], _one_of("M", "C", "K", "H")]
    file: Text
    array: Text | None = None
    coordinates: Names | None = None
    value: Number | None = None
    sd: Number | None = None
    guess: Number | None = None
    min: Number | None = None
    max: Number | None = None


class ConstantEntry(Entry):
    value: GivenAmount | None = None
    sd: GivenAmount | None = None
    guess: GivenAmount | None = None
    min: GivenAmount | None = None
    max: GivenAmount | None = None


class ChannelEntry(Entry):
    of: OnePointOrTable
    quantity: Annotated[str, _one_of(*Quantity)] | None = None
    unit: Text | None = None
    gain: Gain = 1.0
    delay: AmountOrUnknown = 0.0
    sign: NumberOrUnknown = 1.0
    noise: GivenAmount = 0.0
    relative_noise: Share = 0.0
    rate: GivenAmount | None = None
    same_gain_as: Text | None = None
    full_scale: GivenAmount | None = None
    bits: Number | None = None


FREE_EXAMPLE = 'free = "MCK", or [free] and below it K = "full", M = "diagonal"'
TWO_POINTS = '{ between = ["x1", "ground"] }'
EXAMPLES: Mapping[str, str] = {
    "inputs": '{ kind = "displacement" }',
    "masses": '{ at = "x1" }',
    "blocks": '{ matrix = "K", file = "K1.mtx" }',
    "channels": '{ of = "x1", unit = "mm" }',
}
AnyEntry = TypeVar("AnyEntry", bound=Entry)


def explained(error: ErrorDetails, entry: type[Entry]) -> tuple[str, str | None]:
    """Cause and cure of one of pydantic's errors."""
    if error["type"] == "rig":
        return error["ctx"]["what"], error["ctx"]["cure"]
    key = str(error["loc"][-1])
    if error["type"] == "extra_forbidden":
        known = tuple(entry.model_fields)
        meant = [name for name in _ALSO_CALLED.get(key.lower(), ()) if name in known]
        return "unknown key", f"{did_you_mean(meant[0] if meant else key, known)}there are {listed(known)}"
    if error["type"] == "missing":
        return "missing", f"add {_MISSING_EXAMPLES.get(key, key)}"
    return shown(str(error["msg"]), 200), None


# What people write for a key.
_ALSO_CALLED = {
    "at": ("of",), "of": ("at", "between"), "point": ("at", "of"), "points": ("between",), "nodes": ("between",),
    "type": ("quantity", "kind"), "kind": ("quantity",), "units": ("unit",), "sensitivity": ("gain",),
    "mass": ("value",), "stiffness": ("value",), "damping": ("value",), "start": ("guess",), "initial": ("guess",),
    "lower": ("min",), "upper": ("max",), "std": ("sd", "noise"), "sigma": ("sd", "noise"),
}  # fmt: skip
_MISSING_EXAMPLES = {
    "coordinates": 'coordinates = ["x1"]',
    "of": 'of = "x1"',
    "matrix": 'matrix = "K"',
    "file": 'file = "K1.mtx"',
}
