"""Where the information lacks a direction: intervals from how χ² rises along it, a refusal where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.check.profile import with_profile_intervals
from dashpot.data.conditioning.lines import spectrum as spectrum_of
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.uncertainty import flat_valley, linearise, may_lack_direction
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from dashpot.estimate.preparation import prepare
from dashpot.model.network import Model
from tests import rigs
from tests.networks import changed, network
from tests.whole_rigs import chain, record_of

SEEN = (Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION), Channel("u", {"u": 1.0}))
# Springs of 2 : 1 bring the resonances of two equal masses as near to each other as springs can: what lies nearer,
# by noise, has its best fit there, where two solutions have merged.
FOLD = network("x1 x2", "u", "m1@x1=1 m2@x2=1 k1:x1-u k2:x2-x1 c1:x1-u c2:x2-x1")
AT_FOLD = np.array([8000.0, 4000.0, 10.0, 6.0])


def seen_from_above(model: Model, theta: np.ndarray, noise: float, seed: int) -> Spectrum:
    """Acceleration of the upper of two masses at 25 lines, the base known exactly."""
    rig = rigs.Rig(
        model, theta, np.linspace(2, 25, 25), np.ones((25, 1), complex), np.zeros((25, 0), complex)
    )
    V = rigs.covariance(rig, SEEN, noise)
    V[:, -1, -1] = 0
    return rigs.noisy(rig, SEEN, V, np.random.default_rng(seed))


def start_at(theta: np.ndarray) -> MaximumLikelihood:
    return MaximumLikelihood(start=tuple(theta), start_sign=(1.0, 1.0))


@pytest.mark.parametrize("seed", [30, 95, 328])  # of 400 those whose information is singular to 1e-9
def test_a_draw_beyond_the_fold_has_the_intervals_of_its_likelihood(seed: int) -> None:
    spectrum = seen_from_above(FOLD, AT_FOLD, 0.01, seed)
    estimate = identify(FOLD, spectrum, start_at(AT_FOLD))
    assert bool(estimate.converged)
    # Gauss and Newton's information gives thousands of times the value.
    assert np.all(estimate.sd < 0.2 * AT_FOLD)
    followed = with_profile_intervals(FOLD, spectrum, estimate)
    low, high = followed.interval()
    assert set(followed.profiles) == {"k1", "k2", "c1", "c2"}
    assert np.all((low < AT_FOLD) & (high > AT_FOLD))
    assert np.all(high[:2] - low[:2] < 0.1 * AT_FOLD[:2])
    # χ² at the ends of an interval lies the square of 1.96 above its minimum.
    for end in (low[0], high[0]):
        rest = changed(FOLD, "k1", value=float(end))
        best = min(
            float(identify(rest, spectrum, start_at(start)).fit.chi2)
            for start in (followed.values[1:], [16e6 / end * 2, *AT_FOLD[2:]])
        )
        assert best - float(estimate.fit.chi2) == pytest.approx(3.84, abs=0.1)


@pytest.mark.parametrize("seed", [0, 4, 7, 11])
def test_damping_in_proportion_to_stiffness_leaves_a_valley_without_end(seed: int) -> None:
    """Above dampers in proportion two resonances and the proportion are all that is seen, for four unknowns.

    The best fit of many a draw lies there exactly, and the search ended nowhere, with sd a thousand times the values.
    """
    model, theta = chain(2, 0.03, seed=17)
    spectrum = seen_from_above(model, theta, 0.05, seed)
    with pytest.raises(
        IdentifiabilityError, match=r"m2, k1, k2, c1 and c2 cannot be determined.*m2 from 0 to 1\.[12]"
    ):
        identify(model, spectrum, start_at(theta))


@pytest.mark.parametrize("seed", [1, 5])
def test_a_best_fit_at_the_end_of_such_a_valley_has_open_intervals_and_says_so(seed: int) -> None:
    """χ² lies less than 0.1 and 3.8 above its minimum all the way down to m2 = 0, where a parabola gives m2 ± 0.3 %."""
    model, theta = chain(2, 0.03, seed=17)
    spectrum = seen_from_above(model, theta, 0.01, seed)
    followed = with_profile_intervals(model, spectrum, identify(model, spectrum))
    assert followed["m2"].sd < 0.01 * theta[0]
    low, high = followed.interval()
    assert np.all((low < theta) & (theta < high))
    (warning,) = (each for each in followed.warnings if each.code == "open_interval")
    assert set(warning.of) == {"m2", "k1", "k2", "c1", "c2"}


def test_what_the_information_holds_is_left_alone() -> None:
    spectrum = seen_from_above(FOLD, np.array([4000.0, 4000.0, 10.0, 6.0]), 0.01, 1)
    estimate = identify(FOLD, spectrum, start_at(np.array([4000.0, 4000.0, 10.0, 6.0])))
    assert estimate.sd == pytest.approx(estimate.bound_sd, rel=1e-9)


@pytest.mark.long
def test_a_hammer_seen_at_one_of_three_unknown_masses_ends_in_names() -> None:
    """The search went on along a valley in which masses shrink with their springs, and ended unconverged."""
    model, theta = chain(3, 0.02, force=True, base=False, seed=2)
    values = dict(zip([e.name for e in model.elements], model.parameters(theta).tolist(), strict=True))
    model = replace(model, elements=tuple(replace(e, value=None) for e in model.elements))
    theta = np.array([values[unknown.name] for unknown in model.unknowns])
    record = record_of(model, theta, "hammer", seen=("x1",), moving=False, seed=2, decay_times=4).record
    noise = 0.03 * np.std(record.values[:, 0]) * np.random.default_rng(2).normal(size=len(record.values))
    record = replace(record, values=record.values + np.stack([noise, 0 * noise], axis=-1))
    spectrum = spectrum_of([record])
    with pytest.raises(IdentifiabilityError, match=r"m1, m2, m3, k2, k3, c2 and c3 cannot be determined"):
        identify_with_noise(model, spectrum)


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_information_that_holds_all_leaves_no_valley_to_look_for(noise: float) -> None:
    """Of the equation of motion, as oiv has it, and of the channels: either lets every valley through."""
    looked = 0
    for seed in range(30):
        rig = rigs.random_rig(np.random.default_rng(seed), 2)
        seen = rigs.channels(rig)
        spectrum = rigs.noisy(rig, seen, rigs.covariance(rig, seen, noise), np.random.default_rng(seed))
        data = prepare(rig.model, spectrum)
        method = OptimalIV()
        solution = method.solve(data)
        around = linearise(data, solution, method.traits)
        sign = spectrum.signs(solution.signs, 1)
        scale = 1.0 if data.noise_known else float(around.sums.cost[0]) / around.dof
        valley = flat_valley(data.view, measured(data), solution.theta, sign, scale)
        looked += may_lack_direction(around.sums.symmetric[0])
        assert valley is None or may_lack_direction(around.sums.symmetric[0])
    assert looked < 30


def test_a_singular_direction_is_not_passed_over() -> None:
    slopes = np.array([[1.0, 1.0 + 1e-7], [2.0, 2.0], [3.0, 3.0]])
    assert may_lack_direction(slopes.T @ slopes)
    assert not may_lack_direction(np.diag([1e12, 1e-12]))
