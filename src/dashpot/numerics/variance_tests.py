"""Whether variances are alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real

# Independent tests of one hypothesis taken together.


def fishers_product(p: Sequence[Real] | Sequence[float]) -> Real:
    """p-values of all tests together, (...,), of those of each, (tests, ...); 1 where there are none.

    −2 Σ ln p is χ² with two degrees of freedom for each test: R. A. Fisher, Statistical Methods for Research Workers.
    """
    if not len(p):
        return np.ones(())
    logs = np.log(np.maximum(p, 1e-300))  # p-value that counts as such
    return np.asarray(chdtrc(2 * len(logs), -2 * np.sum(logs, axis=0)), dtype=float)


def equal_variances(variance: Real, dof: float) -> float:
    """p-value of variances (groups,), each of so many degrees of freedom, that differ by chance only; 1 of fewer than
    two.

    M. S. Bartlett (1937), Proceedings of the Royal Society A 160, 268.
    """
    groups = len(variance)
    if groups < 2 or not np.any(variance):
        return 1.0
    with np.errstate(divide="ignore"):
        statistic = dof * groups * (np.log(np.mean(variance)) - np.mean(np.log(variance)))
    return float(chdtrc(groups - 1, statistic / (1 + (groups + 1) / (3 * groups * dof))))
