"""Which multiples of the drive are data."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record

CHANNELS = (Channel("base", {"base": 1.0}), Channel("x1", {"x1": 1.0}))
HARMONICS = {1: (1.0, 1.4), 3: (0.08, 0.2), 5: (0.05, 0.03), 8: (0.02, 0.04)}


def dwell(f: float, harmonics: dict[int, tuple[float, float]], *, periods: int = 20, seed: int = 0) -> Record:
    """60 samples a period, 0.2 % noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(60 * periods) / (60 * f)
    values = np.zeros((len(t), 2))
    for order, sizes in harmonics.items():
        values += np.cos(2 * np.pi * order * f * t + order)[:, None] * sizes
    return Record(CHANNELS, t, values + 2e-3 * rng.normal(size=values.shape), f)


def test_harmonics_that_every_channel_shows_are_lines() -> None:
    lines = spectrum([dwell(f, HARMONICS, seed=k) for k, f in enumerate((1.0, 1.7))])
    assert np.allclose(lines.frequency_hz, np.outer([1.0, 1.7], list(HARMONICS)).ravel())
    assert np.allclose(np.abs(lines.amplitudes), 2 * list(HARMONICS.values()), atol=5e-4)
    assert [note.code for note in lines.notes] == ["settled_dwells", "harmonics_driven"]
    assert spectrum([dwell(1.0, HARMONICS)], orders=(1,)).lines == 1


@pytest.mark.parametrize(
    "harmonics",
    [
        {1: (1.0, 1.4)},
        {1: (1.0, 1.4), 3: (0.0, 0.2)},  # the response alone: distortion
        {1: (1.0, 1.4), 3: (0.003, 0.004)},  # significant, but small
    ],
)
def test_fundamentals_alone(harmonics: dict[int, tuple[float, float]]) -> None:
    lines = spectrum([dwell(f, harmonics, seed=k) for k, f in enumerate((1.0, 1.7))])
    assert np.allclose(lines.frequency_hz, [1.0, 1.7])


def test_one_dwell_of_many_does_not_make_it_so() -> None:
    rich, plain = dwell(1.0, HARMONICS), {1: (1.0, 1.4)}
    assert spectrum([rich, *(dwell(f, plain) for f in (1.7, 2.0, 2.5))]).lines == 4
    assert spectrum([rich, dwell(1.7, HARMONICS, periods=4)]).lines == len(HARMONICS) + 1


def test_second_moments_belong_to_fundamentals() -> None:
    assert spectrum([dwell(1.0, HARMONICS)], moments=True).lines == 1
