"""Study files: TOML that says which rigs, tests, noises and methods to compare by Monte Carlo.

    study = read_study("study.toml")

    name = "How much noise"                     draws = 1000       seed = 1       methods = ["iv", "oiv"]
    [rigs.paper]                                file = "rig.toml"  values = { m1 = 3.0, c1 = "30 N·s/m" }
    [frequencies]                               few = [1, 2, 5]    range = "0.5:25/40"
    [unknowns]                                  two = ["m1", "c1"]
    [[grid]]                                    noise = ["1 %", 0.1]  samples = [56]

Whatever is wrong with a file is a UsageError with all its problems, each at `study.toml:8: grid[0].noise`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, create_model

from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.registry import METHODS
from dashpot.io.toml_document import (
    Entry,
    GivenAmount,
    Place,
    Report,
    Text,
    TomlDocument,
    Wanted,
    number,
    one_of,
    read_toml,
    share,
    validated,
    wrong,
)
from dashpot.io.words import choose_from, did_you_mean, listed, written
from dashpot.model.rigfile import read_rig
from dashpot.quantities import Amount, frequencies
from dashpot.study.scenario import ALL, AUTO, NoiseKind, ScenarioGrid, Study, TrueRig, points
from dashpot.study.simulate import NoiseBasis
from dashpot.units import factor_between, scale

NO_EXPERIMENT = "none"  # the rig as it is in none of its experiments

_WANTED = Wanted("study file", "describe a study, starting with [rigs.NAME]")


def read_study(path: str | os.PathLike[str]) -> Study:
    """The study in the TOML file `path`; rig files are looked for next to it.

    Raises UsageError with every problem found, each at file:line and key, DataError if the path is a device.
    """
    document = read_toml(path, UsageError, _WANTED)
    if "coordinates" in document.table:
        cure = "write a study that names it: file = … in [rigs.NAME]"
        raise UsageError("this is a rig file, not a study", document.path, cure)
    return _Reading(document).study()


# What the tables of a study file hold.


def _whole(least: int, most: int, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise wrong(f"{written(value)} is not a whole number", f"write a whole number from {least} on")
    if not least <= value <= most:
        cure = f"write a whole number from {least} to {most:g}"
        raise wrong(f"{written(value)} is out of range", cure)
    return value


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise wrong(f"{written(value)} is neither true nor false", "write true or false, without quotes")
    return value


def _positive(value: object) -> float:
    given = number(value)
    if given <= 0:
        raise wrong(f"{given:g} is not positive", "write a number above 0")
    return given


def _level(value: object) -> float:
    level = share(value)
    if level < 0:
        raise wrong(f"a noise of {level:g}", "write a positive level, such as 0.1")
    return level


def _some(value: object) -> list[Any]:
    """A list without repetitions; a single value stands for a list of one."""
    items = value if isinstance(value, list) else [value]
    if not items:
        raise wrong("the list is empty", "give at least one entry")
    for k, item in enumerate(items):
        if item in items[:k]:
            raise wrong(f"{written(item)} appears twice in the list", "remove one of them")
    return items


def _single(value: object) -> object:
    if isinstance(value, list) and len(value) > 1:
        raise wrong("more than one kind of noise", "write a grid for each")
    return value[0] if isinstance(value, list) and value else value


def _lines(value: object) -> list[Any]:
    """A list, or a text in the syntax of the command line, such as "1:10:0.5"."""
    if isinstance(value, list):
        return _some(value)
    if not isinstance(value, str):
        cure = 'write a list [1, 2, 5], a range "0.5:25/40", or { from = 0.5, to = 25, count = 40 }'
        raise wrong("these are not frequencies", cure)
    try:
        return list(frequencies(value))
    except UsageError as error:
        raise wrong(error.problems[0].what, error.problems[0].cure) from None


Some = BeforeValidator(_some)
Positive = Annotated[float, BeforeValidator(_positive)]
Draws = Annotated[int, BeforeValidator(partial(_whole, 2, 10**9))]
Samples = Annotated[list[Annotated[int, BeforeValidator(partial(_whole, 2, 10**7))]], Some]  # of a dwell
Names = Annotated[list[Text], Some]
Tables = dict[str, Any]


class HeadEntry(Entry):
    name: Text | None = None
    seed: Annotated[int, BeforeValidator(partial(_whole, 0, 2**63))] = 0
    draws: Draws | None = None
    methods: Names | None = None
    periods: Positive = 1.0
    drift: Annotated[int, BeforeValidator(partial(_whole, 0, 5))] | None = None
    amplitudes: Any = None
    rigs: Any = None
    frequencies: Any = None
    unknowns: Any = None
    grid: Any = None
    transients: Annotated[bool, BeforeValidator(_flag)] = False


class RigEntry(Entry):
    examples: ClassVar = {"file": 'file = "rig.toml"'}

    file: Text
    experiment: Text | None = None
    values: dict[str, GivenAmount] = Field(default_factory=dict)


class NamedLines(Entry):
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[list[Positive], BeforeValidator(_lines)]] = Field(init=False)


class NamedSets(Entry):
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Names] = Field(init=False)


class NamedAmounts(Entry):
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, GivenAmount] = Field(init=False)


_SWEEP: Any = {
    "from": (Positive, ...),
    "to": (Positive, ...),
    "count": (Annotated[int, BeforeValidator(partial(_whole, 2, 10**6))], ...),
    "spacing": (Annotated[str, one_of("linear", "logarithmic")], "linear"),
}
Sweep: Any = create_model("Sweep", __base__=Entry, **_SWEEP)  # a field of a class cannot be called "from"


class GridEntry(Entry):
    rigs: Names | None = None
    unknowns: Names = Field(default=[ALL])
    frequencies: Names | None = None
    noise: Annotated[list[Annotated[float, BeforeValidator(_level)]], Some] | None = None
    kind: Annotated[NoiseKind, one_of(*get_args(NoiseKind)), BeforeValidator(_single)] = "relative"
    reference: Text | None = None
    samples: Samples | None = None
    samples_in_all: Samples | None = None
    covariance: Annotated[list[Annotated[NoiseBasis, one_of(*get_args(NoiseBasis))]], Some] = Field(
        default=["given"]
    )
    methods: Names | None = None
    draws: Draws | None = None


class _Reading:
    """The tables of one study file and the problems met in them.  What cannot be read is told, and left out."""

    def __init__(self, document: TomlDocument) -> None:
        self.document, self.path = document.table, document.path
        self.report = Report(document, UsageError)

    def study(self) -> Study:
        """The study.  Raises UsageError with every problem found."""
        head = validated(HeadEntry, self.document, (), self.report) or HeadEntry()
        name = Path(self.path).stem if head.name is None else head.name
        if not name.isprintable():
            what = f"{written(name)} is not a usable name"
            self.report.add(("name",), what, "use one line of plain text")
        rigs, lines = self._rigs(), self._frequencies()
        unknowns, amplitudes = self._unknowns(rigs), self._amplitudes(rigs)
        grids = self._grids(head)
        self.report.raise_any()
        how = (amplitudes, head.periods, head.drift, head.transients)
        study = Study(name, head.seed, rigs, lines, tuple(grids), unknowns, *how)
        for k, grid in enumerate(study.grids):
            try:
                list(points(study, grid))
            except DashpotError as error:
                for problem in error.problems:
                    self.report.add(("grid", k), problem.what, problem.cure)
        self.report.raise_any()
        return study

    def _known(
        self, place: Place, names: Iterable[str], known: Collection[str], what: str
    ) -> tuple[str, ...]:
        """Names, reported where they are not known; `what` they are, for messages."""
        for name in names:
            if known and name not in known:  # that there are none has been told
                cure = choose_from(known, name)
                self.report.add(place, f"{written(name)} is not a {what}", cure)
        return tuple(names)

    def _table(self, key: str) -> Tables:
        """A table of the document, whose names can be shown; empty where it is missing or none."""
        raw = self.document.get(key, {})
        if not isinstance(raw, dict):
            self.report.add((key,), "this is not a table", f"write [{key}] and below it name = …")
            return {}
        for name in raw:
            if not name.isprintable():
                cure = "use a name without line breaks, tabs and what steers a terminal"
                self.report.add((key, name), f"{written(name)} is not a usable name", cure)
        return raw

    def _entries(self, entry: type[Entry], key: str, raw: Tables) -> Tables:
        """A table whose entries are all of one kind."""
        read = validated(entry, raw, (key,), self.report)
        return {} if read is None else dict(read.model_extra or {})

    # The tables that grids refer to.

    def _rigs(self) -> dict[str, TrueRig]:
        """The rigs with their true values; rig files are looked for next to the study file."""
        each = {name: self._rig(name, raw) for name, raw in self._table("rigs").items()}
        rigs = {name: rig for name, rig in each.items() if rig is not None}
        if not rigs and not len(self.report):
            self.report.add(("rigs",), "there is no rig", 'add [rigs.NAME] with file = "rig.toml"')
        return rigs

    def _rig(self, name: str, raw: object) -> TrueRig | None:
        place = ("rigs", name)
        table = {"file": raw} if isinstance(raw, str) else raw
        if not isinstance(table, dict) or not isinstance(table.get("values", {}), dict):
            cure = f'write [rigs.{name}] and below it file = "rig.toml" and values = {{ m1 = 3.0 }}'
            self.report.add(place, "this is not a table", cure)
            return None
        entry = validated(RigEntry, table, place, self.report)
        if entry is None:
            return None
        try:
            rig = read_rig(Path(self.path).parent / entry.file)
        except DashpotError as error:
            self.report.include((*place, "file"), error.problems)
            return None
        if rig.experiments:
            named = [NO_EXPERIMENT, *rig.model.experiments]
            if entry.experiment not in named:
                cure = f'say experiment = "…" next to file: {listed(named)}'
                what = "the rig differs by experiment; a study simulates one rig"
                self.report.add((*place, "experiment"), what, cure)
                return None
            rig = rig.in_experiment(None if entry.experiment == NO_EXPERIMENT else entry.experiment)
        units = {e.name: rig.model.unit(e) for e in rig.model.elements if e.same_as is None}
        truth = {}
        for key, given in entry.values.items():
            at = (*place, "values", key)
            if key in units:
                truth[key] = self._in_si(at, given, partial(factor_between, wanted=units[key]))
            else:
                cure = f"{did_you_mean(key, units)}it has {listed(units)}"
                self.report.add(at, "the rig has no such parameter of its own", cure)
        for unknown in rig.model.unknowns:
            if unknown.name not in entry.values and unknown.prior is None and unknown.guess is None:
                cure = f"add values = {{ {unknown.name} = … }}, in {unknown.unit}"
                self.report.add(place, f"the true value of {unknown.name} is not given", cure)
        return TrueRig(rig.model, truth, rig.channels)

    def _in_si(self, place: Place, given: float | Amount, scale_of: Callable[[str], float]) -> float:
        """A number, in SI units, or an amount in its unit, whose factor `scale_of` gives or raises UsageError."""
        if not isinstance(given, Amount):
            return given
        try:
            return given.number if given.unit is None else given.number * scale_of(given.unit)
        except UsageError as error:
            self.report.add(place, error.problems[0].what, error.problems[0].cure)
            return 1.0

    def _frequencies(self) -> dict[str, tuple[float, ...]]:
        """Sets of frequencies by name, Hz."""
        table = self._table("frequencies")
        plain = {name: raw for name, raw in table.items() if not isinstance(raw, dict)}
        sets = {name: tuple(lines) for name, lines in self._entries(NamedLines, "frequencies", plain).items()}
        for name, raw in table.items():
            if name in plain or (sweep := validated(Sweep, raw, ("frequencies", name), self.report)) is None:
                continue
            low, high = getattr(sweep, "from"), sweep.to
            if low >= high:
                what = f"from {low:g} is not below to {high:g}"
                self.report.add(("frequencies", name), what, "exchange or change them")
                continue
            step = np.geomspace if sweep.spacing == "logarithmic" else np.linspace
            sets[name] = tuple(step(low, high, sweep.count).tolist())
        if not sets and not len(self.report):
            cure = "add [frequencies] with name = [1, 2, 5]"
            self.report.add(("frequencies",), "there are no frequencies", cure)
        return sets

    def _unknowns(self, rigs: Mapping[str, TrueRig]) -> dict[str, tuple[str, ...]]:
        """Sets of parameters that are to be found, by name."""
        parameters = {e.name for rig in rigs.values() for e in rig.model.elements if e.same_as is None}
        table = self._table("unknowns")
        if ALL in table:
            what = "the name all is taken: it is the rig as it is"
            self.report.add(("unknowns", ALL), what, "use another")
        return {
            name: self._known(("unknowns", name), names, parameters, "parameter of the rigs")
            for name, names in self._entries(NamedSets, "unknowns", table).items()
        }

    def _amplitudes(self, rigs: Mapping[str, TrueRig]) -> dict[str, complex]:
        """Amplitudes of the inputs, SI units."""
        inputs = {source.name: (rig, source) for rig in rigs.values() for source in rig.model.inputs}
        amplitudes: dict[str, complex] = {}
        table = self._table("amplitudes")
        for name, given in self._entries(NamedAmounts, "amplitudes", table).items():
            if name in inputs:
                rig, source = inputs[name]
                force = source.kind == "force"
                # Whether it is an angle or a torque
                angular = all(point in rig.model.angles for point in (source.at if force else (name,)))
                kind = "force" if force else "displacement"
                scale_of = partial(scale, quantity=kind, angular=angular)
                amplitudes[name] = self._in_si(("amplitudes", name), given, scale_of)
            elif rigs:
                cure = choose_from(sorted(inputs))
                self.report.add(("amplitudes", name), "no rig has this input", cure)
        for rig_name, rig in rigs.items():
            missing = [source.name for source in rig.model.inputs if source.name not in table]
            if len(rig.model.nonlinear) and missing:
                what = f"the response of {rig_name} depends on the drive level: it has nonlinear elements"
                self.report.add(("amplitudes",), what, f"give the amplitude of {listed(missing)}")
        return amplitudes

    # Grids.

    def _grids(self, head: HeadEntry) -> list[ScenarioGrid]:
        """The grids, without the faulty ones."""
        raw = self.document.get("grid", [])
        entries = raw if isinstance(raw, list) else [raw]
        if not entries:
            self.report.add(
                ("grid",), "there is no grid", "add [[grid]] with noise = [0.1] and samples = [56]"
            )
        grids = []
        for k, table in enumerate(entries):
            if not isinstance(table, dict):
                self.report.add(("grid",), "a grid is not a table", "write [[grid]] and its keys below")
            elif (entry := validated(GridEntry, table, ("grid", k), self.report)) is not None:
                grids.append(self._grid(("grid", k), entry, head))
        return grids

    def _grid(self, place: Place, entry: GridEntry, head: HeadEntry) -> ScenarioGrid:
        """A grid, to be used where nothing was told of it."""
        if entry.noise is None and entry.kind != "channels":
            self.report.add(place, "the noise is not given", "add noise = [0.01, 0.1]")
        if entry.samples is not None and entry.samples_in_all is not None:
            what = "samples and samples_in_all are both given"
            self.report.add(place, what, "keep the one that is meant")
        elif entry.samples is None and entry.samples_in_all is None:
            what = "the number of samples is not given"
            self.report.add(place, what, "add samples = [56], per frequency")
        if entry.kind == "constant" and entry.reference is None:
            cure = "add reference = …, the frequencies at whose rms amplitude the noise is taken"
            self.report.add(place, "constant noise needs a reference amplitude", cure)
        draws = head.draws if entry.draws is None else entry.draws
        if draws is None and "draws" not in self.document:
            self.report.add(place, "the number of draws is not given", "add draws = 1000")
        # Names of entries that are faulty too: they exist, whatever is wrong with them
        tables = {key: self.document.get(key) for key in ("rigs", "frequencies", "unknowns")}
        there = {key: list(raw) if isinstance(raw, dict) else [] for key, raw in tables.items()}
        rigs, lines = there["rigs"], there["frequencies"]
        if entry.reference is not None:
            self._known((*place, "reference"), [entry.reference], lines, "set of frequencies")
        own = entry.methods is not None
        methods = entry.methods or head.methods or [AUTO]
        sets = [ALL, *there["unknowns"]]
        return ScenarioGrid(
            rigs=self._known((*place, "rigs"), entry.rigs or rigs, rigs, "rig"),
            frequencies=self._known(
                (*place, "frequencies"), entry.frequencies or lines, lines, "set of frequencies"
            ),
            noise=(1.0,) if entry.noise is None else tuple(entry.noise),
            samples=tuple(entry.samples or entry.samples_in_all or ()),
            methods=self._known(
                (*place, "methods") if own else ("methods",), methods, (AUTO, *METHODS), "method"
            ),
            draws=draws or 0,
            unknowns=self._known((*place, "unknowns"), entry.unknowns, sets, "set of unknowns"),
            kind=entry.kind,
            reference=entry.reference,
            in_all=entry.samples_in_all is not None,
            covariance=tuple(entry.covariance),
        )
