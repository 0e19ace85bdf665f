"""First values of a nonlinear rig from a whole record whose coordinates are all measured: the equation's weak form.

∫ w (M ẍ + C ẋ + K x + Bᵀ p∘a) dt = ∫ w f dt for smooth windows w that vanish at their ends: the derivatives of masses
and dampers are moved to w, so the measured motion is not differentiated but for laws of the rate (Shinbrot 1957).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.errors import DataError
from dashpot.estimate.inference.diagnostics import require_traces
from dashpot.estimate.nonlinear.records import RecordData, RecordedMotion, recorded_motion
from dashpot.estimate.nonlinear.regression import require_finite_laws
from dashpot.estimate.nonlinear.search import KEPT, constants_to_try, refined_constants, theta_of
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states, rated_states
from dashpot.numerics.small_systems import solve_scaled


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
        model, chosen = self.model, self.model.nonlinear
        d, v = self.elongation[:, chosen], self.rate[:, chosen]
        unit = np.empty_like(d)
        for row, (law, inner) in enumerate(zip(model.laws, model.constant_slices, strict=True)):
            g = constants[inner]
            z = d[:, row]
            if law.operator:
                z = operated_states(law, z, g)
            elif law.rate is not None:
                z = rated_states(law, z, v[:, row], self.step_s, g)
            unit[:, row] = law(d[:, row], v[:, row], z, g).value
        return unit

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
        w = self.windows[derivative] * (-1.0) ** derivative
        length = w.shape[1]
        pieces = np.stack([signal[k : k + length] for k in self.first.tolist()])
        return np.einsum("wt,ptk->pwk", w, pieces).reshape(-1, signal.shape[1])


def weak_form(model: Model, data: RecordData, at: RecordedMotion) -> WeakForm:
    """Of a record whose coordinates are all measured."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    d = at.x @ model.B.T + at.u @ model.D.T
    time = data.step_s * np.arange(len(d))
    rate = CubicSpline(time, d, axis=0)(time, 1)
    length = min(64, len(d))  # samples of a window; each half overlaps the next
    s = np.linspace(0, 1, length)
    span = data.step_s * (length - 1)
    # sin⁴(π s) times a cosine or a sine of 0 to 6 cycles, which chooses a part of the band: sums of waves, whose
    # derivatives are exact
    cycles, own = np.arange(7)[:, None], np.array([1, -4, 6, -4, 1]) / 16
    waves = 2j * np.pi * (cycles + np.arange(-2, 3))
    both = [
        np.einsum("cj,cjt->ct", own * (waves / span) ** k, np.exp(waves[..., None] * s)) for k in range(3)
    ]
    windows = tuple(np.concatenate([each.real, each.imag[1:]]) for each in both)
    first = np.arange(0, len(d) - length + 1, max(length // 2, 1))
    r = model.D.shape[1] - len(data.bases.names)
    shown = [c for c in range(len(data.names)) if data.gain[c] < 0 and np.any(data.force[c])]
    balance = np.concatenate([model.B.T, data.force[shown][:, : len(model.elements)]])
    f = np.hstack([data.inputs[:, r : r + len(model.force_inputs)] @ model.S.T, data.outputs[:, shown]])
    still = np.append(np.any(model.S, axis=1), np.array(data.drift, dtype=bool)[shown])
    form = (model, data.step_s, d, rate, balance, f, still)
    return WeakForm(*form, (windows[0], windows[1], windows[2]), first)


@dataclass(frozen=True)
class WeakEquations:
    """A (equations, unknowns of elements and constant forces) θ = b without the nonlinear elements; free: which θ."""

    form: WeakForm
    linear: Real
    right: Real
    free: Bools

    def fitted(self, constants: Real) -> tuple[Real, float]:
        """(unknown parameters, squared residual) of least squares at given inner constants (G,).

        The residual is not measured by the size of the terms: they cancel where constants are far off.
        """
        A, b = self._with_laws(constants)
        theta = solve_scaled(A.T @ A, A.T @ b)
        left = b - A @ theta
        return theta[: int(np.sum(self.free))], float(left @ left)

    def left_over(self, constants: Real) -> Real:
        """What least squares leave of each equation at given inner constants (G,)."""
        A, b = self._with_laws(constants)
        size = np.linalg.norm(A, axis=0)
        scaled = A / np.where(size > 0, size, 1.0)
        return b - scaled @ np.linalg.lstsq(scaled, b, rcond=None)[0]

    def without_laws(self, constants: Real) -> tuple[Real, float]:
        """(unknown parameters, squared residual) without the nonlinear elements, whose forces are then 1 %."""
        model = self.form.model
        A, b = self._with_laws(constants)
        nonlinear = np.flatnonzero(np.any(model.T[model.nonlinear], axis=0)[self.free])
        rest = np.delete(np.arange(A.shape[1]), nonlinear)
        theta = np.zeros(A.shape[1])
        theta[rest] = solve_scaled(A[:, rest].T @ A[:, rest], A[:, rest].T @ b)
        left = b - A @ theta
        size = np.sqrt(np.sum(A[:, nonlinear] ** 2, axis=0))
        theta[nonlinear] = 0.01 * np.sqrt(b @ b) / np.where(size > 0, size, 1.0)
        return theta[: int(np.sum(self.free))], float(left @ left)

    def _with_laws(self, constants: Real) -> tuple[Real, Real]:
        """A and b with the nonlinear elements, at given inner constants (G,)."""
        model, form = self.form.model, self.form
        columns = np.zeros((len(form.first) * len(form.windows[0]), len(model.elements)))
        columns[:, model.nonlinear] = form.of(form.unit_forces(constants), 0)
        known = columns @ (model.p0 * form.balance).T  # (rows, equations)
        along = np.concatenate([(columns * row) @ model.T[:, self.free] for row in form.balance])
        A = self.linear.copy()
        A[:, : along.shape[1]] += along
        return A, self.right - known.T.ravel()


def weak_equations(form: WeakForm) -> WeakEquations:
    """All equations, one below the other."""
    model = form.model
    columns = np.zeros((len(form.first) * len(form.windows[0]), len(model.elements)))
    for i, element in enumerate(model.elements):
        if element.force_law is None:
            columns[:, i] = form.of(form.elongation[:, i : i + 1], element.law.power)[:, 0]
    free = np.any(model.T, axis=0)
    right = form.of(form.f, 0) - columns @ (model.p0 * form.balance).T  # (rows, equations)
    constant = form.of(np.ones((len(form.f), 1)), 0)
    A = []
    for i, row in enumerate(form.balance):
        offset = np.zeros((len(columns), len(form.still)))
        offset[:, i] = constant[:, 0] * form.still[i]
        A.append(np.concatenate([(columns * row) @ model.T[:, free], offset[:, form.still]], axis=1))
    return WeakEquations(form, np.concatenate(A), right.T.ravel(), free)


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
    information = equations.form.information(valleys[0])[np.ix_(free, free)]
    information += np.diag(1.0 * (model.prior_precision[free] > 0))
    names = [name for name, there in zip(model.unknown_names, free, strict=True) if there]
    # A combination of columns of size 1 whose singular value is below 1e-6 leaves no trace in the motion.
    require_traces(model, names, information, 1e-6**2)
    found = [(constants, equations.fitted(constants)[0]) for constants in valleys]
    starts = [theta_of(model, constants, p) for constants, p in found if np.all(np.isfinite(p))]
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
    constants = _valleys(equations)[0]
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
    return weak_equations(weak_form(model, record, at))


def _valleys(equations: WeakEquations) -> list[Real]:
    """Inner constants (G,) of the least residual in each valley near the best of a grid, the deepest first.

    Noise in the columns fills valleys, so that the deepest need not be the likeliest; what leaves twice the least or
    more is none.
    """
    form, model = equations.form, equations.form.model
    chosen = model.nonlinear
    elongation, speed = (np.max(np.abs(motion[:, chosen]), axis=0) for motion in (form.elongation, form.rate))
    grid = np.array(constants_to_try(model, elongation, speed))

    def residual(constants: Real) -> float:
        p, left = equations.fitted(constants)
        return left if np.all(np.isfinite(p)) else np.inf

    starts = sorted(grid, key=residual)[:KEPT]
    ends = [_polished(equations, refined_constants(model, start, residual)) for start in starts]
    left = np.array([residual(end) for end in ends])
    valleys: list[Real] = []
    for k in np.argsort(left, kind="stable"):
        apart = all(np.any(np.abs(ends[k] - other) > 0.1 * np.abs(other)) for other in valleys)
        if not valleys or (apart and left[k] < 2 * np.min(left)):
            valleys.append(ends[k])
    return valleys


def _polished(equations: WeakEquations, start: Real) -> Real:
    """Inner constants (G,) of less residual near the start: several that share a valley are moved together.

    Gauss and Newton with the parameters at their best for each (variable projection, Golub and Pereyra 1973).
    """
    from scipy.optimize import least_squares

    model = equations.form.model
    open_ones = [j for j, (_, c) in enumerate(model.constants) if c.unknown and c.guess is None and start[j]]
    if len(open_ones) < 2:
        return start

    def moved(nepers: Real) -> Real:
        constants = start.copy()
        constants[open_ones] *= np.exp(nepers)
        return constants

    def left_over(nepers: Real) -> Real:
        return equations.left_over(moved(nepers))

    with np.errstate(all="ignore"):
        try:
            end = least_squares(left_over, np.zeros(len(open_ones)))
        except (ValueError, np.linalg.LinAlgError):  # no number, somewhere on the way
            return start
    better = equations.fitted(moved(end.x))[1] < equations.fitted(start)[1]
    return moved(end.x) if better else start
