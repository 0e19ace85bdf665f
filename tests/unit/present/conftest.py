"""A rig, a test of it, and estimates that fit and that do not."""

import numpy as np
import pytest

from dashpot import Estimate, Model, Spectrum, dwells, identify, parse_rig, simulate_spectrum

RIG = parse_rig(
    """
name = "Frame <script>alert(1)</script>"
coordinates = ["x1", "x2"]
[inputs]
u = {}
[masses]
m1 = { at = "x1" }
m2 = { at = "x2", value = 2.7 }
[springs]
k1 = { between = ["x1", "x2"] }
k2 = { between = ["x2", "u"], same_as = "k1", times = 1.5 }
[dampers]
c1 = { between = ["x1", "x2"] }
c2 = { between = ["x2", "u"] }
[channels]
x1 = { of = "x1", noise = 0.01 }
x2 = { of = "x2", noise = 0.01 }
u = { of = "u" }
"""
)
VALUES = {"m1": 3.0, "k1": 4600.0, "c1": 20.0, "c2": 30.0}


def measured(model: Model = RIG.model, extra: float = 0.0) -> Spectrum:
    """A test of the rig; with `extra` its first mass is heavier below the middle frequency: no model fits."""
    p = model.parameters(model.theta(VALUES))
    rng = np.random.default_rng(3)
    low = simulate_spectrum(model, p, RIG.channels, dwells(model, [1.0, 2, 3, 4, 5], 200), rng)
    heavy = model.parameters(model.theta({**VALUES, "m1": 3.0 + extra}))
    return low + simulate_spectrum(model, heavy, RIG.channels, dwells(model, [6.0, 8, 10, 15, 20], 200), rng)


@pytest.fixture(scope="session")
def good() -> Estimate:
    return identify(RIG.model, measured())


@pytest.fixture(scope="session")
def bad() -> Estimate:
    return identify(RIG.model, measured(extra=0.2))
