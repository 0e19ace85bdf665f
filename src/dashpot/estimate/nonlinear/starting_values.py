"""Where the search for the parameters of a nonlinear rig begins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import NoReturn

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import DashpotError, IdentifiabilityError
from dashpot.estimate.inference.unseen_laws import require_traces
from dashpot.estimate.nonlinear.dwells import dwells_of
from dashpot.estimate.nonlinear.regression import (
    MeasuredMotion,
    measured_motion,
    regression,
    scale_of_lines,
    weighted_normal_equations,
)
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.force_law import Constant
from dashpot.model.nonlinear.harmonic_balance import periodic_response, samples_of
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.model.observation import observation_model

SHARES = (
    0.01,
    0.03,
    0.1,
    0.2,
    0.35,
    0.6,
    0.85,
)  # of the largest elongation or speed, for constants of that unit
PURE = (0.3, 0.8, 1.3, 2.5)  # for constants that are pure numbers
LINEAR_MISFIT = 0.1  # relative noise at which a linear rig is fitted first
KEPT = 4  # starts that are followed
FACTORS = (1.5, 1.15, 1.05)  # of the steps by which inner constants are moved from the best of a grid
TOGETHER = 16  # trials in one call
MANY, REFINED = 2, 9  # unknown constants from which trials are refined, and how many of them are
MOVES = 12  # rounds with each of them, at most
RATIOS = (0.0, 0.03, 0.3, -0.1)  # nonlinear force over the linear one, where nothing tells


def starting_points(data: Prepared, *, afar: bool = False) -> Real:
    """Points ψ, (count, M), to begin from, the most promising first; one repeat.

    Where all is seen: least squares on the harmonics for trial values of the inner constants.  Elsewhere: the fit of
    a linear rig, with nonlinear elements of several strengths; so everywhere if `afar`.
    """
    calibrations = np.concatenate([np.ones(data.view.gains), np.zeros(data.view.delays)])
    if data.states is not None and not afar:
        theta = _by_regression(data)
    else:
        theta, calibrations = _by_linear_rig(data, calibrations)
    return np.concatenate([theta, np.broadcast_to(calibrations, (len(theta), len(calibrations)))], axis=1)


def harmonics_left(data: Prepared) -> float:
    """Share of the known forces that least squares on the harmonics leave, at the best constants that are tried.

    Data of one repeat, all motion seen; raises what `measured_motion` raises.
    """
    motion = measured_motion(data)
    return float(np.min(_residuals(motion, constant_trials(motion), scale_of_lines(motion))))


def _by_regression(data: Prepared) -> Real:
    model = data.model
    motion = measured_motion(data)
    weight = scale_of_lines(motion)
    strengths = np.any(model.T, axis=0)

    def residual(constants: Real) -> float:
        return float(_residuals(motion, [constants], weight)[0])

    trials = constant_trials(motion)
    if len(trials) > 1:
        trials = [trials[k] for k in np.argsort(_residuals(motion, trials, weight), kind="stable")]
    if sum(constant.unknown for _, constant in model.constants) >= MANY:  # too many for a fine grid
        refined = sorted(
            (refined_constants(model, trial, residual) for trial in trials[:REFINED]), key=residual
        )
        trials = distinct_constants(refined)
    thetas = []
    for constants, p in zip(trials, regression(motion, np.array(trials[:KEPT]), weight)[0], strict=False):
        theta = np.zeros(len(model.unknowns))
        theta[strengths] = p
        theta = np.where(model.prior_precision > 0, model.prior_mean, theta)
        slope, known = model.constants_map
        theta[~strengths] = (constants - known) @ slope[:, ~strengths]
        if np.all(np.isfinite(theta)):
            thetas.append(theta)
    if not thetas:
        _refuse(motion, trials[0], weight)
    low, high = model.bounds
    return np.clip(np.array(thetas), low, high)


def _refuse(motion: MeasuredMotion, constants: Real, weight: Real) -> NoReturn:
    """Raises IdentifiabilityError: no trial of the inner constants, such as these (G,), determines the parameters."""
    strengths = np.any(motion.model.T, axis=0)
    names = [name for name, there in zip(motion.model.unknown_names, strengths, strict=True) if there]
    require_traces(motion.model, names, weighted_normal_equations(motion, constants[None], weight)[0][0])
    raise IdentifiabilityError(
        "the measured motion does not determine the unknowns",
        cure="give guesses of the unknowns, or drive the rig at more frequencies and in more sizes",
    )


def _residuals(motion: MeasuredMotion, trials: Sequence[Real], weight: Real) -> Real:
    """What least squares leave with each of some inner constants (G,), inf where they lead nowhere, (trials,)."""
    left = []
    for first in range(0, len(trials), TOGETHER):
        p, residual = regression(motion, np.array(trials[first : first + TOGETHER]), weight)
        left.append(np.where(np.all(np.isfinite(p), axis=-1), residual, np.inf))
    return np.concatenate(left)


def refined_constants(model: Model, start: Real, residual: Callable[[Real], float]) -> Real:
    """Inner constants (G,) of less residual near the start, each unknown one moved by factors that come nearer to 1."""
    best, least = start, residual(start)
    unknown = [
        j for j, (_, constant) in enumerate(model.constants) if constant.unknown and constant.guess is None
    ]
    for factor in FACTORS if unknown else ():
        for _ in range(MOVES):
            before = least
            for j in unknown:
                for step in (factor, 1 / factor):
                    trial = best.copy()
                    trial[j] *= step
                    left = residual(trial)
                    if left < least:
                        best, least = trial, left
                        break
            if least == before:
                break
    return best


def distinct_constants(found: Sequence[Real]) -> list[Real]:
    """Those of the constants (G,) that are not nearly the ones of another before them."""
    kept = list[Real]()
    for constants in found:
        if not any(np.allclose(constants, other, rtol=FACTORS[-1] - 1, atol=0.0) for other in kept):
            kept.append(constants)
    return kept


def constant_trials(motion: MeasuredMotion) -> list[Real]:
    """Values of all inner constants to try, (G,) each: guesses as given, else shares of the measured motion."""
    largest = np.sqrt(np.mean(np.sum(motion.elongations**2, axis=-1), axis=0))
    speed = np.sqrt(
        np.mean(np.sum(motion.elongations**2, axis=-1) * motion.dwells.omega[:, None] ** 2, axis=0)
    )
    return constants_to_try(motion.model, np.max(largest, axis=0), np.max(speed, axis=0))


def constants_to_try(model: Model, elongation: Real, speed: Real) -> list[Real]:
    """As `constant_trials`, for elements whose largest elongation and speed are given, (e,) each."""
    choices: list[tuple[float, ...]] = []
    rows = [row for row, inner in enumerate(model.constant_slices) for _ in range(inner.stop - inner.start)]
    many = sum(constant.unknown and constant.guess is None for _, constant in model.constants) > 2
    for row, (element, constant) in zip(rows, model.constants, strict=True):
        stated = constant.value if constant.value is not None else constant.guess
        if stated is not None:
            choices.append((stated,))
            continue
        choices.append(_trials(element, constant, float(elongation[row]), float(speed[row]), many))
    return [np.array(values) for values in product(*choices)]


def _trials(
    element: Element, constant: Constant, elongation: float, speed: float, few: bool
) -> tuple[float, ...]:
    """Shares of the motion, in the constant's unit and within its bounds."""
    assert element.force_law is not None
    metre, second = element.force_law.exponents[1].get(constant.name, (0.0, 0.0))
    scale = elongation ** (metre + second) * speed**-second if metre or second else 1.0
    shares = PURE if not metre and not second else SHARES
    low = -np.inf if constant.lower is None else constant.lower
    high = np.inf if constant.upper is None else constant.upper
    return tuple(float(np.clip(scale * share, low, high)) for share in (shares[::3] if few else shares))


