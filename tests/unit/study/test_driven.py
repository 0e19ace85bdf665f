"""The motion under a record of the inputs: sensors of any kind, late ones too, and the band of an estimate."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.study.simulate import driven_record, response_band
from tests.nonlinear_rigs import motions, two_masses
from tests.whole_rigs import chain

ALL = motions("x1", "x2", "u")
RATE = 200.0


def base_motion(samples: int) -> tuple[Real, Real, Real]:
    """Times, and a base that begins and ends at rest: displacement and acceleration, in closed form."""
    time = np.arange(samples) / RATE
    T = samples / RATE
    tones = np.array([0, 9, 14, 22, 31]) / T
    weight = np.array([0.0, 1.0, -1.0, 1.0, -1.0])
    # Tones whose sum has neither value nor slope at the ends.
    phase = 2 * np.pi * tones * time[:, None]
    u = 1e-3 * np.sum(weight * np.cos(phase), axis=1)
    a = -1e-3 * np.sum(weight * (2 * np.pi * tones) ** 2 * np.cos(phase), axis=1)
    return time, u, a


def quiet(model, theta, channels, drive):
    return driven_record(model, theta, channels, drive, np.random.default_rng(0)).values


def test_velocities_and_accelerations_are_derivatives_and_noise_is_as_stated():
    model, theta = two_masses("cubic")
    channels = (
        Channel("v1", {"x1": 1.0}, Quantity.VELOCITY), Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
        Channel("du", {"u": 1.0}, Quantity.VELOCITY), replace(ALL[0], name="noisy", noise=1e-4), *ALL,
    )  # fmt: skip
    time = np.arange(1500) / 500
    u = 1e-3 * np.sin(2 * np.pi * 3 * time) ** 2
    shown = driven_record(
        model, theta, channels, Record((ALL[2],), time, u[:, None]), np.random.default_rng(0)
    )
    v1, a2, du, noisy, x1, x2, same = shown.values.T
    inner = slice(20, -20)
    assert np.allclose(np.gradient(x1, time)[inner], v1[inner], atol=2e-3 * np.max(np.abs(v1)))
    assert np.allclose(
        np.gradient(np.gradient(x2, time), time)[inner], a2[inner], atol=1e-2 * np.max(np.abs(a2))
    )
    assert np.allclose(np.gradient(u, time)[inner], du[inner], atol=2e-3 * np.max(np.abs(du)))
    assert np.array_equal(same, u)
    assert np.std(noisy - x1) == pytest.approx(1e-4, rel=0.1)


def test_a_simulated_record_gives_the_parameters_back():
    model, theta = two_masses("quintic")
    rng = np.random.default_rng(2)
    time = np.arange(300) / 200
    u = 4e-4 * np.sum(
        np.cos(2 * np.pi * rng.uniform(1, 15, 20) * time[:, None] + rng.uniform(0, 6, 20)), axis=1
    )
    shown = driven_record(model, theta, ALL, Record((ALL[2],), time, u[:, None]), rng)
    assert np.max(np.abs(fit_records(model, [shown]).estimate().values / theta - 1)) < 1e-4


def test_a_missing_input_is_refused():
    model, theta = two_masses("cubic")
    time, rng = np.arange(50) / 200, np.random.default_rng(0)
    blind = Record((ALL[0],), time, np.zeros((50, 1)))
    with pytest.raises(DataError, match="input"):
        driven_record(model, theta, ALL, blind, rng)


@pytest.mark.parametrize("law", ["cubic", "coulomb", "bouc-wen"])
def test_the_reaction_of_a_base_is_what_accelerates_the_masses(law):
    model, theta = two_masses(law)
    time, u, _ = base_motion(400)
    points = ("x1", "x2")
    channels = [Channel(f"a{x}", {x: 1.0}, Quantity.ACCELERATION) for x in points]
    channels.append(Channel("R", {"u": 1.0}, Quantity.FORCE))
    a1, a2, R = quiet(model, theta, channels, Record((ALL[2],), time, 1e-3 * u[:, None])).T
    np.testing.assert_allclose(R, theta[0] * a1 + 2.7 * a2, atol=1e-9 * np.max(np.abs(R)))


def test_a_base_measured_as_acceleration_drives_as_its_displacement_does():
    """Offset and all: gravity in an accelerometer must not fall through the rig."""
    model, theta = chain(2, 0.03)
    time, u, a = base_motion(1200)
    floors = [Channel(x, {x: 1.0}, Quantity.ACCELERATION) for x in model.coordinates]
    by_u = quiet(model, theta, floors, Record((Channel("u", {"u": 1.0}),), time, u[:, None]))
    sensor = Channel("base", {"u": 1.0}, Quantity.ACCELERATION)
    shown = quiet(model, theta, [*floors, sensor], Record((sensor,), time, a[:, None] + 9.81))
    # The acceleration of the base jumps at the start, where a displacement's spline is smooth.
    assert np.max(np.abs(shown[:, :2] - by_u)[40:]) < 0.01 * np.max(np.abs(by_u))
    assert shown[:, 2] == pytest.approx(a + 9.81)


def test_late_channels_are_late_and_late_inputs_are_not_taken_as_such():
    """By 2.3 samples at some ten samples a cycle; identification takes the delays out again."""
    model, theta = chain(2, 0.03)
    time, u, _ = base_motion(1200)
    late = 2.3 / RATE
    x, y = (Channel(name, {name: 1.0}) for name in model.coordinates)
    base = Channel("u", {"u": 1.0})
    on_time = Record((base,), time, u[:, None])
    plain = quiet(model, theta, (x, y, base), on_time)
    shown = driven_record(model, theta, (x, replace(y, delay=late), base), on_time, np.random.default_rng(0))
    whole = np.interp(time[20:] - late, time, plain[:, 1])
    assert np.max(np.abs(shown.values[20:, 1] - whole)) < 0.05 * np.max(np.abs(whole))
    again = identify(model, spectrum([shown]))
    assert again.values == pytest.approx(theta, rel=1e-3)
    behind = Record((replace(base, delay=2 / RATE),), time, np.vstack([u[:1], u[:1], u[:-2, None]]))
    assert np.max(np.abs(quiet(model, theta, (x,), behind)[:-20] - plain[:-20, :1])) < 1e-6 * np.max(plain)


def test_reactions_of_linear_rigs_are_shown():
    model, theta = chain(2, 0.03)
    time, u, _ = base_motion(600)
    force = Channel("R", {"u": 1.0}, Quantity.FORCE)
    floors = [Channel(x, {x: 1.0}, Quantity.ACCELERATION) for x in model.coordinates]
    shown = quiet(model, theta, [force, *floors], Record((Channel("u", {"u": 1.0}),), time, u[:, None]))
    p = dict(zip([e.name for e in model.elements], model.parameters(theta), strict=True))
    assert shown[:, 0] == pytest.approx(p["m1"] * shown[:, 1] + p["m2"] * shown[:, 2], abs=1e-9 * 4000)


@pytest.mark.slow
def test_the_band_counts_gain_and_delay_of_a_channel():
    model, theta = chain(1, 0.05)
    time, u, _ = base_motion(800)
    base, x = Channel("u", {"u": 1.0}), Channel("x1", {"x1": 1.0}, gain=None, delay=None)
    other = Channel("v1", {"x1": 1.0}, Quantity.VELOCITY)
    drive = Record((base,), time, u[:, None])
    true = replace(x, gain=1.2, delay=0.004)
    noisy = (replace(true, noise=2e-5), replace(other, noise=2e-3), base)
    taken = driven_record(model, theta, noisy, drive, np.random.default_rng(3))
    data = replace(taken, channels=(x, other, base))
    start = MaximumLikelihood(start=(*theta.tolist(), 1.2, 0.004))
    found = identify(model, spectrum([data]), start)
    predicted, band = response_band(model, found, data.channels, drive)
    clean = quiet(model, theta, (true, other, base), drive)
    away = (predicted.values - clean)[50:, 0] / band[50:, 0]
    assert 0.1 < np.sqrt(np.mean(away**2)) < 3
    gain = found["x1.gain"]
    top = int(np.argmax(np.abs(predicted.values[:, 0])))
    assert band[top, 0] > 0.5 * gain.sd / gain.value * abs(predicted.values[top, 0])
