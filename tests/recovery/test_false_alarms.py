"""How often clean tests are called misfits."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

import dashpot
from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.check.verdict import assess
from dashpot.estimate.automatic import identify_with_noise
from tests import rigs
from tests.whole_rigs import chain, record_of

TESTS = 100


@pytest.mark.long
def test_clean_tests_are_called_misfits_no_more_often_than_stated() -> None:
    """At p < 0.01 by χ²: more than five of a hundred have a chance of 6e-4.  Measured in benchmarks/README.md."""
    alarms = 0
    for seed in range(TESTS):
        rng = np.random.default_rng(50_000 + seed)
        rig = rigs.plain_rig(rng, int(rng.integers(2, 4)))
        quantity = (Quantity.DISPLACEMENT, Quantity.ACCELERATION)[int(rng.integers(2))]
        channels = rigs.channels(rig, (quantity,))
        spectrum = rigs.noisy(rig, channels, rigs.covariance(rig, channels, 0.01, inputs=0.01), rng)
        verdict = assess(rig.model, spectrum, identify_with_noise(rig.model, spectrum)[0]).verdict
        alarms += verdict == "does not fit"
    assert alarms <= 5


def alarms_of(kinds: Sequence[str], noise: Callable[[np.random.Generator, Real], Real], tests: int) -> int:
    """How many of so many sound records do not fit, with 2 % of a noise (samples, channels) of variance 1."""
    alarms = 0
    for seed in range(tests):
        rng = np.random.default_rng([60_000, seed])
        model, theta = chain(int(rng.integers(2, 4)), float(rng.uniform(0.02, 0.05)), seed=seed)
        test = record_of(model, theta, kinds[seed % len(kinds)], decay_times=6, seed=seed)
        error = 0.02 * test.size * noise(rng, test.record.values)
        error[:, -1] = 0.0
        record = replace(test.record, values=test.record.values + error)
        alarms += dashpot.identify(model, record, diagnose=True).assessment.verdict == "does not fit"
    return alarms


@pytest.mark.long
def test_heavy_tails_of_a_sound_record_are_no_spikes() -> None:
    """Noise of Student's t with three degrees of freedom: its largest of some thousand samples are 10 to 60 deviations.

    Every one of such records had been condemned.  Of 20 more than two have a chance of 0.02 at three of a hundred.
    """
    assert alarms_of(["random"], lambda rng, y: rng.standard_t(3, size=y.shape) / np.sqrt(3), 20) <= 2


@pytest.mark.long
def test_noise_that_follows_a_passing_motion_is_no_misfit() -> None:
    """An earthquake and sensors whose noise is in proportion to it: lines are far from independent.

    Half of such records had been condemned, as parts of the band disagreed.  The chance is that of the test above.
    """

    def with_motion(rng: np.random.Generator, values: Real) -> Real:
        window = np.ones(len(values) // 25)
        size = np.array([np.convolve(np.abs(column), window, "same") for column in values.T]).T
        return rng.normal(size=values.shape) * size / np.sqrt(np.mean(size**2, axis=0))

    assert alarms_of(["earthquake", "stepped"], with_motion, 16) <= 2
