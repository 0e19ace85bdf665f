"""Whether the laws of nonlinear elements are finite numbers in the measured motion."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import DataError
from dashpot.io.words import joined
from dashpot.model.network import Model

LARGEST = 1e100  # of a unit force: squares of what is larger overflow


def require_finite_laws(model: Model, d: Real, v: Real) -> None:
    """Raises DataError where a law without unknown constants divides by zero, overflows or is no number.

    d, v (e, …, instants): elongations and rates of the nonlinear elements in the measured motion.
    """
    known = model.constants_map[1]
    for row, (index, inner) in enumerate(zip(model.nonlinear, model.constant_slices, strict=True)):
        element = model.elements[int(index)]
        law = element.force_law
        assert law is not None
        if any(constant.unknown for constant in law.constants) or law.has_state:
            continue
        elongation, rate = d[row], v[row]
        with np.errstate(all="ignore"):
            force = np.broadcast_to(law(elongation, rate, elongation, known[inner]).value, elongation.shape)
        if law.expression.crosses_pole(law.values(elongation, rate, elongation, known[inner])):
            what = "divides by zero"
        elif np.any(np.isnan(force)):
            what = "is not defined"
        elif not np.all(np.abs(force) < LARGEST):
            what = "overflows"
        else:
            continue
        reach = [
            f"{name} goes from {np.min(motion):.3g} to {np.max(motion):.3g}"
            for name, motion in (("d", elongation), ("v", rate))
            if name in law.expression.names
        ]
        raise DataError(
            f"the law {law.text!r} of {element.name} {what} within the measured motion "
            f"({joined(reach)}, in SI units)",
            cure="write one that is finite there",
        )
