"""Physical parameters from measured eigenvalues and mode shapes with their uncertainty (Kuratani; THEORY §4).

Weighted nonlinear least squares on natural frequencies, damping ratios and shapes; the complex scale of each shape is
eliminated exactly (variable projection: Golub and Pereyra 1973, Kaufman 1975), so shapes of any scale will do.  Modes
are paired with those of the model by the modal assurance criterion and by frequency.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real
from dashpot.data.modal_data import ModalData
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.inference.diagnostics import held, require_determined, wrong_signs
from dashpot.estimate.inference.uncertainty import MISFIT_LEVEL, mode_values
from dashpot.estimate.likelihood.global_search import DOUBT, apart, not_unique
from dashpot.estimate.method import HeldBounds
from dashpot.estimate.modal.mode_search import STARTS, ModeProblem, check_suited, deepest_minima
from dashpot.estimate.result import MISFIT, SENSOR_NOISE, Estimate, Fit, estimate_of
from dashpot.io.words import with_values
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult, without_bounds
from dashpot.numerics.small_systems import scaled_inverse

NAME = "modal"


def identify_modal(model: Model, data: ModalData, *, starts: int = STARTS, seed: int = 0) -> Estimate:
    """Estimate the unknowns of `model` from measured modes; leading axes of the data are repeats.

    Where only some points are seen, several rigs may have the same modes: one of them is returned, and a warning
    names another.
    Large rigs start from like parts whose first frequency is that of the data; an end far outside their scale is none.
    The first start is linear least squares on (λ²M + λC + K) φ = 0 where every coordinate is seen, and the model's
    guesses where it has them all; where these are missing or end with an unlikely χ², `starts` random rigs whose
    frequencies are those of the data are tried.  Displacement inputs stand still: the modes are those with them held.
    Covariance and bound are the inverse of the information, widened by χ²/dof where χ² rejects the model.

    Raises DataError or UsageError where the data do not suit the rig, IdentifiabilityError where they do not determine
    the unknowns, ConvergenceError where no search ends near the scale of what is known, ModelError where all values
    that it ends in are 0.
    """
    check_suited(model, data)
    problem = ModeProblem.of(model, data)
    minima, ends = deepest_minima(problem, starts, seed)
    return _estimate(problem, minima, ends, data.frequency_hz.shape[:-1])


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
    misfit = (p < MISFIT_LEVEL) & (chi2 > dof)
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
        warnings = (
            *wrong_signs(model, theta[0], widened[0]),
            *held(model.unknown_names, theta[0], bounds),
            *(() if ends is None else _rivals(model, minima, ends, np.sqrt(np.diagonal(covariance[0])))),
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
        modes=None if batch else mode_values(model, theta[0], widened[0]),
        warnings=warnings,
    )


def _rivals(model: Model, minima: OptimizeResult, ends: OptimizeResult, sd: Real) -> tuple[Notice, ...]:
    """A warning where other ends fit nearly as well: frequencies alone have several rigs."""
    best = minima.x[0]
    near = ends.converged & (ends.cost <= minima.cost[0] + DOUBT)
    if np.all(best >= 0):
        near &= np.all(ends.x >= 0, axis=-1)
    others: list[Real] = []
    above: list[float] = []
    for k in np.argsort(ends.cost):
        if near[k] and all(apart(other, ends.x[k], sd) for other in (best, *others)):
            others.append(ends.x[k])
            above.append(float(ends.cost[k] - minima.cost[0]))
    if not others:
        return ()
    cure = "measure shapes at more points, fix a parameter or give a guess of every unknown"
    names, units = model.unknown_names, model.unknown_units
    return (not_unique(names, units, best, others[0], above[0], len(others) - 1, cure),)
