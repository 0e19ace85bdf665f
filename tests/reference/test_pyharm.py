"""Harmonic balance against pyHarm, an independent code, at equal harmonics and instants (figures: make_pyharm.py)."""

import json
from pathlib import Path

import numpy as np
import pytest

from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.nonlinear.harmonics import Drive
from tests.networks import network

FIGURES = json.loads((Path(__file__).parent / "pyharm.json").read_text(encoding="utf-8"))
INSTANTS = 512
LAWS = {
    "cubic": (1e9, {}),
    "jenkins": (4000.0, {"slip": 2.0 / 4000}),
    "coulomb": (2.0, {"v0": 0.03}),
    "gap": (6000.0, {"gap": 5e-4}),
    "one-sided": (6000.0, {"gap": 3e-4}),
}


def rig(law):
    constants = [Constant(name, value) for name, value in LAWS[law][1].items()]
    spring = between("q", Kind.SPRING, "x2", "ground", value=LAWS[law][0])
    return network(
        "x1 x2",
        "f@x1",
        "m1@x1=3 m2@x2=2.7 k1:x1-x2=4600 k2:x2-ground=4600 c1:x1-x2=20 c2:x2-ground=20",
        type(spring)("q", Kind.SPRING, spring.along, value=spring.value, force_law=force_law(law, constants)),
    )


@pytest.mark.parametrize("law", LAWS)
def test_motions_are_those_of_pyharm(law):
    parts = np.array(FIGURES["x1_x2_by_case"][law])  # (frequencies, coordinates, orders, 2)
    reference = np.moveaxis(parts[..., 0] + 1j * parts[..., 1], 1, 2)
    model, (rows, orders) = rig(law), reference.shape[:2]
    f = np.zeros((rows, orders, 1), dtype=complex)
    f[:, 1] = FIGURES["force"]
    drive = Drive(2 * np.pi * np.array(FIGURES["frequency_hz"]), np.zeros((rows, orders, 0), complex), f)
    theta = np.zeros(0)
    p, constants = (
        np.tile(values, (rows, 1)) for values in (model.parameters(theta), model.inner_constants(theta))
    )
    at = periodic_response(model, p, constants, drive, times=INSTANTS)
    assert np.all(at.converged)
    away = np.max(np.abs(at.X - reference), axis=(1, 2)) / np.max(np.abs(reference), axis=(1, 2))
    assert np.max(away) < 1e-6
