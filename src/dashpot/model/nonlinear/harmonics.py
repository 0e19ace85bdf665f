"""Harmonics of periodic motions as complex and as real numbers, and what drives dwells (THEORY §9).

x(t) = Σ_h Re(X_h e^{jhωt}), h = 0 … H.  As real numbers they come in the order X_0, Re X_1, Im X_1, Re X_2, …, that is
W = 2 H + 1 numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.model.network import Model
from dashpot.model.nonlinear.force_law import ForceLaw

# The mirror image of a rig: the one that moves by −x(t) where this one moves by x(t).
#
# Driven at odd harmonics alone, both show the same odd harmonics half a period later; even ones differ in sign.


def mirrored(model: Model, theta: Real) -> Real | None:
    """θ (unknowns,) of the mirror image, None where it is the same rig or no rig of this form.

    A law a(d, v) becomes −a(−d, −v): odd laws stay, even ones change their parameter's sign, others may change the sign
    of constants.  Known and tied parameters are kept, so their laws must be odd.
    """
    image = theta.copy()
    constants, slope = model.inner_constants(theta), model.constants_map[0]
    for index, law, inner in zip(model.nonlinear, model.laws, model.constant_slices, strict=True):
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
    """Signs of the parameter and of the constants with which the law is its own image; None if none are."""
    if law.has_state:  # stop, play and Bouc-Wen know no direction
        return 1.0, (1.0,) * len(g)
    lengths = [abs(c) for c, name in zip(g, law.constant_names, strict=True) if law.exponents[1][name][0] > 0]
    scale = max(lengths, default=1.0)
    points = scale * np.linspace(-1.7, 1.9, 13)  # not symmetric themselves
    d, v = (part.ravel() for part in np.meshgrid(points, points))
    original = np.broadcast_to(law(-d, -v, d, g[None]).value, (1, len(d)))
    size = np.max(np.abs(original)) * 1e-9
    for flips in product((1.0, -1.0), repeat=len(g)):
        image = np.broadcast_to(law(d, v, d, (g * flips)[None]).value, (1, len(d)))
        for strength in (1.0, -1.0):
            if np.max(np.abs(strength * image + original)) <= size:
                return strength, flips
    return None


@dataclass(frozen=True)
class Drive:
    """What drives N dwells: omega (N,) rad/s, U (N, H + 1, r) m and f (N, H + 1, s) N, order 0 being a constant."""

    omega: Real
    U: Complex
    f: Complex

    @property
    def orders(self) -> int:
        """Highest harmonic H."""
        return int(self.U.shape[1]) - 1

    def rows(self, keep: Bools | Ints) -> Drive:
        """Some of the dwells."""
        return Drive(self.omega[keep], self.U[keep], self.f[keep])

    def scaled(self, share: float) -> Drive:
        """All amplitudes multiplied."""
        return Drive(self.omega, share * self.U, share * self.f)

    def with_orders(self, orders: int) -> Drive:
        """The same drive with as many harmonics, cut off or zero."""
        return Drive(self.omega, with_orders(self.U, orders), with_orders(self.f, orders))


def joined_drives(drives: Sequence[Drive]) -> Drive:
    """The dwells of several drives with the same harmonics, one after another."""
    return Drive(
        np.concatenate([drive.omega for drive in drives]),
        np.concatenate([drive.U for drive in drives]),
        np.concatenate([drive.f for drive in drives]),
    )


def with_orders(X: Complex, orders: int) -> Complex:
    """Harmonics (N, H + 1, …) cut off or filled with zeros to `orders`."""
    kept = X[:, : orders + 1]
    if kept.shape[1] == orders + 1:
        return kept
    missing = np.zeros((len(X), orders + 1 - kept.shape[1], *X.shape[2:]), dtype=X.dtype)
    return np.concatenate([kept, missing], axis=1)


def complex_of(q: Real) -> Complex:
    """(..., W) real numbers as harmonics (..., H + 1)."""
    X = np.empty((*q.shape[:-1], (q.shape[-1] + 1) // 2), dtype=np.complex128)
    X[..., 0] = q[..., 0]
    X[..., 1:] = q[..., 1::2] + 1j * q[..., 2::2]
    return X


def real_of(X: Complex) -> Real:
    """Harmonics (..., H + 1) as (..., W) real numbers; the imaginary part of order 0 is left out."""
    q = np.empty((*X.shape[:-1], 2 * X.shape[-1] - 1))
    q[..., 0] = X[..., 0].real
    q[..., 1::2], q[..., 2::2] = X[..., 1:].real, X[..., 1:].imag
    return q


@lru_cache(maxsize=8)
def rates_of_orders(orders: int) -> Complex:
    """jh for the orders h = 0 … orders, (orders + 1,)."""
    return (1j * np.arange(orders + 1)).astype(np.complex128)


def share_blocks(share: Complex) -> Real:
    """The linear share of each element, (N, H + 1, e), as real matrices (N, e, W, W)."""
    each = np.moveaxis(share, -1, 1)
    W = 2 * each.shape[-1] - 1
    blocks = np.zeros((*each.shape[:2], W, W))
    re, im = np.arange(1, W, 2), np.arange(2, W, 2)
    blocks[..., 0, 0] = each[..., 0].real
    blocks[..., re, re] = blocks[..., im, im] = each[..., 1:].real
    blocks[..., im, re] = each[..., 1:].imag
    blocks[..., re, im] = -each[..., 1:].imag
    return blocks


def rows_of(X: Complex) -> Real:
    """(N, H + 1, e, Q) complex as (N, e, W, Q) real."""
    return real_of(X.transpose(0, 2, 3, 1)).swapaxes(-1, -2)


def complex_rows(q: Real) -> Complex:
    """(N, e, W, Q) real as (N, H + 1, e, Q) complex."""
    return complex_of(q.swapaxes(-1, -2)).transpose(0, 3, 1, 2)
