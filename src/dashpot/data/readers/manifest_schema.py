"""What a manifest of a test may say, key by key, and how a fault in it is told."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from dashpot.errors import DashpotError, DataError
from dashpot.io.toml_document import TomlDocument
from dashpot.io.words import did_you_mean, shown, written
from dashpot.quantities import quantity

Names = dict[str, str]  # channel: column
MOST_EXPERIMENTS = 10**9
MULTIPLES = 'multiples as "11:250" or [1, 3, 5]'
WANTED = {
    "folder": "a folder in quotes",
    "name": "a file or a pattern in quotes, or a list of them",
    "columns": 'channels and their columns, such as { x1 = "Acc_X" }',
    "units": 'channels and their units, such as { x1 = "mm" }',
    "sensors": 'sensors and their columns, such as { floor1 = { x1 = "Acc_X" } }',
    "clock": '"shared" or "own"',
    "align_s": "[start, end] in s, such as [0, 8]",
    "experiment": f"a whole number from 0 to {MOST_EXPERIMENTS}",
    "frequency_hz": "a positive number of Hz",
    "lines": MULTIPLES,
    "skip_periods": "a whole number from 0",
    "band_hz": "[lowest, highest] in Hz, such as [2, 25]",
    "window_s": "[start, end] in s, such as [0, 60]",
    "rate_hz": "a positive number of Hz",
    "part": "the name of a group, sheet, block or segment in quotes",
    "orders": MULTIPLES,
    "harmonics": 'multiples as [2, 3], "auto" or "none"',
    "drift": 'a degree from 0, "auto" or "none"',
    "noise": '"auto", "own", "white" or "blocks"',
    "refine": '"auto", "always" or "none"',
    "settle": '"auto", "none" or a time such as "2 s"',
}


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


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class FilesEntry(_Strict):
    """One [[files]] of a manifest."""

    name: Text | Annotated[list[Text], Field(min_length=1)]
    columns: Names = {}
    units: dict[str, str] = {}
    sensors: dict[str, Names] = {}
    clock: Literal["shared", "own"] = "shared"
    align_s: Span | None = None
    experiment: Annotated[int, Field(ge=0, le=MOST_EXPERIMENTS)] | None = None
    frequency_hz: Positive | None = None
    lines: str | list[int] | None = None
    skip_periods: Annotated[int, Field(ge=0)] = 0
    band_hz: Span | None = None
    window_s: Span | None = None
    rate_hz: Positive | None = None
    part: Text | None = None

    @model_validator(mode="after")
    def _of_one_mind(self) -> Self:
        what = self._contradiction()
        if what is not None:
            raise PydanticCustomError("refused", "{what}", {"what": what})
        return self

    def _column_read_twice(self) -> str | None:
        """That two channels are read from one column; None where no two are."""
        for columns in (self.columns, *self.sensors.values()):
            for name, column in columns.items():
                other = next(key for key, value in columns.items() if value == column)
                if other != name:
                    return f"{shown(other)} and {shown(name)} are both read from the column {shown(column)}"
        return None

    def _contradiction(self) -> str | None:
        """What is wrong with keys that each by itself may be right; None where nothing is."""
        twice = self._column_read_twice()
        if twice is not None:
            return twice
        names = [self.name] if isinstance(self.name, str) else self.name
        if self.clock == "own" and not self.sensors:
            return 'clock = "own" is for the files of several sensors; list them in sensors'
        if self.align_s is not None and self.clock != "own":
            return 'align_s is for sensors with clocks of their own; say clock = "own"'
        if self.lines is not None and self.clock == "own":
            return "lines of a multisine are not averaged over sensors with clocks of their own"
        if self.skip_periods and self.lines is None:
            return "skip_periods is for multisines; give their lines, or cut the start off with window_s"
        if self.frequency_hz is not None and any("{frequency}" in name for name in names):
            return "the frequency is said twice: by frequency_hz and by {frequency} in the name"
        return None


class ConditioningTable(_Strict):
    """[conditioning] of a manifest."""

    orders: str | list[int] | None = None
    harmonics: list[Annotated[int, Field(ge=1)]] | Literal["auto", "none"] | None = None
    drift: Annotated[int, Field(ge=0)] | Literal["auto", "none"] | None = None
    noise: Literal["auto", "own", "white", "blocks"] | None = None
    refine: bool | Literal["auto", "always", "none"] | None = None
    settle: Annotated[
        bool | Annotated[float, Field(ge=0, lt=1e9)] | Literal["auto", "none"], BeforeValidator(_seconds)
    ] | None = None  # fmt: skip


class ManifestDocument(_Strict):
    """A whole manifest."""

    folder: str = "."
    conditioning: ConditioningTable = ConditioningTable()
    files: Annotated[list[FilesEntry], Field(min_length=1)]


def manifest_document(document: TomlDocument) -> ManifestDocument:
    """The document, checked.  Raises DataError, with file and line, for its first fault."""
    try:
        return ManifestDocument.model_validate(document.table)
    except ValidationError as error:
        raise _first_fault(error.errors()[0], document) from None


def _first_fault(fault: Mapping[str, Any], document: TomlDocument) -> DataError:
    """What is wrong first, with its line and what may stand there."""
    place = _keys(fault["loc"], document.table)
    key = next((part for part in reversed(place) if part in WANTED), None)
    what, cure = f"{_shown_value(fault['input'])} cannot be used", f"write {WANTED.get(str(key), '')}"
    if fault["type"] == "refused":
        what, _, cure = str(fault["ctx"]["what"]).partition("; ")
        cure = cure or "leave one of them out"
    elif fault["type"] == "extra_forbidden":
        tables: dict[str, type[BaseModel]] = {"files": FilesEntry, "conditioning": ConditioningTable}
        table = str(fault["loc"][0]) if len(fault["loc"]) > 1 else ""
        known = tables.get(table, ManifestDocument).model_fields
        what = "unknown key"
        cure = f"{did_you_mean(str(fault['loc'][-1]), known)}there are {', '.join(known)}"
    elif key is None:
        what = "missing" if fault["type"] == "missing" else what
        cure = 'write [[files]] with name = "…"'
    elif fault["type"] == "missing" and len(place) == 3:
        what = "missing"
    return DataError([document.problem(place, what, cure)])


def _keys(place: Sequence[int | str], table: Any) -> tuple[int | str, ...]:
    """The keys of a fault's place as the file has them, without what pydantic adds, and the one that is missing."""
    keys: list[int | str] = []
    for part in place:
        if keys and keys[-1] in WANTED and not isinstance(table, dict):
            break
        keys.append(part)
        try:
            table = table[part]
        except (KeyError, IndexError, TypeError):
            break
    return tuple(keys)


def _shown_value(value: object) -> str:
    if isinstance(value, list | tuple):
        return shown(f"[{', '.join(written(part) for part in value)}]")
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf"
    return written(value)
