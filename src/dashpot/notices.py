"""Notices: what a reader of a result should know, with a code that programs can rely on.

`text` is a plain sentence of facts without options of the command line; what to do about it is added by code in
`present` and `app`, and nothing is ever filtered by its wording.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

PLAIN_UP_TO = 6  # powers of ten that a sentence writes out: 230000, not 2.3e+05


def in_digits(text: str) -> str:
    """A sentence whose numbers stand as an engineer writes them: 2.3e+02 as 230, 5.4e+07 as 5.4e7, 3e-05 as 3e-5."""

    def number(found: re.Match[str]) -> str:
        power = int(found[2])
        return f"{float(found[0]):.0f}" if 0 <= power <= PLAIN_UP_TO else f"{found[1]}e{power}"

    return re.sub(r"(?<![\w.])(\d(?:\.\d+)?)e([+-]\d\d)\b", number, text)


@dataclass(frozen=True)
class Notice:
    """One warning or note.

    code  a stable name such as "model_misfit"
    text  the sentence
    of    names of the unknowns, channels, inputs or files it concerns; empty where it concerns everything
    """

    code: str
    text: str
    of: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", in_digits(self.text))
        object.__setattr__(self, "of", tuple(self.of))

    def __str__(self) -> str:
        return self.text
