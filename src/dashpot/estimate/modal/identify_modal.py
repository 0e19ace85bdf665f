"""Physical parameters from measured eigenvalues and mode shapes with their uncertainty (Kuratani; THEORY §4).

Weighted nonlinear least squares on natural frequencies, damping ratios and shapes; the complex scale of each shape is
eliminated exactly (variable projection: Golub and Pereyra 1973, Kaufman 1975), so shapes of any scale will do.  Modes
are paired with those of the model by the modal assurance criterion and by frequency.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian
from dashpot.data.modal_data import ModalData
from dashpot.errors import DataError, IdentifiabilityError, UsageError
from dashpot.estimate.inference.derived import known_values, mode_values, tied_values
from dashpot.estimate.inference.diagnostics import held, require_determined, wrong_signs
from dashpot.estimate.inference.uncertainty import MISFIT_LEVEL
from dashpot.estimate.likelihood.maximum_likelihood import DOUBT, TIE
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.result import Estimate, Fit
from dashpot.model.elements import Kind
from dashpot.model.modes import eigenpairs, mode_sensitivities
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise, without_bounds
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled

NAME = "modal"
EXACT = 1e-6  # sd of exact points of a shape, relative to the largest of the others
ASTRAY = 1e-4  # χ² so unlikely may mean a local minimum: other starts are tried
STARTS = 32
FOLLOWED = 10  # of the starts that have not settled after a few steps


def identify_modal(model: Model, data: ModalData, *, starts: int = STARTS, seed: int = 0) -> Estimate:
    """Estimate the unknowns of `model` from measured modes; leading axes of the data are repeats.

    Where only some points are seen, several rigs may have the same modes: one of them is returned, and a warning
    names another.
    The first start is linear least squares on (λ²M + λC + K) φ = 0 where every coordinate is seen, and the model's
    guesses where it has them all; where these are missing or end with an unlikely χ², `starts` random rigs whose
    frequencies are those of the data are tried.  Displacement inputs stand still: the modes are those with them held.
    Covariance and bound are the inverse of the information, widened by χ²/dof where χ² rejects the model.

    Raises DataError or UsageError where the data do not suit the rig, IdentifiabilityError where they do not determine
    the unknowns.
    """
    _check(model, data)
    batch = data.frequency_hz.shape[:-1]
    flat = _flatten(data)
    view = _view(model, flat)
    found, ends = _found(model, flat, view, starts, seed)
    m = len(model.unknowns)
    theta = found.x
    at = _evaluate(model, flat, view, theta, np.arange(len(theta)))
    lower, upper = model.bounds
    free = without_bounds(theta, at, lower, upper)
    covariance = scaled_inverse(at.symmetric)
    dof = view.rows - m + int(np.count_nonzero(model.prior_precision))
    chi2 = at.cost
    p: Real = np.asarray(chdtrc(float(dof), chi2)) if dof > 0 else np.full(len(chi2), np.nan)
    misfit = (p < MISFIT_LEVEL) & (chi2 > dof)
    factor = np.where(misfit, chi2 / max(dof, 1), 1.0)[:, None, None]
    names = tuple(unknown.name for unknown in model.unknowns)
    if not batch:
        _require_regular(at.symmetric[0], model)
        require_determined(names, theta[0], covariance[0])
    rivals = () if ends is None else _rivals(model, found, ends, np.sqrt(np.diagonal(covariance[0])))
    fit = Fit(chi2.reshape(batch), dof, p.reshape(batch))
    widened = covariance * factor
    return Estimate(
        model=model.name,
        method=NAME,
        names=names,
        units=tuple(unknown.unit for unknown in model.unknowns),
        values=theta.reshape((*batch, m)),
        covariance=widened.reshape((*batch, m, m)),
        noise_covariance=covariance.reshape((*batch, m, m)),
        bound_sd=np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)).reshape((*batch, m)),
        dof=np.where(misfit[:, None], float(max(dof, 1)), np.inf).repeat(m, axis=1).reshape((*batch, m)),
        lower=lower,
        upper=upper,
        free_values=free.reshape((*batch, m)),
        basis="model misfit" if np.any(misfit) else "sensor noise",
        converged=found.converged.reshape(batch),
        iterations=found.iterations.reshape(batch),
        history=found.history,
        fit=fit,
        known=known_values(model),
        tied=tied_values(model),
        modes=None if batch else mode_values(model, theta[0], widened[0]),
        signs={},
        warnings=()
        if batch
        else (*_warnings(model, theta[0], widened[0], HeldBounds(lower, upper, free), fit), *rivals),
    )


def _check(model: Model, data: ModalData) -> None:
    model.require_unknowns()
    for name in data.points:
        if name not in model.coordinates:
            raise DataError(
                f"the shapes have a point {name}, which is no coordinate of the rig",
                cure=f"there are {', '.join(model.coordinates)}",
            )
    if not np.any(model.p0) and not np.any(model.prior_precision):
        raise IdentifiabilityError(
            "modes alone do not fix the size of masses and stiffnesses: all of them times any factor have the same",
            cure="give one of them a value",
        )
    if data.modes > model.n:
        raise DataError(
            f"{data.modes} modes are measured, and the rig has no more than {model.n} that swing",
            cure="leave modes out, or give the rig more coordinates",
        )


def _warnings(
    model: Model, theta: Real, covariance: Real, limits: HeldBounds, fit: Fit
) -> tuple[Notice, ...]:
    notices = []
    if bool(fit.rejected):
        text = (
            f"the model does not have these modes: residuals are {float(fit.misfit):.3g} times their uncertainty "
            f"(χ² {float(fit.chi2):.4g} with {fit.dof} degrees of freedom); intervals are widened by that factor"
        )
        notices.append(Notice("modes_misfit", text))
    notices += wrong_signs(model, theta, covariance)
    notices += held(tuple(unknown.name for unknown in model.unknowns), theta, limits)
    return tuple(notices)


def _require_regular(symmetric: Real, model: Model) -> None:
    scale = np.sqrt(np.diagonal(symmetric))
    blind = [u.name for u, s in zip(model.unknowns, scale, strict=True) if not s > 0]
    if not blind:
        values, vectors = np.linalg.eigh(symmetric / np.outer(scale, scale))
        if values[0] > 1e-12:
            return
        weak = np.abs(vectors[:, 0])
        blind = [u.name for u, w in zip(model.unknowns, weak, strict=True) if w > 0.1 * np.max(weak)]
    raise IdentifiabilityError(
        f"the modes do not determine {', '.join(blind)}",
        cure="give one of them a value, measure more modes, or more points of their shapes",
    )


# What is measured


@dataclass(frozen=True)
class _View:
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


def _flatten(data: ModalData) -> ModalData:
    repeats = int(np.prod(data.frequency_hz.shape[:-1], dtype=int))
    return replace(
        data,
        frequency_hz=data.frequency_hz.reshape(repeats, data.modes),
        damping_ratio=data.damping_ratio.reshape(repeats, data.modes),
        shapes=data.shapes.reshape(repeats, data.modes, len(data.points)),
    )


def _view(model: Model, data: ModalData) -> _View:
    """Raises DataError where some uncertainty is missing."""
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
    return _View(damping, eigen, present, shape, look.reshape(len(data.points), model.n), rows)


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


# Pairing


def pair(data: ModalData, view: _View, values: Complex, shapes: Complex) -> Ints:
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
        own = np.sum(np.abs(measured) ** 2, axis=-1)
        theirs = np.einsum("mp,kjp->kmj", there, np.abs(seen) ** 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            mac = across / (own[:, :, None] * theirs)
        cost = cost + np.where(several[:, None], 1 - np.nan_to_num(mac), 0.0)
    cost = np.where(swings[:, None, :], cost, 1e6)
    chosen = np.empty(cost.shape[:2], dtype=np.int64)
    for k, table in enumerate(cost):
        rows, columns = linear_sum_assignment(table)
        chosen[k, rows] = np.where(table[rows, columns] < 1e6, columns, -1)
    return chosen


# The search


def _evaluate(model: Model, data: ModalData, view: _View, theta: Real, rows: Ints) -> QuadraticModel:
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


def _eigen_rows(model: Model, data: ModalData, view: _View, lam: Complex, dlam: Complex) -> tuple[Real, Real]:
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


def _shape_rows(data: ModalData, view: _View, phi: Complex, dphi: Complex) -> tuple[Complex, Complex]:
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


def _found(
    model: Model, data: ModalData, view: _View, starts: int, seed: int
) -> tuple[OptimizeResult, OptimizeResult | None]:
    """The deepest minima found, and for one repeat without a start of its own where all of its starts ended."""
    repeats = len(data.frequency_hz)
    everyone = np.arange(repeats)
    lower, upper = model.bounds

    def search(start: Real, rows: Ints, limit: int) -> OptimizeResult:
        return minimise(
            lambda theta, some: _evaluate(model, data, view, theta, rows[some]),
            start, limit=limit, tolerance=1e-6, lower=lower, upper=upper,
        )  # fmt: skip

    found, ends = None, None
    for first in (_linear(model, data, view), _guessed(model, repeats)):
        if first is None:
            continue
        own = search(first, everyone, 100)
        found = own if found is None else found.improved(everyone, own)
    lonely = found is None and repeats == 1
    dof = max(view.rows - len(model.unknowns), 1)
    for attempt in range(2):
        if found is None:
            astray = everyone
        else:
            tail = np.asarray(chdtrc(float(dof), np.where(np.isfinite(found.cost), found.cost, np.inf)))
            astray = np.flatnonzero(~found.converged | ~np.isfinite(found.cost) | (tail < ASTRAY))
        if not len(astray) or not starts:
            break
        drawn = _random(model, data, starts, np.random.default_rng([seed, attempt]))
        if lonely:
            ends = search(drawn, np.zeros(starts, dtype=np.int64), 25)
            open_ends = np.flatnonzero(~ends.converged & np.isfinite(ends.cost))
            deepest = open_ends[np.argsort(ends.cost[open_ends])[:FOLLOWED]]
            if len(deepest):
                ends = ends.improved(deepest, search(ends.x[deepest], np.zeros_like(deepest), 100))
            own = _one_of(model, ends)
        else:
            # A few steps tell the valleys apart; the deepest is followed to its end.
            short = search(np.tile(drawn, (len(astray), 1)), np.repeat(astray, starts), 25)
            best = np.argmin(
                np.where(np.isfinite(short.cost), short.cost, np.inf).reshape(len(astray), starts), axis=1
            )
            start = short.x.reshape(len(astray), starts, -1)[np.arange(len(astray)), best]
            own = search(start, astray, 100)
        found = own if found is None else found.improved(astray, own)
    if found is None:
        raise UsageError(
            "there is no start for the search", cure="give the unknowns a guess, or allow starts"
        )
    return found, ends


def _one_of(model: Model, ends: OptimizeResult) -> OptimizeResult:
    """The deepest of the ends; of those that fit alike to TIE, one without negative parts, and of like parts."""
    cost = np.where(np.isfinite(ends.cost), ends.cost, np.inf)
    if np.any(ends.converged & np.isfinite(cost)):
        cost = np.where(ends.converged, cost, np.inf)
    alike = cost <= np.min(cost) + TIE
    sound = alike & np.all(ends.x > 0, axis=-1)
    if np.any(sound):
        logs = np.log(np.where(sound[:, None], ends.x, 1.0))
        units = np.array([unknown.unit for unknown in model.unknowns])
        spread = np.sum([np.ptp(logs[:, units == unit], axis=-1) for unit in dict.fromkeys(units)], axis=0)
        at = [int(np.argmin(np.where(sound, spread, np.inf)))]
    else:
        at = [int(np.argmin(cost))]
    return OptimizeResult(ends.x[at], ends.cost[at], ends.converged[at], ends.iterations[at], ends.x[at])


def _rivals(model: Model, found: OptimizeResult, ends: OptimizeResult, sd: Real) -> tuple[Notice, ...]:
    """A warning where other ends fit nearly as well: frequencies alone have several rigs."""
    best = found.x[0]
    near = ends.converged & (ends.cost <= found.cost[0] + DOUBT)
    if np.all(best >= 0):
        near &= np.all(ends.x >= 0, axis=-1)
    others: list[Real] = []
    above: list[float] = []
    for k in np.argsort(ends.cost):
        if near[k] and all(np.any(np.abs(ends.x[k] - one) > 3 * sd) for one in (best, *others)):
            others.append(ends.x[k])
            above.append(float(ends.cost[k] - found.cost[0]))
    if not others:
        return ()
    away = np.abs(others[0] - best)
    largest = np.argsort(-away / np.maximum(np.abs(best), np.abs(others[0])))[:4]
    values = ", ".join(
        f"{model.unknowns[j].name} = {others[0][j]:.4g} {model.unknowns[j].unit}" for j in largest
    )
    more = len(others) - 1
    many = f" ({more} more set{'' if more == 1 else 's'} of values likewise)" if more else ""
    worse = f"almost as well (χ² is {above[0]:.3g} larger)" if above[0] > TIE else "equally well"
    text = (
        f"not unique: {values} fits {worse}{many}; measure shapes at more points, fix a parameter or give a guess "
        "of every unknown"
    )
    return (Notice("not_unique", text, tuple(model.unknowns[j].name for j in largest)),)


def _guessed(model: Model, repeats: int) -> Real | None:
    choices = [u.prior if u.guess is None else u.guess for u in model.unknowns]
    if any(choice is None for choice in choices):
        return None
    return np.tile(np.array(choices, dtype=float), (repeats, 1))


def _linear(model: Model, data: ModalData, view: _View) -> Real | None:
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


def _random(model: Model, data: ModalData, count: int, rng: np.random.Generator) -> Real:
    """`count` rigs of like parts whose frequencies are those of the data, (count, unknowns)."""
    rate = 2 * np.pi * float(np.exp(np.mean(np.log(data.frequency_hz))))
    ratio = float(np.nanmean(np.abs(data.damping_ratio))) if np.any(np.isfinite(data.damping_ratio)) else 0.01
    per_mass = {kind: kind.law.typical_size(1.0, rate, ratio) for kind in Kind}
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
    spread = np.repeat([0.3, 1.0, 2.0], -(-count // 3))[:count, None]
    theta = np.empty((count, len(model.unknowns)))
    scatter = np.exp(spread * rng.standard_normal(theta.shape))
    masses = mass * np.exp(0.7 * rng.standard_normal(count))
    for j, unknown in enumerate(model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            theta[:, j] = unknown.prior
        elif unknown.guess is not None:
            theta[:, j] = unknown.guess * scatter[:, j] ** 0.3
        else:
            theta[:, j] = masses * per_mass[kinds[unknown.name]] * scatter[:, j]
    return theta
