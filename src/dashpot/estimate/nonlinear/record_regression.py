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
from dashpot.estimate.nonlinear.records import RecordData, measured_coordinates
from dashpot.estimate.nonlinear.starting_values import constants_to_try, refined_constants
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_scaled

CYCLES = (0, 1, 2, 3, 4, 5, 6)  # of a window: which part of the band it sees
WIDTH = 64  # samples of a window, about; each half overlaps the next


@dataclass(frozen=True)
class WeakForm:
    """Weak equations of one record: elongations and rates (samples, elements), windows and their derivatives.

    f (samples, n): forces of the force inputs on the coordinates.
    """

    model: Model
    elongation: Real
    rate: Real
    f: Real
    windows: tuple[Real, Real, Real]
    first: Ints

    def unit_forces(self, constants: Real) -> Real:
        """Unit forces of the nonlinear elements in the measured motion, (samples, e), for constants (G,)."""
        model, chosen = self.model, self.model.nonlinear
        d, v = self.elongation[:, chosen], self.rate[:, chosen]
        unit = np.empty_like(d)
        for row, (index, inner) in enumerate(zip(chosen, model.constant_slices, strict=True)):
            law = model.elements[int(index)].force_law
            assert law is not None
            unit[:, row] = law(d[:, row], v[:, row], d[:, row], constants[inner]).value
        return unit

    def of(self, signal: Real, derivative: int) -> Real:
        """∫ w s^(derivative) of signals (samples, k), by parts; (windows, k)."""
        w = self.windows[derivative] * (-1.0) ** derivative
        length = w.shape[1]
        pieces = np.stack([signal[k : k + length] for k in self.first.tolist()])
        rows: Real = np.einsum("wt,ptk->pwk", w, pieces).reshape(-1, signal.shape[1])
        return rows


def weak_form(model: Model, step_s: float, x: Real, u: Real, f: Real) -> WeakForm:
    """x (samples, n), u (samples, r) m and the force inputs f (samples, s) N of one record."""
    from scipy.interpolate import CubicSpline  # with it comes all of scipy.optimize

    d = x @ model.B.T + u @ model.D.T
    time = step_s * np.arange(len(x))
    rate = CubicSpline(time, d, axis=0)(time, 1)
    length = min(WIDTH, len(x))
    s = np.linspace(0, 1, length)
    span = step_s * (length - 1)
    shapes = []
    for cycles in CYCLES:
        for turn in (np.cos, np.sin) if cycles else (np.cos,):
            spline = CubicSpline(s, np.sin(np.pi * s) ** 4 * turn(2 * np.pi * cycles * s))
            shapes.append([spline(s), spline(s, 1) / span, spline(s, 2) / span**2])
    windows = tuple(np.array([shape[k] for shape in shapes]) for k in range(3))
    first = np.arange(0, len(x) - length + 1, max(length // 2, 1))
    return WeakForm(model, d, rate, f @ model.S.T, (windows[0], windows[1], windows[2]), first)


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
        model, form = self.form.model, self.form
        columns = np.zeros((len(form.first) * len(form.windows[0]), len(model.elements)))
        columns[:, model.nonlinear] = form.of(form.unit_forces(constants), 0)
        known = columns @ (model.p0[:, None] * model.B)  # (rows, n)
        along = np.concatenate([(columns * model.B[:, i]) @ model.T[:, self.free] for i in range(model.n)])
        A = self.linear.copy()
        A[:, : along.shape[1]] += along
        b = self.right - known.T.ravel()
        theta = solve_scaled(A.T @ A, A.T @ b)
        left = b - A @ theta
        return theta[: along.shape[1]], float(left @ left)


def weak_equations(form: WeakForm) -> WeakEquations:
    """The equations of motion of all coordinates, one below the other."""
    model = form.model
    columns = np.zeros((len(form.first) * len(form.windows[0]), len(model.elements)))
    for i, element in enumerate(model.elements):
        if element.force_law is None:
            columns[:, i] = form.of(form.elongation[:, i : i + 1], element.law.power)[:, 0]
    free = np.any(model.T, axis=0)
    right = form.of(form.f, 0) - columns @ (model.p0[:, None] * model.B)  # (rows, n)
    constant = form.of(np.ones((len(form.f), 1)), 0)  # a force that stands still is free, where forces act
    push = np.any(model.S, axis=1)
    A = []
    for i in range(model.n):
        offset = np.zeros((len(columns), model.n))
        offset[:, i] = constant[:, 0] * push[i]
        A.append(np.concatenate([(columns * model.B[:, i]) @ model.T[:, free], offset[:, push]], axis=1))
    return WeakEquations(form, np.concatenate(A), right.T.ravel(), free)


def first_record_values(model: Model, records: tuple[RecordData, ...]) -> Real:
    """Guesses where all are given; else the weak form of the equation where all coordinates are measured.

    (unknowns,).  Raises DataError where the motion does not determine them.
    """
    given = [u.prior if u.prior is not None else u.guess for u in model.unknowns]
    open_names = [u.name for u, value in zip(model.unknowns, given, strict=True) if value is None]
    if not open_names:
        return np.array(given, dtype=float)
    x = _measured_motion(model, records[0], open_names)
    record, r = records[0], model.D.shape[1]
    equations = weak_equations(weak_form(model, record.step_s, x, record.inputs[:, :r], record.inputs[:, r:]))
    constants, p = _best_constants(equations)
    slope, known = model.constants_map
    theta = (constants - known) @ slope
    theta[equations.free] = p
    if not np.all(np.isfinite(theta)):
        raise DataError(
            "the motion does not determine the unknowns", record.source, "give guesses in the rig file"
        )
    low, high = model.bounds
    return np.clip(np.where(model.prior_precision > 0, model.prior_mean, theta), low, high)


def _best_constants(equations: WeakEquations) -> tuple[Real, Real]:
    """Inner constants (G,) of the least residual, near the best of a grid, and the parameters that go with them."""
    form, model = equations.form, equations.form.model
    chosen = model.nonlinear
    elongation, speed = (np.max(np.abs(motion[:, chosen]), axis=0) for motion in (form.elongation, form.rate))

    def residual(constants: Real) -> float:
        p, left = equations.fitted(constants)
        return left if np.all(np.isfinite(p)) else np.inf

    constants = refined_constants(
        model, min(constants_to_try(model, elongation, speed), key=residual), residual
    )
    return constants, equations.fitted(constants)[0]


def _measured_motion(model: Model, record: RecordData, open_names: Sequence[str]) -> Real:
    """The coordinates, (samples, n).  Raises DataError where these do not give first values of the unknowns."""
    x = measured_coordinates(model, record)
    if x is None or any(e.force_law is not None and e.force_law.has_state for e in model.elements):
        why = "not all coordinates are measured as displacements" if x is None else "a law has a state"
        raise DataError(
            f"{', '.join(open_names)} {'has' if len(open_names) == 1 else 'have'} no guess, and {why}",
            cure="write guess = … for the unknowns in the rig file",
        )
    return x
