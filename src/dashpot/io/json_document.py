"""JSON as dashpot writes and reads it: UTF-8, indented by one, and null for what is not a finite number."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def to_json(content: object) -> str:
    """The text of a JSON file.  Takes NumPy's numbers and arrays; NaN and infinities, which JSON has not, are null."""
    return json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def from_json(text: str | bytes) -> Any:
    """The content of a JSON text.  Raises ValueError where it is none.

    NaN and infinities, which other programs write, are read as such: whoever wants a number says where one is missing.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists or tables are nested too deep") from None


def nullable(value: float | None, missing: float = math.nan) -> float:
    """A number that may be null, which stands for `missing`."""
    return missing if value is None else float(value)


def _plain(content: object) -> object:
    match content:
        case np.generic() | np.ndarray():
            return _plain(content.tolist())
        case float() if not math.isfinite(content):
            return None
        case Mapping():
            return {key: _plain(value) for key, value in content.items()}
        case list() | tuple():
            return [_plain(value) for value in content]
    return content
