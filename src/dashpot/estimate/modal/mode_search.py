"""The search among rigs for those that have measured modes: from the equation of motion, guesses, or drawn rigs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, linear_sum_assignment
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Ints, Real, freeze, hermitian
from dashpot.data.modal_data import ModalData
from dashpot.errors import ConvergenceError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.likelihood.global_search import COMPETING, TIE
from dashpot.model.elements import Kind
from dashpot.model.modes import eigenpairs, mode_sensitivities
from dashpot.model.network import Model
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise
from dashpot.numerics.small_systems import solve_scaled

# Measured modes as the search needs them, and which of the model's modes each of them is.


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
            # Exact points of a shape have a millionth of the largest standard deviation of the others.
            floor = np.where(variance == 0, 1e-6**2 * np.max(variance), 0.0)
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
            return np.linalg.solve(L, np.diag(1 / sd)).astype(complex)
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


# Where the search of rigs with measured modes starts.


NEAR, AFAR = 0.15, 1.0  # of the spreads, nepers: parts are mostly alike
MOST_SCALINGS, FARTHER = 12, 3.0  # steps in search of the size of like parts, nepers of frequency


def guessed(model: Model, repeats: int) -> Real | None:
    """Guesses and priors, (repeats, unknowns); None where some unknown has neither."""
    choices = [u.prior if u.guess is None else u.guess for u in model.unknowns]
    if any(choice is None for choice in choices):
        return None
    return np.tile(np.array(choices, dtype=float), (repeats, 1))


def linear_start(model: Model, data: ModalData, view: MeasuredModes) -> Real | None:
    """Least squares on (λ²M + λC + K + jH) φ = 0 at the measured λ and φ; None where some coordinate is not seen."""
    if not np.all(view.present) or set(data.points) != set(model.coordinates):
        return None
    lam = data.eigenvalues
    phi = data.shapes @ view.look
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


def like_parts(model: Model, data: ModalData) -> Real:
    """The rig whose unknowns of a kind are all alike and whose first frequency is the first of the data, (unknowns,).

    What is known keeps its value; guesses and priors theirs.  Springs, dampers and the like are scaled, masses only
    where nothing else can be; where that does not lead to the first frequency, usual values are what it is.
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
        return float(np.log(_first_frequency(model, scaled_by(size)) / wanted))

    size = _root(too_quick)
    return theta if size is None else scaled_by(size)


def _root(rising: Callable[[float], float]) -> float | None:
    """Where a rising function is 0; None where it is nowhere, or has no value."""
    at_zero = rising(0.0)
    if not np.isfinite(at_zero) or at_zero == 0:
        return 0.0 if at_zero == 0 else None
    low = high = 0.0
    for _ in range(MOST_SCALINGS):
        low, high = (low - FARTHER, low) if at_zero > 0 else (high, high + FARTHER)
        there = rising(low if at_zero > 0 else high)
        if not np.isfinite(there):
            return None
        if (there > 0) != (at_zero > 0):
            with suppress(ValueError):  # no value on the way
                return float(brentq(rising, low, high, xtol=1e-12))
            return None
    return None


def _first_frequency(model: Model, theta: Real) -> float:
    """The lowest frequency that swings, Hz; NaN where there is none."""
    with np.errstate(all="ignore"):
        values, _ = eigenpairs(model, model.parameters(theta)[None])
    swings = values[0][np.isfinite(values[0]) & (values[0].imag > 1e-6 * np.abs(values[0]))]
    return float(np.min(np.abs(swings))) / (2 * np.pi) if len(swings) else np.nan


def usual_parts(model: Model, data: ModalData) -> Real:
    """A usual value of every unknown, (m,): its guess or prior, else that of its kind beside the known ones."""
    per_mass, mass = _sizes(model, data)
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


