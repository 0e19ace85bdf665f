"""Reading study files."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

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

# Values of a study file: each is read, or what is wrong with it is told at its key.


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


# The tables of a study file that grids refer to: rigs, frequencies, unknowns, amplitudes.


MOST_LINES = 10**6


def read_rigs(values: StudyValues) -> dict[str, TrueRig]:
    """The rigs with their true values; rig files are looked for beside the study file."""
    rigs: dict[str, TrueRig] = {}
    for name, raw in values.table("rigs").items():
        rig = _rig(values, name, raw)
        if rig is not None:
            rigs[name] = rig
    if not rigs and not len(values.report):
        values.report.add(("rigs",), "there is no rig", 'add [rigs.NAME] with file = "rig.toml"')
    return rigs


def _rig(values: StudyValues, name: str, raw: object) -> TrueRig | None:
    place = ("rigs", name)
    table = {"file": raw} if isinstance(raw, str) else raw
    if not isinstance(table, dict):
        cure = f'write [rigs.{name}] and below it file = "rig.toml"'
        values.report.add(place, "this is not a table", cure)
        return None
    values.keys(place, table, ("file", "values"))
    if "file" not in table:
        values.report.add(place, "the rig file is not named", 'add file = "rig.toml"')
        return None
    file = values.text((*place, "file"), table["file"])
    true_values = table.get("values", {})
    if not isinstance(true_values, dict):
        values.report.add((*place, "values"), "this is not a table", "write values = { m1 = 3.0 }")
        true_values = {}
    return _true_rig(values, place, file, true_values) if file else None


def _true_rig(values: StudyValues, place: Place, file: str, true_values: Mapping[str, Any]) -> TrueRig | None:
    try:
        rig = read_rig(Path(values.path).parent / file)
    except DashpotError as error:
        values.report.include((*place, "file"), error.problems)
        return None
    units = {e.name: rig.model.unit(e) for e in rig.model.elements if e.same_as is None}
    truth = {}
    for name, raw in true_values.items():
        place_of_value = (*place, "values", name)
        if name not in units:
            cure = f"{did_you_mean(name, units)}it has {listed(units)}"
            values.report.add(place_of_value, "the rig has no such parameter of its own", cure)
        else:
            unit = units[name]
            truth[name] = values.quantity(place_of_value, raw, partial(factor_between, wanted=unit))
    for unknown in rig.model.unknowns:
        if unknown.name not in true_values and unknown.prior is None and unknown.guess is None:
            cure = f"add values = {{ {unknown.name} = … }}, in {unknown.unit}"
            values.report.add(place, f"the true value of {unknown.name} is not given", cure)
    return TrueRig(rig.model, truth, rig.channels)


def read_frequencies(values: StudyValues) -> dict[str, tuple[float, ...]]:
    """Sets of frequencies by name, Hz."""
    sets = {
        key: _lines(values, ("frequencies", key), raw) for key, raw in values.table("frequencies").items()
    }
    if not sets and not len(values.report):
        cure = "add [frequencies] with name = [1, 2, 5]"
        values.report.add(("frequencies",), "there are no frequencies", cure)
    return sets


def _lines(values: StudyValues, place: Place, raw: object) -> tuple[float, ...]:
    if isinstance(raw, dict):
        return _sweep(values, place, raw)
    if isinstance(raw, str):  # in the syntax of the command line, such as "1:10:0.5"
        try:
            return frequencies(raw)
        except UsageError as error:
            for problem in error.problems:
                values.report.add(place, problem.what, problem.cure)
            return ()
    if not isinstance(raw, list):
        cure = 'write a list [1, 2, 5], a range "0.5:25/40", or { from = 0.5, to = 25, count = 40 }'
        values.report.add(place, "these are not frequencies", cure)
        return ()
    return tuple(values.number(place, item, positive=True) for item in values.entries(place, raw))


def _sweep(values: StudyValues, place: Place, raw: Mapping[str, Any]) -> tuple[float, ...]:
    values.keys(place, raw, ("from", "to", "count", "spacing"))
    missing = [key for key in ("from", "to", "count") if key not in raw]
    if missing:
        values.report.add(place, f"{joined(missing)} missing", "write { from = 0.5, to = 25, count = 40 }")
        return ()
    low, high = (values.number((*place, key), raw[key], positive=True) for key in ("from", "to"))
    count = values.whole((*place, "count"), raw["count"], 2, MOST_LINES)
    spacing = values.text((*place, "spacing"), raw.get("spacing", "linear"))
    if spacing not in ("linear", "logarithmic"):
        what = f"{written(spacing)} is not a spacing"
        values.report.add((*place, "spacing"), what, 'write "linear" or "logarithmic"')
    if low >= high:
        values.report.add(place, f"from {low:g} is not below to {high:g}", "exchange or change them")
        return ()
    step = np.geomspace if spacing == "logarithmic" else np.linspace
    return tuple(step(low, high, count).tolist())


def read_unknowns(values: StudyValues, rigs: Mapping[str, TrueRig]) -> dict[str, tuple[str, ...]]:
    """Sets of parameters that are to be found, by name."""
    parameters = {e.name for rig in rigs.values() for e in rig.model.elements if e.same_as is None}
    sets = {}
    for name, raw in values.table("unknowns").items():
        place = ("unknowns", name)
        if name == ALL:
            values.report.add(place, "the name all is taken: it is the rig as it is", "use another")
        sets[name] = values.names(place, raw, parameters, "parameter of the rigs")
    return sets


def read_input_amplitudes(values: StudyValues, rigs: Mapping[str, TrueRig]) -> dict[str, complex]:
    """Amplitudes of the inputs, SI units."""
    quantities = {
        source.name: ("displacement" if source.kind == "displacement" else "force", _turns(rig, source.name))
        for rig in rigs.values()
        for source in rig.model.inputs
    }
    amplitudes: dict[str, complex] = {}
    for name, raw in values.table("amplitudes").items():
        place = ("amplitudes", name)
        if name not in quantities:
            amplitudes[name] = values.number(place, raw)
            if rigs:
                values.report.add(place, "no rig has this input", f"there are {listed(sorted(quantities))}")
            continue
        quantity, angular = quantities[name]
        amplitudes[name] = values.quantity(place, raw, partial(scale, quantity=quantity, angular=angular))
    for rig_name, rig in rigs.items():
        missing = [source.name for source in rig.model.inputs if source.name not in amplitudes]
        if len(rig.model.nonlinear) and missing:
            what = f"the motion of {rig_name} depends on the size of its drive: it has nonlinear elements"
            values.report.add(("amplitudes",), what, f"give the amplitude of {listed(missing)}")
    return amplitudes


def _turns(rig: TrueRig, name: str) -> bool:
    """Whether an input is an angle or a torque."""
    source = next(source for source in rig.model.inputs if source.name == name)
    points = source.at if source.kind == "force" else (name,)
    return all(point in rig.model.angles for point in points)


# The grids of a study file.


GRID = (
    "rigs", "unknowns", "frequencies", "noise", "kind", "reference", "samples", "samples_in_all", "covariance",
    "methods", "draws",
)  # fmt: skip
KINDS = ("relative", "constant", "channels")
COVARIANCES = ("given", "estimated")
MOST_DRAWS = 10**9
MOST_SAMPLES = 10**7


@dataclass(frozen=True)
class Tables:
    """Names in the tables that grids refer to, faulty entries included."""

    rigs: Collection[str]
    frequencies: Collection[str]
    unknowns: Collection[str]


def read_grids(values: StudyValues, tables: Tables) -> list[ScenarioGrid]:
    """The grids, without the faulty ones."""
    raw = values.document.get("grid", [])
    entries = raw if isinstance(raw, list) else [raw]
    if not entries:
        cure = "add [[grid]] with noise = [0.1] and samples = [56]"
        values.report.add(("grid",), "there is no grid", cure)
    grids = []
    for k, entry in enumerate(entries):
        if not isinstance(entry, dict):
            values.report.add(("grid",), "a grid is not a table", "write [[grid]] and its keys below")
            continue
        grid = _grid(values, ("grid", k), entry, tables)
        if grid is not None:
            grids.append(grid)
    return grids


def _grid(values: StudyValues, place: Place, raw: Mapping[str, Any], tables: Tables) -> ScenarioGrid | None:
    before = len(values.report)
    values.keys(place, raw, GRID)

    def names(key: str, usual: object, known: Collection[str], what: str) -> tuple[str, ...]:
        return values.names((*place, key), raw.get(key, usual), known, what)

    rigs = names("rigs", list(tables.rigs), tables.rigs, "rig")
    lines = names("frequencies", list(tables.frequencies), tables.frequencies, "set of frequencies")
    unknowns = names("unknowns", [ALL], (ALL, *tables.unknowns), "set of unknowns")
    kind = names("kind", "relative", KINDS, "kind of noise")
    covariance = names("covariance", ["given"], COVARIANCES, "covariance")
    methods = _methods(values, place, raw)
    draws = _draws(values, place, raw)
    if len(kind) > 1:
        values.report.add((*place, "kind"), "more than one kind of noise", "write a grid for each")
    levels = _levels(values, place, raw, kind)
    samples, in_all = _samples(values, place, raw)
    reference = _reference(values, place, raw, kind, tables)
    if len(values.report) > before:
        return None
    return ScenarioGrid(
        rigs,
        lines,
        levels,
        samples,
        methods,
        draws,
        unknowns,
        cast("NoiseKind", kind[0]),
        reference,
        in_all,
        cast("tuple[NoiseBasis, ...]", covariance),
    )


def _methods(values: StudyValues, place: Place, raw: Mapping[str, Any]) -> tuple[str, ...]:
    if "methods" in raw:
        return values.names((*place, "methods"), raw["methods"], (AUTO, *METHODS), "method")
    if "methods" in values.document:
        return values.names(("methods",), values.document["methods"], (AUTO, *METHODS), "method")
    return (AUTO,)


def _draws(values: StudyValues, place: Place, raw: Mapping[str, Any]) -> int:
    if "draws" in raw:
        return values.whole((*place, "draws"), raw["draws"], 2, MOST_DRAWS)
    if "draws" in values.document:
        return values.whole(("draws",), values.document["draws"], 2, MOST_DRAWS)
    values.report.add(place, "the number of draws is not given", "add draws = 1000")
    return 0


def _levels(
    values: StudyValues, place: Place, raw: Mapping[str, Any], kind: tuple[str, ...]
) -> tuple[float, ...]:
    """Noise levels."""
    if "noise" in raw:
        place_of_noise = (*place, "noise")
        levels = [values.share(place_of_noise, item) for item in values.entries(place_of_noise, raw["noise"])]
        for level in levels:
            if level < 0:
                cure = "write a positive level, such as 0.1"
                values.report.add(place_of_noise, f"a noise of {level:g}", cure)
        return tuple(levels)
    if kind != ("channels",):
        values.report.add(place, "the noise is not given", "add noise = [0.01, 0.1]")
    return (1.0,)


def _samples(values: StudyValues, place: Place, raw: Mapping[str, Any]) -> tuple[tuple[int, ...], bool]:
    """Numbers of samples, and whether they are in all, not per frequency."""
    in_all = "samples_in_all" in raw
    key = "samples_in_all" if in_all else "samples"
    if in_all and "samples" in raw:
        values.report.add(place, "samples and samples_in_all are both given", "keep the one that is meant")
        return (), in_all
    if key not in raw:
        values.report.add(place, "the number of samples is not given", "add samples = [56], per frequency")
        return (), in_all
    place_of_samples = (*place, key)
    items = values.entries(place_of_samples, raw[key])
    return tuple(values.whole(place_of_samples, item, 2, MOST_SAMPLES) for item in items), in_all


def _reference(
    values: StudyValues, place: Place, raw: Mapping[str, Any], kind: tuple[str, ...], tables: Tables
) -> str | None:
    """The frequencies whose rms amplitude constant noise is a part of."""
    reference = raw.get("reference")
    if reference is not None:
        values.names((*place, "reference"), reference, tables.frequencies, "set of frequencies")
        return str(reference)
    if "constant" in kind:
        cure = "add reference = …, the frequencies whose rms amplitude it is a part of"
        values.report.add(place, "constant noise has no size", cure)
    return None


HEAD = (
    "name", "seed", "draws", "methods", "periods", "drift", "amplitudes", "rigs", "frequencies", "unknowns", "grid",
    "transients",
)  # fmt: skip
_WANTED = Wanted("study file", "describe a study, starting with [rigs.NAME]")


def read_study(path: str | os.PathLike[str]) -> Study:
    """The study in the TOML file `path`; rig files are looked for beside it.

    Raises UsageError with every problem found, each at file:line and key, DataError where the path is a device.
    """
    return _study(read_toml(path, UsageError, _WANTED))


def parse_study(text: str, path: str = "study.toml") -> Study:
    """The study described by a TOML text; `path` is named in messages, and rig files are looked for in its folder.

    Raises UsageError with every problem found, each at file:line and key.
    """
    return _study(parse_toml(text, path, UsageError, _WANTED))


def _study(document: TomlDocument) -> Study:
    values, table = StudyValues(document), document.table
    values.keys((), table, HEAD)
    name = values.text(("name",), table.get("name", Path(document.path).stem))
    if not name.isprintable():
        values.report.add(("name",), f"{written(name)} is not a usable name", "use one line of plain text")
    seed = values.whole(("seed",), table.get("seed", 0), 0, 2**63)
    drift = values.whole(("drift",), table["drift"], 0, 5) if "drift" in table else None
    periods = values.number(("periods",), table.get("periods", 1.0), positive=True)
    transients = values.flag(("transients",), table.get("transients", False))
    rigs = read_rigs(values)
    lines = read_frequencies(values)
    unknowns = read_unknowns(values, rigs)
    amplitudes = read_input_amplitudes(values, rigs)
    grids = read_grids(values, Tables(*(values.names_in(key) for key in ("rigs", "frequencies", "unknowns"))))
    values.report.raise_any()
    study = Study(name, seed, rigs, lines, tuple(grids), unknowns, amplitudes, periods, drift, transients)
    for k, grid in enumerate(study.grids):
        try:
            list(points(study, grid))
        except DashpotError as error:
            for problem in error.problems:
                values.report.add(("grid", k), problem.what, problem.cure)
    values.report.raise_any()
    return study
