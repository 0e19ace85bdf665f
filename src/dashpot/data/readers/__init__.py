"""Readers: one module per file format, and `read`, which asks each whether a file is its own."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Unpack

from dashpot.channel import Channel, Experiment
from dashpot.data.clocks import ClockedRecords, clocked_lines
from dashpot.data.conditioning.lines import spectrum as amplitudes_of
from dashpot.data.conditioning.settings import Conditioning, Treatments, conditioning_of
from dashpot.data.noise import with_local_noise
from dashpot.data.readers.amplitudes import write_amplitudes
from dashpot.data.readers.datafile import DataFile, open_file
from dashpot.data.readers.interpretation import Experiments, Interpreted, interpret_parts
from dashpot.data.readers.manifest import (
    is_manifest,
    is_pattern,
    manifest_of_pattern,
    read_group,
    read_manifest,
)
from dashpot.data.readers.records import Circumstances, write_records
from dashpot.data.readers.registry import reader_of
from dashpot.data.readers.responses import Response
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.io.words import counted
from dashpot.notices import Notice

__all__ = ["Reading", "read", "write_amplitudes", "write_records"]


@dataclass(frozen=True)
class Reading:
    """The contents of data files.

    records       time records, in the order of the files
    amplitudes    lines of files that hold amplitudes; None if there are none
    notes         notices of the readers
    joint         records of sensors with their own sample times
    conditioning  conditioning stated in a manifest; fields of Conditioning
    """

    records: tuple[Record, ...]
    amplitudes: Spectrum | None
    notes: tuple[Notice, ...]
    joint: tuple[ClockedRecords, ...] = ()
    conditioning: Treatments = field(default_factory=lambda: Treatments())

    def __repr__(self) -> str:
        """One line: how many records and lines there are, and their channels."""
        held = [counted(len(self.records) + len(self.joint), "record")]
        if self.amplitudes is not None:
            held.append(counted(self.amplitudes.lines, "line"))
        owner = self.records[0] if self.records else self.amplitudes
        names = "" if owner is None else f" of {', '.join(channel.name for channel in owner.channels)}"
        return f"<Reading: {', '.join(held)}{names}>"

    @property
    def continuous(self) -> bool:
        """Whether there are records and none has a drive frequency, so that each is continuous."""
        return bool(self.records) and all(record.frequency_hz is None for record in self.records)

    def spectrum(
        self, conditioning: Conditioning | None = None, **treatments: Unpack[Treatments]
    ) -> Spectrum:
        """All lines: those of the records, then those of files that hold amplitudes.

        `conditioning`, or its fields as keywords, sets how records are turned into amplitudes.
        Raises DataError if second moments are requested and a file holds amplitudes only.
        """
        usual = Conditioning(**self.conditioning) if conditioning is None else conditioning
        settings = conditioning_of(usual, treatments)
        if settings.moments is True and self.amplitudes is not None:
            raise DataError(
                "a table of amplitudes has no samples",
                cure="give time records, or choose a method that works on amplitudes",
            )
        parts = [] if self.amplitudes is None else [with_local_noise(self.amplitudes)]
        parts[:0] = [clocked_lines(joint, settings) for joint in self.joint]
        if self.records:
            parts.insert(0, amplitudes_of(self.records, settings))
        return parts[0] if len(parts) == 1 else concatenate(parts)


def read(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    channels: Sequence[Channel],
    *,
    frequency_hz: float | None = None,
    experiments: Sequence[Experiment] = (),
) -> Reading:
    """Read files of any known format, manifests of tests (.toml), and patterns such as {frequency}Hz_*.lvm.

    `frequency_hz` is the drive frequency of time records without such a column.  Files without an `experiment` column
    are experiments 0, 1, 2, … in the order given; `experiments` are those of the rig file, which files and rows may be
    of.  Raises DataError, one line per cause, with file, row and column.
    """
    several = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not several:
        raise DataError("there are no data", cure="give at least one file")
    if not channels:
        raise DataError("no channels are listed", cure="list the columns under [channels] in the rig file")
    if frequency_hz is not None and not 0 < frequency_hz < 1e12:
        raise DataError(f"frequency {frequency_hz:g} Hz", cure="frequencies must be positive and finite")
    total, treatments = Interpreted(), Treatments()
    alone: dict[int, tuple[int, list[Response]]] = {}  # by experiment, with the number of its first file
    by = Experiments(tuple(channels), tuple(experiments))
    for number, path in enumerate(several):
        if is_manifest(path) or is_pattern(path):
            manifest = read_manifest(path) if is_manifest(path) else manifest_of_pattern(path, number)
            treatments.update(manifest.conditioning)
            for group in manifest.groups:
                if isinstance(group.entry.experiment, str):
                    kind = by.number(group.entry.experiment, group.place)
                else:
                    kind = max(by.of_file(path.as_posix()) for path in group.paths.values())
                total += by.content(partial(read_group, group, frequency_hz, by.names), kind)
        else:
            file, circumstances = open_file(path), Circumstances(frequency_hz, number, named=by.names)
            kind = by.of_file(os.fspath(path))
            found = by.content(partial(_content, file, circumstances), kind)
            if found.responses:
                alone.setdefault(kind, (number, []))[1].extend(found.responses)
            total += found
    spectra = list(total.spectra)
    for kind, (first, responses) in alone.items():
        spectra += by.joined(responses, kind, first)
    amplitudes = concatenate(spectra) if spectra else None
    return Reading(total.records, amplitudes, total.notes, total.joint, treatments)


def _content(file: DataFile, circumstances: Circumstances, channels: Sequence[Channel]) -> Interpreted:
    """What one file holds of the channels."""
    return interpret_parts(reader_of(file).parts(file), channels, circumstances)
