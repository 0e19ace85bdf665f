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

import math
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.registry import METHODS
from dashpot.io.toml_document import Place, Report, TomlDocument, Wanted, parse_toml, read_toml
from dashpot.io.words import did_you_mean, joined, listed, written
from dashpot.model.rigfile import read_rig
from dashpot.quantities import amount, frequencies, share
from dashpot.study.scenario import ALL, AUTO, NoiseKind, ScenarioGrid, Study, TrueRig, points
from dashpot.study.simulate import NoiseBasis
from dashpot.units import factor_between, scale

HEAD = (
    *("name", "seed", "draws", "methods", "periods", "drift", "amplitudes"),
    *("rigs", "frequencies", "unknowns", "grid", "transients"),
)
GRID = (
    *("rigs", "unknowns", "frequencies", "noise", "kind", "reference"),
    *("samples", "samples_in_all", "covariance", "methods", "draws"),
)
MOST_LINES = 10**6
MOST_DRAWS = 10**9
MOST_SAMPLES = 10**7  # of a dwell
_WANTED = Wanted("study file", "describe a study, starting with [rigs.NAME]")
Value = TypeVar("Value")


def read_study(path: str | os.PathLike[str]) -> Study:
    """The study in the TOML file `path`; rig files are looked for beside it.

    Raises UsageError with every problem found, each at file:line and key, DataError where the path is a device.
    """
    return _Reading(read_toml(path, UsageError, _WANTED)).study()


def parse_study(text: str, path: str = "study.toml") -> Study:
    """The study described by a TOML text; `path` is named in messages, and rig files are looked for in its folder.

    Raises UsageError with every problem found, each at file:line and key.
    """
    return _Reading(parse_toml(text, path, UsageError, _WANTED)).study()


# Single values: each is read, or a UsageError says what is wrong with it.


def _text(raw: object) -> str:
    if not isinstance(raw, str):
        raise UsageError(f"{written(raw)} is not text", cure="write it in quotes")
    return raw


def _flag(raw: object) -> bool:
    if not isinstance(raw, bool):
        cure = "write true or false, without quotes"
        raise UsageError(f"{written(raw)} is neither true nor false", cure=cure)
    return raw


def _number(raw: object) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise UsageError(f"{written(raw)} is not a number", cure="write a number, without quotes")
    number = float(raw) if abs(raw) < 1e300 else math.inf
    if not math.isfinite(number):
        raise UsageError(f"{written(raw)} is not finite", cure="write a finite number")
    return number


def _positive(raw: object) -> float:
    number = _number(raw)
    if number <= 0:
        raise UsageError(f"{number:g} is not positive", cure="write a number above 0")
    return number


def _quantity(raw: object, scale_of: Callable[[str], float]) -> float:
    """A number, in SI units, or a text with its unit; `scale_of` gives a unit's factor or raises UsageError."""
    given = amount(raw) if isinstance(raw, str) else None
    if given is None or given.unit is None:
        return _number(raw)
    return given.number * scale_of(given.unit)


def _level(raw: object) -> float:
    """A number, or a text in per cent, from 0 on."""
    level = share(raw) if isinstance(raw, str) and raw.strip().endswith("%") else _number(raw)
    if level < 0:
        raise UsageError(f"a noise of {level:g}", cure="write a positive level, such as 0.1")
    return level


def _whole(raw: object, least: int, most: int) -> int:
    if isinstance(raw, bool) or not isinstance(raw, int):
        what = f"{written(raw)} is not a whole number"
        raise UsageError(what, cure=f"write a whole number from {least} on")
    if not least <= raw <= most:
        what = f"{written(raw)} is out of range"
        raise UsageError(what, cure=f"write a whole number from {least} to {most:g}")
    return raw


def _name(raw: object, known: Collection[str], what: str) -> str:
    """A name of something known; `what` that is, for messages."""
    if not isinstance(raw, str):
        raise UsageError(f"{written(raw)} is not a name", cure="write names in quotes")
    if raw not in known:
        cure = f"{did_you_mean(raw, known)}there are {listed(known)}"
        raise UsageError(f"{written(raw)} is not a {what}", cure=cure)
    return raw


