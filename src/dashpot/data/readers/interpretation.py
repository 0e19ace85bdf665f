"""Columns as what a rig's channels measured: records of samples, complex amplitudes, or frequency responses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from dashpot.channel import RUNS, Channel, Experiment, channels_of, numbered
from dashpot.data.clocks import ClockedRecords
from dashpot.data.readers.amplitudes import amplitude_columns, phase_notices, read_amplitudes
from dashpot.data.readers.columns import Columns, bare
from dashpot.data.readers.records import Circumstances, read_records
from dashpot.data.readers.responses import Response, is_response, joined_responses, read_frf, read_response
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.io.words import did_you_mean, listed, quoted, shown
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
        if any("/" in name for name in found):
            lines, notes = read_frf(columns, found, channels, circumstances.experiment)
        else:
            lines, notes = read_amplitudes(
                columns, found, channels, circumstances.experiment, circumstances.named
            )
        notes += phase_notices(columns, found, lines.frequency_hz)
        return Interpreted((), (lines,), tuple(notes))
    records, notes = read_records(columns, channels, circumstances)
    return Interpreted(tuple(records), (), tuple(notes))


# Which experiment of the rig file the data are of, by the names of their files or by what they say themselves.


Read = Callable[[Sequence[Channel]], Interpreted]


@dataclass(frozen=True)
class Experiments:
    """The channels of a rig, and its experiments, in which they may be calibrated otherwise."""

    channels: tuple[Channel, ...]
    declared: tuple[Experiment, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the experiments."""
        return tuple(each.name for each in self.declared)

    def of_file(self, path: str) -> int:
        """Number from 1 of the experiment whose pattern a file's name fits, 0 of none.

        Raises DataError where it fits those of two.
        """
        name = PurePath(path)
        fitting = [k for k, each in enumerate(self.declared, 1) if any(name.match(p) for p in each.data)]
        if len(fitting) > 1:
            both = listed(self.names[k - 1] for k in fitting)
            raise DataError(
                f"the file fits the patterns of the experiments {both}", path, "make one of them narrower"
            )
        return fitting[0] if fitting else 0

    def number(self, name: str, place: str) -> int:
        """Number from 1 of an experiment by name.  Raises DataError where the rig file has none of that name."""
        if name in self.names:
            return self.names.index(name) + 1
        cure = f"{did_you_mean(name, self.names)}the rig file has {listed(self.names)}"
        if not self.declared:
            cure = f"declare it in the rig file: [experiments.{name}]; or number the runs 0, 1, 2, …"
        raise DataError(f"{quoted(shown(name, 60))} is not an experiment of the rig file", place, cure)

    def named(self, kind: int) -> tuple[Channel, ...]:
        """The channels that there are in an experiment by number, under their own names."""
        together = (*self.channels, *(channel for each in self.declared for channel in each.channels))
        return channels_of(together, self.names[kind - 1] if kind else None)

    def content(self, read: Read, kind: int = 0) -> Interpreted:
        """What a file holds, of an experiment by number; 0: of those that its rows name.

        `read` reads it as some channels, in the order given.
        """
        if not self.declared:
            return read(self.channels)
        if kind:
            return self._as(read, kind, alone=False)
        found = read(self.channels)
        kinds = {record.experiment // RUNS for record in found.records}
        kinds |= {int(k) for spectrum in found.spectra for k in spectrum.experiment // RUNS}
        if kinds <= {0}:
            return found
        total = Interpreted(notes=found.notes, joint=found.joint)
        for each in sorted(kinds):
            total += replace(self._as(read, each, alone=True), notes=(), joint=())
        return total

    def joined(self, responses: Sequence[Response], kind: int, first: int) -> Iterator[Spectrum]:
        """The spectra of single responses in an experiment by number, 0 of none; runs are numbered from `first` on."""
        own = self.named(kind)
        for spectrum in joined_responses(responses, [replace(c, name=c.column) for c in own], first):
            yield _lines_of(spectrum, own, kind)

    def _as(self, read: Read, kind: int, alone: bool) -> Interpreted:
        """Content read by the channels of one experiment: all of it, or what names this one."""
        own = self.named(kind)
        found = read(tuple(replace(channel, name=channel.column) for channel in own))
        records, spectra = list(found.records), list(found.spectra)
        if alone:
            records = [record for record in records if record.experiment // RUNS == kind]
            spectra = [s.select(np.flatnonzero(s.experiment // RUNS == kind)) for s in spectra]
        joint = [
            replace(each, parts=tuple(of_experiment(part, own, kind) for part in each.parts))
            for each in found.joint
        ]
        return replace(
            found,
            records=tuple(of_experiment(record, own, kind) for record in records),
            spectra=tuple(_lines_of(spectrum, own, kind) for spectrum in spectra if spectrum.lines),
            joint=tuple(joint),
        )


def of_experiment(record: Record, channels: Sequence[Channel], kind: int) -> Record:
    """The record as one of an experiment by number, whose `channels` have the record's as columns."""
    by_column = {channel.column: channel for channel in channels}
    own = tuple(by_column.get(channel.name, channel) for channel in record.channels)
    return replace(record, channels=own, experiment=numbered(kind, record.experiment))


def _lines_of(spectrum: Spectrum, channels: Sequence[Channel], kind: int) -> Spectrum:
    by_column = {channel.column: channel for channel in channels}
    own = tuple(by_column.get(channel.name, channel) for channel in spectrum.channels)
    experiment = kind * RUNS + spectrum.experiment % RUNS
    return replace(spectrum.with_channels(own), experiment=experiment)
