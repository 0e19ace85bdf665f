"""What channels show that measured nothing, and that it is named before any remedy of the channel."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Complex
from dashpot.check.explain.examine import diagnose
from dashpot.check.verdict import silent_channels
from dashpot.data.spectrum import Spectrum
from tests.unit.data.test_local_noise import RIG, functions


def of_a_test(x1: Complex | None = None) -> Spectrum:
    """Twelve lines with 1 % noise, its size known; x1 as given."""
    lines = functions(12, 0.01)
    Y = lines.amplitudes.copy()
    size = 0.01**2 * np.abs(Y[:, :2]) ** 2
    covariance = np.zeros((12, 3, 3), dtype=complex)
    covariance[:, [0, 1], [0, 1]] = size + 0.01 * np.mean(size, axis=0)
    if x1 is not None:
        Y[:, 0] = x1
    return replace(lines, amplitudes=Y, covariance=covariance, noise=("given",) * 12)


def noise_alone(seed: int) -> Complex:
    sd = np.sqrt(of_a_test().covariance[:, 0, 0].real / 2)
    rng = np.random.default_rng(seed)
    return sd * (rng.standard_normal(12) + 1j * rng.standard_normal(12))


@pytest.mark.parametrize(
    ("x1", "shows"),
    [
        (np.zeros(12, dtype=complex), "no motion"),
        (np.full(12, 1e-4 + 2e-5j), "same value"),
        (noise_alone(1), "mostly noise"),
    ],
    ids=["still", "stuck", "noise"],
)
def test_a_channel_that_measured_nothing_is_the_first_cause_and_no_gain_of_it_is(x1, shows):
    data = of_a_test(x1)
    (said,) = silent_channels(RIG, data).values()
    assert shows in said
    found = diagnose(RIG, data)
    assert (found[0].kind, found[0].of) == ("channel", ("x1",))
    assert shows in found[0].text
    assert not [each for each in found[1:] if "x1" in each.of]


def test_channels_that_move_are_not_silent():
    assert silent_channels(RIG, of_a_test()) == {}
