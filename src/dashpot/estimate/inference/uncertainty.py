"""Covariance, bound and χ² of an estimate, from the information of each line and the residuals (THEORY §5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.noise import LEVEL
from dashpot.data.spectrum import FITTED, Spectrum
from dashpot.errors import IdentifiabilityError, ModelError
from dashpot.estimate.inference.time_course import (
    BandStability,
    CountedInTime,
    band_stability,
    counted_in_time,
)
from dashpot.estimate.likelihood.descent import NEAR_END, ROUGH, Stage
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import local, measured, nuisance_columns, per_line
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.likelihood.table_noise import doubts_of_weights
from dashpot.estimate.linear.gram import equation_by_line, equation_sums, sums_of_lines
from dashpot.estimate.linear.instrumental_variables import likeliest
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.nonlinear.objective import NonlinearPart
from dashpot.estimate.preparation import NoiseQuality, Prepared, interval_dof, noise_quality
from dashpot.estimate.result import ModeValues
from dashpot.io.words import joined, with_values
from dashpot.model.modes import Modes, eigenmodes
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.kernel import kernel, kernel_function, threads
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled
from dashpot.unknowns import Unknown

# How far χ² stays low along a direction in which the information is singular, as where two solutions merge.
#
# Gauss and Newton's parabola has no curvature there, and yet χ² may rise: by the fourth power, beyond a fold of the
# response.  The valley is followed both ways, step by step along the weakest direction of where it has led (Allgower
# and Georg, Numerical Continuation Methods, 1990), until χ² has risen as at two standard deviations.  Where it does
# on both sides the curvature that a parabola with that rise has stands in for the missing one; where it does not, the
# data do not tell the unknowns apart that change along the valley.


# Eigenvalue of an information matrix with ones on its diagonal, below which a direction is followed
WEAK = 1e-5
RISE = 4.0  # of χ², at two standard deviations

Evaluate = Callable[[Real, Ints], QuadraticModel]


@dataclass(frozen=True)
class Valley:
    """A valley of χ² through ψ (M,), followed both ways.

    low, high   (M,) the least and the greatest values met while χ² had not risen by RISE
    bounded     whether it has risen so far at both ends
    lowest      (M,) the lowest point met, `fall` below the start
    curvature   (M, M) what the information lacks to rise as χ² does; 0 where the valley is not bounded
    """

    low: Real
    high: Real
    bounded: bool
    lowest: Real
    fall: float
    curvature: Real


def flat_valley(
    view: ObservationModel, data: Measured, psi: Real, sign: Real, scale: float = 1.0
) -> Valley | None:
    """The valley through the minimum ψ (1, M) of one repeat with signs (1, channels); None where information holds all.

    scale: χ² is counted in it, where the size of the noise is not known.  None is followed of several repeats, of
    large or nonlinear rigs, and where unknowns have bounds.
    """
    model = view.model
    if len(psi) != 1 or not small(model) or len(model.nonlinear) or np.any(np.isfinite(model.bounds)):
        return None

    def evaluate(at: Real, _: Ints) -> QuadraticModel:
        return local(view, data, at, np.repeat(sign, len(at), axis=0))

    lacking = np.zeros((psi.shape[1],) * 2)
    walks: list[_Walk] = []
    while len(walks) < 8 and all(
        walk.risen for walk in walks
    ):  # two for each direction that information lacks
        begin = _Point.at(evaluate(psi, np.zeros(1, dtype=np.int64)), psi[0], lacking)
        if begin is None or not begin.weak(scale):
            break
        both = [_Walk.followed(evaluate, begin, side, RISE * scale) for side in (-1.0, 1.0)]
        walks += both
        if all(walk.risen for walk in both):
            # The curvature that makes a parabola as wide as χ² there. The valley may have turned aside: how wide it
            # is straight on is another walk.
            both += [
                _Walk.followed(evaluate, begin, side, RISE * scale, turning=False) for side in (-1.0, 1.0)
            ]
            along = begin.weakest / begin.size
            reach = max(np.max(np.abs((walk.met - begin.psi) @ along)) for walk in both)
            lacking = lacking + RISE * scale / reach**2 * np.outer(along, along)
    if not walks:
        return None
    bounded = all(walk.risen for walk in walks)
    lowest = min((walk.lowest for walk in walks), key=lambda point: point.cost)
    fall = walks[0].begin.cost - lowest.cost
    met = np.concatenate([walk.met for walk in walks])
    fall = fall if fall > 1e-3 * scale else 0.0  # what is lower by less is the same minimum
    lacking = lacking if bounded else np.zeros_like(lacking)
    return Valley(met.min(axis=0), met.max(axis=0), bounded, lowest.psi, fall, lacking)


def require_end(valley: Valley, names: Sequence[str], units: Sequence[str], psi: Real) -> None:
    """Raises IdentifiabilityError that names the unknowns which change along a valley without end at ψ (M,)."""
    change = (valley.high - valley.low) / np.maximum(np.abs(psi), 1e-300)
    moving = [j for j in np.argsort(-change, kind="stable") if change[j] > 0.1]
    if valley.bounded or not moving:
        return
    low = np.where(np.abs(valley.low) < 1e-3 * valley.high, 0.0, valley.low)
    ranges = ", ".join(f"{names[j]} from {low[j]:.3g} to {valley.high[j]:.3g} {units[j]}" for j in moving[:3])
    together = [name for j, name in enumerate(names) if j in moving]
    raise IdentifiabilityError(
        f"{joined(together)} cannot be determined: the fit is equally good for {ranges}",
        cure=f"{with_values(together)}, or add a sensor at another point",
    )


def may_lack_direction(information: Real) -> bool:
    """Whether information (M, M) is weak enough in some direction for a valley to be looked for."""
    sound = np.all(np.isfinite(information)) and np.all(information.diagonal() > 0)
    return bool(sound) and _least_eigenvalue(information) < WEAK


def _least_eigenvalue(information: Real) -> float:
    """The least eigenvalue of information (M, M) scaled to ones on its diagonal."""
    root = np.sqrt(information.diagonal())
    return float(np.linalg.eigvalsh(information / np.outer(root, root))[0])


@dataclass(frozen=True)
class _Point:
    """A point of the valley: ψ (M,), χ², the unknowns' sizes (M,), and the weakest direction in them, of length 1."""

    psi: Real
    cost: float
    size: Real
    weakest: Real
    eigenvalue: float
    information: Real

    @staticmethod
    def at(around: QuadraticModel, psi: Real, lacking: Real | float = 0.0) -> _Point | None:
        """From χ² around ψ and what its information lacks; None where it is not finite there."""
        A = around.symmetric[0] + lacking
        diagonal = A.diagonal()
        if not (np.all(np.isfinite(A)) and np.isfinite(around.cost[0]) and np.all(diagonal > 0)):
            return None
        size = np.maximum(np.abs(psi), 1 / np.sqrt(diagonal))
        scaled = A * np.outer(size, size)
        if not np.all(np.isfinite(scaled)):
            return None
        _, vectors = np.linalg.eigh(scaled)
        return _Point(psi, float(around.cost[0]), size, vectors[:, 0], _least_eigenvalue(A), A)

    def weak(self, scale: float) -> bool:
        """Whether the parabola leaves some unknown open along one direction: by five times its value."""
        if self.eigenvalue >= WEAK:
            return False
        curvature = self.weakest @ (self.information * np.outer(self.size, self.size)) @ self.weakest
        return bool(curvature * 5.0**2 < scale * np.max(np.abs(self.weakest)) ** 2)


