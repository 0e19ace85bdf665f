"""What identify does with rigs that have nonlinear elements: harmonics of dwells, or whole records by integration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dashpot.data.readers import Reading
    from dashpot.data.record import Record
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

HIGHEST = 5  # harmonics that carry information, as far as the sampling shows them
USABLE = 0.45  # of the sampling rate


def whole_record_estimate(
    rig: Rig, paths: Sequence[str], options: Mapping[str, Any], chosen: str, quiet: bool
) -> Estimate | None:
    """The estimate from continuous records of a nonlinear rig; None where the data are dwells or amplitudes.

    Raises DataError and UsageError.
    """
    from dashpot.app.progress import progress
    from dashpot.errors import UsageError
    from dashpot.estimate.nonlinear.whole_record import identify_records

    records = continuous_records(rig, paths, options, quiet)
    if records is None:
        return None
    if chosen not in ("auto", "ml"):
        raise UsageError(
            f"the method {chosen} does not know whole records of nonlinear rigs", cure="use the method ml"
        )
    with progress("identify", quiet) as moved:
        return identify_records(rig.model, records, progress=moved)


def continuous_records(
    rig: Rig, paths: Sequence[str], options: Mapping[str, Any], quiet: bool
) -> Sequence[Record] | None:
    """The records of the data, what was noticed of them told; None where the data are dwells or amplitudes."""
    from dashpot.app.data_files import tell_notes
    from dashpot.data.readers import read

    reading = read(paths, rig.channels, frequency_hz=options["frequency"])
    if not reading.records or any(record.frequency_hz is not None for record in reading.records):
        return None
    tell_notes(reading.notes, quiet)
    return reading.records


def usual_orders(rig: Rig, reading: Reading) -> tuple[int, ...]:
    """Multiples of the drive frequency that the dwells of a nonlinear rig are looked at, as far as they are sampled."""
    highest = HIGHEST if len(rig.model.nonlinear) else 1
    for record in reading.records:
        if record.frequency_hz is not None and len(record.time) > 1:
            rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
            highest = min(highest, int(USABLE * rate / record.frequency_hz))
            highest = min(highest, (len(record.time) - 4) // 3)
    return tuple(range(1, max(highest, 1) + 1))
