"""Libraries that only some uses need: imported when they are asked for, with an error that names the extra."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from dashpot.errors import UsageError


def optional_library(module: str, extra: str, purpose: str) -> Any:
    """An optional module.  Raises UsageError that names the extra where it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        raise UsageError(
            f"{purpose} needs {module.partition('.')[0]}, which is not installed",
            cure=f"install it: pip install 'dashpot[{extra}]'",
        ) from None
