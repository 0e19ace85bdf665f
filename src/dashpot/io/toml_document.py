"""TOML files whose keys know their lines, and a report of all that is wrong with one.

document = read_toml("rig.toml", ModelError, Wanted("rig file", "describe a rig"))
report = Report(document, ModelError)
report.add(("springs", "k1", "value"), "the value is negative", "give 0 or more")
report.raise_any()                     rig.toml:8: springs.k1.value: the value is negative; give 0 or more
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from dashpot.errors import DashpotError, Problem, UsageError
from dashpot.io.ledger import noted
from dashpot.io.words import choose_from, did_you_mean, quoted, shown, written
from dashpot.quantities import Amount, amount, within_range

# Where in a TOML text each key stands.
#
# tomllib gives values without places, and a message about springs.k1 must name its line. The text is
# scanned a second time, only for keys; what the scan does not understand ends it, and what it has found
# until then is kept.


Place = tuple[str | int, ...]

_TEXT = r'''"""(?:[^"\\]|\\.|"(?!""))*"{3,5}|\'\'\'(?:[^\']|\'(?!\'\'))*\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\''''
_TOKEN = re.compile(rf"[ \t\r]+|#[^\n]*|(?P<text>{_TEXT})|(?P<bare>[A-Za-z0-9_-]+)|(?P<mark>.)", re.DOTALL)


class Lines:
    """Lines (from 1) at which the keys of a TOML text are defined, by their paths; items of lists have numbers."""

    def __init__(self, text: str) -> None:
        starts, scan = [0, *(match.end() for match in re.finditer("\n", text))], _Scan(text)
        mentioned = {path: [at] for path, at in scan.mentioned.items() if path not in scan.defined}
        every = (scan.defined | mentioned).items()
        self._where = {path: [bisect_right(starts, at) for at in places] for path, places in every}

    def of(self, path: Sequence[str | int]) -> int | None:
        """Line of the last definition of `path`, or of the nearest table around it; None if there is none."""
        for length in range(len(path), 0, -1):
            lines = self._where.get(tuple(path[:length]))
            if lines is not None:
                return lines[-1]
        return None

    def twice(self) -> tuple[Place, int, int] | None:
        """The first key that is defined again, with the lines of its first and second definition."""
        again = [(lines[1], path, lines[0]) for path, lines in self._where.items() if len(lines) > 1]
        if not again:
            return None
        second, path, first = min(again, key=lambda entry: entry[0])
        return path, first, second


class _LostError(Exception):
    """The scan has met something that is not TOML."""


class _Scan:
    """Where keys are defined, each time, and where tables are first mentioned that only stand within other keys.

    As far as the text is TOML.
    """

    def __init__(self, text: str) -> None:
        found = (match for match in _TOKEN.finditer(text) if match.lastgroup is not None)
        self.tokens = [(match.lastgroup, match[0], match.start()) for match in found]
        self.at = 0
        self.defined: dict[Place, list[int]] = {}
        self.mentioned: dict[Place, int] = {}
        self._counts: dict[Place, int] = {}  # of the tables in arrays of tables
        prefix: Place = ()
        with suppress(_LostError, RecursionError):
            while True:
                self._pass_lines()
                if self._here is None:
                    return
                if self._here == "[":
                    prefix = self._header()
                else:
                    self._pair(prefix)
                if self._here not in (None, "\n"):
                    return

    @property
    def _here(self) -> str | None:
        """The text of the token that comes next; None at the end."""
        return self.tokens[self.at][1] if self.at < len(self.tokens) else None

    def _took(self, mark: str) -> bool:
        """Whether this comes next, and is passed."""
        there = self._here == mark
        self.at += there
        return there

    def _expect(self, mark: str) -> None:
        if not self._took(mark):
            raise _LostError

    def _pass_lines(self) -> None:
        while self._took("\n"):
            pass

    def _position(self) -> int:
        if self.at >= len(self.tokens):
            raise _LostError
        return self.tokens[self.at][2]

    def _header(self) -> Place:
        start = self._position()
        self._expect("[")
        double = self._took("[")
        *around, last = self._key()
        for _ in range(1 + double):
            self._expect("]")
        place: Place = ()
        for part in around:
            place = (*place, part)
            self.mentioned.setdefault(place, start)
            if place in self._counts:
                place = (*place, self._counts[place])
        place = (*place, last)
        if double:
            self._counts[place] = self._counts.get(place, -1) + 1
            self.mentioned.setdefault(place, start)
            place = (*place, self._counts[place])
        self.defined.setdefault(place, []).append(start)
        return place

    def _pair(self, prefix: Place) -> None:
        start, key = self._position(), self._key()
        self._expect("=")
        for length in range(1, len(key)):
            self.mentioned.setdefault((*prefix, *key[:length]), start)
        place = (*prefix, *key)
        self.defined.setdefault(place, []).append(start)
        self._value(place)

    def _key(self) -> tuple[str, ...]:
        parts: list[str] = []
        while True:
            self._position()
            kind, text, _ = self.tokens[self.at]
            self.at += 1
            if kind == "bare":
                parts.append(text)
            elif kind == "text" and "\n" not in text:
                try:
                    parts.append(str(tomllib.loads(f"key = {text}")["key"]))
                except tomllib.TOMLDecodeError:
                    parts.append(text[1:-1])
            else:
                raise _LostError
            if not self._took("."):
                return tuple(parts)

    def _value(self, place: Place) -> None:
        if self._took("["):
            item = 0
            self._pass_lines()
            while not self._took("]"):
                self.defined.setdefault((*place, item), []).append(self._position())
                self._value((*place, item))
                item += 1
                self._end_of_item("]")
        elif self._took("{"):
            self._pass_lines()  # later versions of TOML allow line breaks here
            while not self._took("}"):
                self._pair(place)
                self._end_of_item("}")
        else:  # a text, or all that is written of a number or a moment
            while self._here not in (None, "\n", ",", "]", "}"):
                self.at += 1

    def _end_of_item(self, close: str) -> None:
        """Behind an item comes a comma, or the end."""
        self._pass_lines()
        if self._took(","):
            self._pass_lines()
        elif self._here != close:
            raise _LostError


@dataclass(frozen=True)
class Wanted:
    """What a file should be, for messages: its kind ("rig file") and how it starts ("describe a rig, starting …")."""

    kind: str
    start: str


@dataclass(frozen=True)
class TomlDocument:
    """A TOML file: its table, its text and the path that messages name."""

    table: dict[str, Any]
    text: str
    path: str

    @cached_property
    def lines(self) -> Lines:
        """Where each key stands; only a file with problems is scanned for it."""
        return Lines(_unix(self.text))

    def line(self, place: Place) -> int:
        """The line of a key, or of the nearest table around it; 0 where there is none."""
        return self.lines.of(place) or 0

    def problem(self, place: Place, what: str, cure: str | None = None) -> Problem:
        """What is wrong at a key, placed at path:line: key."""
        line = self.line(place)
        file = f"{self.path}:{line}" if line else self.path
        return Problem(what, f"{file}: {dotted(place)}" if place else file, cure)


class Report:
    """Gathers the problems of a document, to be told all at once in the order of their lines."""

    def __init__(self, document: TomlDocument, error: type[DashpotError]) -> None:
        self.document = document
        self._error = error
        self._problems: list[tuple[int, Problem]] = []

    def __len__(self) -> int:
        return len(self._problems)

    def add(self, place: Place, what: str, cure: str | None = None) -> None:
        """Something is wrong at a key."""
        self._problems.append((self.document.line(place), self.document.problem(place, what, cure)))

    def include(self, place: Place, problems: Iterable[Problem]) -> None:
        """The problems of another file, which is named at this key."""
        line = self.document.line(place)
        self._problems += [(line, problem) for problem in problems]

    def raise_any(self) -> None:
        """Raises the document's kind of error with all problems, if there are any."""
        if self._problems:
            self._problems.sort(key=lambda entry: entry[0])
            raise self._error(dict.fromkeys(problem for _, problem in self._problems))


def read_toml(path: str | os.PathLike[str], error: type[DashpotError], wanted: Wanted) -> TomlDocument:
    """The document in a file.  Raises `error` where it cannot be read or is no TOML in UTF-8."""
    name = os.fspath(path)
    try:
        with open(noted(path), "rb") as file:
            raw = file.read()
    except FileNotFoundError:
        raise error("there is no such file", name, "check the name and the folder") from None
    except IsADirectoryError:
        raise error("this is a folder", name, f"name the {wanted.kind} in it") from None
    except (OSError, ValueError) as cause:
        reason = cause.strerror if isinstance(cause, OSError) and cause.strerror else str(cause)
        raise error(f"the file cannot be read: {reason}", name, "check its name and rights") from None
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise error("the file is UTF-16", name, "save it as UTF-8")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        line = raw.count(b"\n", 0, cause.start) + 1
        what = f"byte {raw[cause.start]:#04x} is not UTF-8"
        raise error(what, f"{name}:{line}", "save the file as UTF-8") from None
    return parse_toml(text, name, error, wanted)


_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*(?:{_PART}[ \t]*\.[ \t]*){{32}}", re.MULTILINE)


def parse_toml(text: str, path: str, error: type[DashpotError], wanted: Wanted) -> TomlDocument:
    """The document of a text; `path` is named in messages.  Raises `error` where it is no TOML."""
    if not text.strip():
        raise error("the file is empty", path, wanted.start)
    deep = _DEEP_KEY.search(text)
    if deep is not None:  # of such a key tomllib keeps every beginning
        line = text.count("\n", 0, deep.start()) + 1
        raise error("a key of more than 32 parts", f"{path}:{line}", f"a {wanted.kind} needs three levels")
    try:
        document = TomlDocument(tomllib.loads(text), text, path)
    except tomllib.TOMLDecodeError as cause:
        if "(at line 1," in str(cause) and not path.lower().endswith(".toml"):  # data, most likely
            raise error(f"this is not a {wanted.kind}", path, f"name the {wanted.kind} (TOML) here") from None
        raise error([_syntax_problem(str(cause), text, path)]) from None
    except RecursionError:
        cure = f"a {wanted.kind} needs three levels"
        raise error("lists or tables are nested too deep", path, cure) from None
    except ValueError:  # Python reads no integers of more than some thousand digits
        raise error("a number has too many digits", path, "write it as 1.5e10") from None
    report = Report(document, error)
    for place in _placeholders(document.table, ()):
        key = str(place[-1])
        cure = _PLACEHOLDER_CURES.get(key, "replace it with the actual value")
        report.add(place, f'"{PLACEHOLDER}" is a placeholder', cure)
    report.raise_any()
    return document


PLACEHOLDER = "?"  # for what somebody still has to write: `start` and `inspect` put it there
_PLACEHOLDER_CURES = {
    "of": 'name the point that the column measures, such as "x1"',
    "at": 'name the point where it acts, such as "x1"',
    "unit": 'write the unit of the numbers, such as "mm", "g" or "V"',
    "quantity": 'write "displacement", "velocity", "acceleration" or "force"',
    "gain": 'write the sensitivity of the sensor, such as "100 mV/g", or "unknown"',
    "rate_hz": "write the sampling rate in Hz, such as rate_hz = 1000",
}


def _placeholders(value: object, place: Place) -> Iterator[Place]:
    """Where PLACEHOLDER stands."""
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _placeholders(each, (*place, key))
    elif value == PLACEHOLDER and place != ("name",):  # a rig may be called so
        yield place


def dotted(place: Place) -> str:
    """springs.k1.between[0]; keys that are not bare are quoted."""
    text = ""
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += ("." if text else "") + toml_key(part)
    return text


def toml_key(name: str) -> str:
    """A key as TOML writes it: bare where it may be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else quoted(name)


def inline_texts(entries: Mapping[str, str]) -> str:
    """An inline table of texts: { u = "base, mm" }."""
    return f"{{ {', '.join(f'{toml_key(name)} = {quoted(text)}' for name, text in entries.items())} }}"


def _unix(text: str) -> str:
    return text.replace("\r\n", "\n")


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
    """tomllib's message as a problem: placed at its line, with a cure."""
    if re.match(r"Cannot (overwrite|declare|mutate)|Duplicate", message):
        again = Lines(_unix(text)).twice()
        if again is not None:
            place, first, second = again
            where = f"{path}:{second}: {dotted(place)}"
            return Problem(f"given twice, first in line {first}", where, "remove one of them")
    cure = next((cure for part, cure in _SYNTAX_CURES if part in message), "correct the TOML here")
    position = re.search(r" \(at line (\d+), column (\d+)\)$", message)
    if position is None:
        last = text.rstrip().count("\n") + 1
        cause = message.removesuffix(" (at end of document)")
        return Problem(f"{shown(cause, 200)}, at the end", f"{path}:{last}", cure)
    line = _unix(text).split("\n")[int(position[1]) - 1]
    rest = line[int(position[2]) - 1 :].strip()
    if rest.startswith("}"):
        cure = "remove the comma before }"
    elif "{" in line and "}" not in line and (not rest or rest.startswith("#")):
        cure = (
            "a table in { } stands on one line; a long one can be a [section.name] with a line for each key"
        )
    cause = shown(f"{message[: position.start()]}, at column {position[2]}", 200)
    return Problem(cause, f"{path}:{position[1]}", cure)


# Tables of TOML as checked entries: values that say what is wrong with them, and how to write them.
#
# class Spring(Entry):
#     value: GivenAmount | None = None
# entry = validated(Spring, raw, ("springs", "k1"), report)     None, and its problems reported, where it is none


class Entry(BaseModel):
    """One table.

    also_called  what people write for a key: the keys that may be meant
    examples     how a key is written that must not be missing
    wanted       what a key takes, where its validators do not say what is wrong
    """

    # Validators of a table are built when a file has one.
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)
    also_called: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    examples: ClassVar[Mapping[str, str]] = {}
    wanted: ClassVar[Mapping[str, str]] = {}


