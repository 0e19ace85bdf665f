"""Searches from many starts find what is hidden once a channel is left out, beside problems where all is seen."""

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.check.explain.channels import without
from dashpot.check.explain.problem import LineProblem, fitted, judged, searched
from dashpot.data.conditioning.lines import spectrum
from dashpot.estimate.likelihood.global_search import candidates
from dashpot.estimate.preparation import prepare
from tests import rigs
from tests.whole_rigs import chain, record_of


@pytest.mark.parametrize(("seed", "left_out"), [(6, "a_x1"), (12, "a_x3"), (16, "a_x1")])
def test_a_rig_is_found_without_the_channel_of_one_of_its_points(seed, left_out):
    rng = np.random.default_rng(seed)
    drive = {"displacements": 1, "forces": 0} if seed % 3 == 0 else {"displacements": 0, "forces": 1}
    rig = rigs.random_rig(
        rng, 3, kinds=rigs.PAPER_KINDS, levers=False, ties=False, lines=20, worst=100, **drive
    )
    chosen = rigs.channels(rig, (Quantity.ACCELERATION,))
    V = rigs.covariance(rig, chosen, 0.002, inputs=0.002)
    data = prepare(rig.model, rigs.noisy(rig, chosen, V, rng))
    (start, *_), (sign, *_) = candidates(data, 1, np.random.default_rng(0))
    seen = LineProblem(data, sign, (start,))
    hidden = without([channel.name for channel in chosen].index(left_out), seen)
    _, found = searched([seen, hidden])
    (right,) = fitted([hidden.from_starts((rig.theta,))])
    assert found.chi2 < right.chi2 + 1


def test_whole_records_are_judged_at_their_starts_together_as_each_alone():
    model, theta = chain(2, 0.03, base=True, seed=3)
    test = record_of(model, theta, "random", seed=2, decay_times=3)
    record = test.noisy(np.random.default_rng(1), 0.02 * test.size * [1, 1, 0])
    data = prepare(model, spectrum([record]), states=False)
    stated = LineProblem(data, np.ones(3), (theta,))
    turned = stated.scaled(0, -1.0)
    assert stated.arranged().ends is not None
    fits = judged([stated, turned])
    assert [fit.chi2 for fit in fits] == pytest.approx([each.slopes(theta)[2] for each in (stated, turned)])
    assert fits[0].reduced < 2 < 100 < fits[1].reduced
