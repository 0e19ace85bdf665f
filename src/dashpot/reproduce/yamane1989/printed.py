"""What the paper prints: its rig, its tables, and the corrections without which they cannot be read."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, frozen


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
