"""Whether an estimate that was read from a file can be one: what a hand or a fault may have changed in it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dashpot.errors import DataError, Problem
from dashpot.io.words import listed
from dashpot.quantities import LARGEST

if TYPE_CHECKING:
    from dashpot.estimate.result import Estimate

ASYMMETRY = 1e-9  # of an entry of a covariance, in standard deviations


def require_sound(estimate: Estimate, where: str) -> None:
    """Raises DataError, placed at `where`, with everything that no estimate can have."""
    problems = [
        Problem(what, where, "write it again with dashpot, or correct it") for what in _faults(estimate)
    ]
    if problems:
        raise DataError(problems)


def _faults(estimate: Estimate) -> Iterator[str]:
    names, count = estimate.names, len(estimate.names)
    texts = (*names, *estimate.units, estimate.model, estimate.method, estimate.basis)
    if not all(isinstance(text, str) for text in (*texts, "" if estimate.rig is None else estimate.rig)):
        yield "a name, a unit or the rig is not text"
        return
    if len(set(names)) < count:
        yield f"order: {next(name for name in names if names.count(name) > 1)} is named twice"
    if np.ndim(estimate.iterations) or np.ndim(estimate.converged):
        yield "iterations: not one number"
        return
    for name in ("covariance", "noise_covariance"):
        matrix = getattr(estimate, name)
        if matrix.shape != (count, count):
            yield f"{name}: {matrix.shape} numbers, and {count} unknowns"
            return
        yield from _matrix_faults(name, matrix, names)
    yield from _value_faults(estimate)
    yield from _reference_faults(estimate)


def _value_faults(estimate: Estimate) -> Iterator[str]:
    """Values that are lost, sizes below 0 and bounds that leave no room."""
    names = estimate.names
    for name, value in zip(names, estimate.values, strict=True):
        if np.isfinite(value) and abs(value) > LARGEST:
            yield f"{name}: {value:g} is out of range"
    if bool(estimate.converged):
        lost = [name for name, value in zip(names, estimate.values, strict=True) if not np.isfinite(value)]
        if lost:
            yield f"{listed(lost)}: no value"
    for label, array in (("bound_sd", estimate.bound_sd), ("interval_dof", estimate.dof)):
        wrong = [name for name, value in zip(names, array, strict=True) if value < 0]
        if wrong:
            yield f"{listed(wrong)}: {label} is negative"
    for name, low, high in zip(names, estimate.lower, estimate.upper, strict=True):
        if not low <= high:
            yield f"{name}: min is above max"


def _reference_faults(estimate: Estimate) -> Iterator[str]:
    """Tied and known elements that refer to nothing or have no value."""
    for _, root, times, _ in estimate.tied:
        if root not in estimate.names:
            yield f"tied: {root} is not among the unknowns"
        if not np.isfinite(times):
            yield f"tied: {times} is not a finite number"
    for name, value, _ in estimate.known:
        if not abs(value) <= LARGEST:
            yield f"{name}: no value, or one that is out of range"


def _matrix_faults(label: str, matrix: np.ndarray, names: tuple[str, ...]) -> Iterator[str]:
    """Variances must not be negative, correlations not beyond 1, and the matrix symmetric; null is not known."""
    variances = np.diagonal(matrix)
    negative = [name for name, value in zip(names, variances, strict=True) if value < 0]
    if negative:
        yield f"{label}: the variance of {listed(negative)} is negative"
        return
    sd = np.sqrt(variances)
    size = np.outer(sd, sd)
    with np.errstate(invalid="ignore", over="ignore"):
        skew = np.abs(matrix - matrix.T) > ASYMMETRY * size
        beyond = np.abs(matrix) > (1 + ASYMMETRY) * size
    if np.any(skew):
        yield f"{label}: not symmetric"
    elif np.any(beyond):
        i, j = np.argwhere(beyond)[0]
        yield f"{label}: the correlation of {names[i]} and {names[j]} is beyond 1"
