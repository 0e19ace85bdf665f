"""Matrices of a rig as Matrix Market files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.io.atomic import write_text
from dashpot.model.dynamics import matrices

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
