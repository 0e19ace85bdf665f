"""What a rig file may hold, and one rig file while it is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, TypeGuard, get_args

from pydantic import BeforeValidator, Field

from dashpot.channel import Quantity
from dashpot.errors import DashpotError, ModelError, UsageError
from dashpot.io.toml_document import (
    DIGITS,
    AnyEntry,
    Entry,
    GivenAmount,
    Names,
    Number,
    Place,
    Report,
    Share,
    Text,
    TomlDocument,
    given_amount,
    number,
    one_of,
    or_unknown,
    share,
    texts,
    validated,
    wrong,
)
from dashpot.io.words import choose_from, did_you_mean, listed, quoted, written
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Distribution, Input, number_problems
from dashpot.model.rigfile.rig import ShakerLimits, limit_is_angular
from dashpot.quantities import Amount
from dashpot.units import scale

GROUND = "ground"
SECTIONS: Mapping[str, Kind] = {kind.section: kind for kind in Kind}
HEAD_KEYS = ("name", "coordinates", "angles")
EXPERIMENTS = "experiments"
SUBSTRUCTURES = "substructures"
TABLES = ("inputs", "free", SUBSTRUCTURES, "blocks", *SECTIONS, "calibrations", "channels", EXPERIMENTS)
VERDICT, SHAKER, NOISE = "verdict", "shaker", "noise"

FREE_EXAMPLE = 'free = "MCK", or [free] and below it K = "full", M = "diagonal"'
EXAMPLES: Mapping[str, str] = {
    "inputs": '{ kind = "displacement" }',
    "masses": '{ at = "x1" }',
    SUBSTRUCTURES: '{ coordinates = "w1:w400", joined = { w1 = "x1" } }',
    "blocks": '{ matrix = "K", file = "K1.mtx" }',
    "calibrations": '{ value = 1, sd = "1 %" }',
    "channels": '{ of = "x1", unit = "mm" }',
    EXPERIMENTS: '{ data = "run2*.csv" }',
} | {section: '{ between = ["x1", "ground"] }' for section in SECTIONS if section != "masses"}

# The fields of elements and constants by the keys that give them.
NUMBERS = {"value": "value", "sd": "sd", "guess": "guess", "min": "lower", "max": "upper"}


def _coordinates(value: object) -> list[str]:
    """A list of names, or a range of them: "q1:q1200"."""
    ends = re.fullmatch(r"([^\d:]*)(\d{1,9}):([^\d:]*)(\d{1,9})", value) if isinstance(value, str) else None
    if ends is None:
        return texts(value)
    first, last, most = int(ends[2]), int(ends[4]), 1_000_000
    if ends[1] != ends[3] or not first <= last < first + most:
        cure = f"write a range such as {quoted('q1:q1200')} of at most {most:,} names, or list them"
        raise wrong(f"{written(value)} is not a range of names", cure)
    return [f"{ends[1]}{k}" for k in range(first, last + 1)]


def _pair(value: object) -> list[str]:
    names = texts(value)
    if len(names) != 2:
        raise wrong(
            f"{len(names)} point{'' if len(names) == 1 else 's'} instead of two",
            'write two points, such as ["x1", "ground"]; a lever with more takes along = { x1 = 0.6, x2 = 0.4 }',
        )
    return names


def _one_or_table(value: object) -> dict[str, Any]:
    if isinstance(value, str):
        return {value: 1.0}
    if isinstance(value, list):
        raise wrong(
            "a list has no factors", "name one point, or write a table of factors { x1 = 1, x2 = -1 }"
        )
    if not isinstance(value, dict):
        raise wrong(
            f"{written(value)} is not a point", 'name one, such as "x1", or a table { x1 = 1, x2 = -1 }'
        )
    if not value:
        raise wrong("the table names no point", "name one, such as { x1 = 1 }")
    return value


def _one_or_many(value: object) -> dict[str, Any]:
    if not isinstance(value, list):
        return _one_or_table(value)
    if not value:
        raise wrong("the list is empty", 'name a coordinate, such as "x1"')
    if not all(isinstance(name, str) for name in value):
        raise wrong("the list holds more than names", 'list names, such as ["x1", "x2"]')
    if len(set(value)) < len(value):
        raise wrong("a name appears twice in the list", "write a table of factors, such as { x1 = 2 }")
    return dict.fromkeys(value, 1.0)


def _table(value: object) -> dict[str, Any]:
    if isinstance(value, dict):
        return _one_or_table(value)
    raise wrong(
        f"{written(value)} is not a table", "write a table of factors, such as { x1 = 0.6, x2 = 0.4 }"
    )


def _part(value: object) -> float:
    given = share(value)
    if not 0 < given < 1:
        raise wrong(f"{written(value)} is out of range", "give a share between 0 and 1, such as 0.02 or 2 %")
    return given


def _sensitivity_or_number(value: object) -> float | str:
    """A number, or a sensitivity such as "100 mV/g", which needs the channel's quantity."""
    if isinstance(value, str) and re.match(rf"\s*{DIGITS}\s*[A-Za-zµμ]", value):
        return value
    return number(value)


