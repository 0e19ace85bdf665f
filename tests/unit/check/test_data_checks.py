"""Checks with data: weak combinations, idle lines, errors of known parameters, profiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.chi2_surface import chi2_surface
from dashpot.check.collinearity import collinearity
from dashpot.check.profile import profile
from dashpot.check.sensitivity import known_errors
from dashpot.data.spectrum import Spectrum
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables, OptimalIV
from dashpot.estimate.method import Method
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from tests.rigs import Rig, channels, covariance, noisy, paper_rig, perfect


def measured(rig: Rig, noise: float = 0.03, seed: int = 1) -> Spectrum:
    seen = channels(rig)
    return noisy(rig, seen, covariance(rig, seen, noise), np.random.default_rng(seed))


@pytest.mark.parametrize(
    "method", [OptimalIV(), MaximumLikelihood(), InstrumentalVariables()], ids=lambda m: m.name
)
def test_errors_of_known_parameters_move_the_estimate_as_told(method: Method) -> None:
    """Against identification with a known spring off by ±0.5 %, residuals of 3 %: to the curvature of that."""
    rig = paper_rig()
    spectrum = measured(rig)
    estimate = identify(rig.model, spectrum, method)
    found = known_errors(rig.model, spectrum, estimate, method)
    assert found.known == ("k1", "k2")
    for k, name in enumerate(found.known):
        ends = [
            identify(rig.knowing({name: {"value": 4600.0 * (1 + off)}}).model, spectrum, method).values
            for off in (0.005, -0.005)
        ]
        moved = (ends[0] - ends[1]) / estimate.values / 0.01
        np.testing.assert_allclose(found.relative[k], moved, rtol=1e-3, atol=1e-3)
    # All forces scale together: 1 % on both springs is 1 % on everything.
    np.testing.assert_allclose(np.sum(found.relative, axis=0), 1.0, atol=1e-4)


def test_errors_of_a_value_with_sd_are_those_of_its_prior() -> None:
    rig = paper_rig().knowing({"k1": {"value": 4600.0, "sd": 60.0}})
    spectrum = measured(rig)
    estimate = identify(rig.model, spectrum)
    found = known_errors(rig.model, spectrum, estimate)
    k = found.known.index("k1")
    assert found.stated[k] == 60.0
    ends = [
        identify(rig.knowing({"k1": {"value": 4600.0 + off, "sd": 60.0}}).model, spectrum).values
        for off in (20.0, -20.0)
    ]
    np.testing.assert_allclose(found.slopes[k], (ends[0] - ends[1]) / 40.0, rtol=2e-3, atol=1e-7)


def test_nothing_known_has_no_errors() -> None:
    model = Model(
        ("x",), (Input("f", "force", {"x": 1.0}),), (mass("m", "x"), between("k", Kind.SPRING, "x", "ground"))
    )
    rig = Rig(
        model,
        np.array([1.0, 400.0]),
        np.array([1.0, 4.0]),
        np.zeros((2, 0), complex),
        np.ones((2, 1), complex),
    )
    spectrum = measured(rig)
    with pytest.raises(UsageError, match="no parameter"):
        known_errors(model, spectrum, identify(model, spectrum))


def two_dampers() -> Rig:
    """A damper and a hysteretic one side by side, lines within 2 %: only ω c + h is seen well."""
    model = Model(
        ("x",), (Input("u"),),
        (
            mass("m", "x", value=1.0), between("k", Kind.SPRING, "x", "u"), between("c", Kind.DAMPER, "x", "u"),
            between("h", Kind.HYSTERETIC, "x", "u"),
        ),
    )  # fmt: skip
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


def test_profile_of_a_parabola_is_the_normal_interval() -> None:
    rig = paper_rig()
    spectrum = measured(rig, 1e-3)
    estimate = identify(rig.model, spectrum)
    for name in estimate.names:
        for level in (0.68, 0.95):
            found = profile(rig.model, spectrum, name, level, estimate)
            assert found.difference < 0.005
            assert not found.misleads
    assert not found.improved
    assert np.all(np.diff(found.points) > 0)
    assert np.min(found.rise) == 0.0


def test_profile_ends_are_where_a_search_with_the_value_fixed_says() -> None:
    """χ² of the fit with the damper known at the end, against the threshold; the rig is far from linear there."""
    rig = paper_rig([2.0, 4.0, 9.0])
    spectrum = measured(rig, 0.15, seed=3)
    estimate = identify(rig.model, spectrum)
    found = profile(rig.model, spectrum, "c2", 0.95, estimate)
    assert found.misleads
    for end in (found.lower, found.upper):
        if not np.isfinite(end) or end < 0:
            continue
        held = identify(rig.knowing({"c2": {"value": float(end)}}).model, spectrum, OptimalIV())
        assert held.fit.chi2 - estimate.fit.chi2 == pytest.approx(float(found.threshold), rel=0.01)


def test_profile_stops_at_a_bound() -> None:
    rig = paper_rig([2.0, 4.0, 9.0])
    elements = tuple(replace(e, lower=35.0) if e.name == "c2" else e for e in rig.model.elements)
    bounded = replace(rig.model, elements=elements)
    spectrum = measured(rig, 0.15, seed=3)
    found = profile(bounded, spectrum, "c2", estimate=identify(bounded, spectrum, MaximumLikelihood()))
    assert found.lower == 35.0


def test_profiles_of_repeats_are_those_of_each() -> None:
    rig = paper_rig([2.0, 4.0, 9.0])
    seen = channels(rig)
    spectrum = noisy(rig, seen, covariance(rig, seen, 0.05), np.random.default_rng(5), 3)
    together = profile(rig.model, spectrum, "m1")
    for k in range(3):
        one = profile(rig.model, replace(spectrum, amplitudes=spectrum.amplitudes[k]), "m1")
        np.testing.assert_allclose([one.lower, one.upper], [together.lower[k], together.upper[k]], rtol=1e-3)


def test_profile_where_the_noise_is_unknown_uses_the_residuals() -> None:
    rig = paper_rig()
    spectrum = measured(rig, 1e-3)
    silent = replace(
        spectrum, covariance=np.full_like(spectrum.covariance, np.nan), noise=("unknown",) * spectrum.lines
    )
    estimate = identify(rig.model, silent)
    found = profile(rig.model, silent, "m1", estimate=estimate)
    assert found.difference < 0.005


def test_profile_of_a_stranger() -> None:
    rig = paper_rig()
    with pytest.raises(UsageError, match="not among the unknowns"):
        profile(rig.model, perfect(rig, channels(rig), covariance(rig, channels(rig), 0.01)), "k1")
