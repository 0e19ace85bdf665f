"""First values of a nonlinear rig from a whole record whose coordinates are all measured: the equation's weak form.

∫ w (M ẍ + C ẋ + K x + Bᵀ p∘a) dt = ∫ w f dt for smooth windows w that vanish at their ends: the derivatives of masses
and dampers are moved to w, so the measured motion is not differentiated but for laws of the rate (Shinbrot 1957).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from dashpot.arrays import Ints, Real
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

    def of(self, signal: Real, derivative: int) -> Real:
        """∫ w s^(derivative) of signals (samples, k), by parts; (windows, k)."""
        w = self.windows[derivative] * (-1.0) ** derivative
        length = w.shape[1]
        pieces = np.stack([signal[k : k + length] for k in self.first.tolist()])
        rows: Real = np.einsum("wt,ptk->pwk", w, pieces).reshape(-1, signal.shape[1])
        return rows


def weak_form(model: Model, step_s: float, x: Real, u: Real, f: Real) -> WeakForm:
    """x (samples, n), u (samples, r) m and the force inputs f (samples, s) N of one record."""
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


def fitted(form: WeakForm, unit: Real) -> tuple[Real, float]:
    """(unknown parameters, relative residual) for the nonlinear elements' unit forces (samples, e)."""
    model = form.model
    columns = np.zeros((len(form.first) * len(form.windows[0]), len(model.elements)))
    for i, element in enumerate(model.elements):
        if element.force_law is None:
            columns[:, i] = form.of(form.elongation[:, i : i + 1], element.law.power)[:, 0]
    columns[:, model.nonlinear] = form.of(unit, 0)
    free = np.any(model.T, axis=0)
    right = form.of(form.f, 0)  # (rows, n)
    known = columns * model.p0
    constant = form.of(np.ones((len(form.f), 1)), 0)  # a force that stands still is free, where forces act
    push = np.any(model.S, axis=1)
    A, b = [], []
    for i in range(model.n):
        offset = np.zeros((len(columns), model.n))
        offset[:, i] = constant[:, 0] * push[i]
        A.append(np.concatenate([(columns * model.B[:, i]) @ model.T[:, free], offset[:, push]], axis=1))
        b.append(right[:, i] - known @ model.B[:, i])
    A_all, b_all = np.concatenate(A), np.concatenate(b)
    theta = solve_scaled(A_all.T @ A_all, A_all.T @ b_all)
    left = b_all - A_all @ theta
    size = float(b_all @ b_all) + float(np.sum((A_all * theta) ** 2))
    return theta[: int(np.sum(free))], float(left @ left) / size if size > 0 else np.inf
