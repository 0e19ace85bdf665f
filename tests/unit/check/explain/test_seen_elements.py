"""Nonlinear elements beside those that a rig has, by the equation of motion."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.examine import diagnose
from dashpot.check.explain.laws import seen_candidates
from dashpot.check.explain.problem import LineProblem
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import Constant, force_law
from tests.nonlinear_rigs import motions, settled, two_masses


def beside(law):
    """A rig with the law alone, and dwells of it with a stop at the lower mass too, 0.3 % noise."""
    model, theta = two_masses(law)
    stop = replace(
        between("stop", Kind.SPRING, "x1", "ground", value=6000.0),
        force_law=force_law("gap", [Constant("gap", 2e-4)]),
    )
    struck = replace(model, elements=(*model.elements, stop))
    spectrum = settled(
        struck, theta, motions("x1", "x2", "u"), np.linspace(4, 12, 14), amplitude=4e-4, orders=(1, 3, 5), noise=3e-3,
        rng=np.random.default_rng(8),
    )  # fmt: skip
    return model, theta, spectrum


@pytest.mark.parametrize("law", ["v**3", "v*abs(v)"])
def test_the_element_that_is_missing_beside_the_rigs_own_law_explains_most(law):
    """The fit without it is far off, and so is the constant inside the rig's own law."""
    model, theta, spectrum = beside(law)
    first, *_ = seen_candidates(
        LineProblem(prepare(model, spectrum), np.ones(len(spectrum.channels)), (1.5 * theta,))
    )
    assert first.element.name == "gap_spring_x1_ground"
    assert first.fall > 0.8 * first.chi2
    assert first.value == pytest.approx(6000.0, rel=0.3)


def test_a_rig_with_a_law_of_its_own_that_no_values_make_fit_is_told_which_element_it_lacks():
    """Its known mass contradicts the motion: the likeliest rig is endlessly heavy."""
    model, _, spectrum = beside("v*abs(v)")
    with pytest.raises(IdentifiabilityError):
        identify(model, spectrum, "ml")
    (first, *_) = diagnose(model, spectrum)
    assert (first.kind, first.of) == ("nonlinear", ("x1", "ground"))
    assert first.remaining < 1.5
    assert first.elements[0].force_law.text == "gap"