AnyEntry = TypeVar("AnyEntry", bound=Entry)


def validated(entry: type[AnyEntry], raw: dict[str, Any], place: Place, report: Report) -> AnyEntry | None:
    """The table `raw` as an entry; None, and its problems reported, where it is none."""
    try:
        return entry.model_validate(raw)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            where = detail["loc"]
            key, what, cure = str(where[-1]) if where else "", shown(str(detail["msg"]), 200), None
            if detail["type"] == "dashpot":
                what, cure = detail["ctx"]["what"], detail["ctx"]["cure"]
            elif detail["type"] == "extra_forbidden":
                known = tuple(entry.model_fields)
                meant = [name for name in entry.also_called.get(key.lower(), ()) if name in known]
                what, cure = "unknown key", choose_from(known, meant[0] if meant else key)
            elif detail["type"] == "missing":
                what, cure = "missing", f"add {entry.examples.get(key, key)}"
            elif where[0] in entry.wanted:
                where = where[:1]
                key, value = str(where[0]), raw[str(where[0])]
                text = (
                    shown(f"[{', '.join(map(written, value))}]")
                    if isinstance(value, list)
                    else written(value)
                )
                what, cure = f"{text} cannot be used", f"write {entry.wanted[key]}"
            report.add((*place, *where), what, cure)
        return None


