"""Channels at their limit, and channels that only rest."""

import numpy as np
import pytest

from dashpot.data.record import samples_at_limit

TIME = np.arange(2000) / 200
SINE = np.sin(2 * np.pi * 1.7 * TIME)
BLOWS = np.maximum(np.cos(2 * np.pi * 0.1 * (TIME - 1)), 0) ** 400 * 50
NOISE = 0.01 * np.random.default_rng(0).normal(size=len(TIME))


@pytest.mark.parametrize(
    ("values", "clipped"),
    [
        (np.clip(SINE, -0.8, 0.8), True),
        (np.clip(SINE + NOISE, None, 0.9), True),
        (np.clip(BLOWS, None, 30), True),  # a few samples of few blows
        (np.clip(BLOWS + NOISE, None, 30), True),
        (SINE, False),
        (np.round(SINE, 1), False),  # steps of a converter
        (BLOWS, False),  # a force that rests at 0 between the blows
        (np.where(BLOWS > 1, BLOWS, 0.0), False),  # with a window
        (np.zeros(100), False),
        (np.zeros(0), False),
    ],
)
def test_what_rests_at_its_limit(values: np.ndarray, clipped: bool) -> None:
    assert (samples_at_limit(values) > 0) == clipped
