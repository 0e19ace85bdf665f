"""Channels and signals that the tests of conditioning share."""

import numpy as np
from scipy.signal import lfilter

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.record import Record

X1, X2, U = Channel("x1", {"x1": 1}), Channel("x2", {"x2": 1}), Channel("u", {"u": 1})


def wave(t, f, amplitudes):
    """Re(X e^{jωt}), (samples, channels)."""
    return np.real(np.exp(2j * np.pi * f * t)[:, None] * np.asarray(amplitudes))


def coloured(rng, a, *shape):
    """AR(1) noise e_t = a e_{t−1} + white, stationary, along the axis before the last."""
    e = rng.normal(size=shape)
    e[..., 0, :] /= np.sqrt(1 - a**2)
    for i in range(1, shape[-2]):
        e[..., i, :] += a * e[..., i - 1, :]
    return e


def noisy_sines(
    memory: float,
    alike: float,
    rng: np.random.Generator,
    noise: float = 0.05,
    jitter: float = 0.0,
    periods: int = 12,
) -> list[Record]:
    """Sines under noise with memory of first order that is partly common to both channels, jitter in steps."""
    records = []
    for f in (4.0, 7.0):
        t = np.arange(20 * periods) / (20 * f)
        e: Real = rng.normal(size=(len(t), 2))
        e[:, 1] = np.sqrt(1 - alike**2) * e[:, 1] + alike * e[:, 0]
        e = lfilter([1.0], [1.0, -memory], e, axis=0) * (1 - memory**2) ** 0.5
        turn = 2 * np.pi * f * (t + jitter / (20 * f) * rng.normal(size=len(t)) if jitter else t)
        values = np.stack([np.sin(turn), 0.3 * np.sin(turn + 1)], axis=-1)
        records.append(Record((X1, U), t, values + noise * e, f))
    return records