def wrong(what: str, cure: str | None = None) -> PydanticCustomError:
    """What a validator raises."""
    return PydanticCustomError("dashpot", "{what}", {"what": what, "cure": cure})


def _wrong_as(error: UsageError) -> PydanticCustomError:
    return wrong(error.problems[0].what, error.problems[0].cure)


# Numbers, with a unit or without, shares and texts.

DIGITS = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def number(value: object) -> float:
    """A finite number of a usable magnitude."""
    if isinstance(value, str):
        text = value.strip()
        bare = re.fullmatch(rf"({DIGITS})\s*(\D.*)?", text)
        if re.fullmatch(r"-?\d+,\d+", text):
            cure = f"write {_plain(text.replace(',', '.'))}, with a point and without quotes"
        elif bare is not None:
            cure = f"write {_plain(bare[1])} without quotes" + (
                ": this number has no unit" if bare[2] is not None else ""
            )
        elif text.lower() in ("unknown", "?", ""):
            cure = "leave the key out where the value is unknown"
        else:
            cure = "write a number"
        raise wrong(f"{written(value)} is text", cure)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong(f"{written(value)} is not a number", "write a number")
    try:
        given = float(value)
    except OverflowError:
        raise wrong("the number is too large", "write a finite number") from None
    if not math.isfinite(given):
        raise wrong(f"{written(value)} is not finite", "write a finite number")
    try:
        return within_range(given, written(value))
    except UsageError as error:
        raise _wrong_as(error) from None


