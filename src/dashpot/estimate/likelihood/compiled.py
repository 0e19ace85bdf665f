"""The likelihood in the compiled kernel: twins of `local` and `per_line`, and of the descent of a `Stage`."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.model.dynamics import kernel_rig
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.kernel import kernel, threads
from dashpot.numerics.levenberg_marquardt import QuadraticModel


def compiled_output(view: ObservationModel, data: Measured) -> Any | None:
    """The kernel's view of the channels, made once for each `data`; None where NumPy is to do the work or must.

    This part of the kernel knows small linear rigs; nonlinear ones (`nonlinear/objective.py`) and whole records
    (`record_sums.py`) have parts of their own.
    """
    core = kernel()
    if core is None or data.ends is not None or data.nonlinear is not None or not small(view.model):
        return None
    cache = data.compiled
    key = (id(core), id(view))
    if key not in cache:
        cache.clear()
        output, rig = (
            None,
            kernel_rig(core, view.model, view.omega) if view.model.n and len(view.omega) else None,
        )
        if rig is not None:
            q = None if data.q is None else np.ascontiguousarray(data.q)
            measured = np.ascontiguousarray(data.y), np.ascontiguousarray(data.W), q
            output = core.Output(rig, *measured, *kernel_channels(view))
        cache[key] = output, view
    return cache[key][0]


def kernel_channels(view: ObservationModel) -> tuple[Any, ...]:
    """What the channels show and the priors of ψ, in the kernel's order."""
    shown = view.derivative, view.on_x, view.on_q, view.force, view.gain, view.delay
    return *shown, bool(np.any(view.flips)), view.prior_precision, view.prior_mean


def compiled_local(
    output: Any, psi: Real, sign: Real, rows: Ints, weight: Real | None = None
) -> QuadraticModel:
    """Cost, slope and curvature at ψ (K, M) in the data of `rows`; of logarithms where they have a `weight`."""
    cost, gradient, information = output.evaluate(
        _numbers(psi), _numbers(sign), rows, weight, True, threads()
    )
    return QuadraticModel(cost, gradient, information, information)


def compiled_cost(output: Any, psi: Real, sign: Real, rows: Ints, weight: Real | None = None) -> Real:
    """The cost alone, (K,)."""
    return output.evaluate(_numbers(psi), _numbers(sign), rows, weight, False, threads())[0]


def _numbers(values: Real) -> Real:
    return np.ascontiguousarray(values, dtype=np.float64)