def _by_linear_rig(data: Prepared, calibrations: Real) -> tuple[Real, Real]:
    """Starts around the best linear rig, its nonlinear elements of several strengths; guesses hold where given."""
    model = data.model
    values, gains = _linear_fit(data, calibrations)
    theta = np.array([_known_start(u.prior, u.guess, values.get(u.name, np.nan)) for u in model.unknowns])
    strengths = np.any(model.T, axis=0)
    open_elements = [j for j in np.flatnonzero(strengths) if not np.isfinite(theta[j])]
    elongation, speed = _expected_motion(data, values)
    starts = []
    for constants in constants_to_try(model, elongation, speed)[:40]:
        sizes = _typical_strength(data, values, constants, elongation)
        for ratio in RATIOS if open_elements else (0.0,):
            trial = theta.copy()
            for j in open_elements:
                trial[j] = ratio * sizes[j]
            slope, known = model.constants_map
            trial[~strengths] = (constants - known) @ slope[:, ~strengths]
            starts.append(np.where(np.isfinite(trial), trial, 1.0))
    return np.array(starts), gains


def _known_start(prior: float | None, guess: float | None, fitted: float) -> float:
    return prior if prior is not None else guess if guess is not None else fitted


def linear_rig(model: Model, replaced: bool = False) -> Model:
    """The rig without its nonlinear elements, or with linear ones of their kind in their place.

    Raises ModelError where that is not a rig.
    """
    kept: list[Element] = []
    for element in model.elements:
        if element.force_law is None:
            kept.append(element)
        elif replaced:
            kept.append(
                replace(element, force_law=None, value=None, sd=None, guess=None, lower=None, upper=None)
            )
    return replace(model, elements=tuple(kept))