class _Walk:
    """One way along the valley from `begin`, to where χ² lies `rise` above it; straight on unless `turning`.

    Steps are in sizes of the unknowns where they have led, for one may begin next to 0.
    """

    def __init__(self, evaluate: Evaluate, begin: _Point, side: float, rise: float, turning: bool) -> None:
        self.evaluate, self.begin, self.rise, self.turning = evaluate, begin, rise, turning
        self.point = self.lowest = begin
        self.direction = side * begin.weakest
        self.step = 1e-3
        self.met = begin.psi[None]

    @staticmethod
    @np.errstate(all="ignore")  # a valley without an end leads beyond all numbers
    def followed(
        evaluate: Evaluate, begin: _Point, side: float, rise: float, *, turning: bool = True
    ) -> _Walk:
        """The walk gone until χ² has risen, or as far as is looked."""
        walk = _Walk(evaluate, begin, side, rise, turning)
        for _ in range(80):  # at most
            if walk.risen or not walk.stepped():
                break
        return walk

    @property
    def risen(self) -> bool:
        """Whether χ² has risen so far."""
        return self.point.cost - self.begin.cost >= self.rise

    @property
    def size(self) -> Real:
        """The sizes of the unknowns in which steps count, (M,)."""
        return self.point.size if self.turning else self.begin.size

    def stepped(self) -> bool:
        """One step on along the chord of the last, short enough for χ² to rise gently; False where none is."""
        before = self.point
        while self.step > 1e-7:
            there = self._across(before.psi + self.step * self.size * self.direction)
            if there is not None and there.cost - before.cost <= self.rise / 4:
                if self.turning:
                    chord = (there.psi - before.psi) / there.size
                    self.direction = chord / np.linalg.norm(chord)
                self.point = there
                self.met = np.concatenate([self.met, there.psi[None]])
                self.lowest = min(self.lowest, there, key=lambda point: point.cost)
                self.step = min(2 * self.step, 0.25)
                return True
            self.step /= 4
        return False

    def _across(self, start: Real) -> _Point | None:
        """The bottom of the valley across the direction at `start` (M,); None where there is none."""
        size = self.size
        # An orthonormal basis of what is across: all right singular vectors but the first.
        across = np.linalg.svd(self.direction[None])[2][1:].T * size[:, None]

        def evaluate(x: Real, rows: Ints) -> QuadraticModel:
            at = self.evaluate(start + x @ across.T, rows)
            matrix = across.T @ at.symmetric @ across
            return QuadraticModel(at.cost, at.gradient @ across, matrix, matrix)

        bottom = minimise(evaluate, np.zeros((1, across.shape[1])), limit=20, tolerance=1e-3, patience=20)
        psi = start + across @ bottom.x[0]
        return _Point.at(self.evaluate(psi[None], np.zeros(1, dtype=np.int64)), psi)


