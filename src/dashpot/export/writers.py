"""The formats' writers as `formats` calls them: each writes an identified rig to a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.data.readers.text import write_rows
from dashpot.errors import UsageError
from dashpot.export.fmu.archive import write_fmu
from dashpot.export.formats import ExportOptions, Written
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.mujoco import mujoco_model
from dashpot.export.parameter_tables import (
    write_matlab_parameters,
    write_matrix_market,
    write_parameter_csv,
    write_parameter_parquet,
)
from dashpot.export.state_space import state_space_of
from dashpot.export.transfer_functions import frequency_response_table, transfer_functions_of
from dashpot.export.universal_file import write_rig_universal_file
from dashpot.io.atomic import write_bytes, write_text


def _frequencies(options: ExportOptions) -> Real:
    if options.frequency_hz is not None:
        return np.asarray(options.frequency_hz, dtype=float)
    if options.data is None:
        raise UsageError(
            "frequency responses need frequencies", cure="give frequencies, or data that have some"
        )
    return np.unique(options.data.frequency_hz)


def export_state_space_json(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """The state space as JSON."""
    write_text(path, state_space_of(rig, options.given).to_json())
    return Written((path,))


def export_state_space_mat(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """The state space as a MATLAB file."""
    write_bytes(path, state_space_of(rig, options.given).to_mat())
    return Written((path,))


def export_transfer_functions(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Transfer functions as JSON."""
    write_text(path, transfer_functions_of(state_space_of(rig, options.given)).to_json())
    return Written((path,))


def export_frequency_responses(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """A table of frequency responses.  Raises UsageError without frequencies."""
    header, columns = frequency_response_table(rig, _frequencies(options))
    write_rows(path, header, columns)
    return Written((path,))


def export_universal_file(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """Frequency responses and modes as a universal file."""
    write_rig_universal_file(rig, path, options.frequency_hz, options.data)
    return Written((path,))


def export_fmu(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """A functional mock-up unit."""
    return Written((path,), write_fmu(rig, path, options.given, compiled=options.compiled))


def export_mujoco(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """A model for MuJoCo."""
    write_text(path, mujoco_model(rig))
    return Written((path,))


def export_matrices(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """M, C, K … as Matrix Market files."""
    return Written(tuple(write_matrix_market(rig, path)))


def export_parameters(rig: IdentifiedRig, path: str, options: ExportOptions) -> Written:
    """A table of the parameters, by the ending."""
    write = {".parquet": write_parameter_parquet, ".m": write_matlab_parameters}
    write.get(Path(path).suffix.lower(), write_parameter_csv)(rig, path)
    return Written((path,))
