"""Which formats a rig can be exported to, by the end of a file's name or by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.data.readers.delimited.writing import write_rows
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.export.fmu.archive import write_fmu
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.matrix_market import write_matrix_market
from dashpot.export.mujoco import mujoco_model
from dashpot.export.parameter_tables import (
    write_matlab_parameters,
    write_parameter_csv,
    write_parameter_parquet,
)
from dashpot.export.state_space import state_space_of
from dashpot.export.transfer_functions import frequency_response_table, transfer_functions_of
from dashpot.export.universal_file import write_rig_universal_file
from dashpot.io.atomic import write_bytes, write_text


@dataclass(frozen=True)
class ExportOptions:
    """What formats may ask for beside the rig.

    given         as what displacement inputs are given (`state_space_of`)
    frequency_hz  (lines,) of frequency responses; those of `data` without it
    data          measured amplitudes, of which frequency responses are written
    compiled      whether an FMU gets a binary where a compiler is found
    """

    given: str | Mapping[str, str] | None = None
    frequency_hz: Real | None = None
    data: Spectrum | None = None
    compiled: bool = True


IN_WORDS = {"given": "quantities of inputs", "frequency_hz": "frequencies", "data": "measured data"}


@dataclass(frozen=True)
class ExportFormat:
    """One kind of content in one kind of file.

    `write` returns the names of the files, and what to tell of them; `takes` names the options that it looks at.
    """

    content: str
    suffixes: tuple[str, ...]
    write: Callable[[IdentifiedRig, str, ExportOptions], Written]
    takes: tuple[str, ...] = ()

    def require_use(self, path: str, given: Iterable[str]) -> None:
        """Raises UsageError where it does not look at one of the options that are given."""
        for name in given:
            if name not in self.takes:
                cause = f"an export of {self.content} has no use for {IN_WORDS[name]}"
                raise UsageError(cause, path, "leave them out")


@dataclass(frozen=True)
class Written:
    """Files that an export has written, and whether an FMU holds a binary (None: it is none)."""

    paths: tuple[str, ...]
    compiled: bool | None = None


def export_rig(
    rig: IdentifiedRig,
    path: str | os.PathLike[str],
    content: str | None = None,
    options: ExportOptions | None = None,
) -> Written:
    """Write a rig in the format that the end of the file's name tells, or the first with that end and `content`.

    Raises UsageError where there is no such format or it has no use for an option, ModelError where it cannot hold
    the rig, DataError where the file cannot be written.
    """
    target = os.fspath(path)
    chosen = format_of(target, content)
    options = ExportOptions() if options is None else options
    chosen.require_use(target, [name for name in IN_WORDS if getattr(options, name) is not None])
    return chosen.write(rig, target, options)


def format_of(path: str, content: str | None = None) -> ExportFormat:
    """The format of a file to be written.  Raises UsageError where there is none."""
    suffix = Path(path).suffix.lower()
    fitting = [each for each in FORMATS if suffix in each.suffixes]
    if content is not None:
        of_content = [each for each in FORMATS if each.content == content]
        if not of_content:
            raise UsageError(f"nothing is exported as {content}", cure=f"there are {', '.join(contents())}")
        fitting = [each for each in of_content if suffix in each.suffixes]
        if not fitting:
            ends = sorted({end for each in of_content for end in each.suffixes})
            raise UsageError(
                f"{content} is not written to {suffix or 'this'} files", path, f"use {', '.join(ends)}"
            )
    if not fitting:
        ends = sorted({end for each in FORMATS for end in each.suffixes})
        cause = (
            f"no export has the extension {suffix}"
            if suffix
            else "the name has no extension to tell the format"
        )
        raise UsageError(cause, path, f"use {', '.join(ends)}")
    return fitting[0]


def contents() -> tuple[str, ...]:
    """Names of what can be exported."""
    return tuple(dict.fromkeys(each.content for each in FORMATS))


def _frequencies(options: ExportOptions) -> Real:
    if options.frequency_hz is not None:
        return np.asarray(options.frequency_hz, dtype=float)
    if options.data is None:
        raise UsageError(
            "frequency responses need frequencies", cure="give frequencies, or data that have some"
        )
    return np.unique(options.data.frequency_hz)


def _state_space_json(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write_text(path, state_space_of(rig, options.given).to_json())
    return Written((path,))


def _state_space_mat(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write_bytes(path, state_space_of(rig, options.given).to_mat())
    return Written((path,))


def _transfer_functions(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write_text(path, transfer_functions_of(state_space_of(rig, options.given)).to_json())
    return Written((path,))


def _frequency_responses(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    header, columns = frequency_response_table(rig, _frequencies(options))
    write_rows(path, header, columns)
    return Written((path,))


def _universal_file(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write_rig_universal_file(rig, path, options.frequency_hz, options.data)
    return Written((path,))


def _fmu(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    return Written((path,), write_fmu(rig, path, options.given, compiled=options.compiled))


def _mujoco(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write_text(path, mujoco_model(rig))
    return Written((path,))


def _matrices(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    return Written(tuple(write_matrix_market(rig, path)))


def _parameters(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    write = {".parquet": write_parameter_parquet, ".m": write_matlab_parameters}
    write.get(Path(path).suffix.lower(), write_parameter_csv)(rig, path)
    return Written((path,))


# The first with an ending is what it means without more words.
FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat("state-space", (".json",), _state_space_json, ("given",)),
    ExportFormat("state-space", (".mat",), _state_space_mat, ("given",)),
    ExportFormat("transfer-functions", (".json",), _transfer_functions, ("given",)),
    ExportFormat("parameters", (".csv", ".parquet", ".m"), _parameters),
    ExportFormat("frequency-responses", (".csv",), _frequency_responses, ("frequency_hz", "data")),
    ExportFormat("matrices", (".mtx",), _matrices),
    ExportFormat("universal-file", (".uff", ".unv"), _universal_file, ("frequency_hz", "data")),
    ExportFormat("fmu", (".fmu",), _fmu, ("given",)),
    ExportFormat("mujoco", (".xml",), _mujoco),
)
