"""Fingerprints: digests of values of which every bit counts and no order that means nothing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np


def fingerprint_of(value: object) -> str:
    """SHA-256 of the canonical form of a value: equal values have equal ones, whoever computes them.

    Raises TypeError for a value that has no canonical form.
    """
    return hashlib.sha256(json.dumps(_canonical(value)).encode()).hexdigest()


def fields_of(value: object) -> list[tuple[str, object]]:
    """Names and values of a dataclass's fields."""
    assert is_dataclass(value)
    return [(field.name, getattr(value, field.name)) for field in fields(value)]


def _canonical(value: object) -> object:
    """A value as JSON of which every bit counts and no order that means nothing: equal values give equal texts."""
    if isinstance(value, Enum):
        return _canonical(value.value)
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [str(array.dtype), list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]
    if is_dataclass(value):
        return {name: _canonical(content) for name, content in fields_of(value)}
    if isinstance(value, Mapping):
        return {str(key): _canonical(value[key]) for key in sorted(value)}
    if isinstance(value, frozenset | set):
        return [_canonical(entry) for entry in sorted(value)]
    if isinstance(value, tuple | list):
        return [_canonical(entry) for entry in value]
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(f"{type(value).__name__} has no canonical form")
