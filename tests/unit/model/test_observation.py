"""What channels show: against the dynamics, finite differences, the sparse twin and sums written out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.errors import DataError
from dashpot.model import observation
from dashpot.model.dynamics import response, unit_forces
from dashpot.model.network import Input
from dashpot.model.observation import (
    calibrated_transfer,
    calibration_factors,
    calibration_slopes,
    channel_amplitudes,
    channel_unit,
    input_channels,
    is_direct,
    measures_input,
    noise_sd,
    observation_model,
    transfer,
    with_relative_noise,
)
from tests.networks import network
from tests.partly_seen import calibrations, reaction
from tests.rigs import random_rig

FORCE = Quantity.FORCE
MODEL = replace(
    network("x1 x2", "u v f@x1", "m1@x1 m2@x2 k1:x1-x2 k2:x2-u c1:x1-v h:x2-v"),
    inputs=(Input("u"), Input("v"), Input("f", "force", {"x1": 1.0, "x2": -0.5})),
)
P = np.array([3.0, 2.7, 4600.0, 3800.0, 20.0, 150.0])
OMEGA = 2 * np.pi * np.array([1.0, 4.0, 7.0, 11.0])
CHANNELS = (
    Channel("x1", {"x1": 1.0}),
    Channel("v2", {"x2": 1.0}, Quantity.VELOCITY),
    Channel("a12", {"x1": 1.0, "x2": -2.0}, Quantity.ACCELERATION),
    Channel("rel", {"x2": 1.0, "u": -1.0}),
    Channel("au", {"u": 1.0}, Quantity.ACCELERATION),
    Channel("push", {"f": 2.0}, FORCE),
    Channel("pull", {"u": 1.0}, FORCE),
    Channel("inside", {"k1": 1.0, "c1": -0.5}, FORCE),
)


def inputs(rng: np.random.Generator, lines: int = 4, count: int = 3) -> np.ndarray:
    return rng.normal(size=(lines, count)) + 1j * rng.normal(size=(lines, count))


def by_hand(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Each channel of CHANNELS from the response and the forces on the parts, term by term."""
    U, f = q[:, :2], q[:, 2]
    x1, x2 = response(MODEL, p, OMEGA, U, q[:, 2:]).T
    w = OMEGA
    k1, k2 = p[2] * (x1 - x2), p[3] * (x2 - U[:, 0])
    c1 = p[4] * 1j * w * (x1 - U[:, 1])
    shown = [
        x1, 1j * w * x2, -(w**2) * (x1 - 2 * x2), x2 - U[:, 0], -(w**2) * U[:, 0], 2 * f, -k2, k1 - 0.5 * c1,
    ]  # fmt: skip
    return np.stack(shown, axis=-1)


class TestWhatIsMeasured:
    @pytest.mark.parametrize(
        ("of", "quantity", "is_input"),
        [
            ({"u": 1.0}, Quantity.DISPLACEMENT, True),
            ({"u": 1.0, "v": -1.0}, Quantity.ACCELERATION, True),
            ({"f": 1.0}, FORCE, True),
            ({"u": 1.0}, FORCE, False),  # the reaction depends on the parameters
            ({"k1": 1.0}, FORCE, False),
            ({"x1": 1.0, "u": -1.0}, Quantity.DISPLACEMENT, False),
        ],
    )
    def test_a_reaction_is_no_input(self, of: dict[str, float], quantity: Quantity, is_input: bool) -> None:
        channel = Channel("y", of, quantity)
        assert measures_input(MODEL, channel) is is_input
        assert bool(observation_model(MODEL, (channel,), OMEGA).inputs_alone[0]) is is_input

    def test_direct_channels_depend_on_no_parameter(self) -> None:
        direct = [is_direct(MODEL, channel) for channel in CHANNELS]
        assert direct == [True] * 6 + [False] * 2
        slopes = transfer(observation_model(MODEL, CHANNELS, OMEGA), P).view.force
        assert np.any(slopes, axis=-1).tolist() == [not one for one in direct]
        for unknown in ({"gain": None}, {"delay": None}, {"sign": None}):
            assert not is_direct(MODEL, replace(CHANNELS[0], **unknown))

    def test_input_channels_show_the_inputs_in_order(self) -> None:
        view = observation_model(MODEL, input_channels(MODEL), OMEGA)
        np.testing.assert_array_equal(view.on_q, np.eye(3))

    def test_units(self) -> None:
        assert [channel_unit(MODEL, c) for c in CHANNELS[:3]] == ["m", "m/s", "m/s²"]
        torsion = replace(MODEL, angles=frozenset(("x1", "x2", "u", "v")))
        assert channel_unit(torsion, CHANNELS[0]) == "rad"
        assert channel_unit(torsion, CHANNELS[6]) == "N·m"


