"""The maximum of the likelihood of measured harmonics: starts, branches and the number of harmonics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import ConvergenceError, DashpotError, IdentifiabilityError
from dashpot.estimate.inference.diagnostics import require_traces
from dashpot.estimate.likelihood.global_search import DOUBT, rival_notice
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.nonlinear.objective import (
    FEWEST,
    WarmStart,
    dwells_of,
    measured_part,
    nonlinear_part,
    predict_harmonics,
    regained,
)
from dashpot.estimate.nonlinear.regression import (
    MeasuredMotion,
    measured_motion,
    regression,
    scale_of_lines,
    weighted_normal_equations,
)
from dashpot.estimate.preparation import Prepared
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.harmonic_balance import (
    MOST_HARMONICS,
    Periodic,
    periodic_response,
    samples_of,
    truncation,
)
from dashpot.model.nonlinear.harmonics import Drive, complex_of, mirrored
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import OptimizeResult
from dashpot.numerics.small_systems import scaled_inverse

if TYPE_CHECKING:
    from dashpot.estimate.likelihood.descent import Likelihood
    from dashpot.estimate.likelihood.measured import Measured


# Where the search for the parameters of a nonlinear rig begins.


KEPT = 4  # starts that are followed
NEXT = 1.05  # the smallest factor by which inner constants are moved from the best of a grid


def starting_points(data: Prepared, *, afar: bool = False) -> Real:
    """Points ψ, (count, M), to begin from, the most promising first; one repeat.

    Where all is seen: least squares on the harmonics for trial values of the inner constants.  Elsewhere: the fit of
    a linear rig, with nonlinear elements of several strengths; so everywhere if `afar`.
    """
    calibrations = data.view.nominal_calibrations
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

    def residual(constants: Real) -> float:
        return float(_residuals(motion, [constants], weight)[0])

    trials = constant_trials(motion)
    if len(trials) > 1:
        trials = [trials[k] for k in np.argsort(_residuals(motion, trials, weight), kind="stable")]
    if sum(constant.unknown for _, constant in model.constants) >= 2:  # too many for a fine grid
        refined = sorted((refined_constants(model, trial, residual) for trial in trials[:9]), key=residual)
        trials = []
        for constants in refined:
            if not any(np.allclose(constants, other, rtol=NEXT - 1, atol=0.0) for other in trials):
                trials.append(constants)
    found = regression(motion, np.array(trials[:KEPT]), weight)[0]
    thetas = [theta_of(model, constants, p) for constants, p in zip(trials, found, strict=False)]
    thetas = [theta for theta in thetas if np.all(np.isfinite(theta))]
    if thetas:
        return np.array(thetas)
    strengths = np.any(model.T, axis=0)
    names = [name for name, there in zip(model.unknown_names, strengths, strict=True) if there]
    require_traces(model, names, weighted_normal_equations(motion, trials[0][None], weight)[0][0])
    raise IdentifiabilityError(
        "the measured motion does not determine the unknowns",
        cure="give initial guesses of the unknowns, or drive the rig at more frequencies and levels",
    )


def theta_of(model: Model, constants: Real, p: Real) -> Real:
    """θ (unknowns,) of inner constants (G,) and unknown parameters, within bounds; what is stated stands."""
    slope, known = model.constants_map
    theta = (constants - known) @ slope
    theta[np.any(model.T, axis=0)] = p
    low, high = model.bounds
    return np.clip(np.where(model.prior_precision > 0, model.prior_mean, theta), low, high)


def _residuals(motion: MeasuredMotion, trials: Sequence[Real], weight: Real) -> Real:
    """What least squares leave with each of some inner constants (G,), inf where they lead nowhere, (trials,)."""
    left = []
    for first in range(0, len(trials), 16):  # in one call
        p, residual = regression(motion, np.array(trials[first : first + 16]), weight)
        left.append(np.where(np.all(np.isfinite(p), axis=-1), residual, np.inf))
    return np.concatenate(left)


def refined_constants(model: Model, start: Real, residual: Callable[[Real], float]) -> Real:
    """Inner constants (G,) of less residual near the start, each unknown one moved by factors that come nearer to 1."""
    best, least = start, residual(start)
    unknown = [
        j for j, (_, constant) in enumerate(model.constants) if constant.unknown and constant.guess is None
    ]
    for factor in (1.5, 1.15, NEXT) if unknown else ():
        for _ in range(12):  # rounds at most
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


def constant_trials(motion: MeasuredMotion) -> list[Real]:
    """Values of all inner constants to try, (G,) each: guesses as given, else shares of the measured motion."""
    power, omega = np.sum(motion.elongations**2, axis=-1), motion.dwells.omega[:, None]
    largest, speed = (np.sqrt(np.mean(each, axis=0)) for each in (power, power * omega**2))
    return constants_to_try(motion.model, np.max(largest, axis=0), np.max(speed, axis=0))


def constants_to_try(model: Model, elongation: Real, speed: Real, *, reciprocal: bool = False) -> list[Real]:
    """As `constant_trials`, for elements whose largest elongation and speed are given, (e,) each.

    Shares are in the constant's unit and within its bounds, and fewer where there are more than two to be found.
    reciprocal: whether constants whose unit has 1/m are tried at one over the shares, where any state can be followed.
    """
    choices: list[tuple[float, ...]] = []
    unknown = sum(constant.unknown and constant.guess is None for _, constant in model.constants)
    for law, largest, fastest in zip(model.laws, elongation.tolist(), speed.tolist(), strict=True):
        for constant in law.constants:
            stated = constant.guess if constant.value is None else constant.value
            if stated is not None:
                choices.append((stated,))
                continue
            metre, second = law.exponents[1].get(constant.name, (0.0, 0.0))
            pure = not metre and not second
            scale = 1.0 if pure else largest ** (metre + second) * fastest**-second
            # Pure numbers, or shares of the largest elongation or speed
            sizes = (
                law.pure.get(constant.name, (0.3, 0.8, 1.3, 2.5))
                if pure
                else (0.01, 0.03, 0.1, 0.2, 0.35, 0.6, 0.85)
            )
            shares = np.array(sizes)[:: 3 if unknown > 2 else 1]
            shares = 1 / shares if reciprocal and metre + second < 0 else shares
            low = -np.inf if constant.lower is None else constant.lower
            high = np.inf if constant.upper is None else constant.upper
            choices.append(tuple(np.clip(scale * shares, low, high).tolist()))
    return [np.array(values) for values in product(*choices)]


def _by_linear_rig(data: Prepared, calibrations: Real) -> tuple[Real, Real]:
    """Starts around the best linear rig, its nonlinear elements of several strengths; guesses hold where given."""
    model = data.model
    values, gains = _linear_fit(data, calibrations)
    stated = [u.guess if u.prior is None else u.prior for u in model.unknowns]
    theta = np.array(
        [
            values.get(u.name, np.nan) if at is None else at
            for u, at in zip(model.unknowns, stated, strict=True)
        ]
    )
    strengths = np.any(model.T, axis=0)
    open_elements = [j for j in np.flatnonzero(strengths) if not np.isfinite(theta[j])]
    near = np.where(np.isnan(theta), 0.0, theta)
    elongation, speed = _expected_motion(data, near)
    starts = []
    omega, largest = np.array([np.median(data.spectrum.omega)]), float(np.max(elongation))
    # What inertia and springs pull with, as hard as which each nonlinear element is to pull
    forces = np.abs(model.parameters(near)) * np.abs(model.factors(omega))[0]
    linear = float(np.max(forces * largest, initial=0.0))
    q = np.zeros((1, len(model.nonlinear), 3))
    q[0, :, 1] = elongation
    for constants in constants_to_try(model, elongation, speed)[:40]:
        shown = complex_of(alternate(model, constants[None], omega, q, 256, slopes=False).a)
        sizes = np.ones(len(model.unknowns))
        for index, unit in zip(model.nonlinear, np.abs(shown)[0].max(axis=-1), strict=True):
            own = np.flatnonzero(model.T[index])
            sizes[own] = (linear if linear > 0 else 1.0) / (unit if unit > 0 else 1.0)
        # Nonlinear force over the linear one, where nothing tells
        for ratio in (0.0, 0.03, 0.3, -0.1) if open_elements else (0.0,):
            trial = theta.copy()
            trial[open_elements] = ratio * sizes[open_elements]
            slope, known = model.constants_map
            trial[~strengths] = (constants - known) @ slope[:, ~strengths]
            starts.append(np.where(np.isfinite(trial), trial, 1.0))
    return np.array(starts), gains


def linear_rig(model: Model, replaced: bool = False) -> Model:
    """The rig without its nonlinear elements, or with linear ones of their kind in their place.

    Raises ModelError if that is not a rig.
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
            # Relative noise of a tenth, at which a linear rig is fitted first
            soft = (0.1 * size)[..., None] * np.eye(y.shape[-1]) * size[:, None, :] * 0.1
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


