"""The equation of motion in the compiled kernel: twins of `starts`, `by_line` and `search`."""

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
    rig = kernel_rig(core, model, states.omega)
    if rig is None:
        return None
    return core.Equation(rig, np.ascontiguousarray(states.z), np.ascontiguousarray(states.covariance))


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
