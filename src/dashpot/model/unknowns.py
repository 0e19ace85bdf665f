"""The unknowns of a rig, and parameters that are tied to others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Unknown:
    """One unknown of θ.

    name, unit    of the parameter, SI
    prior, sd     the stated value and its standard deviation, where it is known with one
    guess         where iterations start
    lower, upper  bounds, None where there are none
    """

    name: str
    unit: str
    prior: float | None = None
    sd: float | None = None
    guess: float | None = None
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class Tie:
    """Where an element's parameter comes from: `times` the parameter of the element at index `root`."""

    root: int
    times: float
