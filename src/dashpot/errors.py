"""The errors of dashpot: each says where, what is wrong, and what to do."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

_UNSEEN = {"Cc", "Cf", "Cs", "Cn", "Co", "Zl", "Zp"}  # control, format, halves of characters, line separators


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    what   the cause
    where  the place: file:line, column, row
    cure   the remedy
    """

    what: str
    where: str | None = None
    cure: str | None = None

    def __str__(self) -> str:
        place = "" if self.where is None else f"{self.where}: "
        remedy = "" if self.cure is None else f"; {self.cure}"
        return printable(f"{place}{self.what}{remedy}")


def printable(text: str, kept: str = "") -> str:
    """The text on one line of a terminal: control characters and what turns or hides text are shown escaped (\\x1b).

    `kept` are those that stay, such as line breaks.
    """
    return re.sub(
        r"[^ -~]",
        lambda c: ascii(c[0])[1:-1] if unicodedata.category(c[0]) in _UNSEEN and c[0] not in kept else c[0],
        text,
    )


class DashpotError(Exception):
    """Base of all errors that a user can cause or cure.  `exit_code` is what the command line returns.

    causes: findings of a diagnosis (`estimate.assessment.Finding`), the most probable first.
    """

    exit_code = 2
    causes: tuple[object, ...] = ()

    def __init__(
        self, what: str | Iterable[Problem], where: str | None = None, cure: str | None = None
    ) -> None:
        self.problems: tuple[Problem, ...] = (
            (Problem(what, where, cure),) if isinstance(what, str) else tuple(what)
        )
        super().__init__("\n".join(str(problem) for problem in self.problems))


class ModelError(DashpotError):
    """The rig file or the model is wrong."""


class DataError(DashpotError):
    """A data file, a record or a spectrum is wrong, or does not fit the model."""


class UsageError(DashpotError):
    """A method or an option cannot be used here."""


class IdentifiabilityError(DashpotError):
    """These data, or any data of these channels, cannot determine the unknown parameters."""

    exit_code = 3


class ConvergenceError(DashpotError):
    """An iteration did not converge."""

    exit_code = 3
