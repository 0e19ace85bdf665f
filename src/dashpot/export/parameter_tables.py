"""Parameters of a rig as tables: CSV, Parquet, and a MATLAB script whose variables Simscape blocks refer to."""

from __future__ import annotations

import keyword
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.data.readers.text import write_rows
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.io.atomic import write_bytes, write_text
from dashpot.model.dynamics import matrices

# Matrices of a rig as Matrix Market files.


SYMMETRIC = "MCKH"
MEANING = {
    "M": "mass", "C": "damping", "K": "stiffness", "H": "hysteretic stiffness",
    "F": "force per velocity of the inputs", "G": "force per displacement of the inputs",
    "J": "force per acceleration of the inputs", "S": "where the force inputs act",
}  # fmt: skip


def matrix_texts(rig: IdentifiedRig) -> Mapping[str, str]:
    """The text of each matrix of M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f: M, C and K, and H, F, G, J, S where not 0.

    Raises ModelError for nonlinear elements.
    """
    rig.require_linear("a matrix")
    parts = matrices(rig.model, rig.p)
    found = {letter: getattr(parts, letter) for letter in "MCKHFGJ"} | {"S": rig.model.S}
    return {
        letter: _text(rig, letter, matrix)
        for letter, matrix in found.items()
        if letter in "MCK" or (matrix.size and np.any(matrix))
    }


def write_matrix_market(rig: IdentifiedRig, path: str | os.PathLike[str]) -> list[str]:
    """Write each matrix as NAME_M.mtx, NAME_C.mtx … beside `path`, NAME.mtx; the names of the files.

    Raises ModelError for nonlinear elements, DataError where a file cannot be written.
    """
    target = Path(path)
    texts = {
        str(target.with_name(f"{target.stem}_{a}{target.suffix}")): t for a, t in matrix_texts(rig).items()
    }
    for name, text in texts.items():
        write_text(name, text)
    return list(texts)


def _text(rig: IdentifiedRig, letter: str, matrix: Real) -> str:
    symmetric = letter in SYMMETRIC
    kept = np.tril(matrix) if symmetric else matrix
    rows, columns = np.nonzero(kept)
    order = np.lexsort((rows, columns))
    across = rig.model.coordinates
    if not symmetric:
        across = rig.model.force_inputs if letter == "S" else rig.model.displacement_inputs
    lines = [
        f"%%MatrixMarket matrix coordinate real {'symmetric' if symmetric else 'general'}",
        f"% {letter}: {MEANING[letter]}, SI units",
        f"% rows: {_names(rig.model.coordinates)}",
        f"% columns: {_names(across)}",
        f"{matrix.shape[0]} {matrix.shape[1]} {len(rows)}",
    ]
    lines += [f"{rows[k] + 1} {columns[k] + 1} {float(kept[rows[k], columns[k]])!r}" for k in order.tolist()]
    return "\n".join(lines) + "\n"


def _names(names: tuple[str, ...]) -> str:
    """Names on one line of a comment, which may not be long."""
    text = ", ".join(" ".join(name.split()) for name in names)
    return text if len(text) <= 900 else text[:900] + " …"


COLUMNS = ("parameter", "kind", "value", "sd", "low95", "high95", "unit", "known", "between")
NORMAL95 = 1.959963984540054  # quantile of the normal distribution
MATLAB_WORDS = {
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while",
}  # fmt: skip


@dataclass(frozen=True)
class ExportedParameter:
    """One parameter: element or inner constant of a law; value, sd and 95 % interval in `unit`; what it joins."""

    name: str
    kind: str
    value: float
    sd: float
    interval95: tuple[float, float]
    unit: str
    known: bool
    between: str


def exported_parameters(rig: IdentifiedRig) -> list[ExportedParameter]:
    """All parameters of the rig in the order of its elements; inner constants of nonlinear laws last."""
    model = rig.model
    of_unknowns = {} if rig.estimate is None else {value.name: value for value in rig.estimate}
    p, sd_theta = rig.p, np.sqrt(np.diagonal(rig.covariance))
    spread = np.abs(model.T) @ sd_theta  # each parameter depends on one unknown at most
    rows = []
    for i, (element, tie) in enumerate(zip(model.elements, model.ties, strict=True)):
        if element.is_entry:
            continue
        value, sd = float(p[i]), float(spread[i])
        root = of_unknowns.get(model.elements[tie.root].name)
        interval = _interval(value, sd) if root is None else _scaled(root.interval95, tie.times)
        joined = " ".join(_term(name, factor) for name, factor in element.along.items()).removeprefix("+ ")
        known, unit = not np.any(model.T[i]), model.unit(element)
        rows.append(
            ExportedParameter(element.name, str(element.kind), value, sd, interval, unit, known, joined)
        )
    constants = model.inner_constants(rig.theta)
    slope, _ = model.constants_map
    for k, (element, constant) in enumerate(model.constants):
        name, value = f"{element.name}.{constant.name}", float(constants[k])
        sd = float(np.abs(slope[k]) @ sd_theta)
        estimated = of_unknowns.get(name)
        interval = _interval(value, sd) if estimated is None else estimated.interval95
        unit = model.constant_unit(element, constant)
        rows.append(
            ExportedParameter(name, "constant", value, sd, interval, unit, not constant.unknown, element.name)
        )
    return rows


