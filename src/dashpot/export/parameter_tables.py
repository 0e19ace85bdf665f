"""Parameters of a rig as tables (CSV, Parquet, a MATLAB script for Simscape blocks), and its matrices."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from dashpot.data.readers.text import write_rows
from dashpot.export.formats import ExportOptions, Written, distinct
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.io.atomic import write_bytes, write_text
from dashpot.io.json_document import to_json
from dashpot.model.dynamics import matrices

# Matrices of a rig as Matrix Market files.


MEANING = {
    "M": "mass",
    "C": "damping",
    "K": "stiffness",
    "H": "hysteretic stiffness",
    "F": "force per velocity of the inputs",
    "G": "force per displacement of the inputs",
    "J": "force per acceleration of the inputs",
    "S": "where the force inputs act",
}


def write_matrices(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write each matrix as NAME_M.mtx, NAME_C.mtx … next to `path`, NAME.mtx.

    Raises ModelError for nonlinear elements, DataError if a file cannot be written.
    """
    target = Path(path)
    texts = {
        str(target.with_name(f"{target.stem}_{a}{target.suffix}")): t for a, t in matrix_texts(rig).items()
    }
    for name, text in texts.items():
        write_text(name, text)
    return Written(tuple(texts))


def matrix_texts(rig: IdentifiedRig) -> Mapping[str, str]:
    """The text of each matrix of M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f: M, C and K, and H, F, G, J, S where not 0.

    Raises ModelError for nonlinear elements.
    """
    rig.require_linear("a matrix")
    parts = matrices(rig.model, rig.p)
    found = {letter: rig.model.S if letter == "S" else getattr(parts, letter) for letter in "MCKHFGJS"}
    texts = {}
    for letter, matrix in found.items():
        if letter not in "MCK" and not (matrix.size and np.any(matrix)):
            continue
        symmetric, across = letter in "MCKH", rig.model.coordinates
        if not symmetric:
            across = rig.model.force_inputs if letter == "S" else rig.model.displacement_inputs
        kept = np.tril(matrix) if symmetric else matrix
        columns, rows = np.nonzero(kept.T)
        lines = [
            f"%%MatrixMarket matrix coordinate real {'symmetric' if symmetric else 'general'}",
            f"% {letter}: {MEANING[letter]}, SI units",
            f"% rows: {_names(rig.model.coordinates)}",
            f"% columns: {_names(across)}",
            f"{matrix.shape[0]} {matrix.shape[1]} {len(rows)}",
            *(f"{i + 1} {j + 1} {float(kept[i, j])!r}" for i, j in zip(rows, columns, strict=True)),
        ]
        texts[letter] = "\n".join(lines) + "\n"
    return texts


def _names(names: tuple[str, ...]) -> str:
    """Names on one line of a comment, which may not be long."""
    text = ", ".join(map(_comment, names))
    return text if len(text) <= 900 else text[:900] + " …"


def _comment(text: str) -> str:
    """Text on one line."""
    return " ".join(text.split())


COLUMNS = ("parameter", "kind", "value", "sd", "low95", "high95", "unit", "known", "between")


@dataclass(frozen=True)
class ExportedParameter:
    """One parameter: element or inner constant of a law; value, sd and 95 % interval in `unit`; what it joins."""

    name: str
    kind: str
    value: float
    sd: float
    low95: float
    high95: float
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
        ends = None if root is None else sorted(tie.times * end for end in root.interval95)
        terms = []
        for name, factor in element.along.items():
            size = "" if abs(factor) == 1 else f"{abs(factor):g} "
            terms.append(f"{'-' if factor < 0 else '+'} {size}{name}")
        joined = " ".join(terms).removeprefix("+ ")
        known, unit = not np.any(model.T[i]), model.unit(element)
        low, high = _interval(value, sd) if ends is None else ends
        rows.append(
            ExportedParameter(element.name, str(element.kind), value, sd, low, high, unit, known, joined)
        )
    constants = model.inner_constants(rig.theta)
    slope, _ = model.constants_map
    for k, (element, constant) in enumerate(model.constants):
        name, value = f"{element.name}.{constant.name}", float(constants[k])
        sd = float(np.abs(slope[k]) @ sd_theta)
        estimated = of_unknowns.get(name)
        low, high = _interval(value, sd) if estimated is None else estimated.interval95
        known, unit = not constant.unknown, model.constant_unit(element, constant)
        rows.append(ExportedParameter(name, "constant", value, sd, low, high, unit, known, element.name))
    return rows


def _interval(value: float, sd: float) -> tuple[float, float]:
    normal95 = 1.959963984540054  # quantile of the normal distribution
    return value - normal95 * sd, value + normal95 * sd


def write_parameters(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Write a row for each parameter (COLUMNS), or by the ending `matlab_script`.

    Parquet holds the covariance of the unknowns as JSON in its metadata (`covariance`, `order`).  Raises DataError
    where the file cannot be written.
    """
    rows, ending = exported_parameters(rig), Path(path).suffix.lower()
    if ending == ".m":
        write_text(path, matlab_script(rig, rows))
        return Written((path,))
    columns = dict(zip(COLUMNS, map(list, zip(*map(astuple, rows), strict=True)), strict=True))
    if ending == ".parquet":
        import pyarrow.parquet as pq

        metadata = {"model": rig.model.name, "order": to_json(list(rig.names))}
        metadata["covariance"] = to_json(rig.covariance.tolist())
        sink = pa.BufferOutputStream()
        pq.write_table(pa.table(columns).replace_schema_metadata(metadata), sink)
        write_bytes(path, sink.getvalue().to_pybytes())
    else:
        numeric = ("value", "sd", "low95", "high95")
        cells = [np.array(c, dtype=float) if n in numeric else list(map(str, c)) for n, c in columns.items()]
        write_rows(path, COLUMNS, cells)
    return Written((path,))


def matlab_script(rig: IdentifiedRig, rows: Sequence[ExportedParameter]) -> str:
    """A MATLAB script: a variable for each parameter, for the fields of Simscape blocks, and their covariance.

    Names that MATLAB does not take are changed, with the name in the rig file next to them.
    """
    lines = [f"% {_comment(rig.model.name or 'Rig')}: parameters in SI units, by dashpot"]
    for row, variable in zip(rows, matlab_names([row.name for row in rows]), strict=True):
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
    return "\n".join(lines) + "\n"


def matlab_names(names: Sequence[str]) -> list[str]:
    """Each name as a variable of MATLAB (and Python): letters, digits, _, at most 63, all different."""
    words = [
        "case",
        "catch",
        "classdef",
        "end",
        "function",
        "otherwise",
        "parfor",
        "persistent",
        "spmd",
        "switch",
    ]
    variables = []
    for name in names:
        variable = re.sub(r"[^A-Za-z0-9_]", "_", name)[:60]
        if not re.match(r"[A-Za-z]", variable) or variable in words or keyword.iskeyword(variable):
            variable = f"p_{variable}"
        variables.append(variable)
    return distinct(variables, taken=("parameter_names", "parameter_covariance"))
