"""The equation of motion in the compiled kernel: twins of `starts`, `equation_by_line`, `_sums` and `search`."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.preparation.state_reconstruction import States
from dashpot.model.kernel_rig import kernel_rig
from dashpot.model.network import Model
from dashpot.model.observation import small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult, QuadraticModel


def compiled_equation(model: Model, states: States) -> Any | None:
    """The kernel's view of the measured states, None where NumPy is to do the work or must."""
    core = kernel()
    if core is None or not small(model) or not model.n or not len(states.omega):
        return None
    if not hasattr(core.Equation, "search"):  # kernels before 0.2.1
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


def compiled_lines(equation: Any, theta: Real) -> tuple[Real, Real, Real]:
    """Information, scores and cost of each line at θ (K, unknowns)."""
    information, scores, cost = equation.lines(np.ascontiguousarray(theta), threads())
    return information, scores, cost


def compiled_sums(model: Model, states: States, theta: Real) -> QuadraticModel | None:
    """Cost, slope and information of all lines at θ (K, unknowns), None as above; those of the last θ are kept."""
    kept = states.compiled.get("sums")
    if kept is None or kept[0] is not model or kept[1] is not theta:
        equation = compiled_equation(model, states)
        if equation is None:
            return None
        sums = equation.evaluate(np.ascontiguousarray(theta), np.arange(len(theta)), threads())
        kept = model, theta, QuadraticModel(*sums)
        states.compiled["sums"] = kept
    local: QuadraticModel = kept[2]
    return local


def compiled_search(
    equation: Any,
    model: Model,
    states: States,
    start: Real,
    repeats: Ints,
    far: float,
    limit: int,
    tolerance: float,
) -> OptimizeResult:
    """Minimise Σ eᴴ Ω(θ) e for some of the repeats, `start` being (K, unknowns) of all of them.

    What runs off to `far` times the largest start has not converged.  Sums at the ends are kept where they are of all.
    """
    ends, sums = equation.search(start, repeats, far, limit, tolerance, PATIENCE, threads())
    result = compiled_result(ends)
    if len(repeats) == len(start):
        states.compiled["sums"] = model, result.x, QuadraticModel(*sums)
    return result


def compiled_result(ends: tuple[Any, ...]) -> OptimizeResult:
    """What a descent of the kernel returns, as `minimise` does."""
    x, cost, converged, iterations, history, rows = ends
    return OptimizeResult(x, cost, converged, iterations, history[:rows])
