"""What validate and identify share where records are held out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dashpot.io.json_document import to_json

if TYPE_CHECKING:
    from dashpot.check.validation import RecordPrediction
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig


def estimate_and_rig(path: str, rig: str | None) -> tuple[Estimate, Rig]:
    """An estimate with the rig it was made of: the one given, else the file that the estimate names.

    Raises DataError or UsageError.
    """
    from dashpot.errors import UsageError
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import read_rig

    estimate = Estimate.load(path)
    if rig is not None:
        return estimate, read_rig(rig)
    if estimate.rig is None:
        raise UsageError(f"{path} does not name its rig file", cure="give it with --rig")
    for candidate in (Path(estimate.rig), Path(path).parent / estimate.rig):
        if candidate.is_file():
            return estimate, read_rig(str(candidate))
    raise UsageError(f"the rig file {estimate.rig} that {path} names is not there", cure="give it with --rig")


def figures_of(predictions: Sequence[RecordPrediction]) -> str:
    """FIT, χ² and degrees of freedom of every channel as JSON."""
    rows = [
        {
            "duration_s": part.duration_s,
            "samples": part.samples,
            "channels": {
                name: {
                    "fit_percent": 100 * part.fit[c],
                    "chi2": part.chi2[c],
                    "dof": int(part.dof[c]),
                }
                for c, name in enumerate(part.channels)
            },
        }
        for part in predictions
    ]
    return to_json({"records": rows})
