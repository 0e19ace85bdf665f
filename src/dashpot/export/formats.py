"""Which formats a rig can be exported to, by the end of a file's name or by name: a new one is a line here.

The names alone load neither NumPy nor a writer.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast
from xml.sax.saxutils import quoteattr

from dashpot.errors import UsageError

if TYPE_CHECKING:
    from dashpot.arrays import Real
    from dashpot.data.spectrum import Spectrum
    from dashpot.export.identified_rig import IdentifiedRig


@dataclass(frozen=True)
class ExportOptions:
    """What formats may ask for in addition to the rig.

    given         as what displacement inputs are given (`state_space_of`)
    frequency_hz  (lines,) of frequency responses; those of `data` without it
    data          measured amplitudes, whose frequency responses are written
    compiled      whether an FMU gets a binary where a compiler is found
    """

    given: str | Mapping[str, str] | None = None
    frequency_hz: Real | None = None
    data: Spectrum | None = None
    compiled: bool = True


IN_WORDS = {"given": "quantities of inputs", "frequency_hz": "frequencies", "data": "measured data"}


@dataclass(frozen=True)
class ExportFormat:
    """One kind of content in one kind of file.

    writer  module of this package and function, (rig, path, options) → Written
    takes   names of the options that it looks at
    """

    content: str
    suffixes: tuple[str, ...]
    writer: str
    takes: tuple[str, ...] = ()

    def require_use(self, path: str, given: Iterable[str]) -> None:
        """Raises UsageError if it does not look at one of the options that are given."""
        for name in given:
            if name not in self.takes:
                cause = f"an export of {self.content} does not use {IN_WORDS[name]}"
                raise UsageError(cause, path, "leave them out")


@dataclass(frozen=True)
class Written:
    """Files that an export has written, and whether an FMU holds a binary (None: it is none)."""

    paths: tuple[str, ...]
    compiled: bool | None = None


def export_rig(
    rig: IdentifiedRig,
    path: str | os.PathLike[str],
    content: str | None = None,
    options: ExportOptions | None = None,
) -> Written:
    """Write a rig in the format that the end of the file's name tells, or the first with that end and `content`.

    Raises UsageError if there is no such format or it has no use for an option, ModelError if it cannot hold
    the rig, DataError if the file cannot be written.
    """
    target = os.fspath(path)
    chosen = format_of(target, content)
    options = ExportOptions() if options is None else options
    chosen.require_use(target, [name for name in IN_WORDS if getattr(options, name) is not None])
    module, _, function = chosen.writer.partition(".")
    return cast(Written, getattr(import_module(f"dashpot.export.{module}"), function)(rig, target, options))


def format_of(path: str, content: str | None = None) -> ExportFormat:
    """The format of a file to be written.  Raises UsageError if there is none."""
    suffix = Path(path).suffix.lower()
    meant = [each for each in FORMATS if content in (None, each.content)]
    if not meant:
        raise UsageError(
            f"{content} is not something that can be exported", cure=f"use one of {', '.join(contents())}"
        )
    for each in meant:
        if suffix in each.suffixes:
            return each
    if content is not None:
        cause = f"{content} is not written to {suffix or 'this'} files"
    elif suffix:
        cause = f"no export has the extension {suffix}"
    else:
        cause = "the file name has no extension, so the format is unknown"
    ends = sorted({end for each in meant for end in each.suffixes})
    raise UsageError(cause, path, f"use {', '.join(ends)}")


def contents() -> tuple[str, ...]:
    """Names of what can be exported."""
    return tuple(dict.fromkeys(each.content for each in FORMATS))


# The first with an ending is what it means without more words.
FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat("state-space", (".json", ".mat"), "state_space.write_state_space", ("given",)),
    ExportFormat("transfer-functions", (".json",), "transfer_functions.write_transfer_functions", ("given",)),
    ExportFormat("parameters", (".csv", ".parquet", ".m"), "parameter_tables.write_parameters"),
    ExportFormat(
        "frequency-responses",
        (".csv",),
        "transfer_functions.write_frequency_responses",
        ("frequency_hz", "data"),
    ),
    ExportFormat("matrices", (".mtx",), "parameter_tables.write_matrices"),
    ExportFormat(
        "universal-file",
        (".uff", ".unv"),
        "universal_file.write_rig_universal_file",
        ("frequency_hz", "data"),
    ),
    ExportFormat("fmu", (".fmu",), "fmu.write_fmu", ("given",)),
    ExportFormat("mujoco", (".xml",), "mujoco.write_mujoco"),
)


def distinct(names: Iterable[str], between: str = "_", taken: Iterable[str] = ()) -> list[str]:
    """The names, made different from each other and from those `taken` by a number behind what is `between`."""
    given, out = set(taken), []
    for name in names:
        unique, count = name, 1
        while unique in given:
            count += 1
            unique = f"{name}{between}{count}"
        given.add(unique)
        out.append(unique)
    return out


def xml_tag(name: str, attributes: Mapping[str, object], inside: str | None = None) -> str:
    """<name attribute="…"/>, or around what is inside; attributes that are None are left out."""
    given = [f"{key}={quoteattr(str(value))}" for key, value in attributes.items() if value is not None]
    head = " ".join([name, *given])
    return f"<{head}/>" if inside is None else f"<{head}>{inside}</{name}>"
