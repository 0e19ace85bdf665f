"""Time records as CSV: `frequency_hz`, `time_s`, then channels; one row per sample, a block of rows per frequency.

Without `frequency_hz` the file is one record (or several, where the time starts again).  `experiment` is optional.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.channel import Channel, numbered
from dashpot.data.readers.columns import (
    FREQUENCY,
    LARGEST,
    TIME,
    Columns,
    check_range,
    frequency_column,
    frequency_scale,
    read_time,
    time_column,
    whole_block,
)
from dashpot.data.readers.text import write_rows
from dashpot.data.record import Record, samples_at_limit
from dashpot.errors import DataError
from dashpot.io.toml_document import toml_key
from dashpot.io.words import listed, shown, written
from dashpot.notices import Notice

EXPERIMENT = "experiment"
_IN_NAME = re.compile(r"(?<![\d.])(\d+(?:[.,p]\d+)?)[ _-]?hz(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class Circumstances:
    """What a file may leave out: the drive frequency of its records, their experiment, their sampling rate in Hz.

    named: the experiments of the rig file, which a column `experiment` may hold in place of numbers
    """

    frequency_hz: float | None = None
    experiment: int = 0
    rate_hz: float | None = None
    named: tuple[str, ...] = ()


def read_records(
    columns: Columns, channels: Sequence[Channel], circumstances: Circumstances = Circumstances()
) -> tuple[list[Record], list[Notice]]:
    """Records and notes.  A frequency is also taken from a file name such as sweep_12.5Hz.csv.

    Raises DataError with file, row and column for what is missing, not a number, or not in order.
    """
    notes = list(columns.notes)
    time_at = time_column(columns, channels, circumstances.rate_hz is not None)
    f_at, experiment_at = frequency_column(columns, channels), columns.find(EXPERIMENT)
    at = []
    for channel in channels:
        cure = (
            f'if it has another name here, write a manifest: columns = {{ {toml_key(channel.name)} = "…" }}'
        )
        at.append(columns.need(channel.name, " (the rig file lists it as a channel)", cure))
    scales = [columns.scale(column, channel) for column, channel in zip(at, channels, strict=True)]
    channels = tuple(map(columns.described, at, channels))
    numeric = None if circumstances.named else experiment_at
    wanted = list(dict.fromkeys(i for i in (f_at, numeric, *at) if i is not None))
    apart = set(at).isdisjoint({time_at, f_at, experiment_at})
    time, numbers = read_time(columns, time_at, wanted, circumstances.rate_hz, at if apart else (), notes)
    frequency, frequency_hz, said = _drive(columns, f_at, numbers, circumstances)
    notes += said
    experiments: Ints = np.broadcast_to(np.int64(circumstances.experiment), len(time))
    if experiment_at is not None:
        experiments = experiment_column(
            columns, experiment_at, numbers.get(experiment_at), circumstances.named
        )
    # In SI units, (samples, channels); the numbers are let go, or changed where they stand together
    block = whole_block([numbers[column] for column in at])
    values = np.empty((len(time), len(at))) if block is None else block
    for i, (column, scale) in enumerate(zip(at, scales, strict=True)):
        np.multiply(numbers.pop(column), scale, out=values[:, i])
        check_range(columns, column, values[:, i], LARGEST, "(SI)")
    starts = _blocks(columns, at[0] if time_at is None else time_at, time, frequency, experiments)
    dwells = len(starts) > 1 and frequency is None and frequency_hz is None
    cure = f"; if one of them is the drive frequency, call it {FREQUENCY}" if dwells else ""
    notes += columns.not_read((*wanted, time_at, experiment_at), cure)
    for array in (time, values):  # which the only record shares
        array.setflags(write=False)
    records = []
    for start, end in zip(starts, [*starts[1:], len(time)], strict=True):
        if end - start < 2:
            cure = "record more, or look for rows that are out of order"
            if frequency is not None:
                cure += "; of a sweep rename the column of the frequency"
            raise columns.error(start, columns.find(TIME) or 0, "the block has one sample", cure)
        driven = frequency_hz if frequency is None else float(frequency[start])
        source = columns.source if len(starts) == 1 else columns.part_from(start)
        samples = (time[start:end], values[start:end], driven, int(experiments[start]))
        records.append(Record(channels, *samples, source=source))
        for channel, column in zip(channels, records[-1].values.T, strict=True):
            count = samples_at_limit(column)
            if count:
                text = (
                    f"{source}: {channel.name} is at its limit in {count} of {len(column)} samples; if it is "
                    "clipped, widen the range or reduce the drive"
                )
                notes.append(Notice("clipped", text, (channel.name,)))
    return records, notes


def _drive(
    columns: Columns, f_at: int | None, numbers: Mapping[int, Real], circumstances: Circumstances
) -> tuple[Real | None, float | None, list[Notice]]:
    """The drive frequency of every sample, or of the whole file (None: not known), and notes."""
    if f_at is not None:
        frequency = numbers[f_at] * frequency_scale(columns, f_at)
        check_frequency(columns, f_at, frequency)
        return frequency, None, []
    if circumstances.frequency_hz is not None:
        return None, circumstances.frequency_hz, []
    # 12.5 of …/sweep_12.5Hz.csv or 12p5Hz, where it is the only one
    named = {float(re.sub("[,pP]", ".", text)) for text in _IN_NAME.findall(Path(columns.source).name)}
    named = {f for f in named if 0 < f < 1e12}
    if len(named) != 1:
        return None, None, []
    frequency_hz = named.pop()
    text = f"{columns.source}: the drive frequency {frequency_hz:g} Hz is taken from the file's name"
    return None, frequency_hz, [Notice("frequency_from_name", text, (columns.source,))]


def check_frequency(columns: Columns, column: int, frequency: Real) -> None:
    """Raises DataError at the first frequency that is not positive.  frequency (rows,), Hz."""
    wrong = ~(frequency > 0) | (frequency > 1e12)
    columns.refuse(column, wrong, "frequency {:g} Hz", "frequencies must be positive", frequency)


def experiment_column(columns: Columns, column: int, values: Real | None, named: Sequence[str]) -> Ints:
    """The numbers of runs, (rows,), or of the experiments that are `named`.  Raises DataError at the first other text.

    values: the column as numbers, None where it may hold names.
    """
    if not named or values is not None:
        assert values is not None
        return whole_numbers(columns, column, values)
    texts = np.array(columns.texts(column))
    distinct, of = np.unique(texts, return_inverse=True)
    numbers = np.zeros(len(distinct), dtype=np.int64)
    for k, text in enumerate(distinct.tolist()):
        if text in named:
            numbers[k] = numbered(named.index(text) + 1, 0)
        elif re.fullmatch(r"\s*\d{1,9}(\.0*)?\s*", text):
            numbers[k] = int(float(text))
        else:
            cure = f"write a number, or a name of the rig file: {listed(named)}"
            columns.refuse(column, texts == text, f"{written(text)} is no experiment", cure)
    return numbers[of.ravel()]


def whole_numbers(columns: Columns, column: int, values: Real) -> Ints:
    """A column as integers.  Raises DataError at the first that is none.  values (rows,)."""
    wrong = (values != np.round(values)) | (np.abs(values) > 2**53)
    columns.refuse(column, wrong, "{:g} is not a whole number", "number them 0, 1, 2, …", values)
    return values.astype(np.int64)


def _blocks(
    columns: Columns, column: int, time: Real, frequency: Real | None, experiments: Ints
) -> list[int]:
    """Where records begin: the frequency or the experiment changes, or the time starts again.

    Raises DataError if the time stands still or goes back without starting again.
    """
    change = experiments[1:] != experiments[:-1]
    if frequency is not None:
        change = change | (frequency[1:] != frequency[:-1])
    starts = [0, *(np.flatnonzero(change) + 1).tolist()]
    back = set((np.flatnonzero(time[1:] <= time[:-1]) + 1).tolist()) - set(starts)
    begun, latest = np.array(starts), 0
    for i in sorted(back):
        start = max(int(begun[np.searchsorted(begun, i, side="right") - 1]), latest)
        if time[i] > time[start] + 0.02 * (time[i - 1] - time[start]):
            stands = time[i] == time[i - 1]
            raise columns.error(
                i,
                column,
                f"the time does not increase ({time[i - 1]:.9g} s, then {time[i]:.9g} s)",
                "write times with more digits, or leave them out and give rate_hz in a manifest"
                if stands
                else "sort the rows; records that follow each other need their own experiment number",
            )
        starts.append(i)
        latest = i
    return sorted(starts)


def write_records(
    records: Sequence[Record], path: str | os.PathLike[str], sd: Sequence[Real] | None = None
) -> None:
    """Write records as stepped-sine CSV that reads back to the same records, numbers in the channels' own units.

    `sd` of each record, (samples, channels), adds a column NAME_sd for every channel that has some.
    Raises DataError for repeats (leading axes), records of different channels, and records that would run together.
    """
    if not records:
        raise DataError("there are no records", cure="give at least one record")
    channels = records[0].channels
    for record in records:
        if record.channels != channels or record.values.ndim != 2:
            raise DataError(
                "records of different channels, or repeats, do not fit in one file",
                record.source,
                "write one file each",
            )
    for before, after in itertools.pairwise(records):
        same = before.frequency_hz == after.frequency_hz and before.experiment == after.experiment
        if same and after.time[0] > before.time[0] + 0.02 * (before.time[-1] - before.time[0]):
            raise DataError(
                f"two records at {after.frequency_hz} Hz would run together",
                after.source,
                "give them experiment numbers",
            )
    header, columns = [TIME], [np.concatenate([record.time for record in records])]
    lengths = [len(record.time) for record in records]
    driven = [record.frequency_hz for record in records if record.frequency_hz is not None]
    if driven and len(driven) < len(records):
        raise DataError("some of the records have no frequency", cure="write them to a file of their own")
    if driven:
        header.insert(0, FREQUENCY)
        columns.insert(0, np.repeat(np.array(driven, dtype=float), lengths))
    if any(record.experiment for record in records):
        header.append(EXPERIMENT)
        columns.append(np.repeat(np.array([record.experiment for record in records]), lengths))
    for i, channel in enumerate(channels):
        header.append(channel.name)
        columns.append(np.concatenate([record.values[:, i] for record in records]) / channel.scale)
    if sd is not None:
        spread = np.concatenate(sd)
        for i in np.flatnonzero(np.any(spread > 0, axis=0)).tolist():
            header.append(f"{channels[i].name}_sd")
            columns.append(spread[:, i] / abs(channels[i].scale))
    write_rows(path, [shown(name, 1000) for name in header], columns)
