"""The equation of motion at measured harmonics as a regression: Yasuda and Watanabe's identification (THEORY §9).

e_h = Bᵀ (p ∘ a_h) − S f_h, a_h from the measured motion: linear elements by their law, nonlinear ones by the
alternating transform of the measured harmonics.  Linear in the parameters where inner constants are known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real, hermitian
from dashpot.errors import DataError, UsageError
from dashpot.estimate.linear.gram import known_side, regressors
from dashpot.estimate.method import Solution, closed_form
from dashpot.estimate.nonlinear.objective import DwellLines, dwells_of, measured_elongations
from dashpot.estimate.preparation import Prepared, States
from dashpot.io.words import joined
from dashpot.model.dynamics import unit_forces
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate, period_basis
from dashpot.model.nonlinear.harmonic_balance import harmonic_unit_forces, periodic_response, samples_of
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled


def require_finite_laws(model: Model, d: Real, v: Real) -> None:
    """Raises DataError if a law without unknown constants divides by zero, overflows or is no number.

    d, v (e, …, instants): elongations and rates of the nonlinear elements in the measured motion.
    """
    known = model.constants_map[1]
    for row, (index, law, inner) in enumerate(
        zip(model.nonlinear, model.laws, model.constant_slices, strict=True)
    ):
        if law.has_state or any(constant.unknown for constant in law.constants):
            continue
        elongation, rate = d[row], v[row]
        with np.errstate(all="ignore"):
            force = np.broadcast_to(law(elongation, rate, elongation, known[inner]).value, elongation.shape)
        if law.expression.crosses_pole(law.values(elongation, rate, elongation, known[inner])):
            what = "divides by zero"
        elif np.any(np.isnan(force)):
            what = "is not defined"
        elif not np.all(np.abs(force) < 1e100):  # squares of what is larger overflow
            what = "overflows"
        else:
            continue
        reach = [
            f"{name} runs from {np.min(motion):.3g} to {np.max(motion):.3g}"
            for name, motion in (("d", elongation), ("v", rate))
            if name in law.expression.names
        ]
        raise DataError(
            f"the law {law.text!r} of {model.elements[int(index)].name} {what} within the measured motion "
            f"({joined(reach)}, in SI units)",
            cure="use a law that is finite there",
        )


@dataclass(frozen=True)
class MeasuredMotion:
    """Measured elongations of K repeats in their dwells, and what the lines' unit forces need.

    force (k, elements), measured (K, lines, k): calibrated channels of the force in elements, and what they show, N.
    """

    model: Model
    dwells: DwellLines
    elongations: Real
    linear: Complex
    f: Complex
    force: Real
    measured: Complex

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

    Raises UsageError if some coordinate is not seen, DataError if a law is no finite number within the motion.
    """
    model, states = data.model, data.states
    if states is None:
        raise UsageError(
            "some coordinate or input is not measured, which least squares on harmonics needs",
            cure="use the method ml",
        )
    dwells = dwells_of(model, data.spectrum)
    linear = unit_forces(model, data.spectrum.omega, states.X, states.U)
    view = data.view
    shown = np.any(view.force, axis=-1) & view.calibration_known
    shown &= ~np.any(np.isnan(data.spectrum.amplitudes), axis=tuple(range(data.spectrum.amplitudes.ndim - 1)))
    motion = MeasuredMotion(
        model,
        dwells,
        measured_elongations(model, dwells, states),
        linear,
        states.f,
        view.force[shown],
        data.spectrum.amplitudes[..., shown],
    )
    q, omega = motion.elongations, dwells.omega[:, None]
    there, rate, _ = period_basis((q.shape[-1] - 1) // 2, samples_of(model, dwells.orders))
    rows = np.moveaxis(q, 2, 0)
    require_finite_laws(model, rows @ there.T, omega * (rows @ rate.T))
    return motion


def scale_of_lines(motion: MeasuredMotion) -> Real:
    """Weights of the lines that make equations of all dwells alike in size, (lines,): 1 over the dwell's power."""
    power = np.sum(
        np.abs(motion.linear * np.max(np.abs(motion.linear), axis=(0, 1), initial=1e-300) ** -1) ** 2, -1
    )
    per_dwell = motion.dwells.by_dwell(np.mean(power, axis=0)[None])[0]
    size = per_dwell[motion.dwells.dwell]
    return 1 / np.where(size > 0, size, 1.0)


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
    """Those of `regression`: N (K, u, u), right side (K, u), regressors (K, lines, n + k, u) and known side
    (K, lines, n + k): the equations of motion, then what channels show of the force in elements.
    """
    model = motion.model
    strengths = np.any(model.T, axis=0)
    a = motion.unit_forces(constants)
    balance = (a[..., None, :] * motion.force) @ model.T
    Phi = np.concatenate([regressors_of(model, a), balance], axis=-2)[..., strengths]
    measured = motion.measured - (a * model.p0) @ motion.force.T
    h = np.concatenate([known_side(model, a, motion.f), measured], axis=-1)
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
    """Raises UsageError if an inner constant is unknown: the equation is linear in the parameters alone."""
    unknown = [f"{element.name}.{constant.name}" for element, constant in model.constants if constant.unknown]
    if unknown:
        raise UsageError(
            f"least squares on harmonics cannot find {', '.join(unknown)}, a constant inside a law",
            cure="state its value, or use the method ml",
        )


def harmonic_least_squares(data: Prepared) -> Solution:
    """θ by least squares on measured harmonics, each dwell weighted by its power; the noise's bias is in it.

    The covariance is that of the scatter between dwells.  Raises UsageError if an inner constant is unknown.
    """
    require_known_constants(data.model)
    motion = measured_motion(data)
    weight = scale_of_lines(motion)
    N, right, Phi, h = weighted_normal_equations(motion, data.model.constants_map[1], weight)
    theta, bread = solve_scaled(N, right), scaled_inverse(N)
    e = h - np.einsum("klnu,ku->kln", Phi, theta)
    scores = np.einsum("klnu,kln->klu", np.conj(Phi), e).real * weight[:, None]
    by_dwell = motion.dwells.by_dwell(scores)
    count = len(motion.dwells.omega)
    meat = count / max(count - 1, 1) * np.einsum("kru,krv->kuv", by_dwell, by_dwell)
    return closed_form(theta, bread @ meat @ bread)


# The equation of motion at the measured harmonics of dwells, as real rows with the noise that each dwell's rows share.
#
# A nonlinear law mixes the harmonics of its dwell: with ∂a/∂q of the alternating transform the noise of the equation
# is, to first order, H Σ Hᵀ with H = Bᵀ p ∂a/∂q [B D] of the nonlinear elements beside the linear ones' (THEORY §9).


@dataclass(frozen=True)
class HarmonicEquations:
    """Dwells of K repeats, all of whose coordinates are seen; θ enters linearly."""

    motion: MeasuredMotion
    states: States

    def rows(self, rows: Ints) -> HarmonicEquations:
        """Some of the repeats, rows (k,)."""
        motion = self.motion
        picked = replace(
            motion, elongations=motion.elongations[rows], linear=motion.linear[rows], f=motion.f[rows]
        )
        return HarmonicEquations(picked, self.states.rows(rows))

    @property
    def constants(self) -> Real:
        """The inner constants, all known, (G,)."""
        return self.motion.model.constants_map[1]

    def regression(self, a: Complex) -> tuple[Real, Real]:
        """Φ (K, dwells, rows, unknowns) and h (K, dwells, rows) with unit forces a (K, lines, elements).

        The real rows of a dwell, slots · 2 · n, are 0 where it has fewer lines than another.
        """
        model, dwells = self.motion.model, self.motion.dwells
        side = known_side(model, a, self.motion.f)[..., None]
        both = np.concatenate([regressors_of(model, a), side], axis=-1)
        K, _, n, columns = both.shape
        rows = np.zeros((K, len(dwells.omega), dwells.slots, 2, n, columns))
        rows[:, dwells.dwell, dwells.slot, 0] = both.real
        rows[:, dwells.dwell, dwells.slot, 1] = both.imag
        flat = rows.reshape(K, len(dwells.omega), -1, columns)
        return flat[..., :-1], flat[..., -1]

    def least_squares(self) -> Real:
        """θ of equally weighted rows of the measured harmonics, (K, unknowns)."""
        Phi, h = self.regression(self.motion.unit_forces(self.constants))
        return self.solved(Phi, Phi, h, None)

    def solved(self, left: Real, Phi: Real, h: Real, at: Real | None) -> Real:
        """θ with leftᵀ (Φ θ − h) = 0 and the priors' rows, weighed by the equation's variance at θ = `at`."""
        N, right = np.einsum("krau,krav->kuv", left, Phi), np.einsum("krau,kra->ku", left, h)
        precision = self.motion.model.prior_precision
        if np.any(precision):
            variance = 1e-18 * np.ones(len(N)) if at is None else self.variance(self.noise(at))
            N = N + variance[:, None, None] * np.diag(precision)
            right = right + variance[:, None] * precision * self.motion.model.prior_mean
        return solve_scaled(N, right)

    def noise(self, theta: Real) -> Real:
        """Covariance of the rows at θ (K, unknowns), (K, dwells, rows, rows); 1 on the diagonal of empty rows."""
        model, dwells, s = self.motion.model, self.motion.dwells, self.states
        K, R, q = len(theta), len(dwells.omega), s.z.shape[-1]
        p = model.parameters(theta)
        span = np.zeros((len(model.elements), q))
        span[:, : s.n + s.r] = np.concatenate([model.B, model.D], axis=1)
        linear = (model.B.T * (p[:, None] * model.factors(s.omega))[:, :, None]) @ span
        linear[..., s.n + s.r :] -= model.S
        H = np.zeros((K, R, dwells.slots, 2, model.n, dwells.slots, 2, q))
        at = (slice(None), dwells.dwell, dwells.slot)
        H[(*at, slice(None), slice(None), dwells.slot)] = np.moveaxis(_real_blocks(linear), 1, 0)
        H += self._mixed(p[:, model.nonlinear], span[model.nonlinear])
        spread = np.zeros((len(s.covariance), R, dwells.slots, 2, q, 2, q))
        spread[at] = _real_blocks(s.covariance / 2)
        size = dwells.slots * 2 * model.n
        of_lines = H.reshape(K, R, size, dwells.slots, 2 * q)
        carried = np.einsum("kratx,krtxy->kraty", of_lines, spread.reshape(*spread.shape[:3], 2 * q, 2 * q))
        C: Real = carried.reshape(K, R, size, -1) @ np.swapaxes(H.reshape(K, R, size, -1), -1, -2)
        empty = np.ones((R, dwells.slots), dtype=bool)
        empty[dwells.dwell, dwells.slot] = False
        return C + np.repeat(empty, 2 * model.n, axis=1)[..., None] * np.eye(size)

    def _mixed(self, p: Real, span: Real) -> Real:
        """What nonlinear elements carry from the noise of one line to the rows of another; p (K, e), span (e, q)."""
        model, dwells, elongations = self.motion.model, self.motion.dwells, self.motion.elongations
        K, R, e, W = elongations.shape
        rows = np.broadcast_to(self.constants, (K * R, len(self.constants)))
        omega, times = np.tile(dwells.omega, K), samples_of(model, dwells.orders)
        slope = alternate(model, rows, omega, elongations.reshape(K * R, e, W), times).slope.reshape(
            K, R, e, W, W
        )
        picked = np.zeros((R, 2 * dwells.slots, W))
        for part in (0, 1):
            picked[dwells.dwell, 2 * dwells.slot + part, 2 * dwells.order - 1 + part] = 1.0
        between = picked[:, None] @ slope @ np.swapaxes(picked, -1, -2)[:, None]
        parts = between.reshape(K, R, e, dwells.slots, 2, dwells.slots, 2)
        return np.einsum(
            "ke,ei,krescfd,ej->krscifdj", p, model.B[model.nonlinear], parts, span, optimize=True
        )

    @staticmethod
    def variance(noise: Real) -> Real:
        """Mean variance of a row, (K,)."""
        return np.mean(np.diagonal(noise, axis1=-2, axis2=-1), axis=(-2, -1))

    def weighted(self) -> tuple[Real, Real]:
        """θ (K, m) weighted by the inverse covariance of the rows at least squares, and its covariance (K, m, m)."""
        Phi, h = self.regression(self.motion.unit_forces(self.constants))
        weight = scaled_inverse(self.noise(self.least_squares()))
        model = self.motion.model
        bread = np.einsum("krau,kruv->krav", weight, Phi)
        N = np.einsum("krau,krav->kuv", bread, Phi) + np.diag(model.prior_precision)
        right = np.einsum("krau,kra->ku", bread, h) + model.prior_precision * model.prior_mean
        return solve_scaled(N, right), scaled_inverse(N)

    def completed(self, theta: Real) -> tuple[Complex, HarmonicEquations]:
        """Unit forces of the model's own motion at θ (K, m), and the equations with its harmonics where unmeasured."""
        model, dwells, elongations = self.motion.model, self.motion.dwells, self.motion.elongations
        K, R = elongations.shape[:2]
        p = np.repeat(model.parameters(theta), R, axis=0)
        constants = np.broadcast_to(self.constants, (K * R, len(self.constants)))
        drive = dwells.drive(np.concatenate([self.states.U, self.states.f], axis=-1), self.states.r)
        start = elongations.reshape(K * R, *elongations.shape[2:])
        at = periodic_response(model, p, constants, drive, start)
        seen = np.zeros((R, elongations.shape[-1]), dtype=bool)
        for part in (0, 1):
            seen[dwells.dwell, 2 * dwells.order - 1 + part] = True
        filled = np.where(seen[:, None], elongations, at.delta.reshape(elongations.shape))
        whole = replace(self, motion=replace(self.motion, elongations=filled))
        return dwells.lines(harmonic_unit_forces(model, drive, at), K), whole

    def with_instruments(self, theta: Real) -> Real:
        """θ with the model's own motion at `theta` as instruments, (K, m)."""
        a, whole = self.completed(theta)
        Phi, h = whole.regression(whole.motion.unit_forces(self.constants))
        return whole.solved(whole.regression(a)[0], Phi, h, theta)

    def spread(self, theta: Real, *, instruments: bool) -> Real:
        """Covariance that the noise gives an equally weighted θ, (K, unknowns, unknowns)."""
        a, whole = self.completed(theta) if instruments else (self.motion.unit_forces(self.constants), self)
        left = whole.regression(a)[0]
        Phi = whole.regression(whole.motion.unit_forces(self.constants))[0]
        C, precision = whole.noise(theta), np.diag(self.motion.model.prior_precision)
        variance = self.variance(C)[:, None, None]
        meat = np.einsum("krau,krab,krbv->kuv", left, C, left, optimize=True) + variance**2 * precision
        half = scaled_inverse(np.einsum("krau,krav->kuv", left, Phi) + variance * precision)
        return half @ meat @ np.swapaxes(half, -1, -2)


def _real_blocks(blocks: Complex) -> Real:
    """Complex matrices (..., rows, columns) as those of real and imaginary parts, (..., 2, rows, 2, columns)."""
    real = np.stack([blocks.real, -blocks.imag], axis=-2)
    turned = np.stack([blocks.imag, blocks.real], axis=-2)
    return np.stack([real, turned], axis=-4)


def require_direct(data: Prepared) -> None:
    """Raises UsageError if a channel shows more than calibrated motions, DataError if not all is seen."""
    for channel, direct in zip(data.spectrum.channels, data.view.is_direct, strict=True):
        if not direct:
            raise UsageError(
                f"channel {channel.name} measures a force in elements or has an unknown calibration, "
                "which this method does not support for a nonlinear rig",
                cure="use the method ml",
            )
    _ = data.seen_states


def harmonic_equations(data: Prepared) -> HarmonicEquations:
    """The equations of prepared data.

    Raises UsageError if an inner constant or a calibration is unknown, DataError if a coordinate is not seen.
    """
    require_known_constants(data.model)
    require_direct(data)
    return HarmonicEquations(measured_motion(data), data.seen_states)
