"""The grids of a study file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, cast

from dashpot.estimate.registry import METHODS
from dashpot.io.toml_document import Place
from dashpot.study.grid import ALL, NoiseKind, ScenarioGrid
from dashpot.study.simulate import NoiseBasis
from dashpot.study.studyfile.values import StudyValues

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
        return values.names((*place, "methods"), raw["methods"], METHODS, "method")
    if "methods" in values.document:
        return values.names(("methods",), values.document["methods"], METHODS, "method")
    return ("oiv",)


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
