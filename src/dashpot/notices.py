"""Notices: what a reader of a result should know, with a code that programs can rely on.

`text` is a plain sentence of facts without options of the command line; what to do about it is added by code in
`present` and `app`, and nothing is ever filtered by its wording.
"""

from __future__ import annotations

from dataclasses import dataclass


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
        object.__setattr__(self, "of", tuple(self.of))

    def __str__(self) -> str:
        return self.text
