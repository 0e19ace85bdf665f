"""Linear rigs fitted to data of nonlinear ones: what the data call for, and nothing where they call for nothing."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.check.element_evidence import compare_in_dwells
from dashpot.check.explain.examine import examined
from dashpot.check.explain.laws import called_for, fitted_in_full, seen_candidates
from dashpot.check.explain.problem import LineProblem
from dashpot.estimate.assessment import applied
from dashpot.estimate.identify import identify
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Element, Kind
from dashpot.model.nonlinear.force_law import force_law
from tests import rigs
from tests.networks import network
from tests.nonlinear_rigs import chain, motions, noisy, settled, two_masses

ALL = motions("x1", "x2", "u")
FREQUENCIES = [2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14]


def linear_fit(law, orders=(1, 3), amplitude=1e-3):
    model, theta = two_masses(law)
    rng = np.random.default_rng(1)
    spectrum = settled(
        model, theta, ALL, FREQUENCIES, orders=orders, amplitude=amplitude, noise=0.005, rng=rng
    )
    linear = replace(model, elements=model.elements[:-1])
    return linear, theta, spectrum, identify(linear, spectrum)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "orders", "words", "name"),
    [
        ("cubic", (1, 3), "odd, stiffening", "k3"),
        pytest.param("v*abs(v)", (1,), "damping that grows with speed", "cq", marks=pytest.mark.long),
    ],
)
def test_the_element_that_the_data_call_for_is_named_and_mends_the_fit(law, orders, words, name):
    linear, theta, spectrum, estimate = linear_fit(law, orders)
    assessment = examined(linear, spectrum, estimate).assessment
    assert assessment.verdict == "does not fit"
    first = assessment.findings[0]
    assert (first.kind, first.of) == ("nonlinear", ("x2", "u"))
    assert first.text == f"the data call for a nonlinear element between x2 and u, {words} (p < 1e-6)"
    assert first.number == pytest.approx(theta[5], rel=0.1)
    mended = applied(linear, spectrum.channels, first)[0]
    assert mended.elements[-1].name == name
    assert float(identify(mended, spectrum).fit.p) > 0.01


def rubber_mount(frequencies, orders, amplitude=1e-3):
    """A mass on a shaken mount that stiffens, without that spring, and dwells of it beside its fold."""
    cubic = Element("k3", Kind.SPRING, {"x1": 1.0, "u": -1.0}, force_law=force_law("cubic"))
    model = network("x1", "u", "m@x1=1.5 k:x1-u c:x1-u", cubic)
    spectrum = settled(
        model, np.array([2500, 6, 2e7]), motions("x1", "u"), frequencies, orders=orders, amplitude=amplitude,
        noise=1e-3, input_noise=1e-3, rng=np.random.default_rng(3),
    )  # fmt: skip
    return replace(model, elements=model.elements[:-1]), spectrum


@pytest.mark.slow
def test_harmonics_beside_a_fold_call_for_the_element_at_its_place():
    """From the fit of the linear rig, 19 times the noise away, a spring to the ground had promised most."""
    linear, spectrum = rubber_mount(np.arange(3, 12.5, 0.5), (1, 2, 3, 4, 5))
    estimate = identify(linear, spectrum, "ml")
    called = called_for(LineProblem(prepare(linear, spectrum), np.ones(2), (estimate.values,)))
    assert called[0].element.along == {"x1": 1.0, "u": -1.0}
    assert called[0].element.force_law.text == "cubic"
    assert called[0].value == pytest.approx(2e7, rel=0.01)
    assert called[0].chi2 - called[0].fall < 1.5 * called[0].dof


@pytest.mark.slow
def test_the_dwell_of_the_largest_motion_does_not_hide_the_element():
    """Left out, it leaves a linear rig that fits: in one dwell of 14 the spring shows."""
    model, theta = chain("cubic", 2)
    weak = np.where([u.name == "q" for u in model.unknowns], 0.1 * theta, theta)
    frequencies = [2, 3, 4, 4.7, 5.3, 6, 8, 9.5, 11, 12.5, 14]
    spectrum = settled(
        model, weak, ALL, frequencies, orders=(1,), amplitude=5e-4, noise=0.003, rng=np.random.default_rng(0)
    )
    linear = replace(model, elements=model.elements[:-1])
    findings = examined(linear, spectrum, identify(linear, spectrum)).assessment.findings
    assert (findings[0].kind, findings[0].of) == ("nonlinear", ("x2", "u"))


def test_stops_on_one_side_are_told_from_those_on_both_by_even_harmonics_alone():
    model, theta = two_masses("one-sided")
    linear = replace(model, elements=model.elements[:-1])
    named = {}
    for orders in ((1, 3), (1, 2, 3)):
        spectrum = settled(
            model, theta, ALL, FREQUENCIES, orders=orders, noise=0.002, rng=np.random.default_rng(1)
        )
        estimate = identify(linear, spectrum, "ml")
        scored = seen_candidates(LineProblem(prepare(linear, spectrum), np.ones(3), (estimate.values,)))
        named[orders] = [each.element for each in scored]
    assert not any(element.force_law.text == "one-sided" for element in named[1, 3])
    first = named[1, 2, 3][0]
    assert (first.force_law.text, first.along) == ("one-sided", {"x2": 1.0, "u": -1.0})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "words"),
    [("cubic", "odd, stiffening"), pytest.param("v*abs(v)", "grows with speed", marks=pytest.mark.long)],
)
def test_harmonics_that_are_mostly_noise_do_not_silence_the_channels_that_show_the_element(law, words):
    """Its own harmonics are small: at most lines the channels are noise, and runs of two levels seem of two rigs."""
    model, theta = two_masses(law)
    spectrum = settled(
        model, theta, ALL, 2 * FREQUENCIES, orders=(1, 2, 3, 5), amplitude=np.repeat([4e-4, 1e-3], len(FREQUENCIES)),
        noise=0.01, rng=np.random.default_rng(0),
    )  # fmt: skip
    linear = replace(model, elements=model.elements[:-1])
    first = examined(linear, spectrum, identify(linear, spectrum)).assessment.findings[0]
    assert (first.kind, first.of) == ("nonlinear", ("x2", "u"))
    assert words in first.text


@pytest.mark.long
def test_beside_one_wrong_dwell_no_candidate_is_sought_that_the_equation_of_motion_does_not_show(monkeypatch):
    """The first mode's dwell is flipped, where a nonlinear element would show as well; six fits took 6 s."""
    fits = []
    monkeypatch.setattr(
        "dashpot.check.explain.laws.fitted_in_full",
        lambda *given: fits.append(given[1].element.name) or fitted_in_full(*given),
    )
    rig = rigs.plain_rig(np.random.default_rng(64), 4)
    channels = rigs.channels(rig)
    spectrum = rigs.noisy(rig, channels, rigs.covariance(rig, channels, 0.01), np.random.default_rng(1))
    loudest = int(np.argmax(np.sum(np.abs(spectrum.amplitudes), axis=1)))
    Y = spectrum.amplitudes.copy()
    Y[loudest, : len(rig.model.coordinates)] *= -1
    wrong = replace(spectrum, amplitudes=Y)
    findings = examined(rig.model, wrong, identify(rig.model, wrong)).assessment.findings
    assert findings[0].kind in ("dwell", "frequency")
    assert findings[0].of == (f"{spectrum.frequency_hz[loudest]:g} Hz",)
    assert not fits


