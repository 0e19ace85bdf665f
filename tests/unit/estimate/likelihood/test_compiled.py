"""The likelihood in the compiled kernel against its twins in NumPy: rigs seen in part, and rigs undamped."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.descent import Likelihood, Stage
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.measured import compiled_cost, compiled_local, compiled_output
from dashpot.estimate.likelihood.objective import directly_driven, local, measured, per_line
from dashpot.estimate.preparation import prepare
from dashpot.numerics.kernel import using
from dashpot.numerics.levenberg_marquardt import OptimizeResult
from tests import rigs
from tests.kernels import apart, compiled, instruction_sets, instructions
from tests.networks import changed, network
from tests.partly_seen import BENCHES, Bench, noisy_base

TWINS = 1e-12
COUNT = 4


def _case(make: Callable[[], Bench]) -> tuple[Bench, Likelihood, np.ndarray, np.ndarray]:
    """A bench of which one unknown has a prior, its likelihood, and points and signs of which some are turned."""
    bench, rng = make(), np.random.default_rng(3)
    name = bench.model.unknowns[0].name
    known = {"value": 1.1 * bench.truth[name], "sd": 0.2 * bench.truth[name], "guess": None}
    bench = replace(bench, model=changed(bench.model, name, **known))
    likelihood = Likelihood.of(prepare(bench.model, bench.spectrum(rng, COUNT)), MaximumLikelihood().effort)
    psi = bench.psi * rng.uniform(0.7, 1.4, (COUNT, len(bench.psi)))
    sign = np.ones((COUNT, len(likelihood.view.channels)))
    sign[:, likelihood.view.flips] = -1
    return bench, likelihood, psi, sign


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize("make", BENCHES)
def test_sums_are_those_of_numpy(make: Callable[[], Bench], name: str) -> None:
    bench, likelihood, psi, sign = _case(make)
    view, rows = likelihood.view, np.arange(COUNT)
    size, both = bench.psi, np.outer(bench.psi, bench.psi)
    for data in (likelihood.exact, measured(likelihood.data, 0.3)):
        with using("numpy"):
            twin, lines = local(view, data, psi, sign), per_line(view, data, psi, sign)
        with instructions(name):
            output = compiled_output(view, data)
            found = compiled_local(output, psi, sign, rows)
            alone = compiled_cost(output, psi, sign, rows)
            by_lines = output.lines(psi, sign)
        assert apart(found.cost[:, None], twin.cost[:, None]) < TWINS
        assert apart(alone[:, None], twin.cost[:, None]) < TWINS
        assert apart(found.gradient, twin.gradient, size) < TWINS
        assert apart(found.symmetric, twin.symmetric, both) < TWINS
        for values, expected, unit in zip(by_lines, lines, (both, size, 1.0), strict=True):
            assert apart(values, expected, unit) < TWINS


@pytest.mark.parametrize("make", BENCHES)
def test_logarithms_are_those_of_numpy(make: Callable[[], Bench]) -> None:
    compiled()
    bench, likelihood, psi, sign = _case(make)
    first = likelihood.only(0)
    data, view = directly_driven(first.view, first.exact), first.view
    assert data is not None
    rows = np.zeros(COUNT, dtype=np.int64)
    weight = np.random.default_rng(5).uniform(size=first.data.spectrum.amplitudes[0].shape)
    with using("numpy"):
        twin = local(view, data, psi, sign, weight)
    output = compiled_output(view, data)
    found = compiled_local(output, psi, sign, rows, weight)
    assert apart(found.cost[:, None], twin.cost[:, None]) < TWINS
    assert apart(found.gradient, twin.gradient, bench.psi) < TWINS
    assert apart(found.symmetric, twin.symmetric, np.outer(bench.psi, bench.psi)) < TWINS


@pytest.mark.parametrize("name", instruction_sets())
def test_rows_are_exchanged_where_a_pivot_vanishes(name: str) -> None:
    """A mass on a spring, at the resonance of what hangs on it: the first pivot is 0, the response is not."""
    model = network("x1 x2", "u", "m1@x1 m2@x2 k1:x1-x2 k2:x2-u=4")
    hz = np.sqrt(np.array([1.0, 2.0, 1.0])) / (2 * np.pi)
    lines = len(hz)
    quantities = (("x1", Quantity.DISPLACEMENT), ("x2", Quantity.ACCELERATION), ("u", Quantity.DISPLACEMENT))
    V = np.diag([1e-4, 1e-4, 0.0]) * np.ones((lines, 1, 1))
    channels = [Channel(f"of {point}", {point: 1.0}, quantity) for point, quantity in quantities]
    Y = np.array([[1.0 + 0.1j, 2.0, 1.0], [0.5, 1.5 - 0.2j, 1.0], [0.9, 2.1, 1.0]])
    spectrum = rigs.stated(channels, hz, Y, V)
    likelihood = Likelihood.of(prepare(model, spectrum), MaximumLikelihood().effort)
    psi, sign = np.array([[1.0, 3.0, 1.0]]), np.ones((1, 3))  # k1 − ω² m1 = 0 at two of the lines
    with using("numpy"):
        twin = local(likelihood.view, likelihood.exact, psi, sign)
    with instructions(name):
        found = compiled_local(compiled_output(likelihood.view, likelihood.exact), psi, sign, np.array([0]))
    assert np.isfinite(twin.cost[0])
    assert apart(found.cost[:, None], twin.cost[:, None]) < TWINS
    assert apart(found.gradient, twin.gradient) < TWINS
    assert apart(found.symmetric, twin.symmetric) < TWINS


@pytest.mark.parametrize("limit", [None, 0])
def test_descents_end_where_those_of_numpy_do(limit: int | None) -> None:
    compiled()
    _, likelihood, psi, sign = _case(noisy_base)
    with using("numpy"):
        twin = likelihood.descend(psi, sign, limit=limit)
    found = likelihood.descend(psi, sign, limit=limit)
    assert np.all(twin.converged) != (limit == 0)
    np.testing.assert_array_equal(found.converged, twin.converged)
    np.testing.assert_array_equal(found.iterations, twin.iterations)
    np.testing.assert_allclose(found.x, twin.x, rtol=1e-9)
    np.testing.assert_allclose(found.cost, twin.cost, rtol=1e-9)
    some = np.array([2, 1])
    part = likelihood.descend(psi[some], sign[some], repeats=some, limit=limit)
    np.testing.assert_array_equal(part.x, found.x[some])


@pytest.mark.parametrize("patience", [12, 1])
def test_an_unknown_whose_bounds_meet_is_as_good_as_known(patience: int) -> None:
    """By steps of Gauss and Newton, and by Newton's from the second on."""
    compiled()
    bench, likelihood, psi, sign = _case(noisy_base)
    at, value, rows = 1, 1.2 * bench.psi[1], np.arange(COUNT)
    low, high, others = likelihood.lower.copy(), likelihood.upper.copy(), np.arange(len(bench.psi)) != at
    low[at] = high[at] = value
    stage = Stage(likelihood.view, likelihood.exact)

    def descended() -> OptimizeResult:
        return stage.descend(
            psi, sign, rows, limit=60, tolerance=1e-6, lower=low, upper=high, patience=patience
        )

    known = changed(bench.model, likelihood.view.names[at], value=value)
    reference = Likelihood.of(prepare(known, likelihood.data.spectrum), likelihood.effort)
    expected = reference.descend(psi[:, others], sign)
    with using("numpy"):
        twin = descended()
    for found in (twin, descended()):
        assert np.all(found.converged)
        assert np.all(found.x[:, at] == value)
        np.testing.assert_allclose(found.cost, expected.cost, rtol=1e-9)
        np.testing.assert_allclose(found.x[:, others], expected.x, rtol=1e-5)


def test_estimates_are_the_same_with_and_without_the_kernel() -> None:
    compiled()
    bench = noisy_base()
    spectrum = bench.spectrum(np.random.default_rng(5), 3)
    method = MaximumLikelihood(starts=8, candidates=100)
    with using("numpy"):
        twin = identify(bench.model, spectrum, method)
    with using("compiled"):
        found = identify(bench.model, spectrum, method)
    np.testing.assert_allclose(found.values, twin.values, rtol=1e-9)
    np.testing.assert_allclose(found.sd, twin.sd, rtol=1e-8)
