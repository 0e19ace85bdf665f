"""Sizes of unknown parameters that go with what is known of a rig, where nobody says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dashpot.model.elements import Kind
from dashpot.model.network import Model

RATE = 30.0  # rad/s, where nothing tells
DAMPING = 0.05


def typical(model: Model) -> tuple[Mapping[Kind, float], float]:
    """(a parameter's size by kind, a typical ω in rad/s) from known values and guesses."""
    m = _middle(model, (Kind.MASS, Kind.INERTER))
    k = _middle(model, (Kind.SPRING,))
    c = _middle(model, (Kind.DAMPER,))
    if m is not None and k is not None:
        rate = float(np.sqrt(k / m))
    elif k is not None and c is not None:
        rate = 2 * DAMPING * k / c
    elif m is not None and c is not None:
        rate = c / m / (2 * DAMPING)
    else:
        rate = RATE
    if m is None:
        m = k / rate**2 if k is not None else c / rate / (2 * DAMPING) if c is not None else 1.0
    if k is None:
        k = m * rate**2
    if c is None:
        c = 2 * DAMPING * m * rate
    sizes = {Kind.MASS: m, Kind.INERTER: m, Kind.SPRING: k, Kind.DAMPER: c, Kind.HYSTERETIC: 2 * DAMPING * k}
    return sizes, rate


def _middle(model: Model, kinds: tuple[Kind, ...]) -> float | None:
    """Geometric mean of the values and guesses of some kinds; None where there are none."""
    numbers = [e.value if e.value is not None else e.guess for e in model.elements if e.kind in kinds]
    given = [number for number in numbers if number is not None and number > 0]
    return float(np.exp(np.mean(np.log(given)))) if given else None
