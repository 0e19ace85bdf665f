"""Xsens DOT inertial sensors: one CSV file for each sensor, on one clock, made one record.

Some rows about the device, then the columns PacketCounter, SampleTimeFine (µs, 32 bits), Euler_X …, Acc_X … (m/s²),
Gyr_X … (°/s).  The first row may hold zeros instead of a measurement.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.channel import Channel, Quantity
from dashpot.data.readers.columns import TIME, ArrayColumns, Load
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.delimited.table import Table, open_table
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.words import counted, shown
from dashpot.notices import Notice

COUNTER, CLOCK = "PacketCounter", "SampleTimeFine"
AXES = ("Acc_X", "Acc_Y", "Acc_Z")
UNITS = {"Acc_": "m/s²", "FreeAcc_": "m/s²", "Gyr_": "deg/s", "Euler_": "deg"}  # by the beginning of the name
WRAP = 1 << 32  # µs, the clock starts again after 71.6 minutes
FEWEST = 0.5  # share of the shortest file that all sensors must have in common


def read_xsens(
    paths: Mapping[str, str | os.PathLike[str]],
    channels: Sequence[Channel],
    axis: str = "X",
    *,
    frequency_hz: float | None = None,
    experiment: int = 0,
    source: str = "record",
) -> tuple[Record, list[Notice]]:
    """The acceleration along `axis` of every channel, at the times that all sensors have in common, and notes.

    `paths` names the file of each channel.  Time counts from the first common sample, in s.  Raises DataError with
    file, row and column for what is missing, not a number, or not in order, and where the sensors share no clock.
    """
    column = f"Acc_{axis}"
    if column not in AXES:
        raise DataError(f"there is no axis {shown(axis)}", source, "it may be X, Y or Z")
    sensors: list[tuple[Ints, Real]] = []
    notes: list[Notice] = []
    for channel in channels:
        if channel.name not in paths:
            cure = f"there are files of {', '.join(paths) or 'nothing'}"
            raise DataError(f"channel {channel.name} has no file", source, cure)
        if channel.quantity is not Quantity.ACCELERATION or channel.scale != 1.0:
            cure = 'set quantity = "acceleration" and unit = "m/s²" for it in the rig file'
            raise DataError(f"channel {channel.name} is not an acceleration in m/s²", source, cure)
        clock, values, told = _sensor(open_table(paths[channel.name], COUNTER), column)
        sensors.append((clock, values))
        notes.extend(told)
    if not sensors:
        raise DataError("no channels are listed", source, "name at least one channel")
    common = sensors[0][0]
    for clock, _ in sensors[1:]:
        common = np.intersect1d(common, clock, assume_unique=True)
    shortest = min(len(clock) for clock, _ in sensors)
    if len(common) < max(2, FEWEST * shortest):
        raise DataError(
            f"the sensors have {len(common)} times in common, the shortest file has {shortest}",
            source,
            "give files of one recording, made by sensors that were synchronised before it",
        )
    if len(common) < shortest:
        text = f"{source}: {counted(shortest - len(common), 'sample')} left out that not all sensors have"
        notes.append(Notice("samples_not_shared", text, (source,)))
    values = np.stack([x[np.searchsorted(clock, common)] for clock, x in sensors], axis=-1)
    time = (common - common[0]) * 1e-6
    return Record(tuple(channels), time, values, frequency_hz, experiment, source), notes


@dataclass(frozen=True)
class XsensReader:
    """The file of one Xsens DOT sensor."""

    format: str = "Xsens DOT"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """Its columns are there."""
        return COUNTER.encode() in file.head and CLOCK.encode() in file.head

    def parts(self, file: DataFile) -> Iterator[ArrayColumns]:
        """What the sensor measured: `time_s` is its own clock, which synchronised sensors share."""
        table = open_table(file, COUNTER)
        ticks, first, notes = _clock(table)
        loads: list[Load] = [lambda: ticks[first:] * 1e-6]
        names, units = [TIME], ["s"]
        for i, name in enumerate(table.header):
            unit = next((unit for prefix, unit in UNITS.items() if name.startswith(prefix)), None)
            if unit is not None:
                names.append(name)
                units.append(unit)
                loads.append(partial(_from, table, i, first))
        yield ArrayColumns(
            file.name, tuple(names), tuple(units), tuple(notes), len(ticks) - first, tuple(loads)
        )


def _from(table: Table, column: int, first: int) -> Real:
    return table.numbers([column])[column][first:]


def _sensor(table: Table, column: str) -> tuple[Ints, Real, list[Notice]]:
    """Clock in µs, values in m/s², notes; rows of zeros at the start left out."""
    at = table.need(column)
    ticks, first, notes = _clock(table)
    return ticks[first:], _from(table, at, first), notes


def _clock(table: Table) -> tuple[Ints, int, list[Notice]]:
    """Clock in µs of all rows, the first row that is a measurement, notes."""
    counter_at, clock_at = table.need(COUNTER), table.need(CLOCK)
    axes = [table.need(name) for name in AXES]
    numbers = table.numbers(list(dict.fromkeys([counter_at, clock_at, *axes])))
    clock = numbers[clock_at]
    wrong = (clock != np.round(clock)) | (clock < 0) | (clock >= WRAP)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise table.error(i, clock_at, f"{clock[i]:g} is not a time in whole µs", "export the file again")
    again = np.concatenate([[0], np.cumsum(np.diff(clock) < -WRAP / 2)]).astype(np.int64)
    ticks = clock.astype(np.int64) + WRAP * again
    back = np.diff(ticks) <= 0
    if np.any(back):
        i = int(np.argmax(back)) + 1
        raise table.error(i, clock_at, "the time does not increase", "sort the rows or split the file")
    silent = np.all([numbers[at] == 0 for at in axes], axis=0)
    first = int(np.argmin(silent)) if not np.all(silent) else len(silent)
    if len(ticks) - first < 2:
        raise DataError("there are no measurements", table.source, "give a file with more samples")
    notes = list(table.notes)
    lost = int(np.sum(np.diff(numbers[counter_at][first:]) - 1))
    if lost > 0:
        text = f"{table.source}: {lost} packets are missing; the others keep their true times"
        notes.append(Notice("packets_lost", text, (table.source,)))
    return ticks, first, notes
