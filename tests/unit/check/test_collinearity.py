"""Weak combinations, and lines that carry nothing."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.evidence import collinearity
from dashpot.check.profile import chi2_surface
from dashpot.estimate.identify import identify
from tests.networks import network
from tests.rigs import Rig, measured, paper_rig


def two_dampers() -> Rig:
    """A damper and a hysteretic one side by side, lines within 2 %: only ω c + h is seen well."""
    model = network("x", "u", "m@x=1 k:x-u c:x-u h:x-u")
    f = np.array([2.97, 3.0, 3.03])
    return Rig(model, np.array([400.0, 2.0, 40.0]), f, np.full((3, 1), 1e-2 + 0j), np.zeros((3, 0), complex))


def test_a_weak_combination_is_named_with_its_effect() -> None:
    rig = two_dampers()
    spectrum = measured(rig, 1e-5)
    estimate = identify(rig.model, spectrum)
    found = collinearity(chi2_surface(rig.model, spectrum, estimate), estimate.covariance)
    [weak] = found.combinations
    assert set(weak.names) == {"c", "h"}
    omega = 2 * np.pi * 3.0
    change = dict(zip(weak.names, weak.direction, strict=True))
    # ω δc + δh = 0
    assert omega * estimate["c"].value * change["c"] == pytest.approx(
        -estimate["h"].value * change["h"], rel=0.02
    )
    # The effect is checked by knowing one of them.
    best = rig.knowing({weak.best: {"value": estimate[weak.best].value}})
    again = identify(best.model, spectrum)
    other = ({"c", "h"} - {weak.best}).pop()
    assert again[other].sd / estimate[other].sd == pytest.approx(weak.narrowing, rel=0.05)
    both = rig.knowing({"k": {"value": estimate["k"].value}, weak.best: {"value": estimate[weak.best].value}})
    alone = identify(both.model, spectrum)[other].sd
    assert estimate[other].sd / alone == pytest.approx(weak.widening[weak.names.index(other)], rel=0.05)


def test_a_sound_test_has_no_weak_combination_and_shares_add_up() -> None:
    rig = paper_rig()
    spectrum = measured(rig)
    estimate = identify(rig.model, spectrum)
    found = collinearity(chi2_surface(rig.model, spectrum, estimate), estimate.covariance)
    assert found.combinations == ()
    np.testing.assert_allclose(np.sum(found.shares, axis=0), 1.0)
    assert found.idle == ()


def test_a_line_with_a_thousand_times_the_noise_is_idle() -> None:
    rig = paper_rig()
    spectrum = measured(rig)
    V = spectrum.covariance.copy()
    V[7] *= 1e6
    loud = replace(spectrum, covariance=V)
    estimate = identify(rig.model, loud)
    assert collinearity(chi2_surface(rig.model, loud, estimate), estimate.covariance).idle == (7,)