def _expected_motion(data: Prepared, theta: Real) -> tuple[Real, Real]:
    """Largest elongation and speed of the nonlinear elements that the linear rig at θ would have, (e,) each."""
    model = data.model
    part = nonlinear_part(data, np.nan_to_num(data.spectrum.amplitudes), None)
    p = model.parameters(theta)
    p[model.nonlinear] = 0.0
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    R, times = len(drive.omega), samples_of(model, part.dwells.orders)
    constants = np.ones((R, len(model.constants)))
    at = periodic_response(model, np.tile(p, (R, 1)), constants, drive, times=times)
    size = np.sqrt(np.sum(np.nan_to_num(at.delta) ** 2, axis=-1))
    if not np.any(size):
        return np.full(size.shape[1], 1e-3), np.full(size.shape[1], 1e-2)
    return np.max(size, axis=0), np.max(size * drive.omega[:, None], axis=0)


FIRST, LONGEST = 30, 100  # iterations from each of the starts, and where the best of them led
ROUGHLY = 0.03  # standard deviations within which descents end that others follow


def search_harmonics(likelihood: Likelihood) -> tuple[OptimizeResult, Measured, tuple[Notice, ...]]:
    """The best end of all repeats, the data with as many harmonics as it needs, and what else fits alike.

    Raises ConvergenceError if no start leads to a response at all.
    """
    data, view, exact = likelihood.data, likelihood.view, likelihood.exact
    near = ROUGHLY if data.noise_known else None  # unknown standard deviations are no measure
    one = data.only(0)
    first = exact.pick(np.array([0]))
    signs = np.ones((1, len(view.channels)))
    ends = _ends(likelihood, one, first, near)
    best, warm = min(ends, key=lambda end: float(end[0].cost[0]))
    warnings = _rivals(view, first, best, [end for end, _ in ends], data.noise_known)
    sign = np.repeat(signs, len(exact.y), axis=0)
    exact = _fresh(exact)
    part = measured_part(exact)
    for repeat in range(len(exact.y) if part.start is None else 1):  # whose motion is not measured
        part.warm.delta[repeat] = warm.delta[0]
        part.warm.inputs[repeat] = warm.inputs[0] if repeat == 0 else part.q[repeat]
    minimum = best
    if len(exact.y) > 1 or not best.converged[0]:
        minimum = likelihood.descend_in(
            exact, np.repeat(best.x, len(exact.y), axis=0), sign, LONGEST, near=near
        )
    last = LONGEST if np.all(minimum.converged) else FIRST  # a valley without an end is followed no further
    if measured_branches_regained(view, exact, minimum.x, sign) or lost_dwells_regained(
        view, exact, minimum.x
    ):
        minimum = likelihood.descend_in(exact, minimum.x, sign, near=near)
    while True:
        part = measured_part(exact)
        if data.noise_known and float(minimum.cost[0]) > 1e3 * first.rows:  # more do not help another rig
            return likelihood.descend_in(exact, minimum.x, sign, FIRST, near=near), exact, warnings
        enough = part.dwells.orders >= MOST_HARMONICS
        if not enough:
            at, p, constants, drive = _at_end(view, exact, minimum.x[:1], 0)
            missing = np.where(at.converged, truncation(view.model, p, constants, drive, at), 0.0)
            # The truncation error of the elongations is to hide in the noise of the best line; unknown noise is what
            # the fit leaves, χ²/row.
            variance = np.diagonal(data.covariance, axis1=-2, axis2=-1).real
            variance = variance * (1.0 if data.noise_known else float(minimum.cost[0]) / max(first.rows, 1))
            power = np.abs(np.nan_to_num(data.spectrum.amplitudes)) ** 2
            noisy = (variance > 0) & (power > 0)
            shares = np.broadcast_to(variance, power.shape)[noisy] / power[noisy]
            allowed = np.clip(0.1 * np.sqrt(np.min(shares)), 1e-10, 1e-3) if len(shares) else 1e-10
            enough = bool(np.max(missing, initial=0.0) <= allowed)
        if enough:
            return likelihood.descend_in(exact, minimum.x, sign, last), exact, warnings
        exact = replace(exact, nonlinear=part.widened(min(2 * part.dwells.orders + 1, MOST_HARMONICS)))
        minimum = likelihood.descend_in(exact, minimum.x, sign, near=near)


