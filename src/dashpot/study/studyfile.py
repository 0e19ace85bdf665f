"""Study files: TOML that says which rigs, tests, noises and methods to compare by Monte Carlo.

    study = read_study("study.toml")

    name = "How much noise"                     draws = 1000       seed = 1       methods = ["iv", "oiv"]
    [rigs.paper]                                file = "rig.toml"  values = { m1 = 3.0, c1 = 30.0 }
    [frequencies]                               few = [1, 2, 5]    range = "0.5:25/40"
    [unknowns]                                  two = ["m1", "c1"]
    [[grid]]                                    noise = [0.01, 0.1]  samples = [56]

Whatever is wrong with a file is a UsageError with all its problems, each at `study.toml:8: grid[0].noise`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.registry import METHODS
from dashpot.io.toml_document import Place, Report, TomlDocument, Wanted, parse_toml, read_toml
from dashpot.io.words import did_you_mean, listed, written
from dashpot.model.rigfile import read_rig
from dashpot.quantities import frequencies
from dashpot.study.grid import ALL, NoiseKind, ScenarioGrid, Study, TrueRig, points
from dashpot.study.simulate import NoiseBasis

_WANTED = Wanted("study file", "describe a study, starting with [rigs.NAME]")

HEAD = (
    "name",
    "seed",
    "draws",
    "methods",
    "periods",
    "drift",
    "amplitudes",
    "rigs",
    "frequencies",
    "unknowns",
    "grid",
)
GRID = (
    "rigs", "unknowns", "frequencies", "noise", "kind", "reference", "samples", "samples_in_all", "covariance",
    "methods", "draws",
)  # fmt: skip
KINDS = ("relative", "constant", "channels")
COVARIANCES = ("given", "estimated")
MOST_DRAWS = 10**9
MOST_SAMPLES = 10**7
MOST_LINES = 10**6


def read_study(path: str | os.PathLike[str]) -> Study:
    """The study in the TOML file `path`; rig files are looked for beside it.

    Raises UsageError with every problem found, each at file:line and key.
    """
    return _Reader(read_toml(path, UsageError, _WANTED)).study()


def parse_study(text: str, path: str = "study.toml") -> Study:
    """The study described by a TOML text; `path` is named in messages, and rig files are looked for in its folder.

    Raises UsageError with every problem found, each at file:line and key.
    """
    return _Reader(parse_toml(text, path, UsageError, _WANTED)).study()


class _Reader:
    """Reads one document, gathering problems; `study` gives the study or raises them all."""

    def __init__(self, document: TomlDocument) -> None:
        self.document = document.table
        self.path = document.path
        self.report = Report(document, UsageError)

    def study(self) -> Study:
        """The study.  Raises UsageError."""
        self._keys((), self.document, HEAD)
        document = self.document
        name = self._text(("name",), document.get("name", Path(self.path).stem))
        seed = self._whole(("seed",), document.get("seed", 0), 0, 2**63)
        drift = self._whole(("drift",), document["drift"], 0, 5) if "drift" in document else None
        periods = self._number(("periods",), document.get("periods", 1.0), positive=True)
        rigs = self._rigs()
        frequencies = {
            key: self._lines(("frequencies", key), raw) for key, raw in self._table("frequencies").items()
        }
        if not frequencies and not len(self.report):
            self.report.add(
                ("frequencies",), "there are no frequencies", "add [frequencies] with name = [1, 2, 5]"
            )
        unknowns = self._unknowns(rigs)
        amplitudes = {
            key: self._number(("amplitudes", key), raw) for key, raw in self._table("amplitudes").items()
        }
        self._amplitudes_known(amplitudes, rigs)
        grids = self._grids(*(self._known(key) for key in ("rigs", "frequencies", "unknowns")))
        self.report.raise_any()
        study = Study(name, seed, rigs, frequencies, tuple(grids), unknowns, amplitudes, periods, drift)
        for place, grid in enumerate(study.grids):
            try:
                points(study, grid)
            except DashpotError as error:
                for problem in error.problems:
                    self.report.add(("grid", place), problem.what, problem.cure)
        self.report.raise_any()
        return study

    # Values

    def _keys(self, place: Place, table: Mapping[str, Any], known: Sequence[str]) -> None:
        for key in table:
            if key not in known:
                self.report.add(
                    (*place, key), "unknown key", f"{did_you_mean(key, known)}there are {listed(known)}"
                )

    def _table(self, key: str) -> dict[str, Any]:
        raw = self.document.get(key, {})
        if isinstance(raw, dict):
            return raw
        self.report.add((key,), "this is no table", f"write [{key}] and below it name = …")
        return {}

    def _text(self, place: Place, raw: object) -> str:
        if isinstance(raw, str):
            return raw
        self.report.add(place, f"{written(raw)} is no text", "write it in quotes")
        return ""

    def _number(self, place: Place, raw: object, *, positive: bool = False) -> float:
        if isinstance(raw, bool) or not isinstance(raw, int | float):
            self.report.add(place, f"{written(raw)} is no number", "write a number, without quotes")
            return 1.0
        number = float(raw) if abs(raw) < 1e300 else math.inf
        if not math.isfinite(number):
            self.report.add(place, f"{written(raw)} is not finite", "write a finite number")
        elif positive and number <= 0:
            self.report.add(place, f"{number:g} is not positive", "write a number above 0")
        else:
            return number
        return 1.0

    def _whole(self, place: Place, raw: object, least: int, most: int) -> int:
        if isinstance(raw, bool) or not isinstance(raw, int):
            self.report.add(
                place, f"{written(raw)} is no whole number", f"write a whole number from {least} on"
            )
        elif not least <= raw <= most:
            self.report.add(
                place, f"{written(raw)} is out of range", f"write a whole number from {least} to {most:g}"
            )
        else:
            return raw
        return least

    def _list(self, place: Place, raw: object) -> list[Any]:
        """A list without repetitions; a single value stands for a list of one."""
        items = raw if isinstance(raw, list) else [raw]
        if not items:
            self.report.add(place, "the list is empty", "give one entry at least")
        seen: set[object] = set()
        for item in items:
            if isinstance(item, str | int | float):
                if item in seen:
                    self.report.add(place, f"{written(item)} stands twice in the list", "remove one of them")
                    return list(dict.fromkeys(i for i in items if isinstance(i, str | int | float)))
                seen.add(item)
        return items

    def _names(self, place: Place, raw: object, known: Collection[str], what: str) -> tuple[str, ...]:
        if not known:
            return ()  # that there are none has been told
        found = []
        for item in self._list(place, raw):
            if not isinstance(item, str):
                self.report.add(place, f"{written(item)} is no name", "write names in quotes")
            elif item not in known:
                cure = f"{did_you_mean(item, known)}there are {listed(known)}" if known else None
                self.report.add(place, f"{written(item)} is no {what}", cure)
            else:
                found.append(item)
        return tuple(found)

    # Tables

    def _rigs(self) -> dict[str, TrueRig]:
        rigs: dict[str, TrueRig] = {}
        for name, raw in self._table("rigs").items():
            place = ("rigs", name)
            if isinstance(raw, str):
                raw = {"file": raw}
            if not isinstance(raw, dict):
                self.report.add(
                    place, "this is no table", f'write [rigs.{name}] and below it file = "rig.toml"'
                )
                continue
            self._keys(place, raw, ("file", "values"))
            if "file" not in raw:
                self.report.add(place, "the rig file is not named", 'add file = "rig.toml"')
                continue
            file = self._text((*place, "file"), raw["file"])
            values = raw.get("values", {})
            if not isinstance(values, dict):
                self.report.add((*place, "values"), "this is no table", "write values = { m1 = 3.0 }")
                values = {}
            if file:
                bench = self._bench(place, file, values)
                rigs |= {} if bench is None else {name: bench}
        if not rigs and not len(self.report):
            self.report.add(("rigs",), "there is no rig", 'add [rigs.NAME] with file = "rig.toml"')
        return rigs

    def _bench(self, place: Place, file: str, values: Mapping[str, Any]) -> TrueRig | None:
        try:
            rig = read_rig(Path(self.path).parent / file)
        except DashpotError as error:
            self.report.include((*place, "file"), error.problems)
            return None
        own = [element.name for element in rig.model.elements if element.same_as is None]
        truth = {}
        for name, raw in values.items():
            here = (*place, "values", name)
            if name not in own:
                cure = f"{did_you_mean(name, own)}it has {listed(own)}"
                self.report.add(here, "the rig has no such parameter of its own", cure)
            else:
                truth[name] = self._number(here, raw)
        for unknown in rig.model.unknowns:
            if unknown.name not in values and unknown.prior is None and unknown.guess is None:
                cure = f"add values = {{ {unknown.name} = … }}, in {unknown.unit}"
                self.report.add(place, f"the true value of {unknown.name} is not said", cure)
        return TrueRig(rig.model, truth, rig.channels)

    def _lines(self, place: Place, raw: object) -> tuple[float, ...]:
        if isinstance(raw, dict):
            return self._sweep(place, raw)
        if isinstance(raw, str):
            return self._written(place, raw)
        if not isinstance(raw, list):
            cure = 'write a list [1, 2, 5], a range "0.5:25/40", or { from = 0.5, to = 25, count = 40 }'
            self.report.add(place, "these are not frequencies", cure)
            return ()
        return tuple(self._number(place, item, positive=True) for item in self._list(place, raw))

    def _written(self, place: Place, text: str) -> tuple[float, ...]:
        """Frequencies in the syntax of the command line, such as "1:10:0.5"."""
        try:
            return frequencies(text)
        except UsageError as error:
            for problem in error.problems:
                self.report.add(place, problem.what, problem.cure)
            return ()

    def _sweep(self, place: Place, raw: Mapping[str, Any]) -> tuple[float, ...]:
        self._keys(place, raw, ("from", "to", "count", "spacing"))
        missing = [key for key in ("from", "to", "count") if key not in raw]
        if missing:
            self.report.add(
                place, f"{' and '.join(missing)} missing", "write { from = 0.5, to = 25, count = 40 }"
            )
            return ()
        low, high = (self._number((*place, key), raw[key], positive=True) for key in ("from", "to"))
        count = self._whole((*place, "count"), raw["count"], 2, MOST_LINES)
        spacing = self._text((*place, "spacing"), raw.get("spacing", "linear"))
        if spacing not in ("linear", "logarithmic"):
            self.report.add(
                (*place, "spacing"), f"{written(spacing)} is no spacing", 'write "linear" or "logarithmic"'
            )
        if low >= high:
            self.report.add(place, f"from {low:g} is not below to {high:g}", "exchange or change them")
            return ()
        step = np.geomspace if spacing == "logarithmic" else np.linspace
        return tuple(step(low, high, count).tolist())

    def _unknowns(self, rigs: Mapping[str, TrueRig]) -> dict[str, tuple[str, ...]]:
        own = {e.name for bench in rigs.values() for e in bench.model.elements if e.same_as is None}
        sets = {}
        for name, raw in self._table("unknowns").items():
            if name == ALL:
                self.report.add(
                    ("unknowns", name), "the name all is taken: it is the rig as it is", "use another"
                )
            sets[name] = self._names(("unknowns", name), raw, own, "parameter of the rigs")
        return sets

    def _amplitudes_known(self, amplitudes: Mapping[str, float], rigs: Mapping[str, TrueRig]) -> None:
        inputs = {one.name for bench in rigs.values() for one in bench.model.inputs}
        for name in amplitudes:
            if rigs and name not in inputs:
                self.report.add(
                    ("amplitudes", name), "no rig has this input", f"there are {listed(sorted(inputs))}"
                )

    # Grids

    def _known(self, key: str) -> list[str]:
        """Names in a table, of entries that are faulty too: they exist, whatever is wrong with them."""
        raw = self.document.get(key)
        return list(raw) if isinstance(raw, dict) else []

    def _grids(
        self, rigs: Collection[str], frequencies: Collection[str], unknowns: Collection[str]
    ) -> list[ScenarioGrid]:
        raw = self.document.get("grid", [])
        tables = raw if isinstance(raw, list) else [raw]
        if not tables:
            self.report.add(
                ("grid",), "there is no grid", "add [[grid]] with noise = [0.1] and samples = [56]"
            )
        grids = []
        for k, table in enumerate(tables):
            if not isinstance(table, dict):
                self.report.add(("grid",), "a grid is no table", "write [[grid]] and its keys below")
                continue
            grid = self._grid(("grid", k), table, rigs, frequencies, unknowns)
            grids += [] if grid is None else [grid]
        return grids

    def _grid(
        self,
        place: Place,
        raw: Mapping[str, Any],
        rigs: Collection[str],
        frequencies: Collection[str],
        unknowns: Collection[str],
    ) -> ScenarioGrid | None:
        before = len(self.report)
        self._keys(place, raw, GRID)

        def each(key: str, read: Callable[[Place, object], Any]) -> tuple[Any, ...]:
            here = (*place, key)
            return tuple(read(here, item) for item in self._list(here, raw[key]))

        own_rigs = self._names((*place, "rigs"), raw.get("rigs", list(rigs)), rigs, "rig")
        own_lines = self._names(
            (*place, "frequencies"),
            raw.get("frequencies", list(frequencies)),
            frequencies,
            "set of frequencies",
        )
        sets = self._names(
            (*place, "unknowns"), raw.get("unknowns", [ALL]), (ALL, *unknowns), "set of unknowns"
        )
        kind = self._names((*place, "kind"), raw.get("kind", "relative"), KINDS, "kind of noise")
        covariance = self._names(
            (*place, "covariance"), raw.get("covariance", ["given"]), COVARIANCES, "covariance"
        )
        methods = self._methods(place, raw)
        draws = raw.get("draws", self.document.get("draws"))
        where = (*place, "draws") if "draws" in raw else ("draws",)
        count = 0
        if draws is None:
            self.report.add(place, "the number of draws is not said", "add draws = 1000")
        else:
            count = self._whole(where, draws, 2, MOST_DRAWS)
        if len(kind) > 1:
            self.report.add((*place, "kind"), "more than one kind of noise", "write a grid for each")
        levels: tuple[float, ...] = ()
        if "noise" in raw:
            levels = each("noise", lambda here, item: self._level(here, item))
        elif kind == ("channels",):
            levels = (1.0,)
        else:
            self.report.add(place, "the noise is not said", "add noise = [0.01, 0.1]")
        in_all = "samples_in_all" in raw
        key = "samples_in_all" if in_all else "samples"
        samples: tuple[int, ...] = ()
        if in_all and "samples" in raw:
            self.report.add(place, "samples and samples_in_all are both given", "keep the one that is meant")
        elif key not in raw:
            self.report.add(place, "the number of samples is not said", "add samples = [56], per frequency")
        else:
            samples = each(key, lambda here, item: self._whole(here, item, 2, MOST_SAMPLES))
        reference = raw.get("reference")
        if reference is not None:
            self._names((*place, "reference"), reference, frequencies, "set of frequencies")
        elif "constant" in kind:
            cure = "add reference = …, the frequencies whose rms amplitude it is a part of"
            self.report.add(place, "constant noise has no size", cure)
        if len(self.report) > before:
            return None
        return ScenarioGrid(
            own_rigs,
            own_lines,
            levels,
            samples,
            methods,
            count,
            sets,
            cast("NoiseKind", kind[0]),
            None if reference is None else str(reference),
            in_all,
            cast("tuple[NoiseBasis, ...]", covariance),
        )

    def _level(self, place: Place, raw: object) -> float:
        number = self._number(place, raw)
        if number < 0:
            self.report.add(place, f"a noise of {number:g}", "write a positive level, such as 0.1")
        return number

    def _methods(self, place: Place, raw: Mapping[str, Any]) -> tuple[str, ...]:
        if "methods" in raw:
            return self._names((*place, "methods"), raw["methods"], METHODS, "method")
        if "methods" in self.document:
            return self._names(("methods",), self.document["methods"], METHODS, "method")
        return ("oiv",)