class _Reading:
    """The tables of one study file and the problems met in them.  What cannot be read is told, and left out."""

    def __init__(self, document: TomlDocument) -> None:
        self.document, self.path = document.table, document.path
        self.report = Report(document, UsageError)

    def study(self) -> Study:
        """The study.  Raises UsageError with every problem found."""
        head = self.document
        self._keys((), head, HEAD)
        name = self._value(("name",), head.get("name", Path(self.path).stem), _text)
        if name is not None and not name.isprintable():
            what = f"{written(name)} is not a usable name"
            self.report.add(("name",), what, "use one line of plain text")
        seed = self._value(("seed",), head.get("seed", 0), partial(_whole, least=0, most=2**63))
        drift = partial(_whole, least=0, most=5)
        degree = self._value(("drift",), head["drift"], drift) if "drift" in head else None
        periods = self._value(("periods",), head.get("periods", 1.0), _positive)
        transients = self._value(("transients",), head.get("transients", False), _flag)
        rigs, lines = self._rigs(), self._frequencies()
        unknowns, amplitudes = self._unknowns(rigs), self._amplitudes(rigs)
        grids = self._grids()
        self.report.raise_any()
        study = Study(
            name, seed, rigs, lines, tuple(grids), unknowns, amplitudes, periods, degree, transients
        )
        for k, grid in enumerate(study.grids):
            try:
                list(points(study, grid))
            except DashpotError as error:
                for problem in error.problems:
                    self.report.add(("grid", k), problem.what, problem.cure)
        self.report.raise_any()
        return study

    def _value(self, place: Place, raw: object, read: Callable[[Any], Any]) -> Any:
        """A value as `read` gives it; None where it cannot be read, which is told."""
        try:
            return read(raw)
        except UsageError as error:
            for problem in error.problems:
                self.report.add(place, problem.what, problem.cure)
            return None

    def _each(self, place: Place, raw: object, read: Callable[[Any], Value]) -> tuple[Value, ...]:
        """The values of a list without repetitions; a single one stands for a list of one."""
        items = raw if isinstance(raw, list) else [raw]
        if not items:
            self.report.add(place, "the list is empty", "give at least one entry")
        plain = [item for item in items if isinstance(item, str | int | float)]
        if twice := [item for k, item in enumerate(plain) if item in plain[:k]]:
            self.report.add(place, f"{written(twice[0])} appears twice in the list", "remove one of them")
        values = (self._value(place, item, read) for item in items)
        return tuple(value for value in values if value is not None)

    def _names(self, place: Place, raw: object, known: Collection[str], what: str) -> tuple[str, ...]:
        """Names of known things; none where there are none, which has been told."""
        return self._each(place, raw, partial(_name, known=known, what=what)) if known else ()

    def _keys(self, place: Place, table: Mapping[str, Any], known: Collection[str]) -> None:
        for key in table:
            if key not in known:
                cure = f"{did_you_mean(key, known)}there are {listed(known)}"
                self.report.add((*place, key), "unknown key", cure)

    def _table(self, key: str) -> dict[str, Any]:
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

    # The tables that grids refer to.

    def _rigs(self) -> dict[str, TrueRig]:
        """The rigs with their true values; rig files are looked for beside the study file."""
        each = {name: self._rig(name, raw) for name, raw in self._table("rigs").items()}
        rigs = {name: rig for name, rig in each.items() if rig is not None}
        if not rigs and not len(self.report):
            self.report.add(("rigs",), "there is no rig", 'add [rigs.NAME] with file = "rig.toml"')
        return rigs

    def _rig(self, name: str, raw: object) -> TrueRig | None:
        place = ("rigs", name)
        table = {"file": raw} if isinstance(raw, str) else raw
        if not isinstance(table, dict):
            cure = f'write [rigs.{name}] and below it file = "rig.toml"'
            self.report.add(place, "this is not a table", cure)
            return None
        self._keys(place, table, ("file", "values"))
        if "file" not in table:
            self.report.add(place, "the rig file is not named", 'add file = "rig.toml"')
            return None
        given = table.get("values", {})
        if not isinstance(given, dict):
            self.report.add((*place, "values"), "this is not a table", "write values = { m1 = 3.0 }")
            given = {}
        file = self._value((*place, "file"), table["file"], _text)
        if not file:
            return None
        try:
            rig = read_rig(Path(self.path).parent / file)
        except DashpotError as error:
            self.report.include((*place, "file"), error.problems)
            return None
        units = {e.name: rig.model.unit(e) for e in rig.model.elements if e.same_as is None}
        truth: dict[str, float | None] = {}
        for key, value in given.items():
            if key in units:
                in_si = partial(_quantity, scale_of=partial(factor_between, wanted=units[key]))
                truth[key] = self._value((*place, "values", key), value, in_si)
            else:
                cure = f"{did_you_mean(key, units)}it has {listed(units)}"
                what = "the rig has no such parameter of its own"
                self.report.add((*place, "values", key), what, cure)
        for unknown in rig.model.unknowns:
            if unknown.name not in given and unknown.prior is None and unknown.guess is None:
                cure = f"add values = {{ {unknown.name} = … }}, in {unknown.unit}"
                self.report.add(place, f"the true value of {unknown.name} is not given", cure)
        return TrueRig(rig.model, {key: v for key, v in truth.items() if v is not None}, rig.channels)

    def _frequencies(self) -> dict[str, tuple[float, ...]]:
        """Sets of frequencies by name, Hz."""
        sets = {
            key: self._lines(("frequencies", key), raw) for key, raw in self._table("frequencies").items()
        }
        if not sets and not len(self.report):
            cure = "add [frequencies] with name = [1, 2, 5]"
            self.report.add(("frequencies",), "there are no frequencies", cure)
        return sets

    def _lines(self, place: Place, raw: object) -> tuple[float, ...]:
        if isinstance(raw, str):  # in the syntax of the command line, such as "1:10:0.5"
            return self._value(place, raw, frequencies) or ()
        if isinstance(raw, list):
            return self._each(place, raw, _positive)
        if not isinstance(raw, dict):
            cure = 'write a list [1, 2, 5], a range "0.5:25/40", or { from = 0.5, to = 25, count = 40 }'
            self.report.add(place, "these are not frequencies", cure)
            return ()
        self._keys(place, raw, ("from", "to", "count", "spacing"))
        if missing := [key for key in ("from", "to", "count") if key not in raw]:
            cure = "write { from = 0.5, to = 25, count = 40 }"
            self.report.add(place, f"{joined(missing)} missing", cure)
            return ()
        low, high = (self._value((*place, key), raw[key], _positive) for key in ("from", "to"))
        counted = partial(_whole, least=2, most=MOST_LINES)
        count = self._value((*place, "count"), raw["count"], counted)
        spacing = self._value((*place, "spacing"), raw.get("spacing", "linear"), _text)
        if spacing not in ("linear", "logarithmic", None):
            what = f"{written(spacing)} is not a spacing"
            self.report.add((*place, "spacing"), what, 'write "linear" or "logarithmic"')
        if low is None or high is None or count is None:
            return ()
        if low >= high:
            self.report.add(place, f"from {low:g} is not below to {high:g}", "exchange or change them")
            return ()
        step = np.geomspace if spacing == "logarithmic" else np.linspace
        return tuple(step(low, high, count).tolist())

    def _unknowns(self, rigs: Mapping[str, TrueRig]) -> dict[str, tuple[str, ...]]:
        """Sets of parameters that are to be found, by name."""
        parameters = {e.name for rig in rigs.values() for e in rig.model.elements if e.same_as is None}
        sets = self._table("unknowns")
        if ALL in sets:
            what = "the name all is taken: it is the rig as it is"
            self.report.add(("unknowns", ALL), what, "use another")
        what = "parameter of the rigs"
        return {name: self._names(("unknowns", name), raw, parameters, what) for name, raw in sets.items()}

    def _amplitudes(self, rigs: Mapping[str, TrueRig]) -> dict[str, complex]:
        """Amplitudes of the inputs, SI units."""
        inputs = {source.name: (rig, source) for rig in rigs.values() for source in rig.model.inputs}
        amplitudes: dict[str, complex] = {}
        for name, raw in self._table("amplitudes").items():
            place, read = ("amplitudes", name), _number
            if name in inputs:
                rig, source = inputs[name]
                quantity = "displacement" if source.kind == "displacement" else "force"
                # Whether it is an angle or a torque
                angular = all(
                    at in rig.model.angles for at in (source.at if quantity == "force" else (name,))
                )
                read = partial(_quantity, scale_of=partial(scale, quantity=quantity, angular=angular))
            elif rigs:
                self.report.add(place, "no rig has this input", f"there are {listed(sorted(inputs))}")
            size = self._value(place, raw, read)
            if size is not None:
                amplitudes[name] = size
        given = self._table("amplitudes")
        for rig_name, rig in rigs.items():
            missing = [source.name for source in rig.model.inputs if source.name not in given]
            if len(rig.model.nonlinear) and missing:
                what = f"the motion of {rig_name} depends on the size of its drive: it has nonlinear elements"
                self.report.add(("amplitudes",), what, f"give the amplitude of {listed(missing)}")
        return amplitudes

    # Grids.

    def _grids(self) -> list[ScenarioGrid]:
        """The grids, without the faulty ones."""
        raw = self.document.get("grid", [])
        entries = raw if isinstance(raw, list) else [raw]
        if not entries:
            self.report.add(
                ("grid",), "there is no grid", "add [[grid]] with noise = [0.1] and samples = [56]"
            )
        grids = []
        for k, entry in enumerate(entries):
            if isinstance(entry, dict):
                before = len(self.report)
                grid = self._grid(("grid", k), entry)
                grids += [grid] if len(self.report) == before else []
            else:
                self.report.add(("grid",), "a grid is not a table", "write [[grid]] and its keys below")
        return grids

    def _grid(self, place: Place, raw: Mapping[str, Any]) -> ScenarioGrid:
        """A grid, to be used where nothing was told of it."""
        self._keys(place, raw, GRID)
        # Names of entries that are faulty too: they exist, whatever is wrong with them
        tables = {key: self.document.get(key) for key in ("rigs", "frequencies", "unknowns")}
        known = {key: list(raw) if isinstance(raw, dict) else [] for key, raw in tables.items()}
        known["unknowns"] = [ALL, *known["unknowns"]]
        kinds, bases = get_args(NoiseKind), get_args(NoiseBasis)

        def names(key: str, usual: object, among: Collection[str], what: str) -> Any:
            return self._names((*place, key), raw.get(key, usual), among, what)

        kind = names("kind", "relative", kinds, "kind of noise")
        if len(kind) > 1:
            self.report.add((*place, "kind"), "more than one kind of noise", "write a grid for each")
        noise: Iterable[float] = (1.0,)
        if "noise" in raw:
            noise = self._each((*place, "noise"), raw["noise"], _level)
        elif kind != ("channels",):
            self.report.add(place, "the noise is not given", "add noise = [0.01, 0.1]")
        samples = [key for key in ("samples", "samples_in_all") if key in raw]
        if len(samples) > 1:
            what = "samples and samples_in_all are both given"
            self.report.add(place, what, "keep the one that is meant")
        elif not samples:
            what = "the number of samples is not given"
            self.report.add(place, what, "add samples = [56], per frequency")
        number = partial(_whole, least=2, most=MOST_SAMPLES)
        reference = raw.get("reference")
        if reference is not None:
            names("reference", None, known["frequencies"], "set of frequencies")
        elif "constant" in kind:
            cure = "add reference = …, the frequencies whose rms amplitude it is a part of"
            self.report.add(place, "constant noise has no size", cure)
        methods = self._own_or_all(place, raw, "methods")
        draws = self._own_or_all(place, raw, "draws")
        return ScenarioGrid(
            rigs=names("rigs", known["rigs"], known["rigs"], "rig"),
            frequencies=names(
                "frequencies", known["frequencies"], known["frequencies"], "set of frequencies"
            ),
            noise=tuple(noise),
            samples=self._each((*place, samples[0]), raw[samples[0]], number) if len(samples) == 1 else (),
            methods=self._names(*methods, (AUTO, *METHODS), "method") if methods else (AUTO,),
            draws=self._draws(place, draws),
            unknowns=names("unknowns", [ALL], known["unknowns"], "set of unknowns"),
            kind=kind[0] if kind else "relative",
            reference=None if reference is None else str(reference),
            in_all=samples == ["samples_in_all"],
            covariance=names("covariance", ["given"], bases, "covariance"),
        )

    def _own_or_all(self, place: Place, raw: Mapping[str, Any], key: str) -> tuple[Place, object] | None:
        """Where a key stands, in the grid or for all of them, and what it says."""
        if key in raw:
            return (*place, key), raw[key]
        return ((key,), self.document[key]) if key in self.document else None

    def _draws(self, place: Place, given: tuple[Place, object] | None) -> int:
        if given is None:
            self.report.add(place, "the number of draws is not given", "add draws = 1000")
            return 0
        return self._value(*given, partial(_whole, least=2, most=MOST_DRAWS)) or 0
