"""What to do about a notice, by its code."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dashpot.notices import Notice

REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "coloured_noise": (
            "a transient or a slightly wrong frequency looks the same: for records, --settle and --refine remove them"
        ),
    }
)


def with_remedy(notice: Notice) -> str:
    """The notice, followed by what can be done about it where that takes an option of the command line."""
    remedy = REMEDIES.get(notice.code)
    return notice.text if remedy is None else f"{notice.text}; {remedy}"
