"""What validate and identify share where records are held out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dashpot.io.json_document import to_json

if TYPE_CHECKING:
    from dashpot.check.validation import RecordPrediction
    from dashpot.estimate.assessment import Finding
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
        if os.path.isfile(candidate):  # False, too, of a name too long for a file
            return estimate, read_rig(str(candidate))
    raise UsageError(f"the rig file {estimate.rig} that {path} names is not there", cure="give it with --rig")


@dataclass(frozen=True)
class Validated:
    """What an estimate predicts of data, and what may be wrong with them where that is little."""

    predictions: tuple[RecordPrediction, ...]
    findings: tuple[Finding, ...] = ()


def predictions_of(
    rig: Rig,
    estimate: Estimate,
    paths: Sequence[str],
    conditioning: Mapping[str, Any],
    quiet: bool,
    *,
    part: tuple[float, float] = (0.0, 1.0),
) -> tuple[RecordPrediction, ...]:
    """What an estimate predicts of data files, or of a part of each record; raises DataError."""
    return validated(rig, estimate, paths, conditioning, quiet, part=part, diagnosed=False).predictions


def validated(
    rig: Rig, estimate: Estimate, paths: Sequence[str], conditioning: Mapping[str, Any], quiet: bool, *,
    part: tuple[float, float] = (0.0, 1.0), diagnosed: bool = True,
) -> Validated:  # fmt: skip
    """The predictions of data files, or of a part of each record, and why they are bad; raises DataError."""
    from dashpot.app.data_files import (
        conditioning_from,
        measured_data,
        part_of,
        read_files,
        with_noise_record,
    )
    from dashpot.app.progress import progress
    from dashpot.check.diagnosis.prediction_mistakes import mistakes_in_lines, mistakes_in_records
    from dashpot.check.validation import missed, validate, validate_records

    reading = read_files(rig, paths, conditioning, quiet)
    if len(rig.model.nonlinear) and reading.continuous:
        still = with_noise_record(conditioning_from(conditioning), rig, conditioning, quiet).still
        records = part_of(reading, part).records
        with progress("validate", quiet):
            predictions = validate_records(rig.model, estimate, records, still)
            wrong = diagnosed and missed(predictions)
            return Validated(predictions, mistakes_in_records(rig.model, estimate, records) if wrong else ())
    spectrum = measured_data(rig, reading, conditioning, quiet, part=part).spectrum
    with progress("validate", quiet):
        predictions = validate(rig.model, estimate, spectrum)
        wrong = diagnosed and missed(predictions)
        return Validated(predictions, mistakes_in_lines(rig.model, estimate, spectrum) if wrong else ())


def figures_of(predictions: Sequence[RecordPrediction], findings: Sequence[Finding] = ()) -> str:
    """FIT, rms error (of records, SI units), χ² and degrees of freedom of every channel, and causes, as JSON."""
    rows = [
        {
            "duration_s": part.duration_s,
            "samples": part.samples,
            "channels": {
                name: {
                    "fit_percent": 100 * part.fit[c],
                    "rms_error": rms_error,
                    "chi2": part.chi2[c],
                    "dof": int(part.dof[c]),
                }
                for c, (name, rms_error) in enumerate(zip(part.channels, part.rms_error, strict=True))
            },
        }
        for part in predictions
    ]
    return to_json({"records": rows, "diagnosis": [finding.content() for finding in findings]})
