"""Independent tests of one hypothesis taken together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real

SMALLEST = 1e-300  # p-value that counts as such


def fishers_product(p: Sequence[Real] | Sequence[float]) -> Real:
    """p-values of all tests together, (...,), of those of each, (tests, ...); 1 where there are none.

    −2 Σ ln p is χ² with two degrees of freedom for each test: R. A. Fisher, Statistical Methods for Research Workers.
    """
    if not len(p):
        return np.ones(())
    logs = np.log(np.maximum(p, SMALLEST))
    return np.asarray(chdtrc(2 * len(logs), -2 * np.sum(logs, axis=0)), dtype=float)
