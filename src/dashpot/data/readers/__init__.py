"""Readers: one module per file format, and `read`, which tells the formats apart by their columns."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum as amplitudes_of
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.readers.delimited.amplitudes import is_amplitudes, read_amplitudes, write_amplitudes
from dashpot.data.readers.delimited.frf import is_frf, read_frf
from dashpot.data.readers.delimited.lvm import is_lvm, open_lvm
from dashpot.data.readers.delimited.stepped_sine import read_records, write_records
from dashpot.data.readers.delimited.table import open_table
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.notices import Notice

__all__ = ["Reading", "read", "write_amplitudes", "write_records"]


@dataclass(frozen=True)
class Reading:
    """What the files hold: time records, lines that were amplitudes already (None: no such file), and what to tell."""

    records: tuple[Record, ...]
    amplitudes: Spectrum | None
    notes: tuple[Notice, ...]

    def spectrum(
        self, conditioning: Conditioning | None = None, **treatments: Unpack[Treatments]
    ) -> Spectrum:
        """All lines: those of the records, then those that were amplitudes.

        `conditioning`, or its fields as keywords, says how records become amplitudes.
        Raises DataError where second moments are asked for and a file holds amplitudes only.
        """
        settings = conditioning_of(conditioning, treatments)
        if settings.moments and self.amplitudes is not None:
            raise DataError(
                "a table of amplitudes has no samples",
                cure="give time records, or choose a method that works on amplitudes",
            )
        parts = [] if self.amplitudes is None else [self.amplitudes]
        if self.records:
            parts.insert(0, amplitudes_of(self.records, settings))
        return parts[0] if len(parts) == 1 else concatenate(parts)


def read(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    channels: Sequence[Channel],
    *,
    frequency_hz: float | None = None,
) -> Reading:
    """Read files of any known format, told apart by their columns.

    `frequency_hz` is the drive frequency of time records without such a column.  Files without an `experiment` column
    are experiments 0, 1, 2, … in the order given.  Raises DataError, one line per cause, with file, row and column.
    """
    several = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not several:
        raise DataError("there are no data", cure="give one file at least")
    if not channels:
        raise DataError(
            "no channels are listed", cure="say in [channels] of the rig file what the columns are"
        )
    if frequency_hz is not None and not 0 < frequency_hz < 1e12:
        raise DataError(f"frequency {frequency_hz:g} Hz", cure="frequencies must be positive and finite")
    records: list[Record] = []
    spectra: list[Spectrum] = []
    notes: list[Notice] = []
    for number, path in enumerate(several):
        table = open_table(path)
        if is_lvm(table):
            table = open_lvm(path)
        if is_frf(table):
            lines, told = read_frf(table, channels, number)
            spectra.append(lines)
        elif is_amplitudes(table):
            lines, told = read_amplitudes(table, channels, number)
            spectra.append(lines)
        else:
            dwells, told = read_records(table, channels, frequency_hz, number)
            records.extend(dwells)
        notes.extend(told)
    return Reading(tuple(records), concatenate(spectra) if spectra else None, tuple(notes))
