"""What to do about a notice, by its code; the options of the command line are named here and in `app` alone."""

from __future__ import annotations

from collections.abc import Collection

from dashpot.io.words import joined
from dashpot.notices import Notice

REMEDIED = "coloured_noise"
# Treatments of records that may help there, and how they are asked for.
OPTIONS = {"settle": "--settle auto", "refine": "--refine always"}


def with_remedy(notice: Notice, *, untried: Collection[str] = tuple(OPTIONS)) -> str:
    """The notice, followed by the options that may help; `untried`: treatments of records that were not chosen."""
    options = [option for treatment, option in OPTIONS.items() if treatment in untried]
    if notice.code != REMEDIED or not options:
        return notice.text
    same = "a transient or a slightly wrong drive frequency looks the same"
    return f"{notice.text}; {same}: try {joined(options)}"
