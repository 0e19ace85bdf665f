"""The paper's rig, and its tables and figures as studies."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, frozen
from dashpot.channel import Quantity
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.study.scenario import ScenarioGrid, Study, TrueRig
from dashpot.study.simulate import standard_channels

# What the paper prints: its rig, its tables, and the corrections without which they cannot be read.


@dataclass(frozen=True)
class Printed:
    """What the paper prints; errors in %, in the order of `unknown`."""

    source: str
    unknown: tuple[str, ...]
    values: Mapping[str, float]
    known: Mapping[str, float]
    eigenvalues: Complex
    cases: Mapping[str, tuple[float, ...]]
    samples: int
    levels: tuple[float, ...]
    table2: Mapping[str, Real]
    table2_eigenvalues: Mapping[str, Complex]
    ls_expected: Mapping[str, Real]
    table3: Mapping[str, float]
    table4: Mapping[str, Real]
    table4_eigenvalues: Mapping[str, Complex]
    bound: Mapping[str, Real]
    corrections: tuple[Mapping[str, str], ...]


@cache
def facts() -> Mapping[str, Any]:
    """The file of facts that comes with this module, as it is."""
    text = (files("dashpot.reproduce.yamane1989") / "facts.toml").read_text(encoding="utf-8")
    return MappingProxyType(tomllib.loads(text))


@cache
def paper_prints() -> Printed:
    """The figures of the paper, from the file that comes with this module."""
    raw = facts()

    def numbers(table: Mapping[str, Any]) -> Mapping[str, Real]:
        return MappingProxyType({key: frozen(row, np.float64) for key, row in table.items()})

    def pairs(rows: Sequence[Any]) -> Complex:
        array = np.array(rows, dtype=float)
        return frozen(array[..., 0] + 1j * array[..., 1], np.complex128)

    table2 = raw["table2"]
    return Printed(
        source=raw["source"],
        unknown=tuple(raw["unknown"]),
        values=MappingProxyType(raw["rig"]["values"]),
        known=MappingProxyType(raw["rig"]["known"]),
        eigenvalues=pairs(raw["rig"]["eigenvalues"]),
        cases=MappingProxyType({name: tuple(map(float, row)) for name, row in raw["cases"].items()}),
        samples=raw["measurement"]["samples"],
        levels=tuple(level / 100 for level in table2["levels"]),
        table2=numbers({name: table2[name] for name in ("ls", "iv")}),
        table2_eigenvalues=MappingProxyType(
            {name: pairs(table2[f"{name}_eigenvalues"]) for name in ("ls", "iv")}
        ),
        ls_expected=numbers(table2["ls_expected"]),
        table3=MappingProxyType(dict(zip(raw["table3"]["unknown"], raw["table3"]["iv"], strict=True))),
        table4=numbers(raw["table4"]),
        table4_eigenvalues=MappingProxyType(
            {name: pairs(rows) for name, rows in raw["table4_eigenvalues"].items()}
        ),
        bound=numbers(raw["bound"]),
        corrections=tuple(MappingProxyType(row) for row in raw["corrections"]),
    )


SEED = 1989
DRAWS = 1000
METHODS = ("ls", "iv", "oiv")
FOUR = "four"
FIGURE2_LEVELS = (0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
FIGURE3_SAMPLES = (50, 75, 100, 150, 200, 300, 400, 600, 800, 1000, 1200, 1400, 1600)


def paper_model() -> Model:
    """The rig of Table 1; k1 and k2 are known, the six others unknown."""
    raw = facts()
    topology, known = raw["topology"], raw["rig"]["known"]
    elements: list[Element] = [mass(name, at) for name, at in topology["masses"].items()]
    for section, kind in (("springs", Kind.SPRING), ("dampers", Kind.DAMPER)):
        for name, (first, second) in topology[section].items():
            elements.append(between(name, kind, first, second, value=known.get(name)))
    order = [*raw["unknown"], *known]
    elements.sort(key=lambda element: order.index(element.name))
    return Model(("x1", "x2"), (Input("u"),), tuple(elements), "Yamane's two masses")


def true_rig() -> TrueRig:
    """The rig with its true values and channels: x1, x2, their velocities, and u without noise."""
    rig = paper_model()
    motions = (Quantity.DISPLACEMENT, Quantity.VELOCITY)
    return TrueRig(rig, paper_prints().values, standard_channels(rig, motions))


def tables_study(draws: int = DRAWS, seed: int = SEED) -> Study:
    """Tables 2 to 4, and their cases under noise of constant size."""
    paper = paper_prints()
    base = _grid(draws)
    every = replace(base, frequencies=tuple(paper.cases))
    grids = (
        replace(base, noise=paper.levels),
        replace(base, unknowns=(FOUR,), methods=("iv", "oiv")),
        every,
        replace(every, kind="constant", reference="CASE-3"),
    )
    return _study("Yamane 1989, Tables 2-4", grids, seed)


def figures_study(draws: int = DRAWS, seed: int = SEED) -> Study:
    """Figures 2 and 3."""
    base = _grid(draws)
    grids = (
        replace(base, noise=FIGURE2_LEVELS),
        replace(base, samples=FIGURE3_SAMPLES, in_all=True, methods=("iv", "oiv")),
    )
    return _study("Yamane 1989, Figures 2-3", grids, seed)


def _grid(draws: int) -> ScenarioGrid:
    """What the paper does where it does not say otherwise."""
    return ScenarioGrid(("paper",), ("CASE-3",), (0.1,), (paper_prints().samples,), METHODS, draws)


def _study(name: str, grids: tuple[ScenarioGrid, ...], seed: int) -> Study:
    """The paper does not say at which instants it sampled.

    Without offset or drift all even spreads over whole half periods have the same distribution, whatever the phase of
    the input (sin ωt in eq. 2, cos ωt here), so half a period is taken: it makes sense of two samples too.
    """
    paper = paper_prints()
    return Study(
        name,
        seed,
        {"paper": true_rig()},
        paper.cases,
        grids,
        unknowns={FOUR: tuple(paper.table3)},
        periods=0.5,
    )
