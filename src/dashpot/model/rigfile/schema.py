"""What one entry of a rig file may hold: values that say what is wrong with them, and how to write them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from dashpot.channel import Quantity
from dashpot.errors import ModelError, UsageError
from dashpot.io.toml_document import Place, Report, TomlDocument
from dashpot.io.words import did_you_mean, listed, quoted, shown, written
from dashpot.model.elements import Kind
from dashpot.quantities import Amount, amount, within_range
from dashpot.units import scale

GROUND = "ground"
SECTIONS: Mapping[str, Kind] = {kind.section: kind for kind in Kind}
HEAD_KEYS = ("name", "coordinates", "angles")
MOST_COORDINATES = 1_000_000
TABLES = ("inputs", "free", "blocks", *SECTIONS, "channels")
VERDICT = "verdict"


def _wrong(what: str, cure: str | None = None) -> PydanticCustomError:
    return PydanticCustomError("rig", "{what}", {"what": what, "cure": cure})


Given = TypeVar("Given")


def _read(given: Callable[[], Given]) -> Given:
    """What `given` returns; what it refuses is refused in its words."""
    try:
        return given()
    except UsageError as error:
        raise _wrong(error.problems[0].what, error.problems[0].cure) from None


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
    return _read(lambda: within_range(number, written(value)))


def _plain(digits: str) -> str:
    """A number as TOML takes it: .5 and 5. are not."""
    digits = digits.removeprefix("+")
    digits = re.sub(r"^(-?)\.", r"\g<1>0.", digits)
    digits = re.sub(r"^(-?)0+(?=\d)", r"\1", digits)
    return re.sub(r"\.(?!\d)", ".0", digits)


def _amount(value: object) -> float | Amount:
    """A number, or a text of a number and its unit."""
    if isinstance(value, str) and _WITH_UNIT.fullmatch(value):
        return _read(lambda: amount(value))
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


def _part(value: object) -> float:
    share = _share(value)
    if not 0 < share < 1:
        raise _wrong(f"{written(value)} is out of range", "give a share between 0 and 1, such as 0.02 or 2 %")
    return share


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


class VerdictEntry(Entry):
    within: Annotated[float, BeforeValidator(_part)]


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


def validation_problem(error: ErrorDetails, entry: type[Entry]) -> tuple[str, str | None]:
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


# One rig file while it is read: its tables, the problems met so far, and what is missing because of them.


def _example(section: str, raw: object) -> str:
    """How an entry of the section is written, of the points that stand there where they are all that does."""
    points = raw if isinstance(raw, list) else [raw]
    if all(isinstance(point, str) for point in points):
        if len(points) == 1 and section in ("masses", "channels"):
            return f"{{ {'of' if section == 'channels' else 'at'} = {written(points[0])} }}"
        if len(points) == 2 and section in SECTIONS and section != "masses":
            return f"{{ between = [{', '.join(map(written, points))}] }}"
    return EXAMPLES.get(section, TWO_POINTS)


class RigReading:
    """A document, the report of its problems, and the names of inputs and elements that could not be read whole."""

    def __init__(self, document: TomlDocument) -> None:
        self.document = document
        self.table = document.table
        self.report = Report(document, ModelError)
        self.faulty: set[str] = set()

    def head(self) -> Head:
        """Name, coordinates and angles; what is usable of the coordinates where they are faulty."""
        known = (*HEAD_KEYS, *TABLES, VERDICT)
        for key in self.table:
            if key not in known:
                cure = f"{did_you_mean(key, known)}a rig file has {listed(known)}"
                self.report.add((key,), "unknown key or section", cure)
                self.faulty.add(key)  # what it holds is missing elsewhere
        raw = {key: self.table[key] for key in HEAD_KEYS if key in self.table}
        head = self.validated(Head, raw, ())
        if head is not None and head.coordinates:
            return head
        if head is not None:
            cure = 'list them, such as coordinates = ["x1"]'
            self.report.add(("coordinates",), "there are no coordinates", cure)
        self.faulty.add("coordinates")
        names = raw.get("coordinates")
        usable = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
        return Head(coordinates=usable)

    def within(self) -> float | None:
        """The share of the motion in [verdict]; None where there is none."""
        raw = self.table.get(VERDICT, {})
        if not isinstance(raw, dict):
            self.report.add(
                (VERDICT,), f"{written(raw)} is not a section", 'write [verdict] and below it within = "2 %"'
            )
            return None
        verdict = self.validated(VerdictEntry, raw, (VERDICT,)) if raw else None
        return None if verdict is None else verdict.within

    def validated(self, entry: type[AnyEntry], raw: dict[str, Any], place: Place) -> AnyEntry | None:
        """The table `raw` as an entry; None, and its problems reported, where it is none."""
        try:
            return entry.model_validate(raw)
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                what, cure = validation_problem(detail, entry)
                self.report.add((*place, *detail["loc"]), what, cure)
            return None

    def entries(self, section: str) -> Iterator[tuple[str, Any]]:
        """Names and tables of a section; a section that is not a table is reported."""
        table = self.table.get(section, {})
        if isinstance(table, dict):
            yield from table.items()
            return
        self.faulty.add(section)
        names = [name for name in table if isinstance(name, str)] if isinstance(table, list) else []
        name = names[0] if names and section in ("inputs", "channels") else "name"
        example = f"[{section}] and below it {name} = {EXAMPLES.get(section, TWO_POINTS)}"
        tables = isinstance(table, list) and table and all(isinstance(entry, dict) for entry in table)
        what = "a list of tables" if tables else written(table)
        self.report.add((section,), f"{what} is not a section", f"write {example}")

    def entry(self, entry: type[AnyEntry], section: str, name: str, raw: object) -> AnyEntry | None:
        """One entry of a section; None, and its problems reported, where it cannot be read."""
        if isinstance(raw, dict):
            return self.validated(entry, raw, (section, name))
        example = _example(section, raw)
        if isinstance(raw, int | float) and not isinstance(raw, bool) and section in SECTIONS:
            example = example.replace(" }", f", value = {written(raw)} }}")
        cure = f"write {name} = {example}"
        if name in (*HEAD_KEYS, "free"):
            cure = f"{name} stands above the first [section]; or {cure}"
        self.report.add((section, name), f"{written(raw)} is not a table", cure)
        return None

    def points_known(
        self,
        place: Place,
        factors: Mapping[str, float],
        points: Collection[str],
        as_table: bool,
        called: str = "point",
    ) -> bool:
        """Whether all points of a combination exist and have a factor; `as_table`: each has a key of its own."""
        good = True
        for point, factor in factors.items():
            place_of_point = (*place, point) if as_table else place
            if point not in points and not (point == GROUND and called == "point"):
                good = False
                if "coordinates" not in self.faulty:  # else the point may stand in what could not be read
                    others = (*points, GROUND) if called == "point" else tuple(points)
                    cure = f"{did_you_mean(point, others)}there are {listed(others)}"
                    self.report.add(place_of_point, f"{written(point)} is not a {called}", cure)
            elif factor == 0:
                good = False
                self.no_factor(place_of_point, point)
        return good

    def no_factor(self, place: Place, point: str) -> None:
        """Reports a factor of zero."""
        self.report.add(place, f"the factor of {point} is 0", "give another one, or leave the point out")


# Amounts in a rig file: numbers in the unit of their entry, or texts with a unit of their own: "4.6 kN/m",
# "1 %".


PER_CENT = "%"


def in_si(
    reading: RigReading, place: Place, given: float | Amount, plain: float, scale_of: Callable[[str], float]
) -> float | None:
    """An amount in SI units: a number times `plain`, else by its own unit; None, and told, where that is no such unit.

    `scale_of` gives the factor of a unit to SI and raises UsageError for a unit of something else.
    """
    if not isinstance(given, Amount):
        return given * plain
    try:
        return given.number * (plain if given.unit is None else scale_of(given.unit))
    except UsageError as error:
        for problem in error.problems:
            reading.report.add(place, problem.what, problem.cure)
        return None


def number_of(given: float | Amount) -> float:
    """The number of an amount, whatever its unit."""
    return given.number if isinstance(given, Amount) else given


def is_share(given: float | Amount | None) -> bool:
    """Whether an amount is written in per cent."""
    return isinstance(given, Amount) and given.unit == PER_CENT


def factors(
    reading: RigReading, place: Place, given: Mapping[str, float | Amount], angles: Collection[str]
) -> dict[str, float] | None:
    """Factors of points: numbers, shares in per cent, and lengths for the arms of angles; None, and told, if faulty."""

    def scale_of(point: str, unit: str) -> float:
        if unit == PER_CENT:
            return 0.01
        if point not in angles:
            raise UsageError(
                f"{point} is not an angle, so its factor has no unit",
                cure="write a number or a share, such as 60 %",
            )
        return scale(unit, "displacement")

    numbers = {
        point: in_si(reading, (*place, point), factor, 1.0, lambda unit, point=point: scale_of(point, unit))  # type: ignore[misc]
        for point, factor in given.items()
    }
    whole = {point: number for point, number in numbers.items() if number is not None}
    return whole if len(whole) == len(numbers) else None


def read_numbers(
    reading: RigReading,
    place: Place,
    entry: ElementEntry | ConstantEntry,
    plain: float,
    scale_of: Callable[[str], float],
) -> dict[str, Any] | None:
    """Value, sd, guess, lower and upper of an entry, where given, in SI units; None, and told, where one is faulty."""
    numbers: dict[str, float] = {}
    faulty = False
    for key, field in (
        ("value", "value"),
        ("sd", "sd"),
        ("guess", "guess"),
        ("min", "lower"),
        ("max", "upper"),
    ):
        given = getattr(entry, key)
        if given is None:
            continue
        if isinstance(given, Amount) and given.unit == PER_CENT:
            number = _share_of_value(reading, (*place, key), given, numbers.get("value"))
        else:
            number = in_si(reading, (*place, key), given, plain, scale_of)
        if number is None:
            faulty = True
        else:
            numbers[field] = number
    return None if faulty else numbers


def _share_of_value(reading: RigReading, place: Place, share: Amount, value: float | None) -> float | None:
    """An sd in per cent of the value; None, and told, for another key or where there is no value."""
    if place[-1] != "sd":
        reading.report.add(place, f"{share} is a share", "only an sd may be one, of the value; write a unit")
        return None
    if value is None:
        reading.report.add(place, f"an sd of {share} without a value", "give the value that it is a share of")
        return None
    return abs(value) * share.number / 100