# The modes of an estimate with their uncertainty.


def linear_modes(model: Model, theta: Real, covariance: Real) -> ModeValues | None:
    """Modes of the linear elements; None if nonlinear ones hold the rig together, and of no or many coordinates.

    theta (m,), covariance (m, m).
    """
    if not 0 < model.n <= 400:  # coordinates: the modes of larger rigs would take longer than all else
        return None
    try:
        return mode_values(model, theta, covariance)
    except ModelError:
        if not len(model.nonlinear):
            raise
        return None


def mode_values(model: Model, theta: Real, covariance: Real) -> ModeValues:
    """Modes at θ with standard deviations of frequency and damping propagated from its covariance.

    NaN where a standard deviation is lost in the rounding of terms that are far larger.
    theta (m,), covariance (m, m).
    """
    # Of up to 12 coordinates the kernel's eigenvalues take less time than LAPACK's.
    p = model.parameters(theta)
    damped = any(np.any(p[model.by_matrix[letter]]) for letter in ("C", "H"))
    compiled = kernel_function("mode_values") if model.n <= 12 and damped else None
    if compiled is not None:
        # None where masses are missing or coupled, or where nothing holds a motion.
        table = compiled(model.B, model.letters, model.T, model.p0, theta, covariance)
        if table is not None:
            return ModeValues(*table)
    of_rig = eigenmodes(model, p)
    with np.errstate(invalid="ignore"):  # the double zero of a free body has no slope
        slope = of_rig.sensitivity @ model.T
    return with_uncertainty(of_rig, slope, covariance)


