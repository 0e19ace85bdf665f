"""The equation of motion in the compiled kernel: twins of `starts`, `equation_by_line` and `search`."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.kernel_rig import kernel_rig
from dashpot.model.network import Model
from dashpot.model.observation import small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult


def compiled_equation(model: Model, states: States) -> Any | None:
    """The kernel's view of the measured states, None where NumPy is to do the work or must."""
    core = kernel()
    if core is None or not small(model) or not model.n or not len(states.omega):
        return None
    key = (id(core), id(model))
    if key not in states.compiled:
        rig = kernel_rig(core, model, states.omega)
        equation = None
        if rig is not None:
            z, V = np.ascontiguousarray(states.z), np.ascontiguousarray(states.covariance)
            equation = core.Equation(rig, z, V)
        states.compiled.clear()
        states.compiled[key] = (equation, model)  # the model is kept, so that its id stays its own
    return states.compiled[key][0]


def compiled_lines(equation: Any, states: States, theta: Real) -> tuple[Real, Real, Real]:
    """Information, scores and cost of each line at θ (K, unknowns); those of the last θ are kept."""
    kept = states.compiled.get("lines")
    if kept is None or kept[0] is not equation or not np.array_equal(kept[1], theta):
        kept = equation, theta.copy(), equation.lines(np.ascontiguousarray(theta), threads())
        states.compiled["lines"] = kept
    information, scores, cost = kept[2]
    return information, scores, cost


def compiled_search(
    equation: Any, start: Real, repeats: Ints, limit: int, tolerance: float, lower: Real, upper: Real
) -> OptimizeResult:
    """Minimise Σ eᴴ Ω(θ) e from `start` (k, unknowns) for some of the repeats."""
    return compiled_result(
        equation.descend(
            np.ascontiguousarray(start), np.ascontiguousarray(repeats), lower, upper, np.full(start.shape[-1], np.inf),
            limit, tolerance, PATIENCE, threads(),
        )
    )  # fmt: skip


def compiled_result(ends: tuple[Any, ...]) -> OptimizeResult:
    """What a descent of the kernel returns, as `minimise` does."""
    x, cost, converged, iterations, history, rows = ends
    return OptimizeResult(x, cost, converged, iterations, history[:rows])
