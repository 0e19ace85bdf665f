"""TOML files whose keys know their lines, and a report of all that is wrong with one.

document = read_toml("rig.toml", ModelError, Wanted("rig file", "describe a rig"))
report = Report(document, ModelError)
report.add(("springs", "k1", "value"), "the value is negative", "give 0 or more")
report.raise_any()                     rig.toml:8: springs.k1.value: the value is negative; give 0 or more
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from dashpot.errors import DashpotError, Problem
from dashpot.io.ledger import noted
from dashpot.io.toml_lines import Lines
from dashpot.io.words import quoted, shown

Place = tuple[str | int, ...]


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
    return parse_toml(_decoded(raw, name, error), name, error, wanted)


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
        return TomlDocument(tomllib.loads(text), text, path)
    except tomllib.TOMLDecodeError as cause:
        raise error([_syntax_problem(str(cause), text, path)]) from None
    except RecursionError:
        cure = f"a {wanted.kind} needs three levels"
        raise error("lists or tables are nested too deep", path, cure) from None
    except ValueError:  # Python reads no integers of more than some thousand digits
        raise error("a number has too many digits", path, "write it as 1.5e10") from None


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


def _decoded(raw: bytes, path: str, error: type[DashpotError]) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise error("the file is UTF-16", path, "save it as UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        line = raw.count(b"\n", 0, cause.start) + 1
        what = f"byte {raw[cause.start]:#04x} is not UTF-8"
        raise error(what, f"{path}:{line}", "save the file as UTF-8") from None


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
