"""The mirror image of a rig: even laws change sign, odd ones stay, others have none."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.model.nonlinear.harmonics import mirrored
from tests.nonlinear_rigs import LAWS, two_masses

CHANGED = {"square": ["q"], "d**3 + b*d**2": ["q.b"]}
WITHOUT = ("cubic", "quintic", "v*abs(v)", "coulomb", "stribeck", "gap", "jenkins", "backlash", "bouc-wen")


@pytest.mark.parametrize("law", CHANGED)
def test_even_laws_change_sign(law):
    model, theta = two_masses(law)
    image = mirrored(model, theta)
    names = [u.name for u, a, b in zip(model.unknowns, theta, image, strict=True) if a != b]
    assert names == CHANGED[law]
    assert np.array_equal(np.abs(image), theta)


@pytest.mark.parametrize("law", [*WITHOUT, "one-sided", "bilinear"])
def test_odd_laws_are_their_own_image_and_one_sided_ones_have_none(law):
    assert law in LAWS
    assert mirrored(*two_masses(law)) is None


def test_known_parameters_are_kept():
    model, theta = two_masses("square")
    known = replace(model, elements=(*model.elements[:-1], replace(model.elements[-1], value=theta[-1])))
    assert mirrored(known, theta[:-1]) is None
