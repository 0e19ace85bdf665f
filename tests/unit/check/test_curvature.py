"""Intervals follow χ² where it is no parabola, by themselves; elsewhere nothing changes."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.check.explain.examine import examined
from dashpot.check.profile import bent_unknowns, profile, with_profile_intervals
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.table_noise import with_residual_noise
from dashpot.estimate.result import Estimate
from dashpot.present.estimate import profiles_in_words
from tests import rigs
from tests.networks import network
from tests.whole_rigs import four_seen_at_two

RIG = network("x", "u", "m@x=1 c:x-u k:x-u")
TRUTH = np.array([4.0, 400.0])


def one_line(noise: float, draws: int | None = None):
    """A mass seen at one frequency below its resonance."""
    rig = rigs.Rig(RIG, TRUTH, np.array([2.0]), np.ones((1, 1), complex), np.zeros((1, 0), complex))
    V = np.zeros((1, 2, 2))
    V[:, 0, 0] = 2 * noise**2
    return rigs.noisy(rig, rigs.channels(rig), V, np.random.default_rng(3), draws)


def test_the_profile_is_taken_by_itself_and_kept_in_files() -> None:
    spectrum = one_line(0.15)
    estimate = identify(RIG, spectrum)
    assert bent_unknowns(RIG, spectrum, estimate).tolist() == [True, True]
    followed = examined(RIG, spectrum, estimate)
    along = profile(RIG, spectrum, "k", estimate=estimate)
    assert followed["k"].interval95 == (float(along.lower), float(along.upper))
    assert bool(along.misleads)
    # At other levels the ends lie where the profile has them.
    for level in (0.5, 0.8):
        at = profile(RIG, spectrum, "k", level, estimate=estimate)
        low, high = followed.interval(level)
        assert [low[1], high[1]] == pytest.approx([float(at.lower), float(at.upper)], rel=0.03)
    assert profiles_in_words(followed).startswith("Profile intervals: c and k")
    again = Estimate.from_json(followed.to_json())
    assert again.profiles == followed.profiles
    assert again["k"].interval95 == followed["k"].interval95


def test_where_chi2_is_a_parabola_nothing_changes() -> None:
    paper = rigs.paper_rig()
    seen = rigs.channels(paper, (Quantity.DISPLACEMENT,))
    spectrum = rigs.noisy(paper, seen, rigs.covariance(paper, seen, 0.02), np.random.default_rng(1))
    estimate = identify(paper.model, spectrum)
    assert with_profile_intervals(paper.model, spectrum, estimate) is estimate
    # Noise that is not known scales χ²: a parabola stays one.
    unknown = rigs.of_unknown_noise(spectrum)
    unknown, method = with_residual_noise(paper.model, unknown, automatic(paper.model, unknown))
    estimate = identify(paper.model, unknown, method)
    assert not np.any(bent_unknowns(paper.model, unknown, estimate))


def partly_seen(draws: int):
    """Four masses on a base, accelerometers on the first and the last, all but one mass unknown, 15 % noise."""
    rig, seen = four_seen_at_two(2, ("x1", "x4"), np.linspace(2, 19, 14))
    V = rigs.covariance(rig, seen, 0.15)
    return rig.model, rig.theta, rigs.noisy(rig, seen, V, np.random.default_rng(5), draws)


@pytest.mark.long
def test_coverage_of_a_rig_seen_in_part() -> None:
    model, theta, spectrum = partly_seen(60)
    method = MaximumLikelihood(start=tuple(theta), start_sign=(1.0, 1.0, 1.0))
    held, bent = [], 0
    for k in range(60):
        draw = replace(spectrum, amplitudes=spectrum.amplitudes[k])
        estimate = with_profile_intervals(model, draw, identify(model, draw, method))
        low, high = estimate.interval()
        held.append((low <= theta) & (theta <= high))
        bent += len(estimate.profiles)
    assert bent > 60
    assert 0.93 <= np.mean(held) <= 0.975
