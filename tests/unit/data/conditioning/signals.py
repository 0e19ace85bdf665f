"""Channels and signals that the tests of conditioning share."""

import numpy as np

from dashpot.channel import Channel

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