OnePointOrTable = Annotated[dict[str, GivenAmount], BeforeValidator(_one_or_table)]


class RigFileEntry(Entry):
    also_called: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "at": ("of",),
        "of": ("at", "between"),
        "point": ("at", "of"),
        "points": ("between",),
        "nodes": ("between",),
        "type": ("quantity", "kind"),
        "kind": ("quantity",),
        "units": ("unit",),
        "sensitivity": ("gain",),
        "mass": ("value",),
        "stiffness": ("value",),
        "damping": ("value",),
        "start": ("guess",),
        "initial": ("guess",),
        "lower": ("min",),
        "upper": ("max",),
        "std": ("sd", "noise"),
        "sigma": ("sd", "noise"),
    }
    examples: ClassVar[Mapping[str, str]] = {
        "coordinates": 'coordinates = ["x1"]',
        "of": 'of = "x1"',
        "matrix": 'matrix = "K"',
        "file": 'file = "K1.mtx"',
    }


class Head(RigFileEntry):
    name: Text = ""
    coordinates: Annotated[list[Text], BeforeValidator(_coordinates)]
    angles: Names = Field(default_factory=list)


class VerdictEntry(RigFileEntry):
    within: Annotated[float, BeforeValidator(_part)]


class NoiseEntry(RigFileEntry):
    distribution: Annotated[Distribution, one_of(*get_args(Distribution))] = "normal"


class ShakerEntry(RigFileEntry):
    stroke: GivenAmount | None = None
    velocity: GivenAmount | None = None
    acceleration: GivenAmount | None = None
    force: GivenAmount | None = None


class InputEntry(RigFileEntry):
    kind: Annotated[Literal["displacement", "force"], one_of("displacement", "force")] = "displacement"
    at: Annotated[dict[str, GivenAmount], BeforeValidator(_one_or_many)] | None = None


class ElementEntry(RigFileEntry):
    at: OnePointOrTable | None = None
    between: Annotated[list[Text], BeforeValidator(_pair)] | None = None
    along: Annotated[dict[str, GivenAmount], BeforeValidator(_table)] | None = None
    value: GivenAmount | None = None
    sd: GivenAmount | None = None
    guess: GivenAmount | None = None
    min: GivenAmount | None = None
    max: GivenAmount | None = None
    unit: Text | None = None
    same_as: Text | None = None
    times: Share = 1.0
    law: Text | None = None


class SubstructureEntry(RigFileEntry):
    coordinates: Annotated[list[Text], BeforeValidator(_coordinates)]
    joined: dict[str, Text] = Field(default_factory=dict)


class BlockEntry(RigFileEntry):
    matrix: Annotated[Literal["M", "C", "K", "H"], one_of("M", "C", "K", "H")]
    file: Text
    of: Text | None = None
    array: Text | None = None
    coordinates: Names | None = None
    value: Number | None = None
    sd: Number | None = None
    guess: Number | None = None
    min: Number | None = None
    max: Number | None = None


class ConstantEntry(RigFileEntry):
    value: GivenAmount | None = None
    sd: GivenAmount | None = None
    guess: GivenAmount | None = None
    min: GivenAmount | None = None
    max: GivenAmount | None = None