def test_amplitudes_are_what_the_parts_do() -> None:
    q = inputs(np.random.default_rng(1))
    view = observation_model(MODEL, CHANNELS, OMEGA)
    rig = transfer(view, P)
    expected = by_hand(P, q)
    np.testing.assert_allclose(np.einsum("lcq,lq->lc", rig.G, q), expected, rtol=1e-9)
    X = response(MODEL, P, OMEGA, q[:, :2], q[:, 2:])
    forces = P * unit_forces(MODEL, OMEGA, X, q[:, :2])
    np.testing.assert_allclose(channel_amplitudes(view, X, q, forces), expected, rtol=1e-9)
    np.testing.assert_allclose(P * rig.unit_forces(q), forces, rtol=1e-9)


def test_amplitudes_take_the_forces_that_the_elements_state() -> None:
    """An element's law is its own: channels of its force show what it states, motions do not ask."""
    rng = np.random.default_rng(2)
    view = observation_model(MODEL, CHANNELS, OMEGA)
    X, q, forces = inputs(rng, count=2), inputs(rng), inputs(rng, count=6)
    Y = channel_amplitudes(view, X, q, forces)
    np.testing.assert_allclose(Y[:, 6], -forces[:, 3], rtol=1e-12)
    np.testing.assert_allclose(Y[:, 7], forces[:, 2] - 0.5 * forces[:, 4], rtol=1e-12)
    np.testing.assert_array_equal(Y[:, :6], channel_amplitudes(view, X, q, 0 * forces)[:, :6])


def test_calibrations_and_their_slopes_against_finite_differences() -> None:
    chosen = (
        replace(CHANNELS[0], gain=None), replace(CHANNELS[1], delay=None, sign=None),
        replace(CHANNELS[6], gain=None, same_gain_as="x1"), CHANNELS[5],
    )  # fmt: skip
    view = observation_model(MODEL, chosen, OMEGA)
    assert view.names[-2:] == ("x1.gain", "v2.delay")
    assert view.units[-2:] == ("1", "s")
    psi = np.array([*P, 1.7, 0.003])
    sign = np.array([1.0, -1.0, 1.0, 1.0])
    kappa = calibration_factors(view, psi, sign)
    np.testing.assert_allclose(kappa[:, 0], 1.7)
    np.testing.assert_allclose(kappa[:, 1], -np.exp(-0.003j * OMEGA))
    np.testing.assert_allclose(kappa[:, 2:], [[1.7, 1.0]] * len(OMEGA))
    Y = inputs(np.random.default_rng(4), count=4)
    slopes = calibration_slopes(view, psi, kappa * Y)
    for k in range(2):
        step = np.where(np.arange(len(psi)) == len(P) + k, 1e-6, 0.0)
        numeric = (
            (calibration_factors(view, psi + step, sign) - calibration_factors(view, psi - step, sign))
            * Y
            / 2e-6
        )
        np.testing.assert_allclose(slopes[..., k], numeric, rtol=1e-6, atol=1e-6)


