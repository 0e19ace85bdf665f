"""Rig files: TOML that describes a model and what its channels measure.

    rig = read_rig("rig.toml")        rig.model, rig.channels
    text = write_rig(rig)             reads back to the same rig

Whatever is wrong with a file is a ModelError with all its problems, each at `rig.toml:8: springs.k1`.
"""

from __future__ import annotations

import difflib
import json
import math
import os
import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from dashpot.channel import Channel, Quantity
from dashpot.errors import ModelError, Problem, UsageError
from dashpot.io.ledger import noted
from dashpot.io.toml_document import Lines
from dashpot.model import network
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model, listed
from dashpot.model.unstructured import LETTERS, Letter, Pairs, free_elements, free_entries
from dashpot.units import scale, sensitivity, si_unit

GROUND = "ground"
SECTIONS: Mapping[str, Kind] = {kind.section: kind for kind in Kind}
_HEAD = ("name", "coordinates", "angles")
_TABLES = ("inputs", "free", *SECTIONS, "channels")

Place = tuple[str | int, ...]


@dataclass(frozen=True)
class Rig:
    """A model, the channels that its data files are made of, and the file it was read from."""

    model: Model
    channels: tuple[Channel, ...]
    path: str = ""


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig in the TOML file `path`.

    Raises ModelError with every problem found, each at file:line and key.
    """
    shown = os.fspath(path)
    try:
        with open(noted(path), "rb") as file:
            raw = file.read()
    except FileNotFoundError:
        raise ModelError("there is no such file", shown, "check the name and the folder") from None
    except IsADirectoryError:
        raise ModelError("this is a folder", shown, "name the rig file in it") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ModelError(f"the file cannot be read: {reason}", shown, "check its name and rights") from None
    return parse_rig(_decoded(raw, shown), shown)


def parse_rig(text: str, path: str = "rig.toml") -> Rig:
    """The rig described by a TOML text; `path` is named in messages.

    Raises ModelError with every problem found, each at file:line and key.
    """
    document = _document(text, path)
    return _Reader(document, text, path).rig()


def default_channels(model: Model) -> tuple[Channel, ...]:
    """A channel for every coordinate and input, of its own name, in SI units."""
    motions = [
        Channel(point, {point: 1.0}, Quantity.DISPLACEMENT, si_unit("displacement", point in model.angles))
        for point in (*model.coordinates, *model.displacement_inputs)
    ]
    forces = [
        Channel(one.name, {one.name: 1.0}, Quantity.FORCE, si_unit("force", _all_in(one.at, model.angles)))
        for one in model.inputs
        if one.kind == "force"
    ]
    return (*motions, *forces)


# From bytes to a table of TOML


def _decoded(raw: bytes, path: str) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ModelError("the file is UTF-16", path, "save it as UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ModelError(
            f"byte {raw[error.start]:#04x} is not UTF-8", f"{path}:{line}", "save the file as UTF-8"
        ) from None


def _document(text: str, path: str) -> dict[str, Any]:
    if not text.strip():
        raise ModelError("the file is empty", path, 'describe a rig, starting with coordinates = ["x1"]')
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ModelError([_syntax_problem(str(error), text, path)]) from None
    except RecursionError:
        raise ModelError("lists or tables are nested too deep", path, "a rig needs three levels") from None
    except ValueError:  # Python reads no integers of more than some thousand digits
        raise ModelError("a number has too many digits", path, "write it as 1.5e10") from None


_SYNTAX_CURES = (
    ("Expected '='", "write key = value"),
    ("Invalid value", 'write numbers with a decimal point, texts in quotes: "x1"'),
    (
        "nitial character for a key",
        "write key = value; keys of other than letters, digits, _ and - take quotes",
    ),
    ("Cannot", "give a key once, as a value or as a table"),
    ("Expected ']", "close the bracket"),
    ("Expected newline", "one key a line; decimals take a point, texts quotes"),
    ("nclosed inline table", "a table in { } stands on one line, its entries separated by commas"),
    ("nclosed array", "separate the items by commas and close the list with ]"),
    ("string", 'close the text with "'),
    ('Expected "\'"', "close the text with '"),
    ("Illegal character", 'texts end with " on the line they start on'),
)


def _syntax_problem(message: str, text: str, path: str) -> Problem:
    if re.match(r"Cannot (overwrite|declare|mutate)|Duplicate", message):
        again = Lines(text.replace("\r\n", "\n")).twice()
        if again is not None:
            place, first, second = again
            return Problem(
                f"given twice, first in line {first}",
                f"{path}:{second}: {_dotted(place)}",
                "remove one of them",
            )
    cure = next((cure for part, cure in _SYNTAX_CURES if part in message), "correct the TOML here")
    found = re.search(r" \(at line (\d+), column (\d+)\)$", message)
    if found is not None:
        line = text.replace("\r\n", "\n").split("\n")[int(found[1]) - 1]
        rest = line[int(found[2]) - 1 :].strip()
        if rest.startswith("}"):
            cure = "remove the comma before }"
        elif "{" in line and "}" not in line and (not rest or rest.startswith("#")):
            cure = "a table in { } stands on one line; a long one can be a [section.name] with a line for each key"
        cause = f"{message[: found.start()]}, at column {found[2]}"
        return Problem(_one_line(cause), f"{path}:{found[1]}", cure)
    last = text.rstrip().count("\n") + 1
    return Problem(
        _one_line(message.removesuffix(" (at end of document)")) + ", at the end", f"{path}:{last}", cure
    )


# What one entry may hold: values that say what is wrong with them


def _wrong(what: str, cure: str | None = None) -> PydanticCustomError:
    return PydanticCustomError("rig", "{what}", {"what": what, "cure": cure})


def _show(value: object) -> str:
    """A value as the file wrote it, short and on one line."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return _quoted(value if len(value) <= 40 else value[:39] + "…")
        case dict():
            return "a table"
        case list():
            return "a list"
        case int() if abs(value) > 10**20:
            return "so large a number"
    return str(value)


