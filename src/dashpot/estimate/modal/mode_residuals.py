"""Measured modes against those of a rig: χ² with its slopes, and how far each measured number is from the rig's.

Source: THEORY §4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real, freeze, hermitian
from dashpot.data.modal_data import ModalData
from dashpot.estimate.modal.pairing import MeasuredModes, measured_modes, pair, with_one_axis
from dashpot.model.modes import eigenpairs, mode_sensitivities
from dashpot.model.network import Model
from dashpot.numerics.levenberg_marquardt import QuadraticModel


@dataclass(frozen=True)
class ModeResiduals:
    """Measured minus the rig's, of one set of modes; NaN where not measured, where the rig has no such mode
    and where a shape is one point.

    frequency, damping  (modes,) in standard deviations
    shape, sd           (modes, points) residual, the scale of the shape taken out, and its standard deviation
    measured            (modes, points) the shapes as measured
    """

    frequency: Real
    damping: Real
    shape: Complex
    sd: Real
    measured: Complex

    def __post_init__(self) -> None:
        freeze(self)


def mode_residuals(model: Model, data: ModalData, theta: Real) -> ModeResiduals:
    """How far the modes of `data` (no batch axes) are from those of the rig at `theta` (unknowns,)."""
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    values, shapes = eigenpairs(model, model.parameters(theta[None]))
    at = pair(flat, view, values, shapes)[0]
    paired = at >= 0
    compared = view.present & (
        np.sum(view.present, axis=1, keepdims=True) > 1
    )  # one point alone is all scale
    lam = np.where(paired, values[0, at], np.nan)
    seen = np.where(paired[:, None], shapes[0, at], np.nan) @ view.look.T
    sd = np.sqrt(np.diagonal(data.covariance, axis1=-2, axis2=-1))
    shape_sd = np.sqrt(np.diagonal(data.shape_covariance, axis1=-2, axis2=-1).real)
    measured: Complex = np.where(compared, data.shapes, np.nan).astype(np.complex128)
    white = [
        view.shape[k] @ np.nan_to_num(np.stack([seen[k], measured[k]], axis=1)) for k in range(data.modes)
    ]
    scale = np.array([np.vdot(w[:, 0], w[:, 1]) / max(np.vdot(w[:, 0], w[:, 0]).real, 1e-300) for w in white])
    with np.errstate(invalid="ignore", divide="ignore"):
        frequency = (data.frequency_hz - np.abs(lam) / (2 * np.pi)) / sd[:, 0]
        damping = (data.damping_ratio + lam.real / np.abs(lam)) / sd[:, 1]
    return ModeResiduals(frequency, damping, measured - scale[:, None] * seen, shape_sd, measured)


def modal_misfit(
    model: Model, data: ModalData, view: MeasuredModes, theta: Real, rows: Ints
) -> QuadraticModel:
    """χ² with the priors, its slope and its curvature for `theta` (k, unknowns) of the repeats `rows`."""
    part = replace(
        data,
        frequency_hz=data.frequency_hz[rows],
        damping_ratio=data.damping_ratio[rows],
        shapes=data.shapes[rows],
    )
    p = model.parameters(theta)
    with np.errstate(all="ignore"):
        values, shapes = eigenpairs(model, p)
        chosen = pair(part, view, values, shapes)
        lost = np.any(chosen < 0, axis=-1)
        at = np.maximum(chosen, 0)
        lam = np.take_along_axis(values, at, axis=-1)
        phi = np.take_along_axis(shapes, at[..., None], axis=-2)
        dlam, dphi = mode_sensitivities(model, p, lam, phi)
        J, r = _eigen_rows(model, part, view, lam, dlam @ model.T)
        Js, rs = _shape_rows(part, view, phi, dphi @ model.T)
    away = theta - model.prior_mean
    precision = model.prior_precision
    cost = np.sum(r**2, axis=(-1, -2)) + 2 * np.sum(np.abs(rs) ** 2, axis=(-1, -2))
    cost = np.where(lost, np.inf, cost) + np.sum(precision * away**2, axis=-1)
    gradient = np.einsum("kmiu,kmi->ku", J, r) + 2 * np.einsum("kmpu,kmp->ku", np.conj(Js), rs).real
    m = len(model.unknowns)
    real, turned = J.reshape(len(theta), -1, m), Js.reshape(len(theta), -1, m)
    symmetric = np.swapaxes(real, -1, -2) @ real + 2 * (hermitian(turned) @ turned).real + np.diag(precision)
    return QuadraticModel(cost, gradient - precision * away, symmetric, symmetric)


def _eigen_rows(
    model: Model, data: ModalData, view: MeasuredModes, lam: Complex, dlam: Complex
) -> tuple[Real, Real]:
    """Whitened slopes (K, modes, 2, unknowns) and residuals (K, modes, 2) of frequency and damping ratio."""
    size = np.abs(lam)
    grow = (np.conj(lam)[..., None] * dlam).real / size[..., None]
    slope = np.stack(
        [
            grow / (2 * np.pi),
            -dlam.real / size[..., None] + lam.real[..., None] * grow / size[..., None] ** 2,
        ],
        axis=-2,
    )
    damping = np.where(view.damping, data.damping_ratio, 0.0)
    predicted = np.where(view.damping, -lam.real / size, 0.0)
    r = np.stack([data.frequency_hz - size / (2 * np.pi), damping - predicted], axis=-1)
    return view.eigen @ slope, (view.eigen @ r[..., None])[..., 0]


def _shape_rows(data: ModalData, view: MeasuredModes, phi: Complex, dphi: Complex) -> tuple[Complex, Complex]:
    """Whitened slopes (K, modes, points, unknowns) and residuals (K, modes, points), what the scale can do taken out.

    a = φ at the measured points; the scale s = aᴴV⁻¹φ_m / aᴴV⁻¹a leaves the residual orthogonal to a.
    """
    seen = (view.shape @ (phi @ view.look.T)[..., None])[..., 0]
    measured = (view.shape @ np.where(view.present, np.nan_to_num(data.shapes), 0.0)[..., None])[..., 0]
    power = np.sum(np.abs(seen) ** 2, axis=-1, keepdims=True)
    power = np.where(power > 0, power, 1.0)
    scale = np.sum(np.conj(seen) * measured, axis=-1, keepdims=True) / power
    r = measured - scale * seen
    slope = view.shape @ (view.look @ dphi) * scale[..., None]
    along = np.sum(np.conj(seen)[..., None] * slope, axis=-2, keepdims=True) / power[..., None]
    return slope - seen[..., None] * along, r
