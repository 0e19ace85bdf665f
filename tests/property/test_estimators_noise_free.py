"""Noise-free data give every parameter back, by every estimator, on random identifiable rigs of 1 to 8 coordinates."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.channel import Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables, OptimalIV
from dashpot.estimate.linear.least_squares import HarmonicLeastSquares, LeastSquares, WeightedLeastSquares
from dashpot.estimate.linear.total_least_squares import TotalLeastSquares
from dashpot.model.elements import Kind
from tests.rigs import Rig, channels, covariance, perfect, random_rig, records

D, V, A = Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION
ON_AMPLITUDES = (HarmonicLeastSquares(), WeightedLeastSquares(), InstrumentalVariables(), OptimalIV())
# (displacement inputs, force inputs)
INPUTS = ((1, 0), (2, 0), (3, 0), (0, 1), (0, 2), (1, 1), (2, 1))


def worst_error(rig: Rig, values: np.ndarray) -> float:
    return float(np.max(np.abs(values / rig.theta - 1)))


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 8),
    inputs=st.sampled_from(INPUTS),
    quantities=st.sampled_from([(D,), (V,), (A,), (D, V), (A, D), (V, A, D)]),
    same_phase=st.booleans(),
)
@settings(max_examples=50)
def test_amplitudes_give_every_parameter_back(
    seed: int, n: int, inputs: tuple[int, int], quantities: tuple[Quantity, ...], same_phase: bool
) -> None:
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, n, displacements=inputs[0], forces=inputs[1], same_phase=same_phase)
    exact = perfect(rig, channels(rig, quantities, rng))
    for method in ON_AMPLITUDES:
        estimate = identify(rig.model, exact, method)
        assert worst_error(rig, estimate.values) < 1e-8, method
        assert estimate.converged


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 8), inputs=st.sampled_from(INPUTS))
@settings(max_examples=30)
def test_so_they_do_under_a_stated_noise(seed: int, n: int, inputs: tuple[int, int]) -> None:
    """The weight is a matter of efficiency alone: with any stated covariance the noise-free answer is the truth."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, n, displacements=inputs[0], forces=inputs[1])
    seen = channels(rig, (D, A), rng)
    stated = covariance(rig, seen, 0.02, inputs=0.01, correlation=0.3)
    for method in (*ON_AMPLITUDES, TotalLeastSquares()):
        estimate = identify(rig.model, perfect(rig, seen, stated), method)
        assert worst_error(rig, estimate.values) < 1e-8, method
        assert estimate.fit.chi2 < 1e-9


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 8),
    inputs=st.sampled_from(INPUTS),
    periods=st.sampled_from([1.0, 3.0, 1.37, 2.81]),
)
@settings(max_examples=30)
def test_samples_give_every_parameter_back(
    seed: int, n: int, inputs: tuple[int, int], periods: float
) -> None:
    """ls and iv on samples.  Hysteretic dampers have no law in time, so ls does without them."""
    rng = np.random.default_rng(seed)
    kinds = frozenset(Kind) - {Kind.HYSTERETIC}
    rig = random_rig(rng, n, displacements=inputs[0], forces=inputs[1], kinds=kinds)
    dwells = records(rig, channels(rig, (D, V), rng), rng, samples=40, periods=periods, relative=0.0)
    exact = spectrum(dwells, drift=None, harmonics=(), noise="white", moments=True)
    for method in (LeastSquares(), InstrumentalVariables()):
        estimate = identify(rig.model, exact, method)
        assert worst_error(rig, estimate.values) < 1e-8, method
