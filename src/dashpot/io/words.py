"""How names and pieces of files stand in messages: short, printable, on one line."""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from dashpot.errors import UsageError

# Formats of files that the end of a name chooses.


PICTURES = ("svg", "png", "pdf")
REPORTS = ("html", "htm", "pdf")


def chosen_format(path: str | os.PathLike[str], formats: Sequence[str]) -> str:
    """The one of `formats` in which the name ends, in small letters.  Raises UsageError if it is none of them."""
    kind = Path(path).suffix.lower().removeprefix(".")
    if kind not in formats:
        *most, last = (f".{each}" for each in formats)
        ends = f"{', '.join(most)} or {last}" if most else last
        raise UsageError("unknown format", os.fspath(path), f"use {ends}")
    return kind


def shown(text: str, most: int = 40) -> str:
    """A piece of a file fit for one line of a message: at most `most` characters, printable ones."""
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean if len(clean) <= most else clean[:most] + "…"


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names for a message: the first `most`, and how many more there are."""
    every = list(names)
    more = "" if len(every) <= most else f" and {len(every) - most} more"
    return ", ".join(shown(name) or "(no name)" for name in every[:most]) + more


def joined(names: Iterable[str]) -> str:
    """All names, with commas and "and": "m1, c1 and k1"."""
    every = list(names)
    return every[0] if len(every) == 1 else ", ".join(every[:-1]) + " and " + every[-1] if every else ""


def with_values(names: Iterable[str], count: int = 1) -> str:
    """The advice to know more: "give m1 or k1 a value", "give 2 of m1, c1 and k1 a value"."""
    every = list(names)
    if len(every) <= count + 1 == 2:
        return f"give {' or '.join(every)} a value"
    shown = every if len(every) <= 6 else [*every[:4], f"{len(every) - 4} others"]
    return f"give {'one' if count == 1 else count} of {joined(shown)} a value"


def counted(count: int, noun: str) -> str:
    """A number of things: "1 input", "2 inputs"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def names_in(text: str | Iterable[str]) -> list[str]:
    """Names, or a text of them with commas between."""
    return [name.strip() for name in text.split(",") if name.strip()] if isinstance(text, str) else list(text)


def quoted(text: str) -> str:
    """A text in quotes, as a TOML basic string, which JSON reads as well unless a character needs eight digits."""
    return "".join(
        c if c.isprintable() else f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}"
        for c in json.dumps(text, ensure_ascii=False)
    )


def written(value: object) -> str:
    """A value of a TOML or JSON file as the file wrote it, short and on one line."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return quoted(value if len(value) <= 40 else value[:39] + "…")
        case dict():
            return "a table"
        case list():
            return "a list"
        case int() if abs(value) > 10**20:
            return "so large a number"
    return str(value)


def choose_from(known: Iterable[str], meant: str = "") -> str:
    """The advice to choose from the known names, after the one that is like `meant`, if one is."""
    names = list(known)
    guess = did_you_mean(meant, names)
    return f"{guess}{'If not, choose' if guess else 'choose'} from {listed(names) or 'none'}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`did you mean "x1"? ` where one of the known names is like the word, else nothing."""
    names = {name.lower(): name for name in known}
    word = word.lower()[:60]
    close = [name for name in names if len(word) >= 3 and name.startswith(word)]
    close = close or difflib.get_close_matches(word, list(names), n=1, cutoff=0.6)
    return f"did you mean {written(names[close[0]])}? " if close else ""
