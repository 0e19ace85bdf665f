"""Parameters from measured modes: the search among rigs for those that have them, and the estimate it ends in."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real, hermitian, zeros_for_nan
from dashpot.data.modal_data import ModalData
from dashpot.data.noise import LEVEL
from dashpot.errors import ConvergenceError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.inference.diagnostics import held, require_determined, wrong_signs
from dashpot.estimate.inference.uncertainty import mode_values, with_uncertainty
from dashpot.estimate.likelihood.global_search import COMPETING, DOUBT, TIE, guessed, rival_notice
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.result import MISFIT, SENSOR_NOISE, Estimate, Fit, ModeValues, estimate_of
from dashpot.io.words import with_values
from dashpot.model.dynamics import no_steady_response
from dashpot.model.elements import Kind
from dashpot.model.matrix_elements import free_names
from dashpot.model.modes import Modes, eigenpairs, eigenpairs_of, mode_sensitivities, sensitivities_of
from dashpot.model.network import Model
from dashpot.model.reduced import ModalRig, extended_basis, lowest_shapes, mode_motions
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise, without_bounds
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled

# Measured modes as a fit needs them, and which of the model's modes each of them is.


@dataclass(frozen=True)
class ModeProblem:
    """χ² of the modes of a rig against K sets of measured ones (THEORY §4).

    data: with one leading axis of repeats; damping (modes,), present (modes, points): whether measured; eigen (modes,
    2, 2): whitens (frequency, damping); shape (modes, points, points): whitens a shape, rows and columns of absent
    points 0; look (points, n) picks these; rows: real numbers that were measured; span: the few motions of a large
    rig that stand for all, on which shapes and `look` are then
    """

    model: Model
    data: ModalData
    damping: Bools
    present: Bools
    eigen: Real
    shape: Complex
    look: Real
    rows: int
    span: ModalRig | None = None

    @staticmethod
    def of(model: Model, data: ModalData) -> ModeProblem:
        """What is measured of each mode, and its whitening.  Raises DataError if some uncertainty is missing."""
        repeats = int(np.prod(data.frequency_hz.shape[:-1], dtype=int))
        data = replace(
            data,
            frequency_hz=data.frequency_hz.reshape(repeats, data.modes),
            damping_ratio=data.damping_ratio.reshape(repeats, data.modes),
            shapes=data.shapes.reshape(repeats, data.modes, len(data.points)),
        )
        damping = np.all(np.isfinite(data.damping_ratio), axis=0)
        present = np.all(np.isfinite(data.shapes), axis=0)
        eigen = np.zeros((data.modes, 2, 2))
        shape = np.zeros((data.modes, len(data.points), len(data.points)), dtype=complex)
        rows = 0
        for k in range(data.modes):
            count = 2 if damping[k] else 1
            of_eigen = data.covariance[k, :count, :count]
            eigen[k, :count, :count] = _whitening(of_eigen, f"frequency of mode {k + 1}").real
            at = np.flatnonzero(present[k])
            if len(at) > 1:
                V = data.shape_covariance[k][np.ix_(at, at)]
                variance = np.diagonal(V).real
                # Exact points of a shape have a millionth of the largest standard deviation of the others.
                floor = np.where(variance == 0, 1e-6**2 * np.max(variance), 0.0)
                shape[k][np.ix_(at, at)] = _whitening(V + np.diag(floor), f"shape of mode {k + 1}")
                rows += 2 * len(at) - 2
            rows += count
        look = np.array([[float(name == x) for x in model.coordinates] for name in data.points])
        look = look.reshape(len(data.points), model.n)
        return ModeProblem(model, data, damping, present, eigen, shape, look, rows)

    def on(self, V: Real) -> ModeProblem:
        """That of the rig on the span of V (n, k), for a problem of the whole rig."""
        return replace(self, look=self.look @ V, span=ModalRig.of(self.model, V))

    def eigenpairs(self, theta: Real) -> tuple[Complex, Complex]:
        """Eigenvalues (K, …) and shapes at θ (K, unknowns), as `model.modes.eigenpairs`."""
        if self.span is None:
            return eigenpairs(self.model, self.model.parameters(theta))
        return eigenpairs_of(self.span.matrices(theta))

    def sensitivities(self, theta: Real, values: Complex, shapes: Complex) -> tuple[Complex, Complex]:
        """∂λ and ∂φ by the unknowns, as `model.modes.mode_sensitivities`."""
        if self.span is None:
            return mode_sensitivities(self.model, self.model.parameters(theta), values, shapes, self.model.T)
        return sensitivities_of(self.span.matrices(theta), self.span.forces(values, shapes), values, shapes)

    @property
    def repeats(self) -> int:
        """K."""
        return len(self.data.frequency_hz)

    @property
    def dof(self) -> int:
        """Degrees of freedom of χ² of a fit, priors counting as data."""
        return self.rows - len(self.model.unknowns) + int(np.count_nonzero(self.model.prior_precision))

    def pair(self, values: Complex, shapes: Complex, rows: Ints | slice = slice(None)) -> Ints:
        """Which of the model's modes each measured one of some repeats is, (K, modes); −1 where there is none.

        The pairs that make Σ (1 − MAC) + |ln (f / f_measured)| least, each mode used once (Hungarian method).
        """
        swings = np.isfinite(values) & (values.imag > 1e-9 * np.abs(zeros_for_nan(values)))
        f = np.where(swings, np.abs(zeros_for_nan(values)), 1.0) / (2 * np.pi)
        cost = np.abs(np.log(f[:, None, :] / self.data.frequency_hz[rows][:, :, None]))
        several = np.sum(self.present, axis=-1) > 1
        if np.any(several):
            seen = zeros_for_nan(shapes) @ self.look.T
            measured = np.where(self.present, zeros_for_nan(self.data.shapes[rows]), 0.0)
            there = self.present.astype(float)
            across = np.abs(np.einsum("kmp,kjp->kmj", np.conj(measured), seen)) ** 2
            size = np.sum(np.abs(measured) ** 2, axis=-1)
            theirs = np.einsum("mp,kjp->kmj", there, np.abs(seen) ** 2)
            with np.errstate(invalid="ignore", divide="ignore"):
                mac = across / (size[:, :, None] * theirs)
            cost = cost + np.where(several[:, None], 1 - zeros_for_nan(mac), 0.0)
        cost = np.where(swings[:, None, :], cost, 1e6)
        chosen = np.empty(cost.shape[:2], dtype=np.int64)
        for k, table in enumerate(cost):
            from scipy.optimize import linear_sum_assignment  # which takes long to load

            of_mode, columns = linear_sum_assignment(table)
            chosen[k, of_mode] = np.where(table[of_mode, columns] < 1e6, columns, -1)
        return chosen

    def evaluate(self, theta: Real, rows: Ints) -> QuadraticModel:
        """χ² with the priors, its slope and its curvature for `theta` (k, unknowns) of the repeats `rows`."""
        model, data = self.model, self.data
        with np.errstate(all="ignore"):
            values, shapes = self.eigenpairs(theta)
            chosen = self.pair(values, shapes, rows)
            lost = np.any(chosen < 0, axis=-1)
            at = np.maximum(chosen, 0)
            lam = np.take_along_axis(values, at, axis=-1)
            phi = np.take_along_axis(shapes, at[..., None], axis=-2)
            dlam, dphi = self.sensitivities(theta, lam, phi)
            # Whitened slopes (K, modes, 2, unknowns) and residuals (K, modes, 2) of frequency and damping ratio
            size = np.abs(lam)
            grow = (np.conj(lam)[..., None] * dlam).real / size[..., None]
            more = -dlam.real / size[..., None] + lam.real[..., None] * grow / size[..., None] ** 2
            J = self.eigen @ np.stack([grow / (2 * np.pi), more], axis=-2)
            damping = np.where(self.damping, data.damping_ratio[rows], 0.0)
            predicted = np.where(self.damping, -lam.real / size, 0.0)
            r = np.stack([data.frequency_hz[rows] - size / (2 * np.pi), damping - predicted], axis=-1)
            r = (self.eigen @ r[..., None])[..., 0]
            # Those of shapes, (K, modes, points, …). With a = φ at the measured points the scale s = aᴴV⁻¹φ_m / aᴴV⁻¹a
            # leaves the residual orthogonal to a; what it can do is taken out of the slopes.
            seen = (self.shape @ (phi @ self.look.T)[..., None])[..., 0]
            shown = np.where(self.present, zeros_for_nan(data.shapes[rows]), 0.0)
            measured = (self.shape @ shown[..., None])[..., 0]
            power = np.sum(np.abs(seen) ** 2, axis=-1, keepdims=True)
            power = np.where(power > 0, power, 1.0)
            scale = np.sum(np.conj(seen) * measured, axis=-1, keepdims=True) / power
            slope = self.shape @ (self.look @ dphi) * scale[..., None]
            along = np.sum(np.conj(seen)[..., None] * slope, axis=-2, keepdims=True) / power[..., None]
            Js, rs = slope - seen[..., None] * along, measured - scale * seen
        away, precision = theta - model.prior_mean, model.prior_precision
        cost = np.sum(r**2, axis=(-1, -2)) + 2 * np.sum(np.abs(rs) ** 2, axis=(-1, -2))
        cost = np.where(lost, np.inf, cost) + np.sum(precision * away**2, axis=-1)
        gradient = np.einsum("kmiu,kmi->ku", J, r) + 2 * np.einsum("kmpu,kmp->ku", np.conj(Js), rs).real
        m = len(model.unknowns)
        real, turned = J.reshape(len(theta), -1, m), Js.reshape(len(theta), -1, m)
        symmetric = np.swapaxes(real, -1, -2) @ real + 2 * (hermitian(turned) @ turned).real
        symmetric = symmetric + np.diag(precision)
        return QuadraticModel(cost, gradient - precision * away, symmetric, symmetric)

    def predicted(self, theta: Real) -> tuple[Complex, Real, Real]:
        """Shapes (modes, points), frequencies (Hz) and damping ratios of the rig at θ (unknowns,), of the one repeat.

        NaN where the rig has no such mode; shapes have the scale that suits the points that were measured.
        """
        values, shapes = self.eigenpairs(theta[None])
        at = self.pair(values, shapes)[0]
        lam = np.where(at >= 0, values[0, at], np.nan)
        seen = np.where((at >= 0)[:, None], shapes[0, at], np.nan) @ self.look.T
        both = zeros_for_nan(np.stack([seen, np.where(self.present, self.data.shapes[0], 0.0)], axis=-1))
        white = self.shape @ both
        power = np.sum(np.abs(white[..., 0]) ** 2, axis=-1)
        scale = np.sum(np.conj(white[..., 0]) * white[..., 1], axis=-1) / np.maximum(power, 1e-300)
        with np.errstate(invalid="ignore", divide="ignore"):
            return scale[:, None] * seen, np.abs(lam) / (2 * np.pi), -lam.real / np.abs(lam)

    @cached_property
    def largest(self) -> Real:
        """Beyond this many times the values of like parts and usual ones nothing that is measured depends on an end."""
        parts = (like_parts(self.model, self.data, self), usual_parts(self.model, self.data))
        return 1e5 * np.maximum(*np.abs(parts))

    def refined(self, start: Real, rows: Ints, limit: int) -> OptimizeResult:
        """The least χ² near starts (k, unknowns), of the repeats they belong to, in values, which may be negative.

        Ends far outside the scale of everything known are none.
        """
        lower, upper = self.model.bounds
        ends = minimise(
            lambda theta, some: self.evaluate(theta, rows[some]),
            start,
            limit=limit,
            tolerance=1e-6,
            lower=lower,
            upper=upper,
        )
        return self._within(ends)

    def search(self, start: Real, rows: Ints, limit: int, *, rough: bool = False) -> OptimizeResult:
        """As `refined`, from starts that may be far away: a step in values would lead beyond zero or any size.

        In logarithms of what starts positive, in steps of a neper at most; `rough` leaves it at that.
        """
        lower, upper = self.model.bounds
        logs = np.all(start > 0, axis=0) & (upper > 0) & ~self._of_any_sign
        with np.errstate(divide="ignore"):
            low, high = (np.where(logs, np.log(np.maximum(end, 0.0)), end) for end in (lower, upper))

        def values(psi: Real) -> Real:
            return np.where(logs, np.exp(np.where(logs, psi, 0.0)), psi)

        def in_logs(psi: Real, some: Ints) -> QuadraticModel:
            theta = values(psi)
            around, slope = self.evaluate(theta, rows[some]), np.where(logs, theta, 1.0)
            matrix = around.symmetric * slope[:, :, None] * slope[:, None, :]
            return QuadraticModel(around.cost, around.gradient * slope, matrix, matrix)

        ends = minimise(
            in_logs,
            np.where(logs, np.log(np.where(logs, start, 1.0)), start),
            limit=limit,
            tolerance=1e-6,
            lower=low,
            upper=high,
            longest=np.where(logs, 1.0, np.inf),
            patience=limit,
        )
        ends = replace(ends, x=values(ends.x), history=values(ends.history))
        if rough:
            return self._within(ends)
        near = self.refined(ends.x, rows, limit)
        history = np.concatenate([ends.history, near.history[1:]])
        return replace(near, iterations=ends.iterations + near.iterations, history=history)

    def _within(self, ends: OptimizeResult) -> OptimizeResult:
        """The ends; those of a rig far too large are none."""
        lost = np.any(np.abs(ends.x) > self.largest, axis=-1)
        return replace(ends, cost=np.where(lost, np.inf, ends.cost), converged=ends.converged & ~lost)

    @cached_property
    def _of_any_sign(self) -> Bools:
        """Which unknowns (unknowns,) are entries of free matrices."""
        free = free_names(self.model)
        return np.array([unknown.name in free for unknown in self.model.unknowns], dtype=bool)


def _whitening(V: Complex | Real, what: str) -> Complex:
    """L⁻¹ of V = L Lᴴ, measured in its standard deviations."""
    sd = np.sqrt(np.maximum(np.diagonal(V).real, 0.0))
    if np.all(np.isfinite(V)) and np.all(sd > 0):
        with suppress(np.linalg.LinAlgError):
            L = np.linalg.cholesky(V / np.outer(sd, sd))
            return np.linalg.solve(L, np.diag(1 / sd)).astype(complex)
    raise DataError(
        f"the covariance of the {what} is not positive definite", cure="state its standard deviations"
    )


# Where the search of rigs with measured modes starts.


def linear_start(problem: ModeProblem) -> Real | None:
    """Least squares on (λ²M + λC + K + jH) φ = 0 at the measured λ and φ; None if some coordinate is not seen."""
    model, data = problem.model, problem.data
    if not np.all(problem.present) or set(data.points) != set(model.coordinates):
        return None
    lam, phi = data.eigenvalues, data.shapes @ problem.look
    phi = phi / np.linalg.norm(phi, axis=-1, keepdims=True)
    a = model.pole_factors(lam) * (phi @ model.B.T) / np.abs(lam)[..., None] ** 2
    Phi = np.einsum("kli,in,iu->klnu", a, model.B, model.T, optimize=True)
    h = -np.einsum("kli,in,i->kln", a, model.B, model.p0, optimize=True)
    flat, side = Phi.reshape(len(a), -1, len(model.unknowns)), h.reshape(len(a), -1)
    N, r = (hermitian(flat) @ flat).real, (hermitian(flat) @ side[..., None])[..., 0].real
    # A weak prior, in the units of the fit, keeps what the equation alone does not fix near what is known of it.
    weak = 1e-6 * np.diagonal(N, axis1=-2, axis2=-1) * (model.prior_precision > 0)
    theta = solve_scaled(N + weak[..., None] * np.eye(N.shape[-1]), r + weak * model.prior_mean)
    return theta if np.all(np.isfinite(theta)) else None


def like_parts(model: Model, data: ModalData, problem: ModeProblem | None = None) -> Real:
    """The rig whose unknowns of a kind are all alike and whose first frequency is the first of the data, (unknowns,).

    What is known keeps its value; guesses and priors theirs.  Springs, dampers and the like are scaled, masses only
    where nothing else can be; where that does not lead to the first frequency, usual values are what it is.  `problem`
    gives the modes of a large rig.
    """
    theta = usual_parts(model, data)
    kinds = {element.name: element.kind for element in model.elements}
    free = np.array([unknown.prior is None and unknown.guess is None for unknown in model.unknowns])
    inert = np.array([kinds[unknown.name].law.power == 2 for unknown in model.unknowns])
    power = np.array([2.0 - kinds[unknown.name].law.power for unknown in model.unknowns])
    scaled = free & ~inert
    turned = 1.0
    if not np.any(scaled & (power == 2)):
        scaled, power, turned = free & inert, np.full(len(theta), 2.0), -1.0
    if not np.any(scaled):
        return theta
    wanted = float(np.min(data.frequency_hz))

    def scaled_by(size: float) -> Real:
        """The rig with its unknowns e^size as quick on their own."""
        return np.where(scaled, theta * np.exp(turned * power * size), theta)

    def too_quick(size: float) -> float:
        """Of its lowest frequency that swings; NaN where there is none."""
        with np.errstate(all="ignore"):
            at = scaled_by(size)[None]
            pairs = problem.eigenpairs(at) if problem is not None else eigenpairs(model, model.parameters(at))
            values = pairs[0][0]
        swings = np.abs(values[np.isfinite(values) & (values.imag > 1e-6 * np.abs(values))])
        return float(np.log(np.min(swings) / (2 * np.pi * wanted))) if len(swings) else np.nan

    at_zero = too_quick(0.0)
    size = low = high = 0.0
    for _ in range(12 if np.isfinite(at_zero) and at_zero != 0 else 0):  # steps of 3 nepers of frequency
        low, high = (low - 3.0, low) if at_zero > 0 else (high, high + 3.0)
        there = too_quick(low if at_zero > 0 else high)
        if not np.isfinite(there):
            break
        if (there > 0) != (at_zero > 0):
            with suppress(ValueError):  # no value on the way
                from scipy.optimize import brentq  # which takes long to load

                size = float(brentq(too_quick, low, high, xtol=1e-12))
            break
    return scaled_by(size)


def usual_parts(model: Model, data: ModalData) -> Real:
    """A usual value of every unknown, (m,): its guess or prior, else that of its kind given the known ones."""
    # Usual values of each kind for a mass of 1 kg that swings as the data do, and the mass that known parts imply
    rate = 2 * np.pi * float(np.exp(np.mean(np.log(data.frequency_hz))))
    ratio = float(np.nanmean(np.abs(data.damping_ratio))) if np.any(np.isfinite(data.damping_ratio)) else 0.01
    per_mass = {kind: float(kind.law.typical_size(1.0, rate, ratio)) for kind in Kind}
    known = [
        np.log(value / per_mass[element.kind])
        for element, value in zip(model.elements, model.p0, strict=True)
        if value > 0 and element.kind is not Kind.DAMPER
    ]
    known += [
        np.log(u.prior) for u in model.unknowns if u.prior is not None and u.prior > 0 and u.unit == "kg"
    ]
    mass = float(np.exp(np.mean(known))) if known else 1.0
    kinds = {element.name: element.kind for element in model.elements}
    return np.array(
        [
            unknown.prior
            if unknown.prior is not None and unknown.sd is not None
            else unknown.guess
            if unknown.guess is not None
            else mass * per_mass[kinds[unknown.name]]
            for unknown in model.unknowns
        ],
        dtype=float,
    )


def random_rigs(
    model: Model, data: ModalData, count: int, rng: np.random.Generator, problem: ModeProblem | None = None
) -> Real:
    """`count` rigs near that of like parts with the first frequency of the data, and of random size, half of each.

    (count, unknowns); what has a guess or a prior stays near it.
    """
    usual, middle = usual_parts(model, data), like_parts(model, data, problem)
    near = np.arange(count) % 2 == 0
    # Nepers by which parts differ: they are mostly alike
    spread = np.where(near, 0.15, 1.0)[:, None] * np.repeat([0.3, 1.0, 2.0], -(-count // 3))[:count, None]
    shared = np.where(near, 1.0, np.exp(0.7 * rng.standard_normal(count)))
    scatter = np.exp(spread * rng.standard_normal((count, len(usual))))
    theta = np.empty((count, len(usual)))
    for j, unknown in enumerate(model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            theta[:, j] = unknown.prior
        elif unknown.guess is not None:
            theta[:, j] = unknown.guess * scatter[:, j] ** 0.3
        else:
            theta[:, j] = np.where(near, middle[j], shared * usual[j]) * scatter[:, j]
    return theta


# How far each measured number is from the rig's.


@dataclass(frozen=True)
class ModeResiduals(Frozen):
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


def mode_residuals(model: Model, data: ModalData, theta: Real) -> ModeResiduals:
    """How far the modes of `data` (no batch axes) are from those of the rig at `theta` (unknowns,)."""
    problem = ModeProblem.of(model, data)
    if model.n >= SPAN_FROM:
        problem = problem.on(wider_span(problem, theta, np.zeros((model.n, 0)))[0])
    shapes, frequency, damping = problem.predicted(theta)
    # One point alone is all scale.
    compared = problem.present & (np.sum(problem.present, axis=1, keepdims=True) > 1)
    sd = np.sqrt(np.diagonal(data.covariance, axis1=-2, axis2=-1))
    shape_sd = np.sqrt(np.diagonal(data.shape_covariance, axis1=-2, axis2=-1).real)
    measured: Complex = np.where(compared, data.shapes, np.nan).astype(np.complex128)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = (data.frequency_hz - frequency) / sd[:, 0], (data.damping_ratio - damping) / sd[:, 1]
    return ModeResiduals(*away, measured - shapes, shape_sd, measured)


# The search.

STARTS = 32
SMALL = 8  # coordinates up to which all starts are searched although guesses have led to a fit


def check_suited(model: Model, data: ModalData) -> None:
    """Raises DataError if modes do not suit the rig, IdentifiabilityError if nothing fixes its size."""
    model.require_unknowns()
    for name in data.points:
        if name not in model.coordinates:
            raise DataError(
                f"the shapes have a point {name}, which is not a coordinate of the rig",
                cure=f"the coordinates are {', '.join(model.coordinates)}",
            )
    if not np.any(model.p0) and not np.any(model.prior_precision):
        raise IdentifiabilityError(
            "modes alone do not fix the scale: all masses and stiffnesses times any factor have the "
            "same modes",
            cure="state one mass or stiffness",
        )
    if data.modes > model.n:
        raise DataError(
            f"{data.modes} modes are measured, but the rig has only {model.n} that oscillate",
            cure="leave out modes, or give the rig more coordinates",
        )


def deepest_minima(
    problem: ModeProblem, starts: int, seed: int, *, others: bool = True
) -> tuple[OptimizeResult, OptimizeResult | None]:
    """The deepest minima, and where all starts ended for a single repeat with unseen points.

    Of a rig whose guesses lead to a fit these are looked for where `others` is asked for and it is small.

    Raises UsageError without any start, ConvergenceError if none ends near the scale of what is known.
    """
    model, data, repeats = problem.model, problem.data, problem.repeats
    everyone, minima, ends = np.arange(repeats), None, None
    choices = [u.prior if u.guess is None else u.guess for u in model.unknowns]
    begun = linear_start(problem) if problem.span is None else None
    if begun is not None:  # which is near, if anything is
        minima = problem.refined(begun, everyone, 100)
    firsts = []
    if None not in choices:
        firsts.append(np.tile(np.array(choices, dtype=float), (repeats, 1)))
    if model.n > 8:  # coordinates: like parts that lead to a fit are then taken without a look for others
        firsts.append(np.tile(like_parts(_without_guesses(model), data, problem), (repeats, 1)))
    for first in firsts:
        reached = problem.search(first, everyone, 100)
        minima = reached if minima is None else minima.improved(everyone, reached)
    lonely = repeats == 1 and begun is None and (minima is None or (others and model.n <= SMALL))
    for attempt in range(2 if starts else 0):
        astray = everyone
        if minima is not None:
            # So unlikely a χ² may mean a local minimum: other starts are tried.
            cost, dof = (
                np.where(np.isfinite(minima.cost), minima.cost, np.inf),
                problem.rows - len(model.unknowns),
            )
            unlikely = chdtrc(float(max(dof, 1)), cost) < 1e-4
            astray = np.flatnonzero(~minima.converged | ~np.isfinite(minima.cost) | unlikely)
        if not len(astray) and (not lonely or ends is not None):
            break
        about = model if not attempt else _without_guesses(model)  # which led nowhere
        drawn = random_rigs(about, data, starts, np.random.default_rng([seed, attempt]), problem)
        if not attempt or about is not model:
            drawn = np.concatenate([like_parts(about, data, problem)[None], drawn])
        if lonely:
            ends = problem.search(drawn, np.zeros(len(drawn), dtype=np.int64), 25, rough=True)
            on_the_way = np.flatnonzero(~ends.converged & np.isfinite(ends.cost))
            # Ten of those that have not settled after a few steps
            deepest = on_the_way[np.argsort(ends.cost[on_the_way], kind="stable")[:10]]
            if len(deepest):
                ends = ends.improved(deepest, problem.search(ends.x[deepest], np.zeros_like(deepest), 100))
            reached = _one_of(model, ends)
        else:
            many = len(drawn)
            short = problem.search(np.tile(drawn, (len(astray), 1)), np.repeat(astray, many), 25, rough=True)
            cost = np.where(np.isfinite(short.cost), short.cost, np.inf).reshape(len(astray), many)
            best = np.argmin(cost, axis=1)
            reached = problem.search(
                short.x.reshape(len(astray), many, -1)[np.arange(len(astray)), best], astray, 100
            )
        if len(astray):
            minima = reached if minima is None else minima.improved(astray, reached)
    if minima is None:
        raise UsageError(
            "there is no initial guess for the search",
            cure="give guesses of the unknowns, or allow random starts",
        )
    if not np.any(np.isfinite(minima.cost)):
        raise ConvergenceError(
            "the search finds no rig with these modes: it leaves the scale of the known values",
            cure="give guesses of the unknowns, measure more modes, or more points of their shapes",
        )
    return minima, ends


def _without_guesses(model: Model) -> Model:
    """The model without guesses, or itself where it has none; factors of matrices keep theirs, which have no usual
    size."""
    given = [element.guess is not None and element.block is None for element in model.elements]
    if not any(given):
        return model
    parts = zip(model.elements, given, strict=True)
    return replace(model, elements=tuple(replace(one, guess=None) if some else one for one, some in parts))


def rigs_with(model: Model, data: ModalData, *, seed: int = 0) -> Real:
    """Rigs that have these modes, (rigs, unknowns), the nearest first: several where not every point is seen.

    `data` has no batch axes.  Raises as `identify_modal`.
    """
    check_suited(model, data)
    problem = ModeProblem.of(model, data)
    starts = STARTS if linear_start(problem) is None else 0
    minima, ends = deepest_minima(problem, starts, seed, others=False)
    if ends is None:
        return minima.x
    near = np.flatnonzero(ends.cost <= minima.cost[0] + COMPETING)
    return np.concatenate([minima.x, ends.x[near[np.argsort(ends.cost[near], kind="stable")]]])


def _one_of(model: Model, ends: OptimizeResult) -> OptimizeResult:
    """The deepest of the ends; of those that fit alike to TIE, one without negative parts, and of like parts."""
    cost = np.where(np.isfinite(ends.cost), ends.cost, np.inf)
    if np.any(ends.converged & np.isfinite(cost)):
        cost = np.where(ends.converged, cost, np.inf)
    sound = (cost <= np.min(cost) + TIE) & np.all(ends.x > 0, axis=-1)
    if np.any(sound):
        logs = np.log(np.where(sound[:, None], ends.x, 1.0))
        units = np.array(model.unknown_units)
        spread = np.sum([np.ptp(logs[:, units == unit], axis=-1) for unit in dict.fromkeys(units)], axis=0)
        cost = np.where(sound, spread, np.inf)
    at = [int(np.argmin(cost))]
    return OptimizeResult(ends.x[at], ends.cost[at], ends.converged[at], ends.iterations[at], ends.x[at])


# Physical parameters from measured eigenvalues and mode shapes with their uncertainty (Kuratani; THEORY §4).
#
# Weighted nonlinear least squares on natural frequencies, damping ratios and shapes; the complex scale of each shape is
# eliminated exactly (variable projection: Golub and Pereyra 1973, Kaufman 1975), so shapes of any scale will do.  Modes
# are paired with those of the model by the modal assurance criterion and by frequency.

NAME = "modal"


def identify_modal(model: Model, data: ModalData, *, starts: int = STARTS, seed: int = 0) -> Estimate:
    """Estimate the unknowns of `model` from measured modes; leading axes of the data are repeats.

    If only some points are measured, several rigs may have the same modes: one of them is returned, and a warning
    names another.
    Large rigs start from equal parts that give the first measured frequency; results far from that scale are rejected.
    The first start is linear least squares on (λ²M + λC + K) φ = 0 where every coordinate is seen, and the model's
    guesses where it has them all; where these are missing or end with an unlikely χ², `starts` random rigs whose
    frequencies are those of the data are tried.  Displacement inputs stand still: the modes are those with them held.
    Covariance and bound are the inverse of the information, widened by χ²/dof where χ² rejects the model.

    Raises DataError or UsageError if the data do not suit the rig, IdentifiabilityError if they do not determine
    the unknowns, ConvergenceError if no search ends near the scale of the known values, and ModelError if every
    value found is 0.
    """
    check_suited(model, data)
    problem = ModeProblem.of(model, data)
    batch = data.frequency_hz.shape[:-1]
    if model.n < SPAN_FROM:
        return _estimate(problem, *deepest_minima(problem, starts, seed), batch)
    problem, minima, ends, notes = on_span(problem, starts, seed)
    return replace(_estimate(problem, minima, ends, batch), notes=notes)


SPAN_FROM = 100  # coordinates from which modes are computed on the span of few motions


def on_span(
    problem: ModeProblem, starts: int, seed: int
) -> tuple[ModeProblem, OptimizeResult, OptimizeResult | None, tuple[Notice, ...]]:
    """The deepest minima as `deepest_minima`, with the problem of a large rig on the span that they were found on.

    The span is made about the start, and about each end again, until that moves no more.  Raises as `deepest_minima`.
    """
    model, data, everyone = problem.model, problem.data, np.arange(problem.repeats)
    theta, V = usual_parts(model, data), np.zeros((model.n, 0))
    V, missed = wider_span(problem, theta, V)
    small = problem.on(V)
    minima, ends = deepest_minima(small, starts, seed)
    settled = False
    for _ in range(12):  # spans at most
        middle = np.median(minima.x, axis=0)
        moved = np.abs(middle - theta) / small.evaluate(minima.x[:1], everyone[:1]).sd[0]
        settled, theta = bool(np.all(moved < 1e-3)), middle
        if settled:
            break
        V, missed = wider_span(problem, theta, V)
        small = problem.on(V)
        reached = small.search(minima.x, everyone, 100)
        minima = replace(reached, iterations=minima.iterations + reached.iterations)
    minima = replace(minima, converged=minima.converged & settled)
    text = (
        f"modes were computed on a reduced basis of {V.shape[1]} motions for {model.n} coordinates; their frequencies "
        f"differ from those of the full model by at most {100 * np.max(missed):.1g} %"
    )
    return small, minima, ends, (Notice("reduced_model", text),)


def wider_span(problem: ModeProblem, theta: Real, V: Real) -> tuple[Real, Real]:
    """A span (n, k) for the modes about θ (unknowns,), V and more, or without V where that would be too wide; and by
    how much V missed the measured modes' eigenvalues there, |δλ / λ|."""
    model, data = problem.model, problem.data
    p = model.parameters(theta)
    highest = 1.2 * 2 * np.pi * float(np.max(data.frequency_hz))
    try:
        shapes = lowest_shapes(model, p, highest, 2 * data.modes + 6)
    except RuntimeError as error:
        raise no_steady_response() from error
    empty = np.zeros((model.n, 0))
    near = problem.on(V if V.shape[1] else extended_basis(empty, shapes.astype(np.complex128)))
    values, on_span = near.eigenpairs(theta[None])
    at = near.pair(values, on_span, slice(0, 1))[0]
    at = at[at >= 0]
    assert near.span is not None
    motions, missed = mode_motions(model, p, near.span, values[0, at], on_span[0, at])
    more = np.concatenate([shapes.astype(np.complex128), motions], axis=1)
    wider = extended_basis(V, more)
    # A span of more than 260 columns is not made wider.
    return (wider if wider.shape[1] <= 260 or not V.shape[1] else extended_basis(empty, more)), missed