def test_calibrated_slopes_against_finite_differences() -> None:
    """Of all of ψ at fixed inputs: parameters, gains and delays."""
    chosen = (replace(CHANNELS[0], gain=None), replace(CHANNELS[6], delay=None, sign=None), CHANNELS[7])
    view = observation_model(MODEL, chosen, OMEGA)
    psi, sign = np.array([*P, 1.7, 0.003]), np.array([1.0, -1.0, 1.0])
    q = inputs(np.random.default_rng(6))
    rig = calibrated_transfer(view, psi, sign)
    shown = by_hand(P, q)[:, [0, 6, 7]] * calibration_factors(view, psi, sign)
    np.testing.assert_allclose(rig.amplitudes(q), shown, rtol=1e-9)
    for j, step in enumerate(np.diag(1e-6 * psi)):
        ends = [calibrated_transfer(view, psi + s * step, sign).amplitudes(q) for s in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * step[j])
        scale = np.max(np.abs(shown), axis=0) / psi[j]
        assert np.max(np.abs(rig.slopes(q)[..., j] - numeric) / scale) < 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_sparse_is_dense(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of solving, with and without force channels, over batches of parameters."""
    rng = np.random.default_rng(seed)
    rig = random_rig(rng, 1 + seed, displacements=1 + seed % 2, forces=seed % 3)
    chosen = [Channel(x, {x: 1.0}, Quantity.VELOCITY) for x in rig.model.coordinates]
    chosen += list(input_channels(rig.model))
    if seed % 2:
        chosen += [Channel("force in the last", {rig.model.elements[-1].name: 1.5}, FORCE)]
        chosen += [Channel(f"reaction {u}", {u: 1.0}, FORCE) for u in rig.model.displacement_inputs]
    view = observation_model(rig.model, chosen, rig.omega)
    p = rig.p * np.exp(0.1 * rng.standard_normal((2, 3, len(rig.p))))
    dense = transfer(view, p)
    monkeypatch.setattr(observation, "SPARSE_FROM", 0)
    sparse = transfer(view, p)
    q = inputs(rng, len(rig.omega), dense.G.shape[-1])
    for name in ("G", "X", "E"):
        full, other = getattr(dense, name), getattr(sparse, name)
        assert full.shape == other.shape == (2, 3, *full.shape[2:])
        np.testing.assert_allclose(other, full, rtol=1e-7, atol=1e-9 * np.max(np.abs(full)))
    q = np.broadcast_to(q, (2, 3, *q.shape))
    np.testing.assert_allclose(sparse.slopes(q), dense.slopes(q), rtol=1e-6, atol=1e-12)
    one = transfer(view, p[1, 2])
    np.testing.assert_allclose(one.G, sparse.G[1, 2], rtol=1e-7, atol=1e-12)
    # More channels than unknowns: their slopes are solved for the other way round
    wide = transfer(observation_model(rig.model, chosen * 20, rig.omega), p)
    assert wide.by_theta is not None
    np.testing.assert_allclose(
        wide.slopes(q)[..., : len(chosen), :],
        dense.slopes(q),
        rtol=1e-6,
        atol=1e-9 * np.max(abs(dense.slopes(q))),
    )


def test_noise_is_a_floor_and_a_part_of_the_amplitude() -> None:
    channel = Channel("x", {"x1": 1.0}, unit="mm", scale=1e-3, gain=-4.0, noise=0.1, relative_noise=0.03)
    assert np.allclose(noise_sd((channel,), np.array([[2.0 + 0j]])), np.hypot(0.1e-3 / 4, 0.06))
    noisy = with_relative_noise(MODEL, CHANNELS, 0.05)
    assert [c.relative_noise for c in noisy] == [0.05, 0.05, 0.05, 0.05, 0, 0, 0.05, 0.05]
    assert all(c.relative_noise == 0.05 for c in with_relative_noise(MODEL, CHANNELS, 0.05, drives=True))


def test_shared_gains_are_one_unknown() -> None:
    bench = calibrations()
    pair = (bench.channels[0], replace(bench.channels[1], delay=0.0, same_gain_as="a3"), *bench.channels[2:])
    view = observation_model(bench.model, pair, 2 * np.pi * bench.frequency_hz)
    assert view.gains == 1
    assert list(view.gain) == [0, 0, -1, -1]
    assert view.names[-1] == "a3.gain"
    assert view.units[-1] == "1"


@pytest.mark.parametrize(
    ("channel", "word"),
    [
        (Channel("F", {"k9": 1}, FORCE), "k9"),
        (Channel("x", {"x9": 1}), "x9"),
        (Channel("x", {"k1": 1}), "k1"),
        (Channel("x", {"x1": 1}, same_gain_as="a9"), "a9"),
        (Channel("x", {"x1": 1}, same_gain_as="a1"), "a1"),
    ],
)
def test_channels_of_what_is_not_there_are_refused(channel: Channel, word: str) -> None:
    bench = reaction()
    with pytest.raises(DataError, match=word):
        observation_model(bench.model, (*bench.channels, channel), 2 * np.pi * bench.frequency_hz)
