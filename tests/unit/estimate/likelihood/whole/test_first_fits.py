"""Free decays without guesses: the first fit of a record finds the rig, wherever even weights lead."""

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.estimate.identify import identify
from dashpot.numerics.kernel import using
from tests.whole_rigs import chain, record_of


@pytest.mark.parametrize("seed", [8, 10, 17, 18, 21, 23])
def test_a_decay_whose_accelerations_are_weighted_evenly_at_first(seed: int) -> None:
    """Those of seeds 0 to 23 that ended in a wrong valley, most of them refused as no free decay."""
    model, theta = chain(2, 0.012, base=False, seed=seed)
    test = record_of(model, theta, "none", decay_times=3, quantities=(Quantity.ACCELERATION,), seed=seed)
    noisy = test.noisy(np.random.default_rng(seed), 0.01 * test.size)
    estimate = identify(model, whole_record(noisy))
    assert np.max(np.abs(estimate.values - theta) / estimate.sd) < 4.5  # p = 2e-4 of 30 values


@pytest.mark.parametrize("seed", [21, 33])
def test_numpy_finds_it_as_well_where_sums_lose_all_digits_on_the_way(seed: int) -> None:
    """Ends explained more than there was at masses of 1e-7 kg and stiffnesses of 1e13 N/m, which looked likely."""
    with using("numpy"):
        test_a_decay_whose_accelerations_are_weighted_evenly_at_first(seed)
