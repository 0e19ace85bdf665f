"""Values of a study file: each is read, or what is wrong with it is told at its key."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from dashpot.errors import UsageError
from dashpot.io.toml_document import Place, Report, TomlDocument
from dashpot.io.words import did_you_mean, listed, written
from dashpot.quantities import amount, share


class StudyValues:
    """The tables of one study file and the problems met in them.  What cannot be read is told and given a stand-in."""

    def __init__(self, document: TomlDocument) -> None:
        self.document = document.table
        self.path = document.path
        self.report = Report(document, UsageError)

    def keys(self, place: Place, table: Mapping[str, Any], known: Sequence[str]) -> None:
        """Reports the keys that are not known."""
        for key in table:
            if key not in known:
                cure = f"{did_you_mean(key, known)}there are {listed(known)}"
                self.report.add((*place, key), "unknown key", cure)

    def table(self, key: str) -> dict[str, Any]:
        """A table of the document, whose names can be shown; empty where it is missing or none."""
        raw = self.document.get(key, {})
        if isinstance(raw, dict):
            for name in raw:
                if not name.isprintable():
                    cure = "use a name without line breaks, tabs and what steers a terminal"
                    self.report.add((key, name), f"{written(name)} is not a usable name", cure)
            return raw
        self.report.add((key,), "this is not a table", f"write [{key}] and below it name = …")
        return {}

    def names_in(self, key: str) -> list[str]:
        """Names in a table, of entries that are faulty too: they exist, whatever is wrong with them."""
        raw = self.document.get(key)
        return list(raw) if isinstance(raw, dict) else []

    def text(self, place: Place, raw: object) -> str:
        """A text."""
        if isinstance(raw, str):
            return raw
        self.report.add(place, f"{written(raw)} is not text", "write it in quotes")
        return ""

    def flag(self, place: Place, raw: object) -> bool:
        """true or false."""
        if isinstance(raw, bool):
            return raw
        self.report.add(
            place, f"{written(raw)} is neither true nor false", "write true or false, without quotes"
        )
        return False

    def number(self, place: Place, raw: object, *, positive: bool = False) -> float:
        """A finite number."""
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            self.report.add(place, f"{written(raw)} is not a number", "write a number, without quotes")
            return 1.0
        number = float(raw) if abs(raw) < 1e300 else math.inf
        if not math.isfinite(number):
            self.report.add(place, f"{written(raw)} is not finite", "write a finite number")
        elif positive and number <= 0:
            self.report.add(place, f"{number:g} is not positive", "write a number above 0")
        else:
            return number
        return 1.0

    def quantity(self, place: Place, raw: object, scale_of: Callable[[str], float]) -> float:
        """A number, in SI units, or a text with its unit; `scale_of` gives a unit's factor or raises UsageError."""
        if not isinstance(raw, str):
            return self.number(place, raw)
        try:
            given = amount(raw)
            if given.unit is not None:
                return given.number * scale_of(given.unit)
        except UsageError as error:
            self.report.add(place, error.problems[0].what, error.problems[0].cure)
            return 1.0
        return self.number(place, raw)

    def share(self, place: Place, raw: object) -> float:
        """A number, or a text in per cent."""
        if not (isinstance(raw, str) and raw.strip().endswith("%")):
            return self.number(place, raw)
        try:
            return share(raw)
        except UsageError as error:
            self.report.add(place, error.problems[0].what, error.problems[0].cure)
            return 1.0

    def whole(self, place: Place, raw: object, least: int, most: int) -> int:
        """A whole number from `least` to `most`."""
        if isinstance(raw, bool) or not isinstance(raw, int):
            what = f"{written(raw)} is not a whole number"
            self.report.add(place, what, f"write a whole number from {least} on")
        elif not least <= raw <= most:
            what = f"{written(raw)} is out of range"
            self.report.add(place, what, f"write a whole number from {least} to {most:g}")
        else:
            return raw
        return least

    def entries(self, place: Place, raw: object) -> list[Any]:
        """A list without repetitions; a single value stands for a list of one."""
        items = raw if isinstance(raw, list) else [raw]
        if not items:
            self.report.add(place, "the list is empty", "give at least one entry")
        seen: set[object] = set()
        for item in items:
            if isinstance(item, str | int | float):
                if item in seen:
                    self.report.add(place, f"{written(item)} appears twice in the list", "remove one of them")
                    return list(dict.fromkeys(i for i in items if isinstance(i, str | int | float)))
                seen.add(item)
        return items

    def names(self, place: Place, raw: object, known: Collection[str], what: str) -> tuple[str, ...]:
        """Names of known things, each once; `what` they are, for messages."""
        if not known:
            return ()  # that there are none has been told
        names = []
        for item in self.entries(place, raw):
            if not isinstance(item, str):
                self.report.add(place, f"{written(item)} is not a name", "write names in quotes")
            elif item not in known:
                cure = f"{did_you_mean(item, known)}there are {listed(known)}"
                self.report.add(place, f"{written(item)} is not a {what}", cure)
            else:
                names.append(item)
        return tuple(names)