@np.errstate(invalid="ignore")
def with_uncertainty(of_rig: Modes, slope: Complex, covariance: Real) -> ModeValues:
    """Modes whose eigenvalues move by `slope` (modes, m) with unknowns of this covariance (m, m)."""
    values = of_rig.eigenvalues
    size = np.abs(values)[:, None]
    size = np.where(size > 0, size, 1.0)
    grow = (values.conj()[:, None] * slope).real / size
    frequency = grow / (2 * np.pi)
    damping = -slope.real / size + values.real[:, None] * grow / size**2
    jacobian = np.stack([frequency, damping])
    jacobian[np.abs(jacobian) <= 1e-13 * np.abs(slope) / size] = 0.0  # no damper: its slope is rounding
    variance = ((jacobian @ covariance) * jacobian).sum(axis=-1)
    reach = np.abs(jacobian)
    terms = ((reach @ np.abs(covariance)) * reach).sum(axis=-1)
    lost = (variance <= 1e-13 * terms) & (terms > 0)  # the sum is rounding
    frequency_sd, damping_sd = np.sqrt(np.where(lost, np.nan, np.maximum(variance, 0.0)))
    return ModeValues(
        values, of_rig.frequency_hz, of_rig.damping_ratio, frequency_sd, damping_sd, of_rig.shapes
    )


ROUNDING = 1e-30  # χ² of exact data against noise of the data's own size


