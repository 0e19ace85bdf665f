"""identify from a file of measured modes, which takes the place of test data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig


def modal_estimate(
    rig_path: str,
    data: tuple[str, ...],
    relative_sd: tuple[float, float, float],
    seed: int,
    quiet: bool,
    unsuited: Mapping[str, bool],
) -> tuple[Rig, Estimate] | None:
    """The rig and the estimate from a file of modes; None where the data are another thing.

    `unsuited` are options that need amplitudes, and whether they are given.  Raises UsageError for these, DataError.
    """
    from dataclasses import replace

    from dashpot.app.data_files import tell_notes
    from dashpot.data.readers.modal_files import holds_modes, modes_and_notes
    from dashpot.errors import UsageError

    if len(data) != 1 or not holds_modes(data[0]):
        return None
    from dashpot.app.progress import progress
    from dashpot.check.modal_verdict import examined_modes
    from dashpot.estimate.modal.identify_modal import identify_modal  # loads scipy.optimize
    from dashpot.model.rigfile import read_rig

    given = [name for name, is_given in unsuited.items() if is_given]
    if given:
        raise UsageError(
            f"{data[0]} holds modes, to which {given[0]} does not apply", cure=f"leave {given[0]} out"
        )
    rig = read_rig(rig_path)
    modes, notes = modes_and_notes(data[0], rig.model.coordinates, rig.channels, relative_sd)
    tell_notes(notes, quiet)
    estimate = identify_modal(rig.model, modes, seed=seed)
    with progress("examine", quiet):
        return rig, replace(examined_modes(rig.model, modes, estimate, seed=seed), rig=rig_path)