def _quoted(text: str) -> str:
    """A TOML basic string."""
    return "".join(
        c if c.isprintable() else f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}"
        for c in json.dumps(text, ensure_ascii=False)
    )


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)[:200]


def _number(value: object) -> float:
    if isinstance(value, str):
        if re.fullmatch(r"\s*-?\d+,\d+\s*", value):
            cure = f"write {_plain(value.strip().replace(',', '.'))}, with a point and without quotes"
            raise _wrong(f"{_show(value)} is text", cure)
        bare = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\D.*)?", value)
        if bare is not None and bare[2] is not None:
            cure = f"write {_plain(bare[1])} without quotes, and the unit in unit = {_quoted(bare[2][:20].strip())}"
            raise _wrong(f"{_show(value)} is text", cure)
        if bare is not None:
            raise _wrong(f"{_show(value)} is text", f"write {_plain(bare[1])} without quotes")
        if value.strip().lower() in ("unknown", "?", ""):
            raise _wrong(f"{_show(value)} is text", "leave the key out where the value is unknown")
        raise _wrong(f"{_show(value)} is text", "write a number")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(f"{_show(value)} is no number", "write a number")
    try:
        number = float(value)
    except OverflowError:
        raise _wrong("the number is too large", "write a finite number") from None
    if not math.isfinite(number):
        raise _wrong(f"{_show(value)} is not finite", "write a finite number")
    return number


def _plain(digits: str) -> str:
    """A number as TOML takes it: .5 and 5. are not."""
    digits = digits.removeprefix("+")
    digits = re.sub(r"^(-?)\.", r"\g<1>0.", digits)
    digits = re.sub(r"^(-?)0+(?=\d)", r"\1", digits)
    return re.sub(r"\.(?!\d)", ".0", digits)


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
        cure = "write it in quotes" if isinstance(value, dict | list) else f'write "{_show(value)}" in quotes'
        raise _wrong(f"{_show(value)} is no text", cure)
    return value


def _texts(value: object) -> list[str]:
    if isinstance(value, str):
        raise _wrong(f"{_show(value)} is text, not a list", f"write [{_quoted(value[:40])}]")
    if not isinstance(value, list):
        raise _wrong(f"{_show(value)} is no list", 'write a list of names, such as ["x1", "x2"]')
    return value


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
            "a list says no factors", "name one point, or write a table of factors { x1 = 1, x2 = -1 }"
        )
    if not isinstance(value, dict):
        raise _wrong(f"{_show(value)} is no point", 'name one, such as "x1", or a table { x1 = 1, x2 = -1 }')
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
            raise _wrong("a name stands twice in the list", "write a table of factors, such as { x1 = 2 }")
        return dict.fromkeys(value, 1.0)
    return _one_or_table(value)