def _plain(digits: str) -> str:
    """A number as TOML takes it: .5 and 5. are not."""
    digits = re.sub(r"^(-?)\.", r"\g<1>0.", digits.removeprefix("+"))
    digits = re.sub(r"^(-?)0+(?=\d)", r"\1", digits)
    return re.sub(r"\.(?!\d)", ".0", digits)


def given_amount(value: object) -> float | Amount:
    """A number, or a text of a number and its unit."""
    if isinstance(value, str) and re.fullmatch(rf"\s*{DIGITS}\s*[^\s\d.,:].*", value):
        try:
            return amount(value)
        except UsageError as error:
            raise _wrong_as(error) from None
    return number(value)


def share(value: object) -> float:
    """A number, or a text in per cent."""
    given = given_amount(value)
    if not isinstance(given, Amount):
        return given
    if given.unit != "%":
        raise wrong(f"{written(value)} is not a share", "write a number or per cent, such as 0.05 or 5 %")
    return given.number / 100


def or_unknown(read: Callable[[object], Any]) -> BeforeValidator:
    """None for "unknown", else what `read` gives."""
    return BeforeValidator(
        lambda value: None if isinstance(value, str) and value.strip().lower() == "unknown" else read(value)
    )


def a_text(value: object) -> str:
    """A text."""
    if isinstance(value, str):
        return value
    cure = "write it in quotes" if isinstance(value, dict | list) else f'write "{written(value)}" in quotes'
    raise wrong(f"{written(value)} is not text", cure)


def texts(value: object) -> list[str]:
    """A list, of texts."""
    if isinstance(value, str):
        raise wrong(f"{written(value)} is text, not a list", f"write [{quoted(value[:40])}]")
    if not isinstance(value, list):
        raise wrong(f"{written(value)} is not a list", 'write a list of names, such as ["x1", "x2"]')
    return value


def one_of(*choices: str) -> BeforeValidator:
    """One of some words."""

    def chosen(value: object) -> str:
        if a_text(value) in choices:
            return str(value)
        guess = did_you_mean(str(value), choices)
        raise wrong(
            f"{written(value)} is not one of the choices", f"{guess}use {' or '.join(map(quoted, choices))}"
        )

    return BeforeValidator(chosen)


Number = Annotated[float, BeforeValidator(number)]
GivenAmount = Annotated[float | Amount, BeforeValidator(given_amount)]
Share = Annotated[float, BeforeValidator(share)]
Text = Annotated[str, BeforeValidator(a_text)]
Names = Annotated[list[Text], BeforeValidator(texts)]