def _interval(value: float, sd: float) -> tuple[float, float]:
    return value - NORMAL95 * sd, value + NORMAL95 * sd


def _scaled(interval: tuple[float, float], times: float) -> tuple[float, float]:
    low, high = sorted(times * end for end in interval)
    return low, high


def _term(name: str, factor: float) -> str:
    size = "" if abs(factor) == 1 else f"{abs(factor):g} "
    return f"{'-' if factor < 0 else '+'} {size}{name}"


def write_parameter_csv(rig: IdentifiedRig, path: str | os.PathLike[str]) -> None:
    """One row for each parameter (COLUMNS).  Raises DataError where the file cannot be written."""
    columns = list(zip(*(_cells(row) for row in exported_parameters(rig)), strict=True))
    numeric = [
        np.array(column, dtype=float) if 2 <= k <= 5 else [str(cell) for cell in column]
        for k, column in enumerate(columns)
    ]
    write_rows(path, COLUMNS, numeric)


def write_parameter_parquet(rig: IdentifiedRig, path: str | os.PathLike[str]) -> None:
    """The same as Parquet, the covariance of the unknowns as JSON in the file's metadata (`covariance`, `order`)."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from dashpot.io.json_document import to_json

    columns = [
        list(column) for column in zip(*(_cells(row) for row in exported_parameters(rig)), strict=True)
    ]
    table = pa.table(dict(zip(COLUMNS, columns, strict=True)))
    metadata = {"model": rig.model.name, "order": to_json(list(rig.names))}
    metadata["covariance"] = to_json(rig.covariance.tolist())
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(metadata), sink)
    write_bytes(path, sink.getvalue().to_pybytes())


def _cells(row: ExportedParameter) -> tuple[str | float | bool, ...]:
    return (row.name, row.kind, row.value, row.sd, *row.interval95, row.unit, row.known, row.between)


def write_matlab_parameters(rig: IdentifiedRig, path: str | os.PathLike[str]) -> None:
    """A MATLAB script: a variable for each parameter, for the fields of Simscape blocks, and their covariance.

    Names that MATLAB does not take are changed, with the name of the rig file beside them.  Raises DataError where the
    file cannot be written.
    """
    rows = exported_parameters(rig)
    variables = matlab_names([row.name for row in rows])
    lines = [f"% {_comment(rig.model.name or 'Rig')}: parameters in SI units, by dashpot"]
    for row, variable in zip(rows, variables, strict=True):
        doubt = "known" if row.known else f"sd {row.sd:.3g}"
        origin = "" if variable == row.name else f", {_comment(row.name)}"
        lines.append(f"{variable} = {row.value!r};  % {row.unit}, {doubt}, {row.kind}{origin}")
    order = [_comment(name).replace("'", "''") for name in rig.names]
    table = ";\n  ".join(" ".join(repr(float(x)) for x in line) for line in rig.covariance)
    lines += [
        "% Covariance of the unknown parameters, in the order of parameter_names",
        "parameter_names = {" + ", ".join(f"'{name}'" for name in order) + "};",
        f"parameter_covariance = [{table}];",
    ]
    write_text(path, "\n".join(lines) + "\n")


def matlab_names(names: Sequence[str]) -> list[str]:
    """Each name as a variable of MATLAB (and Python): letters, digits, _, at most 63, all different."""
    taken: set[str] = {"parameter_names", "parameter_covariance"}
    variables = []
    for name in names:
        variable = re.sub(r"[^A-Za-z0-9_]", "_", name)[:60]
        if not re.match(r"[A-Za-z]", variable) or variable in MATLAB_WORDS or keyword.iskeyword(variable):
            variable = f"p_{variable}"
        unique, count = variable, 1
        while unique in taken:
            count += 1
            unique = f"{variable}_{count}"
        taken.add(unique)
        variables.append(unique)
    return variables


def _comment(text: str) -> str:
    """Text on one line."""
    return " ".join(text.split())
