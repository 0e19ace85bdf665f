"""Predictions of records that an estimate was not made from."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot import Channel, Input, Kind, Model, between, dwells, identify, mass, simulate_spectrum
from dashpot.check.validation import validate

MODEL = Model(
    ("x1", "x2"),
    (Input("u"),),
    (
        mass("m1", "x1"), mass("m2", "x2", value=2.7), between("k1", Kind.SPRING, "x1", "x2"),
        between("k2", Kind.SPRING, "x2", "u", value=4600.0), between("c1", Kind.DAMPER, "x1", "x2"),
        between("c2", Kind.DAMPER, "x2", "u"),
    ),
)  # fmt: skip
TRUTH = {"m1": 3.0, "k1": 4600.0, "c1": 5.0, "c2": 8.0}
LINES = np.linspace(1, 12, 400)


@pytest.mark.parametrize("noise_of_input", [0.0, 2e-2])
def test_chi2_counts_the_noise_of_the_inputs_that_the_rig_passes_on(noise_of_input: float) -> None:
    """800 squares of each channel, predicted by the true rig: 1 ± 0.05; the seed is fixed."""
    channels = (
        Channel("x1", {"x1": 1.0}, noise=5e-2),
        Channel("x2", {"x2": 1.0}, noise=5e-2),
        Channel("u", {"u": 1.0}, noise=noise_of_input),
    )
    p = MODEL.parameters(MODEL.theta(TRUTH))
    test = dwells(MODEL, LINES, 50)
    first, second = (
        simulate_spectrum(MODEL, p, channels, test, np.random.default_rng(seed)) for seed in (1, 2)
    )
    (predicted,) = validate(MODEL, identify(MODEL, first), second)
    assert predicted.channels == ("x1", "x2")
    np.testing.assert_allclose(predicted.chi2 / predicted.dof, 1.0, atol=0.2)
    rms = np.sqrt(np.mean(np.abs(predicted.measured - predicted.predicted) ** 2, axis=0))
    alone = np.mean(np.abs(predicted.measured) ** 2, axis=0)
    np.testing.assert_allclose(predicted.fit, 1 - rms / np.sqrt(alone))