def _table(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(
            f"{_show(value)} is no table", "write a table of factors, such as { x1 = 0.6, x2 = 0.4 }"
        )
    return _one_or_table(value)


def _one_of(*choices: str) -> BeforeValidator:
    def chosen(value: object) -> str:
        if _text(value) in choices:
            return str(value)
        guess = _did_you_mean(str(value), choices)
        raise _wrong(
            f"{_show(value)} is none of the choices", f"{guess}use {' or '.join(map(_quoted, choices))}"
        )

    return BeforeValidator(chosen)


Number = Annotated[float, BeforeValidator(_number)]
NumberOrUnknown = Annotated[float | None, BeforeValidator(_number_or_unknown)]
Gain = Annotated[float | str | None, BeforeValidator(_gain)]
Text = Annotated[str, BeforeValidator(_text)]
Names = Annotated[list[Text], BeforeValidator(_texts)]
OnePointOrTable = Annotated[dict[str, Number], BeforeValidator(_one_or_table)]
OneOrMany = Annotated[dict[str, Number], BeforeValidator(_one_or_many)]
PointTable = Annotated[dict[str, Number], BeforeValidator(_table)]


class _Entry(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class _Head(_Entry):
    name: Text = ""
    coordinates: Names
    angles: Names = Field(default_factory=list)


class _InputEntry(_Entry):
    kind: Annotated[Literal["displacement", "force"], _one_of("displacement", "force")] = "displacement"
    at: OneOrMany | None = None


class _ElementEntry(_Entry):
    at: OnePointOrTable | None = None
    between: Annotated[list[Text], BeforeValidator(_pair)] | None = None
    along: PointTable | None = None
    value: Number | None = None
    sd: Number | None = None
    guess: Number | None = None
    min: Number | None = None
    max: Number | None = None
    unit: Text | None = None
    same_as: Text | None = None
    times: Number = 1.0


class _ChannelEntry(_Entry):
    of: OnePointOrTable
    quantity: Annotated[str, _one_of(*Quantity)] | None = None
    unit: Text | None = None
    gain: Gain = 1.0
    delay: NumberOrUnknown = 0.0
    sign: NumberOrUnknown = 1.0
    noise: Number = 0.0
    relative_noise: Number = 0.0
    rate: Number | None = None
    same_gain_as: Text | None = None


_ENTRIES: Mapping[str, type[_Entry]] = {
    "inputs": _InputEntry,
    "channels": _ChannelEntry,
    **dict.fromkeys(SECTIONS, _ElementEntry),
}
_FREE = 'free = "MCK", or [free] and below it K = "full", M = "diagonal"'
_EXAMPLES: Mapping[str, str] = {
    "inputs": '{ kind = "displacement" }',
    "masses": '{ at = "x1" }',
    "channels": '{ of = "x1", unit = "mm" }',
}
AnyEntry = TypeVar("AnyEntry", bound=_Entry)


# From the table to a rig


class _Reader:
    """Reads one document, gathering problems; `rig` gives the rig or raises them all."""

    def __init__(self, document: dict[str, Any], text: str, path: str) -> None:
        self.document = document
        self.text = text
        self.path = path
        self.problems: list[tuple[int, Problem]] = []
        self.faulty: set[str] = set()  # names of inputs and elements that could not be read whole

    @cached_property
    def lines(self) -> Lines:
        """Where each key stands; only a file with problems is scanned for it."""
        return Lines(self.text.replace("\r\n", "\n"))

    def rig(self) -> Rig:
        """The rig.  Raises ModelError."""
        head = self._head()
        inputs = self._inputs(head)
        elements = [*self._free(head), *self._elements(head, inputs)]
        self._model_problems(head, inputs, elements)
        channels = self._channels(head, inputs, elements)
        if self.problems:
            self.problems.sort(key=lambda found: found[0])
            raise ModelError(dict.fromkeys(problem for _, problem in self.problems))
        model = Model(
            tuple(head.coordinates), tuple(inputs), tuple(elements), head.name, frozenset(head.angles)
        )
        return Rig(model, default_channels(model) if channels is None else tuple(channels), self.path)

    def _report(self, place: Place, what: str, cure: str | None = None) -> None:
        line = self.lines.of(place)
        file = self.path if line is None else f"{self.path}:{line}"
        where = f"{file}: {_dotted(place)}" if place else file
        self.problems.append((line or 0, Problem(what, where, cure)))

    def _validated(self, entry: type[AnyEntry], raw: dict[str, Any], place: Place) -> AnyEntry | None:
        try:
            return entry.model_validate(raw)
        except ValidationError as error:
            for one in error.errors(include_url=False):
                what, cure = _explained(one, entry)
                self._report((*place, *one["loc"]), what, cure)
            return None

    def _head(self) -> _Head:
        known = (*_HEAD, *_TABLES)
        for key in self.document:
            if key not in known:
                cure = f"{_did_you_mean(key, known)}a rig file has {listed(known)}"
                self._report((key,), "unknown key or section", cure)
                self.faulty.add(key)  # what it holds is missing elsewhere
        raw = {key: self.document[key] for key in _HEAD if key in self.document}
        head = self._validated(_Head, raw, ())
        if head is not None and head.coordinates:
            return head
        if head is not None:
            self._report(
                ("coordinates",), "there are no coordinates", 'list them, such as coordinates = ["x1"]'
            )
        self.faulty.add("coordinates")
        names = raw.get("coordinates")
        usable = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
        return _Head(coordinates=usable)

    def _entries(self, section: str) -> Iterator[tuple[str, Any]]:
        table = self.document.get(section, {})
        if isinstance(table, dict):
            yield from table.items()
            return
        self.faulty.add(section)
        example = f"[{section}] and below it name = {_EXAMPLES.get(section, _BETWEEN)}"
        what = "a list of tables" if isinstance(table, list) else _show(table)
        self._report((section,), f"{what} is no section", f"write {example}")

    def _entry(self, entry: type[AnyEntry], section: str, name: str, raw: object) -> AnyEntry | None:
        if isinstance(raw, dict):
            return self._validated(entry, raw, (section, name))
        example = _EXAMPLES.get(section, _BETWEEN)
        if isinstance(raw, int | float) and not isinstance(raw, bool) and section in SECTIONS:
            example = example.replace(" }", f", value = {_show(raw)} }}")
        cure = f"write {name} = {example}"
        if name in (*_HEAD, "free"):
            cure = f"{name} stands above the first [section]; or {cure}"
        self._report((section, name), f"{_show(raw)} is no table", cure)
        return None

    def _inputs(self, head: _Head) -> list[Input]:
        inputs = []
        for name, raw in self._entries("inputs"):
            entry = self._entry(_InputEntry, "inputs", name, raw)
            if entry is None:
                self.faulty.add(name)
                continue
            at = entry.at or {}
            known = entry.kind == "displacement" or self._points_known(
                ("inputs", name, "at"), at, head.coordinates, isinstance(raw.get("at"), dict), "coordinate"
            )
            if known:
                inputs.append(Input(name, entry.kind, at))
            else:
                self.faulty.add(name)
        return inputs

    def _free(self, head: _Head) -> tuple[Element, ...]:
        """Elements of free matrices: free = "MCK", or a table that says which entries may differ from 0."""
        raw = self.document.get("free", {})
        if (
            isinstance(raw, str)
            and raw
            and all(raw.count(letter) == 1 and letter in LETTERS for letter in raw)
        ):
            raw = dict.fromkeys(raw, "full")
        if not isinstance(raw, dict) or ("free" in self.document and not raw):
            self._report(("free",), f"{_show(raw)} names no matrices", f"write {_FREE}")
            self.faulty.add("free")
            return ()
        if raw and 0 < sum(x in head.angles for x in head.coordinates) < len(head.coordinates):
            cure = "describe this rig by its elements"
            self._report(("free",), "free matrices of displacements and angles together have no units", cure)
            self.faulty.add("free")
            return ()
        pairs: dict[Letter, Pairs] = {}
        for name, entries in raw.items():
            letter = next((known for known in LETTERS if known == name), None)
            if letter is None:
                self._report(("free", name), "no such matrix", "there are M, C and K")
            else:
                chosen = self._free_pairs(letter, entries, head.coordinates)
                if chosen is not None:
                    pairs[letter] = chosen
        if set(pairs) != set(raw):
            self.faulty.add("free")
        return free_elements(head.coordinates, pairs=pairs, letters="".join(pairs))

    def _free_pairs(self, letter: Letter, entries: object, coordinates: Sequence[str]) -> Pairs | None:
        """The off-diagonal entries of a free matrix; None where they are misnamed."""
        if entries == "full":
            return list(combinations(coordinates, 2))
        if entries == "diagonal":
            return []
        if not isinstance(entries, list):
            cure = 'write "full", "diagonal" or the pairs that are joined: [["x1", "x2"], ["x2", "x3"]]'
            self._report(("free", letter), f"{_show(entries)} says nothing of its entries", cure)
            return None
        pairs = []
        for k, pair in enumerate(entries):
            known = isinstance(pair, list) and len(pair) == 2 and all(one in coordinates for one in pair)
            if not known or pair[0] == pair[1]:
                text = ", ".join(map(str, pair)) if isinstance(pair, list) else _show(pair)
                cure = f"name two different coordinates: {listed(coordinates)}"
                self._report(("free", letter, k), f"{_one_line(text)[:60]}: no pair of coordinates", cure)
                return None
            pairs.append((pair[0], pair[1]))
        return pairs

    def _elements(self, head: _Head, inputs: Sequence[Input]) -> list[Element]:
        there = _Points(
            self._points(head, inputs),
            frozenset(one.name for one in inputs if one.kind == "force"),
            frozenset(head.angles),
        )
        elements = []
        for section in (key for key in self.document if key in SECTIONS):
            for name, raw in self._entries(section):
                entry = self._entry(_ElementEntry, section, name, raw)
                element = None if entry is None else self._element(section, name, entry, raw, there)
                if element is None:
                    self.faulty.add(name)
                else:
                    elements.append(element)
        names = self._names_of_elements()
        for element in elements:
            target = element.same_as
            if target is not None and target not in names:
                place = (_section_of(element), element.name, "same_as")
                cure = f"{_did_you_mean(target, names)}there are {listed(names)}"
                self._report(place, f"{_show(target)} is no element", cure)
                self.faulty.add(element.name)
        return elements

    def _points(self, head: _Head, inputs: Sequence[Input]) -> dict[str, None]:
        """All points there are, those of faulty inputs too: they exist, whatever is wrong with them."""
        moved = [one.name for one in inputs if one.kind == "displacement"]
        table = self.document.get("inputs")
        broken = [name for name in table if name in self.faulty] if isinstance(table, dict) else []
        return dict.fromkeys((*head.coordinates, *moved, *broken))

    def _names_of_elements(self) -> dict[str, None]:
        tables = (self.document.get(section) for section in SECTIONS)
        return {name: None for table in tables if isinstance(table, dict) for name in table}

    def _points_known(
        self,
        place: Place,
        at: Mapping[str, float],
        points: Collection[str],
        table: bool,
        called: str = "point",
    ) -> bool:
        good = True
        for point, factor in at.items():
            here = (*place, point) if table else place
            if point not in points and not (point == GROUND and called == "point"):
                if "coordinates" in self.faulty:
                    good = False  # the missing points may stand in what could not be read
                    continue
                others = (*points, GROUND) if called == "point" else tuple(points)
                self._report(
                    here,
                    f"{_show(point)} is no {called}",
                    f"{_did_you_mean(point, others)}there are {listed(others)}",
                )
                good = False
            elif factor == 0:
                self._report(here, f"the factor of {point} is 0", "give another one, or leave the point out")
                good = False
        return good

    def _element(
        self,
        section: str,
        name: str,
        entry: _ElementEntry,
        raw: Mapping[str, Any],
        there: _Points,
    ) -> Element | None:
        place = (section, name)
        along = self._attachment(section, place, entry, raw, there)
        factor = self._element_scale(place, entry, along or {}, there.angles)
        if along is None or factor is None:
            return None

        def si(number: float | None) -> float | None:
            return None if number is None else number * factor

        return Element(
            name,
            SECTIONS[section],
            along,
            si(entry.value),
            si(entry.sd),
            si(entry.guess),
            si(entry.min),
            si(entry.max),
            entry.same_as,
            entry.times,
        )

    def _attachment(
        self,
        section: str,
        place: Place,
        entry: _ElementEntry,
        raw: Mapping[str, Any],
        there: _Points,
    ) -> dict[str, float] | None:
        given = [key for key in ("at", "between", "along") if getattr(entry, key) is not None]
        if len(given) != 1:
            usual = 'at = "x1"' if section == "masses" else 'between = ["x1", "ground"]'
            if given:
                self._report(place, f"{' and '.join(given)} are both given", "keep the one that is right")
            else:
                self._report(place, "it is not said what it is attached to", f"add {usual}")
            return None
        key = given[0]
        if entry.between is not None:
            if section == "masses":
                first = next((point for point in entry.between if point != GROUND), "x1")
                cure = f"write at = {_quoted(first)}; an inertance between two points belongs into [inerters]"
                self._report((*place, key), "a mass has one place, not two", cure)
                return None
            if entry.between[0] == entry.between[1]:
                self._report(
                    (*place, key), f"both ends are at {entry.between[0]}", "name two different points"
                )
                return None
        along = _signed(entry.between) if entry.between is not None else dict(entry.at or entry.along or {})
        for point in along:
            if point in there.forces:
                cure = f"attach it to the coordinate that {point} acts at"
                self._report((*place, key), f"{point} is a force, not a point", cure)
                return None
        if not self._points_known((*place, key), along, there.points, isinstance(raw.get(key), dict)):
            return None
        attached = {point: factor for point, factor in along.items() if point != GROUND}
        if not attached:
            self._report(
                (*place, key), "it is attached to nothing but the ground", "attach it to a coordinate"
            )
            return None
        return attached

    def _element_scale(
        self, place: Place, entry: _ElementEntry, along: Mapping[str, float], angles: Collection[str]
    ) -> float | None:
        if entry.unit is None:
            return 1.0
        quantity = SECTIONS[str(place[0])].law.quantity
        try:
            return _scale_of_points(entry.unit, quantity, along, angles)
        except UsageError as error:
            if along:  # else it is not known whether an angle is meant
                self._report((*place, "unit"), error.problems[0].what, error.problems[0].cure)
            return None

    def _model_problems(self, head: _Head, inputs: Sequence[Input], elements: Sequence[Element]) -> None:
        whole = [element for element in elements if element.name not in self.faulty]
        found = network.problems(head.coordinates, inputs, whole, head.angles, complete=not self.faulty)
        for problem in found:
            place = self._place_of(problem.where)
            what = problem.what
            self._report(place, what, problem.cure)

    def _place_of(self, name: str | None) -> Place:
        """The last place in the file where `name`, of a coordinate, input or element, is given."""
        if name is None:
            return ()
        places: list[Place] = []
        coordinates = self.document.get("coordinates")
        if isinstance(coordinates, list):
            places += [("coordinates", i) for i, one in enumerate(coordinates) if one == name]
        for section in ("inputs", *SECTIONS):
            table = self.document.get(section)
            if isinstance(table, dict) and name in table:
                places.append((section, name))
        if not places:
            return (name,)
        return max(places, key=lambda place: self.lines.of(place) or 0)

    # Channels

    def _channels(
        self, head: _Head, inputs: Sequence[Input], elements: Sequence[Element]
    ) -> list[Channel] | None:
        if "channels" not in self.document:
            return None
        sights = _Sights(
            self._points(head, inputs),
            {one.name: one for one in inputs},
            {element.name: element for element in elements},
            frozenset(head.angles),
            frozenset(self.faulty),
        )
        channels = []
        for name, raw in self._entries("channels"):
            place = ("channels", name)
            if not name.isprintable() or name != name.strip() or not name:
                cure = "use the name of the column, without line breaks, tabs or spaces at its ends"
                self._report(place, f"{_show(name)} is no usable name", cure)
                continue
            entry = self._entry(_ChannelEntry, "channels", name, raw)
            if entry is not None:
                channel = self._channel(name, entry, raw, sights)
                channels += [] if channel is None else [channel]
        self._shared_gains(channels)
        return channels

    def _shared_gains(self, channels: Sequence[Channel]) -> None:
        """Whoever shares a gain shares an unknown one, of a channel that has it from nobody else."""
        by_name = {channel.name: channel for channel in channels}
        table = self.document["channels"]
        listed_names = table if isinstance(table, dict) else {}
        for channel in channels:
            owner = channel.same_gain_as
            place = ("channels", channel.name, "same_gain_as")
            if owner is None:
                continue
            if owner not in listed_names:
                others = [name for name in listed_names if name != channel.name]
                cure = f"{_did_you_mean(owner, others)}there are {listed(others)}" if others else "list it"
                self._report(place, f"{_show(owner)} is no channel", cure)
            elif owner == channel.name:
                self._report(place, "the channel shares its gain with itself", "name another one")
            elif owner in by_name and by_name[owner].gain is not None:
                self._report(place, f"the gain of {owner} is known", f'give {owner} gain = "unknown"')
            elif owner in by_name and by_name[owner].same_gain_as is not None:
                cure = f"name {by_name[owner].same_gain_as}"
                self._report(place, f"{owner} has its gain from another channel", cure)

    def _channel(
        self, name: str, entry: _ChannelEntry, raw: Mapping[str, Any], sights: _Sights
    ) -> Channel | None:
        place = ("channels", name)
        table = isinstance(raw["of"], dict)
        of = {point: factor for point, factor in entry.of.items() if point != GROUND}
        good = self._channel_numbers(place, entry)
        for point, factor in of.items():
            here = (*place, "of", point) if table else (*place, "of")
            if point not in sights.names:
                if not self.faulty & {"coordinates", *_TABLES}:
                    cure = f"{_did_you_mean(point, sights.names)}there are {listed(sights.names)}"
                    self._report(here, f"{_show(point)} is no point, input or element", cure)
                good = False
            elif factor == 0:
                self._report(here, f"the factor of {point} is 0", "give another one, or leave the point out")
                good = False
        if not of:
            self._report((*place, "of"), "the ground does not move", "name what the channel measures")
            good = False
        if not good or self.faulty & of.keys():
            return None
        quantity = Quantity(entry.quantity) if entry.quantity is not None else sights.usual_quantity(of)
        fault = sights.fault(of, quantity)
        if fault is not None:
            self._report((*place, "of"), *fault)
            return None
        return self._calibrated(name, entry, of, quantity, sights)

    def _channel_numbers(self, place: Place, entry: _ChannelEntry) -> bool:
        wrong: list[tuple[str, str, str]] = []
        if entry.same_gain_as is not None and "gain" in entry.model_fields_set and entry.gain is not None:
            wrong.append(
                ("same_gain_as", "the gain is given as well", 'write gain = "unknown", or leave it out')
            )
        if entry.gain == 0:
            wrong.append(("gain", "a gain of 0 measures nothing", 'give another one, or "unknown"'))
        if entry.sign is not None and entry.sign not in (1.0, -1.0):
            wrong.append(
                (
                    "sign",
                    f"the sign is {entry.sign:g}",
                    'write 1, -1 or "unknown"; a factor belongs into gain',
                )
            )
        for key in ("noise", "relative_noise"):
            if getattr(entry, key) < 0:
                wrong.append((key, f"a standard deviation of {getattr(entry, key):g}", "give 0 or more"))
        if entry.rate is not None and entry.rate <= 0:
            wrong.append(
                ("rate", f"a rate of {entry.rate:g} Hz", "give a positive number of samples per second")
            )
        for key, what, cure in wrong:
            self._report((*place, key), what, cure)
        return not wrong

    def _calibrated(
        self, name: str, entry: _ChannelEntry, of: Mapping[str, float], quantity: Quantity, sights: _Sights
    ) -> Channel | None:
        place = ("channels", name)
        key = "unit"
        try:
            arms, angles = sights.arms(of, quantity), sights.angles
            unit = entry.unit if entry.unit is not None else si_unit(quantity.value, _all_in(arms, angles))
            # A voltage with a stated gain is in V per SI unit; with the default gain of 1 nobody has calibrated it.
            gain = None if entry.same_gain_as is not None else entry.gain
            electrical = gain is None or "gain" in entry.model_fields_set
            factor = _scale_of_points(unit, quantity.value, arms, angles, electrical)
            key = "gain"
            if isinstance(gain, str):
                gain = sensitivity(gain, unit, quantity.value, _all_in(arms, angles))
        except UsageError as error:
            self._report((*place, key), error.problems[0].what, error.problems[0].cure)
            return None
        return Channel(
            name,
            of,
            quantity,
            unit,
            factor,
            gain,
            entry.delay,
            entry.sign,
            entry.noise,
            entry.relative_noise,
            entry.rate,
            entry.same_gain_as,
        )


_BETWEEN = '{ between = ["x1", "ground"] }'


@dataclass(frozen=True)
class _Points:
    """What elements can be attached to, what they cannot although it is named, and which of the points are angles."""

    points: Collection[str]
    forces: frozenset[str]
    angles: frozenset[str]


@dataclass(frozen=True)
class _Sights:
    """What channels can look at, and whether a look makes sense."""

    points: Collection[str]
    inputs: Mapping[str, Input]
    elements: Mapping[str, Element]
    angles: frozenset[str]
    faulty: frozenset[str]

    @cached_property
    def names(self) -> dict[str, None]:
        """Points, force inputs and elements, faulty ones too."""
        return dict.fromkeys((*self.points, *self.inputs, *self.elements, *sorted(self.faulty)))

    def usual_quantity(self, of: Mapping[str, float]) -> Quantity:
        """Force for force inputs and elements, which do nothing else; displacement for points."""
        moving = any(point in self.points for point in of)
        return Quantity.DISPLACEMENT if moving else Quantity.FORCE

    def fault(self, of: Mapping[str, float], quantity: Quantity) -> tuple[str, str] | None:
        """What is wrong with measuring `quantity` of `of`, and the cure."""
        motionless = [name for name in of if name not in self.points]
        if quantity != Quantity.FORCE:
            if motionless:
                kind = "an element" if motionless[0] in self.elements else "a force"
                return (
                    f"{motionless[0]} is {kind}: it has no {quantity}",
                    'say quantity = "force", or name points',
                )
            return None
        elements = [name for name in of if name in self.elements]
        if len(elements) == len(of):
            return None
        if len(of) > 1:
            return "a force of several things", "name one input, or elements only"
        (name,) = of
        if name in self.points and name not in self.inputs:
            cure = f"name an input or elements: {listed((*self.inputs, *self.elements))}"
            return f"{name} is a coordinate: no force is measured there", cure
        return None

    def arms(self, of: Mapping[str, float], quantity: Quantity) -> Mapping[str, float]:
        """Points and factors that decide between m and rad, N and N·m.  Raises UsageError where forces differ in it."""
        first = next(iter(of))
        if quantity != Quantity.FORCE or first in self.points:
            return of
        if first in self.elements:
            if len({_all_in(self.elements[name].along, self.angles) for name in of}) > 1:
                raise UsageError("forces and torques cannot be added", cure="name elements of one kind")
            return self.elements[first].along
        return self.inputs[first].at


def _signed(pair: Sequence[str]) -> dict[str, float]:
    return {pair[0]: 1.0, pair[1]: -1.0}


def _all_in(points: Iterable[str], angles: Collection[str]) -> bool:
    points = list(points)
    return bool(points) and all(point in angles for point in points)


def _scale_of_points(
    unit: str, quantity: str, along: Mapping[str, float], angles: Collection[str], electrical: bool = False
) -> float:
    """Factor of `unit` to SI for what is stretched along some points.  Raises UsageError.

    Angles alone count in rad, N·m … unless a factor other than ±1, an arm in m, may make a length of them; an angle
    beside a displacement always has an arm.
    """
    if not _all_in(along, angles):
        return scale(unit, quantity, False, electrical)
    try:
        return scale(unit, quantity, True, electrical)
    except UsageError:
        if all(abs(factor) == 1 for factor in along.values()):
            raise
        try:
            return scale(unit, quantity, False, electrical)
        except UsageError:
            pass
        raise


def _section_of(element: Element) -> str:
    return next(section for section, kind in SECTIONS.items() if kind == element.kind)


def _dotted(place: Sequence[str | int]) -> str:
    """springs.k1.between[0]; keys that are not bare are quoted."""
    text = ""
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + _key(part)
    return text


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    names = {name.lower(): name for name in known}
    word = word.lower()[:60]
    close = [name for name in names if len(word) >= 3 and name.startswith(word)]
    close = close or difflib.get_close_matches(word, list(names), n=1, cutoff=0.6)
    return f"did you mean {_show(names[close[0]])}? " if close else ""


def _explained(error: Any, entry: type[_Entry]) -> tuple[str, str | None]:
    """Cause and cure of one of pydantic's errors."""
    if error["type"] == "rig":
        return error["ctx"]["what"], error["ctx"]["cure"]
    key = str(error["loc"][-1])
    if error["type"] == "extra_forbidden":
        known = tuple(entry.model_fields)
        return "unknown key", f"{_did_you_mean(key, known)}there are {listed(known)}"
    if error["type"] == "missing":
        return "missing", f"add {_MISSING.get(key, key)}"
    return _one_line(str(error["msg"])), None


_MISSING = {"coordinates": 'coordinates = ["x1"]', "of": 'of = "x1"'}


# Writing


def write_rig(rig: Rig) -> str:
    """A rig file, TOML, that reads back to the same model and channels; parameters are in SI units.

    Elements are grouped by kind, in the order in which the kinds first appear.  Raises ModelError for a channel
    whose scale is not that of its unit, which a rig file cannot say.
    """
    model = rig.model
    out = [f"name = {_quoted(model.name)}"] if model.name else []
    out.append(f"coordinates = {_list(model.coordinates)}")
    if model.angles:
        out.append(f"angles = {_list(sorted(model.angles))}")
    if model.inputs:
        out += [
            "",
            "[inputs]",
            *(f"{_key(one.name)} = {_inline(_input_fields(one))}" for one in model.inputs),
        ]
    if free := free_entries(model):
        whole = list(combinations(model.coordinates, 2))
        out += ["", "[free]", *(f"{letter} = {_pairs_text(pairs, whole)}" for letter, pairs in free.items())]
    for kind in dict.fromkeys(element.kind for element in model.elements if not element.free):
        section = next(name for name, one in SECTIONS.items() if one == kind)
        members = [element for element in model.elements if element.kind == kind and not element.free]
        out += [
            "",
            f"[{section}]",
            *(f"{_key(one.name)} = {_inline(_element_fields(one))}" for one in members),
        ]
    out += ["", "[channels]"]
    out += [f"{_key(one.name)} = {_inline(_channel_fields(one, model))}" for one in rig.channels]
    return "\n".join(out) + "\n"


def _pairs_text(pairs: Sequence[tuple[str, str]], whole: Sequence[tuple[str, str]]) -> str:
    if len(pairs) in (0, len(whole)):
        return _quoted("full" if pairs else "diagonal")
    return "[" + ", ".join(map(_list, pairs)) + "]"


def _input_fields(one: Input) -> dict[str, str]:
    fields = {"kind": _quoted(one.kind)}
    if one.at:
        fields["at"] = _points_text(one.at)
    return fields


def _element_fields(element: Element) -> dict[str, str]:
    factors = element.along
    match list(factors.items()):
        case [(point, 1.0)] if element.kind == Kind.MASS:
            fields = {"at": _quoted(point)}
        case [(point, 1.0)]:
            fields = {"between": _list([point, GROUND])}
        case [(first, 1.0), (second, -1.0)] if element.kind != Kind.MASS:
            fields = {"between": _list([first, second])}
        case _:
            fields = {
                "along": _inline({_key(point): repr(float(factor)) for point, factor in factors.items()})
            }
    numbers = {
        "value": element.value, "sd": element.sd, "guess": element.guess, "min": element.lower, "max": element.upper,
    }  # fmt: skip
    fields |= {key: repr(float(number)) for key, number in numbers.items() if number is not None}
    if element.same_as is not None:
        fields["same_as"] = _quoted(element.same_as)
        if element.times != 1.0:
            fields["times"] = repr(float(element.times))
    return fields


def _channel_fields(channel: Channel, model: Model) -> dict[str, str]:
    fields = {"of": _points_text(channel.of), "quantity": _quoted(channel.quantity.value)}
    if channel.unit:
        fields["unit"] = _quoted(channel.unit)
    elif channel.scale != 1.0:
        what = f"the channel {channel.name} has a scale of {channel.scale:g} and no unit"
        raise ModelError(what, cure="give it the unit that has this scale")
    calibration = {"gain": channel.gain, "delay": channel.delay, "sign": channel.sign}
    usual = {"gain": 1.0, "delay": 0.0, "sign": 1.0}
    for key, number in calibration.items():
        # The gain of a voltage is stated even where it is 1: else the channel would count as not calibrated.
        stated = number != usual[key] or (key == "gain" and _is_electrical(channel))
        if stated:
            fields[key] = '"unknown"' if number is None else repr(float(number))
    for key, number in (("noise", channel.noise), ("relative_noise", channel.relative_noise)):
        if number != 0:
            fields[key] = repr(float(number))
    if channel.rate is not None:
        fields["rate"] = repr(float(channel.rate))
    if channel.same_gain_as is not None:
        fields["same_gain_as"] = _quoted(channel.same_gain_as)
    return fields


def _is_electrical(channel: Channel) -> bool:
    for angular in (False, True):
        try:
            scale(channel.unit, channel.quantity.value, angular)
        except UsageError:
            continue
        return False
    return True


def _points_text(points: Mapping[str, float]) -> str:
    match list(points.items()):
        case [(point, 1.0)]:
            return _quoted(point)
    return _inline({_key(point): repr(float(factor)) for point, factor in points.items()})


def _inline(fields: Mapping[str, str]) -> str:
    return "{ " + ", ".join(f"{key} = {value}" for key, value in fields.items()) + " }"


def _list(texts: Iterable[str]) -> str:
    return "[" + ", ".join(map(_quoted, texts)) + "]"
