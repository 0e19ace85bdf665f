"""The tables of a study file that grids refer to: rigs, frequencies, unknowns, amplitudes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DashpotError, UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, joined, listed, written
from dashpot.model.rigfile import read_rig
from dashpot.quantities import frequencies
from dashpot.study.grid import ALL, TrueRig
from dashpot.study.studyfile.values import StudyValues
from dashpot.units import factor_between, scale

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
