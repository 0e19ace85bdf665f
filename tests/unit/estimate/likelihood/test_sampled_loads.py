"""What sampling adds to the free motion, against sums over samples from matrix exponentials."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.estimate.likelihood.boundary_loads import sampled_loads, shows_sampled_loads
from dashpot.model.modes import eigenmodes
from dashpot.model.observation import calibrated_transfer, observation_model
from tests.networks import network
from tests.whole_rigs import chain, sampled_free_motion

MOTIONS = (Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION)
CHANNELS = tuple(
    Channel(f"x{1 + k % 2}_{q.value[:3]}", {f"x{1 + k % 2}": 1.0}, q) for k, q in enumerate(MOTIONS)
)


@pytest.mark.parametrize(("per_cycle", "most"), [(20, 1e-8), (6, 1e-4)])
def test_terms_are_what_sums_exceed_integrals_by(per_cycle: float, most: float) -> None:
    model, theta = chain(2, 0.1, base=False, seed=5)
    p = model.parameters(theta)
    highest = float(np.max(eigenmodes(model, p).frequency_hz))
    step = 1 / (per_cycle * highest)
    omega = 2 * np.pi * highest * np.array([0.1, 0.5, 1.0, 1.5])
    view = observation_model(model, CHANNELS, omega)
    assert np.all(shows_sampled_loads(view))
    of = sampled_loads(view, np.ones((1, 3), dtype=bool), p[None], np.array([step]), omega[-1:])
    s = 1j * omega / omega[-1]
    added = of.at(0, s)[0]
    by_load = _to_forces(model, view, theta)
    exact = np.stack([sampled_free_motion(view, p, step, 1j * w) for w in omega], axis=-1)
    exact[:, 2:] /= omega[-1]  # the doublet of the columns is s, not jω
    integral = np.concatenate([by_load, s * by_load], axis=1)
    size = np.max(np.abs(exact), axis=(1, 2), keepdims=True)
    np.testing.assert_allclose((integral + added) / size, exact / size, rtol=0, atol=most)
    assert np.max(np.abs(added / size)) > 100 * most


def _to_forces(model, view, theta):
    """Responses of the channels to a force at each coordinate, (channels, n, lines)."""
    from dashpot.estimate.likelihood.boundary_loads import with_loads

    rig = calibrated_transfer(with_loads(view), theta[None], np.ones((1, len(view.channels))))
    return np.moveaxis(rig.G[0], 0, -1)


def test_slopes_are_differences() -> None:
    model, theta = chain(3, 0.05, base=False, seed=6)
    view = observation_model(model, CHANNELS, np.array([10.0]))
    known, steps, tops = np.ones((2, 3), dtype=bool), np.array([1e-2, 2e-3]), np.array([70.0, 90.0])
    s, loads = 1j * np.array([0.2, 1.0]), np.linspace(-1, 2, 6)[None]

    def added(values):
        of = sampled_loads(view, known, model.parameters(values)[None], steps, tops)
        return np.stack([np.einsum("kcjl,kj->kcl", of.at(r, s), loads)[0] for r in range(2)])

    of = sampled_loads(view, known, model.parameters(theta)[None], steps, tops)
    slopes = np.stack([of.slopes_at(r, s, loads)[0] for r in range(2)])
    for j, value in enumerate(theta):
        step = np.zeros(len(theta))
        step[j] = 1e-5 * value
        differences = (added(theta + step) - added(theta - step)) / (2 * step[j])
        np.testing.assert_allclose(
            slopes[:, :, j], differences, rtol=0, atol=1e-7 * np.max(np.abs(slopes[:, :, j]), initial=1e-300)
        )


def test_channels_of_which_it_is_not_known() -> None:
    model, _ = chain(2, base=False)
    first, second, third = CHANNELS
    odd = (
        replace(first, gain=None),
        replace(second, delay=1e-3),
        third,
        Channel("k1", {"k1": 1.0}, Quantity.FORCE),
    )
    view = observation_model(model, odd, np.array([10.0]))
    assert shows_sampled_loads(view).tolist() == [False, False, True, False]
    massless = network("x1 x2", "", "m1@x1 k1:x1-x2 c2:x2-ground")
    assert not np.any(shows_sampled_loads(observation_model(massless, CHANNELS, np.array([10.0]))))
