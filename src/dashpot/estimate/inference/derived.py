"""What follows from an estimate: known and tied parameters, modes with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ModelError
from dashpot.estimate.result import ModeValues
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.numerics.kernel import kernel_function

MODES_TO = 400  # coordinates: the modes of larger rigs would take longer than all else
COMPILED_TO = 12  # coordinates up to which the kernel's eigenvalues take less time than LAPACK's
LOST = 1e-13  # of the terms of a variance: below it the sum is rounding
Values = TypeVar("Values")


def known_values(model: Model) -> tuple[tuple[str, float, str], ...]:
    """(name, value, unit) of the parameters and constants that are exactly known."""
    return _kept(model, _known_values)


def tied_values(model: Model) -> tuple[tuple[str, str, float, str], ...]:
    """(name, unknown, times, unit) of the parameters that are a multiple of an unknown."""
    return _kept(model, _tied_values)


def _kept(model: Model, make: Callable[[Model], Values]) -> Values:
    """What `make` says of a model, kept with it."""
    if (make,) not in model.views:
        model.views[make,] = make(model)
    return cast("Values", model.views[make,])


def _known_values(model: Model) -> tuple[tuple[str, float, str], ...]:
    unknown = {u.name for u in model.unknowns}
    constants = tuple(
        (f"{e.name}.{c.name}", float(c.value), model.constant_unit(e, c))
        for e, c in model.constants
        if not c.unknown and c.value is not None
    )
    return constants + tuple(
        (element.name, float(model.p0[i]), model.unit(element))
        for i, (element, known) in enumerate(zip(model.elements, _of_no_unknown(model), strict=True))
        if element.name not in unknown and known and not element.is_entry
    )


def _tied_values(model: Model) -> tuple[tuple[str, str, float, str], ...]:
    return tuple(
        (element.name, model.elements[tie.root].name, tie.times, model.unit(element))
        for element, tie, known in zip(model.elements, model.ties, _of_no_unknown(model), strict=True)
        if element.same_as is not None and not element.is_entry and not known
    )


def _of_no_unknown(model: Model) -> list[bool]:
    """Whether an element's parameter follows from known ones alone, (elements,)."""
    known: list[bool] = (np.diff(model.sparse_T.indptr) == 0).tolist()
    return known


def linear_modes(model: Model, theta: Real, covariance: Real) -> ModeValues | None:
    """Modes of the linear elements; None where nonlinear ones hold the rig together, and of rigs of many coordinates.

    theta (m,), covariance (m, m).
    """
    if model.n > MODES_TO:
        return None
    if not len(model.nonlinear):
        return mode_values(model, theta, covariance)
    try:
        return mode_values(model, theta, covariance)
    except ModelError:
        return None


def mode_values(model: Model, theta: Real, covariance: Real) -> ModeValues:
    """Modes at θ with standard deviations of frequency and damping propagated from its covariance.

    NaN where a standard deviation is lost in the rounding of terms that are far larger.
    theta (m,), covariance (m, m).
    """
    compiled = kernel_function("mode_values") if model.n <= COMPILED_TO else None
    if compiled is not None:
        # None where masses are missing or coupled, or where nothing holds a motion.
        table = compiled(model.B, model.letters, model.T, model.p0, theta, covariance)
        if table is not None:
            return ModeValues(*table)
    of_rig = modes(model, model.parameters(theta))
    slope = of_rig.sensitivity @ model.T
    values = of_rig.eigenvalues
    size = np.abs(values)[:, None]
    size = np.where(size > 0, size, 1.0)
    grow = (values.conj()[:, None] * slope).real / size
    frequency = grow / (2 * np.pi)
    damping = -slope.real / size + values.real[:, None] * grow / size**2
    jacobian = np.stack([frequency, damping])
    variance = ((jacobian @ covariance) * jacobian).sum(axis=-1)
    reach = np.abs(jacobian)
    terms = ((reach @ np.abs(covariance)) * reach).sum(axis=-1)
    lost = (variance <= LOST * terms) & (terms > 0)
    frequency_sd, damping_sd = np.sqrt(np.where(lost, np.nan, np.maximum(variance, 0.0)))
    return ModeValues(
        values, of_rig.frequency_hz, of_rig.damping_ratio, frequency_sd, damping_sd, of_rig.shapes
    )
