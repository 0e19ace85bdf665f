"""Masses, dampers and springs of a vibrating rig from noisy test data.

    import dashpot

    rig = dashpot.read_rig("rig.toml")
    estimate = rig.identify("data.csv")
    print(estimate)

Public names, which `__init__.pyi` lists, are loaded when they are first used, so that `import dashpot` costs nothing.
"""

from __future__ import annotations

import re
from importlib import import_module
from types import FunctionType

_LISTED = __spec__.loader.get_data(f"{__file__}i").decode()
_HOME = {name: home for home, name in re.findall(r"^from (\S+) import \w+ as (\w+)$", _LISTED, re.MULTILINE)}

__all__ = ["__version__", *_HOME]  # noqa: PLE0604, names as text


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version("dashpot")
    if name not in _HOME:
        raise AttributeError(f"module 'dashpot' has no attribute {name!r}")
    attribute = getattr(import_module(_HOME[name]), name)
    if isinstance(attribute, FunctionType):
        attribute = import_module("dashpot.shorthand").refusing(attribute)
        attribute.__module__ = "dashpot"  # under which pickle finds it again
    globals()[name] = attribute
    return attribute


def __dir__() -> list[str]:
    return sorted(__all__)
