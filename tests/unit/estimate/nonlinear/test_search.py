"""Ends of the search that fit alike are told, and dwells far from linear are not lost."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.errors import DataError, IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.model.nonlinear.force_law import force_law
from tests.nonlinear_rigs import IN_ROWS, chain, guessed, motions, settled, two_masses

FREQUENCIES = [2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14]
ALL = motions("x1", "x2", "u")


FEW_MASSES = [(1, "gap"), (2, "coulomb"), (2, "bilinear"), (3, "cubic"), (4, "v**3"), (5, "square")]
SLOW = [(count, law) for law, count in IN_ROWS if law not in ("stribeck", "bouc-wen")]


@pytest.mark.parametrize(
    ("count", "law"),
    [*FEW_MASSES, *(pytest.param(*rig, marks=pytest.mark.long) for rig in SLOW if rig not in FEW_MASSES)],
)
def test_exact_harmonics_give_all_parameters_of_every_law_back(count, law):
    model, theta = chain(law, count)
    channels = motions(*model.coordinates, "u")
    amplitude = 1e-3 if count < 3 else 2e-3 / count  # the last mass moves as in the shorter ones
    spectrum = settled(model, theta, channels, FREQUENCIES, orders=(1, 2, 3), amplitude=amplitude, most=63)
    estimate = identify(model, spectrum, "ml")
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < 1e-6
    assert "not_unique" not in [notice.code for notice in estimate.warnings]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2])
def test_stribecks_friction_is_given_back_without_guesses(count):
    model, theta = chain("stribeck", count)
    channels = motions(*model.coordinates, "u")
    spectrum = settled(model, theta, channels, FREQUENCIES, orders=(1, 3), most=63)
    estimate = identify(model, spectrum, "ml")
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "count", "most", "within"),
    [
        *(("stribeck", count, 63, 1e-6) for count in (3, 4, 5)),
        *(("bouc-wen", count, 31, 1e-3) for count in (1, 3, 5)),
    ],
)
def test_friction_that_slides_and_hysteresis_are_given_back_from_guesses(law, count, most, within):
    """Bouc-Wen's force has kinks: 31 harmonics, of which the data are made, leave 6e-4.

    At half the drive Stribeck's friction on four masses hardly slides: its constants may then differ by 1 % and leave
    1e-9 of the motion.
    """
    model, theta = chain(law, count)
    channels, amplitude = (
        motions(*model.coordinates, "u"),
        1e-3 if count < 3 or law == "stribeck" else 2e-3 / count,
    )
    spectrum = settled(model, theta, channels, FREQUENCIES, orders=(1, 3), amplitude=amplitude, most=most)
    estimate = identify(guessed(model, theta, 1.03), spectrum, "ml")
    assert bool(estimate.converged)
    assert np.max(np.abs(estimate.values / theta - 1)) < within


def test_odd_harmonics_do_not_tell_the_sign_of_an_even_law_and_it_is_said():
    model, theta = two_masses("square")
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.005, rng=np.random.default_rng(3))
    estimate = identify(guessed(model, theta), spectrum, "ml")
    notice = next(notice for notice in estimate.warnings if notice.code == "not_unique")
    assert notice.of == ("q",)
    even = settled(model, theta, ALL, FREQUENCIES, orders=(1, 2), noise=0.005, rng=np.random.default_rng(3))
    assert "not_unique" not in [n.code for n in identify(guessed(model, theta), even, "ml").warnings]


@pytest.mark.long
def test_dwells_far_from_linear_are_found_where_nobody_has_measured_their_motion():
    """The stiffening spring pulls a hundred times as hard as the linear ones at 5 Hz."""
    model, theta = two_masses("quintic")
    frequencies, rng = [2, 4, 5, 6, 9.5, 12.5], np.random.default_rng(3)
    spectrum = settled(model, theta, motions("x2", "u"), frequencies, noise=0.005, rng=rng)
    estimate = identify(guessed(model, theta, 1.01), spectrum, "ml")
    assert float(estimate.fit.p) > 0.01
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)


@pytest.mark.long
def test_constants_that_the_data_hardly_tell_have_intervals_as_wide():
    """Friction that falls from a large value by a large share is friction that falls from another."""
    model, theta = two_masses("stribeck")
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.005, rng=np.random.default_rng(3))
    estimate = identify(model, spectrum, "ml")
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)
    assert estimate["q.ratio"].sd > 1


def test_a_law_that_divides_by_zero_within_the_motion_is_refused():
    model, theta = two_masses("cubic")
    spectrum = settled(model, theta, ALL, FREQUENCIES)
    pole = replace(model.elements[-1], force_law=force_law("d/(d - 0.0004)"))
    with pytest.raises(DataError, match="divides by zero"):
        identify(replace(model, elements=(*model.elements[:-1], pole)), spectrum, "ml")


def test_coefficients_inside_laws_may_be_negative():
    """Only gaps, slips and what is divided by are above 0; that of a polynomial is a length, too."""
    model, theta = two_masses("d**3 + b*d**2")
    theta[-1] = -theta[-1]
    spectrum = settled(
        model, theta, ALL, FREQUENCIES, orders=(1, 2, 3), noise=0.002, rng=np.random.default_rng(1)
    )
    estimate = identify(model, spectrum, "ml")
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)
    assert estimate["q.b"].value < -2 * estimate["q.b"].sd


@pytest.mark.long
def test_a_slider_that_never_slips_ends_soon_and_is_said_not_to_show():
    """Four dwells of a hundredth of its reach: spring and slider share one valley, which was followed for 500 steps."""
    model, theta = chain("jenkins", 1)
    spectrum = settled(
        model, theta, motions("x1", "u"), [4, 5, 6, 7], amplitude=1e-5, orders=(1, 3, 5), noise=0.005,
        rng=np.random.default_rng(3),
    )  # fmt: skip
    estimate = identify(model, spectrum)
    assert "law_not_seen" in [notice.code for notice in estimate.warnings]
    assert estimate.iterations <= 40


def test_a_gap_that_never_closes_is_named_before_the_search():
    """No trial of its width had given a start, which ended in an error of numpy."""
    model, theta = chain("gap", 1)
    spectrum = settled(model, theta, motions("x1", "u"), FREQUENCIES, amplitude=6e-5, noise=0.01)
    with pytest.raises(IdentifiabilityError, match="no information"):
        identify(guessed(model, theta, 1.03), spectrum, "ml")


def test_constants_that_hardly_show_are_named_where_their_element_does():
    """Friction that hardly slides: vs was 7 deviations off without a word.  Seed 1."""
    model, theta = chain("stribeck", 4)
    spectrum = settled(
        model, theta, motions(*model.coordinates, "u"), (4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0), noise=0.01,
        rng=np.random.default_rng(1),
    )  # fmt: skip
    estimate = identify(guessed(model, theta, 1.03), spectrum, "ml")
    (notice,) = [n for n in estimate.warnings if n.code == "constant_hardly_seen"]
    assert "q.v0" in notice.of
    wide = settled(
        model, theta, motions(*model.coordinates, "u"), (4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0), noise=1e-4,
        amplitude=3e-3, rng=np.random.default_rng(1),
    )  # fmt: skip
    estimate = identify(guessed(model, theta, 1.03), wide, "ml")
    assert "constant_hardly_seen" not in [n.code for n in estimate.warnings]
