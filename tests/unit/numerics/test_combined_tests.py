"""Tests taken together: uniform p-values stay uniform."""

import numpy as np
import pytest
from scipy.stats import combine_pvalues

from dashpot.numerics.variance_tests import fishers_product


def test_as_scipy() -> None:
    p = np.random.default_rng(1).uniform(size=(7, 3))
    assert fishers_product(list(p)) == pytest.approx(combine_pvalues(p, axis=0).pvalue)
    assert fishers_product([0.03]) == pytest.approx(0.03)


def test_none_and_nothing_left() -> None:
    assert fishers_product([]) == 1
    assert fishers_product([0.0, 1.0]) == pytest.approx(0, abs=1e-250)
