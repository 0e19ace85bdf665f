"""A test of many files: a manifest, TOML, or a pattern of file names such as `{frequency}Hz_{sensor}.lvm`.

folder = "recordings"                        # of the files, from where this file is; may be left out
[conditioning]                               # how records become amplitudes; the options of a command come first
settle = "auto"
[[files]]
name = "mass1/{frequency}Hz_*.txt"           # a file, or a pattern: {frequency}, {sensor}, {experiment}, * and ?
columns = { a1 = "Acceleration", F1 = "Force" }   # channel (or time_s, frequency_hz) = column of the file
units = { a1 = "g" }                         # of the numbers in the file, where it says none or a wrong one
sensors = { floor1 = { x1 = "Acc_X" } }      # the same for each {sensor}; its files are joined to one record
clock = "shared"                             # of the sensors; "own": offset and drift are estimated
align_s = [0, 8]                             # where they were shaken together, by which own clocks are set
experiment = 0                               # else the number of the entry
frequency_hz = 1.0                           # else {frequency}, the file's own, or none: a continuous record
lines = "11:250"                             # a multisine: multiples of frequency_hz that are excited
skip_periods = 1                             # of a multisine, until it has settled
band_hz = [2, 25]                            # only the files driven in it
window_s = [0, 60]                           # only this part of each record
rate_hz = 610.35                             # of samples without times
part = "Sheet1"                              # the group, sheet, block or segment of the file
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Annotated, Any, ClassVar, Literal, Self, cast

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from dashpot.channel import RESERVED_NAMES, Channel
from dashpot.data.clocks import ClockedRecords, Sensor, aligned_sensors, joined_sensors
from dashpot.data.conditioning.clock import within_times
from dashpot.data.conditioning.settings import Treatments
from dashpot.data.noise import moderated
from dashpot.data.periods import average_periods, one_period, samples_of_period
from dashpot.data.readers.columns import Columns, is_unit
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.interpretation import Interpreted, interpret
from dashpot.data.readers.records import Circumstances, read_records
from dashpot.data.readers.registry import reader_of
from dashpot.errors import DashpotError, DataError
from dashpot.io.toml_document import Entry, Report, Wanted, read_toml, validated, wrong
from dashpot.io.words import choose_from, listed, shown
from dashpot.quantities import quantity

# What a manifest of a test may say, key by key, and how a fault in it is told.


Names = dict[str, str]  # channel: column
MOST_EXPERIMENTS = 10**9
MULTIPLES = 'multiples as "11:250" or [1, 3, 5]'


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError
    return ends


def _seconds(value: object) -> object:
    """The time that a text says, s; other values as they are."""
    if not isinstance(value, str) or value in ("auto", "none"):
        return value
    try:
        return quantity(value, "time")
    except DashpotError:
        raise ValueError from None


Span = Annotated[tuple[float, float], Field(strict=False), AfterValidator(_ascending)]
Text = Annotated[str, Field(min_length=1)]
Positive = Annotated[float, Field(gt=0, lt=1e12)]
Duration = Annotated[float, Field(ge=0, lt=1e9)]


class FilesEntry(Entry):
    """One [[files]] of a manifest."""

    examples: ClassVar[Mapping[str, str]] = {"name": 'name = "…", a file or a pattern'}
    wanted: ClassVar[Mapping[str, str]] = {
        "name": "a file or a pattern in quotes, or a list of them",
        "columns": 'channels and their columns, such as { x1 = "Acc_X" }',
        "units": 'channels and their units, such as { x1 = "mm" }',
        "sensors": 'sensors and their columns, such as { floor1 = { x1 = "Acc_X" } }',
        "clock": '"shared" or "own"',
        "align_s": "[start, end] in s, such as [0, 8]",
        "experiment": f"a whole number from 0 to {MOST_EXPERIMENTS}, or the name of an experiment of the rig file",
        "frequency_hz": "a positive number of Hz",
        "lines": MULTIPLES,
        "skip_periods": "a whole number from 0",
        "band_hz": "[lowest, highest] in Hz, such as [2, 25]",
        "window_s": "[start, end] in s, such as [0, 60]",
        "rate_hz": "a positive number of Hz",
        "part": "the name of a group, sheet, block or segment in quotes",
    }
    name: Text | Annotated[list[Text], Field(min_length=1)]
    columns: Names = Field(default_factory=dict)
    units: dict[str, str] = Field(default_factory=dict)
    sensors: dict[str, Names] = Field(default_factory=dict)
    clock: Literal["shared", "own"] = "shared"
    align_s: Span | None = None
    experiment: Annotated[int, Field(ge=0, le=MOST_EXPERIMENTS)] | Text | None = None
    frequency_hz: Positive | None = None
    lines: str | list[int] | None = None
    skip_periods: Annotated[int, Field(ge=0)] = 0
    band_hz: Span | None = None
    window_s: Span | None = None
    rate_hz: Positive | None = None
    part: Text | None = None

    @model_validator(mode="after")
    def _of_one_mind(self) -> Self:
        """Raises where keys contradict each other that each by itself may be right."""
        for columns in (self.columns, *self.sensors.values()):
            for name, column in columns.items():
                other = next(key for key, value in columns.items() if value == column)
                if other != name:
                    both = f"{shown(other)} and {shown(name)} are both read from the column {shown(column)}"
                    raise wrong(both, "leave one of them out")
        names = [self.name] if isinstance(self.name, str) else self.name
        if self.clock == "own" and not self.sensors:
            raise wrong('clock = "own" is for the files of several sensors', "list them in sensors")
        if self.align_s is not None and self.clock != "own":
            raise wrong("align_s is for sensors with clocks of their own", 'say clock = "own"')
        if self.lines is not None and self.clock == "own":
            what = "lines of a multisine are not averaged over sensors with clocks of their own"
            raise wrong(what, "leave one of them out")
        if self.skip_periods and self.lines is None:
            raise wrong(
                "skip_periods is for multisines", "give their lines, or cut the start off with window_s"
            )
        if self.frequency_hz is not None and any("{frequency}" in name for name in names):
            what = "the frequency is stated twice: by frequency_hz and by {frequency} in the name"
            raise wrong(what, "leave one of them out")
        return self


class ConditioningTable(Entry):
    """[conditioning] of a manifest."""

    wanted: ClassVar[Mapping[str, str]] = {
        "orders": MULTIPLES,
        "harmonics": 'multiples as [2, 3], "auto" or "none"',
        "drift": 'a degree from 0, "auto" or "none"',
        "noise": '"auto", "own", "white" or "blocks"',
        "refine": '"auto", "always" or "none"',
        "settle": '"auto", "none" or a time such as "2 s"',
    }
    orders: str | list[int] | None = None
    harmonics: list[Annotated[int, Field(ge=1)]] | Literal["auto", "none"] | None = None
    drift: Annotated[int, Field(ge=0)] | Literal["auto", "none"] | None = None
    noise: Literal["auto", "own", "white", "blocks"] | None = None
    refine: bool | Literal["auto", "always", "none"] | None = None
    settle: Annotated[bool | Duration | Literal["auto", "none"] | None, BeforeValidator(_seconds)] = None


class ManifestHead(Entry):
    """A whole manifest."""

    wanted: ClassVar[Mapping[str, str]] = {
        "folder": "a folder in quotes",
        "conditioning": "a table [conditioning]",
        "files": '[[files]] with name = "…"',
    }
    folder: str = "."
    conditioning: dict[str, Any] = Field(default_factory=dict)
    files: Annotated[list[dict[str, Any]], Field(min_length=1)]


NUMBER = r"\d+(?:[.,p]\d+)?"
_FIELDS = {"frequency": NUMBER, "sensor": "[^/]+?", "experiment": r"\d+"}
_PLACE = re.compile(r"\{(\w*)\}|(\*\*/)|(\*)|(\?)")
MOST_LINES = 100_000
MOST_ENTRIES = 1_000_000  # names of files and folders that one pattern looks at
DEEPEST = 32  # folders inside folders
LONGEST_SEARCH = 20.0  # s


@dataclass(frozen=True)
class FileGroup:
    """Files that were recorded at once: one, or one for each sensor; and what their entry says of them.

    paths  {sensor: path}; the sensor is "" where there is one file
    """

    entry: FilesEntry
    place: str
    paths: dict[str, Path]
    frequency_hz: float | None
    experiment: int


@dataclass(frozen=True)
class Manifest:
    """All groups of files of a test, and how their records become amplitudes where the test says so."""

    groups: tuple[FileGroup, ...]
    conditioning: Treatments


def is_manifest(path: str | os.PathLike[str]) -> bool:
    """Whether the name of a data file is one of a manifest."""
    return os.fspath(path).lower().endswith(".toml")


def is_pattern(path: str | os.PathLike[str]) -> bool:
    """Whether the name of a data file is a pattern: no file has it, and it has places to fill."""
    return not os.path.exists(path) and _PLACE.search(os.fspath(path)) is not None


def read_manifest(path: str | os.PathLike[str]) -> Manifest:
    """The manifest, with its patterns resolved.

    Raises DataError, with file and line, for what is no TOML, unknown or of the wrong kind, and where a pattern fits
    no file.
    """
    wanted = Wanted("manifest of a test", 'write [[files]] with name = "…", and what its columns are')
    document = read_toml(path, DataError, wanted)
    if "coordinates" in document.table:
        raise DataError("this is a rig file, not a manifest of data", document.path, "name data files here")
    if "files" not in document.table:  # which makes it one
        raise DataError([document.problem(("files",), "missing", 'add [[files]] with name = "…"')])
    report, source, groups = Report(document, DataError), document.path, []
    head = validated(ManifestHead, document.table, (), report)
    report.raise_any()
    assert head is not None
    conditioning = validated(ConditioningTable, head.conditioning, ("conditioning",), report)
    entries = [validated(FilesEntry, raw, ("files", k), report) for k, raw in enumerate(head.files)]
    report.raise_any()
    for number, entry in enumerate(entries):
        line = document.line(("files", number))
        place = f"{source}:{line}" if line else source
        groups += resolved(entry, Path(path).parent / head.folder, place, number) if entry else []
    fields: Any = {} if conditioning is None else conditioning.model_dump(exclude_none=True)
    if fields.get("orders", "auto") != "auto":
        fields["orders"] = line_numbers(fields["orders"], source)
    return Manifest(tuple(groups), cast(Treatments, fields))


def files_named(path: str | os.PathLike[str]) -> list[Path]:
    """The data files that the name of a file, a manifest or a pattern stands for, in order.

    Raises DataError as `read_manifest`.
    """
    if is_manifest(path):
        groups = read_manifest(path).groups
    elif is_pattern(path):
        groups = manifest_of_pattern(path, 0).groups
    else:
        return [Path(path)]
    return list(dict.fromkeys(each for group in groups for each in group.paths.values()))


def manifest_of_pattern(pattern: str | os.PathLike[str], number: int) -> Manifest:
    """The files whose names fit a pattern, as experiment `number`.  Raises DataError if none does."""
    folder, name = _parted(pattern)
    groups = resolved(FilesEntry(name=name), folder, shown(os.fspath(pattern), 200), number)
    return Manifest(tuple(groups), {})


def files_fitting(pattern: str) -> list[str]:
    """Files whose names fit a pattern, links as well.  Raises DataError if none does, or too much is there."""
    folder, name = _parted(pattern)
    place = shown(pattern, 200)
    paths = (str(folder / each) for each in _below(folder, name, place))
    found = [path for path in paths if os.path.isfile(path)]
    if not found:
        raise DataError("no file fits this pattern", place, "correct the pattern or the folder")
    return found


def _parted(pattern: str | os.PathLike[str]) -> tuple[Path, str]:
    """The folder in which a pattern is looked for, and what is left of it from its first place on."""
    fixed, rest = [], os.fspath(pattern).replace(os.sep, "/").split("/")
    while len(rest) > 1 and not _PLACE.search(rest[0]):
        fixed.append(rest.pop(0))
    return Path("/".join(fixed) + "/") if fixed else Path("."), "/".join(rest)


def resolved(entry: FilesEntry, folder: Path, place: str, number: int) -> list[FileGroup]:
    """The groups of one entry, by experiment and frequency.  Raises DataError if no file fits."""
    names = [entry.name] if isinstance(entry.name, str) else entry.name
    groups: dict[tuple[float | None, int, str], FileGroup] = {}
    for name in names:
        for path, fields, without_sensor in _matches(name, folder, place):
            frequency, sensor = entry.frequency_hz, fields.get("sensor", "")
            if "frequency" in fields:
                frequency = float(re.sub("[,p]", ".", fields["frequency"]))
            low, high = entry.band_hz or (0.0, math.inf)
            outside = entry.band_hz is not None and (frequency is None or not low <= frequency <= high)
            if outside or (entry.sensors and sensor not in entry.sensors):
                continue
            stated = entry.experiment if isinstance(entry.experiment, int) else number
            experiment = int(fields.get("experiment", stated))
            if experiment > MOST_EXPERIMENTS:
                raise DataError(
                    f"the experiment {shown(str(experiment))} of {shown(path.name)}", place, "use *"
                )
            key = (frequency, experiment, without_sensor if entry.sensors else path.as_posix())
            group = groups.setdefault(key, FileGroup(entry, place, {}, frequency, experiment))
            group.paths[sensor] = path
    if not groups:
        raise DataError("no file of these names is left", place, "correct sensors or band_hz")
    for group in groups.values():
        missing = set(entry.sensors) - set(group.paths)
        if missing:
            what = (
                f"{next(iter(group.paths.values()))}: there is no file of sensor {', '.join(sorted(missing))}"
            )
            raise DataError(shown(what, 300), place, "add it, or take the sensor out")
    return sorted(groups.values(), key=lambda g: (g.experiment, g.frequency_hz or 0.0))


def _regex(name: str) -> str:
    """A pattern as a regular expression with its fields as groups."""
    regex, position = "", 0
    for match in _PLACE.finditer(name):
        regex += re.escape(name[position : match.start()])
        field, deep, star, _ = match.groups()
        if field is not None:
            regex += f"(?P<{field}>{_FIELDS[field]})" if field else "[^/]*"
        else:
            regex += "(?:.*/)?" if deep else "[^/]*" if star else "[^/]"
        position = match.end()
    return regex + re.escape(name[position:])


def _matches(name: str, folder: Path, place: str) -> Iterator[tuple[Path, dict[str, str], str]]:
    """Files that fit a name or pattern, what its fields are there, and their names less the sensor's; in order.

    Raises DataError if none does, or one lies outside the folder.
    """
    if Path(name).anchor or ".." in Path(name).parts:
        raise DataError(
            f'"{shown(name, 100)}" leads out of the folder', place, "write it relative to folder, without .."
        )
    if not _PLACE.search(name):
        yield _inside(folder, name, place), {}, name
        return
    # The fields of a pattern
    fields = [field for field, *_ in _PLACE.findall(name) if field]
    unknown = [field for field in fields if field not in _FIELDS]
    if unknown:
        cure = f"{choose_from(_FIELDS, unknown[0])}; * stands for anything else"
        raise DataError(f'unknown field {{{shown(unknown[0])}}} in "{shown(name, 100)}"', place, cure)
    if len(set(fields)) < len(fields):
        raise DataError(f'a field occurs twice in "{shown(name, 100)}"', place, "name each one once")
    regex = _regex(name)
    count = 0
    for relative in sorted(_below(folder, name, place)):
        found = re.fullmatch(regex, relative)
        if found is not None:
            count += 1
            start, end = found.span("sensor") if "sensor" in fields else (0, 0)
            left = relative[:start] + relative[end:]
            yield _inside(folder, relative, place), found.groupdict(), left
    if not count:
        raise DataError(
            f'no file fits "{shown(name, 100)}" in {shown(str(folder), 150)}', place, "correct name or folder"
        )


def _inside(folder: Path, relative: str, place: str) -> Path:
    """The path of a file.  Raises DataError if a link on the way leads out of the folder."""
    with suppress(ValueError):  # of what is no path, which says its reader
        if not Path(os.path.realpath(folder / relative)).is_relative_to(os.path.realpath(folder)):
            what = f"{shown(relative, 100)} is a link out of the folder {shown(str(folder), 150)}"
            raise DataError(what, place, "copy the file into it, or write its own folder as folder")
    return folder / relative


def _below(folder: Path, name: str, place: str) -> set[str]:
    """What lies below a folder and may fit a pattern; hidden names are left out by ** and *, links to folders by **.

    Raises DataError if that is too much to look through, or a link leads out of the folder.
    """
    steps = re.sub(r"\*\*/(?:\*\*/)+", "**/", name).split("/")
    if "**" in steps and os.path.realpath(folder) == Path(os.path.realpath(folder)).anchor:
        raise DataError("** would go through the whole file system", place, "name the folder of the data")
    until, entries = monotonic() + LONGEST_SEARCH, 0
    found, ahead = set(), [("", 0, 0)]
    while ahead:
        at, number, depth = ahead.pop()
        if number == len(steps):
            found.add(at.removesuffix("/"))
            continue
        step, deep = steps[number], steps[number] == "**"
        if not _PLACE.search(step) and not deep:
            if os.path.lexists(folder / at / step):
                ahead.append((f"{at}{step}/", number + 1, depth + 1))
            continue
        if deep:
            ahead.append((at, number + 1, depth))
        _inside(folder, at, place)
        fits = re.compile("[^.].*" if deep else _regex(step))
        with suppress(OSError, ValueError), os.scandir(folder / at) as inside:
            for entry in inside:
                entries += 1
                if entries > MOST_ENTRIES or depth > DEEPEST or monotonic() > until:
                    what = f"over {MOST_ENTRIES} names, {DEEPEST} levels or {LONGEST_SEARCH:g} s of searching"
                    raise DataError(f'"{shown(name, 100)}": {what}', place, "name the folder more closely")
                hidden = entry.name.startswith(".") and not step.startswith(".")
                if hidden or not fits.fullmatch(entry.name):
                    continue
                if not deep:
                    ahead.append((f"{at}{entry.name}/", number + 1, depth + 1))
                elif entry.is_dir(follow_symlinks=False):
                    ahead.append((f"{at}{entry.name}/", number, depth + 1))
    return found


def line_numbers(text: str | Sequence[int], place: str) -> tuple[int, ...]:
    """Multiples of a frequency: a list, or start:stop or start:stop:step, both ends included.  Raises DataError."""
    try:
        if not isinstance(text, str):
            numbers = tuple(int(number) for number in text)
        elif ":" in text:
            start, stop, *step = (int(part) for part in text.split(":"))
            if len(step) > 1 or not (step or [1])[0] > 0 or stop - start > MOST_LINES:
                raise ValueError
            numbers = tuple(range(start, stop + 1, *step))
        else:
            numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < 1 or len(numbers) > MOST_LINES:
        raise DataError(f"{shown(str(text))} are not multiples", place, 'write them as "11:250" or [1, 3, 5]')
    return tuple(sorted(set(numbers)))


# Files of a manifest as records and spectra: columns chosen and renamed, sensors joined, periods averaged.


def read_group(
    group: FileGroup, frequency_hz: float | None, experiments: Sequence[str], channels: Sequence[Channel]
) -> Interpreted:
    """What one group of files holds.  `frequency_hz` serves where neither they nor their names say it.

    `experiments` are those that rows may name.

    Raises DataError, one line, for what is missing or damaged in a file, or does not fit its entry.
    """
    entry, found = group.entry, Interpreted()
    driven = frequency_hz if group.frequency_hz is None else group.frequency_hz
    circumstances = Circumstances(driven, group.experiment, entry.rate_hz, tuple(experiments))
    if entry.sensors:
        found = _joined(group, channels, circumstances)
    else:
        (path,) = group.paths.values()
        for columns in _parts(group, path):
            chosen, named = _chosen(group, columns, entry.columns, channels)
            found += interpret(chosen, named, circumstances)
    names = {name for columns in (entry.columns, *entry.sensors.values()) for name in columns}
    if not names.isdisjoint(channel.name for channel in channels):
        # If the entry chooses columns, what else is in the file is not worth a note.
        notes = tuple(note for note in found.notes if note.code != "columns_not_read")
        found = replace(found, notes=notes)
    if entry.window_s is not None:
        joint = (
            replace(each, parts=tuple(within_times(part, *entry.window_s) for part in each.parts))
            for each in found.joint
        )
        records = tuple(within_times(record, *entry.window_s) for record in found.records)
        found = replace(found, records=records, joint=tuple(joint))
    if entry.lines is not None:  # a multisine: the mean of its periods
        lines = line_numbers(entry.lines, group.place)
        spectra = list(found.spectra)
        for record in found.records:
            if record.frequency_hz is None:
                cure = "give frequency_hz, the reciprocal of the period"
                raise DataError("the period of the multisine is not known", group.place, cure)
            period, skip = 1 / record.frequency_hz, group.entry.skip_periods
            whole = len(record.time) // samples_of_period(record, period)
            if whole - skip > 1:
                spectra.append(moderated(average_periods(record, period, lines, skip=skip), kind="periods"))
            else:
                spectra.append(one_period(record, period, lines))
        found = replace(found, records=(), spectra=tuple(spectra))
    return found


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
        cure = choose_from(names) if any(names) else "its parts have no names: leave part out"
        raise DataError(what, file.name, cure)
    # Some libraries read samples only while the file is open, so the parts are gone through again.
    for number, part in enumerate(reader.parts(file)):
        if number in (wanted or [0]):
            yield part


def _chosen(
    group: FileGroup, columns: Columns, names: Mapping[str, str], channels: Sequence[Channel]
) -> tuple[Columns, tuple[Channel, ...]]:
    """The columns under the names of the channels and in the units of the entry, and the channels that are meant.

    Raises DataError if the entry names a channel that the rig has not, or a unit that is none.
    """
    by_name = {channel.name: channel for channel in channels}
    for name in (*names, *group.entry.units):
        if name not in by_name and name not in RESERVED_NAMES:
            cure = f"the rig file lists {listed(by_name)}"
            raise DataError(f"{shown(name)} is not a channel of the rig", group.place, cure)
    named = [by_name[name] for name in names if name in by_name]
    return _renamed(group, columns, names), tuple(named) if named else tuple(channels)


def _renamed(group: FileGroup, columns: Columns, names: Mapping[str, str]) -> Columns:
    """The columns under the names of the channels and in the units of the entry.  Raises DataError for what is none."""
    for name, unit in group.entry.units.items():
        if name not in RESERVED_NAMES and not is_unit(unit):
            what = f"units: {shown(unit)} of {shown(name)} is not a unit"
            raise DataError(what, group.place, "write one such as mm, g or mV")
    chosen = columns.renamed({column: name for name, column in names.items()})
    if group.entry.units:
        units = [chosen.unit(i) for i in range(len(chosen.header))]
        other_sensors = {name for sensor in group.entry.sensors.values() for name in sensor} - names.keys()
        for name, unit in group.entry.units.items():
            if name not in other_sensors:
                units[chosen.need(name)] = unit
        chosen = replace(chosen, units=tuple(units))
    return chosen


def columns_meant(path: str | os.PathLike[str]) -> Iterator[tuple[Columns, frozenset[str]]]:
    """The parts of what a name stands for, under the names and in the units that a manifest gives them.

    With them the channels that it chooses; none: all.  Raises DataError as `read_group`.
    """
    if not is_manifest(path):
        for file in map(open_file, files_named(path)):
            yield from ((part, frozenset()) for part in reader_of(file).parts(file))
        return
    for group in read_manifest(path).groups:
        for sensor, each in group.paths.items():
            names = {**group.entry.columns, **group.entry.sensors.get(sensor, {})}
            for part in _parts(group, each):
                yield _renamed(group, part, names), frozenset(names) - frozenset(RESERVED_NAMES)


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
    notes += notices
    if isinstance(joint, ClockedRecords):
        return Interpreted(notes=tuple(notes), joint=(joint,))
    return Interpreted((joint,), notes=tuple(notes))
