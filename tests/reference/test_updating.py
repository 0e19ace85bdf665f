"""Published cases of parameters from modes."""

from __future__ import annotations

import numpy as np
import pytest

import dashpot
from dashpot.data.modal_data import independent_modes
from dashpot.model.elements import Element, Kind
from dashpot.model.modes import eigenpairs
from dashpot.model.network import Model


@pytest.mark.long
def test_eighteen_storeys_are_found_from_guesses_far_off() -> None:
    """Four modes at seven sensors, without noise (Otsuki et al. 2021, doi 10.1177/13694332211022066)."""
    nominal = 1e5 * np.array(
        [1155, 1092, 1073, 1028, 1028, 990, 963, 938, 876, 840, 824, 788, 712, 660, 619, 562, 491, 363]
    )
    actual = nominal * (1 + 0.05 * np.array([1, 1, -1, -2, 2, -3, 3, 5, -2, 4, 6, 5, -3, 1, -3, 2, 4, 4]))
    guesses = nominal * np.random.default_rng(1).uniform(0, 2, 18)  # as in its runs
    points = [f"x{i + 1}" for i in range(18)]
    parts = [
        Element(f"m{i}", Kind.MASS, {points[i]: 1.0}, value=weight * 1e3 / 9.8)
        for i, weight in enumerate([208] * 11 + [206] * 6 + [202])
    ]
    for i, guess in enumerate(guesses.tolist()):
        along = {points[i]: 1.0, points[i - 1]: -1.0} if i else {points[0]: 1.0}
        parts.append(Element(f"k{i}", Kind.SPRING, along, guess=guess))
    model = Model(tuple(points), (), tuple(parts))
    values, shapes = eigenpairs(model, model.parameters(actual[None]))
    first = np.argsort(np.where(values[0].imag > 0, values[0].imag, np.inf))[:4]
    seen = shapes[0, first][:, [0, 3, 6, 8, 11, 14, 17]]
    seen = (seen / seen[np.arange(4), np.argmax(np.abs(seen), axis=1)][:, None]).real.astype(complex)
    hz, none = np.abs(values[0, first]) / (2 * np.pi), np.full(4, np.nan)
    data = independent_modes(
        ("x1", "x4", "x7", "x9", "x12", "x15", "x18"),
        (hz, 1e-4 * hz),
        (none, none),
        (seen, np.full(seen.shape, 1e-3)),
    )
    estimate = dashpot.identify(model, data)
    assert estimate.values == pytest.approx(actual, rel=0.01)
