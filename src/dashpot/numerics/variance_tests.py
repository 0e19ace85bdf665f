"""Whether variances are alike."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real


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