def _ends(
    likelihood: Likelihood, one: Prepared, first: Measured, near: float | None
) -> list[tuple[OptimizeResult, WarmStart]]:
    """Where descents from the starting points end, and the responses there.

    They go on to the first that fits, or through all starts where laws have many constants.  Raises
    ConvergenceError if none leads to a response.
    """
    signs = np.ones((1, len(one.view.channels)))
    acceptable = first.rows + 6 * np.sqrt(2.0 * first.rows)
    # Relative noise of the stages from afar
    stages = [*(_coarse(measured(one, softness)) for softness in (0.3, 0.03)), first]
    ends, fits = list[tuple[OptimizeResult, WarmStart]](), False
    # Several unknown constants of a law may give a fit several ends.
    several = any(sum(constant.unknown for constant in law.constants) >= 2 for law in one.model.laws)
    for psi, afar in _ranked(likelihood, one, stages):
        if fits and afar:
            break
        data = _fresh(first)
        end = likelihood.descend_in(data, psi[None], signs, FIRST, near=near)
        if np.isfinite(end.cost[0]):
            ends.append((end, measured_part(data).warm))
        fits |= bool(end.cost[0] <= acceptable and (end.converged[0] or several))
        if fits and not several:
            break
    if not ends:
        raise ConvergenceError(
            "harmonic balance finds no response near the initial guesses",
            cure="give other guesses of the unknowns",
        )
    return ends


