"""Inputs: what drives a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

InputKind = Literal["displacement", "force"]


@dataclass(frozen=True)
class Input:
    """A prescribed displacement, or a force.

    name  of the input
    kind  "displacement" or "force"
    at    of a force: coordinates and their factors, or arms in m
    """

    name: str
    kind: InputKind = "displacement"
    at: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", MappingProxyType(dict(self.at)))

    def __reduce__(self) -> tuple[object, ...]:
        return (Input, (self.name, self.kind, dict(self.at)))

    def __hash__(self) -> int:
        return hash((self.name, self.kind, frozenset(self.at.items())))
