"""Formats of files that the end of a name chooses."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from dashpot.errors import UsageError

PICTURES = ("svg", "png", "pdf")
REPORTS = ("html", "htm", "pdf")


def chosen_format(path: str | os.PathLike[str], formats: Sequence[str]) -> str:
    """The one of `formats` in which the name ends, in small letters.  Raises UsageError where it is none of them."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in formats:
        *most, last = (f".{each}" for each in formats)
        ends = f"{', '.join(most)} or {last}" if most else last
        raise UsageError("the end of the name chooses the format", os.fspath(path), f"end it in {ends}")
    return kind
