"""Weighted means of channels that each show one point: the kernel against NumPy and the full least squares."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.estimate.preparation import reconstruction, states_by_point
from dashpot.model.observation import observation_model
from dashpot.numerics.kernel import using
from tests.kernels import compiled
from tests.rigs import channels, covariance, noisy, random_rig

REPEATS = 3
TWICE = (Quantity.DISPLACEMENT, Quantity.VELOCITY)  # of every point


@pytest.mark.parametrize("seed", range(6))
def test_states_of_the_kernel_are_those_of_numpy(seed: int) -> None:
    """With exact inputs and noisy ones, channels missing at some lines, and noise of each repeat's own."""
    compiled()
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 1 + seed % 3, forces=1)
    V = covariance(rig, channels(rig, TWICE), 0.05, inputs=0.03 * (seed % 2))
    spectrum = noisy(rig, channels(rig, TWICE), V, rng, REPEATS)
    view = observation_model(rig.model, spectrum.channels, spectrum.omega)
    V = V * rng.uniform(0.5, 2, (REPEATS, 1, 1, 1)) if seed % 3 == 0 else V[None]
    used = np.ones((rig.lines, len(spectrum.channels)), dtype=bool)
    used[::3, 0] = False
    with using("numpy"):
        twin = states_by_point(view, used, V, spectrum.amplitudes)
    with using("compiled"):
        found = states_by_point(view, used, V, spectrum.amplitudes)
    assert twin is not None
    for values, expected in zip(found, twin, strict=True):
        np.testing.assert_allclose(values, expected, rtol=1e-12)
    amplitudes = np.where(used, spectrum.amplitudes, np.nan)
    P = reconstruction(view, replace(spectrum, amplitudes=amplitudes), V)
    np.testing.assert_allclose(found[2], P, rtol=1e-9, atol=1e-9 * np.abs(P).max())


@pytest.mark.parametrize("choice", ["numpy", "compiled"])
def test_correlated_channels_and_exact_ones_of_one_point_are_left_to_least_squares(choice: str) -> None:
    if choice == "compiled":
        compiled()
    rng = np.random.default_rng(1)
    rig = random_rig(rng, 2)
    V = covariance(rig, channels(rig, TWICE), 0.05)
    spectrum = noisy(rig, channels(rig, TWICE), V, rng, REPEATS)
    view = observation_model(rig.model, spectrum.channels, spectrum.omega)
    used = np.ones((rig.lines, len(spectrum.channels)), dtype=bool)
    correlated = V[None].copy()
    correlated[..., 0, 1] = correlated[..., 1, 0] = 0.1 * V[..., 0, 0]
    with using(choice):
        assert states_by_point(view, used, correlated, spectrum.amplitudes) is None
        assert states_by_point(view, used, np.zeros_like(V)[None], spectrum.amplitudes) is None