def random_rigs(model: Model, data: ModalData, count: int, rng: np.random.Generator) -> Real:
    """`count` rigs near that of like parts with the first frequency of the data, and of random size, half of each.

    (count, unknowns); what has a guess or a prior stays near it.
    """
    usual, middle = usual_parts(model, data), like_parts(model, data)
    near = np.arange(count) % 2 == 0
    spread = np.where(near, NEAR, AFAR)[:, None] * np.repeat([0.3, 1.0, 2.0], -(-count // 3))[:count, None]
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


def _sizes(model: Model, data: ModalData) -> tuple[dict[Kind, float], float]:
    """Usual values of each kind for a mass of 1 kg that swings as the data do, and the mass that known parts imply."""
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
    return per_mass, float(np.exp(np.mean(known))) if known else 1.0


# Measured modes against those of a rig: χ² with its slopes, and how far each measured number is from the
# rig's.
#
# Source: THEORY §4.


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


STARTS = 32
# Coordinates above which a rig of like parts that leads to a fit is taken without a look for others
LARGE = 8

Search = Callable[[Real, Ints, int], OptimizeResult]  # starts, the repeats they belong to, most steps


def check_suited(model: Model, data: ModalData) -> None:
    """Raises DataError where modes do not suit the rig, IdentifiabilityError where nothing fixes its size."""
    model.require_unknowns()
    for name in data.points:
        if name not in model.coordinates:
            raise DataError(
                f"the shapes have a point {name}, which is not a coordinate of the rig",
                cure=f"there are {', '.join(model.coordinates)}",
            )
    if not np.any(model.p0) and not np.any(model.prior_precision):
        raise IdentifiabilityError(
            "modes alone do not fix the size of masses and stiffnesses: all of them times any factor have the same",
            cure="give one mass or stiffness a value",
        )
    if data.modes > model.n:
        raise DataError(
            f"{data.modes} modes are measured, and the rig has no more than {model.n} that oscillate",
            cure="leave modes out, or give the rig more coordinates",
        )


def _search_near(model: Model, data: ModalData, view: MeasuredModes) -> Search:
    """Minimises χ².

    An end far outside the scale of everything known is none: nothing that is measured depends on it there.
    """
    lower, upper = model.bounds
    # An end beyond this many times the values of like parts and usual ones is none.
    largest = 1e5 * np.maximum(np.abs(like_parts(model, data)), np.abs(usual_parts(model, data)))

    def search(start: Real, rows: Ints, limit: int) -> OptimizeResult:
        def misfit(theta: Real, some: Ints) -> QuadraticModel:
            return modal_misfit(model, data, view, theta, rows[some])

        ends = minimise(misfit, start, limit=limit, tolerance=1e-6, lower=lower, upper=upper)
        lost = np.any(np.abs(ends.x) > largest, axis=-1)
        return replace(ends, cost=np.where(lost, np.inf, ends.cost), converged=ends.converged & ~lost)

    return search


def deepest_minima(
    model: Model, data: ModalData, view: MeasuredModes, starts: int, seed: int
) -> tuple[OptimizeResult, OptimizeResult | None]:
    """The deepest minima, and for one repeat without a start of its own where all of its starts ended.

    Raises UsageError without any start, ConvergenceError where none ends near the scale of what is known.
    """
    repeats = len(data.frequency_hz)
    everyone = np.arange(repeats)
    search = _search_near(model, data, view)
    minima, ends = None, None
    firsts = [linear_start(model, data, view), guessed(model, repeats)]
    if model.n > LARGE:
        firsts.append(np.tile(like_parts(model, data), (repeats, 1)))
    for first in firsts:
        if first is None:
            continue
        reached = search(first, everyone, 100)
        minima = reached if minima is None else minima.improved(everyone, reached)
    lonely = minima is None and repeats == 1
    for attempt in range(2):
        astray = everyone if minima is None else _astray(minima, view.rows - len(model.unknowns))
        if not len(astray) or not starts:
            break
        drawn = random_rigs(model, data, starts, np.random.default_rng([seed, attempt]))
        if not attempt:
            drawn = np.concatenate([like_parts(model, data)[None], drawn])
        if lonely:
            ends = _ends(search, drawn)
            reached = _one_of(model, ends)
        else:
            reached = _deepest(search, drawn, astray)
        minima = reached if minima is None else minima.improved(astray, reached)
    if minima is None:
        raise UsageError(
            "there is no start for the search", cure="give the unknowns a guess, or allow starts"
        )
    if not np.any(np.isfinite(minima.cost)):
        raise ConvergenceError(
            "no start leads to a rig with these modes: the searches end far outside the scale of what is known",
            cure="give the unknowns a guess, measure more modes, or more points of their shapes",
        )
    return minima, ends


def searched_from(model: Model, data: ModalData, starts: Real) -> OptimizeResult:
    """The deepest end, the one row of it, of searches from the linear start and from `starts` (K, unknowns).

    `data` has no batch axes.  Raises as `identify_modal` where the data do not suit the rig.
    """
    check_suited(model, data)
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    linear = linear_start(model, flat, view)
    firsts = starts if linear is None else np.concatenate([starts, linear])
    return _deepest(_search_near(model, flat, view), firsts, np.zeros(1, dtype=np.int64))


def rigs_with(model: Model, data: ModalData, *, seed: int = 0) -> Real:
    """Rigs that have these modes, (rigs, unknowns), the nearest first: several where not every point is seen.

    `data` has no batch axes.  Raises as `identify_modal`.
    """
    check_suited(model, data)
    flat = with_one_axis(data)
    view = measured_modes(model, flat)
    starts = STARTS if linear_start(model, flat, view) is None else 0
    minima, ends = deepest_minima(model, flat, view, starts, seed)
    if ends is None:
        return minima.x
    near = np.flatnonzero(ends.cost <= minima.cost[0] + COMPETING)
    return np.concatenate([minima.x, ends.x[near[np.argsort(ends.cost[near])]]])


def _astray(minima: OptimizeResult, dof: int) -> Ints:
    """The repeats that have not settled, or settled where χ² is unlikely."""
    cost = np.where(np.isfinite(minima.cost), minima.cost, np.inf)
    tail = np.asarray(chdtrc(float(max(dof, 1)), cost))
    # So unlikely a χ² may mean a local minimum: other starts are tried.
    return np.flatnonzero(~minima.converged | ~np.isfinite(minima.cost) | (tail < 1e-4))


def _ends(search: Search, drawn: Real) -> OptimizeResult:
    """Where all starts of the one repeat end; the deepest of those that are still on their way are followed."""
    ends = search(drawn, np.zeros(len(drawn), dtype=np.int64), 25)
    on_the_way = np.flatnonzero(~ends.converged & np.isfinite(ends.cost))
    # Ten of those that have not settled after a few steps
    deepest = on_the_way[np.argsort(ends.cost[on_the_way])[:10]]
    if not len(deepest):
        return ends
    return ends.improved(deepest, search(ends.x[deepest], np.zeros_like(deepest), 100))


def _deepest(search: Search, drawn: Real, rows: Ints) -> OptimizeResult:
    """For each of the rows, all starts for a few steps, which tell the valleys apart; the deepest to its end."""
    starts = len(drawn)
    short = search(np.tile(drawn, (len(rows), 1)), np.repeat(rows, starts), 25)
    cost = np.where(np.isfinite(short.cost), short.cost, np.inf).reshape(len(rows), starts)
    best = np.argmin(cost, axis=1)
    return search(short.x.reshape(len(rows), starts, -1)[np.arange(len(rows)), best], rows, 100)


def _one_of(model: Model, ends: OptimizeResult) -> OptimizeResult:
    """The deepest of the ends; of those that fit alike to TIE, one without negative parts, and of like parts."""
    cost = np.where(np.isfinite(ends.cost), ends.cost, np.inf)
    if np.any(ends.converged & np.isfinite(cost)):
        cost = np.where(ends.converged, cost, np.inf)
    alike = cost <= np.min(cost) + TIE
    sound = alike & np.all(ends.x > 0, axis=-1)
    if np.any(sound):
        logs = np.log(np.where(sound[:, None], ends.x, 1.0))
        units = np.array(model.unknown_units)
        spread = np.sum([np.ptp(logs[:, units == unit], axis=-1) for unit in dict.fromkeys(units)], axis=0)
        at = [int(np.argmin(np.where(sound, spread, np.inf)))]
    else:
        at = [int(np.argmin(cost))]
    return OptimizeResult(ends.x[at], ends.cost[at], ends.converged[at], ends.iterations[at], ends.x[at])
