"""The paper's rig as a test setup, its CASE 3, and data of it: what the tests of design share."""

from __future__ import annotations

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.design.test_setup import ShakerLimits, TestSetup, nominal_setup
from dashpot.quantities import frequencies
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.rigs import paper_rig

CASE3 = "1,1.5,2:4:0.25,5,6,7,8:12:0.5,13,14"
BAND = (0.25, 25.0)


def paper_setup(limits: ShakerLimits | None = None) -> TestSetup:
    rig = paper_rig()
    sensors = [
        Channel(f"{'' if q is Quantity.DISPLACEMENT else 'd'}{x}", {x: 1.0}, q, relative_noise=0.1)
        for q in (Quantity.DISPLACEMENT, Quantity.VELOCITY)
        for x in ("x1", "x2")
    ]
    return nominal_setup(rig.model, [*sensors, Channel("u", {"u": 1.0})], rig.theta, limits=limits)


def measured(setup: TestSetup, samples: int = 56, seed: int = 0, f: str = CASE3) -> Spectrum:
    rng = np.random.default_rng(seed)
    test = dwells(setup.model, frequencies(f), samples)
    return simulate_spectrum(setup.model, setup.p[0], setup.channels, test, rng)