class ChannelEntry(RigFileEntry):
    of: OnePointOrTable
    quantity: Annotated[str, one_of(*Quantity)] | None = None
    unit: Text | None = None
    gain: Annotated[float | str | None, or_unknown(_sensitivity_or_number)] = 1.0
    delay: Annotated[float | Amount | None, or_unknown(given_amount)] = 0.0
    sign: Annotated[float | None, or_unknown(number)] = 1.0
    noise: GivenAmount = 0.0
    relative_noise: Share = 0.0
    rate: GivenAmount | None = None
    same_gain_as: Text | None = None
    full_scale: GivenAmount | None = None
    bits: Number | None = None


class RigReading:
    """A document, the report of its problems, the names of what could not be read whole, and what has been read.

    points       coordinates and moved points, faulty ones too: they exist, whatever is wrong with them
    attachable   these and the ground
    inputs, elements   by name
    substructures      by name, the point of each row of its matrices
    calibrations       those that channels share: by name, whether they are a gain or a delay

    What is wrong is reported, and reading goes on with a stand-in, so that all problems are told at once: an entry is
    sound where there are no more `problems` than before it.
    """

    def __init__(self, document: TomlDocument) -> None:
        self.document = document
        self.table = document.table
        self.report = Report(document, ModelError)
        self.faulty: set[str] = set()
        self._untold = 0
        self.head = self._head()
        self.substructures = self._substructures()
        self.angles = frozenset(self.head.angles)
        self.points: dict[str, None] = dict.fromkeys(self.head.coordinates)
        self.attachable: dict[str, None] = {}
        self.inputs: dict[str, Input] = {}
        self.calibrations: dict[str, str] = {}
        self.elements: dict[str, Element] = {}

    @property
    def problems(self) -> int:
        """How many there are so far, those included that follow from others and are not told."""
        return len(self.report) + self._untold

    def include(self, place: Place, error: DashpotError) -> None:
        """Report what another part of the house says is wrong, at this place."""
        for problem in error.problems:
            self.report.add(place, problem.what, problem.cure)

    def _head(self) -> Head:
        """Name, coordinates and angles; what is usable of the coordinates where they are faulty."""
        known = (*HEAD_KEYS, *TABLES, VERDICT, SHAKER, NOISE)
        for key in self.table:
            if key not in known:
                cure = f"{did_you_mean(key, known)}a rig file has {listed(known)}"
                self.report.add((key,), "unknown key or section", cure)
                self.faulty.add(key)  # what it holds is missing elsewhere
        raw = {key: self.table[key] for key in HEAD_KEYS if key in self.table}
        others = self.table.get(SUBSTRUCTURES)
        head = validated(Head, ({"coordinates": []} if others else {}) | raw, (), self.report)
        if head is not None and (head.coordinates or others or self.table.get("inputs")):
            return head
        if head is not None:
            cure = 'list them, such as coordinates = ["x1"]'
            self.report.add(("coordinates",), "there are no coordinates", cure)
        self.faulty.add("coordinates")
        names = raw.get("coordinates")
        usable = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
        return Head(coordinates=usable)

    def _substructures(self) -> dict[str, list[str]]:
        """The points of each substructure's rows; those that are joined to no other are coordinates of the rig."""
        own: dict[str, list[str]] = {}
        joined: dict[str, str] = {}
        seen = dict.fromkeys(self.head.coordinates)
        for name, raw in self.entries(SUBSTRUCTURES):
            entry = self.entry(SubstructureEntry, SUBSTRUCTURES, name, raw)
            if entry is None:
                self.faulty |= {name, "coordinates"}
                continue
            place = (SUBSTRUCTURES, name)
            for point in entry.coordinates:
                if point in seen:
                    cure = f"give it another name, and join both: joined = {{ {point}_{name} = {quoted(point)} }}"
                    self.report.add((*place, "coordinates"), f"{written(point)} exists already", cure)
                    self.faulty |= {name, "coordinates"}
                seen[point] = None
            self.require_points(
                (*place, "joined"), dict.fromkeys(entry.joined, 1.0), entry.coordinates, "row"
            )
            own[name] = entry.coordinates
            joined |= entry.joined
        for point in joined:
            end, steps = point, 0
            while end in joined and steps <= len(joined):
                end, steps = joined[end], steps + 1
            if end in joined:
                cure = "let one of the points stay a coordinate"
                self.report.add((SUBSTRUCTURES,), f"{written(point)} is joined to itself", cure)
                return own
            joined[point] = end
        more = [point for rows in own.values() for point in rows if point not in joined]
        self.head = self.head.model_copy(update={"coordinates": [*self.head.coordinates, *more]})
        return {name: [joined.get(point, point) for point in rows] for name, rows in own.items()}

    def _settings(self, name: str, of: type[AnyEntry], example: str) -> AnyEntry | None:
        """A section of settings; None if there is none."""
        raw = self.table.get(name, {})
        if not isinstance(raw, dict):
            self.report.add(
                (name,), f"{written(raw)} is not a section", f"write [{name}] and below it {example}"
            )
            return None
        return validated(of, raw, (name,), self.report) if raw else None

    def within(self) -> float | None:
        """The share of the motion in [verdict]; None if there is none."""
        verdict = self._settings(VERDICT, VerdictEntry, 'within = "2 %"')
        return None if verdict is None else verdict.within

    def distribution(self) -> Distribution:
        """That of the noise, in [noise]."""
        noise = self._settings(NOISE, NoiseEntry, 'distribution = "auto"')
        return "normal" if noise is None else noise.distribution

    def shaker(self) -> ShakerLimits | None:
        """The limits of [shaker]; None if there are none."""
        entry, limits = self._settings(SHAKER, ShakerEntry, 'stroke = "5 mm"'), dict[str, Any]()
        if entry is None:
            return None
        moved = [name for name, each in self.inputs.items() if each.kind == "displacement"]
        forced = [p for each in self.inputs.values() if each.kind == "force" for p in each.at]
        for key, value in entry:
            if value is None:
                continue
            quantity = "displacement" if key == "stroke" else key
            try:
                turning = limit_is_angular(quantity, moved, forced, self.angles)
                size = value.si(quantity, turning) if isinstance(value, Amount) else float(value)
                one: dict[str, Any] = {key: size}
                limits |= ShakerLimits(**one).given
            except UsageError as error:
                self.include((SHAKER, key), error)
        return ShakerLimits(**limits) if limits and not self.faulty else None

    def entries(self, section: str) -> Iterator[tuple[str, Any]]:
        """Names and tables of a section; a section that is not a table is reported."""
        table = self.table.get(section, {})
        if isinstance(table, dict):
            yield from table.items()
            return
        self.faulty.add(section)
        names = [name for name in table if isinstance(name, str)] if isinstance(table, list) else []
        name = names[0] if names and section in ("inputs", "channels") else "name"
        tables = isinstance(table, list) and table and all(isinstance(entry, dict) for entry in table)
        what = "a list of tables" if tables else written(table)
        cure = f"write [{section}] and below it {name} = {EXAMPLES[section]}"
        self.report.add((section,), f"{what} is not a section", cure)

    def entry(
        self, entry: type[AnyEntry], section: str, name: str, raw: object, place: Place | None = None
    ) -> AnyEntry | None:
        """One entry of a section; None, and its problems reported, where it cannot be read."""
        place = (section, name) if place is None else place
        if isinstance(raw, dict):
            return validated(entry, raw, place, self.report)
        cure = f"write {name} = {_example(section, raw)}"
        if name in (*HEAD_KEYS, "free"):
            cure = f"{name} stands above the first [section]; or {cure}"
        self.report.add(place, f"{written(raw)} is not a table", cure)
        return None

    def require_points(
        self,
        place: Place,
        factors: Mapping[str, float],
        points: Collection[str],
        called: str = "point",
        unless: Collection[str] = ("coordinates",),
    ) -> None:
        """Report the points of a combination that do not exist or have no factor.

        Nothing is said of a point that may stand in what could not be read, the places `unless`.
        """
        raw: Any = self.table
        for key in place:
            raw = raw.get(key) if isinstance(raw, dict) else None
        for point, factor in factors.items():
            at = (*place, point) if isinstance(raw, dict) else place
            if point not in points and self.faulty & set(unless):
                self._untold += 1
            elif point not in points:
                cure = choose_from(points, point)
                self.report.add(at, f"{written(point)} is not a {called}", cure)
            elif factor == 0:
                cure = "give another one, or leave the point out"
                self.report.add(at, f"the factor of {point} is 0", cure)

    def in_si(
        self, place: Place, given: float | Amount, plain: float, scale_of: Callable[[str], float]
    ) -> float:
        """An amount in SI units: a number times `plain`, else by its own unit, whose factor `scale_of` gives.

        Where it raises UsageError, for a unit of something else, that is reported.
        """
        if not isinstance(given, Amount):
            return given * plain
        try:
            return given.number * (plain if given.unit is None else scale_of(given.unit))
        except UsageError as error:
            self.include(place, error)
            return given.number

    def factors(self, place: Place, given: Mapping[str, float | Amount]) -> dict[str, float]:
        """Factors of points: numbers, shares in per cent, and lengths for the arms of angles."""
        found = {}
        for point, factor in given.items():
            scale_of = partial(_scale_of_factor, point=point, turns=point in self.angles)
            found[point] = self.in_si((*place, point), factor, 1.0, scale_of)
        return found

    def numbers(
        self,
        place: Place,
        entry: ElementEntry | ConstantEntry,
        plain: float,
        scale_of: Callable[[str], float],
    ) -> dict[str, Any]:
        """The NUMBERS of an entry, where given, in SI units, by the names of their fields."""
        found: dict[str, float] = {}
        for key, field in NUMBERS.items():
            given = getattr(entry, key)
            if is_share(given):
                found[field] = self._share_of_value((*place, key), given, found.get("value"))
            elif given is not None:
                found[field] = self.in_si((*place, key), given, plain, scale_of)
        return found

    def stated(
        self, place: Place, entry: ConstantEntry, scale_of: Callable[[str], float], plain: float = 1.0
    ) -> dict[str, float]:
        """The NUMBERS of what may be unknown, as `numbers`; reported if they contradict each other."""
        found = self.numbers(place, entry, plain, scale_of)
        numbers = {key: found[field] for key, field in NUMBERS.items() if field in found}
        for problem in number_problems(str(place[-1]), numbers):
            self.report.add(place, problem.what, problem.cure)
        return found

    def constant_entry(self, place: Place, raw: object, otherwise: str) -> ConstantEntry | None:
        """What is said of a number that may be unknown: an amount, "unknown", or a table.

        None, and reported, if it cannot be read; what is none of these is `otherwise`.
        """
        if raw == "unknown":
            return ConstantEntry()
        if isinstance(raw, str | int | float) and not isinstance(raw, bool):
            raw = {"value": raw}
        if isinstance(raw, dict):
            return validated(ConstantEntry, raw, place, self.report)
        name = place[-1]
        cure = f'write a number, {name} = "unknown", or {name} = {{ guess = 0.1 }}'
        self.report.add(place, otherwise, cure)
        return None

    def _share_of_value(self, place: Place, share: Amount, value: float | None) -> float:
        """An sd in per cent of the value."""
        if place[-1] != "sd":
            cure = "only an sd may be one, of the value; write a unit"
            self.report.add(place, f"{share} is a share", cure)
        elif value is None:
            self.report.add(
                place, f"an sd of {share} without a value", "give the value that it is a share of"
            )
        return abs(value or 0.0) * share.number / 100


