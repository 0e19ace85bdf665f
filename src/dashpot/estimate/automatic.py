"""The estimate where no method is named: the one that suits, and a second, thorough one where the first is no answer.

oiv is efficient and fast where everything is seen, but at 20 % noise one run in four ends in a wrong valley or nowhere
(THEORY §11).  Where it finds nothing, does not converge, does not fit, or makes a part of the rig negative, ml searches
from many starts, in logarithms, and what fits better is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dashpot.arrays import Bools
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ConvergenceError, DashpotError, IdentifiabilityError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.inference.diagnostics import nonlinear_names
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.method import Method
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.unstructured import free_names
from dashpot.notices import Notice

LARGEST = 8  # coordinates: beyond, many starts take longer than anyone waits
REJECTED = 1e-3  # p-value below which a fit may be a wrong valley
BEYOND = 2.0  # standard deviations by which a negative part is no accident
FITS = 0.01  # p-value of a fit
STARTS, ROUNDS = 32, 2
BETTER = 0.9  # χ² of the second over that of the first below which it is taken, where neither fits


def identify_automatically(
    model: Model,
    spectrum: Spectrum,
    method: Method | None = None,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """The estimate by `method` (that of `automatic`), or by a thorough search where that is no answer.

    Repeats are estimated by the first alone.  Raises as `identify`.
    """
    first = automatic(model, spectrum) if method is None else method
    plain = MaximumLikelihood(seed=seed)
    if spectrum.batch or first.traits.by_output:
        return identify(model, spectrum, first, progress=progress)
    try:
        estimate = identify(model, spectrum, first, progress=progress)
    except (IdentifiabilityError, ConvergenceError) as error:
        return _in_place_of(model, spectrum, first, plain, error)
    if plausible(model, estimate) or model.n > LARGEST:
        return estimate
    second = _searched(model, spectrum, replace(plain, starts=STARTS, rounds=ROUNDS, thorough=True))
    if second is None or not _better(model, estimate, second):
        return estimate
    text = f"{first.name} {_failing(estimate)}; ml, from many starts, is taken"
    return replace(second, warnings=(*second.warnings, Notice("another_method", text)))


def plausible(model: Model, estimate: Estimate) -> bool:
    """Whether one estimate has converged, is not rejected by χ², and makes no part of the rig negative."""
    rejected = bool(estimate.fit.p < REJECTED)
    return bool(estimate.converged) and not rejected and not np.any(_negative(model, estimate))


def _negative(model: Model, estimate: Estimate) -> Bools:
    """Parts that are negative beyond doubt, (unknowns,); entries of free matrices and nonlinear terms may be."""
    exempt = free_names(model) | nonlinear_names(model)
    names = [unknown.name for unknown in model.unknowns]
    physical = np.array([name not in exempt for name in names])
    values, sd = estimate.values[: len(names)], estimate.noise_sd[: len(names)]
    negative: Bools = physical & (values < -BEYOND * sd)
    return negative


def _in_place_of(
    model: Model, spectrum: Spectrum, first: Method, second: Method, error: DashpotError
) -> Estimate:
    """The second method where the first has no answer; the first one's error where neither has."""
    try:
        estimate = identify(model, spectrum, second)
    except (IdentifiabilityError, ConvergenceError):
        raise error from None
    if not bool(estimate.converged):
        raise error
    text = f"{first.name} finds no answer here; ml is taken in its place"
    return replace(estimate, warnings=(*estimate.warnings, Notice("another_method", text)))


def _searched(model: Model, spectrum: Spectrum, method: Method) -> Estimate | None:
    try:
        return identify(model, spectrum, method)
    except (IdentifiabilityError, ConvergenceError):
        return None


def _better(model: Model, first: Estimate, second: Estimate) -> bool:
    if not bool(second.converged):
        return False
    if not bool(first.converged) or bool(second.fit.p > FITS) > bool(first.fit.p > FITS):
        return True
    healthier = np.sum(_negative(model, second)) < np.sum(_negative(model, first))
    if bool(second.fit.p > FITS) and healthier:
        return True
    return bool(second.fit.chi2 < BETTER * first.fit.chi2)


def _failing(estimate: Estimate) -> str:
    if not bool(estimate.converged):
        return "did not converge"
    return "ended in another minimum"
