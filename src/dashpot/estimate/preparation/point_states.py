"""Channels that each show one entry of z = (X, U, f), their noise uncorrelated: weighted means instead of systems."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.model.observation import ObservationModel
from dashpot.numerics.kernel import kernel_function


def states_by_point(
    view: ObservationModel, used: Bools, V: Complex, y: Complex
) -> tuple[Complex, Complex, Complex] | None:
    """ẑ (..., lines, q), its covariance (..., lines, q, q) and P (..., lines, q, channels) with ẑ = P y; None as below.

    used (lines, channels), V (..., lines, channels, channels), y (..., lines, channels).
    """
    compiled = kernel_function("point_states")
    if compiled is None or V.ndim != 4 or y.ndim != 3:
        simple = combined_by_point(view.direct, used, V)
        return None if simple is None else ((simple[0] @ y[..., None])[..., 0], simple[1], simple[0])
    if view.single_entries is None:
        return None
    states: tuple[Complex, Complex, Complex] | None = compiled(
        *view.single_entries, used, V, y, view.direct_incidence.shape[-1]
    )
    return states


def combined_by_point(C: Complex, used: Bools, V: Complex) -> tuple[Complex, Complex] | None:
    """P (..., lines, q, channels) with ẑ = P y, and the covariance of ẑ (..., lines, q, q); None where it is not so.

    C (lines, channels, q) as `ObservationModel.direct`, used (lines, channels), V (..., lines, channels, channels).  A
    channel of a point weighs with |C|²/V; an exact one alone counts.
    """
    shows = (C != 0).any(axis=0)
    if (np.count_nonzero(shows, axis=-1) > 1).any():
        return None
    variance = V.diagonal(axis1=-2, axis2=-1).real
    if np.count_nonzero(V) != np.count_nonzero(variance):
        return None
    nonzero = shows.astype(float)
    reading: Complex = C.sum(axis=-1)  # of the one entry
    seen = used & (reading != 0)
    exact = seen & (variance <= 0)
    exactly = exact @ nonzero
    if (exactly > 1).any():
        return None  # two exact channels of one point
    counted: Bools = seen & (exact | (exactly @ nonzero.T == 0))
    size: Real = (reading * reading.conj()).real
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(counted, size / np.where(exact, size, variance), 0.0)
        information = weight @ nonzero
        share = np.where(counted, weight / (information @ nonzero.T) / reading, 0.0)
        spread = np.where(exactly > 0, 0.0, 1 / information)
    P: Complex = nonzero.T * share[..., None, :]
    covariance = np.zeros((*spread.shape, C.shape[-1]), dtype=np.complex128)
    entry = np.arange(C.shape[-1])
    covariance[..., entry, entry] = spread
    return P, covariance
