"""The fast path draws from the same distribution as the samples that it spares; noise and channels are as described."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning import lines as harmonics
from dashpot.errors import DataError, UsageError
from dashpot.model.observation import noise_sd, with_relative_noise
from dashpot.study import simulate as sim
from tests.networks import network

MOTION = (Quantity.DISPLACEMENT, Quantity.VELOCITY)


@pytest.fixture
def rig():
    return network("x", "u", "m@x k:x-u=4600 c:x-u c0:x-ground")


@pytest.fixture
def p(rig):
    return rig.parameters(rig.theta({"m": 3.0, "c": 30.0, "c0": 50.0}))


def channels_of(rig, level=0.1):
    return with_relative_noise(rig, sim.standard_channels(rig, MOTION), level)


def features(spectrum):
    """Numbers whose means, over repeats, describe the joint distribution: first and second powers, cross products."""
    A = spectrum.amplitudes
    V = np.broadcast_to(spectrum.covariance, (*spectrum.batch, *spectrum.covariance.shape[-3:]))
    M = spectrum.moments.products
    K = len(A)
    upper = np.triu_indices(M.shape[-1])
    flat = [
        A.real.reshape(K, -1), A.imag.reshape(K, -1), V.real[..., :2, :2].reshape(K, -1),
        M[..., upper[0], upper[1]].reshape(K, -1),
    ]  # fmt: skip
    first = np.concatenate(flat, axis=1)
    centred = first - np.mean(first, axis=0)
    scale = np.std(first, axis=0)
    alive = scale > 1e-9 * (np.abs(np.mean(first, axis=0)) + 1e-9)
    unit = centred[:, alive] / scale[alive]
    return first[:, alive], np.concatenate(
        [unit[:, i : i + 1] * unit[:, i:] for i in range(unit.shape[1])], axis=1
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "periods", "drift"), [(9, 1.3, 1), (7, 1.0, None), (3, 1.0, None), (40, 2.5, 0)]
)
def test_fast_path_has_the_distribution_of_the_samples(rig, p, samples, periods, drift):
    """Means, variances and all correlations of amplitudes, covariances and moments, 20,000 repeats each way.

    The largest of some 200 two-sample z values stays below 5 but for a chance of 1e-4 a case.
    """
    test = sim.dwells(rig, [4.0], samples, periods=periods)
    channels = channels_of(rig, 0.3)
    K = 20_000
    records = sim.simulate_records(rig, p, channels, test, np.random.default_rng(samples), draws=K)
    slow = harmonics.spectrum(records, harmonics=(1,), drift=drift, noise="white", moments=True)
    fast = sim.simulate_spectrum(
        rig, p, channels, test, np.random.default_rng(100 + samples), draws=K,
        noise="estimated", moments=True, drift=drift,
    )  # fmt: skip
    assert np.array_equal(fast.dof, slow.dof)
    assert np.array_equal(fast.samples, slow.samples)
    for one, other in zip(features(fast), features(slow), strict=True):
        assert one.shape == other.shape
        error = np.sqrt((np.var(one, axis=0) + np.var(other, axis=0)) / K)
        z = (np.mean(one, axis=0) - np.mean(other, axis=0)) / error
        assert np.max(np.abs(z)) < 5


def test_given_covariance_is_the_true_one(rig, p):
    test = sim.dwells(rig, [4.0], 9, periods=1.3)
    found = sim.simulate_spectrum(
        rig, p, channels_of(rig), test, np.random.default_rng(1), draws=20_000, drift=1
    )
    Y = sim.clean_amplitudes(rig, p, found.channels, test)
    noise = found.amplitudes - Y
    variance = np.mean(np.abs(noise) ** 2, axis=0)
    stated = np.diagonal(found.covariance, axis1=-2, axis2=-1).real
    # |Δ|² of a nearly circular Δ has at most the spread √2 of its mean: 5 of these errors.
    assert np.all(np.abs(variance - stated) <= 5 * np.sqrt(2 / 20_000) * stated)
    assert np.all(np.isinf(found.dof))
    assert found.noise == ("given",)


def test_the_amplitudes_do_not_depend_on_what_else_is_asked(rig, p):
    test = sim.dwells(rig, [1.0, 5.0], 16)
    plain, full = (
        sim.simulate_spectrum(rig, p, channels_of(rig), test, np.random.default_rng(3), draws=5, **more)
        for more in ({}, {"noise": "estimated", "moments": True})
    )
    assert np.array_equal(plain.amplitudes, full.amplitudes)
    assert plain.moments is None
    single = sim.simulate_spectrum(
        rig, p, channels_of(rig), test, np.random.default_rng(3), noise="estimated"
    )
    assert single.batch == ()
    assert single.covariance.shape == (2, 3, 3)


def test_two_samples_a_dwell_are_enough_where_the_noise_is_given(rig, p):
    test = sim.dwells(rig, [4.0], 2, periods=0.5)
    found = sim.simulate_spectrum(
        rig, p, channels_of(rig), test, np.random.default_rng(1), draws=4, moments=True
    )
    assert np.all(np.isfinite(found.moments.products))
    with pytest.raises(DataError, match="leave no residual"):
        sim.simulate_spectrum(rig, p, channels_of(rig), test, np.random.default_rng(1), noise="estimated")
    with pytest.raises(DataError, match="cannot separate"):
        sim.simulate_spectrum(
            rig, p, channels_of(rig), sim.dwells(rig, [4.0], 2, periods=1.0), np.random.default_rng(1)
        )


def test_singular_residuals_have_the_rank_of_their_freedom(rig, p):
    channels = with_relative_noise(rig, sim.standard_channels(rig, tuple(Quantity)[:3]), 0.1)
    test = sim.dwells(rig, [4.0], 4)
    found = sim.simulate_spectrum(
        rig, p, channels, test, np.random.default_rng(1), draws=20_000, noise="estimated"
    )
    sd = noise_sd(channels, sim.clean_amplitudes(rig, p, channels, test))[0, :3]
    V = found.covariance[:, 0, :3, :3].real / np.outer(sd, sd)
    assert np.all(np.linalg.matrix_rank(V[:50], tol=1e-9) == 2)
    # E V̂ = V: Wishart entries over 2 degrees of freedom have an sd of at most their size, 4/N = 1 here.
    assert np.allclose(np.mean(V, axis=0), np.eye(3), atol=5 / np.sqrt(20_000))


@pytest.mark.slow
def test_records_return_to_the_physical_quantity(rig, p):
    """Known gain, sign and delay are in the record and out of the spectrum; noise counts in the channel's unit."""
    channels = (
        Channel("x", {"x": 1.0}, unit="mm", scale=1e-3, gain=2.0, sign=-1.0, delay=0.004, noise=0.4),
        Channel("u", {"u": 1.0}),
        Channel("foot", {"u": 1.0}, Quantity.FORCE),
        Channel("link", {"k": 1.0, "c": 1.0}, Quantity.FORCE),
    )
    test = sim.dwells(rig, [3.0], 400, periods=5.0, amplitudes={"u": 0.01})
    quiet = tuple(replace(channel, noise=0.0) for channel in channels)
    records = sim.simulate_records(
        rig, p, quiet, test, np.random.default_rng(1), offset=np.array([1.0, 0, 0, 5])
    )
    found = harmonics.spectrum(records, harmonics=(1,), drift=0)
    Y = sim.clean_amplitudes(rig, p, quiet, test)
    assert np.allclose(found.amplitudes, Y, rtol=1e-9)
    assert noise_sd(channels, Y)[0].tolist() == pytest.approx([0.4e-3 / 2, 0, 0, 0])
    # The foot carries what spring and damper pull back: u − x stretched, against the element's own x − u.
    assert found.amplitudes[0, 2] == pytest.approx(-found.amplitudes[0, 3])
    x, u = Y[0, :2]
    omega = 2 * np.pi * 3.0
    assert Y[0, 2] == pytest.approx((4600 + 1j * omega * 30) * (u - x))


