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
from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dashpot.data.conditioning.settings import Treatments
from dashpot.errors import DataError
from dashpot.io.toml_document import TomlDocument, Wanted, read_toml
from dashpot.io.words import shown

NUMBER = r"\d+(?:[.,p]\d+)?"
_FIELDS = {"frequency": NUMBER, "experiment": r"\d+"}
_PLACE = re.compile(r"\{(\w*)\}|(\*\*/)|(\*)|(\?)")
MOST_LINES = 100_000

Names = dict[str, str]  # channel: column


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class FilesEntry(_Strict):
    """One [[files]] of a manifest."""

    name: str | list[str]
    columns: Names = {}
    units: dict[str, str] = {}
    sensors: dict[str, Names] = {}
    clock: Literal["shared", "own"] = "shared"
    align_s: tuple[float, float] | None = Field(default=None, strict=False)
    experiment: int | None = None
    frequency_hz: Annotated[float, Field(gt=0, lt=1e12)] | None = None
    lines: str | list[int] | None = None
    skip_periods: Annotated[int, Field(ge=0)] = 0
    band_hz: tuple[float, float] | None = Field(default=None, strict=False)
    window_s: tuple[float, float] | None = Field(default=None, strict=False)
    rate_hz: Annotated[float, Field(gt=0, lt=1e12)] | None = None
    part: str | None = None


class _Conditioning(_Strict):
    orders: str | list[int] | None = None
    harmonics: list[int] | Literal["auto", "none"] | None = None
    drift: int | Literal["auto", "none"] | None = None
    noise: Literal["auto", "own", "white", "blocks"] | None = None
    refine: bool | Literal["auto", "always", "none"] | None = None
    settle: bool | float | Literal["auto", "none"] | None = None


class _Manifest(_Strict):
    folder: str = "."
    conditioning: _Conditioning = _Conditioning()
    files: Annotated[list[FilesEntry], Field(min_length=1)]


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
    try:
        manifest = _Manifest.model_validate(document.table)
    except ValidationError as error:
        raise _first_fault(error, document) from None
    source = document.path
    groups = []
    for number, entry in enumerate(manifest.files):
        line = document.line(("files", number))
        place = f"{source}:{line}" if line else source
        groups += resolved(entry, Path(path).parent / manifest.folder, place, number)
    return Manifest(tuple(groups), _treatments(manifest.conditioning, source))


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


def _matches(name: str, folder: Path, place: str) -> Iterator[tuple[Path, dict[str, str], str]]:
    """Files that fit a name or pattern, what its fields are there, and their names less the sensor's; in order.

    Raises DataError where none does.
    """
    if not _PLACE.search(name):
        yield folder / name, {}, name
        return
    fields = [field for field, *_ in _PLACE.findall(name) if field]
    if len(set(fields)) < len(fields):
        raise DataError(f'a field occurs twice in "{shown(name, 100)}"', place, "name each one once")
    wild, regex, position = "", "", 0
    for match in _PLACE.finditer(name):
        between = name[position : match.start()]
        wild, regex = wild + glob.escape(between), regex + re.escape(between)
        field, deep, star, _ = match.groups()
        if field is not None:
            wild += "*"
            regex += f"(?P<{field}>{_FIELDS.get(field, '[^/]+?')})" if field else "[^/]*"
        else:
            wild += "**/" if deep else "*" if star else "?"
            regex += "(?:.*/)?" if deep else "[^/]*" if star else "[^/]"
        position = match.end()
    wild, regex = wild + glob.escape(name[position:]), regex + re.escape(name[position:])
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


def _treatments(conditioning: _Conditioning, source: str) -> Treatments:
    """The fields of Conditioning that the manifest sets."""
    fields: Any = conditioning.model_dump(exclude_none=True)
    if fields.get("orders", "auto") != "auto":
        fields["orders"] = line_numbers(fields["orders"], source)
    return cast(Treatments, fields)


def _first_fault(error: ValidationError, document: TomlDocument) -> DataError:
    """What is wrong first, with its line."""
    fault = error.errors()[0]
    place = tuple(part for part in fault["loc"] if not isinstance(part, str) or part.isidentifier())
    what, cure = shown(fault["msg"], 120), "correct it"
    if fault["type"] == "extra_forbidden":
        known = (
            FilesEntry
            if place[:1] == ("files",)
            else _Conditioning
            if place[:1] == ("conditioning",)
            else _Manifest
        )
        what, cure = "unknown key", f"there are {', '.join(known.model_fields)}"
    elif fault["type"] == "missing":
        what, cure = "missing", 'write [[files]] with name = "…"'
    return DataError([document.problem(place, what, cure)])
