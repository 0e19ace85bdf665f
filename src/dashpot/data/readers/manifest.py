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

import glob
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from dashpot.data.conditioning.settings import Treatments
from dashpot.data.readers.manifest_schema import (
    MOST_EXPERIMENTS,
    ConditioningTable,
    FilesEntry,
    manifest_document,
)
from dashpot.errors import DataError
from dashpot.io.toml_document import Wanted, read_toml
from dashpot.io.words import did_you_mean, listed, shown

NUMBER = r"\d+(?:[.,p]\d+)?"
_FIELDS = {"frequency": NUMBER, "sensor": "[^/]+?", "experiment": r"\d+"}
_PLACE = re.compile(r"\{(\w*)\}|(\*\*/)|(\*)|(\?)")
MOST_LINES = 100_000


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
    manifest = manifest_document(document)
    source = document.path
    groups = []
    for number, entry in enumerate(manifest.files):
        line = document.line(("files", number))
        place = f"{source}:{line}" if line else source
        groups += resolved(entry, Path(path).parent / manifest.folder, place, number)
    return Manifest(tuple(groups), _treatments(manifest.conditioning, source))


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
    """The files whose names fit a pattern, as experiment `number`.  Raises DataError where none does."""
    text = os.fspath(pattern).replace(os.sep, "/")
    fixed, rest = [], text.split("/")
    while len(rest) > 1 and not _PLACE.search(rest[0]):
        fixed.append(rest.pop(0))
    folder = Path("/".join(fixed) + "/") if fixed else Path(".")
    groups = resolved(FilesEntry(name="/".join(rest)), folder, shown(text, 200), number)
    return Manifest(tuple(groups), {})


def resolved(entry: FilesEntry, folder: Path, place: str, number: int) -> list[FileGroup]:
    """The groups of one entry, by experiment and frequency.  Raises DataError where no file fits."""
    names = [entry.name] if isinstance(entry.name, str) else entry.name
    groups: dict[tuple[float | None, int, str], FileGroup] = {}
    for name in names:
        for path, fields, without_sensor in _matches(name, folder, place):
            frequency, sensor = _frequency(entry, fields), fields.get("sensor", "")
            if not _in_band(entry, frequency) or (entry.sensors and sensor not in entry.sensors):
                continue
            experiment = int(
                fields.get("experiment", number if entry.experiment is None else entry.experiment)
            )
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


def _frequency(entry: FilesEntry, fields: Mapping[str, str]) -> float | None:
    """The drive frequency that a file's name says, else the entry's."""
    if "frequency" not in fields:
        return entry.frequency_hz
    return float(re.sub("[,p]", ".", fields["frequency"]))


def _in_band(entry: FilesEntry, frequency: float | None) -> bool:
    if entry.band_hz is None:
        return True
    return frequency is not None and entry.band_hz[0] <= frequency <= entry.band_hz[1]


def _fields(name: str, place: str) -> list[str]:
    """The fields of a pattern.  Raises DataError where there is no such field, or one occurs twice."""
    fields = [field for field, *_ in _PLACE.findall(name) if field]
    unknown = [field for field in fields if field not in _FIELDS]
    if unknown:
        cure = f"{did_you_mean(unknown[0], _FIELDS)}there are {listed(_FIELDS)}; * stands for anything else"
        raise DataError(f'unknown field {{{shown(unknown[0])}}} in "{shown(name, 100)}"', place, cure)
    if len(set(fields)) < len(fields):
        raise DataError(f'a field occurs twice in "{shown(name, 100)}"', place, "name each one once")
    return fields


def _wild_and_regex(name: str) -> tuple[str, str]:
    """A pattern as `glob` takes it, and as a regular expression with its fields as groups."""
    wild, regex, position = "", "", 0
    for match in _PLACE.finditer(name):
        between = name[position : match.start()]
        wild, regex = wild + glob.escape(between), regex + re.escape(between)
        field, deep, star, _ = match.groups()
        if field is not None:
            wild += "*"
            regex += f"(?P<{field}>{_FIELDS[field]})" if field else "[^/]*"
        else:
            wild += "**/" if deep else "*" if star else "?"
            regex += "(?:.*/)?" if deep else "[^/]*" if star else "[^/]"
        position = match.end()
    wild, regex = wild + glob.escape(name[position:]), regex + re.escape(name[position:])
    return wild, regex


def _matches(name: str, folder: Path, place: str) -> Iterator[tuple[Path, dict[str, str], str]]:
    """Files that fit a name or pattern, what its fields are there, and their names less the sensor's; in order.

    Raises DataError where none does.
    """
    if not _PLACE.search(name):
        yield folder / name, {}, name
        return
    fields = _fields(name, place)
    wild, regex = _wild_and_regex(name)
    count = 0
    for relative in sorted(glob.glob(wild, root_dir=folder, recursive=True)):
        found = re.fullmatch(regex, relative.replace(os.sep, "/"))
        if found is not None:
            count += 1
            start, end = found.span("sensor") if "sensor" in fields else (0, 0)
            yield folder / relative, found.groupdict(), relative[:start] + relative[end:]
    if not count:
        raise DataError(
            f'no file fits "{shown(name, 100)}" in {shown(str(folder), 150)}', place, "correct name or folder"
        )


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


def _treatments(conditioning: ConditioningTable, source: str) -> Treatments:
    """The fields of Conditioning that the manifest sets."""
    fields: Any = conditioning.model_dump(exclude_none=True)
    if fields.get("orders", "auto") != "auto":
        fields["orders"] = line_numbers(fields["orders"], source)
    return cast(Treatments, fields)
