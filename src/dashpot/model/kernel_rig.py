"""A rig at its lines as the compiled kernel takes it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.model.elements import MATRICES
from dashpot.model.network import Model


def kernel_rig(kernel: Any, model: Model, omega: Real) -> Any | None:
    """The kernel's Rig, None where it does not know the rig's laws: nonlinear ones.  The last ones are kept.

    omega (lines,), rad/s.
    """
    if len(model.nonlinear):
        return None
    key = (kernel, omega.tobytes())
    if key not in model.views:
        factors = np.stack([law.factor(omega) for law in MATRICES.values()])
        imaginary = np.any(factors.imag, axis=-1)
        model.views[key] = kernel.Rig(
            model.B, model.D, model.T, model.p0, model.S, model.letters,
            np.where(imaginary[:, None], factors.imag, factors.real), imaginary, np.ascontiguousarray(omega),
            model.prior_precision, model.prior_mean,
        )  # fmt: skip
    return model.views[key]