def _coarse(data: Measured) -> Measured:
    """Data with as few harmonics as smooth laws begin with, where what the others add does not matter yet."""
    part = measured_part(data)
    fewest = max(FEWEST[True], 2 * int(np.max(part.dwells.order)) + 1)
    return replace(data, nonlinear=part.with_harmonics(min(part.dwells.orders, fewest)))


def _rivals(
    view: ObservationModel,
    first: Measured,
    best: OptimizeResult,
    ends: Sequence[OptimizeResult],
    noise_known: bool,
) -> tuple[Notice, ...]:
    """A warning where another end, or the mirror image of the best one, fits nearly as well."""
    others = [(end.x[0], float(end.cost[0])) for end in ends if end is not best]
    image = mirrored(view.model, best.x[0, : view.m])
    if image is not None:
        psi = np.concatenate([image, best.x[0, view.m :]])
        others.append((psi, float(_costs(view, first, psi[None])[0])))
    misfit = float(best.cost[0]) / max(first.rows - len(view.names), 1)
    scale = max(1.0, misfit) if noise_known else misfit
    above = [(cost - float(best.cost[0]), psi) for psi, cost in others]
    near = [each for each in above if each[0] <= DOUBT * scale]
    if not near:
        return ()
    curvature = local(view, _fresh(first), best.x, np.ones((1, len(view.channels)))).symmetric[0]
    sd = np.sqrt(np.abs(np.diagonal(scaled_inverse(curvature))))
    others = [(psi, rise) for rise, psi in sorted(near, key=lambda other: other[0])]
    return rival_notice(view.unknowns, best.x[0], sd, others, scale)


def _fresh(exact: Measured) -> Measured:
    """The same data without memory of earlier responses, for many starts, each of which may lose dwells."""
    part = measured_part(exact)
    return replace(exact, nonlinear=replace(part, warm=WarmStart(), patient=False, raised=False))


