"""The tables of a rig for the C source of its functional mock-up unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.realisation import DERIVATIVES
from dashpot.model.observation import observation_model


def root_elements(rig: IdentifiedRig) -> list[int]:
    """Elements whose parameters are not tied to another's, in order."""
    return [i for i, tie in enumerate(rig.model.ties) if tie.root == i]


def c_tables(rig: IdentifiedRig, orders: Ints, token: str) -> str:
    """The header rig.h: sizes, incidences, laws, channels and the parameters' values.

    orders (elements,): powers of jω.
    """
    model = rig.model
    view = observation_model(model, rig.outputs, np.zeros(1))
    roots = root_elements(rig)
    r, s = len(orders), model.S.shape[1]
    sizes = {
        "N": model.n, "R": r, "S": s, "E": len(model.elements), "ROOTS": len(roots), "O": len(rig.outputs),
        "LOWER": int(np.sum(orders)),
    }  # fmt: skip
    power = [DERIVATIVES[element.law.matrix] for element in model.elements]
    lines = ["/* One rig: sizes, elements, channels, parameters in SI units. */", f'#define TOKEN "{token}"']
    lines += [f"#define {name} {size}" for name, size in sizes.items()]
    lines += [
        _table("int", "order_of[SOME(R)]", orders),
        _table("int", "power_of[E]", power),
        _table("int", "root_of[E]", [roots.index(tie.root) for tie in model.ties]),
        _table("double", "times_of[E]", [tie.times for tie in model.ties]),
        _table("double", "default_of[ROOTS]", rig.p[roots]),
        _table("double", "along_x[E][N]", model.B),
        _table("double", "along_u[E][SOME(R)]", _some(model.D)),
        _table("double", "force_at[N][SOME(S)]", _some(model.S)),
        _table("int", "derivative_of[O]", view.derivative),
        _table("double", "on_x[O][N]", view.on_x),
        _table("double", "on_q[O][SOME(R + S)]", _some(view.on_q)),
        _table("double", "on_force[O][E]", view.force),
    ]
    return "\n".join(lines) + "\n"


def _some(table: Real) -> Real:
    """The table with one column of zeros where it has none: C has no empty arrays."""
    return table if table.shape[1] else np.zeros((len(table), 1))


def _table(kind: str, declared: str, values: Real | Ints | Sequence[float]) -> str:
    array = np.asarray(values)
    return f"static const {kind} {declared} = {_braces(array if array.size else np.zeros(1, dtype=int))};"


def _braces(values: np.ndarray[Any, Any]) -> str:
    if values.ndim == 1:
        return "{" + ", ".join(repr(value) for value in values.tolist()) + "}"
    return "{" + ",\n  ".join(_braces(row) for row in values) + "}"