def _example(section: str, raw: object) -> str:
    """How an entry of the section is written, of the points or the number that stand there where that is all."""
    points = raw if isinstance(raw, list) else [raw]
    if all(isinstance(point, str) for point in points):
        if len(points) == 1 and section in ("masses", "channels"):
            return f"{{ {'of' if section == 'channels' else 'at'} = {written(points[0])} }}"
        if len(points) == 2 and section in SECTIONS and section != "masses":
            return f"{{ between = [{', '.join(map(written, points))}] }}"
    example = EXAMPLES[section]
    if isinstance(raw, int | float) and not isinstance(raw, bool) and section in SECTIONS:
        return example.replace(" }", f", value = {written(raw)} }}")
    return example


def _scale_of_factor(unit: str, point: str, turns: bool) -> float:
    if unit == "%":
        return 0.01
    if turns:
        return scale(unit, "displacement")
    raise UsageError(
        f"{point} is not an angle, so its factor has no unit", cure="write a number or a share, such as 60 %"
    )


def number_of(given: float | Amount) -> float:
    """The number of an amount, whatever its unit."""
    return given.number if isinstance(given, Amount) else given


def is_share(given: float | Amount | None) -> TypeGuard[Amount]:
    """Whether an amount is written in per cent."""
    return isinstance(given, Amount) and given.unit == "%"
