"""Modes of free decays found without a start, and what a search makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks import decays_and_stands
from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.global_search import decay_minima, free_modes
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.preparation import prepare
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind, between, mass
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Input, Model


def chain(n: int, rng: np.random.Generator, known: int = 1) -> tuple[Model, Real]:
    """n masses in a row on the ground, parts of all sizes, the first `known` masses known; θ true."""
    m, k = rng.uniform(0.5, 3, n), rng.uniform(500, 6000, n)
    c = rng.uniform(0.006, 0.06) * k / np.sqrt(np.mean(k) / np.mean(m)) * rng.uniform(0.5, 1.5, n)
    names = [f"x{i + 1}" for i in range(n)]
    below = ["ground", *names]
    elements = [mass(f"m{i + 1}", names[i], value=float(m[i]) if i < known else None) for i in range(n)]
    elements += [between(f"k{i + 1}", Kind.SPRING, names[i], below[i]) for i in range(n)]
    elements += [between(f"c{i + 1}", Kind.DAMPER, names[i], below[i]) for i in range(n)]
    return Model(tuple(names), (), tuple(elements)), np.concatenate([m[known:], k, c])


def decay(
    model: Model, theta: Real, seen: list[int], quantity: Quantity, noise: float, rng: np.random.Generator
) -> Record:
    """A release from moved positions, forty cycles of the slowest mode, 20 samples in one of the fastest."""
    at, n = matrices(model, model.parameters(theta)), model.n
    A = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(at.M, at.K), -np.linalg.solve(at.M, at.C)]]
    )
    poles = np.linalg.eigvals(A)
    step = 2 * np.pi / np.max(np.abs(poles)) / 20
    forward, state = expm(A * step), np.concatenate([rng.normal(size=n) * 1e-3, np.zeros(n)])
    states = [state]
    for _ in range(int(40 * 2 * np.pi / np.min(np.abs(poles)) / step)):
        states.append(forward @ states[-1])
    motion = np.array(states)
    shown = motion[:, :n] if quantity is Quantity.DISPLACEMENT else (motion @ A.T)[:, n:]
    values = shown[:, seen]
    values = values + noise * np.std(values, axis=0) * rng.normal(size=values.shape)
    channels = tuple(Channel(f"s{i + 1}", {f"x{i + 1}": 1.0}, quantity) for i in seen)
    return Record(channels, step * np.arange(len(values)), values)


@pytest.mark.parametrize("quantity", [Quantity.DISPLACEMENT, Quantity.ACCELERATION])
def test_modes_of_a_decay_without_noise_are_those_of_the_rig(quantity: Quantity) -> None:
    rng = np.random.default_rng(3)
    model, theta = chain(3, rng)
    records = [decay(model, theta, [0, 2], quantity, 0.0, rng) for _ in range(2)]
    poles, _ = free_modes(prepare(model, spectrum(records), states=False))
    true = eigenmodes(model, model.parameters(theta)).eigenvalues
    np.testing.assert_allclose(poles, true[np.argsort(np.abs(true))], rtol=1e-6)


def test_sensors_between_coordinates_tell_shapes() -> None:
    rng = np.random.default_rng(4)
    model, theta = chain(2, rng)
    record = decay(model, theta, [0, 1], Quantity.DISPLACEMENT, 0.01, rng)
    apart = Channel("apart", {"x2": 1.0, "x1": -1.0}, Quantity.DISPLACEMENT)
    record = replace(
        record,
        channels=(record.channels[0], apart),
        values=np.column_stack([record.values[:, 0], record.values[:, 1] - record.values[:, 0]]),
    )
    minima = decay_minima(prepare(model, spectrum([record]), states=False), MaximumLikelihood().effort)
    np.testing.assert_allclose(minima.psi[0], theta, rtol=0.05)


def test_a_driven_rig_has_no_free_modes_to_begin_with() -> None:
    rng = np.random.default_rng(5)
    model, theta = chain(2, rng)
    record = decay(model, theta, [0, 1], Quantity.DISPLACEMENT, 0.01, rng)
    pushed = replace(model, inputs=(Input("f", "force", {"x2": 1.0}),))
    force = Channel("f", {"f": 1.0}, Quantity.FORCE)
    values = np.column_stack([record.values, rng.normal(size=len(record.time))])
    data = prepare(pushed, spectrum([Record((*record.channels, force), record.time, values)]))
    assert not len(decay_minima(data, MaximumLikelihood().effort).cost)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2, 3))])
def test_accelerations_of_six_masses_lead_home(seed: int) -> None:
    # From the equation of motion alone two of ten were lost after a minute each.
    rng = np.random.default_rng((seed, 6))
    model, theta = chain(6, rng)
    record = decay(model, theta, list(range(6)), Quantity.ACCELERATION, 0.01, rng)
    estimate = identify(model, spectrum([record]))
    assert np.max(np.abs(estimate.values - theta) / estimate.sd) < 5  # 17 unknowns: by chance once in 10⁵


@pytest.mark.parametrize("seed", range(4))
def test_two_rigs_with_the_same_decay_are_both_told(seed: int) -> None:
    rng = np.random.default_rng((seed, 2))
    model, theta = chain(2, rng, known=2)
    record = decay(model, theta, [1], Quantity.DISPLACEMENT, 0.01, rng)
    data = spectrum([record])
    estimate = identify(model, data)
    # Both springs and dampers make two frequencies and two ratios: of the two rigs that do, one is the truth.
    home = MaximumLikelihood(start=tuple(theta.tolist()), start_sign=(1.0,))
    rival = [notice for notice in estimate.warnings if notice.code == "not_unique"]
    if np.max(np.abs(estimate.values - theta) / estimate.sd) > 5:
        assert rival
        assert estimate.fit.chi2 == pytest.approx(identify(model, data, home).fit.chi2, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "number"), [(5, 1), (4, 8), (5, 12)])
def test_modes_that_hardly_show_lead_no_search_astray(count: int, number: int) -> None:
    """Subspaces of these records have other modes; searches from there ended 8 to 74 standard deviations off."""
    drawn = decays_and_stands.decay(None, count, np.random.default_rng((61, number, count)))
    estimate = drawn.rig.identify(drawn.data, judge=False)
    z = [(estimate[name].value - value) / estimate[name].sd for name, value in drawn.truth.items()]
    assert estimate.converged
    assert np.max(np.abs(z)) < 4
