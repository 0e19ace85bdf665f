"""Channels as functions of the unknowns: against the simulation, finite differences, and inputs as unknowns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from dashpot.channel import Channel, Quantity
from dashpot.estimate.likelihood.objective import directly_driven, local, measured, predict
from dashpot.estimate.preparation import prepare
from dashpot.model import dynamics as sparse_dynamics
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model
from tests.partly_seen import BENCHES, Bench, noisy_base


def prepared(bench, correlation=0.0, draws=1, seed=1):
    data = prepare(bench.model, bench.spectrum(np.random.default_rng(seed), draws, correlation))
    return data, observation_model(bench.model, data.spectrum.channels, data.spectrum.omega)


def signs(bench):
    return np.array([[bench.signs.get(channel.name, 1.0) for channel in bench.channels]])


@pytest.fixture(params=BENCHES, ids=lambda make: make.__name__)
def bench(request):
    return request.param()


def test_channels_show_what_the_simulation_says(bench):
    data, view = prepared(bench)
    exact = replace(measured(data), q=bench.q[None])
    at = predict(view, exact, bench.psi[None], signs(bench))
    shown = (exact.y - at.r)[0]
    truth = bench.shown(bench.psi)
    assert view.names == bench.names
    assert np.allclose(shown, truth, rtol=0, atol=1e-11 * np.abs(truth).max(axis=0))


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_information_is_that_of_inputs_written_out_as_unknowns(bench, correlation):
    """Π of profiled inputs against the Schur complement of real and imaginary parts of every input at every line."""
    data, view = prepared(bench, correlation)
    given = measured(data)
    exact = replace(given, y=bench.shown(bench.psi)[None] * (given.y != 0))
    found = np.sum(predict(view, exact, bench.psi[None], signs(bench)).information(), axis=-3)[0]
    expected = bench.information(correlation)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.all(np.abs(found - expected) <= 1e-6 * size)


def test_gradients_of_logarithms_are_those_of_finite_differences(bench):
    """Away from the minimum, to 1e-6; those of the likelihood itself: tests/property/test_ml_laws.py."""
    data, view = prepared(bench, 0.4)
    driven = directly_driven(view, measured(data))
    assert driven is not None
    weight = np.linspace(0.1, 1.0, driven.y[0].size).reshape(driven.y.shape[1:])

    def cost(psi):
        return local(view, driven, psi, signs(bench), weight)

    psi = bench.psi[None] * np.exp(0.02 * np.sin(np.arange(len(bench.psi))))
    slope = np.empty(psi.shape[-1])
    for j in range(len(slope)):
        h = 1e-4 * abs(psi[0, j]) * np.eye(len(slope))[j]
        rough = (cost(psi + 2 * h).cost - cost(psi - 2 * h).cost) / (4 * h[j])
        fine = (cost(psi + h).cost - cost(psi - h).cost) / (2 * h[j])
        slope[j] = (4 * fine[0] - rough[0]) / 3
    here = cost(psi)
    sd = 1 / np.sqrt(np.diagonal(here.symmetric[0]))
    assert np.allclose(
        -2 * here.gradient[0] * sd, slope * sd, rtol=1e-6, atol=1e-6 * np.max(np.abs(slope * sd))
    )


def chain(n, lines):
    """A chain of n masses between a base and a force at its end, seen at three points and at the base's force."""
    rng = np.random.default_rng(n)
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements = [mass(f"m{i}", f"x{i}") for i in range(1, n + 1)]
    elements += [between(f"k{i}", Kind.SPRING, points[i - 1], points[i]) for i in range(1, n + 1)]
    elements += [between(f"c{i}", Kind.DAMPER, points[i - 1], points[i]) for i in range(1, n + 1)]
    size = {"m": 1.0, "k": 4000.0, "c": 8.0}
    values = {e.name: size[e.name[0]] * float(np.exp(rng.uniform(-1, 1))) for e in elements}
    f = np.geomspace(1, 20, lines)
    channels = (
        Channel("first", {"x1": 1}, Quantity.ACCELERATION), Channel("middle", {f"x{n // 2}": 1, "x3": -1}),
        Channel("last", {f"x{n}": 1}, Quantity.VELOCITY), Channel("R", {"u": 1}, Quantity.FORCE),
        Channel("u", {"u": 1}), Channel("p", {"p": 1}, Quantity.FORCE),
    )  # fmt: skip
    model = Model(tuple(points[1:]), (Input("u"), Input("p", "force", {f"x{n}": 1.0})), tuple(elements))
    U, force = np.full((lines, 1), 0.01 + 0j), np.full((lines, 1), 3.0 + 1j)
    return Bench("chain", model, values, channels, f, U, force, {"": 0.01})


def test_a_large_rig_costs_one_sparse_factorisation_a_line(monkeypatch):
    """And gives the same many starts at once; time itself is measured in benchmarks/large.py."""
    calls = []
    monkeypatch.setattr(sparse_dynamics, "splu", lambda *args, **how: calls.append(1) or splu(*args, **how))
    bench = chain(60, 7)
    data, view = prepared(bench)
    given = measured(data)
    psi = np.stack([bench.psi, 1.1 * bench.psi])
    both = local(view, given, psi, np.ones((2, 6)))
    assert len(calls) == 2 * 7
    alone = local(view, given, psi[1:], np.ones((1, 6)))
    assert np.array_equal(both.cost[1:], alone.cost)
    assert np.array_equal(both.gradient[1:], alone.gradient)


def test_a_channel_that_was_not_measured_weighs_nothing():
    """NaN at some lines is the same as the channel with a noise that swamps it there."""
    bench = noisy_base()
    data, view = prepared(bench)
    Y = data.spectrum.amplitudes.copy()
    Y[:, 5:9, 1] = np.nan
    holes = replace(data, spectrum=replace(data.spectrum, amplitudes=Y), states=None)
    V = data.covariance.copy()
    V[:, 5:9, 1, 1] *= 1e12
    swamped = replace(data, covariance=V, states=None)
    one, two = (predict(view, measured(d), bench.psi[None], signs(bench)) for d in (holes, swamped))
    assert np.allclose(
        one.information(), two.information(), rtol=1e-6, atol=1e-6 * np.abs(two.information()).max()
    )
    assert np.allclose(one.cost_per_line, two.cost_per_line, rtol=1e-6)
    assert measured(holes).rows == measured(data).rows - 8


def test_inputs_that_no_channel_of_a_line_sees_are_not_driven():
    bench = noisy_base()
    data, view = prepared(bench)
    Y = data.spectrum.amplitudes.copy()
    Y[:, 3, :] = np.nan
    holes = replace(data, spectrum=replace(data.spectrum, amplitudes=Y), states=None)
    at = predict(view, measured(holes), bench.psi[None], signs(bench))
    assert at.q[0, 3, 0] == 0
    assert np.all(np.isfinite(at.information()))
    assert np.all(at.information()[0, 3] == 0)
