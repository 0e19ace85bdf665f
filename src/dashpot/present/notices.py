"""Every notice explained, from `notices.toml`, and what to do about those for which an option may help."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dashpot.io.words import joined
from dashpot.notices import Notice

REMEDIED = "coloured_noise"
# Treatments of records that may help there, and how they are asked for.
OPTIONS = {"settle": "--settle auto", "refine": "--refine always"}


@dataclass(frozen=True)
class Explained:
    """place: where such notices arise; meaning and cure in Markdown."""

    place: str
    meaning: str
    cure: str


@cache
def notice_guide() -> Mapping[str, Explained]:
    """Code → its explanation; a test holds it complete."""
    text = Path(__file__).with_name("notices.toml").read_text(encoding="utf-8")
    return {
        code: Explained(place, **said)
        for place, codes in tomllib.loads(text).items()
        for code, said in codes.items()
    }


def with_remedy(notice: Notice, *, untried: Collection[str] = tuple(OPTIONS)) -> str:
    """The notice, followed by the options that may help; `untried`: treatments of records that were not chosen."""
    options = [option for treatment, option in OPTIONS.items() if treatment in untried]
    if notice.code != REMEDIED or not options:
        return notice.text
    same = "a transient or a slightly wrong drive frequency looks the same"
    return f"{notice.text}; {same}: try {joined(options)}"
