"""One period of a multisine: amplitudes to rounding, and noise from the lines beside that are not excited."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.periods import one_period
from dashpot.data.record import Record
from dashpot.errors import DataError

CHANNELS = (Channel("f", {"f": 1}, gain=2.0), Channel("x", {"x": 1}, delay=1e-3))
N, STEP = 512, 0.01
ODD = tuple(range(1, 101, 2))


def multisine(rng, noise, samples=N, start=0.3):
    t = start + STEP * np.arange(samples)
    X = np.exp(2j * np.pi * rng.uniform(size=(len(ODD), 2))) * [1.0, 0.5]
    waves = np.exp(2j * np.pi * np.outer(t, ODD) / (N * STEP))
    return X, Record(CHANNELS, t, np.real(waves @ X) + noise * rng.normal(size=(samples, 2)), 1 / (N * STEP))


def test_amplitudes_of_a_clean_period_are_exact():
    rng = np.random.default_rng(1)
    X, record = multisine(rng, 0.0, samples=700)
    lines = one_period(record, N * STEP, ODD)
    delay = np.exp(2j * np.pi * lines.frequency_hz * 1e-3)
    assert lines.amplitudes[:, 0] == pytest.approx(X[:, 0] / 2, abs=1e-12)
    assert lines.amplitudes[:, 1] == pytest.approx(X[:, 1] * delay, abs=1e-12)
    assert np.max(np.abs(lines.covariance)) < 1e-24


def test_noise_is_as_large_as_it_is():
    """100 records of 50 lines: the mean of error²/V is dof/(dof - 2) = 1.11, known to 3 %."""
    rng = np.random.default_rng(2)
    ratios = []
    for _ in range(100):
        X, record = multisine(rng, 0.3)
        lines = one_period(record, N * STEP, ODD)
        error = lines.amplitudes[:, 0] - X[:, 0] / 2
        ratios.append(np.mean(np.abs(error) ** 2 / lines.covariance[:, 0, 0].real))
    assert np.mean(ratios) == pytest.approx(20 / 18, rel=0.08)


@pytest.mark.parametrize(
    ("samples", "period", "orders", "what"),
    [
        (400, N * STEP, ODD, "shorter than its period"),
        (N, N * STEP * 1.0007, ODD, "not a whole number of samples"),
        (N, N * STEP, range(1, 101), "nothing shows the noise"),
        (N, N * STEP, [1, 3, 300], "beyond half the sampling rate"),
    ],
)
def test_what_cannot_be_is_said(samples, period, orders, what):
    _, record = multisine(np.random.default_rng(3), 0.1, samples)
    with pytest.raises(DataError, match=what):
        one_period(record, period, orders)
