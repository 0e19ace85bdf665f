"""Notices explained by their codes, from the texts of `notice_guide`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dashpot.present.text.notice_guide import NOTICES


@dataclass(frozen=True)
class Explained:
    """place: where such notices arise; meaning and cure in Markdown."""

    place: str
    meaning: str
    cure: str


GUIDE: Mapping[str, Explained] = MappingProxyType(
    {code: Explained(place, meaning, cure) for code, place, meaning, cure in NOTICES}
)