@dataclass(frozen=True)
class Linearised:
    """Information and residuals at an estimate, for K repeats and M unknowns.

    sums: cost, slope and information of all lines with the rows of the priors; by_line gives those of each line
    alone for chosen repeats.  rows: how many real equations the lines hold; precision (M,) of the priors.
    """

    unknowns: tuple[Unknown, ...]
    sums: QuadraticModel
    by_line: Callable[[Ints], tuple[Real, Real, Real]]
    rows: int
    precision: Real

    @cached_property
    def lines(self) -> tuple[Real, Real, Real]:
        """Information (K, lines, M, M), scores (K, lines, M) and cost (K, lines) of each line."""
        return self.by_line(np.arange(len(self.sums.cost)))

    def bands(self, repeats: Ints, frequency_hz: Real) -> BandStability:
        """What parts of the band know, of chosen repeats."""
        information, scores, _ = self.by_line(repeats)
        return band_stability(frequency_hz, information, scores, np.diag(self.precision))

    def with_curvature(self, curvature: Real) -> Linearised:
        """This with information (M, M) that no line alone has, spread evenly over them."""

        def by_line(repeats: Ints) -> tuple[Real, Real, Real]:
            information, scores, cost = self.by_line(repeats)
            return information + curvature / information.shape[1], scores, cost

        symmetric = self.sums.symmetric + curvature
        sums = replace(self.sums, symmetric=symmetric, free=symmetric)
        return replace(self, sums=sums, by_line=by_line)

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom of χ²."""
        return self.rows - len(self.unknowns) + int(np.count_nonzero(self.precision))


@dataclass(frozen=True)
class Uncertainty:
    """Covariances and fit of K repeats; see Estimate for the names.

    above: what χ² at the estimate lies above the minimum of its parabola, (K,), 0 where the method keeps off it
    bands: how parts of the band agree, where the noise is that of the residuals of whole records, else None
    in_time: what their noise in time makes of the estimates, likewise
    """

    covariance: Real
    noise: Real
    bound: Real
    dof: Real
    chi2: Real
    p: Real
    above: Real
    bands: BandStability | None = None
    in_time: CountedInTime | None = None


@dataclass(frozen=True)
class Inference:
    """A method's solution and how uncertain it is.

    most_likely   θ, (K, unknowns)
    unknowns      all that is estimated
    dof           degrees of freedom of χ²
    information   of all lines and priors, (K, M, M)
    valley        along which χ² stays low, of one repeat where information lacks a direction
    """

    method: Method
    solution: Solution
    most_likely: Real
    unknowns: tuple[Unknown, ...]
    dof: int
    uncertainty: Uncertainty
    information: Real
    valley: Valley | None = None


def inference(data: Prepared, solution: Solution, method: Method) -> Inference:
    """Uncertainty of what `method` found.

    χ² and bound are the model's, not the method's: they belong to the most likely parameters near θ.
    """
    best = most_likely(data, solution, method.traits)
    # What each line says of many lines and repeats is large, and held no longer than it is needed.
    around = linearise(data, best, method.traits)
    valley = None
    if method.traits.maximum_likelihood and solution.bounds is None and len(best.theta) == 1:
        solution, around, valley = _with_flat_valley(data, solution, around, method.traits)
        best = solution
    worth = uncertainty(data, best, around, method.traits)
    if method.traits.maximum_likelihood:
        # What runs off to infinity takes steps below its deviations, too, and is nowhere near a minimum.
        least = np.maximum(worth.chi2 / max(around.dof, 1), 1.0 if data.noise_known else 0.0)
        settled = worth.above <= 0.1 * least  # of χ², above the minimum of its parabola
        if not settled.all():
            solution = replace(solution, converged=solution.converged & settled)
    if worth.in_time is not None:
        solution = replace(solution, theta=solution.theta + worth.in_time.step)
    of = around.unknowns, around.dof
    return Inference(method, solution, best.theta, *of, worth, around.sums.symmetric, valley)


def _with_flat_valley(
    data: Prepared, solution: Solution, around: Linearised, traits: Traits
) -> tuple[Solution, Linearised, Valley | None]:
    """The bottom of a valley whose information lacks a direction, and the curvature that χ² has along it."""
    view, sign = data.view, data.spectrum.signs(solution.signs, 1)
    valley = None
    for _ in range(3):  # descents into valleys whose bottom is not where the descent ended
        if not may_lack_direction(around.sums.symmetric[0]):
            valley = None
            break
        exact = measured(data)
        scale = 1.0 if data.noise_known else float(around.sums.cost[0]) / max(around.dof, 1)
        valley = flat_valley(view, exact, solution.theta, sign, scale)
        if valley is None or not valley.bounded or valley.fall == 0:
            break
        first, lowest = np.zeros(1, dtype=np.int64), valley.lowest[None]
        end = Stage(view, exact).descend(lowest, sign, first, limit=ROUGH, tolerance=NEAR_END)
        solution = replace(solution, theta=end.x)
        around = linearise(data, solution, traits)
    if valley is None or not valley.bounded:
        return solution, around, valley
    around = around.with_curvature(valley.curvature)
    solution = replace(solution, covariance=around.sums.inverse, converged=np.array([valley.fall == 0]))
    return solution, around, valley


def with_noise_of_residuals(data: Prepared, method: Method) -> Prepared:
    """The noise scaled until χ² is its degrees of freedom: priors weigh against noise of the right size only."""
    for held in (True, False, False):
        trial = data.without_priors() if held else data
        if not trial.view.names:
            continue
        best = most_likely(trial, method.solve(trial), method.traits)
        around = linearise(trial, best, method.traits)
        data = data.scaled(np.maximum(around.sums.cost, ROUNDING) / max(around.dof, 1))
    return data


def most_likely(data: Prepared, solution: Solution, traits: Traits) -> Solution:
    """The solution with the most likely parameters near it."""
    if traits.maximum_likelihood:
        return solution
    if len(data.model.nonlinear):
        best = MaximumLikelihood().solve(data)
        return replace(solution, theta=best.theta, responses=best.responses)
    return replace(solution, theta=likeliest(data, solution.theta))


def linearise(data: Prepared, solution: Solution, traits: Traits) -> Linearised:
    """Residuals and information in the channels (by output) or in the equation of motion, where all is seen.

    Both say the same where all channels are direct; only the channels know of calibrations, of force channels and of
    nonlinear elements.
    """
    by_output = traits.by_output or len(data.model.nonlinear)
    return _of_channels(data, solution) if by_output else _of_equation(data, solution)


def _of_channels(data: Prepared, solution: Solution) -> Linearised:
    view, exact = data.view, measured(data)
    if isinstance(solution.responses, NonlinearPart):
        exact = replace(exact, nonlinear=solution.responses)
    sign = data.spectrum.signs(solution.signs, len(exact.y))
    lines = per_line(view, exact, solution.theta, sign)
    rows = exact.rows - nuisance_columns(view, exact, solution.theta, sign)
    precision = view.prior_precision
    sums = sums_of_lines(*lines, solution.theta, precision, view.prior_mean)

    def by_line(repeats: Ints) -> tuple[Real, Real, Real]:
        if np.array_equal(repeats, np.arange(len(lines[0]))):
            return lines
        information, scores, cost = lines
        return information[repeats], scores[repeats], cost[repeats]

    return Linearised(view.unknowns, sums, by_line, rows, precision)


def _of_equation(data: Prepared, solution: Solution) -> Linearised:
    model, states, theta = data.model, data.seen_states, solution.theta

    def by_line(repeats: Ints) -> tuple[Real, Real, Real]:
        chosen = states if len(repeats) == len(theta) else states.rows(repeats)
        return equation_by_line(model, chosen, theta[repeats])

    rows = 2 * model.n * data.spectrum.lines
    return Linearised(
        model.unknowns, equation_sums(model, states, theta), by_line, rows, model.prior_precision
    )


@np.errstate(all="ignore")  # what the data know nothing of is infinite
def uncertainty(data: Prepared, solution: Solution, around: Linearised, traits: Traits) -> Uncertainty:
    """Covariance, bound and χ².

    `solution` and `around` are to be those of the most likely parameters, to which one Gauss-Newton step leads, with
    the covariance of the method.  Where the noise is unknown, χ² supplies its size; where it was estimated, weights and
    intervals pay for that; where the model does not fit, the covariance grows by χ²/dof, or to the scatter over parts
    of the band where that is larger; in whole records whose residuals tell the noise, where the parts disagree.  Where
    bounds hold unknowns, χ² is that of the values held.
    """
    sums = around.sums
    excess = np.zeros(len(sums.cost)) if traits.definite else _excess(sums, solution)
    dof = around.dof
    usable = float(max(dof, 1))
    if not data.noise_known:
        chi2 = np.maximum(sums.cost - excess, 0.0)
        scale = np.maximum(chi2, ROUNDING) / usable
        covariance, prior = solution.covariance * scale[:, None, None], np.diag(around.precision)
        bound = scaled_inverse((sums.symmetric - prior) / scale[:, None, None] + prior)
        nothing, degrees = np.full(len(chi2), np.nan), np.full(solution.theta.shape, usable)
        if FITTED in data.spectrum.noise and traits.weighted:
            grown, degrees = doubts_of_weights(data, solution)
            covariance = covariance + grown * scale[:, None, None]
        return Uncertainty(
            covariance, covariance, bound, degrees, np.full(len(chi2), usable), nothing, excess
        )
    bread = sums.inverse
    chi2, bound, noise = np.maximum(sums.cost - excess, 0.0), bread, bread
    degrees = np.full(solution.theta.shape, np.inf)
    if not data.spectrum.noise_given:  # weights and intervals pay for noise that was estimated
        quality = noise_quality(data.spectrum, data.correlated)
        (information, _, cost), prior = around.lines, np.diag(around.precision)
        penalty = sums.cost - np.sum(cost, axis=-1)
        less = excess * np.mean(quality.shrink, axis=-1)
        chi2 = np.maximum(np.sum(cost * quality.shrink, axis=-1) + penalty - less, 0.0)
        if not np.all(quality.shrink == 1):
            shrink = np.broadcast_to(quality.shrink, cost.shape)
            bound = scaled_inverse(np.einsum("klij,kl->kij", information, shrink) + prior)
        noise, degrees = _noise(information, quality, bread, prior)
    p = _p_value(chi2, dof, around.rows, data.spectrum)
    if not traits.weighted:
        noise = solution.covariance
    if RESIDUAL in data.spectrum.noise and traits.weighted:
        in_time = counted_in_time(data, solution, sums, noise, bound, degrees)
        bands = around.bands(np.arange(len(chi2)), data.spectrum.frequency_hz).in_noise(in_time.louder)
        noise, bound = in_time.covariance, in_time.bound
        covariance, degrees = bands.widened(noise, in_time.dof, bands.disagree)
        return Uncertainty(covariance, noise, bound, degrees, chi2, p, excess, bands, in_time)
    (misfit,) = ((p < LEVEL) & (chi2 > dof)).nonzero()
    covariance = noise
    if len(misfit):
        covariance = noise.copy()
        wide = noise[misfit] * (chi2[misfit] / usable)[:, None, None]
        few = np.minimum(degrees[misfit], usable)
        bands = around.bands(misfit, data.spectrum.frequency_hz)
        covariance[misfit], degrees[misfit] = bands.widened(wide, few, np.ones(len(misfit), dtype=bool))
    return Uncertainty(covariance, noise, bound, degrees, chi2, p, excess)


def _excess(sums: QuadraticModel, solution: Solution) -> Real:
    """What χ² at θ lies above its minimum, (K,), unknowns held at a bound staying there."""
    gradient = sums.gradient
    if solution.bounds is None:
        step = np.matvec(sums.inverse, gradient)
    else:
        held = (solution.theta <= solution.bounds.lower) | (solution.theta >= solution.bounds.upper)
        gradient = np.where(held, 0.0, gradient)
        apart = (held[:, :, None] | held[:, None, :]) & ~np.eye(held.shape[-1], dtype=bool)
        step = solve_scaled(np.where(apart, 0.0, sums.symmetric), gradient)
    return (gradient * step).sum(axis=-1)


def _noise(information: Real, quality: NoiseQuality, bread: Real, prior: Real) -> tuple[Real, Real]:
    """Covariance of a weighted estimate, the noise having been estimated, and the degrees of freedom behind it."""
    stated = bread @ prior @ bread
    core = kernel()
    if core is not None:
        summed, shared = core.line_shares(
            np.ascontiguousarray(information),
            np.ascontiguousarray(np.atleast_2d(quality.inflation)),
            bread,
            threads(),
        )
        degrees = interval_dof(shared, quality.dof, np.diagonal(stated, axis1=-2, axis2=-1))
        return bread @ summed @ bread + stated, degrees
    each = bread[:, None]
    shares = each @ (information * quality.inflation[..., None, None]) @ each
    exact = np.diagonal(stated, axis1=-2, axis2=-1)
    degrees = interval_dof(np.diagonal(shares, axis1=-2, axis2=-1), quality.dof, exact)
    return np.sum(shares, axis=-3) + stated, degrees


def _p_value(chi2: Real, dof: int, rows: int, spectrum: Spectrum) -> Real:
    """Tail probability of χ², widened where the noise was estimated.

    With an estimated covariance a line's quadratic form is a Lawley-Hotelling trace; mean and variance of their sum
    are matched by a scaled χ².
    """
    if dof <= 0 or RESIDUAL in spectrum.noise:  # noise sized by these very residuals tests nothing
        return np.full(len(chi2), np.nan)
    if spectrum.noise_given:
        return np.asarray(chdtrc(float(dof), chi2), dtype=float)
    nu, n = spectrum.dof, rows / (2 * spectrum.lines)
    with np.errstate(invalid="ignore", divide="ignore"):
        wide = (nu - 1) * (nu - n + 1) / ((nu - n) * (nu - n - 3))
    wide = np.where(np.isfinite(nu), np.where(nu - n - 3 > 0, wide, np.nan), 1.0)
    ratio = float(np.nanmean(wide)) if np.any(np.isfinite(wide)) else 1.0
    return np.asarray(chdtrc(dof / ratio, chi2 / ratio), dtype=float)
