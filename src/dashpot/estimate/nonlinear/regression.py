"""The equation of motion at measured harmonics as a regression: Yasuda and Watanabe's identification (THEORY §9).

e_h = Bᵀ (p ∘ a_h) − S f_h, a_h from the measured motion: linear elements by their law, nonlinear ones by the
alternating transform of the measured harmonics.  Linear in the parameters where inner constants are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, hermitian
from dashpot.errors import UsageError
from dashpot.estimate.linear.gram import known_side, regressors
from dashpot.estimate.method import Solution, closed_form
from dashpot.estimate.nonlinear.dwells import DwellLines, dwells_of, measured_elongations
from dashpot.estimate.nonlinear.law_domain import require_finite_laws
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.dynamics import unit_forces
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate, period_basis
from dashpot.model.nonlinear.harmonic_balance import samples_of
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured elongations of K repeats in their dwells, and what the lines' unit forces need."""

    model: Model
    dwells: DwellLines
    elongations: Real
    linear: Complex
    f: Complex

    def unit_forces(self, constants: Real) -> Complex:
        """a of all elements at every line, (K, lines, elements), for inner constants (G,); of one repeat also for T
        sets of them (T, G), (T, lines, elements)."""
        R = self.elongations.shape[1]
        sets = len(constants) if constants.ndim == 2 else len(self.elongations)
        q = np.broadcast_to(self.elongations, (sets, *self.elongations.shape[1:]))
        omega = np.tile(self.dwells.omega, sets)
        times = samples_of(self.model, self.dwells.orders)
        rows = np.repeat(np.broadcast_to(constants, (sets, constants.shape[-1])), R, axis=0)
        forces = alternate(self.model, rows, omega, q.reshape(-1, *q.shape[2:]), times, slopes=False)
        a = np.broadcast_to(self.linear, (sets, *self.linear.shape[1:])).copy()
        a[..., self.model.nonlinear] = self.dwells.lines(np.moveaxis(complex_of(forces.a), -1, 1), sets)
        return a


def measured_motion(data: Prepared) -> MeasuredMotion:
    """The motion that the channels show.

    Raises UsageError where some coordinate is not seen, DataError where a law is no finite number within the motion.
    """
    model, states = data.model, data.states
    if states is None:
        raise UsageError(
            "some coordinate or input is not seen, which least squares on harmonics needs",
            cure="use the method ml",
        )
    dwells = dwells_of(model, data.spectrum)
    linear = unit_forces(model, data.spectrum.omega, states.X, states.U)
    motion = MeasuredMotion(model, dwells, measured_elongations(model, dwells, states), linear, states.f)
    _require_finite_laws(motion)
    return motion


def _require_finite_laws(motion: MeasuredMotion) -> None:
    """Raises DataError where a law, its constants known, is no finite number within the measured motion."""
    model, q = motion.model, motion.elongations
    there, rate, _ = period_basis((q.shape[-1] - 1) // 2, samples_of(model, motion.dwells.orders))
    rows = np.moveaxis(q, 2, 0)
    require_finite_laws(model, rows @ there.T, motion.dwells.omega[:, None] * (rows @ rate.T))


def scale_of_lines(motion: MeasuredMotion) -> Real:
    """Weights of the lines that make equations of all dwells alike in size, (lines,): 1 over the dwell's power."""
    power = np.sum(
        np.abs(motion.linear * np.max(np.abs(motion.linear), axis=(0, 1), initial=1e-300) ** -1) ** 2, -1
    )
    per_dwell = motion.dwells.by_dwell(np.mean(power, axis=0)[None])[0]
    size = per_dwell[motion.dwells.dwell]
    weight: Real = 1 / np.where(size > 0, size, 1.0)
    return weight


def regression(motion: MeasuredMotion, constants: Real, weight: Real) -> tuple[Real, Real]:
    """(parameters (K, unknown elements), residual over the known side (K,)) of weighted least squares.

    The terms' own sizes do not count: they cancel where constants, as `MeasuredMotion.unit_forces` takes them, are far
    off.
    """
    N, right, Phi, h = weighted_normal_equations(motion, constants, weight)
    p = solve_scaled(N, right)
    e = h - np.einsum("klnu,ku->kln", Phi, p)
    power = np.sum(np.abs(h) ** 2 * weight[:, None], axis=(1, 2))
    residual = np.sum(np.abs(e) ** 2 * weight[:, None], axis=(1, 2)) / np.where(power > 0, power, 1.0)
    return p, residual


def weighted_normal_equations(
    motion: MeasuredMotion, constants: Real, weight: Real
) -> tuple[Real, Real, Complex, Complex]:
    """Those of `regression`: N (K, u, u), right side (K, u), regressors (K, lines, n, u), known side (K, lines, n)."""
    model = motion.model
    strengths = np.any(model.T, axis=0)
    a = motion.unit_forces(constants)
    Phi = regressors_of(model, a)[..., strengths]
    h = known_side(model, a, motion.f)
    rows = Phi.shape[-3] * Phi.shape[-2]
    scaled = (Phi * weight[:, None, None]).reshape(len(Phi), rows, -1)
    left = hermitian(scaled)
    N = (left @ Phi.reshape(len(Phi), rows, -1)).real + np.diag(1e-18 * model.prior_precision[strengths])
    right = (left @ h.reshape(len(Phi), rows, 1)).real[..., 0]
    return N, right, Phi, h


def regressors_of(model: Model, a: Complex) -> Complex:
    """Φ = Bᵀ diag(a) T, (K, lines, n, unknowns); 0 for inner constants."""
    return regressors(model, a) if not len(model.constants) else (a[..., None, :] * model.B.T) @ model.T


def require_known_constants(model: Model) -> None:
    """Raises UsageError where an inner constant is unknown: the equation is linear in the parameters alone."""
    unknown = [f"{element.name}.{constant.name}" for element, constant in model.constants if constant.unknown]
    if unknown:
        raise UsageError(
            f"least squares on harmonics cannot find {', '.join(unknown)}, which is inside a law",
            cure="give it a value, or use the method ml",
        )


def harmonic_least_squares(data: Prepared) -> Solution:
    """θ by least squares on measured harmonics, each dwell weighted by its power; the noise's bias is in it.

    The covariance is that of the scatter between dwells.  Raises UsageError where an inner constant is unknown.
    """
    model = data.model
    require_known_constants(model)
    motion = measured_motion(data)
    weight = scale_of_lines(motion)
    theta, _ = regression(motion, model.constants_map[1], weight)
    a = motion.unit_forces(model.constants_map[1])
    Phi = regressors_of(model, a)
    e = known_side(model, a, motion.f) - np.einsum("klnu,ku->kln", Phi, theta)
    rows = Phi.shape[-3] * Phi.shape[-2]
    left = hermitian((Phi * weight[:, None, None]).reshape(len(Phi), rows, -1))
    bread = scaled_inverse((left @ Phi.reshape(len(Phi), rows, -1)).real)
    scores = np.einsum("klnu,kln->klu", np.conj(Phi), e).real * weight[:, None]
    by_dwell = motion.dwells.by_dwell(scores)
    count = len(motion.dwells.omega)
    spread = count / max(count - 1, 1)
    meat = spread * np.einsum("kru,krv->kuv", by_dwell, by_dwell)
    return closed_form(theta, bread @ meat @ bread)
