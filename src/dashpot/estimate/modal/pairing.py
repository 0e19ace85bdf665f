"""Measured modes as the search needs them, and which of the model's modes each of them is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.data.modal_data import ModalData
from dashpot.errors import DataError
from dashpot.model.network import Model

EXACT = 1e-6  # sd of exact points of a shape, relative to the largest of the others


@dataclass(frozen=True)
class MeasuredModes:
    """The data as the search needs them: what is there, and the roots that whiten it.

    frequency, damping: (modes,) whether measured; eigen (modes, 2, 2): whitens (frequency, damping);
    shape (modes, points, points): whitens a shape, rows and columns of absent points 0; look (points, n) picks them.
    """

    damping: Bools
    eigen: Real
    present: Bools
    shape: Complex
    look: Real
    rows: int

    def dof(self, model: Model) -> int:
        """Degrees of freedom of χ² of a fit of `model`, whose priors count as data."""
        return self.rows - len(model.unknowns) + int(np.count_nonzero(model.prior_precision))


def with_one_axis(data: ModalData) -> ModalData:
    """The data with one leading axis of repeats."""
    repeats = int(np.prod(data.frequency_hz.shape[:-1], dtype=int))
    return replace(
        data,
        frequency_hz=data.frequency_hz.reshape(repeats, data.modes),
        damping_ratio=data.damping_ratio.reshape(repeats, data.modes),
        shapes=data.shapes.reshape(repeats, data.modes, len(data.points)),
    )


def measured_modes(model: Model, data: ModalData) -> MeasuredModes:
    """What is measured of each mode, and its whitening.  Raises DataError where some uncertainty is missing."""
    damping = np.all(np.isfinite(data.damping_ratio), axis=0)
    present = np.all(np.isfinite(data.shapes), axis=0)
    eigen = np.zeros((data.modes, 2, 2))
    shape = np.zeros((data.modes, len(data.points), len(data.points)), dtype=complex)
    rows = 0
    for k in range(data.modes):
        count = 2 if damping[k] else 1
        eigen[k, :count, :count] = _whitening(
            data.covariance[k, :count, :count], f"frequency of mode {k + 1}"
        ).real
        at = np.flatnonzero(present[k])
        if len(at) > 1:
            V = data.shape_covariance[k][np.ix_(at, at)]
            variance = np.diagonal(V).real
            floor = np.where(variance == 0, EXACT**2 * np.max(variance), 0.0)
            shape[k][np.ix_(at, at)] = _whitening(V + np.diag(floor), f"shape of mode {k + 1}")
            rows += 2 * len(at) - 2
        rows += count
    look = np.array([[float(name == x) for x in model.coordinates] for name in data.points])
    return MeasuredModes(damping, eigen, present, shape, look.reshape(len(data.points), model.n), rows)


def _whitening(V: Complex | Real, what: str) -> Complex:
    """L⁻¹ of V = L Lᴴ, measured in its standard deviations."""
    sd = np.sqrt(np.maximum(np.diagonal(V).real, 0.0))
    if np.all(np.isfinite(V)) and np.all(sd > 0):
        try:
            L = np.linalg.cholesky(V / np.outer(sd, sd))
            white: Complex = np.linalg.solve(L, np.diag(1 / sd)).astype(complex)
            return white
        except np.linalg.LinAlgError:
            pass
    raise DataError(
        f"the covariance of the {what} is not positive definite", cure="give its standard deviations"
    )


def pair(data: ModalData, view: MeasuredModes, values: Complex, shapes: Complex) -> Ints:
    """Which of the model's modes each measured one is, (K, modes); −1 where there is none.

    The pairs that make Σ (1 − MAC) + |ln (f / f_measured)| least, each mode used once (Hungarian method).
    """
    swings = np.isfinite(values) & (values.imag > 1e-9 * np.abs(np.nan_to_num(values)))
    f = np.where(swings, np.abs(np.nan_to_num(values)), 1.0) / (2 * np.pi)
    cost = np.abs(np.log(f[:, None, :] / data.frequency_hz[:, :, None]))
    several = np.sum(view.present, axis=-1) > 1
    if np.any(several):
        seen = np.nan_to_num(shapes) @ view.look.T
        measured = np.where(view.present, np.nan_to_num(data.shapes), 0.0)
        there = view.present.astype(float)
        across = np.abs(np.einsum("kmp,kjp->kmj", np.conj(measured), seen)) ** 2
        size = np.sum(np.abs(measured) ** 2, axis=-1)
        theirs = np.einsum("mp,kjp->kmj", there, np.abs(seen) ** 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            mac = across / (size[:, :, None] * theirs)
        cost = cost + np.where(several[:, None], 1 - np.nan_to_num(mac), 0.0)
    cost = np.where(swings[:, None, :], cost, 1e6)
    chosen = np.empty(cost.shape[:2], dtype=np.int64)
    for k, table in enumerate(cost):
        rows, columns = linear_sum_assignment(table)
        chosen[k, rows] = np.where(table[rows, columns] < 1e6, columns, -1)
    return chosen
