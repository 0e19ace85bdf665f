"""Plain mistakes of channels beside nonlinear elements, in settled dwells where all motion is seen."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.check.explain.examine import diagnose, examined
from dashpot.check.explain.record_channels import mistakes_by_equation
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import force_law
from tests.mistakes import times
from tests.networks import changed, network
from tests.nonlinear_rigs import motions, settled, two_masses

FREQUENCIES = np.linspace(4, 12, 14)


def measured(law, wrong=None, factor=1.0):
    """A rig and its dwells at 0.3 % noise, one channel times `factor`."""
    model, theta = two_masses(law)
    rng = np.random.default_rng(5)
    spectrum = settled(
        model, theta, motions("x1", "x2", "u"), FREQUENCIES, orders=(1, 3), noise=3e-3, rng=rng
    )
    wrong = next((c for c, channel in enumerate(spectrum.channels) if channel.name == wrong), 0)
    return model, times(spectrum, wrong, factor)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "wrong", "factor", "kind"), [("gap", "x2", 1000.0, "unit"), ("cubic", "u", 9.80665, "unit")]
)
def test_a_channel_of_the_wrong_unit_is_named_first(law, wrong, factor, kind):
    model, spectrum = measured(law, wrong, factor)
    causes = mistakes_by_equation(prepare(model, spectrum), 1e4)
    assert (causes[0].kind, causes[0].of, causes[0].number) == (kind, (wrong,), pytest.approx(factor))
    assert causes[0].remaining < 1.5


@pytest.mark.slow
def test_two_channels_exchanged_are_named_first():
    model, spectrum = measured("cubic")
    order = [1, 0, 2]
    V = spectrum.covariance[:, order][:, :, order]
    exchanged = replace(spectrum, amplitudes=spectrum.amplitudes[:, order], covariance=V)
    causes = mistakes_by_equation(prepare(model, exchanged), 1e4)
    assert (causes[0].kind, causes[0].of) == ("swap", ("x1", "x2"))


@pytest.mark.slow
@pytest.mark.parametrize("law", ["cubic", "gap", "coulomb"])
def test_right_channels_are_not_called_wrong(law):
    """Neither as the rig has them, nor where a spring beside the law has a wrong value."""
    model, spectrum = measured(law)
    assert mistakes_by_equation(prepare(model, spectrum), 1.0) == ()
    stiff = changed(model, "k1", value=2300.0)
    assert mistakes_by_equation(prepare(stiff, spectrum), 1e4) == ()


@pytest.mark.slow
def test_the_assessment_of_a_fit_that_fails_says_which_channel():
    model, spectrum = measured("cubic", "x2", -1.0)
    estimate = examined(model, spectrum, identify(model, spectrum, "ml"))
    assert estimate.assessment.verdict == "does not fit"
    (first, *_) = estimate.assessment.findings
    assert (first.kind, first.of) == ("sign", ("x2",))
    assert "sign = -1.0" in first.change


@pytest.mark.slow
def test_where_no_fit_comes_to_an_end_the_diagnosis_says_which_channel():
    model, spectrum = measured("gap", "x2", -1.0)
    with pytest.raises(IdentifiabilityError, match="no information"):
        identify(model, spectrum, "ml")
    (first, *_) = diagnose(model, spectrum)
    assert (first.kind, first.of) == ("sign", ("x2",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "kind"), [(1.07, "gain"), pytest.param(np.exp(0.15j), "delay", marks=pytest.mark.long)]
)
def test_a_small_mistake_of_a_channel_is_weighed_beside_the_law(factor, kind):
    """Too small for the equation of motion to settle it at once."""
    model, spectrum = measured("cubic")
    turn = np.array([factor if channel.name == "x2" else 1.0 for channel in spectrum.channels])
    power = (
        spectrum.frequency_hz / np.max(spectrum.frequency_hz) if kind == "delay" else np.ones(spectrum.lines)
    )
    wrong = replace(spectrum, amplitudes=spectrum.amplitudes * turn ** power[:, None])
    estimate = examined(model, wrong, identify(model, wrong, "ml"))
    (first, *_) = estimate.assessment.findings
    assert (first.kind, first.of) == (kind, ("x2",))
    assert first.odds > 0.5


@pytest.mark.long
def test_a_unit_that_only_comes_near_is_no_reason_not_to_weigh_what_else_may_be_wrong():
    """The only known value of a rig, in lb: the motion in another unit, by 2, leaves a good deal more than noise."""
    cubic = replace(between("k3", Kind.SPRING, "x", "ground"), force_law=force_law("cubic"))
    model = network("x", "f@x", "m@x k:x-ground c:x-ground=40", cubic)
    spectrum = settled(
        model, np.array([2.0, 4000.0, 4e8]), (Channel("x", {"x": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE)),
        np.linspace(4, 12, 8), orders=(1,), amplitude=8.0, noise=3e-3, rng=np.random.default_rng(5),
    )  # fmt: skip
    wrong = changed(model, "c", value=2.2046 * 40)
    estimate = examined(wrong, spectrum, identify(wrong, spectrum, "ml"))
    (first, *_) = estimate.assessment.findings
    assert (first.kind, first.of, first.number) == ("value", ("c",), pytest.approx(40, rel=0.01))
