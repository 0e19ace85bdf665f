"""One rig file while it is read: its tables, the problems met so far, and what is missing because of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from dashpot.errors import ModelError
from dashpot.io.toml_document import Place, Report, TomlDocument
from dashpot.io.words import did_you_mean, listed, written
from dashpot.model.rigfile.schema import (
    EXAMPLES,
    GROUND,
    HEAD_KEYS,
    SECTIONS,
    TABLES,
    TWO_POINTS,
    AnyEntry,
    Head,
    explained,
)


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
        known = (*HEAD_KEYS, *TABLES)
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

    def validated(self, entry: type[AnyEntry], raw: dict[str, Any], place: Place) -> AnyEntry | None:
        """The table `raw` as an entry; None, and its problems reported, where it is none."""
        try:
            return entry.model_validate(raw)
        except ValidationError as error:
            for detail in error.errors(include_url=False):
                what, cure = explained(detail, entry)
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
