"""The mirror image of a rig: the one that moves by −x(t) where this one moves by x(t).

Driven at odd harmonics alone, both show the same odd harmonics half a period later; even ones differ in sign.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from dashpot.arrays import Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw

POINTS = np.linspace(-1.7, 1.9, 13)  # not symmetric themselves, in units of the law's own lengths and speeds
ALIKE = 1e-9


def mirrored(model: Model, theta: Real) -> Real | None:
    """θ (unknowns,) of the mirror image, None where it is the same rig or no rig of this form.

    A law a(d, v) becomes −a(−d, −v): odd laws stay, even ones change their parameter's sign, others may change the sign
    of constants.  Known and tied parameters are kept, so their laws must be odd.
    """
    image = theta.copy()
    constants, slope = model.inner_constants(theta), model.constants_map[0]
    for index, inner in zip(model.nonlinear, model.constant_slices, strict=True):
        law = model.elements[int(index)].force_law
        assert law is not None
        turned = _turned(law, constants[inner])
        if turned is None:
            return None
        strength, flips = turned
        columns = [
            (np.flatnonzero(model.T[index]), strength),
            *((np.flatnonzero(row), sign) for row, sign in zip(slope[inner], flips, strict=True)),
        ]
        for column, sign in columns:
            if sign < 0 and (len(column) != 1 or model.prior_precision[column[0]] > 0):
                return None
            if sign < 0:
                image[column] = -theta[column]
    return None if np.array_equal(image, theta) else image


def _turned(law: ForceLaw, g: Real) -> tuple[float, tuple[float, ...]] | None:
    """Signs of the parameter and of the constants with which the law is its own image; None where none are."""
    if law.has_state:  # stop, play and Bouc-Wen know no direction
        return 1.0, (1.0,) * len(g)
    lengths = [abs(c) for c, name in zip(g, law.constant_names, strict=True) if law.exponents[1][name][0] > 0]
    scale = max(lengths, default=1.0)
    d, v = (part.ravel() for part in np.meshgrid(scale * POINTS, scale * POINTS))
    original = np.broadcast_to(law(-d, -v, d, g[None]).value, (1, len(d)))
    size = np.max(np.abs(original)) * ALIKE
    for flips in product((1.0, -1.0), repeat=len(g)):
        image = np.broadcast_to(law(d, v, d, (g * flips)[None]).value, (1, len(d)))
        for strength in (1.0, -1.0):
            if np.max(np.abs(strength * image + original)) <= size:
                return strength, flips
    return None
