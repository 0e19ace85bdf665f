"""What is in a data file, whatever its rig: columns, units, sampling, gaps, clipping, resolution, content."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TypeVar

import numpy as np

from dashpot.arrays import Frozen, Real
from dashpot.channel import RESERVED_NAMES, Channel, Quantity
from dashpot.data.conditioning.clock import FEWEST, GAP
from dashpot.data.readers.amplitudes import amplitude_columns
from dashpot.data.readers.columns import (
    Columns,
    are_units,
    bare,
    factors,
    frequency_column,
    named_unit,
    parts_of_ratio,
    read_time,
    time_column,
)
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.manifest import columns_meant, files_named, is_manifest
from dashpot.data.readers.registry import reader_of
from dashpot.data.readers.responses import is_response, response_named
from dashpot.data.record import samples_at_limit
from dashpot.errors import DashpotError, DataError
from dashpot.io.toml_document import PLACEHOLDER, toml_key
from dashpot.io.words import quoted
from dashpot.notices import Notice
from dashpot.units import PIXELS, QUANTITIES

Loaded = TypeVar("Loaded")
MOST_SAMPLES = 1 << 22  # of a column whose resolution is sought
LONGEST_FOR_CONTENT = 1 << 16  # samples of a stretch whose frequency content is shown
WORDS = {
    Quantity.FORCE: ("force", "load", "kraft", "hammer", "torque"),
    Quantity.ACCELERATION: ("acc", "beschl", "a_"),
    Quantity.VELOCITY: ("vel", "gyr", "omega", "speed"),
    Quantity.DISPLACEMENT: ("disp", "weg", "pos", "laser", "theta", "angle", "x"),
}
_LETTERS = {"a": "acceleration", "v": "velocity", "f": "force", **dict.fromkeys("xyzdsuqw", "displacement")}
_BASE = re.compile(
    r"(base|table|shaker|ground|floor_?0|input|drive|excit|ref|boden|tisch|fuss|fuß)", re.IGNORECASE
)
_BASE_LETTERS = re.compile(r"([auw]?[_ ]?(base|table|ground)|u\d*|w\d*|[axv]?0)$", re.IGNORECASE)
_COUNTER = re.compile(
    r"(unnamed: 0|(frame|sample|scan|row|index|counter|bild)?[_ ]?(number|no|nr|index|id|#)?\.?)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class NamedChannel:
    """A channel that data tell of: its name, unit, whether it is the input of a response, `decay` as of a column."""

    name: str
    unit: str | None
    of_input: bool = False
    decay: float = np.nan


@dataclass(frozen=True)
class InspectedColumn(Frozen):
    """One column of numbers.

    missing     samples that are no finite numbers
    clipped     samples that rest at the greatest or least value, where they are many
    resolution  the smallest step between values that differ, in the column's unit; NaN where all are alike
    bands_hz    (bands,) upper ends of the bands of `level_db`
    level_db    (bands,) power in each band below the strongest, dB; empty where the sampling is not known
    decay       rms of the last quarter of the longest stretch over that of its first; NaN where that rests
    """

    name: str
    unit: str | None
    quantity: str | None
    mean: float
    rms: float
    least: float
    greatest: float
    missing: int
    clipped: int
    resolution: float
    bands_hz: Real
    level_db: Real
    decay: float = np.nan

    @property
    def bits(self) -> float:
        """Bits that the range of the values takes at their resolution."""
        span = (self.greatest - self.least) / self.resolution if self.resolution > 0 else np.nan
        return float(np.log2(span + 1))


@dataclass(frozen=True)
class InspectedPart:
    """One part of a file: a table, group, block, sheet or segment.

    rates_hz     lowest and highest sampling rate of its stretches; None if there is no time
    stretches    how often the clock starts again or the drive changes its frequency
    uneven       largest departure of a step from the mean one, over the mean one
    gaps         steps that are longer than usual
    longest_gap  (from, to), s: the longest of them; None if there is none
    duration_s   of all stretches together
    frequencies  drive frequencies that the part names, Hz
    others       columns without numbers, or beyond those that are shown
    damaged      what is wrong with columns that begin with a number and hold something else as well
    notes        what was noticed on reading
    complexes    channels that amplitudes or frequency responses are of; empty: the columns are samples
    """

    source: str
    samples: int
    rates_hz: tuple[float, float] | None
    stretches: int
    uneven: float
    gaps: int
    longest_gap: tuple[float, float] | None
    duration_s: float
    frequencies: tuple[float, ...]
    columns: tuple[InspectedColumn, ...]
    others: tuple[str, ...]
    damaged: tuple[DashpotError, ...]
    notes: tuple[Notice, ...]
    complexes: tuple[NamedChannel, ...] = ()

    @property
    def channels(self) -> tuple[NamedChannel, ...]:
        """The channels that it tells of: one for each column of samples, or those of amplitudes and responses."""
        each = (NamedChannel(column.name, column.unit, decay=column.decay) for column in self.columns)
        return self.complexes or tuple(each)


@dataclass(frozen=True)
class Inspection:
    """A file: its format and its parts; `more` parts are not shown."""

    source: str
    format: str
    parts: tuple[InspectedPart, ...]
    more: int


def inspect_file(path: str | os.PathLike[str]) -> Inspection:
    """What is in a file.  Raises DataError if it cannot be read at all."""
    file = open_file(path)
    reader = reader_of(file)
    parts: list[InspectedPart] = []
    more = 0
    for columns in reader.parts(file):
        if len(parts) < 200:
            parts.append(_part(columns))
        else:
            more += 1
    if not any(part.columns for part in parts):
        for part in parts:
            if part.damaged:
                raise part.damaged[0]
        raise DataError("no column holds numbers", file.name, "name a data file")
    return Inspection(file.name, reader.format, tuple(parts), more)


def inspect_named(path: str | os.PathLike[str]) -> list[Inspection]:
    """The files that a name stands for; those of a manifest with the columns that it chooses, by its names and units.

    Raises DataError if one cannot be read.
    """
    if not is_manifest(path):
        return [inspect_file(each) for each in files_named(path)]
    found = []
    for columns, chosen in columns_meant(path):
        part = _part(columns)
        if chosen:
            part = replace(
                part,
                columns=tuple(column for column in part.columns if column.name in chosen),
                complexes=tuple(channel for channel in part.complexes if channel.name in chosen),
            )
        found.append(Inspection(columns.source, f"as {os.path.basename(path)} names it", (part,), 0))
    return found


def inspect_columns(columns: Columns) -> Inspection:
    """What is in columns that a program holds.  Raises DataError if none holds numbers."""
    part = _part(columns)
    if not part.columns:
        raise DataError("no column holds numbers", columns.source, "give columns of numbers")
    return Inspection(columns.source, "columns", (part,), 0)


def _part(columns: Columns) -> InspectedPart:
    damaged: list[DashpotError] = []
    notes = list(columns.notes)
    time_at = _tried(lambda: time_column(columns, (), may_lack=True), None, [])
    f_at = _tried(lambda: frequency_column(columns, ()), None, [])
    time: Real = np.zeros(0)
    driven: Real = np.zeros(0)
    if time_at is not None:
        time = _tried(lambda: read_time(columns, time_at, [], None, (), notes)[0], time, damaged)
    if f_at is not None:
        driven = _tried(partial(_numbers, columns, f_at), driven, damaged)
    # Where the drive changes its frequency or the clock starts again another stretch begins
    new = np.diff(time) <= 0
    if len(driven) == len(time):
        new |= driven[1:] != driven[:-1]
    edges = [0, *(np.flatnonzero(new) + 1).tolist(), len(time)]
    ends = [(begin, end) for begin, end in pairwise(edges) if end > begin + 1]
    # stretches that are looked at: more are no recording
    stretches = []
    for begin, end in ends[:10_000]:
        steps = np.diff(time[begin:end])
        regular = steps[steps <= GAP * float(np.median(steps))]  # others are gaps
        mean, gaps = float(np.mean(regular)), len(steps) - len(regular)
        at = begin + int(np.argmax(steps))
        longest = (float(time[at]), float(time[at + 1])) if gaps else None
        uneven = float(np.max(np.abs(regular - mean))) / mean
        stretches.append(
            _Stretch(begin, end, 1 / mean, uneven, gaps, longest, float(time[end - 1] - time[begin]))
        )
    rates = [stretch.rate_hz for stretch in stretches]
    inspected: list[InspectedColumn] = []
    others, samples = [], len(time)
    for i, name in enumerate(columns.names):
        if i in (time_at, f_at):
            continue
        values: Real = np.zeros(0)
        if len(inspected) < 64:
            begins_with_number = re.match(r"[-+]?\d", columns.first(i)) is not None
            noted = damaged if begins_with_number else []
            values = _tried(partial(_numbers, columns, i), values, noted)
        if not np.any(np.isfinite(values)):
            if columns.header[i]:
                others.append(columns.header[i])
            continue
        samples = max(samples, len(values))
        good = values[np.isfinite(values)]
        if counts(columns, i, good):
            others += [columns.header[i]] if columns.header[i] else []
            continue
        plain, _ = bare(name)
        unit, quantity, _ = recognised(plain, columns.unit(i))
        steps = np.diff(np.unique(good[:MOST_SAMPLES]))
        bands, level = _content(values, stretches)
        inspected.append(
            InspectedColumn(
                plain,
                unit,
                quantity,
                float(np.mean(good)),
                float(np.std(good)),
                float(np.min(good)),
                float(np.max(good)),
                len(values) - len(good),
                samples_at_limit(good),
                float(np.min(steps)) if len(steps) else np.nan,
                bands,
                level,
                _decay(values, stretches),
            )
        )
    known = tuple(np.unique(driven[np.isfinite(driven)]).tolist()[:1000])
    return InspectedPart(
        columns.source,
        samples,
        (min(rates), max(rates)) if rates else None,
        len(stretches),
        max((stretch.uneven for stretch in stretches), default=0.0),
        sum(stretch.gaps for stretch in stretches),
        max(filter(None, (each.longest_gap for each in stretches)), key=lambda g: g[1] - g[0], default=None),
        sum(stretch.duration_s for stretch in stretches),
        known,
        tuple(inspected),
        tuple(others),
        tuple(damaged),
        tuple(notes),
        tuple(_tried(lambda: _complexes(columns), [], damaged)),
    )


def _numbers(columns: Columns, column: int) -> Real:
    return columns.numbers([column], [column])[column]


def _tried(load: Callable[[], Loaded], otherwise: Loaded, damaged: list[DashpotError]) -> Loaded:
    """What is loaded; where that is damaged, which is noted, something else."""
    try:
        return load()
    except DashpotError as error:
        damaged.append(error)
        return otherwise


@dataclass(frozen=True)
class _Stretch:
    """Samples from begin to end on one clock: a record, or a dwell at one drive frequency."""

    begin: int
    end: int
    rate_hz: float
    uneven: float
    gaps: int
    longest_gap: tuple[float, float] | None
    duration_s: float


def _decay(values: Real, stretches: Sequence[_Stretch]) -> float:
    longest = max(stretches, key=lambda s: s.end - s.begin, default=None)
    if longest is None or len(values) < longest.end or longest.end - longest.begin < FEWEST:
        return np.nan
    x = values[longest.begin : longest.end]
    quarter = len(x) // 4
    there = np.isfinite(x)
    if not (there[:quarter].any() and there[-quarter:].any()):
        return np.nan
    x = x - np.mean(x[-quarter:][there[-quarter:]])
    first, last = (float(np.sqrt(np.nanmean(part**2))) for part in (x[:quarter], x[-quarter:]))
    return last / first if first > 0 else np.nan


def _content(values: Real, stretches: Sequence[_Stretch]) -> tuple[Real, Real]:
    """Power of all stretches in bands from 0 to half the highest sampling rate, dB below the strongest."""
    shown = [stretch for stretch in stretches if stretch.end - stretch.begin >= FEWEST]
    if not shown or len(values) < shown[-1].end:
        return np.zeros(0), np.zeros(0)
    highest = max(stretch.rate_hz for stretch in shown) / 2
    count = min(60, max(stretch.end - stretch.begin for stretch in shown) // 2 + 1)
    sums = np.zeros(count)
    for stretch in shown:
        x = values[stretch.begin : min(stretch.end, stretch.begin + LONGEST_FOR_CONTENT)]
        x = x[np.isfinite(x)]
        if len(x) < FEWEST:
            continue
        power = np.abs(np.fft.rfft((x - np.mean(x)) * np.hanning(len(x)))) ** 2 / len(x)
        frequency_hz = np.arange(len(power)) / len(power) * stretch.rate_hz / 2
        sums += np.bincount((frequency_hz / highest * count).astype(int), power, minlength=count)[:count]
    if not np.any(sums > 0):
        return np.zeros(0), np.zeros(0)
    return np.arange(1, count + 1) / count * highest, 10 * np.log10(np.maximum(sums / np.max(sums), 1e-30))


def guessed_quantity(name: str, unit: str | None) -> str | None:
    """What a column may measure: by its unit, else by its name; None if neither says it."""
    for quantity in Quantity:
        if unit and factors(unit, quantity.value):
            return quantity.value
    lower = name.lower()
    if letter := re.fullmatch(r"([a-z])[\d_xyz]*", lower):
        return _LETTERS.get(letter[1])
    for quantity, words in WORDS.items():
        if any(lower.startswith(word) for word in words):
            return quantity.value
    return Quantity.DISPLACEMENT.value if unit in PIXELS else None


def recognised(column: str, unit: str | None) -> tuple[str | None, str | None, bool]:
    """The unit of a column, what it may measure, and whether its name is one of the base.

    unit  what the file states, which counts; else the ending of the name, where it is one of what the name says
    """
    name, ending = named_unit(column)
    quantity = guessed_quantity(name, unit)
    if not unit and ending:
        raw = not any(factors(ending, each) for each in QUANTITIES)
        direction = re.fullmatch("[A-Z]", ending)  # N, V: north, vertical
        fits = raw or (not quantity and guessed_quantity("", ending))
        if (quantity and factors(ending, quantity)) or (fits and not direction):
            unit = ending
    quantity = quantity or guessed_quantity(name, unit)
    return unit, quantity, quantity != "force" and bool(_BASE.search(name) or _BASE_LETTERS.fullmatch(name))


def counts(columns: Columns, column: int, values: Real | None = None) -> bool:
    """Whether a column numbers the rows, by its name and by whole numbers that rise.  values (rows,): if at hand."""
    if not any(columns.header) or not _COUNTER.fullmatch(bare(columns.header[column])[0]):
        return False
    found = _tried(partial(_numbers, columns, column), np.zeros(0), []) if values is None else values
    return len(found) > 1 and bool(np.all(found == np.round(found)) and np.mean(np.diff(found) > 0) > 0.5)


def channels_in(data: Sequence[str | os.PathLike[str] | Columns]) -> dict[str, Channel]:
    """The channels that files or tables hold by themselves, by name: quantity and unit as the first one says them.

    Columns of numbers, amplitudes (NAME_re), both sides of responses (OUT/IN_re, or by the file's name); of a manifest
    those that it names.  Raises DataError if a file cannot be read.
    """
    found: dict[str, Channel] = {}
    for one in data:
        for columns, chosen in [(one, frozenset[str]())] if isinstance(one, Columns) else columns_meant(one):
            for channel in _complexes(columns) or _samples(columns):
                if not chosen or channel.name in chosen:
                    found.setdefault(channel.name, _channel_of(channel.name, channel.unit))
    return found


def _complexes(columns: Columns) -> list[NamedChannel]:
    """The channels that amplitudes or responses are of; none where the columns are samples."""
    found = amplitude_columns(columns)
    stems = {stem: None if pair.decibel else columns.unit(pair.first) for stem, pair in found.items()}
    if not found and is_response(columns):
        pair, unit = response_named(columns)
        stems = {"/".join(pair): unit}
    channels = dict[str, NamedChannel]()
    for stem, unit in stems.items():
        if "&" in stem:  # the covariance of two
            continue
        out, stroke, into = stem.partition("/")
        responds = stroke and unit is not None and are_units(unit)
        of = parts_of_ratio(unit or "") if responds else [None if stroke else unit, None]
        for name, unit_of, of_input in ((out, of[0], False), (into, of[1], True)):
            if name:
                channels.setdefault(name, NamedChannel(name, unit_of, of_input))
    return list(channels.values())


def _samples(columns: Columns) -> Iterator[NamedChannel]:
    """Columns of samples but the time and the drive frequency; those without a name where none has one."""
    apart = {time_column(columns, (), may_lack=True), frequency_column(columns, ())}
    others = [i for i in range(len(columns.header)) if i not in apart]
    nameless = not any(columns.header[i] for i in others)
    for i in others:
        plain = re.match(r"[-+]?\.?\d|nan", columns.first(i), re.IGNORECASE)
        named = (columns.header[i] or nameless) and columns.names[i] not in RESERVED_NAMES
        if plain and named and not counts(columns, i):
            yield NamedChannel(columns.names[i], recognised(columns.names[i], columns.unit(i))[0])


def _channel_of(name: str, unit: str | None) -> Channel:
    """A channel of the quantity that its unit is one of, in that unit; without one as if in SI units."""
    for quantity in Quantity if unit else ():
        if scales := factors(str(unit), quantity.value):
            return Channel(name, {name: 1.0}, quantity, str(unit), scales[0])
    return Channel(name, {name: 1.0}, unit=unit or "")


def suggested_channels(inspections: Sequence[Inspection]) -> str:
    """A [channels] table to start from, in TOML: one entry for each channel that any of the files tells of."""
    lines: dict[str, str] = {}
    for each in (each for inspection in inspections for part in inspection.parts for each in part.channels):
        _, kind, _ = recognised(each.name, each.unit)
        quantity = f', quantity = "{kind}"' if kind else ""
        unit = f", unit = {quoted(each.unit)}" if each.unit else ""
        lines.setdefault(each.name, f'{toml_key(each.name)} = {{ of = "{PLACEHOLDER}"{quantity}{unit} }}')
    return "\n".join(["[channels]", *lines.values()]) + "\n"
