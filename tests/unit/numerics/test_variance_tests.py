"""Whether variances are alike."""

import numpy as np
import pytest
from scipy.stats import bartlett

from dashpot.numerics.variance_tests import equal_variances


def test_as_scipy_says() -> None:
    """Eight groups of 21 normal numbers; their means take a degree of freedom each."""
    groups = np.random.default_rng(4).normal(size=(8, 21)) * np.linspace(1, 1.5, 8)[:, None]
    assert equal_variances(np.var(groups, axis=1, ddof=1), 20) == pytest.approx(bartlett(*groups).pvalue)


def test_nothing_to_compare() -> None:
    """One group, or groups of zeros."""
    assert equal_variances(np.ones(1), 4) == 1.0
    assert equal_variances(np.zeros(3), 4) == 1.0
