"""Columns as what a rig's channels measured: records of samples, complex amplitudes, or frequency responses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from dashpot.channel import Channel
from dashpot.data.clocks import ClockedRecords
from dashpot.data.readers.amplitudes import amplitude_columns, phase_notices, read_amplitudes, read_frf
from dashpot.data.readers.columns import Columns, bare
from dashpot.data.readers.records import Circumstances, read_records
from dashpot.data.readers.responses import Response, is_response, read_response
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.notices import Notice


@dataclass(frozen=True)
class Interpreted:
    """Records, lines that were amplitudes already, notes, records of sensors with times of their own, and responses.

    responses: of files with one each, which are still to be joined
    """

    records: tuple[Record, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    notes: tuple[Notice, ...] = ()
    joint: tuple[ClockedRecords, ...] = ()
    responses: tuple[Response, ...] = ()

    def __add__(self, other: Interpreted) -> Interpreted:
        return Interpreted(
            (*self.records, *other.records),
            (*self.spectra, *other.spectra),
            (*self.notes, *other.notes),
            (*self.joint, *other.joint),
            (*self.responses, *other.responses),
        )


def interpret_parts(
    parts: Iterable[Columns], channels: Sequence[Channel], circumstances: Circumstances
) -> Interpreted:
    """All parts of a file that hold any of the channels; the first, where none does.

    Raises DataError as `interpret`.
    """
    total, first = Interpreted(), None
    for part in parts:
        first = part if first is None else first
        # Whether a column belongs to one of the channels
        names = {name for column in part.header for name in (column, bare(column)[0])} | {*part.names}
        stems = {name.rpartition("_")[0].split("/")[0] for name in names}
        if any(channel.name in names | stems for channel in channels):
            total += interpret(part, channels, circumstances)
    if not (total.records or total.spectra or total.responses) and first is not None:
        return interpret(first, channels, circumstances)
    return total


def interpret(columns: Columns, channels: Sequence[Channel], circumstances: Circumstances) -> Interpreted:
    """What the columns are is told by their names.

    Raises DataError, one line per cause, with file, row and column.
    """
    found = amplitude_columns(columns)
    if not found and is_response(columns):
        response, notes = read_response(columns, channels)
        return Interpreted(notes=tuple(notes), responses=(response,))
    if found:
        reader = read_frf if any("/" in name for name in found) else read_amplitudes
        lines, notes = reader(columns, found, channels, circumstances.experiment, circumstances.named)
        notes += phase_notices(columns, found, lines.frequency_hz)
        return Interpreted((), (lines,), tuple(notes))
    records, notes = read_records(columns, channels, circumstances)
    return Interpreted(tuple(records), (), tuple(notes))
