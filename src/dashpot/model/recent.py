"""What has been made of a model lately, kept because it is asked for over and over."""

from __future__ import annotations

from typing import Any

MOST = 8


class Recent(dict[tuple[object, ...], Any]):
    """The last MOST entries; the oldest goes where there are more."""

    def __setitem__(self, key: tuple[object, ...], value: Any) -> None:
        if key not in self and len(self) >= MOST:
            del self[next(iter(self))]
        super().__setitem__(key, value)
