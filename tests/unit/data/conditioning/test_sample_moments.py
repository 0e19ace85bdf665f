"""Second moments against those of samples projected by hand."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from tests.unit.data.conditioning.signals import X1, X2


@pytest.mark.parametrize("drift", [None, 0, 1])
def test_second_moments_are_those_of_the_projected_samples(drift):
    rng = np.random.default_rng(17)
    t = np.arange(150) / 20
    y = 3 + rng.normal(size=(2, 150, 2))
    channels = (replace(X1, gain=2.0, sign=-1.0), X2)
    lines = spectrum([Record(channels, t, y, 1.1)], moments=True, drift=drift)
    waves = np.stack([np.cos(2 * np.pi * 1.1 * t), np.sin(2 * np.pi * 1.1 * t)], axis=-1)
    for i in range(2):
        q = np.concatenate([y[i] * [-0.5, 1], waves], axis=1)
        if drift is not None:
            A = np.vander(t - t.mean(), drift + 1)
            q = q - A @ np.linalg.lstsq(A, q, rcond=None)[0]
        np.testing.assert_allclose(lines.moments.products[i, 0], q.T @ q, rtol=1e-10, atol=1e-9)