def _estimate(
    problem: ModeProblem, minima: OptimizeResult, ends: OptimizeResult | None, batch: tuple[int, ...]
) -> Estimate:
    """The deepest minima with their covariance and χ²; `ends` are those of all starts, where rivals are looked for."""
    model, theta = problem.model, minima.x
    at = problem.evaluate(theta, np.arange(len(theta)))
    lower, upper = model.bounds
    bounds = HeldBounds(lower, upper, without_bounds(theta, at, lower, upper))
    covariance = scaled_inverse(at.symmetric)
    chi2, dof = at.cost, problem.dof
    p: Real = np.asarray(chdtrc(float(dof), chi2)) if dof > 0 else np.full(len(chi2), np.nan)
    misfit = (p < LEVEL) & (chi2 > dof)
    widened = covariance * np.where(misfit, chi2 / max(dof, 1), 1.0)[:, None, None]
    warnings: tuple[Notice, ...] = ()
    if not batch:
        scale = np.sqrt(np.diagonal(at.symmetric[0]))
        blind = [name for name, size in zip(model.unknown_names, scale, strict=True) if not size > 0]
        if not blind:
            values, vectors = np.linalg.eigh(at.symmetric[0] / np.outer(scale, scale))
            weak = np.abs(vectors[:, 0]) > 0.1 * np.max(np.abs(vectors[:, 0]))
            if not values[0] > 1e-12:
                blind = [name for name, moves in zip(model.unknown_names, weak, strict=True) if moves]
        if blind:
            raise IdentifiabilityError(
                f"the modes do not determine {', '.join(blind)}",
                cure=f"{with_values(blind)}, measure more modes, or more points of their shapes",
            )
        require_determined(model.unknown_names, theta[0], covariance[0])
        rivals: tuple[Notice, ...] = ()
        if ends is not None:  # other ends fit nearly as well: frequencies alone have several rigs
            sd = np.sqrt(np.diagonal(covariance[0]))
            best = minima.x[0]
            near = ends.converged & (ends.cost <= minima.cost[0] + DOUBT)
            if np.all(best >= 0):
                near &= np.all(ends.x >= 0, axis=-1)
            others, so = [], guessed(model.unknowns, best)
            for k in np.flatnonzero(near)[np.argsort(ends.cost[near], kind="stable")]:
                above = float(ends.cost[k] - minima.cost[0])
                if above + 2 * (so - guessed(model.unknowns, ends.x[k])) <= DOUBT:  # guesses count as data
                    others.append((ends.x[k], above))
            cure = "measure shapes at more points, or state a value, with an sd where it is not exact"
            rivals = rival_notice(model.unknowns, best, sd, others, 1.0, cure)
        warnings = (
            *wrong_signs(model, theta[0], widened[0]),
            *held(model.unknown_names, theta[0], bounds),
            *rivals,
        )
    return estimate_of(
        model,
        NAME,
        model.unknowns,
        theta,
        widened,
        batch,
        noise=covariance,
        bound=covariance,
        dof=np.where(misfit[:, None], float(max(dof, 1)), np.inf).repeat(theta.shape[1], axis=1),
        fit=Fit(chi2.reshape(batch), dof, p.reshape(batch)),
        basis=MISFIT if np.any(misfit) else SENSOR_NOISE,
        converged=minima.converged,
        iterations=minima.iterations,
        history=minima.history,
        bounds=bounds,
        modes=None if batch else _mode_values(problem, theta[0], widened[0]),
        warnings=warnings,
    )


def _mode_values(problem: ModeProblem, theta: Real, covariance: Real) -> ModeValues:
    """All modes at θ (unknowns,), of a large rig those in the band of the measured ones."""
    if problem.span is None:
        return mode_values(problem.model, theta, covariance)
    values, shapes = (part[0] for part in problem.eigenpairs(theta[None]))
    highest = 1.1 * 2 * np.pi * float(np.max(problem.data.frequency_hz))
    swings = (values.imag > 1e-9 * np.abs(values)) & (np.abs(values) > 1e-5 * highest)
    inside = np.flatnonzero(swings & (np.abs(values) < highest))
    at = inside[np.argsort(np.abs(values[inside]), kind="stable")]
    slope, _ = problem.sensitivities(theta[None], values[None, at], shapes[None, at])
    lifted = shapes[at] @ problem.span.V.T
    lifted = lifted / lifted[np.arange(len(at)), np.argmax(np.abs(lifted), axis=1), None]
    none = np.zeros((len(at), 0), dtype=np.complex128)
    return with_uncertainty(Modes(values[at], lifted, none), slope[0], covariance)
