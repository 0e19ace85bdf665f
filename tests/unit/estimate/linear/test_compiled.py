"""The equation of motion in the compiled kernel against its twins in NumPy, on random rigs."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.estimate.linear.gram import (
    compiled_equation,
    equation_by_line,
    equation_covariance,
    equation_sums,
)
from dashpot.estimate.linear.instrumental_variables import objective, search
from dashpot.estimate.linear.least_squares import starts
from dashpot.estimate.preparation import Prepared, prepare
from dashpot.numerics.kernel import using
from tests.kernels import apart, compiled, instruction_sets, instructions
from tests.rigs import Rig, channels, covariance, noisy, random_rig

REPEATS = 5
TWINS = 1e-12


def _case(seed: int) -> tuple[Rig, Prepared, np.ndarray]:
    """A random rig of one to four coordinates, noisy data of it, and parameters away from the truth."""
    rng = np.random.default_rng(seed)
    forces = int(seed % 3 != 0 or rng.integers(0, 2))
    rig = random_rig(
        rng, int(rng.integers(1, 5)), displacements=int(rng.integers(0, 3)) if seed % 3 else 1, forces=forces
    )
    V = covariance(
        rig, channels(rig), 0.05, inputs=0.03 * (seed % 2), correlation=0.3 if seed % 4 == 0 else 0.0
    )
    spectrum = noisy(rig, channels(rig), V, rng, REPEATS)
    if seed % 5 == 0:  # each repeat has noise of its own
        spectrum = replace(spectrum, covariance=V * rng.uniform(0.5, 2, (REPEATS, 1, 1, 1)))
    if seed % 4 == 1:  # a prior
        name = rig.names[0]
        rig = rig.knowing({name: {"value": float(rig.theta[0]) * 1.02, "sd": float(rig.theta[0]) * 0.05}})
    theta = rig.theta * rng.uniform(0.7, 1.4, (REPEATS, len(rig.theta)))
    return rig, prepare(rig.model, spectrum), theta


def _tolerance(rig: Rig, data: Prepared, theta: np.ndarray) -> float:
    """TWINS, or what rounding makes of the worst conditioned noise of the equation where that is more."""
    Se = equation_covariance(rig.model, rig.model.parameters(theta), data.seen_states)
    sd = np.sqrt(np.diagonal(Se, axis1=-2, axis2=-1).real)
    worst = float(np.max(np.linalg.cond(Se / (sd[..., :, None] * sd[..., None, :]))))
    return max(TWINS, 4 * np.finfo(float).eps * worst)


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize("seed", range(10))
def test_sums_and_starts_are_those_of_numpy(seed: int, name: str) -> None:
    rig, data, theta = _case(seed)
    rows = np.arange(REPEATS)
    with using("numpy"):
        twin = objective(rig.model, data.seen_states, rows)(theta, rows)
        twin_starts = starts(rig.model, data.seen_states)
        lines = equation_by_line(rig.model, data.seen_states, theta)
    with instructions(name):
        equation = compiled_equation(rig.model, data.seen_states)
        cost, gradient, symmetric, mixed = equation.evaluate(theta, rows)
        found = equation.starts()
        by_lines = equation.lines(theta)
    both, least = np.outer(rig.theta, rig.theta), _tolerance(rig, data, theta)
    assert apart(cost[:, None], twin.cost[:, None]) < least
    assert apart(gradient, twin.gradient, rig.theta) < least
    assert apart(symmetric, twin.symmetric, both) < least
    assert apart(mixed, twin.free, both) < least
    for values, expected in zip(found, twin_starts, strict=True):
        # The solution of a system of condition 1e3 or so.
        assert np.max(np.abs(values - expected) / rig.theta) < 1e-10
    for values, expected, size in zip(by_lines, lines, (both, rig.theta, 1.0), strict=True):
        assert apart(values, expected, size) < least


@pytest.mark.parametrize("seed", range(6))
def test_searches_take_the_same_steps(seed: int) -> None:
    compiled()
    rig, data, theta = _case(seed)
    rows = np.arange(REPEATS)
    with using("numpy"):
        twin = search(rig.model, data.seen_states, theta, rows, limit=200, tolerance=1e-9)
    equation = compiled_equation(rig.model, data.seen_states)
    found = search(rig.model, data.seen_states, theta, rows, limit=200, tolerance=1e-9)
    kept = equation_sums(rig.model, data.seen_states, found.x)  # those of the search, not computed again
    sums = equation.evaluate(found.x, rows)
    for values, expected in zip((kept.cost, kept.gradient, kept.symmetric, kept.free), sums, strict=True):
        np.testing.assert_array_equal(values, expected)
    assert np.array_equal(found.converged, twin.converged)
    close = found.converged
    np.testing.assert_allclose(found.x[close], twin.x[close], rtol=1e-9)
    np.testing.assert_allclose(found.cost[close], twin.cost[close], rtol=1e-9)
    if close[0]:
        assert len(found.history) == found.iterations[0] + 1
        np.testing.assert_array_equal(found.history[-1], found.x[0])


def test_threads_and_neighbours_do_not_change_a_bit() -> None:
    compiled()
    rig, data, theta = _case(1)
    equation = compiled_equation(rig.model, data.seen_states)
    rows = np.arange(REPEATS)
    one, _ = equation.search(theta, rows, 1e9, 200, 1e-9, 12, 1)
    three, _ = equation.search(theta, rows, 1e9, 200, 1e-9, 12, 3)
    alone, _ = equation.search(theta, rows[3:4], 1e9, 200, 1e-9, 12, 1)
    for first, second in zip(one[:4], three[:4], strict=True):
        np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(alone[0][0], one[0][3])


def test_arrays_of_another_size_are_refused() -> None:
    compiled()
    rig, data, theta = _case(2)
    equation = compiled_equation(rig.model, data.seen_states)
    with pytest.raises(ValueError, match="unknowns"):
        equation.evaluate(theta[:, :-1].copy(), np.arange(REPEATS))
    with pytest.raises(ValueError, match="none of the repeats"):
        equation.evaluate(theta, np.arange(REPEATS) + 1)
