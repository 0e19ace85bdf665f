"""What sampling folds back of the motion that the ends of a record leave free (THEORY §8).

The boundary loads of (W) are those of a finite Fourier integral; lines are sums over samples.  By Euler and Maclaurin
h Σ f(nh), of a motion that begins at 0, exceeds its integral by (h/2) f(0) − (h²/12) f'(0) + (h⁴/720) f'''(0) − …, with
f(t) = y(t) e^{−st}: a polynomial in s = jω made of the first derivatives of the free motion.  These the equation of
motion gives: an impulse is answered by D⁻¹ = Σ Γ_q s^{−q}, y^{(k)}(0) = Γ_{k+1}, with M Γ_2 = 1 and
M Γ_q = −C Γ_{q−1} − K Γ_{q−2}.  Known like this it costs nothing; polynomials fitted in its place cost a free decay
several per cent of its precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.small_systems import scaled_inverse

# Power of h, derivative of f, factor.
SUM_BEYOND_INTEGRAL = (
    (1, 0, 1 / 2),
    (2, 1, -1 / 12),
    (4, 3, 1 / 720),
    (6, 5, -1 / 30240),
    (8, 7, 1 / 1209600),
)
DERIVATIVES = 3  # a motion, its velocity and its acceleration
POWERS = 8  # of s, from 1 to s⁷
LAST = 11  # of the Γ: a doublet's, in an acceleration, and its seventh derivative


@dataclass(frozen=True)
class SampledLoads:
    """What channels show beyond the response to an impulse (0) and a doublet (1) at each coordinate, of each record.

    Coefficients of powers of s = jω over the record's highest ω.
    terms (K, records, 2, powers, channels, n); slopes (K, records, 2, powers, channels, n, unknowns of the rig)
    """

    terms: Real
    slopes: Real

    def at(self, record: int, s: Complex) -> Complex:
        """At some lines of a record, under unit loads: (K, channels, 2 n, lines)."""
        K, loads, powers, channels, n = self.terms[:, record].shape
        terms = np.transpose(self.terms[:, record], (0, 3, 1, 4, 2)).reshape(K, channels, loads * n, powers)
        shown: Complex = terms @ _powers(s)
        return shown

    def slopes_at(self, record: int, s: Complex, loads: Real) -> Complex:
        """By the unknowns of the rig under loads (K, 2 n): (K, channels, unknowns of the rig, lines)."""
        slopes = self.slopes[:, record]
        by_loads = np.moveaxis(slopes, 4, 2).reshape(len(slopes), loads.shape[-1], *slopes.shape[2:4], -1)
        terms = np.einsum("kjpcm,kj->kcmp", by_loads, loads)
        shown: Complex = terms @ _powers(s)
        return shown


def shows_sampled_loads(view: ObservationModel) -> Bools:
    """Channels of which it is known, (channels,): motions on the record's own clock, of a rig with mass everywhere."""
    model = view.model
    if not small(model):
        return np.zeros(len(view.channels), dtype=bool)
    masses = matrices(model, np.ones(len(model.elements))).M
    if np.linalg.matrix_rank(masses) < model.n:
        return np.zeros(len(view.channels), dtype=bool)
    on_time = np.array([channel.delay == 0 for channel in view.channels], dtype=bool)
    known = on_time & (view.gain < 0) & ~view.flips & ~np.any(view.force, axis=-1)
    moved: Bools = known & np.any(view.on_x, axis=-1)
    return moved


def sampled_loads(view: ObservationModel, known: Bools, p: Real, step: Real, highest: Real) -> SampledLoads:
    """Those of a rig with parameters p (K, elements) in records of sampling step (records,) s and highest ω, rad/s.

    0 in channels of which it is not `known`, (records, channels).  Not finite where the masses are singular.
    """
    gamma, by_unknown = _derivatives(view.model, p)
    on_x = view.on_x * known[:, :, None]
    weight = _beyond(step, highest)[:, view.derivative]  # (records, channels, 2, powers, Γ)
    terms = np.einsum("rclpq,rci,qkij->krlpcj", weight, on_x, gamma, optimize=True)
    slopes = np.einsum("rclpq,rci,qkmij->krlpcjm", weight, on_x, by_unknown, optimize=True)
    return SampledLoads(terms, slopes)


def _powers(s: Complex) -> Complex:
    """1, s, s² and so on, (powers, lines)."""
    return s ** np.arange(POWERS)[:, None]


def _derivatives(model: Model, p: Real) -> tuple[Real, Real]:
    """Γ_0 … Γ_LAST (LAST + 1, K, n, n), and their slopes by the unknowns (LAST + 1, K, unknowns, n, n)."""
    at, by = matrices(model, p), matrices(model, np.ascontiguousarray(model.T.T))
    with np.errstate(all="ignore"):
        inverse = scaled_inverse(at.M)
    shape = (LAST + 1, len(p), model.n, model.n)
    gamma = np.zeros(shape)
    slopes = np.zeros((*shape[:2], len(by.M), *shape[2:]))
    gamma[2] = inverse
    for q in range(2, LAST + 1):
        if q > 2:
            gamma[q] = -inverse @ (at.C @ gamma[q - 1] + at.K @ gamma[q - 2])
        right = by.M @ gamma[q][:, None] + by.C @ gamma[q - 1][:, None] + by.K @ gamma[q - 2][:, None]
        right += at.C[:, None] @ slopes[q - 1] + at.K[:, None] @ slopes[q - 2]
        slopes[q] = -inverse[:, None] @ right
    return gamma, slopes


def _beyond(step: Real, highest: Real) -> Real:
    """What sums over samples exceed integrals by, as factors of the Γ: (records, derivatives, 2, powers, Γ).

    Of channels that show the motion and its first two derivatives; without their impulses, which no sample shows.
    """
    out = np.zeros((len(step), DERIVATIVES, 2, POWERS, LAST + 1))
    for derivative in range(DERIVATIVES):
        for load in range(2):
            order = derivative + load
            for power in range(order - 1):
                out[:, derivative, load, power, order - power] -= 1
            for height, k, factor in SUM_BEYOND_INTEGRAL:
                for power in range(k + 1):
                    of_jump = factor * comb(k, power) * (-1) ** power * step**height
                    out[:, derivative, load, power, order + 1 + k - power] += of_jump
    # From powers of jω to those of s, and from a doublet jω to the column s.
    scale = highest[:, None, None] ** (np.arange(POWERS) - np.arange(2)[:, None])
    return out * scale[:, None, :, :, None]
