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
    m, c, k = _middle(model, "M"), _middle(model, "C"), _middle(model, "K")
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
    middle: dict[str, float | None] = {"M": m, "C": c, "K": k}
    sizes = {}
    for kind in Kind:
        size = middle.get(kind.law.matrix)
        sizes[kind] = kind.law.typical_size(m, rate, DAMPING) if size is None else size
    return sizes, rate


def _middle(model: Model, letter: str) -> float | None:
    """Geometric mean of the values and guesses of the elements of a matrix; None where there are none."""
    elements = [
        e for e in model.elements if e.law.matrix == letter and e.force_law is None and e.block is None
    ]
    numbers = [e.value if e.value is not None else e.guess for e in elements]
    given = [number for number in numbers if number is not None and number > 0]
    return float(np.exp(np.mean(np.log(given)))) if given else None