def _ranked(likelihood: Likelihood, one: Prepared, stages: Sequence[Measured]) -> Iterator[tuple[Real, bool]]:
    """Starting points, the most promising first, and whether they come from afar.

    Where all is seen, those of the regression come before those from afar, which go through softened data, in which
    valleys are wide, before they are ranked.  A regression of laws without unknown constants leaves no other valley to
    look for, and laws with a state take minutes from afar; even laws leave odd harmonics no trace in a regression.
    """
    view = one.view
    image = mirrored(one.model, np.ones(view.m))
    odd = bool(np.all(dwells_of(one.model, one.spectrum).order % 2))
    if one.states is not None and (image is None or not odd):
        points = starting_points(one)
        yield from ((psi, False) for psi in _best_first(view, _coarse(stages[-1]), points))
        laws = [law for law in one.model.laws if any(constant.unknown for constant in law.constants)]
        if not laws or any(law.has_state for law in laws):
            return
    points = starting_points(one, afar=True)
    for stage, kept in zip(stages[:-1], (KEPT, KEPT // 2), strict=True):
        if len(points) > 1:
            points = _valleys(likelihood, stage, _best_first(view, stage, points)[:kept])
    yield from ((psi, True) for psi in _best_first(view, stages[-1], points))


def _valleys(likelihood: Likelihood, stage: Measured, points: Real) -> Real:
    """Where rough descents from points (count, M) end in softened data, until two end alike; the best first."""
    signs = np.ones((1, stage.y.shape[-1]))
    ends = list[OptimizeResult]()
    for psi in points:
        end = likelihood.descend_in(_fresh(stage), psi[None], signs, FIRST, near=ROUGHLY)
        ends.append(end)
        if any(_alike(end, other) for other in ends[:-1]):
            break
    kept = list[OptimizeResult]()
    for end in sorted(ends, key=lambda end: float(end.cost[0])):
        if not any(_alike(end, other) for other in kept):
            kept.append(end)
    return np.concatenate([end.x for end in kept])


def _best_first(view: ObservationModel, data: Measured, points: Real) -> Real:
    """Points (count, M) of one repeat, the most probable first."""
    return points if len(points) == 1 else points[np.argsort(_costs(view, data, points), kind="stable")]


def _alike(end: OptimizeResult, other: OptimizeResult) -> bool:
    """Whether two descents ended at the same place, as far as rough ones tell."""
    alike = 0.02  # of the values and of the cost of softened data
    far = np.abs(end.x - other.x) > alike * np.maximum(np.abs(end.x), np.abs(other.x))
    apart = np.abs(end.cost[0] - other.cost[0]) > alike * max(float(other.cost[0]), 1.0)
    return not np.any(far) and not apart


def _costs(view: ObservationModel, data: Measured, points: Real) -> Real:
    """−2 ln(likelihood) at many points of one repeat, inf where there is no response."""
    pieces = []
    for first in range(0, len(points), 16):  # at once
        psi = points[first : first + 16]
        data = _fresh(data)
        part = replace(measured_part(data), raised=False)
        with np.errstate(all="ignore"):
            cost = predict_harmonics(view, data, part, psi, np.ones((len(psi), len(view.channels))))[5]
        pieces.append(np.sum(cost, axis=-1))
    total = np.concatenate(pieces)
    return np.where(np.isfinite(total), total, np.inf)


def _at_end(
    view: ObservationModel, exact: Measured, psi: Real, repeat: int
) -> tuple[Periodic, Real, Real, Drive]:
    """The responses of one repeat at ψ (1, M) from its last ones, with the parameters and the drive of its dwells."""
    part = measured_part(exact)
    q = (part.q if exact.q is None else exact.q)[repeat : repeat + 1]
    q = part.warm.inputs.get(repeat, q[0])[None] if exact.q is None else q
    theta, R = psi[:, : view.m], len(part.dwells.omega)
    p = np.repeat(view.model.parameters(theta), R, axis=0)
    constants = np.repeat(view.model.inner_constants(theta), R, axis=0)
    drive = part.dwells.drive(q, view.model.D.shape[1])
    start = part.warm.delta.get(repeat)
    return periodic_response(view.model, p, constants, drive, start), p, constants, drive


def lost_dwells_regained(view: ObservationModel, exact: Measured, psi: Real) -> bool:
    """Whether dwells without a response at ψ (K, M) have got one by raising their drive slowly from rest.

    The last responses remember it.
    """
    warm, gained = measured_part(exact).warm, False
    for repeat in range(len(psi)):
        at, _, _, drive = _at_end(view, exact, psi[repeat : repeat + 1], repeat)
        if np.all(at.converged):
            continue
        delta = regained(view.model, psi[repeat : repeat + 1, : view.m], drive, at.delta, at.converged)
        if delta is not None:
            warm.delta[repeat], warm.cost[repeat], gained = delta, np.inf, True
            warm.along.pop(repeat, None)
            warm.latest = None
    return gained


def measured_branches_regained(view: ObservationModel, exact: Measured, psi: Real, sign: Real) -> bool:
    """Whether responses at ψ (K, M) are nearer to the data from the measured motion than from the last ones.

    On the way from a start far off a dwell may have come to another motion than was measured, and then keeps to it.
    They are then remembered in place of the last ones.
    """
    part = measured_part(exact)
    if part.start is None or not part.warm.delta:
        return False
    anew = _fresh(exact)
    with np.errstate(all="ignore"):
        cost, other = (
            np.sum(predict_harmonics(view, data, measured_part(data), psi, sign)[5], axis=-1)
            for data in (exact, anew)
        )
    # By a hundredth of the cost, or of what noise alone makes of it
    nearer = np.flatnonzero(other < cost - 0.01 * np.maximum(np.abs(cost), exact.rows))
    for repeat in part.repeat[nearer].tolist():
        part.warm.take(measured_part(anew).warm, repeat)
    return bool(len(nearer))
