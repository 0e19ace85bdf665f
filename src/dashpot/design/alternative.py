"""Another test beside a plan: what it would give, and how many times the samples it takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.data.spectrum import Spectrum
from dashpot.design.criteria import Criterion, Robustness, criterion_value
from dashpot.design.plan import Plan
from dashpot.design.precision import ExpectedPrecision, expected_precision
from dashpot.design.schedule import Schedule
from dashpot.design.test_setup import TestSetup
from dashpot.errors import DashpotError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables
from dashpot.model.channel_noise import noise_sd
from dashpot.model.observation import calibration_names


def spread_of_iv(setup: TestSetup, schedule: Schedule) -> ExpectedPrecision | None:
    """What the paper's bootstrap instrumental variables would give from the same test (the sandwich of THEORY §5).

    None where they cannot be used: some coordinate is not seen, a calibration is unknown, or an element is nonlinear.
    """
    if calibration_names(setup.channels) or len(setup.model.nonlinear):
        return None
    seen = setup.seen(schedule.frequency_hz, schedule.pattern)
    sd = noise_sd(setup.channels, seen.Y)
    variance = 4 * sd**2 / schedule.samples[:, None]
    V = (variance[..., None] * np.eye(len(setup.channels))).astype(np.complex128)
    count = len(schedule.frequency_hz)
    spectrum = Spectrum(
        setup.channels, schedule.frequency_hz, seen.Y, V, np.maximum(schedule.samples, 1).astype(np.int64),
        np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=np.int64),
    )  # fmt: skip
    try:
        estimate = identify(setup.model, spectrum, InstrumentalVariables())
    except DashpotError:
        return None
    size = np.abs(np.where(estimate.values == 0, 1.0, estimate.values))
    C = estimate.noise_covariance
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return ExpectedPrecision(estimate.names, estimate.units, estimate.values, np.sqrt(np.diagonal(C)), C, rms)


def _beside(setup: TestSetup, found: ExpectedPrecision, known: Real) -> ExpectedPrecision:
    """An estimate weighed with what is known, (scenarios, q, q) in parts of the sizes, at the nominal values."""
    size = setup.sizes[0]
    outer = np.outer(size, size)
    C = np.linalg.inv(np.linalg.inv(found.covariance / outer) + known[0]) * outer
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return replace(found, sd=np.sqrt(np.diagonal(C)), covariance=C, figure=rms)


@dataclass(frozen=True)
class Alternative:
    """Another test beside the plan.

    predicted   what it would give with the optimal estimator, from as many samples as it has
    iv          the same with the paper's bootstrap; None where that cannot be used
    factor      how many times the plan's samples it takes to be as good as the plan; inf where it never is
    factor_iv   the same with the paper's bootstrap
    """

    schedule: Schedule
    predicted: ExpectedPrecision
    iv: ExpectedPrecision | None
    factor: float
    factor_iv: float | None


def compare_tests(
    setup: TestSetup,
    criterion: Criterion,
    plan: Plan,
    other: Schedule,
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Alternative:
    """Another test against a plan.

    Raises IdentifiabilityError where it does not determine the unknowns, whatever the number of its samples.
    known (unknowns, unknowns): information in SI units.
    """
    prior = setup.prior if known is None else known
    M = other.information(setup)
    predicted = expected_precision(setup, criterion, prior + M, robustness)
    terms = criterion.terms(setup, robustness)
    aim = criterion_value(terms, prior + plan.schedule.information(setup)).F
    times = _times_as_long(lambda t: criterion_value(terms, prior + t * M).F, aim)
    ratio = float(np.sum(other.samples)) / max(float(np.sum(plan.schedule.samples)), 1.0)
    iv = spread_of_iv(setup, other)
    factor_iv = None
    if iv is not None and known is None:
        names = [u.name for u in setup.model.unknowns]
        factor_iv = ratio * (iv.rms(names) / plan.predicted.rms(names)) ** 2
    if iv is not None and known is not None:
        iv = _beside(setup, iv, known)
    return Alternative(other, predicted, iv, ratio * times, factor_iv)


def _times_as_long(F: Callable[[float], float], aim: float) -> float:
    """The factor at which a falling F reaches `aim`, between e⁻²⁰ and e⁴⁰; inf beyond."""
    low, high = -20.0, 40.0
    if aim < F(float(np.exp(high))):
        return math.inf
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if aim < F(float(np.exp(middle))) else (low, middle)
    return float(np.exp(high))
