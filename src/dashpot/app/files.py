"""Files and folders as parameters of commands: checked before the work starts.

A parameter that names a file or folder has one of these types, by which no output of a call can be an input of it:
each input and output is entered in the run's ledger, whichever comes first, and what clashes is refused.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from dashpot.errors import DataError, UsageError
from dashpot.io import ledger
from dashpot.io.name_endings import chosen_format

STDOUT = "-"  # as the name of a file to write


class InputFile(click.ParamType[str]):
    """A file that is read.  Whether it is there, its reader says."""

    name = "file"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where it is an output of the same call."""
        return ledger.noted(str(value))

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="file")]


class InputFileOr(InputFile):
    """A file that is read where there is one of that name; else a text with a meaning of its own."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path or the text.  Raises UsageError where it is an output of the same call."""
        text = str(value)
        return super().convert(text, param, ctx) if os.path.exists(text) else text


class OutputFile(click.ParamType[str]):
    """A file to write; with `stdout`, - is standard output; with `new`, one that is there already is not replaced.

    Where there are `formats`, its name ends in one of them.
    """

    name = "file"

    def __init__(self, stdout: bool = False, new: bool = False, formats: Sequence[str] = ()) -> None:
        self.stdout, self.new, self.formats = stdout, new, tuple(formats)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where it could not be written after the work, or must not be."""
        target = str(value)
        if self.stdout and target == STDOUT:
            return target
        _require_writable(target)
        if self.new and os.path.isfile(target):
            raise UsageError("a file of this name exists", target, "name another file, or remove this one")
        entries = ledger.current()
        if entries is not None:
            entries.claim(target, id(self) if param is None else param.name)
        if self.formats:
            chosen_format(target, self.formats)
        return target

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="file")]


def _require_writable(target: str) -> None:
    """Raises UsageError where no file of that name could be written."""
    if not target or os.path.isdir(target):
        raise UsageError("this is a folder", target or '""', "name a file in it")
    if "\0" in target:
        raise UsageError("a null character in a path", target, "name another file")
    there = os.path.exists(target)
    folder = Path(target).parent if there else Path(os.path.realpath(target)).parent
    if not os.path.isdir(folder):
        raise UsageError(f"the folder {folder} does not exist", target, "create it, or name another file")
    special = there and not os.path.isfile(target)
    writable = os.access(target if special else folder, os.W_OK)
    if not writable or (there and not os.access(target, os.W_OK)):
        raise UsageError(
            "no permission to write this file", target, "change its permissions, or name another file"
        )


class OutputFolder(click.ParamType[str]):
    """A folder that is made where it is missing.  What is written into it is checked when it is."""

    name = "folder"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where the folder cannot be made."""
        target = str(value)
        check_folder(target)
        return target

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="dir")]


def check_folder(target: str) -> None:
    """Refuse a folder for output that cannot be made: its parent must exist.  Raises UsageError."""
    if not target or "\0" in target:
        raise UsageError("this is not the name of a folder", target or '""', "name another folder")
    path = Path(target)
    if os.path.exists(target) and not os.path.isdir(target):
        raise UsageError("this is a file, not a folder", target, "name another folder")
    if not os.path.exists(target) and not os.path.isdir(path.absolute().parent):
        raise UsageError(f"the folder {path.parent} does not exist", target, "create it, or name another")


def write_result(target: str | None, text: str) -> None:
    """Write a result to a file, to stdout for "-", or nowhere for None.  Raises DataError."""
    from dashpot.io.atomic import write_text

    if target == STDOUT:
        click.echo(text, nl=False)
    elif target is not None:
        write_text(target, text)


def write_pictures(folder: str | Path, pictures: Mapping[str, bytes]) -> list[str]:
    """Write PNG files by name into a folder, which is made if missing; their paths.  Raises DataError."""
    from dashpot.io.atomic import write_bytes

    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise DataError(f"the folder cannot be made ({reason})", str(target), "name another one") from None
    paths = [str(target / f"{name}.png") for name in pictures]
    for path, content in zip(paths, pictures.values(), strict=True):
        write_bytes(path, content)
    return paths
