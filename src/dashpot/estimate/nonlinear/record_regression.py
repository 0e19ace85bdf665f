"""First values of a nonlinear rig from a whole record whose coordinates are all measured: the equation's weak form.

∫ w (M ẍ + C ẋ + K x + Bᵀ p∘a) dt = ∫ w f dt for smooth windows w that vanish at their ends: the derivatives of masses
and dampers are moved to w, so the measured motion is not differentiated but for laws of the rate (Shinbrot 1957).
Noise of the motion is in the columns too, so that least squares are biased: they begin a fit in which the motion is
corrected until the equations hold (errors in variables; Bortz, Messenger and Dukic 2023, Bull. Math. Biol. 85, 110).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from dashpot.arrays import Bools, Ints, Real
from dashpot.data.noise import white_floor, without_leakage
from dashpot.data.spectrum import LinesInTime
from dashpot.errors import DataError
from dashpot.estimate.inference.diagnostics import require_traces
from dashpot.estimate.nonlinear.record_problem import bounds_near, known_inputs, least_cost
from dashpot.estimate.nonlinear.records import RecordData, RecordedMotion, recorded_motion
from dashpot.estimate.nonlinear.regression import require_finite_laws
from dashpot.estimate.nonlinear.search import KEPT, constants_to_try, theta_of
from dashpot.estimate.preparation import States
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states, rated_states
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel
from dashpot.numerics.small_systems import solve_scaled

FAR = 10.0  # times the largest elongation: states that go there do not settle
EXACT = 1e-9  # of the variance of an equation: rounding
INEXACT = 3e-4  # of the rms of a signal: what samples and windows tell wrongly where there is no noise


@dataclass(frozen=True)
class WeakForm:
    """Weak equations of one record: elongations and rates (samples, elements), windows and their derivatives.

    balance (equations, elements): what the forces in elements add up to, f (samples, equations): on every coordinate
    what force inputs apply, then in every calibrated channel of the force in elements what it shows; still
    (equations,): where a constant of f is unknown.
    """

    model: Model
    step_s: float
    elongation: Real
    rate: Real
    balance: Real
    f: Real
    still: Bools
    windows: tuple[Real, Real, Real]
    first: Ints

    def unit_forces(self, constants: Real) -> Real:
        """Unit forces of the nonlinear elements in the measured motion, (samples, e), for constants (G,)."""
        unit = np.empty_like(self.elongation[:, self.model.nonlinear])
        for row, inner in enumerate(self.model.constant_slices):
            unit[:, row] = self.unit_force(row, constants[inner])
        return unit

    def unit_force(self, row: int, g: Real) -> Real:
        """That of one nonlinear element, (samples,), for the constants (g,) of its law; no number beyond the motion."""
        law, index = self.model.laws[row], int(self.model.nonlinear[row])
        d, v = self.elongation[:, index], self.rate[:, index]
        z = d
        if law.operator:
            z = operated_states(law, d, g)
        elif law.rate is not None:
            try:
                z = rated_states(law, d, v, self.step_s, g)
            except (ValueError, np.linalg.LinAlgError):  # no number
                z = np.full_like(d, np.nan)
            z = np.where(np.abs(z) < FAR * np.max(np.abs(d)), z, np.nan)
        unit: Real = law(d, v, z, g).value
        return unit

    def constants_to_try(self) -> list[Real]:
        """Constants (G,) of all laws that may be near the true ones, by the largest elongations and speeds."""
        motions = (self.elongation[:, self.model.nonlinear], self.rate[:, self.model.nonlinear])
        elongation, speed = (np.max(np.abs(motion), axis=0) for motion in motions)
        return constants_to_try(self.model, elongation, speed, reciprocal=True)

    def information(self, constants: Real) -> Real:
        """Normal equations of all unknown parameters with their forces as they are in time, (unknowns, unknowns).

        In time, unlike in weak form, equal laws give equal columns, whatever the noise.
        """
        from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

        model = self.model
        time = self.step_s * np.arange(len(self.elongation))
        rates = [self.elongation, self.rate, CubicSpline(time, self.rate, axis=0)(time, 1)]
        unit = np.stack([rates[element.law.power][:, i] for i, element in enumerate(model.elements)], axis=1)
        unit[:, model.nonlinear] = self.unit_forces(constants)
        columns = ((unit[:, None, :] * self.balance) @ model.T).reshape(-1, model.T.shape[1])
        size = np.sqrt(np.sum(columns**2, axis=0))
        scaled = columns / np.where(size > 0, size, 1.0)
        return scaled.T @ scaled

    def of(self, signal: Real, derivative: int) -> Real:
        """∫ w s^(derivative) of signals (samples, k), by parts; (windows, k)."""
        return self.in_pieces(signal, derivative).reshape(-1, signal.shape[1])

    def in_pieces(self, signal: Real, derivative: int) -> Real:
        """The same, (pieces, windows, k)."""
        w = self.windows[derivative] * (-1.0) ** derivative
        length = w.shape[1]
        pieces = np.stack([signal[k : k + length] for k in self.first.tolist()])
        return np.einsum("wt,ptk->pwk", w, pieces)


def weak_form(model: Model, data: RecordData, at: RecordedMotion) -> WeakForm:
    """Of a record whose coordinates are all measured."""
    r = model.D.shape[1] - len(data.bases.names)
    shown = [c for c in range(len(data.names)) if data.gain[c] < 0 and np.any(data.force[c])]
    balance = np.concatenate([model.B.T, data.force[shown][:, : len(model.elements)]])
    f = np.hstack([data.inputs[:, r : r + len(model.force_inputs)] @ model.S.T, data.outputs[:, shown]])
    still = np.append(np.any(model.S, axis=1), np.array(data.drift, dtype=bool)[shown])
    return _weak_form(model, data.step_s, at.x @ model.B.T + at.u @ model.D.T, balance, f, still)


def _weak_form(model: Model, step_s: float, d: Real, balance: Real, f: Real, still: Bools) -> WeakForm:
    """Of elongations d (samples, elements)."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    time = step_s * np.arange(len(d))
    rate = CubicSpline(time, d, axis=0)(time, 1)
    length = min(64, len(d))  # samples of a window; each half overlaps the next
    s = np.linspace(0, 1, length)
    span = step_s * (length - 1)
    # sin⁴(π s) times a cosine or a sine of 0 to 6 cycles, which chooses a part of the band: sums of waves, whose
    # derivatives are exact
    cycles, own = np.arange(7)[:, None], np.array([1, -4, 6, -4, 1]) / 16
    waves = 2j * np.pi * (cycles + np.arange(-2, 3))
    both = [
        np.einsum("cj,cjt->ct", own * (waves / span) ** k, np.exp(waves[..., None] * s)) for k in range(3)
    ]
    windows = tuple(np.concatenate([each.real, each.imag[1:]]) for each in both)
    first = np.arange(0, len(d) - length + 1, max(length // 2, 1))
    form = (model, step_s, d, rate, balance, f, still)
    return WeakForm(*form, (windows[0], windows[1], windows[2]), first)


@dataclass(frozen=True)
class UnitForces:
    """Weak unit forces, columns (pieces, windows, elements), and how they grow with the elongation and its derivatives.

    slopes (3, elements); of laws by least squares over the motion (Booton 1954; Caughey 1963).
    """

    columns: Real
    slopes: Real

    def without(self, noise: Real) -> Real:
        """Less what noise of elongations makes, (3, pieces, windows, elements) in the windows and their derivatives."""
        return self.columns - np.einsum("ka,kpwa->pwa", self.slopes, noise)


@dataclass(frozen=True)
class WeakEquations:
    """Σ A θ = b of the pieces of a record, (pieces, equations, windows), whose columns are noisy like the motion.

    form: of the measured motion; smooth: of the motion less what of it is noise, for the laws.  columns (pieces,
    windows, elements): weak unit forces of the linear elements; right (pieces, windows, equations): of f; noise
    (elements + equations, the same): covariance of white noise in a sample of the elongations and of f.
    products (3, 3, windows, windows): of the windows and their derivatives.  free: which θ are parameters.
    whitener (equations · windows, the same): what makes the noise of the equations of a piece white; error likewise:
    covariance of what they are off by apart from that noise.
    """

    form: WeakForm
    smooth: WeakForm
    columns: Real
    right: Real
    noise: Real
    products: Real
    free: Bools
    whitener: Real
    error: Real | float = 0.0

    def fitted(self, constants: Real) -> tuple[Real, float]:
        """(unknown parameters and constant forces, squared residual) of least squares at inner constants (G,).

        The residual is not measured by the size of the terms: they cancel where constants are far off.
        """
        A, b = self._whitened(constants)
        theta = solve_scaled(A.T @ A, A.T @ b)
        left = b - A @ theta
        return theta, float(left @ left)

    def without_laws(self, constants: Real) -> tuple[Real, float]:
        """(unknown parameters, squared residual) without the nonlinear elements, whose forces are then 1 %."""
        model = self.form.model
        A, b = self._whitened(constants)
        nonlinear = np.flatnonzero(np.any(model.T[model.nonlinear], axis=0)[self.free])
        rest = np.delete(np.arange(A.shape[1]), nonlinear)
        theta = np.zeros(A.shape[1])
        theta[rest] = solve_scaled(A[:, rest].T @ A[:, rest], A[:, rest].T @ b)
        left = b - A @ theta
        size = np.sqrt(np.sum(A[:, nonlinear] ** 2, axis=0))
        theta[nonlinear] = 0.01 * np.sqrt(b @ b) / np.where(size > 0, size, 1.0)
        return theta[: int(np.sum(self.free))], float(left @ left)

    def whitened_at(self, theta: Real) -> WeakEquations:
        """The same, weighed by the noise that they have at θ (unknowns,)."""
        model = self.form.model
        unit = self._unit(model.inner_constants(theta))
        return replace(self, whitener=self._whitener_at(model.parameters(theta), unit))

    def erring(self, share: float) -> WeakEquations:
        """The same with an error of the equations themselves, whose variance is a share of what they are weighed by."""
        root = np.linalg.inv(self.whitener)
        return replace(self, error=share * root @ root.T)

    def with_noisy_columns(self, psi: Real) -> OptimizeResult:
        """The likeliest θ and constant forces, ψ (unknowns + forces,), from a start: the motion's noise is in A too.

        With e = b − A θ and its covariance C(θ), eᵀ C⁻¹ e is what the motion must be corrected by; along θ it falls
        as A does that is made of the motion corrected (Gauss and Newton; Britt and Luecke 1973).
        """
        model = self.form.model
        lower, upper = bounds_near(model, psi[: len(model.unknowns)])
        stated = model.prior_precision > 0
        lower, upper = np.where(stated, model.prior_mean, lower), np.where(stated, model.prior_mean, upper)
        open_ = np.full(len(psi) - len(lower), np.inf)
        limits = np.append(lower, -open_), np.append(upper, open_)
        return least_cost(model, lambda x: self._quadratic(x[0]), psi, limits, 60, 0.01)

    def _quadratic(self, psi: Real) -> QuadraticModel:
        model, form = self.form.model, self.form
        theta, forces = np.split(psi, [len(model.unknowns)])
        p, constants = model.parameters(theta), model.inner_constants(theta)
        shape = (len(form.first), len(form.balance) * len(form.windows[0]))
        constant = self._constant_forces()
        unit = self._unit(constants)
        try:
            inverse = self._whitener_at(p, unit)
        except np.linalg.LinAlgError:  # no number
            nothing = np.full((1, len(psi), len(psi)), np.nan)
            return QuadraticModel(np.array([np.inf]), nothing[..., 0], nothing, nothing)
        e = self.right - (unit.columns * p) @ form.balance.T
        e = np.swapaxes(e, 1, 2).reshape(shape) - constant @ forces
        white = e @ inverse.T
        score = (white @ inverse).reshape(shape[0], len(form.balance), -1)
        # The noise of elongations that the equations tell, Cov(d, e) C⁻¹ e, in the windows and their derivatives
        shared = np.einsum("ab,ljb->laj", self.noise[: len(p)], self._carried(p, unit))
        told = np.einsum("laj,klwv,pjv->kpwa", shared, self.products, score, optimize=True)
        true = unit.without(told)
        along = true[..., None] * model.T
        slope = model.constants_map[0]
        for u in np.flatnonzero(np.any(slope, axis=0)).tolist():
            step = 1e-4 * max(abs(theta[u]), 1e-9)
            along[..., u] += (self._unit(constants + step * slope[:, u]).without(told) - true) / step * p
        A = np.einsum("pwiu,ji->pjwu", along, form.balance).reshape(*shape, -1)
        A = np.concatenate([A, np.broadcast_to(constant, (len(A), *constant.shape))], axis=-1)
        J = np.einsum("ab,pbu->pau", inverse, A)
        matrix = np.tensordot(J, J, axes=([0, 1], [0, 1]))[None]
        gradient = np.einsum("pau,pa->u", J, white)[None]
        return QuadraticModel(np.array([np.sum(white**2)]), gradient, matrix, matrix)

    @cached_property
    def derivatives(self) -> Real:
        """1 where a linear element is proportional to that derivative of its elongation, (3, elements)."""
        elements = self.form.model.elements
        return np.array(
            [[1.0 * (e.force_law is None and e.law.power == k) for e in elements] for k in range(3)]
        )

    def _unit(self, constants: Real) -> UnitForces:
        """Of all elements, at inner constants (G,) of the laws."""
        model, smooth = self.form.model, self.smooth
        columns, slopes = self.columns.copy(), self.derivatives.copy()
        forces = smooth.unit_forces(constants)
        columns[..., model.nonlinear] = smooth.in_pieces(forces, 0)
        for force, i in zip(forces.T, model.nonlinear.tolist(), strict=True):
            motion = np.stack([smooth.elongation[:, i], smooth.rate[:, i]], axis=1)
            slopes[:2, i] = solve_scaled(motion.T @ motion, motion.T @ force)
        return UnitForces(columns, slopes)

    def _carried(self, p: Real, unit: UnitForces) -> Real:
        """What of elongations and f each derivative brings into the equations, (3, equations, elements + equations)."""
        balance = self.form.balance
        of_f = np.zeros((3, len(balance), len(balance)))
        of_f[0] = np.eye(len(balance))
        return np.concatenate([-(p * unit.slopes)[:, None, :] * balance, of_f], axis=2)

    def _whitener_at(self, p: Real, unit: UnitForces) -> Real:
        """What makes the noise of the equations of a piece white at parameters p, (equations · windows, the same)."""
        carried = self._carried(p, unit)
        between = np.einsum("kia,ab,ljb->klij", carried, self.noise, carried)
        size = len(carried[0]) * len(self.products[0, 0])
        C = np.einsum("klij,klwv->iwjv", between, self.products).reshape(size, size)
        rounding = np.diag(np.full(size, EXACT * np.mean(np.diagonal(C))))
        whitener: Real = np.linalg.inv(np.linalg.cholesky(C + self.error + rounding))
        return whitener

    def _constant_forces(self) -> Real:
        """(equations · windows, constants of f that are unknown)."""
        form = self.form
        constant = np.sum(form.windows[0], axis=1)
        return np.kron(np.eye(len(form.still))[:, form.still], constant[:, None])

    def _whitened(self, constants: Real) -> tuple[Real, Real]:
        """A and b at given inner constants (G,), all equations one below the other."""
        model, balance = self.form.model, self.form.balance
        columns = self._unit(constants).columns
        b = np.swapaxes(self.right - (columns * model.p0) @ balance.T, 1, 2).reshape(len(columns), -1)
        A = np.einsum("pwi,ji,iu->pjwu", columns, balance, model.T[:, self.free]).reshape(*b.shape, -1)
        forces = self._constant_forces()
        A = np.concatenate([A, np.broadcast_to(forces, (len(A), *forces.shape))], axis=-1)
        return (self.whitener @ A).reshape(-1, A.shape[-1]), (b @ self.whitener.T).ravel()


def weak_equations(model: Model, data: RecordData, at: RecordedMotion) -> WeakEquations:
    """Of a record whose coordinates are all measured, weighed as if all linear elements pulled alike."""
    form = weak_form(model, data, at)
    motion = np.hstack([at.x, at.u])
    x, u = np.split(known_inputs(motion, np.sqrt(_white_noise(motion))).mean, [model.n], axis=1)
    smooth = weak_form(model, data, replace(at, x=x, u=u))
    stretched = np.hstack([model.B, model.D])
    noise = block_diag((stretched * _errors(motion)) @ stretched.T, np.diag(_errors(form.f)))
    return _weighed(form, smooth, noise)


def decay_start(model: Model, states: States, at: LinesInTime) -> Real:
    """Unknowns (unknowns,) of a linear rig that moves freely, from the lines of one record.

    In windows of some samples its modes are wide, and what is searched has one valley where the likelihood of the whole
    record has one for each line.  The ends, which some lines alone do not show, are left out, and so is the mean.
    """
    cut = at.samples // 50
    x = at.history(states.X[0])[cut : at.samples - cut]
    noise = np.mean(states.covariance[0][at.lines, : model.n, : model.n].real, axis=0) * at.samples / 4
    noise += np.diag(np.mean((INEXACT * x) ** 2, axis=0))
    equations = (model.B.T, np.zeros_like(x), np.ones(model.n, dtype=bool))
    form = _weak_form(model, at.step_s, x @ model.B.T, *equations)
    noise = block_diag(model.B @ noise @ model.B.T, np.zeros((model.n, model.n)))
    return _valleys(_weighed(form, form, noise))[0]


def _weighed(form: WeakForm, smooth: WeakForm, noise: Real) -> WeakEquations:
    """Weighed as if all linear elements pulled alike; noise as `WeakEquations` has it."""
    model = form.model
    columns = np.zeros((len(form.first), len(form.windows[0]), len(model.elements)))
    for i, element in enumerate(model.elements):
        if element.force_law is None:
            columns[..., i] = form.in_pieces(form.elongation[:, i : i + 1], element.law.power)[..., 0]
    signed = np.stack([(-1.0) ** k * w for k, w in enumerate(form.windows)])
    products = np.einsum("kwt,lvt->klwv", signed, signed)
    right, free = form.in_pieces(form.f, 0), np.any(model.T, axis=0)
    equations = WeakEquations(form, smooth, columns, right, noise, products, free, np.eye(1))
    # Before anything is known all linear elements pull alike, and no two noises cancel.
    size = np.sqrt(np.mean(columns**2, axis=(0, 1)))
    p = np.array([1.0 if e.law.power < 2 else -1.0 for e in model.elements]) / np.where(
        size > 0, size, np.inf
    )
    return replace(equations, whitener=equations._whitener_at(p, UnitForces(columns, equations.derivatives)))


def _white_noise(signals: Real) -> Real:
    """Variance of white noise in the samples of signals (samples, k), as far as the top of the band shows it, (k,)."""
    power = without_leakage(np.fft.rfft(signals, axis=0)) / len(signals)
    return np.array([white_floor(each) for each in power.T])


def _errors(signals: Real) -> Real:
    """Variance of what signals (samples, k) are off by, (k,): noise, and what samples and windows tell wrongly."""
    return _white_noise(signals) + np.mean((INEXACT * signals) ** 2, axis=0)


def first_record_values(model: Model, records: tuple[RecordData, ...]) -> Real:
    """The first of the `valley_starts`, (unknowns,), with the same errors."""
    return valley_starts(model, records)[0]


def valley_starts(model: Model, records: tuple[RecordData, ...]) -> list[Real]:
    """Guesses where all are given; else valleys of the weak form of the equation where all coordinates are measured.

    (unknowns,) each, the deepest first.  Raises DataError if the motion does not determine them or a law is no number
    in it, IdentifiabilityError if laws leave no trace in it or cannot be told apart.
    """
    given = [u.prior if u.prior is not None else u.guess for u in model.unknowns]
    open_names = [u.name for u, value in zip(model.unknowns, given, strict=True) if value is None]
    if not open_names:
        return [np.array(given, dtype=float)]
    equations = _equations(model, records[0], open_names)
    require_finite_laws(
        model, equations.form.elongation.T[model.nonlinear], equations.form.rate.T[model.nonlinear]
    )
    valleys = _valleys(equations)
    free = equations.free
    information = equations.form.information(model.inner_constants(valleys[0]))[np.ix_(free, free)]
    information += np.diag(1.0 * (model.prior_precision[free] > 0))
    names = [name for name, there in zip(model.unknown_names, free, strict=True) if there]
    # A combination of columns of size 1 whose singular value is below 1e-6 leaves no trace in the motion.
    require_traces(model, names, information, 1e-6**2)
    starts = [theta for theta in valleys if np.all(np.isfinite(theta))]
    if not starts:
        raise DataError(
            "the motion does not determine the unknowns",
            records[0].source,
            "give initial guesses in the rig file",
        )
    return starts


def mostly_linear_values(model: Model, records: tuple[RecordData, ...]) -> Real | None:
    """As `first_record_values`, with nonlinear forces that are a small share of the others, (unknowns,).

    None where guesses are given, not all coordinates are measured, or the laws explain more than noise would.
    """
    open_names = [u.name for u in model.unknowns if u.prior is None and u.guess is None]
    if not open_names or recorded_motion(model, records[0]) is None:
        return None
    equations = _equations(model, records[0], open_names)
    theta = _valleys(equations)[0]
    constants = model.inner_constants(theta)
    equations = equations.whitened_at(theta)
    p, left = equations.without_laws(constants)
    explained = equations.fitted(constants)[1] < 0.9 * left  # laws that show explain a tenth at least
    return None if explained or not np.all(np.isfinite(p)) else theta_of(model, constants, p)


def _equations(model: Model, record: RecordData, open_names: Sequence[str]) -> WeakEquations:
    """Raises DataError if the motion of the coordinates does not give first values of the unknowns."""
    at = recorded_motion(model, record)
    if at is None:
        raise DataError(
            f"{', '.join(open_names)} {'has' if len(open_names) == 1 else 'have'} no initial guess, and "
            "not all coordinates are measured as displacements",
            cure="write guess = … for the unknowns in the rig file",
        )
    return weak_equations(model, record, at)


def _valleys(equations: WeakEquations) -> list[Real]:
    """Unknowns (unknowns,) of the least residual in each valley near the best of a grid, the deepest first.

    Noise in the columns fills valleys of least squares and moves them; 1.5 times the least is none.
    """
    model, grid = equations.form.model, equations.form.constants_to_try()

    def best(equations: WeakEquations) -> list[tuple[Real, float]]:
        """Where the best of the grid lead to, and what they leave."""

        def residual(constants: Real) -> float:
            p, left = equations.fitted(constants)
            return left if np.all(np.isfinite(p)) else np.inf

        found = []
        for constants in sorted(grid, key=residual)[:KEPT]:
            (p, left), free = equations.fitted(constants), int(np.sum(equations.free))
            psi = np.append(theta_of(model, constants, p[:free]), p[free:])
            # What constants of the grid leave is no noise of the motion, which would follow it into large parameters.
            psi = equations.erring(left / equations.right.size).with_noisy_columns(psi).x[0]
            end = equations.with_noisy_columns(psi)
            found.append((end.x[0][: len(model.unknowns)], float(end.cost[0])))
        return found

    ends = best(equations)
    theta, cost = min(ends, key=lambda end: end[1])
    if np.isfinite(cost):
        ends += best(equations.whitened_at(theta))
    left = np.array([cost for _, cost in ends])
    valleys: list[Real] = []
    for k in np.argsort(left, kind="stable"):
        apart = all(np.any(np.abs(ends[k][0] - other) > 0.1 * np.abs(other)) for other in valleys)
        if not valleys or (apart and left[k] < 1.5 * np.min(left) and len(valleys) < KEPT):
            valleys.append(ends[k][0])
    return valleys
