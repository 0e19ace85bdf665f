"""Methods of values that are short for functions of the package: `rig.identify(data)` is `dashpot.identify(rig, data)`.

A value knows none of the layers above its own.  The function is looked up in `dashpot.api` by its name when the method
is called, as `dashpot.identify` is when it is used; nothing is imported before.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, cast


def call(function: str, *arguments: Any, **options: Any) -> Any:
    """Call a function of `dashpot.api` by its name."""
    return getattr(import_module("dashpot.api"), function)(*arguments, **options)


class InNotebooks:
    """A value that a notebook shows as a table."""

    def _repr_html_(self) -> str:
        return cast(str, call("html", self))


class Printable(InNotebooks):
    """A result that prints as its command does, and can be drawn."""

    def __str__(self) -> str:
        """What the command prints."""
        return cast(str, call("text", self))

    def plot(self, level: float = 0.95) -> Any:
        """A matplotlib Figure of the values with their intervals."""
        return call("plot", self, level)
