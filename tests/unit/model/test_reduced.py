"""A rig on the span of few motions: exact where they were computed, in its slopes too, and near to second order."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.model.observation import ObservationModel, calibrated_transfer, input_channels, observation_model
from dashpot.model.reduced import ReducedRig, extended_basis, line_motions, reduced
from tests.partly_seen import calibrations
from tests.rigs import random_rig


def on_basis(view: ObservationModel, p: np.ndarray) -> ReducedRig:
    """The rig on the motions at all lines of `view`, at p (elements,)."""
    motions = np.concatenate([line_motions(view, p, line) for line in range(len(view.omega))], axis=1)
    return reduced(view, extended_basis(np.zeros((view.model.n, 0)), motions))


def viewed(seed: int, n: int = 12, lines: int = 2) -> tuple[ObservationModel, np.ndarray]:
    """A random rig, seen at two coordinates, with the forces at its inputs and in an element; and θ."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, n, displacements=1 + seed % 2, forces=seed % 3, worst=1e9, known=0.5)
    model = rig.model
    chosen = [Channel(x, {x: 1.0}, Quantity.VELOCITY) for x in (model.coordinates[0], model.coordinates[-1])]
    chosen += [*input_channels(model), Channel("inside", {model.elements[-1].name: 1.5}, Quantity.FORCE)]
    chosen += [Channel(f"R{u}", {u: 1.0}, Quantity.FORCE) for u in model.displacement_inputs]
    return observation_model(model, chosen, rig.omega[:lines]), rig.theta


@pytest.mark.parametrize("seed", range(4))
def test_exact_where_the_motions_were_computed(seed: int) -> None:
    view, theta = viewed(seed)
    small = replace(view, reduced=on_basis(view, view.model.parameters(theta)))
    assert small.reduced.size <= view.model.n
    psi, sign = theta[None], np.ones((1, len(view.channels)))
    full, other = calibrated_transfer(view, psi, sign), calibrated_transfer(small, psi, sign)
    q = np.random.default_rng(seed).normal(size=full.G.shape[-1]) + 0j
    q = np.broadcast_to(q, (1, len(view.omega), len(q)))
    np.testing.assert_allclose(other.G, full.G, rtol=1e-6, atol=1e-7 * np.max(np.abs(full.G)))
    np.testing.assert_allclose(
        other.amplitudes(q), full.amplitudes(q), atol=1e-7 * np.max(np.abs(full.amplitudes(q)))
    )
    J = full.slopes(q)
    assert np.max(np.abs(other.slopes(q) - J) / np.max(np.abs(J), axis=(0, 1, 2))) < 1e-5


def test_the_error_elsewhere_is_a_product_of_two() -> None:
    """A rig of 30 coordinates on the motions of one line: half the distance, a quarter of the error at most."""
    view, theta = viewed(0, n=30, lines=1)
    small = replace(view, reduced=on_basis(view, view.model.parameters(theta)))
    sign = np.ones((1, len(view.channels)))
    rng = np.random.default_rng(3)
    way = rng.standard_normal(len(theta))
    errors = []
    for distance in (0.02, 0.01, 0.005):
        psi = (theta * (1 + distance * way))[None]
        full, other = (calibrated_transfer(v, psi, sign).G for v in (view, small))
        errors.append(np.max(np.abs(full - other)) / np.max(np.abs(full)))
    assert errors[0] > 1e-12
    assert errors[1] < 0.35 * errors[0]
    assert errors[2] < 0.35 * errors[1]


def test_calibrations_are_those_of_the_whole_rig() -> None:
    bench = calibrations()
    view = observation_model(bench.model, bench.channels, 2 * np.pi * bench.frequency_hz)
    p = bench.model.parameters(bench.psi[: view.m])
    small = replace(view, reduced=on_basis(view, p))
    sign = np.array([[bench.signs.get(channel.name, 1.0) for channel in bench.channels]])
    full, other = (calibrated_transfer(v, bench.psi[None], sign) for v in (view, small))
    q = np.ones((1, len(view.omega), full.G.shape[-1]), dtype=complex)
    J = full.slopes(q)
    assert np.max(np.abs(other.slopes(q) - J) / np.max(np.abs(J), axis=(0, 1, 2))) < 1e-6


def test_a_basis_grows_by_what_is_new() -> None:
    rng = np.random.default_rng(4)
    first = rng.normal(size=(50, 3)) + 1j * rng.normal(size=(50, 3))
    V = extended_basis(np.zeros((50, 0)), first)
    assert V.shape == (50, 6)
    again = extended_basis(
        V, np.concatenate([first @ rng.normal(size=(3, 4)), rng.normal(size=(50, 1)) + 0j], axis=1)
    )
    assert again.shape == (50, 7)
    np.testing.assert_allclose(again.T @ again, np.eye(7), atol=1e-12)
    assert extended_basis(V, np.full((50, 1), np.nan + 0j)).shape == (50, 6)
