"""Files that commands write: checked before the work starts, and there whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from dashpot.errors import DataError, UsageError


def check_targets(targets: Iterable[str | None], sources: Iterable[str] = ()) -> None:
    """Refuse what could not be written after the work: raises UsageError, before the work.

    A target must not be a folder, lie in a missing one, be named twice, or be one of the files that are read.
    """
    read = {os.path.realpath(source): source for source in sources}
    taken: set[str] = set()
    for target in targets:
        if target is None:
            continue
        path = Path(target)
        real = os.path.realpath(target)
        if not target or path.is_dir():
            raise UsageError("this is a folder", target or '""', "name a file in it")
        if not path.parent.is_dir():
            raise UsageError(
                f"the folder {path.parent} does not exist", target, "make it, or name another file"
            )
        if not os.access(path.parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
            raise UsageError(
                "this may not be written", target, "change its permissions, or name another file"
            )
        if real in read:
            raise UsageError("this would overwrite a file that is read", target, "name another file")
        if real in taken:
            raise UsageError("two outputs have this name", target, "name another file")
        taken.add(real)


def check_folder(target: str | None) -> None:
    """Refuse a folder for output that cannot be made: its parent must exist.  Raises UsageError."""
    if target is None:
        return
    path = Path(target)
    if path.exists() and not path.is_dir():
        raise UsageError("this is a file, not a folder", target, "name another folder")
    if not path.exists() and not path.absolute().parent.is_dir():
        raise UsageError(f"the folder {path.parent} does not exist", target, "make it, or name another")


def write_text(target: str, text: str) -> None:
    """Write a text file whole: a temporary file beside it takes its place at the end.  Raises DataError."""
    path = Path(target)
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise DataError(
            f"cannot be written ({error.strerror or error})", target, "check the path and the space left"
        ) from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