def _linear_fit(data: Prepared, calibrations: Real) -> tuple[dict[str, float], Real]:
    """Unknowns of the best linear rig by name, and the calibrations with it; nothing where none can be fitted."""
    from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood

    dwells = dwells_of(data.model, data.spectrum)
    fundamental = np.flatnonzero(dwells.order == 1)
    for replaced in (False, True):
        try:
            model = linear_rig(data.model, replaced)
            spectrum = data.spectrum.select(fundamental)
            view = observation_model(model, spectrum.channels, spectrum.omega)
            y = np.nan_to_num(spectrum.amplitudes)
            size = np.mean(np.abs(y), axis=0)
            soft = (LINEAR_MISFIT * size)[..., None] * np.eye(y.shape[-1]) * size[:, None, :] * LINEAR_MISFIT
            exact = np.diagonal(data.covariance, axis1=-2, axis2=-1)[:, fundamental] == 0
            V = data.covariance[:, fundamental] + np.where(exact[..., None], 0.0, soft)
            solution = MaximumLikelihood(starts=16, candidates=600, rounds=2).solve(
                replace(data, view=view, spectrum=spectrum, covariance=V, states=None)
            )
        except DashpotError:
            continue
        theta = solution.theta[0]
        names = [u.name for u in model.unknowns]
        fitted = dict(zip(names, theta[: len(names)].tolist(), strict=True))
        nonlinear = {e.name for e in data.model.elements if e.force_law is not None}
        return {k: v for k, v in fitted.items() if k not in nonlinear}, theta[len(names) :]
    return {}, calibrations


def _expected_motion(data: Prepared, values: dict[str, float]) -> tuple[Real, Real]:
    """Largest elongation and speed of the nonlinear elements that the linear rig would have, (e,) each."""
    model, e = data.model, len(data.model.nonlinear)
    from dashpot.estimate.nonlinear.objective import nonlinear_part

    part = nonlinear_part(data, np.nan_to_num(data.spectrum.amplitudes), None)
    theta = np.array([_known_start(u.prior, u.guess, values.get(u.name, 0.0)) for u in model.unknowns])
    p = model.parameters(theta)
    p[model.nonlinear] = 0.0
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    R = len(drive.omega)
    at = periodic_response(
        model,
        np.tile(p, (R, 1)),
        np.ones((R, len(model.constants))),
        drive,
        times=samples_of(model, part.dwells.orders),
    )
    size = np.sqrt(np.sum(np.nan_to_num(at.delta) ** 2, axis=-1))
    if not np.any(size):
        return np.full(e, 1e-3), np.full(e, 1e-2)
    return np.max(size, axis=0), np.max(size * drive.omega[:, None], axis=0)


def _typical_strength(data: Prepared, values: dict[str, float], constants: Real, elongation: Real) -> Real:
    """Parameters at which each nonlinear element pulls as hard as inertia and springs do, (unknowns,)."""
    model = data.model
    omega = float(np.median(data.spectrum.omega))
    theta = np.array([_known_start(u.prior, u.guess, values.get(u.name, 0.0)) for u in model.unknowns])
    forces = np.abs(model.parameters(theta)) * np.abs(model.factors(np.array([omega])))[0]
    linear = float(np.max(forces * float(np.max(elongation)), initial=0.0))
    q = np.zeros((1, len(model.nonlinear), 3))
    q[0, :, 1] = elongation
    a = alternate(model, constants[None], np.array([omega]), q, 256, slopes=False).a
    unit = np.abs(complex_of(a))[0].max(axis=-1)
    sizes = np.ones(len(model.unknowns))
    for row, index in enumerate(model.nonlinear):
        for j in np.flatnonzero(model.T[index]):
            sizes[j] = (linear if linear > 0 else 1.0) / (unit[row] if unit[row] > 0 else 1.0)
    return sizes