def test_noise_of_constant_size_is_the_same_at_all_frequencies(rig, p):
    channels = sim.standard_channels(rig, MOTION)
    reference = sim.dwells(rig, [2.0, 4.0, 8.0])
    constant = sim.with_constant_noise(rig, p, channels, 0.1, reference)
    Y = sim.clean_amplitudes(rig, p, channels, reference)
    sd = noise_sd(constant, Y)
    assert np.allclose(sd, sd[0])
    assert np.allclose(sd[0, :2], 0.1 * np.sqrt(np.mean(np.abs(Y[:, :2]) ** 2, axis=0)))
    assert sd[0, 2] == 0
    relative = noise_sd(with_relative_noise(rig, channels, 0.1, drives=True), Y)
    assert np.allclose(relative, 0.1 * np.abs(Y))


def test_what_is_not_there_is_named(rig, p):
    with pytest.raises(UsageError, match="no input v"):
        sim.dwells(rig, [1.0], amplitudes={"v": 1.0})
    with pytest.raises(DataError, match="channel a measures"):
        sim.clean_amplitudes(rig, p, (Channel("a", {"y": 1.0}),), sim.dwells(rig, [1.0]))
    with pytest.raises(DataError, match="frequency -1 Hz"):
        sim.dwells(rig, [-1.0])


def test_rate_sets_the_time_of_a_dwell(rig):
    test = sim.dwells(rig, [2.0, 5.0], 100, rate=50.0)
    assert np.allclose(np.diff(test.time(1)), 0.02)
    assert test.periods.tolist() == [4.0, 10.0]
