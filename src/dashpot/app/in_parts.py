"""Data sets that workers read and identify: how they are treated, and one rig's merged into one estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dashpot.errors import UsageError

if TYPE_CHECKING:
    from dashpot.estimate.result import Estimate
    from dashpot.fleet.treatment import Treatment
    from dashpot.model.rigfile import Rig


def treatment_from(
    rig: Rig, chosen: str, positive: bool, seed: int, options: Mapping[str, Any], quiet: bool
) -> Treatment:
    """How every data set is treated, from the options of `conditioning_options` and of the estimator.

    Raises UsageError where the method holds no bounds, DataError for a noise record that cannot be used.
    """
    from dashpot.app.data_files import conditioning_from, with_noise_record
    from dashpot.app.parameters import require_bounds_held
    from dashpot.fleet.treatment import Treatment

    if positive:
        require_bounds_held(chosen)
    settings = with_noise_record(conditioning_from(options), rig, options, quiet)
    method = None if chosen == "auto" else chosen
    return Treatment(method, settings, options["frequency"], positive, seed)


def estimate_in_parts(
    path: str,
    rig: Rig,
    data: Sequence[str],
    treatment: Treatment,
    workers: int | None,
    dask: str | None,
    quiet: bool,
) -> Estimate:
    """The merged estimate of all files, shared out to worker processes or a cluster.

    Raises UsageError for nonlinear rigs and files given twice, and what `identify_in_parts` raises.
    """
    from dataclasses import replace

    from dashpot.app.cluster import shared_out
    from dashpot.app.data_files import require_each_once, tell_notes
    from dashpot.app.progress import progress
    from dashpot.fleet.record_parts import identify_in_parts
    from dashpot.io.ledger import noted

    if len(rig.model.nonlinear):
        raise UsageError(
            "parts can be merged for linear rigs only",
            "--in-parts",
            "identify some of the files together, without it",
        )
    require_each_once(data)
    files = [noted(name) for name in data]
    with shared_out(dask, workers, len(files) == 1) as mapper, progress("identify", quiet) as moved:
        estimate = identify_in_parts(rig, files, treatment, mapper=mapper, progress=moved)
    tell_notes(estimate.notes, quiet)
    return replace(estimate, rig=path)


def require_in_parts(in_parts: bool, sharing: Mapping[str, bool], whole: Mapping[str, bool]) -> None:
    """Raises UsageError for options given that need --in-parts (`sharing`), or that it cannot serve (`whole`)."""
    wrong = next((name for name, given in (whole if in_parts else sharing).items() if given), None)
    if wrong is None:
        return
    if in_parts:
        raise UsageError(
            f"{wrong} needs all data at once, and --in-parts never has them",
            cure="identify one file, without it",
        )
    raise UsageError(f"{wrong} shares out the parts of --in-parts", cure="give that too, or leave it out")
