"""The linear elements of a rig at every harmonic, with a share of the nonlinear ones that keeps them regular."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.harmonics import Drive, rates_of_orders


@dataclass(frozen=True)
class LinearPart:
    """The linear elements and the share s of the nonlinear ones at each harmonic.

    inverse (N, H + 1, n, n): D⁻¹; receptance (N, H + 1, e, e): Z; share (N, H + 1, e): s; driven (N, H + 1, n):
    R U + S f less the share that inputs stretch; free (N, H + 1, e): elongation without nonlinear forces.
    """

    inverse: Complex
    receptance: Complex
    share: Complex
    driven: Complex
    free: Complex

    def rows(self, keep: Bools | Ints) -> LinearPart:
        """That of some of the dwells."""
        return LinearPart(
            self.inverse[keep], self.receptance[keep], self.share[keep], self.driven[keep], self.free[keep]
        )


def linear_part(model: Model, p: Real, drive: Drive, secant: Complex) -> LinearPart:
    """`secant` (N, e): force per elongation that is kept in the linear part, N/m at the fundamental."""
    chosen = model.nonlinear
    B, D = model.B[chosen], model.D[chosen]
    jw = drive.omega[:, None] * rates_of_orders(drive.orders)
    share = secant.real[:, None, :] + jw[..., None] * (secant.imag / drive.omega[:, None])[:, None, :]
    both = linear_stiffness(model, p, jw)
    both = both + np.einsum("nhe,ei,ej->nhij", share, B, np.concatenate([B, D], axis=1))
    n = model.n
    driven = -np.einsum("nhij,nhj->nhi", both[..., n:], drive.U) + np.einsum("ij,nhj->nhi", model.S, drive.f)
    inverse = _regular_inverse(both[..., :n])
    X = np.einsum("nhij,nhj->nhi", inverse, driven)
    return LinearPart(inverse, B @ inverse @ B.T, share, driven, X @ B.T + drive.U @ D.T)


def linear_stiffness(model: Model, p: Real, jw: Complex) -> Complex:
    """[D | −R] of the linear elements at each harmonic, (N, H + 1, n, n + r)."""
    omega = jw.imag
    factors = model.factors(omega)  # (N, H + 1, elements), 0 for nonlinear ones
    both: Complex = np.einsum(
        "nhe,ei,ej->nhij", p[:, None, :] * factors, model.B, np.concatenate([model.B, model.D], axis=1)
    )
    return both


def _regular_inverse(D: Complex) -> Complex:
    """D⁻¹; what nothing holds (a floating rig at order 0) is held by a spring too soft to matter."""
    n = D.shape[-1]
    size = np.max(np.abs(D), axis=(-2, -1), keepdims=True)
    largest = np.max(size, axis=1, keepdims=True)
    soft = np.zeros_like(size)
    soft[:, :1] = 1e-10 * np.where(size[:, :1] > 1e-12 * largest, size[:, :1], largest)
    try:
        with np.errstate(all="ignore"):
            inverse: Complex = np.linalg.inv(D + np.where(_singular(D), soft, 0.0) * np.eye(n)).astype(
                np.complex128
            )
            return inverse
    except np.linalg.LinAlgError:
        return np.full_like(D, np.nan)


def _singular(D: Complex) -> Bools:
    """Whether the constant term of the response is not held, (N, H + 1, 1, 1)."""
    n = D.shape[-1]
    loose = np.zeros((*D.shape[:2], 1, 1), dtype=bool)
    diagonal = np.sqrt(np.abs(np.diagonal(D[:, 0], axis1=-2, axis2=-1)))
    held = np.where(diagonal > 0, diagonal, 1.0)
    scaled = D[:, 0] / (held[:, :, None] * held[:, None, :])
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(scaled), scaled, 0.0)
    loose[:, 0, 0, 0] = (np.linalg.svd(finite, compute_uv=False)[:, -1] < 1e-12 * n) | np.any(
        diagonal == 0, axis=-1
    )
    return loose
