"""What to do about a notice, by its code; the options of the command line are named here and in `app` alone."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dashpot.notices import Notice

# Of data that are time records: how they become amplitudes can be changed.
RECORD_REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "coloured_noise": (
            "a transient or a slightly wrong drive frequency looks the same: try --settle auto and --refine always"
        ),
        "transient_undetectable": "state the settling time, such as --settle 2s",
    }
)


def with_remedy(notice: Notice, *, records: bool = True) -> str:
    """The notice, followed by the option that helps where there is one; `records`: whether it concerns time records."""
    remedy = RECORD_REMEDIES.get(notice.code) if records else None
    return notice.text if remedy is None else f"{notice.text}; {remedy}"
