"""Files of a manifest as records and spectra: columns chosen and renamed, sensors joined, periods averaged."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.channel import RESERVED_NAMES, Channel
from dashpot.data.clock_offset import Sensor
from dashpot.data.clocks import ClockedRecords, aligned_sensors, joined_sensors
from dashpot.data.periods import average_periods, one_period, samples_of_period
from dashpot.data.readers.columns import Columns, is_unit
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.delimited.stepped_sine import Circumstances, read_records
from dashpot.data.readers.interpretation import Interpreted, interpret
from dashpot.data.readers.manifest import FileGroup, line_numbers
from dashpot.data.readers.registry import reader_of
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.words import listed, shown
from dashpot.notices import Notice


def read_group(group: FileGroup, channels: Sequence[Channel], frequency_hz: float | None) -> Interpreted:
    """What one group of files holds.  `frequency_hz` serves where neither they nor their names say it.

    Raises DataError, one line, for what is missing or damaged in a file, or does not fit its entry.
    """
    driven = frequency_hz if group.frequency_hz is None else group.frequency_hz
    circumstances = Circumstances(driven, group.experiment, group.entry.rate_hz)
    if group.entry.sensors:
        interpreted = _joined(group, channels, circumstances)
    else:
        (path,) = group.paths.values()
        interpreted = Interpreted()
        for columns in _parts(group, path):
            chosen, named = _chosen(group, columns, group.entry.columns, channels)
            interpreted += interpret(chosen, named, circumstances)
    interpreted = _windowed(interpreted, group)
    if group.entry.lines is None:
        return interpreted
    return _averaged(interpreted, line_numbers(group.entry.lines, group.place), group)


def _parts(group: FileGroup, path: Path) -> Iterator[Columns]:
    """The parts of a file that the entry means: all that have its columns, or the one it names."""
    file = open_file(path)
    reader = reader_of(file)
    wanted, names = [], []
    columns = list(group.entry.columns.values())
    for number, part in enumerate(reader.parts(file)):
        names.append(part.source.removeprefix(file.name).strip(" :()"))
        if group.entry.part is not None:
            fits = group.entry.part in (names[-1], names[-1].rpartition("/")[2])
        else:
            fits = all(part.find(name) is not None for name in columns)
        if fits:
            wanted.append(number)
    if group.entry.part is not None and not wanted:
        what = f"there is no part {shown(group.entry.part)}"
        cure = f"there are {listed(names)}" if any(names) else "its parts have no names: leave part out"
        raise DataError(what, file.name, cure)
    # Some libraries read samples only while the file is open, so the parts are gone through again.
    for number, part in enumerate(reader.parts(file)):
        if number in (wanted or [0]):
            yield part


def _require_known(group: FileGroup, names: Mapping[str, str], by_name: Mapping[str, Channel]) -> None:
    """Raises DataError where the entry names a channel that the rig has not, or a unit that is none."""
    for name in (*names, *group.entry.units):
        if name not in by_name and name not in RESERVED_NAMES:
            cure = f"the rig file lists {listed(by_name)}"
            raise DataError(f"{shown(name)} is not a channel of the rig", group.place, cure)
    for name, unit in group.entry.units.items():
        if name in by_name and not is_unit(unit):
            what = f"units: {shown(unit)} of {shown(name)} is not a unit"
            raise DataError(what, group.place, "write one such as mm, g or mV")


def _chosen(
    group: FileGroup, columns: Columns, names: Mapping[str, str], channels: Sequence[Channel]
) -> tuple[Columns, tuple[Channel, ...]]:
    """The columns under the names of the channels and in the units of the entry, and the channels that are meant."""
    by_name = {channel.name: channel for channel in channels}
    _require_known(group, names, by_name)
    chosen = columns.renamed({column: name for name, column in names.items()})
    if group.entry.units:
        units = [chosen.unit(i) for i in range(len(chosen.header))]
        other_sensors = {name for sensor in group.entry.sensors.values() for name in sensor} - names.keys()
        for name, unit in group.entry.units.items():
            if name not in other_sensors:
                units[chosen.need(name)] = unit
        chosen = replace(chosen, units=tuple(units))
    named = [by_name[name] for name in names if name in by_name]
    return _only(chosen, named), tuple(named) if named else tuple(channels)


def _only(columns: Columns, named: Sequence[Channel]) -> Columns:
    """The same; what else is in a file of which the entry chooses columns is not worth a note."""
    return columns if not named else replace(columns, notes=(*columns.notes, _CHOSEN))


_CHOSEN = Notice("columns_chosen", "")


def _joined(group: FileGroup, channels: Sequence[Channel], circumstances: Circumstances) -> Interpreted:
    """The record of all sensors of the group."""
    sensors, notes = [], []
    for name, names in group.entry.sensors.items():
        path = group.paths[name]
        columns, named = _chosen(group, next(_parts(group, path)), {**group.entry.columns, **names}, channels)
        records, notices = read_records(columns, named, circumstances)
        notes += notices
        if len(records) != 1:
            raise DataError(
                f"{len(records)} records in the file of a sensor", str(path), "give one file each"
            )
        sensors.append(Sensor(name, named, records[0].time, records[0].values))
    source = next(iter(group.paths.values())).name
    given = (sensors, circumstances.frequency_hz, circumstances.experiment, source)
    own = group.entry.clock == "own"
    joint, notices = aligned_sensors(*given, group.entry.align_s) if own else joined_sensors(*given)
    notes = [*_said(notes), *notices]
    if isinstance(joint, ClockedRecords):
        return Interpreted(notes=tuple(notes), joint=(joint,))
    return Interpreted((joint,), notes=tuple(notes))


def _said(notes: Iterable[Notice]) -> list[Notice]:
    """Notes that are worth saying where the entry chooses the columns."""
    notes = list(notes)
    chosen = _CHOSEN in notes
    return [n for n in notes if n != _CHOSEN and not (chosen and n.code == "columns_not_read")]


def _windowed(found: Interpreted, group: FileGroup) -> Interpreted:
    """The records within the window of the entry, notes tidied."""
    found = replace(found, notes=tuple(_said(found.notes)))
    window = group.entry.window_s
    if window is None:
        return found
    return replace(
        found,
        records=tuple(_cut(record, window) for record in found.records),
        joint=tuple(
            replace(joint, parts=tuple(_cut(part, window) for part in joint.parts)) for joint in found.joint
        ),
    )


def _cut(record: Record, window: tuple[float, float]) -> Record:
    inside = (record.time >= window[0]) & (record.time <= window[1])
    if np.sum(inside) < 2:
        span = f"{record.time[0]:g} to {record.time[-1]:g} s"
        raise DataError(f"nothing lies in window_s, the record goes from {span}", record.source, "correct it")
    return replace(record, time=record.time[inside], values=record.values[inside])


def _averaged(found: Interpreted, lines: tuple[int, ...], group: FileGroup) -> Interpreted:
    """Records of a multisine as the mean of their periods."""
    spectra = list(found.spectra)
    for record in found.records:
        if record.frequency_hz is None:
            cure = "give frequency_hz, the reciprocal of the period"
            raise DataError("the period of the multisine is not known", group.place, cure)
        period, skip = 1 / record.frequency_hz, group.entry.skip_periods
        whole = len(record.time) // samples_of_period(record, period)
        if whole - skip > 1:
            spectra.append(average_periods(record, period, lines, skip=skip))
        else:
            spectra.append(one_period(record, period, lines))
    return replace(found, records=(), spectra=tuple(spectra))
