"""MATLAB files: version 5 to 7.2 by SciPy, 7.3 as the HDF5 that it is."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from dashpot.data.readers.array_columns import ArrayColumns
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.matlab_layout import check_layout
from dashpot.data.readers.matlab_vectors import long_vectors
from dashpot.data.readers.optional import damaged
from dashpot.data.readers.variables import parts_of_variables
from dashpot.errors import DataError

DEEPEST = 8  # structures inside structures


@dataclass(frozen=True)
class MatlabReader:
    """MATLAB files before 7.3; fields of structures are STRUCT.FIELD, or FIELD where one structure is all there is."""

    format: str = "MATLAB"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """The first bytes say so."""
        return file.head.startswith(b"MATLAB 5.0 MAT-file")

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """The variables; elements of an array of structures are parts of their own.

        Raises DataError where the file cannot be read.
        """
        from scipy.io import loadmat

        data = file.contents
        check_layout(data, file.name)
        with damaged(file.name, self.format):
            long = long_vectors(file, data)
        with damaged(file.name, self.format), warnings.catch_warnings(), file.reading() as stream:
            warnings.simplefilter("ignore")  # of objects that only MATLAB can read
            content: dict[str, Any] = loadmat(
                cast(Any, stream),
                variable_names=long.others,
                squeeze_me=False,
                struct_as_record=False,
                verify_compressed_data_integrity=True,
            )
        variables: dict[str, Any] = {**long.vectors}
        series: list[tuple[str, dict[str, Any]]] = []
        named = {name: value for name, value in content.items() if not name.startswith("__")}
        alone = (
            not variables and sum(np.size(value) > 1 or _is_structure(value) for value in named.values()) == 1
        )
        for name, value in named.items():
            if alone and _is_structure(value):  # as an array of one
                series.append((name, _fields(value.item(), 0)))
            else:
                _flatten(name, value, variables, series)
        for name, fields in series:
            yield from parts_of_variables(f"{file.name} ({name})", {**variables, **fields})
        if series and not any(np.size(value) > 1 for value in variables.values()):
            return
        if not variables:
            raise DataError("there are no variables of numbers", file.name, "save the channels as arrays")
        yield from parts_of_variables(file.name, variables)


def _is_structure(value: Any) -> bool:
    """Whether this is one structure."""
    return (
        np.size(value) == 1 and np.asarray(value).dtype.kind == "O" and hasattr(value.item(), "_fieldnames")
    )


def _fields(structure: Any, depth: int) -> dict[str, Any]:
    """The fields of a structure under their names."""
    fields: dict[str, Any] = {}
    for field in structure._fieldnames:
        _flatten(field, getattr(structure, field), fields, [], depth + 1)
    return fields


def _flatten(
    name: str, value: Any, variables: dict[str, Any], series: list[tuple[str, dict[str, Any]]], depth: int = 0
) -> None:
    """Put a variable under its name, and the fields of structures under theirs."""
    array = np.asarray(value)
    if array.dtype.kind in "fiubc":
        variables[name] = array
        return
    if array.dtype.kind != "O" or depth > DEEPEST:
        return
    structures = [item for item in array.ravel().tolist() if hasattr(item, "_fieldnames")]
    if len(structures) == 1 and array.size == 1:
        for field in structures[0]._fieldnames:
            inner = getattr(structures[0], field)
            _flatten(f"{name}.{field}", inner, variables, series, depth + 1)
    elif structures and len(structures) == array.size:
        for k, item in enumerate(structures):
            series.append((f"{name}({k + 1})", _fields(item, depth)))
