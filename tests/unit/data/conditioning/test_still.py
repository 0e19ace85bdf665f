"""The noise of a channel while it is at rest within a record, and the most that it can be by its spectrum."""

import numpy as np
import pytest
from scipy.signal import lfilter

from dashpot.data.noise import most_noise, variance_at_rest

SAMPLES = 6000


def blow(samples: int = SAMPLES, length: int = 6, height: float = 300.0) -> np.ndarray:
    """A half sine in a record that is at rest otherwise."""
    values = np.zeros(samples)
    values[1000 : 1000 + length] = height * np.sin(np.pi * (np.arange(length) + 0.5) / length)
    return values


@pytest.mark.parametrize("seed", range(5))
def test_noise_before_and_after_a_blow_is_found(seed: int) -> None:
    noise = 0.7 * np.random.default_rng(seed).normal(size=SAMPLES)
    assert variance_at_rest(blow() + noise) == pytest.approx(0.49, rel=4 * (2 / SAMPLES) ** 0.5)


def test_noise_before_an_earthquake_is_found() -> None:
    rng = np.random.default_rng(5)
    motion = lfilter([1.0], [1.0, -1.9, 0.98], rng.normal(size=SAMPLES))
    motion[:1000] = 0.0
    assert variance_at_rest(motion + 0.5 * rng.normal(size=SAMPLES)) == pytest.approx(0.25, rel=0.2)


def test_a_drift_is_no_noise() -> None:
    noise = 0.7 * np.random.default_rng(6).normal(size=SAMPLES)
    assert variance_at_rest(blow() + noise + np.linspace(0, 30, SAMPLES)) == pytest.approx(0.49, rel=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_what_never_rests_tells_nothing(seed: int) -> None:
    """White noise, a resonance that random noise drives, a sweep that grows."""
    rng = np.random.default_rng(seed)
    assert variance_at_rest(rng.normal(size=SAMPLES)) == 0.0
    resonance = lfilter([1.0], [1.0, -1.9, 0.98], rng.normal(size=SAMPLES))
    assert variance_at_rest(resonance + 0.1 * rng.normal(size=SAMPLES)) == 0.0
    t = np.linspace(0, 1, SAMPLES)
    assert variance_at_rest(t * np.sin(200 * t * (1 + t)) + 0.001 * rng.normal(size=SAMPLES)) == 0.0


def test_a_rest_with_a_hum_or_without_noise_tells_nothing() -> None:
    rng = np.random.default_rng(7)
    assert variance_at_rest(blow()) == 0.0
    hum = lfilter([1.0], [1.0, -0.9], rng.normal(size=SAMPLES))
    assert variance_at_rest(blow(height=3000.0) + hum) == 0.0


@pytest.mark.parametrize("samples", [1000, 30_000])
def test_the_most_that_white_noise_can_be(samples: int) -> None:
    """40 channels of noise, half of them under a drift that ends elsewhere: the bound is rarely below, never far."""
    rng = np.random.default_rng(6)
    values = rng.normal(size=(samples, 40))
    values[:, :20] += np.linspace(0, 10, samples)[:, None]
    most = most_noise(np.fft.rfft(values, axis=0)[1:] * (2 / samples)) * samples / 4
    assert np.mean(most < 1) < 0.2  # 5 % expected, of 40
    assert np.min(most) > 0.85
    assert np.mean(most) < 1.4