@pytest.mark.long
def test_a_dwell_on_the_upper_branch_of_a_fold_does_not_hide_the_element():
    """At the true values it is lost, and its cost had left clearances and a quintic spring as the likeliest."""
    linear, spectrum = rubber_mount(np.arange(3, 12.5, 0.5), (1,))
    (first, *_) = examined(linear, spectrum, identify(linear, spectrum)).assessment.findings
    assert (first.kind, first.elements[0].force_law.text) == ("nonlinear", "cubic")
    assert first.number == pytest.approx(2e7, rel=0.01)
    best = compare_in_dwells(linear, spectrum).ranked[0]
    assert best.elements[0].name == "k3"
    assert best.elements[0].guess == pytest.approx(2e7, rel=0.01)
    assert best.remaining < 0.02


@pytest.mark.long
def test_friction_in_fundamentals_alone_is_named_first_between_the_right_points():
    """Its law is not told from other damping that falls with speed; the input left out explains as much."""
    linear, _, spectrum, estimate = linear_fit("coulomb", (1,))
    assessment = examined(linear, spectrum, estimate).assessment
    assert assessment.verdict == "does not fit"
    assert (assessment.findings[0].kind, assessment.findings[0].of) == ("nonlinear", ("x2", "u"))


@pytest.mark.long
def test_a_shaken_mass_that_rubs_refuses_the_linear_fit_and_its_friction_is_found():
    """160 intervals of 40 draws: 95 % of them scatter by 2 points, so 88 to 100 % is beyond three of it."""
    model, theta = chain("coulomb", 1)
    seen = motions("x1", "u")
    exact = settled(model, theta, seen, FREQUENCIES, orders=(1, 3, 5))
    linear = replace(model, elements=model.elements[:-1])
    data = noisy(exact, 0.002, 40, 5)
    first = replace(data, amplitudes=data.amplitudes[0])
    assessment = examined(linear, first, identify(linear, first)).assessment
    assert assessment.verdict == "does not fit"
    finding = assessment.findings[0]
    assert (finding.kind, finding.of) == ("nonlinear", ("x1", "u"))
    assert finding.text.endswith("friction (p < 1e-6)")
    assert finding.number == pytest.approx(5.0, rel=0.05)
    estimate = identify(model, data, "ml")
    assert np.mean(np.asarray(estimate.fit.p) > 0.01) > 0.9
    held = np.abs(estimate.values - theta) < 1.96 * estimate.sd
    assert np.mean(held) > 0.88


@pytest.mark.long
def test_data_of_a_linear_rig_call_for_no_nonlinear_element():
    """At most one of 40 candidates in a million by chance."""
    linear, theta, spectrum, estimate = linear_fit("cubic", amplitude=1e-7)
    data = prepare(linear, spectrum)
    assert bool(estimate.converged)
    assert np.allclose(estimate.values, theta[:5], rtol=0.05)
    assert called_for(LineProblem(data, np.ones(3), (estimate.values,))) == []


def test_a_measured_force_gives_its_input_and_tests_no_element():
    """A mass heavier than stated, and a compliance beside it, which elements of the list only come near."""
    model = network("x", "f@x", "m@x=2 k:x-ground=3000 c:x-ground")
    hz, rng = np.linspace(2.0, 9.0, 10), np.random.default_rng(3)
    omega = 2 * np.pi * hz
    Y = np.stack([1 / (3000 + 12j * omega - 2.1 * omega**2) + 1e-5, np.ones(10)], axis=1)
    sd = 1e-4 * np.abs(Y)
    Y = Y + sd * (rng.standard_normal(Y.shape) + 1j * rng.standard_normal(Y.shape))
    channels = (Channel("x", {"x": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE))
    data = prepare(model, rigs.stated(channels, hz, Y, 2 * (sd**2)[:, :, None] * np.eye(2)))
    found = called_for(LineProblem(data, np.ones(2), (np.array([4.6]),)))
    assert found
    assert all(each.dof == each.fit.dof == each.fit.problem.dof for each in found)
