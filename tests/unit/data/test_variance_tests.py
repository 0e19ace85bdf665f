"""Whether variances are alike, and tests taken together, against SciPy."""

import numpy as np
import pytest
from scipy.stats import bartlett, chi2

from dashpot.data.noise import equal_variances, together


def test_equal_variances_are_bartletts() -> None:
    """Eight groups of 21 normal numbers; their means take a degree of freedom each."""
    groups = np.random.default_rng(4).normal(size=(8, 21)) * np.linspace(1, 1.5, 8)[:, None]
    assert equal_variances(np.var(groups, axis=1, ddof=1), 20) == pytest.approx(bartlett(*groups).pvalue)
    assert equal_variances(np.ones(1), 4) == equal_variances(np.zeros(3), 4) == 1.0  # nothing to compare


def test_tests_taken_together_are_squares_of_normal_numbers() -> None:
    p = np.random.default_rng(1).uniform(size=7)
    assert together([p[:3], None, *p[3:]]) == pytest.approx(chi2.sf(np.sum(chi2.isf(p, 1)), 7))
    assert together([0.03]) == pytest.approx(0.03)
    assert together([]) == together([None]) == 1
    assert together([0.0, 1.0]) == pytest.approx(0, abs=1e-240)
